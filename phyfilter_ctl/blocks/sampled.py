"""Sampled blocks for continuous diagrams: they run at their own rate and hold their outputs in between."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from .._sections import FloatArray
from ..sampled import SampledPhyFilter

__all__ = ["FilterLaw"]


@dataclass(frozen=True, eq=False)
class FilterLaw:
    """A sampled PhyFilter as part of a diagram.

    Parameters
    ----------
    sampled : SampledPhyFilter
    channels : int
        Number n_x of channels of x.
    inertia : (n_x,) or (n_x, n_x) array, {"scalar", "diagonal", "full"} or None
        Constant inertia; or that the inertia is an input (M[0]; M[0] ... M[n_x-1]; M[0,0], M[0,1] ... row by row);
        or None for I.
    """

    sampled: SampledPhyFilter
    channels: int
    inertia: FloatArray | Literal["scalar", "diagonal", "full"] | None = None
