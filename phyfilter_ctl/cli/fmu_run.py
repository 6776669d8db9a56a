"""``phyfilter-ctl fmu run``: one FMU by itself, on inputs from a table."""

from __future__ import annotations

import argparse
import csv
import io
import sys
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .._intake import check_count
from .._output import check_target, write_figure, write_json, write_text

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    import control as ct

    from .._sections import FloatArray
    from ..fmi import CosimulationResponse, FmuDescription, Isolation

__all__ = ["isolated", "run"]

_ENDED = "to end the run at"


def isolated(options: argparse.Namespace) -> bool | Isolation:
    """Whether, and how long at most, the FMU runs in a process of its own."""
    from ..fmi import Isolation

    return not options.in_process and Isolation(options.call_limit, options.time_limit)


def _has_bar(options: argparse.Namespace) -> bool:
    return sys.stderr.isatty() and not options.quiet


class _Result(NamedTuple):
    """What a run gave, whichever way it was made."""

    labels: list[str]
    outputs: FloatArray
    log: Sequence[str]
    message: str
    plot: Callable[[], ct.ControlPlot]
    texts: Mapping[str, Sequence[str]] = MappingProxyType({})


def run(options: argparse.Namespace) -> int:
    """Run the FMU, write and print what came of it; return the exit status."""
    from ..fmi import CosimulationResponse, FmuError, describe
    from ..fmi.messages import complaints

    check_target(options.out)
    check_target(options.picture, suffixes=(".png", ".pdf", ".svg"))
    found = describe(options.file)
    options.kind = options.kind or next((kind for kind in ("cs", "me", "se") if kind in found.kinds), "cs")
    exchange = options.kind == "me"
    start = found.start_time or 0.0
    stop = next((s for s in (options.stop, found.stop_time) if s is not None), start + 1.0)
    step = options.step or (found.step if exchange else found.communication_step) or (stop - start) / 500.0
    if not (stop > start and 0.0 < step <= stop - start):
        raise ValueError(
            f"expected --stop after {start:g} s and --step within the run, got {stop:g} and {step:g}"
        )
    advice = "choose --stop and --step, or allow more by --max-steps"
    check_count((stop - start) / step, options.max_steps, f"steps of {options.file}", advice)
    times = start + step * np.arange(round((stop - start) / step) + 1, dtype=np.float64)
    try:
        result = (_exchanged if exchange else _cosimulated)(options, times)
    except FmuError as error:
        if not isinstance(error.results, CosimulationResponse) or np.all(np.isnan(error.results.outputs)):
            print(f"phyfilter-ctl: error: {error}", file=sys.stderr)
            return 1
        result = _of_cosimulation(error.results)
    # An FMU that ends its own run did what it was made for.
    failed = int(bool(result.message) and _ENDED not in result.message)
    if result.message:
        print(f"phyfilter-ctl: {'error' if failed else 'note'}: {result.message}", file=sys.stderr)
    for message in complaints(result.log):
        print(f"phyfilter-ctl: the FMU says: {message}", file=sys.stderr)
    outputs = result.outputs
    known = np.flatnonzero(~np.all(np.isnan(outputs), axis=0))
    reached = int(np.max(known, initial=-1)) + 1 if result.labels else len(times)
    if options.out is not None:
        write_text(options.out, _table(result, times[:reached]))
    if options.picture is not None:
        import matplotlib

        matplotlib.use("Agg")
        write_figure(options.picture, result.plot().figure)
    shown = outputs[:, :reached] if reached else outputs[:0]
    if options.json is not None:
        figures = {
            label: {"first": values[0], "last": values[-1], "least": values.min(), "largest": values.max()}
            for label, values in zip(result.labels, shown, strict=False)
        }
        ends = {label: {"first": t[0], "last": t[-1]} for label, t in result.texts.items() if t}
        write_json(
            options.json,
            {
                "name": found.name,
                "points": reached,
                "start": start,
                "end": times[max(reached, 1) - 1],
                "message": result.message or None,
                "failed": bool(failed),
                "outputs": figures | ends,
            },
        )
    if "-" not in (options.out, options.json):
        print(f"{found.name}: {reached} points, {start:g} to {times[max(reached, 1) - 1]:g} s")
        for label, values in zip(result.labels, shown, strict=False):
            print(
                f"  {label:24} {values[0]:12.6g} -> {values[-1]:12.6g}   "
                f"within {values.min():.6g} .. {values.max():.6g}"
            )
        for label, texts in result.texts.items():
            print(f"  {label:24} {texts[0]!r} -> {texts[-1]!r}" if texts else f"  {label}")
    return failed


def _cosimulated(options: argparse.Namespace, times: FloatArray) -> _Result:
    from ..fmi import Fmu, cosimulate, describe, import_fmu

    description = describe(options.file)
    inputs = {} if options.input is None else _inputs(options.input, times, description)[0]
    whole = Fmu(
        options.file,
        parameters=dict(map(_setting, options.set)),
        outputs=options.record,
        clocks=_clocks(options.clock, description),
        isolated=isolated(options),
    )
    if options.record is not None or options.kind == "se":
        whole = import_fmu(whole, kind=options.kind, step=float(times[1] - times[0]))
    response = cosimulate(
        {"fmu": whole},
        times,
        inputs={f"fmu.{name}": values for name, values in inputs.items()},
        progress=_has_bar(options),
    )
    return _of_cosimulation(response)


def _of_cosimulation(response: CosimulationResponse) -> _Result:
    labels = [label.removeprefix("fmu.") for label in response.output_labels or []]
    outputs = np.asarray(response.outputs).reshape(len(labels), len(response.time))
    texts = {
        label.removeprefix("fmu."): [
            value.hex() if isinstance(value, bytes) else str(value) for value in values
        ]
        for label, values in response.texts.items()
    }
    return _Result(labels, outputs, response.messages["fmu"], response.message or "", response.plot, texts)


def _exchanged(options: argparse.Namespace, times: FloatArray) -> _Result:
    from ..fmi import Fmu, FmuModel, describe, import_fmu
    from ..simulation import simulate

    whole = Fmu(
        options.file,
        parameters=dict(map(_setting, options.set)),
        outputs=options.record,
        clocks=_clocks(options.clock, describe(options.file)),
        isolated=isolated(options),
    )
    block = import_fmu(whole, kind="me", start_time=float(times[0]))
    assert isinstance(block, FmuModel)
    names, labels = block.labels
    description = block.description
    given, held = ({}, False) if options.input is None else _inputs(options.input, times, description)
    if strange := sorted(set(given) - set(names)):
        raise ValueError(
            f"{options.input}: {strange[0]!r} is no input of numbers; there are {', '.join(names) or 'none'}"
        )
    inputs = [
        given.get(name, np.full(len(times), start))
        for name, start in zip(names, block.start_inputs, strict=True)
    ]
    response = simulate(
        block,
        times,
        np.array(inputs) if inputs else None,
        interpolation="hold" if held else "linear",
        limits={"progress": _has_bar(options)},
    )
    outputs = np.asarray(response.outputs).reshape(len(labels), len(response.time))
    return _Result(list(labels), outputs, block.messages, response.message or "", response.plot)


def _inputs(path: str, times: FloatArray, description: FmuDescription) -> tuple[dict[str, FloatArray], bool]:
    """Inputs at these times, and whether one of them is discrete and so held."""
    from ..fmi.held_inputs import is_continuous
    from ..fmi.replay import read_table

    names, table = read_table(Path(path))
    discrete = {
        label for entry in description.of("input") if not is_continuous(entry) for label in entry.labels
    }
    # A row at one of the times but for rounding holds from there.
    last = np.searchsorted(table[:, 0], times + 1e-9 * np.min(np.diff(times)), side="right") - 1
    found = {
        name: table[np.maximum(last, 0), i]
        if name in discrete
        else np.interp(times, table[:, 0], table[:, i])
        for i, name in enumerate(names)
        if i
    }
    return found, not discrete.isdisjoint(found)


def _clocks(texts: Sequence[str], description: FmuDescription) -> dict[str, float | list[float]]:
    """Instants of triggered clocks, intervals of others."""
    triggered = {clock.name for clock in description.clocks if clock.variability == "triggered"}
    found: dict[str, float | list[float]] = {}
    for text in texts:
        name, _, numbers = text.partition("=")
        try:
            values = [float(word) for word in numbers.split(",")]
        except ValueError as error:
            raise ValueError(f"--clock: expected NAME=S or NAME=S,S,..., got {text!r}") from error
        found[name] = values if name in triggered or len(values) > 1 else values[0]
    return found


def _setting(text: str) -> tuple[str, str]:
    name, separator, value = text.partition("=")
    if not name or not separator:
        raise ValueError(f"--set: expected NAME=VALUE, got {text!r}")
    return name, value  # a number or a text: what the variable is says which


def _table(result: _Result, times: FloatArray) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["time", *result.labels, *result.texts])
    rows = zip(times, result.outputs.T, *result.texts.values(), strict=False)
    writer.writerows([repr(float(t)), *(repr(float(v)) for v in row), *texts] for t, row, *texts in rows)
    return text.getvalue()
