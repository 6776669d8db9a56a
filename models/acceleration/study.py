"""Two studies of the comparison: order and poles of the filter, and the sampling interval."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.design import LearnResult
from phyfilter_ctl.recording import Recording
from phyfilter_ctl.study import Report

from .differentiator import counted
from .experiment import Comparison, Effort, Learned, fit_learned
from .learning import Form, learn_filters
from .params import params
from .tuning import Case, filtered, rmse

__all__ = ["IntervalStudy", "LearnedPoint", "PoleMap", "intervals", "order_by_pole", "sampling_intervals"]

FloatArray = NDArray[np.float64]

# Enough rows must be left for the window, the split and the start that is left out.
_FEWEST_ROWS = 20


@dataclass(frozen=True)
class PoleMap:
    """Test RMSE of the low-pass form with n equal poles.

    Attributes
    ----------
    orders : tuple of int
    poles : (m,) array
        |p| in rad/s.
    rmse : (orders, m) array
        m/s^2.
    tuned : dict of int to (float, float)
        By order: the geometric mean of the tuned filter's poles in rad/s, and its test RMSE.
    learned : tuple of LearnedPoint
        Filters learned on the flights that the others were tuned on.
    """

    orders: tuple[int, ...]
    poles: FloatArray
    rmse: FloatArray
    tuned: dict[int, tuple[float, float]]
    learned: tuple[LearnedPoint, ...]


@dataclass(frozen=True)
class LearnedPoint:
    """A learned filter on the map.

    Attributes
    ----------
    order : int
        Order asked for.
    form : {"lowpass", "general"}
    result : LearnResult
    tuning_rmse : float
        On the flights it was learned on, by the same measure as the tuned filters, m/s^2.
    test_rmse : float
        m/s^2.
    """

    order: int
    form: Form
    result: LearnResult
    tuning_rmse: float
    test_rmse: float

    @property
    def pole(self) -> float:
        """Geometric mean of the poles, rad/s."""
        return float(self.result.filter.a[0] ** (1.0 / self.result.order_used))


@dataclass(frozen=True)
class IntervalStudy:
    """Test RMSE over the sampling interval.

    Attributes
    ----------
    dt : (m,) array
        s.
    rmse : dict of str to (m,) array
        By method ("network", "phyfilter_1", ...), m/s^2.
    """

    dt: FloatArray
    rmse: dict[str, FloatArray]


def order_by_pole(comparison: Comparison) -> PoleMap:
    """Test RMSE over the order and a repeated pole, the network being the comparison's (pole placement).

    The map shows what tuning and learning aimed at; nothing is chosen by it.
    """
    chosen = params().study
    low, high = chosen.poles
    poles = np.geomspace(low, high, chosen.points)
    cases = comparison.test_cases()
    scores = [
        [rmse(filtered(PhyFilter.from_poles([-p] * n), cases, comparison.dt), comparison.test) for p in poles]
        for n in chosen.orders
    ]
    test = comparison.test_rmse
    tuned = {
        n: (float(found.filter.a[0] ** (1.0 / n)), test[f"phyfilter_{n}"])
        for n, found in comparison.learned.filters.items()
    }
    tuning = comparison.learned.cases
    learned = tuple(
        LearnedPoint(
            n,
            form,
            result,
            rmse(filtered(result.filter, tuning, comparison.dt), [case.log for case in tuning]),
            rmse(filtered(result.filter, cases, comparison.dt), comparison.test),
        )
        for (n, form), result in learn_filters(tuning, tuple(comparison.learned.filters)).items()
    )
    return PoleMap(chosen.orders, poles, np.array(scores), tuned, learned)


def intervals(dt: float) -> list[int]:
    """Factors by which flights sampled every ``dt`` seconds are decimated: 1, 2, ... up to the longest interval.

    Recordings that are too slow for three of them take 1, 2 and 3.

    Examples
    --------
    >>> intervals(0.002)
    [1, 2, 3, 4, 5, 6, 7, 8, 9]
    >>> intervals(0.01)
    [1, 2, 3]
    """
    return list(range(1, max(3, int(params().study.longest / dt + 1e-9)) + 1))


def sampling_intervals(
    comparison: Comparison, *, effort: Effort | None = None, report: Report | None = None
) -> IntervalStudy:
    """Test RMSE of network and filters with every k-th sample only.

    At every interval the window is chosen, the network trained and the filters tuned anew, on the decimated training
    flights. The window keeps its number of velocities; so at long intervals it lasts longer.

    Parameters
    ----------
    comparison : Comparison
        Its own result is the one at its own interval.
    effort : Effort, optional
        None means in full.
    report : callable, optional
        Called with a few words at the beginning of every interval.
    """
    effort = Effort() if effort is None else effort
    network, filters = ["network"], [f"phyfilter_{n}" for n in comparison.learned.filters]
    scores: dict[str, list[float]] = {name: [] for name in network + filters}
    used: list[float] = []
    for k in intervals(comparison.dt):
        dt = k * comparison.dt
        train_logs, test_logs = (
            [log.decimate(k) for log in logs] for logs in (comparison.train, comparison.test)
        )
        if min(log.n - counted(log).start for log in (*train_logs, *test_logs)) < _FEWEST_ROWS:
            break
        if report is not None:
            report(f"interval of {1e3 * dt:.3g} ms")
        learned = comparison.learned
        if k > 1:
            learned = fit_learned(train_logs, dt, seed=comparison.seed, effort=effort)
        used.append(dt)
        for name, value in _scores(learned, test_logs, dt).items():
            scores[name].append(value)
    return IntervalStudy(np.array(used), {name: np.array(values) for name, values in scores.items()})


def _scores(learned: Learned, logs: Sequence[Recording], dt: float) -> dict[str, float]:
    cases = [Case(log, learned.network.predict(log.x)) for log in logs]
    answers = {"network": rmse([case.f_theta for case in cases], logs)}
    for order, found in learned.filters.items():
        answers[f"phyfilter_{order}"] = rmse(filtered(found.filter, cases, dt), logs)
    return answers
