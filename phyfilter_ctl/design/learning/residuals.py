"""From recordings to what a filter is learned from: the measured residual u of each step and the target at its end."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from types import NoneType
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ... import _signals
from ..._sections import FloatArray
from ...execution import Executor
from ...filter import PhyFilter, Recursion, Sampling, record
from ...recording import Recording
from ...recording.checks import refuse_gaps

# Residuals that vary by less than this of their size are constant: rounding of x over a step.
_CONSTANT = 1e-9
# Samples that standard errors look at; of longer data the beginning of each flight.
BEGINNINGS = 100_000
# A part between gaps has even steps where they agree with the log's to this; times far from 0 are rounded.
_SAME_STEP = 1e-3
# Flights whose steps differ from those of most by this factor are in another unit of time.
_OTHER_UNIT = 100.0
_LOST = 0.01  # share by which the mean step exceeds the median where samples are lost


@dataclass(frozen=True, eq=False)
class Flight:
    """One flight, reduced to the channels that take part.

    Attributes
    ----------
    u : (m, K) array
        Measured residual of step k, from sample k to sample k + 1. Where the filter makes no step, over a gap, there is
        none.
    target : (m, K) array
        gamma* = label - f_theta at sample k + 1.
    dt : float
        Step in s; the median one of the log where they differ.
    steps : (m,) array or None
        Steps in s where they differ.
    weight : float
        How much all of it counts.
    sample_weights : (m, K) array or None
        How much each sample counts beside that.
    g : (m, K) array or None
        Mean of g over step k, where the log has one.
    channels : tuple of str
        Their names.
    log : int
        Place of its log among all.
    mean_step : float
        Mean step in s of the log between its gaps; 0 for ``dt``.
    gaps : tuple of float
        Lengths in s of its gaps.
    first : int
        Steps at its beginning that are run through and do not count.
    """

    u: FloatArray
    target: FloatArray
    dt: float
    steps: FloatArray | None
    weight: float = 1.0
    # Factories leave no attribute of the class: a stored flight reads these when they are asked for.
    sample_weights: FloatArray | None = field(default_factory=NoneType)
    g: FloatArray | None = field(default_factory=NoneType)
    channels: tuple[str, ...] = ()
    log: int = 0
    mean_step: float = 0.0
    gaps: tuple[float, ...] = ()
    first: int = 0

    @property
    def executor(self) -> Executor | None:
        """What reads flights that are not in memory; see ``stored``."""
        return None

    @property
    def is_even(self) -> bool:
        """Whether steps are equal."""
        return self.steps is None

    @property
    def is_weighted(self) -> bool:
        """Whether samples count differently."""
        return self.sample_weights is not None

    @property
    def is_plain(self) -> bool:
        """Whether steps are equal and samples count alike."""
        return self.is_even and not self.is_weighted

    @property
    def takes_part(self) -> bool:
        """Whether any weight is positive."""
        return self.weight > 0.0 and (self.sample_weights is None or bool(np.any(self.sample_weights > 0.0)))

    @property
    def is_constant(self) -> tuple[bool, bool]:
        """Whether u is, in every channel, and gamma*."""
        return _is_constant(self.u), _is_constant(self.target)

    @property
    def power(self) -> float:
        """Sum of u^2."""
        return float(np.sum(self.u**2))

    @property
    def length(self) -> int:
        """Number m of steps."""
        return len(self.u)

    @property
    def width(self) -> int:
        """Number K of channels."""
        return self.u.shape[1]

    @property
    def samples(self) -> int:
        """Number of targets that count, all channels together."""
        return (self.length - self.first) * self.width

    def counted(self) -> Flight:
        """What counts of it, by itself."""
        if not self.first:
            return self
        known: dict[str, Any] = {entry.name: getattr(self, entry.name) for entry in fields(Flight)}
        for name in ("u", "target", "steps", "sample_weights", "g"):
            known[name] = None if known[name] is None else known[name][self.first :]
        known["first"] = 0
        return Flight(**known)

    @property
    def longest_step(self) -> float:
        """Longest step in s."""
        return self.dt if self.steps is None else float(np.max(self.steps))

    @property
    def has_g(self) -> bool:
        """Whether the log has g."""
        return self.g is not None

    def masked(self, rows: Sequence[slice]) -> Flight:
        """The flight with some rows that do not count."""
        weights = np.ones_like(self.target) if self.sample_weights is None else self.sample_weights.copy()
        for part in rows:
            weights[part] = 0.0
        return replace(self, sample_weights=weights)

    def levelled(self) -> Flight:
        """The flight as if its steps were equal and the weights, slowly varying, part of the signals."""
        if self.sample_weights is None:
            return replace(self, dt=self.mean_step or self.dt, steps=None, g=None)
        root = np.sqrt(self.sample_weights)
        return replace(
            self,
            u=root * self.u,
            target=root * self.target,
            dt=self.mean_step or self.dt,
            steps=None,
            sample_weights=None,
            g=None,
        )

    def beginning(self, count: int) -> Flight:
        """A copy of its first steps, so many, without g."""
        signals = (self.u, self.target, self.steps, self.sample_weights)
        u, target, steps, weights = (None if each is None else each[:count].copy() for each in signals)
        assert u is not None
        assert target is not None
        return replace(self, u=u, target=target, steps=steps, sample_weights=weights, g=None)

    def totals(self, first: int, last: int) -> tuple[FloatArray, FloatArray]:
        """Sums (K,) of u and of gamma* over steps ``first`` to ``last - 1``."""
        return self.u[first:last].sum(axis=0), self.target[first:last].sum(axis=0)

    def before(self, place: int) -> tuple[FloatArray, bool]:
        """u (K, l) from step ``place - 1`` backwards, and whether that is all there is."""
        return self.u[:place].T[:, ::-1], True


class _OfFlight(Protocol):
    @property
    def flight(self) -> Flight: ...


Part = TypeVar("Part", bound=Flight | _OfFlight)
Found = TypeVar("Found")


def each(work: Callable[[Part], Found], parts: Sequence[Part]) -> Iterator[Found]:
    """What a function of a module finds for flights, or parts of them, in order; side by side where they are read."""
    for part in parts:
        flight = part if isinstance(part, Flight) else part.flight
        if flight.executor is not None:
            return flight.executor.map(work, parts)
    return map(work, parts)


def flights_of(
    logs: Sequence[Recording],
    *,
    channels: Sequence[int | str] | None = None,
    weights: Sequence[ArrayLike] | None = None,
    sampling: Sampling | None = None,
    skip: float = 0.0,
) -> list[Flight]:
    """Residuals and targets of logs, without the first sample, where f_hat = f_theta, and those after a gap.

    Parameters
    ----------
    logs : sequence of Recording
        With labels; a missing f_theta or g is 0.
    channels : sequence of int or str, optional
        Channels that take part, by number or name; None means all.
    weights : sequence, optional
        One entry a log: a number, (N,) or (N, K) for K channels that take part.
    sampling : Sampling, optional
        What counts of it: rules, delay, limits of g, inertia and E; the interval is each log's own. With E the channels
        are those of f, and what the logs hold of f_theta and the label, as M x' - g, is carried to them.
    skip : float
        Time in s at the beginning of every log that does not count.

    Raises
    ------
    TypeError
        If an entry is not a Recording.
    ValueError
        If a label is missing, a channel is unknown, or a weight has the wrong shape, is negative or not finite, or
        all are 0.
    """
    if weights is not None and len(weights) != len(logs):
        raise ValueError(f"weights: expected one entry for each of the {len(logs)} logs, got {len(weights)}")
    found, given = [], sampling or Sampling()
    options = {name: getattr(given, name) for name in ("g", "f_theta", "delay", "g_limit", "inertia", "E")}
    for i, log in enumerate(logs):
        if not isinstance(log, Recording):
            raise TypeError(f"recordings: expected Recordings, got {type(log).__name__} at place {i}")
        if log.label is None:
            raise ValueError(
                f"{named(log, i)} has no label: learning needs the true f; give label=, or label columns in the CSV. "
                "Without one: estimate(log), or smooth_label(log).recording, whose label comes out of x"
            )
        # Any filter will do: the measured residual does not depend on it.
        recursion = PhyFilter([1.0]).sampled(log.dt, "exact", **options).recursion
        columns = _columns(log, i, channels) if given.E is None else _all_of(recursion, log, channels)
        weight, own = (1.0, None) if weights is None else _weight(weights[i], log, i, len(columns))
        steps = np.diff(log.times)
        gaps = np.flatnonzero(recursion.is_gap(steps))
        parts = [
            _reduced(log.segment(first, last) if len(gaps) else log, columns, recursion)
            for first, last in pairwise([0, *(gaps + 1).tolist(), log.n])
            if last > first + 1
        ]
        of_g = [part.g for part in parts if part.g is not None]
        made = np.delete(steps, gaps)
        even = all(part.steps is None for part in parts)
        longest = max(parts, key=lambda part: len(part.u))
        own = None if own is None else np.delete(own, gaps, axis=0)
        first = _skipped(np.delete(log.times[1:], gaps), log, i, skip) if skip else 0
        if first and not (even and own is None):  # these are summed sample by sample
            own = np.ones((len(made), len(columns))) if own is None else own.copy()
            own[:first] = 0.0
        found.append(
            Flight(
                np.concatenate([part.u for part in parts]),
                np.concatenate([part.target for part in parts]),
                longest.dt if even else log.dt,
                None if even else made,
                weight,
                own,
                np.concatenate(of_g) if of_g else None,
                tuple(log.channels[k] if given.E is None else f"f[{k}]" for k in columns),
                i,
                0.0 if log.is_uniform else float(np.mean(made)),
                tuple(steps[gaps].tolist()),
                first,
            )
        )
    if not any(flight.takes_part for flight in found):
        raise ValueError("weights: all are 0, nothing to fit; give at least one flight a positive weight")
    return found


def _skipped(times: FloatArray, log: Recording, i: int, skip: float) -> int:
    """Number of targets, at some times, in the first so many seconds of a log."""
    first = int(np.sum(times < log.times[0] + skip - _SAME_STEP * log.dt))
    if first >= len(times):
        raise ValueError(
            f"skip: expected less than the {log.duration:.4g} s that {named(log, i)} lasts, got {skip:g} s"
        )
    return first


def measured_residuals(
    logs: Sequence[Recording], *, channels: Sequence[int | str] | None = None
) -> tuple[list[FloatArray], float]:
    """Measured residual of every step of each log, (m, K) each, and the step that all share in s; no label needed.

    Raises
    ------
    ValueError
        Without logs, or where steps differ within a log or between logs.
    """
    if not logs:
        raise ValueError("logs: expected at least one")
    found, h = [], logs[0].dt
    for i, log in enumerate(logs):
        columns = _columns(log, i, channels)
        recursion = PhyFilter([1.0]).sampled(log.dt, "exact").recursion
        u, _, dt, steps, _ = _reduced(log, columns, recursion, log.x)
        if steps is not None or abs(dt - h) > 1e-6 * h:
            raise ValueError(
                f"{named(log, i)}: expected equal steps of {h:.6g} s; make them so by "
                "log.resample(dt), or phyfilter-ctl log resample FILE --dt S --out FILE"
            )
        found.append(u)
    return found, h


def other_channels(flight: Flight, first: Flight) -> str:
    """What is wrong with the channels of a flight beside those of the first, in words; empty where they agree."""
    if flight.channels == first.channels:
        return ""
    return (
        f"has {len(flight.channels)} channels, {', '.join(flight.channels)}, where the first flight has "
        f"{', '.join(first.channels)}; choose those that all have by channels=[names]"
    )


def other_time_units(flights: Sequence[Flight]) -> dict[int, str]:
    """By log: what is wrong with flights whose steps are a hundred times those of most, or a hundredth.

    Of two kinds that are equally many all are named.
    """
    steps = {flight.log: flight.dt for flight in flights}
    found = {
        log: [other for other in steps.values() if not 1.0 / _OTHER_UNIT < other / dt < _OTHER_UNIT]
        for log, dt in steps.items()
    }
    return {
        log: (
            f"its steps are {steps[log]:.4g} s, those of other flights {others[0]:.4g} s: times in another unit? Give "
            "it, as by reading=partial(Recording.read, time_unit='ms')"
        )
        for log, others in found.items()
        if 2 * len(others) >= len(steps)
    }


def gap_notes(flights: Sequence[Flight]) -> tuple[str, ...]:
    """What was made of gaps in time and of steps that differ, in words."""
    found = []
    lengths = {flight.log: flight.gaps for flight in flights if flight.gaps}
    if lengths:
        log, longest = max(
            ((log, max(of_log)) for log, of_log in lengths.items()), key=lambda entry: entry[1]
        )
        found.append(
            f"{sum(map(len, lengths.values()))} gaps in the times of {len(lengths)} of {len(flights)} flights, the "
            f"longest {longest:.4g} s in flight {log}: there the filter makes no step, and goes on from the next sample"
        )
    lost = [f for f in flights if abs(f.mean_step / f.dt - 1.0) > _LOST and f.mean_step > 0.0]
    if lost:
        found.append(
            f"steps of flight {lost[0].log} differ: their mean is {lost[0].mean_step:.6g} s, their median "
            f"{lost[0].dt:.6g} s is taken as the filter's; samples are lost"
        )
    return tuple(found)


def refuse_uninformative(flights: Sequence[Flight], order: int) -> None:
    """Refuse data that say nothing about a filter of this order.

    Raises
    ------
    ValueError
        If there are fewer samples than parameters, or u or gamma* is constant everywhere.
    """
    samples = sum(flight.samples for flight in flights)
    if samples < 2 * order:
        raise ValueError(
            f"{samples} samples of f for up to {2 * order} parameters of a filter of order {order}: expected at "
            "least as many; give a longer log or a lower order"
        )
    for k, what in enumerate(("measured residual M x' - g - f_theta", "target label - f_theta")):
        if all(flight.is_constant[k] for flight in flights):
            raise ValueError(
                f"the {what} is constant in every channel of every flight: it says nothing about how fast the filter "
                "should be; give a log with motion in it (and check that the columns are the right ones)"
            )


def named(log: Recording, i: int) -> str:
    """The flight in words, for messages."""
    return f"log {i} ({log.name!r})" if log.name else f"log {i}"


def _is_constant(values: FloatArray) -> bool:
    low, high = np.min(values, axis=0), np.max(values, axis=0)
    return bool(np.all(high - low <= _CONSTANT * np.maximum(np.abs(low), np.abs(high))))


class _Reduced(NamedTuple):
    """What is between two gaps: u, gamma*, the step, the steps where they differ, what g takes off u."""

    u: FloatArray
    target: FloatArray
    dt: float
    steps: FloatArray | None
    g: FloatArray | None


def _reduced(
    log: Recording, columns: list[int], recursion: Recursion, label: FloatArray | None = None
) -> _Reduced:
    refuse_gaps(log.name, log.missing)
    typical = recursion.sampling.dt
    even = log.is_uniform and abs(log.dt - typical) <= _SAME_STEP * typical
    steps = None if even else np.diff(log.times)
    f_theta = None if log.f_theta is None else _onto_f(recursion, log.f_theta)

    def residual(g: FloatArray | None) -> FloatArray:
        if recursion.sampling.delay:
            u, _ = record.step_residuals(recursion, log.x, g, f_theta, log.inertia, log.times)
        else:
            signals = record.checked_signals(recursion, log.x, g, f_theta, log.inertia)
            u = record.measured_residual(recursion, *signals, steps, slice(0, log.n - 1))
        return np.ascontiguousarray(u[:, columns], dtype=float)

    label = log.label if label is None else label
    assert label is not None
    target = _onto_f(recursion, label)
    target = target if f_theta is None else target - f_theta
    u = residual(log.g)
    # What the filter takes off M x' for g, a delay of x included.
    known = None if log.g is None else residual(None) - u
    return _Reduced(u, target[1:, columns].copy(), log.dt if even else typical, steps, known)


def _onto_f(recursion: Recursion, values: FloatArray) -> FloatArray:
    """What acts on x (N, n_x) in channels of f (N, n_f)."""
    return values if recursion.into is None else np.asarray(values @ recursion.into, dtype=float)


def _all_of(recursion: Recursion, log: Recording, channels: Sequence[int | str] | None) -> list[int]:
    if channels is not None:
        raise ValueError(
            "channels: with E the channels are those of f, and all take part; leave one of the two out"
        )
    return list(range(recursion.channels(log.n_x)))


def _columns(log: Recording, i: int, channels: Sequence[int | str] | None) -> list[int]:
    if channels is None:
        return list(range(log.n_x))
    if isinstance(channels, str) or len(channels) == 0:
        hint = f"; one is [{channels!r}]" if isinstance(channels, str) and channels else ""
        raise ValueError(f"channels: expected a sequence of numbers or names, got {channels!r}{hint}")
    columns = []
    for entry in channels:
        if isinstance(entry, str):
            if entry not in log.channels:
                raise ValueError(
                    f"channels: {named(log, i)} has no channel {entry!r}; expected one of {', '.join(log.channels)}"
                )
            columns.append(log.channels.index(entry))
        elif 0 <= entry < log.n_x:
            columns.append(int(entry))
        else:
            raise ValueError(
                f"channels: expected 0 to {log.n_x - 1} for the {log.n_x} channels of {named(log, i)}, got {entry!r}"
            )
    if len(set(columns)) < len(columns):
        raise ValueError(f"channels: {list(channels)!r} names a channel twice; raise its weight instead")
    return columns


def _weight(entry: ArrayLike, log: Recording, i: int, count: int) -> tuple[float, FloatArray | None]:
    weight = _signals.real("weights", entry)
    if not np.all(np.isfinite(weight)) or np.any(weight < 0.0):
        raise ValueError(f"weights: expected finite weights of 0 or more for {named(log, i)}")
    if weight.ndim == 0:
        return float(weight), None
    if weight.shape not in ((log.n,), (log.n, count)):
        raise ValueError(
            f"weights: expected a number, ({log.n},) or ({log.n}, {count}) for {named(log, i)}, "
            f"got shape {weight.shape}"
        )
    full = np.broadcast_to(weight.reshape(log.n, -1), (log.n, count))[1:]
    return (float(full[0, 0]), None) if np.ptp(full) == 0.0 else (1.0, full.copy())
