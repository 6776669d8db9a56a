"""What a filter within limits is to make least, and how a step of it changes that."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..._sections import ComplexArray, FloatArray
from ...filter import Sampling
from ...filter.recursion import transition
from .parametrisation import Chain
from .sensitivity import Data

__all__ = ["Estimation", "Objective", "Remembering", "responses"]


class Objective(Protocol):
    """What a filter within the limits is to make least."""

    def cost(self, chain: Chain, c: FloatArray) -> float:
        """A mean square; inf where there is none."""
        ...

    def model(self, chain: Chain, c: FloatArray, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gradient (p,) and Gauss-Newton matrix (p, p) by unknowns that move F by ``rows`` [xi; eta]."""
        ...


@dataclass(frozen=True, eq=False)
class Estimation(Objective):
    """Mean square of gamma* - F u on the flights.

    Attributes
    ----------
    data : Data
    """

    data: Data

    def cost(self, chain: Chain, c: FloatArray) -> float:
        """See :class:`Objective`."""
        found, n = self.data.moments(chain.doubled), chain.order
        if found is None:
            return float("inf")
        G, m = found
        return float(self.data.energy - 2.0 * c @ m[:n] + c @ G[:n, :n] @ c) / self.data.weight

    def model(self, chain: Chain, c: FloatArray, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :class:`Objective`."""
        found = self.data.moments(chain.doubled)
        assert found is not None  # the filter has a cost on these data
        G, m = found
        scale = 2.0 / self.data.weight
        return -scale * rows @ (m - G[:, : chain.order] @ c), scale * rows @ G @ rows.T


class Remembering(Data):
    """Data whose moments are asked for several times at one filter.

    Parameters
    ----------
    data : Data
    """

    def __init__(self, data: Data) -> None:
        self.data: Data = data
        self._key, self._found = b"", None

    @property
    def energy(self) -> float:
        """As of the data."""
        return self.data.energy

    @property
    def weight(self) -> float:
        """As of the data."""
        return self.data.weight

    def moments(self, doubled: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """As of the data."""
        key = doubled.tobytes()
        if key != self._key:
            self._key, self._found = key, self.data.moments(doubled)
        return self._found


def responses(chain: Chain, omega: FloatArray, sampling: Sampling, *, whole: bool = True) -> ComplexArray:
    """States of the sampled doubled chain, per measured residual, (k, 2n): [xi; eta], or xi alone (k, n)."""
    size = 2 * chain.order if whole else chain.order
    A, B = chain.doubled[:size, :size], chain.doubled[:size, -1]
    dA = transition(A, sampling.method, sampling.dt)
    drive = dA @ np.linalg.solve(A, B)
    delta = np.expm1(1j * omega * sampling.dt)
    drives = np.tile(drive.astype(np.complex128), (len(omega), 1))[..., None]
    found = np.linalg.solve(delta[:, None, None] * np.eye(size) - dA, drives)[..., 0]
    return np.asarray((1.0 + delta)[:, None] * found, dtype=np.complex128)
