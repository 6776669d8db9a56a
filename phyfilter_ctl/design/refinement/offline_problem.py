"""The least squares of an offline refinement, and its weight of trust by cross-validation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from ..._sections import FloatArray
from ...filter import SampledPhyFilter
from ...learned import LearnedModel
from ...recording import Recording
from . import regression
from .regression import Tuned

M = TypeVar("M", bound=LearnedModel)
Masks = list[NDArray[np.bool_]]

# Linear models of more parameters than this are refined by descent: their regressors would fill the memory.
_DIRECT = 200
# Directions of the parameters that the flights move less than this, relative, stay as they are.
_RANK = 1e-10
# Cross-validation leaves out one flight at a time, or one block of a flight where there are few flights.
_FOLDS = 5
# Weights of trust that are tried, relative to the mean square of a regressor; descent tries fewer.
_TRUSTS = 10.0 ** np.arange(3.0, -6.5, -1.0)
_TRUSTS_DESCENT = 10.0 ** np.arange(0.0, -6.5, -2.0)
# Descent has converged when an iteration gains less than this share of the cost with no change.
_CONVERGED = 1e-5
# A cost that cross-validation promises to lower by less than this share is not worth a new model.
_GAIN = 1e-3


class Solution(NamedTuple):
    """Change (p,) of the moving parameters and how it came about."""

    change: FloatArray
    cost: float
    iterations: int
    converged: bool
    trust: float  # inf where no change is best


@dataclass(frozen=True)
class Problem(Generic[M]):
    """Fit of the moving parameters to what the filter had to add."""

    tuned: Tuned[M]
    sampled: SampledPhyFilter
    flights: tuple[Recording, ...]
    keep: float
    memory: FloatArray | None

    def solve(self, trust: float | None, max_iterations: int) -> Solution:
        """Least cost; the weight of trust by cross-validation where it is None."""
        linear = self.tuned.count <= _DIRECT and all(
            self.tuned.is_linear(regression.features_of(log)) for log in self.flights
        )
        # One thread: the products are narrow, and several threads made them ten times slower.
        with threadpool_limits(1, user_api="blas"):
            return self._directly(trust) if linear else self._by_descent(trust, max_iterations)

    # -- linear models ----------------------------------------------------------------------------------------

    def _directly(self, trust: float | None) -> Solution:
        """One least-squares solution, from a triangular factor of each fold."""
        p = self.tuned.count
        folds: list[FloatArray] = []
        for log, target, masks in zip(self.flights, self._targets, self._folds, strict=True):
            columns = self.tuned.regressors(regression.features_of(log))
            rows = regression.filtered(self.sampled, columns)
            folds += [_triangle(rows[mask], target[mask]) for mask in masks]
        sizes = np.array([int(mask.sum()) for masks in self._folds for mask in masks])
        memory = np.zeros((0, p + 1))
        if self.memory is not None:
            kept = self.tuned.regressors(self.memory)
            memory = _triangle(kept, np.zeros(kept.shape[:2])) * np.sqrt(self.keep / len(kept))
        if trust is None:
            trust = _cross_validated(folds, sizes, memory)
            if np.isinf(trust):
                return self._unchanged(1)
        ridge = np.sqrt(trust) * np.eye(p, p + 1)
        stacked = np.vstack([*folds, memory * np.sqrt(sizes.sum()), ridge * np.sqrt(sizes.sum())])
        change = np.asarray(np.linalg.lstsq(stacked[:, :p], stacked[:, p], rcond=_RANK)[0], dtype=float)
        misfit = stacked @ np.append(change, -1.0)
        return Solution(change, float(misfit @ misfit) / float(sizes.sum()), 1, True, trust)

    @cached_property
    def _folds(self) -> list[Masks]:
        """Rows of each flight by fold: whole flights, or blocks where there are few."""
        blocks = -(-_FOLDS // len(self.flights))
        edges = [np.linspace(0, log.n, blocks + 1).astype(int) for log in self.flights]
        return [
            [(np.arange(log.n) >= a) & (np.arange(log.n) < b) for a, b in pairwise(at)]
            for log, at in zip(self.flights, edges, strict=True)
        ]

    @cached_property
    def _targets(self) -> list[FloatArray]:
        """What F of the change of f_theta shall be, for each flight."""
        return [
            regression.correction(self.sampled, log, self.tuned.model.predict(regression.features_of(log)))
            for log in self.flights
        ]

    def _unchanged(self, iterations: int) -> Solution:
        nothing = np.zeros(self.tuned.count)
        cost = float(sum(np.sum(target**2) for target in self._targets)) / sum(log.n for log in self.flights)
        return Solution(nothing, cost, iterations, True, np.inf)

    # -- other models -----------------------------------------------------------------------------------------

    def _by_descent(self, trust: float | None, max_iterations: int) -> Solution:
        """L-BFGS; without a given trust, from much trust to little until a third of the data says stop."""
        everything = [np.ones(log.n, dtype=bool) for log in self.flights]
        if trust is not None:
            return self._descended(trust, np.zeros(self.tuned.count), everything, max_iterations)
        held = self._last_third()
        training = [~mask for mask in held]
        change = np.zeros(self.tuned.count)
        best, iterations = (self._cost(change, 0.0, held)[0] * (1.0 - _GAIN), np.inf, change), 0
        for weight in _TRUSTS_DESCENT * self._sensitivity():
            tried = self._descended(weight, change, training, max_iterations)
            iterations += tried.iterations
            cost, change = self._cost(tried.change, 0.0, held)[0], tried.change
            if not cost < best[0] and np.isfinite(best[1]):
                break
            if cost < best[0]:
                best = (cost, weight, change)
        if np.isinf(best[1]):
            return self._unchanged(iterations)
        final = self._descended(best[1], best[2], everything, max_iterations)
        return final._replace(iterations=iterations + final.iterations)

    def _last_third(self) -> Masks:
        count = len(self.flights)
        if count >= 3:
            return [np.full(log.n, 3 * i >= 2 * count) for i, log in enumerate(self.flights)]
        return [np.arange(log.n) >= 2 * log.n // 3 for log in self.flights]

    def _sensitivity(self) -> float:
        """Mean square of d f_theta / d theta over parameters and samples, from random cotangents."""
        rng = np.random.default_rng(0)
        total, samples = 0.0, 0
        for log in self.flights:
            signs = rng.choice([-1.0, 1.0], self._targets[0].shape[1] * log.n).reshape(log.n, -1)
            gradient = self.tuned.model.vjp(regression.features_of(log), signs)[self.tuned.index]
            total, samples = total + float(gradient @ gradient), samples + log.n
        return total / (samples * self.tuned.count)

    def _descended(self, trust: float, start: FloatArray, masks: Masks, max_iterations: int) -> Solution:
        first = self._cost(np.zeros_like(start), 0.0, masks)[0]
        found = minimize(
            self._cost,
            start,
            args=(trust, masks),
            jac=True,
            method="L-BFGS-B",
            options={
                "maxiter": max_iterations,
                "maxfun": 20 * max_iterations,
                "maxcor": 30,
                "ftol": _CONVERGED * first / max(first, 1.0),
            },
        )
        change = np.asarray(found.x, dtype=float)
        return Solution(change, float(found.fun), int(found.nit), bool(found.success), trust)

    def _cost(self, change: FloatArray, trust: float, masks: Masks) -> tuple[float, FloatArray]:
        """Cost over the rows in ``masks``, and its gradient."""
        model = self.tuned.moved(change)
        cost, gradient = trust * float(change @ change), 2.0 * trust * change
        weight = 1.0 / sum(int(mask.sum()) for mask in masks)
        for log, target, mask in zip(self.flights, self._targets, masks, strict=True):
            if not mask.any():
                continue
            z = regression.features_of(log)
            gained = model.predict(z) - self.tuned.model.predict(z)
            error = regression.filtered(self.sampled, gained) - target
            error[~mask] = 0.0
            back = regression.filtered_adjoint(self.sampled, error)
            cost += weight * float(np.sum(error**2))
            gradient = gradient + 2.0 * weight * model.vjp(z, back)[self.tuned.index]
        if self.memory is not None:
            moved = model.predict(self.memory) - self.tuned.model.predict(self.memory)
            weight = self.keep / len(moved)
            cost += weight * float(np.sum(moved**2))
            gradient = gradient + 2.0 * weight * model.vjp(self.memory, moved)[self.tuned.index]
        return cost, gradient


def _triangle(rows: FloatArray, target: FloatArray) -> FloatArray:
    """R of regressors (N, n_x, p) beside their target (N, n_x)."""
    p = rows.shape[2]
    both = np.column_stack([rows.reshape(-1, p), target.reshape(-1)])
    return np.asarray(np.linalg.qr(both, mode="r"), dtype=float)


def _cross_validated(folds: list[FloatArray], sizes: NDArray[np.intp], memory: FloatArray) -> float:
    """Weight of trust with the least cost on folds left out; inf where no change is better than any."""
    p = memory.shape[1] - 1
    products = np.array([factor.T @ factor for factor in folds])
    total, kept = products.sum(axis=0), memory.T @ memory
    unit = float(np.trace(total[:p, :p])) / (p * sizes.sum()) or 1.0
    costs = np.zeros(len(_TRUSTS))
    for product, size in zip(products, sizes, strict=True):
        training = (total - product) / (sizes.sum() - size) + kept
        values, vectors = np.linalg.eigh(training[:p, :p])
        projected = vectors.T @ training[:p, p]
        for i, trust in enumerate(_TRUSTS * unit):
            change = vectors @ (projected / (np.maximum(values, 0.0) + trust))
            ends = np.append(change, -1.0)
            costs[i] += float(ends @ product @ ends)
    none = float(total[p, p])
    best = int(np.argmin(costs))
    return float(_TRUSTS[best] * unit) if costs[best] < (1.0 - _GAIN) * none else np.inf
