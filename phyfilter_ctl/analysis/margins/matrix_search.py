"""Margins of loops that are no scalar: opened at several signals, sampled at several rates, or acting between instants.

One factor k multiplies all opened signals. Real k: gain; k = e^(j phi): phase; dynamic perturbations: the disk.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import control as ct
import numpy as np

from ..._sections import ComplexArray, FloatArray
from .. import _resolvent
from . import sweep
from ._scaling import scaled_norm
from .scalar_search import NONE, Bound, StableGains

__all__ = ["MatrixSearch"]

# Factors that are looked at, and points of a half turn.
_FACTORS = np.geomspace(1e-4, 1e4, 641)
_PHASES = np.linspace(0.0, np.pi, 361)
# Points at most of the frequency grid; a peak between them is refined.
_MOST_POINTS = 1200
# Stands for a pole at infinity.
_AWAY = 1e100

_Matrices: TypeAlias = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class MatrixSearch:
    """A loop as a matrix that depends on the factor on its opened signals.

    Parameters
    ----------
    closed : callable
        k -> state matrix of the loop closed with the signals times k.
    step : float
        Seconds that the matrix advances; 0 for a rate of change.
    system : control.StateSpace or None
        L, where there is one.
    blocks : tuple of int
        Entries of L that belong to each signal.
    delayed : callable, optional
        Searches the delay margin where a delay is more than a lag in phase.
    missing : str
        Which margins are nan, and why.
    """

    closed: Callable[[complex], FloatArray | ComplexArray]
    step: float
    system: ct.StateSpace | None
    blocks: tuple[int, ...]
    delayed: Callable[[], Bound] | None = None
    missing: str = ""

    @classmethod
    def of(
        cls,
        system: ct.StateSpace,
        blocks: tuple[int, ...] | None = None,
        delayed: Callable[[], Bound] | None = None,
        missing: str = "",
    ) -> MatrixSearch:
        """That of a loop gain L with the return difference I + L."""
        A, B, C, D = _matrices(system)

        def closed(k: complex) -> FloatArray | ComplexArray:
            through = np.eye(len(D)) + k * D
            # Not solve: with no states some versions of it take a singular matrix.
            return np.asarray(A - k * (B @ np.linalg.inv(through) @ C))

        step = float(system.dt) if system.isdtime(strict=True) else 0.0
        return cls(closed, step, system, blocks or (1,) * len(D), delayed, missing)

    @cached_property
    def is_stable(self) -> bool:
        return bool(self._excess(np.ones(1))[0] < 0.0)

    @cached_property
    def stable_gains(self) -> tuple[StableGains, ...]:
        edges, before = sweep.sign_changes(self._excess, _FACTORS)
        inside = self._excess(_FACTORS[:1])[0] < 0.0
        bounds = [(0.0, NONE)] if inside else []
        bounds += [(float(edge), self._frequency(edge)) for edge in edges[before != 0.0]]
        if len(bounds) % 2:
            bounds.append((float("inf"), NONE))
        pairs = zip(bounds[::2], bounds[1::2], strict=True)
        return tuple(StableGains(low, high, (w0, w1)) for (low, w0), (high, w1) in pairs)

    @cached_property
    def phase(self) -> Bound:
        found = sweep.sign_changes(lambda phi: self._excess(np.exp(1j * phi)), _PHASES)[0]
        if not len(found):
            return Bound(float("inf"), NONE)
        return Bound(float(found[0]), self._frequency(np.exp(1j * found[0])))

    @cached_property
    def delay(self) -> Bound:
        if self.delayed is not None:
            return self.delayed()
        if self.system is None:
            return Bound(NONE, NONE)
        omega, lag = self.lags()
        if not len(omega):
            return Bound(float("inf"), NONE)
        k = int(np.argmin(lag / omega))
        return Bound(float(lag[k] / omega[k]), float(omega[k]))

    @cached_property
    def gain_crossings(self) -> FloatArray:
        """Where an eigenvalue of L has modulus 1."""
        return np.unique(self.lags()[0]) if self.system is not None else np.zeros(0)

    def lags(self) -> tuple[FloatArray, FloatArray]:
        """Frequencies at which an eigenvalue of L has modulus 1, and the lag in (0, 2 pi] that brings it to -1."""

        def sizes(omega: FloatArray) -> FloatArray:
            return np.sort(np.abs(np.linalg.eigvals(self._values(omega))), axis=1)

        # Sorted by modulus they are continuous, though not which of them is which.
        on_grid = sizes(self.grid)
        near = np.flatnonzero((on_grid.min(axis=0) < 1.1) & (on_grid.max(axis=0) > 0.9))
        found = [sweep.sign_changes(lambda w, i=i: sizes(w)[:, i] - 1.0, self.grid)[0] for i in near]
        omega = np.concatenate([np.zeros(0), *found])
        if not len(omega):
            return omega, omega
        values = np.linalg.eigvals(self._values(omega))
        nearest = np.argmin(np.abs(np.abs(values) - 1.0), axis=1)
        lag = np.angle(-values[range(len(omega)), nearest]) % (2.0 * np.pi)
        return omega, np.where(lag == 0.0, 2.0 * np.pi, lag)

    def disk(self, skew: float) -> Bound:
        """By the least upper bound with scalings D, at each frequency."""
        if self.system is None:
            return Bound(NONE, NONE)
        # S has the poles of the closed loop: it is finite where L is not.
        S = _sensitivity(*_matrices(self.system))
        shift = 0.5 * (skew - 1.0) * np.eye(sum(self.blocks))

        def sizes(omega: FloatArray, *, exact: bool) -> FloatArray:
            return scaled_norm(self._response(S, omega) + shift, self.blocks, exact=exact)

        points = np.append(0.0, self.grid)
        quick = sizes(points, exact=False)
        best, where = 0.0, 0
        # From the largest quick bound down, until none that is left can beat the best.
        for i in np.argsort(-quick):
            if quick[i] <= best:
                break
            found = float(sizes(points[i : i + 1], exact=True)[0])
            best, where = max((best, where), (found, int(i)))
        if not best:
            return Bound(float("inf"), NONE)
        alpha, omega = 1.0 / best, float(points[where])
        around = points[max(0, where - 1) : where + 2]
        if len(around) == 3:
            alpha, omega = min((alpha, omega), sweep.least(lambda w: 1.0 / sizes(w, exact=True), around))
        limit = float(scaled_norm((S[3] + shift)[None].astype(np.complex128), self.blocks)[0])
        if not self.step and limit * alpha > 1.0:
            return Bound(1.0 / limit, float("inf"))
        return Bound(alpha, omega)

    @cached_property
    def grid(self) -> FloatArray:
        """Frequencies in rad/s up to the Nyquist frequency of ``step``."""
        assert self.system is not None
        poles = [np.linalg.eigvals(np.asarray(self.system.A)), np.linalg.eigvals(self.closed(1.0))]
        corners = np.concatenate(poles).astype(np.complex128)
        nyquist = np.pi / self.step if self.step else np.inf
        if self.step:
            corners = np.append(np.log(corners[np.abs(corners) > 1e-12]) / self.step, nyquist)
        corners = corners[np.abs(corners) > 1e-9 * np.max(np.abs(corners), initial=0.0)]
        corners = corners if len(corners) else np.ones(1, dtype=np.complex128)
        points = sweep.grid(corners, nyquist, turn=4.0 * self.step)
        points = points[:: max(1, len(points) // _MOST_POINTS)]
        return np.union1d(points, nyquist) if self.step else points

    def _values(self, omega: FloatArray) -> ComplexArray:
        """L, (K, n, n)."""
        assert self.system is not None
        L = self._response(_matrices(self.system), omega)
        # A pole is hit exactly at one point of the grid at most.
        return np.where(np.isfinite(L), L, 1e150 * np.eye(L.shape[1]))

    def _response(self, matrices: _Matrices, omega: FloatArray) -> ComplexArray:
        """(K, n, n)."""
        points = np.exp(1j * omega * self.step) if self.step else 1j * omega
        return np.moveaxis(_resolvent.evaluate(*matrices, points.astype(np.complex128)), 2, 0)

    def _roots(self, k: complex) -> ComplexArray:
        try:
            return np.linalg.eigvals(self.closed(k)).astype(np.complex128)
        except np.linalg.LinAlgError:  # a singular algebraic loop, which is not stable
            return np.array([_AWAY + 0j])

    def _excess(self, factors: FloatArray | ComplexArray) -> FloatArray:
        """How far the worst closed-loop pole is outside, (K,)."""
        roots = (self._roots(k) for k in factors)
        if self.step:
            return np.array([np.max(np.abs(each), initial=0.0) - 1.0 for each in roots])
        return np.array([np.max(each.real, initial=-np.inf) for each in roots])

    def _frequency(self, k: complex) -> float:
        """Of the closed-loop pole on the boundary, in rad/s: sampled, modulo 2 pi/step."""
        roots = self._roots(k)
        if self.step:
            return abs(float(np.angle(roots[np.argmax(np.abs(roots))]))) / self.step
        return abs(float(roots[np.argmax(roots.real)].imag))


def _matrices(system: ct.StateSpace) -> _Matrices:
    A, B, C, D = (np.asarray(part, dtype=float) for part in (system.A, system.B, system.C, system.D))
    return A, B, C, D


def _sensitivity(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray) -> _Matrices:
    """Of (I + L)^-1."""
    inverse = np.asarray(np.linalg.inv(np.eye(len(D)) + D), dtype=float)
    return A - B @ inverse @ C, B @ inverse, -(inverse @ C), inverse
