"""Recorded results of an FMU, and the same run again."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

import fmpy
import numpy as np

from .._output import replacing
from .._renamed import takes_former
from .._sections import FloatArray
from .clock_schedule import ClockTimes
from .fmu import Fmu
from .inspect import describe
from .instance import FmuInstance
from .signals import Signals
from .unpacked import UnpackedFmu

__all__ = ["Reference", "read_table", "replay", "replay_in_fmpy", "replayed"]


@dataclass(frozen=True, eq=False)
class Reference:
    """Recorded inputs and outputs of a run.

    Parameters
    ----------
    times : (N,) array
        Communication points, seconds.
    inputs : dict of str to (N,) array
        At these times.
    outputs : dict of str to (N,) array
    """

    times: FloatArray
    inputs: Mapping[str, FloatArray]
    outputs: Mapping[str, FloatArray]

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read ``NAME_out.csv`` and, where there is one, ``NAME_in.csv`` beside it.

        Parameters
        ----------
        path : str or Path
            Of the outputs.

        Raises
        ------
        ValueError
            If a file is no table of numbers with times that increase.
        FileNotFoundError
            If there is no such file.
        """
        path = Path(path)
        if not path.name.endswith("_out.csv"):
            raise ValueError(
                f"{path}: expected a file NAME_out.csv, with NAME_in.csv beside it where there are inputs"
            )
        names, table = read_table(path)
        times = table[:, 0]
        inputs: dict[str, FloatArray] = {}
        given = path.with_name(path.name.removesuffix("_out.csv") + "_in.csv")
        if given.exists():
            labels, values = read_table(given)
            inputs = {
                label: np.interp(times, values[:, 0], values[:, j]) for j, label in enumerate(labels) if j
            }
        return cls(times, inputs, {label: table[:, j] for j, label in enumerate(names) if j})

    def write(self, path: str | Path) -> None:
        """Write ``NAME_out.csv`` and ``NAME_in.csv``; numbers read back as they were.

        Parameters
        ----------
        path : str or Path
            Of the outputs, ``NAME_out.csv``.
        """
        path = Path(path)
        tables = {path: self.outputs}
        if self.inputs:
            tables[path.with_name(path.name.removesuffix("_out.csv") + "_in.csv")] = self.inputs
        for target, columns in tables.items():
            with replacing(target) as whole:
                file = io.TextIOWrapper(whole, "utf-8", newline="")
                writer = csv.writer(file, lineterminator="\n", quoting=csv.QUOTE_NONNUMERIC)
                writer.writerow(["time", *columns])
                writer.writerows(np.column_stack([self.times, *columns.values()]).tolist())
                file.detach()  # flushed, and not closed yet


@takes_former
def replay(
    fmu: str | Path | Fmu,
    reference: Reference,
    *,
    inputs_at: Literal["start", "end"] = "start",
) -> tuple[tuple[str, ...], FloatArray]:
    """Run a co-simulation FMU on recorded inputs, one communication step between two recorded times.

    Parameters
    ----------
    fmu : str, Path or Fmu
        The file, or the file with parameters, clocks, a tolerance and a process of its own.
    reference : Reference
    inputs_at : {"start", "end"}
        Inputs of a step are those recorded at its start (then outputs are read after the next inputs are set) or at
        its end (for a sampled block that takes its sample at the end of the step).

    Returns
    -------
    labels : tuple of str
    outputs : (N, k) array

    Raises
    ------
    ValueError
        If the FMU lacks a recorded signal or is not for co-simulation.
    FmuError
        If it fails.
    """
    chosen = Fmu.of(fmu)
    unpacked = UnpackedFmu(chosen)
    try:
        return replayed(unpacked, reference, inputs_at, clocks=chosen.clocks, tolerance=chosen.tolerance)
    finally:
        unpacked.close()


def replayed(
    fmu: UnpackedFmu,
    reference: Reference,
    inputs_at: Literal["start", "end"],
    *,
    clocks: ClockTimes | None = None,
    tolerance: float | None = None,
) -> tuple[tuple[str, ...], FloatArray]:
    """As :func:`replay`, of an FMU that is unpacked already.

    Parameters
    ----------
    fmu : UnpackedFmu
    reference : Reference
    inputs_at : {"start", "end"}
    clocks : dict, optional
    tolerance : float, optional
    """
    labels = tuple(reference.outputs)
    instance = FmuInstance(fmu, "cs", "replay", clocks)
    try:
        inputs = _vector(instance, "input", tuple(reference.inputs))
        outputs = _vector(instance, "output", labels)
        table = np.tile(inputs[0].read(instance), (len(reference.times), 1))
        for label, place in zip(reference.inputs, inputs[1], strict=True):
            table[:, place] = reference.inputs[label]
        times = reference.times
        instance.initialise(
            float(times[0]), stop_time=float(times[-1]), tolerance=tolerance, values=fmu.values
        )
        inputs[0].write(instance, table[0])
        instance.begin()
        rows = [outputs[0].read(instance)[outputs[1]]]
        for k in range(1, len(times)):
            if inputs_at == "end":
                inputs[0].write(instance, table[k])
            instance.do_step(float(times[k - 1]), float(times[k] - times[k - 1]))
            if inputs_at == "start":
                inputs[0].write(instance, table[k])
            rows.append(outputs[0].read(instance)[outputs[1]])
        return labels, np.array(rows)
    finally:
        instance.close()


def replay_in_fmpy(
    path: str | Path, reference: Reference, *, inputs_at: Literal["start", "end"] = "start"
) -> dict[str, FloatArray]:
    """Run a co-simulation FMU on recorded inputs in FMPy, another importer: outputs by label.

    Parameters
    ----------
    path : str or Path
    reference : Reference
        At equally spaced times; inputs of whole arrays where the FMU has arrays.
    inputs_at : {"start", "end"}
        As for :func:`replay`.

    Notes
    -----
    FMPy sets inputs at the beginning of a step. For a sample that is taken at its end each is given a step early. The
    first serves the start as well: of two rows of the same time FMPy takes the earlier one before the first step.
    """
    description, times = describe(path), reference.times
    if inputs_at == "end":
        times = np.concatenate([[times[0] - (times[1] - times[0]), times[0]], times[:-1]])
    inputs = [entry for entry in description.of("input") if entry.labels[0] in reference.inputs]
    outputs = [entry for entry in description.of("output") if set(entry.labels) & set(reference.outputs)]
    sizes = [(entry.name, float, (len(entry.labels),) if len(entry.labels) > 1 else ()) for entry in inputs]
    table = np.zeros(len(times), [("time", float), *sizes])
    table["time"] = times
    for entry in inputs:
        values = np.column_stack([reference.inputs[label] for label in entry.labels])
        early = np.vstack([values[:1], values[:1], values[1:]]) if inputs_at == "end" else values
        table[entry.name] = early if len(entry.labels) > 1 else early[:, 0]
    result = fmpy.simulate_fmu(
        str(path),
        start_time=float(reference.times[0]),
        stop_time=float(reference.times[-1]),
        output_interval=float(reference.times[1] - reference.times[0]),
        fmi_type="CoSimulation",
        input=table,
        output=[entry.name for entry in outputs],
    )
    found: dict[str, FloatArray] = {}
    for entry in outputs:
        found |= zip(
            entry.labels, np.asarray(result[entry.name]).reshape(len(reference.times), -1).T, strict=True
        )
    return found


def _vector(instance: FmuInstance, causality: str, labels: Sequence[str]) -> tuple[Signals, list[int]]:
    signals = instance.signals(causality)
    missing = [label for label in labels if label not in signals.labels]
    if missing:
        raise ValueError(
            f"recorded {causality} {missing[0]!r}: the FMU has {', '.join(signals.labels) or 'none'}"
        )
    return signals, [signals.labels.index(label) for label in labels]


def read_table(path: Path) -> tuple[list[str], FloatArray]:
    """A CSV file with a header; first column time."""
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows: Sequence[list[str]] = [row for row in csv.reader(file) if row]
    if len(rows) < 2 or rows[0][0].strip() != "time":
        raise ValueError(f'{path}: expected a header that starts with "time", and at least one row')
    try:
        table = np.array([[float(cell) for cell in row] for row in rows[1:]])
    except ValueError as error:
        raise ValueError(f"{path}: expected numbers in equally long rows: {error}") from error
    if table.ndim != 2 or table.shape[1] != len(rows[0]):
        raise ValueError(f"{path}: rows and header differ in length")
    if not np.all(np.isfinite(table[:, 0])) or np.any(np.diff(table[:, 0]) <= 0.0):
        raise ValueError(f"{path}: expected times that increase")
    return [name.strip() for name in rows[0]], table
