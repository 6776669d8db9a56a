"""Learning a model f_theta and the filter of its residual together.

f_hat depends on f_theta through 1 - F: directly, and through the measured residual of each step. So the cotangent of
f_theta is 1 - F run backwards in time over the cotangent of f_hat (2 (f_hat - f) for a sum of squares), and any
learned model with a vector-Jacobian product takes part. What the filter repairs anyway costs the model no capacity.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, minimize

from .. import _signals
from .._sections import FloatArray
from ..filter import PaperFilter, PhyFilter, SampledPhyFilter
from ..learned import FitResult, LearnedModel
from ..learned.model import expect_model
from ..recording import Recording
from ..results import Result, SearchResult, Status
from .adjoint.costs import SquaredError, StageCost
from .adjoint.gradient import Record, listed, record_of, terms_of
from .adjoint.rollout import Form, Rollout
from .learning.parametrisation import Chain, chain_of

__all__ = ["JointGradient", "JointResult", "joint_gradient", "learn_jointly"]

M = TypeVar("M", bound=LearnedModel)
Strategy = Literal["simultaneous", "alternating"]
# Cost of a point whose filter cannot be formed, over the cost at the start: the line search turns back.
_OUT_OF_REACH = 1e6
# Bounds of the filter: decay rates up to the sampling rate, down to this over the length of the longest flight.
_SLOWEST = 1e-2
_ROUNDS = 5


@dataclass(frozen=True, repr=False)
class JointGradient(Result):
    """A cost over flights and its gradient in the model and in the filter.

    Attributes
    ----------
    value : float
        sum l_i over all samples but the first of each flight.
    model : (n_parameters,) array
        Gradient in the parameters of the model.
    a : (n,) array
        Gradient in a_0 ... a_{n-1}; in the low-pass form b_0 = a_0 moves along.
    b : (n,) array, optional
        Gradient in b_0 ... b_{n-1}; None in the low-pass form.
    squares : float
        Sum of |f - f_hat|^2 over the same samples and all channels.
    count : int
        Samples times channels in it.
    """

    value: float
    model: FloatArray
    a: FloatArray
    b: FloatArray | None
    squares: float
    count: int


@dataclass(frozen=True, repr=False)
class JointResult(Result, SearchResult[tuple[M, PhyFilter]]):
    """What :func:`learn_jointly` gave.

    Attributes
    ----------
    model : LearnedModel
    filter : PhyFilter
    rmse : float
        Root-mean-square of f - f_hat over the flights and channels, in the unit of f.
    history : tuple of float
        ``rmse`` at the start and after each iteration.
    held_out : tuple of float
        The same on the flights held out; empty without any. ``model`` and ``filter`` are those of its least entry.
    status : Status
        CONVERGED, ITERATION_LIMIT, STALLED, CANCELLED, or FAILED: the model could not be fitted to start from.
    message : str
        The status in words, and what to try.
    """

    model: M
    filter: PhyFilter
    rmse: float
    history: tuple[float, ...]
    held_out: tuple[float, ...]
    status: Status
    message: str

    @property
    def best(self) -> tuple[M, PhyFilter]:
        """``model`` and ``filter``: what every search calls what it found."""
        return self.model, self.filter


def joint_gradient(
    logs: Recording | Sequence[Recording],
    model: LearnedModel,
    sampled: SampledPhyFilter | PaperFilter,
    *,
    form: Form | None = None,
    cost: StageCost | None = None,
    segments: int = 1,
    workers: int = 1,
) -> JointGradient:
    """Cost of a model and a filter over labelled flights, and its gradient in both.

    Parameters
    ----------
    logs : Recording or sequence of Recording
        Flights with features z for the model, a label (the true f) and equal steps of ``sampled.dt``. An f_theta in
        them is not used.
    model : LearnedModel
        A fitted model; f_theta is its prediction.
    sampled : SampledPhyFilter or PaperFilter
        The filter.
    form, segments, workers
        As for :class:`Rollout`.
    cost : StageCost, optional
        l_i(f_i, f_hat_i, a); None means :class:`SquaredError`.

    Returns
    -------
    JointGradient

    Raises
    ------
    ValueError
        If a flight has no features, no label or other steps; and as for :class:`Rollout`.

    Examples
    --------
    >>> from phyfilter_ctl.learned import Network
    >>> z = np.linspace(-2.0, 2.0, 200)[:, None]
    >>> log = Recording.from_arrays(x=0.0 * z, dt=0.01, label=np.sin(z), features=z)
    >>> model = Network((4,), max_iterations=5).fit(z, np.sin(z)).model
    >>> joint_gradient(log, model, PhyFilter([1.0]).sampled(0.01)).model.shape
    (13,)
    """
    expect_model(model)
    rollout = Rollout(sampled, form=form, segments=segments, workers=workers)
    return _evaluate(rollout, listed(logs), model, cost or SquaredError())


def learn_jointly(
    logs: Recording | Sequence[Recording],
    model: M,
    filter0: PhyFilter | SampledPhyFilter,
    *,
    form: Form | None = None,
    cost: StageCost | None = None,
    held_out: Recording | Sequence[Recording] = (),
    strategy: Strategy = "simultaneous",
    max_iterations: int = 200,
    tolerance: float = 1e-6,
    callback: Callable[[int, float], bool | None] | None = None,
    segments: int = 1,
    workers: int = 1,
) -> JointResult[M]:
    """Learn a model and the filter of its residual on the same flights, by L-BFGS with the exact joint gradient.

    Parameters
    ----------
    logs : Recording or sequence of Recording
        As for :func:`joint_gradient`.
    model : LearnedModel
        Where to start; one without parameters is fitted to the labels first.
    filter0 : PhyFilter or SampledPhyFilter
        Where to start, and how it is sampled (method "exact" or "tustin"); a PhyFilter is sampled exactly.
    form : {"lowpass", "general"}, optional
        As for :class:`Rollout`.
    cost : StageCost, optional
        As for :func:`joint_gradient`.
    held_out : Recording or sequence of Recording
        Flights to choose the iterate by. None given: the last, which is the best on ``logs``.
    strategy : {"simultaneous", "alternating"}
        Move model and filter together, or by turns; the filter alone comes first in both.
    max_iterations : int
        Most iterations, over all turns.
    tolerance : float
        Relative decrease of the cost in an iteration below which it stops.
    callback : callable, optional
        (iteration, rmse) -> stop; called after each iteration, True stops.
    segments, workers : int
        As for :class:`Rollout`.

    Returns
    -------
    JointResult

    Raises
    ------
    ValueError
        As for :func:`joint_gradient`; and for options out of range, method "euler", which
        are not stable everywhere on the way.

    Notes
    -----
    The filter moves in the logarithms of Routh's ratios of D (Hurwitz for all values, decay rates bounded by the
    sampling rate), and b in scaled coefficients. Deterministic. L-BFGS-B: R. H. Byrd, P. Lu, J. Nocedal, C. Zhu, SIAM
    J. Sci. Comput. 16 (1995).

    Examples
    --------
    >>> from phyfilter_ctl.learned import Network
    >>> rng = np.random.default_rng(1)
    >>> z = np.linspace(-2.0, 2.0, 400)[:, None]
    >>> f = np.sin(2.0 * z) + 0.3
    >>> x = 0.01 * np.cumsum(f, axis=0) + 1e-3 * rng.standard_normal(f.shape)
    >>> log = Recording.from_arrays(x=x, dt=0.01, label=f, features=z)
    >>> result = learn_jointly(log, Network((4,), max_iterations=3), PhyFilter([3.0]), max_iterations=30)
    >>> result.rmse < 0.2 * result.history[0]
    True
    """
    expect_model(model)
    flights, others = listed(logs), [held_out] if isinstance(held_out, Recording) else list(held_out)
    if strategy not in get_args(Strategy):
        raise ValueError(f"strategy: expected one of {get_args(Strategy)}, got {strategy!r}")
    max_iterations = _signals.count("max_iterations", max_iterations)
    if not tolerance > 0.0:
        raise ValueError(f"tolerance: expected a positive number, got {tolerance!r}")
    sampled = filter0.sampled(flights[0].dt, "exact") if isinstance(filter0, PhyFilter) else filter0
    if sampled.sampling.method == "euler":
        raise ValueError(
            "filter0: expected method 'exact' or 'tustin', got 'euler'; sample the result with Euler after"
        )
    rollout = Rollout(sampled, form=form, segments=segments, workers=workers)
    for log in (*flights, *others):
        record_of(rollout, log)
        _features(log)
    if len(model.parameters) == 0:
        first = _first_fit(model, flights)
        if first.status is Status.FAILED:
            message = f"the first fit of the model failed ({first.message}); hand in a fitted model"
            return JointResult(model, sampled.filter, float("inf"), (), (), Status.FAILED, message)
        model = first.model
    problem = _Joint(flights, others, model, rollout, cost or SquaredError())
    return _Search(problem, max_iterations, tolerance, callback).run(strategy)


def _features(log: Recording) -> FloatArray:
    if log.features is None:
        name = f"log {log.name!r}" if log.name else "log"
        raise ValueError(
            f"{name}: expected features z for the model, got none; add them with with_signals(features=...)"
        )
    return log.features


def _first_fit(model: M, flights: Sequence[Recording]) -> FitResult[M]:
    z = np.concatenate([_features(log) for log in flights])
    return model.fit(z, np.concatenate([log.label for log in flights if log.label is not None]))


def _evaluate(
    rollout: Rollout, logs: Sequence[Recording], model: LearnedModel, cost: StageCost
) -> JointGradient:
    value, squares, count = 0.0, 0.0, 0
    by_model, by_a, by_b = np.zeros(len(model.parameters)), np.zeros(rollout.sampled.order), None
    for log in logs:
        z = _features(log)
        flight = record_of(rollout, log, model.predict(z))
        trace = rollout.forward(flight.inputs)
        part, r, direct = terms_of(rollout, flight.label, trace.f_hat, 1, log.n_x, cost, None)
        back = rollout.backward(trace, r, signals=True)
        assert back.f_theta is not None  # asked for
        value += part
        squares += _squares(flight, trace.f_hat)
        count += flight.label[1:].size
        by_model += model.vjp(z, back.f_theta)
        by_a += back.a + direct
        if back.b is not None:
            by_b = back.b if by_b is None else by_b + back.b
    return JointGradient(value, by_model, by_a, by_b, squares, count)


def _squares(flight: Record, f_hat: FloatArray) -> float:
    return float(np.sum((f_hat - flight.label)[1:] ** 2))


class _Joint(Generic[M]):
    """The problem as a function of one vector: model, log ratios of D, scaled b."""

    def __init__(
        self,
        logs: Sequence[Recording],
        held_out: Sequence[Recording],
        model: M,
        rollout: Rollout,
        cost: StageCost,
    ) -> None:
        self.logs, self.others, self.model, self.rollout, self.cost = logs, held_out, model, rollout, cost
        filter = rollout.sampled.filter
        n = filter.order
        self.scale = filter.a[0] ** (np.arange(n, 0, -1) / n)
        theta = chain_of(filter.poles).theta
        b = filter.b / self.scale if rollout.form == "general" else np.zeros(0)
        self.start = np.concatenate([model.parameters, theta, b])
        self.filter_part = np.arange(len(self.start)) >= len(model.parameters)
        fastest = np.log(1.0 / rollout.sampled.dt)
        slowest = np.log(_SLOWEST / max(log.duration for log in logs))
        bounds = np.full((len(self.start), 2), [-np.inf, np.inf])
        bounds[len(model.parameters) :][:n] = slowest, fastest
        bounds[len(model.parameters), 1] += np.log(n)  # the sum of n decay rates
        self.bounds = bounds

    def at(self, p: FloatArray) -> tuple[M, Rollout]:
        """Model and rollout at p.

        Raises
        ------
        ValueError
            If poles at the edge of rounding cannot be told from the imaginary axis.
        """
        n, count = self.rollout.sampled.order, len(self.model.parameters)
        chain, tail = Chain(p[count : count + n], 0.0), p[count + n :]
        b = tail * self.scale if len(tail) else None
        filter = PhyFilter(chain.polynomials[0], b, poles=chain.poles)
        old = self.rollout
        sampled = old.sampled.with_filter(filter)
        rollout = Rollout(sampled, form=old.form, segments=old.segments, workers=old.workers)
        return self.model.with_parameters(p[:count]), rollout

    def cost_and_gradient(self, p: FloatArray) -> tuple[float, FloatArray, float]:
        """Mean cost per number, its gradient in p, and the rmse."""
        model, rollout = self.at(p)
        found = _evaluate(rollout, self.logs, model, self.cost)
        count = len(found.model)
        slopes = Chain(p[count : count + len(found.a)], 0.0).polynomials[2]
        b = np.zeros(0) if found.b is None else found.b * self.scale
        gradient = np.concatenate([found.model, slopes @ found.a, b])
        return found.value / found.count, gradient / found.count, float(np.sqrt(found.squares / found.count))

    def held_out_rmse(self, p: FloatArray) -> float:
        """Over the flights held out."""
        model, rollout = self.at(p)
        flights = [record_of(rollout, log, model.predict(_features(log))) for log in self.others]
        squares = sum(_squares(flight, rollout.forward(flight.inputs).f_hat) for flight in flights)
        return float(np.sqrt(squares / sum(flight.label[1:].size for flight in flights)))


class _Search(Generic[M]):
    """L-BFGS over parts of the vector, and a record of what it met."""

    def __init__(
        self,
        problem: _Joint[M],
        max_iterations: int,
        tolerance: float,
        callback: Callable[[int, float], bool | None] | None,
    ) -> None:
        self.problem, self.left, self.tolerance, self.callback = problem, max_iterations, tolerance, callback
        self.p = problem.start
        self.unit, _, rmse = problem.cost_and_gradient(self.p)
        self.unit = abs(self.unit) or 1.0
        self.history = [rmse]
        self.held_out = [problem.held_out_rmse(self.p)] if problem.others else []
        self.best = self.p
        self.stopped = False
        self._met: tuple[bytes, float] = (b"", rmse)

    def run(self, strategy: Strategy) -> JointResult[M]:
        part = self.problem.filter_part
        # The filter first: beside one that is far too slow the model learns what the filter should repair.
        last = self._minimise(part, max(1, self.left // 4))
        if self.stopped or self.left <= 0:
            pass
        elif strategy == "simultaneous":
            last = self._minimise(np.ones(len(part), dtype=bool), self.left)
        else:
            turn = max(1, self.left // (2 * _ROUNDS))
            while True:
                before = self.history[-1]
                last = self._minimise(~part, turn)
                if self.left > 0 and not self.stopped:
                    last = self._minimise(part, turn)
                settled = before - self.history[-1] <= self.tolerance * before
                if self.stopped or self.left <= 0 or settled:
                    last.status = 0 if settled else 1
                    break
        model, rollout = self.problem.at(self.best)
        rmse = self.problem.cost_and_gradient(self.best)[2]
        status, message = self._status(last)
        return JointResult(
            model, rollout.sampled.filter, rmse, tuple(self.history), tuple(self.held_out), status, message
        )

    def _minimise(self, moving: NDArray[np.bool_], most: int) -> OptimizeResult:
        fixed, problem = self.p.copy(), self.problem

        def value(part: FloatArray) -> tuple[float, FloatArray]:
            p = fixed.copy()
            p[moving] = part
            try:
                with np.errstate(over="ignore", invalid="ignore"):
                    cost, gradient, rmse = problem.cost_and_gradient(p)
            except ValueError:
                return _OUT_OF_REACH, np.zeros(len(part))
            if not (np.isfinite(cost) and np.all(np.isfinite(gradient))):
                return _OUT_OF_REACH, np.zeros(len(part))
            self._met = (p.tobytes(), rmse)
            return cost / self.unit, gradient[moving] / self.unit

        def after(intermediate_result: OptimizeResult) -> None:
            self.p = fixed.copy()
            self.p[moving] = intermediate_result.x
            self._note()
            if self.stopped:
                raise StopIteration

        options = {"maxiter": min(most, self.left), "ftol": self.tolerance, "gtol": 1e-10, "maxcor": 20}
        bounds = problem.bounds[moving]
        first = np.clip(fixed[moving], bounds[:, 0], bounds[:, 1])
        return minimize(
            value, first, jac=True, method="L-BFGS-B", bounds=bounds, callback=after, options=options
        )

    def _note(self) -> None:
        known, rmse = self._met
        if known != self.p.tobytes():
            rmse = self.problem.cost_and_gradient(self.p)[2]
        self.history.append(rmse)
        self.left -= 1
        if self.problem.others:
            self.held_out.append(self.problem.held_out_rmse(self.p))
            if self.held_out[-1] <= min(self.held_out):
                self.best = self.p
        else:
            self.best = self.p
        if self.callback is not None and self.callback(len(self.history) - 1, rmse):
            self.stopped = True

    def _status(self, last: OptimizeResult) -> tuple[Status, str]:
        count = len(self.history) - 1
        if self.stopped:
            return Status.CANCELLED, f"cancelled by the callback after iteration {count}"
        if last.status == 0:
            return Status.CONVERGED, f"converged in {count} iterations"
        if last.status == 1:
            return (
                Status.ITERATION_LIMIT,
                f"still learning after {count} iterations; raise max_iterations or tolerance",
            )
        return Status.STALLED, f"no further descent after {count} iterations; usable, or try another start"
