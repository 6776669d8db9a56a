"""Tuning of a filter of given order on flights with a learned estimate that has not seen them.

    minimise over the poles, and over N where it is free,   sum_k |f_hat_k - f_k|^2

The poles are the logarithms of a first-order and second-order sections, so D is Hurwitz wherever the search goes. f_hat
is linear in N: with a free numerator (b_0 = a_0, so that F(0) = 1) b_1 ... b_{n-1} follow from least squares for every
choice of poles (variable projection).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from phyfilter_ctl.filter import FilterBank, PhyFilter, SampledPhyFilter
from phyfilter_ctl.recording import Recording

from .differentiator import counted, labels
from .params import params
from .scores import root_mean

__all__ = ["Case", "TunedFilter", "filtered", "rmse", "squares", "tune_filters"]

FloatArray = NDArray[np.float64]

_STEP = 0.5  # of the first simplex, in the logarithm of a frequency: a factor of 1.6
_TOLERANCE = 0.02  # of the logarithms: poles to 2 %, far finer than the minimum is sharp
_RELATIVE_COST = 1e-4


@dataclass(frozen=True)
class Case:
    """A flight and a learned estimate of its acceleration.

    Attributes
    ----------
    log : Recording
        With label.
    f_theta : (N, n_x) array
    """

    log: Recording
    f_theta: FloatArray


@dataclass(frozen=True)
class TunedFilter:
    """A filter and how it was found.

    Attributes
    ----------
    filter : PhyFilter
    form : {"lowpass", "general"}
        N = a_0, or b_0 = a_0 and the rest of N free.
    tuning_rmse : float
        Of f_hat on the flights tuned on, m/s^2.
    evaluations : int
    """

    filter: PhyFilter
    form: Literal["lowpass", "general"]
    tuning_rmse: float
    evaluations: int


def filtered(
    filter: PhyFilter | FilterBank | SampledPhyFilter, cases: Sequence[Case], dt: float
) -> list[FloatArray]:
    """f_hat (N, n_x) of each flight: x = v, g = 0, M = 1; at its own times where they are not every ``dt``."""
    sampled = filter if isinstance(filter, SampledPhyFilter) else filter.sampled(dt)
    estimates = []
    for case in cases:
        uniform = case.log.is_uniform and np.isclose(case.log.dt, sampled.dt, rtol=1e-6)
        f_hat = sampled.run(case.log.x, f_theta=case.f_theta, times=None if uniform else case.log.times)
        estimates.append(np.asarray(f_hat, dtype=float))
    return estimates


def squares(estimates: Sequence[FloatArray], logs: Sequence[Recording]) -> FloatArray:
    """By flight (flights, 2): sum of squared errors over the samples that count and all axes, and how many."""
    errors = [(e - labels(log))[counted(log)] for e, log in zip(estimates, logs, strict=True)]
    return np.array([[float(np.sum(error**2)), error.size] for error in errors])


def rmse(estimates: Sequence[FloatArray], logs: Sequence[Recording]) -> float:
    """Root-mean-square error over all samples that count and all axes, m/s^2."""
    return root_mean(squares(estimates, logs))


def tune_filters(
    orders: Sequence[int], cases: Sequence[Case], dt: float, *, evaluations: int | None = None
) -> dict[int, TunedFilter]:
    """Filters of the given orders with the least RMSE on these flights.

    Every order is searched in the low-pass form and in the general one, each from the result of the order below and
    from a few other starts; the general one is kept where it is worth it.

    Parameters
    ----------
    orders : sequence of int
        From 1, rising by 1, at most 3.
    cases : sequence of Case
        Flights that the learned model has not seen.
    dt : float
        Nominal sampling interval, s.
    evaluations : int, optional
        Of the cost for each start; None means the figure in ``params.toml``.

    Raises
    ------
    ValueError
        If the orders are others.
    """
    if list(orders) != list(range(1, len(orders) + 1)) or not 1 <= len(orders) <= 3:
        raise ValueError(f"orders: expected 1, 1 2 or 1 2 3, got {list(orders)}")
    limit = params().filter.evaluations if evaluations is None else evaluations
    found: dict[str, dict[int, _Found]] = {"lowpass": {}, "general": {}}
    makers: dict[str, _Maker] = {"lowpass": _lowpass, "general": _general}
    chosen: dict[int, TunedFilter] = {}
    for n in orders:
        for form, make in makers.items():
            if n == 1 and form == "general":
                found[form][1] = found["lowpass"][1]  # N has one coefficient only
                continue
            before = found[form][n - 1].point if n > 1 else np.zeros(0)
            found[form][n] = _search(n, make, cases, dt, _starts(n, before, dt), limit)
        plain, general = found["lowpass"][n], found["general"][n]
        better = general.cost < (1.0 - params().filter.worthwhile) * plain.cost
        best = general if better else plain
        chosen[n] = TunedFilter(
            best.filter,
            "general" if better else "lowpass",
            best.cost,
            plain.evaluations + (general.evaluations if n > 1 else 0),
        )
    return chosen


@dataclass(frozen=True)
class _Found:
    filter: PhyFilter
    point: FloatArray
    cost: float
    evaluations: int


_Maker = Callable[[FloatArray, Sequence[Case], float], PhyFilter]


def _poles(point: FloatArray) -> NDArray[np.complex128]:
    """Poles from (log p), (log w, log zeta) or (log w, log zeta, log p)."""
    if len(point) == 1:
        return np.array([-np.exp(point[0])], dtype=np.complex128)
    w, zeta = np.exp(point[:2])
    root = np.emath.sqrt(zeta**2 - 1.0)
    pair = np.array([-w * (zeta - root), -w * (zeta + root)], dtype=np.complex128)
    return np.concatenate([pair, -np.exp(point[2:])])


def _lowpass(point: FloatArray, cases: Sequence[Case], dt: float) -> PhyFilter:
    return PhyFilter.from_poles(_poles(point))


def _general(point: FloatArray, cases: Sequence[Case], dt: float) -> PhyFilter:
    """The best b_1 ... b_{n-1} for these poles."""
    base = PhyFilter.from_poles(_poles(point))
    n = base.order
    # In powers of the mean pole the columns are of one size.
    powers = base.a[0] ** (1.0 - np.arange(n) / n)
    # Each s^i / D alone, driven by the same residual.
    alone = [PhyFilter.from_poles(base.poles, powers * (np.arange(n) == i)) for i in range(1, n)]
    kept = [counted(case.log) for case in cases]
    theta = [case.f_theta for case in cases]
    columns = [
        np.concatenate(
            [(y - f)[k].ravel() for y, f, k in zip(filtered(part, cases, dt), theta, kept, strict=True)]
        )
        for part in alone
    ]
    wanted = np.concatenate(
        [
            (labels(case.log) - y)[k].ravel()
            for case, y, k in zip(cases, filtered(base, cases, dt), kept, strict=True)
        ]
    )
    weights = np.linalg.lstsq(np.stack(columns, axis=1), wanted, rcond=None)[0]
    b = base.b.copy()
    b[1:] = weights * powers[1:]
    return PhyFilter.from_poles(base.poles, b)


def _bounds(n: int, dt: float) -> FloatArray:
    """Lower and upper bounds (n, 2) of the point."""
    chosen = params().filter
    frequency = [chosen.slowest, chosen.fastest / dt]
    damping = [chosen.damping_low, chosen.damping_high]
    return np.log([frequency, damping, frequency][:n] if n > 1 else [frequency])


def _starts(n: int, before: FloatArray, dt: float) -> list[FloatArray]:
    """Points to search from; the order below enters with an added pole that is so fast as to do nothing."""
    fast = np.log(0.6 * params().filter.fastest / dt)
    if n == 1:
        return [np.log([w]) for w in (1.0, 5.0, 25.0)]
    if n == 2:
        (p,) = before
        return [np.array([p, 0.1]), np.array([0.5 * (p + fast), 1.0]), np.array([p + 0.5, -0.4])]
    w, zeta = before
    return [np.array([w, zeta, fast]), np.array([w, -0.3, fast - 1.5]), np.array([w + 0.5, zeta, w + 0.5])]


def _search(
    n: int, make: _Maker, cases: Sequence[Case], dt: float, starts: Sequence[FloatArray], limit: int
) -> _Found:
    bounds = _bounds(n, dt)
    logs = [case.log for case in cases]

    def cost(point: FloatArray) -> float:
        filter = make(point, cases, dt)
        return rmse(filtered(filter, cases, dt), logs)

    best_point, best_cost, evaluations = starts[0], np.inf, 0
    for start in starts:
        corner = np.clip(start, bounds[:, 0], bounds[:, 1])
        inward = np.where(corner + _STEP > bounds[:, 1], -_STEP, _STEP)
        found = minimize(
            cost,
            corner,
            method="Nelder-Mead",
            bounds=bounds,
            options={
                "initial_simplex": np.vstack([corner, corner + np.diag(inward)]),
                "maxfev": limit,
                "xatol": _TOLERANCE,
                "fatol": _RELATIVE_COST * cost(corner),
            },
        )
        evaluations += int(found.nfev) + 1
        if found.fun < best_cost:
            best_point, best_cost = np.asarray(found.x, dtype=float), float(found.fun)
    return _Found(make(best_point, cases, dt), best_point, best_cost, evaluations)
