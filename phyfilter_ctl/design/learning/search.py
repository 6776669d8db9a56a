"""The search over orders and starts: every order from many starts, the lower order's answer among them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..._sections import ComplexArray, FloatArray
from ...filter import PhyFilter
from ...filter.sampling import Method
from . import levenberg
from .coordinates import FASTEST, Coordinates, Limited, Schwarz
from .levenberg import Descent
from .parametrisation import Chain
from .samples import Pooled
from .sensitivity import Data, Evaluation, evaluate, filter_of
from .shape import LOWPASS, Shape
from .shrinkage import Shrinkage

_CUTOFFS = 10  # of the scan for where to start
_TRIAL_STEPS = 8  # for every start; the best go on
_GO_ON = 3
_REFINED, _FINE_STEPS = 2, 3  # answers of the trials' problem that are tried on the other, and for how long
_TOGETHER = 1e-4  # two trials whose costs agree to this are on one way


@dataclass(frozen=True, eq=False)
class Best:
    """The best of one order."""

    theta: FloatArray
    chain: Chain
    found: Evaluation
    start: int
    done: bool
    bound: bool

    @property
    def cost(self) -> float:
        return self.found.cost


@dataclass(eq=False)
class OrderSearch:
    """Everything the starts of all orders share.

    Attributes
    ----------
    coarse, fine : Data
        What trials run on, and what the answer must hold on; one object where they are the same.
    method : {"exact", "matched", "euler", "tustin"}
    step : float
        Longest sampling interval in s.
    floor : float
        Least decay rate in rad/s.
    limit : int
        Steps of one descent.
    report : callable
        Order, start, descent; called after every step that lowered a cost.
    shape : Shape
        What F is made to be.
    shrinkage : float
        Strength of the pull towards the order below, rho sum_k u_k^2 (``shrinkage``); 0 for none.
    best : dict
        By order; filled by :meth:`climb`, also when a callback breaks off.
    rough : dict
        By order: the best trial, for :meth:`settle`.
    """

    coarse: Data
    fine: Data
    method: Method
    step: float
    floor: float
    limit: int
    report: Callable[[int, int, Descent], None]
    shape: Shape = LOWPASS
    shrinkage: float = 0.0
    best: dict[int, Best] = field(default_factory=dict)
    rough: dict[int, Descent] = field(default_factory=dict)

    @cached_property
    def coordinates(self) -> Coordinates:
        """The unknowns of the descents."""
        if not self.shape.is_limited:
            return Schwarz(self.step, self.floor)
        low, high = self.band
        return Limited(np.array(self.shape.poles, dtype=np.complex128), low, high, self.shape.least_damping)

    @property
    def band(self) -> tuple[float, float]:
        """Least and largest rate in rad/s that single poles may have; without limits the largest holds on average."""
        low, high = self.shape.pole_range or (self.floor, np.inf)
        return max(low, self.floor), min(high, FASTEST / self.step)

    def filter(self, best: Best) -> PhyFilter:
        """The filter of a best one."""
        return filter_of(best.chain, best.found.c, self.shape)

    def settle(self) -> None:
        """After a callback broke off: orders that had only been tried are judged on the fine data as they stand."""
        for n, descent in self.rough.items():
            if n not in self.best and (found := self.cost(self.fine)(descent.theta)) is not None:
                self.best[n] = Best(
                    descent.theta, self.coordinates.chain(descent.theta), found, 0, False, False
                )

    def climb(self, order: int, given: Sequence[PhyFilter], starts: int, rng: np.random.Generator) -> None:
        """Solve the orders 1 ... order, each warm-started from the one before."""
        for n in range(self.shape.least_order, order + 1):
            mine = [self.coordinates.of(filter.poles) for filter in given if filter.order == n]
            warm = [self.with_pole(self.best[n - 1].chain, rate) for rate in self._extra_rates(n)]
            scan = self._scan(n)
            random = [self._random(n, scan[0], rng) for _ in range(starts)]
            self._solve(n, [*warm, *mine, *scan[1:], *random], len(warm))

    def _solve(self, n: int, begins: list[FloatArray], warm: int) -> None:
        upper, lower = self.box(n)
        trials: list[tuple[int, Descent]] = []
        for number, theta in enumerate(begins):
            begun = levenberg.start(self.cost(self.coarse), theta)
            if begun is not None:
                trials.append((number, self._descend(n, number, begun, self.coarse, _TRIAL_STEPS)))
        chosen = _distinct(trials)
        ended = [(number, self._descend(n, number, now, self.coarse, self.limit)) for number, now in chosen]
        if self.fine is not self.coarse:
            ended = self._refined(n, ended, begins[:warm])
        if not ended:
            return
        number, descent = min(ended, key=lambda entry: entry[1].found.cost)
        edge = bool(np.any(levenberg.bound(descent.theta, descent.found.gradient, upper, lower)))
        self._keep(n, number, descent, edge)

    def _refined(
        self, n: int, ended: list[tuple[int, Descent]], warm: list[FloatArray]
    ) -> list[tuple[int, Descent]]:
        """The best of the trials, and the lower order's answer, take a few steps on the fine data; one goes on."""
        ended = sorted(ended, key=lambda entry: entry[1].found.cost)[:_REFINED]
        thetas = [(number, descent.theta) for number, descent in ended]
        thetas += [*enumerate(warm[:1])]
        begun = [(number, levenberg.start(self.cost(self.fine), theta)) for number, theta in thetas]
        tried = [
            (number, self._descend(n, number, now, self.fine, _FINE_STEPS))
            for number, now in begun
            if now is not None
        ]
        if not tried:
            return []
        number, now = min(tried, key=lambda entry: entry[1].found.cost)
        return [(number, self._descend(n, number, now, self.fine, self.limit))]

    def _descend(self, n: int, number: int, now: Descent, data: Data, limit: int) -> Descent:
        upper, lower = self.box(n)

        def report(descent: Descent) -> None:
            if data is self.fine:
                self._keep(n, number, descent, False)
            elif n not in self.rough or descent.found.cost < self.rough[n].found.cost:
                self.rough[n] = descent
            self.report(n, number, descent)

        return levenberg.descend(
            self.cost(data),
            now,
            upper,
            lower,
            limit=limit,
            negligible=1e-15 * data.energy / data.weight,
            report=report,
        )

    def _keep(self, n: int, number: int, descent: Descent, edge: bool) -> None:
        known = self.best.get(n)
        if known is None or descent.found.cost <= known.cost:
            chain = self.coordinates.chain(descent.theta)
            self.best[n] = Best(descent.theta, chain, descent.found, number, descent.done, edge)

    def cost(self, data: Data) -> Callable[[FloatArray], Evaluation | None]:
        """The cost on some data as a function of the unknowns."""

        def cost(theta: FloatArray) -> Evaluation | None:
            chain = self.coordinates.chain(theta)
            # Beyond the Nyquist frequency a pole is the alias of a slower one.
            if np.max(np.abs(chain.poles.imag)) * self.step > np.pi:
                return None
            found = evaluate(self._pulled_down(data, chain.order), chain, self.shape)
            return None if found is None else self.coordinates.pulled(found, chain, theta)

        return cost

    def _pulled_down(self, data: Data, n: int) -> Data:
        below = self.best.get(n - 1)
        if self.shrinkage == 0.0 or below is None:
            return data
        pull = Shrinkage(below.chain, below.found.c, self.shrinkage, self.step, self.method)
        return Pooled([data, pull])

    def box(self, n: int) -> tuple[FloatArray, FloatArray]:
        """Upper and lower bounds of the unknowns of order n."""
        return self.coordinates.box(n)

    # -- starts -------------------------------------------------------------------------------------------------

    @property
    def _fastest(self) -> float:
        """A rate in rad/s that the sampling still resolves, under every rule."""
        return 1.0 / self.step

    def with_pole(self, chain: Chain, rate: float | None = None) -> FloatArray:
        """The chain with one real pole more, None as fast as can be: not moved, so that the general form contains the
        old filter."""
        return self.coordinates.of(np.append(chain.poles, -(rate or self._fastest)), inside=False)

    def _extra_rates(self, n: int) -> list[float]:
        """Where the additional pole of a warm start goes: as fast as the sampling allows, and by the others."""
        if n - 1 not in self.best:
            return []
        sizes = np.abs(self.best[n - 1].chain.poles)
        near = min(2.0 * float(np.max(sizes)), 0.5 * self._fastest)
        return [self._fastest, near, max(0.5 * float(np.min(sizes)), 2.0 * self.floor)]

    def _scan(self, n: int) -> list[FloatArray]:
        """Poles spread a little about a cutoff: the best of a scan of cutoffs, damped well and weakly."""
        low, high = self.band
        slow = max(min(4.0 * self.floor, 0.1 * self._fastest), low)
        cutoffs = np.geomspace(slow, max(min(0.5 * self._fastest, high), slow), _CUTOFFS)
        best: list[FloatArray] = []
        for damping in (1.0, 0.4):
            begins = [self.coordinates.of(_spread(n, cutoff, damping)) for cutoff in cutoffs]
            chains = [self.coordinates.chain(theta) for theta in begins]
            found = [evaluate(self.coarse, chain, self.shape) for chain in chains]
            costs = [np.inf if entry is None else entry.cost for entry in found]
            best.append(begins[int(np.argmin(costs))])
        return [best[0], *best]

    def _random(self, n: int, about: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Poles drawn about those of a start, a factor of three either way and more."""
        centre = float(np.exp(np.mean(np.log(np.abs(self.coordinates.chain(about).poles)))))
        poles: list[complex] = []
        while len(poles) < n:
            size = float(
                np.clip(centre * np.exp(1.2 * rng.standard_normal()), 2.0 * self.floor, self._fastest)
            )
            damping = rng.uniform(0.1, 1.3)
            if n - len(poles) == 1 or damping >= 1.0:
                poles.append(complex(-size))
            else:
                pole = size * complex(-damping, np.sqrt(1.0 - damping**2))
                poles += [pole, pole.conjugate()]
        return self.coordinates.of(np.array(poles))


def _spread(n: int, cutoff: float, damping: float) -> ComplexArray:
    """n poles of sizes up to 20 % about the cutoff; pairs of one damping, or all real."""
    sizes = cutoff * np.geomspace(0.8, 1.25, n) if n > 1 else np.array([cutoff])
    poles = -sizes.astype(np.complex128)
    if damping < 1.0:
        turn = complex(-damping, np.sqrt(1.0 - damping**2))
        for i in range(0, n - 1, 2):
            poles[i], poles[i + 1] = sizes[i] * turn, sizes[i] * turn.conjugate()
    return poles


def _distinct(trials: list[tuple[int, Descent]]) -> list[tuple[int, Descent]]:
    """The best trials on ways of their own."""
    chosen: list[tuple[int, Descent]] = []
    for number, descent in sorted(trials, key=lambda entry: entry[1].found.cost):
        costs = [other.found.cost for _, other in chosen]
        if all(abs(descent.found.cost - cost) > _TOGETHER * cost for cost in costs):
            chosen.append((number, descent))
    return chosen[:_GO_ON]
