"""The paper's Algorithm 1: the gradient of any sum of stage costs, by a rollout forwards and costates backwards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..._sections import FloatArray
from ...filter import PaperFilter, SampledPhyFilter
from ...recording import Recording
from ...recording.checks import refuse_gaps
from ...results import Result
from .costs import SquaredError, StageCost
from .rollout import Carry, Form, Rollout, RolloutInputs

__all__ = ["AdjointGradient", "adjoint_gradient"]

# Samples whose cost is formed at once: its temporaries stay in the cache.
_COST_ROWS = 1 << 15
# A log's own step may differ from that of the sampled filter by its rounding.
_SAME_STEP = 1e-6


@dataclass(frozen=True, repr=False)
class AdjointGradient(Result):
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
    logs: Recording | Sequence[Recording],
    sampled: SampledPhyFilter | PaperFilter,
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
    logs : Recording or sequence of Recording
        Flights with a label (the true f) and equal steps of ``sampled.dt``.
    sampled : SampledPhyFilter or PaperFilter
        The filter, any discretisation, or as the paper prints it; see :class:`Rollout`.
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
    >>> log = Recording.from_arrays(x=(1.0 - np.cos(t))[:, None], dt=0.01, label=np.sin(t)[:, None])
    >>> gradient = adjoint_gradient(log, PhyFilter([20.0]).sampled(0.01))
    >>> bool(gradient.a[0] < 0.0)  # a faster filter would be better: there is no noise
    True
    """
    rollout = Rollout(sampled, form=form, segments=segments, workers=workers, carry=carry)
    flights = [record_of(rollout, log) for log in listed(logs)]
    return summed([gradient_of(rollout, [flight], cost or SquaredError(), terminal) for flight in flights])


# -- records, shared with training and joint learning ------------------------------------------------------------


@dataclass(frozen=True)
class Record:
    """A record with what it is compared to."""

    inputs: RolloutInputs
    label: FloatArray  # (N, n_f)
    skip: int = 1  # samples at its start that are not scored


def listed(logs: Recording | Sequence[Recording]) -> list[Recording]:
    """One flight or several as a list that is not empty."""
    flights = [logs] if isinstance(logs, Recording) else list(logs)
    if not flights:
        raise ValueError("logs: expected at least one flight, got none")
    return flights


def record_of(rollout: Rollout, log: Recording, f_theta: FloatArray | None = None) -> Record:
    """A flight with its label, sampled as the filter is; f_theta is the log's if None."""
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
    refuse_gaps(log.name, log.missing)
    f_theta = log.f_theta if f_theta is None else f_theta
    return Record(rollout.inputs(log.x, log.g, f_theta, log.inertia), log.label)


def gradient_of(
    rollout: Rollout, flights: Sequence[Record], cost: StageCost, terminal: StageCost | None
) -> AdjointGradient:
    """Over flights of one length, run side by side as channels."""
    channels = flights[0].label.shape[1]
    inputs = (
        flights[0].inputs
        if len(flights) == 1
        else RolloutInputs.beside([flight.inputs for flight in flights])
    )
    trace = rollout.forward(inputs)
    label = np.concatenate([flight.label for flight in flights], axis=1)
    value, r, direct = terms_of(rollout, label, trace.f_hat, flights[0].skip, channels, cost, terminal)
    back = rollout.backward(trace, r)
    samples = (len(label) - flights[0].skip) * len(flights)
    return AdjointGradient(value, back.a + direct, back.b, samples)


def terms_of(
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


def summed(parts: Sequence[AdjointGradient]) -> AdjointGradient:
    """Cost, gradient and number of samples over all parts."""
    free = [part.b for part in parts if part.b is not None]
    b = np.sum(free, axis=0) if free else None
    return AdjointGradient(
        float(np.sum([part.value for part in parts])),
        np.sum([part.a for part in parts], axis=0),
        b,
        sum(part.samples for part in parts),
    )


# -- training -------------------------------------------------------------------------------------------------------
