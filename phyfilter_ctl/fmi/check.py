"""Does an FMU keep what its description promises? It is validated, run, and held against recorded results."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from fmpy.model_description import ValidationError, read_model_description
from fmpy.validation import validate_model_description

from .._renamed import takes_former
from .archive import extracted, parse_xml
from .check_probes import dependencies, derivatives, round_trip
from .check_report import Checker, CheckReport, Rule
from .documents import schema_problems
from .fmu import Fmu
from .inspect import FmuDescription, Kind, describe, refuse_unknown
from .instance import FmuInstance
from .messages import complaints
from .names import is_structured
from .platforms import native_platform
from .replay import Reference, replayed
from .signals import Signals
from .structure import resized, structure_among
from .unpacked import UnpackedFmu

__all__ = ["check"]

_RUN_STEPS = 100
_WORDS: dict[Kind, str] = {"me": "model exchange", "cs": "co-simulation"}
_FLOATS = ("Float64", "Float32")
# What FMPy says, and the paragraph that it is about.
_SUBJECTS: dict[str, Rule] = {
    " unit ": "units",
    "Unknown": "structure",
    "ModelStructure": "structure",
    "dependencies": "structure",
}


@takes_former
def check(
    fmu: str | Path | Fmu,
    *,
    reference: str | Path | None = None,
    inputs_at: Literal["start", "end"] = "start",
    rtol: float = 1e-4,
    atol: float = 1e-6,
    run: bool = True,
) -> CheckReport:
    """Check an FMU. **With** ``run`` **its code is run**, in a process of its own unless ``Fmu.isolated`` is False.

    Validated are: the archive; the description against its schema, names, units, start values and the completeness of
    its structure; then, for each kind it offers, that it starts and runs, that the state can be taken and put back bit
    for bit, that its outputs depend on what they are said to depend on and on nothing else, and that its directional
    derivatives are those of its outputs and state derivatives.

    Parameters
    ----------
    fmu : str, Path or Fmu
        The file, or the file with the parameters, clocks and tolerance that it is run with. ``isolated=False`` runs
        foreign code in the caller's process, with all that it may do there; else a crash is a finding too. SECURITY.md
        says what a process of its own fences.
    reference : str or Path, optional
        Recorded outputs ``NAME_out.csv`` (first column time), replayed as co-simulation on ``NAME_in.csv`` beside it.
    inputs_at : {"start", "end"}
        Whether the inputs of a communication step in the replay are those at its start or at its end.
    rtol, atol : float
        Allowed deviation from the reference: ``atol + rtol * |value|``.
    run : bool
        Whether to load and run the FMU.

    Returns
    -------
    CheckReport
        A broken FMU is a finding, never an exception.

    Raises
    ------
    ValueError
        If the reference itself cannot be read, or a parameter is none that the FMU lets be set.
    """
    if inputs_at not in ("start", "end"):
        raise ValueError(f'inputs_at: expected "start" or "end", got {inputs_at!r}')
    recorded = None if reference is None else Reference.read(reference)
    chosen = Fmu.of(fmu)
    checker = Checker(Path(chosen.path), chosen.limits)
    description = None
    with checker.stage("archive and schema", "schema"):
        description = describe(chosen.path, limits=chosen.limits)
    if description is None:
        return checker.report()
    checker.fmi = description.fmi
    structure = structure_among(description, chosen.parameters)
    refuse_unknown(
        resized(description, structure, limits=chosen.limits) if structure else description, chosen.parameters
    )
    _static(checker, description)
    if not run:
        return checker.report()
    with checker.stage("binary"):
        if native_platform() not in description.platforms:
            has = ", ".join(description.platforms) or "none"
            checker.hint(f"not run: no binary for {native_platform()}; it has binaries for {has}")
            return checker.report()
    with checker.stage("unpack"):
        unpacked = UnpackedFmu(chosen, isolated=True)
        started = partial(_started, unpacked, chosen)
        try:
            for kind in description.kinds:
                if kind != "se":
                    _dynamic(checker, unpacked.description, kind, started)
            if recorded is not None:
                _replayed(checker, unpacked, chosen, recorded, inputs_at, (rtol, atol))
        finally:
            unpacked.close()
    return checker.report()


def _static(checker: Checker, description: FmuDescription) -> None:
    with checker.stage("structure and names"), extracted(checker.path, checker.limits) as folder:
        problems = _problems(folder)
        for problem in problems:
            checker.error(problem, _rule(problem))
        for line, name in _odd_names(folder):
            checker.error(
                f"the name {name!r} (line {line}) breaks the structured convention, which this FMU claims",
                "names",
            )
        if set(description.kinds) == {"se"}:
            checker.hint("for scheduled execution only: not run")
        elif not description.kinds:
            checker.error("is for neither model exchange nor co-simulation", "schema")
    with checker.stage("units", "units"):
        for entry in description.variables:
            if not entry.unit or entry.unit in description.units:
                continue
            if any(f'The unit "{entry.unit}" of variable "{entry.name}"' in problem for problem in problems):
                checker.error(f"{entry.name}: unit {entry.unit!r} is not defined by base units")
            else:  # which FMI leaves open
                checker.hint(
                    f"{entry.name}: unit {entry.unit!r} has no base units, so it cannot be converted"
                )
        bare = [
            entry.name
            for entry in description.variables
            if entry.causality in ("input", "output") and entry.type in _FLOATS and not entry.unit
        ]
        if bare:
            checker.hint(f"no unit: {', '.join(bare)}")
    with checker.stage("start values", "variables"):
        labels = {label for entry in description.variables if entry.start for label in entry.labels}
        for label in description.state_labels:
            if label not in labels:
                checker.hint(
                    f"state {label} has no start value: it cannot be set or read before initialisation"
                )
        for entry in description.variables:
            if entry.start and len(entry.starts) != len(entry.labels):
                checker.error(
                    f"{entry.name}: {len(entry.start)} start values for {len(entry.labels)} elements"
                )
            elif entry.type in _FLOATS and not all(math.isfinite(float(value)) for value in entry.start):
                checker.error(f"{entry.name}: start value is not finite")


def _problems(folder: Path) -> list[str]:
    """What FMPy finds wrong with the description of an unpacked FMU, beyond its schema."""
    problems: list[str] = []
    build = folder / "sources" / "buildDescription.xml"
    try:
        model = read_model_description(str(folder), validate=False)
        if build.is_file() and model.fmiVersion != "2.0":
            root = parse_xml(build.read_bytes(), build.name)
            problems += [f"{build.name}, {text}" for text in schema_problems(root, "fmi3BuildDescription")]
        return problems + validate_model_description(model, validate_model_structure=True)
    except ValidationError as error:
        return problems + error.problems
    except Exception as error:  # what it stumbles over
        return [*problems, str(error)]


def _odd_names(folder: Path) -> list[tuple[int, str]]:
    """Lines and names against the convention; FMPy's own search takes minutes for a thousand names."""
    document = folder / "modelDescription.xml"
    root = parse_xml(document.read_bytes(), document.name)
    if root.get("variableNamingConvention") != "structured":
        return []
    found = root.iterfind("ModelVariables/*[@name]")
    return [(e.sourceline or 0, name) for e in found if not is_structured(name := e.get("name", ""))]


def _dynamic(
    checker: Checker,
    description: FmuDescription,
    kind: Kind,
    started: Callable[[Kind], AbstractContextManager[FmuInstance]],
) -> None:
    word = _WORDS[kind]
    checker.needs_tool, checker.unavailable = description.kinds[kind].needs_tool, False
    with checker.stage(f"{word}: run", "step" if kind == "cs" else None), started(kind) as instance:
        outputs = instance.signals("output")
        _finite(checker, outputs, instance, "after initialisation")
        if kind == "cs":
            h = _step(description)
            count = _steps(description, h)
            for k in range(count):
                instance.do_step(_start(description) + k * h, h)
            _finite(checker, outputs, instance, f"after {count} steps of {h:g} s")
        elif description.states:
            rate = instance.derivatives(_start(description), instance.states())
            if not np.all(np.isfinite(rate)):
                checker.error(f"state derivatives are not finite at the start: {rate.tolist()}")
        for message in complaints(instance.messages):
            checker.warning(f"the FMU says: {message}")
    if checker.unavailable:
        return
    if description.kinds[kind].state and kind == "cs":
        with checker.stage(f"{word}: state", "state"), started(kind) as instance:
            round_trip(checker, instance, _start(description), _step(description))
    with (
        checker.stage(f"{word}: dependencies", "dependencies", probing=True),
        started(kind) as instance,
    ):
        dependencies(checker, instance)
    if description.kinds[kind].directional_derivatives and kind == "me":
        with (
            checker.stage(f"{word}: derivatives", "derivatives", probing=True),
            started(kind) as instance,
        ):
            derivatives(checker, instance, _start(description))


@contextmanager
def _started(fmu: UnpackedFmu, chosen: Fmu, kind: Kind) -> Iterator[FmuInstance]:
    instance = FmuInstance(fmu, kind, "check", chosen.clocks)
    tolerance = fmu.description.tolerance if chosen.tolerance is None else chosen.tolerance
    try:
        instance.initialise(_start(fmu.description), tolerance=tolerance, values=fmu.values)
        instance.begin()
        yield instance
    finally:
        instance.close()


def _start(description: FmuDescription) -> float:
    return description.start_time or 0.0


def _step(description: FmuDescription) -> float:
    span = (description.stop_time or 1.0) - _start(description)
    return description.communication_step or span / _RUN_STEPS


def _steps(description: FmuDescription, h: float) -> int:
    """As many as fit into the default experiment, up to a limit: beyond it an FMU need not run."""
    if description.stop_time is None:
        return _RUN_STEPS
    return max(1, min(_RUN_STEPS, int((description.stop_time - _start(description)) / h + 1e-6)))


def _rule(problem: str) -> Rule:
    """What a problem that FMPy names is about."""
    for word, rule in _SUBJECTS.items():
        if word in problem:
            return rule
    return "variables"


def _finite(checker: Checker, outputs: Signals, instance: FmuInstance, when: str) -> None:
    values = outputs.read(instance)
    wrong = [label for label, value in zip(outputs.labels, values, strict=True) if not np.isfinite(value)]
    if wrong:
        checker.error(f"not finite {when}: {', '.join(wrong)}")


def _replayed(
    checker: Checker,
    fmu: UnpackedFmu,
    chosen: Fmu,
    reference: Reference,
    inputs_at: Literal["start", "end"],
    tolerance: tuple[float, float],
) -> None:
    with checker.stage("replay"):
        labels, found = replayed(fmu, reference, inputs_at, clocks=chosen.clocks, tolerance=chosen.tolerance)
        rtol, atol = tolerance
        expected = np.column_stack([reference.outputs[label] for label in labels])
        error = np.abs(found - expected)
        over = np.where(np.isnan(error), np.inf, error) / (atol + rtol * np.abs(expected))
        checker.figures["largest deviation from the reference"] = float(np.max(error, initial=0.0))
        for j, label in enumerate(labels):
            k = int(np.argmax(over[:, j]))
            if over[k, j] > 1.0:
                checker.error(
                    f"{label}: {found[k, j]:.9g} at t = {reference.times[k]:g}, recorded {expected[k, j]:.9g}; allowed "
                    f"deviation {atol + rtol * abs(expected[k, j]):.3g}"
                )
