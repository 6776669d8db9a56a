"""The sampled filter over a whole record: checks, measured residual, recursion."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._samples import LARGEST, seconds, unmasked, unusable, usable
from .._sections import FloatArray
from . import paper_form, recursion, windows
from .loop import channels

if TYPE_CHECKING:
    from .sampled_filter import SampledPhyFilter

# Time stamps that differ from a fixed grid by no more than their own rounding are that grid.
_STAMP_ROUNDING = 8 * np.finfo(float).eps

Array = NDArray[np.floating]


def run(
    sampled: SampledPhyFilter,
    x: ArrayLike,
    g: ArrayLike | None,
    f_theta: ArrayLike | None,
    inertia: ArrayLike | None,
    times: ArrayLike | None,
) -> Array:
    """See :meth:`SampledPhyFilter.run`."""
    signals = checked_signals(sampled, x, g, f_theta, inertia)
    stamps = None if times is None else _times(times, len(signals[0]), sampled.dt)
    held = held_samples(sampled, *signals)
    if held.any() and sampled.nonfinite == "raise":
        _refuse_nonfinite(sampled, *signals)
    if sampled.realisation == "paper":
        f_hat = _run_paper(sampled, *signals, stamps)
    elif sampled.delay or held.any():
        f_hat = _run_aligned(sampled, *signals, stamps, held)
    else:
        f_hat = _run_plain(sampled, *signals, stamps)
    if sampled.limit is not None:
        limit = sampled.limit.astype(f_hat.dtype)
        np.clip(f_hat, -limit, limit, out=f_hat)
    return f_hat


def checked_signals(
    sampled: SampledPhyFilter,
    x: ArrayLike,
    g: ArrayLike | None,
    f_theta: ArrayLike | None,
    inertia: ArrayLike | None,
) -> tuple[Array, Array, Array, Array | None]:
    """x, g (N, n_x), f_theta (N, n_f) and the inertia in the precision of the filter, shapes checked."""
    dtype = np.dtype(sampled.precision)
    x = _signal("x", x, dtype)
    N, n_x = x.shape
    n_f = channels(sampled, n_x)
    zero = dtype.type(0)
    g = np.broadcast_to(zero, (N, n_x)) if g is None else _signal("g", g, dtype, (N, n_x))
    f_theta = (
        np.broadcast_to(zero, (N, n_f)) if f_theta is None else _signal("f_theta", f_theta, dtype, (N, n_f))
    )
    with np.errstate(over="ignore"):  # as in _signal
        M = None if inertia is None else _record_inertia(inertia, N, n_x).astype(dtype, copy=False)
    return x, g, f_theta, M


def held_samples(
    sampled: SampledPhyFilter, x: Array, g: Array, f_theta: Array, M: Array | None
) -> NDArray[np.bool_]:
    """Samples (N,) that are not finite. With g held, sample k comes with the g of sample k - 1."""
    held = np.zeros(len(x), dtype=bool)
    for signal in (x, f_theta) if M is None else (x, f_theta, M):
        if not usable(signal):  # row by row only where there is something to find
            held |= _bad_rows(signal)
    if not usable(g):
        bad = _bad_rows(g)
        held |= np.concatenate([bad[:1], bad[:-1]]) if sampled.g == "hold" else bad
    return held


def _refuse_nonfinite(
    sampled: SampledPhyFilter, x: Array, g: Array, f_theta: Array, M: Array | None
) -> NoReturn:
    """Name the first row that is not finite, where it stands: a held g spoils the sample after it."""
    acting = g[:-1] if sampled.g == "hold" and len(g) > 1 else g
    named = {"x": x, "g": acting, "f_theta": f_theta} | ({} if M is None else {"inertia": M})
    bad = {name: rows for name, signal in named.items() if len(rows := np.flatnonzero(_bad_rows(signal)))}
    name = min(bad, key=lambda key: bad[key][0])
    count = len(np.unique(np.concatenate(list(bad.values()))))
    raise ValueError(
        f"x, g, f_theta and inertia must be finite, up to {LARGEST:g} and not masked: {count} bad "
        f"sample{'s' if count > 1 else ''}, the first in row {bad[name][0]} of {name}; clean the record, or use "
        "nonfinite='hold' to carry over gaps"
    )


def _bad_rows(signal: Array) -> NDArray[np.bool_]:
    return np.asarray(unusable(signal).reshape(len(signal), -1).any(axis=1))


def _run_plain(
    sampled: SampledPhyFilter, x: Array, g: Array, f_theta: Array, M: Array | None, stamps: FloatArray | None
) -> Array:
    """No gap and no delay: chunk by chunk, with no array as long as the record but the result."""
    f_hat = np.empty_like(f_theta)
    f_hat[0] = f_theta[0]
    steps = None if stamps is None else np.diff(stamps)

    def residual(rows: slice) -> Array:
        return measured_residual(sampled, x, g, f_theta, M, steps, rows)

    for rows, y in _respond(sampled, len(x) - 1, f_theta.shape[1], residual, steps):
        np.add(f_theta[1:][rows], y, out=f_hat[1:][rows], casting="same_kind")
    return f_hat


def _run_aligned(
    sampled: SampledPhyFilter,
    x: Array,
    g: Array,
    f_theta: Array,
    M: Array | None,
    stamps: FloatArray | None,
    held: NDArray[np.bool_],
) -> Array:
    """With a delay, or with gaps: a held sample makes the step to the next good one longer."""
    acting = np.concatenate([g[:1], g[:-1]]) if sampled.g == "hold" else g
    acting, f_theta = windows.fill_forward(acting), windows.fill_forward(f_theta)
    M = None if M is None else windows.fill_forward(M, 1.0)
    f_hat = f_theta.copy()
    rows = np.flatnonzero(~held)
    if len(rows) > 1:
        grid: FloatArray = (sampled.dt * np.arange(len(x))).astype(float) if stamps is None else stamps
        u = _aligned_residual(sampled, x, acting, f_theta, M, grid, rows)
        steps: FloatArray | None = None if stamps is None and not held.any() else np.diff(grid[rows])
        for part, y in _respond(sampled, len(u), u.shape[1], lambda chunk: u[chunk], steps):
            f_hat[rows[1:][part]] += y
    return f_hat


def _respond(
    sampled: SampledPhyFilter,
    count: int,
    n_f: int,
    residual: Callable[[slice], Array],
    steps: FloatArray | None,
) -> Iterator[tuple[slice, Array]]:
    """C w of ``count`` steps, chunk by chunk; one filter for all channels or one for each."""
    shared = len(sampled.filters) == 1
    columns = [slice(None)] if shared else [slice(i, i + 1) for i in range(n_f)]
    states = [np.zeros((n_f if shared else 1, sampled.order)) for _ in columns]
    if steps is not None and count:
        sampled._coefficients.check_step(float(steps.max()))
    length = recursion.CHUNK if steps is None else recursion.IRREGULAR_CHUNK
    for first in range(0, count, length):
        rows = slice(first, min(first + length, count))
        u = residual(rows).astype(float, copy=False)
        y = np.empty(u.shape)
        for i, column in enumerate(columns):
            if steps is None:
                y[:, column], states[i] = recursion.uniform(
                    sampled._coefficients.kernels[i], u[:, column], states[i]
                )
            else:
                dA, equilibrium, C = sampled._coefficients.at(steps[rows], i)
                refine = recursion.needs_refinement(sampled._coefficients.slowest, float(steps.min()))
                y[:, column], states[i] = recursion.irregular(
                    dA, equilibrium, C, u[:, column], states[i], refine=refine
                )
        yield rows, y


def measured_residual(
    sampled: SampledPhyFilter,
    x: Array,
    g: Array,
    f_theta: Array,
    M: Array | None,
    steps: FloatArray | None,
    rows: slice,
) -> Array:
    """u of the steps ``rows`` (step k runs from sample k to sample k + 1), no gap and no delay; (m, n_f)."""
    here, there = rows, slice(rows.start + 1, rows.stop + 1)
    rate = 1.0 / sampled.dt if steps is None else (1.0 / steps[rows])[:, None]
    half = x.dtype.type(0.5)
    u = x[there] - x[here]
    if M is not None:
        u = times_inertia(M if len(M) == 1 else half * (M[here] + M[there]), u)
    u *= np.asarray(rate, dtype=x.dtype)
    u -= g[here] if sampled.g == "hold" else half * (g[here] + g[there])
    if sampled.E is not None:
        u = u @ sampled.E_left.T.astype(x.dtype)
    u -= f_theta[here] if sampled.f_theta == "hold" else half * (f_theta[here] + f_theta[there])
    return u


def _aligned_residual(
    sampled: SampledPhyFilter,
    x: Array,
    g: Array,
    f_theta: Array,
    M: Array | None,
    times: FloatArray,
    rows: NDArray[np.intp],
) -> Array:
    """u over the steps between ``rows``, with g, f_theta and the inertia taken ``delay`` earlier."""
    ends = times[rows] - sampled.delay
    g_first = g[1:] if sampled.g == "hold" else g[:-1]
    f_first, f_last = f_theta[:-1], f_theta[:-1] if sampled.f_theta == "hold" else f_theta[1:]
    g_mean = windows.window_means(times, g_first, g[1:], ends[:-1], ends[1:])
    f_mean = windows.window_means(times, f_first, f_last, ends[:-1], ends[1:])
    dx = np.diff(x[rows], axis=0)
    if M is not None:
        if len(M) > 1:
            at_ends = windows.values_at(times, M, ends)
            M = 0.5 * (at_ends[1:] + at_ends[:-1])
        dx = times_inertia(M, dx)
    u = dx / np.diff(ends)[:, None] - g_mean
    return (u if sampled.E is None else u @ sampled.E_left.T) - f_mean


def _run_paper(
    sampled: SampledPhyFilter, x: Array, g: Array, f_theta: Array, M: Array | None, stamps: FloatArray | None
) -> Array:
    if M is not None or stamps is not None:
        raise ValueError(
            "realisation='paper' has neither an inertia nor unequal steps: use realisation='sections'"
        )
    state = paper_form.start(sampled.filter, x[0], f_theta[0])
    f_hat = f_theta.copy()
    for k in range(1, len(x)):  # the rounding of every step is what this realisation is kept to show
        state = paper_form.step(sampled.filter, state, x[k], g[k - 1], f_theta[k], sampled.dt)
        f_hat[k] = state.alpha[0]
    return f_hat


# -- checks, shared with the loop -----------------------------------------------------------------------------------


def _signal(name: str, values: ArrayLike, dtype: np.dtype, shape: tuple[int, int] | None = None) -> Array:
    with np.errstate(over="ignore"):  # to an infinity in float32, refused or held as such
        array = np.asarray(unmasked(values), dtype=dtype)
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
    stamps = seconds("times", times)
    if stamps.shape != (N,):
        raise ValueError(f"times: expected shape ({N},) to go with x, got {stamps.shape}")
    if not usable(stamps):
        row = int(np.argmax(unusable(stamps)))
        raise ValueError(
            f"times: no time within {LARGEST:g} s in row {row} ({stamps[row]}); drop or repair the row"
        )
    steps = np.diff(stamps)
    if np.any(steps <= 1.0 / LARGEST):
        row = int(np.argmax(steps <= 1.0 / LARGEST)) + 1
        what = "stands still" if steps[row - 1] >= 0.0 else "runs back"
        raise ValueError(
            f"times: time {what} at row {row} ({stamps[row - 1]} s, then {stamps[row]} s): expected increasing "
            "times; drop or repair the row"
        )
    rounding = _STAMP_ROUNDING * float(np.max(np.abs(stamps)))
    return None if np.all(np.abs(steps - dt) <= rounding) else stamps


def _record_inertia(inertia: ArrayLike, N: int, n_x: int) -> Array:
    """Checked inertia of a record: diagonal (1 or N, n_x) or full (1 or N, n_x, n_x)."""
    M = np.asarray(unmasked(inertia), dtype=float)
    if M.ndim == 0:
        return np.full((1, n_x), M)
    if M.ndim == 2 and n_x == N and M.shape == (n_x, n_x):
        raise ValueError(
            f"inertia: shape {M.shape} is ambiguous because N == n_x == {N}: it may be one full matrix or a diagonal "
            "per sample; give it as (N, n_x, n_x)"
        )
    if M.shape in ((n_x,), (n_x, n_x)):
        return M[None]
    if M.shape not in ((N, n_x), (N, n_x, n_x)):
        raise ValueError(
            f"inertia: expected a number or shape ({n_x},), ({n_x}, {n_x}), ({N}, {n_x}) or ({N}, {n_x}, {n_x}), "
            f"got {M.shape}"
        )
    return M


def times_inertia(M: Array, dx: Array) -> Array:
    """M dx for diagonal M (m, n_x) or full M (m, n_x, n_x), dx (m, n_x)."""
    return M * dx if M.ndim == 2 else (M @ dx[..., None])[..., 0]
