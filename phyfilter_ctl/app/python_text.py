"""A design as Python: by its family and cutoff while it is one, by its poles where they were moved."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import get_args

import numpy as np

from ..analysis import frequency_response
from ..design.placement import Family, bandpass, lowpass
from ..filter import PhyFilter
from .designs import Design

__all__ = ["Named", "family_of", "python_text"]

_LONG_LINE = 70
# A typed cutoff comes back through the poles it placed, in the browser too; coefficients of a family agree to this.
_SAME = 1e-9
# Poles that were put in one place are a binomial filter of some odd cutoff: only a round one was meant so.
_ROUND, _ALL = 6, 15
_EDGES = 12  # digits to which the edges of a band are found again


@dataclass(frozen=True)
class Named:
    """A design that is still a family's.

    Parameters
    ----------
    call : str
        What builds it, after ``pf.``.
    title : str
        Family, order and cutoff as a part of a file's name.
    """

    call: str
    title: str


def python_text(design: Design) -> str:
    """Code that builds the same filter: a family's to 1e-9 of each coefficient, any other to the bit.

    Parameters
    ----------
    design : Design

    Returns
    -------
    str
        Lines that leave ``filter``, and ``sampled`` where the sampled filter is stable.

    Examples
    --------
    >>> from dataclasses import replace
    >>> butterworth = Design().with_filter(lowpass(2, 20.0, family="butterworth"))
    >>> print(python_text(butterworth).splitlines()[2])
    filter = pf.lowpass(2, 20.0, family='butterworth')
    >>> moved = replace(butterworth, poles=(-14.0 + 14.5j, -14.0 - 14.5j))
    >>> print(python_text(moved).splitlines()[2])
    filter = pf.PhyFilter.from_poles([complex(-14.0, 14.5), complex(-14.0, -14.5)])
    """
    named = family_of(design.filter)
    made = f"pf.{named.call}" if named is not None else _by_poles(design)
    lines = ["import phyfilter_ctl as pf", "", f"filter = {made}"]
    try:
        sampled = design.handed_over
    except ValueError as error:
        lines.append(f"# {' '.join(str(error).split())}")
    else:
        said = "".join(f", {name}={value!r}" for name, value in design.signals.as_json().items())
        lines.append(f"sampled = filter.sampled({design.dt!r}, method={sampled.sampling.method!r}{said})")
    return "\n".join(lines) + "\n"


def family_of(filter: PhyFilter) -> Named | None:
    """The family, order and cutoff that give the same filter; None where there are none, and for one pole.

    Parameters
    ----------
    filter : PhyFilter
    """
    if filter.is_lowpass or filter.type > 0:
        return _lowpass(filter) if filter.order > 1 else None
    return _bandpass(filter) if filter.order % 2 == 0 and filter.b[filter.order // 2] > 0.0 else None


def _lowpass(filter: PhyFilter) -> Named | None:
    """A low-pass filter's: the cutoff is in proportion to the poles."""
    n, kind = filter.order, 1 if filter.is_lowpass else filter.type
    for family in get_args(Family):
        unit = lowpass(n, 1.0, family=family, type=kind)
        cutoff = float(np.exp((np.log(filter.a[0]) - np.log(unit.a[0])) / n))
        digits = range(1, _ROUND + 1 if family == "binomial" else _ALL + 1)

        def made(cutoff: float, family: Family = family) -> PhyFilter:
            return lowpass(n, cutoff, family=family, type=kind)

        if not _same(made(cutoff), filter):
            continue
        for (rounded,) in _rounded([cutoff], digits, made, filter):
            of_type = f", type={kind}" if kind > 1 else ""
            named = "" if n == 1 else f", family={family!r}"
            title = f"{'lowpass' if n == 1 else family}_{n}_{rounded:g}" + (
                f"_type{kind}" if kind > 1 else ""
            )
            return Named(f"lowpass({n}, {rounded!r}{named}{of_type})", title)
    return None


def _bandpass(filter: PhyFilter) -> Named | None:
    try:
        edges = [float(edge) for edge in frequency_response(filter).band_edges]
    except (ValueError, IndexError, ZeroDivisionError):
        return None
    if not 0.0 < edges[0] < edges[1] < np.inf:
        return None
    for family in get_args(Family):

        def made(low: float, high: float, family: Family = family) -> PhyFilter:
            return bandpass(filter.order, low, high, family=family)

        for low, high in _rounded(edges, range(1, _EDGES + 1), made, filter):
            call = f"bandpass({filter.order}, {low!r}, {high!r}, family={family!r})"
            return Named(call, f"bandpass_{filter.order}_{low:g}_{high:g}")
    return None


def _rounded(
    values: list[float], digits: range, made: Callable[..., PhyFilter], filter: PhyFilter
) -> Iterator[tuple[float, ...]]:
    """The values at the fewest digits that give the filter."""
    for count in digits:
        rounded = tuple(float(f"{value:.{count}g}") for value in values)
        if all(abs(new - old) <= 1e-6 * old for new, old in zip(rounded, values, strict=True)) and _same(
            made(*rounded), filter
        ):
            yield rounded
            return


def _same(one: PhyFilter, other: PhyFilter) -> bool:
    pairs = ((one.a, other.a), (one.b, other.b))
    return all(bool(np.all(np.abs(p - q) <= _SAME * np.abs(q))) for p, q in pairs)


def _by_poles(design: Design) -> str:
    numbers = [_number(p) for p in design.poles]
    poles = f"[{', '.join(numbers)}]"
    if len(poles) > _LONG_LINE:
        poles = "[\n" + "".join(f"    {number},\n" for number in numbers) + "]"
    if design.numerator.kind == "type":
        return f"pf.place_poles({poles}, type={design.numerator.type})"
    if design.numerator.kind == "lowpass":
        return f"pf.PhyFilter.from_poles({poles})"
    return f"pf.PhyFilter.from_poles({poles}, b={design.filter.b.tolist()!r})"


def _number(value: complex) -> str:
    return repr(value.real) if value.imag == 0.0 else f"complex({value.real!r}, {value.imag!r})"
