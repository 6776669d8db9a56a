"""Filters from what must hold: the least worst-case error for bounds of the residual and of the noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import control as ct
import numpy as np

from ..._sections import FloatArray
from ...analysis.bounds import BoundResult, ultimate_bound
from ...filter import PhyFilter
from ...results import Result, Status
from .shapes import at_speed, best_shape, starts

__all__ = ["LeastBound", "TradeOff", "bound_trade_off", "least_bound"]


Active = Literal["none", "noise_limit", "accept", "fastest"]
# A higher order that is better by less than this is not taken.
_WORTH_AN_ORDER = 1e-3


@dataclass(frozen=True, eq=False, repr=False)
class LeastBound(Result):
    """A filter with the least worst-case error; made by :func:`least_bound`.

    Attributes
    ----------
    filter : PhyFilter
    bound : BoundResult
        What it promises.
    active : {"none", "noise_limit", "accept", "fastest"}
        What kept it from being faster.
    status : Status
        CONVERGED or ORDER_ADDS_NOTHING.
    message : str
        The status in words, and what to try.
    """

    filter: PhyFilter
    bound: BoundResult
    active: Active
    status: Status
    message: str


def least_bound(
    order: int,
    *,
    residual: Mapping[int, float],
    noise: float = 0.0,
    inertia_error: float = 0.0,
    rate: float = 0.0,
    inertia: float = 1.0,
    type: int = 1,
    noise_limit: float | None = None,
    accept: Callable[[PhyFilter], bool] | None = None,
    fastest: float | None = None,
) -> LeastBound:
    """The filter whose bound of |f - f_hat| is least.

    Parameters
    ----------
    order : int
        Largest order of D, 1 to 6; a lower one that is as good to 0.1 % is returned.
    residual : dict of int to float
        delta_k: bounds of derivatives of gamma, as for :func:`ultimate_bound`; at least one of order 1 ... type.
    noise, inertia_error, rate, inertia : float
        As for :func:`ultimate_bound`.
    type : int
        Zeros of 1 - F at s = 0; 1 is the low-pass form.
    noise_limit : float, optional
        Largest part of the bound that noise may have.
    accept : callable, optional
        Whether a filter may be used, e.g.
        ``lambda f: pf.prior_margin(f, actuator=act, delay=0.02).modulus_margin > 0.5``; expected to hold for slow
        filters and to fail from some speed on.
    fastest : float, optional
        Largest geometric mean of the poles in rad/s.

    Returns
    -------
    LeastBound

    Raises
    ------
    ValueError
        For an order or type out of range, or where nothing keeps the filter from being infinitely fast.

    Notes
    -----
    For poles of geometric mean w and a shape of theirs, the parts scale as w^-k, w and 1. So the best speed of a
    shape is known in closed form, and one search over shapes (Nelder and Mead's, from the binomial, Butterworth and
    Bessel ones) serves every ratio of the bounds.

    Examples
    --------
    First order: delta_1 / w + 2 w nu is least at w = sqrt(delta_1 / (2 nu)).

    >>> found = least_bound(1, residual={1: 8.0}, noise=0.01)
    >>> round(float(found.filter.a[0]), 3), round(found.bound.bound, 4)
    (20.0, 0.8)
    """
    if not 1 <= order <= 6:
        raise ValueError(f"order: expected 1 to 6, got {order}")
    if not 1 <= type <= order:
        raise ValueError(f"type: expected 1 to the order {order}, got {type}")
    slopes = {k: v for k, v in residual.items() if 1 <= k <= type}
    if not slopes or not any(v > 0.0 for v in slopes.values()):
        raise ValueError(
            f"residual: expected a positive bound of a derivative of order 1 ... {type}, got {dict(residual)}; without "
            "one no speed of the filter is better than another"
        )
    if noise <= 0.0 and fastest is None and accept is None:
        raise ValueError(
            "nothing keeps the filter from being infinitely fast: give the noise, accept (a margin) or fastest"
        )

    def bound_of(filter: PhyFilter) -> BoundResult:
        return ultimate_bound(
            filter, residual=residual, noise=noise, inertia_error=inertia_error, rate=rate, inertia=inertia
        )

    def speed_of(shape: FloatArray, n: int) -> tuple[float, Active]:
        unit = at_speed(shape, n, type, 1.0)
        gains = ultimate_bound(unit, residual=slopes, noise=noise, inertia=inertia)
        choices: list[tuple[float, Active]] = [(np.inf, "none")]
        if noise > 0.0:
            # min_k is a minimum of functions, each with its own best speed: the least of their values wins.
            best = [(k * gains.gains[k] * d / gains.noise) ** (1.0 / (k + 1)) for k, d in slopes.items() if d]
            values = [
                min(gains.gains[k] * d / w**k for k, d in slopes.items() if d) + gains.noise * w for w in best
            ]
            choices.append((best[int(np.argmin(values))], "none"))
            if noise_limit is not None:
                choices.append((noise_limit / gains.noise, "noise_limit"))
        if fastest is not None:
            choices.append((fastest, "fastest"))
        return min(choices)

    def limited(shape: FloatArray, n: int) -> tuple[PhyFilter, Active]:
        speed, why = speed_of(shape, n)
        if accept is None:
            return at_speed(shape, n, type, speed), why
        return _accepted(lambda w: at_speed(shape, n, type, w), accept, speed, why)

    best: LeastBound | None = None
    for n in range(type, order + 1):
        shape, _ = best_shape(lambda s, n=n: bound_of(limited(s, n)[0]).bound, starts(n))
        filter, why = limited(shape, n)
        bound = bound_of(filter)
        if best is None or bound.bound < (1.0 - _WORTH_AN_ORDER) * best.bound.bound:
            best = LeastBound(filter, bound, why, Status.CONVERGED, f"order {n}: no lower order does as well")
    assert best is not None
    if best.filter.order < order:
        message = f"order {best.filter.order} suffices: order {order} is not better by 0.1 %"
        best = replace(best, status=Status.ORDER_ADDS_NOTHING, message=message)
    return best


def _accepted(
    make: Callable[[float], PhyFilter], accept: Callable[[PhyFilter], bool], speed: float, why: Active
) -> tuple[PhyFilter, Active]:
    """The fastest filter up to ``speed`` that is accepted, to 0.1 %."""
    high = speed if np.isfinite(speed) else 1e6
    if accept(make(high)):
        return make(high), why
    low = high
    for _ in range(60):
        low *= 0.5
        if accept(make(low)):
            break
    else:
        raise ValueError("accept: refuses filters of every speed; a margin that no filter has cannot be met")
    while high / low > 1.001:
        middle = np.sqrt(low * high)
        low, high = (middle, high) if accept(make(middle)) else (low, middle)
    return make(low), "accept"


@dataclass(frozen=True, eq=False, repr=False)
class TradeOff(Result):
    """Designs from slow to fast; made by :func:`bound_trade_off` and by ``variance_trade_off``.

    Attributes
    ----------
    filters : tuple of PhyFilter
    following : (m,) array
        Error from the residual: bound, or standard deviation.
    noise : (m,) array
        Error from the noise of x, in the same sense.
    label : str
        What the two are.
    """

    filters: tuple[PhyFilter, ...]
    following: FloatArray
    noise: FloatArray
    label: str

    @property
    def best(self) -> int:
        """Index of the design whose sum is least."""
        return int(np.argmin(self.following + self.noise))

    def plot(self) -> ct.ControlPlot:
        """Error from the noise against error from the residual.

        Returns
        -------
        control.ControlPlot
        """
        from ... import plots

        return plots.trade_off_plot(self.following, self.noise, self.best, self.label)


def bound_trade_off(
    order: int,
    *,
    residual: Mapping[int, float],
    noise: float,
    type: int = 1,
    inertia: float = 1.0,
    points: int = 100,
) -> TradeOff:
    """Worst-case error from the residual against that from the noise, over best designs.

    Parameters
    ----------
    order, residual, noise, type, inertia
        As for :func:`least_bound`, with one derivative bounded.
    points : int
        Number of designs.

    Returns
    -------
    TradeOff
        From slow to fast, within a factor of 10 of the best sum on both sides.

    Raises
    ------
    ValueError
        As :func:`least_bound`, and unless one derivative is bounded and the noise positive.

    Notes
    -----
    With one bounded derivative all best designs have one shape: the one of the least G^(1/(k+1)) N^(k/(k+1)).

    Examples
    --------
    >>> curve = bound_trade_off(2, residual={1: 8.0}, noise=0.01, points=5)
    >>> bool((np.diff(curve.following) < 0).all() and (np.diff(curve.noise) > 0).all())
    True
    """
    if len(residual) != 1 or not noise > 0.0:
        raise ValueError(
            "expected one bounded derivative and a positive noise: else the designs have no common shape"
        )
    if points < 2:
        raise ValueError(f"points: expected 2 or more, got {points}")
    found = least_bound(order, residual=residual, noise=noise, type=type, inertia=inertia)
    ((k, _),) = residual.items()
    factors = np.geomspace(10.0 ** (-1.0 / k), 10.0, points)
    filters = tuple(found.filter.faster(factor) for factor in factors)
    return TradeOff(
        filters,
        found.bound.intrinsic * factors ** -float(k),
        found.bound.noise * factors,
        f"bound from |gamma^({k})| and |nu|",
    )
