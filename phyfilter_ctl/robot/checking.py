"""A robot's log checked: its recording, what is not plausible, and how well other conventions would fit."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..logfiles import LogFile, Signal
from ..recording import Check, Finding, Recording
from ..recording.findings import finding, rms, windows_of
from .document import RobotSignal
from .frames import BODY, WORLD
from .reading import Reading

__all__ = ["checked"]

_STRETCH = 30.0  # s of the log by which conventions are judged
_CLEARLY_BETTER = 0.7  # share of the misfit that another convention leaves
_MASS = 0.2  # relative
_GAP = 3.0  # medians: a longer step ends a part


def checked(robot: Reading, log: LogFile) -> Check:
    """See :meth:`Robot.check`."""
    recording = robot.read(log)
    known = bool(robot.time_unit) or log.format not in ("csv", "parquet", "arrow", "mat", "hdf5")
    found = list(recording.check(time_unit_known=known))
    misfits: dict[str, float] = {}
    if "g" in robot.model and not any(f.suspicion == "time_unit" for f in found):
        part = _Part(log, *_stretch(recording))
        misfits = _misfits(robot, part)
        other = _wrong_convention(misfits)
        found = [f for f in found if f.suspicion != "wrong_frame" or other is None]
        found += [other] if other is not None else []
        mass = None if other is not None else _wrong_mass(robot, part)
        if mass is not None:
            found = [f for f in found if f.suspicion != "wrong_mass"] + [mass]
    return Check(recording, tuple(found), misfits)


def _stretch(recording: Recording) -> tuple[float, float]:
    """First and last time of the middle of the longest part in which nothing is missing and no clock jumps."""
    steps = np.diff(recording.times)
    ends = np.flatnonzero((steps > _GAP * recording.dt) | recording.missing[1:] | recording.missing[:-1])
    edges = np.concatenate([[-1], ends, [recording.n - 1]])
    longest = int(np.argmax(np.diff(edges)))
    first, last = (float(recording.times[k]) for k in (edges[longest] + 1, edges[longest + 1]))
    middle = 0.5 * (first + last)
    return max(first, middle - 0.5 * _STRETCH), min(last, middle + 0.5 * _STRETCH)


class _Part(LogFile):
    """A stretch of a log, read from its file once, however many conventions are tried."""

    def __init__(self, log: LogFile, start: float, stop: float) -> None:
        vars(self).update(vars(log), _read={}, _log=log, _span=(start, stop))

    def read(self, topic: str, fields: Sequence[str] | None = None, *, clock: str | None = None) -> Signal:
        """See :meth:`LogFile.read`."""
        found: dict[object, Signal] = vars(self)["_read"]
        key = (topic, fields if fields is None else tuple(fields), clock)
        if key not in found:
            whole = vars(self)["_log"].read(topic, fields, clock=clock)
            start, stop = vars(self)["_span"]
            kept = (whole.times >= start) & (whole.times <= stop)
            found[key] = replace(whole, times=whole.times[kept], values=whole.values[kept])
        return found[key]


def _misfit(recording: Recording) -> float | None:
    """Least over the lengths of windows: at the longest where noise rules, at the shortest where motion does."""
    windows = [w for w in windows_of(recording) if w.g is not None]
    return min((rms(w.left) for w in windows), default=None)


def _misfits(robot: Reading, log: LogFile) -> dict[str, float]:
    given = _misfit(robot.read(log))
    if given is None:
        return {}
    found: dict[str, float] = {}
    for name, signals in _conventions(robot.signals).items():
        try:
            misfit = _misfit(replace(robot, signals={**robot.signals, **signals}).read(log))
        except (
            ValueError
        ):  # a quaternion read in another order is one as well; what else fails is no convention
            continue
        if misfit is not None:
            found[name] = misfit
    return {"as declared": given} | dict(sorted(found.items(), key=lambda entry: entry[1]))


def _conventions(signals: Mapping[str, RobotSignal]) -> dict[str, dict[str, RobotSignal]]:
    """Other declarations of one signal, and of an attitude with a vector, in words."""
    own: dict[str, dict[str, RobotSignal]] = {}
    for name, signal in signals.items():
        options: dict[str, RobotSignal] = {}
        if signal.rotation:
            orders = ("rpy",) if signal.rotation == "rpy" else ("wxyz", "xyzw")
            pairs = [(body, world) for body in BODY for world in ("ENU", "NED")]
            pairs += [(world, body) for body, world in pairs]
            for order, frames in itertools.product(orders, pairs):
                text = f'{name}: rotation = "{order}", frames = ["{frames[0]}", "{frames[1]}"]'
                options[text] = replace(signal, rotation=order, frames=frames)
        elif signal.frame not in ("", "none"):
            for frame in WORLD if signal.frame in WORLD else BODY:
                options[f'{name}: frame = "{frame}"'] = replace(signal, frame=frame)
        own[name] = {text: option for text, option in options.items() if option != signal}
    found = {text: {name: option} for name, options in own.items() for text, option in options.items()}
    attitudes = [name for name, signal in signals.items() if signal.rotation]
    for q, v in itertools.product(attitudes, [n for n, s in signals.items() if s.frame in WORLD]):
        found |= {
            f"{one}; {other}": {q: own[q][one], v: own[v][other]}
            for one, other in itertools.product(own[q], own[v])
            if signals[v].frame != own[v][other].frame and signals[q].rotation == own[q][one].rotation
        }
    return found


def _wrong_convention(misfits: Mapping[str, float]) -> Finding | None:
    others = list(misfits.items())[1:]
    if not others:
        return None
    given, (name, least) = misfits["as declared"], others[0]
    if least >= _CLEARLY_BETTER * given:
        return None
    said = f"rms of M x' - g is {given:.3g} N as declared, but {least:.3g} N with {name}"
    return finding("wrong_frame", said)


def _wrong_mass(robot: Reading, log: LogFile) -> Finding | None:
    """The constant that M is, where it is one: the value with the least M x' - g, which is linear in it."""
    name = robot.model.get("M", "")
    value = robot.constants.get(name) if isinstance(name, str) else None
    if not isinstance(value, float):
        return None
    other = replace(robot, constants={**robot.constants, name: 1.1 * value}).read(log)
    pair = [windows_of(each) for each in (robot.read(log), other)]
    if not (pair[0] and pair[1]):
        return None
    left, right = (windows[-1].left for windows in pair)
    slope = (right - left) / (0.1 * value)
    energy = float(np.sum(slope * slope))
    if not energy > 0.0:
        return None
    change = -float(np.sum(slope * left)) / energy
    rest = rms(left + slope * change) / max(rms(left), np.finfo(float).tiny)
    if abs(change) < _MASS * value or rest > _CLEARLY_BETTER:
        return None
    said = f"{name} = {value + change:.3g} fits best, {value:.3g} is given"
    return finding("wrong_mass", said)
