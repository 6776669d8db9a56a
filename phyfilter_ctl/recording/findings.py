"""What is not plausible about a recording, and what to do about it.

Over windows of some steps the momentum that x shows is compared with what g and the label say:
M dx/W = mean g + mean f. Over longer windows noise counts for less; the least misfit of three lengths is taken.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from ..filter import PhyFilter, record
from ..results import Result
from .agreement import label_factor_fault, lag_sums, late_g, late_text, window_sums
from .checks import is_jump
from .parts import Parts

__all__ = ["Finding", "Suspicion", "Windows", "findings_of"]

_SHORTEST, _LONGEST = 10e-6, 1.0  # of steps that nobody asks about, s
_WINDOWS = (0.1, 0.3, 1.0)  # s
_MOST_STEPS = 4e5  # enough to judge by
_GRAVITY = 9.81
_WORSE_THAN_NONE = 1.0  # misfit of the label, relative to the label
_CLEARLY_BETTER = 0.5  # share of the misfit that another convention leaves
_MASS = 0.25  # relative
_SAME_NOISE = 0.1
_WHITE = 1.5  # fourth over third differences of the steps' slopes: 1.9 where x has white noise, 0 where it is smooth
_FOURTH = 70.0  # variance of fourth differences of white noise, relative
_NOISE = 2.0  # times its rms


Suspicion = Literal[
    "time_unit",
    "missing_g",
    "label_misfit",
    "label_is_derivative",
    "late_g",
    "wrong_frame",
    "wrong_mass",
    "clock_jump",
    "gaps",
]
REMEDIES: Mapping[Suspicion, str] = {
    "time_unit": "give the unit of time, time_unit='ms' (s, us, ns), or a factor for the column",
    "missing_g": "give g, the known part of M x': gravity, thrust, torques; without it the filter takes it for f",
    "label_misfit": "the label is not M x' - g: look for another unit, frame, sign or clock of the label, g, M or x",
    "label_is_derivative": "the label repeats the noise of x, so scores favour filters that pass it: take an "
    "independent sensor, or a two-sided smoother of x",
    "late_g": "log what the actuators do, or shift g by that before",
    "wrong_frame": "declare the convention that fits, or turn the signal before",
    "wrong_mass": "weigh the robot, or check the unit and the model of the thrust",
    "clock_jump": "the clock was set, or the log goes on after a pause: filters go on from the next sample; learn from "
    "the parts",
    "gaps": 'run a filter with nonfinite="hold", learn from recording.pieces(), or fix the log',
}


@dataclass(frozen=True, repr=False)
class Finding(Result):
    """One thing that is not plausible.

    Attributes
    ----------
    suspicion : str
        ``"time_unit"``, ``"clock_jump"``, ``"gaps"``, ``"missing_g"``, ``"late_g"``, ``"label_misfit"``,
        ``"label_is_derivative"``, ``"wrong_frame"`` or ``"wrong_mass"``.
    message : str
        What was found, with figures, and what to do.
    """

    _answer = ("message",)

    suspicion: Suspicion
    message: str

    def __str__(self) -> str:
        return self.message


def finding(suspicion: Suspicion, said: str) -> Finding:
    """With what to do about it."""
    return Finding(suspicion, f"{said}: {REMEDIES[suspicion]}")


@dataclass(frozen=True, eq=False)
class Windows:
    """Means over windows of steps, (w, n_x) each.

    Attributes
    ----------
    slope : array
        M dx/W.
    g : array or None
    label : array or None
    noise : float
        rms of what white noise of x makes in the slope.
    """

    slope: FloatArray
    g: FloatArray | None
    label: FloatArray | None
    noise: float

    @property
    def left(self) -> FloatArray:
        """What g and the label leave of the slope."""
        known = [part for part in (self.g, self.label) if part is not None]
        return self.slope - sum(known, np.zeros_like(self.slope))

    @classmethod
    def of(cls, log: Parts, length: float) -> Windows | None:
        """Of a recording without gaps; None if it is too short."""
        steps, slope = np.diff(log.times), _slopes(log)
        count = max(1, round(length / log.dt))
        starts = np.arange(0, len(steps) - count + 1, count)
        if len(starts) < 5:
            return None

        def mean(values: NDArray[np.floating]) -> FloatArray:
            rows = slice(0, starts[-1] + count)
            sums = np.add.reduceat((values * steps[:, None])[rows], starts, axis=0)
            return np.asarray(sums / np.add.reduceat(steps[rows], starts)[:, None], dtype=float)

        label = None if log.label is None else mean(0.5 * (log.label[1:] + log.label[:-1]))
        white = rms(np.diff(slope, 3, axis=0)) / np.sqrt(_FOURTH) * np.sqrt(2.0) / count
        return cls(mean(slope), None if log.g is None else mean(log.g[:-1]), label, white)


def windows_of(log: Parts) -> list[Windows]:
    """Of the longest piece, at each length; as many steps as it takes to judge."""
    piece = _longest(log)
    if piece is None:
        return []
    lengths = dict.fromkeys(max(length, 3.0 * piece.dt) for length in _WINDOWS)
    return [found for length in lengths if (found := Windows.of(piece, length)) is not None]


def _longest(log: Parts) -> Parts | None:
    """The longest piece without gaps, as far as it takes to judge; None where there is none."""
    pieces = log.pieces() if log.missing.any() else (log,)
    return max(pieces, key=len)[: int(_MOST_STEPS)] if pieces else None


def findings_of(recording: Parts, *, time_unit_known: bool = False) -> tuple[Finding, ...]:
    """What is not plausible about a recording, with what to do.

    Parameters
    ----------
    recording : Recording
    time_unit_known : bool
        Whether the unit of time was given, and long or short steps are meant.

    Returns
    -------
    tuple of Finding
        Empty where nothing is.

    Examples
    --------
    >>> import numpy as np
    >>> from phyfilter_ctl import Recording
    >>> t = np.arange(2000) * 20_000.5
    >>> [f.suspicion for f in findings_of(Recording(t, np.sin(t / 5e5)))]
    ['time_unit']
    """
    found: list[Finding] = []
    if not (time_unit_known or _SHORTEST <= recording.dt <= _LONGEST):
        found.append(_time_unit(recording))
    steps = np.diff(recording.times)
    if len(jumps := np.flatnonzero(is_jump(steps, recording.dt))):
        k = int(jumps[0])
        said = f"the times jump ahead {len(jumps)} time{'s' if len(jumps) > 1 else ''}, first by {steps[k]:.6g} s after"
        found.append(finding("clock_jump", f"{said} {recording.times[k]:.6g} s"))
    if gaps := int(recording.missing.sum() - recording.missing[jumps].sum()):
        found.append(finding("gaps", f"{gaps} of {recording.n} rows miss a signal"))
    if found and found[0].suspicion == "time_unit":
        return tuple(found)  # nothing else can be judged
    windows = windows_of(recording)
    if recording.label is not None:
        checks = [
            _label_misfit(recording, windows) or _label_factor(recording),
            _label_is_derivative(recording),
        ]
    else:
        checks = [_wrong_frame(windows), _wrong_mass(windows)]
    if not any(checks):
        checks = [_late_g(recording, windows)]
    return (*found, *(each for each in checks if each is not None))


def _slopes(log: Parts) -> FloatArray:
    """M dx/h of every step."""
    recursion = PhyFilter([1.0]).sampled(log.dt).recursion
    signals = record.checked_signals(recursion, log.x, None, None, log.inertia)
    slope = record.measured_residual(recursion, *signals, np.diff(log.times), slice(0, log.n - 1))
    return np.asarray(slope, dtype=float)


def rms(values: NDArray[np.floating]) -> float:
    """Over samples and channels."""
    return float(np.sqrt(np.mean(np.square(values))))


def _time_unit(log: Parts) -> Finding:
    dt = log.dt
    units = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}
    fits = [
        f"{dt * f:.3g} s if it counts {unit}" for unit, f in units.items() if _SHORTEST <= dt * f <= _LONGEST
    ]
    limits = f"expected 10 us to 1 s{'; ' if fits else ''}{', '.join(fits)}"
    return finding("time_unit", f"the time steps are {dt:.4g} s, {limits}")


# -- the label ------------------------------------------------------------------------------------------------------


def _label_misfit(log: Parts, windows: Sequence[Windows]) -> Finding | None:
    """f = M x' - g is further from the label than nothing is."""
    triples = [(w, w.label, w.left) for w in windows if w.label is not None and rms(w.label) > 0.0]
    if not triples:
        return None
    w, label, left = min(triples, key=lambda each: rms(each[2]) / rms(each[1]))
    ratio = rms(left) / rms(label)
    if ratio <= _WORSE_THAN_NONE or rms(left) < _NOISE * w.noise:
        return None
    said = f"M x' {'- g ' if log.g is not None else ''}misses the label by {ratio:.2g} times its rms over windows"
    if w.g is None:
        mean = np.abs(left.mean(axis=0))
        heavy = int(np.argmax(mean))
        constant = 1.0 if log.inertia is None else log.inertia if log.inertia.ndim == 0 else np.nan
        if abs(mean[heavy] / (_GRAVITY * constant) - 1.0) < 0.2:
            said += f", by {mean[heavy]:.3g} in {log.channels[heavy]}, as gravity would"
        return finding("missing_g", f"there is no g, and {said}")
    fits = {name: rms(w.slope - g - label) for name, g in _variants(w.g).items()}
    name = min(fits, key=lambda key: fits[key])
    said += f"; {name} it fits" if fits[name] < _CLEARLY_BETTER * rms(left) else ""
    return finding("label_misfit", said)


def _variants(g: FloatArray) -> dict[str, FloatArray]:
    """g as other conventions would have it."""
    turned = {f"with {name}": values for name, values in _turned(g).items()}
    return {"with -g": -g, "without g": np.zeros_like(g)} | turned


def _turned(g: FloatArray) -> dict[str, FloatArray]:
    if g.shape[1] != 3:
        return {}
    return {
        "g turned from NED to ENU": g[:, [1, 0, 2]] * [1.0, 1.0, -1.0],
        "g turned from FRD to FLU": g * [1.0, -1.0, -1.0],
        "g turned from NWU to ENU": g[:, [1, 0, 2]] * [-1.0, 1.0, 1.0],
        "g of the other sign along z": g * [1.0, 1.0, -1.0],
    }


def _label_is_derivative(log: Parts) -> Finding | None:
    """The label holds the noise that differences of x have, to a share of it; only where x has noise."""
    if log.label is None or log.missing.any() or log.n < 50:
        return None
    step = _slopes(log)
    if rms(np.diff(step, 4, axis=0)) < _WHITE * rms(np.diff(step, 3, axis=0)):
        return None
    # A mean of g over the steps on both sides of a sample is g smoothed, and so everything else is.
    g = np.zeros_like(log.label) if log.g is None else 0.5 * (log.g + np.vstack([log.g[:1], log.g[:-1]]))
    near, far = step[1:-2] + step[2:-1], step[:-3] + step[3:]
    differences = {
        "forward": (slice(None, -1), step),
        "backward": (slice(1, None), step),
        "central": (slice(1, -1), 0.5 * (step[1:] + step[:-1])),
        "five-point": (slice(2, -2), (7.0 * near - far) / 12.0),
    }
    for name, (rows, difference) in differences.items():
        left = _smooth(log.label[rows] - difference) + g[rows][1:-1]
        if rms(np.diff(left, 4, axis=0)) < _SAME_NOISE * rms(np.diff(_smooth(difference), 4, axis=0)):
            said = f"the label is the {name} difference of x itself, noise included"
            return finding("label_is_derivative", said)
    return None


def _smooth(values: FloatArray) -> FloatArray:
    return 0.25 * (values[:-2] + 2.0 * values[1:-1] + values[2:])


def _label_factor(log: Parts) -> Finding | None:
    """The label is of another unit or channel."""
    piece = _longest(log)
    if piece is None or piece.label is None:
        return None
    slope = _slopes(piece) - (0.0 if piece.g is None else piece.g[:-1])
    sums = [window_sums(slope, 0.5 * (piece.label[1:] + piece.label[:-1]), np.diff(piece.times))]
    faults = (label_factor_fault(sums, j, log.channels, log.dt) for j in range(log.n_x))
    said = next(filter(None, faults), "")
    return Finding("label_misfit", said) if said else None


# -- without a label ------------------------------------------------------------------------------------------------


def _wrong_frame(windows: Sequence[Windows]) -> Finding | None:
    for w in windows:
        if w.g is None:
            return None
        given, fits = rms(w.slope - w.g), {name: rms(w.slope - g) for name, g in _turned(w.g).items()}
        if not fits:
            return None
        name = min(fits, key=lambda key: fits[key])
        if fits[name] < _CLEARLY_BETTER * given:
            said = f"rms of M x' - g is {given:.3g}, but {fits[name]:.3g} with {name}"
            return finding("wrong_frame", said)
    return None


def _late_g(log: Parts, windows: Sequence[Windows]) -> Finding | None:
    """M x' follows g later."""
    piece = _longest(log)
    if piece is None or piece.g is None or not windows:
        return None
    label = 0.0 if piece.label is None else 0.5 * (piece.label[1:] + piece.label[:-1])
    g = piece.g[:-1]
    sums = lag_sums(
        _slopes(piece) - g - label, g, piece.dt, None if piece.is_uniform else np.diff(piece.times)
    )
    force = windows[-1].slope - (0.0 if windows[-1].g is None else windows[-1].g)
    for j, own in enumerate(sums):
        if late := late_g([own], rms(force[:, j])):
            return Finding("late_g", late_text(late, log.channels[j]))
    return None


def _wrong_mass(windows: Sequence[Windows]) -> Finding | None:
    """c M x' = g fits far better with another c than 1; noise of x pulls c down, so windows are long."""
    if not windows or windows[-1].g is None:
        return None
    slope, g = (v - v.mean(axis=0) for v in (windows[-1].slope, windows[-1].g))
    c = float(np.sum(slope * g) / max(float(np.sum(slope * slope)), np.finfo(float).tiny))
    alike = float(np.sum(slope * g)) / max(rms(slope) * rms(g) * slope.size, np.finfo(float).tiny)
    if alike < 0.95 or abs(np.log(max(c, 1e-9))) < np.log(1.0 + _MASS):
        return None
    said = f"x moves as with {c:.3g} times the M given (correlation {alike:.3f})"
    return finding("wrong_mass", said)
