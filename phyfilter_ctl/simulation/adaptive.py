"""Adaptive integration: Dormand and Prince's 8(5,3) pair, one call of a CasADi function for each step.

Hairer, Norsett, Wanner, "Solving Ordinary Differential Equations I", II.5 and II.6; the coefficients are SciPy's.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import casadi as ca
import numpy as np
from scipy.integrate import DOP853

from .._sections import FloatArray
from ..diagram import FlatModel
from .chains import bind
from .limits import LOOKED_AT, Limits, chattering
from .steps import KEPT, Results, compose

__all__ = ["Integrator", "StepError"]

_STAGES = 12
_ORDER = 8
# The polynomial inside a step errs by up to ten times the end of the step (measured on a lag).
_INSIDE = 0.1
_SAFETY, _LEAST, _MOST = 0.9, 0.2, 10.0
# Accepted steps between two looks at where a run is going, and looks in a row that must say it goes nowhere: it would
# take so many times the steps that are left.
_FORESEEN_AFTER, _DOUBTS, _HOPELESS = 512, 4, 10.0
_TIME_ROUNDING = 10 * np.finfo(float).eps


class StepError(Exception):
    """The step became too small, or the derivative is not finite.

    Parameters
    ----------
    message : str
    time : float
        Where, in seconds.
    inside : (k, n_x) array
        States at the times before.
    """

    def __init__(self, message: str, time: float, inside: FloatArray) -> None:
        super().__init__(f"{message} at t = {time:.9g} s")
        self.time = time
        self.inside = inside


def _sizes(flat: FlatModel) -> list[int]:
    """x, (t, h, rtol, atol), u at t, rates of u, p, z."""
    n_u = len(flat.inputs)
    return [len(flat.states), 4, n_u, n_u, len(flat.parameters), len(flat.held)]


def _weighted(weights: FloatArray, slopes: Sequence[ca.SX]) -> ca.SX:
    total = type(slopes[0]).zeros(*slopes[0].shape)
    for weight, slope in zip(weights.tolist(), slopes, strict=True):
        total = total + weight * slope if weight else total
    return total


def _stages(
    flat: FlatModel, given: Sequence[ca.SX], slopes: list[ca.SX], table: FloatArray, nodes: FloatArray
) -> list[ca.SX]:
    """More slopes: at each node, on the weighted sum of those before."""
    x, q, u, rate, p, z = given
    for row, node in zip(table, nodes.tolist(), strict=True):
        at = x + q[1] * _weighted(row[: len(slopes)], slopes)
        slopes = [*slopes, flat.dynamics(q[0] + node * q[1], at, u + node * q[1] * rate, p, z)]
    return slopes


@lru_cache(maxsize=KEPT)
def _trial(flat: FlatModel) -> ca.Function:
    """One step: x at its end, its error over the tolerance, and the slopes of all stages, the next first one last."""

    def body(*arguments: ca.SX) -> Results:
        *given, first = arguments
        x, q, u, rate, p, z = given
        slopes = _stages(flat, given, [first], DOP853.A[1:], DOP853.C[1:])
        after = x + q[1] * _weighted(DOP853.B, slopes)
        slopes.append(flat.dynamics(q[0] + q[1], after, u + q[1] * rate, p, z))
        scale = q[3] + q[2] * ca.fmax(ca.fabs(x), ca.fabs(after))
        fifth, third = (ca.sumsqr(_weighted(E, slopes) / scale) for E in (DOP853.E5, DOP853.E3))
        bound = (fifth + 0.01 * third) * len(flat.states)
        error = q[1] * ca.if_else(bound > 0.0, fifth / ca.sqrt(bound), bound)
        return after, error, ca.horzcat(*slopes)

    return compose("pf_dop853", [*_sizes(flat), len(flat.states)], body)


@lru_cache(maxsize=KEPT)
def _interpolant(flat: FlatModel) -> ca.Function:
    """Coefficients of the polynomial of seventh order in a step."""
    n_x = len(flat.states)

    def body(*arguments: ca.SX) -> Results:
        *given, after, stages = arguments
        x, h = given[0], given[1][1]
        slopes = list(ca.horzsplit(ca.reshape(stages, n_x, _STAGES + 1)))
        slopes = _stages(flat, given, slopes, DOP853.A_EXTRA, DOP853.C_EXTRA)
        change = after - x
        first = [change, h * slopes[0] - change, 2 * change - h * (slopes[_STAGES] + slopes[0])]
        return (ca.horzcat(*first, *(h * _weighted(row, slopes) for row in DOP853.D)),)

    return compose("pf_dop853_dense", [*_sizes(flat), n_x, n_x * (_STAGES + 1)], body)


@lru_cache(maxsize=KEPT)
def _slope(flat: FlatModel) -> ca.Function:
    return compose("pf_slope", _sizes(flat), lambda x, q, u, rate, p, z: (flat.dynamics(q[0], x, u, p, z),))


class _Call:
    """A CasADi function on fixed arrays."""

    def __init__(self, function: ca.Function, arguments: list[FloatArray]) -> None:
        shapes = [(function.size2_out(i), function.size1_out(i)) for i in range(function.n_out())]
        self.results: list[FloatArray] = [np.zeros(shape) for shape in shapes]
        self._arguments = arguments
        self._buffer, self._trigger = function.buffer()
        for i, array in enumerate(arguments):
            bind(self._buffer.set_arg, i, array)
        for i, array in enumerate(self.results):
            bind(self._buffer.set_res, i, array)

    def __call__(self) -> list[FloatArray]:
        self._trigger()
        return self.results


class Integrator:
    """Integrates the continuous part from one discontinuity to the next, keeping its step length.

    Parameters
    ----------
    flat : FlatModel
    p : (n_p,) array
    limits : Limits
    rtol, atol : float
        Error of a step and inside it, root mean square over the states of error / (atol + rtol abs(x)), below 1.
    max_step : float, optional
        Longest step in seconds.
    until : float
        Where the whole run ends, in seconds.
    """

    def __init__(
        self,
        flat: FlatModel,
        p: FloatArray,
        limits: Limits,
        *,
        rtol: float,
        atol: float,
        max_step: float | None = None,
        until: float = np.inf,
    ) -> None:
        n_x, n_u = len(flat.states), len(flat.inputs)
        self._x, self._q = np.zeros(n_x), np.array([0.0, 0.0, _INSIDE * rtol, _INSIDE * atol])
        self._u, self._rate = np.zeros(n_u), np.zeros(n_u)
        self._z, self._first = np.zeros(len(flat.held)), np.zeros(n_x)
        given = [self._x, self._q, self._u, self._rate, np.array(p, dtype=float), self._z]
        self._slope = _Call(_slope(flat), given)
        self._trial = _Call(_trial(flat), [*given, self._first])
        after, _, slopes = self._trial.results
        self._dense = _Call(_interpolant(flat), [*given, after, slopes])
        self._max_step = np.inf if max_step is None else max_step
        self._h, self._accepted = 0.0, 0
        self._flat, self._limits, self._until = flat, limits, until
        self._slopes, self._counts = np.full((LOOKED_AT, n_x), np.nan), np.zeros(LOOKED_AT, dtype=np.int64)
        self._mark, self._doubts = (0.0, 0), 0
        self.steps: int = 0

    @property
    def chattering(self) -> str:
        """What chatters, by the derivatives after the last accepted steps; "" for nothing."""
        newest, oldest = (
            self._counts[(self._accepted - 1) % LOOKED_AT],
            self._counts[self._accepted % LOOKED_AT],
        )
        return chattering(self._flat, np.roll(self._slopes, -self._accepted, axis=0), int(newest - oldest))

    def _note(self, t: float) -> bool:
        """Keeps what the accepted step tells of chattering; whether that will outlast the run's limits."""
        place = self._accepted % LOOKED_AT
        self._slopes[place], self._counts[place] = self._first, self.steps
        self._accepted += 1
        if self._accepted % _FORESEEN_AFTER:
            return False
        (since, count), self._mark = self._mark, (t, self.steps)
        needed = (self.steps - count) * (self._until - t) / max(t - since, 1e-300)
        self._doubts = self._doubts + 1 if needed > _HOPELESS * self._limits.left and self.chattering else 0
        return self._doubts >= _DOUBTS

    def run(
        self,
        x: FloatArray,
        z: FloatArray,
        interval: tuple[float, float],
        u: tuple[FloatArray, FloatArray],
        times: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """x at the end of an interval on which u runs straight, and at ``times`` inside it, (len(times), n_x).

        Raises
        ------
        StepError
            See there.
        """  # fmt: skip
        t, end = interval
        inside = np.zeros((len(times), len(x)))
        self._x[:], self._z[:], self._u[:] = x, z, u[0]
        self._rate[:] = (u[1] - u[0]) / (end - t)
        self._q[0] = t
        self._first[:] = self._slope()[0].ravel()
        if not np.all(np.isfinite(self._first)):
            raise StepError("a derivative is not finite", t, inside[:0])
        if not self._h:
            self._h = self._first_step(end - t)
        done, rejected = 0, False
        while t < end:
            left = end - t
            wanted = min(self._h, self._max_step)
            h = left if wanted >= left * (1 - 1e-9) else left / 2 if wanted > left / 2 else wanted
            refusal = self._limits.spend(1)
            if refusal:
                raise StepError(refusal, t, inside[:done])
            self._q[1] = h
            after, error, slopes = self._trial()
            self.steps += 1
            norm = float(error[0, 0])
            if not norm < 1.0:  # NaN included
                factor = max(_LEAST, _SAFETY * norm ** (-1 / _ORDER)) if np.isfinite(norm) else 0.1
                self._h, rejected = h * factor, True
                if self._h < _TIME_ROUNDING * max(abs(t), abs(end)):
                    kind = (
                        "became smaller than rounding"
                        if np.isfinite(norm)
                        else "meets values that are not finite"
                    )
                    raise StepError(f"the step {kind}", t, inside[:done])
                continue
            later = end if h == left else t + h
            stop = int(np.searchsorted(times, later, side="right"))
            if stop > done:
                inside[done:stop] = self._interpolate((times[done:stop] - t) / h)
                done = stop
            factor = min(_MOST, _SAFETY * norm ** (-1 / _ORDER)) if norm else _MOST
            grown = h * (min(1.0, factor) if rejected else factor)
            # A step cut short by the end of the interval says nothing against the longer one.
            self._h = grown if h >= wanted * (1 - 1e-9) else max(self._h, grown)
            rejected = False
            self._x[:] = after[0]
            self._first[:] = slopes[_STAGES]
            t = later
            if self._note(t):
                raise StepError("the steps left would not do: given up", t, inside[:done])
            self._u[:] = u[0] + (t - interval[0]) * self._rate
            self._q[0] = t
        return self._x.copy(), inside

    def _interpolate(self, part: FloatArray) -> FloatArray:
        coefficients = self._dense()[0]
        value = np.zeros((len(part), coefficients.shape[1]))
        for i, row in enumerate(coefficients[::-1]):
            value += row
            value *= (part if i % 2 == 0 else 1 - part)[:, None]
        return value + self._x

    def _first_step(self, length: float) -> float:
        """Hairer, Norsett, Wanner I, II.4, without the second evaluation."""
        scale = self._q[3] + self._q[2] * np.abs(self._x)
        size, speed = np.sqrt(np.mean((self._x / scale) ** 2)), np.sqrt(np.mean((self._first / scale) ** 2))
        h = 0.01 * size / speed if size > 1e-5 and speed > 1e-5 else 1e-6
        return float(min(h, length))
