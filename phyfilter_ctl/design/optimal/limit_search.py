"""What a search under limits looks at: many shapes at once on a grid of frequencies, and one filter with care."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.linalg import LinAlgError

from ..._sections import ComplexArray, FloatArray, expm1
from ...analysis import error_bound, frequency_response
from ...analysis.margins import filter_margins
from ...filter import PhyFilter
from ...plots import FrequencyLimit
from ...values import Loop
from .shapes import chains, outputs, sections
from .worst_case import worst_gains

__all__ = ["Measures", "Wanted", "measured", "verified"]

# Frequencies over the middle speed of a shape at which its loop and its band are looked at.
_LOOP = np.geomspace(3e-3, 1e3, 240)
_IN_LIMIT, _FINE = 24, 400  # frequencies of a limit, in the search and in the end
_OPEN = 1e3  # what stands for an open end, times the speed of the filter
_FAR = 3.0  # beyond this, in the logarithm, a margin counts as kept without measure


class Measures(NamedTuple):
    """Of m shapes at their speeds.

    Attributes
    ----------
    noise, following, bandwidth, delay_margin : (m,) arrays
        As of ``LimitsFront``; the margin of the continuous loop.
    kept : (m, c) array
        How far each wish is kept, in the natural logarithm; negative where it is not.
    """

    noise: FloatArray
    following: FloatArray
    bandwidth: FloatArray
    delay_margin: FloatArray
    kept: FloatArray


@dataclass(frozen=True)
class Wanted:
    """What is to be kept.

    Parameters
    ----------
    order, type : int
    dt : float
    limits : tuple of FrequencyLimit
    lag, delay : float
        Of the loop in s.
    delay_margin : float
    ratios : tuple of float
        Least and largest M_hat/M.
    """

    order: int
    type: int
    dt: float
    limits: tuple[FrequencyLimit, ...]
    lag: float
    delay: float
    delay_margin: float
    ratios: tuple[float, float]

    @property
    def limited(self) -> int:
        """How many of the wishes are of the limits."""
        return _IN_LIMIT * len(self.limits)

    @cached_property
    def loop(self) -> bool:
        """Whether anything is asked of the loop."""
        return self.delay_margin > 0.0 or self.ratios != (1.0, 1.0)

    def names(self) -> list[str]:
        """Of the wishes, in the order of ``Measures.kept``."""
        limits = [
            f"the limit of {'|F|' if each.of == 'F' else '|1 - F|'}"
            for each in self.limits
            for _ in range(_IN_LIMIT)
        ]
        return [*limits, "a stable loop", "the delay margin", "the largest M_hat/M", "the least M_hat/M"]


def measured(wanted: Wanted, shapes: FloatArray, speeds: FloatArray) -> Measures:
    """What shapes (m, p) at speeds (m,) in rad/s do, vectorised; margins of the continuous loop.

    With q = -(1 - F)/(F G) and G the actuator, the loop with M_hat/M = mu and a further delay T is on the edge where
    mu e^(-j omega T) = q: the margins are read off where q is positive, and where |q| = 1.
    """
    dampings, rates = sections(shapes, wanted.order)
    A, equilibrium = chains(dampings, rates)
    C = outputs(A, equilibrium, shapes[:, wanted.order - 1 :], wanted.type)
    response = _Response(A, equilibrium, C)
    gains = worst_gains(shapes, wanted.order, wanted.type, 1)
    F = response(np.broadcast_to(_LOOP, (len(shapes), len(_LOOP))))
    rows = [_under(limit, response, speeds) for limit in wanted.limits]
    margins = _Margins(F, _LOOP * speeds[:, None], wanted)
    rows.append(margins.kept(wanted))
    return Measures(
        _noise(A, equilibrium, C, speeds, wanted.dt),
        gains.following / speeds,
        speeds * _crossing(np.log(np.abs(F)) + 0.5 * math.log(2.0), _LOOP),
        margins.delay,
        np.concatenate(rows, axis=1),
    )


class _Response:
    """F of shapes of speed 1."""

    def __init__(self, A: FloatArray, equilibrium: FloatArray, C: FloatArray) -> None:
        self._A, self._C = A, C
        self._B = -(A @ equilibrium[..., None])

    def __call__(self, nu: FloatArray) -> ComplexArray:
        """At frequencies (m, N) over the speed."""
        eye = np.eye(self._A.shape[1])
        states = np.linalg.solve(
            1j * nu[..., None, None] * eye - self._A[:, None],
            np.broadcast_to(self._B[:, None], (*nu.shape, len(eye), 1)),
        )
        return np.asarray((self._C[:, None, None, :] @ states)[..., 0, 0])


def _under(limit: FrequencyLimit, response: _Response, speeds: FloatArray) -> FloatArray:
    """How far below a limit, (m, N)."""
    low = np.full(len(speeds), limit.low) if limit.low > 0.0 else np.minimum(speeds, limit.high) / _OPEN
    high = (
        np.full(len(speeds), limit.high) if np.isfinite(limit.high) else np.maximum(speeds, limit.low) * _OPEN
    )
    share = np.linspace(0.0, 1.0, _IN_LIMIT)
    if not np.isfinite(limit.high):
        share = share**2  # most of them where |F| is large
    elif limit.low == 0.0:
        share = 1.0 - share[::-1] ** 2
    omega = low[:, None] * (high / low)[:, None] ** share
    F = response(omega / speeds[:, None])
    values = np.abs(F if limit.of == "F" else 1.0 - F)
    return math.log(limit.magnitude) - np.log(np.maximum(values, 1e-12))


def _noise(
    A: FloatArray, equilibrium: FloatArray, C: FloatArray, speeds: FloatArray, dt: float
) -> FloatArray:
    """Deviation of f_hat for white noise on the samples: the squares of the exact filter's answer to a pulse of x."""
    found = np.empty(len(speeds))
    for k, speed in enumerate(speeds):
        step = expm1(A[k], float(speed * dt))
        B = -step @ equilibrium[k]
        transition = np.eye(len(B)) + step
        P, power = np.outer(B, B), transition
        for _ in range(60):  # doubling: P = sum of transition^i B B' transition'^i
            more = power @ P @ power.T
            P, power = P + more, power @ power
            if np.abs(more).max() <= 1e-14 * np.abs(P).max():
                break
        row = C[k] @ step
        found[k] = math.sqrt(max(float((C[k] @ B) ** 2 + row @ P @ row), 0.0)) / dt
    return found


def _crossing(values: FloatArray, x: FloatArray) -> FloatArray:
    """The first x (m,) at which values (m, N) fall through 0, on straight lines over log x; the last x without one."""
    falls = (values[:, :-1] > 0.0) & (values[:, 1:] <= 0.0)
    k = np.where(falls.any(axis=1), falls.argmax(axis=1), len(x) - 2)
    rows = np.arange(len(values))
    left, right = values[rows, k], values[rows, k + 1]
    share = np.clip(left / np.where(left != right, left - right, 1.0), 0.0, 1.0)
    return x[k] * (x[k + 1] / x[k]) ** share


class _Margins:
    """Of the continuous loops of F (m, N) at frequencies (m, N)."""

    def __init__(self, F: ComplexArray, omega: FloatArray, wanted: Wanted) -> None:
        actuator = np.exp(-1j * omega * wanted.delay) / (1.0 + 1j * omega * wanted.lag)
        E = 1.0 - F
        closed = E + F * actuator
        turns = np.diff(np.angle(closed), axis=1)
        turns -= 2.0 * np.pi * np.round(turns / (2.0 * np.pi))
        nearest = np.abs(closed).min(axis=1)
        # A loop that is stable comes back without a turn; else how far it would have to move, as a slope to go by.
        self._stable = np.where(np.abs(turns.sum(axis=1)) < np.pi, nearest, -nearest - 1e-3)
        q = -E / (F * actuator)
        logs, angle = np.log(np.maximum(np.abs(q), 1e-300)), np.unwrap(np.angle(q), axis=1)
        self.delay = self._delays(logs, angle, omega)
        self._largest, self._least = self._ratios(logs, angle)

    @staticmethod
    def _delays(logs: FloatArray, angle: FloatArray, omega: FloatArray) -> FloatArray:
        crosses = logs[:, :-1] * logs[:, 1:] <= 0.0
        share = np.where(
            crosses, logs[:, :-1] / np.where(crosses, logs[:, :-1] - logs[:, 1:] + 1e-300, 1.0), 0.0
        )
        at = angle[:, :-1] + share * np.diff(angle, axis=1)
        speed = omega[:, :-1] * (omega[:, 1:] / omega[:, :-1]) ** share
        delays = np.where(crosses, (-at % (2.0 * np.pi)) / speed, np.inf)
        return np.minimum(delays.min(axis=1), 1e6)

    @staticmethod
    def _ratios(logs: FloatArray, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Logarithms of the stable ratios' ends around 1."""
        turns = angle / (2.0 * np.pi)
        crosses = np.floor(turns[:, :-1]) != np.floor(turns[:, 1:])
        whole = np.maximum(np.floor(turns[:, :-1]), np.floor(turns[:, 1:]))
        step = np.diff(turns, axis=1)
        share = np.where(crosses, (whole - turns[:, :-1]) / np.where(crosses, step, 1.0), 0.0)
        at = np.where(crosses, logs[:, :-1] + share * np.diff(logs, axis=1), np.nan)
        largest = np.nanmin(np.where(at > 0.0, at, np.inf), axis=1)
        least = np.nanmax(np.where(at <= 0.0, at, -np.inf), axis=1)
        return np.minimum(largest, 1e3), np.maximum(least, -1e3)

    def kept(self, wanted: Wanted) -> FloatArray:
        """(m, 4): stable, delay margin, largest and least ratio."""
        m, far = len(self._stable), np.full(len(self._stable), _FAR)
        if not wanted.loop:
            return np.column_stack([self._stable if wanted.lag or wanted.delay else far, far, far, far])
        low, high = math.log(wanted.ratios[0]), math.log(wanted.ratios[1])
        asked = math.log(wanted.delay_margin) if wanted.delay_margin > 0.0 else -np.inf
        with np.errstate(divide="ignore"):
            delay = np.minimum(np.log(self.delay) - asked, _FAR) if np.isfinite(asked) else np.full(m, _FAR)
        delay = np.where(self._stable > 0.0, np.maximum(delay, -_FAR), -_FAR)
        return np.column_stack(
            [self._stable, delay, np.minimum(self._largest - high, _FAR), np.minimum(low - self._least, _FAR)]
        )


def verified(wanted: Wanted, filter: PhyFilter) -> tuple[FloatArray, FloatArray]:
    """By how much a filter misses each wish, as the search counts them, and its figures, sampled and on fine grids.

    Returns
    -------
    lacking : (c,) array
        In the natural logarithm; 0 where a wish is kept.
    figures : (4,) array
        noise, bound, bandwidth, delay margin.
    """
    sampled = filter.sampled(wanted.dt)
    response = frequency_response(sampled)
    lacking = np.zeros(wanted.limited + 4)
    for i, limit in enumerate(wanted.limits):
        size = np.abs(filter.poles)
        low = limit.low or min(size.min(), limit.high) / _OPEN
        high = limit.high if np.isfinite(limit.high) else _OPEN * max(size.max(), limit.low)
        inside = [w for w in np.abs(filter.poles.imag) if low < w < high]
        F = filter(1j * np.unique(np.concatenate([np.geomspace(low, high, _FINE), inside])))
        worst = float(np.log(np.abs(F if limit.of == "F" else 1.0 - F).max() / limit.magnitude))
        lacking[i * _IN_LIMIT : (i + 1) * _IN_LIMIT] = max(worst, 0.0)
    margin = filter_margins(sampled, Loop(actuator=wanted.lag, delay=wanted.delay - wanted.dt))
    try:
        further = margin.delay_margin if margin.is_stable else 0.0
    except LinAlgError:
        further = 0.0
    low, high = wanted.ratios
    checks = [
        0.0 if margin.is_stable else _FAR,
        math.log(wanted.delay_margin / max(further, 1e-12)) if wanted.delay_margin > 0.0 else 0.0,
        math.log(high / margin.max_ratio) if wanted.loop and margin.is_stable else 0.0,
        math.log(max(margin.min_ratio, 1e-12) / low) if wanted.loop and margin.is_stable else 0.0,
    ]
    lacking[wanted.limited :] = np.clip(checks, 0.0, _FAR)
    bound = error_bound(filter, {1: 1.0}).bound
    return lacking, np.array([response.noise_gain, bound, response.band_edges[1], further])
