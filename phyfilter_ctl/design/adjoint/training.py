"""The paper's Algorithm 2: coefficients trained by Adam on mini-batches of segments, with early stopping.

A first-order method on raw coefficients needs a learning rate for each order. For a sum of squares Gauss-Newton on
exact sensitivities (``design.learning``) is the better tool; this one takes any stage cost and any discretised filter.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from threadpoolctl import threadpool_limits

from ..._renamed import takes_former
from ..._sections import FloatArray
from ...filter import PaperFilter, PhyFilter, SampledPhyFilter
from ...recording import Recording
from ...results import Result, SearchResult, Status
from ..learning.parametrisation import Chain, chain_of
from .costs import SquaredError, StageCost
from .gradient import Record, gradient_of, listed, record_of, summed, terms_of
from .rollout import Form, Rollout

__all__ = ["Adam", "TrainResult", "train"]

Coordinates = Literal["coefficients", "hurwitz"]


@dataclass(frozen=True)
class Adam:
    """The optimiser of Algorithm 2: a step, the mini-batches it takes, and when to stop.

    Parameters
    ----------
    rate : float, optional
        Learning rate eta: about the change of each number in a step. None means a fiftieth of what is learned: 0.02
        for logarithms, for coefficients 0.02 times the smallest of them over the order (a higher order wants a
        smaller rate, as the paper's Fig. S2 says).
    beta1, beta2 : float
        Forgetting factors of the means of the gradient and of its square.
    epsilon : float
        Guards the division, relative to the unit of the gradient.
    batch : int
        Segments whose gradients are added before a step.
    patience : int
        Epochs without a better validation cost before it stops.
    max_epochs : int
        Most passes over the segments.
    seed : int
        Seed of the order of the segments.

    Raises
    ------
    ValueError
        If a number is out of range.

    Notes
    -----
    D. P. Kingma, J. Ba, "Adam: a method for stochastic optimization", ICLR 2015, Algorithm 1.

    Examples
    --------
    >>> p, memory = Adam(rate=0.1).step(np.array([1.0]), np.array([4.0]), None)
    >>> p.round(6).tolist()
    [0.9]
    """

    rate: float | None = None
    beta1: float = 0.9
    beta2: float = 0.999
    epsilon: float = 1e-12
    batch: int = 1
    patience: int = 20
    max_epochs: int = 200
    seed: int = 0

    def __post_init__(self) -> None:
        _check_counts(batch=self.batch, patience=self.patience, max_epochs=self.max_epochs)
        _check_counts(least=0, seed=self.seed)
        if self.rate is not None and not (np.isfinite(self.rate) and self.rate > 0.0):
            raise ValueError(f"rate: expected a positive learning rate, got {self.rate!r}")
        for name in ("beta1", "beta2"):
            if not 0.0 <= getattr(self, name) < 1.0:
                raise ValueError(f"{name}: expected 0 <= {name} < 1, got {getattr(self, name)!r}")
        if not self.epsilon > 0.0:
            raise ValueError(f"epsilon: expected a positive number, got {self.epsilon!r}")

    def step(
        self, p: FloatArray, gradient: FloatArray, memory: tuple[int, FloatArray, FloatArray] | None
    ) -> tuple[FloatArray, tuple[int, FloatArray, FloatArray]]:
        """Move p (m,) against the gradient (m,).

        Parameters
        ----------
        p, gradient : (m,) arrays
        memory : tuple, optional
            What the step before returned; None at the first.
        """
        count, mean, square = memory or (0, np.zeros_like(p), np.zeros_like(p))
        count += 1
        mean = self.beta1 * mean + (1.0 - self.beta1) * gradient
        square = self.beta2 * square + (1.0 - self.beta2) * gradient**2
        unbiased = mean / (1.0 - self.beta1**count)
        size = np.sqrt(square / (1.0 - self.beta2**count)) + self.epsilon
        return p - (0.02 if self.rate is None else self.rate) * unbiased / size, (count, mean, square)


@dataclass(frozen=True, repr=False)
class TrainResult(Result, SearchResult[PhyFilter]):
    """What :func:`train` gave.

    Attributes
    ----------
    filter : PhyFilter
        The best filter met, by the validation cost.
    rmse : float
        Root-mean-square of f - f_hat on the validation part, in the unit of f.
    history : tuple of float
        Mean cost per sample of the training segments, over each epoch as it was run.
    validation : tuple of float
        Mean cost per sample of the validation part before the first epoch and after each.
    best_epoch : int
        Epochs after which ``filter`` was met; 0 is the start.
    status : Status
        CONVERGED (no better filter for ``patience`` epochs), ITERATION_LIMIT, DIVERGED or CANCELLED.
    message : str
        The status in words, and what to try.
    """

    filter: PhyFilter
    rmse: float
    history: tuple[float, ...]
    validation: tuple[float, ...]
    best_epoch: int
    status: Status
    message: str

    @property
    def best(self) -> PhyFilter:
        """``filter``: what every search calls what it found."""
        return self.filter


@takes_former
def train(
    logs: Recording | Sequence[Recording],
    filter0: PhyFilter | SampledPhyFilter | PaperFilter,
    *,
    form: Form | None = None,
    cost: StageCost | None = None,
    terminal: StageCost | None = None,
    segment: int | None = None,
    warmup: int = 0,
    optimiser: Adam | None = None,
    coordinates: Coordinates = "coefficients",
    validation: float = 0.2,
    callback: Callable[[int, float, PhyFilter], bool | None] | None = None,
) -> TrainResult:
    """Algorithm 2: train the coefficients by Adam on mini-batches of segments, with early stopping.

    Parameters
    ----------
    logs : Recording or sequence of Recording
        Flights with a label and equal steps, all of one length of step.
    filter0 : PhyFilter, SampledPhyFilter or PaperFilter
        Where to start. A SampledPhyFilter says which discretisation is rolled out, a PaperFilter that it is the
        paper's own; a PhyFilter is sampled exactly.
    form : {"lowpass", "general"}, optional
        As for :class:`Rollout`.
    cost, terminal : StageCost, optional
        As for :func:`adjoint_gradient`.
    segment : int, optional
        Steps in a segment; each starts at rest, as in the paper. What does not fill a segment is left out. None
        takes each flight whole.
    warmup : int
        Steps run before each segment without being scored, so that it does not start at rest.
    optimiser : Adam, optional
        With its learning rate, mini-batches and most epochs; None means ``Adam()``.
    coordinates : {"coefficients", "hurwitz"}
        What the optimiser moves: the raw coefficients as in the paper, which may leave the stable region; or the
        logarithms of Routh's ratios of D (and b scaled to one size), which cannot.
    validation : float
        Share of each flight, at its end, kept to decide when to stop; 0 decides on the training part.
    callback : callable, optional
        (epoch, validation cost, filter) -> stop; called after each epoch, True stops.

    Returns
    -------
    TrainResult
        Divergence is a status, never an exception.

    Raises
    ------
    ValueError
        For options out of range, flights without label or with other steps, or too short for a segment.

    Notes
    -----
    The paper's supplement, "Formalization of parameter learning", Algorithm 2.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> f = np.sin(0.02 * np.arange(2000))[:, None]
    >>> x = 0.01 * np.cumsum(f, axis=0) + 1e-3 * rng.standard_normal((2000, 1))
    >>> log = Recording.from_arrays(x=x, dt=0.01, label=f)
    >>> result = train(log, PhyFilter([1.0]), segment=400, optimiser=Adam(rate=0.5, max_epochs=30))
    >>> result.validation[-1] < result.validation[0]
    True
    """
    _check_counts(least=0, warmup=warmup)
    if segment is not None:
        _check_counts(segment=segment)
    if coordinates not in get_args(Coordinates):
        raise ValueError(f"coordinates: expected one of {get_args(Coordinates)}, got {coordinates!r}")
    if not 0.0 <= validation < 1.0:
        raise ValueError(f"validation: expected a share from 0 to below 1, got {validation!r}")
    flights = listed(logs)
    sampled = filter0.sampled(flights[0].dt) if isinstance(filter0, PhyFilter) else filter0
    rollout = Rollout(sampled, form=form)
    parts = [(log, log) if validation == 0.0 else log.split(1.0 - validation) for log in flights]
    segments = _segments([record_of(rollout, part) for part, _ in parts], segment, warmup)
    held_out = Rollout(sampled.with_filter(sampled.filter), form=form)
    training = _Training(
        segments,
        [record_of(held_out, part) for _, part in parts],
        cost or SquaredError(),
        terminal,
        rollout,
        coordinates,
    )
    # Two threads of a BLAS make products of this size many times slower where another process runs.
    with threadpool_limits(1, user_api="blas"):
        return _descend(training, optimiser or Adam(), callback)


# -- gradients ------------------------------------------------------------------------------------------------------


def _check_counts(*, least: int = 1, **counts: int) -> None:
    for name, value in counts.items():
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
            raise ValueError(f"{name}: expected a whole number of at least {least}, got {value!r}")


def _segments(flights: Sequence[Record], length: int | None, warmup: int) -> list[Record]:
    """Segments of ``length`` steps, each with ``warmup`` steps before it."""
    if length is None:
        return [Record(f.inputs, f.label, min(warmup, len(f.label) - 2) + 1) for f in flights]
    pieces = []
    for flight in flights:
        for first in range(warmup, len(flight.label) - length, length):
            here = slice(first - warmup, first + length + 1)
            inputs = flight.inputs.samples(here.start, here.stop)
            pieces.append(Record(inputs, flight.label[here], warmup + 1))
    if not pieces:
        longest = max(len(flight.label) for flight in flights)
        raise ValueError(
            f"segment: no flight has {warmup} + {length} steps to train on, the longest {longest - 1}; "
            "shorten segment or warmup"
        )
    return pieces


@dataclass(frozen=True)
class _Training:
    """The problem, as functions of the numbers p that the optimiser moves."""

    segments: list[Record]
    held_out: list[Record]
    cost: StageCost
    terminal: StageCost | None
    rollout: Rollout
    coordinates: Coordinates
    _: KW_ONLY
    scale: FloatArray = field(init=False)  # of b beside logarithms

    def __post_init__(self) -> None:
        a = self.rollout.sampled.filter.a
        n = len(a)
        object.__setattr__(self, "scale", abs(a[0]) ** (np.arange(n, 0, -1) / n))

    def start(self) -> FloatArray:
        filter = self.rollout.sampled.filter
        general = self.rollout.form == "general"
        if self.coordinates == "coefficients":
            return np.concatenate([filter.a, filter.b]) if general else filter.a.copy()
        theta = chain_of(filter.poles).theta
        return np.concatenate([theta, filter.b / self.scale]) if general else theta

    def at(self, p: FloatArray) -> Rollout:
        """Rollout at p.

        Raises
        ------
        ValueError
            If the filter is not stable there.
        """
        n = self.rollout.sampled.order
        head, tail = p[:n], p[n:]
        if self.coordinates == "coefficients":
            filter = PhyFilter(head, tail if len(tail) else None)
        else:
            chain = Chain(head, 0.0)
            b = tail * self.scale if len(tail) else None
            filter = PhyFilter(chain.polynomials[0], b, poles=chain.poles)
        return Rollout(self.rollout.sampled.with_filter(filter), form=self.rollout.form)

    def gradient(self, p: FloatArray, rollout: Rollout, batch: Sequence[Record]) -> tuple[float, FloatArray]:
        """Mean cost per sample of a batch, and its gradient in p."""
        groups: dict[tuple[int, int], list[Record]] = {}
        for flight in batch:
            groups.setdefault((len(flight.label), flight.skip), []).append(flight)
        total = summed([gradient_of(rollout, group, self.cost, self.terminal) for group in groups.values()])
        vector = total.vector
        if self.coordinates == "hurwitz":
            n = len(total.a)
            slopes = Chain(p[:n], 0.0).polynomials[2]
            vector = np.concatenate([slopes @ total.a, vector[n:] * self.scale[: len(vector) - n]])
        return total.value / total.samples, vector / total.samples

    def score(self, rollout: Rollout) -> tuple[float, float]:
        """Mean cost per sample of the held-out part, and the rmse."""
        values, squares, samples = 0.0, 0.0, 0
        for flight in self.held_out:
            f_hat, channels = rollout.forward(flight.inputs).f_hat, flight.label.shape[1]
            values += terms_of(rollout, flight.label, f_hat, 1, channels, self.cost, self.terminal)[0]
            squares += float(np.sum((f_hat - flight.label)[1:] ** 2)) / channels
            samples += len(f_hat) - 1
        return values / samples, float(np.sqrt(squares / samples))


def _descend(
    training: _Training,
    optimiser: Adam,
    callback: Callable[[int, float, PhyFilter], bool | None] | None,
) -> TrainResult:
    rng = np.random.default_rng(optimiser.seed)
    batch, patience, max_epochs = optimiser.batch, optimiser.patience, optimiser.max_epochs
    p = training.start()
    if optimiser.rate is None and training.coordinates == "coefficients":
        a = training.rollout.sampled.filter.a
        optimiser = replace(optimiser, rate=0.02 * float(a.min()) / len(a))
    rollout, memory = training.rollout, None
    value, rmse = training.score(rollout)
    best, history, validation = (value, rmse, 0, rollout.sampled.filter), [], [value]

    def result(status: Status, message: str) -> TrainResult:
        return TrainResult(best[3], best[1], tuple(history), tuple(validation), best[2], status, message)

    for epoch in range(1, max_epochs + 1):
        order, costs = rng.permutation(len(training.segments)), []
        for first in range(0, len(order), batch):
            chosen = [training.segments[i] for i in order[first : first + batch]]
            with np.errstate(over="ignore", invalid="ignore"):
                cost, slope = training.gradient(p, rollout, chosen)
                p, memory = optimiser.step(p, slope, memory)
            try:
                if not (np.isfinite(cost) and np.all(np.isfinite(p))):
                    raise ValueError("the cost or its gradient is not finite")
                rollout = training.at(p)
            except ValueError as error:
                reason = str(error).split(";")[0]
                return result(Status.DIVERGED, f"epoch {epoch} left the stable region ({reason}); take a smaller rate, "
                    "or coordinates='hurwitz'")  # fmt: skip
            costs.append(cost)
        history.append(float(np.mean(costs)))
        value, rmse = training.score(rollout)
        validation.append(value)
        if value < best[0]:
            best = (value, rmse, epoch, rollout.sampled.filter)
        if callback is not None and callback(epoch, value, rollout.sampled.filter):
            return result(Status.CANCELLED, f"cancelled by the callback after epoch {epoch}")
        if epoch - best[2] >= patience:
            return result(Status.CONVERGED, f"no better on the held-out part for {patience} epochs")
    return result(
        Status.ITERATION_LIMIT, f"still learning after {max_epochs} epochs; raise max_epochs or the rate"
    )
