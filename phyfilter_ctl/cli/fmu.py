"""``phyfilter-ctl fmu``: say what is in an FMU, check it, run it, and check all recipes."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

from .._output import add_json, write_json

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["add_arguments", "main"]

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
    run.add_argument(
        "--max-steps", type=int, default=20_000_000, metavar="N", help="most steps (default: 20000000)"
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
    from .fmu_run import run

    return {"describe": _describe, "check": _check, "run": run, "recipes": _recipes}[options.fmu_job](options)


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
    from ..fmi import Fmu, check
    from .fmu_run import isolated

    report = check(
        Fmu(options.file, isolated=isolated(options)),
        reference=options.reference,
        inputs_at=options.inputs_at,
        run=not options.no_run,
    )
    _publish(options, report, lambda: json.loads(report.as_json()))
    return int(not report.ok)


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
