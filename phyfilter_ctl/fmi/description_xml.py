"""modelDescription.xml of FMI 2.0 and 3.0, and the XML files beside it."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from math import isinf, isnan

from .._units import UnitDefinition, unit_definition
from .clocks import as_fraction
from .description import FIRST_REFERENCE, FmuInterface, InterfaceVariable

__all__ = ["build_description", "log_categories", "model_description", "terminals_and_icons"]

_CATEGORIES = {
    "logEvents": "Events and parameters that came into force",
    "logStatusWarning": "Parameters that were refused",
    "logStatusDiscard": "Steps that were taken back",
    "logStatusError": "Calls that were refused",
}


def log_categories() -> dict[str, str]:
    """Name and description of each log category."""
    return dict(_CATEGORIES)


def model_description(interface: FmuInterface, token: str, files: Sequence[str]) -> str:
    """modelDescription.xml.

    Parameters
    ----------
    interface : FmuInterface
    token : str
        GUID or instantiation token.
    files : sequence of str
        C files in the folder sources.
    """
    return _text(
        _description2(interface, token, files) if interface.fmi == "2.0" else _description3(interface, token)
    )


def _text(root: ET.Element) -> str:
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _number(value: float) -> str:
    if isnan(value):
        return "NaN"
    return ("INF" if value > 0 else "-INF") if isinf(value) else repr(float(value))


def _root(interface: FmuInterface, token_name: str, token: str, fmi: str) -> ET.Element:
    root = ET.Element("fmiModelDescription", fmiVersion=fmi, modelName=interface.model.name)
    root.set(token_name, token)
    if interface.description:
        root.set("description", interface.description)
    if interface.experiment.author:
        root.set("author", interface.experiment.author)
    root.set("generationTool", f"phyfilter-ctl {_own_version()}")
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "").strip()
    if epoch.isdigit():
        root.set("generationDateAndTime", f"{datetime.fromtimestamp(int(epoch), UTC):%Y-%m-%dT%H:%M:%SZ}")
    root.set("variableNamingConvention", "structured")
    return root


def _own_version() -> str:
    try:
        return version("phyfilter-ctl")
    except PackageNotFoundError:  # a bare checkout
        return "unknown"


def _units(interface: FmuInterface, root: ET.Element) -> None:
    names = sorted({variable.unit for variable in interface.variables if variable.unit})
    if not names:
        return
    element = ET.SubElement(root, "UnitDefinitions")
    for unit in (unit_definition(name) for name in names):
        _unit(ET.SubElement(element, "Unit", name=unit.name), unit)


def _unit(element: ET.Element, unit: UnitDefinition) -> None:
    if unit.exponents is not None:
        base = ET.SubElement(
            element, "BaseUnit", {name: str(power) for name, power in unit.exponents.items()}
        )
        if unit.factor != 1.0:
            base.set("factor", _number(unit.factor))
    for name, factor, offset in unit.display:
        shown = ET.SubElement(element, "DisplayUnit", name=name, factor=_number(factor))
        if offset:
            shown.set("offset", _number(offset))


def _common(interface: FmuInterface, root: ET.Element) -> None:
    _units(interface, root)
    categories = ET.SubElement(root, "LogCategories")
    for name, text in _CATEGORIES.items():
        ET.SubElement(categories, "Category", name=name, description=text)
    experiment = interface.experiment
    element = ET.SubElement(
        root, "DefaultExperiment", startTime=_number(experiment.start), stopTime=_number(experiment.stop),
        tolerance=_number(experiment.tolerance),
    )  # fmt: skip
    step = (
        experiment.step
        or interface.model.communication
        or min((p for _, p in interface.model.tasks), default=0.0)
    )
    if step:
        element.set("stepSize", _number(step))


def _numeric(element: ET.Element, variable: InterfaceVariable) -> None:
    shown = (lambda value: str(int(value))) if variable.kind == "structure" else _number
    if variable.unit:
        element.set("unit", variable.unit)
        if variable.unit == "rad":
            element.set("displayUnit", "deg")
    for name, bound in (("min", variable.minimum), ("max", variable.maximum)):
        if not isinf(bound):
            element.set(name, shown(bound))
    if variable.nominal:
        element.set("nominal", _number(variable.nominal))
    if variable.start is not None:
        element.set("start", " ".join(map(shown, variable.start)))


def _flag(value: bool) -> str:
    return "true" if value else "false"


# ---- FMI 2.0 ----


def _description2(interface: FmuInterface, token: str, files: Sequence[str]) -> ET.Element:
    root = _root(interface, "guid", f"{{{token}}}", "2.0")
    if interface.exchange and interface.model.events:
        root.set("numberOfEventIndicators", str(len(interface.model.events)))
    shared = {
        "modelIdentifier": interface.model.name,
        "canNotUseMemoryManagementFunctions": "true",
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "providesDirectionalDerivative": _flag(interface.derivatives),
    }
    if interface.exchange:
        element = ET.SubElement(
            root,
            "ModelExchange",
            shared,
            completedIntegratorStepNotNeeded=_flag(not (interface.model.remembers or interface.model.events)),
        )
        _source_files(element, files)
    if interface.simulation:
        element = ET.SubElement(
            root,
            "CoSimulation",
            shared,
            canHandleVariableCommunicationStepSize=_flag(not interface.fixed_step),
            canInterpolateInputs="true",
        )
        _source_files(element, files)
    _common(interface, root)
    variables = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(interface.variables, FIRST_REFERENCE):
        element = ET.SubElement(
            variables, "ScalarVariable", name=variable.name, valueReference=str(reference)
        )
        _roles(element, variable)
        real = ET.SubElement(element, "Real")
        _numeric(real, variable)
        if variable.derivative_of is not None:
            real.set("derivative", str(variable.derivative_of + 1))  # an index
    structure = ET.SubElement(root, "ModelStructure")
    for name, places in (
        ("Outputs", interface.of_kind("output")),
        ("Derivatives", interface.of_kind("derivative")),
        ("InitialUnknowns", interface.of_kind("output", "derivative")),
    ):
        if places:
            group = ET.SubElement(structure, name)
            for place in places:
                unknown = ET.SubElement(group, "Unknown", index=str(place + 1))
                _dependencies(interface, unknown, place, name == "InitialUnknowns", 1)
    return root


def _source_files(element: ET.Element, files: Sequence[str]) -> None:
    if not files:
        return
    group = ET.SubElement(element, "SourceFiles")
    for name in files:
        ET.SubElement(group, "File", name=name)


def _roles(element: ET.Element, variable: InterfaceVariable) -> None:
    if variable.description:
        element.set("description", variable.description)
    element.set("causality", variable.causality)
    element.set("variability", variable.variability)
    if variable.initial and variable.causality != "input":  # FMI 2 allows none on inputs
        element.set("initial", variable.initial)


def _dependencies(
    interface: FmuInterface, unknown: ET.Element, place: int, at_start: bool, offset: int
) -> None:
    """Without the attribute an unknown depends on all knowns, which is so at the start of sampled blocks."""
    if at_start and interface.sampled:
        return
    found = list(interface.dependencies(place))
    if at_start:
        found += interface.of_kind("parameter", "fixed")
    found.sort()
    unknown.set("dependencies", " ".join(str(i + offset) for i in found))
    unknown.set("dependenciesKind", " ".join("dependent" for _ in found))


# ---- FMI 3.0 ----


def _description3(interface: FmuInterface, token: str) -> ET.Element:
    root = _root(interface, "instantiationToken", f"{{{token}}}", "3.0")
    shared = {
        "modelIdentifier": interface.model.name,
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        "providesDirectionalDerivatives": _flag(interface.derivatives),
        "providesAdjointDerivatives": _flag(interface.derivatives),
        "providesPerElementDependencies": "true",
    }
    if interface.exchange:
        ET.SubElement(
            root,
            "ModelExchange",
            shared,
            needsCompletedIntegratorStep=_flag(interface.model.remembers or bool(interface.model.events)),
        )
    if interface.simulation:
        if interface.fixed_step:
            shared = shared | {"fixedInternalStepSize": _number(interface.fixed_step)}
        ET.SubElement(
            root, "CoSimulation", shared, canHandleVariableCommunicationStepSize="true", hasEventMode="true",
            providesIntermediateUpdate=_flag(bool(interface.model.states)), mightReturnEarlyFromDoStep="true",
            canReturnEarlyAfterIntermediateUpdate=_flag(bool(interface.model.states)),
        )  # fmt: skip
    _common(interface, root)
    variables = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(interface.variables, FIRST_REFERENCE):
        kind = {"clock": "Clock", "structure": "UInt64"}.get(variable.kind, "Float64")
        element = ET.SubElement(variables, kind, name=variable.name, valueReference=str(reference))
        _roles(element, variable)
        if variable.clock is not None:
            element.set("clocks", str(variable.clock + FIRST_REFERENCE))
        if variable.kind == "clock":
            _interval(element, interface.model.tasks[variable.first][1])
        if interface.simulation and variable.kind in {"input", "output"} and interface.model.states:
            element.set("intermediateUpdate", "true")
        _numeric(element, variable)
        if variable.derivative_of is not None:
            element.set("derivative", str(variable.derivative_of + FIRST_REFERENCE))
        for axis, length in enumerate(variable.shape):
            dimension = ET.SubElement(element, "Dimension")
            if axis == 0 and variable.length is not None:
                dimension.set("valueReference", str(variable.length + FIRST_REFERENCE))
            else:
                dimension.set("start", str(length))
    structure = ET.SubElement(root, "ModelStructure")
    for name, places in (
        ("Output", interface.of_kind("output")),
        ("ContinuousStateDerivative", interface.of_kind("derivative")),
        ("InitialUnknown", interface.of_kind("output", "derivative")),
    ):
        for place in places:
            unknown = ET.SubElement(structure, name, valueReference=str(place + FIRST_REFERENCE))
            _dependencies(interface, unknown, place, name == "InitialUnknown", FIRST_REFERENCE)
    for place in interface.of_kind("condition"):
        ET.SubElement(structure, "EventIndicator", valueReference=str(place + FIRST_REFERENCE))
    return root


def _interval(clock: ET.Element, period: float) -> None:
    """The first sample belongs to initialization, the first tick comes a period later."""
    clock.set("canBeDeactivated", "true")
    clock.set("intervalVariability", "constant")
    clock.set("intervalDecimal", _number(period))
    clock.set("shiftDecimal", _number(period))
    counter, resolution = as_fraction(period)
    if resolution:
        clock.set("supportsFraction", "true")
        clock.set("resolution", str(resolution))
        clock.set("intervalCounter", str(counter))
        clock.set("shiftCounter", str(counter))


def build_description(interface: FmuInterface, files: Sequence[str]) -> str:
    """sources/buildDescription.xml of FMI 3.0.

    Parameters
    ----------
    interface : FmuInterface
    files : sequence of str
        C files in the folder sources.
    """
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=interface.model.name)
    group = ET.SubElement(configuration, "SourceFileSet", language="C99")
    for name in files:
        ET.SubElement(group, "SourceFile", name=name)
    ET.SubElement(
        configuration, "Library", name="m", external="true", description="The C library's mathematics"
    )
    return _text(root)


def terminals_and_icons(interface: FmuInterface) -> str:
    """terminalsAndIcons/terminalsAndIcons.xml of FMI 3.0: inputs left, outputs right, one terminal per vector.

    Parameters
    ----------
    interface : FmuInterface
    """
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    picture = ET.SubElement(root, "GraphicalRepresentation")
    box = {"x1": "-100", "y1": "-100", "x2": "100", "y2": "100"}
    ET.SubElement(picture, "CoordinateSystem", box, suggestedScalingFactorTo_mm="0.1")
    ET.SubElement(picture, "Icon", box)
    sides = [(kind, _vectors(interface, kind)) for kind in ("input", "output")]
    if not any(vectors for _, vectors in sides):
        return _text(root)
    terminals = ET.SubElement(root, "Terminals")
    for kind, vectors in sides:
        left = kind == "input"
        for i, (name, members) in enumerate(vectors.items()):
            terminal = ET.SubElement(
                terminals, "Terminal", name=name, matchingRule="bus", terminalKind="signals"
            )
            for variable in members:
                ET.SubElement(
                    terminal, "TerminalMemberVariable", variableName=variable.name, memberName=variable.name,
                    variableKind="signal",
                )  # fmt: skip
            y = 100.0 - 200.0 * (i + 1) / (len(vectors) + 1)
            ET.SubElement(
                terminal, "TerminalGraphicalRepresentation", defaultConnectionColor="0 0 0",
                x1=_number(-110.0 if left else 100.0), x2=_number(-100.0 if left else 110.0), y1=_number(y - 5.0),
                y2=_number(y + 5.0), iconBaseName="terminal",
            )  # fmt: skip
    return _text(root)


def _vectors(interface: FmuInterface, kind: str) -> dict[str, list[InterfaceVariable]]:
    groups: dict[str, list[InterfaceVariable]] = {}
    for variable in interface.variables:
        if variable.kind == kind:
            groups.setdefault(variable.name.split("[", 1)[0], []).append(variable)
    return groups
