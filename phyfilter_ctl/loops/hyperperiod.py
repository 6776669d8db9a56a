"""When the sampled blocks of a diagram run within the common multiple of their periods."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import lcm

import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from ..diagram import FlatModel

__all__ = ["Instants", "instants_of"]

# In a hyperperiod: each costs a product of matrices.
_MOST_INSTANTS = 2000
# Ratios of periods are fractions of whole numbers up to this.
_LARGEST_RATIO = 10_000
# Instants coincide within this part of the shortest period (FlatModel).
_COINCIDE = 1e-9


@dataclass(frozen=True)
class Instants:
    """When sampled blocks run within a hyperperiod.

    Parameters
    ----------
    period : float
        H in seconds.
    times : (m,) array
        Seconds from its beginning, the first 0.
    due : (m, tasks) bool array
    """

    period: float
    times: FloatArray
    due: NDArray[np.bool_]

    @property
    def lengths(self) -> FloatArray:
        return np.diff(self.times, append=self.period)


def instants_of(flat: FlatModel) -> Instants:
    """Instants up to the common multiple of all periods.

    Raises
    ------
    ValueError
        If there are no sampled blocks, or their periods have no common multiple that is short enough.
    """
    periods = [task.period for task in flat.tasks]
    if not periods:
        raise ValueError(f"{flat.name} has no sampled blocks: use flatten(...).linearize()")
    shortest = min(periods)
    ratios = [Fraction(period / shortest).limit_denominator(_LARGEST_RATIO) for period in periods]
    unit = lcm(*(ratio.denominator for ratio in ratios))  # the shortest period in ticks
    ticks = [int(ratio * unit) for ratio in ratios]
    whole = lcm(*ticks)
    drift = max(abs(p / shortest - float(r)) / float(r) for p, r in zip(periods, ratios, strict=True))
    count = sum(whole // tick for tick in ticks)
    if count > _MOST_INSTANTS + len(ticks) or drift * whole / unit > _COINCIDE:
        named = ", ".join(f"{task.name} {task.period:.9g} s" for task in flat.tasks)
        raise ValueError(
            f"{flat.name}: the periods of {named} have no common multiple within {_MOST_INSTANTS} instants; choose "
            "periods that are small multiples of each other, or analyse the loops one by one"
        )
    due = {
        tick: np.array([tick % each == 0 for each in ticks])
        for each in ticks
        for tick in range(0, whole, each)
    }
    when = sorted(due)
    return Instants(
        shortest * whole / unit, shortest * np.array(when) / unit, np.array([due[t] for t in when])
    )
