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
from pathlib import Path
from typing import TYPE_CHECKING, SupportsIndex, get_args

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from ... import _signals
from ...execution import Report, silent
from ...filter import PhyFilter, Sampling
from ...filter.sampling import Method, Rule
from ...recording import Recording
from ...results import Status
from .answer import Asked, answer, rmse
from .constraints import LoopGoal
from .coordinates import FASTEST
from .correlation import MOST_LAGS, memory
from .in_loop import keep_limits
from .label_check import label_faults, label_sums
from .levenberg import Descent
from .reading import Logs, OnBad, Reading, read_flight
from .residuals import Flight, gap_notes, other_channels, refuse_uninformative
from .result import LearnEvent, LearnResult
from .search import Search
from .sensitivity import Data
from .sources import sources
from .stored import StoredFlights
from .structure import Form, Structure, structure_of

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["learn"]

HIGHEST_ORDER = 12
# A decay rate of 2 pi / T settles to 0.2 % within a flight of T, and flights resolve frequencies 2 pi / T apart.
_SHOWN = 2.0 * np.pi
_SLOW = 0.1  # of the sampling rate: what is slow in logs of a few samples
_SHORT = 200  # samples a coefficient below which an order is cross-validated unasked


def learn(
    logs: Logs,
    order: SupportsIndex | Sequence[SupportsIndex],
    *,
    form: Form = "lowpass",
    dc_gain: float | None = 1.0,
    type: SupportsIndex | None = None,
    zeros_at: ArrayLike = (),
    blocked_at: ArrayLike = (),
    poles: ArrayLike = (),
    pole_range: tuple[float, float] | None = None,
    damping: float | None = None,
    regularisation: float = 0.0,
    start: PhyFilter | Sequence[PhyFilter] | None = None,
    starts: int = 5,
    weights: ArrayLike | Sequence[ArrayLike] | None = None,
    channels: Sequence[int | str] | None = None,
    label_offset: bool = False,
    held_out: Logs | None = None,
    seed: int = 0,
    method: Method = "exact",
    g: Rule = "hold",
    f_theta: Rule = "average",
    delay: float = 0.0,
    limit: ArrayLike | None = None,
    g_limit: tuple[ArrayLike, ArrayLike] | None = None,
    E: ArrayLike | None = None,
    max_iterations: int = 80,
    wiener: bool = True,
    cross_validate: bool | None = None,
    intervals: bool = True,
    loop: LoopGoal | None = None,
    callback: Callable[[LearnEvent], bool | None] | None = None,
    read: Callable[[Path], Recording] = read_flight,
    on_bad: OnBad = "raise",
    workers: int | None = None,
    scheduler: str | Client | None = None,
    report: Report = silent,
) -> LearnResult:
    """Return the filter of an order that fits f best on flights, and how far it is from the best possible one.

    Parameters
    ----------
    logs : Recording, path, or sequence of Recording, path or function () -> Recording
        Flights with a label, the true f = M x' - g, of the same channels; they stay apart. A missing f_theta or g is 0.
        Steps may differ, within a flight and between flights. Files are read when they are needed, not kept; of a
        folder every table (Parquet, Arrow, Feather, CSV) is a flight. Or one function () -> iterable of Recording,
        called anew for every pass.
    order : int or sequence of int
        Order n of D, 1 to 12. Lower orders are learned on the way. Of several orders, ``range(1, 7)``, the one that
        cross-validation chooses is returned.
    form : {"lowpass", "general"}
        N = a_0, or N free but for the conditions below.
    dc_gain : float or None
        F(0) of the general form: 1, the default, follows a constant residual with no steady error. 0 leaves it alone
        (band-pass). None leaves F(0) to the data, which rarely hold it.
    type : int, optional
        Zeros of 1 - F at s = 0 (general form): 2 follows ramps with no steady error, and so on.
    zeros_at : array_like, shape (m,), optional
        Angular frequencies in rad/s at which 1 - F vanishes, as for :func:`~phyfilter_ctl.place_poles`: what is
        periodic there is followed.
    blocked_at : array_like, shape (m,), optional
        Angular frequencies in rad/s at which F vanishes: what is periodic there, a vibration, is not followed.
    poles : array_like, shape (m,), optional
        Poles in rad/s that are given; the others are learned.
    pole_range : (float, float), optional
        Least and largest magnitude in rad/s of the poles that are learned, inside what the data show (Notes).
    damping : float, optional
        Least damping ratio of the poles that are learned.
    regularisation : float
        Pull towards the filter of the order below: the share of further samples, white and as strong as the measured
        residual, that would ask for it. 0 for none.
    start : PhyFilter or sequence of PhyFilter, optional
        Further starts, each for its own order.
    starts : int
        Number of random starts of every order, beside warm starts from the order before and a scan of cutoffs.
    weights : array_like or sequence of array_like, optional
        How much the squared errors count, one entry a flight: a number, (N,) or (N, K) for the K channels that take
        part. For a single Recording the entry itself.
    channels : sequence of int or str, optional
        Channels that take part, by number or name; None means all.
    label_offset : bool
        Whether the label of each flight and channel may be off by a constant, which is fitted along: for labels that
        have lost their mean. Errors are then less their mean over the flight.
    held_out : as ``logs``, optional
        Flights that are scored, not learned from.
    seed : int
        Of the random starts; the same seed gives the same filter.
    method : {"exact", "matched", "euler", "tustin"}
        Discretisation with which the filter will run.
    g, f_theta : {"hold", "average"}
        What the signals do between samples, as for :class:`SampledPhyFilter`.
    delay : float
        Known delay of x in s, as for :class:`SampledPhyFilter`; the label is not delayed.
    limit : float or array_like, optional
        Bound on |f_hat| that ``result.sampled()`` has. It plays no part in learning.
    g_limit : pair (low, high) of floats or array_likes, shape (n_x,), optional
        What the actuators leave of g, as for :class:`SampledPhyFilter`: where the logs hold commands beyond it, the
        measured residual is that of the filter that will run. With ``channels`` a pair of floats.
    E : array_like, shape (n_x, n_f), optional
        Direction in which f acts, M x' = g + E f. f_theta and label of the logs are what acts on x, E f.
    max_iterations : int
        Most steps of one descent.
    wiener : bool
        Whether to compare with the causal Wiener filter.
    cross_validate : bool, optional
        Whether to score every order on folds it was not learned from, whole flights where there are five at least:
        ``result.orders``, ``result.flights``. None does where it decides: several orders asked for, or fewer than 200
        samples a coefficient. A single order whose RMSE there is more than 1 % above that of a lower one is not
        returned; the lowest good one is.
    intervals : bool
        Whether to find standard errors.
    loop : LoopGoal, optional
        The loop f_hat is fed back in, and the margins and limits that the filter must keep there. ``orders`` and
        ``flights`` of the result stay those of the filter learned without it, which chooses the largest order; a filter
        that limits bind has no ``intervals`` and is not compared with the Wiener filter.
    callback : callable, optional
        Called with a :class:`LearnEvent` after every step that lowered a cost; True stops.
    read : callable
        Path -> Recording, for files that need more than :meth:`Recording.read` takes by default, such as
        ``partial(Recording.read, time_unit="ms")`` or ``Robot.load(...).read``.
    on_bad : {"raise", "skip"}
        What a flight does that cannot be read or has no label: an error, or an entry of ``result.skipped``.
    workers : int, optional
        Processes that read files; 1 reads them here. None means one per core, or 1 where all are files of 64 MB at most
        together.
    scheduler : str or distributed.Client, optional
        Of a Dask cluster whose workers read the files instead, by the same paths.
    report : callable
        Called with the name of every flight that is read for the first time.

    Returns
    -------
    LearnResult

    Raises
    ------
    TypeError
        If ``logs`` or ``start`` hold something else.
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

    One filter serves all channels that take part. A filter of its own for each:
    ``stack([learn(logs, n, channels=[name]).filter for name in channels])``; :func:`learn_axes` chooses.

    Examples
    --------
    A label made by a known filter is learned back:

    >>> import numpy as np
    >>> from phyfilter_ctl import Recording, PhyFilter
    >>> x = np.cumsum(np.random.default_rng(0).standard_normal((2000, 1)), axis=0)
    >>> label = PhyFilter([400.0, 30.0]).sampled(0.01).run(x)
    >>> result = learn(Recording.from_arrays(x=x, dt=0.01, label=label), 2, wiener=False)
    >>> result.filter.a.round(4).tolist()
    [400.0, 30.0]
    """
    orders = _orders(order)
    n = max(orders)
    _check_options(form, method, starts, max_iterations)
    structure = structure_of(
        form,
        dc_gain=dc_gain,
        type=type,
        zeros_at=zeros_at,
        blocked_at=blocked_at,
        poles=poles,
        pole_range=pole_range,
        damping=damping,
    )
    structure.refuse(min(orders))
    sampling = Sampling(1.0, method, g, f_theta, delay=delay, limit=limit, g_limit=g_limit)
    if channels is not None and sampling.g_limit is not None and sampling.g_limit.size > 2:
        raise ValueError("g_limit: with channels expected one pair of numbers, got one for each channel")
    pull = _signals.number("regularisation", regularisation, least=0.0)
    if on_bad not in get_args(OnBad):
        raise ValueError(f"on_bad: expected one of {', '.join(get_args(OnBad))}, got {on_bad!r}")
    entries = _weights(weights, isinstance(logs, Recording))
    options = {
        **{"channels": channels, "g": g, "f_theta": f_theta, "delay": sampling.delay},
        **{"g_limit": g_limit, "E": E},
    }
    with ExitStack() as stack:
        reading = Reading(stack, read, options, on_bad == "skip", workers, scheduler, report)
        flights, skipped = reading.flights("logs", logs, entries)
        refuse_uninformative(flights, n)
        tests, bad = ([], ()) if held_out is None else reading.flights("held_out", held_out, None)
        if tests and (fault := other_channels(tests[0], flights[0])):
            raise ValueError(f"held_out: {fault}")
        given = _starts(start, n)
        notes = _notes(flights, label_offset)
        recorder = _Recorder(callback)
        # Two threads of a BLAS make products of this size ten times slower.
        stack.enter_context(threadpool_limits(1, user_api="blas"))
        data = sources(flights, method, offset=label_offset)
        search = _search(flights, data, form, method, n, max_iterations, recorder.report, structure, pull)
        with suppress(_CancelledError):
            search.climb(n, given, starts, np.random.default_rng(seed))
        if recorder.cancelled:
            search.settle()
        asked = Asked(
            orders,
            flights,
            tests,
            replace(sampling, dt=flights[0].dt),
            E,
            label_offset,
            wiener,
            _worthwhile(flights, orders, form) if cross_validate is None else cross_validate,
            intervals,
            (*skipped, *bad),
        )
        result = answer(search, asked, tuple(recorder.events), recorder.cancelled, notes)
        if loop is not None:
            result = keep_limits(
                search,
                loop,
                asked.sampling,
                flights,
                result,
                lambda found: _scores(found, search, asked),
                offset=label_offset,
            )
    if result.status is Status.INFEASIBLE:
        warnings.warn(result.message, stacklevel=2)
    for note in result.notes[len(notes) :]:
        warnings.warn(note, stacklevel=2)
    return result


def _scores(filter: PhyFilter, search: Search, asked: Asked) -> tuple[float, float | None]:
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
        warnings.warn(fault, stacklevel=3)
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
    form: Form,
    method: Method,
    order: int,
    limit: int,
    report: Callable[[int, int, Descent], None],
    structure: Structure,
    pull: float,
) -> Search:
    longest = max(float((flight.mean_step or flight.dt) * flight.length) for flight in flights)
    step = max(flight.longest_step for flight in flights)
    shortest = min(flight.dt for flight in flights)
    floor = max(
        min(_SHOWN / longest, _SLOW / shortest),
        memory(order) / (MOST_LAGS * shortest) if longest > MOST_LAGS * shortest else 0.0,
    )
    # A gap is one long step, but no reason to keep the poles slow; forward Euler has no choice.
    typical = max(flight.dt for flight in flights)
    strength = pull * sum(flight.weight * flight.power for flight in flights)
    resolved = step if method == "euler" else typical
    search = Search(*data, form, method, resolved, floor, limit, report, structure, strength)
    low, high = search.band
    if not low < high:
        raise ValueError(
            f"pole_range: expected a part of what the flights show, {floor:.3g} to {FASTEST / search.step:.3g} rad/s "
            f"(2 pi over the longest flight, {FASTEST:g} over the step), got {structure.pole_range}"
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


def _check_options(form: Form, method: Method, starts: int, max_iterations: int) -> None:
    for name, value, choices in (("form", form, get_args(Form)), ("method", method, get_args(Method))):
        if value not in choices:
            raise ValueError(f"{name}: expected one of {', '.join(choices)}, got {value!r}")
    _signals.count("starts", operator.index(starts), least=0)
    _signals.count("max_iterations", operator.index(max_iterations))


def _weights(weights: ArrayLike | Sequence[ArrayLike] | None, single: bool) -> Sequence[ArrayLike] | None:
    if weights is None:
        return None
    if single:
        return [_signals.real("weights", weights)]
    if not isinstance(weights, Sequence | np.ndarray) or isinstance(weights, str):
        raise TypeError(f"weights: expected a sequence with one entry a flight, got {weights!r}")
    return [_signals.real("weights", entry) for entry in weights]


def _starts(start: PhyFilter | Sequence[PhyFilter] | None, order: int) -> list[PhyFilter]:
    given = [] if start is None else [start] if isinstance(start, PhyFilter) else list(start)
    for entry in given:
        if not isinstance(entry, PhyFilter):
            raise TypeError(f"start: expected PhyFilters, got {type(entry).__name__}")
        if entry.order > order:
            raise ValueError(f"start: a filter of order {entry.order} cannot start the orders up to {order}")
    return given
