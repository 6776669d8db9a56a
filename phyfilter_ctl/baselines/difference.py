"""Backward difference over several samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from .protocol import SearchRange, of_recordings


@dataclass(frozen=True)
class BackwardDifference:
    """Slope of the chord over the last ``samples`` intervals.

        a_k = (v_k - v_{k-m}) / (m h)

    Before the start the first sample is repeated: a_k = (v_k - v_0) / (m h) for k < m.

    Parameters
    ----------
    samples : int
        Number m of intervals. The estimate lags by m h / 2; white noise of standard deviation s on v
        appears as sqrt(2) s / (m h).

    Raises
    ------
    ValueError, TypeError
        If ``samples`` is not a whole number of at least 1.

    Examples
    --------
    >>> BackwardDifference(2).estimate([[0.0], [1.0], [2.0], [3.0]], 0.5).ravel().tolist()
    [0.0, 1.0, 2.0, 2.0]
    """

    samples: int = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "samples", _signals.count("samples", self.samples))

    @classmethod
    def search_space(cls, dt: float) -> tuple[SearchRange, ...]:
        """One to at most 100 intervals of ``dt`` seconds, fewer where these exceed half a second.

        Examples
        --------
        >>> BackwardDifference.search_space(0.02)
        (SearchRange(name='samples', low=1, high=25, integer=True),)
        """
        longest = round(0.5 / _signals.duration("dt", dt))
        return (SearchRange("samples", 1, min(100, max(2, longest)), integer=True),)

    @of_recordings
    def estimate(self, v: ArrayLike, dt: float) -> FloatArray:
        """Derivative of v (N, n_x) every ``dt`` s, or f_hat of a recording; see :class:`TunableDifferentiator`."""
        v, dt = _signals.array("v", v, ("N", "n_x")), _signals.duration("dt", dt)
        m = min(self.samples, len(v))  # further back than the flight is long there is only its first sample
        rise = v - np.concatenate([np.repeat(v[:1], m, axis=0), v[:-m]])
        return rise / (self.samples * dt)
