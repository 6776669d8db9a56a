"""Geometry of packages of FMUs: written as the layout has it, read back, and drawn as others place it."""

import zipfile

import numpy as np
import pytest
from fmpy.ssp.ssd import read_ssd

import phyfilter_ctl as pf
from phyfilter_ctl.fmi import System, Wire, write_ssp
from phyfilter_ctl.fmi.ssp_read import read_package
from tests.drawing.checker import faults

VARIABLE = '<ScalarVariable name="{name}" valueReference="{k}" causality="{kind}"><Real{unit}{start}/></ScalarVariable>'
DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="{name}" guid="{name}">
<CoSimulation modelIdentifier="{name}"/>
<UnitDefinitions><Unit name="N"><BaseUnit kg="1" m="1" s="-2"/></Unit></UnitDefinitions>
<ModelVariables>{variables}</ModelVariables>
<ModelStructure><Outputs>{outputs}</Outputs></ModelStructure>
</fmiModelDescription>"""
PX = 96.0 / 25.4  # of a mm
WRITTEN = 0.02  # px: places have thousandths of a mm


def fmu(folder, name, inputs, outputs, unit=""):
    path = folder / f"{name}.fmu"
    said = f' unit="{unit}"' if unit else ""
    variables = [
        VARIABLE.format(name=label, k=k, kind=kind, unit=said, start=' start="0"' if kind == "input" else "")
        for k, (label, kind) in enumerate(
            [*((label, "input") for label in inputs), *((label, "output") for label in outputs)]
        )
    ]
    known = "".join(f'<Unknown index="{len(inputs) + k + 1}"/>' for k in range(len(outputs)))
    with zipfile.ZipFile(path, "w") as archive:
        text = DESCRIPTION.format(name=name, variables="".join(variables), outputs=known)
        archive.writestr("modelDescription.xml", text)
    return path


def random_package(folder, seed, parts):
    """Parts of one to three inputs and outputs, some of them vectors, wired at random, loops included."""
    rng = np.random.default_rng(seed)
    fmus, sources, sinks = {}, [], []
    for k in range(parts):
        ends = []
        for letter in "uy":
            names = [f"{letter}{n}" for n in range(int(rng.integers(1, 4)))]
            if rng.random() < 0.4:
                names[-1:] = [f"{letter}v[{n}]" for n in range(3)]
            ends.append(names)
        fmus[f"p{k}"] = fmu(folder, f"p{k}", *ends, unit="N" if rng.random() < 0.3 else "")
        sinks += [f"p{k}.{label}" for label in ends[0]]
        sources += [f"p{k}.{label}" for label in ends[1]]
    fed = rng.permutation(len(sinks))
    wires = [Wire(sinks[i], sources[int(rng.integers(len(sources)))]) for i in fed[: 2 * len(fed) // 3]]
    inputs = {f"r{n}": [sinks[i]] for n, i in enumerate(fed[2 * len(fed) // 3 :])}
    return fmus, wires, inputs, {"z0": sources[0], "z1": sources[-1]}


@pytest.mark.parametrize("seed", range(8))
def test_what_is_written_is_drawn_again_without_a_fault(tmp_path, seed):
    fmus, wires, inputs, outputs = random_package(tmp_path, seed, 2 + seed)
    path = write_ssp(System(fmus, wires, inputs=inputs, outputs=outputs), tmp_path / "x.ssp")
    read_ssd(str(path), validate=True)
    found = read_package(path)
    assert found.geometry is not None
    picture = pf.draw(path)
    assert faults(picture) == []
    assert {entry.name for entry in picture.nodes if entry.kind == "block"} == fmus.keys()
    drawn = {(entry.source, target) for entry in picture.wires for target in entry.targets}
    pairs = [(wire.source, wire.sink) for wire in wires]
    pairs += [(f"{label} (input).{label}", sink) for label, sinks in inputs.items() for sink in sinks]
    pairs += [(source, f"{label} (output).{label}") for label, source in outputs.items()]
    assert drawn == {(port(picture, source), port(picture, sink)) for source, sink in pairs}


def port(picture, label):
    """Node and port of a connector, ``part.label``."""
    part, _, name = label.partition(".")
    node = next(entry for entry in picture.nodes if entry.name == part)
    return part, next(entry.name for entry in node.ports if name in entry.labels)


def test_a_package_of_a_diagram_has_the_places_of_its_drawing(tmp_path):
    fmus = {"a": fmu(tmp_path, "a", ["u"], ["y"]), "b": fmu(tmp_path, "b", ["u"], ["y"])}
    wires = [Wire("b.u", "a.y"), Wire("a.u", "b.y")]
    path = write_ssp(System(fmus, wires, outputs={"z": "a.y"}), tmp_path / "x.ssp")
    given, own = (
        {entry.name: np.array(entry.box) for entry in pf.draw(path, **options).nodes}
        for options in ({}, {"outputs": "border"})
    )
    assert np.allclose(given["b"] - given["a"], own["b"] - own["a"], atol=WRITTEN)
    # Names of signals that stand in an annotation alone have no place: the layout draws them.
    write_ssp(System(fmus, wires, outputs={"z": "a.y"}), tmp_path / "y.ssp", system_connectors=False)
    found = read_package(tmp_path / "y.ssp")
    assert found.geometry is None
    assert "z (output)" in {entry.name for entry in pf.draw(tmp_path / "y.ssp").nodes}
    text = zipfile.ZipFile(tmp_path / "y.ssp").read("SystemStructure.ssd").decode()
    assert text.count("<ssd:ElementGeometry") == 2
    assert text.count("<ssd:ConnectionGeometry") == 2


FOREIGN = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"
  xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon" version="1.0" name="foreign">
  <ssd:System name="foreign">
    <ssd:Connectors>
      <ssd:Connector name="w" kind="input"><ssd:ConnectorGeometry x="0" y="0.75"/></ssd:Connector>
      <ssd:Connector name="v" kind="output"/>
    </ssd:Connectors>
    <ssd:Elements>
      <ssd:Component name="a" source="resources/a.fmu"><ssd:Connectors>
        <ssd:Connector name="u" kind="input"><ssd:ConnectorGeometry x="0" y="0.5"/></ssd:Connector>
        <ssd:Connector name="y" kind="output"><ssd:ConnectorGeometry x="1" y="0.25"/></ssd:Connector></ssd:Connectors>
        <ssd:ElementGeometry x1="{x1}" y1="20" x2="20" y2="40"/></ssd:Component>
      <ssd:Component name="b" source="resources/a.fmu"><ssd:Connectors>
        <ssd:Connector name="u" kind="input"><ssd:ConnectorGeometry x="0" y="0.5"/></ssd:Connector>
        <ssd:Connector name="y" kind="output"><ssd:ConnectorGeometry x="1" y="0.5"/></ssd:Connector></ssd:Connectors>
        <ssd:ElementGeometry x1="60" y1="0" x2="80" y2="40" rotation="{rotation}"/></ssd:Component>
      <ssd:System name="inner"><ssd:Connectors><ssd:Connector name="i" kind="input"/>
        <ssd:Connector name="o" kind="output"/></ssd:Connectors>
        <ssd:ElementGeometry x1="100" y1="0" x2="140" y2="20"/>
        <ssd:Elements><ssd:Component name="c" source="resources/a.fmu"><ssd:Connectors>
          <ssd:Connector name="u" kind="input"/></ssd:Connectors></ssd:Component></ssd:Elements>
        <ssd:Connections><ssd:Connection startConnector="i" endElement="c" endConnector="u"/></ssd:Connections>
      </ssd:System>
    </ssd:Elements>
    <ssd:Connections>
      <ssd:Connection startConnector="w" endElement="a" endConnector="u">{gain}</ssd:Connection>
      <ssd:Connection startElement="b" startConnector="u" endElement="a" endConnector="y">
        <ssd:ConnectionGeometry pointsX="{px}" pointsY="25 30"/></ssd:Connection>
      <ssd:Connection startElement="b" startConnector="y" endElement="inner" endConnector="i"/>
      <ssd:Connection startElement="b" startConnector="y" endConnector="v"/>
    </ssd:Connections>
    {canvas}
  </ssd:System>
</ssd:SystemStructureDescription>"""
CANVAS = '<ssd:SystemGeometry x1="0" y1="-10" x2="150" y2="60"/>'


def foreign(folder, **changes):
    """A package of another tool."""
    given = {"x1": "40", "rotation": "0", "px": "55 50", "gain": "", "canvas": CANVAS} | changes
    part = fmu(folder, "a", ["u"], ["y"], unit="N")
    path = folder / "foreign.ssp"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("SystemStructure.ssd", FOREIGN.format(**given))
        archive.write(part, "resources/a.fmu")
    return path


def places(picture):
    """In mm, x from the canvas' left and y up from its lower side, as its corner stands in the picture."""
    boxes = {entry.name: entry.box for entry in picture.nodes}
    ports = {(entry.name, port.name): (port.x, port.y) for entry in picture.nodes for port in entry.ports}
    x0, y0 = boxes["inner"][0] - 100 * PX, boxes["inner"][3]

    def mm(x, y):
        return round((x - x0) / PX, 2), round((y0 - y) / PX, 2)

    return (
        {name: (*mm(box[0], box[3]), *mm(box[2], box[1])) for name, box in boxes.items()},
        {key: mm(*at) for key, at in ports.items()},
        {wire.source: {mm(*at) for line in wire.lines for at in line} for wire in picture.wires},
    )


def test_a_package_of_others_is_drawn_as_it_says(tmp_path):
    picture = pf.draw(foreign(tmp_path))
    boxes, ports, lines = places(picture)
    # x1 > x2 is a mirrored component: its input is on the right.
    assert boxes["a"] == (20, 20, 40, 40)
    assert (ports["a", "u"], ports["a", "y"]) == ((40, 30), (20, 25))
    assert boxes["b"] == (60, 0, 80, 40)
    assert boxes["inner"] == (100, 0, 140, 20)
    assert ports["w (input)", "w"] == (0, 0.75 * 70 - 10)
    # Connectors without a place: inputs left, outputs right.
    assert (ports["inner", "i"], ports["inner", "o"]) == ((100, 10), (140, 10))
    assert ports["v (output)", "v"] == (150, 25)
    kinds = {entry.name: entry.kind for entry in picture.nodes}
    assert (kinds["a"], kinds["inner"]) == ("block", "diagram")
    # The connection is named from its sink: it begins at a's output, and its corners come the other way round.
    assert lines["a", "y"] >= {(20, 25), (50, 30), (60, 20)}
    # No waypoints: level, upright, level, half-way.
    assert {(90, 20), (90, 10)} <= lines["b", "y"]
    signals = {wire.signal: [text.text for text in wire.texts] for wire in picture.wires}
    assert signals["a.y"] == signals["b.y"] == ["[N]"]


def test_a_turned_component_has_its_connectors_turned_left_round(tmp_path):
    boxes, ports, _ = places(pf.draw(foreign(tmp_path, rotation="90")))
    assert boxes["b"] == (50, 10, 90, 30)
    assert (ports["b", "u"], ports["b", "y"]) == ((70, 10), (70, 30))


def test_small_boxes_are_drawn_larger_until_their_names_fit(tmp_path):
    small = FOREIGN.replace('x1="100" y1="0" x2="140" y2="20"', 'x1="100" y1="0" x2="102" y2="20"')
    path = foreign(tmp_path)
    with zipfile.ZipFile(path, "w") as archive:
        given = {"x1": "40", "rotation": "0", "px": "55 50", "gain": "", "canvas": CANVAS}
        archive.writestr("SystemStructure.ssd", small.format(**given))
        archive.write(tmp_path / "a.fmu", "resources/a.fmu")
    picture = pf.draw(path)
    inner = next(entry for entry in picture.nodes if entry.name == "inner")
    assert inner.box[2] - inner.box[0] >= 50.0  # px: of the smallest block
    assert picture.width <= 6100.0


@pytest.mark.parametrize(
    "changes",
    [
        {"x1": "NaN"}, {"x1": "20"}, {"x1": "1e300"}, {"rotation": "INF"}, {"px": "55"}, {"px": "55 NaN"},
        {"gain": '<ssc:LinearTransformation factor="2"/>'},
        {"canvas": '<ssd:SystemGeometry x1="0" y1="0" x2="-10" y2="60"/>'},
    ],
    ids=str,
)  # fmt: skip
def test_places_that_cannot_be_drawn_are_left_to_the_layout(tmp_path, changes):
    path = foreign(tmp_path, **changes)
    found = read_package(path)
    assert found.geometry is None
    assert {"a", "b", "inner.c"} <= {entry.name for entry in pf.draw(path).nodes}


def test_without_a_canvas_it_is_what_the_elements_take(tmp_path):
    found = read_package(foreign(tmp_path, canvas=""))
    assert found.geometry is not None
    assert found.geometry.canvas == (20, 0, 140, 40)


def test_entries_of_one_vector_at_two_places_are_two_terminals(tmp_path):
    part = fmu(tmp_path, "a", [f"u[{k}]" for k in range(4)], ["y"])
    places = {0: 0.8, 1: 0.8, 2: 0.2, 3: 0.2}
    ends = "".join(
        f'<ssd:Connector name="r[{k}]" kind="input"><ssd:ConnectorGeometry x="0" y="{y}"/></ssd:Connector>'
        for k, y in places.items()
    )
    head, _, _ = FOREIGN.partition("<ssd:Connectors>")
    text = f"""{head}<ssd:Connectors>{ends}</ssd:Connectors><ssd:Elements>
      <ssd:Component name="a" source="resources/a.fmu"><ssd:Connectors>{ends.replace("r[", "u[")}</ssd:Connectors>
      <ssd:ElementGeometry x1="40" y1="0" x2="80" y2="60"/></ssd:Component></ssd:Elements><ssd:Connections>
      {"".join(f'<ssd:Connection startConnector="r[{k}]" endElement="a" endConnector="u[{k}]"/>' for k in range(4))}
      </ssd:Connections><ssd:SystemGeometry x1="0" y1="0" x2="100" y2="60"/></ssd:System>
      </ssd:SystemStructureDescription>"""
    path = tmp_path / "two.ssp"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("SystemStructure.ssd", text)
        archive.write(part, "resources/a.fmu")
    picture = pf.draw(path)
    assert [entry.name for entry in picture.nodes] == ["r (input)", "r (input) 2", "a"]
    assert {(wire.source[0], wire.targets, wire.size) for wire in picture.wires} == {
        ("r (input)", (("a", "u"),), 2),
        ("r (input) 2", (("a", "u 2"),), 2),
    }
