"""The loop with the filter and the command sampled: the command is held over the step, plant and actuator run on.

    chi(z) = 1 - F_d(z) m(z) + mu [F_d(z) (1 - 1/z)/h X(z) + Kd X(z) + Kp Y(z)]

F_d: from the measured residual to f_hat; m: mean of the held command over the step that ends now; X, Y: from the
command to measured velocity and position of a unit mass behind hold, delay and actuator, all exact. Where the filter is
told the force that acts, m is the mean of that over the step, (1 - 1/z)/h X(z).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..._sections import ComplexArray, FloatArray, expm1
from ...filter import SampledPhyFilter
from ...filter.windows import mean_weights
from ...values.actuator import Actuator
from .. import _paths, _resolvent
from ..options import Told
from . import sweep
from ._factors import roots_of, trimmed

__all__ = ["SampledLoop"]

# Steps of delay above which the poles are counted along the unit circle: the matrix has a state for each.
_LONG = 100.0
# A piece of the curve is straight if its middle is off the chord by no more than this share of its distance from 0.
_BEND = 0.1
_MOST_HALVINGS = 40


@dataclass(frozen=True, eq=False)
class SampledLoop(sweep.Remembered):
    """Sampled filter, actuator, delay of the command, outer gains kp, kd per unit mass, and what the filter is told."""

    sampled: SampledPhyFilter
    actuator: Actuator
    delay: float
    kp: float
    kd: float
    told: Told = "commanded"

    @property
    def nyquist(self) -> float:
        return np.pi / self.sampled.dt

    @cached_property
    def tail(self) -> tuple[float, float]:
        return float("inf"), float("inf")

    def later(self, extra: float) -> SampledLoop:
        """The same loop with ``extra`` seconds more delay of the command."""
        return replace(self, delay=self.delay + extra)

    def with_filter(self, sampled: SampledPhyFilter) -> SampledLoop:
        """The same loop about another filter of the same step and delay: what is around it is known."""
        found = replace(self, sampled=sampled)
        object.__setattr__(found, "plant", self.plant)  # a frozen dataclass, a cached property
        return found

    @cached_property
    def plant(self) -> tuple[FloatArray, FloatArray, FloatArray, int]:
        """Step of (actuator, x, position): transition - I, what the newer and the older command add, whole steps late.

        A delay of the measurement acts on x as one of the command would. The newer command acts over the last part of
        the step, the older one before.
        """
        h = self.sampled.dt
        late = (self.delay + self.sampled.sampling.delay) / h
        whole = int(late)
        part = (late - whole) * h
        A, B, C, D = self.actuator.matrices
        m = len(A)
        augmented = np.zeros((m + 3, m + 3))
        augmented[:m, :m], augmented[:m, m + 2 :] = A, B
        augmented[m, :m], augmented[m, m + 2] = C[0], D[0, 0]
        augmented[m + 1, m] = 1.0
        early, rest, step = expm1(augmented, part), expm1(augmented, h - part), expm1(augmented, h)
        newer = rest[:-1, -1]
        older = early[:-1, -1] + rest[:-1, :-1] @ early[:-1, -1]
        return step[:-1, :-1], newer, older, whole

    def _evaluate(self, omega: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Q and P on the unit circle, each (K,)."""
        Q, P, _ = self.parts(omega)
        return Q, P

    def parts(self, omega: FloatArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Q, P and what d(P/Q) Q^2 is dF times of, each (K,)."""
        F, error = _paths._recursion(self.sampled, omega)
        missing, through, outer = self.surroundings(omega)
        # 1 - F m = (1 - F) + F (1 - m), 1 - m summed without the subtraction.
        Q, P = error - F * missing, F * through + outer
        return Q, P, through * Q + (1.0 + missing) * P

    @property
    def dt(self) -> float:
        """Seconds from sample to sample."""
        return self.sampled.dt

    @property
    def late(self) -> float:
        """Seconds of delay, of the command and of the measurement."""
        return self.delay + self.sampled.sampling.delay

    @property
    def corners(self) -> ComplexArray:
        """Poles and zeros of what is around the filter."""
        act = self.actuator
        return np.concatenate([act.poles, roots_of(act.numerator)[1]]).astype(np.complex128)

    def is_stable(self, filter: SampledPhyFilter) -> bool:
        """Whether the loop is, with another filter of the same step and delay."""
        return self.with_filter(filter).unstable(1.0) == 0

    def surroundings(self, omega: FloatArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """What F stands in, each (K,): m - 1, and what P is F times of and beside that."""
        sampled, h = self.sampled, self.sampled.dt
        half = 0.5 * omega * h
        delta = 2j * np.sin(half) * np.exp(1j * half)
        back = 1.0 / (1.0 + delta)
        weights = mean_weights("hold", sampled.sampling.delay / h)
        lags = np.outer(omega * h, np.arange(len(weights)))
        missing = np.asarray(np.expm1(-1j * lags) @ weights, dtype=np.complex128)

        transition, newer, older, whole = self.plant
        drive = newer[:, None] + older[:, None] * back
        m = len(transition) - 2
        if m:
            inputs = np.stack([newer[:m], older[:m]], axis=1)
            G = _resolvent.evaluate(transition[:m, :m], inputs, np.eye(m), np.zeros((m, 2)), delta)
            drive = drive + transition[:, :m] @ (G[:, 0] + G[:, 1] * back)
        change = drive[m]  # delta X
        late = back**whole
        outer = np.zeros(len(omega), dtype=np.complex128)
        if self.kp or self.kd:
            X = change / delta
            outer = (self.kd * X + self.kp * (drive[m + 1] + h * X) / delta) * late
        through = back * change / h * late
        return (through - 1.0 if self.told == "applied" else missing), through, outer

    def gain(self, omega: FloatArray, ratio: float) -> ComplexArray:
        """Of the loop opened at the command at a ratio, (K,), for a filter that is told what acts."""
        F, _ = _paths._recursion(self.sampled, omega)
        _, through, outer = self.surroundings(omega)
        return (ratio - 1.0) * F * through + ratio * outer

    def error(self, omega: FloatArray) -> ComplexArray:
        """Q, (K,)."""
        return self(omega)[0]

    def normalisation(self, omega: FloatArray) -> ComplexArray:
        """What Q and P carry as a common factor: nothing."""
        return np.ones(len(omega), dtype=np.complex128)

    @cached_property
    def at_zero(self) -> tuple[float, float]:
        """Q and P at z = 1; P infinite with an outer loop is given as Q = 0."""
        if self.kp or self.kd:
            return 0.0, 1.0
        F = self.sampled.filter.dc_gain
        gain = self.actuator.numerator[0] / self.actuator.denominator[0]
        if self.told == "applied":
            return float(1.0 - F * gain), float(F * gain)
        return (0.0 if self.sampled.filter.type else 1.0 - F), float(F * gain)

    @cached_property
    def at_nyquist(self) -> tuple[float, float]:
        """Q and P at z = -1, both real."""
        Q, P = self(np.array([self.nyquist]))
        return float(Q[0].real), float(P[0].real)

    @cached_property
    def grid(self) -> FloatArray:
        """Frequencies up to the Nyquist frequency dense enough that every crossing has its own interval."""
        filter, act = self.sampled.filter, self.actuator
        outer = [self.kp / self.kd] if self.kp and self.kd else []
        zeros = roots_of(trimmed(filter.b, filter.poles))[1]
        parts = [
            filter.poles,
            zeros,
            act.poles,
            roots_of(act.numerator)[1],
            [self.kd, np.sqrt(self.kp)],
        ]
        corners = np.concatenate([*parts, outer, roots_of(filter.error_numerator)[1], [self.nyquist]])
        late = self.delay + self.sampled.sampling.delay + 4.0 * self.sampled.dt
        return sweep.grid(corners[corners != 0.0].astype(np.complex128), self.nyquist, turn=late)

    def matrix(self, ratio: complex) -> FloatArray | ComplexArray:
        """State matrix of the closed loop minus I; its eigenvalues are z - 1.

        States at instant k: actuator, increment x_k - x_{k-1} of the measured x, x and position where the outer loop
        needs them, w_{k-1}, and the commands sent at k - 1, k - 2, ...
        """
        transition, newer, older, whole = self.plant
        h = self.sampled.dt
        m = len(transition) - 2
        kept = [m, m + 1][: 2 if self.kp else 1 if self.kd else 0]
        rows = [*range(m), m, *kept]  # the increment is the change of x
        dA, equilibrium, C = self.sampled.transition
        n = len(dA)
        weights = mean_weights("hold", self.sampled.sampling.delay / h)
        past = max(whole + 1, len(weights) - 1)
        plant, size = m + 1 + len(kept), m + 1 + len(kept) + n + past
        unit = np.eye(size, dtype=np.result_type(type(ratio), float))
        w, sent = unit[plant : plant + n], unit[plant + n :]

        if self.told == "applied":
            u = ((ratio - 1.0) / h) * unit[m]
        else:
            u = (ratio / h) * unit[m] - weights[1:] @ sent[: len(weights) - 1]
        change = dA @ w - np.outer(dA @ equilibrium, u)
        command = -C @ (w + change)
        for state, gain in zip(range(m + 1, plant), (self.kd, self.kp), strict=False):
            command = command - ratio * gain * unit[state]
        # Columns of the plant's transition that are states here: x itself acts on the position only.
        sources = np.concatenate([unit[:m], np.zeros((2, size), dtype=unit.dtype)])
        sources[[m, m + 1][: len(kept)]] = unit[m + 1 : plant]
        line = np.concatenate([command[None], sent])  # commands sent at k, k - 1, ...
        step = (transition @ sources + np.outer(newer, line[whole]) + np.outer(older, line[whole + 1]))[rows]
        step[m] -= unit[m]
        return np.concatenate([step, change, line[:past] - sent])

    def roots(self, ratio: complex) -> ComplexArray:
        """Closed-loop poles z."""
        return 1.0 + np.linalg.eigvals(self.matrix(ratio)).astype(np.complex128)

    def unstable(self, ratio: complex) -> int | None:
        """Number of closed-loop poles that are not inside the unit circle."""
        if self.delay + self.sampled.sampling.delay > _LONG * self.sampled.dt:
            return self._outside(complex(ratio))
        delta = np.linalg.eigvals(self.matrix(ratio)).astype(np.complex128)
        return sweep.count_unstable(delta, sampled=True)

    def _outside(self, ratio: complex) -> int | None:
        """The same by the turns of chi about 0 along the unit circle: a long delay makes the matrix large.

        chi times (d/(d + r h))^k, d = z - 1, k the integrators of the outer loop, has all poles inside and tends to 1.
        """
        h = self.sampled.dt
        k = 2 if self.kp else 1 if self.kd else 0
        r = min(float(np.min(np.abs(self.sampled.filter.poles))), 1.0 / h)
        static = float(self.actuator.numerator[0] / self.actuator.denominator[0])
        Q, P = self.at_zero
        start = Q + ratio * P if k == 0 else ratio * static * (self.kp / r**2 if k == 2 else self.kd / r)

        def curve(omega: FloatArray) -> ComplexArray:
            Q, P = self(omega)
            d = np.expm1(1j * omega * h)
            return (Q + ratio * P) * (d / (d + r * h)) ** k

        grid = self.grid
        values = curve(grid)
        turn = _turn(curve, np.append(0.0, grid), np.append(start, values))
        if ratio.imag:
            turn -= _turn(lambda w: curve(-w), np.append(0.0, grid), np.append(start, curve(-grid)))
        else:
            turn *= 2.0
        return round(-turn / (2.0 * np.pi)) if np.isfinite(turn) else None


def _turn(curve: Callable[[FloatArray], ComplexArray], omega: FloatArray, values: ComplexArray) -> float:
    """Change of the argument along the curve, halved where it bends; nan where it meets 0."""
    low, high, left, right = omega[:-1], omega[1:], values[:-1], values[1:]
    turn = 0.0
    for _ in range(_MOST_HALVINGS):
        middle = 0.5 * (low + high)
        value = curve(middle)
        near = np.minimum(np.abs(left), np.abs(right))
        straight = np.abs(value - 0.5 * (left + right)) < _BEND * near
        straight &= np.abs(right - left) < near
        turn += float(np.sum(np.angle(right[straight] / left[straight])))
        if np.all(straight):
            return turn
        low, middle, high = low[~straight], middle[~straight], high[~straight]
        left, value, right = left[~straight], value[~straight], right[~straight]
        low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
        left, right = np.concatenate([left, value]), np.concatenate([value, right])
    return float("nan")
