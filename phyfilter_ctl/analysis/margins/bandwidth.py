"""Largest bandwidth of a family of filters that a loop tolerates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from ... import _signals
from ...filter import FilterBank, PhyFilter, SampledPhyFilter
from ...results import PerChannel, Result, Status, in_lines
from ...values import Loop
from ...values.actuator import checked_number
from .filter_margins import checked_loop, filter_margins

__all__ = ["BandwidthLimit", "largest_bandwidth"]

_POINTS_PER_DECADE = 24
_TOLERANCE = 1e-9
# Golden section steps into a dip of the modulus margin between points of the scan.
_DIP_STEPS = 16
_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


@dataclass(frozen=True, eq=False, repr=False)
class BandwidthLimit(Result):
    """Bandwidths that a loop tolerates; made by :func:`largest_bandwidth`.

    Parameters
    ----------
    limit : float
        Every bandwidth from the lower end of the range up to this is borne, in rad/s; the upper end where all are, nan
        where the lower end is not.
    islands : tuple of (float, float)
        Further intervals of borne bandwidths above the limit.
    modulus_margin : float
        What was asked for.
    status : Status
        LIMITED, UNLIMITED or INFEASIBLE.
    message : str
        What was found, and what to try.
    """

    _units = MappingProxyType({"limit": "rad/s"})

    _answer = ("limit",)

    limit: float
    islands: tuple[tuple[float, float], ...]
    modulus_margin: float
    status: Status
    message: str

    def describe(self) -> str:
        """The limit as text, one line each.

        Returns
        -------
        str

        Examples
        --------
        >>> limit = largest_bandwidth(lambda w: PhyFilter([w]), Loop(delay=0.02), modulus_margin=0.5)
        >>> print(limit.describe().splitlines()[0])
        bandwidth up to     35.06 rad/s (5.58 Hz), with a modulus margin of 0.5 or more
        """
        asked = (
            f"with a modulus margin of {self.modulus_margin:g} or more" if self.modulus_margin else "stable"
        )
        islands = "; ".join(f"{low:.4g} ... {high:.4g} rad/s" for low, high in self.islands)
        limit = f"{_signals.in_both(self.limit)}, {asked}" if np.isfinite(self.limit) else "none"
        status = f"{self.status}: {self.status.meaning}"
        return in_lines(
            {"bandwidth up to": limit, "islands above": islands, "status": status, "": self.message}
        )


def largest_bandwidth(
    make: Callable[[float], PhyFilter | SampledPhyFilter | FilterBank],
    loop: Loop | None = None,
    *,
    dt: float | None = None,
    modulus_margin: float = 0.5,
    low: float = 0.1,
    high: float = 1e3,
) -> BandwidthLimit:
    """Largest bandwidth for which the complete loop keeps a modulus margin, or at least is stable.

    Parameters
    ----------
    make : callable
        Bandwidth in rad/s -> filter, continuous in it: ``lambda w: PhyFilter([w])``. Of a stack every channel counts.
    loop : Loop, optional
        Without gains the inner loop.
    dt : float, optional
        Sampling interval in seconds, where ``make`` gives a PhyFilter that is to be sampled.
    modulus_margin : float
        Least distance of the open loop from -1 that is asked for, in [0, 1). 0.5, the default, holds the peak of the
        sensitivity at 2, as in :class:`~phyfilter_ctl.LoopGoal`. 0 asks for stability alone: a filter of that
        bandwidth is at the limit of stability and no design.
    low, high : float
        Range of bandwidths to search in rad/s.

    Returns
    -------
    BandwidthLimit
        limit to 1e-9 relative.

    Raises
    ------
    TypeError, ValueError
        As for :func:`~phyfilter_ctl.margins`; if ``make`` is a filter and no callable, the range is empty or the
        modulus margin out of range; and what ``make`` raises.

    Notes
    -----
    The modulus margin is a continuous function of the bandwidth and 0 where the loop is unstable, so a bandwidth that
    is not borne shows as a dip: the range is scanned, every dip is followed down, and each end bisected.

    Examples
    --------
    First order behind a lag of 50 ms and 10 ms of delay, kp/kd = 10/4; and what it could be at the limit of stability:

    >>> loop = Loop(10.0, 4.0, actuator=0.05, delay=0.01)
    >>> found = largest_bandwidth(lambda w: PhyFilter([w]), loop)
    >>> round(found.limit, 2), found.islands
    (11.5, ())
    >>> round(largest_bandwidth(lambda w: PhyFilter([w]), loop, modulus_margin=0.0).limit, 2)
    77.87
    """
    if isinstance(make, PhyFilter | SampledPhyFilter) or not callable(make):
        raise TypeError(
            f"make: expected a callable from a bandwidth to a filter, got {type(make).__name__}; "
            "write lambda w: pf.lowpass(1, w), or take margins for one filter"
        )
    around = checked_loop(loop)
    low, high = checked_number("low", low, least=0.0), checked_number("high", high, least=0.0)
    if not 0.0 < low < high:
        raise ValueError(f"low, high: expected 0 < low < high, got {low:g} and {high:g} rad/s")
    wanted = checked_number("modulus_margin", modulus_margin, least=0.0)
    if wanted >= 1.0:
        raise ValueError(
            f"modulus_margin: expected a number in [0, 1), got {wanted:g}; no loop that acts reaches 1"
        )

    def spare(bandwidth: float) -> float:
        """Positive where the bandwidth is borne."""
        found = filter_margins(make(bandwidth), around, dt=dt)
        margins = found if isinstance(found, PerChannel) else (found,)
        return min(each.modulus_margin for each in margins) - wanted

    granted = "" if around.command_limit is None else "; while the command stays within its limit"
    points, values = _scan(spare, low, high)
    intervals = _intervals(spare, points, values)
    if not intervals or intervals[0][0] > low:
        islands = "" if not intervals else f"; borne are {_text(intervals)}"
        kept = values[0] + wanted
        message = (
            f"the lowest bandwidth, {low:g} rad/s, is not borne: modulus margin {kept:.4g}, {wanted:g} is asked for"
            f"{islands}; lower the gains or start lower{granted}"
        )
        return BandwidthLimit(float("nan"), tuple(intervals), wanted, Status.INFEASIBLE, message)
    (_, limit), *islands = intervals
    if limit == high:
        message = f"every bandwidth up to {high:g} rad/s is borne; raise high{granted}"
        return BandwidthLimit(limit, (), wanted, Status.UNLIMITED, message)
    beyond = f"; beyond it {_text(islands)} are borne again, cut off from it" if islands else ""
    message = f"borne up to {_signals.in_both(limit)}{beyond}{granted}"
    return BandwidthLimit(limit, tuple(islands), wanted, Status.LIMITED, message)


def _scan(spare: Callable[[float], float], low: float, high: float) -> tuple[list[float], list[float]]:
    """Points of the range and the margin there; a dip that stays positive is followed down to its least value."""
    count = int(np.ceil(_POINTS_PER_DECADE * np.log10(high / low))) + 2
    points = [float(w) for w in np.geomspace(low, high, count)]
    points[0], points[-1] = low, high
    values = [spare(w) for w in points]
    extra = []
    for i in range(1, count - 1):
        left, here, right = values[i - 1 : i + 2]
        if 0.0 < here <= left and here <= right and here < max(left, right):
            extra.append(_follow(spare, points[i - 1], points[i + 1]))
    merged = sorted([*zip(points, values, strict=True), *extra])
    return [w for w, _ in merged], [value for _, value in merged]


def _follow(spare: Callable[[float], float], low: float, high: float) -> tuple[float, float]:
    """Golden section for the least value; stops where it is not positive."""
    a, b = low, high
    inner = [b - _GOLDEN * (b - a), a + _GOLDEN * (b - a)]
    seen = [spare(w) for w in inner]
    for _ in range(_DIP_STEPS):
        if min(seen) <= 0.0:
            break
        if seen[0] < seen[1]:
            b = inner[1]
            inner = [b - _GOLDEN * (b - a), inner[0]]
            seen = [spare(inner[0]), seen[0]]
        else:
            a = inner[0]
            inner = [inner[1], a + _GOLDEN * (b - a)]
            seen = [seen[1], spare(inner[1])]
    k = int(seen[1] < seen[0])
    return inner[k], seen[k]


def _intervals(
    spare: Callable[[float], float], points: list[float], values: list[float]
) -> list[tuple[float, float]]:
    """Intervals of positive values, ends inside the range bisected; the end given is on the borne side."""
    found: list[tuple[float, float]] = []
    start = points[0] if values[0] > 0.0 else None
    for i in range(1, len(points)):
        before, after = values[i - 1] > 0.0, values[i] > 0.0
        if before == after:
            continue
        good, bad = (points[i - 1], points[i]) if before else (points[i], points[i - 1])
        while abs(bad - good) > _TOLERANCE * good:
            middle = 0.5 * (good + bad)
            good, bad = (middle, bad) if spare(middle) > 0.0 else (good, middle)
        if after:
            start = good
        elif start is not None:
            found.append((start, good))
            start = None
    if start is not None:
        found.append((start, points[-1]))
    return found


def _text(intervals: list[tuple[float, float]]) -> str:
    return ", ".join(f"{a:.4g} to {b:.4g} rad/s" for a, b in intervals)
