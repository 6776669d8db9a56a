"""The loop in continuous time, Q(s) + mu P(s) e^(-s delay), normalised by its stable denominators.

    1 - F + mu Act e^(-s delay) (F + Kp/s^2 + Kd/s) = 0

times (s/(s + r))^k, k the number of integrators of the outer loop, is q(s) + mu p(s) e^(-s delay) with stable q and p,
q(inf) = 1 and p(inf) = 0: no neutral chain of roots, finitely many on the right.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import polynomial as poly

from ..._sections import ComplexArray, FloatArray
from ...filter import PhyFilter
from ...values.actuator import Actuator
from . import sweep
from ._factors import Factors, roots_of, trimmed
from ._winding import zeros_on_the_right

__all__ = ["ContinuousLoop", "phase_slope"]

# Roots with a smaller real part, relative, turn the phase at one frequency only.
_ON_AXIS = 1e-12


def phase_slope(factors: Factors, omega: FloatArray) -> FloatArray:
    """Derivative of the phase by the frequency in rad/s; roots on the axis turn it at one frequency only."""
    slope = np.zeros(len(omega))
    for sign, roots in ((1.0, factors.zeros), (-1.0, factors.poles)):
        for root in roots[np.abs(roots.real) > _ON_AXIS * np.abs(roots)]:
            slope -= sign * root.real / np.abs(1j * omega - root) ** 2
    return slope


@dataclass(frozen=True, eq=False)
class ContinuousLoop(sweep.Remembered):
    """Filter, actuator, delay and outer gains kp, kd per unit mass."""

    filter: PhyFilter
    actuator: Actuator
    delay: float
    kp: float
    kd: float

    @property
    def nyquist(self) -> float:
        return float("inf")

    @property
    def _integrators(self) -> int:
        return 2 if self.kp else 1 if self.kd else 0

    @cached_property
    def _outer(self) -> FloatArray:
        """Numerator of F + Kp/s^2 + Kd/s over D s^k, ascending."""
        k = self._integrators
        numerator = np.concatenate([np.zeros(k), trimmed(self.filter.b, self.filter.poles)])
        if k == 0:
            return numerator
        gains = np.array([self.kp, self.kd] if k == 2 else [self.kd])
        return poly.polyadd(numerator, poly.polymul(gains, np.append(self.filter.a, 1.0)))

    @cached_property
    def factors(self) -> tuple[Factors, Factors]:
        """(q, p)."""
        filter, k = self.filter, self._integrators
        shift = np.full(k, -self._shift, dtype=np.complex128)
        own = np.concatenate([roots_of(filter.error_numerator)[1], 0.0 * shift])
        gain, zeros = roots_of(self.actuator.numerator)
        outer_gain, outer_zeros = roots_of(self._outer)
        poles = np.concatenate([filter.poles, shift])
        q = Factors.build(1.0, own, poles)
        p = Factors.build(
            gain * outer_gain,
            np.concatenate([zeros, outer_zeros]),
            np.concatenate([poles, self.actuator.poles]),
        )
        return q, p

    @cached_property
    def polynomials(self) -> tuple[FloatArray, FloatArray]:
        """Ascending coefficients of Q = (D - N) den s^k and P = num (N s^k + ...): Q + mu P e^(-s delay) = 0."""
        Q = poly.polymul(self.filter.error_numerator, self.actuator.denominator)
        Q = np.concatenate([np.zeros(self._integrators), Q])
        P = poly.polymul(self.actuator.numerator, self._outer)
        return Q.astype(np.float64), np.pad(P, (0, len(Q) - len(P))).astype(np.float64)

    def _evaluate(self, omega: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """q and mu-free p e^(-s delay) on the imaginary axis, each (K,)."""
        s = (1j * omega).astype(np.complex128)
        q, p = self.factors
        return q(s), p(s) * np.exp(-s * self.delay)

    def error(self, omega: FloatArray) -> ComplexArray:
        """Q, (K,)."""
        return self(omega)[0]

    def normalisation(self, omega: FloatArray) -> ComplexArray:
        """(s/(s + r))^k on the imaginary axis, (K,)."""
        s = (1j * omega).astype(np.complex128)
        return (s / (s + self._shift)) ** self._integrators

    @property
    def _shift(self) -> float:
        """r."""
        return float(np.exp(np.mean(np.log(np.abs(self.filter.poles)))))

    @cached_property
    def at_zero(self) -> tuple[float, float]:
        """q and p at s = 0."""
        q, p = self.factors
        zero = np.zeros(1, dtype=np.complex128)
        return float(q(zero)[0].real), float(p(zero)[0].real)

    @cached_property
    def at_nyquist(self) -> None:
        return None

    @cached_property
    def corners(self) -> ComplexArray:
        """Roots and poles at which the loop changes its slope."""
        q, p = self.factors
        corners = np.concatenate([q.zeros, q.poles, p.zeros, p.poles])
        return corners[corners != 0.0]

    @cached_property
    def tail(self) -> tuple[float, float]:
        """(frequency, ratio): beyond the frequency every crossing is of a pole that leaves the stable region, as the
        phase of P/Q only falls; up to the ratio every crossing is on the grid."""
        return self._reach[0], self._reach[2]

    @cached_property
    def _reach(self) -> tuple[float, float, float]:
        """Where the delay outruns the phase of P/Q, the end of the grid, the ratio that all beyond it exceeds."""
        if self.delay == 0.0:
            return float("inf"), float("inf"), float("inf")
        omega = sweep.grid(self.corners, float("inf"))
        # Not the whole delay: the phase is looked at on a grid only.
        forward = np.flatnonzero(self._phase_slope(omega) > 0.5 * self.delay)
        start = float(omega[min(int(forward[-1]) + 1, len(omega) - 1)]) if len(forward) else 0.0
        # The phase falls by a whole turn between these two: the negative real axis is crossed there for certain.
        turn = 4.0 * np.pi / self.delay
        inner, outer = start + turn, start + 2.0 * turn
        omega = np.union1d(
            omega, np.append(np.linspace(inner, outer, 100), 1e3 * max(outer, float(omega[-1])))
        )
        least, most = self._gains(omega)
        later = np.maximum.accumulate(most[::-1])[::-1]
        # What lies beyond the end needs larger ratios than the first crossing in the tail.
        first = np.min(least[(omega >= inner) & (omega <= outer)])
        enough = np.flatnonzero((omega >= outer) & (later <= first))
        k = int(enough[0]) if len(enough) else len(omega) - 1
        return start, float(omega[k]), 1.0 / float(later[k]) if later[k] else float("inf")

    def _gains(self, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What |P/Q| is between."""
        q, p = self.factors
        s = (1j * omega).astype(np.complex128)
        with np.errstate(divide="ignore", invalid="ignore"):
            gain = np.nan_to_num(np.abs(p(s) / q(s)), nan=0.0)
        return gain, gain

    def _phase_slope(self, omega: FloatArray) -> FloatArray:
        """Derivative of the phase of P/Q without the delay, or more."""
        q, p = self.factors
        return phase_slope(p, omega) - phase_slope(q, omega)

    @cached_property
    def grid(self) -> FloatArray:
        """Frequencies dense enough that every crossing has its own interval, up into the tail."""
        if self.delay == 0.0:
            logarithmic = sweep.grid(self.corners, float("inf"))
            return np.union1d(logarithmic, self._exact_crossings)
        return sweep.grid(np.append(self.corners, 1.0 / self.delay), self._reach[1], turn=self.delay)

    @property
    def _exact_crossings(self) -> FloatArray:
        """Without delay Im P(j omega) conj Q(j omega) is a polynomial: points between its roots.

        The points between, not the roots: the search then finds a change of sign between each two, misses none.
        """
        Q, P = self.polynomials
        scale = float(np.exp(np.mean(np.log(np.abs(self.corners)))))
        powers = scale ** np.arange(len(Q))
        Q, P = Q * powers, P * powers
        Q = Q / np.max(np.abs(Q))
        product = poly.polymul(P, Q * (-1.0) ** np.arange(len(Q)))[1::2]
        # Odd powers of s = j w: s^(2m+1) = j w (-w^2)^m.
        squares = -roots_of(product)[1]
        squares = squares[(np.abs(squares.imag) <= 1e-6 * np.abs(squares)) & (squares.real > 0.0)]
        found = np.unique(np.sqrt(squares.real)) * scale
        if len(found) == 0:
            return found
        between = np.sqrt(found[:-1] * found[1:])
        return np.concatenate([found[:1] / 1.01, between, found[-1:] * 1.01])

    def roots(self, ratio: complex) -> ComplexArray | None:
        """Closed-loop poles in rad/s; None with delay, where there are infinitely many."""
        if self.delay:
            return None
        Q, P = self.polynomials
        scale = float(np.exp(np.mean(np.log(np.abs(self.corners)))))
        closed = (Q + ratio * P) * scale ** (np.arange(len(Q)) - (len(Q) - 1.0))
        first = int(np.argmax(closed != 0.0))
        found = np.roots(closed[first:][::-1]) * scale
        return np.concatenate([np.zeros(first), found]).astype(np.complex128)

    def unstable(self, ratio: complex) -> int | None:
        """Number of closed-loop poles that are not in the open left half plane."""
        roots = self.roots(ratio)
        if roots is None:
            q, p = self.factors
            return zeros_on_the_right(q, p, self.delay, complex(ratio), self.grid[:: self._thin])
        return sweep.count_unstable(roots, sampled=False)

    @cached_property
    def _thin(self) -> int:
        # The certified count halves pieces where it must: a coarse start is cheaper.
        return max(1, len(self.grid) // 200)
