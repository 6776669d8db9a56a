"""Filters of least error variance for a random residual and noise of x, beside the unbeaten Kalman filter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import control as ct
import numpy as np
from scipy.linalg import solve_continuous_are, solve_discrete_are
from scipy.signal import ss2tf

from ..._sections import FloatArray
from ...analysis.variance import Variance, discretised, error_variance
from ...filter import PhyFilter
from ...results import Result, SearchResult
from ...values import Gaussian
from ...values.disturbance import shaping
from .shapes import at_speed, best_shape, starts

__all__ = ["LeastVariance", "kalman_filter", "kalman_variance", "least_variance"]

# A higher order that is better by less than this is not taken.
_WORTH_AN_ORDER = 1e-3

Shape = ct.StateSpace | ct.TransferFunction


@dataclass(frozen=True, eq=False, repr=False)
class LeastVariance(Result, SearchResult[PhyFilter]):
    """A filter of least error variance; made by :func:`least_variance`.

    Attributes
    ----------
    filter : PhyFilter
        Continuous; sample it with ``dt`` where one was given.
    variance : Variance
    kalman : float
        Error variance of the steady-state Kalman filter for the same data: no causal filter has less.
    """

    filter: PhyFilter
    variance: Variance
    kalman: float

    @property
    def best(self) -> PhyFilter:
        """``filter``: what every search calls what it found."""
        return self.filter

    @property
    def ratio(self) -> float:
        """Error variance over the Kalman filter's, 1 or more."""
        return self.variance.error / self.kalman


def least_variance(
    order: int, *, residual: Shape, noise: float, dt: float | None = None, type: int = 1
) -> LeastVariance:
    """The filter of a form with the least variance of f - f_hat.

    Parameters
    ----------
    order : int
        Largest order of D, 1 to 6, above the type unless ``dt`` is given (white noise through s F needs it); a lower
        one that is as good to 0.1 % is returned.
    residual : control system
        Shaping filter of gamma from unit white noise, see :func:`gauss_markov`.
    noise : float
        Of x: square root of its power density (continuous) or standard deviation of a sample (with ``dt``).
    dt : float, optional
        Sampling interval in seconds, for a filter used with ``sampled(dt)``.
    type : int
        Zeros of 1 - F at s = 0; 1 is the low-pass form. For the general form see :func:`kalman_filter`.

    Returns
    -------
    LeastVariance

    Raises
    ------
    ValueError
        As :func:`error_variance`, or for an order out of range or a noise of 0.

    Examples
    --------
    >>> from phyfilter_ctl import gauss_markov
    >>> found = least_variance(2, residual=gauss_markov(1.0, 0.5), noise=0.01)
    >>> 1.0 <= found.ratio < 1.1
    True
    """
    if not 1 <= order <= 6 or not 1 <= type <= order:
        raise ValueError(f"expected an order 1 to 6 and a type 1 to the order, got {order} and {type}")
    if not noise > 0.0:
        raise ValueError("noise: expected a positive noise; without any the fastest filter is best")
    if dt is None and type == order:
        raise ValueError(
            f"noise: white noise has an infinite variance through s F of order {order} and type {type}: give dt, a "
            "higher order or a lower type"
        )
    kalman = kalman_variance(residual=residual, noise=noise, dt=dt)

    def variance(filter: PhyFilter) -> Variance:
        return error_variance(filter if dt is None else filter.sampled(dt), Gaussian(residual, noise=noise))

    best: PhyFilter | None = None
    for n in range(type + (dt is None), order + 1):
        found = _least(n, type, dt, lambda filter: variance(filter).error)
        if best is None or variance(found).error < (1.0 - _WORTH_AN_ORDER) * variance(best).error:
            best = found
    assert best is not None
    return LeastVariance(best, variance(best), kalman)


def _least(order: int, type: int, dt: float | None, cost: Callable[[PhyFilter], float]) -> PhyFilter:
    """Best filter of one order: the speed is one more coordinate of the shape, from a scan over all speeds."""
    first: list[FloatArray] = []
    for start in starts(order):
        speeds = np.geomspace(1e-3, 1e4 if dt is None else 3.0 / dt, 40)
        costs = [cost(at_speed(start, order, type, w)) for w in speeds]
        first.append(np.append(start, np.log(speeds[int(np.argmin(costs))])))
    center = np.mean([start[-1] for start in first])

    def filter_of(parameters: FloatArray) -> PhyFilter:
        return at_speed(parameters[:-1], order, type, float(np.exp(parameters[-1] + center)))

    relative = [np.append(start[:-1], start[-1] - center) for start in first]
    best, _ = best_shape(lambda p: cost(filter_of(p)), relative, free=1)
    return filter_of(best)


def kalman_filter(*, residual: Shape, noise: float) -> PhyFilter:
    """The steady-state Kalman filter of x' = gamma, measured in white noise: a PhyFilter of general form.

    Parameters
    ----------
    residual : control system
        Shaping filter of gamma, of m states.
    noise : float
        Square root of the power density of the noise of x.

    Returns
    -------
    PhyFilter
        Of order m + 1.

    Raises
    ------
    ValueError
        For a noise of 0 or an unsuitable shaping filter.

    Examples
    --------
    For a residual that hardly forgets, two Butterworth poles at (deviation sqrt(2/time constant) / noise)^(1/2):

    >>> from phyfilter_ctl import gauss_markov
    >>> filter = kalman_filter(residual=gauss_markov(100.0, 1e6), noise=0.001)
    >>> abs(filter.poles).round(2).tolist(), round(filter.dc_gain, 3)
    ([11.89, 11.89], 1.0)
    """
    A, Q, C, H = _motion(residual)
    P = np.asarray(solve_continuous_are(A.T, H.T, Q, [[_positive(noise) ** 2]]))
    L = P @ H.T / noise**2
    closed = A - L @ H
    numerator, _ = ss2tf(closed, L, C, np.zeros((1, 1)))
    # s F = N s / D: the row from s^n down to s^0, whose last entry is 0.
    b = np.asarray(numerator)[0, 1:-1][::-1]
    return PhyFilter.from_poles(np.linalg.eigvals(closed), np.append(b, 0.0))


def kalman_variance(*, residual: Shape, noise: float, dt: float | None = None) -> float:
    """Error variance of the steady-state Kalman filter.

    Parameters
    ----------
    residual, noise, dt
        As for :func:`least_variance`.

    Returns
    -------
    float
        Of gamma at a sample given x up to that sample; of gamma(t) given x up to t without ``dt``.

    Raises
    ------
    ValueError
        As :func:`kalman_filter`.

    Examples
    --------
    >>> from phyfilter_ctl import gauss_markov
    >>> round(kalman_variance(residual=gauss_markov(1.0, 0.5), noise=0.01), 4)
    0.3292
    """
    A, Q, C, H = _motion(residual)
    R = np.array([[_positive(noise) ** 2]])
    if dt is None:
        P = np.asarray(solve_continuous_are(A.T, H.T, Q, R))
        return float((C @ P @ C.T).item())
    step, covariance = discretised(A, Q, dt)
    P = np.asarray(solve_discrete_are(step.T, H.T, covariance, R))
    P = P - P @ H.T @ np.linalg.solve(H @ P @ H.T + R, H @ P)
    return float((C @ P @ C.T).item())


def _motion(residual: Shape) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """A, noise density Q, row of gamma and row of x of the process and its integral x."""
    shape = shaping("residual", residual)
    m = shape.nstates
    A, B, row = np.asarray(shape.A), np.asarray(shape.B), np.asarray(shape.C)
    joint = np.block([[A, np.zeros((m, 1))], [row, np.zeros((1, 1))]])
    Q = np.zeros((m + 1, m + 1))
    Q[:m, :m] = B @ B.T
    return joint, Q, np.append(row, 0.0)[None, :], np.eye(m + 1)[-1:]


def _positive(noise: float) -> float:
    if not (np.isfinite(noise) and noise > 0.0):
        raise ValueError(f"noise: expected a positive number, got {noise}")
    return noise
