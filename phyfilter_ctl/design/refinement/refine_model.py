"""Refinement: what the filter had to add becomes part of the model.

The filter's correction y = f_hat - f_theta is F u, u the measured residual of each step. Offline the parameters that
make it least are sought,

    min_theta  mean_k |F (M x' - g - f_theta(z; theta))|^2 + trust |theta - theta_0|^2
               + keep mean_memory |f_theta(z; theta) - f_theta(z; theta_0)|^2.

Measurement and prediction pass the same filter, so its lag cancels: no label is late. No true f is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ...filter import SampledPhyFilter
from ...learned import LearnedModel, Network
from ...learned.model import expect_model
from ...recording import Recording
from ...results import Result, SearchResult, Status
from . import regression
from .offline_problem import Problem, Solution
from .online import OnlineFlight, OnlineRefiner
from .regression import Tuned

__all__ = ["ModelScore", "RefineResult", "last_layer", "refine", "score_model"]

M = TypeVar("M", bound=LearnedModel)
M_co = TypeVar("M_co", bound=LearnedModel, covariant=True)

# Online there is nothing to cross-validate with; a parameter must then explain this share of f^2 for its unit.
_TRUST_ONLINE = 1e-3


@dataclass(frozen=True, repr=False)
class ModelScore(Result):
    """How a model does on flights, with the filter behind it.

    Attributes
    ----------
    share : float
        Root mean square of f_hat - f_theta over that of f_hat: the filter's share of the estimate.
    f_theta_rmse, f_hat_rmse : float
        Errors against the label, in its unit; NaN where a flight has none.
    """

    share: float
    f_theta_rmse: float
    f_hat_rmse: float


@dataclass(frozen=True, repr=False)
class RefineResult(Result, SearchResult[M_co]):
    """What refinement gave.

    Attributes
    ----------
    model : LearnedModel
        The refined model; the one given where ``status`` is REJECTED or FAILED.
    before, after : ModelScore
        The model given and the refined one (even if rejected) on the flights refined on.
    held_out_before, held_out_after : ModelScore or None
        The same on ``held_out``.
    cost : float
        Least value found of the cost that was minimised (offline), f^2; NaN online.
    trust : float
        Weight of trust used; inf where cross-validation found no change worth it.
    iterations : int
        Iterations of the optimiser; 1 for a model linear in its parameters; updates online.
    flights : tuple of OnlineFlight
        Online: what the model and the filter gave in flight, one for each log; empty offline.
    status : Status
        CONVERGED, ITERATION_LIMIT, FAILED, or REJECTED: cross-validation found no change worth it, or the filter's
        share on ``held_out`` did not fall.
    message : str
        The status in words, and what to try.
    """

    model: M_co
    before: ModelScore
    after: ModelScore
    held_out_before: ModelScore | None
    held_out_after: ModelScore | None
    cost: float
    trust: float
    iterations: int
    status: Status
    message: str
    flights: tuple[OnlineFlight, ...] = field(default=(), repr=False)

    @property
    def best(self) -> M_co:
        """``model``: what every search calls what it found."""
        return self.model


def refine(
    model: M,
    logs: Recording | Sequence[Recording],
    filter: SampledPhyFilter,
    *,
    mode: Literal["offline", "online"] = "offline",
    trainable: slice | ArrayLike | None = None,
    memory: ArrayLike | None = None,
    keep: float = 1.0,
    trust: float | None = None,
    forgetting: float = 30.0,
    every: int = 10,
    held_out: Recording | Sequence[Recording] = (),
    max_iterations: int = 200,
) -> RefineResult[M]:
    """Return the model improved by what the filter had to add in flight.

    A model linear in its moving parameters is refined by one least-squares solution, another one by L-BFGS on its
    vector-Jacobian product. The labels of the logs (the true f) are only used for the scores.

    Parameters
    ----------
    model : LearnedModel
        A fitted model of f; evaluated at the ``features`` of the logs, whose ``f_theta`` is not read.
    logs : Recording or sequence of Recording
        Flights with features, sampled at the filter's rate.
    filter : SampledPhyFilter
        The filter behind the model.
    mode : {"offline", "online"}
        After the flights, or sample by sample with forgetting as :class:`OnlineRefiner` does, flight after flight.
    trainable : slice or array_like of int, optional
        Parameters that move, such as :func:`last_layer`; None for all.
    memory : array_like, shape (N_m, n_z), optional
        Features of old data at which the model shall keep its predictions.
    keep : float
        Weight of that, relative to the mean square over the flights.
    trust : float, optional
        Weight of |theta - theta_0|^2, in f^2 for parameters in their own unit. None: offline by cross-validation,
        leaving out flight after flight (blocks where there are fewer than five flights, the last third for
        nonlinear models); online 1e-3.
    forgetting : float
        Online: time constant in s over which samples fade.
    every : int
        Online: samples between updates of the model.
    held_out : Recording or sequence of Recording
        Flights on which the filter's share must fall, else the refined model is rejected.
    max_iterations : int
        Most iterations of L-BFGS.

    Returns
    -------
    RefineResult

    Raises
    ------
    ValueError, TypeError
        If the model is not fitted, a log lacks features or has another sampling interval, an option is out of range,
        the filter has a delay or float32, or online the model is not linear in its moving parameters.

    Notes
    -----
    Filtering both sides is the prefiltered prediction error of L. Ljung, "System Identification", 2nd ed., 1999,
    section 7.2. Fitting the model to f_hat itself, as it is, moved earlier by the filter's delay, or run through the
    filter a second time backwards, leaves errors 20 times as large behind a slow filter. Refining the model with the
    filtered residual is the first open problem named in the paper's Discussion.

    Examples
    --------
    A wrong model -0.5 x of f = -x, refined on one flight without its true f:

    >>> from phyfilter_ctl.recording import Recording
    >>> from phyfilter_ctl.learned import Network
    >>> from phyfilter_ctl import PhyFilter
    >>> t = 0.01 * np.arange(2000)[:, None]
    >>> x = np.sin(t)
    >>> wrong = Network((8,), seed=1).fit(x, -0.5 * x).model
    >>> log = Recording.from_arrays(x=x, dt=0.01, g=np.cos(t) + x, label=-x, features=x)
    >>> result = refine(wrong, log, PhyFilter([5.0]).sampled(0.01, g="average"), trainable=last_layer(wrong))
    >>> str(result.status), round(result.before.f_theta_rmse, 2), result.after.f_theta_rmse < 0.01
    ('converged', 0.35, True)
    """
    sampled = regression.checked_filter(filter)
    flights = regression.checked_logs("logs", logs, sampled.dt)
    others = regression.checked_logs("held_out", held_out, sampled.dt)
    if not flights:
        raise ValueError("logs: expected at least one flight, got none")
    if mode not in ("offline", "online"):
        raise ValueError(f"mode: expected 'offline' or 'online', got {mode!r}")
    if max_iterations < 1:
        raise ValueError(f"max_iterations: expected at least 1, got {max_iterations}")
    refiner = OnlineRefiner(
        model,
        sampled,
        trainable=trainable,
        memory=memory,
        keep=keep,
        trust=_TRUST_ONLINE if trust is None else trust,
        forgetting=forgetting,
        every=every,
    )
    if mode == "online":
        flown, refined = refiner.run_all(flights)
        updates = sum(len(flight.parameters) - 1 for flight in flown)
        change = refined.parameters[refiner.tuned.index] - model.parameters[refiner.tuned.index]
        solution = Solution(change, float("nan"), updates, True, refiner.trust)
        return _judged(refiner.tuned, solution, flights, others, sampled, flown)
    problem = Problem(refiner.tuned, sampled, flights, keep, refiner.kept)
    solution = problem.solve(trust, max_iterations)
    return _judged(refiner.tuned, solution, flights, others, sampled)


def score_model(
    model: LearnedModel, logs: Recording | Sequence[Recording], filter: SampledPhyFilter
) -> ModelScore:
    """How much the filter must add to a model on flights, and how far both are from the truth.

    Parameters
    ----------
    model : LearnedModel
        Evaluated at the ``features`` of the logs.
    logs : Recording or sequence of Recording
        Flights with features, sampled at the filter's rate.
    filter : SampledPhyFilter
        The filter behind the model.

    Returns
    -------
    ModelScore

    Raises
    ------
    ValueError, TypeError
        As for :func:`refine`.
    """
    expect_model(model)
    sampled = regression.checked_filter(filter)
    flights = regression.checked_logs("logs", logs, sampled.dt)
    if not flights:
        raise ValueError("logs: expected at least one flight, got none")
    sums, samples = np.zeros(4), 0
    for log in flights:
        f_theta = model.predict(regression.features_of(log))
        y = regression.correction(sampled, log, f_theta)
        label = np.full(f_theta.shape, np.nan) if log.label is None else log.label
        parts = (y, f_theta + y, f_theta - label, f_theta + y - label)
        sums += [float(np.sum(part**2)) for part in parts]
        samples += y.size
    share = float(np.sqrt(sums[0] / sums[1])) if sums[1] > 0.0 else 0.0
    return ModelScore(share, float(np.sqrt(sums[2] / samples)), float(np.sqrt(sums[3] / samples)))


def last_layer(network: Network) -> slice:
    """The parameters of a network's linear output layer, in which it is linear.

    Parameters
    ----------
    network : Network
        A fitted one.

    Raises
    ------
    ValueError
        If it has not been fitted.

    Examples
    --------
    >>> z = np.linspace(-1.0, 1.0, 50)[:, None]
    >>> last_layer(Network((5,)).fit(z, z).model)
    slice(10, 16, None)
    """
    if network.layers is None:
        raise ValueError("the network has no weights yet: call fit(z, f) and use the model of its result")
    count = len(network.parameters)
    units, channels = network.layers.sizes[-2:]
    return slice(count - (units + 1) * channels, count)


def _judged(
    tuned: Tuned[M],
    solution: Solution,
    flights: tuple[Recording, ...],
    others: tuple[Recording, ...],
    sampled: SampledPhyFilter,
    flown: tuple[OnlineFlight, ...] = (),
) -> RefineResult[M]:
    """Scores before and after, and whether the refined model earns its place."""
    model, good = tuned.model, bool(np.all(np.isfinite(solution.change)))
    candidate = tuned.moved(solution.change) if good else model
    before, after = (score_model(each, flights, sampled) for each in (model, candidate))
    held = [score_model(each, others, sampled) for each in (model, candidate)] if others else [None, None]
    status, message = Status.CONVERGED, "converged"
    if not good:
        status, message = Status.FAILED, "the parameters ran out of the range of numbers; give a larger trust"
    elif np.isinf(solution.trust):
        status = Status.REJECTED
        message = (
            "no change of the parameters lowers the filter's correction on data left out: what is left of the residual "
            "is not a function of the features; the model given is returned; refine on more flights or other features"
        )
    elif held[0] is not None and held[1] is not None and held[1].share >= held[0].share:
        status = Status.REJECTED
        message = (
            f"on the held-out flights the filter's share went from {held[0].share:.3g} to {held[1].share:.3g}; the "
            "model given is returned; refine on more flights, raise trust, or refine fewer parameters (trainable)"
        )
    elif not solution.converged:
        status = Status.ITERATION_LIMIT
        message = f"not converged in {solution.iterations} iterations; usable; raise max_iterations or trust"
    return RefineResult(
        model if status in (Status.REJECTED, Status.FAILED) else candidate,
        before,
        after,
        held[0],
        held[1],
        solution.cost,
        solution.trust,
        solution.iterations,
        status,
        message,
        flown,
    )
