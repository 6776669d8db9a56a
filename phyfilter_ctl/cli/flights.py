"""Flights of ``phyfilter-ctl learn``: what is said of each, and what learns from them, in memory or left in files."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from .._sections import FloatArray
from ..design.learning.reading import files_of
from ..execution import Executor, progress
from ..recording import Recording
from .columns import constant_inertia, plausibility, read_columns

__all__ = ["Flights", "Summary", "read_flights", "read_labelled"]

# Files of so many bytes together are kept in memory, where learning is fastest.
_AT_HAND = 1 << 27


@dataclass(frozen=True, eq=False)
class Summary:
    """What is said of a flight.

    Attributes
    ----------
    name : str
    n : int
        Samples.
    channels : tuple of str
    unit : str
    inertia : array or None
        Where it is known and does not vary.
    has_f_theta : bool
    squares : (n_x,) array
        Sum of (label - f_theta)^2 over the samples that are scored.
    findings : tuple of str
        What is not plausible.
    """

    name: str
    n: int
    channels: tuple[str, ...]
    unit: str
    inertia: FloatArray | None
    has_f_theta: bool
    squares: FloatArray
    findings: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Flights:
    """The good flights of a list of files and folders.

    Attributes
    ----------
    logs : list of Recording or Path
        As ``learn`` takes them.
    summaries : list of Summary
    skipped : dict of str to str
        Bad ones, and why.
    """

    logs: list[Recording | Path] = field(default_factory=list)
    summaries: list[Summary] = field(default_factory=list)
    skipped: dict[str, str] = field(default_factory=dict)

    @property
    def samples(self) -> int:
        """Of all flights."""
        return sum(each.n for each in self.summaries)

    @property
    def names(self) -> list[str]:
        """Of the flights."""
        return [each.name for each in self.summaries]

    def alone(self, channels: Sequence[str]) -> float | None:
        """RMSE of f_theta alone on some channels; None without flights."""
        if not self.summaries:
            return None
        squares = sum(each.squares[each.channels.index(name)] for each in self.summaries for name in channels)
        return float(np.sqrt(squares / (len(channels) * sum(each.n - 1 for each in self.summaries))))


def read_labelled(path: Path, options: argparse.Namespace) -> Recording:
    """A flight to learn from.

    Raises
    ------
    ValueError, OSError
        If it cannot be read or has no label.
    """
    log = read_columns(path, options)
    if log.label is None:
        raise ValueError(
            f"{path}: no label, the true f to learn from; name its columns by --label, or in the file ax, ay, az "
            "(for vx, vy, vz) or label_<x>"
        )
    return log


def read_flights(names: Sequence[str], options: argparse.Namespace) -> Flights:
    """Read every flight once; of a folder every table is one.

    Raises
    ------
    ValueError, OSError
        If there are none, or one is bad and not skipped.
    """
    files = [file for name in names for file in files_of(Path(name))]
    size = sum(file.stat().st_size for file in files if file.is_file())
    here = options.scheduler is None and size <= _AT_HAND
    found = Flights()
    with (
        Executor(1 if here else options.workers, scheduler=options.scheduler) as executor,
        progress(len(files), options.quiet) as report,
    ):
        work = partial(_looked_at, options=options, keep=here)
        answers = executor.map(work, files, names=[str(file) for file in files], report=report)
        for file, answer in zip(files, answers, strict=True):
            _add(found, file, answer, options.skip_bad)
    if names and not found.logs:
        raise ValueError(
            f"no good flight among {len(files)}; the first: {next(iter(found.skipped.values()))}"
        )
    return found


def _looked_at(path: Path, options: argparse.Namespace, keep: bool) -> tuple[Summary, Recording | None] | str:
    try:
        log = read_labelled(path, options)
        findings = tuple(plausibility([log], options))
    except (ValueError, OSError) as error:
        if options.skip_bad:
            return str(error)
        raise
    assert log.label is not None
    gamma = log.label if log.f_theta is None else log.label - log.f_theta
    squares = np.sum(gamma[1:] ** 2, axis=0)
    known = (log.name, log.n, log.channels, log.unit, constant_inertia(log), log.f_theta is not None)
    return Summary(*known, squares, findings), log if keep else None


def _add(found: Flights, file: Path, answer: tuple[Summary, Recording | None] | str, skip: bool) -> None:
    if not isinstance(answer, str) and found.summaries:
        first = found.summaries[0]
        if answer[0].channels != first.channels:
            other, expected = ", ".join(answer[0].channels), ", ".join(first.channels)
            answer = f"{file}: has the channels {other}, where {first.name} has {expected}"
            if not skip:
                raise ValueError(answer)
    if isinstance(answer, str):
        found.skipped[str(file)] = answer
    else:
        found.summaries.append(answer[0])
        found.logs.append(file if answer[1] is None else answer[1])
