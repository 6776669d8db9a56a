"""The best filter that keeps the limits of a loop: sequential quadratic programs whose iterates are all admissible.

At an admissible filter the cost's Gauss-Newton model and every dip, gain and phase crossing of the loop, linear in
F(j omega), make a quadratic program; its step is corrected for the curvature of the limits and shortened until the
limits hold and the cost falls. So whatever the search does, it ends at a filter that is admissible, and no worse than
the start: the filter learned without the loop (and simpler ones), as fast as the loop tolerates it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..._sections import FloatArray
from ...analysis.margins.slopes import Around, LoopOnGrid, Surroundings
from ...filter import PhyFilter, SampledPhyFilter, Sampling
from .constraints import LoopGoal, Near, again, loop_of, near_limits
from .coordinates import chain_slopes
from .objective import Objective, responses
from .parametrisation import Chain
from .quadratic import quadratic_program
from .search import OrderSearch
from .sensitivity import Data, Solver, filter_of, jacobian
from .shape import condition_rows

__all__ = ["INSIDE", "Admissible", "Point"]

_SHORTER = 8  # times that a step is shortened before the descent ends
_CORRECTIONS = 2
_LONGEST = 0.7  # of a step, in logarithms
_PROMISE = 1e-5  # of the cost, below which a descent is done
_SMALL, _SMALL_STEPS = 1e-4, 3  # so many steps that gained less than this of the cost end it too
# Spare room kept in the search, and where the exact margins find less than it did.
INSIDE = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
_DIFFERENCE = 1e-5
_AMPLE = 0.5  # spare room beyond which a step is not asked to keep what has to be differenced
_APART = 1e-4  # of frequencies, in logarithms: a dip moves as the filter does
_SAME_CROSSING = 0.2  # two filters' crossings this near are one, in logarithms
_SPEEDS = 24  # scanned from that of a filter down to the slowest
_HALVINGS = 8
_ADDS_NOTHING = 1e-4


@dataclass(frozen=True, eq=False)
class Point:
    """A filter on the way.

    Attributes
    ----------
    theta : array
        Unknowns of the search.
    chain : Chain
    c : (n,) array
        F = c xi.
    filter : PhyFilter
    cost : float
    sampled : SampledPhyFilter or None
        As it will run; None where Euler's method diverges.
    loop : LoopOnGrid or None
        None where only exact margins are known.
    task : Admissible
    """

    theta: FloatArray
    chain: Chain
    c: FloatArray
    filter: PhyFilter
    cost: float
    sampled: SampledPhyFilter | None
    loop: LoopOnGrid | None
    task: Admissible

    @cached_property
    def near(self) -> list[Near]:
        """Where the loop comes near to its limits."""
        return [] if self.loop is None else near_limits(self.task.constraint, self.loop)

    @cached_property
    def spares(self) -> dict[str, float]:
        """Spare room of limits that are at no frequency."""
        assert self.sampled is not None  # asked of filters that run
        if self.loop is None:
            return self.task.constraint.spare(self.sampled)
        return self.task.constraint.others(self.sampled)

    @cached_property
    def keeps(self) -> bool:
        """Whether all limits hold, so far as the search sees them."""
        least = 0.5 * self.task.inside
        if self.sampled is None or any(each.spare < least for each in self.near):
            return False
        if self.loop is not None and not self.loop.around.loop.is_stable(self.sampled):
            return False
        return all(spare >= least for spare in self.spares.values())


@dataclass(frozen=True, eq=False)
class Admissible:
    """The search among filters that keep the limits.

    Attributes
    ----------
    search : OrderSearch
        That without a loop, ended.
    data : Data
        Its.
    constraint : LoopGoal
    sampling : Sampling
        As the filter will run.
    objective : Objective
    inside : float
        Spare room that limits keep.
    """

    search: OrderSearch
    data: Data
    constraint: LoopGoal
    sampling: Sampling
    objective: Objective
    inside: float = INSIDE[0]

    def best(self, orders: int, given: Iterable[PhyFilter] = ()) -> tuple[Point, bool] | None:
        """The best admissible filter up to an order, and whether its descent ended; None where there is none.

        ``given`` are further starts.
        """
        found: tuple[Point, bool] | None = None
        for n in range(max(self.search.shape.least_order, 1), orders + 1):
            starts = [] if n not in self.search.best else [self.search.filter(self.search.best[n])]
            starts += [filter for filter in given if filter.order == n]
            if found is not None:
                starts += [_with_pole(found[0].filter, rate) for rate in self._rates(found[0].filter)]
            begun = [point for start in starts if (point := self.slowed(start)) is not None]
            ended = [self._descend(point) for point in begun]
            if not ended:
                continue
            least = min(ended, key=lambda entry: entry[0].cost)
            if found is None or least[0].cost < (1.0 - _ADDS_NOTHING) * found[0].cost:
                found = least
        return found

    def _rates(self, filter: PhyFilter) -> list[float]:
        """Of a pole more: as fast as the sampling shows, and by the others."""
        fastest, sizes = 1.0 / self.search.step, np.abs(filter.poles)
        return [fastest, min(2.0 * float(np.max(sizes)), 0.5 * fastest)]

    def slowed(self, filter: PhyFilter) -> Point | None:
        """A filter as fast as the loop tolerates it, at its own speed at most."""
        slowest = min(self.search.band[0] / float(np.max(np.abs(filter.poles))), 1.0)

        def at(speed: float) -> Point | None:
            slow = at_speed(filter, speed)
            point = self._at(self.search.coordinates.of(slow.poles), lambda chain: chain.output(slow.b))
            return point if point is not None and point.keeps else None

        before = 1.0
        for speed in np.geomspace(1.0, slowest, _SPEEDS):
            point = at(float(speed))
            if point is not None:
                break
            before = float(speed)
        else:
            return None
        low, high = float(speed), before
        for _ in range(_HALVINGS if high > low else 0):
            middle = float(np.sqrt(low * high))
            faster = at(middle)
            low, high = (low, middle) if faster is None else (middle, high)
            point = point if faster is None else faster
        return point

    # -- one descent --------------------------------------------------------------------------------------------

    def _descend(self, now: Point) -> tuple[Point, bool]:
        damping, done, small = 1e-3, False, 0
        for _ in range(self.search.limit):
            rows = self._rows(now)
            gradient, curvature = self.objective.model(now.chain, now.c, rows)
            curvature = curvature + 1e-12 * float(np.trace(curvature)) / len(rows) * np.eye(len(rows))
            limits = self._limits(now, rows)
            trial = None
            for _ in range(_SHORTER):
                metric = curvature + damping * np.diag(np.diag(curvature))
                trial, promised, limits = self._trial(now, rows, gradient, metric, limits)
                done = promised <= _PROMISE * now.cost
                if done or (trial is not None and trial.cost < now.cost):
                    break
                damping *= 8.0
            if done or small == _SMALL_STEPS or trial is None or not trial.cost < now.cost:
                return now, done or small == _SMALL_STEPS
            small = small + 1 if now.cost - trial.cost < _SMALL * now.cost else 0
            now, damping = trial, max(damping / 8.0, 1e-9)
        return now, False

    def _trial(
        self, now: Point, rows: FloatArray, gradient: FloatArray, metric: FloatArray, limits: _Limits
    ) -> tuple[Point | None, float, _Limits]:
        """The filter after a step, None where it is not admissible; by how much the step lowers the model; the limits
        and what the step met beside them."""
        upper, lower = self.search.box(now.chain.order)
        box = _box(now.theta, np.maximum(upper, now.theta), np.minimum(lower, now.theta), len(rows))
        free = rows[len(now.theta) :, : now.chain.order]
        promised, left = 0.0, limits.spare
        for k in range(_CORRECTIONS + 1):
            step = quadratic_program(
                gradient, metric, np.vstack([limits.slopes, box[0]]), np.append(left - self.inside, box[1])
            )
            if step is None:
                return None, np.inf if k else 0.0, limits
            if k == 0:
                promised = -float(gradient @ step + 0.5 * step @ metric @ step)
            trial = self._moved(now, step, free)
            if trial is None or (trial.cost < now.cost and trial.keeps):
                return trial, promised, limits
            if trial.sampled is None:
                return None, promised, limits
            limits = self._with_new(now, rows, limits, trial)
            left = np.append(left, limits.spare[len(left) :])
            seen = self._again(trial, limits)
            # The limits' curvature, as the step has met it.
            left = np.where(np.isnan(seen), left, np.minimum(seen - limits.slopes @ step, limits.spare))
        return None, promised, limits

    def _moved(self, now: Point, step: FloatArray, free: FloatArray) -> Point | None:
        count = len(now.theta)
        upper, lower = self.search.box(now.chain.order)
        # A programme that is nearly infeasible is not solved to its bounds.
        theta = np.clip(now.theta + step[:count], np.minimum(lower, now.theta), np.maximum(upper, now.theta))
        c = now.c + step[count:] @ free
        return self._at(theta, lambda chain: c)

    def _at(self, theta: FloatArray, output: Callable[[Chain], FloatArray]) -> Point | None:
        """The filter with these unknowns and an output row moved as little as the structure asks."""
        search = self.search
        chain = search.coordinates.chain(theta)
        if np.max(np.abs(chain.poles.imag)) * search.step > np.pi:
            return None
        n = chain.order
        if search.shape.form == "lowpass":
            c = np.zeros(n)
            c[-1] = chain.lowpass[0]
        else:
            found = self.data.moments(chain.doubled)
            if found is None:
                return None
            c = output(chain)
            S, d = condition_rows(search.shape, chain.doubled)
            c = c + Solver(found[0][:n, :n], S[:n]).met((d - c @ S[:n])[None])[0]
        cost = self.objective.cost(chain, c)
        if not np.isfinite(cost):
            return None
        filter = filter_of(chain, c, search.shape)
        try:
            sampled = SampledPhyFilter(filter, self.sampling)
        except ValueError:  # Euler's method diverges
            sampled = None
        loop = None if sampled is None or self._around is None else LoopOnGrid(self._around, sampled)
        return Point(theta, chain, c, filter, cost, sampled, loop, self)

    def _rows(self, now: Point) -> FloatArray:
        """d F = row [xi; eta] by the unknowns and by what the structure leaves free of c."""
        rows = jacobian(self.data, now.chain, now.c, self.search.shape)
        n = now.chain.order
        if not self.search.shape.is_limited:
            return rows
        return np.concatenate(
            [chain_slopes(self.search.coordinates, now.chain, now.theta) @ rows[:n], rows[n:]]
        )

    # -- limits -------------------------------------------------------------------------------------------------

    @cached_property
    def loop(self) -> Surroundings | None:
        """What the filters stand in; None where only exact margins are known."""
        return loop_of(self.constraint, SampledPhyFilter(PhyFilter([self.search.floor]), self.sampling))

    @cached_property
    def _around(self) -> Around | None:
        return None if self.loop is None else Around(self.loop, self.search.floor)

    def _limits(self, now: Point, rows: FloatArray) -> _Limits:
        slopes = self._slopes(now, rows, now.near)
        names = tuple(name for name, spare in now.spares.items() if spare < _AMPLE)
        spare = np.array([*(each.spare for each in now.near), *(now.spares[name] for name in names)])
        if names:
            slopes = np.vstack([slopes, self._differences(now, rows, names)])
        return _Limits(tuple(now.near), names, spare, slopes, ())

    def _slopes(self, now: Point, rows: FloatArray, near: Iterable[Near]) -> FloatArray:
        near = list(near)
        omega = np.array([each.omega for each in near])
        moved = responses(now.chain, omega, self.sampling) @ rows.T  # (k, p): dF(j omega)
        return np.real(np.array([each.slope for each in near])[:, None] * moved)

    def _with_new(self, now: Point, rows: FloatArray, limits: _Limits, trial: Point) -> _Limits:
        """With frequencies at which a step has made the modulus too small, apart from those known, or has raised |L|
        beyond 1 where that leaves too little delay margin."""
        if now.loop is None:
            return limits
        known = np.array([each.omega for each in (*limits.near, *limits.met)])
        lost = [each for each in trial.near if each.spare < self.inside]
        dips = [
            each.omega
            for each in lost
            if each.name == "modulus margin"
            and np.min(np.abs(np.log(known / each.omega)), initial=np.inf) > _APART
        ]
        crossings = np.array([each.omega for each in lost if each.name == "delay margin"])
        met = again(self.constraint, now.loop, np.array(dips)) if dips else []
        if len(crossings):
            below = again(self.constraint, now.loop, crossings, gain=True)
            met += [each for each in below if each.spare > 0.0]
        if not met:
            return limits
        return _Limits(
            limits.near,
            limits.names,
            np.append(limits.spare, [each.spare for each in met]),
            np.vstack([limits.slopes, self._slopes(now, rows, met)]),
            (*limits.met, *met),
        )

    def _again(self, trial: Point, limits: _Limits) -> FloatArray:
        """Spare room of the same limits for another filter, nan where that is not known."""
        seen = np.full(len(limits.spare), np.nan)
        if trial.loop is None:
            return np.array([trial.spares[name] for name in limits.names])
        places = [*range(len(limits.near)), *range(len(seen) - len(limits.met), len(seen))]
        entries = list(zip(places, (*limits.near, *limits.met), strict=True))
        at = [i for i, each in entries if each.name == "modulus margin"]
        omega = np.array([each.omega for _, each in entries if each.name == "modulus margin"])
        seen[at] = [each.spare for each in again(self.constraint, trial.loop, omega)]
        # A crossing is the nearest of its kind.
        for i, each in entries[: len(limits.near)]:
            same = [other for other in trial.near if other.name == each.name != "modulus margin"]
            nearest = min(same, key=lambda other: abs(np.log(other.omega / each.omega)), default=None)
            if nearest is not None and abs(np.log(nearest.omega / each.omega)) < _SAME_CROSSING:
                seen[i] = nearest.spare
        return seen

    def _differences(self, now: Point, rows: FloatArray, names: Iterable[str]) -> FloatArray:
        """Slopes (k, p) of spare room by differences."""
        count, free = len(now.theta), rows[len(now.theta) :, : now.chain.order]
        names = list(names)
        found = np.zeros((len(names), len(rows)))
        for i in range(len(rows)):
            step = np.zeros(len(rows))
            step[i] = (
                _DIFFERENCE
                if i < count
                else _DIFFERENCE
                * float(np.linalg.norm(now.c))
                / max(float(np.linalg.norm(free[i - count])), 1e-300)
            )
            end = self._moved(now, step, free)
            if end is not None and end.sampled is not None:
                found[:, i] = [(end.spares[name] - now.spares[name]) / step[i] for name in names]
        return found


@dataclass(frozen=True, eq=False)
class _Limits:
    """Limits linear in a step: those near, those without a frequency by name, and what earlier steps met."""

    near: tuple[Near, ...]
    names: tuple[str, ...]
    spare: FloatArray  # (k,)
    slopes: FloatArray  # (k, p)
    met: tuple[Near, ...]


def at_speed(filter: PhyFilter, speed: float) -> PhyFilter:
    """F(s / speed)."""
    powers = speed ** np.arange(filter.order, 0, -1)
    return PhyFilter(filter.a * powers, filter.b * powers)


def _with_pole(filter: PhyFilter, rate: float) -> PhyFilter:
    """F times (s + rate)/(s + rate) in the general form, F with one fast pole more in the low-pass form."""
    poles = np.append(filter.poles, -rate)
    a = PhyFilter.from_poles(poles).a
    if np.array_equal(filter.b, PhyFilter(filter.a).b):
        return PhyFilter(a)
    return PhyFilter(a, np.convolve(filter.b, [rate, 1.0]))


def _box(theta: FloatArray, upper: FloatArray, lower: FloatArray, size: int) -> tuple[FloatArray, FloatArray]:
    eye = np.eye(len(theta), size)
    return np.vstack([-eye, eye]), np.minimum(np.append(upper - theta, theta - lower), _LONGEST)
