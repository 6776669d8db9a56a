"""The points of the study: what is varied, and how far.

Every point is a job of its own, of frozen numbers only, so that any core or machine finds the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from .flights import Scenario
from .methods import Known, Method, MethodName
from .params import params

__all__ = [
    "AXES",
    "FORMS",
    "MAPPED",
    "RIVALS",
    "SCENARIOS",
    "USED",
    "AxisName",
    "Form",
    "Grid",
    "LearnedFilter",
    "Point",
    "bandwidths",
    "plan",
]

AxisName = Literal["g", "order", "learned", "delay", "wind", "mass", "map"]
AXES: tuple[AxisName, ...] = get_args(AxisName)
"""``g``: choice of g over bandwidth; ``order``: low-pass forms of order 1 to 3 and type 2 over bandwidth; ``learned``:
filters learned on the tuning flights; ``delay``: of the commands, in s, that nobody was told; ``wind``: factor on it;
``mass``: factor on the added mass; ``map``: bandwidth by speed on the circle."""

SCENARIOS: tuple[Scenario, ...] = ("mass", "wind")
KNOWN: tuple[Known, ...] = get_args(Known)
# Who flies the axes that are not about the filter, and who may win the map.
RIVALS: tuple[MethodName, ...] = ("integral", "seer", "observer", "phyfilter")
MAPPED: tuple[MethodName, ...] = ("seer", "observer", "phyfilter")
USED: tuple[MethodName, ...] = (*RIVALS, "phyfilter_type2")
Form = tuple[int, Literal["lowpass", "general"]]
FORMS: tuple[Form, ...] = (
    (1, "lowpass"),
    (2, "lowpass"),
    (1, "general"),
    (2, "general"),
    (3, "general"),
)
_ORDERS = (1, 2, 3)
# m/s on the map: a round in 19 s, and what the heaviest vehicle of the study can hold.
_SPEEDS = (0.5, 3.5)


@dataclass(frozen=True)
class Grid:
    """How finely the axes are sampled, and with how many flights.

    Parameters
    ----------
    seeds, map_seeds : tuple of int
        Of the flights at every point of the axes and of the map.
    bandwidths, map_bandwidths, map_speeds : int
        Points on logarithmic scales.
    delays : tuple of int
        Samples.
    factors : tuple of float
        On wind and mass.
    duration : float, optional
        s of every flight; None means that of ``params.toml``.
    """

    seeds: tuple[int, ...] = tuple(range(20))
    map_seeds: tuple[int, ...] = tuple(range(6))
    bandwidths: int = 8
    map_bandwidths: int = 6
    map_speeds: int = 6
    delays: tuple[int, ...] = (0, 3, 6, 9, 12, 15)
    factors: tuple[float, ...] = (0.0, 0.5, 1.0, 1.5, 2.0)
    duration: float | None = None


@dataclass(frozen=True)
class Point:
    """One point of the study.

    Attributes
    ----------
    axis : str
    family : str
        The curve it belongs to: a choice of g, an order, a method.
    value : float
        Place on the axis.
    method : Method
    strength, mass_scale : float
        Factors on wind and added mass.
    speed : float, optional
        On the circle, m/s; None means that of ``params.toml``.
    scenarios : tuple of str
        What it is flown in.
    with_margin : bool
        Whether its modulus margin is taken.
    needs_margin : bool
        Whether it is flown with the margin of ``params.toml`` only, the outer loop as fast as that lets it be.
    """

    axis: AxisName
    family: str
    value: float
    method: Method
    strength: float = 1.0
    mass_scale: float = 1.0
    speed: float | None = None
    scenarios: tuple[Scenario, ...] = SCENARIOS
    with_margin: bool = False
    needs_margin: bool = False


@dataclass(frozen=True)
class LearnedFilter:
    """A filter learned on the tuning flights.

    Attributes
    ----------
    order : int
        As asked for; the filter may have fewer poles where more do not help.
    form : {"lowpass", "general"}
    coefficients : ((n,) tuple, (n,) tuple)
        a and b.
    rmse : float
        Of the force on these flights, N.
    message : str
    """

    order: int
    form: Literal["lowpass", "general"]
    coefficients: tuple[tuple[float, ...], tuple[float, ...]]
    rmse: float
    message: str

    @property
    def name(self) -> str:
        """For tables."""
        return f"{'low-pass' if self.form == 'lowpass' else 'general'}, n = {self.order}"


def plan(
    axes: Sequence[AxisName],
    methods: Mapping[MethodName, Method],
    grid: Grid,
    learned: Sequence[LearnedFilter] = (),
) -> list[Point]:
    """All points of some axes.

    Parameters
    ----------
    axes : sequence of str
        Of ``AXES``.
    methods : mapping
        As tuned. On the axes ``g`` and ``order`` all filters fly with the outer loop of the tuned PhyFilter, on ``map``
        and ``learned`` with the fastest that has the margin.
    grid : Grid
    learned : sequence of LearnedFilter
        For the axis of that name.

    Raises
    ------
    ValueError
        For an unknown axis or a missing method.
    """
    if unknown := [axis for axis in axes if axis not in AXES]:
        raise ValueError(f"axes: expected some of {', '.join(AXES)}, got {', '.join(unknown)}")
    if missing := [name for name in USED if name not in methods]:
        raise ValueError(f"methods: the study needs {', '.join(USED)}, missing {', '.join(missing)}")
    return [point for axis in dict.fromkeys(axes) for point in _points(axis, methods, grid, learned)]


def _points(
    axis: AxisName,
    methods: Mapping[MethodName, Method],
    grid: Grid,
    learned: Sequence[LearnedFilter],
) -> Iterator[Point]:
    ours = methods["phyfilter"]
    if axis == "g":
        for known in KNOWN:
            for w in bandwidths(grid.bandwidths):
                method = replace(ours, known=known, bandwidth=w)
                yield Point(axis, known, w, method, with_margin=True)
    elif axis == "order":
        forms = {f"order {n}": replace(ours, order=n) for n in _ORDERS}
        forms["type 2"] = replace(ours, name="phyfilter_type2", order=1)
        for family, method in forms.items():
            for w in bandwidths(grid.bandwidths):
                yield Point(axis, family, w, method.with_bandwidth(w), with_margin=True)
    elif axis == "learned":
        yield Point(axis, "tuned", 0.0, ours, with_margin=True)
        for k, found in enumerate(learned):
            method = replace(ours, coefficients=found.coefficients)
            yield Point(axis, found.name, k + 1.0, method, with_margin=True, needs_margin=True)
    elif axis == "map":
        yield from _map(methods, grid)
    else:
        for name in RIVALS:
            yield from _conditions(axis, name, methods[name], grid)


def _conditions(axis: AxisName, name: str, method: Method, grid: Grid) -> Iterator[Point]:
    """What a method meets is varied, not the method."""
    if axis == "delay":
        for late in grid.delays:
            value = late * params().sampling.dt
            yield Point(axis, name, value, replace(method, late=late), with_margin=True)
    for factor in grid.factors:
        if axis == "wind":
            yield Point(axis, name, factor, method, strength=factor, scenarios=("wind",))
        elif axis == "mass":
            yield Point(axis, name, factor, method, mass_scale=factor)


def _map(methods: Mapping[MethodName, Method], grid: Grid) -> Iterator[Point]:
    """Each with the fastest outer loop that has the margin: the margins are the same, the outer loops are not."""
    seer = methods["seer"]
    filters: tuple[MethodName, ...] = ("observer", "phyfilter")
    for speed in np.geomspace(*_SPEEDS, grid.map_speeds):
        fast = round(float(speed), 3)
        yield Point("map", "seer", seer.bandwidth, seer, speed=fast)
        for w in bandwidths(grid.map_bandwidths):
            for name in filters:
                method = methods[name].with_bandwidth(w)
                yield Point("map", name, w, method, speed=fast, with_margin=True, needs_margin=True)


def bandwidths(count: int) -> tuple[float, ...]:
    """Of filters, rad/s, evenly on a logarithmic scale over the range that is studied."""
    return tuple(round(float(w), 3) for w in np.geomspace(*params().tuning.studied, count))
