"""Clocks of imported FMUs: what a description says of them, and when they tick in a run."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import lxml.etree as etree

from .. import _signals

__all__ = ["ClockSchedule", "ClockTimes", "FmuClock", "read_clocks", "same_time"]

ClockTimes = Mapping[str, float | Sequence[float]]
"""By clock: seconds between two ticks, or for a triggered clock the times at which it ticks."""

_ROUNDING = 1e-12  # of a time, that arithmetic may leave between two that are meant to be one
_SETTABLE = ("fixed", "tunable")


@dataclass(frozen=True)
class FmuClock:
    """A clock of an FMU.

    Parameters
    ----------
    name : str
    reference : int
        Value reference.
    causality : str
        "input" for one that the importer ticks, "output" or "local" for one that the FMU does.
    variability : str
        Of its interval: "constant", "fixed", "calculated", "tunable", "changing", "countdown" or "triggered".
    interval : float or None
        Seconds between two ticks; None where the description does not say.
    shift : float
        Seconds from the start of a run to its first tick.
    priority : int
        That of the lowest number goes first.
    """

    name: str
    reference: int
    causality: str
    variability: str
    interval: float | None = None
    shift: float = 0.0
    priority: int = 0


def read_clocks(root: etree._Element) -> tuple[FmuClock, ...]:
    """Clocks of a model description.

    Parameters
    ----------
    root : Element
        ``fmiModelDescription``, of FMI 3.0.

    Raises
    ------
    ValueError
        If the resolution of a clock is not above zero.

    Examples
    --------
    >>> text = (
    ...     '<fmiModelDescription><ModelVariables><Clock name="c" valueReference="7" causality="input" '
    ...     'intervalVariability="constant" resolution="200" intervalCounter="1"/></ModelVariables>'
    ...     "</fmiModelDescription>"
    ... )
    >>> clock, = read_clocks(etree.fromstring(text))
    >>> clock.name, clock.interval, clock.shift
    ('c', 0.005, 0.0)
    """
    types = {entry.get("name"): entry for entry in root.iterfind("TypeDefinitions/ClockType")}
    found = []
    for entry in root.iterfind("ModelVariables/Clock"):
        said = {**dict(types.get(entry.get("declaredType"), entry).attrib), **dict(entry.attrib)}
        resolution = float(said.get("resolution", "nan"))
        if resolution <= 0.0:
            raise ValueError(
                f"Clock {said['name']}: resolution: expected a number > 0, got {said['resolution']}"
            )
        decimal, counter = said.get("intervalDecimal"), said.get("intervalCounter")
        interval = float(decimal) if decimal else float(counter) / resolution if counter else math.nan
        shift = said.get("shiftDecimal") or float(said.get("shiftCounter", "0")) / resolution
        found.append(
            FmuClock(
                name=str(said["name"]),
                reference=int(said["valueReference"]),
                causality=str(said.get("causality", "local")),
                variability=str(said.get("intervalVariability", "")),
                interval=interval if 0.0 < interval < math.inf else None,
                shift=float(shift) if math.isfinite(float(shift)) else 0.0,
                priority=int(said.get("priority", "0")),
            )
        )
    return tuple(found)


def same_time(a: float, b: float) -> bool:
    """Whether two times in seconds differ by rounding at most.

    Parameters
    ----------
    a, b : float

    Examples
    --------
    >>> same_time(0.1 + 0.2, 0.3), same_time(0.3, 0.3001)
    (True, False)
    """
    return a == b or abs(a - b) <= _ROUNDING * max(min(abs(a), abs(b)), 1.0)


@dataclass(frozen=True)
class _Plan:
    """Ticks at origin + k * interval; the next one has this number."""

    origin: float
    interval: float
    k: int = 0

    @property
    def next(self) -> float:
        return self.origin + self.k * self.interval if self.k else self.origin


class ClockSchedule:
    """Which input clocks of a running FMU tick next, and when.

    Parameters
    ----------
    clocks : sequence of FmuClock
        All of the FMU.
    times : dict of str to float or sequence of float
        Intervals of clocks whose interval is the importer's to choose, instants of triggered ones.
    owner : str
        The FMU, for messages.

    Raises
    ------
    ValueError
        If a name is none of an input clock, or its interval or instants cannot be chosen so.
    """

    def __init__(self, clocks: Iterable[FmuClock], times: ClockTimes, owner: str) -> None:
        self.clocks: tuple[FmuClock, ...] = tuple(clocks)
        self.inputs: dict[str, FmuClock] = {
            clock.name: clock for clock in self.clocks if clock.causality == "input"
        }
        self.outputs: tuple[FmuClock, ...] = tuple(c for c in self.clocks if c.causality == "output")
        self._instants: dict[str, tuple[float, ...]] = {}
        self.chosen: dict[str, float] = {}
        for name, given in times.items():
            if name not in self.inputs:
                there = ", ".join(self.inputs) or "none"
                raise ValueError(f"{owner}: clocks: {name!r} is no input clock; there are {there}")
            clock = self.inputs[name]
            if clock.variability == "triggered":
                self._instants[name] = _instants(f"{owner}: clocks: {name}", given)
            elif clock.variability in _SETTABLE:
                self.chosen[name] = _interval(f"{owner}: clocks: {name}", given)
            else:
                raise ValueError(
                    f"{owner}: clocks: {name!r} has a {clock.variability} interval, which the importer cannot choose"
                )
        self._plans: dict[str, _Plan] = {}
        self._passed: dict[str, int] = {}

    def told(self, *, running: bool) -> tuple[FmuClock, ...]:
        """Clocks whose intervals the FMU is to be asked for.

        Parameters
        ----------
        running : bool
            At an event, not at the start.
        """
        asked = ("tunable", "changing", "countdown", *(() if running else ("calculated",)))
        return tuple(
            clock
            for clock in self.inputs.values()
            if clock.name not in self.chosen and clock.variability in asked
        )

    @property
    def unknown(self) -> list[str]:
        """Periodic clocks that nobody has told an interval of."""
        aperiodic = ("triggered", "countdown")
        return [n for n, c in self.inputs.items() if c.variability not in aperiodic and n not in self._plans]

    @property
    def state(self) -> object:
        """What the coming ticks hang on, to be put back."""
        return dict(self._plans), dict(self._passed)

    @state.setter
    def state(self, value: object) -> None:
        assert isinstance(value, tuple)
        self._plans, self._passed = dict(value[0]), dict(value[1])

    @property
    def next(self) -> float:
        """Time of the next tick in seconds; inf for none."""
        return min((self._next(name) for name in self.inputs), default=math.inf)

    def begin(self, t: float) -> None:
        """A run starts.

        Parameters
        ----------
        t : float
            Seconds.
        """
        self._plans = {}
        for name, clock in self.inputs.items():
            interval = self.chosen.get(name, clock.interval)
            if interval is not None and clock.variability not in ("triggered", "countdown"):
                self._plans[name] = _Plan(t + clock.shift, interval)
        self._passed = {
            name: sum(1 for time in times if time < t and not same_time(time, t))
            for name, times in self._instants.items()
        }

    def due(self, t: float) -> tuple[FmuClock, ...]:
        """Clocks that tick now and have not yet, those of the highest priority first.

        Parameters
        ----------
        t : float
            Seconds.
        """
        found = [c for n, c in self.inputs.items() if self._next(n) <= t or same_time(self._next(n), t)]
        return tuple(sorted(found, key=lambda clock: clock.priority))

    def ticked(self, clock: FmuClock, t: float) -> None:
        """A clock ticked: what comes next.

        Parameters
        ----------
        clock : FmuClock
        t : float
            Seconds.
        """
        if clock.variability in ("countdown", "triggered"):
            self._plans.pop(clock.name, None)
            left = self._instants.get(clock.name, ())[self._passed.get(clock.name, 0) :]
            if left and (left[0] <= t or same_time(left[0], t)):
                self._passed[clock.name] += 1
        elif plan := self._plans.get(clock.name):
            self._plans[clock.name] = replace(plan, k=plan.k + 1)

    @property
    def ends(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Names of the clocks that another's ticks may trigger, and of those that the FMU ticks itself."""
        triggered = tuple(name for name, clock in self.inputs.items() if clock.variability == "triggered")
        return triggered, tuple(clock.name for clock in self.outputs)

    def trigger(self, name: str, t: float) -> None:
        """A triggered clock is to tick once more, now.

        Parameters
        ----------
        name : str
        t : float
            Seconds.
        """
        self._plans[name] = _Plan(t, math.inf)

    def tell(self, clock: FmuClock, interval: float, t: float) -> None:
        """The FMU tells the interval that begins now, or of the last tick on.

        Parameters
        ----------
        clock : FmuClock
        interval : float
            Seconds.
        t : float
            Now.

        Raises
        ------
        ValueError
            If no clock can have such an interval.
        """
        once = clock.variability == "countdown"
        if not (0.0 <= interval < math.inf and (once or interval > 0.0)):
            raise ValueError(
                f"clock {clock.name!r}: expected an interval {'>= 0' if once else '> 0'} s, got {interval}"
            )
        plan = self._plans.get(clock.name)
        if once:
            self._plans[clock.name] = _Plan(t + interval, math.inf)
        elif plan is None:  # its first tick lies ahead
            self._plans[clock.name] = _Plan(t + clock.shift, interval)
        elif interval != plan.interval:
            last = plan.origin + (plan.k - 1) * plan.interval
            first = plan.k == 0
            self._plans[clock.name] = _Plan(plan.origin if first else last, interval, 0 if first else 1)

    def _next(self, name: str) -> float:
        plan = self._plans.get(name)
        left = self._instants.get(name, ())[self._passed.get(name, 0) :]
        return min(plan.next if plan else math.inf, left[0] if left else math.inf)


def _instants(what: str, given: float | Sequence[float]) -> tuple[float, ...]:
    if isinstance(given, int | float):
        raise ValueError(
            f"{what} is triggered: expected the times in s at which it ticks, got one number {given}"
        )
    return tuple(_signals.sample_times(what, given).tolist()) if len(given) else ()


def _interval(what: str, given: float | Sequence[float]) -> float:
    if not isinstance(given, int | float) or not 0.0 < given < math.inf:
        raise ValueError(f"{what}: expected its interval, seconds > 0, got {given}")
    return float(given)
