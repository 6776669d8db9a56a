"""Events on the way: where a condition passes 0 inside a step, and what happens then.

Every condition has a side, the sign it was last seen with. An event is where the sign changes in its direction; it is
located to the rounding of time on the polynomial inside the step, by sections of all parts at once. An event with a
memory happens at its own times too, and takes new sides for all its conditions from where it left the block.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from ..diagram import FlatModel
from .chains import Call
from .pair import sizes
from .steps import KEPT, Results, compose

__all__ = ["Crossing", "EndlessEventsError", "EventWatch", "RunEndedError", "refuse_events"]

# Parts of a step at which the conditions are looked at: early ones for what returns soon after an event, uneven ones
# for what repeats itself.
_PARTS = np.array([2.0**-20, 2.0**-10, 2.0**-5, 0.123, 0.197, 0.271, 0.397, 0.521, 0.643, 0.759, 0.883, 1.0])
# The polynomial through the conditions at some must meet others to that part of their range, and not come nearer to 0
# between them than that other part; else both halves are looked at, down to the 1024th part of the step. Below that
# part of the largest value ever seen, changes are rounding.
_NODES, _CHECKED = [0, 3, 5, 7, 9, 11], [2, 4, 6, 8, 10]
_RESOLVED, _CLEAR, _FINEST, _NOISE = 0.05, 0.02, 10, 1e-9
# Parts before the first of them, down to rounding, for what returns sooner still.
_EARLY = 2.0 ** -np.linspace(48.0, 20.0, len(_PARTS))
_SECTIONS = np.arange(1, len(_PARTS) + 1) / len(_PARTS)
_AROUND = np.array([-1e-2, -1e-3, -1e-4, -1e-6, -1e-8, 0.0, 1e-8, 1e-6, 1e-4, 1e-3, 1e-2])
_ROUNDING = 4 * np.finfo(float).eps
# What is past 0 by rounding returns within that part of the step before and of time.
_SOON, _SOONER = 1e-9, 1e4 * np.finfo(float).eps
# Rounds of events at one time, and repetitions of one without time in between, that are taken for endless.
_ROUNDS, _IN_A_ROW = 100, 40
_NO_TIME = 1e-12
_NEVER = -np.inf, 0, np.inf


def refuse_events(flat: FlatModel, what: str) -> None:
    """Raise where a diagram has events and something would pass them over."""
    if flat.events:
        raise ValueError(
            f"{what} passes over the events of {flat.name} ({', '.join(event.name for event in flat.events)}): "
            "expected a diagram without, such as the block's equations between events, its attribute system; or, for a "
            "switch in the equations, a smooth one, np.tanh(v / width) for np.sign(v)"
        )


class EndlessEventsError(Exception):
    """Events that follow each other without end."""


class RunEndedError(Exception):
    """A block asked to end the run."""


class _Bracket(NamedTuple):
    """Parts between which an event lies, and the conditions there; None where they are not known."""

    begin: float
    end: float
    before: FloatArray | None
    after: FloatArray


class Crossing(NamedTuple):
    """The first event in a step: at which part of it, and which conditions passed 0 there."""

    part: float
    fired: NDArray[np.bool_]


def _interpolation(at: FloatArray) -> FloatArray:
    """Values at parts of the step from those at the nodes, (len(at), len(nodes))."""
    nodes = _PARTS[_NODES]
    return np.asarray(np.linalg.solve(np.vander(nodes).T, np.vander(at, len(nodes)).T).T, dtype=float)


_MET = _interpolation(_PARTS[_CHECKED])
_ENDS = 2.0 ** -np.arange(
    5.0, 20.0
)  # a condition may turn round soon after a step's begin and before its end
_BETWEEN = _interpolation(np.concatenate([_ENDS, np.linspace(0.02, 0.98, 25), 1.0 - _ENDS]))


@lru_cache(maxsize=KEPT)
def _sampled(flat: FlatModel) -> ca.Function:
    """(times (1, k), x (n_x, k), u (n_u, k), p, z) -> conditions (n_e, k)."""
    assert flat.conditions is not None
    return flat.conditions.map("pf_conditions", "serial", len(_PARTS), [3, 4], [])


@lru_cache(maxsize=KEPT)
def _rates(flat: FlatModel) -> ca.Function:
    """Conditions at a point, and how fast they change along the solution."""
    conditions = flat.conditions
    assert conditions is not None
    moving = any(event.memory is None for event in flat.events)

    def body(x: ca.SX, q: ca.SX, u: ca.SX, rate: ca.SX, p: ca.SX, z: ca.SX) -> Results:
        point = [q[0], x, u, p, z]
        kind = type(x)
        if not moving:
            return conditions(*point), kind.zeros(conditions.size1_out(0))
        symbols = [kind.sym(f"i{i}", conditions.size1_in(i)) for i in range(5)]
        along = [kind.sym(f"d{i}", conditions.size1_in(i)) for i in range(3)]
        value = conditions(*symbols)
        change = sum((ca.jtimes(value, symbols[i], along[i]) for i in range(3)), kind.zeros(value.numel()))
        function = ca.Function("pf_rates", [*symbols, *along], [value, change])
        results = function.call([*point, kind(1.0), flat.dynamics(*point), rate])
        return results

    return compose("pf_events", sizes(flat), body)


def _at_point(flat: FlatModel, function: ca.Function) -> ca.Function:
    return compose("pf_completed", sizes(flat), lambda x, q, u, rate, p, z: (function(q[0], x, u, p, z),))


class EventWatch:
    """Watches the conditions of a run.

    Parameters
    ----------
    flat : FlatModel
        With events.
    given : list of arrays
        x, (t, ...), u, rates of u, p, z, as the integrator has them; read in place.
    renew : callable
        Brings z to what follows from x after an event.
    """

    def __init__(
        self, flat: FlatModel, given: list[FloatArray], renew: Callable[[], None] = lambda: None
    ) -> None:
        x, _, u, _, p, z = given
        count = len(_PARTS)
        self._flat, self._given, self._renew = flat, given, renew
        self._times, self._x, self._u = (
            np.zeros((count, 1)),
            np.zeros((count, len(x))),
            np.zeros((count, len(u))),
        )
        self._sampled = Call(_sampled(flat), [self._times, self._x, self._u, p, z])
        self._rates = Call(_rates(flat), given)
        self._directions = np.array([event.direction for event in flat.events for _ in range(event.rows)])
        self._owner = np.repeat(np.arange(len(flat.events)), [event.rows for event in flat.events])
        self._remembers = np.array([flat.events[i].memory is not None for i in self._owner], dtype=bool)
        self._completed = [
            (i, Call(_at_point(flat, event.completed), given))
            for i, event in enumerate(flat.events)
            if event.completed is not None
        ]
        self._changed = [
            (i, Call(_at_point(flat, event.changed), given))
            for i, event in enumerate(flat.events)
            if event.changed is not None
        ]
        self._asked: set[int] = set()
        self._side: NDArray[np.float64] | None = None
        # Conditions that are 0 but for rounding and were not seen on their side yet.
        self._returning = np.zeros(len(self._owner), dtype=bool)
        self._largest = np.zeros(len(self._owner))
        # How far beyond 0 an event left a condition that is on its way back to its side; nan for others.
        self._depth = np.full(len(self._owner), np.nan)
        self._recent: dict[
            str, tuple[float, int, float]
        ] = {}  # when, how often in a row, how long after the last
        self._h, self._soon = 0.0, 0.0
        self.log: list[tuple[float, str]] = []

    @property
    def next_event(self) -> float:
        """Time of the next event that is known beforehand; inf for none."""
        return min((memory.next_event for memory in self._flat.memories), default=np.inf)

    @property
    def declared(self) -> list[tuple[float, str]]:
        """The log without the switches in the equations."""
        own = {event.name for event in self._flat.events if event.switch}
        return [entry for entry in self.log if entry[1] not in own]

    def is_due(self, t: float) -> bool:
        """Whether an event that is known beforehand happens at a time, but for rounding.

        Parameters
        ----------
        t : float
        """
        return self.next_event <= t + _ROUNDING * abs(t)

    def begin(self) -> None:
        """Start what keeps something from event to event, and bring x to where it starts."""
        for memory in self._flat.memories:
            memory.restart(float(self._given[1][0]))
        for i, event in enumerate(self._flat.events):
            if event.memory is not None:
                self._happen(i)

    @property
    def state(self) -> object:
        """What the events to come hang on, to be put back."""
        side = None if self._side is None else self._side.copy()
        arrays = self._returning.copy(), self._largest.copy(), self._depth.copy()
        return set(self._asked), side, arrays, dict(self._recent), (self._h, self._soon), len(self.log)

    @state.setter
    def state(self, value: object) -> None:
        assert isinstance(value, tuple)
        asked, side, arrays, recent, (self._h, self._soon), logged = value
        self._asked, self._recent = set(asked), dict(recent)
        self._side = None if side is None else side.copy()
        self._returning, self._largest, self._depth = (array.copy() for array in arrays)
        del self.log[logged:]

    # -- inside a step ------------------------------------------------------------------------------------------

    def crossing(self, h: float, states: Callable[[FloatArray], FloatArray]) -> Crossing | None:
        """The first event in a step of length h, whose states at parts of it are given."""
        self._h = h
        side, returning = np.array(self._side), self._returning.copy()
        found = self._search(0.0, 1.0, h, states, side, returning)
        lost = () if found else self._missed(self._sampled.results[0][-1], h)
        back = returning & (self._directions * side < 0.0)
        if found is None and back.any() and h > self._soon:
            # Back and through 0 again, sooner than was looked; or so soon that no time is between.
            side, returning = np.array(self._side), self._returning.copy()
            found = self._first(_EARLY, self._at(_EARLY, h, states), side, returning)
            if found is None:
                return Crossing(0.0, back)
        self._side, self._returning = side, returning
        if found is None:
            if len(lost):
                names = [self._flat.events[self._owner[i]].name for i in lost]
                raise EndlessEventsError(self._endless(float(self._given[1][0]), names))
            return None
        end, values = self._located(found, h, states)
        return Crossing(end, self._fires(values, side, returning))

    def _missed(self, values: FloatArray, h: float) -> NDArray[np.intp]:
        """Conditions that were on their way back to their side after an event and fell away from it instead.

        Their events have followed each other faster than the rounding of time can tell.
        """
        beyond = self._directions * values
        self._depth[beyond < 0.0] = np.nan
        if not h > self._soon:
            return np.zeros(0, dtype=np.intp)
        return np.flatnonzero((beyond > 1e3 * self._depth) & (beyond > _NOISE * self._largest))

    def _search(
        self,
        begin: float,
        end: float,
        h: float,
        states: Callable[[FloatArray], FloatArray],
        side: NDArray[np.float64],
        returning: NDArray[np.bool_],
        finer: int = _FINEST,
    ) -> _Bracket | None:
        """The parts between which the first event of a stretch lies, halved until nothing can hide in it."""
        parts = begin + (end - begin) * _PARTS
        values = self._at(parts, h, states)
        if finer and not self._is_resolved(values):
            middle = (begin + end) / 2
            return self._search(begin, middle, h, states, side, returning, finer - 1) or self._search(
                middle, end, h, states, side, returning, finer - 1
            )
        return self._first(parts, values, side, returning, _Bracket(begin, end, None, values[-1]))

    def _is_resolved(self, values: FloatArray) -> bool:
        """Whether the values at the parts tell where the conditions pass 0."""
        values = np.where(np.isfinite(values).all(axis=0), values, 0.0)  # of the others nothing is known
        self._largest = np.maximum(self._largest, np.abs(values).max(axis=0))
        inwards = values * np.where(values[-1] < 0.0, -1.0, 1.0)
        least, spread = inwards.min(axis=0), np.ptp(values, axis=0)
        near = (spread > _NOISE * self._largest) & (least <= spread)
        if not near.any():
            return True
        inwards, least, spread = inwards[:, near], least[near], spread[near]
        off = np.abs(_MET @ inwards[_NODES] - inwards[_CHECKED]).max(axis=0)
        lowest = np.minimum((_BETWEEN @ inwards[_NODES]).min(axis=0), least)
        ends = np.minimum(inwards[0], inwards[-1])
        hidden = (least > 0.0) & (lowest < np.minimum(ends, _CLEAR * spread))
        return not ((off > _RESOLVED * spread) | hidden).any()

    def _located(
        self, found: _Bracket, h: float, states: Callable[[FloatArray], FloatArray]
    ) -> tuple[float, FloatArray]:
        """The first part at which an event has happened, to the rounding of time, and the conditions there.

        By sections, every second time around where a straight line between the ends passes 0.
        """
        side, returning = self._side, self._returning
        assert side is not None
        resolution = _ROUNDING * max(abs(float(self._given[1][0])), h) / h
        uniform = True
        while found.end - found.begin > resolution:
            length = found.end - found.begin
            i = int(np.argmax(self._fires(found.after, side, returning)))
            before, after = (0.0, 0.0) if found.before is None else (found.before[i], found.after[i])
            if uniform or not before * after < 0.0:
                parts = found.begin + length * _SECTIONS
            else:
                near = found.begin + length * before / (before - after) + length * _AROUND
                parts = np.append(np.clip(near, found.begin, found.end), found.end)
            parts[-1] = found.end
            uniform = not uniform
            narrower = self._first(parts, self._at(parts, h, states), side, returning, found)
            assert narrower is not None  # the last part is where it was found
            found = narrower
        fired = self._fires(found.after, side, returning)
        if (found.after[fired] == 0.0).any():  # just past 0, as a reset that asks for the sign expects it
            later = min(found.end + resolution, 1.0)
            values = self._at(np.full(len(_PARTS), later), h, states)[0]
            if np.array_equal(self._past(values, side) & fired, fired):
                return later, values
        return found.end, found.after

    def _at(self, parts: FloatArray, h: float, states: Callable[[FloatArray], FloatArray]) -> FloatArray:
        """Conditions at parts of the step, (k, n_e)."""
        _, q, u, rate, _, _ = self._given
        self._times[:, 0] = q[0] + h * parts
        self._x[:] = states(parts)
        self._u[:] = u + h * parts[:, None] * rate
        return self._sampled()[0].copy()

    def _past(self, values: FloatArray, side: NDArray[np.float64] | None) -> NDArray[np.bool_]:
        """Conditions that have left their side."""
        return np.sign(values) == -np.sign(side) if side is not None else np.zeros(len(values), dtype=bool)

    def _fires(
        self, values: FloatArray, side: NDArray[np.float64], returning: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        reached = self._past(values, side) | ((values == 0.0) & (side != 0.0))
        return reached & ~returning & (self._directions * side <= 0.0)

    def _first(
        self,
        parts: FloatArray,
        values: FloatArray,
        side: NDArray[np.float64],
        returning: NDArray[np.bool_],
        within: _Bracket | None = None,
    ) -> _Bracket | None:
        """The parts between which the first event lies; sides are brought to the first of them, or to the end."""
        if not returning.any() and (values * side > 0.0).all():
            return None
        begin, before = (0.0, None) if within is None else (within.begin, within.before)
        for part, now in zip(parts.tolist(), values, strict=True):
            if self._fires(now, side, returning).any():
                return _Bracket(begin, part, before, now)
            returning &= self._past(now, side) | (now == 0.0)
            seen = (now != 0.0) & ~returning
            side[seen] = np.sign(now[seen])
            begin, before = part, now
        return None

    # -- at a point ---------------------------------------------------------------------------------------------

    def settle(self, fired: NDArray[np.bool_] | None = None) -> None:
        """Runs the events that happen at the point, and those that they or a jump of inputs set off.

        Raises
        ------
        EndlessEventsError, RunEndedError
        """
        t = float(self._given[1][0])
        fired = np.zeros(len(self._directions), dtype=bool) if fired is None else fired
        for _ in range(_ROUNDS):
            happening = sorted({*self._owner[fired].tolist(), *self._due(t)})
            for i in happening:
                self._count(t, self._flat.events[i].name)
                self._happen(i)
            if happening:
                self._renew()
            values, rates = (result.ravel().copy() for result in self._rates())
            fired = self._arm(t, values, rates, fired | (np.isin(self._owner, happening) & self._remembers))
            if not fired.any() and not self._due(t):
                return
        raise EndlessEventsError(self._endless(t))

    def completed(self) -> bool:
        """Tells the blocks that want to know of a step of integration; whether one of them wants an event now.

        Raises
        ------
        RunEndedError
        """
        for i, call in self._completed:
            answer = float(call()[0].item())
            if answer:
                self._asked.add(i)
            self._check_end(i, answer == 2.0)
        return bool(self._asked) or bool(self._jumped())

    def _due(self, t: float) -> set[int]:
        soon = t + _ROUNDING * abs(t)
        timed = {
            i
            for i, event in enumerate(self._flat.events)
            if event.memory is not None and event.memory.next_event <= soon
        }
        return timed | self._asked | self._jumped()

    def _jumped(self) -> set[int]:
        return {i for i, call in self._changed if float(call()[0].item()) == 1.0}

    def _happen(self, i: int) -> None:
        x, q, u, _, p, z = self._given
        event = self._flat.events[i]
        self._asked.discard(i)
        if event.reset is not None:
            after = np.asarray(event.reset(q[0], x, u, p, z), dtype=float).ravel()
            x[:] = after[: len(x)]
            self._check_end(i, event.memory is not None and after[-1] == 1.0)

    def _check_end(self, i: int, end: bool) -> None:
        memory = self._flat.events[i].memory
        if end and memory is not None:
            raise RunEndedError(memory.ended)

    def _arm(
        self, t: float, values: FloatArray, rates: FloatArray, fired: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Sides after events; which others have been set off."""
        if self._side is None:
            self._side = np.where(values != 0.0, np.sign(values), np.sign(rates))
            return np.zeros_like(fired)
        before, seen = self._side, np.sign(values)
        onward = -before
        jumped = ~fired & ~self._returning & (seen == onward) & (before != 0.0)
        # A fired condition is 0 but for rounding unless its reset moved it: then where it is heading counts, and its
        # sign only once it has got there. Either way through 0, turning round is to pass it again.
        self._soon = _SOON * self._h + _SOONER * abs(t)
        near = fired & ~self._remembers & (np.abs(values) <= np.abs(rates) * self._soon)
        heading = np.where((rates == 0.0) | (self._directions == 0), onward, np.sign(rates))
        again = near & (self._directions == 0) & (rates * onward < 0.0)
        back = fired & ~self._remembers & (self._directions * values >= 0.0)
        soon = np.array(
            [self._recent.get(self._flat.events[i].name, _NEVER)[2] <= self._soon for i in self._owner], bool
        )
        back &= (self._directions * rates < 0.0) | (soon & (self._directions != 0))
        self._depth = np.where(back, np.abs(values), np.where(fired, np.nan, self._depth))
        self._side = np.where(near, heading, np.where(fired, seen, np.where(jumped, onward, before)))
        self._returning = (near & ~again & (seen != heading)) | (self._returning & ~fired)
        return jumped & (self._directions * before <= 0.0)

    def _count(self, t: float, name: str) -> None:
        last, in_a_row, _ = self._recent.get(name, _NEVER)
        in_a_row = in_a_row + 1 if t - last <= _NO_TIME * max(abs(t), 1.0) else 0
        self._recent[name] = t, in_a_row, t - last
        self.log.append((t, name))
        if in_a_row > _IN_A_ROW:
            raise EndlessEventsError(self._endless(t))

    def _endless(self, t: float, last: Sequence[str] = ()) -> str:
        names = dict.fromkeys(last or [name for _, name in self.log[-_IN_A_ROW:]])
        return (
            f"the events {', '.join(names)} follow each other without time in between at t = {t:.9g} s: a sliding "
            "mode, or ever shorter bounces. Give a switch hysteresis; let a reset bring to rest what is slower than a "
            "threshold"
        )
