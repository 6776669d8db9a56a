"""The sampled filter one sample at a time: pure functions from state to state.

In float32 each state carries a compensation word (Kahan's), and the increment dA (w - equilibrium u) is formed from the
distance to the equilibrium, so that at rest on a constant residual nothing is left to round.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._samples import LARGEST, interval, unmasked, unusable, usable
from . import paper_form, windows
from .coefficients import StepConstants

if TYPE_CHECKING:
    from .sampled_filter import SampledPhyFilter

Array = NDArray[np.floating]


class Interval(NamedTuple):
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
    """All that the filter remembers of one sample. Immutable; made by ``start``, advanced by ``step``."""

    w: Array  # (n_f, n) states of the sections
    carry: Array | None  # (n_f, n) compensation words, in float32
    x: Array  # (n_x,) last accepted measurement
    g: Array | None  # (n_x,) last g; None before the first step
    f_theta: Array  # (n_f,) last f_theta
    inertia: Array | None  # (n_x,) or (n_x, n_x) last inertia, None for I
    held: bool = False  # whether the last sample was refused and f_theta returned
    gap: float = 0.0  # seconds from the last accepted sample to the last sample
    past: tuple[Interval, ...] = ()  # steps of the gap, and those that a delay still needs
    paper: paper_form.PaperState | None = None


def start(
    sampled: SampledPhyFilter,
    x0: ArrayLike,
    *,
    f_hat0: ArrayLike | None,
    f_theta0: ArrayLike | None,
    inertia0: ArrayLike | None,
    g0: ArrayLike | None,
) -> FilterState:
    """See :meth:`SampledPhyFilter.start`."""
    dtype = np.dtype(sampled.precision)
    x = np.array(_given(x0, dtype))
    if x.ndim != 1 or len(x) == 0:
        raise ValueError(f"x0: expected shape (n_x,), got {x.shape}")
    n_f = channels(sampled, len(x))
    f_theta = np.zeros(n_f, dtype) if f_theta0 is None else _vector("f_theta0", f_theta0, n_f, dtype)
    g = None if g0 is None else _vector("g0", g0, len(x), dtype)
    inertia = None if inertia0 is None else _inertia("inertia0", inertia0, len(x), dtype)
    f_hat = f_theta if f_hat0 is None else _vector("f_hat0", f_hat0, n_f, dtype)
    named = {"x0": x, "f_theta0": f_theta, "f_hat0": f_hat, "g0": g, "inertia0": inertia}
    for name, values in named.items():
        if values is not None and not usable(values):
            raise ValueError(f"{name}: expected finite values up to {LARGEST:g}, got {values.tolist()}")
    if sampled.realisation == "paper":
        if f_hat0 is not None or inertia is not None:
            raise ValueError("realisation='paper' starts at f_theta0 with M = I; use realisation='sections'")
        paper = paper_form.start(sampled.filter, x, f_theta)
        return FilterState(np.zeros((n_f, 0), dtype), None, x, g, f_theta, None, paper=paper)
    w = _at_rest(sampled, (f_hat - f_theta).astype(float)).astype(dtype)
    carry = np.zeros_like(w) if dtype == np.float32 else None
    return FilterState(w, carry, x, g, f_theta, inertia)


def step(
    sampled: SampledPhyFilter,
    state: FilterState,
    x: ArrayLike,
    g: ArrayLike | None,
    f_theta: ArrayLike | None,
    *,
    inertia: ArrayLike | None,
    dt: float | None,
) -> tuple[FilterState, Array]:
    """See :meth:`SampledPhyFilter.step`."""
    check_state(sampled, state)
    dtype = state.x.dtype
    x = _given(x, dtype)
    g = np.zeros_like(state.x) if g is None else _given(g, dtype)
    f_theta = np.zeros_like(state.f_theta) if f_theta is None else _given(f_theta, dtype)
    if x.shape != state.x.shape or g.shape != x.shape or f_theta.shape != state.f_theta.shape:
        raise ValueError(
            f"expected x and g of shape {state.x.shape} and f_theta of shape {state.f_theta.shape}, as at the start; "
            f"got {x.shape}, {g.shape} and {f_theta.shape}"
        )
    if dt is None or dt == sampled.dt:
        h, constants = sampled.dt, sampled._coefficients.nominal
    else:
        h, constants = _step_length(sampled, dt), None
    M = state.inertia if inertia is None else _inertia("inertia", inertia, len(x), dtype)
    # One number shows whether all are, or the slow look decides; sums of Python's numbers overflow without a warning.
    size = sum(map(abs, [*x.tolist(), *g.tolist(), *f_theta.tolist()]))
    bad = not size <= LARGEST and not (usable(x) and usable(g) and usable(f_theta))
    if bad or (M is not None and inertia is not None and not usable(M)):
        return _refuse(sampled, state, x, g, f_theta, M, h)
    if state.paper is not None:
        return _step_paper(sampled, state, x, g, f_theta, inertia, dt)

    if sampled.delay or state.gap:
        u, h, past = _aligned_residual(sampled, state, x, g, f_theta, M, h)
        constants = sampled._coefficients.step(h) if h != sampled.dt else sampled._coefficients.nominal
    else:
        constants = sampled._coefficients.step(h) if constants is None else constants
        u, past = _residual(sampled, state, x, g, f_theta, M, constants.rate), ()
    w, carry = _advance(state, u, constants)
    total = w if carry is None else w + carry
    y = total @ constants.C if constants.C.ndim == 1 else (total * constants.C).sum(axis=1)
    state = FilterState(w, carry, x, g, f_theta, M, False, 0.0, past)
    return state, _limited(sampled, f_theta + y)


def _advance(state: FilterState, u: Array, constants: StepConstants) -> tuple[Array, Array | None]:
    """w + dA (w - equilibrium u), compensated in float32."""
    dA, equilibrium = constants.dA, constants.equilibrium
    distance = state.w - u[:, None] * equilibrium
    if state.carry is not None:
        distance += state.carry
    change = distance @ dA if dA.ndim == 2 else (dA @ distance[..., None])[..., 0]
    if state.carry is None:
        return state.w + change, None
    change += state.carry
    w = state.w + change
    # Two-sum: what the addition rounded away, whichever of the two was larger.
    taken = w - state.w
    return w, (state.w - (w - taken)) + (change - taken)


def _residual(
    sampled: SampledPhyFilter,
    state: FilterState,
    x: Array,
    g: Array,
    f_theta: Array,
    M: Array | None,
    rate: np.floating,
) -> Array:
    dx = x - state.x
    if M is not None:
        M = _mean_inertia(state.inertia, M)
        dx = M * dx if M.ndim == 1 else M @ dx
    u = dx * rate
    u -= g if sampled.g == "hold" or state.g is None else (g + state.g) * g.dtype.type(0.5)
    if sampled.E is not None:
        u = sampled.E_left.astype(u.dtype) @ u
    u -= state.f_theta if sampled.f_theta == "hold" else (f_theta + state.f_theta) * f_theta.dtype.type(0.5)
    return u


def _aligned_residual(
    sampled: SampledPhyFilter,
    state: FilterState,
    x: Array,
    g: Array,
    f_theta: Array,
    M: Array | None,
    h: float,
) -> tuple[Array, float, tuple[Interval, ...]]:
    """u over the time since the last accepted sample, ``delay`` earlier; that time; the steps still needed."""
    past = (*state.past, _interval(sampled, state, g, f_theta, M, h))
    length, delay = state.gap + h, sampled.delay
    times = np.cumsum([0.0, *(entry.dt for entry in past)])
    times -= times[-1]
    ends = np.array([-length - delay, -delay])
    means = [
        windows.window_means(
            times, np.array([v[0] for v in values]), np.array([v[1] for v in values]), *ends[:, None]
        )[0]
        for values in ([entry.g for entry in past], [entry.f_theta for entry in past])
    ]
    dx = (x - state.x).astype(float)
    if M is not None:
        # An inertia first given now was the same before: intervals without one take it too.
        pairs = [entry.inertia or (M, M) for entry in past]
        samples = np.array([pairs[0][0], *(pair[1] for pair in pairs)], dtype=float)
        mean = windows.values_at(times, samples, ends).mean(axis=0)
        dx = mean * dx if mean.ndim == 1 else mean @ dx
    u = dx / length - means[0]
    u = (u if sampled.E is None else sampled.E_left @ u) - means[1]
    return u.astype(x.dtype), length, _still_needed(past, delay)


def _interval(
    sampled: SampledPhyFilter, state: FilterState, g: Array, f_theta: Array, M: Array | None, h: float
) -> Interval:
    before = g if sampled.g == "hold" or state.g is None else state.g
    after = state.f_theta if sampled.f_theta == "hold" else f_theta
    inertia = None if M is None else (M if state.inertia is None else state.inertia, M)
    return Interval(h, (before, g), (state.f_theta, after), inertia)


def _still_needed(past: tuple[Interval, ...], reach: float) -> tuple[Interval, ...]:
    """The latest intervals that cover the last ``reach`` seconds."""
    covered = 0.0
    for count, entry in enumerate(reversed(past)):
        if covered >= reach:
            return past[len(past) - count :]
        covered += entry.dt
    return past


def _refuse(
    sampled: SampledPhyFilter,
    state: FilterState,
    x: Array,
    g: Array,
    f_theta: Array,
    M: Array | None,
    h: float,
) -> tuple[FilterState, Array]:
    """A sample that is not finite: an error, or held and taken as part of a longer step later."""
    if sampled.nonfinite == "raise":
        raise ValueError(
            f"x, g, f_theta and inertia must be finite, up to {LARGEST:g} and not masked, got x={x.tolist()}, "
            f"g={g.tolist()}, f_theta={f_theta.tolist()}; the state is unchanged; skip the sample (and pass the longer "
            "dt), or use nonfinite='hold'"
        )
    g = np.where(unusable(g), np.zeros_like(g) if state.g is None else state.g, g)
    f_theta = np.where(unusable(f_theta), state.f_theta, f_theta)
    if M is not None:
        last = (
            np.ones_like(M) if state.inertia is None else _mean_inertia(state.inertia, state.inertia, M.ndim)
        )
        M = np.where(unusable(M), last, M)
    past = (*state.past, _interval(sampled, state, g, f_theta, M, h))
    state = state._replace(g=g, f_theta=f_theta, inertia=M, held=True, gap=state.gap + h, past=past)
    return state, _limited(sampled, f_theta.copy())


def _step_paper(
    sampled: SampledPhyFilter,
    state: FilterState,
    x: Array,
    g: Array,
    f_theta: Array,
    inertia: ArrayLike | None,
    dt: float | None,
) -> tuple[FilterState, Array]:
    if inertia is not None or (dt is not None and dt != sampled.dt) or state.paper is None:
        raise ValueError(
            "realisation='paper' has neither an inertia nor unequal steps: use realisation='sections'"
        )
    paper = paper_form.step(sampled.filter, state.paper, x, g, f_theta, sampled.dt)
    return state._replace(x=x, g=g, f_theta=f_theta, paper=paper), _limited(sampled, paper.alpha[0].copy())


def shift_x(sampled: SampledPhyFilter, state: FilterState, dx: ArrayLike) -> FilterState:
    """See :meth:`SampledPhyFilter.shift_x`."""
    jump = _vector("dx", dx, len(state.x), state.x.dtype)
    if not usable(jump):
        raise ValueError(f"dx: expected finite values, got {jump.tolist()}")
    paper = None if state.paper is None else paper_form.shift(sampled.filter, state.paper, jump)
    return state._replace(x=state.x + jump, paper=paper)


def _at_rest(sampled: SampledPhyFilter, y: Array) -> Array:
    """State (n_f, n) of the constant residual for which C w = y."""
    _, equilibrium, C = sampled._coefficients.bank
    for entry in sampled.filters:
        if abs(entry.dc_gain) < 1e-9 and np.any(y):
            raise ValueError(
                "f_hat0: F(0) = 0 (band-pass), so no constant residual gives an estimate other than f_theta0; "
                "start without f_hat0"
            )
    if not np.any(y):
        return np.zeros((len(y), sampled.order))
    return y[:, None] * equilibrium / (C * equilibrium).sum(axis=1)[:, None]


def check_state(sampled: SampledPhyFilter, state: FilterState) -> None:
    """Refuse the state of a filter that differs in order, channels, precision or realisation."""
    C, paper = sampled._coefficients.nominal.C, sampled.realisation == "paper"
    n_f = len(state.x) if sampled.E is None else sampled.E.shape[1]
    shape = state.w.shape
    if (
        (state.paper is not None) is paper
        and (paper or shape[-C.ndim :] == C.shape)
        and shape[0] == n_f
        and state.x.dtype == C.dtype
    ):
        return
    made = "of realisation='paper'" if state.paper is not None else f"of order {shape[1]}"
    ours = "of realisation='paper'" if paper else f"of order {sampled.order}"
    raise ValueError(
        f"state: made by a filter {made} with {shape[0]} channels of f in {state.x.dtype}, given to one {ours} with "
        f"{channels(sampled, len(state.x))} in {sampled.precision}; go on with the filter that made it, or take it "
        "over with that filter's retune(state, new_filter)"
    )


def channels(sampled: SampledPhyFilter, n_x: int) -> int:
    """Number n_f of channels of f for a state of n_x, checked against E, the filters and the limit."""
    n_f = n_x
    if sampled.E is not None:
        if sampled.E.shape[0] != n_x:
            raise ValueError(f"x has {n_x} channels but E has {sampled.E.shape[0]} rows: expected as many")
        n_f = sampled.E.shape[1]
    if len(sampled.filters) not in (1, n_f):
        raise ValueError(
            f"{len(sampled.filters)} filters for {n_f} channels: expected one, or one per channel"
        )
    if sampled.limit is not None and sampled.limit.ndim == 1 and len(sampled.limit) != n_f:
        raise ValueError(
            f"limit: {len(sampled.limit)} bounds for {n_f} channels; expected one number or {n_f}"
        )
    return n_f


def _limited(sampled: SampledPhyFilter, f_hat: Array) -> Array:
    if sampled.limit is None:
        return f_hat
    limit = sampled.limit.astype(f_hat.dtype)
    return np.clip(f_hat, -limit, limit)


def _mean_inertia(before: Array | None, now: Array, ndim: int = 0) -> Array:
    if before is None or before is now:
        before = now
    ndim = max(ndim, before.ndim, now.ndim)
    before, now = (np.diag(M) if M.ndim < ndim else M for M in (before, now))
    return (before + now) * now.dtype.type(0.5)


def _given(values: ArrayLike, dtype: np.dtype) -> Array:
    """Numbers in the arithmetic of the filter: NaN where they are masked, infinite where float32 does not reach."""
    if dtype.itemsize == 8:  # quicker to ask than dtype == np.float64
        return np.asarray(unmasked(values), dtype)
    with np.errstate(over="ignore"):
        return np.asarray(unmasked(values), dtype)


def _inertia(name: str, inertia: ArrayLike, n_x: int, dtype: np.dtype) -> Array:
    M = _given(inertia, dtype)
    if M.ndim == 0:
        return np.full(n_x, M)
    if M.shape not in ((n_x,), (n_x, n_x)):
        raise ValueError(f"{name}: expected a number or shape ({n_x},) or ({n_x}, {n_x}), got {M.shape}")
    return M


def _vector(name: str, values: ArrayLike, length: int, dtype: np.dtype) -> Array:
    vector = np.array(_given(values, dtype))
    if vector.shape != (length,):
        raise ValueError(f"{name}: expected shape ({length},), got {vector.shape}")
    return vector


def _step_length(sampled: SampledPhyFilter, dt: float) -> float:
    dt = interval("dt", dt)
    if not 1.0 / LARGEST < dt < LARGEST:
        raise ValueError(
            f"dt: expected the positive length of the step in seconds, got {dt}; time runs forwards"
        )
    sampled._coefficients.check_step(dt)
    return float(dt)
