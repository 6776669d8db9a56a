"""System structure packages (SSP 1.0 and 2.0) read: components, wires, parameters."""

from __future__ import annotations

import dataclasses
import os
import shutil
import tempfile
import weakref
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import lxml.etree as etree

from .._output import naming
from .archive import ArchiveLimits, unpack
from .cosimulation_wiring import Wire
from .fmu import Fmu
from .foreign import Isolation
from .inspect import FmuDescription, Scalar, describe
from .ssp_files import SspFiles
from .ssp_geometry import FMU_TYPES, SIGNALS, SspGeometry, read_geometry
from .ssp_values import NAMESPACES, SspValue, parameter_values, transformation, unit_definitions
from .system import System
from .units import AS_IS, FmuUnit, Linear, conversion, understood_unit

__all__ = ["SspPackage", "read_package", "read_ssp"]

_DEFINITION, _PACKAGE = "application/x-ssp-definition", "application/x-ssp-package"
_VALUES = ("parameter", "structuralParameter", "constant")  # connectors that hand on values, not signals

_DEEPEST = 16

Node = tuple[str, str]  # element path, connector


class _Folder:
    """A temporary folder, removed with this object."""

    def __init__(self) -> None:
        self.path: Path = Path(tempfile.mkdtemp(prefix="phyfilter-"))
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)


@dataclass(frozen=True)
class _PackedFmu(Fmu):
    """An FMU of a package, which keeps the folder where it was unpacked."""

    folder: _Folder | None = field(default=None, repr=False, compare=False)


@dataclass(frozen=True, eq=False)
class SspPackage:
    """A package, unpacked.

    Parameters
    ----------
    name : str
    system : System
        Components of inner systems are parts called ``system.component``.
    start_time, stop_time : float or None
    geometry : SspGeometry or None
        Of its diagram, where the package has a whole one.
    """

    name: str
    system: System
    start_time: float | None = None
    stop_time: float | None = None
    geometry: SspGeometry | None = None

    @property
    def files(self) -> dict[str, Path]:
        """Of each component."""
        return {name: Path(part.path) for name, part in self.system.parts.items() if isinstance(part, Fmu)}

    @property
    def wires(self) -> tuple[Wire, ...]:
        """Of the system."""
        return tuple(wire for wire in self.system.connections if isinstance(wire, Wire))


def read_ssp(
    path: str | Path, *, isolated: bool | Isolation | None = None, limits: ArchiveLimits | None = None
) -> System:
    """Read a system structure package (SSP 1.0 or 2.0); nothing of its FMUs is run.

    Parameters
    ----------
    path : str or Path
    isolated : bool or Isolation, optional
        Whether each of its FMUs runs in a process of its own, as for :class:`Fmu`.
    limits : ArchiveLimits, optional
        What it may hold at most, packages and FMUs inside it included.

    Returns
    -------
    System
        Components of inner systems are parts called ``system.component``. The FMUs lie in a temporary folder, which is
        removed when the last part is gone.

    Raises
    ------
    ValueError
        If the archive is damaged or hostile, the description is not valid, a component is no FMU or missing, or a
        connection cannot be followed.

    Examples
    --------
    >>> system = read_ssp("drone.ssp", isolated=True)                               # doctest: +SKIP
    >>> cosimulate(system, timepts, inputs={"w": 0.1}, master=Master(0.002))        # doctest: +SKIP
    """
    return read_package(path, isolated=isolated, limits=limits).system


def read_package(
    path: str | Path, *, isolated: bool | Isolation | None = None, limits: ArchiveLimits | None = None
) -> SspPackage:
    """As :func:`read_ssp`, with what the package says besides.

    Parameters
    ----------
    path, isolated, limits
        As for :func:`read_ssp`.
    """
    path = Path(path)
    home = _Folder()
    folder = home.path
    with naming(folder):
        unpack(path, folder, limits)
    files = SspFiles(path, folder, limits)
    reader = _Reader(path, files, limits)
    try:
        root, system = reader.document(folder / "SystemStructure.ssd")
        reader.system("", system)
        experiment = root.find("ssd:DefaultExperiment", NAMESPACES)
        parts = {
            name: _PackedFmu(file, isolated=isolated, limits=limits, folder=home)
            for name, file in reader.parts.items()
        }
        return reader.result(root.get("name", path.stem), parts, system, experiment)
    except ValueError as error:  # of a part: named by where it was unpacked
        text = str(error).replace(f"{folder}{os.sep}", "")
        raise ValueError(text if str(path) in text else f"{path}: {text}") from error


@dataclass(frozen=True)
class _Connection:
    """What drives a connector."""

    source: Node
    then: Linear
    convert: bool


@dataclass
class _Reader:
    """What is found on the way down through inner systems."""

    path: Path
    files: SspFiles
    limits: ArchiveLimits | None
    parts: dict[str, Path] = field(default_factory=dict)
    descriptions: dict[str, FmuDescription] = field(default_factory=dict)
    kinds: dict[Node, str] = field(default_factory=dict)
    units: dict[Node, FmuUnit] = field(default_factory=dict)
    drivers: dict[Node, _Connection] = field(default_factory=dict)
    values: dict[str, SspValue] = field(default_factory=dict)
    dictionaries: dict[str, str] = field(default_factory=dict)  # reference -> the dictionary's own place
    defined: dict[str, FmuUnit] = field(default_factory=dict)  # units of the documents open now
    depth: int = 0

    def document(self, file: Path) -> tuple[etree._Element, etree._Element]:
        """Root and system of an .ssd file; its units are known from here on.

        Parameters
        ----------
        file : Path
        """
        root = self.files.structure(file)
        system = root.find("ssd:System", NAMESPACES)
        if system is None:
            raise ValueError(f"{self.path}: {file.name}: no System inside")
        self.defined = {**self.defined, **unit_definitions(root)}
        return root, system

    def system(self, prefix: str, element: etree._Element) -> None:
        """A system and all inside it.

        Parameters
        ----------
        prefix : str
            Its path; "" for the whole.
        element : lxml element
        """
        self._connectors(prefix, element)
        for entry in element.iterfind("ssd:SignalDictionaries/ssd:SignalDictionary", NAMESPACES):
            self.dictionaries[f"{prefix}:{entry.get('name')}"] = f"{prefix}:{entry.get('name')}"
        for child in element.findall("ssd:Elements/*", NAMESPACES):
            self.files.meet(1)
            tag = etree.QName(child).localname
            name = _joined(prefix, self._attribute(child, "name"))
            if tag == "System":
                self.system(name, child)
            elif tag == "Component":
                self._component(name, child)
            else:
                self._reference(prefix, name, child)
        for connection in element.findall("ssd:Connections/ssd:Connection", NAMESPACES):
            self._connection(prefix, connection)
        # Bindings of an outer system come later and win, as SSP wants it.
        self._bindings(prefix, element)

    def _attribute(self, element: etree._Element, name: str) -> str:
        value = element.get(name)
        if value is None:
            raise ValueError(
                f"{self.path}: a {etree.QName(element).localname} without the attribute {name!r}"
            )
        return value

    def _connectors(self, name: str, element: etree._Element) -> None:
        for connector in element.findall("ssd:Connectors/ssd:Connector", NAMESPACES):
            node = name, self._attribute(connector, "name")
            self.kinds[node] = self._attribute(connector, "kind")
            unit = next((child.get("unit") for child in connector if child.get("unit")), None)
            if unit is not None:
                known = self.defined.get(unit) or understood_unit(unit)
                self.units |= {node: known} if known is not None else {}

    def _component(self, name: str, element: etree._Element) -> None:
        kind = element.get("type")
        if kind not in (*FMU_TYPES, _DEFINITION, _PACKAGE):
            raise ValueError(f"{self.path}: {name}: component of type {kind!r}; expected an FMU or a system")
        file = self.files.within(self._attribute(element, "source"), name)
        if kind in FMU_TYPES:
            same = next((other for other, known in self.parts.items() if known == file), name)
            self.parts[name] = file
            self.descriptions[name] = self.descriptions.get(same) or describe(file, limits=self.limits)
        else:
            self._inner(name, file, packed=kind == _PACKAGE)
        self._connectors(name, element)
        self._bindings(name, element)

    def _inner(self, name: str, file: Path, *, packed: bool) -> None:
        """A system in a file of its own."""
        outer = self.files.folder, self.defined
        self.depth += 1
        if self.depth > _DEEPEST:
            raise ValueError(
                f"{self.path}: {name}: more than {_DEEPEST} packages or definitions within each other"
            )
        _, system = self.document(self.files.enter(file) if packed else file)
        self.system(name, system)
        self.files.folder, self.defined = outer
        self.depth -= 1

    def _reference(self, prefix: str, name: str, element: etree._Element) -> None:
        """A reference to a signal dictionary, which the systems around it declare."""
        wanted, at = self._attribute(element, "dictionary"), prefix
        while f"{at}:{wanted}" not in self.dictionaries and at:
            at = at.rpartition(".")[0]
        if f"{at}:{wanted}" not in self.dictionaries:
            raise ValueError(f"{self.path}: {name}: there is no signal dictionary {wanted!r}")
        self.dictionaries[name] = f"{at}:{wanted}"
        self._connectors(name, element)

    def _connection(self, prefix: str, element: etree._Element) -> None:
        nodes: list[Node] = []
        gives: list[bool | None] = []  # None: an entry of a dictionary, which does both
        for side in ("start", "end"):
            inner = element.get(f"{side}Element")
            owner = prefix if inner is None else _joined(prefix, inner)
            node = owner, self._attribute(element, f"{side}Connector")
            if node not in self.kinds:
                raise ValueError(
                    f"{self.path}: a connection names {_shown(node)!r}; there is no such connector"
                )
            if inner is not None and owner in self.dictionaries:
                gives.append(None)
                node = self.dictionaries[owner], node[1]
            else:
                gives.append(self._gives(node, inside=inner is None))
            nodes.append(node)
        if gives[0] is None:
            gives[0] = not gives[1]
        if gives[0] == gives[1]:
            both = "sources" if gives[0] else "sinks"
            raise ValueError(f"{self.path}: {_shown(nodes[0])!r} and {_shown(nodes[1])!r} are both {both}")
        source, sink = nodes if gives[0] else nodes[::-1]
        if sink in self.drivers:
            raise ValueError(f"{self.path}: {_shown(sink)!r} is driven twice")
        convert = element.get("suppressUnitConversion") not in ("true", "1")
        then = transformation(element, f"{self.path}: {_shown(sink)}")
        self.drivers[sink] = _Connection(source, then, convert)

    def _gives(self, node: Node, *, inside: bool) -> bool:
        """Whether a connector is a source; seen from inside, a system's own inputs are, and its outputs are sinks."""
        kind = self.kinds[node]
        if kind in _VALUES:
            return inside
        if kind not in ("input", "output"):
            raise ValueError(
                f"{self.path}: {_shown(node)!r}: connections of kind {kind!r} are not supported; expected input, "
                "output or parameter"
            )
        return kind == ("input" if inside else "output")

    def _unit(self, node: Node) -> FmuUnit | None:
        return self.units.get(node) or self._own_unit(node)

    def _own_unit(self, node: Node) -> FmuUnit | None:
        """Unit of the FMU's variable behind a connector."""
        entry = self.descriptions.get(node[0])
        for variable in entry.variables if entry is not None else ():
            if entry is not None and (node[1] == variable.name or node[1] in variable.labels):
                return entry.units.get(variable.unit) or understood_unit(variable.unit)
        return None

    def _traced(self, node: Node) -> tuple[Node, Linear, bool]:
        """Where a signal is made, what happens to it until it is the variable behind a node, and whether the units at
        the ends are still to be compared: where nothing was converted, or could not be."""
        chain: list[tuple[Node, _Connection]] = []
        at = node
        while at in self.drivers:
            chain.append((at, self.drivers[at]))
            at = self.drivers[at].source
            if any(at == seen for seen, _ in chain):
                raise ValueError(f"{self.path}: {_shown(at)!r} drives itself")
        total, compare = AS_IS, all(wire.convert for _, wire in chain)
        unit, changes = self._own_unit(at), list[Linear | None]()
        stages = [(self._unit(at), AS_IS, True)]
        stages += [(self._unit(sink), wire.then, wire.convert) for sink, wire in reversed(chain)]
        stages.append((self._own_unit(node), AS_IS, True))
        for target, then, convert in stages:
            change = conversion(unit, target) if convert else AS_IS
            changes.append(change)
            total = then.after((change or AS_IS).after(total))
            unit = target or unit
        return at, total, compare and (None in changes or all(change == AS_IS for change in changes))

    def _wire(self, node: Node) -> Wire | None:
        """Wire from where a signal is made to a node; None where nothing drives it."""
        at, total, compare = self._traced(node)
        if at == node or (at[0] not in self.parts and at[0] != ""):
            return None  # an inner system's input, or a dictionary's entry, that nothing drives
        # An input connector of the whole gets a leading dot, which no component's output has. Where units measure
        # different things the wire is left to `wire_up`, which says so.
        return Wire(".".join(node), ".".join(at), *total, convert=compare)

    def result(
        self,
        name: str,
        parts: Mapping[str, Fmu],
        system: etree._Element,
        experiment: etree._Element | None,
    ) -> SspPackage:
        """The whole package.

        Parameters
        ----------
        name : str
        parts : dict of str to Fmu
        system : lxml element
        experiment : lxml element or None
        """
        wires: list[Wire] = []
        inputs: dict[str, list[Wire]] = {
            label: [] for (owner, label), kind in self.kinds.items() if not owner and kind == "input"
        }
        for (owner, label), kind in self.kinds.items():
            if owner not in self.parts or kind != "input":
                continue
            wire = self._wire((owner, label))
            if wire is not None and wire.source.startswith("."):
                inputs[wire.source[1:]].append(dataclasses.replace(wire, source=""))
            elif wire is not None:
                wires.append(wire)
        outputs = self._outputs()
        times = (None if experiment is None else experiment.get(key) for key in ("startTime", "stopTime"))
        start, stop = (None if text is None else float(text) for text in times)
        self._named(system, inputs, outputs)
        whole = System(parts, wires, inputs=inputs, outputs=outputs, parameters=self._parameters())
        return SspPackage(name, whole, start, stop, read_geometry(system))

    def _parameters(self) -> dict[str, Scalar]:
        """Values of the FMUs' variables; those for names that no FMU has are ignored, as SSP wants it."""
        result: dict[str, Scalar] = {}
        for part, entry in self.descriptions.items():
            for variable in entry.variables:
                for label in dict.fromkeys((variable.name, *variable.labels)):
                    key = f"{part}.{label}"
                    if key in self.values:
                        result[key] = self.values[key].of(
                            self._own_unit((part, label)), f"{self.path}: {key}"
                        )
        for node, kind in self.kinds.items():
            if node[0] not in self.parts or kind not in _VALUES:
                continue
            source, total, _ = self._traced(node)
            found = self.values.get(".".join(source).removeprefix("."))
            if source == node or found is None:
                continue
            value = found.of(self._unit(source), f"{self.path}: {_shown(source)}")
            result[".".join(node)] = (
                value if total == AS_IS or isinstance(value, str) else total(float(value))
            )
        return result

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
        for node in [node for node, kind in self.kinds.items() if not node[0] and kind == "output"]:
            wire = self._wire(node)
            if wire is None:
                continue
            if wire.source.startswith(".") or (wire.gain, wire.offset) != (1.0, 0.0):
                raise ValueError(
                    f"{self.path}: output {node[1]!r}: expected a component's output as it is, without gain or another "
                    "unit"
                )
            result[node[1]] = wire.source
        return result

    # -- parameters -------------------------------------------------------------------------------------------

    def _bindings(self, owner: str, element: etree._Element) -> None:
        for binding in element.findall("ssd:ParameterBindings/ssd:ParameterBinding", NAMESPACES):
            root = self._document(owner, binding, "ssd:ParameterValues/ssv:ParameterSet")
            self.files.meet(1 if root is None else len(root.findall(".//ssv:Parameter", NAMESPACES)))
            values = {} if root is None else parameter_values(root, self.defined)
            mapping = self._mapping(owner, binding)
            if mapping is not None:
                values = {
                    target: dataclasses.replace(
                        values[source], then=then, unit=values[source].unit if convert else None
                    )
                    for target, (source, then, convert) in mapping.items()
                    if source in values
                }
            prefix = f"{owner}." if owner else ""
            self.values |= {
                f"{prefix}{binding.get('prefix', '')}{key}": value for key, value in values.items()
            }

    def _document(self, owner: str, binding: etree._Element, inside: str) -> etree._Element | None:
        source = binding.get("source")
        if source is None:
            return binding.find(inside, NAMESPACES)
        return self.files.parsed(self.files.within(source, owner or "the system"))

    def _mapping(self, owner: str, binding: etree._Element) -> dict[str, tuple[str, Linear, bool]] | None:
        holder = binding.find("ssd:ParameterMapping", NAMESPACES)
        if holder is None:
            return None
        root = self._document(owner, holder, "ssm:ParameterMapping")
        entries = [] if root is None else root.findall("ssm:MappingEntry", NAMESPACES)
        return {
            self._attribute(entry, "target"): (
                self._attribute(entry, "source"),
                transformation(entry, f"{self.path}: {owner}"),
                entry.get("suppressUnitConversion") not in ("true", "1"),
            )
            for entry in entries
        }


def _joined(prefix: str, name: str) -> str:
    return f"{prefix}.{name}" if prefix else name


def _shown(node: Node) -> str:
    return ".".join(node)
