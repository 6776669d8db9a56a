"""The sampled filter one sample at a time: pure functions from state to state, of one system or of many at once.

In float32 each state carries a compensation word (Kahan's), and the increment dA (w - equilibrium u) is formed from the
distance to the equilibrium, so that at rest on a constant residual nothing is left to round.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._signals import LARGEST, duration, real, refuse_unusable, unusable, usable
from . import windows
from .recursion import Recursion, advance, mean, momentum, output, residual

Array = NDArray[np.floating]

_SKIP = "the state is unchanged; skip the sample (and pass the longer dt), or use nonfinite='hold'"


class PastStep(NamedTuple):
    """What g, f_theta and the inertia did between two samples; kept for a delayed measurement.

    Attributes
    ----------
    dt : float
        Seconds between them.
    g, f_theta, inertia : pair of arrays
        At the beginning and at the end; the inertia None for I.
    """

    dt: float
    g: tuple[Array, Array]
    f_theta: tuple[Array, Array]
    inertia: tuple[Array, Array] | None


class FilterState(NamedTuple):
    """All that the filter remembers of one sample. Immutable; made by ``start``, advanced by ``step``.

    Leading axes (...) are systems that run side by side.
    """

    w: Array  # (..., n_f, n) states of the sections
    carry: Array | None  # (..., n_f, n) compensation words, in float32
    x: Array  # (..., n_x) last accepted measurement
    g: Array | None  # (..., n_x) last g; None before the first step
    f_theta: Array  # (..., n_f) last f_theta
    inertia: Array | None  # diagonal (n_x,) or (..., n_x), or full (..., n_x, n_x); None for I
    held: bool = False  # whether the last sample was refused and the residual's estimate kept
    gap: float = 0.0  # seconds from the last accepted sample to the last sample
    past: tuple[PastStep, ...] = ()  # steps of the gap, and those that a delay still needs


def start(
    recursion: Recursion,
    x0: ArrayLike,
    *,
    f_hat0: ArrayLike | None,
    f_theta0: ArrayLike | None,
    inertia0: ArrayLike | None,
    g0: ArrayLike | None,
) -> FilterState:
    """See :meth:`SampledPhyFilter.start`."""
    dtype = np.dtype(recursion.sampling.precision)
    x = real("x0", x0, dtype)
    if x.ndim == 0 or x.size == 0:
        raise ValueError(f"x0: expected shape (n_x,), or (..., n_x) of many systems, got {x.shape}")
    if x.ndim > 1 and recursion.sampling.nonfinite == "hold":
        raise ValueError("nonfinite='hold' is for one system at a time: start each alone, or use 'raise'")
    of_f = (*x.shape[:-1], recursion.channels(x.shape[-1]))
    f_theta = np.zeros(of_f, dtype) if f_theta0 is None else _vector("f_theta0", f_theta0, of_f, dtype)
    g = None if g0 is None else _vector("g0", g0, x.shape, dtype)
    if inertia0 is None and not isinstance(recursion.sampling.inertia, str):
        inertia0 = recursion.sampling.inertia
    inertia = None if inertia0 is None else checked_inertia("inertia0", inertia0, x)
    f_hat = f_theta if f_hat0 is None else _vector("f_hat0", f_hat0, of_f, dtype)
    named = {"x0": x, "f_theta0": f_theta, "f_hat0": f_hat, "g0": g, "inertia0": inertia}
    for name, values in named.items():
        if values is not None:
            refuse_unusable(name, values)
    g = None if g is None else recursion.acting(g)
    w = _at_rest(recursion, (f_hat - f_theta).astype(float)).astype(dtype)
    carry = np.zeros_like(w) if dtype == np.float32 else None
    return FilterState(w, carry, x, g, f_theta, inertia)


def step(
    recursion: Recursion,
    state: FilterState,
    x: ArrayLike,
    g: ArrayLike | None,
    f_theta: ArrayLike | None,
    *,
    inertia: ArrayLike | None,
    dt: float | None,
) -> tuple[FilterState, Array]:
    """See :meth:`SampledPhyFilter.step`."""
    check_state(recursion, state)
    x, g, f_theta, M, good = checked_sample(recursion, state, x, g, f_theta, inertia)
    h = recursion.sampling.dt if dt is None or dt == recursion.sampling.dt else _step_length(recursion, dt)
    if good and recursion.is_gap(state.gap + h):
        return resume(recursion, state, x, g, f_theta, M)
    if good:
        return take(recursion, state, x, g, f_theta, M, h)
    if recursion.sampling.nonfinite == "raise":
        for name, signal in (("x", x), ("g", g), ("f_theta", f_theta), ("inertia", M)):
            if signal is not None:
                refuse_unusable(name, signal, advice=_SKIP)
    state = hold(recursion, state, g, f_theta, M, h)
    if recursion.is_gap(state.gap):
        state = state._replace(past=())  # no step will close that gap
    return state, recursion.limited(state.f_theta + output(state.w, state.carry, recursion.nominal.C))


def checked_sample(
    recursion: Recursion,
    state: FilterState,
    x: ArrayLike,
    g: ArrayLike | None,
    f_theta: ArrayLike | None,
    inertia: ArrayLike | None,
) -> tuple[Array, Array, Array, Array | None, bool]:
    """x, the g that acts, f_theta and the inertia of one sample, shapes checked, and whether all are usable."""
    dtype = state.x.dtype
    x = _given("x", x, dtype)
    g = np.zeros_like(state.x) if g is None else _given("g", g, dtype)
    f_theta = np.zeros_like(state.f_theta) if f_theta is None else _given("f_theta", f_theta, dtype)
    if x.shape != state.x.shape or g.shape != x.shape or f_theta.shape != state.f_theta.shape:
        raise ValueError(
            f"x, g, f_theta: expected shapes {state.x.shape}, {state.x.shape} and {state.f_theta.shape}, as at the "
            f"start, got {x.shape}, {g.shape} and {f_theta.shape}"
        )
    g = recursion.acting(g)
    if inertia is None:
        if state.inertia is None:
            inertia = recursion.sampling.inertia_or(None)
        if inertia is None:
            return x, g, f_theta, state.inertia, _all_usable(x, g, f_theta)
    M = checked_inertia("inertia", inertia, x)
    return x, g, f_theta, M, _all_usable(x, g, f_theta) and usable(M)


def take(
    recursion: Recursion, state: FilterState, x: Array, g: Array, f_theta: Array, M: Array | None, h: float
) -> tuple[FilterState, Array]:
    """A good sample after h seconds."""
    sampling = recursion.sampling
    if sampling.delay or state.gap:
        u, h, past = _late_residual(recursion, state, x, g, f_theta, M, h)
        constants = recursion.step(h)
    else:
        constants, past, slope = recursion.step(h), (), x - state.x
        if M is not None:
            slope = momentum(_mean_inertia(state.inertia, M), slope)
        slope *= constants.rate
        known = g if sampling.g == "hold" or state.g is None else mean("average", state.g, g)
        u = residual(slope, known, mean(sampling.f_theta, state.f_theta, f_theta), recursion.into)
    w, carry = advance(state.w, state.carry, u, constants)
    f_hat = f_theta + output(w, carry, constants.C)
    return FilterState(w, carry, x, g, f_theta, M, False, 0.0, past), recursion.limited(f_hat)


def resume(
    recursion: Recursion, state: FilterState, x: Array, g: Array, f_theta: Array, M: Array | None
) -> tuple[FilterState, Array]:
    """A good sample after a gap: the filter goes on from it with the states that it has, without a step to it."""
    state = state._replace(x=x, g=g, f_theta=f_theta, inertia=M, held=False, gap=0.0, past=())
    return state, recursion.limited(f_theta + output(state.w, state.carry, recursion.nominal.C))


def _all_usable(x: Array, g: Array, f_theta: Array) -> bool:
    # One number shows whether all are, or the slow look decides; sums of Python's numbers overflow without a warning.
    if x.ndim == 1 and sum(map(abs, [*x.tolist(), *g.tolist(), *f_theta.tolist()])) <= LARGEST:
        return True
    return usable(x) and usable(g) and usable(f_theta)


def _late_residual(
    recursion: Recursion, state: FilterState, x: Array, g: Array, f_theta: Array, M: Array | None, h: float
) -> tuple[Array, float, tuple[PastStep, ...]]:
    """u over the time since the last accepted sample, ``delay`` earlier; that time; the steps still needed."""
    past = (*state.past, _interval(recursion, state, g, f_theta, M, h))
    length, delay = state.gap + h, recursion.sampling.delay
    times = np.cumsum([0.0, *(entry.dt for entry in past)])
    times -= times[-1]
    g_pair, f_pair = (
        [np.array(values, dtype=float) for values in zip(*pairs, strict=True)]
        for pairs in ([entry.g for entry in past], [entry.f_theta for entry in past])
    )
    if M is not None:
        # An inertia first given now was the same before: intervals without one take it too.
        pairs = [entry.inertia or (M, M) for entry in past]
        M = np.array(_of_one_form([pairs[0][0], *(pair[1] for pair in pairs)]), dtype=float)
    ends = np.array([-length - delay, -delay])
    dx = (x - state.x).astype(float)[None]
    u = windows.late_residual(recursion, times, ends, dx, g_pair, f_pair, M)[0]
    return u.astype(x.dtype), length, _still_needed(past, delay)


def _interval(
    recursion: Recursion, state: FilterState, g: Array, f_theta: Array, M: Array | None, h: float
) -> PastStep:
    before = g if recursion.sampling.g == "hold" or state.g is None else state.g
    after = state.f_theta if recursion.sampling.f_theta == "hold" else f_theta
    inertia = None if M is None else (M if state.inertia is None else state.inertia, M)
    return PastStep(h, (before, g), (state.f_theta, after), inertia)


def _still_needed(past: tuple[PastStep, ...], reach: float) -> tuple[PastStep, ...]:
    """The latest intervals that cover the last ``reach`` seconds."""
    covered = 0.0
    for count, entry in enumerate(reversed(past)):
        if covered >= reach:
            return past[len(past) - count :]
        covered += entry.dt
    return past


def hold(
    recursion: Recursion, state: FilterState, g: Array, f_theta: Array, M: Array | None, h: float
) -> FilterState:
    """A sample after h seconds that is no good: what is finite of it counts in a step that becomes longer."""
    g = np.where(unusable(g), np.zeros_like(g) if state.g is None else state.g, g)
    f_theta = np.where(unusable(f_theta), state.f_theta, f_theta)
    if M is not None:
        last = (
            np.ones_like(M) if state.inertia is None else _mean_inertia(state.inertia, state.inertia, M.ndim)
        )
        M = np.where(unusable(M), last, M)
    past = (*state.past, _interval(recursion, state, g, f_theta, M, h))
    return state._replace(g=g, f_theta=f_theta, inertia=M, held=True, gap=state.gap + h, past=past)


def shift_x(state: FilterState, dx: ArrayLike) -> FilterState:
    """See :meth:`SampledPhyFilter.shift_x`."""
    jump = _vector("dx", dx, state.x.shape, state.x.dtype)
    refuse_unusable("dx", jump)
    return state._replace(x=state.x + jump)


def _at_rest(recursion: Recursion, y: Array) -> Array:
    """State (..., n_f, n) of the constant residual for which C w = y."""
    if not np.any(y):
        return np.zeros((*y.shape, recursion.order))
    if any(abs(chain.C @ chain.equilibrium) < 1e-9 for chain in recursion.chains):
        raise ValueError(
            "f_hat0: F(0) = 0 (band-pass), so no constant residual gives an estimate other than f_theta0; "
            "start without f_hat0"
        )
    _, equilibrium, C = recursion.bank
    return y[..., None] * equilibrium / (C * equilibrium).sum(axis=1)[:, None]


def check_state(recursion: Recursion, state: FilterState) -> None:
    """Refuse the state of a filter that differs in order, channels or precision."""
    C, E = recursion.nominal.C, recursion.E
    n_f = state.x.shape[-1] if E is None else E.shape[1]
    shape = state.w.shape
    if shape[-C.ndim :] == C.shape and shape[-2] == n_f and state.x.dtype == C.dtype:
        return
    raise ValueError(
        f"state: made by a filter of order {shape[-1]} with {shape[-2]} channels of f in {state.x.dtype}, given to one "
        f"of order {recursion.order} with {recursion.channels(state.x.shape[-1])} in {C.dtype}; go on with the filter "
        "that made it, or take it over with that filter's retune(state, new_filter)"
    )


def _mean_inertia(before: Array | None, now: Array, ndim: int = 0) -> Array:
    first, last = _of_one_form([now if before is None else before, now], ndim)
    return mean("average", first, last)


def _of_one_form(inertias: list[Array], ndim: int = 0) -> list[Array]:
    """Diagonals as matrices, where there are matrices among them."""
    ndim = max(ndim, *(M.ndim for M in inertias))
    return [M[..., None] * np.eye(M.shape[-1], dtype=M.dtype) if M.ndim < ndim else M for M in inertias]


def _given(name: str, values: ArrayLike, dtype: np.dtype) -> Array:
    """Numbers in the arithmetic of the filter: NaN where they are masked, infinite where float32 does not reach."""
    if type(values) is np.ndarray and values.dtype is dtype:  # as it is at nearly every step
        return values.copy()  # it may be a buffer that the loop writes to, or a simulator's own
    return real(name, values, dtype)


def checked_inertia(name: str, inertia: ArrayLike, x: Array) -> Array:
    """A number for all, a diagonal for all or for each system, or full matrices, for x (..., n_x)."""
    M, n_x = _given(name, inertia, x.dtype), x.shape[-1]
    if M.ndim == 0:
        return np.full(n_x, M)
    if x.ndim > 1 and M.shape == (n_x, n_x) != x.shape:
        return np.broadcast_to(M, (*x.shape, n_x))
    if M.shape not in ((n_x,), x.shape, (*x.shape, n_x)):
        each = "" if x.ndim == 1 else f", {x.shape} or {(*x.shape, n_x)}"
        raise ValueError(
            f"{name}: expected a number or shape ({n_x},) or ({n_x}, {n_x}){each}, got {M.shape}"
        )
    return M


def _vector(name: str, values: ArrayLike, shape: tuple[int, ...], dtype: np.dtype) -> Array:
    vector = real(name, values, dtype)
    if vector.shape != shape:
        raise ValueError(f"{name}: expected shape {shape}, got {vector.shape}")
    return vector


def _step_length(recursion: Recursion, dt: float) -> float:
    dt = duration("dt", dt)
    if not 1.0 / LARGEST < dt < LARGEST:
        raise ValueError(
            f"dt: expected the positive length of the step in seconds, got {dt}; time runs forwards"
        )
    if not recursion.is_gap(dt):
        recursion.check_step(dt)
    return dt
