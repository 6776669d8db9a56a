"""Recordings out of CSV files by options that name their columns, for every command that takes recordings."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import EllipsisType
from typing import TYPE_CHECKING, Any, Protocol, get_args

from .._choices import TimeUnit
from .._intake import LARGEST

if TYPE_CHECKING:
    from .._sections import FloatArray
    from ..filter import SampledPhyFilter
    from ..recording import Recording

__all__ = [
    "COLUMNS",
    "add_columns",
    "add_largest",
    "constant_inertia",
    "for_signals_of",
    "names_of",
    "plausibility",
    "read_columns",
]

# Options that name columns.
COLUMNS = ("time", "time-unit", "dt", "x", "label", "g", "f-theta", "model", "features", "inertia")
_RULES = ("hold", "average")
_VELOCITIES = ("vx", "vy", "vz")


def add_columns(
    parser: argparse.ArgumentParser, *, dt: str = "sampling interval in s of files without times"
) -> None:
    """Add the options that name columns; ``dt`` is what the help says of --dt."""
    columns = parser.add_argument_group("columns, with commas between them (none: leave the signal out)")
    columns.add_argument("--time", metavar="COLUMN", help="times (default t, time, timestamp, ...)")
    columns.add_argument(
        "--time-unit",
        choices=get_args(TimeUnit),
        help="of the times (default: as the table says, else s with steps of 10 us to 1 s)",
    )
    columns.add_argument("--dt", type=float, metavar="S", help=dt)
    columns.add_argument("--x", metavar="C,C,...", help="measured signal (default vx,vy,vz)")
    columns.add_argument("--label", metavar="C,C,...", help="true f")
    columns.add_argument("--g", metavar="C,C,...", help="known part of M x'")
    columns.add_argument("--f-theta", metavar="C,C,...", help="learned model's estimate of f")
    columns.add_argument(
        "--model", metavar="FILE", help="instead: .onnx, or .npz of a learned model, run on --features"
    )
    columns.add_argument("--features", metavar="C,C,...", help="what --model takes (default feature_0, ...)")
    columns.add_argument("--inertia", metavar="M,... | C,...", help="M: numbers or columns (default 1)")
    columns.add_argument("--delimiter", metavar="CHAR", help="between columns (default: as the file has it)")
    add_largest(columns)
    columns.add_argument("--g-rule", choices=_RULES, default="hold", help="g between samples (default hold)")
    columns.add_argument(
        "--f-theta-rule", choices=_RULES, default="average", help="f_theta between samples (default average)"
    )


def add_largest(parser: argparse.ArgumentParser | argparse._ArgumentGroup) -> None:
    """Add ``--largest``, alike for every command that reads logs."""
    parser.add_argument(
        "--largest",
        type=int,
        default=LARGEST,
        metavar="BYTES",
        help="memory that one reading of a log may take (default: 1 GiB); more is refused",
    )


def read_columns(path: str | Path, options: argparse.Namespace) -> Recording:
    """A recording by those options: of any table that :meth:`Recording.read` reads.

    Raises
    ------
    ValueError, OSError
        If the options contradict each other, or the file cannot be read.
    """
    from ..logfiles import read_recording
    from ..recording import Recording
    from ..recording.header import TICKS

    for name in ("time", "time_unit"):
        if getattr(options, name) is not None and options.dt is not None:
            option = f"--{name.replace('_', '-')}"
            raise ValueError(f"{option} and --dt: expected one of them; --dt is for files without times")
    if options.model is not None and options.f_theta is not None:
        raise ValueError("--model and --f-theta: expected one of them")
    if options.features is not None and options.model is None:
        raise ValueError("--features: expected --model beside it, which takes them")
    x = _VELOCITIES if options.x is None else names_of("--x", options.x)
    label, g = _columns("--label", options.label), _columns("--g", options.g)
    f_theta = None if options.model else _columns("--f-theta", options.f_theta)
    features = _columns("--features", options.features) if options.model else None
    signals: dict[str, Any] = {"label": label, "g": g, "f_theta": f_theta, "features": features}
    inertia = _inertia(options.inertia)
    if options.delimiter is None:
        log = read_recording(
            path,
            time=options.time,
            time_unit=options.time_unit,
            dt=options.dt,
            x=x,
            inertia=inertia,
            largest=options.largest,
            **signals,
        )
    else:
        time = None if options.dt is not None else options.time or "t"
        known = options.time_unit is not None and time is not None
        log = Recording.from_csv(
            path,
            time=time,
            dt=options.dt,
            x=x,
            inertia=inertia,
            scale={str(time): TICKS[str(options.time_unit)]} if known else None,
            delimiter=options.delimiter,
            **signals,
        )
    return log if options.model is None else _with_model(path, log, options.model)


def plausibility(logs: Sequence[Recording], options: argparse.Namespace) -> list[str]:
    """What is not plausible about the recordings that :func:`read_columns` read, with what to do.

    Raises
    ------
    ValueError
        For steps of time that can hardly be seconds, unless their unit was given.
    """
    known, found = options.time_unit is not None or options.dt is not None, list[str]()
    for log in logs:
        for finding in log.check(time_unit_known=known):
            if finding.suspicion == "time_unit":
                raise ValueError(f"{log.name}: {finding.message}")
            found.append(f"{log.name}: {finding.message}")
    return found


def _with_model(path: str | Path, log: Recording, name: str) -> Recording:
    from ..learned import learned_model

    if log.features is None:
        raise ValueError(
            f"{path}: --model needs features; name their columns by --features, or feature_0, ..."
        )
    return log.with_model(learned_model(name, z=log.features)).with_signals(features=None)


def names_of(option: str, text: str) -> list[str]:
    """Names with commas between them."""
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise ValueError(f"{option}: expected names of columns with commas between them, got {text!r}")
    return names


def _columns(option: str, text: str | None) -> list[str] | EllipsisType | None:
    """None leaves a signal out, ``...`` takes the default columns where the file has them."""
    if text is None:
        return ...
    return None if text == "none" else names_of(option, text)


def _inertia(text: str | None) -> list[float] | list[str] | float | EllipsisType | None:
    columns = _columns("--inertia", text)
    if columns is None or isinstance(columns, EllipsisType):
        return columns
    try:
        numbers = [float(entry) for entry in columns]
    except ValueError:
        return columns
    return numbers[0] if len(numbers) == 1 else numbers


class DescribedLog(Protocol):
    """What of a recording is shown: its size, channels and signals."""

    @property
    def n(self) -> int: ...
    @property
    def channels(self) -> tuple[str, ...]: ...
    @property
    def unit(self) -> str: ...
    @property
    def inertia(self) -> FloatArray | None: ...


def for_signals_of(filter: SampledPhyFilter, logs: Sequence[DescribedLog]) -> SampledPhyFilter:
    """A filter that knows the channels, the unit of x and the constant inertia of these recordings."""
    import numpy as np

    inertias = [constant_inertia(log) for log in logs]
    first = inertias[0]
    same = first is not None and all(i is not None and np.array_equal(i, first) for i in inertias)
    known = filter.sampling
    sampling = replace(
        known,
        channels=known.names or logs[0].channels or None,
        inertia=first if same else known.inertia,
        units={"x": logs[0].unit, **known.units},
    )
    return replace(filter, sampling=sampling)


def constant_inertia(log: DescribedLog) -> FloatArray | None:
    """M of a flight where it is known and does not vary."""
    if log.inertia is None or log.inertia.ndim == 0 or len(log.inertia) != log.n:
        return log.inertia
    return log.inertia[0] if (log.inertia == log.inertia[0]).all() else None
