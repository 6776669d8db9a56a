"""Rollouts of a sampled filter: forwards over a record, and the costate recursion backwards.

Algorithm 1 of the paper's supplement ("Formalization of parameter learning") for two realisations of one filter:
the increment recursion, whose costate is the same filter run backwards in time, and the paper's own integrators.
A record may be cut into segments that run side by side. The filter is linear, so what enters a segment from the one
before adds its free response: the states at the borders follow from the segments' responses from rest by the same
recursion with a larger step, backwards likewise, and nothing is approximated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from typing import Literal, NamedTuple, TypeVar, get_args

import numpy as np
from numpy.typing import ArrayLike

from ... import _signals
from ..._choices import Form
from ..._sections import FloatArray
from ...execution import Executor
from ...filter import PaperFilter, SampledPhyFilter, record
from ...filter.blocked import propagate
from ...filter.recursion import Recursion, momentum
from .block_map import BLOCK, BlockMap
from .paper_rollout import PaperMap

__all__ = ["Carry", "Cotangents", "Form", "Rollout", "RolloutInputs", "RolloutTrace"]

Carry = Literal["exact", "none"]
S = TypeVar("S")
T = TypeVar("T")


class RolloutInputs(NamedTuple):
    """Signals of one record, or of several of one length side by side as further channels.

    Attributes
    ----------
    x, g : (N, n_x) arrays
    f_theta : (N, n_f) array
    inertia : (1 or N, n_x) or (1 or N, n_x, n_x) array, or None
    u : (N - 1, n_f) array
        Measured residual of each step.
    """

    x: FloatArray
    g: FloatArray
    f_theta: FloatArray
    inertia: FloatArray | None
    u: FloatArray

    @property
    def signals(self) -> FloatArray:
        """x, g and f_theta (N, 3, n_x), where there is no E."""
        return np.stack([self.x, self.g, self.f_theta], axis=1)

    def samples(self, first: int, last: int) -> RolloutInputs:
        """Samples ``first`` to ``last - 1``.

        Parameters
        ----------
        first, last : int
        """
        here, M = slice(first, last), self.inertia
        M = M if M is None or len(M) == 1 else M[here]
        return RolloutInputs(self.x[here], self.g[here], self.f_theta[here], M, self.u[first : last - 1])

    @staticmethod
    def beside(parts: Sequence[RolloutInputs]) -> RolloutInputs:
        """Records of one length as channels of one; their inertia is in ``u`` already and is left out.

        Parameters
        ----------
        parts : sequence of RolloutInputs
        """
        x, g, f_theta, u = (
            np.concatenate(columns, axis=1)
            for columns in zip(*((part.x, part.g, part.f_theta, part.u) for part in parts), strict=True)
        )
        return RolloutInputs(x, g, f_theta, None, u)


class RolloutTrace(NamedTuple):
    """A forward rollout, kept for the way back.

    Attributes
    ----------
    f_hat : (N, n_f) array
    inputs : RolloutInputs
    states : list of lists of arrays
        What the realisation needs again, segment by segment.
    """

    f_hat: FloatArray
    inputs: RolloutInputs
    states: list[list[FloatArray]]


class Cotangents(NamedTuple):
    """Gradient of sum(cotangent * f_hat), a number.

    Attributes
    ----------
    a : (n,) array
        In a_0 ... a_{n-1}; low-pass form: with b_0 = a_0 moving along.
    b : (n,) array or None
        In b_0 ... b_{n-1}; None for the low-pass form.
    x, g : (N, n_x) arrays or None
        The signals None unless asked for.
    f_theta : (N, n_f) array or None
    """

    a: FloatArray
    b: FloatArray | None
    x: FloatArray | None
    g: FloatArray | None
    f_theta: FloatArray | None


@dataclass(frozen=True, eq=False)
class Rollout:
    """A sampled filter as a differentiable map of its coefficients and signals.

    Parameters
    ----------
    sampled : SampledPhyFilter or PaperFilter
        One filter for all channels, double precision, no delay and no limit. A PaperFilter is rolled out as Eq. (5)
        prints it (forward Euler, a loop over the samples: short records only), else it is the increment recursion.
    form : {"lowpass", "general"}, optional
        Whether b_0 = a_0 moves with a, or a and b are free; None takes the form of the filter.
    segments : int
        Pieces that the record is cut into, run side by side.
    workers : int
        Threads that they run on.
    carry : {"exact", "none"}
        What enters a segment: the state (and backwards the costate) of its neighbour, exactly; or nothing, which is
        the truncated rollout: each segment starts at rest, and the gradient is off by what the borders cut.

    Raises
    ------
    ValueError
        For options out of range, or a sampled filter with a delay, a limit, float32 or a filter per channel.

    Notes
    -----
    The paper's costate recursion lambda_{i-1} = grad l_i + (grad phi_i)' lambda_i with all its terms, the one of the
    last sample included (f_hat_N depends on the coefficients).

    Examples
    --------
    >>> import numpy as np
    >>> from phyfilter_ctl import PhyFilter
    >>> rollout = Rollout(PhyFilter([20.0]).sampled(0.01))
    >>> trace = rollout.forward(rollout.inputs(np.linspace(0.0, 1.0, 11)[:, None]))
    >>> gradient = rollout.backward(trace, np.ones((11, 1)))
    >>> gradient.a.round(6).tolist()
    [1.543208]
    """

    sampled: SampledPhyFilter | PaperFilter
    _: KW_ONLY
    form: Form | None = None
    segments: int = 1
    workers: int = 1
    carry: Carry = "exact"

    def __post_init__(self) -> None:
        sampled, (chains, sampling) = self.sampled, (self._recursion.chains, self._recursion.sampling)
        if len(chains) != 1:
            raise ValueError(
                f"sampled: expected one filter for all channels, got {len(chains)}; learn each channel alone"
            )
        if sampling.delay or sampling.limit is not None or sampling.precision != "float64":
            raise ValueError(
                "sampled: expected no delay, no limit and float64, got "
                f"delay={sampling.delay:g}, limit={sampling.limit}, precision={sampling.precision!r}; learn "
                "without them"
            )
        if sampling.method == "matched":
            raise ValueError(
                "sampled: expected method 'exact', 'euler' or 'tustin', got 'matched', whose output row follows "
                "from the zeros of 1 - F; learn with 'exact' and sample the result matched"
            )
        if self.form is None:
            object.__setattr__(self, "form", "lowpass" if sampled.filter.is_lowpass else "general")
        for name, choices in (("form", Form), ("carry", Carry)):
            if getattr(self, name) not in get_args(choices):
                raise ValueError(f"{name}: expected one of {get_args(choices)}, got {getattr(self, name)!r}")
        if self.form == "lowpass" and not sampled.filter.is_lowpass:
            raise ValueError("form: 'lowpass' was asked of a filter whose N is not a_0; use form='general'")
        for name in ("segments", "workers"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 1:
                raise ValueError(f"{name}: expected a whole number of at least 1, got {value!r}")

    def inputs(
        self,
        x: ArrayLike,
        g: ArrayLike | None = None,
        f_theta: ArrayLike | None = None,
        inertia: ArrayLike | None = None,
    ) -> RolloutInputs:
        """Check the signals of a record and form the measured residual of each step.

        Parameters
        ----------
        x, g, f_theta, inertia
            As for :meth:`SampledPhyFilter.run`, at equal steps.

        Raises
        ------
        ValueError
            For wrong shapes, fewer than two samples, values that are not finite, or an inertia in the paper's
            realisation.
        """
        signals = record.checked_signals(self._recursion, x, g, f_theta, inertia)
        if len(signals[0]) < 2:
            raise ValueError(f"x: expected at least 2 samples, got {len(signals[0])}")
        held = record.held_samples(self._recursion, *signals)
        if held.any():
            raise ValueError(
                f"x, g, f_theta, inertia: not finite in row {int(np.argmax(held))}; drop or repair it"
            )
        if isinstance(self.sampled, PaperFilter) and signals[3] is not None:
            raise ValueError("inertia: a PaperFilter has none; roll out a SampledPhyFilter")
        u = record.measured_residual(self._recursion, *signals, None, slice(0, len(signals[0]) - 1))
        x, g, f_theta, u = (part.astype(float, copy=False) for part in (*signals[:3], u))
        M = signals[3]
        return RolloutInputs(x, g, f_theta, None if M is None else M.astype(float, copy=False), u)

    def forward(self, inputs: RolloutInputs) -> RolloutTrace:
        """Roll the filter out over a record, from rest.

        Parameters
        ----------
        inputs : RolloutInputs
            From :meth:`inputs`.
        """
        if isinstance(self.sampled, PaperFilter):
            f_hat, states = self._paper(self.sampled).forward(inputs.signals)
            return RolloutTrace(f_hat, inputs, [states])
        f_hat = inputs.f_theta.copy()
        pieces = self._pieces(len(inputs.u))
        starts = self._borders(pieces, lambda rows: self._map.final_state(inputs.u[rows]), forwards=True)

        def work(i: int) -> list[FloatArray]:
            y, states = self._map.respond(inputs.u[pieces[i]], starts[:, i])
            f_hat[1:][pieces[i]] += y
            return states

        return RolloutTrace(f_hat, inputs, self.side_by_side(work, range(len(pieces))))

    def backward(self, trace: RolloutTrace, cotangent: FloatArray, *, signals: bool = False) -> Cotangents:
        """Run the costate back over a record.

        Parameters
        ----------
        trace : RolloutTrace
            From :meth:`forward`.
        cotangent : (N, n_f) array
            Gradient of the cost in each f_hat.
        signals : bool
            Whether to give the gradient in x, g and f_theta as well.

        Returns
        -------
        Cotangents

        Raises
        ------
        ValueError
            If ``cotangent`` has another shape than f_hat.
        """
        r = _signals.array("cotangent", cotangent, trace.f_hat.shape, beside="f_hat")
        if isinstance(self.sampled, PaperFilter):
            p, inward = self._paper(self.sampled).backward(
                trace.inputs.signals, trace.f_hat, trace.states[0], r
            )
            n = self.sampled.order
            general = self.form == "general"
            return Cotangents(p[:n], p[n:] if general else None, *(inward if signals else (None, None, None)))
        pieces = self._pieces(len(r) - 1)
        u, after = trace.inputs.u, r[1:]
        ends = self._borders(pieces, lambda rows: self._map.first_costate(after[rows]), forwards=False)

        def work(i: int) -> tuple[FloatArray, FloatArray | None]:
            rows = pieces[i]
            return self._map.pull_back(u[rows], after[rows], trace.states[i], ends[:, i], inputs=signals)

        gradients, parts = zip(*self.side_by_side(work, range(len(pieces))), strict=True)
        raw = np.sum(gradients, axis=0) / self._map.scale
        a, b = np.split(raw, 2)
        if self.form == "lowpass":
            a[0] += b[0]
        inward = self._to_signals(trace.inputs, r, np.concatenate(parts)) if signals else (None, None, None)
        return Cotangents(a, b if self.form == "general" else None, *inward)

    def side_by_side(self, work: Callable[[S], T], tasks: Iterable[S]) -> list[T]:
        """Results of ``work`` on each of ``tasks``, on the threads of this rollout."""
        tasks = list(tasks)
        with Executor(max(1, min(self.workers, len(tasks))), kind="threads") as executor:
            return list(executor.map(work, tasks))

    @property
    def _recursion(self) -> Recursion:
        sampled = self.sampled.increments if isinstance(self.sampled, PaperFilter) else self.sampled
        return sampled.recursion

    @cached_property
    def _map(self) -> BlockMap:
        return BlockMap.build(self.sampled.filter, self._recursion.sampling.method, self.sampled.dt)

    def _paper(self, paper: PaperFilter) -> PaperMap:
        return PaperMap.build(paper, lowpass=self.form == "lowpass")

    def _pieces(self, count: int) -> list[slice]:
        """Steps cut into segments of whole blocks, of one length but the last."""
        length = BLOCK * -(-count // (BLOCK * self.segments))
        return [slice(first, min(first + length, count)) for first in range(0, count, length)]

    def _borders(
        self, pieces: list[slice], alone: Callable[[slice], FloatArray], *, forwards: bool
    ) -> FloatArray:
        """States before each segment, or costates after it, (K, segments, n).

        ``alone`` gives what a segment passes on when nothing enters it.
        """
        n, count = self.sampled.order, len(pieces)
        inner = pieces[:-1] if forwards else pieces[:0:-1]
        if not inner or self.carry == "none":
            channels = alone(slice(0, 0)).shape[0]
            return np.zeros((channels, count, n))
        passed = np.stack(self.side_by_side(alone, inner), axis=1)
        over = self._map.transition((pieces[0].stop - pieces[0].start) // BLOCK)
        start = np.zeros((len(passed), n))
        entering = propagate((over if forwards else over.T)[None], passed, start, refine=True)
        entering = np.concatenate([start[:, None], entering], axis=1)
        return entering if forwards else entering[:, ::-1]

    def _to_signals(
        self, inputs: RolloutInputs, r: FloatArray, cotangent: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Cotangents of x, g and f_theta from those of f_hat and u: the transpose of the measured residual."""
        sampling, E_left = self._recursion.sampling, self._recursion.E_left
        f_theta = r.copy()
        _spread(f_theta, cotangent, hold=sampling.f_theta == "hold")
        if E_left is not None:
            cotangent = cotangent @ E_left
        g = np.zeros(inputs.g.shape)
        _spread(g, cotangent, hold=sampling.g == "hold")
        M = inputs.inertia
        if M is not None:
            M = M if len(M) == 1 else 0.5 * (M[1:] + M[:-1])
            M = M if M.ndim == 2 else M.transpose(0, 2, 1)
            cotangent = momentum(M, cotangent).astype(float, copy=False)
        x = np.zeros(inputs.x.shape)
        x[1:] += cotangent / sampling.dt
        x[:-1] -= cotangent / sampling.dt
        return x, g, f_theta


def _spread(target: FloatArray, cotangent: FloatArray, *, hold: bool) -> None:
    """Take the cotangent (N - 1, K) of a mean over each step from the samples (N, K) that it was formed of."""
    if hold:
        target[:-1] -= cotangent
    else:
        target[:-1] -= 0.5 * cotangent
        target[1:] -= 0.5 * cotangent
