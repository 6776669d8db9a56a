"""Switches of a flat model as events: smooth between them, and at rest where a solution slides along one.

The position of every switch that makes the derivatives jump becomes a held signal, its range, which changes at events
only. Where the solutions on both sides of a border lead to it, it stays there, as A. F. Filippov has it (Differential
Equations with Discontinuous Righthand Sides, 1988): x' = f_below + s (f_above - f_below) with the share s in [0, 1]
that keeps the level of the switch at its border, until s leaves [0, 1]. So does a mass that dry friction holds.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple, cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..blocks.functions import Variable
from .equations import FlatEvent
from .model import FlatModel
from .structure import Structure, Switch, has_switches, structure_of

__all__ = ["located"]

# More switches than these are left to the control of the error, and more of them than those never slide.
_MOST, _MOST_SLIDING = 24, 6
# Random points at which a switch is tried, and steps of Newton's method to its border.
_POINTS, _NEWTON = 64, 12
# What counts as a jump, relative to the size of the derivatives.
_JUMP = 1e-9
# How far beside its border, in the units of its level, a switch is looked at.
_BESIDE = (1e-6, 2e-6)
# A level is at its border where it passes it within that part of the time and that many seconds; one that slides may be
# off by what it passes in the second pair. Rounding of its terms comes on top.
_NEAR, _OFF = (1e-11, 1e-14), (1e-9, 1e-12)
_ROUNDING = 1e-14
# A share leaves [0, 1] where it is beyond it by this.
_BEYOND = 1e-9
# Times that all switches are looked at when some are decided: one that slides acts on the others.
_PASSES = 3
_NEVER = 1e300  # s: no time yet
_INSIDE = 1e-30  # of a condition on the border: not 0, in float too
# In place of 1 for a sign that slides: one that is 0 since nothing moves its level.
_RESTS = 2
_SIGNALS = (0, 1, 2, 4)  # t, x, u and z
_MOVING = 0b111  # t, x and u change between instants


class _Frozen(NamedTuple):
    """The model with the positions of its switches given."""

    flat: FlatModel
    switches: tuple[Switch, ...]
    arguments: list[ca.SX]
    positions: ca.SX  # of the switches that are located
    results: list[ca.SX]  # in the order of `_functions`
    levels: ca.SX


@lru_cache(maxsize=64)
def located(flat: FlatModel) -> FlatModel:
    """A model without jumps between its events.

    Parameters
    ----------
    flat : FlatModel

    Returns
    -------
    FlatModel
        The same one where its derivatives do not jump, or cannot be looked into: with nonlinear algebraic loops,
        functions that run as Python, or imported FMUs. Else one whose events are followed by those of the switches,
        and whose held signals by their ranges, which are undecided at first; its ``unknowns`` decide them.

    Examples
    --------
    >>> import control as ct
    >>> from phyfilter_ctl.diagram import flatten
    >>> mass = ct.nlsys(lambda t, x, u, p: [u[0] - np.sign(x[0])], None, inputs=1, outputs=1, states=["v"], name="mass")
    >>> [event.name for event in located(flatten(mass)).events]
    ['v.switch']
    """
    if (
        any(event.switch for event in flat.events)
        or flat.dt > 0.0
        or flat.loops
        or flat.memories
        or not flat.states
    ):
        return flat
    try:
        dynamics = flat.dynamics if flat.dynamics.is_a("SXFunction") else flat.dynamics.expand()
        if not has_switches(dynamics):
            return flat
        arguments = [ca.SX.sym(name, flat.dynamics.size1_in(i)) for i, name in enumerate("txupz")]
        whole = ca.Function("whole", arguments, [ca.densify(f(*arguments)) for f in _functions(flat)])
        structure = structure_of(whole, _SIGNALS)
    except (RuntimeError, NotImplementedError):
        return flat
    chosen = [switch for switch in _jumping(flat, structure) if switch.on & _MOVING]
    if not 0 < len(chosen) <= _MOST:
        return flat
    return _Located(_frozen(flat, structure, chosen)).model()


def _functions(flat: FlatModel) -> list[ca.Function]:
    """All that is evaluated between instants: dynamics first, then outputs and what tasks see, then events."""
    events = [f for e in flat.events for f in (e.reset, e.completed, e.changed) if f is not None]
    conditions = [] if flat.conditions is None else [flat.conditions]
    return [flat.dynamics, flat.output, *(task.signals for task in flat.tasks), *conditions, *events]


def _chained(
    structure: Structure, given: Sequence[Switch] = (), positions: ca.SX | None = None
) -> list[ca.SX]:
    """Positions of all switches, of those given as symbols, of the others by their values."""
    found: list[ca.SX] = []
    for i, switch in enumerate(structure.switches):
        if switch in given:
            assert positions is not None
            found.append(positions[given.index(switch)])
            continue
        before = [other.position for other in structure.switches[:i]]
        found.append(ca.substitute([switch.now], before, found)[0] if before else switch.now)
    return found


def _frozen(flat: FlatModel, structure: Structure, chosen: Sequence[Switch]) -> _Frozen:
    positions = ca.SX.sym("m", len(chosen))
    values = _chained(structure, chosen, positions)
    symbols = [switch.position for switch in structure.switches]
    *results, levels = ca.substitute(
        [*structure.results, ca.vertcat(*(switch.level for switch in chosen))], symbols, values
    )
    return _Frozen(flat, tuple(chosen), structure.arguments, positions, results, ca.densify(levels))


# -- which of them jump -----------------------------------------------------------------------------------------


def _jumping(flat: FlatModel, structure: Structure) -> list[Switch]:
    """Switches at whose border the derivatives differ by the side, found at random points of it."""
    dynamics = ca.vertcat(structure.results[0])
    symbols = [switch.position for switch in structure.switches]
    reached = _reached(structure, dynamics)
    values = _chained(structure)
    found = []
    for i in reached:
        switch = structure.switches[i]
        level = ca.substitute([switch.level], symbols[:i], values[:i])[0] if i else switch.level
        if _jumps(flat, structure, i, level, dynamics):
            found.append(switch)
    return found


def _reached(structure: Structure, dynamics: ca.SX) -> list[int]:
    """Switches that the derivatives depend on, also through the levels of others."""
    wanted: set[int] = set()
    looked: list[ca.SX] = [dynamics]
    while looked:
        expression = looked.pop()
        for i, switch in enumerate(structure.switches):
            if i not in wanted and ca.depends_on(expression, switch.position):
                wanted.add(i)
                looked += [switch.level, switch.now]
    return sorted(wanted)


def _jumps(flat: FlatModel, structure: Structure, i: int, level: ca.SX, dynamics: ca.SX) -> bool:
    switch, arguments = structure.switches[i], structure.arguments
    symbols = [other.position for other in structure.switches]
    t, x, u = arguments[:3]
    moving = ca.vertcat(t, x, u)
    gradient = ca.jacobian(level, moving).T
    border = ca.floor(level + 0.5) if switch.borders == "whole" else ca.SX(0)
    along = gradient / ca.sumsqr(gradient)
    towards = ca.Function("towards", arguments, [along, border - level]).map(_POINTS)
    # On both sides of the border, with the switches behind it as they follow.
    sides = []
    for n in (border - 1, border):
        values = _chained(structure, [switch], ca.vertcat(switch.value(n)))
        sides.append(ca.substitute([dynamics], symbols, values)[0])
    difference = ca.Function("difference", arguments, [sides[1] - sides[0], sides[0]]).map(_POINTS)
    place = _points(flat)

    def moved(by: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        change = np.where(np.isfinite(by), by, 0.0)
        return [*np.split(np.vstack(place[:3]) + change, [1, 1 + x.numel()]), *place[3:]]

    for _ in range(_NEWTON):
        direction, left = (np.asarray(part, dtype=float) for part in towards(*place))
        place = moved(direction * left)
    direction, left = (np.asarray(part, dtype=float) for part in towards(*place))
    # Beside the border, where no equality holds by chance: a jump stays the same twice as far off, a bend doubles.
    near, far = (
        [np.asarray(part, dtype=float) for part in difference(*moved(part * direction))] for part in _BESIDE
    )
    size = 1.0 + np.abs(near[1]).max(axis=0) + np.abs(np.vstack(place[:3])).max(axis=0)
    jump = np.abs(near[0])
    # The level gets to both sides of the border there: one that is 0 at its least is no switch.
    passes = np.ones(_POINTS, dtype=bool)
    for sign in (-1.0, 1.0):
        beyond = -np.asarray(towards(*moved(sign * _BESIDE[0] * direction))[1], dtype=float).ravel()
        passes &= np.abs(sign * beyond / _BESIDE[0] - 1.0) <= 0.5
    there = passes & (jump > _JUMP * size) & (np.abs(far[0] - near[0]) <= 0.25 * jump)
    return bool((there & (np.abs(left) <= _JUMP * size)).any())


def _points(flat: FlatModel) -> list[NDArray[np.float64]]:
    """t, x, u, p and z at random, in columns; parameters around their own values."""
    rng = np.random.default_rng(1)
    scale = 10.0 ** rng.uniform(-1.0, 2.0, _POINTS)
    sizes = [flat.dynamics.size1_in(i) for i in range(5)]
    place = [scale * rng.normal(size=(size, _POINTS)) for size in sizes]
    starts = [np.zeros(1), flat.start_state(), flat.start_inputs(), flat.start_parameters()]
    for i in (1, 2):
        place[i] += starts[i][:, None]
    own = starts[3][:, None]
    place[3] = np.where(
        own != 0.0, own * rng.uniform(0.5, 1.5, place[3].shape), rng.uniform(0.0, 1.0, place[3].shape)
    )
    place[4] += np.array([variable.start for variable in flat.held])[:, None]
    return place


# -- the model with their ranges held ---------------------------------------------------------------------------


class _Point(NamedTuple):
    """The model at a point: what is blended where switches slide, and the switches' own."""

    blended: list[ca.SX]
    rates: ca.SX  # of the levels
    sizes: ca.SX  # of the terms of the levels
    levels: ca.SX
    shares: ca.SX
    pulls: ca.SX  # by how much the rates differ from side to side


class _Located:
    """Builds the model: behind what is held come the ranges, then 1 for each switch that slides, -1 while undecided."""

    def __init__(self, frozen: _Frozen) -> None:
        self._frozen, self._flat = frozen, frozen.flat
        self._switches, self._count = frozen.switches, len(frozen.switches)
        self._n_held = len(frozen.flat.held)
        t, x, u, _, _ = frozen.arguments
        m = frozen.positions
        # A level that follows an input needs the rate of that, which runs straight: from where it was last.
        self._n_u = u.numel() if ca.depends_on(frozen.levels, u) else 0
        slope = ca.SX.sym("slope", self._n_u)
        symbols = [*frozen.arguments, slope, m]
        dynamics = ca.densify(frozen.results[0])
        by = ca.vertcat(t, x, u)
        jacobian = ca.jacobian(frozen.levels, by)
        along = ca.vertcat(1, dynamics, slope if self._n_u else ca.SX.zeros(u.numel()))
        rates = ca.mtimes(jacobian, along)
        sizes = ca.mtimes(ca.fabs(jacobian), ca.fabs(by)) + ca.fabs(frozen.levels)
        tasks = len(self._flat.tasks)
        self._blended = [dynamics, *(ca.densify(r) for r in frozen.results[1 : 2 + tasks]), ca.densify(rates)]
        self._core = ca.Function("core", symbols, [*self._blended, ca.densify(sizes), frozen.levels])
        acts = [bool(ca.depends_on(rates[j], m[j])) for j in range(self._count)]
        self._sliding = [j for j in range(self._count) if acts[j]][:_MOST_SLIDING]
        self._slide = self._field()

    def _field(self) -> ca.Function:
        """(t, x, u, p, z, slope, ranges, slides) -> blended results, sizes, levels, shares, pulls."""
        arguments = self._new()
        n, s = ca.SX.sym("n", self._count), ca.SX.sym("s", self._count)
        # One that is undecided is where its level says.
        levels = self._core(*arguments, self._positions(n))[-1]
        ranges = ca.vertcat(
            *(ca.if_else(s[j] < 0, self._range(j, levels[j]), n[j]) for j in range(self._count))
        )
        below = ca.vertcat(
            *(
                ca.if_else(s[j] == _RESTS, 0, position)
                if self._switches[j].at_border == "between"
                else position
                for j, position in enumerate(ca.vertsplit(self._positions(ranges)))
            )
        )
        base = self._core(*arguments, below)
        results, (sizes, levels) = list(base[:-2]), base[-2:]
        changes = []
        for j in self._sliding:
            above = ca.SX(below)
            above[j] = self._switches[j].value(ranges[j] + 1)
            values = self._core(*arguments, above)
            changes.append([a - b for a, b in zip(values[: len(results)], results, strict=True)])
        slides = [s[j] == 1 for j in self._sliding]
        shares = self._shares(results[-1], [change[-1] for change in changes], slides)
        for k, change in enumerate(changes):
            for i, part in enumerate(change):
                # Not the product alone: the side that is not taken may be infinite.
                results[i] += shares[k] * ca.if_else(slides[k], part, 0)
        every, pulls = ca.SX.zeros(self._count), ca.SX.zeros(self._count)
        for k, j in enumerate(self._sliding):
            every[j], pulls[j] = shares[k], ca.fabs(changes[k][-1][j])
        outcome = [*results, sizes, levels, every, pulls]
        return ca.Function("slide", [*arguments, n, s], ca.cse([ca.densify(part) for part in outcome]))

    def _positions(self, ranges: ca.SX) -> ca.SX:
        return ca.vertcat(*(switch.value(ranges[j]) for j, switch in enumerate(self._switches)))

    def _range(self, j: int, level: ca.SX) -> ca.SX:
        return ca.floor(level) if self._switches[j].borders == "whole" else ca.if_else(level < 0, -1, 0)

    def _shares(self, rates: ca.SX, changes: Sequence[ca.SX], slides: Sequence[ca.SX]) -> ca.SX:
        """Those that keep the levels that slide at their borders: rates + sum of share times change = 0."""
        count = len(self._sliding)
        matrix, right = ca.SX.eye(count), ca.SX.zeros(count)
        matrix = ca.densify(matrix)
        for a, j in enumerate(self._sliding):
            for b in range(count):
                both = ca.logic_and(slides[a], slides[b])
                matrix[a, b] = ca.if_else(both, changes[b][j], 1 if a == b else 0)
            right[a] = ca.if_else(slides[a], -rates[j], 0)
        if count == 0:
            return ca.SX(0, 1)
        return right / matrix[0, 0] if count == 1 else ca.solve(matrix, right)

    def _new(self) -> list[ca.SX]:
        """t, x, u, p, z and the slope of u."""
        sizes = [self._flat.dynamics.size1_in(i) for i in range(5)]
        return [ca.SX.sym(name, size) for name, size in zip("txupzs", [*sizes, self._n_u], strict=True)]

    @property
    def _more(self) -> int:
        """What is held more than in the model."""
        return 2 * self._count + (2 * self._n_u + 1 if self._n_u else 0)

    def _split(self, z: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX]:
        """What is held, the slope of u, ranges, slides; and the time and u that were last."""
        sizes = [self._n_held, self._n_u, self._count, self._count, self._more - 2 * self._count - self._n_u]
        held, slope, ranges, slides, last = ca.vertsplit(z, np.cumsum([0, *sizes]).tolist())
        return held, slope, ranges, slides, last

    def _consistent(self, t: ca.SX, at: _Point, n: ca.SX, s: ca.SX) -> ca.SX:
        """Above 0 where a switch is in its range, or slides with a share between 0 and 1."""
        found = []
        for j, switch in enumerate(self._switches):
            level = at.levels[j]
            whole = switch.borders == "whole"
            inside = (level - n[j]) * (n[j] + 1 - level) if whole else (2 * n[j] + 1) * level
            if j in self._sliding:
                share = (at.shares[j] + _BEYOND) * (1 + _BEYOND - at.shares[j])
                near = 1 - ca.fabs(level - (n[j] + 1)) / _allowed(t, _OFF, at.pulls[j], at.sizes[j])
                inside = ca.if_else(s[j] == 1, ca.fmin(share, near), inside)
            if switch.at_border == "between":
                rest = 1 - ca.fabs(level - (n[j] + 1)) / _allowed(t, _OFF, 0, at.sizes[j])
                inside = ca.if_else(s[j] == _RESTS, rest, inside)
            found.append(ca.if_else(s[j] < 0, -1, inside))
        return ca.vertcat(*found)

    def _point(self, *arguments: ca.SX) -> _Point:
        *blended, rates, sizes, levels, shares, pulls = self._slide(*arguments)
        return _Point(blended, rates, sizes, levels, shares, pulls)

    def _decided(self, j: int, *everything: ca.SX) -> list[ca.SX]:
        """Range and slide of one switch, where what it has is not consistent."""
        switch = self._switches[j]
        *point, n, s = everything
        t = point[0]
        at = self._point(*everything)
        level, whole = at.levels[j], switch.borders == "whole"
        border = ca.floor(level + 0.5) if whole else ca.SX(0)
        rates = []
        for side in (border - 1, border):
            ranges, sliding = ca.SX(n), ca.SX(s)
            ranges[j], sliding[j] = side, 0
            rates.append(self._point(*point, ranges, sliding).rates[j])
        below, above = rates
        speed = ca.fmax(ca.fabs(below), ca.fabs(above))
        near = ca.fabs(level - border) <= _allowed(t, _NEAR, speed, at.sizes[j])
        up, down = above > 0, below < 0
        slides = j in self._sliding
        held = ca.logic_and(ca.logic_and(below >= 0, above <= 0), ca.logic_or(below > 0, above < 0))
        # Where both sides lead away, on to the other one; where both lead to the border, there. Where neither moves it,
        # or a side has no value, it is what the instruction says.
        across = ca.if_else(ca.logic_and(s[j] == 0, n[j] >= border), border - 1, border)
        still = border if switch.at_border == "above" else border - 1
        range_there = ca.if_else(held, border - 1 if slides else across, still)
        range_there = ca.if_else(down, border - 1, range_there)
        range_there = ca.if_else(up, ca.if_else(down, across, border), range_there)
        slides_there = ca.logic_and(held, slides)
        if switch.at_border == "between":
            rests = ca.logic_not(ca.logic_or(ca.logic_or(up, down), held))
            slides_there = ca.if_else(rests, _RESTS, slides_there)
        far = self._range(j, level)
        wrong = ca.logic_not(self._consistent(t, at, n, s)[j] > 0)
        ranges, sliding = ca.SX(n), ca.SX(s)
        ranges[j] = ca.if_else(wrong, ca.if_else(near, range_there, far), n[j])
        sliding[j] = ca.if_else(wrong, ca.if_else(near, slides_there, 0), s[j])
        return [ranges, sliding]

    def _unknowns(self) -> ca.Function:
        """(t, x, u, p, z) -> ranges and slides; those that are consistent stay."""
        MX = cast(type[ca.SX], ca.MX)
        arguments = self._new()
        n, s = ca.SX.sym("n", self._count), ca.SX.sym("s", self._count)
        everything = [*arguments, n, s]
        steps = [
            ca.Function(f"decided{j}", everything, ca.cse(self._decided(j, *everything)))
            for j in range(self._count)
        ]
        asked = ca.Function(
            "asked",
            everything,
            [ca.mmin(self._consistent(arguments[0], self._point(*everything), n, s)) <= 0],
        )
        symbols = [MX.sym(f"i{i}", part.numel()) for i, part in enumerate(everything)]
        ranges, slides = symbols[-2:]
        for _ in range(_PASSES if self._count > 1 else 1):
            for step in steps:
                ranges, slides = step(*symbols[:-2], ranges, slides)
        decide = ca.Function("decide", symbols, [ca.vertcat(ranges, slides)])
        symbols = [MX.sym(f"i{i}", part.numel()) for i, part in enumerate(everything)]
        keep = ca.Function("keep", symbols, [ca.vertcat(*symbols[-2:])])
        choice = ca.Function.if_else("choice", decide, keep)
        outer = [MX.sym(name, f.numel()) for name, f in zip("txup", arguments, strict=False)]
        t, _, u, _ = outer
        z = MX.sym("z", self._n_held + self._more)
        held, slope, ranges, slides, last = self._split(z)
        now = []
        if self._n_u:
            later = t > last[0]
            slope = ca.if_else(later, (u - last[1:]) / ca.if_else(later, t - last[0], 1), slope)
            now = [t, u]
        inner = [*outer, held, slope, ranges, slides]
        found = ca.vertcat(slope, choice(asked(*inner), *inner), *now)
        return ca.Function("unknowns", [*outer, z], [found], list("txupz"), ["value"])

    def model(self) -> FlatModel:
        """The model with an event for each switch."""
        flat, tasks = self._flat, len(self._flat.tasks)
        t, x, u, p, *_ = self._new()
        z = ca.SX.sym("z", self._n_held + self._more)
        held, slope, n, s, _ = self._split(z)
        inner = [t, x, u, p, held, slope, n, s]
        at = self._point(*inner)
        plain = ca.Function(
            "plain",
            [*self._frozen.arguments, self._frozen.positions],
            self._frozen.results[2 + tasks :] or [ca.SX(0, 1)],
        ).call([t, x, u, p, held, self._positions(n)])

        def function(name: str, value: ca.SX) -> ca.Function:
            return ca.Function(name, [t, x, u, p, z], [ca.densify(value)], list("txupz"), ["value"])

        rest = iter(plain)
        conditions = [] if flat.conditions is None else [next(rest)]
        # On a border that nothing moves it from a switch stays: to be past it, it has to be beyond.
        consistent = self._consistent(t, at, n, s)
        conditions.append(consistent + _INSIDE * (consistent == 0))
        events = [
            dataclasses.replace(
                event,
                **{
                    name: function(name, next(rest))
                    for name in ("reset", "completed", "changed")
                    if getattr(event, name) is not None
                },
            )
            for event in flat.events
        ]
        names = _names(flat, self._frozen)
        switches = [FlatEvent(name, -1, None, switch=True) for name in names]
        kept = [Variable(f"{name}.{what}", -1.0) for what in ("range", "slides") for name in names]
        if self._n_u:
            slopes = [Variable(f"{variable.name}.slope") for variable in flat.inputs]
            last = [Variable(f"{variable.name}.last", variable.start) for variable in flat.inputs]
            kept = [*slopes, *kept, Variable("time.last", _NEVER), *last]
        return dataclasses.replace(
            flat,
            held=(*flat.held, *kept),
            dynamics=function("dynamics", at.blended[0]),
            output=function("output", at.blended[1]),
            tasks=tuple(
                dataclasses.replace(task, signals=function("signals", value))
                for task, value in zip(flat.tasks, at.blended[2:], strict=True)
            ),
            unknowns=self._unknowns(),
            events=(*events, *switches),
            conditions=function("conditions", ca.vertcat(*conditions)),
        )


def _allowed(t: ca.SX, within: tuple[float, float], rate: ca.SX | float, size: ca.SX) -> ca.SX:
    """How far from its border a level may be."""
    part, seconds = within
    return (part * ca.fabs(t) + seconds) * rate + _ROUNDING * size + 1e-300


def _names(flat: FlatModel, frozen: _Frozen) -> list[str]:
    """By what the levels depend on first: states, else inputs, else time."""
    names: list[str] = []
    for level in ca.vertsplit(frozen.levels):
        _, x, u, *_ = frozen.arguments
        found = [
            variable.name
            for symbol, variables in ((x, flat.states), (u, flat.inputs))
            for i, variable in enumerate(variables)
            if ca.depends_on(level, symbol[i])
        ]
        name = f"{found[0] if found else 'time'}.switch"
        same = sum(other.startswith(name) for other in names)
        names.append(f"{name}{same + 1}" if same else name)
    return names
