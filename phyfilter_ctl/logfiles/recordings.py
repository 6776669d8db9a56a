"""A table (Parquet, Arrow, Feather, MAT, HDF5, CSV) as a recording, by the names of its columns."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from types import EllipsisType
from typing import NamedTuple

from numpy.typing import ArrayLike

from .._intake import LARGEST
from ..recording import Recording
from ..recording.columns import VELOCITIES, inertia_option, wanted_columns, with_inertia
from .clock import TimeUnit
from .formats import FORMATS
from .logfile import open_log

__all__ = ["read_recording"]


class _Table(NamedTuple):
    path: Path
    header: tuple[str, ...]


def read_recording(
    path: str | os.PathLike[str],
    *,
    time: str | None = None,
    time_unit: TimeUnit | None = None,
    x: Sequence[str] = VELOCITIES,
    label: Sequence[str] | EllipsisType | None = ...,
    g: Sequence[str] | EllipsisType | None = ...,
    f_theta: Sequence[str] | EllipsisType | None = ...,
    features: Sequence[str] | EllipsisType | None = ...,
    inertia: ArrayLike | EllipsisType | None = ...,
    channels: Sequence[str] | None = None,
    unit: str | None = None,
    largest: int = LARGEST,
) -> Recording:
    """A recording from a table of any format that :func:`open_log` reads.

    Parameters
    ----------
    path : str or path-like
    time : str, optional
        Column of the times; None for the one that is called so.
    time_unit : {"s", "ms", "us", "ns"}, optional
        What it counts, where neither its name, as in ``t [s]``, nor its type or metadata say it.
    x, label, g, f_theta, features, inertia
        Columns, as for :meth:`Recording.from_csv`, with the same names where they are not given.
    channels : sequence of str, optional
        Names of the channels; None means the columns of x.
    unit : str, optional
        Unit of x; None means m/s for the default columns, else none.
    largest : int
        Bytes that the file may take in memory, as for :func:`open_log`.

    Returns
    -------
    Recording

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is no table, lacks a column, has no unit of time, takes more memory than ``largest``, or a value is
        missing.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "short.csv"
    ...     _ = path.write_text("t [ms];v;label_v\\n0;1.0;0.5\\n10;1.005;0.5\\n")
    ...     read_recording(path, x=["v"], unit="m/s")
    Recording('short': 2 samples of v [m/s], 0.01 s, dt 0.01 s; label)
    """
    log = open_log(path, time=time, time_unit=time_unit, largest=largest)
    if not FORMATS[log.format].table:
        raise ValueError(
            f"{path}: a {log.format} log has topics on clocks of their own: say what they are in a robot file, and "
            "read it by Robot.load(...).read"
        )
    topic, *others = log.topics
    if others:
        listed = ", ".join(each.name for each in log.topics)
        raise ValueError(f"{path}: expected one table, got {listed}; read them by open_log")
    header = tuple(
        name
        for field in topic.fields
        for name in ([f"{field.name}[{k}]" for k in range(*field.shape)] if field.shape else [field.name])
    )
    columns, constant = inertia_option(inertia)
    signals = {"label": label, "g": g, "f_theta": f_theta, "features": features, "inertia": columns}
    x, wanted = wanted_columns(_Table(log.path, header), time=None, x=x, signals=signals)
    names = list(dict.fromkeys(name for each in wanted.values() for name in each))
    signal = log.read(topic.name, names)
    place = {name: k for k, name in enumerate(names)}
    values = {
        key: signal.values if list(each) == names else signal.values[:, [place[name] for name in each]]
        for key, each in wanted.items()
    }
    return Recording.from_arrays(
        **{"inertia": constant, **with_inertia(values)},
        times=signal.times,
        name=log.path.stem,
        channels=x if channels is None else channels,
        unit=("m/s" if x == VELOCITIES else "") if unit is None else unit,
    )
