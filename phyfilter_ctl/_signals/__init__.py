"""The gate: numbers, arrays and times as they are handed to public functions, checked in one place and one wording.

Let in, as float64, are finite real numbers in the shape asked for, also out of frames, series and labelled arrays;
times may carry their unit and time zone. Refused are complex numbers, text, dates where no times are meant, other
objects, NaN and what is masked or missing, infinities and magnitudes whose square leaves double precision, other
shapes, other numbers of samples than beside them, and nothing at all: always as "name: expected against got; what to
do".
"""

from .arrays import (
    LARGEST,
    Given,
    Where,
    array,
    filled,
    inertia,
    real,
    refuse_unusable,
    row,
    unmasked,
    unusable,
    usable,
)
from .containers import channel_names, labels
from .numbers import count, in_both, number
from .times import duration, interval, refuse_ticks, refuse_unordered, sample_times, seconds

__all__ = [
    "LARGEST",
    "Given",
    "Where",
    "array",
    "channel_names",
    "count",
    "duration",
    "filled",
    "in_both",
    "inertia",
    "interval",
    "labels",
    "number",
    "real",
    "refuse_ticks",
    "refuse_unordered",
    "refuse_unusable",
    "row",
    "sample_times",
    "seconds",
    "unmasked",
    "unusable",
    "usable",
]
