"""Co-simulation FMUs in ``simulate``: alone, in diagrams, in loops, and to where they end the run.

What is expected comes from the oscillator's transition matrix, from python-control and from hand calculation.
"""

import control as ct
import numpy as np
import pytest
from foreign_typed import NUMBERS, typed

import phyfilter_ctl as pf
from phyfilter_ctl.fmi import Fmu, Master, System, cosimulate, import_fmu
from phyfilter_ctl.fmi.cosimulation_run import Run

H = 0.01
T = np.linspace(0.0, 1.0, 101)
U = np.sin(3 * T)
M, K, D, C = 2.0, 8.0, 0.4, 3.0
# The FMU makes RK4 steps of 1 ms: error about h^4; loops do not enlarge it.
INTEGRATED = 1e-9
# Of the adaptive method, whose tolerance is 1e-8 a step.
ADAPTIVE = 1e-7


def sampled_oscillator():
    """place -> x, v, force on an input held over H, by its transition matrix."""
    A = [[0.0, 1.0], [-(K + C) / M, -D / M]]
    plant = ct.ss(A, [[0.0], [C / M]], [[1.0, 0.0], [0.0, 1.0], [-C, 0.0]], [[0.0], [0.0], [C]])
    return ct.c2d(plant, H, "zoh")


def expected_alone(u):
    model, x, rows = sampled_oscillator(), np.array([1.0, 0.0]), []
    for value in u:
        rows.append(model.C @ x + model.D[:, 0] * value)
        x = model.A @ x + model.B[:, 0] * value
    return np.array(rows).T


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_alone(build, fmi):
    block = import_fmu(build(fmi), kind="cs", name="mass")
    inputs = np.tile(U, (block.ninputs, 1))
    found = pf.simulate(block, T, inputs)(squeeze=False)
    assert found.success
    assert found.method == "discrete"
    assert np.max(np.abs(found.outputs[:: block.ninputs] - expected_alone(U))) < INTEGRATED
    there = ct.input_output_response(block, T, inputs, block.start_state)
    assert np.array_equal(there.outputs, found.outputs)
    assert np.array_equal(pf.simulate(block, T, inputs)(squeeze=False).outputs, found.outputs), "a second run"
    freed = pf.simulate(block, T)(squeeze=False).outputs[:: block.ninputs]
    assert np.max(np.abs(freed - expected_alone(0 * U))) < INTEGRATED, "inputs at their starts"


def test_in_a_discrete_diagram(build):
    """In a loop by way of x, beside the output that sees the input at once."""

    def loop():
        block = import_fmu(build(), kind="cs", name="mass")
        lag = ct.ss([[0.8]], [[0.2]], [[1.0]], [[0.0]], H, inputs="e", outputs="place", name="lag")
        error = ct.summing_junction(["r", "-x"], "e", name="error")
        outputs = ["x", "force", "place"]
        return ct.interconnect([block, lag, error], inputs="r", outputs=outputs, check_unused=False)

    found = pf.simulate(loop(), T, U)
    there = ct.input_output_response(loop(), T, U, 0.0)
    assert found.success
    assert np.array_equal(found.outputs, there.outputs)


@pytest.mark.parametrize("method", ["auto", "rk4", "stiff"])
def test_in_a_continuous_diagram(build, method):
    """Through a lag that an adaptive method integrates, at times that are no communication points too."""
    block = pf.sampled_block(import_fmu(build(), kind="cs", name="mass"), name="mass")
    gain = ct.ss([], [], [], [[2.0]], inputs="x", outputs="w", name="gain")
    lag = ct.nlsys(
        lambda t, x, u, p: [(u[0] - x[0]) / 0.3], None, inputs="w", outputs="y", states="y", name="lag"
    )
    diagram = ct.interconnect([block, gain, lag], inputs="place", outputs=["x", "y"], check_unused=False)
    times = np.linspace(0.0, 1.0, 401)
    found = pf.simulate(diagram, times, np.sin(3 * times), method=method)
    assert found.success
    x = expected_alone(U)[0]
    assert np.max(np.abs(found.outputs[0, ::4] - x)) < INTEGRATED
    assert np.array_equal(found.outputs[0, 1::4], found.outputs[0, :-1:4]), "held in between"
    y, decay = [0.0], np.exp(-H / 0.3)
    for value in x[:-1]:
        y.append(decay * y[-1] + (1 - decay) * 2.0 * value)
    assert np.max(np.abs(found.outputs[1, ::4] - y)) < ADAPTIVE


# Of the feedthrough to force the description tells, says nothing, or denies it.
@pytest.mark.parametrize("declared", [True, None, False])
def test_loops_beside_feedthrough(build, declared):
    """A sampled law reads x and drives place, which acts on force at the same instant."""
    block = import_fmu(build(declared=declared), kind="cs", name="mass")
    assert block.feedthrough().tolist() == [[False], [False], [True]]
    law = ct.ss([], [], [], [[-0.5, 1.0]], H, inputs=["x", "r"], outputs="place", name="law")
    plant = pf.sampled_block(block)
    diagram = ct.interconnect(
        [plant, pf.sampled_block(law)], inputs="r", outputs=["x", "force"], check_unused=False
    )
    found = pf.simulate(diagram, T, U)
    model, x, rows = sampled_oscillator(), np.array([1.0, 0.0]), []
    for r in U:
        place = r - 0.5 * x[0]
        rows.append([x[0], C * (place - x[0])])
        x = model.A @ x + model.B[:, 0] * place
    assert found.success
    assert np.max(np.abs(found.outputs.T - rows)) < INTEGRATED
    ring = ct.ss([], [], [], [[-0.1, 1.0]], H, inputs=["force", "r"], outputs="place", name="law")
    with pytest.raises(ValueError, match=r"wait for each other at an instant: .*mass\.force"):
        pf.flatten(
            ct.interconnect([plant, pf.sampled_block(ring)], inputs="r", outputs="x", check_unused=False)
        )


def test_an_algebraic_loop_in_a_discrete_diagram(build):
    """place = r - 0.1 force, force = C (place - x); before any run the diagram is tried at random states."""
    block = import_fmu(build(), kind="cs", name="mass")
    law = ct.nlsys(
        None, lambda t, x, u, p: [u[1] - 0.1 * u[0]], inputs=["force", "r"], outputs="place", name="law", dt=H
    )
    diagram = ct.interconnect([block, law], inputs="r", outputs=["x", "place"], check_unused=False)
    found = pf.simulate(diagram, T[:9], U[:9])  # each instant asks the FMU some hundred times
    model, x, rows = sampled_oscillator(), np.array([1.0, 0.0]), []
    for r in U[:9]:
        place = (r + 0.1 * C * x[0]) / (1 + 0.1 * C)
        rows.append([x[0], place])
        x = model.A @ x + model.B[:, 0] * place
    assert found.success
    assert np.max(np.abs(found.outputs.T - rows)) < INTEGRATED


def test_a_discrete_diagram_as_a_sampled_block(build):
    block = import_fmu(build(), kind="cs", name="mass")
    gain = ct.ss([], [], [], [[2.0]], H, inputs="x", outputs="w", name="gain")
    inner = ct.interconnect([block, gain], inputs="place", outputs="w", name="inner", check_unused=False)
    lag = ct.tf([1.0], [0.3, 1.0], inputs="w", outputs="y", name="lag")
    diagram = ct.interconnect([pf.sampled_block(inner), lag], inputs="place", outputs=["w", "y"])
    found = pf.simulate(diagram, T, U)
    assert found.success
    assert np.max(np.abs(found.outputs[0] - 2.0 * expected_alone(U)[0])) < INTEGRATED


def test_a_batch_has_the_instance_one_run_at_a_time(build):
    block = import_fmu(build(), kind="cs", name="mass")
    inputs = np.stack([[k * U] for k in range(1, 5)])
    flat = pf.flatten(pf.sampled_block(block))
    for system in (block, flat):
        runs = pf.simulate_batch(system, T, inputs, limits={"workers": 4})
        for run, u in zip(runs, inputs, strict=True):
            assert np.max(np.abs(run.outputs - expected_alone(u[0]))) < INTEGRATED
    stiffer = pf.simulate_batch(flat, T, 0.0, params={"m": [2.0, 1.0]}, limits={"workers": 2})
    assert stiffer[0].outputs[0, -1] != stiffer[1].outputs[0, -1], "fixed parameters, set at each start"


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_a_run_that_the_fmu_ends(build, fmi):
    """At 0.5 s, the end of a step: its outputs there are recorded, and it refuses inputs from then on."""
    path = build(fmi, defines=("ENDS_ON=0.5",))
    block = import_fmu(Fmu(path, outputs=["x"]), kind="cs", name="mass")
    inputs = np.tile(U, (block.ninputs, 1))
    lag = ct.tf([1.0], [0.3, 1.0], inputs="a", outputs="y", name="lag")
    wired = {
        "connections": [["lag.a", f"mass.{block.output_labels[0]}"]],
        "inplist": [f"mass.{label}" for label in block.input_labels],
        "inputs": block.input_labels,
        "outlist": [f"mass.{block.output_labels[0]}", "lag.y"],
        "outputs": ["x", "y"],
        "check_unused": False,
    }
    diagram = ct.interconnect([pf.sampled_block(block), lag], **wired)
    for system in (block, diagram):
        found = pf.simulate(system, T, inputs)(squeeze=False)
        assert not found.success
        assert found.message == "block mass: the FMU asked to end the run at t = 0.5 s"
        assert np.max(np.abs(found.outputs[0, :51] - expected_alone(U)[0, :51])) < INTEGRATED
        assert np.isnan(found.outputs[0, 51:]).all()
    there = ct.input_output_response(block, T[:51], inputs[:, :51], 0.0, squeeze=False)
    assert np.max(np.abs(there.outputs[0] - expected_alone(U)[0, :51])) < INTEGRATED
    assert pf.simulate(block, T[:51], inputs[:, :51]).success, "where nothing after the end is asked for"


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
@pytest.mark.parametrize("in_c", [True, False])
def test_a_co_simulation_that_an_fmu_ends(build, fmi, in_c, monkeypatch):
    """The others come to the same point, and their inputs there are handed on."""
    monkeypatch.setattr(Run, "in_c", in_c)
    parts = {"ends": build(fmi, defines=("ENDS_ON=0.5",)), "other": build()}
    x = "ends.x" if fmi == "2.0" else "ends.x[0]"
    for options in ({}, {"scheme": "gauss-seidel"}, {"isolated": True}, {"hold": "first"}):
        given = dict(options)
        isolated = given.pop("isolated", None)
        whole = System({k: Fmu(part, isolated=isolated) for k, part in parts.items()}, [("other.place", x)])
        found = cosimulate(whole, T, outputs=[x, "other.force"], master=Master(**given))
        assert "the FMU asks to end the run at t = 0.5" in found.message, options
        assert np.isfinite(found.outputs[:, :51]).all(), options
        assert np.isnan(found.outputs[:, 51:]).all(), options
        assert np.max(np.abs(found.outputs[0, :51] - expected_alone(0 * U)[0, :51])) < INTEGRATED
    controlled = cosimulate(parts, T[::50], outputs=[x], master=Master(tolerance=1e-5))
    assert np.isfinite(controlled.outputs).ravel().tolist() == [True, True, False]
    assert controlled.outputs.ravel()[1] == pytest.approx(expected_alone(0 * U)[0, 50], abs=INTEGRATED)


def test_inputs_that_nothing_drives(tmp_path, build):
    """They keep their starts: that of an enumeration, of an integer, of a Boolean; FMI has no 0 for them."""
    given = {"u_Int32": 7, "u_Boolean": True, "u_Enumeration": 2}
    path = typed(tmp_path)
    block = import_fmu(Fmu(path, parameters=given), kind="cs", name="typed")
    starts = dict(zip(block.input_labels, block.start_inputs.tolist(), strict=True))
    assert [starts[name] for name in (*given, "a[0]", "a[1]")] == [7.0, 1.0, 2.0, 0.5, 1.0]
    twice = ct.ss([], [], [], [[2.0]], 0.1, inputs="y_Int8", outputs="w", name="twice")
    diagram = ct.interconnect(
        [block, twice], inputs="u_Int8", outputs=["y_Int8", "w", *(f"y{name[1:]}" for name in given)],
        check_unused=False,
    )  # fmt: skip
    times = 0.1 * np.arange(6)
    found = pf.simulate(diagram, times, [0.0, 3.0, -4.0, 5.0, 0.0, 1.0])
    assert found.success
    assert found.outputs[0].tolist() == [0.0, 3.0, -4.0, 5.0, 0.0, 1.0]
    assert found.outputs[1].tolist() == [0.0, 6.0, -8.0, 10.0, 0.0, 2.0]
    assert found.outputs[2:].tolist() == [[7.0] * 6, [1.0] * 6, [2.0] * 6]
    alone = pf.simulate(import_fmu(path, kind="cs"), times)(squeeze=False)
    assert alone.success
    row = dict(zip(block.output_labels, alone.outputs[:, -1].tolist(), strict=True))
    assert row["y_Enumeration"] == -1.0
    there = ct.input_output_response(import_fmu(path, kind="cs"), times, 0.0, 0.0, squeeze=False)
    assert there.outputs[block.output_labels.index("y_Enumeration")].tolist() == [-1.0] * 6
    mass = import_fmu(Fmu(build(), parameters={"place": 0.25}), kind="me", name="mass")
    free = ct.interconnect([mass], outputs="force", check_unused=False)
    first = pf.simulate(free, T)(squeeze=False).outputs[0, 0]
    assert first == pytest.approx(C * (0.25 - 1.0)), "model exchange too"


def test_every_type_passes_through(tmp_path):
    """Inputs of all types at once, sampled in a continuous diagram whose times are finer than its steps."""
    block = import_fmu(typed(tmp_path), kind="cs", name="typed")
    driven = [f"u_{kind}" for kind in NUMBERS]
    diagram = ct.interconnect(
        [pf.sampled_block(block)], inputs=driven, outputs=[f"y{name[1:]}" for name in driven], check_unused=False
    )  # fmt: skip
    times = 0.05 * np.arange(11)
    values = np.array([1.0, 0.0] * 5 + [1.0])
    inputs = np.array([2.0 * values if kind == "Enumeration" else values for kind in NUMBERS])
    inputs[list(NUMBERS).index("Enumeration"), 1::2] = -1.0
    found = pf.simulate(diagram, times, inputs)
    assert found.success, found.message
    assert np.array_equal(found.outputs[:, ::2], inputs[:, ::2])
    wrong = inputs.copy()
    wrong[1, 4] = 0.5
    refused = pf.simulate(diagram, times, wrong)
    assert "u_Int8 (Int8): expected an integer, got 0.5" in refused.message
    assert np.isfinite(refused.outputs[:, :4]).all()


def test_its_linearisation_is_refused(build):
    block = import_fmu(build(), kind="cs", name="mass")
    for system in (block, pf.sampled_block(block)):
        with pytest.raises(ValueError, match="cannot be linearised"):
            pf.flatten(system).linearize()


def test_what_fails_inside_is_told(build):
    block = import_fmu(build(defines=("FAIL_AT=0.355",)), kind="cs", name="mass")
    found = pf.simulate(pf.sampled_block(block), T, U)
    assert not found.success
    assert "block mass" in found.message
    assert "spring broke at t = 0.35" in found.message
    assert np.isfinite(found.outputs[:, :36]).all()
    assert np.isnan(found.outputs[:, 37:]).all()


def test_each_block_of_a_diagram_has_its_own_instance(build):
    """python-control copies a block that stands twice in a list; two wrappers around one FMU are refused."""
    block = import_fmu(build(), kind="cs", name="mass")
    plant = pf.sampled_block(block)
    wires = {"inplist": ["mass.place", "other.place"], "inputs": 2, "outputs": 2, "check_unused": False}
    wires["outlist"] = ["mass.x", "other.x"]
    inputs = np.array([U, -2.0 * U])
    twins = ct.interconnect([plant, plant.copy(name="other")], **wires)
    found = pf.simulate(twins, T, inputs)
    expected = [expected_alone(u)[0] for u in inputs]
    assert np.max(np.abs(found.outputs - expected)) < INTEGRATED
    with pytest.raises(ValueError, match="blocks mass and other are one and the same"):
        pf.flatten(ct.interconnect([plant, pf.sampled_block(block, name="other")], **wires))


def test_an_input_that_is_no_number_is_not_passed_over(build):
    """It reaches the FMU, whose outputs are no numbers from the next point on."""
    block = import_fmu(Fmu(build(), outputs=["x"]), kind="cs", name="mass")
    source = ct.nlsys(
        None, lambda t, x, u, p: [np.log(0.305 - t)], inputs=0, outputs="place", name="log", dt=H
    )
    found = pf.simulate(ct.interconnect([source, block], outputs="x"), T)(squeeze=False)
    assert not found.success
    assert np.isfinite(found.outputs[0]).tolist() == [k < 32 for k in range(101)]
