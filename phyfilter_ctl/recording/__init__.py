"""Recordings: named channels, units, CSV in and out, checks that name the row, splits by recording."""

from functools import partial
from typing import TYPE_CHECKING

from .._renamed import former
from .estimate_comparison import EstimateComparison
from .findings import Finding
from .recording import Check, Recording
from .splits import split

__all__ = ["Check", "EstimateComparison", "Finding", "Recording", "split"]

if not TYPE_CHECKING:
    __getattr__ = partial(former, __name__)
