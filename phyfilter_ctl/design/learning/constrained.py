"""The best filter that keeps the limits of a loop: sequential quadratic programs whose iterates are all admissible.

At an admissible filter the cost's Gauss-Newton model and every dip, gain and phase crossing of the loop, linear in
F(j omega), make a quadratic program; its step is corrected for the curvature of the limits and shortened until the
limits hold and the cost falls. So whatever the search does, it ends at a filter that is admissible, and no worse than
the start: the filter learned without the loop (and simpler ones), as fast as the loop tolerates it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls

from ..._sections import FloatArray
from ...filter import PhyFilter, SampledPhyFilter, Sampling
from ...filter.recursion import transition
from .constraints import LoopConstraint, Near
from .coordinates import chain_slopes
from .parametrisation import Chain
from .search import Search
from .sensitivity import Solver, filter_of, jacobian

__all__ = ["Admissible", "Point", "at_speed"]

_SHORTER = 8  # times that a step is shortened before the descent ends
_CORRECTIONS = 2
_LONGEST = 0.7  # of a step, in logarithms
_PROMISE = 1e-5  # of the cost, below which a descent is done
_SMALL, _SMALL_STEPS = 1e-4, 3  # so many steps that gained less than this of the cost end it too
_INSIDE = 1e-6  # spare room kept in the search
_DIFFERENCE = 1e-5
_APART = 0.02  # of frequencies, in logarithms
_SPEEDS = 24  # scanned from that of a filter down to the slowest
_HALVINGS = 8
_ADDS_NOTHING = 1e-4


class Point(NamedTuple):
    """A filter on the way."""

    theta: FloatArray
    chain: Chain
    c: FloatArray
    filter: PhyFilter
    cost: float


@dataclass(frozen=True, eq=False)
class Admissible:
    """The search among filters that keep the limits.

    Attributes
    ----------
    search : Search
        That without a loop, ended.
    constraint : LoopConstraint
    sampling : Sampling
        As the filter will run.
    """

    search: Search
    constraint: LoopConstraint
    sampling: Sampling

    def best(self, orders: int) -> tuple[Point, bool] | None:
        """The best admissible filter up to an order, and whether its descent ended; None where there is none."""
        found: tuple[Point, bool] | None = None
        for n in range(max(self.search.structure.least_order, 1), orders + 1):
            starts = [] if n not in self.search.best else [self.search.filter(self.search.best[n])]
            if found is not None:
                starts.append(_with_pole(found[0].filter, 1.0 / self.search.step))
            begun = [point for start in starts if (point := self.slowed(start)) is not None]
            ended = [self._descend(point) for point in begun]
            if not ended:
                continue
            least = min(ended, key=lambda entry: entry[0].cost)
            if found is None or least[0].cost < (1.0 - _ADDS_NOTHING) * found[0].cost:
                found = least
        return found

    def slowed(self, filter: PhyFilter) -> Point | None:
        """A filter as fast as the loop tolerates it, at its own speed at most."""
        slowest = min(self.search.band[0] / float(np.max(np.abs(filter.poles))), 1.0)

        def at(speed: float) -> Point | None:
            slow = at_speed(filter, speed)
            point = self._at(self.search.coordinates.of(slow.poles), lambda chain: chain.output(slow.b))
            return point if point is not None and self._keeps(point) else None

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
            gradient, curvature = self._model(now, rows)
            met: list[float] = []  # frequencies of dips at which steps failed
            trial = None
            for _ in range(_SHORTER):
                near, spare, slopes = self._limits(now, rows, met)
                metric = curvature + damping * np.diag(np.diag(curvature))
                trial, promised = self._trial(now, rows, gradient, metric, near, spare, slopes, met)
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
        self,
        now: Point,
        rows: FloatArray,
        gradient: FloatArray,
        metric: FloatArray,
        near: list[Near],
        spare: FloatArray,
        slopes: FloatArray,
        met: list[float],
    ) -> tuple[Point | None, float]:
        """The filter after a step, None where it is not admissible; and by how much the step lowers the model."""
        upper, lower = self.search.box(now.chain.order)
        box = _box(now.theta, np.maximum(upper, now.theta), np.minimum(lower, now.theta), len(rows))
        free = rows[len(now.theta) :, : now.chain.order]
        promised, left = 0.0, spare
        for k in range(_CORRECTIONS + 1):
            step = _program(gradient, metric, np.vstack([slopes, box[0]]), np.append(left - _INSIDE, box[1]))
            if step is None:
                return None, np.inf if k else 0.0
            if k == 0:
                promised = -float(gradient @ step + 0.5 * step @ metric @ step)
            trial = self._moved(now, step, free)
            if trial is None or (trial.cost < now.cost and self._keeps(trial)):
                return trial, promised
            if self.constraint.margins is None:
                met += self._new_dips(trial, near)
                seen = self.constraint.again(self._sampled(trial), near)
                seen = np.append(seen, np.full(len(spare) - len(seen), np.nan))
            else:
                seen = np.array(list(self._spares(trial).values()))
            # The limits' curvature, as the step has met it.
            left = np.where(np.isnan(seen), left, np.minimum(seen - slopes @ step, spare))
        return None, promised

    def _moved(self, now: Point, step: FloatArray, free: FloatArray) -> Point | None:
        count = len(now.theta)
        c = now.c + step[count:] @ free
        return self._at(now.theta + step[:count], lambda chain: c)

    def _at(self, theta: FloatArray, output: Callable[[Chain], FloatArray]) -> Point | None:
        """The filter with these unknowns and an output row moved as little as the structure asks."""
        search = self.search
        chain = search.coordinates.chain(theta)
        if np.max(np.abs(chain.poles.imag)) * search.step > np.pi:
            return None
        found = search.fine.moments(chain.doubled)
        if found is None:
            return None
        n, (G, m) = chain.order, found
        if search.form == "lowpass":
            c = np.zeros(n)
            c[-1] = chain.lowpass[0]
        else:
            c = output(chain)
            S, d = search.structure.rows(chain.doubled)
            c = c + Solver(G[:n, :n], S[:n]).met((d - c @ S[:n])[None])[0]
        cost = search.fine.energy - 2.0 * c @ m[:n] + c @ G[:n, :n] @ c
        filter = filter_of(chain, c, search.form, search.structure)
        return Point(theta, chain, c, filter, float(cost) / search.fine.weight)

    def _rows(self, now: Point) -> FloatArray:
        """d F = row [xi; eta] by the unknowns and by what the structure leaves free of c."""
        rows = jacobian(self.search.fine, now.chain, now.c, self.search.form, self.search.structure)
        n = now.chain.order
        if not self.search.structure.is_limited:
            return rows
        return np.concatenate(
            [chain_slopes(self.search.coordinates, now.chain, now.theta) @ rows[:n], rows[n:]]
        )

    def _model(self, now: Point, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        found = self.search.fine.moments(now.chain.doubled)
        assert found is not None  # the filter has a cost on these data
        G, m = found
        scale = 2.0 / self.search.fine.weight
        curvature = scale * rows @ G @ rows.T
        least = 1e-12 * float(np.trace(curvature)) / len(rows)
        return -scale * rows @ (m - G[:, : now.chain.order] @ now.c), curvature + least * np.eye(len(rows))

    # -- limits -------------------------------------------------------------------------------------------------

    def _sampled(self, point: Point) -> SampledPhyFilter:
        return SampledPhyFilter(point.filter, self.sampling)

    def _spares(self, point: Point) -> dict[str, float]:
        filter = self._sampled(point)
        return (
            self.constraint.spare(filter)
            if self.constraint.margins is not None
            else self.constraint.others(filter)
        )

    def _keeps(self, point: Point) -> bool:
        try:
            sampled = self._sampled(point)
        except ValueError:  # Euler's method diverges
            return False
        if any(spare < 0.0 for spare in self._spares(point).values()):
            return False
        if self.constraint.margins is not None:
            return True
        return self.constraint.is_stable(sampled) and all(
            each.spare >= 0.0 for each in self.constraint.near(sampled)
        )

    def _new_dips(self, trial: Point, near: list[Near]) -> list[float]:
        """Frequencies at which a step has made the modulus too small, apart from those known."""
        known = np.array([each.omega for each in near])
        return [
            each.omega
            for each in self.constraint.near(self._sampled(trial))
            if each.name == "modulus margin"
            and each.spare < 0.0
            and np.min(np.abs(np.log(known / each.omega)), initial=np.inf) > _APART
        ]

    def _limits(
        self, now: Point, rows: FloatArray, met: list[float]
    ) -> tuple[list[Near], FloatArray, FloatArray]:
        """Where the loop is near to its limits, spare room (k,) there and of what has no frequency, slopes (k, p)."""
        formula = self.constraint.margins is None
        near = self.constraint.near(self._sampled(now), met) if formula else []
        omega = np.array([each.omega for each in near])
        moved = _responses(now.chain, omega, self.sampling) @ rows.T  # (k, p): dF(j omega)
        slopes = np.real(np.array([each.slope for each in near])[:, None] * moved)
        spares = self._spares(now)
        if spares:
            slopes = np.vstack([slopes, self._differences(now, rows, list(spares))])
        return near, np.array([*(each.spare for each in near), *spares.values()]), slopes

    def _differences(self, now: Point, rows: FloatArray, names: list[str]) -> FloatArray:
        """Slopes (k, p) of spare room by central differences."""
        count, free = len(now.theta), rows[len(now.theta) :, : now.chain.order]
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
            ends = [self._moved(now, sign * step, free) for sign in (1.0, -1.0)]
            if ends[0] is None or ends[1] is None:
                continue
            high, low = (self._spares(end) for end in ends if end is not None)
            found[:, i] = [(high[name] - low[name]) / (2.0 * step[i]) for name in names]
        return found


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


def _responses(chain: Chain, omega: FloatArray, sampling: Sampling) -> np.ndarray:
    """States [xi; eta] of the sampled doubled chain, per measured residual, (k, 2n)."""
    A, B = chain.doubled[:-1, :-1], chain.doubled[:-1, -1]
    dA = transition(A, sampling.method, sampling.dt)
    drive = dA @ np.linalg.solve(A, B)
    delta = np.expm1(1j * omega * sampling.dt)[:, None, None]
    found = np.linalg.solve(
        delta * np.eye(len(A)) - dA, np.tile(drive, (len(omega), 1))[..., None].astype(complex)
    )
    return np.asarray((1.0 + delta[:, 0]) * found[..., 0])


def _box(theta: FloatArray, upper: FloatArray, lower: FloatArray, size: int) -> tuple[FloatArray, FloatArray]:
    eye = np.eye(len(theta), size)
    return np.vstack([-eye, eye]), np.minimum(np.append(upper - theta, theta - lower), _LONGEST)


def _program(gradient: FloatArray, H: FloatArray, A: FloatArray, spare: FloatArray) -> FloatArray | None:
    """The step d that minimises gradient d + d' H d/2 with spare + A d >= 0; None where nothing keeps that.

    Lawson and Hanson's least distance programming: by non-negative least squares.
    """
    try:
        L = cholesky(H, lower=True)
    except np.linalg.LinAlgError:
        return None
    free = solve_triangular(L, gradient, lower=True)
    G = solve_triangular(L, A.T, lower=True)  # columns
    h = G.T @ free - spare
    E = np.vstack([G, h])
    sizes = np.linalg.norm(E, axis=0)
    E = E[:, sizes > 0.0] / sizes[sizes > 0.0]
    target = np.append(np.zeros(len(G)), 1.0)
    try:
        y, _ = nnls(E, target)
    except RuntimeError:
        return None
    r = E @ y - target
    if -r[-1] <= 1e-12:
        return None
    v = -r[:-1] / r[-1]
    return np.asarray(solve_triangular(L.T, v - free, lower=False))
