"""Learning a filter from flights whose true f is known: least squares, certain and without a learning rate.

    min_F sum_k w_k |gamma*_k - (F u)_k|^2,    gamma* = label - f_theta,    u = M x' - g - f_theta, mean over each step

In the increment form the filter is a linear system from u to gamma*, so learning it is output-error identification.
Levenberg and Marquardt's descent runs on exact sensitivities of the sampled filter, from many starts, order by order.
"""

from __future__ import annotations

import operator
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import SupportsIndex, get_args

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from ... import _signals
from ...filter import PhyFilter
from ...filter.sampling import Method, Rule
from ...recording import Recording
from ...results import Status
from . import levenberg, verdict
from .coordinates import FASTEST
from .correlation import MOST_LAGS, memory
from .label_check import label_faults
from .levenberg import Descent
from .residuals import Flight, flights_of, refuse_uninformative
from .result import LearnEvent, LearnResult, is_identified
from .samples import response
from .search import Best, Search
from .sensitivity import Data
from .sources import sources
from .structure import Form, Structure, structure_of
from .wiener import wiener_floor

__all__ = ["learn"]

HIGHEST_ORDER = 12
# Squared errors below this share of the target's square are rounding.
_EXACT = 1e-14
# A decay rate of 2 pi / T settles to 0.2 % within a flight of T, and flights resolve frequencies 2 pi / T apart.
_SHOWN = 2.0 * np.pi
_SLOW = 0.1  # of the sampling rate: what is slow in logs of a few samples
_REFITS = 4  # Gauss-Newton steps of the filter learned without a block


def learn(
    logs: Recording | Sequence[Recording],
    order: SupportsIndex,
    *,
    form: Form = "lowpass",
    dc_gain: float | None = 1.0,
    type: SupportsIndex | None = None,
    zeros_at: ArrayLike = (),
    blocked_at: ArrayLike = (),
    poles: ArrayLike = (),
    pole_range: tuple[float, float] | None = None,
    damping: float | None = None,
    start: PhyFilter | Sequence[PhyFilter] | None = None,
    starts: int = 5,
    weights: ArrayLike | Sequence[ArrayLike] | None = None,
    channels: Sequence[int | str] | None = None,
    held_out: Recording | Sequence[Recording] | None = None,
    seed: int = 0,
    method: Method = "exact",
    g: Rule = "hold",
    f_theta: Rule = "average",
    max_iterations: int = 80,
    wiener: bool = True,
    callback: Callable[[LearnEvent], bool | None] | None = None,
) -> LearnResult:
    """Return the filter of an order that fits f best on flights, and how far it is from the best possible one.

    Parameters
    ----------
    logs : Recording or sequence of Recording
        Flights with a label, the true f = M x' - g; they stay apart. A missing f_theta or g is 0. Steps may differ,
        within a flight and between flights.
    order : int
        Order n of D, 1 to 12. Lower orders are learned on the way.
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
    start : PhyFilter or sequence of PhyFilter, optional
        Further starts, each for its own order.
    starts : int
        Number of random starts of every order, beside warm starts from the order before and a scan of cutoffs.
    weights : array_like or sequence of array_like, optional
        How much the squared errors count, one entry a flight: a number, (N,) or (N, K) for the K channels that take
        part. For a single Recording the entry itself.
    channels : sequence of int or str, optional
        Channels that take part, by number or name; None means all.
    held_out : Recording or sequence of Recording, optional
        Flights that are scored, not learned from.
    seed : int
        Of the random starts; the same seed gives the same filter.
    method : {"exact", "matched", "euler", "tustin"}
        Discretisation with which the filter will run.
    g, f_theta : {"hold", "average"}
        What the signals do between samples, as for :class:`SampledPhyFilter`.
    max_iterations : int
        Most steps of one descent.
    wiener : bool
        Whether to compare with the causal Wiener filter.
    callback : callable, optional
        Called with a :class:`LearnEvent` after every step that lowered a cost; True stops.

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
        If a label cannot be f: over whole flights its mean is not that of M x' - g, or it differs by g itself.

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

    Conditions on F are linear in N and hold exactly (least squares with equality constraints). With limits on single
    poles or given ones D is a product of sections instead, in a box of its own.

    The general form of order n contains that of order n - 1: its cost never rises. A low-pass filter whose bounded
    additional pole does not pay is not returned; the lower order is. Nor is a general filter with |1 - F(0)| > 1, or
    with |1 - F| > 2 (the largest sensitivity that loops are designed for) where a flight shows three periods at most:
    where a label has lost its mean or drifts, slow poles follow it at frequencies at which the residual itself holds
    little, and the price is paid by the first steady residual.

    One filter serves all channels that take part. A filter of its own for each:
    ``stack([learn(logs, n, channels=[name]).filter for name in channels])``.

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
    n = _order(order)
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
    structure.refuse(n)
    single = isinstance(logs, Recording)
    entries = _weights(weights, single)
    flights = flights_of(_listed("logs", logs), channels=channels, weights=entries, g=g, f_theta=f_theta)
    refuse_uninformative(flights, n)
    tests = (
        []
        if held_out is None
        else flights_of(_listed("held_out", held_out), channels=channels, g=g, f_theta=f_theta)
    )
    given = _starts(start, n)
    notes = _notes(logs, flights, channels)
    recorder = _Recorder(callback)
    # Two threads of a BLAS make products of this size ten times slower.
    with threadpool_limits(1, user_api="blas"):
        search = _search(flights, form, method, n, max_iterations, recorder.report, structure)
        with suppress(_CancelledError):
            search.climb(n, given, starts, np.random.default_rng(seed))
        if recorder.cancelled:
            search.settle()
        return _result(search, n, flights, tests, recorder, wiener, notes)


def _notes(
    logs: Recording | Sequence[Recording], flights: Sequence[Flight], channels: Sequence[int | str] | None
) -> tuple[str, ...]:
    """What to know of the logs; faults of their labels are warned of."""
    names = _listed("logs", logs)[0].channels
    chosen = names if channels is None else [c if isinstance(c, str) else names[c] for c in channels]
    faults = label_faults(flights, chosen)
    for fault in faults:
        warnings.warn(fault, stacklevel=3)
    missing = [] if any(flight.g is not None for flight in flights) else ["no g: M x' is taken as f"]
    return (*missing, *faults)


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
    form: Form,
    method: Method,
    order: int,
    limit: int,
    report: Callable[[int, int, Descent], None],
    structure: Structure,
) -> Search:
    coarse, fine = sources(flights, method)
    longest = max(float(flight.dt * len(flight.u)) for flight in flights)
    step = max(flight.dt if flight.steps is None else float(np.max(flight.steps)) for flight in flights)
    shortest = min(flight.dt for flight in flights)
    floor = max(
        min(_SHOWN / longest, _SLOW / shortest),
        memory(order) / (MOST_LAGS * shortest) if longest > MOST_LAGS * shortest else 0.0,
    )
    # A gap is one long step, but no reason to keep the poles slow; forward Euler has no choice.
    typical = max(flight.dt for flight in flights)
    search = Search(
        coarse, fine, form, method, step if method == "euler" else typical, floor, limit, report, structure
    )
    low, high = search.band
    if not low < high:
        raise ValueError(
            f"pole_range: expected a part of what the flights show, {floor:.3g} to {FASTEST / search.step:.3g} rad/s "
            f"(2 pi over the longest flight, {FASTEST:g} over the step), got {structure.pole_range}"
        )
    return search


# -- the answer ----------------------------------------------------------------------------------------------


def _result(
    search: Search,
    order: int,
    flights: Sequence[Flight],
    tests: Sequence[Flight],
    recorder: _Recorder,
    wiener: bool,
    notes: tuple[str, ...],
) -> LearnResult:
    if not search.best:
        raise ValueError("no start had a finite cost; check the label and the residual for extreme values")
    used = max(search.best)
    status = Status.CANCELLED if recorder.cancelled else Status.CONVERGED
    if search.form == "lowpass":
        least = min(entry.cost for entry in search.best.values())
        enough = (
            max(least, 0.0) / (1.0 - verdict.ADDS_NOTHING) + _EXACT * search.fine.energy / search.fine.weight
        )
        used = min(n for n, entry in search.best.items() if entry.cost <= enough)
    else:
        identified = [
            n for n, entry in search.best.items() if is_identified(search.filter(entry), search.floor)
        ]
        used = max(identified, default=min(search.best))
    best = search.best[used]
    if not recorder.cancelled:
        status = verdict.status_of(best, used, order, search)
    filter = search.filter(best)
    floor = None
    if wiener and not recorder.cancelled:
        floor = wiener_floor(flights, filter, lambda data: _refitted(data, best, search), search.method)
    return LearnResult(
        filter=filter,
        rmse=_rmse(filter, flights, search.method),
        cost=max(best.cost, 0.0),  # of an exact fit only rounding is left, of either sign
        held_out_rmse=_rmse(filter, tests, search.method) if tests else None,
        order_used=used,
        status=status,
        message=verdict.message_of(status, used, order, search),
        notes=notes,
        history=tuple(recorder.events),
        costs={n: max(entry.cost, 0.0) for n, entry in sorted(search.best.items())},
        wiener=floor,
        dt=flights[0].dt,
        method=search.method,
        slowest=search.floor,
    )


def _refitted(data: Data, best: Best, search: Search) -> PhyFilter:
    """The learned filter after some steps on other data."""
    cost = search.cost(data)
    begun = levenberg.start(cost, best.theta)
    if begun is None:
        return search.filter(best)
    upper, lower = search.box(best.chain.order)
    descent = levenberg.descend(
        cost, begun, upper, lower, limit=_REFITS, negligible=0.0, report=lambda _: None
    )
    chain = search.coordinates.chain(descent.theta)
    return search.filter(Best(descent.theta, chain, descent.found, 0, True, False))


def _rmse(filter: PhyFilter, flights: Sequence[Flight], method: Method) -> float:
    squares = sum(float(np.sum((f.target - response(filter, f, method)) ** 2)) for f in flights)
    return float(np.sqrt(squares / sum(flight.samples for flight in flights)))


# -- checks --------------------------------------------------------------------------------------------------


def _order(order: SupportsIndex) -> int:
    n = operator.index(order)
    if not 1 <= n <= HIGHEST_ORDER:
        raise ValueError(f"order: expected 1 to {HIGHEST_ORDER}, got {n}")
    return n


def _check_options(form: Form, method: Method, starts: int, max_iterations: int) -> None:
    for name, value, choices in (("form", form, get_args(Form)), ("method", method, get_args(Method))):
        if value not in choices:
            raise ValueError(f"{name}: expected one of {', '.join(choices)}, got {value!r}")
    _signals.count("starts", operator.index(starts), least=0)
    _signals.count("max_iterations", operator.index(max_iterations))


def _listed(name: str, logs: Recording | Sequence[Recording]) -> list[Recording]:
    found = [logs] if isinstance(logs, Recording) else list(logs)
    if not found:
        raise ValueError(f"{name}: expected at least one Recording, got none")
    return found


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
