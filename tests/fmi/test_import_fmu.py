"""Foreign FMUs as python-control systems, against the closed form of the oscillator."""

import copy
import gc
import os
import tempfile
import zipfile

import control as ct
import fmpy
import numpy as np
import pytest

from phyfilter_ctl.fmi import Fmu, FmuError, import_fmu
from phyfilter_ctl.fmi.instance import FmuInstance
from phyfilter_ctl.fmi.unpacked import UnpackedFmu

T = np.linspace(0.0, 2.0, 201)
M, K, D, C = 2.0, 8.0, 0.4, 3.0
# python-control's adaptive run at rtol 1e-10 against the exact response. Inputs are linear in between in both, and the
# adaptive run steps over their kinks every 10 ms: 1.5e-7 was seen.
SIMULATED = 1e-6
# The co-simulation FMU makes RK4 steps of 1 ms: error about h^4.
INTEGRATED = 1e-9


def model(k=K, c=C):
    """The oscillator in state space: place -> x, v, force."""
    A = [[0.0, 1.0], [-(k + c) / M, -D / M]]
    return ct.ss(A, [[0.0], [c / M]], [[1.0, 0.0], [0.0, 1.0], [-c, 0.0]], [[0.0], [0.0], [c]])


def simulated(block, U, state, **options):
    tight = {"rtol": 1e-10, "atol": 1e-12}
    return ct.input_output_response(block, T, U, state, solve_ivp_kwargs=tight, **options)


def test_model_exchange(build):
    block = import_fmu(build(), kind="me", name="mass")
    assert (block.input_labels, block.output_labels, block.state_labels) == (
        ["place"],
        ["x", "v", "force"],
        ["x", "v"],
    )
    assert block.params == {"m": M, "k": K, "d": D, "c": C}
    assert block.units == {
        "place": "m",
        "x": "m",
        "v": "m/s",
        "force": "N",
        "m": "kg",
        "k": "N/m",
        "c": "N/m",
    }
    assert block.start_state.tolist() == [1.0, 0.0]
    U = np.sin(3 * T)
    expected = ct.forced_response(model(), T, U, [1.0, 0.0]).outputs
    assert np.max(np.abs(simulated(block, U, block.start_state).outputs - expected)) < SIMULATED
    linear = ct.linearize(block, [0.3, -0.2], [0.1])
    assert np.allclose(linear.A, model().A, atol=1e-6)
    assert np.allclose(linear.D, model().D, atol=1e-6)


def test_model_exchange_with_arrays(build):
    block = import_fmu(build("3.0"), kind="me")
    assert block.input_labels == ["place[0]", "place[1]"]
    assert block.state_labels == ["x[0]", "x[1]", "v[0]", "v[1]"]
    assert block.start_state.tolist() == [1.0, 2.0, 0.0, 0.0]
    U = np.array([np.sin(3 * T), np.cos(2 * T)])
    found = simulated(block, U, block.start_state).outputs
    for i in range(2):
        expected = ct.forced_response(model(), T, U[i], [1.0 + i, 0.0]).outputs
        assert np.max(np.abs(found[i::2] - expected)) < SIMULATED


def test_parameters(build):
    expected = ct.forced_response(model(k=20.0), T, 0 * T, [0.5, 0.0]).outputs
    given = import_fmu(Fmu(build(), parameters={"k": 20.0, "x": 0.5}), kind="me")
    assert given.params["k"] == 20.0
    assert given.start_state.tolist() == [0.5, 0.0]
    late = import_fmu(build(), kind="me")
    first = simulated(late, 0 * T, [0.5, 0.0]).outputs
    changed = simulated(late, 0 * T, [0.5, 0.0], params={"k": 20.0}).outputs
    again = simulated(late, 0 * T, [0.5, 0.0]).outputs
    assert np.max(np.abs(changed - expected)) < SIMULATED
    assert np.max(np.abs(simulated(given, 0 * T, given.start_state).outputs - expected)) < SIMULATED
    assert np.array_equal(first, again), "parameters of one run do not stay for the next"
    with pytest.raises(ValueError, match="no variable with a start value is called stiffness"):
        import_fmu(Fmu(build(), parameters={"stiffness": 1.0}))


def test_in_a_diagram_beside_other_blocks(build):
    """Coupled to its own copy and a controller, as one linear system would behave."""
    block = import_fmu(build(), kind="me", name="mass")
    other = block.copy(name="other")
    gain = ct.ss([], [], [], [[-0.5]], inputs="e", outputs="u", name="gain")
    loop = ct.interconnect(
        [block, other, gain],
        connections=[["mass.place", "gain.u"], ["other.place", "mass.x"], ["gain.e", "other.x"]],
        inplist=[],
        outlist=["mass.x", "other.x"],
        outputs=["a", "b"],
        check_unused=False,
    )
    found = ct.input_output_response(
        loop, T, initial_state=[1.0, 0.0, 1.0, 0.0], solve_ivp_kwargs={"rtol": 1e-10, "atol": 1e-12}
    )
    k, d, c = (K + C) / M, D / M, C / M
    A = np.array([[0, 1, 0, 0], [-k, -d, -0.5 * c, 0], [0, 0, 0, 1], [c, 0, -k, -d]])
    exact = ct.initial_response(ct.ss(A, np.zeros((4, 1)), np.eye(4)[[0, 2]], 0), T, [1.0, 0.0, 1.0, 0.0])
    assert np.max(np.abs(found.outputs - exact.outputs)) < SIMULATED


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_co_simulation(build, fmi):
    block = import_fmu(build(fmi), kind="cs", name="mass")
    assert block.dt == 0.01
    U = np.tile(np.sin(3 * T), (block.ninputs, 1))
    found = ct.input_output_response(block, T, U, [0.0])
    held = ct.forced_response(ct.c2d(model(), 0.01, "zoh"), T, U[0], [1.0, 0.0]).outputs
    assert np.max(np.abs(found.outputs[:: block.ninputs] - held)) < INTEGRATED
    again = ct.input_output_response(block, T, U, [0.0])
    assert np.array_equal(found.outputs, again.outputs)


def test_co_simulation_by_hand(build):
    block = import_fmu(Fmu(build(), parameters={"x": 0.5}), kind="cs", step=0.1)
    assert block.restart()[0] == 0.5
    discrete = ct.c2d(model(), 0.1, "zoh")
    x = np.array([0.5, 0.0])
    for k in range(5):
        y = block.step([0.1 * k])
        x = discrete.A @ x + discrete.B[:, 0] * 0.1 * k
        assert np.allclose(y[:2], x, atol=INTEGRATED)
    assert block.steps_done == 5
    with pytest.raises(ValueError, match=r"inputs: expected shape \(1,\)"):
        block.step([1.0, 2.0])


def test_going_back_one_step(build):
    """python-control may evaluate a step more than once, with other inputs."""
    for options in ({}, {"state": False, "defines": ("NO_STATE",)}):
        block = import_fmu(build(**options), kind="cs", step=0.1)
        block.dynamics(0.0, [0.0], [0.0])
        assert block.dynamics(0.1, [1.0], [0.3])[0] == 2.0
        straight = block.output(0.2, [2.0], [0.3])
        assert block.dynamics(0.1, [1.0], [0.3])[0] == 2.0, "the same step again is no step"
        if options:
            with pytest.raises(
                FmuError, match=r"stands at step 2 and was asked for step 1; it cannot put back"
            ):
                block.dynamics(0.1, [1.0], [-4.0])
        else:
            block.dynamics(0.1, [1.0], [-4.0])
            assert not np.array_equal(block.output(0.2, [2.0], [0.3]), straight)
            block.dynamics(0.1, [1.0], [0.3])
            assert np.array_equal(block.output(0.2, [2.0], [0.3]), straight)
            with pytest.raises(FmuError, match="asked for step 7"):
                block.output(0.7, [7.0], [0.0])


def test_parameters_of_a_co_simulation(build):
    block = import_fmu(build(), kind="cs", step=0.1)
    block.dynamics(0.0, [0.0], [0.0])
    before = block.output(0.1, [1.0], [0.0])
    tuned = block.output(0.1, [1.0], [0.0], params={"c": 6.0})
    assert tuned[2] == pytest.approx(2 * before[2])
    with pytest.raises(ValueError, match="m cannot change during a run"):
        block.output(0.1, [1.0], [0.0], params={"m": 1.0})
    with pytest.raises(ValueError, match="cannot be linearised"):
        ct.linearize(block, [0.5], [0.0])


def test_copies_do_not_touch_each_other(build):
    block = import_fmu(build(), kind="cs", step=0.1)
    twin = copy.deepcopy(block)
    block.step([1.0])
    assert twin.steps_done == 0
    assert twin.step([0.0])[0] != block.step([1.0])[0]


def test_events(build):
    with pytest.raises(ValueError, match="has 1 event indicators"):
        import_fmu(build(indicators=1), kind="me").dynamics(0.0, [1.0, 0.0], [0.0])
    assert import_fmu(build(indicators=1)).dt == 0.01, "co-simulation handles its events itself"
    import_fmu(build(indicators=1), kind="me", events="ignore")
    timed = import_fmu(build(defines=("EVENT_AT=0.5",)), kind="me")
    timed.dynamics(0.4, [1.0, 0.0], [0.0])
    with pytest.raises(FmuError, match=r"time event at t = 0.5, before t = 0.6"):
        timed.dynamics(0.6, [1.0, 0.0], [0.0])


def test_what_cannot_be_imported(build):
    here = fmpy.platform_tuple
    with pytest.raises(ValueError, match=f"no binary for {here}; it has binaries for x86_64-windows"):
        import_fmu(build(platform="win64"))
    with pytest.raises(ValueError, match="expected an FMU for model exchange; it is for co-simulation"):
        import_fmu(build(kinds="cs"), kind="me")
    with pytest.raises(ValueError, match='expected "me", "cs" or "se"'):
        import_fmu(build(), kind="fmu")  # type: ignore[arg-type]  # the error is the point
    with pytest.raises(FmuError, match=r"Instantiate: error: .*guid is other, not oscillator"):
        import_fmu(build(guid="other"))
    with pytest.raises(FmuError, match="the token is another model's"):
        import_fmu(build("3.0", guid="other"))


def test_binary_that_is_none(build, tmp_path):
    path = tmp_path / "x.fmu"
    with zipfile.ZipFile(build()) as source, zipfile.ZipFile(path, "w") as target:
        for name in source.namelist():
            target.writestr(name, b"not a library" if name.startswith("binaries") else source.read(name))
    before = os.getcwd()
    with pytest.raises(FmuError, match="load the binary: refused"):
        import_fmu(path)
    assert os.getcwd() == before


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_failures_name_the_fmu_the_call_and_the_log(build, fmi):
    block = import_fmu(build(fmi, defines=("FAIL_AT=0.35",)), kind="cs", step=0.1, name="mass")
    U = np.zeros((block.ninputs, 11))
    with pytest.raises(FmuError, match=rf"'mass': fmi{fmi[0]}DoStep: error: at t = 0.3; .*spring broke"):
        ct.input_output_response(block, np.linspace(0, 1, 11), U, [0.0])
    if fmi == "2.0":
        assert block.messages == ("[error] error: spring broke at t = 0.3: too long",)
    block.close()
    with pytest.raises(FmuError, match="has ended"):
        block.step(U[:, 0])


def test_another_user_of_fmpy_does_not_get_our_messages(build, capsys):
    """fmpy has one logger per process for FMI 2.0: another instance may have taken it."""
    block = import_fmu(build(defines=("FAIL_AT=0.35",)), kind="cs", step=0.1)
    fmpy.simulate_fmu(str(build()), fmi_type="CoSimulation", stop_time=0.1)
    for _ in range(3):
        block.step([0.0])
    with pytest.raises(FmuError, match=r"spring broke at t = 0\.3"):
        block.step([0.0])
    assert "spring" not in capsys.readouterr().out


@pytest.mark.slow
def test_files_go_away(build, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    block = import_fmu(build())
    assert len(list(tmp_path.iterdir())) == 1
    del block
    gc.collect()
    assert not list(tmp_path.iterdir())


def test_unknown_variable(build):
    with pytest.raises(ValueError, match="there is no variable 'q'"):
        instance_of(build()).set_values({"q": 1.0})


def instance_of(path):
    return FmuInstance(UnpackedFmu(path), "cs", "alone")
