"""Batches, sensitivities, and the compiled backend."""

import control as ct
import numpy as np
import pytest

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.blocks import sampled_block
from phyfilter_ctl.codegen import CompilerError, find_compiler
from phyfilter_ctl.diagram import flatten
from phyfilter_ctl.diagram.fixed_step import rates
from phyfilter_ctl.simulation import compiled, cost, sensitivity, simulate, simulate_batch
from phyfilter_ctl.simulation.arguments import prepare
from phyfilter_ctl.study import Executor

TIMES = np.linspace(0.0, 2.0, 101)
# Central differences of step 1e-5: rounding 1e-11, and the third derivative times 1e-10.
DIFFERENCE = 2e-7
# C and the virtual machine evaluate the same expressions in another order.
ROUNDING = 1e-12


def loop_with(drag):
    """A mass with drag under a PD controller, and a sampled filter that feeds back what it finds."""
    mass = ct.nlsys(
        lambda t, x, u, p: [x[1], (u[0] + u[1] - p["drag"] * drag(x[1])) / p["m"]], None,
        inputs=["tau", "d"], outputs=["s", "v"], states=["s", "v"], params={"m": 1.2, "drag": 0.3}, name="mass",
    )  # fmt: skip
    steer = ct.nlsys(
        None, lambda t, x, u, p: [p["kp"] * (u[0] - u[1]) - p["kd"] * u[2] - u[3]],
        inputs=["r", "s", "v", "f"], outputs=["tau"], params={"kp": 9.0, "kd": 5.0}, name="steer",
    )  # fmt: skip
    block = sampled_block(PhyFilter.from_poles([-20.0, -20.0]).sampled(0.008, g="hold"), 1, name="filter")
    return flatten(ct.interconnect(
        [mass, steer, block],
        connections=[["mass.tau", "steer.tau"], ["steer.s", "mass.s"], ["steer.v", "mass.v"],
                     ["steer.f", "filter.f_hat[0]"], ["filter.x[0]", "mass.v"], ["filter.g[0]", "steer.tau"]],
        inplist=["steer.r", "mass.d", "filter.f_theta[0]"], inputs=["r", "d", "f_theta"],
        outlist=["mass.s", "filter.f_hat[0]"], outputs=["s", "f_hat"], name="loop",
    ))  # fmt: skip


@pytest.fixture(scope="module")
def loop():
    return loop_with(lambda v: v * np.sqrt(v**2 + 1e-4))


@pytest.fixture(scope="module")
def linear_loop():
    return loop_with(lambda v: v)


def stopping(t, x, u, params):
    if np.linalg.eigvals(np.diag(x)).real[0] > params["stop"]:
        raise ValueError(f"stop at {params['stop']}")
    return [1.0]


def stopped():
    return ct.nlsys(stopping, None, inputs=0, outputs=1, states=1, params={"stop": 1.0}, name="stopped")


def test_each_run_of_a_batch_tells_of_its_own_failure():
    runs = simulate_batch(
        stopped(), [0.0, 5.0], params={"stop": [1.0, 2.0, 3.0, 100.0]}, limits={"workers": 4}
    )
    for run, stop in zip(runs[:3], (1.0, 2.0, 3.0), strict=True):
        assert f"raised ValueError: stop at {stop}" in str(run.message)
        assert 0.0 < run.callbacks["stopped"] <= 1.0
    assert runs[3].success


def test_python_blocks_stay_in_their_process():
    with (
        Executor(workers=2) as executor,
        pytest.raises(
            ValueError, match=r"workers: block stopped runs as Python \(.*eigvals.*a number runs the batch"
        ),
    ):
        simulate_batch(stopped(), [0.0, 1.0], params={"stop": [1.0, 2.0]}, limits={"workers": executor})


INPUTS = [np.sign(np.sin(5.0 * TIMES)), 0.4, 0.0]


@pytest.mark.parametrize(
    ("method", "backend"),
    [("rk4", "vm"), ("exact", "vm"), ("adaptive", "vm"), ("rk4", "c"), ("adaptive", "c")],
)
def test_batch_is_the_single_runs_bit_for_bit(loop, linear_loop, method, backend):
    loop = linear_loop if method == "exact" else loop
    masses, gains = np.linspace(0.8, 1.6, 5), np.linspace(6.0, 12.0, 5)
    options = {"method": method, "backend": backend}
    many = simulate_batch(
        loop, TIMES, INPUTS, params={"m": masses, "kp": gains, "kd": 4.0}, limits={"workers": 2}, **options
    )
    assert len(many) == 5
    for run, m, kp in zip(many, masses, gains, strict=True):
        single = simulate(loop, TIMES, INPUTS, params={"m": m, "kp": kp, "kd": 4.0}, **options)
        np.testing.assert_array_equal(run.outputs, single.outputs)
        np.testing.assert_array_equal(run.states, single.states)
    assert not np.array_equal(many[0].outputs, many[1].outputs)


@pytest.mark.slow
def test_other_processes_find_the_same_numbers(loop):
    starts = np.random.default_rng(0).standard_normal((5, 2))
    options = {"initial_state": starts, "method": "rk4", "backend": "vm"}
    expected = simulate_batch(loop, TIMES, INPUTS, **options)
    with Executor(2) as executor:
        found = simulate_batch(loop, TIMES, INPUTS, limits={"workers": executor}, **options)
        assert list(executor.map(abs, [-1])) == [1]  # it is its owner's to close
    for one, other in zip(expected, found, strict=True):
        assert (other.success, other.message, other.output_labels) == (
            one.success,
            one.message,
            one.output_labels,
        )
        np.testing.assert_array_equal(other.outputs, one.outputs)


def test_batches_of_starts_and_inputs(loop):
    rng = np.random.default_rng(0)
    starts, inputs = rng.standard_normal((4, 2)), rng.standard_normal((4, 3, len(TIMES)))
    many = simulate_batch(loop, TIMES, inputs, starts, method="rk4", backend="vm")
    assert isinstance(many, ct.TimeResponseList)
    for run, start, table in zip(many, starts, inputs, strict=True):
        np.testing.assert_array_equal(
            run.outputs, simulate(loop, TIMES, table, start, method="rk4", backend="vm").outputs
        )
    for arguments in ({}, {"params": {"m": 1.0}}, {"params": {"m": [1.0, 2.0]}, "initial_state": starts}):
        with pytest.raises(ValueError, match="expected one number B of runs"):
            simulate_batch(loop, TIMES, 0.0, **arguments)
    with pytest.raises(ValueError, match="workers"):
        simulate_batch(loop, TIMES, inputs, limits={"workers": 0})


def test_a_run_that_fails_leaves_the_others_alone():
    system = ct.nlsys(lambda t, x, u, p: [p["a"] * x[0] ** 2 - x[0]], None, inputs=0, outputs=1, states=1,
                      params={"a": 0.0}, name="bad")  # fmt: skip
    many = simulate_batch(system, TIMES, 0.0, 1.0, params={"a": [0.0, 5.0, 0.5]}, method="rk4")
    assert [run.success for run in many] == [True, False, True]
    np.testing.assert_allclose(many[0].states[0], np.exp(-TIMES), atol=1e-6)


@pytest.mark.parametrize("method", ["rk4", "adaptive"])
def test_compiled_equals_the_virtual_machine(loop, method):
    tolerance = ROUNDING if method == "rk4" else 1e-8
    machine = simulate(loop, TIMES, INPUTS, [0.1, 0.2], params={"m": 1.1}, method=method, backend="vm")
    native = simulate(loop, TIMES, INPUTS, [0.1, 0.2], params={"m": 1.1}, method=method, backend="c")
    assert (machine.backend, native.backend, native.method) == ("vm", "c", method)
    np.testing.assert_allclose(native.outputs, machine.outputs, atol=tolerance)
    np.testing.assert_allclose(native.states, machine.states, atol=tolerance)


def test_compiled_discrete_diagram():
    system = ct.tf([0.3, 0.1], [1.0, -1.2, 0.5], 0.05)
    times, u = 0.05 * np.arange(200), np.random.default_rng(3).standard_normal(200)
    machine = simulate(system, times, u, [0.1, -0.2], backend="vm")
    native = simulate(system, times, u, [0.1, -0.2], backend="c")
    np.testing.assert_allclose(native.outputs, machine.outputs, atol=ROUNDING)
    np.testing.assert_allclose(native.states, machine.states, atol=ROUNDING)


def test_compiled_where_it_pays(loop, linear_loop, monkeypatch):
    """Long runs compile, short ones do not, and a batch counts as a whole."""
    find_compiler()  # skipped where there is none
    short = simulate(loop, TIMES, INPUTS, method="rk4")
    assert short.backend == "vm"
    assert "predicted" in short.explanation
    # As if compiling took as long as three runs, and nothing else took time.
    for name in ("_COMPILE", "_COMPILE_EACH", "_MAKING", "_MAKING_EACH", "_MAKING_APART", "_C_ROW"):
        monkeypatch.setattr(cost, name, 0.0)
    run = prepare(loop, TIMES, INPUTS, None, None, "linear")
    fastest = rates(loop, TIMES[0], run.start, run.inputs[0], run.parameters, np.zeros(len(loop.held)))[1]
    bare = cost.expected_cost(loop, run, fastest, fixed=True, max_step=None, runs=1)
    monkeypatch.setattr(cost, "_COMPILE", 3.0 * bare.vm / cost._OPERATION)
    assert simulate(loop, TIMES, INPUTS, method="rk4").backend == "vm"
    many = simulate_batch(loop, TIMES, INPUTS, params={"m": np.linspace(1.0, 2.0, 9)}, method="rk4")
    assert {run.backend for run in many} == {"c"}
    assert simulate(linear_loop, TIMES, INPUTS, method="exact").backend == "vm"


def test_missing_compiler_is_named(loop, monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")
    fresh = flatten(ct.tf([1.0], [1.0, 1.0]))
    with pytest.raises(CompilerError, match=r"'no-such-compiler'.*backend='vm'"):
        simulate(fresh, TIMES, 1.0, backend="c")
    # Without a compiler the machine does the work.
    assert simulate(fresh, np.linspace(0.0, 1.0, 3), 1.0, method="rk4", max_step=1e-5).backend == "vm"


def test_no_c_code_for_it_leaves_the_virtual_machine(loop, monkeypatch):
    def refuse(flat):
        raise ValueError("no C code")

    monkeypatch.setattr(compiled, "_compiled", refuse)
    monkeypatch.setattr(cost, "_COMPILE", 0.0)
    monkeypatch.setattr(cost, "_COMPILE_EACH", 0.0)
    assert simulate(loop, TIMES, INPUTS, method="rk4").backend == "vm"
    with pytest.raises(ValueError, match="no C code"):
        simulate(loop, TIMES, INPUTS, method="rk4", backend="c")


def test_divergence_in_c_is_a_status():
    system = ct.nlsys(lambda t, x, u, p: x**2, None, inputs=0, outputs=1, states=1, name="bad")
    response = simulate(system, np.linspace(0.0, 2.0, 201), 0.0, 1.0, method="rk4", backend="c")
    assert not response.success
    assert response.message
    assert np.isnan(response.states[0, -1])
    assert np.isfinite(response.states[0, 90])


def test_sensitivities_are_the_differences(loop):
    names = ["m", "mass.drag", "kp"]
    result = sensitivity(loop, TIMES, INPUTS, by=names, by_start=["s", "v"])
    assert result.names == ("mass.m", "mass.drag", "steer.kp", "mass.s", "mass.v")
    assert result.outputs.shape == (101, 2, 5)
    assert result.states.shape == (101, 2, 5)
    plain = simulate(loop, TIMES, INPUTS, method="rk4", backend="vm")
    np.testing.assert_allclose(result.response.outputs, plain.outputs, atol=ROUNDING)
    at = {v.name: v.start for v in loop.parameters}
    # The step is chosen from the poles at the start; the differences must take the same one.
    step = 0.002
    result = sensitivity(loop, TIMES, INPUTS, by=names, by_start=["s", "v"], max_step=step)
    for i, name in enumerate(result.names):
        sides = []
        for sign in (1.0, -1.0):
            moved = {name: (at[name] if i < 3 else 0.0) + sign * 1e-5}
            options = {"params": moved} if i < 3 else {"initial_state": moved}
            sides.append(simulate(loop, TIMES, INPUTS, method="rk4", backend="vm", max_step=step, **options))
        for of, found in (("outputs", result.outputs), ("states", result.states)):
            difference = (getattr(sides[0], of) - getattr(sides[1], of)) / 2e-5
            np.testing.assert_allclose(found[:, :, i].T, difference, atol=DIFFERENCE)


def test_sensitivity_in_closed_form():
    """x' = a (1 - x): dx/da = t e^{-a t}, dx/dx_0 = e^{-a t}; discrete: x_{k+1} = b x_k, dx_k/db = k b^{k-1}."""
    lag = ct.nlsys(lambda t, x, u, p: [p["a"] * (1.0 - x[0])], None, inputs=0, outputs=1, states="x",
                   params={"a": 1.5}, name="lag")  # fmt: skip
    result = sensitivity(lag, TIMES, by=["a"], by_start=["x"])
    np.testing.assert_allclose(result.outputs[:, 0, 0], TIMES * np.exp(-1.5 * TIMES), atol=1e-8)
    np.testing.assert_allclose(result.outputs[:, 0, 1], np.exp(-1.5 * TIMES), atol=1e-8)
    power = ct.nlsys(lambda t, x, u, p: [p["b"] * x[0]], None, inputs=0, outputs=1, states="x",
                     params={"b": 0.9}, dt=0.5, name="power")  # fmt: skip
    k = np.arange(20)
    found = sensitivity(power, 0.5 * k, initial_state=2.0, by=["b"]).states[:, 0, 0]
    np.testing.assert_allclose(found, 2.0 * k * 0.9 ** np.maximum(k - 1, 0), rtol=1e-13)


def test_sensitivity_refuses(loop):
    for arguments, message in (
        ({}, "at least one parameter or state"),
        ({"by": ["k"]}, r"by: 'k' names none"),
        ({"by": "m"}, "expected a list of names"),
        ({"by_start": ["w"]}, "by_start: 'w' names none"),
        ({"by": ["m"], "max_step": -1.0}, "max_step"),
    ):
        with pytest.raises(ValueError, match=message):
            sensitivity(loop, TIMES, INPUTS, **arguments)
