"""The corpus on every route: ``python -m tests.corpus``.

Prints one row for each system (worst error of a route over what it may have, or its status) and a table of the routes.
An answer is right, wrong (a number that is off, with success=True), or a status: success False, or a refusal with a
message. A status is right where no solution exists.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import phyfilter_ctl as pf
from phyfilter_ctl.codegen import CompilerError
from phyfilter_ctl.fmi import FmuSolver
from tests.corpus.system import Array, System
from tests.corpus.systems import FAMILIES, all_systems

# What simulate is asked for by default.
RTOL, ATOL_SHARE = 1e-8, 0.01  # atol is that share of rtol
# Steps whose errors add up: 100 errors of a step, each as large as asked for.
ACCUMULATED = 100.0
# Of systems that have a solution, how many simulate may meet with a status in place of an answer.
MOST_STATUSES = 0.05
# A system that amplifies errors more than this tells right from wrong no longer, and does not belong here.
MOST_AMPLIFIED = 1000.0
# Steps of a run of fixed length, and what the classical method may lose with them where all is smooth.
FIXED_STEPS, FIXED_ERROR = 4000, 1e-6
# Without location of switches an answer of fixed step is off by the motion of a few steps.
FIXED_LATE = 20.0
# CVODE (FMPy's, in model exchange) at a relative tolerance of 1e-8 and absolute ones of its own.
CVODE_TOLERANCE, CVODE_ERROR = 1e-8, 3e-5
# Size of the disturbance by which the sensitivity to the start is measured, and that of the second run of a batch.
NUDGE, ANOTHER = 1e-6, 0.03
# Seconds of this machine that a run may take.
TIME_LIMIT = 5.0


@dataclass(frozen=True)
class Cell:
    """What one route gave for one system.

    Parameters
    ----------
    outcome : {"right", "wrong", "status", "crash"}
        A crash is an exception that is no refusal.
    error : float
        Largest error over the one allowed; NaN for a status.
    message : str
    seconds : float
    """

    outcome: str
    error: float = np.nan
    message: str = ""
    seconds: float = 0.0


class RefusedError(Exception):
    """A status in place of an answer."""


# What a refusal may be.
REFUSALS = (RefusedError, ValueError, TypeError, CompilerError)


class Case:
    """A system with its reference and what may be off."""

    def __init__(self, system: System, rtol: float = RTOL) -> None:
        self.system, self.rtol = system, rtol
        self.times = system.timepts
        self.start = np.asarray(system.start, dtype=float)
        self.inputs = None if system.inputs is None else np.atleast_2d(system.inputs(self.times))
        self.expected: Array | None = None
        self.amplification = 1.0
        if system.reference is not None:
            self.expected = self.answer(self.start)
            self.amplification = self._amplification()

    def _amplification(self) -> float:
        """How much of an error at the start is left later, at most, along two directions; 1 at least."""
        found = 1.0
        start = np.asarray(self.system.hidden or self.start, dtype=float)
        scale = np.maximum(np.abs(start), 1.0)
        for direction in (np.ones(len(start)), (-1.0) ** np.arange(len(start)))[: len(start)]:
            moved = self.answer(start + NUDGE * scale * direction)
            found = max(found, float(np.abs(moved - self.expected).max() / NUDGE / scale.max()))
        return found

    @property
    def options(self) -> dict[str, Any]:
        """Keywords of a run; the default tolerance is not said."""
        asked = {} if self.rtol == RTOL else {"rtol": self.rtol, "atol": ATOL_SHARE * self.rtol}
        return {"limits": {"time_limit": TIME_LIMIT}, **asked}

    def answer(self, start: Array) -> Array:
        assert self.system.reference is not None
        return np.atleast_2d(
            self.system.reference(self.times, start if len(start) else np.array(self.system.hidden))
        )

    def _scale(self) -> Array:
        assert self.expected is not None
        return np.maximum(np.abs(self.expected).max(axis=1, keepdims=True), ATOL_SHARE)

    def allowed(self, kind: str) -> Array:
        """Error that an answer may have, for each output."""
        assert self.expected is not None
        scale = self._scale()
        asked = ACCUMULATED * self.amplification * self.rtol * (ATOL_SHARE + scale)
        if kind == "asked":
            return asked
        if kind == "cvode":
            return asked + self.amplification * CVODE_ERROR * scale.max()
        late = 0.0
        if self.system.switching:
            step = (self.times[-1] - self.times[0]) / FIXED_STEPS
            rates = np.abs(np.diff(self.expected, axis=1)) / np.diff(self.times)
            late = FIXED_LATE * step * max(float(rates.max()), self.system.pace)
        return asked + self.amplification * (FIXED_ERROR * scale.max() + late)


def answered(case: Case, response: Any) -> Array:
    """Outputs of a response, or its status."""
    if not response.success:
        raise RefusedError(response.message)
    return np.asarray(response.outputs, dtype=float).reshape(-1, len(case.times))


def _simulated(**options: Any) -> Callable[[Case, Any, Path], Array]:
    def run(case: Case, model: Any, folder: Path) -> Array:
        chosen = dict(options)
        if chosen.get("method") in ("rk4", "exact"):  # of fixed steps where the diagram is not linear
            chosen["max_step"] = (case.times[-1] - case.times[0]) / FIXED_STEPS
        response = pf.simulate(
            model,
            case.times,
            case.inputs,
            case.start if len(case.start) else None,
            **case.options,
            **chosen,
        )
        return answered(case, response)

    return run


def _as_called(case: Case, model: Any, folder: Path) -> Array:
    """The diagram itself, with nothing chosen; a fresh one, as a first call."""
    response = pf.simulate(
        case.system.build(),
        case.times,
        case.inputs,
        case.start if len(case.start) else None,
        **case.options,
    )
    return answered(case, response)


def _batch(case: Case, model: Any, folder: Path) -> Array:
    """Two runs, from the start and from another: rows of the second below those of the first."""
    starts = np.array([case.start, second_start(case)])
    inputs = None if case.inputs is None else np.array([case.inputs, case.inputs])
    if not len(case.start):
        inputs = np.zeros((2, model_inputs(model), len(case.times))) if inputs is None else inputs
    options = case.options | {"limits": case.options["limits"] | {"workers": 1}}
    runs = pf.simulate_batch(model, case.times, inputs, starts if len(case.start) else None, **options)
    return np.vstack([answered(case, run) for run in runs])


def model_inputs(model: Any) -> int:
    return len(model.inputs)


def second_start(case: Case) -> Array:
    """Where a state is 0 it stays there."""
    return case.start * (1.0 + ANOTHER * np.asarray(case.system.movable))


def _fmu(version: str, kind: str) -> Callable[[Case, Any, Path], Array]:
    def run(case: Case, model: Any, folder: Path) -> Array:
        import fmpy  # only where it is asked for: it takes a second

        path = folder / f"fmi{version[0]}.fmu"
        if not path.exists():
            solver = FmuSolver("adaptive", rtol=case.rtol, atol=ATOL_SHARE * case.rtol)
            pf.export_fmu(model, path, fmi=version, experiment=pf.fmi.FmuExperiment(solver=solver))
        description = fmpy.read_model_description(str(path))
        variables = {each.name: each for each in description.modelVariables}
        outputs = [name for name, each in variables.items() if each.causality == "output"]
        starts: dict[str, Any] = {}
        for state, value in zip(model.states, case.start, strict=False):
            name = state.name if state.name in variables else state.name.partition("[")[0]
            if name == state.name:
                starts[name] = float(value)
            else:  # FMI 3 has arrays
                starts[name] = [*starts.get(name, []), float(value)]
        signals = None
        if case.inputs is not None:
            names = [v.name for v in description.modelVariables if v.causality == "input"]
            signals = np.array(
                [tuple(row) for row in np.vstack([case.times, case.inputs]).T],
                dtype=[("time", float), *((name, float) for name in names)],
            )
        messages: list[str] = []
        try:
            found = fmpy.simulate_fmu(
                str(path), fmi_type={"cs": "CoSimulation", "me": "ModelExchange"}[kind], start_time=case.times[0],
                stop_time=case.times[-1], output_interval=case.times[1] - case.times[0], solver="CVode",
                relative_tolerance=CVODE_TOLERANCE, start_values=starts, input=signals, timeout=TIME_LIMIT,
                logger=lambda *arguments: messages.append(str(arguments[-1])),
            )  # fmt: skip
        except Exception as error:  # FMPy raises plain ones
            raise RefusedError(f"FMPy: {error}") from error
        rows = [
            np.flatnonzero(np.abs(found["time"] - t) < 1e-9 * max(1.0, case.times[-1])) for t in case.times
        ]
        if any(len(row) == 0 for row in rows):
            raise RefusedError(f"ended at {found['time'][-1]}")
        last = [row[-1] for row in rows]
        return np.vstack([found[name].reshape(len(found), -1)[last].T for name in outputs])

    return run


_DRIVER = """#include <stdio.h>
#include "corpus.h"
int main(void) {{
  static corpus self;
  pf_real u[{inputs} + 1] = {{0}}, y[{outputs}];
  if (corpus_init(&self) != PF_OK) return 1;
  for (long k = 0; k <= {steps}L; k++) {{
    if (corpus_step(&self, u, y) != PF_OK) return 2;
    if (k % {every} == 0)
      for (int i = 0; i < {outputs}; i++) printf("%.17g\\n", (double)y[i]);
  }}
  return 0;
}}
"""


def _firmware(case: Case, model: Any, folder: Path) -> Array:
    """C as firmware runs it: exported, compiled with its own main, in steps of fixed length."""
    every = -(-FIXED_STEPS // (len(case.times) - 1))
    source = folder / "firmware"
    states = (
        tuple(
            replace(state, start=float(value)) for state, value in zip(model.states, case.start, strict=True)
        )
        if len(case.start)
        else model.states
    )
    step = float(case.times[1] - case.times[0]) / every
    pf.export_c(replace(model, states=states), source, step=step, name="corpus")
    count = len(model.outputs)
    text = _DRIVER.format(
        inputs=len(model.inputs), outputs=count, steps=every * (len(case.times) - 1), every=every
    )
    (source / "main.c").write_text(text, encoding="utf-8")
    command = [
        os.environ.get("CC", "cc"),
        "-O1",
        "-o",
        "run",
        *sorted(p.name for p in source.glob("*.c")),
        "-lm",
    ]
    subprocess.run(command, cwd=source, check=True, capture_output=True)
    done = subprocess.run([str(source / "run")], capture_output=True, text=True, timeout=60, check=False)
    if done.returncode:
        raise RefusedError(
            f"the firmware ended with {done.returncode} after {len(done.stdout.splitlines()) // count} rows"
        )
    return np.array(done.stdout.split(), dtype=float).reshape(-1, count).T


@dataclass(frozen=True)
class Route:
    """A way to an answer."""

    run: Callable[[Case, Any, Path], Array]
    allowed: str = "asked"
    compiles: bool = False


ROUTES: dict[str, Route] = {
    "simulate": Route(_as_called),
    "adaptive-vm": Route(_simulated(method="adaptive", backend="vm")),
    "stiff-vm": Route(_simulated(method="stiff", backend="vm")),
    "rk4-vm": Route(_simulated(method="rk4", backend="vm"), "fixed"),
    "exact": Route(_simulated(method="exact"), "fixed"),
    "batch": Route(_batch),
    "adaptive-c": Route(_simulated(method="adaptive", backend="c"), compiles=True),
    "rk4-c": Route(_simulated(method="rk4", backend="c"), "fixed", compiles=True),
    "export-c": Route(_firmware, "fixed", compiles=True),
    "fmi2-cs": Route(_fmu("2.0", "cs"), compiles=True),
    "fmi3-cs": Route(_fmu("3.0", "cs"), compiles=True),
    "fmi2-me": Route(_fmu("2.0", "me"), "cvode", compiles=True),
    "fmi3-me": Route(_fmu("3.0", "me"), "cvode", compiles=True),
}
SHORT_ROUTES = ("simulate", "adaptive-vm", "stiff-vm", "batch")
QUICK_ROUTES = (
    "simulate",
    "adaptive-vm",
    "stiff-vm",
    "rk4-vm",
    "exact",
    "batch",
    "adaptive-c",
    "rk4-c",
    "export-c",
)
FMU_ROUTES = ("fmi2-cs", "fmi3-cs", "fmi2-me", "fmi3-me")
# RefusedError by design where the diagram is none of theirs; no answer is missing.
OPTIONAL = ("exact", "rk4-vm", "rk4-c", "export-c")


def applies(system: System, route: str) -> bool:
    """Whether the route is run: steps of fixed length and explicit ones cannot do what is stiff; FMUs, which take
    seconds to make, are those of the first system of each structure."""
    if system.stiff and route not in ("simulate", "stiff-vm", "batch", "fmi2-me", "fmi3-me"):
        return False
    if route.startswith("fmi") or route == "export-c":
        uneven = np.ptp(np.diff(system.timepts)) > 1e-9 * system.timepts[-1]
        # FMPy holds inputs over a step, in both kinds.
        varies = system.inputs is not None and np.ptp(system.inputs(system.timepts), axis=1).any()
        # Firmware of a sampled law runs in steps of its period, which the times are no multiples of.
        exported = system.fmu if route != "export-c" else system.family not in ("sampled", "discrete")
        return not uneven and not varies and exported and _first_of(system)
    return True


def _first_of(system: System) -> bool:
    return next((each for each in all_systems() if each.structure == system.structure), system) == system


def judged(case: Case, route: str, model: Any, folder: Path) -> Cell:
    """What a route says of a system."""
    begin = time.perf_counter()
    try:
        with warnings.catch_warnings(), quiet():
            warnings.simplefilter("ignore")
            found = ROUTES[route].run(case, model() if callable(model) else model, folder)
    except Exception as error:
        text = " ".join(str(error).split())
        kind = "" if isinstance(error, RefusedError) else f"{type(error).__name__}: "
        outcome = "status" if isinstance(error, REFUSALS) else "crash"
        return Cell(outcome, message=kind + text, seconds=time.perf_counter() - begin)
    seconds = time.perf_counter() - begin
    if case.expected is None:
        finite = bool(np.all(np.isfinite(found)))
        return Cell("wrong" if finite else "status", message="an answer where none exists", seconds=seconds)
    expected, allowed = case.expected, case.allowed(ROUTES[route].allowed)
    if route == "batch":
        other = expected if not len(case.start) else case.answer(second_start(case))
        expected, allowed = np.vstack([expected, other]), np.vstack([allowed, allowed])
    if found.shape != expected.shape:
        return Cell("wrong", np.inf, f"shape {found.shape} for {expected.shape}", seconds)
    if case.system.residual is not None:
        assert case.inputs is not None
        commands = np.tile(case.inputs[0], (len(found), 1))
        left = [
            [case.system.residual(*each) for each in zip(*rows, strict=True)]
            for rows in zip(found, commands, strict=True)
        ]
        expected = found - np.array(left, dtype=float)
    with np.errstate(invalid="ignore"):
        error = float(np.max(np.abs(found - expected) / allowed))
    if not error <= 1.0:
        row, column = np.unravel_index(np.argmax(np.abs(found - expected) / allowed), found.shape)
        at = case.times[column]
        text = f"y[{row}] at {at:.4g} s is {found[row, column]:.8g} for {expected[row, column]:.8g}"
        return Cell("wrong", error, text, seconds)
    return Cell("right", error, "", seconds)


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """What C prints itself (CVODE, loggers of FMUs) does not belong into the table."""
    sys.stdout.flush()
    saved = os.dup(1), os.dup(2)
    null = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 1), os.dup2(null, 2)
        yield
    finally:
        os.dup2(saved[0], 1), os.dup2(saved[1], 2)
        for each in (*saved, null):
            os.close(each)


def examined(system: System, routes: Iterable[str], rtol: float = RTOL) -> dict[str, Cell]:
    """All cells of a system."""
    case = Case(system, rtol)
    made: list[Any] = []

    def model() -> Any:
        if not made:
            made.append(pf.flatten(system.build()))
        return made[0]

    with tempfile.TemporaryDirectory() as folder:
        return {route: judged(case, route, model, Path(folder)) for route in routes if applies(system, route)}


def shown(cell: Cell | None) -> str:
    if cell is None:
        return "."
    if cell.outcome in ("status", "crash"):
        return cell.outcome.upper() if cell.outcome == "crash" else "status"
    return f"{'' if cell.outcome == 'right' else 'WRONG '}{cell.error:.2g}"


def report(
    table: dict[str, dict[str, Cell]], systems: Sequence[System], routes: Sequence[str]
) -> tuple[str, int]:
    """The table as text, and how many cells are wrong."""
    lines, wrong = [], 0
    width = max(len(each.name) for each in systems) + 2
    lines.append(f"{'system':{width}}" + "".join(f"{route:>13}" for route in routes))
    for each in systems:
        cells = table[each.name]
        lines.append(f"{each.name:{width}}" + "".join(f"{shown(cells.get(route)):>13}" for route in routes))
    structures = {each.structure for each in systems}
    elsewhere = [each for each in systems if each.source]
    lines.append("")
    lines.append(
        f"{len(systems)} systems, {len(structures)} structures, {len(elsewhere)} from elsewhere, "
        f"{sum(not each.solvable for each in systems)} without a solution"
    )
    lines.append(
        f"{'route':14}{'right':>7}{'wrong':>7}{'status':>8}{'status where solvable':>23}{'worst right':>13}"
        f"{'seconds':>9}"
    )
    solvable = {each.name for each in systems if each.solvable}
    for route in routes:
        cells = {name: row[route] for name, row in table.items() if route in row}
        bad = [name for name, cell in cells.items() if cell.outcome in ("wrong", "crash")]
        statuses = [name for name, cell in cells.items() if cell.outcome == "status"]
        missing = [name for name in statuses if name in solvable]
        asked = sum(name in solvable for name in cells)
        right = len(cells) - len(bad) - len(missing)
        worst = max((cell.error for cell in cells.values() if cell.outcome == "right"), default=np.nan)
        wrong += len(bad)
        share = 100.0 * len(missing) / asked if asked else 0.0
        seconds = sum(cell.seconds for cell in cells.values())
        lines.append(
            f"{route:14}{right:7}{len(bad):7}{len(statuses):8}{f'{len(missing)} ({share:.1f} %)':>23}"
            f"{worst:13.2g}{seconds:9.1f}"
        )
    lines.append(f"errors are shares of what is allowed; {wrong} cells wrong or crashed")
    return "\n".join(lines), wrong


def failures(table: dict[str, dict[str, Cell]], systems: Sequence[System]) -> list[str]:
    """Cells that are wrong, and statuses in place of an answer."""
    lines = []
    for each in systems:
        for route, cell in table[each.name].items():
            missing = cell.outcome == "status" and each.solvable and route not in OPTIONAL
            if cell.outcome in ("wrong", "crash") or missing:
                lines.append(
                    f"{each.family:12} {each.name:32} {route:12} {cell.outcome:7} {cell.error:9.3g} "
                    f"{cell.message[:220]}"
                )
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the corpus; 1 if an answer is wrong, or simulate has a status in place of too many."""
    parser = argparse.ArgumentParser(prog="python -m tests.corpus", description=__doc__)
    parser.add_argument("--short", action="store_true", help="a few systems of each family, without compiler")
    parser.add_argument(
        "--family", action="append", choices=sorted(FAMILIES), help="only this one; may repeat"
    )
    parser.add_argument("--system", action="append", help="only this one; may repeat")
    parser.add_argument(
        "--routes", nargs="+", choices=tuple(ROUTES), help="only these; by default all without FMUs"
    )
    parser.add_argument("--fmu", action="store_true", help="FMUs too, run by FMPy")
    parser.add_argument(
        "--random", type=int, default=0, metavar="N", help="N random systems in place of the corpus"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the random ones")
    parser.add_argument("--json", metavar="FILE", help="all cells, to a file")
    parser.add_argument(
        "--failures", metavar="FILE", help="cells that are wrong or without an answer, to a file"
    )
    parser.add_argument("--rtol", type=float, default=RTOL, help="what is asked for; atol is 0.01 of it")
    parser.add_argument("--progress", action="store_true", help="each system as it is done, to stderr")
    options = parser.parse_args(arguments)
    if options.random:
        from tests.corpus.random_systems import random_systems

        systems = random_systems(options.random, options.seed)
    else:
        systems = [
            each for each in all_systems()
            if not (options.family or options.system)
            or each.family in (options.family or ()) or each.name in (options.system or ())
        ]  # fmt: skip
    if options.short:
        systems = [each for each in systems if each.short]
    default = SHORT_ROUTES if options.short else QUICK_ROUTES
    routes = tuple(options.routes) if options.routes else (*default, *(FMU_ROUTES if options.fmu else ()))
    table: dict[str, dict[str, Cell]] = {}
    for each in systems:
        table[each.name] = examined(each, routes, options.rtol)
        if options.progress:
            cells = ", ".join(f"{route} {shown(cell)}" for route, cell in table[each.name].items())
            print(f"{each.name}: {cells}", file=sys.stderr, flush=True)
    if not systems:
        parser.error("no such system")
    text, wrong = report(table, systems, routes)
    solvable = [each for each in systems if each.solvable]
    missing = sum(
        "simulate" in routes and table[each.name]["simulate"].outcome == "status" for each in solvable
    )
    print(text)
    lines = failures(table, systems)
    print("\n".join(lines))
    if options.failures:
        Path(options.failures).write_text("\n".join([text, "", *lines, ""]), encoding="utf-8")
    if options.json:
        cells = {name: {route: asdict(cell) for route, cell in row.items()} for name, row in table.items()}
        Path(options.json).write_text(json.dumps(cells, indent=1), encoding="utf-8")
    return int(wrong > 0 or missing > MOST_STATUSES * len(solvable))
