"""Noise of a flight, and what blows in it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl.study import unit_noise

from .vehicle import NOISES

__all__ = ["check_seeds", "noise"]

FloatArray = NDArray[np.float64]


def check_seeds(seeds: Sequence[int]) -> tuple[int, ...]:
    """The seeds.

    Raises
    ------
    ValueError
        For none, negative ones, or one twice.
    """
    if not seeds or min(seeds) < 0 or len(set(seeds)) != len(seeds):
        raise ValueError(f"seeds: expected different whole numbers from 0 on, got {list(seeds)}")
    return tuple(seeds)


def noise(seeds: Sequence[int], samples: int) -> FloatArray:
    """Unit white noise of the diagram's inputs, (B, 25, samples); that of a seed is the same for all methods."""
    return unit_noise(seeds, sum(NOISES.values()), samples)
