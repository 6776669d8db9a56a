"""What is not plausible about a recording, and what to do about it.

Over windows of some steps the momentum that x shows is compared with what g and the label say:
M dx/W = mean g + mean f. Over longer windows noise counts for less; the least misfit of three lengths is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from ..filter import PhyFilter, record
from ..recording import Recording
from ..results import Result

__all__ = ["Finding", "Suspicion", "Windows", "findings_of"]

_SHORTEST, _LONGEST = 10e-6, 1.0  # of steps that nobody asks about, s
_WINDOWS = (0.1, 0.3, 1.0)  # s
_MOST_STEPS = 4e5  # enough to judge by
_GRAVITY = 9.81
_WORSE_THAN_NONE = 1.0  # misfit of the label, relative to the label
_CLEARLY_BETTER = 0.5  # share of the misfit that another convention leaves
_MASS = 0.25  # relative
_SAME_NOISE = 0.05
_FOURTH = 70.0  # variance of fourth differences of white noise, relative
_NOISE = 2.0  # times its rms


class Suspicion(StrEnum):
    """What may be wrong. A member equals its word; ``meaning`` says what to do.

    Attributes
    ----------
    meaning : str
    """

    meaning: str

    TIME_UNIT = (
        "time_unit",
        "give the unit of time: time_unit, --time-unit s|ms|us|ns, or a factor for the column",
    )
    MISSING_G = (
        "missing_g",
        "give g, the known part of M x': gravity, thrust, torques; without it the filter takes it for f",
    )
    LABEL_MISFIT = (
        "label_misfit",
        "the label is not M x' - g: look for another unit, frame, sign or clock of the label, g, M or x",
    )
    LABEL_IS_DERIVATIVE = (
        "label_is_derivative",
        "the label repeats the noise of x, so scores favour filters that pass it: take an independent sensor, or a "
        "two-sided smoother of x",
    )
    WRONG_FRAME = "wrong_frame", "declare the convention that fits, or turn the signal before"
    WRONG_MASS = "wrong_mass", "weigh the robot, or check the unit and the model of the thrust"
    GAPS = "gaps", 'run a filter with nonfinite="hold", learn from recording.pieces(), or fix the log'

    def __new__(cls, word: str, meaning: str = "") -> Suspicion:
        """A member from its word, with what to do."""
        member = str.__new__(cls, word)
        member._value_ = word
        member.meaning = meaning
        return member


@dataclass(frozen=True, repr=False)
class Finding(Result):
    """One thing that is not plausible.

    Attributes
    ----------
    suspicion : Suspicion
    message : str
        What was found, with figures, and what to do.
    """

    suspicion: Suspicion
    message: str

    def __str__(self) -> str:
        return self.message


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

    @classmethod
    def of(cls, log: Recording, length: float) -> Windows | None:
        """Of a recording without gaps; None if it is too short."""
        steps = np.diff(log.times)
        recursion = PhyFilter([1.0]).sampled(log.dt).recursion
        signals = record.checked_signals(recursion, log.x, None, None, log.inertia)
        slope = record.measured_residual(recursion, *signals, steps, slice(0, log.n - 1))
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


def windows_of(log: Recording) -> list[Windows]:
    """Of the longest piece, at each length; as many steps as it takes to judge."""
    pieces = log.pieces() if log.missing.any() else (log,)
    if not pieces:
        return []
    piece = max(pieces, key=len)[: int(_MOST_STEPS)]
    lengths = dict.fromkeys(max(length, 3.0 * piece.dt) for length in _WINDOWS)
    return [found for length in lengths if (found := Windows.of(piece, length)) is not None]


def findings_of(recording: Recording, *, time_unit_known: bool = False) -> tuple[Finding, ...]:
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
    >>> [str(f.suspicion) for f in findings_of(Recording(t, np.sin(t / 5e5)))]
    ['time_unit']
    """
    found: list[Finding] = []
    if not (time_unit_known or _SHORTEST <= recording.dt <= _LONGEST):
        found.append(_time_unit(recording))
    if gaps := int(recording.missing.sum()):
        message = f"{gaps} of {recording.n} rows miss a signal; {Suspicion.GAPS.meaning}"
        found.append(Finding(Suspicion.GAPS, message))
    if found and found[0].suspicion is Suspicion.TIME_UNIT:
        return tuple(found)  # nothing else can be judged
    windows = windows_of(recording)
    if recording.label is not None:
        checks = [_label_misfit(recording, windows), _label_is_derivative(recording)]
    else:
        checks = [_wrong_frame(windows), _wrong_mass(windows)]
    return (*found, *(finding for finding in checks if finding is not None))


def rms(values: NDArray[np.floating]) -> float:
    """Over samples and channels."""
    return float(np.sqrt(np.mean(np.square(values))))


def _time_unit(log: Recording) -> Finding:
    dt = log.dt
    units = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}
    fits = [
        f"{dt * f:.3g} s if it counts {unit}" for unit, f in units.items() if _SHORTEST <= dt * f <= _LONGEST
    ]
    limits = f"expected 10 us to 1 s{'; ' if fits else ''}{', '.join(fits)}"
    return Finding(
        Suspicion.TIME_UNIT, f"the time steps are {dt:.4g} s, {limits}; {Suspicion.TIME_UNIT.meaning}"
    )


# -- the label ------------------------------------------------------------------------------------------------------


def _label_misfit(log: Recording, windows: Sequence[Windows]) -> Finding | None:
    """f = M x' - g is further from the label than nothing is."""
    if not windows or not any(rms(w.label) > 0.0 for w in windows if w.label is not None):
        return None
    best: tuple[float, Windows, FloatArray] | None = None
    for w in windows:
        assert w.label is not None
        left = (w.slope if w.g is None else w.slope - w.g) - w.label
        ratio = rms(left) / max(rms(w.label), np.finfo(float).tiny)
        if best is None or ratio < best[0]:
            best = ratio, w, left
    assert best is not None
    ratio, w, left = best
    if ratio <= _WORSE_THAN_NONE or rms(left) < _NOISE * w.noise:
        return None
    said = f"M x' {'- g ' if log.g is not None else ''}misses the label by {ratio:.2g} times its rms over windows"
    if log.g is None:
        mean = np.abs(left.mean(axis=0))
        weight = _GRAVITY * _mass_scale(log)
        heavy = int(np.argmax(mean))
        if abs(mean[heavy] / weight - 1.0) < 0.2:
            said += f", by {mean[heavy]:.3g} in {log.channels[heavy]}, as gravity would"
        return Finding(Suspicion.MISSING_G, f"there is no g, and {said}: {Suspicion.MISSING_G.meaning}")
    assert w.label is not None
    fits = {name: rms(w.slope - g - w.label) for name, g in _variants(w).items()}
    if fits and min(fits.values()) < _CLEARLY_BETTER * rms(left):
        said += f"; {min(fits, key=lambda name: fits[name])} it fits"
    return Finding(Suspicion.LABEL_MISFIT, f"{said}: {Suspicion.LABEL_MISFIT.meaning}")


def _variants(w: Windows) -> dict[str, FloatArray]:
    """g as other conventions would have it."""
    assert w.g is not None
    found = {"with -g": -w.g, "without g": np.zeros_like(w.g)}
    return found | {f"with {name}": turned for name, turned in _turned(w.g).items()}


def _turned(g: FloatArray) -> dict[str, FloatArray]:
    if g.shape[1] != 3:
        return {}
    return {
        "g turned from NED to ENU": g[:, [1, 0, 2]] * [1.0, 1.0, -1.0],
        "g turned from FRD to FLU": g * [1.0, -1.0, -1.0],
        "g turned from NWU to ENU": g[:, [1, 0, 2]] * [-1.0, 1.0, 1.0],
        "g of the other sign along z": g * [1.0, 1.0, -1.0],
    }


def _mass_scale(log: Recording) -> float:
    M = log.inertia
    if M is None:
        return 1.0
    return float(np.mean(np.abs(M))) if M.ndim == 0 or M.shape[-1] != log.n_x or M.ndim == 1 else 1.0


def _label_is_derivative(log: Recording) -> Finding | None:
    """The label holds the noise that differences of x have, to a share of it."""
    if log.label is None or log.missing.any() or log.n < 50:
        return None
    f = log.label if log.g is None else log.label + log.g
    steps = np.diff(log.times)[:, None]
    recursion = PhyFilter([1.0]).sampled(log.dt).recursion
    signals = record.checked_signals(recursion, log.x, None, None, log.inertia)
    forward = record.measured_residual(recursion, *signals, steps[:, 0], slice(0, log.n - 1))
    central = 0.5 * (forward[1:] + forward[:-1])
    five = (
        8.0 * (forward[1:-2] + forward[2:-1]) - (forward[:-3] + forward[1:-2] + forward[2:-1] + forward[3:])
    ) / 12.0
    pairs = {"forward": (f[:-1], forward), "backward": (f[1:], forward), "central": (f[1:-1], central)}
    pairs["five-point"] = (f[2:-2], five)
    for name, (given, difference) in pairs.items():
        noise = rms(np.diff(difference, 4, axis=0))
        if (
            noise > 1e-9 * rms(difference)
            and rms(np.diff(given - difference, 4, axis=0)) < _SAME_NOISE * noise
        ):
            said = f"the label is the {name} difference of x itself, noise included"
            return Finding(Suspicion.LABEL_IS_DERIVATIVE, f"{said}: {Suspicion.LABEL_IS_DERIVATIVE.meaning}")
    return None


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
            return Finding(Suspicion.WRONG_FRAME, f"{said}: {Suspicion.WRONG_FRAME.meaning}")
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
    return Finding(Suspicion.WRONG_MASS, f"{said}: {Suspicion.WRONG_MASS.meaning}")
