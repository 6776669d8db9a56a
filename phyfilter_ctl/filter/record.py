"""The sampled filter over a whole record: checks, measured residual, recursion."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple, NoReturn, Protocol, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._sections import FloatArray
from .._signals import inertia as signal_inertia
from .._signals import real, refuse_unusable, sample_times, unusable, usable
from . import blocked, windows
from .recursion import Recursion, mean, momentum, residual

# Time stamps that differ from a fixed grid by no more than their own rounding are that grid.
_STAMP_ROUNDING = 8 * np.finfo(float).eps

_REPAIR = "repair the record, or use nonfinite='hold' to carry over gaps"

Array = NDArray[np.floating]


class Log(Protocol):
    """What a recording holds that a filter runs on; that of :mod:`phyfilter_ctl.recording` does."""

    @property
    def x(self) -> FloatArray: ...
    @property
    def g(self) -> FloatArray | None: ...
    @property
    def f_theta(self) -> FloatArray | None: ...
    @property
    def inertia(self) -> FloatArray | None: ...
    @property
    def times(self) -> FloatArray: ...
    @property
    def channels(self) -> tuple[str, ...]: ...
    @property
    def unit(self) -> str: ...


class Estimator(Protocol):
    """What estimates f from a recording: a sampled filter, and each of :mod:`phyfilter_ctl.baselines`."""

    def estimate(self, recording: Log, /) -> FloatArray:
        """f_hat (N, n_x) at every sample of a recording, from that sample and those before it."""
        ...


def is_log(x: ArrayLike | Log) -> TypeGuard[Log]:
    """Whether it is a recording, not a signal."""
    return all(hasattr(x, name) for name in ("x", "g", "f_theta", "inertia", "times", "channels", "unit"))


def run_log(recursion: Recursion, log: Log) -> Array:
    """See :meth:`SampledPhyFilter.run`."""
    sampling = recursion.sampling
    if sampling.names != log.channels and set(sampling.names) == set(log.channels):
        raise ValueError(
            f"channels: the recording has {', '.join(log.channels)}, which the filter has in another order: "
            f"{', '.join(sampling.names)}"
        )
    unit = sampling.units.get("x", "")
    if unit and log.unit and unit != log.unit:
        raise ValueError(
            f"units: the filter has x in {unit}, the recording in {log.unit}; convert the recording"
        )
    return run(recursion, log.x, log.g, log.f_theta, log.inertia, _own_times(log, sampling.dt))


def _own_times(log: Log, dt: float) -> FloatArray | None:
    """None where they are every dt."""
    elapsed = log.times - log.times[0]
    even = np.max(np.abs(elapsed - dt * np.arange(len(elapsed)))) <= 1e-6 * dt
    return None if even else log.times


def run(
    recursion: Recursion,
    x: ArrayLike,
    g: ArrayLike | None,
    f_theta: ArrayLike | None,
    inertia: ArrayLike | None,
    times: ArrayLike | None,
) -> Array:
    """See :meth:`SampledPhyFilter.run`."""
    signals = checked_signals(recursion, x, g, f_theta, inertia)
    stamps = None if times is None else _times(times, len(signals[0]), recursion.sampling.dt)
    held = held_samples(recursion, *signals)
    if held.any() and recursion.sampling.nonfinite == "raise":
        _refuse_nonfinite(recursion, *signals)
    if recursion.sampling.delay or held.any() or _has_gaps(recursion, stamps):
        f_hat = _run_aligned(recursion, *signals, stamps, held)
    else:
        f_hat = _run_plain(recursion, *signals, stamps)
    return recursion.limited(f_hat, out=f_hat)


def _has_gaps(recursion: Recursion, stamps: FloatArray | None) -> bool:
    """Whether the times have a step after which the filter starts again; most of them are none."""
    if stamps is None or len(stamps) < 2:
        return False
    steps = np.diff(stamps)
    usual = float(np.median(steps))
    if recursion.is_gap(usual):
        raise ValueError(
            f"times: expected steps of about {recursion.sampling.dt:g} s, for which the filter is sampled, got "
            f"{usual:g} s, a gap each; give them in seconds, or sample the filter at the step that they have"
        )
    return bool(recursion.is_gap(steps).any())


def checked_signals(
    recursion: Recursion,
    x: ArrayLike,
    g: ArrayLike | None,
    f_theta: ArrayLike | None,
    inertia: ArrayLike | None,
) -> tuple[Array, Array, Array, Array | None]:
    """x, the g that acts (N, n_x), f_theta (N, n_f) and the inertia in the filter's precision, shapes checked."""
    dtype = np.dtype(recursion.sampling.precision)
    inertia = recursion.sampling.inertia_or(inertia)
    x = _signal("x", x, dtype)
    N, n_x = x.shape
    n_f = recursion.channels(n_x)
    zero = dtype.type(0)
    g = np.broadcast_to(zero, (N, n_x)) if g is None else _signal("g", g, dtype, (N, n_x))
    f_theta = (
        np.broadcast_to(zero, (N, n_f)) if f_theta is None else _signal("f_theta", f_theta, dtype, (N, n_f))
    )
    with np.errstate(over="ignore"):  # as in _signal
        M = None if inertia is None else _record_inertia(inertia, N, n_x).astype(dtype, copy=False)
    return x, recursion.acting(g), f_theta, M


def finite_signals(
    recursion: Recursion,
    x: ArrayLike,
    g: ArrayLike | None,
    f_theta: ArrayLike | None,
    inertia: ArrayLike | None,
) -> tuple[Array, Array, Array, Array | None]:
    """:func:`checked_signals` of which every sample is finite."""
    signals = checked_signals(recursion, x, g, f_theta, inertia)
    if held_samples(recursion, *signals).any():
        _refuse_nonfinite(recursion, *signals)
    return signals


def held_samples(
    recursion: Recursion, x: Array, g: Array, f_theta: Array, M: Array | None
) -> NDArray[np.bool_]:
    """Samples (N,) that are not finite. With g held, sample k comes with the g of sample k - 1."""
    held = np.zeros(len(x), dtype=bool)
    for signal in (x, f_theta) if M is None else (x, f_theta, M):
        if not usable(signal):  # row by row only where there is something to find
            held |= _bad_rows(signal)
    if not usable(g):
        bad = _bad_rows(g)
        held |= np.concatenate([bad[:1], bad[:-1]]) if recursion.sampling.g == "hold" else bad
    return held


def _refuse_nonfinite(recursion: Recursion, x: Array, g: Array, f_theta: Array, M: Array | None) -> NoReturn:
    """Name the first sample that is not finite, where it stands: a held g spoils the sample after it."""
    acting = g[:-1] if recursion.sampling.g == "hold" and len(g) > 1 else g
    named = {"x": x, "g": acting, "f_theta": f_theta} | ({} if M is None else {"inertia": M})
    first = {
        name: rows[0] for name, signal in named.items() if len(rows := np.flatnonzero(_bad_rows(signal)))
    }
    name = min(first, key=lambda key: first[key])
    refuse_unusable(name, named[name], advice=_REPAIR)
    raise AssertionError("no sample is bad")


def _bad_rows(signal: Array) -> NDArray[np.bool_]:
    return np.asarray(unusable(signal).reshape(len(signal), -1).any(axis=1))


def _run_plain(
    recursion: Recursion, x: Array, g: Array, f_theta: Array, M: Array | None, stamps: FloatArray | None
) -> Array:
    """No gap and no delay: chunk by chunk, with no array as long as the record but the result."""
    f_hat = np.empty_like(f_theta)
    f_hat[0] = f_theta[0]
    steps = None if stamps is None else np.diff(stamps)

    def measured(rows: slice) -> Array:
        return measured_residual(recursion, x, g, f_theta, M, steps, rows)

    for rows, y in respond(recursion, len(x) - 1, f_theta.shape[1], measured, steps):
        np.add(f_theta[1:][rows], y, out=f_hat[1:][rows], casting="same_kind")
    return f_hat


def _run_aligned(
    recursion: Recursion,
    x: Array,
    g: Array,
    f_theta: Array,
    M: Array | None,
    stamps: FloatArray | None,
    held: NDArray[np.bool_],
) -> Array:
    """With a delay, or with gaps: a held sample makes the step to the next good one longer, a longer gap has none."""
    f_theta = windows.fill_forward(f_theta)
    behind = np.zeros(f_theta.shape)  # f_hat - f_theta
    rows = np.flatnonzero(~held)
    if len(rows) > 1:
        grid = stamps if stamps is not None else np.asarray(recursion.sampling.dt * np.arange(len(x)), float)
        steps = np.diff(grid[rows])
        gaps = recursion.is_gap(steps)
        aligned = _Aligned.of(recursion, x, g, f_theta, M, grid)
        pieces = np.split(rows, np.flatnonzero(gaps) + 1)
        u = np.concatenate([aligned.residual(piece) for piece in pieces])
        ends, even = rows[1:][~gaps], stamps is None and not held.any()
        for part, y in respond(
            recursion, len(u), u.shape[1], lambda chunk: u[chunk], None if even else steps[~gaps]
        ):
            behind[ends[part]] = y
        held = held.copy()
        held[rows[1:][gaps]] = True
    if held.any():  # the estimate of the residual stays while samples are held
        behind = behind[np.maximum.accumulate(np.where(held, 0, np.arange(len(x))))]
    return np.add(f_theta, behind, out=np.empty_like(f_theta), casting="same_kind")


class _Aligned(NamedTuple):
    """A record whose signals are known between all samples, good or not; x only at good ones."""

    recursion: Recursion
    x: Array
    g: tuple[Array, Array]  # at the beginning and at the end of each interval
    f_theta: tuple[Array, Array]
    M: Array | None
    grid: FloatArray

    @classmethod
    def of(
        cls, recursion: Recursion, x: Array, g: Array, f_theta: Array, M: Array | None, grid: FloatArray
    ) -> _Aligned:
        """Of a record; f_theta has no gaps any more."""
        hold, hold_f = (rule == "hold" for rule in (recursion.sampling.g, recursion.sampling.f_theta))
        acting = windows.fill_forward(np.concatenate([g[:1], g[:-1]]) if hold else g)
        M = None if M is None else windows.fill_forward(M, 1.0)
        g_pair = (acting[1:] if hold else acting[:-1], acting[1:])
        return cls(recursion, x, g_pair, (f_theta[:-1], f_theta[:-1] if hold_f else f_theta[1:]), M, grid)

    def residual(self, rows: NDArray[np.intp]) -> Array:
        """u of the steps between the samples ``rows``; what was before the first of them is not known any more."""
        known = slice(rows[0], rows[-1] + 1)
        within = slice(rows[0], rows[-1])
        g, f_theta = ([part[within] for part in pair] for pair in (self.g, self.f_theta))
        M = self.M if self.M is None or len(self.M) == 1 else self.M[known]
        if len(rows) < 2:
            return self.f_theta[0][:0]
        ends, dx = self.grid[rows] - self.recursion.sampling.delay, np.diff(self.x[rows], axis=0)
        return windows.late_residual(self.recursion, self.grid[known], ends, dx, g, f_theta, M)


def step_residuals(
    recursion: Recursion,
    x: ArrayLike,
    g: ArrayLike | None,
    f_theta: ArrayLike | None,
    inertia: ArrayLike | None,
    times: FloatArray,
) -> tuple[Array, NDArray[np.intp]]:
    """u (m, n_f) that the filter is fed with over a whole record, and the samples (m + 1,) that its steps lie between.

    Samples that are not finite are left out: the step across them is longer.
    """
    x, g, f_theta, M = checked_signals(recursion, x, g, f_theta, inertia)
    rows = np.flatnonzero(~held_samples(recursion, x, g, f_theta, M))
    if len(rows) == len(x) and not recursion.sampling.delay:
        return measured_residual(recursion, x, g, f_theta, M, np.diff(times), slice(0, len(x) - 1)), rows
    if len(rows) < 2:
        return f_theta[:0], rows
    return _Aligned.of(recursion, x, g, windows.fill_forward(f_theta), M, times).residual(rows), rows


def respond(
    recursion: Recursion,
    count: int,
    n_f: int,
    measured: Callable[[slice], Array],
    steps: FloatArray | None,
) -> Iterator[tuple[slice, Array]]:
    """C w of ``count`` steps from rest, chunk by chunk; one filter for all channels or one for each.

    ``measured`` gives u (m, n_f) of some of the steps; ``steps`` their lengths where they differ.
    """
    shared = len(recursion.chains) == 1
    columns = [slice(None)] if shared else [slice(i, i + 1) for i in range(n_f)]
    states = [np.zeros((n_f if shared else 1, recursion.order)) for _ in columns]
    if steps is not None and count:
        recursion.check_step(float(steps.max()))
    length = blocked.CHUNK if steps is None else blocked.IRREGULAR_CHUNK
    for first in range(0, count, length):
        rows = slice(first, min(first + length, count))
        u = measured(rows).astype(float, copy=False)
        y = np.empty(u.shape)
        for i, column in enumerate(columns):
            if steps is None:
                y[:, column], states[i] = blocked.uniform(recursion._kernels[i], u[:, column], states[i])
            else:
                dA, equilibrium, C = recursion.at(steps[rows], i)
                refine = blocked.needs_refinement(recursion.slowest, float(steps.min()))
                y[:, column], states[i] = blocked.irregular(
                    dA, equilibrium, C, u[:, column], states[i], refine=refine
                )
        yield rows, y


def measured_residual(
    recursion: Recursion,
    x: Array,
    g: Array,
    f_theta: Array,
    M: Array | None,
    steps: FloatArray | None,
    rows: slice,
) -> Array:
    """u of the steps ``rows`` (step k runs from sample k to sample k + 1), no gap and no delay; (m, n_f)."""
    here, there = rows, slice(rows.start + 1, rows.stop + 1)
    rate = 1.0 / recursion.sampling.dt if steps is None else (1.0 / steps[rows])[:, None]
    slope = x[there] - x[here]
    if M is not None:
        slope = momentum(M if len(M) == 1 else mean("average", M[here], M[there]), slope)
    slope *= np.asarray(rate, dtype=x.dtype)
    between = recursion.sampling
    g_mean, f_mean = mean(between.g, g[here], g[there]), mean(between.f_theta, f_theta[here], f_theta[there])
    return residual(slope, g_mean, f_mean, recursion.into)


# -- checks, shared with the loop -----------------------------------------------------------------------------------


def _signal(name: str, values: ArrayLike, dtype: np.dtype, shape: tuple[int, int] | None = None) -> Array:
    array = real(name, values, dtype, copy=False)
    if array.ndim == 1 and (shape is None or shape == (len(array), 1)):
        array = array[:, None]
    if array.ndim != 2 or 0 in array.shape:
        raise ValueError(
            f"{name}: expected a non-empty (N, channels) array, samples first, got shape {array.shape}"
        )
    if shape is not None and array.shape != shape:
        raise ValueError(f"{name}: expected shape {shape} to go with x, got {array.shape}")
    return array


def _times(times: ArrayLike, N: int, dt: float) -> FloatArray | None:
    """Checked time stamps; None where they are the nominal grid."""
    stamps = sample_times("times", times, N)
    steps = np.diff(stamps)
    rounding = _STAMP_ROUNDING * float(np.max(np.abs(stamps)))
    return None if np.all(np.abs(steps - dt) <= rounding) else stamps


def _record_inertia(inertia: ArrayLike, N: int, n_x: int) -> Array:
    """Checked inertia of a record: diagonal (1 or N, n_x) or full (1 or N, n_x, n_x)."""
    M = signal_inertia("inertia", inertia, n_x, N, finite=False)
    if M.ndim == 0:
        return np.full((1, n_x), M)
    return M[None] if M.shape in ((n_x,), (n_x, n_x)) else M
