"""Levenberg and Marquardt's descent in a box, for costs that bring their Gauss-Newton matrix along."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..._sections import FloatArray
from .sensitivity import Evaluation

_FIRST_DAMPING = 1e-3
_LEAST_DAMPING, _MOST_DAMPING = 1e-12, 1e10
# The unknowns are logarithms: no step changes a rate by more than a factor e^2.
_LONGEST_STEP = 2.0
# The descent is done once a step promises less than this of the cost.
_PROMISE = 1e-10
# A descent is still going down, and ends at the limit, where a step has given and the next promises more than this. The
# others are at their end, but may need some more steps to see it.
_GOING_DOWN = 1e-6


class Descent(NamedTuple):
    """Where a descent stands."""

    theta: FloatArray
    found: Evaluation
    iterations: int
    done: bool
    damping: float = _FIRST_DAMPING


def start(evaluate: Callable[[FloatArray], Evaluation | None], theta: FloatArray) -> Descent | None:
    """A descent before its first step; None where the start has no cost."""
    found = evaluate(theta)
    return None if found is None or not np.isfinite(found.cost) else Descent(theta, found, 0, False)


def descend(
    evaluate: Callable[[FloatArray], Evaluation | None],
    now: Descent,
    upper: FloatArray,
    lower: FloatArray,
    *,
    limit: int,
    negligible: float,
    report: Callable[[Descent], None],
) -> Descent:
    """Go on from ``now`` for at most ``limit`` steps.

    Parameters
    ----------
    evaluate : callable
        theta -> Evaluation, or None where there is no cost (as if it were infinite).
    now : Descent
    upper, lower : (n,) arrays
        The box. A start outside is not moved in; it may only come closer.
    limit : int
        Twice as many, at most, while they lower the cost by next to nothing.
    negligible : float
        Cost at which the fit is exact to rounding.
    report : callable
        Called after every step that lowered the cost.

    Notes
    -----
    Damping after Nielsen, IMM-REP-1999-05; the diagonal scaling is Marquardt's. Unknowns at a bound that the gradient
    pushes against are left out of the step.
    """
    theta, found, done, damping = now.theta, now.found, now.done, now.damping
    upper, lower = np.maximum(upper, theta), np.minimum(lower, theta)
    iterations, growth, gained = now.iterations, 2.0, 0.0
    while not done:
        free = ~bound(theta, found.gradient, upper, lower)
        # A cost at rounding may be negative, with a curvature that is none.
        if not np.any(free) or found.cost <= negligible:
            done = True
            break
        step = _step(found, free, damping)
        trial = np.clip(theta + step, lower, upper)
        step = trial - theta
        promised = -float(found.gradient @ step + 0.5 * step @ found.curvature @ step)
        if promised <= _PROMISE * found.cost:
            done = True
            break
        taken = iterations - now.iterations
        if taken > limit and (taken >= 2 * limit or min(gained, promised) > _GOING_DOWN * found.cost):
            break
        iterations += 1
        reached = evaluate(trial)
        gained = found.cost - reached.cost if reached is not None else -np.inf
        if reached is None or not gained > 0.0:
            damping *= growth
            growth *= 2.0
            done = damping > _MOST_DAMPING
            continue
        trust = 1.0 - (2.0 * gained / promised - 1.0) ** 3
        damping = max(damping * max(1.0 / 3.0, trust), _LEAST_DAMPING)
        theta, found, growth = trial, reached, 2.0
        report(Descent(theta, found, iterations, False, damping))
    return Descent(theta, found, iterations, done, damping)


def bound(theta: FloatArray, gradient: FloatArray, upper: FloatArray, lower: FloatArray) -> np.ndarray:
    """Which unknowns (n,) lie on the box with the cost falling outwards."""
    return ((theta >= upper) & (gradient < 0.0)) | ((theta <= lower) & (gradient > 0.0))


def _step(found: Evaluation, free: np.ndarray, damping: float) -> FloatArray:
    curvature = found.curvature[free][:, free]
    sizes = np.sqrt(np.maximum(np.diag(curvature), 1e-30 * max(found.cost, np.finfo(float).tiny)))
    values, vectors = np.linalg.eigh(curvature / np.outer(sizes, sizes))
    slope = vectors.T @ (found.gradient[free] / sizes)
    step = np.zeros(len(found.gradient))
    step[free] = -(vectors @ (slope / (np.maximum(values, 0.0) + damping))) / sizes
    return step * min(1.0, _LONGEST_STEP / max(float(np.max(np.abs(step))), np.finfo(float).tiny))
