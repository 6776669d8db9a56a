"""The paper's Algorithms 1 and 2: the gradient by a rollout forwards and costates backwards, and training with it.

Algorithm 2 is a first-order method on raw coefficients and needs a learning rate for each order. For a sum of squares
Gauss-Newton on exact sensitivities is the better tool; this one takes any stage cost and any discretised filter.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from itertools import pairwise
from typing import Literal, get_args

import numpy as np
from threadpoolctl import threadpool_limits

from ..._sections import FloatArray
from ...filter import PhyFilter
from ...flightlog import FlightLog
from ...sampled import SampledPhyFilter
from ..learning.parametrisation import Chain, chain_of
from .costs import CasadiCost, CostTerms, SquaredError, StageCost
from .rollout import Carry, Form, Inputs, Rollout

__all__ = [
    "Adam",
    "AdjointGradient",
    "CasadiCost",
    "CostTerms",
    "SquaredError",
    "StageCost",
    "TrainResult",
    "adjoint_gradient",
    "train",
]

Coordinates = Literal["coefficients", "hurwitz"]
# Samples whose cost is formed at once: its temporaries stay in the cache.
_COST_ROWS = 1 << 15
# A log's own step may differ from that of the sampled filter by its rounding.
_SAME_STEP = 1e-6


@dataclass(frozen=True)
class AdjointGradient:
    """A cost over one or many records and its gradient.

    Attributes
    ----------
    value : float
        sum l_i + l_N over all samples but the first of each record, where f_hat is f_theta whatever the filter.
    a : (n,) array
        Gradient in a_0 ... a_{n-1}; in the low-pass form b_0 = a_0 moves along.
    b : (n,) array, optional
        Gradient in b_0 ... b_{n-1}; None in the low-pass form.
    samples : int
        Samples in the sum.
    """

    value: float
    a: FloatArray
    b: FloatArray | None
    samples: int

    @property
    def vector(self) -> FloatArray:
        """a, then b in the general form."""
        return self.a if self.b is None else np.concatenate([self.a, self.b])


def adjoint_gradient(
    logs: FlightLog | Sequence[FlightLog],
    sampled: SampledPhyFilter,
    *,
    form: Form | None = None,
    cost: StageCost | None = None,
    terminal: StageCost | None = None,
    segments: int = 1,
    workers: int = 1,
    carry: Carry = "exact",
) -> AdjointGradient:
    """Algorithm 1: the cost of a filter over labelled flights and its gradient in the coefficients.

    Parameters
    ----------
    logs : FlightLog or sequence of FlightLog
        Flights with a label (the true f) and equal steps of ``sampled.dt``.
    sampled : SampledPhyFilter
        The filter, any discretisation and realisation; see :class:`Rollout`.
    form, segments, workers, carry
        As for :class:`Rollout`.
    cost : StageCost, optional
        l_i(f_i, f_hat_i, a); None means :class:`SquaredError`.
    terminal : StageCost, optional
        l_N of the last sample of each flight; None means ``cost``.

    Returns
    -------
    AdjointGradient

    Raises
    ------
    ValueError
        If a flight has no label, steps that differ or another step than the filter; and as for :class:`Rollout`.

    Notes
    -----
    The paper's supplement, "Formalization of parameter learning", with the term grad_a l_N that its printed gradient
    lacks. Cost: about three passes of the filter, linear in the samples.

    Examples
    --------
    >>> import numpy as np
    >>> from phyfilter_ctl import PhyFilter
    >>> t = 0.01 * np.arange(200)
    >>> log = FlightLog.from_arrays(x=(1.0 - np.cos(t))[:, None], dt=0.01, label=np.sin(t)[:, None])
    >>> gradient = adjoint_gradient(log, PhyFilter([20.0]).sampled(0.01))
    >>> bool(gradient.a[0] < 0.0)  # a faster filter would be better: there is no noise
    True
    """
    rollout = Rollout(sampled, form=form, segments=segments, workers=workers, carry=carry)
    flights = [_flight(rollout, log) for log in _sequence(logs)]
    return _sum([_gradient(rollout, [flight], cost or SquaredError(), terminal) for flight in flights])


@dataclass(frozen=True)
class Adam:
    """The optimiser of Algorithm 2.

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

    def __post_init__(self) -> None:
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


@dataclass(frozen=True)
class TrainResult:
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
    status : {"converged", "epoch_limit", "diverged", "stopped"}
        "converged": no better filter for ``patience`` epochs. "stopped": the callback asked for it.
    message : str
        The status in words, and what to try.
    """

    filter: PhyFilter
    rmse: float
    history: tuple[float, ...]
    validation: tuple[float, ...]
    best_epoch: int
    status: Literal["converged", "epoch_limit", "diverged", "stopped"]
    message: str


def train(
    logs: FlightLog | Sequence[FlightLog],
    filter0: PhyFilter | SampledPhyFilter,
    *,
    form: Form | None = None,
    cost: StageCost | None = None,
    terminal: StageCost | None = None,
    segment: int | None = None,
    warmup: int = 0,
    batch: int = 1,
    optimiser: Adam | None = None,
    coordinates: Coordinates = "coefficients",
    validation: float = 0.2,
    patience: int = 20,
    epochs: int = 200,
    callback: Callable[[int, float, PhyFilter], bool | None] | None = None,
    seed: int = 0,
) -> TrainResult:
    """Algorithm 2: train the coefficients by Adam on mini-batches of segments, with early stopping.

    Parameters
    ----------
    logs : FlightLog or sequence of FlightLog
        Flights with a label and equal steps, all of one length of step.
    filter0 : PhyFilter or SampledPhyFilter
        Where to start. A SampledPhyFilter says which discretisation is rolled out (``realisation="paper"`` for the
        paper's own); a PhyFilter is sampled exactly.
    form : {"lowpass", "general"}, optional
        As for :class:`Rollout`.
    cost, terminal : StageCost, optional
        As for :func:`adjoint_gradient`.
    segment : int, optional
        Steps in a segment; each starts at rest, as in the paper. What does not fill a segment is left out. None
        takes each flight whole.
    warmup : int
        Steps run before each segment without being scored, so that it does not start at rest.
    batch : int
        Segments whose gradients are added before a step of the optimiser.
    optimiser : Adam, optional
        With its learning rate; None means ``Adam()``.
    coordinates : {"coefficients", "hurwitz"}
        What the optimiser moves: the raw coefficients as in the paper, which may leave the stable region; or the
        logarithms of Routh's ratios of D (and b scaled to one size), which cannot.
    validation : float
        Share of each flight, at its end, kept to decide when to stop; 0 decides on the training part.
    patience : int
        Epochs without a better validation cost before it stops.
    epochs : int
        Most passes over the segments.
    callback : callable, optional
        (epoch, validation cost, filter) -> stop; called after each epoch, True stops.
    seed : int
        Seed of the order of the segments.

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
    >>> log = FlightLog.from_arrays(x=x, dt=0.01, label=f)
    >>> result = train(log, PhyFilter([1.0]), segment=400, optimiser=Adam(rate=0.5), epochs=30)
    >>> result.validation[-1] < result.validation[0]
    True
    """
    _check_options(segment=segment, warmup=warmup, batch=batch, patience=patience, epochs=epochs)
    if coordinates not in get_args(Coordinates):
        raise ValueError(f"coordinates: expected one of {get_args(Coordinates)}, got {coordinates!r}")
    if not 0.0 <= validation < 1.0:
        raise ValueError(f"validation: expected a share from 0 to below 1, got {validation!r}")
    flights = _sequence(logs)
    sampled = filter0.sampled(flights[0].dt) if isinstance(filter0, PhyFilter) else filter0
    rollout = Rollout(sampled, form=form)
    parts = [(log, log) if validation == 0.0 else log.split(1.0 - validation) for log in flights]
    segments = _segments([_flight(rollout, part) for part, _ in parts], segment, warmup)
    held_out = Rollout(sampled.with_filter(sampled.filter), form=form)
    training = _Training(
        segments,
        [_flight(held_out, part) for _, part in parts],
        cost or SquaredError(),
        terminal,
        rollout,
        coordinates,
    )
    # Two threads of a BLAS make products of this size many times slower where another process runs.
    with threadpool_limits(1, user_api="blas"):
        return _descend(training, optimiser or Adam(), batch, patience, epochs, callback, seed)


# -- gradients ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Flight:
    """A record with what it is compared to."""

    inputs: Inputs
    label: FloatArray  # (N, n_f)
    skip: int = 1  # samples at its start that are not scored


def _sequence(logs: FlightLog | Sequence[FlightLog]) -> list[FlightLog]:
    flights = [logs] if isinstance(logs, FlightLog) else list(logs)
    if not flights:
        raise ValueError("logs: expected at least one flight, got none")
    return flights


def _flight(rollout: Rollout, log: FlightLog, f_theta: FloatArray | None = None) -> _Flight:
    name = f"log {log.name!r}" if log.name else "log"
    if log.label is None:
        raise ValueError(
            f"{name}: expected a label (the true f) to learn from, got none; add it with with_signals"
        )
    dt = rollout.sampled.dt
    if not log.is_uniform or abs(log.dt - dt) > _SAME_STEP * dt:
        steps = f"steps of {log.dt:g} s" if log.is_uniform else "steps that differ"
        raise ValueError(
            f"{name}: expected equal steps of {dt:g} s as in the filter, got {steps}; use resample({dt:g})"
        )
    f_theta = log.f_theta if f_theta is None else f_theta
    return _Flight(rollout.inputs(log.x, log.g, f_theta, log.inertia), log.label)


def _gradient(
    rollout: Rollout, flights: Sequence[_Flight], cost: StageCost, terminal: StageCost | None
) -> AdjointGradient:
    """Over flights of one length, run side by side as channels."""
    channels = flights[0].label.shape[1]
    inputs = flights[0].inputs if len(flights) == 1 else Inputs.beside([flight.inputs for flight in flights])
    trace = rollout.forward(inputs)
    label = np.concatenate([flight.label for flight in flights], axis=1)
    value, r, direct = _terms(rollout, label, trace.f_hat, flights[0].skip, channels, cost, terminal)
    back = rollout.backward(trace, r)
    samples = (len(label) - flights[0].skip) * len(flights)
    return AdjointGradient(value, back.a + direct, back.b, samples)


def _terms(
    rollout: Rollout,
    label: FloatArray,
    f_hat: FloatArray,
    skip: int,
    channels: int,
    cost: StageCost,
    terminal: StageCost | None,
) -> tuple[float, FloatArray, FloatArray]:
    """Cost, its gradient in f_hat and its direct gradient in a. Sums over samples may be formed in parts."""
    N, a = len(label), rollout.sampled.filter.a
    last = N if terminal is None else N - 1
    bounds = [*range(skip, last, _COST_ROWS), last]
    tasks = [(cost, slice(one, two)) for one, two in pairwise(bounds)]
    if terminal is not None:
        tasks.append((terminal, slice(N - 1, N)))
    r = np.zeros(f_hat.shape)

    def work(task: tuple[StageCost, slice]) -> tuple[float, FloatArray]:
        one, rows = task
        terms = one(label[rows].reshape(-1, channels), f_hat[rows].reshape(-1, channels), a)
        r[rows] = terms.f_hat.reshape(r[rows].shape)
        return terms.value, terms.a

    values, direct = zip(*rollout.side_by_side(work, tasks), strict=True)
    return float(np.sum(values)), r, np.sum(direct, axis=0)


def _sum(parts: Sequence[AdjointGradient]) -> AdjointGradient:
    free = [part.b for part in parts if part.b is not None]
    b = np.sum(free, axis=0) if free else None
    return AdjointGradient(
        float(np.sum([part.value for part in parts])),
        np.sum([part.a for part in parts], axis=0),
        b,
        sum(part.samples for part in parts),
    )


# -- training -------------------------------------------------------------------------------------------------------


def _check_options(*, segment: int | None, **counts: int) -> None:
    least = {"warmup": 0}
    for name, value in (counts | ({} if segment is None else {"segment": segment})).items():
        low = least.get(name, 1)
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < low:
            raise ValueError(f"{name}: expected a whole number of at least {low}, got {value!r}")


def _segments(flights: Sequence[_Flight], length: int | None, warmup: int) -> list[_Flight]:
    """Segments of ``length`` steps, each with ``warmup`` steps before it."""
    if length is None:
        return [_Flight(f.inputs, f.label, min(warmup, len(f.label) - 2) + 1) for f in flights]
    pieces = []
    for flight in flights:
        for first in range(warmup, len(flight.label) - length, length):
            here = slice(first - warmup, first + length + 1)
            inputs = flight.inputs.samples(here.start, here.stop)
            pieces.append(_Flight(inputs, flight.label[here], warmup + 1))
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

    segments: list[_Flight]
    held_out: list[_Flight]
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

    def gradient(self, p: FloatArray, rollout: Rollout, batch: Sequence[_Flight]) -> tuple[float, FloatArray]:
        """Mean cost per sample of a batch, and its gradient in p."""
        groups: dict[tuple[int, int], list[_Flight]] = {}
        for flight in batch:
            groups.setdefault((len(flight.label), flight.skip), []).append(flight)
        total = _sum([_gradient(rollout, group, self.cost, self.terminal) for group in groups.values()])
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
            values += _terms(rollout, flight.label, f_hat, 1, channels, self.cost, self.terminal)[0]
            squares += float(np.sum((f_hat - flight.label)[1:] ** 2)) / channels
            samples += len(f_hat) - 1
        return values / samples, float(np.sqrt(squares / samples))


def _descend(
    training: _Training,
    optimiser: Adam,
    batch: int,
    patience: int,
    epochs: int,
    callback: Callable[[int, float, PhyFilter], bool | None] | None,
    seed: int,
) -> TrainResult:
    rng = np.random.default_rng(seed)
    p = training.start()
    if optimiser.rate is None and training.coordinates == "coefficients":
        a = training.rollout.sampled.filter.a
        optimiser = replace(optimiser, rate=0.02 * float(a.min()) / len(a))
    rollout, memory = training.rollout, None
    value, rmse = training.score(rollout)
    best, history, validation = (value, rmse, 0, rollout.sampled.filter), [], [value]

    def result(
        status: Literal["converged", "epoch_limit", "diverged", "stopped"], message: str
    ) -> TrainResult:
        return TrainResult(best[3], best[1], tuple(history), tuple(validation), best[2], status, message)

    for epoch in range(1, epochs + 1):
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
                return result("diverged", f"epoch {epoch} left the stable region ({reason}); take a smaller rate, "
                    "or coordinates='hurwitz'")  # fmt: skip
            costs.append(cost)
        history.append(float(np.mean(costs)))
        value, rmse = training.score(rollout)
        validation.append(value)
        if value < best[0]:
            best = (value, rmse, epoch, rollout.sampled.filter)
        if callback is not None and callback(epoch, value, rollout.sampled.filter):
            return result("stopped", f"stopped by the callback after epoch {epoch}")
        if epoch - best[2] >= patience:
            return result("converged", f"no better on the held-out part for {patience} epochs")
    return result("epoch_limit", f"still learning after {epochs} epochs; raise epochs or the rate")
