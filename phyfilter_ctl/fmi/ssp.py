"""System structure packages (SSP 1.0) written: a diagram as FMUs, wires and parameters."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import control as ct
import lxml.etree as etree
from fmpy.ssp.ssd import validate_tree

from .._intake import check_name
from .._renamed import takes_former
from ..diagram import flatten
from .archive_write import write_archive
from .cosimulation_wiring import Wire, as_wires
from .export import export_fmu
from .fmu import Fmu
from .inspect import FmuDescription, FmuVariable, Scalar, describe
from .ports import FmuPorts
from .ssp_cut import cut_diagram
from .ssp_geometry import SIGNALS, add_geometry, laid_out
from .ssp_values import NAMESPACES
from .system import System
from .units import FmuUnit

__all__ = ["export_ssp", "write_ssp"]

_SSD, _SSC, _SSV = (f"{{{NAMESPACES[key]}}}" for key in ("ssd", "ssc", "ssv"))
_SSP_TYPES = {"Boolean": "Boolean", "String": "String", "Enumeration": "Enumeration"}
_PARAMETERS = "resources/parameters.ssv"
_TOOL = "phyfilter_ctl"


def export_ssp(
    system: ct.InterconnectedSystem,
    path: str | Path,
    *,
    split: Mapping[str, Sequence[str]] | None = None,
    fmi: Literal["2.0", "3.0"] = "2.0",
    platforms: Sequence[str] | Literal["all"] = ("native",),
    name: str | None = None,
    parameters: Mapping[str, Scalar] | None = None,
    stop_time: float | None = None,
    system_connectors: bool = False,
    unconnected: Literal["error", "zero"] = "error",
) -> Path:
    """Export a diagram as a system structure package: one co-simulation FMU per part, and their wiring.

    Parameters
    ----------
    system : control.InterconnectedSystem
    path : str or Path
        File to write, ending in ``.ssp``; replaced whole or not at all.
    split : dict of str to sequence of str, optional
        Blocks of each part: ``{"plant": ["drone"], "controller": ["pd", "sum"], "filter": ["phyfilter"]}``. Each
        block a part by default. Sums and gains between blocks go into the part they lead to.
    fmi : {"2.0", "3.0"}
        Of the FMUs; most importers of SSP 1.0 take 2.0 only.
    platforms : sequence of str or "all"
        As for ``export_fmu``.
    name : str, optional
        Of the system; the diagram's by default.
    parameters : dict of str to number or text, optional
        Values by ``part.parameter`` in the package's parameter file; the FMUs' start values for the rest.
    stop_time : float, optional
        Default experiment, from 0.
    system_connectors : bool
        Whether inputs and outputs of the diagram become connectors of the package, as FMPy needs them to drive inputs.
        ecos, libcosim and OMSimulator open no package whose connections go through them; without, the names of the
        diagram's inputs and outputs stand in an annotation, which :func:`cosimulate` reads.
    unconnected : {"error", "zero"}
        Inputs of blocks that nothing drives: refused, or 0, as for :func:`phyfilter_ctl.flatten`.

    Returns
    -------
    Path

    Raises
    ------
    TypeError, ValueError
        As for :func:`cut_diagram`; if a part cannot be exported as an FMU.

    Notes
    -----
    Up to 150 parts are laid out as :func:`phyfilter_ctl.draw` does, which takes seconds for more than 100; other tools
    find the places as SSP's geometry.

    Where a part feeds another, the signal is held from one communication point to the next: the package converges to
    the diagram with the first order of the communication step. One thing stays different at any step: a sampled block
    with ``g="hold"`` whose g follows its own f_hat at once through another part remembers that g from before its new
    f_hat. Keep such a pair in one part, or put a state between them.
    """
    target = _target(path)
    cut = cut_diagram(system, split)
    with tempfile.TemporaryDirectory(prefix="phyfilter-") as folder:
        fmus: dict[str, Path] = {}
        for part, piece in cut.parts.items():
            assert isinstance(piece, ct.InterconnectedSystem)
            fmus[part] = Path(folder, f"{part}.fmu")
            flat = flatten(piece, unconnected=unconnected)
            export_fmu(
                flat,
                fmus[part],
                fmi=fmi,
                kinds=("cs",),
                platforms=platforms,
                name=part,
                ports=FmuPorts(arrays=False),
            )
        return write_ssp(
            replace(cut, parts=fmus, parameters=parameters or {}),
            target,
            name=name or system.name or "system",
            stop_time=stop_time,
            system_connectors=system_connectors,
        )


@takes_former
def write_ssp(
    system: System,
    path: str | Path,
    *,
    name: str = "system",
    start_time: float = 0.0,
    stop_time: float | None = None,
    system_connectors: bool = True,
) -> Path:
    """Write a system structure package (SSP 1.0) around FMUs, ours or others'.

    Parameters
    ----------
    system : System
        Of FMU files; one wire for each input. Parameters of the system, and of an :class:`Fmu`, go into the package's
        parameter file.
    path : str or Path
        File to write, ending in ``.ssp``.
    name : str
        Of the system.
    start_time, stop_time : float
        Default experiment, in seconds; left out without ``stop_time``.
    system_connectors : bool
        False writes inputs and outputs of the whole as an annotation, see :func:`export_ssp`.

    Returns
    -------
    Path

    Raises
    ------
    ValueError
        If a name is unknown or an input is driven twice; if that of a part, which becomes its file's, is no plain name.
    """
    target = _target(path)
    fmus: dict[str, Path] = {}
    given: dict[str, Scalar] = {}
    for part, thing in system.parts.items():
        check_name(part, f"{target}: a part")
        if not isinstance(thing, str | Path | Fmu):
            raise TypeError(
                f"{part}: expected an FMU file, got {type(thing).__name__}; export_fmu writes one"
            )
        fmu = Fmu.of(thing)
        fmus[part] = Path(fmu.path)
        given |= {f"{part}.{key}": value for key, value in fmu.parameters.items()}
    descriptions = {part: describe(file) for part, file in fmus.items()}
    wires = as_wires(system.connections, _labels(descriptions, "input"), _labels(descriptions, "output"))
    inputs, outputs = system.ends, system.outputs
    if not system_connectors and any(
        wire != Wire(wire.sink, "") for ends in inputs.values() for wire in ends
    ):
        raise ValueError(
            f"{target}: an input with a gain or an offset needs a connector; give system_connectors=True"
        )
    ends = [(wire.sink, "input") for wire in wires] + [(wire.source, "output") for wire in wires]
    ends += [(wire.sink, "input") for sinks in inputs.values() for wire in sinks]
    ends += [(source, "output") for source in outputs.values()]
    variables = {end: _variable(descriptions, *end) for end in ends}
    driven = [sink for sink, kind in ends if kind == "input"]
    twice = sorted({sink for sink in driven if driven.count(sink) > 1})
    if twice:
        raise ValueError(
            f"{target}: {twice[0]!r} is driven twice; an SSP connection joins one output and one input"
        )
    values = _values(descriptions, {**given, **system.parameters})
    ends_of_whole = inputs, outputs
    shown = ends_of_whole if system_connectors else ({}, {})
    ssd = _structure(descriptions, fmus, wires, variables, *shown, name)
    _add_layout(ssd[0], list(fmus), variables, wires, *ends_of_whole)
    if not system_connectors:
        _annotation(ssd[0], *ends_of_whole)
    if stop_time is not None:
        etree.SubElement(
            ssd,
            f"{_SSD}DefaultExperiment",
            startTime=repr(float(start_time)),
            stopTime=repr(float(stop_time)),
        )
    validate_tree(ssd, "SystemStructureDescription.xsd")
    ssv = _parameter_set(descriptions, values)
    validate_tree(ssv, "SystemStructureParameterValues.xsd")
    files = {"SystemStructure.ssd": _text(ssd), _PARAMETERS: _text(ssv)}
    files |= {f"resources/{part}.fmu": Path(file).read_bytes() for part, file in fmus.items()}
    return write_archive(target, files)


def _structure(
    descriptions: Mapping[str, FmuDescription],
    fmus: Mapping[str, Path],
    wires: Sequence[Wire],
    variables: Mapping[tuple[str, str], FmuVariable],
    inputs: Mapping[str, Sequence[Wire]],
    outputs: Mapping[str, str],
    name: str,
) -> etree._Element:
    spaces = {key: NAMESPACES[key] for key in ("ssd", "ssc")}
    root = etree.Element(f"{_SSD}SystemStructureDescription", nsmap=spaces, version="1.0", name=name)
    root.set("generationTool", _TOOL)
    system = etree.SubElement(root, f"{_SSD}System", name=name)
    outer = [(label, "input", variables[sinks[0].sink, "input"]) for label, sinks in inputs.items() if sinks]
    outer += [(label, "output", variables[source, "output"]) for label, source in outputs.items()]
    _connectors(system, outer)
    bindings = etree.SubElement(system, f"{_SSD}ParameterBindings")
    etree.SubElement(
        bindings, f"{_SSD}ParameterBinding", type="application/x-ssp-parameter-set", source=_PARAMETERS
    )
    elements = etree.SubElement(system, f"{_SSD}Elements")
    for part in fmus:
        component = etree.SubElement(
            elements,
            f"{_SSD}Component",
            name=part,
            type="application/x-fmu-sharedlibrary",
            source=f"resources/{part}.fmu",
            implementation="CoSimulation",
        )
        used = {end[0].removeprefix(f"{part}."): end for end in variables if end[0].startswith(f"{part}.")}
        _connectors(component, [(label, end[1], variables[end]) for label, end in used.items()])
    pairs = [(wire.source, wire.sink, wire) for wire in wires]
    pairs += [(label, wire.sink, wire) for label, sinks in inputs.items() for wire in sinks]
    pairs += [(source, label, Wire(label, source)) for label, source in outputs.items()]
    if pairs:
        connections = etree.SubElement(system, f"{_SSD}Connections")
        for source, sink, wire in pairs:
            _connection(connections, source, sink, wire, list(fmus))
    _units(root, f"{_SSD}Units", descriptions, {entry.unit for entry in variables.values()})
    return root


def _add_layout(
    system: etree._Element,
    fmus: Sequence[str],
    variables: Mapping[tuple[str, str], FmuVariable],
    wires: Sequence[Wire],
    inputs: Mapping[str, Sequence[Wire]],
    outputs: Mapping[str, str],
) -> None:
    """Where tools draw it: as ``phyfilter_ctl.draw`` would."""
    found = {label: _split(label, fmus) for label, _ in variables}
    ports = {part: ([], []) for part in fmus}
    units: dict[str, dict[str, str]] = {part: {} for part in fmus}
    for (label, kind), variable in variables.items():
        part, signal = found[label]
        ports[part][kind == "output"].append(signal)
        units[part][signal] = variable.unit
    pairs = [(found[wire.source], found[wire.sink]) for wire in wires]
    pairs += [(("", label), found[wire.sink]) for label, sinks in inputs.items() for wire in sinks]
    pairs += [(found[source], ("", label)) for label, source in outputs.items()]
    geometry = laid_out(
        ports, pairs, [label for label, sinks in inputs.items() if sinks], list(outputs), units
    )
    if geometry is not None:
        add_geometry(system, geometry)


def _annotation(
    system: etree._Element, inputs: Mapping[str, Sequence[Wire]], outputs: Mapping[str, str]
) -> None:
    """Names of the whole's inputs and outputs, for those who know this annotation; others pass it over."""
    holder = etree.SubElement(system, f"{_SSD}Annotations")
    annotation = etree.SubElement(holder, f"{_SSC}Annotation", type=SIGNALS)
    signals = etree.SubElement(annotation, f"{{{SIGNALS}}}Signals")
    pairs = [("Input", label, wire.sink) for label, sinks in inputs.items() for wire in sinks]
    pairs += [("Output", label, source) for label, source in outputs.items()]
    for tag, label, place in pairs:
        etree.SubElement(signals, f"{{{SIGNALS}}}{tag}", name=label, signal=place)


def _connectors(element: etree._Element, entries: Sequence[tuple[str, str, FmuVariable]]) -> None:
    if not entries:
        return
    connectors = etree.SubElement(element, f"{_SSD}Connectors")
    for label, kind, variable in entries:
        connector = etree.SubElement(connectors, f"{_SSD}Connector", name=label, kind=kind)
        value = etree.SubElement(connector, f"{_SSC}{_type(variable)}")
        if variable.unit and _type(variable) == "Real":
            value.set("unit", variable.unit)


def _connection(
    connections: etree._Element, source: str, sink: str, wire: Wire, parts: Sequence[str]
) -> None:
    element = etree.SubElement(connections, f"{_SSD}Connection")
    for side, label in (("start", source), ("end", sink)):
        owner, connector = _split(label, parts)
        if owner:
            element.set(f"{side}Element", owner)
        element.set(f"{side}Connector", connector)
    if (wire.gain, wire.offset) != (1.0, 0.0):
        etree.SubElement(
            element,
            f"{_SSC}LinearTransformation",
            factor=repr(float(wire.gain)),
            offset=repr(float(wire.offset)),
        )
    if not wire.convert:
        element.set("suppressUnitConversion", "true")


def _split(label: str, parts: Sequence[str]) -> tuple[str, str]:
    """Part and signal of a label; "" and the label of the whole's own."""
    owner = max((part for part in parts if label.startswith(f"{part}.")), key=len, default="")
    return owner, label.removeprefix(f"{owner}.") if owner else label


def _parameter_set(
    descriptions: Mapping[str, FmuDescription], values: Mapping[str, tuple[FmuVariable, Scalar]]
) -> etree._Element:
    spaces = {key: NAMESPACES[key] for key in ("ssv", "ssc")}
    root = etree.Element(f"{_SSV}ParameterSet", nsmap=spaces, version="1.0", name="parameters")
    root.set("generationTool", _TOOL)
    parameters = etree.SubElement(root, f"{_SSV}Parameters")
    for key, (variable, value) in values.items():
        kind = _type(variable)
        text = (
            str(value).lower() if kind == "Boolean" else repr(float(value)) if kind == "Real" else str(value)
        )
        parameter = etree.SubElement(parameters, f"{_SSV}Parameter", name=key)
        element = etree.SubElement(parameter, f"{_SSV}{kind}", value=text)
        if kind == "Real" and variable.unit:
            element.set("unit", variable.unit)
    _units(root, f"{_SSV}Units", descriptions, {variable.unit for variable, _ in values.values()})
    return root


def _units(
    root: etree._Element, tag: str, descriptions: Mapping[str, FmuDescription], names: set[str]
) -> None:
    known: dict[str, FmuUnit] = {}
    for description in descriptions.values():
        known |= description.units
    used = sorted(name for name in names if name)
    if not used:
        return
    units = etree.SubElement(root, tag)
    for name in used:
        definition = known.get(name, FmuUnit({}))
        unit = etree.SubElement(units, f"{_SSC}Unit", name=name)
        base = etree.SubElement(unit, f"{_SSC}BaseUnit")
        for key, exponent in definition.exponents.items():
            base.set(key, str(exponent))
        if definition.factor != 1.0:
            base.set("factor", repr(definition.factor))
        if definition.offset != 0.0:
            base.set("offset", repr(definition.offset))


def _labels(descriptions: Mapping[str, FmuDescription], kind: str) -> tuple[str, ...]:
    return tuple(
        f"{part}.{label}"
        for part, description in descriptions.items()
        for variable in description.of(kind)
        for label in variable.labels
    )


def _type(variable: FmuVariable) -> str:
    if variable.type.startswith("Float"):
        return "Real"
    return _SSP_TYPES.get(variable.type, "Integer")


def _variable(descriptions: Mapping[str, FmuDescription], label: str, kind: str) -> FmuVariable:
    for part in sorted(descriptions, key=len, reverse=True):
        if label.startswith(f"{part}."):
            signal = label.removeprefix(f"{part}.")
            for variable in descriptions[part].of(kind):
                # A whole array is one connector in FMI 3.0's sense; here every element is one.
                if signal in variable.labels:
                    return variable
    raise ValueError(f"{label!r} is not an {kind} of a component; components are {list(descriptions)}")


def _values(
    descriptions: Mapping[str, FmuDescription], parameters: Mapping[str, Scalar]
) -> dict[str, tuple[FmuVariable, Scalar]]:
    result: dict[str, tuple[FmuVariable, Scalar]] = {}
    for part, description in descriptions.items():
        for variable in description.of("parameter"):
            labels = dict(zip(variable.labels, variable.starts, strict=False))
            result |= {f"{part}.{label}": (variable, start) for label, start in labels.items()}
    unknown = sorted(set(parameters) - set(result))
    if unknown:
        raise ValueError(f"parameters: {unknown[0]!r} is none; there are {sorted(result)}")
    return result | {key: (result[key][0], value) for key, value in parameters.items()}


def _text(root: etree._Element) -> bytes:
    return etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)


def _target(path: str | Path) -> Path:
    target = Path(path)
    if target.suffix.lower() != ".ssp":
        raise ValueError(f"{path}: expected a file that ends in .ssp")
    if not target.parent.is_dir():
        raise ValueError(f"{path}: there is no folder {target.parent}")
    return target
