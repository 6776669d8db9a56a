"""The filter of joint torques on bodies that MuJoCo moves: a leg on a fixed base, a body with legs on the ground."""

from dataclasses import replace

import numpy as np
import pytest

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.controllers import JointTorqueFilter
from phyfilter_ctl.plants.legged import JointSpacePrior, quantities

mujoco = pytest.importorskip("mujoco", reason="needs the extra mujoco")

H = 0.002
# M (q'_k - q'_{k-1}) / h: what MuJoCo solved for is taken back from rounded velocities; eps |q'| M/h ~ 1e-13 N m.
EXACT = 1e-10

LEG = """
<mujoco><option timestep="0.002" integrator="{integrator}"/>
<default><geom type="capsule" contype="0" conaffinity="0"/><joint damping="{damping}" armature="0.01"/></default>
<worldbody><body><joint name="roll" axis="1 0 0"/><geom fromto="0 0 0 0 .06 0" size=".03" mass=".43"/>
<body pos="0 .1 0"><joint name="hip" axis="0 1 0" stiffness="2"/><geom fromto="0 0 0 0 0 -.2" size=".02" mass=".61"/>
<body pos="0 0 -.2"><joint name="knee" axis="0 1 0"/><geom fromto="0 0 0 .05 0 -.2" size=".02" mass=".18"/>
</body></body></body></worldbody>
<actuator><motor joint="roll"/><motor joint="hip"/><motor joint="knee"/></actuator></mujoco>
"""
BODY = """
<mujoco><option timestep="0.002" integrator="implicitfast"/>
<default><joint damping="0.1" armature="0.01"/></default>
<worldbody><geom type="plane" size="5 5 .1"/><body pos="0 0 .34"><freejoint/>
<geom type="box" size=".25 .1 .05" mass="6"/>
<body pos="0 .12 0"><joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".5"/></body>
<body pos="0 -.12 0"><joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".5"/></body>
<body pos=".2 0 0"><joint axis="1 0 0"/><geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".5"/></body>
</body></worldbody></mujoco>
"""


def simulate(xml, prior, filter, f, command, steps=400, change=lambda now, data, model: now):
    """f_hat (N, n) of the filter while torques ``f`` act that it is not told of."""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    law = JointTorqueFilter(filter.sampled(model.opt.timestep, g="hold"), prior)
    nb = model.nv - len(f)
    state, f_hat = law.start(data.qvel[nb:]), [np.zeros(len(f))]
    for k in range(steps):
        tau = command(k)
        data.qfrc_applied[nb:] = tau + f
        mujoco.mj_step(model, data)
        now = change(quantities(model, data, stepped=True), data, model)
        state, estimate = law.step(state, now.qd, now, tau)
        f_hat.append(estimate)
    return np.array(f_hat)


def swing(k):
    return np.array([0.4, 1.0, 0.5]) * np.sin(0.02 * k + np.arange(3.0))


def step_response(filter, steps):
    """Of f = 1, by the record filter."""
    return filter.sampled(H).run(H * np.arange(steps + 1.0))[:, 0]


F = np.array([1.5, -0.7, 0.3])
FILTERS = [PhyFilter([10.0]), PhyFilter([400.0, 30.0]), PhyFilter.from_poles([-5.0, -20.0, -40.0])]


@pytest.mark.parametrize("filter", FILTERS, ids=["n1", "n2", "n3"])
@pytest.mark.parametrize(("integrator", "damping"), [("Euler", 0.0), ("Euler", 0.2), ("implicitfast", 0.2)])
def test_leg_with_all_known_gives_the_step_response(filter, integrator, damping):
    """A moving leg, full M(q) and bias: f_hat is the filter's own step response times f, whatever the leg does."""
    xml = LEG.format(integrator=integrator, damping=damping)
    f_hat = simulate(xml, JointSpacePrior(), filter, F, swing)
    expected = step_response(filter, 400)[:, None] * F
    np.testing.assert_allclose(f_hat, expected, atol=EXACT)


def test_diagonal_inertia_with_the_rest_known():
    """What the diagonal leaves out, (M - diag M) q'', is a bias like any other."""

    def change(now, data, model):
        off = now.M - np.diag(np.diag(now.M))
        return replace(now, bias=now.bias + off @ data.qacc)  # no damping: qacc is what the step applied

    xml = LEG.format(integrator="Euler", damping=0.0)
    f_hat = simulate(xml, JointSpacePrior(inertia="diagonal"), FILTERS[0], F, swing, change=change)
    np.testing.assert_allclose(f_hat, step_response(FILTERS[0], 400)[:, None] * F, atol=EXACT)


def test_diagonal_inertia_alone_is_wrong_while_the_leg_moves():
    xml = LEG.format(integrator="Euler", damping=0.0)
    f_hat = simulate(xml, JointSpacePrior(inertia="diagonal"), FILTERS[0], F, swing)
    assert np.abs(f_hat - step_response(FILTERS[0], 400)[:, None] * F).max() > 0.05


def test_floating_base_on_the_ground():
    """A body that falls on its legs: with contact known and the base eliminated, impacts leave no trace in f_hat."""
    f = np.array([0.5, -0.4, 0.2])
    f_hat = simulate(BODY, JointSpacePrior(base="floating"), FILTERS[0], f, lambda k: np.zeros(3))
    # The contact solver stops at its own tolerance: its force and the acceleration it left agree to that only.
    np.testing.assert_allclose(f_hat, step_response(FILTERS[0], 400)[:, None] * f, atol=1e-6)
    left_out = simulate(
        BODY, JointSpacePrior(base="floating", contact="omitted"), FILTERS[0], f, lambda k: np.zeros(3)
    )
    assert np.abs(left_out - f_hat).max() > 0.3
    base_left_out = simulate(BODY, JointSpacePrior(), FILTERS[0], f, lambda k: np.zeros(3))
    assert np.abs(base_left_out - f_hat).max() > 0.02


def test_quantities_against_a_shake_of_the_model():
    """M, bias and contact reproduce the acceleration of MuJoCo's own forward dynamics."""
    model = mujoco.MjModel.from_xml_string(BODY)
    data = mujoco.MjData(model)
    for _ in range(150):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    now = quantities(model, data)
    assert now.base == 6
    assert now.M is not None
    assert now.bias is not None
    np.testing.assert_allclose(now.M @ data.qacc, now.contact_torque - now.bias, atol=1e-8)


def test_missing_extra_is_named(monkeypatch):
    import importlib

    def absent(name, *rest, **options):
        if name == "mujoco":
            raise ImportError(name)
        return genuine(name, *rest, **options)

    genuine = importlib.import_module
    model = mujoco.MjModel.from_xml_string(BODY)
    monkeypatch.setattr("phyfilter_ctl.plants.legged.simulator.import_module", absent)
    with pytest.raises(ImportError, match=r"extra mujoco: pip install 'phyfilter-ctl\[mujoco\]'"):
        quantities(model, mujoco.MjData(model))
