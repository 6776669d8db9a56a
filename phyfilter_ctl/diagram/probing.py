"""Points at which a traced function is compared with its original, and the parameters that move between them."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import control as ct
import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from ..blocks.interpreted import acting
from .branches import DefaultsError, Way

__all__ = [
    "MismatchError",
    "Point",
    "Recorder",
    "Reference",
    "compare",
    "different_defaults",
    "filled",
    "has_integers",
    "is_tunable",
    "numbers",
    "probe_points",
    "uncovered",
]

PROBES = 14
RELATIVE = 1e-8  # of an entry: the traced function may sum in another order
ABSOLUTE = 1e-12  # of the largest number around: what cancellation leaves
# Points among which one is looked for on each side of every branch, and steps towards the other side.
_POOL, _STEPS = 600, 12


class MismatchError(Exception):
    """The traced function and its original differ."""


@dataclass(frozen=True)
class Point:
    """Where a traced function is compared with its original."""

    t: float
    x: FloatArray
    u: FloatArray
    values: Mapping[str, object]


def probe_points(
    system: ct.NonlinearIOSystem, values: Mapping[str, object], constant: set[str]
) -> list[Point]:
    """Small and large, positive and of both signs, some with other parameter values; at last all zeros."""
    rng = np.random.default_rng(20240)
    n, m = system.nstates or 0, system.ninputs or 0
    points = []
    for i in range(PROBES):
        scale = (1.0, 0.05, 1.0, 30.0, 3.0)[i % 5]
        draw = (lambda k: rng.uniform(0.1, 1.0, k)) if i % 3 == 1 else (lambda k: rng.normal(size=k))
        changed = (
            values
            if i < PROBES - 5
            else {k: v if k in constant else _moved(v, rng) for k, v in values.items()}
        )
        points.append(Point(float(rng.uniform(0.0, 3.0)), scale * draw(n), scale * draw(m), changed))
    return [*points, Point(0.0, np.zeros(n), np.zeros(m), values)]


def _moved(value: object, rng: np.random.Generator) -> object:
    """Another value of a parameter; integers stay integers."""
    if not is_tunable(value):
        return value
    if isinstance(value, list | tuple):
        return type(value)(_moved(entry, rng) for entry in value)
    if has_integers(value):
        return value + 1 if isinstance(value, np.ndarray) else int(numbers(value)) + 1
    array = numbers(value)
    moved = array * rng.uniform(0.8, 1.2, array.shape) + 0.01 * rng.uniform(0.0, 1.0, array.shape)
    return float(moved) if moved.ndim == 0 else moved


def has_integers(value: object) -> bool:
    """Whether a value is, or holds, an integer."""
    if isinstance(value, list | tuple):
        return any(has_integers(entry) for entry in value)
    if isinstance(value, np.ndarray):
        return value.dtype.kind in "iu"
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def is_tunable(value: object) -> bool:
    """Whether a value is made of numbers that may become a parameter."""
    if isinstance(value, bool | np.bool_):
        return False
    if isinstance(value, list | tuple):
        return len(value) > 0 and all(np.ndim(e) == 0 and is_tunable(e) for e in value)
    if isinstance(value, np.ndarray):
        return value.dtype.kind in "iuf" and value.size > 0
    return isinstance(value, int | float | np.integer | np.floating)


def numbers(value: object) -> FloatArray:
    """A value as an array of floats."""
    return np.asarray(value, dtype=float)


def filled(values: Mapping[str, object], tunable: Sequence[str], p: FloatArray) -> dict[str, object]:
    """Values with those of the tunable parameters from one vector; integers stay integers where they are whole."""
    result, start = dict(values), 0
    for name in tunable:
        value = values[name]
        shape = numbers(value).shape
        part = p[start : start + int(np.prod(shape))]
        start += len(part)
        if has_integers(value) and np.array_equal(part, np.round(part)):
            part = part.astype(int)
        array = part.reshape(shape)
        result[name] = (
            type(value)(part.tolist())
            if isinstance(value, list | tuple)
            else array
            if shape
            else array.item()
        )
    return result


class Recorder(dict[str, object]):
    """A ``params`` dictionary that notes the defaults of what it does not have: ``params.get("m", 4.0)``.

    Parameters
    ----------
    values : mapping
    missing : mapping
        Values of names that a function may ask for without a default.
    defaults : mapping
        Those noted before, of this function and of others of its block.

    Raises
    ------
    DefaultsError
        When a function gives one name another default than before.
    """

    def __init__(
        self, values: Mapping[str, object], missing: Mapping[str, object], defaults: Mapping[str, object]
    ) -> None:
        super().__init__(values)
        self._missing, self._defaults = missing, defaults
        self.noted: dict[str, object] = {}

    def get(self, key: str, default: object = None, /) -> object:
        """As of a dict; a default of numbers is noted as a parameter."""
        if key in self._missing or not is_tunable(default):
            return super().get(key, self.noted.get(key)) if key in self else default
        before = self._defaults.get(key, self.noted.get(key, default))
        if not np.array_equal(np.asarray(before), np.asarray(default)):
            raise DefaultsError(different_defaults(key, before, default))
        if key in self:
            return super().get(key)
        self.noted[key] = default
        return default

    def __missing__(self, key: str) -> object:
        if key not in self:
            raise KeyError(key)
        return self.noted[key]

    def __contains__(self, key: object) -> bool:
        if super().__contains__(key):
            return True
        if key in self._missing:
            self.noted[str(key)] = self._missing[str(key)]
        return key in self._missing

    # A function that takes all of them may read any.

    def __iter__(self) -> Iterator[str]:
        self.noted |= {key: value for key, value in self._missing.items() if not dict.__contains__(self, key)}
        return iter([*super().__iter__(), *self.noted])

    def keys(self) -> Any:
        """Of all, those that were not given included."""
        return dict.fromkeys(self).keys()

    def items(self) -> Any:
        """Of all, those that were not given included."""
        return {key: self[key] for key in self}.items()

    def copy(self) -> dict[str, object]:
        """A plain dict of all."""
        return {key: self[key] for key in self}


def different_defaults(name: str, one: object, other: object) -> str:
    """What to say of a parameter that is read with two defaults."""
    return (
        f"params.get({name!r}, ...) has the default {one} in one place and {other} in another: one name is one "
        "parameter; give it one default, or a value by params= where the block is made"
    )


class Reference:
    """One function of the original: the update, or the output.

    Parameters
    ----------
    function : callable
        (t, x, u, params) -> entries.
    size : int
        How many entries.
    what : str
        Block and function, for messages.
    missing, defaults : mapping
        Values of parameters that have none, and those that functions of the block have in their text.
    """

    def __init__(
        self,
        function: Callable[..., object],
        size: int,
        what: str,
        missing: Mapping[str, object],
        defaults: Mapping[str, object],
    ) -> None:
        self._function, self._size, self._missing, self._defaults = function, size, missing, defaults
        self.what: str = what
        self.failure: Exception | None = None
        self.seconds: float = 0.0

    def params(self, values: Mapping[str, object]) -> Recorder:
        """What the function gets."""
        return Recorder(values, self._missing, self._defaults)

    def call(self, t: float, x: FloatArray, u: FloatArray, values: Mapping[str, object]) -> FloatArray:
        """The entries; raises what the function raises."""
        # A copy: the function may hand out one buffer again and again.
        result = np.array(self._function(t, x, u, self.params(values)), dtype=float).reshape(-1)
        if len(result) != self._size:
            raise ValueError(f"{self.what} function gives {len(result)} entries, expected {self._size}")
        return result

    def evaluate(self, point: Point) -> FloatArray:
        """The entries; all infinite where the function refuses the point, since not-a-number is an answer."""
        return self.evaluate_all([point])[0]

    def evaluate_all(self, points: Iterable[Point]) -> list[FloatArray]:
        """The entries at some points, one after the other."""
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            return [self._entries(point) for point in points]

    def _entries(self, point: Point) -> FloatArray:
        begin = time.perf_counter()
        try:
            return self.call(point.t, point.x.copy(), point.u.copy(), point.values)
        except DefaultsError:
            raise
        except Exception as error:
            self.failure = self.failure or error
            return np.full(self._size, np.inf)
        finally:
            self.seconds = max(self.seconds, time.perf_counter() - begin)

    def depends(self, points: Sequence[Point]) -> NDArray[np.bool_]:
        """Which input changes which entry at some point, (entries, inputs)."""
        found = [acting(lambda u, at=at: self.evaluate(replace(at, u=u)), [at.u]) for at in points]
        return np.logical_or.reduce(found)


def compare(
    traced: ca.Function, points: Sequence[Point], originals: Sequence[FloatArray], tunable: Sequence[str]
) -> None:
    """Raises MismatchError where the traced function differs from its original at a point."""
    count = len(points)
    x, u = np.array([point.x for point in points]), np.array([point.u for point in points])
    parts = [[numbers(point.values[name]).reshape(-1) for name in tunable] for point in points]
    p = np.array([np.concatenate(part) if part else np.zeros(0) for part in parts])
    times = np.array([[point.t for point in points]])
    values = np.asarray(traced.map(count)(times, x.T, u.T, p.T), dtype=float).reshape(-1, count).T
    expected = np.array(originals)
    known = np.isfinite(expected)
    largest = np.ones(count)
    for part in (expected, x, u):
        largest = np.maximum(largest, np.abs(np.where(np.isfinite(part), part, 0.0)).max(axis=1, initial=0.0))
    allowed = RELATIVE * np.abs(np.where(known, expected, 0.0)) + ABSOLUTE * largest[:, None]
    with np.errstate(invalid="ignore"):
        far = ~(np.abs(values - expected) <= allowed)
    wrong = ((known & far) | (np.isnan(expected) & np.isfinite(values))).any(axis=1)
    if wrong.any():
        k = int(np.argmax(wrong))
        raise MismatchError(
            f"traced with symbols it gives {values[k].tolist()}, the original {expected[k].tolist()} at "
            f"x={points[k].x}, u={points[k].u}"
        )
    checked = known.any(axis=0)
    if not np.all(checked):
        raise MismatchError(f"entries {np.flatnonzero(~checked).tolist()} are not finite at any probed point")


def uncovered(
    found: Sequence[Way],
    arguments: Sequence[ca.SX],
    points: Sequence[Point],
    values: Mapping[str, object],
    tunable: Sequence[str],
) -> tuple[list[Point], list[str]]:
    """More points, so that each side of each condition has one; and the conditions of which a side was not reached."""
    found = [way for way in found if not way.off_table]  # where the original raises too, by what a list is
    sides = list(dict.fromkeys((d.key, d.taken) for way in found for d in way.decisions))
    if not sides:
        return [], []
    known = {d.key: d for way in found for d in way.decisions}
    index = {key: i for i, key in enumerate(known)}
    conditions = ca.Function(
        "conditions",
        list(arguments),
        [ca.vertcat(*(d.condition for d in known.values())), ca.vertcat(*(d.margin for d in known.values()))],
    )
    rest = ca.vertcat(*arguments)
    slopes = ca.Function(
        "slopes", list(arguments), [ca.jacobian(ca.vertcat(*(d.margin for d in known.values())), rest)]
    )
    n, m = len(points[0].x), len(points[0].u)
    cuts = np.cumsum([1, n, m])
    pool = _pool(points, tunable, 1 + n + m)
    # Each signal in turn not a number, and infinite, for what asks for that.
    odd = np.tile(pool[0], (3 * cuts[-1], 1))
    for part, value in zip(np.split(odd[:, : cuts[-1]], 3), (np.nan, np.inf, -np.inf), strict=True):
        np.fill_diagonal(part, value)

    def split(rows: FloatArray) -> list[FloatArray]:
        return np.split(rows, cuts, axis=-1)

    def truths(rows: FloatArray) -> NDArray[np.bool_]:
        return np.atleast_2d(np.asarray(conditions(*(part.T for part in split(rows)))[0], dtype=float).T != 0)

    def matches(way: Way, truth: NDArray[np.bool_]) -> NDArray[np.bool_]:
        return np.logical_and.reduce(
            [truth[:, index[d.key]] == d.taken for d in way.decisions], initial=True
        ) & np.ones(len(truth), dtype=bool)

    truth, odd_truth = truths(pool), truths(odd)
    more, reached = list[FloatArray](), set[tuple[str, bool]]()
    for way in found:
        where = np.flatnonzero(matches(way, truth))
        row = pool[where[0]] if len(where) else _towards(way, pool, truth, index, conditions, slopes, split)
        if row is None or not matches(way, truths(row[None]))[0]:
            where = np.flatnonzero(matches(way, odd_truth))
            if not len(where):
                continue
            row = odd[where[0]]
        more.append(row)
        reached |= {(d.key, d.taken) for d in way.decisions}
    extra = []
    for row in more:
        t, x, u, p = split(row)
        extra.append(Point(float(t[0]), x, u, filled(values, tunable, p)))
    return extra, [
        str(known[key].condition)
        for key, taken in sides
        if (key, taken) not in reached and not known[key].picks
    ]


def _pool(points: Sequence[Point], tunable: Sequence[str], signals: int) -> FloatArray:
    """Rows (t, x, u, p): the points, and many more of all sizes, some whole numbers."""
    rng = np.random.default_rng(31)
    parameters = [
        np.concatenate([np.zeros(0), *(numbers(point.values[name]).reshape(-1) for name in tunable)])
        for point in points
    ]
    own = [
        np.concatenate([[point.t], point.x, point.u, p]) for point, p in zip(points, parameters, strict=True)
    ]
    scale = 10.0 ** rng.uniform(-2.0, 4.0, (_POOL, 1))
    rows = scale * rng.normal(size=(_POOL, signals))
    rows[::3] = rng.integers(-3, 12, rows[::3].shape)
    rows[:, 0] = np.abs(rows[:, 0])
    p = np.array([parameters[0] * (1.0 if i % 4 else rng.uniform(-2.0, 2.0)) for i in range(_POOL)])
    return np.vstack([own, np.hstack([rows, p.reshape(_POOL, -1)])])


def _towards(
    way: Way,
    pool: FloatArray,
    truth: NDArray[np.bool_],
    index: Mapping[str, int],
    conditions: ca.Function,
    slopes: ca.Function,
    split: Callable[[FloatArray], list[FloatArray]],
) -> FloatArray | None:
    """A point on this way, by Newton's steps across the first margin that stands against it."""
    taken = np.array([truth[:, index[d.key]] == d.taken for d in way.decisions])
    row = pool[int(np.argmax(np.logical_and.accumulate(taken).sum(axis=0)))].copy()
    for step in range(_STEPS):
        truths, margins = (np.asarray(part, dtype=float).reshape(-1) for part in conditions(*split(row)))
        against = [index[d.key] for d in way.decisions if (truths[index[d.key]] != 0) != d.taken]
        if not against:
            return row
        slope = np.asarray(slopes(*split(row)), dtype=float)[against[0]]
        margin, length = margins[against[0]], slope @ slope
        if not (np.isfinite(margin) and np.isfinite(length) and length > 0.0):
            return None
        # Onto the border, and by ever more beyond it; a first step that ends on it meets an equality.
        row -= (
            slope * (margin + (np.sign(margin) or 1.0) * (0.0 if step == 0 else 1e-8 * 10.0**step)) / length
        )
    return None
