"""System structure packages: diagrams cut into parts, packages written, read, and run by others."""

import zipfile

import control as ct
import lxml.etree as etree
import numpy as np
import pytest
from fmpy.ssp.simulation import simulate_ssp
from fmpy.ssp.ssd import read_ssd, read_ssv
from foreign_fmus import description, oscillator

from phyfilter_ctl.fmi import (
    ArchiveLimits,
    Master,
    System,
    Wire,
    cosimulate,
    cut_diagram,
    read_ssp,
    write_ssp,
)
from phyfilter_ctl.fmi.ssp_read import read_package
from phyfilter_ctl.fmi.ssp_values import NAMESPACES, parameter_values

T = np.linspace(0.0, 2.0, 21)
U = np.array([np.ones_like(T), np.sin(T)])
ORDER_ONE = 0.15
SPLITS = {
    "blocks": None,
    "two": {"plant": ["plant"], "rest": ["controller", "lowpass"]},
    "crossed": {"one": ["lowpass", "plant"], "controller": ["controller"]},
    "whole": {"all": ["plant", "controller", "lowpass"]},
}
WIRES = [Wire("a.place", "b.x")]


def diagram():
    """Sums, gains, direct feedthrough, a nonlinear plant, outputs that are sums and inputs."""
    plant = ct.nlsys(
        lambda t, x, u, p: np.array([x[1], -p.get("k", 4.0) * np.sin(x[0]) - 0.3 * x[1] + u[0]]),
        lambda t, x, u, p: x,
        inputs=["f"],
        outputs=["q", "v"],
        states=["q", "v"],
        params={"k": 4.0},
        name="plant",
    )
    controller = ct.ss(
        [[-5.0]],
        [[1.0, 0.0]],
        [[2.0], [0.0]],
        [[3.0, 1.0], [1.0, 0.0]],
        inputs=["e", "w"],
        outputs=["u", "m"],
        name="controller",
    )
    lowpass = ct.tf([1], [0.1, 1], inputs="y", outputs="yf", name="lowpass")
    return ct.interconnect(
        [plant, controller, lowpass],
        connections=[
            ["plant.f", "controller.u", "-lowpass.yf"],
            ["controller.e", "-plant.q", "-lowpass.yf"],
            ["lowpass.y", "plant.v"],
        ],
        inplist=["controller.e", ["controller.w", "plant.f"]],
        inputs=["ref", "w"],
        outlist=["plant.q", ["plant.v", "-plant.q"], "controller.u", "plant.f"],
        outputs=["q", "mix", "u", "f"],
        name="loop",
        check_unused=False,
    )


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    return oscillator(tmp_path_factory.mktemp("foreign"))


@pytest.mark.slow
@pytest.mark.parametrize("name", SPLITS)
def test_parts_converge_to_the_diagram(name):
    system = diagram()
    monolith = ct.input_output_response(
        system, T, U, [0.5, 0.0, 0.0, 0.0], solve_ivp_kwargs={"rtol": 1e-10, "atol": 1e-12}
    )
    cut = cut_diagram(system, SPLITS[name])
    start = {name: np.zeros(part.nstates) for name, part in cut.parts.items()}
    for name, part in cut.parts.items():
        start[name][[label.endswith("plant_q") for label in part.state_labels]] = 0.5
    errors = []
    for step in (0.01, 0.005):
        found = cosimulate(cut, T, inputs={"ref": U[0], "w": U[1]}, initial_state=start, master=Master(step))
        assert found.output_labels == ["q", "mix", "u", "f"]
        errors.append(float(np.max(np.abs(found.outputs - monolith.outputs))))
    assert errors[0] < 0.02
    assert abs(errors[0] / errors[1] - 2.0) < ORDER_ONE


def test_names_of_connectors():
    cut = cut_diagram(diagram(), SPLITS["two"])
    assert cut.parts["plant"].input_labels == ["controller_u", "lowpass_yf", "w"], (
        "summands are named as their sources"
    )
    assert cut.parts["rest"].input_labels == ["plant_q", "ref", "controller_w", "lowpass_y"]
    assert cut.parts["rest"].params == {}
    assert cut.parts["plant"].params == {"k": 4.0}
    assert cut.inputs == {"ref": ("rest.ref",), "w": ("plant.w", "rest.controller_w")}
    assert cut.outputs["mix"] == "plant.mix"


@pytest.mark.parametrize(
    ("split", "message"),
    [
        ({"plant": ["plant"]}, "no part holds controller, lowpass"),
        ({"plant": ["plant", "motor"]}, "names 'motor'; the diagram has the blocks"),
        ({"a": ["plant", "controller"], "b": ["plant", "lowpass"]}, "'plant' is in 'a' and in 'b'"),
        ({"plant": "plant"}, "expected a list of block names"),
    ],
)
def test_wrong_splits(split, message):
    with pytest.raises(ValueError, match=message):
        cut_diagram(diagram(), split)


def test_what_cannot_be_cut():
    with pytest.raises(TypeError, match="expected an interconnected system"):
        cut_diagram(ct.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]]))  # type: ignore[arg-type]  # the error is the point
    a, b = (ct.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]], name=name, inputs="u", outputs="y") for name in "ab")
    summed = ct.interconnect([a, b], connections=False, inplist=["a.u", "b.u"], outlist=[["a.y", "b.y"]])
    with pytest.raises(ValueError, match=r"sums signals of the parts \['a', 'b'\]"):
        cut_diagram(summed)


def package(path, fmu, **options):
    given = {
        "inputs": {"where": ["b.place"]},
        "outputs": {"xa": "a.x", "xb": "b.x"},
        "parameters": {"b.k": 20.0},
        "stop_time": 2.0,
    } | options
    own = {name: given.pop(name) for name in ("inputs", "outputs", "parameters")}
    return write_ssp(System({"a": fmu, "b": fmu}, WIRES, **own), path, **given)


def test_written_and_read(tmp_path, fmu):
    path = package(tmp_path / "two.ssp", fmu)
    found = read_package(path)
    assert found.wires == tuple(WIRES)
    assert {key: [w.sink for w in wires] for key, wires in found.system.inputs.items()} == {
        "where": ["b.place"]
    }
    assert found.system.outputs == {"xa": "a.x", "xb": "b.x"}
    assert (found.system.parameters["b.k"], found.system.parameters["a.k"]) == (20.0, 8.0)
    assert (found.start_time, found.stop_time) == (0.0, 2.0)
    packed = cosimulate(path, T, inputs={"where": U[1]}, master=Master(0.01))
    loose = cosimulate(
        System({"a": fmu, "b": fmu}, [("a.place", "b.x")]),
        T,
        inputs={"b.place": U[1]},
        outputs=["a.x", "b.x"],
        parameters={"b.k": 20.0},
        master=Master(0.01),
    )
    assert packed.output_labels == ["xa", "xb"]
    assert np.array_equal(packed.outputs, loose.outputs)
    stiffer = cosimulate(path, T, inputs={"where": U[1]}, parameters={"b.k": 8.0}, master=Master(0.01))
    assert not np.array_equal(stiffer.outputs, packed.outputs), "what the caller says wins over the package"


def test_run_by_fmpy(tmp_path, fmu):
    """Another importer on the same package: both first order, so they meet as the step shrinks."""
    path = package(tmp_path / "two.ssp", fmu)
    values = read_ssv(str(path), resource="resources/parameters.ssv")
    differences = []
    for step in (0.01, 0.005):
        theirs = simulate_ssp(
            str(path),
            stop_time=2.0,
            step_size=step,
            parameter_set=values,
            input={"where": lambda t: np.sin(t)},
        )
        times = step * np.arange(len(theirs) + 1)
        ours = cosimulate(path, timepts=times, inputs={"where": np.sin})
        # fmpy notes with each row the time at which its step began.
        difference = [
            np.max(np.abs(theirs[name] - ours.outputs[i, 1:])) for i, name in enumerate(("xa", "xb"))
        ]
        differences.append(max(difference))
    assert differences[0] < 0.1
    assert abs(differences[0] / differences[1] - 2.0) < ORDER_ONE


def test_valid_and_reproducible(tmp_path, fmu):
    first = package(tmp_path / "a.ssp", fmu)
    second = package(tmp_path / "b.ssp", fmu)
    assert first.read_bytes() == second.read_bytes()
    assert read_ssd(str(first), validate=True).system.name == "system"
    assert read_ssv(str(first), resource="resources/parameters.ssv", validate=True).parameters
    bare = package(tmp_path / "c.ssp", fmu, inputs={}, outputs={}, stop_time=None)
    assert read_ssd(str(bare), validate=True).system.connectors == []
    run = cosimulate(bare, timepts=T, inputs={"b.place": 0.1}, outputs=["a.x"])
    assert run.outputs.shape == (1, len(T))


def test_what_cannot_be_written(tmp_path, fmu):
    with pytest.raises(ValueError, match=r"expected a file that ends in .ssp"):
        package(tmp_path / "x.zip", fmu)
    with pytest.raises(ValueError, match=r"'a.place' is driven twice"):
        package(tmp_path / "x.ssp", fmu, inputs={"where": ["a.place"]})
    with pytest.raises(ValueError, match=r"'a.q' is not an output of a component"):
        package(tmp_path / "x.ssp", fmu, outputs={"q": "a.q"})
    with pytest.raises(ValueError, match=r"parameters: 'b.q' is none"):
        package(tmp_path / "x.ssp", fmu, parameters={"b.q": 1.0})
    assert not list(tmp_path.iterdir())


SSD = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"
  xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"
  xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues"
  xmlns:ssm="http://ssp-standard.org/SSP1/SystemStructureParameterMapping" version="1.0" name="nested">
  <ssd:System name="nested">
    <ssd:Connectors><ssd:Connector name="where" kind="input"/><ssd:Connector name="out" kind="output"/></ssd:Connectors>
    <ssd:Elements>
      <ssd:Component name="a" source="resources/m.fmu">
        <ssd:Connectors><ssd:Connector name="place" kind="input"/>
          <ssd:Connector name="x" kind="output"/></ssd:Connectors>
        <ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues><ssv:ParameterSet version="1.0" name="p">
          <ssv:Parameters><ssv:Parameter name="k"><ssv:Real value="5.0"/></ssv:Parameter>
          <ssv:Parameter name="unknown"><ssv:Real value="5.0"/></ssv:Parameter>
          <ssv:Parameter name="softness"><ssv:Real value="2.0"/></ssv:Parameter></ssv:Parameters>
        </ssv:ParameterSet></ssd:ParameterValues>{mapping}</ssd:ParameterBinding></ssd:ParameterBindings>
      </ssd:Component>
      <ssd:System name="inner">
        <ssd:Connectors><ssd:Connector name="u" kind="input"/><ssd:Connector name="y" kind="output"/></ssd:Connectors>
        <ssd:Elements><ssd:Component name="b" source="{source}"><ssd:Connectors>
          <ssd:Connector name="place" kind="input"/><ssd:Connector name="x" kind="output"/></ssd:Connectors>
        </ssd:Component></ssd:Elements>
        <ssd:Connections>
          <ssd:Connection startConnector="u" endElement="b" endConnector="place">
            <ssc:LinearTransformation factor="3" offset="0.5"/></ssd:Connection>
          <ssd:Connection startConnector="y" endElement="b" endConnector="x"/>
        </ssd:Connections>
      </ssd:System>
    </ssd:Elements>
    <ssd:Connections>
      <ssd:Connection startElement="a" startConnector="place" endConnector="where"/>
      <ssd:Connection startElement="a" startConnector="x" endElement="inner" endConnector="u">
        <ssc:LinearTransformation factor="2" offset="0.1"/></ssd:Connection>
      <ssd:Connection startElement="inner" startConnector="y" endConnector="out"/>{extra}
    </ssd:Connections>
  </ssd:System>
</ssd:SystemStructureDescription>"""
MAPPING = """<ssd:ParameterMapping><ssm:ParameterMapping version="1.0">
<ssm:MappingEntry source="softness" target="k"><ssc:LinearTransformation factor="-1" offset="9"/></ssm:MappingEntry>
</ssm:ParameterMapping></ssd:ParameterMapping>"""


def foreign(path, fmu, *, source="resources/m.fmu", mapping="", extra=""):
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("SystemStructure.ssd", SSD.format(source=source, mapping=mapping, extra=extra))
        archive.write(fmu, "resources/m.fmu")
    return path


def test_a_foreign_package_with_inner_systems(tmp_path, fmu):
    """Connections either way round, transformations in a chain, inline bindings, a mapping."""
    found = read_package(foreign(tmp_path / "x.ssp", fmu))
    assert list(found.system.parts) == ["a", "inner.b"]
    (wire,) = found.wires
    assert (wire.sink, wire.source) == ("inner.b.place", "a.x")
    assert (wire.gain, wire.offset) == (pytest.approx(6.0), pytest.approx(0.8))
    assert found.system.parameters == {"a.k": 5.0}
    assert found.system.outputs == {"out": "inner.b.x"}
    found = read_package(foreign(tmp_path / "y.ssp", fmu, mapping=MAPPING))
    assert found.system.parameters == {"a.k": 7.0}
    run = cosimulate(tmp_path / "x.ssp", T, inputs={"where": 0.3}, master=Master(0.01))
    loose = cosimulate(
        System({"a": fmu, "b": fmu}, [Wire("b.place", "a.x", 6.0, 0.8)]),
        T,
        inputs={"a.place": 0.3},
        outputs=["b.x"],
        parameters={"a.k": 5.0},
        master=Master(0.01),
    )
    assert np.allclose(run.outputs, loose.outputs, atol=1e-12)


def test_units_are_converted(tmp_path, fmu):
    """SSP has the importer do it: millimetres on one side."""
    text = description(unit="mm").replace(
        '<Unit name="N">', '<Unit name="mm"><BaseUnit m="1" factor="0.001"/></Unit><Unit name="N">'
    )
    small = tmp_path / "small.fmu"
    with zipfile.ZipFile(fmu) as source, zipfile.ZipFile(small, "w") as target:
        for name in source.namelist():
            target.writestr(name, text if name == "modelDescription.xml" else source.read(name))
    path = write_ssp(System({"a": fmu, "b": small}, [Wire("b.place", "a.x")]), tmp_path / "x.ssp")
    found = read_package(path)
    assert found.wires[0].gain == pytest.approx(1000.0)
    with pytest.raises(ValueError, match="differ by a factor of 1000"):
        cosimulate(System({"a": fmu, "b": small}, [("b.place", "a.x")]), T)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"source": "../outside.fmu"}, "expected a file inside the package"),
        ({"source": "resources/%2e%2e/%2e%2e/outside.fmu"}, "expected a file inside the package"),
        ({"source": "file:///etc/passwd"}, "expected a file inside the package"),
        ({"source": "resources/none.fmu"}, "expected a file inside the package"),
        ({"source": "x" * 100_000}, "expected a file inside the package"),
        (
            {"extra": '<ssd:Connection startElement="a" startConnector="q" endConnector="out"/>'},
            "'a.q'; there is no such connector",
        ),
        (
            {"extra": '<ssd:Connection startElement="a" startConnector="x" endConnector="out"/>'},
            "out' is driven twice",
        ),
        (
            {"extra": '<ssd:Connection startElement="a" startConnector="x" endConnector="where"/>'},
            "are both sources",
        ),
        ({"extra": "<ssd:Nonsense/>"}, "SystemStructure.ssd is not valid"),
    ],
)
def test_packages_that_are_refused(tmp_path, fmu, options, message):
    path = foreign(tmp_path / "x.ssp", fmu, **options)
    with pytest.raises(ValueError, match=message):
        cosimulate(path, timepts=T)


def around(path, entries, sources, kind="application/x-ssp-package"):
    """A package with components c0, c1, ... of these sources, which hold systems."""
    head = SSD[: SSD.index("<ssd:System ")]
    components = "".join(
        f'<ssd:Component name="c{i}" type="{kind}" source="{s}"/>' for i, s in enumerate(sources)
    )
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in entries.items():
            archive.writestr(name, data)
        archive.writestr(
            "SystemStructure.ssd",
            f'{head}<ssd:System name="s"><ssd:Elements>{components}</ssd:Elements></ssd:System>'
            "</ssd:SystemStructureDescription>",
        )
    return path


def test_a_package_used_twice(tmp_path, fmu):
    inner = foreign(tmp_path / "inner.ssp", fmu)
    path = around(tmp_path / "x.ssp", {"inner.ssp": inner.read_bytes()}, ["inner.ssp", "inner.ssp"])
    found = read_package(path)
    assert list(found.system.parts) == ["c0.a", "c0.inner.b", "c1.a", "c1.inner.b"]
    assert {wire.sink for wire in found.wires} == {"c0.inner.b.place", "c1.inner.b.place"}


def test_packages_without_end(tmp_path, fmu):
    """A definition inside itself; a few that each use the next one ten times; names by the million."""
    kind = "application/x-ssp-definition"
    circle = around(tmp_path / "a.ssp", {}, ["SystemStructure.ssd"], kind)
    with pytest.raises(ValueError, match="more than 16 packages or definitions within each other"):
        read_ssp(circle)
    text = (
        zipfile.ZipFile(around(tmp_path / "b.ssp", {}, ["NEXT"] * 10, kind))
        .read("SystemStructure.ssd")
        .decode()
    )
    levels = {f"{k}.ssd": text.replace("NEXT", f"{k + 1}.ssd") for k in range(9)} | {
        "9.ssd": text[: text.index("<ssd:Elements>")] + text[text.index("</ssd:System>") :]
    }
    tree = around(tmp_path / "c.ssp", levels, ["0.ssd"], kind)
    few = ArchiveLimits(scalars=100)
    with pytest.raises(ValueError, match="more than 100 elements and parameter values"):
        read_ssp(tree, limits=few)
    text = SSD.replace(
        '<ssv:Real value="5.0"/>', '<ssv:Real value="5.0"/><ssc:Dimension size="999999999"/>', 1
    )
    with pytest.raises(ValueError, match=r"parameter 'k': 0 values for dimensions \[999999999\]"):
        parameter_values(etree.fromstring(text.encode()).find(".//ssv:ParameterSet", NAMESPACES), {})


def test_no_package(tmp_path, fmu):
    with pytest.raises(ValueError, match=r"no SystemStructure.ssd inside"):
        cosimulate(fmu, timepts=T)
    bomb = tmp_path / "x.ssp"
    with zipfile.ZipFile(bomb, "w") as archive:
        archive.writestr("SystemStructure.ssd", '<!DOCTYPE x [<!ENTITY a "b">]><x/>')
    with pytest.raises(ValueError, match="declares a document type"):
        cosimulate(bomb, timepts=T)


def test_the_schema_is_the_standards(tmp_path, fmu):
    with zipfile.ZipFile(package(tmp_path / "x.ssp", fmu)) as archive:
        root = etree.fromstring(archive.read("SystemStructure.ssd"))
    assert root.tag == "{http://ssp-standard.org/SSP1/SystemStructureDescription}SystemStructureDescription"
    units = [
        unit.get("name") for unit in root.iter("{http://ssp-standard.org/SSP1/SystemStructureCommon}Unit")
    ]
    assert units == ["m"]


SECOND = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"
  xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"
  xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues" version="{version}" name="second">
  <ssd:System name="second">
    <ssd:Connectors><ssd:Connector name="where" kind="input"><ssc:Float64 unit="mm"/></ssd:Connector>
      <ssd:Connector name="stiffness" kind="parameter"><ssc:Float64 unit="N/mm"/></ssd:Connector></ssd:Connectors>
    <ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues><ssv:ParameterSet version="2.0" name="p">
      <ssv:Parameters><ssv:Parameter name="stiffness"><ssv:Float64 value="0.005" unit="N/mm"/></ssv:Parameter>
      <ssv:Parameter name="a.m"><ssv:Float64 value="2500" unit="g"/></ssv:Parameter>
      <ssv:Parameter name="c.x"><ssv:Float64><ssv:Value value="3"/><ssv:Value value="4"/></ssv:Float64>
        <ssc:Dimension size="2"/></ssv:Parameter></ssv:Parameters>
      <ssv:Units><ssc:Unit name="g"><ssc:BaseUnit kg="1" factor="0.001"/></ssc:Unit></ssv:Units>
    </ssv:ParameterSet></ssd:ParameterValues></ssd:ParameterBinding></ssd:ParameterBindings>
    <ssd:Elements>
      <ssd:Component name="a" source="resources/m.fmu"><ssd:Connectors>
        <ssd:Connector name="place" kind="input"/><ssd:Connector name="k" kind="parameter"/>
        <ssd:Connector name="x" kind="output"><ssc:Float64 unit="cm"/></ssd:Connector></ssd:Connectors>
      </ssd:Component>
      <ssd:Component name="c" source="resources/two.fmu"><ssd:Connectors>
        <ssd:Connector name="place[0]" kind="input"/><ssd:Connector name="place[1]" kind="input"/></ssd:Connectors>
      </ssd:Component>
      <ssd:Component name="inner" type="application/x-ssp-definition" source="inner.ssd"/>
      <ssd:SignalDictionaryReference name="bus" dictionary="signals"><ssd:Connectors>
        <ssd:Connector name="x" kind="inout"/></ssd:Connectors></ssd:SignalDictionaryReference>
      <ssd:SignalDictionaryReference name="again" dictionary="signals"><ssd:Connectors>
        <ssd:Connector name="x" kind="inout"/></ssd:Connectors></ssd:SignalDictionaryReference>
    </ssd:Elements>
    <ssd:Connections>
      <ssd:Connection startConnector="where" endElement="a" endConnector="place"/>
      <ssd:Connection startConnector="stiffness" endElement="a" endConnector="k"/>
      <ssd:Connection startElement="a" startConnector="x" endElement="bus" endConnector="x">
        <ssc:LinearTransformation factor="2" offset="1"/></ssd:Connection>
      <ssd:Connection startElement="again" startConnector="x" endElement="c" endConnector="place[1]"/>
      <ssd:Connection startElement="again" startConnector="x" endElement="inner" endConnector="u"/>
    </ssd:Connections>
    <ssd:SignalDictionaries><ssd:SignalDictionary name="signals"/></ssd:SignalDictionaries>
  </ssd:System>
</ssd:SystemStructureDescription>"""
INNER = """<ssd:SystemStructureDescription xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"
  version="2.0" name="inner"><ssd:System name="any">
    <ssd:Connectors><ssd:Connector name="u" kind="input"/></ssd:Connectors>
    <ssd:Elements><ssd:Component name="b" source="resources/m.fmu"><ssd:Connectors>
      <ssd:Connector name="place" kind="input"/></ssd:Connectors></ssd:Component></ssd:Elements>
    <ssd:Connections><ssd:Connection startConnector="u" endElement="b" endConnector="place"/></ssd:Connections>
</ssd:System></ssd:SystemStructureDescription>"""


@pytest.fixture(scope="module")
def second(fmu, tmp_path_factory):
    folder = tmp_path_factory.mktemp("second")
    two = oscillator(folder, "3.0", name="two")

    def write(name="second.ssp", version="2.0", text=SECOND):
        with zipfile.ZipFile(folder / name, "w") as archive:
            archive.writestr("SystemStructure.ssd", text.replace("{version}", version))
            archive.writestr("inner.ssd", INNER)
            archive.writestr("stray.ssd", "<not well formed")
            archive.write(fmu, "resources/m.fmu")
            archive.write(two, "resources/two.fmu")
        return folder / name

    return write


def test_version_2(second):
    """Types of FMI 3, units at connectors, parameter connectors, arrays, a signal dictionary, a system in a file of
    its own; a stray file that is no XML harms nobody."""
    found = read_package(second())
    assert list(found.system.parts) == ["a", "c", "inner.b"]
    wires = {wire.sink: wire for wire in found.wires}
    # x in m, shown in cm; 2 x + 1 in the unit of the dictionary's entry, which has none: cm; then back into m.
    for sink in ("c.place[1]", "inner.b.place"):
        assert wires[sink].source == "a.x"
        assert (wires[sink].gain, wires[sink].offset) == (pytest.approx(2.0), pytest.approx(0.01))
    (where,) = found.system.inputs["where"]
    assert (where.sink, where.gain) == ("a.place", pytest.approx(1e-3))
    assert found.system.parameters == {
        "a.k": pytest.approx(5.0),
        "a.m": pytest.approx(2.5),
        "c.x[0]": 3.0,
        "c.x[1]": 4.0,
    }
    run = cosimulate(second(), T, inputs={"where": 300.0}, outputs=["a.x"], master=Master(0.1))
    assert run.success


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('version="{version}"', 'version="3.0"', r"of version '3.0'; expected 1.0 or 2.0"),
        ('<ssd:Component name="a"', "<ssd:Component", "a Component without the attribute 'name'"),
        ('dictionary="signals"', 'dictionary="none"', "bus: there is no signal dictionary 'none'"),
        ('unit="g"', 'unit="s"', "a.m: the unit of the value and that of the parameter measure different things"),
        ('kind="parameter"/>', 'kind="calculatedParameter"/>', "'calculatedParameter' are not supported"),
        ('source="inner.ssd"', 'source="stray.ssd"', "stray.ssd: not a well-formed XML document"),
    ],
)  # fmt: skip
def test_what_is_refused_in_version_2(second, old, new, message):
    assert old in SECOND
    with pytest.raises(ValueError, match=message):
        cosimulate(second("wrong.ssp", text=SECOND.replace(old, new)), timepts=T)
