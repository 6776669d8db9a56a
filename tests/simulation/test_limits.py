"""Runs that would not end, and fixed steps that would diverge."""

import re

import control as ct
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.diagram.fixed_step import largest_stable_step
from phyfilter_ctl.simulation import Limits

# R(z) = 1 + z + z^2/2 + z^3/6 + z^4/24 leaves the unit disc there: the root of z^3/24 + z^2/6 + z/2 + 1, and sqrt 8.
REAL_AXIS, IMAGINARY_AXIS = 2.785293563405282, 8.0**0.5
# Ten digits of eigenvalues and roots of degree 8.
DIGITS = 1e-9


def relay_loop():
    """A relay that is smooth, but over 1e-14: no switch that could be located."""
    relay = ct.nlsys(
        None, lambda t, x, u, p: [-u[0] / np.sqrt(u[0] ** 2 + 1e-28)], inputs=1, outputs=1, name="relay"
    )
    mass = ct.nlsys(lambda t, x, u, p: [u[0] + 0.3], None, inputs=1, outputs=1, states=["v"], name="mass")
    return ct.interconnect(
        [relay, mass], connections=[["mass.u[0]", "relay.y[0]"], ["relay.u[0]", "mass.y[0]"]], inputs=[],
        outlist=["mass.y[0]"], outputs=["v"], name="loop",
    )  # fmt: skip


def run(backend, **limits):
    return pf.simulate(
        relay_loop(), [0.0, 0.5, 2.0], initial_state=[0.5], method="adaptive", backend=backend, limits=limits
    )


def test_a_sliding_mode_ends_and_names_what_chatters():
    """v reaches 0 at 0.5 / 0.7 s and stays: x' = -relay(x) + 0.3 jumps between -0.7 and 1.3."""
    answer = run("vm", max_steps=1500)
    assert not answer.success
    assert answer.failed_at == pytest.approx(0.5 / 0.7, abs=1e-4)
    assert re.search(
        r"Block mass chatters: the derivative of mass.v jumps between -0.7 and 1.3", answer.message
    )
    assert "max_steps" in answer.message
    np.testing.assert_allclose(answer.outputs[0, :2], [0.5, 0.15], atol=1e-9)
    assert np.isnan(answer.outputs[0, 2])


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["vm", "c"])
def test_a_sliding_mode_ends_by_itself(backend):
    answer = run(backend)
    assert not answer.success
    assert "Block mass chatters" in answer.message
    assert answer.failed_at < 0.72


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["vm", "c"])
def test_time_limit(backend):
    answer = run(backend, time_limit=0.05, max_steps=10**12)
    assert not answer.success
    assert "time limit" in answer.message or "given up" in answer.message


def test_step_budget_of_fixed_steps():
    lag = ct.nlsys(lambda t, x, u, p: [-(x[0] ** 3)], None, inputs=1, outputs=1, states=1, name="lag")
    answer = pf.simulate(
        lag, [0.0, 1.0], 0.0, [1.0], method="rk4", max_step=1e-4, backend="vm", limits={"max_steps": 9000}
    )
    assert not answer.success
    assert "9000 steps allowed (max_steps) are spent" in answer.message
    enough = pf.simulate(
        lag, [0.0, 1.0], 0.0, [1.0], method="rk4", max_step=1e-4, backend="vm", limits={"max_steps": 10_001}
    )
    assert enough.outputs[-1] == pytest.approx(3**-0.5, abs=1e-12)


@pytest.mark.parametrize("method", ["rk4", "exact", "numpy"])
def test_what_the_steps_allowed_reach_is_returned(method):
    """Half a second of one: x = exp(-t) there."""
    lag = pf.flatten(ct.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]], name="lag"))
    times = np.linspace(0.0, 1.0, 1001)
    if method == "numpy":
        answer = pf.simulate(lag, times, 0.0, [1.0], backend="numpy", limits={"max_steps": 500})
    else:
        answer = pf.simulate(
            lag, times, 0.0, [1.0], method=method, backend="vm", max_step=1e-3, limits={"max_steps": 500}
        )
    assert not answer.success
    assert answer.failed_at == pytest.approx(0.5, abs=1e-12)
    assert re.search(
        r"the 500 steps allowed \(max_steps\) are spent at t = 0.5 s: .*max_steps .*allow more",
        answer.message,
    )
    reached = 501 if method == "numpy" else 500  # there a step takes down where it begins
    np.testing.assert_allclose(answer.outputs[:reached], np.exp(-times[:reached]), atol=1e-12)
    assert np.isnan(answer.outputs[reached:]).all()


@pytest.mark.parametrize("wrong", [{"max_steps": 0}, {"max_steps": 2.5}, {"time_limit": 0.0}])
def test_limits_are_checked(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        pf.simulate(ct.tf([1.0], [1.0, 1.0]), [0.0, 1.0], 1.0, limits=wrong)


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({"max_step": 5}, "limits: expected max_steps, .*'max_step'; did you mean 'max_steps'"),
        ({"workers": 2}, "workers are of simulate_batch"),
        ({"workers": 0}, "workers"),
    ],
)
def test_limits_are_named(limits, message):
    with pytest.raises(ValueError, match=message):
        pf.simulate(ct.tf([1.0], [1.0, 1.0]), [0.0, 1.0], 1.0, limits=limits)
    with pytest.raises(TypeError, match="limits: expected a Limits or a mapping"):
        pf.simulate(ct.tf([1.0], [1.0, 1.0]), [0.0, 1.0], 1.0, limits=5)


def test_limits_are_a_value_too():
    lag = ct.nlsys(lambda t, x, u, p: [-(x[0] ** 3)], None, inputs=1, outputs=1, states=1, name="lag")
    given = {"method": "rk4", "max_step": 1e-2, "backend": "vm"}
    one, other = (
        pf.simulate(lag, [0.0, 1.0], 0.0, [1.0], **given, limits=limits)
        for limits in (Limits(max_steps=50), {"max_steps": 50})
    )
    assert one.message == other.message != ""


@pytest.mark.parametrize(
    ("matrix", "bound"),
    [
        ([[-2000.0]], REAL_AXIS / 2000.0),
        ([[0.0, 1.0], [-1e6, 0.0]], IMAGINARY_AXIS / 1e3),
        ([[5.0]], np.inf),  # it grows by itself
        ([[-1.0, 0.0], [0.0, -50.0]], REAL_AXIS / 50.0),
    ],
)
def test_largest_stable_step(matrix, bound):
    n = len(matrix)
    plant = ct.ss(matrix, np.ones((n, 1)), np.ones((1, n)), [[0.0]], name="plant")
    assert largest_stable_step(pf.flatten(plant)).seconds == pytest.approx(bound, rel=DIGITS)


@pytest.mark.parametrize("damping", [0.0, 1e-6, 1e-3, 0.1, 0.5, 0.8, 1.0])
def test_the_largest_stable_step_is_the_first_at_which_a_mode_grows(damping):
    """abs(R) along the ray of each eigenvalue -damping +- j sqrt(1 - damping^2), looked at in small steps."""
    rate = np.sqrt(1.0 - damping**2)
    plant = ct.ss(
        [[-damping, rate], [-rate, -damping]], np.ones((2, 1)), np.ones((1, 2)), [[0.0]], name="plant"
    )
    bound = largest_stable_step(pf.flatten(plant)).seconds
    w = np.linspace(0.0, 4.0, 4001)[1:] * complex(-damping, rate)
    grows = np.abs(1.0 + w + w**2 / 2 + w**3 / 6 + w**4 / 24) > 1.0 + 1e-9
    assert 0.001 * np.argmax(grows) <= bound <= 0.001 * (np.argmax(grows) + 1)


def test_export_refuses_a_step_that_diverges(tmp_path):
    lag = ct.tf([1.0], [0.34e-3, 1.0], name="lag")
    with pytest.raises(ValueError, match=r"eigenvalue -2941.*at most 0.000946 s; give substeps=2"):
        pf.export_c(lag, tmp_path / "lag")
    assert not (tmp_path / "lag").exists()
    folder = pf.export_c(lag, tmp_path / "lag", substeps=2)
    assert "2 steps of Runge-Kutta later" in (folder / "lag.c").read_text()
    folder = pf.export_c(lag, tmp_path / "lag", step=9e-4)
    assert "#define LAG_STEP 0.0009 " in (folder / "lag.h").read_text()
    with pytest.raises(ValueError, match="substeps: expected a whole number"):
        pf.export_c(lag, tmp_path / "lag", substeps=0)
    with pytest.raises(ValueError, match="step, substeps and operating_points are those of a diagram"):
        pf.export_c(pf.PhyFilter([20.0]).sampled(0.002), tmp_path / "filter", channels=1, substeps=2)


def test_export_checks_other_operating_points(tmp_path):
    """x' = -u x: nothing decays at the start, where u is 0."""
    lag = ct.nlsys(
        lambda t, x, u, p: [-u[0] * x[0]], None, inputs=["rate"], outputs=1, states=["x"], name="lag"
    )
    pf.export_c(lag, tmp_path / "lag")
    with pytest.raises(ValueError, match=r"at {'rate': 5000.0}, a mode.*at most 0.000557 s; give substeps=2"):
        pf.export_c(lag, tmp_path / "lag", operating_points=[{"x": 1.0}, {"rate": 5000.0}])
    with pytest.raises(ValueError, match="speed"):
        pf.export_c(lag, tmp_path / "lag", operating_points=[{"speed": 1.0}])


@pytest.mark.slow
def test_fmu_refuses_it_too(tmp_path):
    lag = ct.tf([1.0], [0.34e-3, 1.0], name="lag")
    experiment = pf.fmi.FmuExperiment(solver=pf.fmi.FmuSolver(step=1e-3))
    with pytest.raises(ValueError, match=r"FmuSolver\(step=0.000946\)"):
        pf.export_fmu(lag, tmp_path / "lag.fmu", platforms=(), experiment=experiment)
