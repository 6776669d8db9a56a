"""A linear loop gain L given as state space: 1 + k L = 0 in the same form as the loops with a filter."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import control as ct
import numpy as np

from ..._sections import ComplexArray, FloatArray
from .. import _resolvent
from . import sweep

__all__ = ["StateSpaceLoop"]

# Zeros beyond this many times the fastest pole come from rounding.
_FAR = 1e6


@dataclass(frozen=True, eq=False)
class StateSpaceLoop(sweep.Remembered):
    """Q + k P with P = L Q, Q = prod (s - p)/(s + |p|) over the open-loop poles (z - p over z): smooth at poles too."""

    system: ct.StateSpace
    delay: float = 0.0

    @property
    def nyquist(self) -> float:
        return np.pi / self._step if self._step else float("inf")

    @cached_property
    def tail(self) -> tuple[float, float]:
        return float("inf"), float("inf")

    @cached_property
    def _step(self) -> float:
        return float(self.system.dt) if self.system.isdtime(strict=True) else 0.0

    @cached_property
    def _matrices(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        system = self.system
        A, B, C, D = (np.asarray(part, dtype=float) for part in (system.A, system.B, system.C, system.D))
        return A, B, C, D

    @cached_property
    def _poles(self) -> ComplexArray:
        return np.linalg.eigvals(self._matrices[0]).astype(np.complex128)

    @cached_property
    def _scale(self) -> float:
        sizes = np.abs(self._poles)
        return float(np.max(sizes, initial=0.0)) or 1.0

    def _evaluate(self, omega: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        points = np.exp(1j * omega * self._step) if self._step else 1j * omega
        Q = np.ones(len(points), dtype=np.complex128)
        for pole in self._poles:
            # A pole at 0 is measured against a slow one.
            against = points if self._step else points + max(abs(pole), 1e-3 * self._scale)
            Q = Q * ((points - pole) / against)
        L = _resolvent.evaluate(*self._matrices, points.astype(np.complex128))[0, 0]
        # L is infinite only where a pole is hit exactly: P is finite there, but unknown; one grid point among many.
        return Q, np.where(np.isfinite(L), L, 0.0) * Q

    @cached_property
    def at_zero(self) -> tuple[float, float]:
        return self._real(1.0 if self._step else 0.0)

    @cached_property
    def at_nyquist(self) -> tuple[float, float]:
        """At z = -1, or at infinity."""
        return self._real(-1.0) if self._step else (1.0, float(self._matrices[3][0, 0]))

    def _real(self, point: float) -> tuple[float, float]:
        """1 and L at a real point, (0, 1) at a pole."""
        value = complex(_resolvent.evaluate(*self._matrices, np.array([point], dtype=np.complex128))[0, 0, 0])
        finite = np.isfinite(value) and abs(value) < 1.0 / sweep.SAME
        return (1.0, value.real) if finite else (0.0, 1.0)

    @cached_property
    def grid(self) -> FloatArray:
        zeros = np.asarray(self.system.zeros(), dtype=np.complex128)
        corners = np.concatenate([self._poles, zeros[np.isfinite(zeros)]])
        if self._step:
            corners = np.log(corners[corners != 0.0]) / self._step
            corners = np.append(corners, self.nyquist)
        corners = corners[(np.abs(corners) < _FAR * self._scale) | bool(self._step)]
        # A pole at 0 comes out of the eigenvalue solver as rounding.
        corners = corners[np.abs(corners) > 1e-9 * np.max(np.abs(corners), initial=0.0)]
        if len(corners) == 0:
            corners = np.ones(1, dtype=np.complex128)
        return sweep.grid(corners, self.nyquist, turn=4.0 * self._step)

    def roots(self, ratio: complex) -> ComplexArray:
        """Eigenvalues of the loop closed with L scaled by ``ratio``."""
        A, B, C, D = self._matrices
        return np.linalg.eigvals(A - B @ C * (ratio / (1.0 + ratio * D[0, 0]))).astype(np.complex128)

    def unstable(self, ratio: complex) -> int | None:
        """Number of closed-loop poles that are not stable, hidden ones too; None for a singular algebraic loop."""
        if 1.0 + ratio * self._matrices[3][0, 0] == 0.0:
            return None
        roots = self.roots(ratio)
        sampled = bool(self._step)
        return sweep.count_unstable(roots - 1.0 if sampled else roots, sampled=sampled)
