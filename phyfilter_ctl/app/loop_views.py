"""What the loop does with a design in it: frequency responses, root loci and time responses, by the library's loop.

The loop is the one that the margins speak of, opened between the command and the actuator,

    L = mu Act e^(-s delay) F/(1 - F),    S = 1/(1 + L),    T = L/(1 + L),    mu = M_hat/M,

sampled as it runs with the command held over the step. S is also what the loop leaves of the residual.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.linalg import LinAlgError
from scipy.optimize import linear_sum_assignment

from .._sections import ComplexArray, FloatArray
from ..analysis import FilterMargins
from ..analysis.margins.sampled import SampledLoop
from ..filter import PhyFilter, SampledPhyFilter
from ..results import plain
from .answers import frequency_grid
from .designs import FASTEST, SLOWEST, Design
from .loops import UNSEARCHED, loop_note, margin_of, runs_sampled
from .responses import loop_responses

__all__ = ["locus", "loop", "responses", "variations"]

# Values of a range: both ends and what is between.
_RATIOS, _TIMES = 5, 3
# Of the locus: decades to either side of what is assumed, and points.
_DECADES = {"ratio": 2.0, "bandwidth": 1.0}
_LOCUS_POINTS = 81
_MOST_STEPS = 25.0  # of delay: each is a pole
_SEEN = 30.0  # of the fastest pole or bandwidth: roots beyond are not drawn
_HALVINGS = 40
_DEAD = 1e-9  # |z| of what is gone after a step


def variations(design: Design) -> list[Design]:
    """The design with every combination of ratio, lag and delay on a grid over their ranges; [] without ranges.

    Parameters
    ----------
    design : Design

    Returns
    -------
    list of Design
        5 ratios, even in their logarithm, 3 lags and 3 delays, where these have a range.
    """
    assume = design.assume
    factor = 1.0 + assume.ratio_spread
    low, high = max(assume.ratio / factor, 1e-6), assume.ratio * factor
    ratios = np.geomspace(low, high, _RATIOS).tolist() if factor > 1.0 else [assume.ratio]

    def around(value: float, spread: float) -> list[float]:
        if spread == 0.0:
            return [value]
        return np.unique([max(value - spread, 0.0), value, value + spread]).tolist()

    lags, delays = around(assume.lag, assume.lag_spread), around(assume.delay, assume.delay_spread)
    grid = list(itertools.product(lags, delays, ratios))
    if len(grid) == 1:
        return []
    return [
        replace(design, assume=replace(assume, lag=lag, delay=delay, ratio=ratio))
        for lag, delay, ratio in grid
    ]


def loop(design: Design) -> dict[str, object]:
    """The reply to op "loop": L, S and T on a grid, and the band that the assumed ranges leave.

    Parameters
    ----------
    design : Design

    Returns
    -------
    dict
        omega, L, S, T as real and imaginary parts, note, stable, band, message.
    """
    sampled = _sampled(design)
    omega = frequency_grid(design, design.filter)
    if runs_sampled(design, sampled):
        omega = omega[omega <= math.pi / design.dt]
    try:
        margin = margin_of(design, sampled)
        stable = margin.is_stable
        band, message = _band(design, sampled, omega)
    except (ValueError, LinAlgError, FloatingPointError):
        raise ValueError(f"{UNSEARCHED}; bring delay, lag and poles closer") from None
    L, S, T = _gains(margin, omega)
    return {
        "omega": omega.tolist(),
        **{key: _parts(value) for key, value in (("L", L), ("S", S), ("T", T))},
        "note": loop_note(runs_sampled(design, sampled)),
        "stable": stable,
        "band": band,
        "message": message,
    }


def locus(design: Design, over: str) -> dict[str, object]:
    """The reply to op "locus": closed-loop poles in the s-plane over M_hat/M, or over the bandwidth of F.

    Parameters
    ----------
    design : Design
    over : {"ratio", "bandwidth"}
        "bandwidth": all poles and zeros of F times a factor.

    Returns
    -------
    dict
        at (K,), branches (each K points [re, im] or null), now (the poles of the design as it is), limits, message.

    Notes
    -----
    The sampled loop's poles z are drawn at s = log(z)/h, the delay whole and exact. A delay of many steps has as many
    poles: there the locus is not drawn.
    """
    sampled = _sampled(design)
    reason = _undrawn(design, sampled)
    if sampled is None or reason:
        return {"at": [], "branches": [], "now": [], "limits": [], "message": reason}
    poles_at = _poles_over(design, sampled, over)
    middle = design.assume.ratio if over == "ratio" else 1.0
    low, high = _reach(design, over)
    at = np.unique(np.append(np.geomspace(low, high, _LOCUS_POINTS), middle))
    found = [poles_at(float(value)) for value in at]
    seen = _SEEN * max(float(np.max(np.abs(design.filter.poles))), 1.0 / max(design.assume.lag, design.dt))
    branches = _matched(found, seen)
    now = poles_at(middle)
    limits = _limits(poles_at, at, found)
    return {
        "at": at.tolist(),
        "branches": branches,
        "now": _points(now[np.abs(now) <= seen]),
        "limits": limits,
        "message": "",
    }


def responses(design: Design) -> dict[str, object]:
    """The reply to op "responses": what the closed loop does after a step and after one wrong sample.

    Parameters
    ----------
    design : Design

    Returns
    -------
    dict
        t, command, disturbance, noise (each value, and low and high of the ranges), noise_sd, dt, message.
    """
    return loop_responses(design, variations(design))


# -- frequency --------------------------------------------------------------------------------------------------


def _sampled(design: Design) -> SampledPhyFilter | None:
    try:
        return design.sampled
    except ValueError:  # forward Euler at too long a step
        return None


def _gains(margin: FilterMargins, omega: FloatArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """L, S and T."""
    Q, P = margin.loop(omega)
    P = margin.inertia_ratio * P
    return P / Q, Q / (Q + P), P / (Q + P)


def _band(
    design: Design, sampled: SampledPhyFilter | None, omega: FloatArray
) -> tuple[dict[str, object] | None, str]:
    """Least and largest magnitude of L, S and T and phase of L over the ranges, and what was looked at."""
    members = variations(design)
    if not members:
        return None, ""
    found = {key: [math.inf + np.zeros(len(omega)), np.zeros(len(omega))] for key in ("L", "S", "T")}
    phase = [math.inf + np.zeros(len(omega)), -math.inf + np.zeros(len(omega))]
    corners, lost = [], 0
    ends = [{getattr(each.assume, key) for each in members} for key in ("lag", "delay", "ratio")]
    exact = runs_sampled(design, sampled)
    known: dict[tuple[float, float], FilterMargins] = {}
    for member in members:
        # A ratio only scales P: one evaluation of the loop for each lag and delay.
        timing = member.assume.lag, member.assume.delay
        known[timing] = known.get(timing) or margin_of(member, sampled, exact=exact)
        margin = replace(known[timing], inertia_ratio=member.assume.ratio)
        L, S, T = _gains(margin, omega)
        for key, value in (("L", L), ("S", S), ("T", T)):
            size = np.abs(value)
            found[key] = [np.fmin(found[key][0], size), np.fmax(found[key][1], size)]
        turned = np.rad2deg(np.unwrap(np.angle(L)))
        phase = [np.fmin(phase[0], turned), np.fmax(phase[1], turned)]
        lost += margin.loop.unstable(margin.inertia_ratio) != 0
        a = member.assume
        if all(value in (min(e), max(e)) for value, e in zip((a.lag, a.delay, a.ratio), ends, strict=True)):
            corners.append({"ratio": a.ratio, "lag": a.lag, "delay": a.delay, "L": _parts(L)})
    band: dict[str, object] = {key: [plain(low), plain(high)] for key, (low, high) in found.items()}
    band |= {"phase": [plain(phase[0]), plain(phase[1])], "corners": corners}
    band |= {"members": len(members), "unstable": lost}
    verdict = f"unstable at {lost} of them" if lost else "stable at each of them"
    return band, f"Band: {len(members)} loops on a grid over the assumed ranges, {verdict}."


def _parts(values: ComplexArray) -> list[list[float | None]]:
    return [plain(values.real), plain(values.imag)]


# -- loci -------------------------------------------------------------------------------------------------------


def _undrawn(design: Design, sampled: SampledPhyFilter | None) -> str:
    """Why there is no locus; "" where there is one."""
    if sampled is None:
        return "The sampled filter is unstable: no locus of the loop with it."
    steps = design.assume.delay / design.dt
    if steps > _MOST_STEPS:
        return (
            f"No locus: a delay of {steps:.4g} steps makes as many poles. Assume less than "
            f"{_MOST_STEPS:g} steps, or sample slower."
        )
    return ""


def _reach(design: Design, over: str) -> tuple[float, float]:
    decades = _DECADES[over]
    low, high = 10.0**-decades, 10.0**decades
    if over == "ratio":
        return design.assume.ratio * low, design.assume.ratio * high
    sizes = np.abs(design.filter.poles)
    return max(low, SLOWEST / float(sizes.min())), min(high, FASTEST / float(sizes.max()))


def _poles_over(design: Design, sampled: SampledPhyFilter, over: str) -> Callable[[float], ComplexArray]:
    """Closed-loop poles as log(z)/h in rad/s at a value, but for those that die within a step; [] where F diverges."""
    loop = margin_of(design, sampled, exact=True).loop
    assert isinstance(loop, SampledLoop)

    def at(value: float) -> ComplexArray:
        if over == "ratio":
            z = loop.roots(value)
        else:
            other = _sampled(scaled(design, value))
            if other is None:
                return np.zeros(0, dtype=np.complex128)
            z = loop.with_filter(other).roots(design.assume.ratio)
        return np.asarray(np.log(z[np.abs(z) > _DEAD]) / design.dt, dtype=np.complex128)

    return at


def scaled(design: Design, factor: float) -> Design:
    """The design with all poles and zeros of F times a factor: F(s/factor).

    Parameters
    ----------
    design : Design
    factor : float

    Returns
    -------
    Design
    """
    filter = design.filter
    b = filter.b * factor ** np.arange(filter.order, 0, -1)
    return design.with_filter(PhyFilter.from_poles(factor * filter.poles, b))


def _matched(found: list[ComplexArray], seen: float) -> list[list[list[float] | None]]:
    """Branches: from one set of poles to the next every pole goes on to the one nearest to it, all distances together
    least, in log s so that fast poles do not decide for slow ones."""
    count = max(map(len, found), default=0)
    rows = np.full((len(found), count), complex(np.nan, np.nan))
    for k, poles in enumerate(found):
        order = np.arange(len(poles))
        before = rows[k - 1] if k else rows[0]
        known = np.flatnonzero(np.isfinite(before))
        if k and len(known) and len(poles):
            gap = np.abs(before[known][:, None] - poles[None, :])
            size = np.abs(before[known])[:, None] + np.abs(poles)[None, :]
            left, right = linear_sum_assignment(gap / np.maximum(size, 1e-12))
            places = np.full(len(poles), -1)
            places[right] = known[left]
            free = iter(sorted(set(range(count)) - set(places.tolist())))
            order = np.array([place if place >= 0 else next(free) for place in places], dtype=int)
        rows[k, order] = poles
    rows[~(np.abs(rows) <= seen)] = complex(np.nan, np.nan)
    branches = [_points(row) for row in rows.T if np.any(np.isfinite(row))]
    return branches


def _points(values: ComplexArray) -> list[list[float] | None]:
    return [[float(v.real), float(v.imag)] if np.isfinite(v) else None for v in values]


def _limits(
    poles_at: Callable[[float], ComplexArray], at: FloatArray, found: list[ComplexArray]
) -> list[dict[str, float]]:
    """Where a pole reaches the imaginary axis, halved down between two points of the locus."""

    def growth(poles: ComplexArray) -> float:
        return float(np.max(poles.real, initial=-math.inf)) if len(poles) else math.inf

    values = [growth(poles) for poles in found]
    limits = []
    for k in range(len(at) - 1):
        if (values[k] < 0.0) == (values[k + 1] < 0.0) or not math.isfinite(values[k] + values[k + 1]):
            continue
        low, high, start = float(at[k]), float(at[k + 1]), values[k] < 0.0
        for _ in range(_HALVINGS):
            middle = math.sqrt(low * high)
            low, high = (middle, high) if (growth(poles_at(middle)) < 0.0) == start else (low, middle)
        poles = poles_at(low)
        worst = poles[int(np.argmax(poles.real))]
        limits.append({"at": low, "omega": abs(float(worst.imag)), "leaving": float(start)})
    return limits
