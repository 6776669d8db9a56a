"""Filters from what must hold: the least worst-case error for bounds of the residual and of the noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
from threadpoolctl import threadpool_limits

from ...analysis.bounds import ErrorBound, error_bound
from ...filter import PhyFilter
from ...results import Result, SearchResult, Status
from ...values import Bounded
from ..learning import Form
from ..placement import place_poles
from .floor import error_floor
from .worst_case import Active, WorstCase

__all__ = ["LeastBound", "least_bound"]

# A higher order that is better by less than this is not taken.
_WORTH_AN_ORDER = 1e-3


@dataclass(frozen=True, eq=False, repr=False)
class LeastBound(Result, SearchResult[PhyFilter]):
    """A filter with the least worst-case error; made by :func:`least_bound`.

    Attributes
    ----------
    filter : PhyFilter
    bound : ErrorBound
        What it promises.
    floor : float
        Worst-case error that no causal estimator can do without, see :func:`error_floor`.
    ratio : float
        Bound over floor, what a wrong inertia adds to the bound left out; infinite without noise.
    active : {"none", "noise_limit", "accept", "fastest"}
        What kept it from being faster.
    status : Status
        CONVERGED or ORDER_ADDS_NOTHING.
    message : str
        The status in words, how far the bound is above the floor, and what to try.
    """

    _figures = ("filter", "bound", "floor", "ratio", "active", "status", "message")

    filter: PhyFilter
    bound: ErrorBound
    floor: float
    active: Active
    status: Status
    message: str

    @property
    def best(self) -> PhyFilter:
        """``filter``: what every search calls what it found."""
        return self.filter

    @property
    def ratio(self) -> float:
        """Bound over floor."""
        return (self.bound.intrinsic + self.bound.noise) / self.floor if self.floor > 0.0 else float("inf")


def least_bound(
    order: int,
    *,
    residual: Mapping[int, float],
    noise: float = 0.0,
    inertia_error: float = 0.0,
    rate: float = 0.0,
    inertia: float = 1.0,
    form: Form = "lowpass",
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
        delta_k: bounds of derivatives of gamma, as for :func:`error_bound`; at least one of order 1 ... type.
    noise, inertia_error, rate, inertia : float
        As for :func:`error_bound`.
    form : {"lowpass", "general"}
        Whether N has the ``type`` lowest coefficients of D and no more, or any others besides.
    type : int
        Zeros of 1 - F at s = 0: F(0) = 1 in any case.
    noise_limit : float, optional
        Largest part of the bound that noise may have.
    accept : callable, optional
        Whether a filter may be used, e.g.
        ``lambda f: pf.margins(f, loop).modulus_margin > 0.5``; expected to hold for slow
        filters and to fail from some speed on. Where it binds, the search takes some thousand calls of it.
    fastest : float, optional
        Largest geometric mean of the poles in rad/s.

    Returns
    -------
    LeastBound

    Raises
    ------
    ValueError
        For an order, type or form out of range, or where nothing keeps the filter from being infinitely fast.

    Notes
    -----
    For poles of geometric mean w and a shape of theirs, the parts scale as w^-k, w and 1. So the best speed of a
    shape is known in closed form, and one search over shapes (L-BFGS-B, from the binomial, Butterworth and Bessel
    ones) serves every ratio of the bounds. The bound is smooth in a shape and, for given poles, convex in N. Only
    what the search ends with is certified. With several derivatives it is the best of the best for each of them.

    Examples
    --------
    First order: delta_1 / w + 2 w nu is least at w = sqrt(delta_1 / (2 nu)).

    >>> found = least_bound(1, residual={1: 8.0}, noise=0.01)
    >>> round(float(found.filter.a[0]), 3), round(found.bound.bound, 4)
    (20.0, 0.8)

    A general numerator comes close to what is possible at all:

    >>> print(least_bound(3, residual={1: 8.0}, noise=0.01, form="general").message)
    order 3: no lower order does as well; 7.4 % above what no causal estimator can beat
    """
    if not 1 <= order <= 6:
        raise ValueError(f"order: expected 1 to 6, got {order}")
    if not 1 <= type <= order:
        raise ValueError(f"type: expected 1 to the order {order}, got {type}")
    slopes = {k: v for k, v in residual.items() if 1 <= k <= type and v > 0.0}
    if not slopes:
        raise ValueError(
            f"residual: expected a positive bound of a derivative of order 1 ... {type}, got {dict(residual)}; without "
            "one no speed of the filter is better than another"
        )
    if form not in get_args(Form):
        raise ValueError(f"form: expected one of {', '.join(get_args(Form))}, got {form!r}")

    bounds = Bounded(residual, noise=noise, inertia_error=inertia_error, rate=rate)

    def bound_of(filter: PhyFilter) -> ErrorBound:
        return error_bound(filter, bounds, inertia=inertia)

    bound_of(place_poles(-np.ones(type), type=type))  # refuses bounds that are none
    if noise == 0.0 and fastest is None and accept is None:
        raise ValueError(
            "nothing keeps the filter from being infinitely fast: give the noise, accept (a margin) or fastest"
        )
    cases = [
        WorstCase(k, delta, noise * inertia, inertia_error * rate, noise_limit, fastest)
        for k, delta in slopes.items()
    ]
    best: tuple[PhyFilter, Active, float] | None = None
    with threadpool_limits(1, user_api="blas"):  # many small products, slower on several threads
        for n in range(type, order + 1):
            free = n - type if form == "general" else 0
            found = min((case.least(n, type, free, accept) for case in cases), key=lambda each: each[2])
            if best is None or found[2] < (1.0 - _WORTH_AN_ORDER) * best[2]:
                best = found
    assert best is not None
    filter, active, _ = best
    bound = bound_of(filter)
    if noise_limit is not None and bound.noise > noise_limit:  # by what the search's gains were too small
        filter = filter.faster(noise_limit / bound.noise)
        bound = bound_of(filter)
    result = LeastBound(
        filter,
        bound,
        error_floor(residual=residual, noise=noise, inertia=inertia),
        active,
        Status.CONVERGED if filter.order == order else Status.ORDER_ADDS_NOTHING,
        "",
    )
    return replace(result, message=_message(result, order, form == "lowpass" and order > type))


def _message(found: LeastBound, order: int, narrow: bool) -> str:
    """How the search ended, and how far from what is possible; ``narrow``: the general form has more to offer."""
    n = found.filter.order
    said = [f"order {n}: no lower order does as well"]
    if n < order:
        said = [f"order {n} suffices: order {order} is not better by 0.1 %"]
    if found.floor > 0.0:
        above = f"{100.0 * (found.ratio - 1.0):.1f} % above what no causal estimator can beat"
        said.append(above + (", form='general' comes closer" if narrow else ""))
    alone = found.bound.residual.get(0, np.inf)
    if alone <= found.bound.bound:
        said.append(f"f_hat = f_theta, no filter, errs by no more than {alone:g}")
    return "; ".join(said)
