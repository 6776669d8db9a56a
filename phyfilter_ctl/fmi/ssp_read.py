"""System structure packages (SSP 1.0) read: components, wires, parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote, urlsplit

import lxml.etree as etree
from fmpy.ssp.ssd import validate_tree

from .archive import ArchiveLimits, extracted, parse_xml
from .cosimulation_wiring import Wire
from .inspect import FmuDescription, FmuUnit, Scalar, describe

__all__ = ["SspSystem", "opened_ssp"]

NAMESPACES = {
    "ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
    "ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon",
    "ssv": "http://ssp-standard.org/SSP1/SystemStructureParameterValues",
    "ssm": "http://ssp-standard.org/SSP1/SystemStructureParameterMapping",
}
# Annotation of a system: names for components' inputs and outputs, where it has no connectors of its own.
SIGNALS = "urn:phyfilter-ctl:signals"
_FMU_TYPES = (None, "application/x-fmu-sharedlibrary")
_NUMBERS = {"Real": float, "Integer": int, "Enumeration": str, "String": str}


@dataclass(frozen=True, eq=False)
class SspSystem:
    """A package, unpacked.

    Parameters
    ----------
    name : str
    parts : dict of str to Path
        FMU by component; components of inner systems as ``system.component``.
    wires : tuple of Wire
    inputs : dict of str to tuple of Wire
        What each input connector of the whole drives (``source`` is empty).
    outputs : dict of str to str
        ``component.output`` behind each output connector of the whole.
    parameters : dict of str to number or text
        By ``component.variable``.
    start_time, stop_time : float or None
    """

    name: str
    parts: Mapping[str, Path]
    wires: tuple[Wire, ...]
    inputs: Mapping[str, tuple[Wire, ...]]
    outputs: Mapping[str, str]
    parameters: Mapping[str, Scalar]
    start_time: float | None = None
    stop_time: float | None = None


@contextmanager
def opened_ssp(path: str | Path, *, limits: ArchiveLimits | None = None) -> Iterator[SspSystem]:
    """A package in a temporary folder; nothing of its FMUs is run.

    Parameters
    ----------
    path : str or Path
    limits : ArchiveLimits, optional

    Raises
    ------
    ValueError
        If the archive is damaged or hostile, the description is not valid, a component is no FMU or missing, or a
        connection cannot be followed.
    """
    path = Path(path)
    with extracted(path, limits) as folder:
        document = folder / "SystemStructure.ssd"
        if not document.is_file():
            raise ValueError(f"{path}: no SystemStructure.ssd inside: not a system structure package")
        root = parse_xml(document.read_bytes(), f"{path}: SystemStructure.ssd", limits)
        _validate(path, root)
        reader = _Reader(path, folder, limits)
        system = root.find("ssd:System", NAMESPACES)
        assert system is not None  # the schema says so
        reader.system("", system)
        experiment = root.find("ssd:DefaultExperiment", NAMESPACES)
        yield reader.result(root.get("name", path.stem), system, experiment)


@dataclass
class _Reader:
    """What is found on the way down through inner systems. Nodes are (element path, connector)."""

    path: Path
    folder: Path
    limits: ArchiveLimits | None
    parts: dict[str, Path] = field(default_factory=dict)
    descriptions: dict[str, FmuDescription] = field(default_factory=dict)
    kinds: dict[tuple[str, str], str] = field(default_factory=dict)
    drivers: dict[tuple[str, str], tuple[tuple[str, str], float, float, bool]] = field(default_factory=dict)
    parameters: dict[str, Scalar] = field(default_factory=dict)

    def system(self, prefix: str, element: etree._Element) -> None:
        self._connectors(prefix, element)
        for child in element.findall("ssd:Elements/*", NAMESPACES):
            tag = etree.QName(child).localname
            name = f"{prefix}.{child.get('name')}" if prefix else str(child.get("name"))
            if tag == "System":
                self.system(name, child)
            elif tag == "Component":
                self._component(name, child)
            else:
                raise ValueError(
                    f"{self.path}: {name}: a {tag} is not supported; expected components and systems"
                )
        for connection in element.findall("ssd:Connections/ssd:Connection", NAMESPACES):
            self._connection(prefix, connection)
        # Bindings of an outer system come later and win, as SSP wants it.
        self._bindings(prefix, element)

    def _connectors(self, name: str, element: etree._Element) -> None:
        for connector in element.findall("ssd:Connectors/ssd:Connector", NAMESPACES):
            self.kinds[name, str(connector.get("name"))] = str(connector.get("kind"))

    def _component(self, name: str, element: etree._Element) -> None:
        if element.get("type") not in _FMU_TYPES:
            raise ValueError(
                f"{self.path}: {name}: component of type {element.get('type')!r}; expected an FMU"
            )
        self.parts[name] = self._file(str(element.get("source")), name)
        self.descriptions[name] = describe(self.parts[name], limits=self.limits)
        self._connectors(name, element)
        self._bindings(name, element)

    def _file(self, source: str, name: str) -> Path:
        parts = urlsplit(source)
        target = (self.folder / unquote(parts.path)).resolve()
        outside = parts.scheme or parts.netloc or not target.is_relative_to(self.folder.resolve())
        if outside or not target.is_file():
            raise ValueError(f"{self.path}: {name}: expected a file inside the package, got {source!r}")
        return target

    def _connection(self, prefix: str, element: etree._Element) -> None:
        ends = []
        for side in ("start", "end"):
            inner = element.get(f"{side}Element")
            owner = prefix if inner is None else (f"{prefix}.{inner}" if prefix else inner)
            node = owner, str(element.get(f"{side}Connector"))
            if node not in self.kinds:
                raise ValueError(
                    f"{self.path}: a connection names {'.'.join(node)!r}; there is no such connector"
                )
            # Seen from this system, its own inputs are sources and its own outputs are sinks.
            gives = self.kinds[node] == ("input" if inner is None else "output")
            takes = self.kinds[node] == ("output" if inner is None else "input")
            if not gives and not takes:
                raise ValueError(
                    f"{self.path}: {'.'.join(node)!r}: connections of kind {self.kinds[node]!r} are not supported; "
                    "expected input and output"
                )
            ends.append((node, gives))
        if ends[0][1] == ends[1][1]:
            both = "sources" if ends[0][1] else "sinks"
            raise ValueError(
                f"{self.path}: {'.'.join(ends[0][0])!r} and {'.'.join(ends[1][0])!r} are both {both}"
            )
        source, sink = (ends[0][0], ends[1][0]) if ends[0][1] else (ends[1][0], ends[0][0])
        if sink in self.drivers:
            raise ValueError(f"{self.path}: {'.'.join(sink)!r} is driven twice")
        gain, offset = _linear(element, f"{self.path}: {'.'.join(sink)}")
        convert = element.get("suppressUnitConversion") not in ("true", "1")
        self.drivers[sink] = source, gain, offset, convert

    def _traced(self, node: tuple[str, str]) -> Wire | None:
        """Wire from where a signal is made to a node; None where nothing drives it."""
        gain, offset, convert, at = 1.0, 0.0, True, node
        seen = {node}
        while at in self.drivers:
            at, factor, shift, converts = self.drivers[at]
            gain, offset = gain * factor, gain * shift + offset
            convert = convert and converts
            if at in seen:
                raise ValueError(f"{self.path}: {'.'.join(at)!r} drives itself")
            seen.add(at)
        if at == node:
            return None
        if at[0] not in self.parts and at[0] != "":
            return None  # an inner system's input that nothing drives
        # An input connector of the whole gets a leading dot, which no component's output has.
        return Wire(".".join(node), ".".join(at), gain, offset, convert)

    def result(self, name: str, system: etree._Element, experiment: etree._Element | None) -> SspSystem:
        wires: list[Wire] = []
        inputs: dict[str, list[Wire]] = {
            label: [] for (owner, label), kind in self.kinds.items() if not owner and kind == "input"
        }
        for (owner, label), kind in self.kinds.items():
            if owner not in self.parts or kind != "input":
                continue
            wire = self._traced((owner, label))
            if wire is not None and wire.source.startswith("."):
                inputs[wire.source[1:]].append(dataclasses.replace(wire, source=""))
            elif wire is not None:
                wires.append(self._converted(wire))
        outputs = self._outputs()
        times = {
            key: None if experiment is None else experiment.get(key) for key in ("startTime", "stopTime")
        }
        start, stop = (None if text is None else float(text) for text in times.values())
        known = {
            f"{part}.{label}"
            for part, entry in self.descriptions.items()
            for variable in entry.variables
            for label in (variable.name, *variable.labels)
        }
        # Values for names that no FMU has are ignored, as SSP wants it.
        parameters = {key: value for key, value in self.parameters.items() if key in known}
        self._named(system, inputs, outputs)
        frozen = {label: tuple(found) for label, found in inputs.items()}
        return SspSystem(name, self.parts, tuple(wires), frozen, outputs, parameters, start, stop)

    def _named(self, system: etree._Element, inputs: dict[str, list[Wire]], outputs: dict[str, str]) -> None:
        """Add the inputs and outputs that an annotation names."""
        signals = f"ssd:Annotations/ssc:Annotation[@type='{SIGNALS}']/*/*"
        for entry in system.iterfind(signals, NAMESPACES):
            label, signal = str(entry.get("name")), str(entry.get("signal"))
            if tuple(signal.rsplit(".", 1)) not in self.kinds:
                raise ValueError(f"{self.path}: {label!r} stands for {signal!r}; there is no such connector")
            if etree.QName(entry).localname == "Input":
                inputs.setdefault(label, []).append(Wire(signal, ""))
            else:
                outputs[label] = signal

    def _outputs(self) -> dict[str, str]:
        result: dict[str, str] = {}
        for owner, label in [node for node, kind in self.kinds.items() if not node[0] and kind == "output"]:
            wire = self._traced((owner, label))
            if wire is None:
                continue
            if wire.source.startswith(".") or (wire.gain, wire.offset) != (1.0, 0.0):
                raise ValueError(
                    f"{self.path}: output {label!r}: expected a component's output as it is, without gain"
                )
            result[label] = wire.source
        return result

    def _converted(self, wire: Wire) -> Wire:
        """SSP has the importer convert units of one dimension."""
        if not wire.convert:
            return wire
        sink, source = self._unit(wire.sink), self._unit(wire.source)
        if sink is None or source is None or sink == source or sink.exponents != source.exponents:
            return wire
        gain = wire.gain * source.factor / sink.factor
        offset = (wire.offset * source.factor + source.offset - sink.offset) / sink.factor
        return dataclasses.replace(wire, gain=gain, offset=offset, convert=False)

    def _unit(self, label: str) -> FmuUnit | None:
        for part, entry in self.descriptions.items():
            for variable in entry.variables:
                if label.startswith(f"{part}.") and label.removeprefix(f"{part}.") in variable.labels:
                    return entry.units.get(variable.unit)
        return None

    # -- parameters -------------------------------------------------------------------------------------------

    def _bindings(self, owner: str, element: etree._Element) -> None:
        for binding in element.findall("ssd:ParameterBindings/ssd:ParameterBinding", NAMESPACES):
            values = self._values(owner, binding)
            mapping = self._mapping(owner, binding)
            if mapping is not None:
                values = {
                    target: float(values[source]) * gain + offset
                    if (gain, offset) != (1.0, 0.0)
                    else values[source]
                    for target, (source, gain, offset) in mapping.items()
                    if source in values
                }
            prefix = f"{owner}." if owner else ""
            self.parameters |= {
                f"{prefix}{binding.get('prefix', '')}{key}": value for key, value in values.items()
            }

    def _document(self, owner: str, binding: etree._Element, inside: str) -> etree._Element | None:
        source = binding.get("source")
        if source is None:
            return binding.find(inside, NAMESPACES)
        file = self._file(source, owner or "the system")
        return parse_xml(file.read_bytes(), f"{self.path}: {source}", self.limits)

    def _values(self, owner: str, binding: etree._Element) -> dict[str, Scalar]:
        root = self._document(owner, binding, "ssd:ParameterValues/ssv:ParameterSet")
        result: dict[str, Scalar] = {}
        for parameter in [] if root is None else root.findall("ssv:Parameters/ssv:Parameter", NAMESPACES):
            value = next((child for child in parameter if isinstance(child.tag, str)), None)
            if value is None:
                continue
            kind, text = etree.QName(value).localname, value.get("value", "")
            if kind == "Boolean":
                result[str(parameter.get("name"))] = text in ("true", "1")
            elif kind in _NUMBERS:
                result[str(parameter.get("name"))] = _NUMBERS[kind](text)
        return result

    def _mapping(self, owner: str, binding: etree._Element) -> dict[str, tuple[str, float, float]] | None:
        holder = binding.find("ssd:ParameterMapping", NAMESPACES)
        if holder is None:
            return None
        root = self._document(owner, holder, "ssm:ParameterMapping")
        entries = [] if root is None else root.findall("ssm:MappingEntry", NAMESPACES)
        return {
            str(entry.get("target")): (str(entry.get("source")), *_linear(entry, f"{self.path}: {owner}"))
            for entry in entries
        }


def _linear(element: etree._Element, where: str) -> tuple[float, float]:
    for child in element:
        if not isinstance(child.tag, str):
            continue
        tag = etree.QName(child).localname
        if tag == "LinearTransformation":
            return float(child.get("factor", "1")), float(child.get("offset", "0"))
        if tag.endswith("Transformation"):
            raise ValueError(f"{where}: a {tag} is not supported; expected a LinearTransformation")
    return 1.0, 0.0


def _validate(path: Path, root: etree._Element) -> None:
    version = root.get("version", "")
    schema = (
        "SystemStructureDescription.xsd" if version.startswith("1.0") else "SystemStructureDescription11.xsd"
    )
    try:
        validate_tree(root, schema)
    except Exception as error:  # fmpy raises a bare exception with the schema's messages
        raise ValueError(f"{path}: SystemStructure.ssd is not valid: {error}") from error
