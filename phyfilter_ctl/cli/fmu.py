"""``phyfilter-ctl fmu``: say what is in an FMU, check it, run it, and check all recipes."""

from __future__ import annotations

import argparse
import csv
import io
import json
import sys
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .._output import add_json, check_target, write_figure, write_json, write_text

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    import control as ct

    from .._sections import FloatArray
    from ..fmi import CosimulationResponse, FmuDescription, Isolation

__all__ = ["add_arguments", "main"]

_ENDED = "to end the run at"
_DESCRIPTION = (
    "FMUs of any tool, FMI 2.0 and 3.0. check and run load the FMU's code, into a process of its own: it may crash or "
    "hang there, but does what it likes to your files. Trust it first."
)

_EPILOG = """examples:
  phyfilter-ctl fmu describe model.fmu                      variables, kinds, platforms; loads no code
  phyfilter-ctl fmu check model.fmu --reference model_out.csv
  phyfilter-ctl fmu run model.fmu --stop 5 --set plant.m=2 --input inputs.csv --out outputs.csv --picture run.png
  phyfilter-ctl fmu recipes fmus                            build every recipe's FMU and check it on its record"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``phyfilter-ctl fmu``."""
    parser.description, parser.epilog = _DESCRIPTION, _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    jobs = parser.add_subparsers(title="jobs", metavar="JOB", required=True, dest="fmu_job")
    describe = jobs.add_parser("describe", help="what the FMU says of itself, without loading it")
    describe.add_argument("file", metavar="FILE.fmu")
    check = jobs.add_parser("check", help="validate, run, and replay a record")
    check.add_argument("file", metavar="FILE.fmu")
    check.add_argument(
        "--reference", metavar="NAME_out.csv", help="recorded outputs; inputs in NAME_in.csv beside it"
    )
    check.add_argument(
        "--inputs-at",
        choices=("start", "end"),
        default="start",
        help="which inputs a step gets in the replay",
    )
    check.add_argument("--no-run", action="store_true", help="look at the archive and the description only")
    run = jobs.add_parser("run", help="simulate")
    run.add_argument("file", metavar="FILE.fmu")
    run.add_argument("--stop", type=float, metavar="S", help="last time in s (default: the FMU's, or 1)")
    run.add_argument(
        "--step",
        type=float,
        metavar="S",
        help="communication step in s (default: the FMU's, or 1/500 of the run)",
    )
    run.add_argument(
        "--set",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME=VALUE",
        help="parameters and start values; one that the FMU refuses ends the run",
    )
    run.add_argument(
        "--input",
        metavar="FILE.csv",
        help="inputs over time, first column time, names in the first row: straight lines between rows, discrete ones "
        "held (in model exchange all are held from step to step where one is discrete)",
    )
    run.add_argument(
        "--record",
        nargs="+",
        action="extend",
        metavar="PATTERN",
        help="variables to put out, of any causality (* and ? stand for other characters; default: the outputs)",
    )
    run.add_argument(
        "--kind",
        choices=("cs", "me", "se"),
        help="co-simulation; model exchange, integrated here with its events; or scheduled execution (default: the "
        "first of these that it has)",
    )
    run.add_argument(
        "--clock",
        nargs="+",
        default=[],
        metavar="NAME=S[,S...]",
        help="times in s at which a triggered clock ticks; interval in s of a clock that has none of its own",
    )
    run.add_argument("--out", metavar="FILE.csv", help="outputs over time; - for standard output")
    run.add_argument("--picture", metavar="FILE", help="outputs as png, pdf or svg")
    for job in (check, run):
        job.add_argument(
            "--in-process",
            action="store_true",
            help="run the FMU in this process: quicker, and it may take it along",
        )
        job.add_argument(
            "--call-limit", type=float, default=60.0, metavar="S", help="longest call in s (default: 60)"
        )
        job.add_argument("--time-limit", type=float, metavar="S", help="longest run in s")
    recipes = jobs.add_parser("recipes", help="build and check the FMU of every recipe in a folder")
    recipes.add_argument("folder", metavar="DIR")
    for job in (describe, check, run, recipes):
        add_json(job)


def main(options: argparse.Namespace) -> int:
    """Run ``phyfilter-ctl fmu``; return the exit status: 1 where a check found an error or the FMU failed.

    Raises
    ------
    ValueError, OSError
        If the options are wrong or a file cannot be read or written.
    """
    return {"describe": _describe, "check": _check, "run": _run, "recipes": _recipes}[options.fmu_job](
        options
    )


def _describe(options: argparse.Namespace) -> int:
    from ..fmi import describe

    found = describe(options.file)
    _publish(options, found, lambda: json.loads(found.as_json()))
    return 0


def _publish(options: argparse.Namespace, text: object, figures: Callable[[], object]) -> None:
    if options.json is not None:
        write_json(options.json, figures())
    if options.json != "-":
        print(text)


def _check(options: argparse.Namespace) -> int:
    from ..fmi import check

    report = check(
        options.file,
        reference=options.reference,
        inputs_at=options.inputs_at,
        run=not options.no_run,
        isolated=_isolated(options),
    )
    _publish(options, report, lambda: json.loads(report.as_json()))
    return int(not report.ok)


def _isolated(options: argparse.Namespace) -> bool | Isolation:
    from ..fmi import Isolation

    return not options.in_process and Isolation(options.call_limit, options.time_limit)


def _recipes(options: argparse.Namespace) -> int:
    from ..fmi.recipes import check_all

    reports = check_all(options.folder)
    text = "\n".join(str(report) for entries in reports.values() for report in entries)
    _publish(
        options,
        text,
        lambda: {name: [json.loads(r.as_json()) for r in entries] for name, entries in reports.items()},
    )
    return int(not all(report.ok for entries in reports.values() for report in entries))


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


def _run(options: argparse.Namespace) -> int:
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
    from ..fmi import cosimulate, describe, import_fmu

    description = describe(options.file)
    inputs = {} if options.input is None else _inputs(options.input, times, description)[0]
    isolated = _isolated(options)
    settings = dict(map(_setting, options.set))
    whole = options.file
    if options.record is not None or options.kind == "se":
        step = float(times[1] - times[0])
        whole = import_fmu(
            whole,
            kind=options.kind,
            step=step,
            parameters=settings,
            outputs=options.record,
            isolated=isolated,
        )
        settings = {}
    response = cosimulate(
        {"fmu": whole},
        [],
        timepts=times,
        inputs={f"fmu.{name}": values for name, values in inputs.items()},
        parameters={f"fmu.{name}": value for name, value in settings.items()},
        progress=_has_bar(options),
        isolated=isolated,
        clocks={f"fmu.{name}": times for name, times in _clocks(options.clock, description).items()},
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
    from ..fmi import FmuModel, describe, import_fmu
    from ..simulation import simulate

    settings = dict(map(_setting, options.set))
    block = import_fmu(
        options.file,
        kind="me",
        parameters=settings,
        start_time=float(times[0]),
        outputs=options.record,
        isolated=_isolated(options),
        clocks=_clocks(options.clock, describe(options.file)),
    )
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
        squeeze=False,
        progress=_has_bar(options),
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
