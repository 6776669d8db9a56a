"""A test that needs no label: does f_hat, held, say where x goes next?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from ..filter import SampledPhyFilter
from ..results import Interval, Result
from .steps import Steps, filtered, jackknife, units_of

Samples = NDArray[np.intp]

__all__ = ["Prediction", "ahead", "prediction"]

_LATE = 1.5  # of the horizon: across a longer gap nothing is predicted


@dataclass(frozen=True, repr=False)
class Prediction(Result):
    """How well x is predicted some time ahead: g and f_theta as they were, what the model misses held as it is now.

    Attributes
    ----------
    horizon : float
        s.
    still, model, filter : float
        Rms of the error over samples and channels, in the unit of x (of M x where the inertia is a full matrix): where
        x stays as it is, by g and f_theta alone, and with f_hat - f_theta held.
    reduction : Interval
        1 - filter / model.
    improves : bool
        Whether the interval of the reduction lies above 0.
    """

    horizon: float
    still: float
    model: float
    filter: float
    reduction: Interval
    improves: bool


def ahead(part: Steps, horizon: float) -> tuple[Samples, Samples]:
    """Steps k (n,) and later ones j (n,) whose ends are a horizon apart, as near as the samples allow."""
    ends, horizon = part.times[1:], max(horizon, part.dt)
    later = np.searchsorted(ends, ends + horizon - 0.5 * part.dt)
    here = np.flatnonzero(later < len(ends))
    later = later[here]
    near = ends[later] - ends[here] <= _LATE * horizon
    return here[near], later[near]


def prediction(
    sampled: SampledPhyFilter, parts: Sequence[Steps], horizon: float, confidence: float
) -> Prediction:
    """The test over all recordings.

    Raises
    ------
    ValueError
        If no two samples are a horizon apart.
    """
    rows = []
    for part in parts:
        here, later = ahead(part, horizon)
        span = (part.times[1:][later] - part.times[1:][here])[:, None]
        held = filtered(sampled, part.u, part.h[:, 0])[here]
        still, model = (_over(part.h * values, here, later) for values in (part.moved, part.u))
        rows.append(
            np.stack(
                [((e / part.scale) ** 2).mean(axis=1) for e in (still, model, model - span * held)], axis=1
            )
        )
    if (count := sum(map(len, rows))) == 0:
        raise ValueError(f"horizon: expected less than the recordings last, got {horizon:g} s")
    rows = [row for row in rows if len(row)]

    def reduced(total: FloatArray) -> float:
        return 1.0 - math.sqrt(total[2] / total[1]) if total[1] > 0.0 else 0.0

    reduction = jackknife(units_of(rows), reduced, confidence)
    still, model, held = np.sqrt(np.sum([row.sum(axis=0) for row in rows], axis=0) / count).tolist()
    return Prediction(horizon, still, model, held, reduction, reduction.low > 0.0)


def _over(steps: FloatArray, here: Samples, later: Samples) -> FloatArray:
    total = np.cumsum(steps, axis=0)
    return total[later] - total[here]
