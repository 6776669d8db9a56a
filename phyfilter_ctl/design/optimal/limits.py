"""Filters within limits: poles and zeros under bounds of |F| and |1 - F| and margins of the loop, along a front."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from ..._sections import FloatArray
from ...filter import PhyFilter
from ...plots import FrequencyLimit
from ...results import Result, Status
from ..learning import Form
from .limit_search import Measures, Wanted, measured, verified
from .shapes import at_speed, starts

__all__ = ["LimitsFront", "Trade", "limits_front"]

Trade = Literal["noise", "margin"]

_STARTS = 3  # random shapes besides those of the families
_SPEEDS = 24  # from which every shape starts, over
_DECADES = 2.0  # to either side of what the limits speak of
_KEPT = 4  # starts that are followed to the end
_ITERATIONS = 60
_SLACK = 1e-3  # relative: within it a limit counts as kept
_SPREAD = 0.6  # of random shapes, in the logarithm
_STEP = 1e-6  # of a difference
_REPAIRS = 3
_SHAPE, _ROOM = math.log(8.0), math.log(1e6)


@dataclass(frozen=True, eq=False, repr=False)
class LimitsFront(Result):
    """Filters that keep limits, none of which is better in both respects; made by :func:`limits_front`.

    Attributes
    ----------
    filters : tuple of PhyFilter
        From slow to fast; none where no filter was found.
    noise : (m,) array
        Deviation of f_hat per deviation of white noise on the samples of x, in 1/s.
    bound : (m,) array
        Worst-case error per unit of the residual's slope, ||(1 - F)/s||_1, in s.
    bandwidth : (m,) array
        Upper edge of the band of F in rad/s.
    delay_margin : (m,) array
        Of the sampled loop, in s; infinite where no delay makes it unstable.
    tried : int
        Starts of the search.
    certain : bool
        Whether an empty result is proven: no filter of the order and form, or none at all, as the message says.
    status : Status
        CONVERGED, INFEASIBLE or CANCELLED.
    message : str
        How the search ended, and where nothing was found what stood against it.
    """

    _figures = ("noise", "bound", "bandwidth", "delay_margin", "tried", "certain", "status", "message")

    filters: tuple[PhyFilter, ...]
    noise: FloatArray
    bound: FloatArray
    bandwidth: FloatArray
    delay_margin: FloatArray
    tried: int
    certain: bool
    status: Status
    message: str


def limits_front(
    order: int,
    *,
    dt: float,
    limits: Sequence[FrequencyLimit] = (),
    type: int = 1,
    form: Form = "lowpass",
    actuator_lag: float = 0.0,
    delay: float = 0.0,
    delay_margin: float = 0.0,
    inertia_ratios: tuple[float, float] = (1.0, 1.0),
    trade: Trade = "noise",
    points: int = 9,
    callback: Callable[[int, int], bool] | None = None,
) -> LimitsFront:
    """Filters under limits in the frequency domain and margins of the loop, from one end of a trade-off to the other.

    Parameters
    ----------
    order : int
        Order of D, 1 to 6.
    dt : float
        Sampling interval in s.
    limits : sequence of FrequencyLimit
        What |F| and |1 - F| must stay below.
    type : int
        Zeros of 1 - F at s = 0, 1 to the order.
    form : {"lowpass", "general"}
        Whether N has the ``type`` lowest coefficients of D and no more, or its zeros are searched as well.
    actuator_lag, delay : float
        First-order lag and delay in s of what acts on f_hat.
    delay_margin : float
        Delay in s that the loop must tolerate besides, at M_hat/M = 1.
    inertia_ratios : tuple of float
        Range of constant M_hat/M, around 1, over which the loop must be stable.
    trade : {"noise", "margin"}
        Noise against the worst-case error, or bandwidth against the delay margin.
    points : int
        Number of filters along the front.
    callback : callable, optional
        Called with how many steps are done, and of how many; True ends the search.

    Returns
    -------
    LimitsFront
        Every filter in it was checked, sampled, with :func:`~phyfilter_ctl.margins` and on a fine grid
        of each limit's frequencies; what did not hold there is left out.

    Raises
    ------
    ValueError
        If an argument is out of its range.

    Notes
    -----
    Sequential quadratic programming over the shape of poles and zeros and their speed, from well-known families and
    random shapes at the best of many speeds: one respect is made best while the other is held at each of ``points``
    values between the ends (the epsilon-constraint method, Y. Y. Haimes, L. S. Lasdon and D. A. Wismer, IEEE Trans.
    SMC 1, 1971). The search is local: an empty result is certain only where |F| + |1 - F| >= 1 forbids the limits at
    some frequency, or for one pole, whose speed has an interval in closed form.

    Examples
    --------
    One pole at w: |1 - F| <= 0.1 up to 1 rad/s asks for w >= sqrt(99), |F| <= 0.5 from 100 rad/s on for
    w <= 100 / sqrt(3).

    >>> front = limits_front(
    ...     1,
    ...     dt=0.001,
    ...     limits=[FrequencyLimit("error", 0.1, high=1.0), FrequencyLimit("F", 0.5, low=100.0)],
    ...     points=2,
    ... )
    >>> [round(float(filter.a[0]), 2) for filter in front.filters]
    [9.95, 57.74]
    """
    _check(order, type, form, dt, trade, inertia_ratios, points)
    wanted = Wanted(
        order=order,
        type=type,
        dt=dt,
        limits=tuple(limits),
        lag=actuator_lag,
        delay=delay + dt,  # the step average and the command that is held
        delay_margin=delay_margin,
        ratios=(float(inertia_ratios[0]), float(inertia_ratios[1])),
    )
    if said := _forbidden(limits) or (_one_pole(limits) if order == 1 else ""):
        return _none(said, tried=0, certain=True)
    with threadpool_limits(1, user_api="blas"):
        return _Search(wanted, form == "general", trade, points, callback or (lambda done, of: False)).run()


def _check(
    order: int,
    type: int,
    form: Form,
    dt: float,
    trade: Trade,
    ratios: tuple[float, float],
    points: int,
) -> None:
    if not 1 <= order <= 6:
        raise ValueError(f"order: expected 1 to 6, got {order}")
    if not 1 <= type <= order:
        raise ValueError(f"type: expected 1 to the order {order}, got {type}")
    if form not in get_args(Form):
        raise ValueError(f"form: expected one of {', '.join(get_args(Form))}, got {form!r}")
    if trade not in get_args(Trade):
        raise ValueError(f"trade: expected one of {', '.join(get_args(Trade))}, got {trade!r}")
    if not (math.isfinite(dt) and dt > 0.0):
        raise ValueError(f"dt: expected a positive number of seconds, got {dt}")
    if not 0.0 < ratios[0] <= 1.0 <= ratios[1]:
        raise ValueError(f"inertia_ratios: expected a range around 1, such as (0.5, 2), got {ratios}")
    if points < 1:
        raise ValueError(f"points: expected 1 or more, got {points}")


def _forbidden(limits: Sequence[FrequencyLimit]) -> str:
    """Why no filter of any order keeps the limits, from F + (1 - F) = 1; empty where that says nothing."""
    for one in limits:
        for other in limits:
            low, high = max(one.low, other.low), min(one.high, other.high)
            if (
                one.of == "F"
                and other.of == "error"
                and low <= high
                and one.magnitude + other.magnitude < 1.0
            ):
                return (
                    f"no filter of any order: at {max(low, 1e-300):.4g} rad/s |F| and |1 - F| add up to 1 or more, and "
                    f"{one.magnitude:.3g} and {other.magnitude:.3g} are allowed"
                )
    return ""


def _one_pole(limits: Sequence[FrequencyLimit]) -> str:
    """Why no single pole keeps the limits: at w, |1 - F| rises to its value at a limit's end, and |F| falls from it."""
    slowest = [
        each.high * math.sqrt(1.0 / each.magnitude**2 - 1.0)
        for each in limits
        if each.of == "error" and each.magnitude < 1.0
    ]
    fastest = [
        each.low * each.magnitude / math.sqrt(1.0 - each.magnitude**2)
        for each in limits
        if each.of == "F" and each.magnitude < 1.0
    ]
    if slowest and fastest and max(slowest) > min(fastest):
        return (
            f"no filter with one pole: |1 - F| asks for {max(slowest):.4g} rad/s or more, |F| for {min(fastest):.4g} "
            "rad/s or less"
        )
    return ""


def _none(message: str, *, tried: int, certain: bool, status: Status = Status.INFEASIBLE) -> LimitsFront:
    empty = np.zeros(0)
    return LimitsFront((), empty, empty, empty, empty, tried, certain, status, message)


class _CancelledError(Exception):
    """The callback said so."""


class _Search:
    """Points are shapes with the logarithm of a speed behind them."""

    def __init__(
        self, wanted: Wanted, general: bool, trade: Trade, points: int, callback: Callable[[int, int], bool]
    ) -> None:
        self.wanted, self.points = wanted, points
        self._free = wanted.order - wanted.type if general else 0
        self._noise = trade == "noise"
        self._callback, self._done = callback, 0
        self._steps = 1 + 2 * _KEPT + points
        self._tight = np.zeros(0)
        speeds = [edge for each in wanted.limits for edge in (each.low, each.high) if 0.0 < edge < np.inf]
        slow, fast = (min(speeds), max(speeds)) if speeds else (0.01 / wanted.dt, 0.1 / wanted.dt)
        fast = min(fast * 10.0**_DECADES, 2.0 / wanted.dt)
        self._range = (math.log(min(slow * 10.0**-_DECADES, 0.01 * fast)), math.log(fast))

    def run(self) -> LimitsFront:
        try:
            return self._run()
        except _CancelledError:
            return _none("stopped before the end", tried=self._tried, certain=False, status=Status.CANCELLED)

    def _run(self) -> LimitsFront:
        first = self._first()
        self._tick()
        raised = [self._raised(start) for start in first[:_KEPT]]
        found = [p for p in raised if self._kept(p[None]).min() >= -_SLACK]
        if not found:
            return self._nothing(max(raised, key=lambda p: float(self._kept(p[None]).min())))
        ends = [self._best(found, which) for which in (0, 1)]
        values = self._respects(np.stack(ends))
        held = np.linspace(values[0, 1], values[1, 1], self.points)
        front: list[FloatArray] = []
        before = ends[0]
        for level in held:
            share = (level - held[0]) / (held[-1] - held[0]) if held[-1] != held[0] else 0.0
            candidates = [
                before,
                (1.0 - share) * ends[0] + share * ends[1],
                ends[1] if share > 0.5 else ends[0],
            ]
            before = self._least(0, candidates, level) if 0.0 < share < 1.0 else ends[int(share)]
            front.append(before)
            self._tick()
        return self._checked(front)

    def _tick(self) -> None:
        self._done += 1
        if self._callback(min(self._done, self._steps), self._steps):
            raise _CancelledError

    # -- where it starts ------------------------------------------------------------------------------------------

    def _first(self) -> list[FloatArray]:
        """Every shape at the speed at which it comes closest, the closest first."""
        families = [np.append(start, np.zeros(self._free)) for start in starts(self.wanted.order)]
        rng = np.random.default_rng(1)
        random = [families[-1] + _SPREAD * rng.standard_normal(len(families[-1])) for _ in range(_STARTS)]
        shapes = families + (random if len(families[-1]) else [])
        self._tried = len(shapes) * _SPEEDS
        found: list[tuple[float, FloatArray]] = []
        for shape in shapes:
            speeds = np.linspace(*self._range, _SPEEDS)
            batch = np.column_stack([np.tile(np.clip(shape, -_SHAPE, _SHAPE), (_SPEEDS, 1)), speeds])
            worst = self._kept(batch).min(axis=1)
            k = int(np.argmax(worst))
            found.append((float(worst[k]), batch[k]))
        found.sort(key=lambda each: -each[0])
        return [p for _, p in found]

    def _raised(self, start: FloatArray) -> FloatArray:
        """From a start to where everything is kept, or comes closest to it, by raising what is kept least."""
        self._tick()
        if self._kept(start[None]).min() >= 0.0:
            return start
        p = np.append(start, self._kept(start[None]).min())
        solved = self._solve(p, lambda q: -q[:, -1], lambda q: self._kept(q[:, :-1]) - q[:, -1:], top=0.01)
        both = np.stack([start, solved[:-1]])
        return both[int(np.argmax(self._kept(both).min(axis=1)))]

    # -- one problem ----------------------------------------------------------------------------------------------

    def _measure(self, batch: FloatArray) -> Measures:
        return measured(self.wanted, batch[:, :-1], np.exp(batch[:, -1]))

    def _kept(self, batch: FloatArray) -> FloatArray:
        """How far each limit and margin is kept, in the logarithm, (m, c); negative where it is not."""
        kept = self._measure(batch).kept
        return kept - self._tight if len(self._tight) else kept

    def _respects(self, batch: FloatArray) -> FloatArray:
        """The two that are traded, (m, 2), both to be small."""
        found = self._measure(batch)
        if self._noise:
            return np.log(np.column_stack([found.noise, found.following]))
        return np.log(np.column_stack([1.0 / found.bandwidth, 1.0 / found.delay_margin]))

    def _best(self, found: list[FloatArray], which: int) -> FloatArray:
        """The end of the front at which one respect is best."""
        best = self._least(which, found, None)
        self._tick()
        return best

    def _least(self, which: int, candidates: list[FloatArray], level: float | None) -> FloatArray:
        """Where one respect is least, the other at most at a level."""

        def kept(batch: FloatArray) -> FloatArray:
            rows = self._kept(batch)
            return rows if level is None else np.column_stack([rows, level - self._respects(batch)[:, 1]])

        solved = [
            self._solve(start, lambda batch: self._respects(batch)[:, which], kept) for start in candidates
        ]
        both = np.stack([*solved, *candidates])
        broken = np.maximum(-kept(both).min(axis=1), 0.0)
        costs = self._respects(both)[:, which] + np.where(broken > _SLACK, 1e3 * broken, 0.0)
        return both[int(np.argmin(costs))]

    def _solve(
        self,
        start: FloatArray,
        cost: Callable[[FloatArray], FloatArray],
        kept: Callable[[FloatArray], FloatArray],
        top: float | None = None,
    ) -> FloatArray:
        """SLSQP with differences that are evaluated together; ``top`` bounds one more coordinate at the end."""
        steps = _STEP * np.vstack([np.zeros(len(start)), np.eye(len(start))])

        def slopes(function: Callable[[FloatArray], FloatArray], p: FloatArray) -> FloatArray:
            values = function(p + steps)
            return np.asarray((values[1:] - values[0]) / _STEP).T

        shape = len(start) - 1 - self._free - (top is not None)
        bounds: list[tuple[float, float]] = [(-_SHAPE, _SHAPE)] * shape + [(-_ROOM, _ROOM)] * self._free
        bounds += [self._range]
        if top is not None:
            bounds.append((-1e3, top))
        found = minimize(
            lambda p: float(cost(p[None])[0]),
            start,
            jac=lambda p: slopes(cost, p),
            constraints={"type": "ineq", "fun": lambda p: kept(p[None])[0], "jac": lambda p: slopes(kept, p)},
            bounds=bounds,
            method="SLSQP",
            options={"maxiter": _ITERATIONS, "ftol": 1e-7},
        )
        low, high = np.array(bounds).T
        x = np.asarray(found.x, dtype=float)
        return np.clip(x, low, high) if np.all(np.isfinite(x)) else start

    # -- what comes of it -----------------------------------------------------------------------------------------

    def _filter(self, p: FloatArray) -> PhyFilter:
        return at_speed(p[:-1], self.wanted.order, self.wanted.type, float(np.exp(p[-1])))

    def _checked(self, front: list[FloatArray]) -> LimitsFront:
        """The filters that hold where they are checked, without those that another one is better than."""
        kept: list[tuple[PhyFilter, FloatArray]] = []
        dropped = 0
        for p in front:
            filter, lacking, figures = self._repaired(p)
            if lacking > _SLACK:
                dropped += 1
            elif not any(np.allclose(figures, other, rtol=1e-3) for _, other in kept):
                kept.append((filter, figures))
        if not kept:
            return _none(
                f"none found: {dropped} candidates kept the limits on the grid of the search, none when checked "
                "sampled; ask for a little less",
                tried=self._tried,
                certain=False,
            )
        kept.sort(key=lambda each: each[1][2])
        filters = tuple(filter for filter, _ in kept)
        noise, bound, bandwidth, margin = np.stack([figures for _, figures in kept]).T
        said = f"{len(filters)} filters of order {self.wanted.order}, from {self._tried} starts"
        if dropped:
            said += f"; {dropped} left out, which did not hold when checked"
        return LimitsFront(
            filters, noise, bound, bandwidth, margin, self._tried, False, Status.CONVERGED, said
        )

    def _repaired(self, p: FloatArray) -> tuple[PhyFilter, float, FloatArray]:
        """The filter of a point, searched again with more asked where the check finds too little; what still lacks."""
        filter = self._filter(p)
        lacking, figures = verified(self.wanted, filter)
        tight = np.zeros_like(lacking)
        for _ in range(_REPAIRS):
            if lacking.max() <= _SLACK:
                break
            tight = tight + 1.05 * lacking
            self._tight = tight
            filter = self._filter(self._least(0, [p], float(self._respects(p[None])[0, 1])))
            lacking, figures = verified(self.wanted, filter)
        self._tight = np.zeros(0)
        return filter, float(lacking.max()), figures

    def _nothing(self, closest: FloatArray) -> LimitsFront:
        kept = self._kept(closest[None])[0]
        k = int(np.argmin(kept))
        said = f"{self.wanted.names()[k]} by {20.0 * -kept[k] / math.log(10.0):.2g} dB"
        return _none(
            f"none found in {self._tried} starts; the closest misses {said}: ask for less, or raise the order",
            tried=self._tried,
            certain=False,
        )
