"""Single numbers: real, finite, large enough; frequencies in words."""

from __future__ import annotations

import numpy as np

from .arrays import unmasked

__all__ = ["count", "in_both", "number"]


def number(
    name: str, value: float, unit: str = "", *, above: float | None = None, least: float | None = None
) -> float:
    """A finite number.

    Parameters
    ----------
    name : str
    value : float
    unit : str
        For the complaint.
    above, least : float, optional
        It must be greater than the one, and not smaller than the other.

    Raises
    ------
    TypeError
        If it is not one real number.
    ValueError
        If it is not finite or too small.

    Examples
    --------
    >>> number("cutoff", 0, "rad/s", above=0.0)
    Traceback (most recent call last):
        ...
    ValueError: cutoff: expected a finite number > 0 rad/s, got 0
    """
    given = np.asarray(unmasked(value))
    if given.ndim or given.dtype.kind not in "fiu":
        raise TypeError(f"{name}: expected a number, got {value!r}")
    plain = float(given)
    low = above if above is not None else least
    if (
        not np.isfinite(plain)
        or (above is not None and plain <= above)
        or (least is not None and plain < least)
    ):
        bound = "" if low is None else f" {'>' if above is not None else '>='} {low:g}"
        of = f" {unit}" if unit and bound else f", in {unit}" if unit else ""
        raise ValueError(f"{name}: expected a finite number{bound}{of}, got {value!r}")
    return plain


def count(name: str, value: int, least: int = 1) -> int:
    """A whole number of at least ``least``.

    Raises
    ------
    TypeError, ValueError
        If it is none, or smaller.
    """
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | np.integer):
        raise TypeError(f"{name}: expected a whole number, got {value!r}")
    if value < least:
        raise ValueError(f"{name}: expected at least {least}, got {value}")
    return int(value)


def in_both(omega: float) -> str:
    """An angular frequency as people read it, in rad/s and in Hz.

    Parameters
    ----------
    omega : float
        In rad/s.

    Examples
    --------
    >>> in_both(20.0), in_both(0.0), in_both(float("inf"))
    ('20 rad/s (3.18 Hz)', '0 rad/s', 'inf rad/s')
    """
    hertz = f" ({omega / (2.0 * np.pi):.3g} Hz)" if 0.0 < omega < np.inf else ""
    return f"{omega:.4g} rad/s{hertz}"
