"""What a design does: curves and figures, by the library's own functions, quick enough to follow a drag."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.linalg import LinAlgError

from .._sections import ComplexArray, FloatArray
from ..analysis import error_bound, frequency_response, grids
from ..analysis.frequency import FilterResponse
from ..filter import PhyFilter, SampledPhyFilter
from ..results import plain
from .designs import Design
from .loops import AssumedLoop, assumed_loop
from .steps import settling_time, step_response
from .verdict import verdict

__all__ = ["answer", "figures", "frequency_grid"]

_CURVE_POINTS = 320  # logarithmic; resonances have some of their own
_PEAK_POINTS = 20
# A pole that rings for so many radians costs the exact bound more time than a drag has; the ellipsoid's is certified.
_RINGING = 300.0
_MOST_SAMPLES = 60_000  # over which the sampled bound is added up
_BOUNDS = ("bound", "bound_sampled")


class Figure(NamedTuple):
    """One entry of "numbers"."""

    key: str
    label: str
    value: float | None
    unit: str
    note: str = ""

    def as_json(self) -> dict[str, object]:
        """Without a value that JSON cannot hold."""
        value = plain(self.value)
        note = self.note or ("" if value is not None else "not defined for this filter")
        entry: dict[str, object] = {
            "key": self.key,
            "label": self.label,
            "value": value,
            "unit": self.unit,
        }
        return entry | ({"note": note} if note else {})


def answer(design: Design) -> dict[str, object]:
    """The reply to op "design".

    Parameters
    ----------
    design : Design

    Returns
    -------
    dict
        filter, frequency, step, numbers, stable_sampled, verdict, messages.
    """
    filter, sampled = design.filter, _sampled(design)
    messages: list[str] = []
    if sampled is None:
        messages.append(
            f"Sampled every {1e3 * design.dt:.4g} ms with forward Euler the filter is unstable: choose the exact "
            f"method, or a step below {1e3 * design.euler_dt:.4g} ms."
        )
    if design.unmatched:
        messages.append(f"Sampled exactly, not matched: {design.unmatched}.")
    curves, response, as_sampled = _frequency(design, filter, sampled)
    band, settling = _band(response), settling_time(filter)
    loop = assumed_loop(design, sampled)
    found = _figures(design, sampled, band, settling, as_sampled, loop)
    messages += _advice(design, band)
    bounds = [figure.value for figure in found if figure.key in _BOUNDS]
    return {
        "filter": {
            "a": filter.a.tolist(),
            "b": filter.b.tolist(),
            "poles": plain(filter.poles),
            "zeros": plain(filter.zeros),
            "type": filter.type,
            "dc_gain": filter.dc_gain,
        },
        "frequency": curves,
        "step": _step(filter, settling),
        "numbers": [figure.as_json() for figure in found],
        "stable_sampled": sampled is not None,
        "verdict": verdict(design, sampled, loop, bounds),
        "messages": messages,
    }


def figures(design: Design) -> list[dict[str, object]]:
    """The figures of :func:`answer` alone, for a design beside the one that is edited.

    Parameters
    ----------
    design : Design

    Returns
    -------
    list of dict
        As "numbers" of the reply to op "design".
    """
    filter, sampled = design.filter, _sampled(design)
    _, response, as_sampled = _frequency(design, filter, sampled)
    loop = assumed_loop(design, sampled)
    found = _figures(design, sampled, _band(response), settling_time(filter), as_sampled, loop)
    return [figure.as_json() for figure in found]


def _sampled(design: Design) -> SampledPhyFilter | None:
    try:
        return design.sampled
    except ValueError:  # forward Euler at too long a step
        return None


def _figures(
    design: Design,
    sampled: SampledPhyFilter | None,
    band: tuple[float, float],
    settling: float,
    as_sampled: FilterResponse | None,
    loop: AssumedLoop,
) -> list[Figure]:
    shape, bounds = _shape(design, band, settling, as_sampled), _bounds(design, design.filter, sampled)
    return [*shape, *bounds, *_margins(design, loop)]


# -- curves -----------------------------------------------------------------------------------------------------


def _frequency(
    design: Design, filter: PhyFilter, sampled: SampledPhyFilter | None
) -> tuple[dict[str, object], FilterResponse, FilterResponse | None]:
    """Curves, and the responses of F and of the sampled F."""
    omega = frequency_grid(design, filter)
    response = frequency_response(filter, omega)
    S, as_sampled = np.full(len(omega), complex(np.nan, np.nan)), None
    if sampled is not None:
        below = omega <= np.pi / design.dt
        as_sampled = frequency_response(sampled, omega[below])
        S[below] = as_sampled.F
    curves: dict[str, object] = {"omega": omega.tolist()}
    for key, value in (("F", response.F), ("E", response.error), ("S", S)):
        curves[key] = _pair(value)
    return curves, response, as_sampled


def _pair(values: ComplexArray) -> list[list[float | None]]:
    """Magnitude and unwrapped phase in degrees."""
    phase = np.full(len(values), np.nan)
    known = np.isfinite(values)
    phase[known] = np.rad2deg(np.unwrap(np.angle(values[known])))
    return [plain(np.abs(values)), plain(phase)]


def frequency_grid(design: Design, filter: PhyFilter) -> FloatArray:
    """A decade and a half to either side of poles and zeros, and of what is drawn; dense at resonances.

    Parameters
    ----------
    design : Design
    filter : PhyFilter
        Its filter.

    Returns
    -------
    (N,) array
        In rad/s, ascending.
    """
    nyquist = np.pi / design.dt
    marks = np.concatenate([grids.breaks(filter), _drawn(design.limits)])
    low = min(0.03 * float(marks.min()), 0.03 * nyquist)
    high = max(30.0 * float(marks.max()), 1.2 * nyquist)
    pairs = filter.poles[filter.poles.imag > -2.0 * filter.poles.real]
    around = (pairs.imag[:, None] + pairs.real[:, None] * np.linspace(-3.0, 3.0, _PEAK_POINTS)).ravel()
    grid = np.concatenate([np.geomspace(low, high, _CURVE_POINTS - 1), around, [nyquist]])
    return np.unique(grid[(grid >= low) & (grid <= high)])


def _drawn(limits: object) -> list[float]:
    """Every positive number of the limits under a name with "omega" in it."""

    def found(value: object, counts: bool) -> Iterator[float]:
        if isinstance(value, dict):
            for key, entry in value.items():
                yield from found(entry, counts or "omega" in str(key))
        elif isinstance(value, list):
            for entry in value:
                yield from found(entry, counts)
        elif counts and isinstance(value, float) and 1e-6 <= value <= 1e8:
            yield value

    return list(found(limits, False))


def _step(filter: PhyFilter, settling: float) -> dict[str, object]:
    t, F, E = step_response(filter, settling)
    return {"t": plain(t), "F": plain(F), "E": plain(E)}


# -- figures ----------------------------------------------------------------------------------------------------


def _shape(
    design: Design, band: tuple[float, float], settling: float, sampled: FilterResponse | None
) -> list[Figure]:
    low, high = band
    note = f"from {low:.4g} to {high:.4g} rad/s" if low > 0.0 else ""
    gain = None if sampled is None else sampled.noise_gain
    unit = design.assume.unit
    lost = "" if sampled is not None else "the sampled filter is unstable"
    return [
        Figure("bandwidth", "Bandwidth of F, -3 dB", high - low, "rad/s", note),
        Figure("settling", "Settling of the step response, 2 %", settling, "s"),
        Figure("noise_gain", "Noise gain, f_hat per white noise on x", gain, "1/s", lost),
        Figure(
            "noise",
            "Standard deviation of f_hat from the noise of x",
            None if gain is None else gain * design.assume.noise,
            unit,
            lost or "M_hat = 1",
        ),
        Figure(
            "euler_dt",
            "Largest step of forward Euler",
            design.euler_dt,
            "s",
            "stable below it; the other methods are stable at any step",
        ),
    ]


def _band(response: FilterResponse) -> tuple[float, float]:
    try:
        low, high = response.band_edges
    except (ValueError, IndexError, ZeroDivisionError):  # N = 0 passes nothing
        return float("nan"), float("nan")
    return float(low), float(high)


def _bounds(design: Design, filter: PhyFilter, sampled: SampledPhyFilter | None) -> list[Figure]:
    """Certified ultimate bounds for the assumed slope, of F and of F as it runs."""
    unit, residual = design.assume.unit, {1: design.assume.slope}
    label = "Ultimate bound of the error"
    labels = dict(zip(_BOUNDS, (label, f"{label} at the samples"), strict=True))
    if filter.type == 0:
        note = "none: F(0) is not 1, so the error grows with a residual that grows"
        return [Figure(key, text, None, unit, note) for key, text in labels.items()]
    rings = bool(np.any(np.abs(filter.poles) > -_RINGING * filter.poles.real))
    try:
        bound = error_bound(filter, residual, method="ellipsoid" if rings else "exact").bound
        note = "certified, not the least: a pole is hardly damped" if rings else "certified; attained"
    except (ValueError, LinAlgError):
        bound, note = float("nan"), "a pole is too little damped for a certificate"
    found = [Figure("bound", labels["bound"], bound, unit, note)]
    return [*found, _sampled_bound(labels["bound_sampled"], design, sampled, residual)]


def _sampled_bound(
    label: str, design: Design, sampled: SampledPhyFilter | None, residual: dict[int, float]
) -> Figure:
    unit = design.assume.unit
    if sampled is None:
        return Figure("bound_sampled", label, None, unit, "the sampled filter is unstable")
    radius = float(np.max(np.abs(1.0 + np.linalg.eigvals(sampled.transition[0]))))
    if radius >= 1.0 or -_MOST_SAMPLES * math.log(max(radius, 1e-300)) < 20.0:
        note = "too many samples to add up: see the bound of the continuous filter"
        return Figure("bound_sampled", label, None, unit, note)
    try:
        found = error_bound(sampled, residual)
    except (ValueError, LinAlgError):
        return Figure("bound_sampled", label, None, unit, "no certificate: see the continuous filter")
    return Figure(
        "bound_sampled", label, found.bound, unit, f"certified as long as {'; '.join(found.assumptions)}"
    )


def _margins(design: Design, loop: AssumedLoop) -> list[Figure]:
    """Margins, and what to read where one has no number."""
    margin, note = loop.margin, loop.note
    values = {
        "ratio_low": None if margin is None else margin.min_ratio,
        "ratio_high": None if margin is None else margin.max_ratio,
        "delay_margin": loop.delay,
        "phase_margin": loop.phase,
    }
    notes = dict.fromkeys(values, note) | {"phase_margin": note + loop.distance}
    for key, value in values.items():
        if value is not None and math.isnan(value):
            notes[key] = f"unstable at M_hat/M = 1; {note}"
        elif value is not None and math.isinf(value):
            notes[key] = f"no limit; {note}"
        elif value == 0.0 and key == "ratio_low":
            notes[key] = f"no lower limit; {note}"
        elif value == 0.0:
            notes[key] = f"unstable at M_hat/M = {design.assume.ratio:g}; {note}"
    labels = {"ratio_low": "Least M_hat/M", "ratio_high": "Largest M_hat/M", "delay_margin": "Delay margin"}
    units = {"delay_margin": "s", "phase_margin": "deg"}
    return [
        Figure(key, labels.get(key, "Phase margin"), value, units.get(key, ""), notes[key])
        for key, value in values.items()
    ]


def _advice(design: Design, band: tuple[float, float]) -> list[str]:
    """What a look at the figures should not miss."""
    messages: list[str] = []
    nyquist = np.pi / design.dt
    _, high = band
    if math.isfinite(high) and high > 0.5 * nyquist:
        messages.append(
            f"The band of F reaches {high:.4g} rad/s and the Nyquist frequency is {nyquist:.4g} rad/s: sample faster, "
            "or the sampled F is another filter."
        )
    return messages
