"""How ``learn`` searches, and how it reads: options that most calls leave alone."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias, get_args

from ... import _signals
from ...execution import Report, silent
from ...filter import PhyFilter
from ...recording import Recording

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["LearnEvent", "OnBad", "Reading", "Search", "begun_from", "reading_of"]

OnBad = Literal["raise", "skip"]


@dataclass(frozen=True)
class LearnEvent:
    """One step that lowered the cost.

    Attributes
    ----------
    order : int
        Order being learned.
    start : int
        Number of the start within the order; the lower ones are warm starts from the order before.
    iteration : int
        Steps from this start so far.
    cost : float
        Weighted mean square of gamma* - F u.
    """

    order: int
    start: int
    iteration: int
    cost: float


@dataclass(frozen=True)
class Search:
    """How filters are searched for, for ``learn(..., search=...)``.

    Parameters
    ----------
    start : PhyFilter or sequence of PhyFilter
        Further starts, each for its own order.
    starts : int
        Number of random starts of every order, besides warm starts from the order before and a scan of cutoffs.
    seed : int
        Of the random starts; the same seed gives the same filter.
    max_iterations : int
        Most steps of one descent.
    regularisation : float
        Pull towards the filter of the order below: the share of further samples, white and as strong as the measured
        residual, that would ask for it. 0 for none.
    cross_validate : bool, optional
        Whether a single order gives way to a lower one where its RMSE, on folds it was not learned from, is more than
        1 % above that of a lower one. None does for fewer than 200 samples a coefficient. Of several orders
        cross-validation chooses in any case; the table of all orders, ``result.orders``, needs no option.
    callback : callable, optional
        Called with a :class:`~phyfilter_ctl.design.LearnEvent` after every step that lowered a cost; True stops.

    Raises
    ------
    TypeError
        If ``start`` holds something else than filters.
    ValueError
        If a number is out of range.

    Examples
    --------
    >>> Search(starts=0, seed=3).max_iterations
    80
    """

    start: PhyFilter | Sequence[PhyFilter] = ()
    starts: int = 5
    seed: int = 0
    max_iterations: int = 80
    regularisation: float = 0.0
    cross_validate: bool | None = None
    callback: Callable[[LearnEvent], bool | None] | None = None

    def __post_init__(self) -> None:
        given = (self.start,) if isinstance(self.start, PhyFilter) else tuple(self.start)
        for entry in given:
            if not isinstance(entry, PhyFilter):
                raise TypeError(f"start: expected PhyFilters, got {type(entry).__name__}")
        object.__setattr__(self, "start", given)
        _signals.count("starts", operator.index(self.starts), least=0)
        _signals.count("seed", operator.index(self.seed), least=0)
        _signals.count("max_iterations", operator.index(self.max_iterations))
        _signals.number("regularisation", self.regularisation, least=0.0)


@dataclass(frozen=True)
class Reading:
    """How recordings are read, many files or few, for ``learn(..., reading=...)``.

    Parameters
    ----------
    read : callable
        Path -> Recording, for files that need more than :meth:`Recording.read` takes by default, such as
        ``partial(Recording.read, time_unit="ms")`` or ``Robot.load(...)``.
    on_bad : {"raise", "skip"}
        What a recording does that cannot be read or has no label: an error, or an entry of ``result.skipped``.
    skip : float
        Time in s at the beginning of every recording, also of one in memory, that the filter runs through and the cost,
        scores and checks of the label do not count.
    workers : int, str or distributed.Client, optional
        Processes that read files; 1 reads them here. None means one per core, or 1 where all are files of 64 MB at most
        together. Of a Dask cluster its scheduler's address or its client: its workers read the files, by the same
        paths.
    report : callable
        Called with the name of every recording that is read for the first time.

    Raises
    ------
    TypeError
        If ``read`` cannot be called.
    ValueError
        If ``on_bad`` is none of these.

    Examples
    --------
    >>> Reading(on_bad="skip", workers=1).on_bad
    'skip'
    """

    read: Callable[[Path], Recording] = Recording.read
    on_bad: OnBad = "raise"
    skip: float = 0.0
    workers: int | str | Client | None = None
    report: Report = silent

    def __post_init__(self) -> None:
        if not callable(self.read):
            raise TypeError(f"read: expected a function Path -> Recording, got {type(self.read).__name__}")
        if self.on_bad not in get_args(OnBad):
            raise ValueError(f"on_bad: expected one of {', '.join(get_args(OnBad))}, got {self.on_bad!r}")
        object.__setattr__(self, "skip", _signals.number("skip", self.skip, "s", least=0.0))


def begun_from(search: Search, order: int) -> tuple[PhyFilter, ...]:
    """The starts that a search was given, for orders up to one.

    Raises
    ------
    ValueError
        If one is of a higher order.
    """
    given = (search.start,) if isinstance(search.start, PhyFilter) else tuple(search.start)
    for entry in given:
        if entry.order > order:
            raise ValueError(f"start: a filter of order {entry.order} cannot start the orders up to {order}")
    return given


Read: TypeAlias = Reading | Callable[[Path], Recording]


def reading_of(given: Read | None) -> Reading:
    """What was given of it: options, a robot, a function path -> Recording, or nothing.

    Raises
    ------
    TypeError
        If it is something else.
    """
    if given is None:
        return Reading()
    if isinstance(given, Reading):
        return given
    if callable(given):
        return Reading(given)
    raise TypeError(
        f"reading: expected a Reading, a Robot or a function Path -> Recording, got {type(given).__name__}"
    )
