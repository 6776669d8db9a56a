"""The loop whose filter is told the force that acts, Act e^(-s delay) v, instead of the command v.

    1 + Act e^(-s delay) [(mu - 1) F + mu (Kp/s^2 + Kd/s)] = 0

Over the ratios mu it is Q + mu P with Q = 1 - Act e^(-s delay) F: a second delay, and no factor of mu alone. Opened at
the command, at one mu, it is 1 + k L with L = Act e^(-s delay) [(mu - 1) F + mu K]. With mu = 1 the filter is not in
the loop.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.polynomial import polynomial as poly

from ..._sections import ComplexArray, FloatArray
from ...values.actuator import Actuator
from . import sweep
from ._continuous import ContinuousLoop, phase_slope
from ._factors import Factors, roots_of, trimmed
from ._winding import zeros_on_the_right
from .sampled import SampledLoop

__all__ = ["AppliedLoop", "opened"]

# Coefficients of 1 - Act below this, relative, come from rounding.
_NOTHING = 1e-13


def opened(loop: sweep.Characteristic, ratio: float) -> tuple[sweep.Characteristic, float]:
    """A loop, and the gain of it that is there, whose gains are those of the command: margins are taken of it."""
    if isinstance(loop, AppliedLoop):
        return loop.opened(ratio), 1.0
    if isinstance(loop, SampledLoop) and loop.told == "applied":
        return _OpenedSampled(loop, ratio), 1.0
    return loop, ratio


@dataclass(frozen=True, eq=False)
class _Applied(ContinuousLoop):
    """What the two loops share: nothing cancels in the denominators of filter and actuator."""

    @cached_property
    def _poles(self) -> ComplexArray:
        shift = np.full(self._integrators, -self._shift, dtype=np.complex128)
        return np.concatenate([self.filter.poles, self.actuator.poles, shift])

    @cached_property
    def _passed(self) -> FloatArray:
        """Numerator of Act F s^k, ascending."""
        numerator = poly.polymul(self.actuator.numerator, trimmed(self.filter.b, self.filter.poles))
        return np.concatenate([np.zeros(self._integrators), numerator]).astype(np.float64)

    @cached_property
    def _held(self) -> FloatArray:
        """Numerator of Act K s^k over the same denominator."""
        gains = np.array([[], [self.kd], [self.kp, self.kd]][self._integrators])
        if not len(gains):
            return np.zeros(1)
        numerator = poly.polymul(gains, np.append(self.filter.a, 1.0))
        return poly.polymul(self.actuator.numerator, numerator).astype(np.float64)


@dataclass(frozen=True, eq=False)
class AppliedLoop(_Applied):
    """As :class:`ContinuousLoop`, over mu: q is without the delay."""

    def opened(self, ratio: float) -> _Opened:
        """At the command."""
        return _Opened(self.filter, self.actuator, self.delay, self.kp, self.kd, ratio)

    @cached_property
    def _told(self) -> Factors:
        """Act F (s/(s + r))^k."""
        gain, zeros = roots_of(self._passed)
        return Factors.build(gain, zeros, self._poles)

    @cached_property
    def polynomials(self) -> tuple[FloatArray, FloatArray]:
        """Ascending coefficients of Q and P without the delay, over one denominator."""
        P = poly.polymul(self.actuator.numerator, self._outer)
        # 1 - Act F = (1 - F) + F (1 - Act): zeros at s = 0 stay exact.
        missing = poly.polysub(self.actuator.denominator, self.actuator.numerator)
        missing[np.abs(missing) <= _NOTHING * self.actuator.denominator[: len(missing)]] = 0.0
        Q = poly.polyadd(
            poly.polymul(self.filter.error_numerator, self.actuator.denominator),
            poly.polymul(trimmed(self.filter.b, self.filter.poles), missing),
        )
        Q = np.concatenate([np.zeros(self._integrators), Q])
        return Q.astype(np.float64), np.pad(P, (0, len(Q) - len(P))).astype(np.float64)

    @cached_property
    def factors(self) -> tuple[Factors, Factors]:
        """(q, p), the delay left out of both."""
        (_, own), (gain, zeros) = (roots_of(part) for part in self.polynomials)
        return Factors.build(1.0, own, self._poles), Factors.build(gain, zeros, self._poles)

    def _evaluate(self, omega: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        s = (1j * omega).astype(np.complex128)
        q, p = self.factors
        return q(s) - self._told(s) * np.expm1(-s * self.delay), p(s) * np.exp(-s * self.delay)

    def _share(self, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
        """|Act F|, below 1 where the two below hold, and |(s/(s + r))^k|."""
        whole = np.abs(self.normalisation(omega))
        return np.minimum(np.abs(self._told((1j * omega).astype(np.complex128))) / whole, 1.0), whole

    def _gains(self, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
        share, whole = self._share(omega)
        gain = np.abs(self.factors[1]((1j * omega).astype(np.complex128))) / whole
        with np.errstate(divide="ignore"):
            return gain / (1.0 + share), gain / (1.0 - share)

    def _phase_slope(self, omega: FloatArray) -> FloatArray:
        """That of P/(s/(s + r))^k, and at most as much as 1/(1 - Act e^(-s delay) F) may add."""
        k, told, s = self._integrators, self._told, 1j * omega[:, None]
        shifted = np.full(k, -self._shift, dtype=np.complex128)
        slope = phase_slope(self.factors[1], omega)
        slope -= phase_slope(Factors(1.0, 0.0 * shifted, shifted), omega)
        share, _ = self._share(omega)
        zeros = told.zeros[told.zeros != 0.0]
        turned = np.sum(1.0 / (s - zeros), axis=1) - np.sum(
            1.0 / (s - self._poles[: len(self._poles) - k]), axis=1
        )
        turned += np.count_nonzero(told.zeros == 0.0) / s[:, 0] - k / s[:, 0]
        with np.errstate(divide="ignore"):
            return slope + share * (np.abs(turned) + self.delay) / (1.0 - share)

    def unstable(self, ratio: complex) -> int | None:
        """Number of closed-loop poles that are not in the open left half plane."""
        if not self.delay:
            return super().unstable(ratio)
        ratio = complex(ratio)
        loop = self.opened(ratio.real)
        if ratio.imag == 0.0:
            return loop.unstable(1.0)
        numerator = poly.polyadd((ratio - 1.0) * self._passed, ratio * self._held).astype(np.complex128)
        leading = complex(numerator[np.flatnonzero(numerator)[-1]])
        p = Factors.build(1.0, roots_of(numerator / leading)[1], self._poles)
        return zeros_on_the_right(loop.factors[0], p, self.delay, leading, loop.grid[:: loop._thin])


@dataclass(frozen=True, eq=False)
class _Opened(_Applied):
    """1 + k L at one ratio."""

    ratio: float

    @cached_property
    def polynomials(self) -> tuple[FloatArray, FloatArray]:
        """Ascending coefficients of s^k times the denominator of Act F, and of L times that."""
        denominator = poly.polymul(np.append(self.filter.a, 1.0), self.actuator.denominator)
        Q = np.concatenate([np.zeros(self._integrators), denominator])
        P = poly.polyadd((self.ratio - 1.0) * self._passed, self.ratio * self._held)
        return Q.astype(np.float64), np.pad(P, (0, len(Q) - len(P))).astype(np.float64)

    @cached_property
    def factors(self) -> tuple[Factors, Factors]:
        """(q, p)."""
        gain, zeros = roots_of(self.polynomials[1])
        own = self._poles.copy()
        own[len(own) - self._integrators :] = 0.0
        return Factors.build(1.0, own, self._poles), Factors.build(gain, zeros, self._poles)


@dataclass(frozen=True, eq=False)
class _OpenedSampled(sweep.Remembered):
    """1 + k L on the unit circle."""

    loop: SampledLoop
    ratio: float

    @property
    def nyquist(self) -> float:
        return self.loop.nyquist

    @cached_property
    def tail(self) -> tuple[float, float]:
        return self.loop.tail

    @property
    def delay(self) -> float:
        return self.loop.delay

    @property
    def kp(self) -> float:
        return self.loop.kp

    @property
    def kd(self) -> float:
        return self.loop.kd

    @cached_property
    def grid(self) -> FloatArray:
        return self.loop.grid

    def _evaluate(self, omega: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        return np.ones(len(omega), dtype=np.complex128), self.loop.gain(omega, self.ratio)

    @cached_property
    def at_zero(self) -> tuple[float, float]:
        Q, P = self.loop.at_zero
        return (Q, P) if self.kp or self.kd else (1.0, (self.ratio - 1.0) * P)

    @cached_property
    def at_nyquist(self) -> tuple[float, float]:
        return 1.0, float(self.loop.gain(np.array([self.nyquist]), self.ratio)[0].real)

    def _at(self, gain: complex) -> SampledLoop:
        """Whatever acts is ``gain`` times as much, and told so."""
        act, k = self.loop.actuator, float(gain.real)
        A, B, C, D = act.matrices
        return replace(self.loop, actuator=Actuator(k * act.numerator, act.poles, (A, B, k * C, k * D)))

    def roots(self, ratio: complex) -> ComplexArray:
        return self._at(ratio).roots(self.ratio)

    def unstable(self, ratio: complex) -> int | None:
        return self._at(ratio).unstable(self.ratio)
