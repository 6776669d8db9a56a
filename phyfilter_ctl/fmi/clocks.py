"""Periodic clocks of FMI 3: intervals as fractions, and whose states change at whose ticks."""

from __future__ import annotations

from fractions import Fraction

from ..codegen.model import CModel

__all__ = ["as_fraction", "owners_of"]

_FINEST = 10**7  # denominator of an interval in seconds that counts as a fraction


def as_fraction(seconds: float) -> tuple[int, int]:
    """Counter and resolution that are the same number of seconds; (0, 0) where there is no such fraction.

    Parameters
    ----------
    seconds : float

    Examples
    --------
    >>> as_fraction(0.005), as_fraction(2.0**-0.5)
    ((1, 200), (0, 0))
    """
    fraction = Fraction(seconds).limit_denominator(_FINEST)
    return fraction.as_integer_ratio() if float(fraction) == seconds else (0, 0)


def owners_of(model: CModel) -> tuple[int | None, ...]:
    """Task of each sampled state; that of the longest name where blocks are called like parts of others.

    Parameters
    ----------
    model : CModel
    """
    if len(model.tasks) == 1:
        return (0,) * len(model.sampled_states)
    ordered = sorted(range(len(model.tasks)), key=lambda i: -len(model.tasks[i][0]))
    return tuple(
        next((i for i in ordered if state.name.startswith(f"{model.tasks[i][0]}.")), None)
        for state in model.sampled_states
    )
