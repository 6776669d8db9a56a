"""What the figures of a filter amount to, in sentences that a person reads first."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from ..filter import PhyFilter
from .frequency import frequency_response
from .margins import FilterMargins

__all__ = ["Sentence", "on_error", "on_limit", "on_loop", "on_loops"]

_EXACT = 1e-9  # relative: what is a round number but for rounding is not rounded down


class Sentence(NamedTuple):
    """One statement of a verdict; level "bad" is for what must not be handed over unseen."""

    text: str
    level: Literal["good", "warn", "bad"] = "good"


def on_loop(margin: FilterMargins, delay_margin: float) -> list[Sentence]:
    """Whether the loop is stable with f_hat fed back, and what it tolerates, rounded to the safe side.

    Parameters
    ----------
    margin : FilterMargins
        At the inertia ratio that is taken for granted.
    delay_margin : float
        In s; inf for any delay.

    Returns
    -------
    list of Sentence

    Notes
    -----
    mu = M_hat / M is stable between its ends, so the true M may be 1/high to 1/low times the modelled one.

    Examples
    --------
    >>> from phyfilter_ctl import PhyFilter, margins
    >>> margin = margins(PhyFilter.from_poles([-20.0] * 3))
    >>> [each.text for each in on_loop(margin, margin.delay_margin)]
    ['Stable.', 'Tolerates 189 ms more delay, masses from 0.112 times yours.']
    """
    ratio = margin.inertia_ratio
    inside = [ends for ends in margin.stable_ratios if ends[0] < ratio < ends[1]]
    if margin.is_stable and inside:
        return _tolerates(delay_margin, *inside[0])
    found = [f"Unstable {_closed(margin)}, or shorten lag and delay."]
    if margin.stable_ratios:
        found.append(f"Stable for {' or '.join(_masses(*ends) for ends in margin.stable_ratios)} only.")
    return [Sentence(text, "bad") for text in found]


def on_loops(loops: Sequence[FilterMargins]) -> list[Sentence]:
    """The same of several loops with one filter in them: the least that any of them tolerates.

    Parameters
    ----------
    loops : sequence of margins
        All at one inertia ratio.

    Returns
    -------
    list of Sentence
    """
    for loop in loops:
        said = on_loop(loop, loop.delay_margin)
        if said[0].level == "bad":
            return said
    ratio = loops[0].inertia_ratio
    inside = [next(ends for ends in loop.stable_ratios if ends[0] < ratio < ends[1]) for loop in loops]
    low, high = max(low for low, _ in inside), min(high for _, high in inside)
    return _tolerates(min(loop.delay_margin for loop in loops), low, high)


def _tolerates(delay_margin: float, low: float, high: float) -> list[Sentence]:
    more = "any delay" if math.isinf(delay_margin) else f"{_time(delay_margin)} more delay"
    return [Sentence("Stable."), Sentence(f"Tolerates {more}, {_masses(low, high)}.")]


def on_error(bound: float | None, unit: str, slope: float | None = None, why: str = "") -> Sentence:
    """How large the error can become.

    Parameters
    ----------
    bound : float or None
        Certified; None or not finite where there is none.
    unit : str
        Of f; empty where it has no name.
    slope : float, optional
        The |gamma'| that the bound takes for granted.
    why : str
        Why there is none, where that is known.

    Returns
    -------
    Sentence

    Examples
    --------
    >>> on_error(0.04004, "m/s²", 1.0).text
    'Error at most 0.04004 m/s² while |γ′| ≤ 1 m/s²/s.'
    """
    if bound is None or not math.isfinite(bound):
        return Sentence(f"No bound of the error{f': {why}' if why else ''}.", "warn")
    name = f" {unit}" if unit else ""
    given = "" if slope is None else f" while |γ′| ≤ {slope:.4g}{f' {unit}/s' if unit else ' per s'}"
    return Sentence(f"Error at most {_safe(bound, up=True, digits=4)}{name}{given}.")


def on_limit(filter: PhyFilter, kind: Literal["error", "estimate"], omega: float, level: float) -> Sentence:
    """Whether |1 - F| stays below a level up to a frequency, or |F| from a frequency on, rounded to the safe side.

    Parameters
    ----------
    filter : PhyFilter
    kind : {"error", "estimate"}
        |1 - F| at and below ``omega``; |F| at and above it.
    omega : float
        In rad/s.
    level : float

    Returns
    -------
    Sentence

    Examples
    --------
    |1 - F| of one pole is w / sqrt(w^2 + 400): at 20 rad/s 0.7071, 17 dB above a tenth.

    >>> on_limit(PhyFilter([20.0]), "error", 20.0, 0.1).text
    '17 dB above your limit on |1−F| at 20 rad/s.'
    """
    sizes = np.abs(np.concatenate([filter.poles, filter.zeros]))
    breaks = sizes[sizes > 0.0]
    low, high = min(0.01 * float(breaks.min()), 1e-2 * omega), max(100.0 * float(breaks.max()), 1e2 * omega)
    around = filter.poles.imag[:, None] + filter.poles.real[:, None] * np.linspace(-3.0, 3.0, 21)
    grid = np.unique(np.concatenate([np.geomspace(low, high, 400), around.ravel(), [omega]]))
    grid = (
        grid[(grid >= low) & (grid <= omega)] if kind == "error" else grid[(grid >= omega) & (grid <= high)]
    )
    response = frequency_response(filter, grid)
    gains = np.abs(response.error if kind == "error" else response.F)
    worst = int(np.argmax(gains))
    name = "|1−F|" if kind == "error" else "|F|"
    if gains[worst] == 0.0:
        return Sentence(f"Within your limit on {name}.")
    excess = 20.0 * math.log10(gains[worst] / level)
    if excess > 0.0:
        above = _safe(excess, up=True, digits=2)
        return Sentence(f"{above} dB above your limit on {name} at {grid[worst]:.3g} rad/s.", "bad")
    return Sentence(f"{_safe(-excess, up=False, digits=2)} dB below your limit on {name}.")


def _closed(margin: FilterMargins) -> str:
    outer = margin.around.has_gains
    return f"with {'the outer gains' if outer else 'f̂ fed back'}: lower the bandwidth{' or the gains' if outer else ''}"


def _masses(low: float, high: float) -> str:
    """The true masses of a range of ratios, as multiples of the modelled one, the range rounded inwards."""
    least = "" if math.isinf(high) else _safe(1.0 / high, up=True)
    most = "" if low == 0.0 else _safe(1.0 / low, up=False)
    if least and most:
        return f"masses {least} to {most} times yours"
    if least:
        return f"masses from {least} times yours"
    return f"masses up to {most} times yours" if most else "any mass"


def _time(seconds: float) -> str:
    factor, unit = (1.0, "s") if seconds >= 1.0 else (1e3, "ms") if seconds >= 1e-3 else (1e6, "µs")
    return f"{_safe(factor * seconds, up=False)} {unit}"


def _safe(value: float, *, up: bool, digits: int = 3) -> str:
    """A positive number at a few digits, rounded to one side."""
    if value == 0.0:
        return "0"
    place = 10.0 ** (digits - 1 - math.floor(math.log10(value)))
    whole = math.ceil(value * place * (1.0 - _EXACT)) if up else math.floor(value * place * (1.0 + _EXACT))
    return f"{whole / place:.{digits}g}"
