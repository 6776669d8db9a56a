"""Learning a filter from flights whose true f is known: least squares, certain and without a learning rate.

    min_F sum_k w_k |gamma*_k - (F u)_k|^2,    gamma* = label - f_theta,    u = M x' - g - f_theta, mean over each step

In the increment form the filter is a linear system from u to gamma*, so learning it is output-error identification.
Levenberg and Marquardt's descent runs on exact sensitivities of the sampled filter, from many starts, order by order.
"""

from __future__ import annotations

import operator
import warnings
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import partial
from typing import Any, Literal, SupportsIndex, get_args, overload

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from ... import _signals
from ..._renamed import takes_former_options
from ...filter import PhyFilter, Sampling
from ...filter.sampling import Method
from ...recording import Recording
from ...results import Status
from .answer import Asked, answer, rmse
from .axes import AxesResult, compared, one_each, refuse_beside
from .constraints import LoopGoal
from .coordinates import FASTEST
from .correlation import MOST_LAGS, memory
from .evidence import Where
from .in_loop import keep_limits
from .label_check import label_faults, label_sums
from .levenberg import Descent
from .options import LearnEvent, Read, Reading, Search, begun_from, reading_of
from .reading import Reader, Recordings
from .residuals import Flight, gap_notes, other_channels, refuse_uninformative
from .result import LearnResult
from .search import OrderSearch
from .sensitivity import Data
from .shape import Form, Shape, refuse_order, shape_of
from .sources import sources
from .stored import StoredFlights

__all__ = ["learn"]

Label = Literal["given", "offset"]
ByAxis = Literal["shared", "each", "compare"]

HIGHEST_ORDER = 12
# A decay rate of 2 pi / T settles to 0.2 % within a flight of T, and flights resolve frequencies 2 pi / T apart.
_SHOWN = 2.0 * np.pi
_SLOW = 0.1  # of the sampling rate: what is slow in logs of a few samples
_SAME_RATE = 0.01  # share by which the filter's step may differ from the recordings' unnoted
_SHORT = 200  # samples a coefficient below which an order is cross-validated unasked


@overload
def learn(
    recordings: Recordings,
    order: SupportsIndex | Sequence[SupportsIndex],
    *,
    shape: Shape | Form = ...,
    sampling: Sampling | None = ...,
    channels: Sequence[int | str] | None = ...,
    axes: Literal["shared"] = ...,
    weights: ArrayLike | Sequence[ArrayLike] | None = ...,
    label: Label = ...,
    held_out: Recordings | None = ...,
    loop: LoopGoal | None = ...,
    search: Search | None = ...,
    reading: Read | None = ...,
) -> LearnResult: ...
@overload
def learn(
    recordings: Recordings,
    order: SupportsIndex | Sequence[SupportsIndex],
    *,
    shape: Shape | Form = ...,
    sampling: Sampling | None = ...,
    channels: Sequence[int | str] | None = ...,
    axes: Literal["each", "compare"],
    weights: ArrayLike | Sequence[ArrayLike] | None = ...,
    label: Label = ...,
    held_out: Recordings | None = ...,
    loop: LoopGoal | None = ...,
    search: Search | None = ...,
    reading: Read | None = ...,
) -> AxesResult: ...
@takes_former_options
def learn(
    recordings: Recordings,
    order: SupportsIndex | Sequence[SupportsIndex],
    *,
    shape: Shape | Form = "lowpass",
    sampling: Sampling | None = None,
    channels: Sequence[int | str] | None = None,
    axes: ByAxis = "shared",
    weights: ArrayLike | Sequence[ArrayLike] | None = None,
    label: Label = "given",
    held_out: Recordings | None = None,
    loop: LoopGoal | None = None,
    search: Search | None = None,
    reading: Read | None = None,
) -> LearnResult | AxesResult:
    """Return the filter of an order that fits f best on flights, and how far it is from the best possible one.

    Parameters
    ----------
    recordings : Recording, path, or sequence of Recording, path or function () -> Recording
        Flights with a label, the true f = M x' - g, of the same channels; they stay apart. A missing f_theta or g is 0.
        Steps may differ, within a flight and between flights. Files are read when they are needed, not kept; of a
        folder every table (Parquet, Arrow, Feather, CSV) is a flight. Or one function () -> iterable of Recording,
        called anew for every pass.
    order : int or sequence of int
        Order n of D, 1 to 12. Lower orders are learned on the way. Of several orders, ``range(1, 7)``, the one that
        cross-validation chooses is returned.
    shape : Shape or {"lowpass", "general"}
        What F is made to be: a word for N = a_0 or N free with F(0) = 1, or further conditions.
    sampling : Sampling, optional
        With what the filter will run: method, rules of g and f_theta, delay of x (the label is not delayed), what the
        actuators leave of g (where the recordings hold commands beyond it), the inertia of recordings that have none,
        and E: f_theta and label of the recordings are what acts on x, E f. Its limit plays no part in learning, nor
        does its precision. Without ``dt`` the filter runs at the step of the first recording. With ``channels`` limits
        of g and an inertia are single numbers.
    channels : sequence of int or str, optional
        Channels that take part, by number or name; None means all.
    axes : {"shared", "each", "compare"}
        One filter for all channels; one for each, as :func:`~phyfilter_ctl.stack` makes a bank of them; or the choice,
        by cross-validation, among one, one each and a matrix, a bank in coordinates in which the axes are not coupled.
        Flights are cut and carried into other coordinates for that: of ``sampling`` only method, rules and delay, and
        neither ``weights`` nor ``held_out``.
    weights : array_like or sequence of array_like, optional
        How much the squared errors count, one entry a recording: a number, (N,) or (N, K) for the K channels that take
        part. For a single Recording the entry itself.
    label : {"given", "offset"}
        "offset": the label of each recording and channel may be off by a constant, which is fitted along: for labels
        that have lost their mean. Errors are then less their mean over the recording.
    held_out : as ``recordings``, optional
        Recordings that are scored, not learned from.
    loop : LoopGoal, optional
        The loop f_hat is fed back in, and the margins and limits that the filter must keep there. ``orders`` and
        ``flights`` of the result stay those of the filter learned without it, which chooses the largest order; a filter
        that limits bind has no ``intervals`` and is not compared with the Wiener filter.
    search : Search, optional
        Starts, seed, iterations, regularisation, a callback.
    reading : Reading, Robot or callable, optional
        How files are read: a robot, a function path -> Recording, or what many files need besides; and how much of
        every beginning is left out.

    Returns
    -------
    LearnResult
        With ``axes="shared"``.
    AxesResult
        Otherwise.

    Raises
    ------
    TypeError
        If ``recordings`` or an option hold something else.
    ValueError
        If a label is missing, there are fewer samples than parameters, the residual is constant, the order is outside
        1 to 12 or too low for the conditions on F, or an option is none of the above.

    Warns
    -----
    UserWarning
        If a label cannot be f: over whole flights its mean is not that of M x' - g, it differs by g itself, or it is of
        another unit, sign or channel. If g acts later than it is logged. If
        flights disagree. If no filter keeps the limits of ``loop``.

    Notes
    -----
    D is parametrised by the logarithms of its Schwarz form (Routh's ratios): Hurwitz for any value, every D met once,
    no branch where poles meet. The decay rates of the poles add up to at most 3 n / h (h the longest step) and each is
    at least 2 pi / T (T the longest flight); frequencies stay below the Nyquist frequency. N enters linearly and is
    solved for (variable projection: Golub and Pereyra, SIAM J. Numer. Anal. 10 (1973)). Derivatives are those of
    the sampled filter: the chain with doubled poles is discretised as a whole.

    Flights of equal steps are reduced to correlations once, exactly, so a step costs as many operations as the filter
    remembers samples, whatever the length and number of flights. Unequal steps and weights of single samples are
    summed sample by sample; there the trials run on the mean step (and weighted signals), the answer does not.

    Over a gap in the times, more than 20 steps, the filter makes no step and goes on from the next sample, as ``run``
    does. ``result.sampled()`` has the median step of the first flight.

    Conditions on F are linear in N and hold exactly (least squares with equality constraints). With limits on single
    poles or given ones D is a product of sections instead, in a box of its own.

    The general form of order n contains that of order n - 1: its cost never rises. A low-pass filter whose bounded
    additional pole does not pay is not returned; the lower order is. Nor is a general filter with |1 - F(0)| > 1, or
    with |1 - F| > 2 (the largest sensitivity that loops are designed for) where a flight shows three periods at most:
    where a label has lost its mean or drifts, slow poles follow it at frequencies at which the residual itself holds
    little, and the price is paid by the first steady residual.

    Several orders: the lowest within one standard error of the best cross-validated one is returned (Breiman et al.,
    1984), the error that of the difference between the two, fold by fold; within two where there are fewer than five
    flights and folds are blocks of them, which know nothing of how flights differ.

    Files are read once for the whole descent, whatever their number, and some times more for folds and scores. What is
    kept of each is its beginning, for intervals, and its end, 128 MB of all together: for a filter that remembers more
    than that they are read again once a step, as are flights of unequal steps or with weights of single samples; folds
    take the record to have begun there. Sums go in the order of the flights, so the answer does not depend on what
    reads them. A process holds two flights.

    The Wiener floor, the intervals, the table of orders and that of flights are computed when ``result.wiener``,
    ``.intervals``, ``.orders`` and ``.flights`` are asked for the first time; files are read again for all but the
    intervals. Of recordings in memory the result keeps u and gamma* up to 16 MB, of more of them correlations by fold
    and u before every cut, as far back as these reach; and for intervals the beginnings of all, 100,000 samples. Where
    steps differ, samples have weights, the rule is "matched" or the filter remembers much of each recording, u and
    gamma* are kept whatever they take.

    Examples
    --------
    A label made by a known filter is learned back:

    >>> import numpy as np
    >>> from phyfilter_ctl import Recording, PhyFilter
    >>> x = np.cumsum(np.random.default_rng(0).standard_normal((2000, 1)), axis=0)
    >>> label = PhyFilter([400.0, 30.0]).sampled(0.01).run(x)
    >>> result = learn(Recording.from_arrays(x=x, dt=0.01, label=label), 2)
    >>> result.filter.a.round(4).tolist()
    [400.0, 30.0]
    """
    _orders(order)
    wanted, how, made = shape_of(shape), Search() if search is None else search, reading_of(reading)
    if not isinstance(how, Search):
        raise TypeError(f"search: expected a Search, got {type(how).__name__}")
    asked = _sampling(sampling, channels)
    for name, value, choices in (("label", label, Label), ("axes", axes, ByAxis)):
        if value not in get_args(choices):
            raise ValueError(f"{name}: expected one of {', '.join(get_args(choices))}, got {value!r}")
    options: dict[str, Any] = {"shape": wanted, "label": label, "loop": loop, "how": how}
    if axes == "each":
        learner = partial(_learned, order=order, held_out=held_out, made=made, **options)
        entries = _weights(weights, isinstance(recordings, Recording))
        return one_each(recordings, learner, channels, asked, entries, made)
    if axes == "compare":
        refuse_beside(weights=weights, held_out=held_out)
        learner = partial(_learned, order=order, sampling=asked, made=made, **options)
        return compared(recordings, learner, channels, asked, made)
    return _learned(
        recordings,
        order,
        sampling=asked,
        channels=channels,
        weights=_weights(weights, isinstance(recordings, Recording)),
        held_out=held_out,
        made=made,
        **options,
    )


def _learned(
    recordings: Recordings,
    order: SupportsIndex | Sequence[SupportsIndex],
    *,
    shape: Shape,
    sampling: Sampling,
    label: Label,
    loop: LoopGoal | None,
    how: Search,
    made: Reading,
    channels: Sequence[int | str] | None = None,
    weights: Sequence[ArrayLike] | None = None,
    held_out: Recordings | None = None,
) -> LearnResult:
    """One filter for all channels that take part."""
    orders = _orders(order)
    n, offset = max(orders), label == "offset"
    refuse_order(shape, min(orders))
    begins = begun_from(how, n)
    with ExitStack() as stack:
        reader = Reader(stack, made, {"channels": channels, "sampling": sampling, "skip": made.skip})
        flights, skipped = reader.flights("recordings", recordings, weights)
        refuse_uninformative(flights, n)
        tests, bad = ([], ()) if held_out is None else reader.flights("held_out", held_out, None)
        if tests and (fault := other_channels(tests[0], flights[0])):
            raise ValueError(f"held_out: {fault}")
        sampling.check_channels(len(flights[0].channels) if sampling.E is None else len(sampling.E))
        notes = (*_notes(flights, offset), *_other_rate(sampling, flights[0].dt))
        recorder = _Recorder(how.callback)
        # Two threads of a BLAS make products of this size ten times slower.
        stack.enter_context(threadpool_limits(1, user_api="blas"))
        data = sources(flights, sampling.method, offset=offset)
        seeking = _search(flights, data, shape, sampling.method, n, how, recorder.report)
        with suppress(_CancelledError):
            seeking.climb(n, begins, how.starts, np.random.default_rng(how.seed))
        if recorder.cancelled:
            seeking.settle()
        task = Asked(
            orders,
            flights,
            tests,
            sampling if sampling.has_dt else replace(sampling, dt=flights[0].dt),
            offset,
            _worthwhile(flights, orders, shape.form) if how.cross_validate is None else how.cross_validate,
            (*skipped, *bad),
            Where.of(flights, reader, recordings, weights),
        )
        result = answer(seeking, task, tuple(recorder.events), recorder.cancelled, notes)
        if loop is not None:
            result = keep_limits(
                seeking,
                loop,
                task.sampling,
                flights,
                result,
                lambda found: _scores(found, seeking, task),
                offset=offset,
            )
    if result.status is Status.INFEASIBLE:
        warnings.warn(result.message, stacklevel=4)
    for note in result.notes[len(notes) :]:
        warnings.warn(note, stacklevel=4)
    return result


def _sampling(given: Sampling | None, channels: Sequence[int | str] | None) -> Sampling:
    found = Sampling() if given is None else given
    if not isinstance(found, Sampling):
        raise TypeError(f"sampling: expected a Sampling, got {type(found).__name__}")
    if channels is not None and found.g_limit is not None and found.g_limit.size > 2:
        raise ValueError("g_limit: with channels expected one pair of numbers, got one for each channel")
    if channels is not None and isinstance(found.inertia, np.ndarray) and found.inertia.ndim:
        raise ValueError("inertia: with channels expected one number, got one for each channel")
    return found


def _other_rate(sampling: Sampling, dt: float) -> tuple[str, ...]:
    """That the filter will run at another rate than it is learned at, in words; empty where it will not."""
    if not sampling.has_dt or abs(sampling.dt / dt - 1.0) <= _SAME_RATE:
        return ()
    return (f"learned at the recordings' steps of {dt:.6g} s, for steps of {sampling.dt:.6g} s",)


def _scores(filter: PhyFilter, search: OrderSearch, asked: Asked) -> tuple[float, float | None]:
    held_out = rmse(filter, asked.tests, search, asked.offset) if asked.tests else None
    return rmse(filter, asked.flights, search, asked.offset), held_out


def _worthwhile(flights: Sequence[Flight], orders: Sequence[int], form: Form) -> bool:
    """Whether folds decide something: several orders, or a short log."""
    coefficients = max(orders) * (2 if form == "general" else 1)
    return len(orders) > 1 or sum(flight.samples for flight in flights) < _SHORT * coefficients


def _notes(flights: Sequence[Flight], offset: bool) -> tuple[str, ...]:
    """What to know of the logs; faults of their labels are warned of."""
    sums = flights.sums if isinstance(flights, StoredFlights) else [label_sums(flight) for flight in flights]
    faults = label_faults(sums, flights[0].channels, offset=offset)
    for fault in faults:
        warnings.warn(fault, stacklevel=5)
    missing = [] if any(flight.has_g for flight in flights) else ["no g: M x' is taken as f"]
    return (*missing, *gap_notes(flights), *faults)


class _CancelledError(Exception):
    """The callback asked to stop."""


class _Recorder:
    """Keeps the history and passes it on."""

    def __init__(self, callback: Callable[[LearnEvent], bool | None] | None) -> None:
        self.callback, self.cancelled = callback, False
        self.events: list[LearnEvent] = []

    def report(self, order: int, start: int, descent: Descent) -> None:
        # Of an exact fit only rounding is left, of either sign.
        event = LearnEvent(order, start, descent.iterations, max(descent.found.cost, 0.0))
        self.events.append(event)
        if self.callback is not None and self.callback(event):
            self.cancelled = True
            raise _CancelledError


def _search(
    flights: Sequence[Flight],
    data: tuple[Data, Data],
    shape: Shape,
    method: Method,
    order: int,
    how: Search,
    report: Callable[[int, int, Descent], None],
) -> OrderSearch:
    longest = max(float((flight.mean_step or flight.dt) * flight.length) for flight in flights)
    step = max(flight.longest_step for flight in flights)
    shortest = min(flight.dt for flight in flights)
    floor = max(
        min(_SHOWN / longest, _SLOW / shortest),
        memory(order) / (MOST_LAGS * shortest) if longest > MOST_LAGS * shortest else 0.0,
    )
    # A gap is one long step, but no reason to keep the poles slow; forward Euler has no choice.
    typical = max(flight.dt for flight in flights)
    strength = how.regularisation * sum(flight.weight * flight.power for flight in flights)
    resolved = step if method == "euler" else typical
    search = OrderSearch(*data, method, resolved, floor, how.max_iterations, report, shape, strength)
    low, high = search.band
    if not low < high:
        raise ValueError(
            f"pole_range: expected a part of what the flights show, {floor:.3g} to {FASTEST / search.step:.3g} rad/s "
            f"(2 pi over the longest flight, {FASTEST:g} over the step), got {shape.pole_range}"
        )
    return search


# -- checks --------------------------------------------------------------------------------------------------


def _orders(order: SupportsIndex | Sequence[SupportsIndex]) -> tuple[int, ...]:
    given = order if isinstance(order, Sequence | np.ndarray) else [order]
    try:
        found = tuple(sorted({operator.index(n) for n in given}))
    except TypeError:
        raise TypeError(
            f"order: expected a whole number, or several to choose from as range(1, 7), got {order!r}"
        ) from None
    if not found or not 1 <= found[0] <= found[-1] <= HIGHEST_ORDER:
        raise ValueError(f"order: expected 1 to {HIGHEST_ORDER}, got {order}")
    return found


def _weights(weights: ArrayLike | Sequence[ArrayLike] | None, single: bool) -> Sequence[ArrayLike] | None:
    if weights is None:
        return None
    if single:
        return [_signals.real("weights", weights)]
    if not isinstance(weights, Sequence | np.ndarray) or isinstance(weights, str):
        raise TypeError(f"weights: expected a sequence with one entry a flight, got {weights!r}")
    return [_signals.real("weights", entry) for entry in weights]
