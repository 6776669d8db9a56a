"""Textbook loops drawn: where blocks stand, what is written, what wires are called, and what is refused."""

import zipfile
from xml.etree import ElementTree

import control as ct
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.drawing import Drawing
from phyfilter_ctl.filter import stack
from phyfilter_ctl.fmi import System, Wire, describe, write_ssp

LEVEL = 1e-6  # px: what rounding in the layout leaves of a straight line


def tf(name, numerator, denominator, u, y):
    return ct.tf(numerator, denominator, name=name, inputs=u, outputs=y)


def total(name, terms, y, **options):
    return ct.summing_junction(terms, y, name=name, **options)


PI = tf("PI", [2.0, 1.0], [1.0, 0.0], "e", "u")
PLANT = tf("plant", [4.0], [1.0, 2.0], "u", "y")


def pi_loop():
    return ct.interconnect([total("error", ["r", "-y"], "e"), PI, PLANT], inputs="r", outputs="y", name="pi")


def sensor_loop():
    blocks = [
        total("error", ["r", "-y_m"], "e"),
        PI,
        total("load", ["u", "d"], "u_d"),
        tf("plant", [4.0], [1.0, 2.0], "u_d", "y"),
        tf("sensor", [100.0], [1.0, 100.0], "y", "y_m"),
    ]
    return ct.interconnect(blocks, inputs=["r", "d"], outputs=["y", "u"], name="sensor_loop")


def nested():
    inside = ct.interconnect(
        [tf("lead", [1.0, 1.0], [0.1, 1.0], "e", "v"), tf("K_p", [3.0], [1.0], "v", "u")],
        inputs="e",
        outputs="u",
        name="controller",
    )
    return ct.interconnect(
        [total("error", ["r", "-y"], "e"), inside, PLANT], inputs="r", outputs="y", name="outer"
    )


def node(picture, name):
    return next(entry for entry in picture.nodes if entry.name == name)


def port(picture, name, direction="out"):
    return next(entry for entry in node(picture, name).ports if entry.direction == direction)


def wire(picture, signal):
    return next(entry for entry in picture.wires if entry.signal == signal)


def middle(entry):
    return (entry.box[0] + entry.box[2]) / 2, (entry.box[1] + entry.box[3]) / 2


def written(picture):
    return [text.text for entry in (*picture.nodes, *picture.wires) for text in entry.texts]


def test_the_forward_path_is_one_straight_line_and_feedback_lies_below():
    picture = pf.draw(pi_loop())
    heights = [port(picture, name).y for name in ("r (input)", "error", "PI", "plant")]
    assert np.ptp(heights) < LEVEL
    places = [middle(node(picture, name))[0] for name in ("r (input)", "error", "PI", "plant", "y (output)")]
    assert places == sorted(places)
    lowest = max(y for line in wire(picture, "plant.y").lines for _, y in line)
    assert lowest > max(entry.box[3] for entry in picture.nodes)
    sides = {(entry.sign, entry.side) for entry in node(picture, "error").ports if entry.direction == "in"}
    assert sides == {(1, "W"), (-1, "S")}


def test_a_sensor_stands_mirrored_below_and_the_load_enters_from_above():
    picture = pf.draw(sensor_loop())
    sensor, plant = node(picture, "sensor"), node(picture, "plant")
    assert sensor.box[1] > plant.box[3]
    assert port(picture, "sensor", "in").side == "E"
    assert port(picture, "sensor").side == "W"
    assert not wire(picture, "sensor.y_m").forward
    assert [p.side for p in node(picture, "load").ports if p.direction == "in"] == ["W", "N"]
    left, right = (
        middle(node(picture, "error"))[0],
        max(x for line in wire(picture, "plant.y").lines for x, _ in line),
    )
    assert left + 60 < middle(sensor)[0] < right - 60


@pytest.mark.parametrize("build", [pi_loop, sensor_loop, nested])
def test_maps_are_read_back(build):
    system = build()
    connect, inputs, outputs = pf.draw(system).maps
    blocks = system.connect_map.shape[1]
    driven = np.hstack([system.connect_map, system.input_map])
    shown = np.asarray(system.output_map, float)
    expected = np.hstack([shown[:, :blocks], np.zeros((len(shown), system.ninputs))])
    expected = expected + shown[:, blocks:] @ driven if shown.shape[1] > blocks else expected
    np.testing.assert_array_equal(connect, system.connect_map)
    np.testing.assert_array_equal(inputs, system.input_map)
    np.testing.assert_array_equal(outputs, expected)


def test_sums_and_gains_that_are_on_wires_alone():
    wires = [["plant.u", ("C", "u", 2.0), "-F.y"], ["F.u", "plant.y"]]
    blocks = [tf("C", [1.0], [1.0, 0.0], "e", "u"), PLANT, tf("F", [1.0], [1.0, 1.0], "u", "y")]
    system = ct.interconnect(
        blocks, connections=[*wires, ["C.e", "-plant.y"]], inplist=["C.e"], outlist=["plant.y"]
    )
    picture = pf.draw(system)
    kinds = [entry.kind for entry in picture.nodes if not any(p.labels for p in entry.ports)]
    assert sorted(kinds) == ["gain", "sum", "sum"]
    assert "2" in [text.text for text in node(picture, "gain 1").texts]
    np.testing.assert_array_equal(picture.maps[0], system.connect_map)


@pytest.mark.parametrize("depth", [0, 1])
def test_wires_have_the_names_that_margins_take(depth):
    system = nested()
    picture = pf.draw(system, depth)
    assert "controller.K_p.u" in picture.signals
    for signal in picture.signals:
        assert pf.margins(system, at=signal).gain_margin[1] > 1.0


def test_an_opened_diagram_has_its_ports_on_its_frame_and_its_blocks_inside():
    picture = pf.draw(nested(), 1)
    frame = node(picture, "controller")
    assert frame.kind == "frame"
    inside = [entry for entry in picture.nodes if entry.frame == "controller"]
    assert {"controller.lead", "controller.K_p"} < {entry.name for entry in inside}
    for entry in inside:
        assert frame.box[0] - LEVEL <= entry.box[0] <= entry.box[2] <= frame.box[2] + LEVEL
        assert frame.box[1] <= entry.box[1] <= entry.box[3] <= frame.box[3]
    assert {p.x for p in frame.ports} == {frame.box[0], frame.box[2]}
    entering = [w for w in picture.wires if w.source[0] == "controller.e (input)"]
    assert [w.names for w in entering] == [("error.e",)]


def test_vectors_are_one_thick_wire_with_their_size():
    def block(name, u, y):
        signals = {"inputs": [f"{u}[{k}]" for k in range(2)], "outputs": [f"{y}[{k}]" for k in range(2)]}
        return ct.ss(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)), name=name, **signals)

    error = total("error", ["r", "-y"], "e", dimension=2)
    ends = {"inputs": ["r[0]", "r[1]"], "outputs": ["y[0]", "y[1]"]}
    picture = pf.draw(ct.interconnect([error, block("C", "e", "u"), block("P", "u", "y")], **ends))
    assert {entry.size for entry in picture.wires} == {2}
    assert len(picture.wires) == 4
    assert wire(picture, "P.y").names == ("P.y[0]", "P.y[1]")
    assert written(picture).count("2") == 4


def test_symbols():
    saturation = ct.nlsys(None, lambda t, x, u, p: np.clip(u, -1, 1), inputs="u", outputs="y", name="sat")
    hidden = ct.nlsys(None, lambda t, x, u, p: 1 / 0, inputs="u", outputs="y", name="odd")
    held = ct.tf([1.0], [1.0, -0.5], 0.1, name="held")
    kinds = {
        "integrator": tf("I", [1.0], [1.0, 0.0], "u", "y"),
        "gain": tf("K", [-2.5], [1.0], "u", "y"),
        "fraction": tf("G", [1.0], [1.0, 1.0], "u", "y"),
        "curve": saturation,
        "block": hidden,
        "delay": pf.transport_delay(["u"], 0.02),
        "filter": pf.phyfilter_block(pf.PhyFilter([400.0, 40.0]), 1),
    }
    assert {kind: pf.draw(block).nodes[1].kind for kind, block in kinds.items() if kind != "filter"} == {
        kind: kind for kind in kinds if kind != "filter"
    }
    picture = pf.draw(kinds["filter"])
    assert node(picture, "phyfilter").kind == "filter"
    assert "order 2, 20 rad/s" in written(picture)
    assert {"−2.5"} <= set(written(pf.draw(kinds["gain"])))
    assert {"1", "z − 0.5", "T = 100 ms"} <= set(written(pf.draw(held)))


def test_sampled_delays_are_powers_of_z_and_a_table_is_its_curve():
    line = pf.blocks.delay_line(["u[0]", "u[1]"], 5, 0.002)
    behind = ct.tf([1.0], [1.0, 0.0, 0.0, 0.0], 0.1, name="late", inputs="u", outputs="y")
    for block, power in ((line, "−5"), (behind, "−3")):
        picture = pf.draw(block)
        assert picture.nodes[1].kind == "delay"
        assert written(picture)[:5].count("z") == 1
        assert power in written(picture)
    table = pf.lookup_table([-2.0, 0.0, 1.0], [-1.0, 0.0, 4.0])
    assert pf.draw(table).nodes[1].kind == "curve"


def test_units_stand_on_wires_where_a_block_or_all_readers_know_them():
    plant = pf.transport_delay(["force"], 0.02, outputs=["pushed"], unit="kg m/s^2", name="motor")
    other = pf.transport_delay(["force"], 0.02, outputs=["copied"], unit="", name="probe")
    picture = pf.draw(ct.interconnect([plant, other], inputs="force", outputs=["pushed", "copied"]))
    units = {
        entry.source[0]: [text.text for text in entry.texts if text.text.startswith("[")]
        for entry in picture.wires
    }
    assert units == {"force (input)": ["[kg·m/s²]"], "motor": ["[kg·m/s²]"], "probe": []}
    # Those of what is inside a closed diagram; a gain on the way has units of its own.
    inside = ct.interconnect(
        [plant], inputs=["u"], outputs=["y", "z"], name="drive",
        connections=False, inplist=["motor.force"], outlist=["motor.pushed", ("motor", "pushed", 2.0)],
    )  # fmt: skip
    closed = pf.draw(ct.interconnect([inside], inplist=["drive.u"], outlist=["drive.y", "drive.z"]))
    assert [text for text in written(closed) if text.startswith("[k")] == ["[kg·m/s²]"] * 2


def test_a_wide_drawing_scrolls_before_its_text_is_smaller_than_nine_px():
    blocks = [
        tf(f"stage_{k}", [1.0], [1.0, 1.0], f"a_very_long_{k}", f"a_very_long_{k + 1}") for k in range(9)
    ]
    picture = pf.draw(ct.interconnect(blocks, inputs="a_very_long_0", outputs="a_very_long_9"))
    least = float(picture.svg.partition("min-width:")[2].partition("px")[0])
    smallest = min(text.size for entry in (*picture.nodes, *picture.wires) for text in entry.texts)
    assert smallest >= 9.0
    assert picture.width > 736.0
    assert smallest * least / picture.width >= 9.0


def test_a_learned_model_is_marked():
    from phyfilter_ctl.learned import Chebyshev

    v = np.linspace(-3.0, 3.0, 50)[:, None]
    block = pf.learned_block(Chebyshev(2, n_d=0).fit(v, -0.4 * v**2).model)
    assert pf.draw(block).nodes[1].kind == "learned"


def test_several_rates_are_listed():
    def sampled(name, u, y, period):
        return pf.sampled_block(
            ct.ss([[0.5]], [[1.0]], [[1.0]], [[0.0]], period, inputs=u, outputs=y), name=name
        )

    blocks = [sampled("slow", "r", "v", 0.1), sampled("fast", "v", "u", 0.01), PLANT]
    picture = pf.draw(ct.interconnect(blocks, inputs="r", outputs="y"))
    assert [text.text for text in picture.texts] == ["10 ms: fast   100 ms: slow"]


def test_an_input_that_nothing_drives_is_marked():
    plant = ct.ss([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]], inputs=["u", "d"], outputs="y", name="plant")
    with pytest.warns(UserWarning, match="Unused input"):
        system = ct.interconnect([plant], inplist=["plant.u"], outlist=["plant.y"])
    picture = pf.draw(system)
    assert [entry.name for entry in picture.nodes if entry.kind == "undriven"] == ["plant.d (undriven)"]


def test_values_are_written_on_wires():
    picture = pf.draw(pi_loop(), values={"PI.u": 3.25, "r": 1.0})
    assert {"3.25", "1"} <= set(written(picture))
    with pytest.raises(ValueError, match=r"values: no wire is called 'q'; there are PI\.u"):
        pf.draw(pi_loop(), values={"q": 1.0})


def test_svg_is_read_by_people_pages_and_screen_readers():
    picture = pf.draw(sensor_loop())
    root = ElementTree.fromstring(picture.svg)
    space = "{http://www.w3.org/2000/svg}"
    assert root.get("role") == "img"
    assert root.findtext(f"{space}title") == "sensor_loop"
    assert "Inputs: r, d. Blocks: error, PI" in (root.findtext(f"{space}desc") or "")
    assert "prefers-color-scheme:dark" in (root.findtext(f"{space}style") or "")
    signals = {group.get("data-signal") for group in root.iter(f"{space}g") if group.get("class") == "net"}
    assert set(picture.signals) <= signals
    assert {"PI", "sensor"} <= {text.text for text in root.iter(f"{space}text")}
    assert picture._repr_svg_() == picture.svg


def test_hostile_names_are_escaped_and_cut():
    block = ct.ss(
        [[-1.0]], [[1.0]], [[1.0]], [[0.0]], name="x" * 200, inputs=["<b>&\"'"], outputs=["]]>\x07"]
    )
    picture = pf.draw(block)
    texts = [
        text.text or ""
        for text in ElementTree.fromstring(picture.svg).iter("{http://www.w3.org/2000/svg}text")
    ]
    assert "<b>&\"'" in texts
    assert max(map(len, texts)) <= 28


@pytest.mark.parametrize(("ending", "start"), [("svg", b"<svg"), ("png", b"\x89PNG"), ("pdf", b"%PDF")])
def test_save(tmp_path, ending, start):
    path = tmp_path / f"loop.{ending}"
    pf.draw(pi_loop()).save(path)
    assert path.read_bytes().startswith(start)


def test_save_refuses_other_endings(tmp_path):
    with pytest.raises(ValueError, match=r"ends in \.svg, \.png, \.pdf, got 'loop\.gif'"):
        pf.draw(pi_loop()).save(tmp_path / "loop.gif")


def test_hints_move_a_block_below_or_ahead():
    usual, ahead = pf.draw(sensor_loop()), pf.draw(sensor_loop(), ahead=["sensor"])
    assert port(usual, "sensor").side == "W"
    assert port(ahead, "sensor").side == "E"


def many(count):
    blocks = [ct.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]], name=f"b{k}") for k in range(count)]
    return ct.InterconnectedSystem(blocks, inputs=["u"], outputs=["y"])


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ((3,), TypeError, "system: expected a python-control system, a filter"),
        (("loop.txt",), ValueError, r"system: expected the path of an \.fmu, an \.ssp .* got 'loop\.txt'"),
        ((PLANT, -1), ValueError, "depth: expected a whole number, 0 or more, got -1"),
        ((PLANT, True), ValueError, "depth: expected a whole number"),
    ],
)
def test_bad_input(arguments, error, message):
    with pytest.raises(error, match=message):
        pf.draw(*arguments)


def test_unknown_options():
    with pytest.raises(ValueError, match="below: no block is called 'q'; there are PI, error, plant"):
        pf.draw(pi_loop(), below=["q"])
    with pytest.raises(ValueError, match="outputs: expected 'border', 'near' or None, got 'left'"):
        pf.draw(pi_loop(), outputs="left")


@pytest.mark.filterwarnings("ignore:Unused")
def test_too_many_blocks_are_refused_before_anything_is_laid_out():
    with pytest.raises(ValueError, match=r"at most \d+ blocks on a level, got 2000 .* depth=0"):
        pf.draw(many(2000))


def test_feedback_of_transfer_functions_is_the_one_block_that_is_left():
    kinds = [entry.kind for entry in pf.draw(ct.feedback(PLANT, 1)).nodes]
    assert kinds == ["input", "fraction", "output"]


@pytest.mark.parametrize(
    ("filter", "size"),
    [
        (pf.PhyFilter([20.0]), 1),
        (pf.PhyFilter([400.0, 40.0]).sampled(0.002), 1),
        (stack([pf.PhyFilter([2.0]), pf.PhyFilter([400.0, 40.0])]), 2),
    ],
)
def test_a_filter_is_drawn_in_the_loop_of_its_equation(filter, size):
    picture = pf.draw(filter)
    assert {entry.size for entry in picture.wires} == {size}
    kinds = {entry.name: entry.kind for entry in picture.nodes}
    assert (kinds["F"], kinds["model"], kinds["residual"]) == ("filter", "learned", "sum")
    signs = {p.name: p.sign for p in node(picture, "residual").ports if p.direction == "in"}
    assert signs == {"rate": 1, "g": -1, "f_theta": -1}
    assert port(picture, "F").side == "W"


def test_a_flat_model_shows_its_ends_in_a_notebook():
    flat = pf.flatten(pi_loop())
    picture = pf.draw(flat)
    assert [entry.kind for entry in picture.nodes] == ["input", "block", "output"]
    assert "2 states" in written(picture)
    assert flat._repr_svg_() == picture.svg


DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="{name}" guid="{name}">
<CoSimulation modelIdentifier="{name}"/>
<ModelVariables>
<ScalarVariable name="{u}" valueReference="0" causality="input"><Real start="0"/></ScalarVariable>
<ScalarVariable name="{y}" valueReference="1" causality="output"><Real/></ScalarVariable>
</ModelVariables>
<ModelStructure><Outputs><Unknown index="2"/></Outputs></ModelStructure>
</fmiModelDescription>"""


def fmu(folder, name, u, y):
    path = folder / f"{name}.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", DESCRIPTION.format(name=name, u=u, y=y))
    return path


def test_fmus_and_packages_are_drawn_from_their_descriptions(tmp_path):
    parts = {"control": fmu(tmp_path, "control", "e", "u"), "robot": fmu(tmp_path, "robot", "u", "y")}
    for source in (parts["robot"], str(parts["robot"]), describe(parts["robot"])):
        assert [entry.name for entry in pf.draw(source).nodes] == ["u (input)", "robot", "y (output)"]
    wires = [Wire("robot.u", "control.u"), Wire("control.e", "robot.y")]
    package = tmp_path / "loop.ssp"
    write_ssp(System(parts, wires, outputs={"y": "robot.y"}), package)
    picture = pf.draw(package)
    assert {entry.name for entry in picture.nodes} == {"control", "robot", "y (output)"}
    assert {(w.source[0], w.targets) for w in picture.wires} >= {("control", (("robot", "u"),))}


def test_a_drawing_is_what_it_was():
    one, two = pf.draw(sensor_loop()), pf.draw(sensor_loop())
    assert isinstance(one, Drawing)
    assert one == two


def test_a_name_that_python_control_counted_up_is_no_title():
    first, second = (pf.draw(ct.ss(-1.0, 1.0, 1.0, 0.0, name=None)) for _ in range(2))
    assert "<title>block diagram</title>" in first.svg
    assert first.svg.partition("<desc>")[0] == second.svg.partition("<desc>")[0]
    assert "<title>servo</title>" in pf.draw(ct.ss(-1.0, 1.0, 1.0, 0.0, name="servo")).svg
