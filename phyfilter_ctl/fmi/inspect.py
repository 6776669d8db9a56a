"""What an FMU says of itself, read without loading its code."""

from __future__ import annotations

import dataclasses
import json
import math
import re
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Literal

import lxml.etree as etree
import numpy as np
from fmpy.model_description import ModelDescription, ModelVariable
from numpy.typing import NDArray

from .._intake import check_count, limited
from ..results import plain
from .abilities import FmuKind, read_kind
from .archive import ArchiveLimits, parse_xml, read_entries, refuse_sizes
from .clock_schedule import FmuClock, read_clocks
from .documents import complete_initial, fmi_version, read_description, validate_description
from .platforms import platforms_among
from .units import FmuUnit

__all__ = ["FmuDescription", "FmuKind", "FmuVariable", "describe", "refuse_unknown"]

_BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
Scalar = float | int | bool | str | bytes
Kind = Literal["me", "cs", "se"]
_KINDS: dict[Kind, str] = {"me": "ModelExchange", "cs": "CoSimulation", "se": "ScheduledExecution"}


@dataclass(frozen=True)
class FmuVariable:
    """A variable of an FMU; an array is one variable.

    Parameters
    ----------
    name, type, causality, variability, initial, unit, display_unit, description : str
        As in the model description; type is "Float64" for FMI 2.0's "Real". "" where there is none.
    reference : int
        Value reference.
    shape : tuple of int
        () for a scalar.
    start : tuple
        Start values, flat; one value may stand for a whole array; empty where there is none. Of Binary: bytes.
    minimum, maximum, nominal : float or None
    derivative_of : str
        Name of the state that this is the derivative of, or "".
    items : tuple of int
        Values that an enumeration may take; empty where they are not given.
    dimensions : tuple of str
        By axis the structural parameter that is its length; "" where the length is fixed.
    clocks : tuple of str
        Names of the clocks that it belongs to; empty where it is of no clock.
    """

    name: str
    reference: int
    type: str
    causality: str
    variability: str
    initial: str = ""
    unit: str = ""
    display_unit: str = ""
    shape: tuple[int, ...] = ()
    start: tuple[Scalar, ...] = ()
    minimum: float | None = None
    maximum: float | None = None
    nominal: float | None = None
    derivative_of: str = ""
    description: str = ""
    items: tuple[int, ...] = ()
    dimensions: tuple[str, ...] = ()
    clocks: tuple[str, ...] = ()

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of its scalars in C order: ``x`` itself, or ``x[0]``, ``x[1]``, or ``x[0,0]``, ...

        Examples
        --------
        >>> FmuVariable("x", 1, "Float64", "input", "continuous", shape=(2,)).labels
        ('x[0]', 'x[1]')
        """
        if not self.shape:
            return (self.name,)
        indices = product(*(range(size) for size in self.shape))
        return tuple(f"{self.name}[{','.join(map(str, index))}]" for index in indices)

    @property
    def starts(self) -> tuple[Scalar, ...]:
        """One start value per label; empty where there is none.

        Examples
        --------
        >>> FmuVariable("x", 1, "Float64", "input", "continuous", shape=(2,), start=(0.5,)).starts
        (0.5, 0.5)
        """
        count = len(self.labels)
        return self.start * count if len(self.start) == 1 else self.start


@dataclass(frozen=True)
class FmuDescription:
    """What an FMU says of itself; made by :func:`describe`.

    Parameters
    ----------
    path, name, fmi, description, tool, generated, token : str
        File, model name, FMI version, one line, generating tool, date, GUID or instantiation token.
    kinds : dict of str to FmuKind
        "me", "cs" and "se" (scheduled execution), as far as it has them.
    platforms : tuple of str
        With a binary, as ``x86_64-linux``.
    sources : bool
        Whether C sources are inside.
    variables : tuple of FmuVariable
    clocks : tuple of FmuClock
        When its clocks tick; they are among the variables too.
    units : dict of str to FmuUnit
    states, event_indicators : int
        Number of continuous states and of event indicators.
    indicators : tuple of str
        FMI 3: the variables that are event indicators.
    dependencies : dict of str to tuple of str or None
        For each output and state derivative: the variables it is said to depend on; None where nothing is said.
    start_time, stop_time, step, tolerance : float or None
        Default experiment.
    entries, size : int
        Files in the archive, bytes unpacked.
    """

    path: str
    name: str
    fmi: str
    kinds: Mapping[Kind, FmuKind]
    platforms: tuple[str, ...]
    sources: bool
    variables: tuple[FmuVariable, ...]
    clocks: tuple[FmuClock, ...] = ()
    units: Mapping[str, FmuUnit] = field(default_factory=dict)
    states: int = 0
    event_indicators: int = 0
    indicators: tuple[str, ...] = ()
    dependencies: Mapping[str, tuple[str, ...] | None] = field(default_factory=dict)
    start_time: float | None = None
    stop_time: float | None = None
    step: float | None = None
    tolerance: float | None = None
    description: str = ""
    tool: str = ""
    generated: str = ""
    token: str = ""
    entries: int = 0
    size: int = 0

    def of(self, causality: str) -> tuple[FmuVariable, ...]:
        """Variables of one causality.

        Parameters
        ----------
        causality : str
            "input", "output", "parameter", "local", ...
        """
        return tuple(variable for variable in self.variables if variable.causality == causality)

    def feedthrough(self, inputs: Sequence[str], outputs: Sequence[str]) -> NDArray[np.bool_]:
        """Which input acts on which output, by the model structure; where nothing is said FMI means every input.

        Parameters
        ----------
        inputs, outputs : sequence of str
            Labels.

        Returns
        -------
        (outputs, inputs) bool array
        """
        owner = {label: entry.name for entry in self.variables for label in entry.labels}
        found = np.ones((len(outputs), len(inputs)), dtype=bool)
        for i, output in enumerate(outputs):
            known = self.dependencies.get(owner[output])
            if known is not None:
                found[i] = [owner[label] in known for label in inputs]
        return found

    @property
    def state_labels(self) -> tuple[str, ...]:
        """Names of the continuous states, in the order of the derivatives in the model structure."""
        by_name = {variable.name: variable for variable in self.variables}
        derivatives = (by_name[name] for name in self.dependencies if by_name[name].derivative_of)
        return tuple(label for entry in derivatives for label in by_name[entry.derivative_of].labels)

    @property
    def communication_step(self) -> float | None:
        """Seconds that suit its co-simulation: the default experiment's, in multiples of a fixed internal step; else
        the shortest interval of a clock."""
        kind = self.kinds.get("cs")
        intervals = [clock.interval for clock in self.clocks if clock.interval]
        fixed = kind.fixed_step if kind else None
        if not fixed:
            return self.step or min(intervals, default=None)
        return fixed * max(1, round((self.step or fixed) / fixed))

    def as_json(self) -> str:
        """All of it as JSON."""
        figures = json.loads(json.dumps(dataclasses.asdict(self), default=bytes.hex))
        return json.dumps(plain(figures, infinite=True), indent=2, ensure_ascii=False, allow_nan=False)

    def __str__(self) -> str:
        kinds = ", ".join(f"{name} ({kind})" for name, kind in self.kinds.items())
        facts = {
            "file": f"{self.path}, {self.entries} entries, {self.size} bytes unpacked",
            "FMI": f"{self.fmi}, {kinds}",
            "platforms": ", ".join(self.platforms) or "none",
            "sources": "yes" if self.sources else "no",
            "made by": " ".join(part for part in (self.tool, self.generated) if part) or "not said",
            "states": f"{self.states}, {self.event_indicators} event indicators",
            "experiment": _experiment(self),
        }
        head = f"{self.name}: {self.description}" if self.description else self.name
        lines = [head, *(f"  {key:<11} {text}" for key, text in facts.items())]
        for causality in (
            "input",
            "output",
            "parameter",
            "structuralParameter",
            "calculatedParameter",
            "local",
        ):
            entries = self.of(causality)
            if entries:
                lines.append(f"  {causality}")
                lines += [f"    {_variable_line(entry)}" for entry in entries]
        return "\n".join(lines)


def refuse_unknown(description: FmuDescription, parameters: Mapping[str, Scalar]) -> None:
    """Raise where a value is for nothing that an FMU lets be set.

    Parameters
    ----------
    description : FmuDescription
    parameters : dict

    Raises
    ------
    ValueError
    """
    settable = {
        label
        for entry in description.variables
        if entry.start or entry.causality == "input"
        for label in (entry.name, *entry.labels)
    }
    unknown = [key for key in parameters if key not in settable]
    if unknown:
        raise ValueError(
            f"{description.path}: no variable with a start value is called {', '.join(unknown)}; "
            f"there are {', '.join(sorted(settable))}"
        )


def describe(path: str | Path, *, limits: ArchiveLimits | None = None) -> FmuDescription:
    """Read an FMU's description. Nothing of the FMU is run.

    Parameters
    ----------
    path : str or Path
    limits : ArchiveLimits, optional
        What the archive may hold at most.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the archive is damaged or hostile, is no FMU, has another FMI version than 2.0 or 3.0, or a description
        that its schema does not allow (with the lines concerned).
    """
    path = Path(path)
    entries, documents = read_entries(path, ["modelDescription.xml", "sources/buildDescription.xml"], limits)
    if "modelDescription.xml" not in documents:
        raise ValueError(f"{path}: no modelDescription.xml inside: not an FMU")
    roots = {name: parse_xml(data, f"{path}: {name}", limits) for name, data in documents.items()}
    root = roots["modelDescription.xml"]
    validate_description(path, root)
    if complete_initial(root):
        documents["modelDescription.xml"] = etree.tostring(root)
    with tempfile.TemporaryDirectory(prefix="phyfilter-") as folder:
        for name, data in documents.items():
            target = Path(folder, *name.split("/"))
            target.parent.mkdir(exist_ok=True)
            target.write_bytes(data)
        model = read_description(Path(folder), str(path))
    refuse_sizes(path, [(entry.name or "", entry.shape or ()) for entry in model.modelVariables], limits)
    try:
        with limited("modelDescription.xml"):
            found = _described(path, root, model, entries)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    _refuse_numbers(found, limits or ArchiveLimits())
    return found


def _refuse_numbers(found: FmuDescription, limits: ArchiveLimits) -> None:
    """Times that no run can have, and counts that no memory holds."""
    for key, value in (("startTime", found.start_time), ("stopTime", found.stop_time)):
        if value is not None and not math.isfinite(value):
            raise ValueError(
                f"{found.path}: DefaultExperiment: {key}: expected finite seconds, got {value:g}"
            )
    if found.step is not None and not 0.0 < found.step < math.inf:
        raise ValueError(
            f"{found.path}: DefaultExperiment: stepSize: expected seconds > 0, got {found.step:g}"
        )
    step = found.communication_step
    if step and found.stop_time is not None and found.stop_time - (found.start_time or 0.0) > 2.0**53 * step:
        raise ValueError(
            f"{found.path}: DefaultExperiment: more than 2^53 steps of {step:g} s up to {found.stop_time:g} s; refused"
        )
    check_count(found.event_indicators, limits.scalars, f"event indicators in {found.path}")


def _described(
    path: Path, root: etree._Element, model: ModelDescription, entries: tuple[zipfile.ZipInfo, ...]
) -> FmuDescription:
    names = [entry.filename for entry in entries]
    elements = {element.get("name"): element for element in root.iterfind("ModelVariables/*")}
    variables = tuple(
        _variable(entry, elements[(entry.alias or entry).name])
        for entry in model.modelVariables
        if entry.type is not None
    )
    kinds: dict[Kind, FmuKind] = {}
    for kind, tag in _KINDS.items():
        if (element := root.find(tag)) is not None:
            kinds[kind] = read_kind(element)
    experiment = model.defaultExperiment
    return FmuDescription(
        path=str(path),
        name=model.modelName or path.stem,
        fmi=fmi_version(path, root),
        kinds=kinds,
        platforms=platforms_among(names),
        sources=any(re.fullmatch(r"sources/.+\.(c|cc|cpp)", name) for name in names),
        variables=_with_derivatives(model, variables),
        clocks=read_clocks(root),
        units={unit.name: _unit(unit) for unit in model.unitDefinitions if unit.name and unit.baseUnit},
        states=model.numberOfContinuousStates,
        event_indicators=model.numberOfEventIndicators,
        indicators=tuple(entry.variable.name for entry in model.eventIndicators if entry.variable),
        dependencies={
            entry.variable.name: None
            if entry.dependencies is None
            else tuple(known.name for known in entry.dependencies)
            for entry in [*model.outputs, *model.derivatives]
            if entry.variable is not None
        },
        start_time=_number(experiment.startTime) if experiment else None,
        stop_time=_number(experiment.stopTime) if experiment else None,
        step=_number(experiment.stepSize) if experiment else None,
        tolerance=_number(experiment.tolerance) if experiment else None,
        description=model.description or "",
        tool=model.generationTool or "",
        generated=model.generationDateAndTime or "",
        token=model.instantiationToken or "",
        entries=len(entries),
        size=sum(entry.file_size for entry in entries),
    )


def _with_derivatives(model: ModelDescription, variables: tuple[FmuVariable, ...]) -> tuple[FmuVariable, ...]:
    states = {
        entry.name: entry.derivative.name
        for entry in model.modelVariables
        if isinstance(entry.derivative, ModelVariable)
    }
    return tuple(
        dataclasses.replace(entry, derivative_of=states[entry.name]) if entry.name in states else entry
        for entry in variables
    )


def _variable(entry: ModelVariable, element: etree._Element) -> FmuVariable:
    """A variable; from its element what fmpy leaves out: bounds of UInt, start values of texts but the first."""
    declared = entry.declaredType
    kind = {"Real": "Float64", "Integer": "Int32"}.get(entry.type, entry.type)

    def attribute(name: str) -> str | None:
        """Of the variable, else of the type it is declared with."""
        own = element.get(name) or getattr(entry, name)
        return own if own is not None or declared is None else getattr(declared, name)

    texts = [start.get("value", "") for start in element.findall("Start")]
    return FmuVariable(
        name=entry.name,
        reference=entry.valueReference,
        type=kind,
        causality=entry.causality or "local",
        variability=entry.variability or "",
        initial=entry.initial or "",
        unit=attribute("unit") or "",
        display_unit=attribute("displayUnit") or "",
        shape=tuple(entry.shape or ()),
        start=_start(kind, texts or entry.start),
        minimum=_number(attribute("min")),
        maximum=_number(attribute("max")),
        nominal=_number(attribute("nominal")),
        description=entry.description or "",
        items=tuple(int(item.value or 0) for item in declared.items) if declared else (),
        dimensions=tuple(axis.variable.name if axis.variable else "" for axis in entry.dimensions),
        clocks=tuple(str(getattr(clock, "name", clock)) for clock in entry.clocks or ()),
    )


def _start(kind: str, text: str | Sequence[str] | None) -> tuple[Scalar, ...]:
    if text is None:
        return ()
    if kind in ("String", "Binary"):
        words = (text,) if isinstance(text, str) else text
        return tuple(bytes.fromhex(word) if kind == "Binary" else word for word in words)
    words = text.split() if isinstance(text, str) else text
    if kind == "Boolean":
        return tuple(word in ("true", "1") for word in words)
    return tuple(float(word) if kind.startswith("Float") else int(word) for word in words)


def _unit(unit: object) -> FmuUnit:
    base = getattr(unit, "baseUnit", None)
    exponents = {name: int(getattr(base, name)) for name in _BASE_UNITS if getattr(base, name, 0)}
    return FmuUnit(exponents, float(getattr(base, "factor", 1.0)), float(getattr(base, "offset", 0.0)))


def _number(text: str | float | None) -> float | None:
    return None if text is None else float(text)


def _experiment(description: FmuDescription) -> str:
    words = {
        "start": description.start_time,
        "stop": description.stop_time,
        "step": description.step,
        "tolerance": description.tolerance,
    }
    return ", ".join(f"{word} {value:g}" for word, value in words.items() if value is not None) or "not said"


def _shown(value: Scalar) -> str:
    return (
        f"{value:g}" if isinstance(value, float) else value.hex() if isinstance(value, bytes) else str(value)
    )


def _variable_line(entry: FmuVariable) -> str:
    size = "x".join(map(str, entry.shape))
    start = ", ".join(map(_shown, entry.start))
    parts = [
        f"{entry.name}{f' ({size})' if size else ''}",
        f"[{entry.unit}]" if entry.unit else "",
        f"= {start}" if start else "",
        "" if entry.variability in ("continuous", "") else entry.variability,
        f"  {entry.description}" if entry.description else "",
    ]
    return " ".join(part for part in parts if part)
