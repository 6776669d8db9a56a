"""Descent on a smooth loss by L-BFGS, with its outcome in the words of a fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from .._sections import FloatArray
from ..results import Status

# What a loss that is not finite becomes, in units of the first one: the line search shortens its step.
_WALL = 1e10


@dataclass(frozen=True, eq=False)
class Descent:
    """Parameters (n,) where the descent ended, its last loss, and how it ended."""

    parameters: FloatArray
    loss: float
    iterations: int
    status: Status
    message: str


def descend(
    loss: Callable[[FloatArray], tuple[float, FloatArray]],
    start: FloatArray,
    *,
    max_iterations: int,
    tolerance: float,
) -> Descent:
    """Minimise ``loss``, which returns its value and its gradient.

    Parameters
    ----------
    loss : callable
        Parameters (n,) -> (value, gradient (n,)).
    start : (n,) array
        First parameters.
    max_iterations : int
        Most iterations.
    tolerance : float
        Largest entry of the gradient at which the descent stops.
    """
    # One thread: the products are narrow, and several are slower on a busy machine. Overflow is a step too far.
    with threadpool_limits(1, user_api="blas"), np.errstate(over="ignore", invalid="ignore"):
        first, slope = loss(start)
        if not (np.isfinite(first) and np.all(np.isfinite(slope))):
            return Descent(start, float("inf"), 0, Status.FAILED, "the loss is not finite at the start")
        wall = _WALL * (1.0 + abs(first))

        def guarded(parameters: FloatArray) -> tuple[float, FloatArray]:
            value, gradient = loss(parameters)
            if np.isfinite(value) and np.all(np.isfinite(gradient)):
                return value, gradient
            return wall, np.zeros_like(parameters)

        limits = {"maxiter": max_iterations, "maxfun": 20 * max_iterations, "gtol": tolerance, "ftol": 0.0}
        options = limits | {"maxcor": 30}
        end = minimize(guarded, start, jac=True, method="L-BFGS-B", options=options)
    parameters, value, iterations = np.asarray(end.x, dtype=float), float(end.fun), int(end.nit)
    if not value < wall:
        return Descent(start, float("inf"), iterations, Status.FAILED, "every step made the loss infinite")
    if end.success:
        return Descent(parameters, value, iterations, Status.CONVERGED, "converged")
    if iterations >= max_iterations:
        message = f"not converged in {iterations} iterations; raise max_iterations, tolerance or l2"
        return Descent(parameters, value, iterations, Status.ITERATION_LIMIT, message)
    message = "the optimiser found no further descent; usable, or scale the data, or raise tolerance"
    return Descent(parameters, value, iterations, Status.STALLED, message)
