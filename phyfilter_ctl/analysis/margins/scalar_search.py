"""Margins of one scalar loop Q + k P = 0, read off its frequency response."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np

from ..._sections import FloatArray
from . import sweep
from .sweep import Characteristic, Crossing

__all__ = ["Bound", "MarginSearch", "ScalarSearch", "StableGains"]

# A crossing belongs to the end of an interval that agrees with it to this.
_SAME_END = 1e-9
NONE = float("nan")


class Bound(NamedTuple):
    """A margin, and the frequency in rad/s at which it binds: nan where nothing does."""

    value: float
    omega: float


class StableGains(NamedTuple):
    """Factors on the loop gain, low < k < high, with which the loop is stable.

    ``omega`` are the frequencies in rad/s at which a closed-loop pole crosses the boundary of stability at either end;
    nan where there is none.
    """

    low: float
    high: float
    omega: tuple[float, float]


class MarginSearch(Protocol):
    """What :class:`Margins` asks of a loop."""

    @cached_property
    def is_stable(self) -> bool: ...

    @cached_property
    def stable_gains(self) -> tuple[StableGains, ...]: ...

    @cached_property
    def phase(self) -> Bound: ...

    @cached_property
    def delay(self) -> Bound: ...

    @cached_property
    def gain_crossings(self) -> FloatArray: ...

    def disk(self, skew: float) -> Bound:
        """1/max of the structured singular value of S + (skew - 1)/2 over frequency."""
        ...

    @property
    def missing(self) -> str:
        """Which margins are nan, and why."""
        ...


@dataclass(frozen=True, eq=False)
class ScalarSearch:
    """A loop at one ratio; ``delayed`` searches the delay margin where a delay is more than a lag in phase."""

    loop: Characteristic
    ratio: float = 1.0
    delayed: Callable[[], Bound] | None = None

    @property
    def missing(self) -> str:
        return ""

    @cached_property
    def is_stable(self) -> bool:
        return self.loop.unstable(self.ratio) == 0

    @cached_property
    def crossings(self) -> list[Crossing]:
        return sweep.ratio_crossings(self.loop)

    @cached_property
    def intervals(self) -> tuple[tuple[float, float], ...]:
        """Of ratios."""
        return tuple(sweep.intervals(self.loop, self.crossings))

    @cached_property
    def stable_gains(self) -> tuple[StableGains, ...]:
        def frequency(end: float) -> float:
            return next((c.omega for c in self.crossings if abs(c.ratio - end) <= _SAME_END * end), NONE)

        return tuple(
            StableGains(
                low / self.ratio,
                high / self.ratio,
                (frequency(low) if low else NONE, frequency(high) if np.isfinite(high) else NONE),
            )
            for low, high in self.intervals
        )

    @cached_property
    def phase(self) -> Bound:
        omega, lag = sweep.lag_to_instability(self.loop, self.ratio)
        return _least(np.minimum(lag, 2.0 * np.pi - lag), omega)

    @cached_property
    def delay(self) -> Bound:
        if self.delayed is not None:
            return self.delayed()
        omega, lag = sweep.lag_to_instability(self.loop, self.ratio)
        return _least(lag / omega, omega)

    @cached_property
    def gain_crossings(self) -> FloatArray:
        return sweep.gain_crossings(self.loop, self.ratio)

    def disk(self, skew: float) -> Bound:
        """One channel: the largest |S + (skew - 1)/2|."""
        shift = 0.5 * (skew - 1.0)

        def margin(omega: FloatArray) -> FloatArray:
            Q, P = self.loop(omega)
            closed = Q + self.ratio * P
            with np.errstate(divide="ignore"):
                return np.abs(closed) / np.abs(Q + shift * closed)

        found = [sweep.least(margin, self.loop.grid)]
        ends = [(0.0, self.loop.at_zero)]
        if np.isinf(self.loop.nyquist):
            ends.append((np.inf, self.loop.at_nyquist or (1.0, 0.0)))
        for omega, (Q, P) in ends:
            closed = Q + self.ratio * P
            if Q + shift * closed:
                found.append((abs(closed) / abs(Q + shift * closed), omega))
        return Bound(*min(found))


def _least(values: FloatArray, omega: FloatArray) -> Bound:
    if not len(values):
        return Bound(float("inf"), NONE)
    k = int(np.argmin(values))
    return Bound(float(values[k]), float(omega[k]))
