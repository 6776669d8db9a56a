"""From a signal's place in a log to SI units, the internal frame and one common time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .._sections import FloatArray
from .clocks import Track
from .document import RobotSignal, factor_of, nearest
from .frames import BODY, WORLD, attitude, to_internal

if TYPE_CHECKING:
    from ..logfiles import LogFile

__all__ = ["track_of"]


def track_of(path: Path, name: str, signal: RobotSignal, log: LogFile, clocks: Mapping[str, float]) -> Track:
    """The signal on its own clock.

    Raises
    ------
    ValueError
        If the log has it not, its unit is not known or another one, its clock runs back or is slower than its gap.
    """
    where = f"{path}: signals.{name}"
    topic = _topic(where, signal, log)
    try:
        found = log.read(topic, list(signal.fields), clock=signal.clock or None)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    _refuse_count(where, signal, len(found.fields))
    times, values = _ordered(where, topic, np.asarray(found.times), np.asarray(found.values, dtype=float))
    values = values * _factor(where, signal, found.fields, found.units)
    try:
        if signal.rotation:
            values = attitude(values, signal.rotation, signal.frames)
        elif signal.frame not in ("", "none"):
            values = to_internal(values, signal.frame)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    step = float(np.median(np.diff(times)))
    if step > signal.gap:
        raise ValueError(
            f"{where}.gap: expected at least the {step:.3g} s between two samples of {topic!r}, got {signal.gap:g}; "
            "set it to the longest step across which the signal is still known"
        )
    return Track(
        times=times + clocks.get(topic, 0.0) + signal.delay,
        values=values[:, 0] if signal.is_number else values,
        between=signal.between,
        gap=signal.gap * (1.0 + 1e-9),
        tail=step,
    )


def _refuse_count(where: str, signal: RobotSignal, got: int) -> None:
    """A field may be an array of several columns."""
    expected = 1 if signal.is_number else signal.columns
    if expected not in (None, got):
        raise ValueError(
            f"{where}.fields: expected {expected} columns, got {got} of {', '.join(signal.fields)}"
        )
    if got == 3 and not signal.frame and not signal.rotation:
        raise ValueError(
            f'{where}.frame: missing: of three columns, one of {", ".join((*WORLD, *BODY))}, or "none" if no vector'
        )


def _topic(where: str, signal: RobotSignal, log: LogFile) -> str:
    names = tuple(topic.name for topic in log.topics)
    if not signal.topic:
        if len(names) == 1:
            return names[0]
        raise ValueError(f"{where}.topic: missing: {log.path} has {len(names)}: {', '.join(names)}")
    if signal.topic not in names:
        raise ValueError(f"{where}.topic: {log.path} has no {signal.topic!r}; {nearest(signal.topic, names)}")
    return signal.topic


def _ordered(where: str, topic: str, times: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Without samples that have no time, and of several at one time the last."""
    known = np.isfinite(times)
    times, values = times[known], values[known]
    steps = np.diff(times)
    if (steps < 0.0).any():
        k = int(np.argmax(steps < 0.0))
        raise ValueError(
            f"{where}: the clock of {topic!r} runs back {-steps[k]:.6g} s after {times[k]:.9g} s; cut the log there"
        )
    kept = np.append(steps > 0.0, True) if len(times) else np.zeros(0, dtype=bool)
    if kept.sum() < 2:
        raise ValueError(f"{where}: expected at least 2 samples of {topic!r}, got {int(kept.sum())}")
    return times[kept], values[kept]


def _factor(where: str, signal: RobotSignal, fields: Sequence[str], said: Sequence[str]) -> FloatArray:
    """Factor to SI of each field: the file's own unit, which must be of the kind the log says, or the log's."""
    factors: list[float] = []
    for field, unit in zip(fields, said, strict=True):
        logged = factor_of(unit) if unit else None
        if not signal.unit:
            if logged is None:
                got = f"only {unit!r}, which is not understood" if unit else "none"
                raise ValueError(
                    f"{where}.unit: missing: the log says {got} of {field!r}; write the unit it is in"
                )
            factors.append(logged[0])
            continue
        own = factor_of(signal.unit)
        assert own is not None  # checked when the file was read
        if logged is not None and unit != "1" and (dict(own[1]), own[0]) != (dict(logged[1]), logged[0]):
            raise ValueError(
                f"{where}.unit: the log says {unit!r} of {field!r}, expected that, got {signal.unit!r}"
            )
        factors.append(own[0])
    return np.array(factors)
