"""Does an FMU keep what its description promises? It is validated, run, and held against recorded results."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from fmpy.validation import validate_fmu

from .._sections import FloatArray
from .archive import ArchiveLimits, extracted
from .foreign import Isolation
from .inspect import FmuDescription, Kind, describe
from .instance import FmuError, FmuInstance
from .messages import complaints
from .platforms import native_platform
from .replay import Reference, read_reference, replay
from .signals import Signals
from .unpacked import UnpackedFmu

__all__ = ["CheckReport", "Finding", "check"]

_RUN_STEPS = 100
_PROBES = 4
_WORDS: dict[Kind, str] = {"me": "model exchange", "cs": "co-simulation"}
# Central differences with a step of 1e-5 of a value of order one: truncation about 1e-10, rounding about 1e-11.
_DIFFERENCE, _DERIVATIVES_AGREE = 1e-5, 1e-6
_FLOATS = ("Float64", "Float32")


@dataclass(frozen=True)
class Finding:
    """Something that a check came upon.

    Parameters
    ----------
    level : {"error", "note"}
        Errors break a promise or a rule of FMI; notes are worth knowing.
    stage : str
    message : str
    """

    level: Literal["error", "note"]
    stage: str
    message: str


@dataclass(frozen=True)
class CheckReport:
    """Result of :func:`check`.

    Parameters
    ----------
    path : str
    stages : tuple of str
        Checks that were made, in order.
    findings : tuple of Finding
    figures : dict of str to float
        What was measured, such as the largest deviation from the reference.
    """

    path: str
    stages: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    figures: dict[str, float] = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        """Whether no error was found."""
        return not self.errors

    @property
    def errors(self) -> tuple[Finding, ...]:
        """Findings that are errors."""
        return tuple(entry for entry in self.findings if entry.level == "error")

    def as_json(self) -> str:
        """All of it as JSON."""
        # JSON has no infinity: a run that diverged says so in words.
        figures = {key: value if math.isfinite(value) else str(value) for key, value in self.figures.items()}
        return json.dumps(dataclasses.asdict(self) | {"ok": self.ok, "figures": figures}, indent=2)

    def __str__(self) -> str:
        verdict = "ok" if self.ok else f"{len(self.errors)} error{'s' * (len(self.errors) > 1)}"
        lines = [f"{self.path}: {verdict}"]
        for stage in self.stages:
            found = [entry for entry in self.findings if entry.stage == stage]
            state = "failed" if any(entry.level == "error" for entry in found) else "ok"
            lines.append(f"  {stage:<22} {state}")
            lines += [f"    {entry.level}: {entry.message}" for entry in found]
        lines += [f"  {key}: {value:.3g}" for key, value in self.figures.items()]
        return "\n".join(lines)


class _Checker:
    def __init__(self, path: Path, limits: ArchiveLimits | None) -> None:
        self.path, self.limits = path, limits
        self.stages: list[str] = []
        self.findings: list[Finding] = []
        self.figures: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """A stage that fails ends, and the others go on."""
        self.stages.append(name)
        try:
            yield
        except (ValueError, OSError, FmuError) as error:
            self.error(str(error))

    def error(self, message: str) -> None:
        self.findings.append(Finding("error", self.stages[-1], message))

    def note(self, message: str) -> None:
        self.findings.append(Finding("note", self.stages[-1], message))

    def report(self) -> CheckReport:
        return CheckReport(str(self.path), tuple(self.stages), tuple(self.findings), self.figures)


def check(
    path: str | Path,
    *,
    reference: str | Path | None = None,
    inputs_at: Literal["start", "end"] = "start",
    rtol: float = 1e-4,
    atol: float = 1e-6,
    run: bool = True,
    limits: ArchiveLimits | None = None,
    isolated: bool | Isolation = False,
) -> CheckReport:
    """Check an FMU. **With** ``run`` **its code is run**, in this process or with ``isolated`` in one of its own.

    Validated are: the archive; the description against its schema, names, units, start values and the completeness of
    its structure; then, for each kind it offers, that it starts and runs, that the state can be taken and put back bit
    for bit, that its outputs depend on what they are said to depend on and on nothing else, and that its directional
    derivatives are those of its outputs and state derivatives.

    Parameters
    ----------
    path : str or Path
    reference : str or Path, optional
        Recorded outputs ``NAME_out.csv`` (first column time), replayed as co-simulation on ``NAME_in.csv`` beside it.
    inputs_at : {"start", "end"}
        Whether the inputs of a communication step in the replay are those at its start or at its end.
    rtol, atol : float
        Allowed deviation from the reference: ``atol + rtol * |value|``.
    run : bool
        Whether to load and run the FMU.
    limits : ArchiveLimits, optional
        What the archive may hold at most.
    isolated : bool or Isolation
        Whether the FMU runs in a process of its own, and within which limits of time; then a crash is a finding too.

    Returns
    -------
    CheckReport
        A broken FMU is a finding, never an exception.

    Raises
    ------
    ValueError
        If the reference itself cannot be read.
    """
    if inputs_at not in ("start", "end"):
        raise ValueError(f'inputs_at: expected "start" or "end", got {inputs_at!r}')
    recorded = None if reference is None else read_reference(reference)
    checker = _Checker(Path(path), limits)
    description = None
    with checker.stage("archive and schema"):
        description = describe(path, limits=limits)
    if description is None:
        return checker.report()
    _static(checker, description)
    if not run:
        return checker.report()
    with checker.stage("binary"):
        if native_platform() not in description.platforms:
            has = ", ".join(description.platforms) or "none"
            checker.note(f"not run: no binary for {native_platform()}; it has binaries for {has}")
            return checker.report()
    with checker.stage("unpack"):
        fmu = UnpackedFmu(path, limits=limits, isolated=isolated)
        try:
            for kind in description.kinds:
                _dynamic(checker, fmu, kind)
            if recorded is not None:
                _replayed(checker, fmu, recorded, inputs_at, (rtol, atol))
        finally:
            fmu.close()
    return checker.report()


def _static(checker: _Checker, description: FmuDescription) -> None:
    with checker.stage("structure and names"), extracted(checker.path, checker.limits) as folder:
        for problem in validate_fmu(str(folder)):
            checker.error(problem)
        if not description.kinds:
            checker.error("is for neither model exchange nor co-simulation")
    with checker.stage("units"):
        for entry in description.variables:
            if entry.unit and entry.unit not in description.units:
                checker.error(f"{entry.name}: unit {entry.unit!r} is not defined by base units")
        bare = [
            entry.name
            for entry in description.variables
            if entry.causality in ("input", "output") and entry.type in _FLOATS and not entry.unit
        ]
        if bare:
            checker.note(f"no unit: {', '.join(bare)}")
    with checker.stage("start values"):
        labels = {label for entry in description.variables if entry.start for label in entry.labels}
        for label in description.state_labels:
            if label not in labels:
                checker.note(
                    f"state {label} has no start value: it cannot be set or read before initialisation"
                )
        for entry in description.variables:
            if entry.start and len(entry.starts) != len(entry.labels):
                checker.error(
                    f"{entry.name}: {len(entry.start)} start values for {len(entry.labels)} elements"
                )
            elif entry.type in _FLOATS and not all(math.isfinite(float(value)) for value in entry.start):
                checker.error(f"{entry.name}: start value is not finite")


def _dynamic(checker: _Checker, fmu: UnpackedFmu, kind: Kind) -> None:
    description = fmu.description
    word = _WORDS[kind]
    with checker.stage(f"{word}: run"), _started(fmu, kind) as instance:
        outputs = instance.signals("output")
        _finite(checker, outputs, instance, "after initialisation")
        if kind == "cs":
            h = _step(description)
            for k in range(_RUN_STEPS):
                instance.do_step(_start(description) + k * h, h)
            _finite(checker, outputs, instance, f"after {_RUN_STEPS} steps of {h:g} s")
        elif description.states:
            rate = instance.derivatives(_start(description), instance.states())
            if not np.all(np.isfinite(rate)):
                checker.error(f"state derivatives are not finite at the start: {rate.tolist()}")
        for message in complaints(instance.messages):
            checker.note(f"the FMU says: {message}")
    if fmu.description.kinds[kind].state and kind == "cs":
        with checker.stage(f"{word}: state"), _started(fmu, kind) as instance:
            _round_trip(checker, instance)
    with checker.stage(f"{word}: dependencies"), _started(fmu, kind) as instance:
        _dependencies(checker, instance)
    if fmu.description.kinds[kind].directional_derivatives and kind == "me":
        with checker.stage(f"{word}: derivatives"), _started(fmu, kind) as instance:
            _derivatives(checker, instance)


@contextmanager
def _started(fmu: UnpackedFmu, kind: Kind) -> Iterator[FmuInstance]:
    instance = FmuInstance(fmu, kind, "check")
    try:
        instance.initialise(_start(fmu.description))
        instance.begin()
        yield instance
    finally:
        instance.close()


def _start(description: FmuDescription) -> float:
    return description.start_time or 0.0


def _step(description: FmuDescription) -> float:
    span = (description.stop_time or 1.0) - _start(description)
    return description.communication_step or span / _RUN_STEPS


def _finite(checker: _Checker, outputs: Signals, instance: FmuInstance, when: str) -> None:
    values = outputs.read(instance)
    wrong = [label for label, value in zip(outputs.labels, values, strict=True) if not np.isfinite(value)]
    if wrong:
        checker.error(f"not finite {when}: {', '.join(wrong)}")


def _round_trip(checker: _Checker, instance: FmuInstance) -> None:
    outputs, inputs = instance.signals("output"), instance.signals("input")
    h, t0 = _step(instance.description), _start(instance.description)
    rng = np.random.default_rng(0)
    drive = 0.1 * rng.standard_normal((20, len(inputs)))

    def run(first: int, last: int) -> FloatArray:
        rows = []
        for k in range(first, last):
            inputs.write(instance, drive[k])
            instance.do_step(t0 + k * h, h, final=False)
            rows.append(outputs.read(instance))
        return np.array(rows)

    run(0, 10)
    state = instance.save()
    before = run(10, 20)
    instance.restore(state)
    after = run(10, 20)
    instance.forget(state)
    if not np.array_equal(before, after, equal_nan=True):
        worst = outputs.labels[int(np.argmax(np.max(np.abs(before - after), axis=0)))]
        checker.error(
            f"after the state was put back the rest of the run differs by {np.max(np.abs(before - after)):.3g} (in "
            f"{worst}); expected the same bits"
        )


def _dependencies(checker: _Checker, instance: FmuInstance) -> None:
    """Move one input at a time and see which outputs move, against what the model structure says."""
    description = instance.description
    entries = [entry for entry in description.of("input") if entry.type in _FLOATS]
    inputs, outputs = Signals(entries, description.fmi), instance.signals("output")
    owners = [entry.name for entry in entries for _ in entry.labels]
    results = [entry.name for entry in description.of("output") for _ in entry.labels]
    start = inputs.read(instance)
    rng = np.random.default_rng(0)
    seen: set[tuple[str, str]] = set()
    for _ in range(_PROBES):
        base = start + rng.standard_normal(len(start))
        inputs.write(instance, base)
        before = outputs.read(instance)
        for j, owner in enumerate(owners):
            inputs.write(instance, base + np.eye(len(base))[j])
            moved = outputs.read(instance) != before
            seen |= {(result, owner) for result, m in zip(results, moved, strict=True) if m}
        inputs.write(instance, base)
    for result in dict.fromkeys(results):
        known = description.dependencies.get(result)
        for owner in dict.fromkeys(owners):
            if known is not None and (result, owner) in seen and owner not in known:
                checker.error(f"{result} depends on {owner}, which its dependencies leave out")
            elif known is not None and owner in known and (result, owner) not in seen:
                checker.note(f"{result} is said to depend on {owner}; it did not move with it at once")


def _derivatives(checker: _Checker, instance: FmuInstance) -> None:
    """Directional derivatives along a random direction against central differences."""
    description = instance.description
    by_name = {entry.name: entry for entry in description.variables}
    rates = [by_name[name] for name in description.dependencies if by_name[name].derivative_of]
    states = [by_name[entry.derivative_of] for entry in rates]
    inputs = [entry for entry in description.of("input") if entry.type == "Float64"]
    unknowns = Signals(
        [*rates, *(e for e in description.of("output") if e.type == "Float64")], description.fmi
    )
    input_signals = Signals(inputs, description.fmi)
    n, t = description.states, _start(description)
    rng = np.random.default_rng(1)
    x, u = instance.states(), input_signals.read(instance)
    x = x + 0.1 * rng.standard_normal(n)
    u = u + 0.1 * rng.standard_normal(len(u))
    seed = rng.standard_normal(n + len(u))

    def at(scale: float) -> FloatArray:
        instance.set_point(t, x + scale * seed[:n])
        input_signals.write(instance, u + scale * seed[n:])
        return unknowns.read(instance)

    difference = (at(_DIFFERENCE) - at(-_DIFFERENCE)) / (2 * _DIFFERENCE)
    at(0.0)
    found = instance.directional(
        [*unknowns.references], [e.reference for e in [*states, *inputs]], seed, len(unknowns)
    )
    scale = 1.0 + np.abs(difference)
    worst = int(np.argmax(np.abs(found - difference) / scale)) if len(scale) else 0
    if len(scale) and np.abs(found - difference)[worst] > _DERIVATIVES_AGREE * scale[worst]:
        checker.error(
            f"directional derivative of {unknowns.labels[worst]}: {found[worst]:.6g}; differences give "
            f"{difference[worst]:.6g}"
        )


def _replayed(
    checker: _Checker,
    fmu: UnpackedFmu,
    reference: Reference,
    inputs_at: Literal["start", "end"],
    tolerance: tuple[float, float],
) -> None:
    with checker.stage("replay"):
        labels, found = replay(fmu, reference, inputs_at=inputs_at)
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
