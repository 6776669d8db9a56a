"""The standing quadruped: the joint loop with a filter is a PID, and the linear loop says what the simulator does."""

from __future__ import annotations

import importlib

import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, models
from phyfilter_ctl.plants.legged import JointQuantities

mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed: the quadruped's stance is not tested")
stance = importlib.import_module(f"{models.__name__}.quadruped.stance")
loop = importlib.import_module(f"{models.__name__}.quadruped.loop")
params = importlib.import_module(f"{models.__name__}.quadruped.params").params

# Rounding of some thousand operations, relative to torques of 100 N m.
ROUNDING = 1e-9
# Of the sampled loop against the continuous PID: half a sample of 5 ms at 20 rad/s is 5 %, at 2 rad/s 0.5 %.
SAMPLED = 0.005
# MuJoCo's contacts under 2 N are linear to this part.
LINEAR = 0.03
# The growth of small motions against the linear loop's, relative.
GROWTH = 0.15

STIFF = (80.0, 2.0)
FILTERS = {
    "order 1": PhyFilter([1.0]),
    "order 2": PhyFilter.from_poles([-2.0, -3.0]),
    "band-pass": PhyFilter.from_poles([-0.2, -1.0], b=[0.0, 1.0]),
}


@pytest.fixture(scope="module")
def plant() -> object:
    return stance.linearized()


@pytest.mark.parametrize("name", FILTERS)
def test_controller_is_the_joint_loop(name: str) -> None:
    """The state space against the filter that flies, on random motions."""
    case = stance.Case(name, FILTERS[name], 30.0, 1.0)
    K, rng = stance.controller(case), np.random.default_rng(0)
    q, qd = rng.normal(0.0, 0.1, (200, 12)), rng.normal(0.0, 1.0, (200, 12))
    qd[0] = 0.0  # both start at rest
    q[0] = 0.0
    choice = loop.FilterChoice(tuple(case.filter.a), tuple(case.filter.b), limit=1e9, anti_windup="none")
    joints = loop.make_filter(choice)
    state, torque, wanted = joints.start(qd[:1], JointQuantities(qd[:1])), np.zeros((1, 12)), []
    x, found = np.zeros(K.nstates), []
    for k in range(200):
        if k:
            state, f_hat = joints.step(state, qd[k : k + 1], JointQuantities(qd[k : k + 1]), torque)
            torque = -30.0 * q[k : k + 1] - qd[k : k + 1] - f_hat
        wanted.append(torque[0])
        u = np.concatenate([q[k], qd[k]])
        found.append(K.C @ x + K.D @ u)
        x = K.A @ x + K.B @ u
    np.testing.assert_allclose(found, wanted, atol=ROUNDING)


def test_order_one_is_a_pid() -> None:
    case = stance.Case("", PhyFilter([1.0]), 30.0, 1.0)
    K, omega = stance.controller(case), np.array([0.1, 0.5, 1.0, 2.0])
    for joint in (0, 1, 2):
        column = [joint, 12 + joint]
        for w in omega:
            z = np.exp(1j * w * params().control.dt)
            response = (
                K.C[joint] @ np.linalg.solve(z * np.eye(K.nstates) - K.A, K.B[:, column]) + K.D[joint, column]
            )
            found = -(response[0] + 1j * w * response[1])
            assert abs(found / stance.pid(case, np.array([w]), joint)[0] - 1.0) < SAMPLED
    with pytest.raises(ValueError, match="low-pass filter of order 1"):
        stance.pid(stance.Case("", None, 30.0, 1.0), omega)


def deviations(case: object, seconds: float, force: np.ndarray, kick: float = 0.0) -> np.ndarray:
    """Place of the trunk off its stance in MuJoCo, (N, 3), the loop acting on deviations as the linear one does."""
    model, data = stance.settled()
    trunk, base, q0 = data.qpos[:3].copy(), data.ctrl.copy(), data.qpos[7:].copy()
    K, x, places = stance.controller(case), None, []
    x = np.zeros(K.nstates)
    data.qvel[3] += kick
    data.xfrc_applied[model.body("trunk").id, :3] = force
    for _ in range(round(seconds / params().control.dt)):
        u = np.concatenate([data.qpos[7:] - q0, data.qvel[6:]])
        data.ctrl[:] = base + K.C @ x + K.D @ u
        x = K.A @ x + K.B @ u
        mujoco.mj_step(model, data)
        places.append(np.concatenate([data.qpos[:3] - trunk, data.qvel[3:6]]))
    return np.array(places)


def linear(plant: object, case: object, seconds: float, force: np.ndarray) -> np.ndarray:
    loop_, out = stance.closed(case, plant), []
    x = np.zeros(loop_.nstates)
    for _ in range(round(seconds / params().control.dt)):
        x = loop_.A @ x + loop_.B @ force
        out.append(loop_.C @ x)
    return np.array(out)


@pytest.mark.parametrize("filter", [None, PhyFilter([1.0])], ids=["PD", "order 1"])
def test_linear_loop_says_how_far_the_trunk_gives_way(plant: object, filter: PhyFilter | None) -> None:
    case, force = stance.Case("", filter, *STIFF), np.array([0.0, 0.0, -2.0])
    true, found = deviations(case, 4.0, force)[:, 2], linear(plant, case, 4.0, force)[:, 2]
    assert np.abs(true - found).max() < LINEAR * np.abs(true).max()


def test_filter_takes_the_sag_and_costs_damping(plant: object) -> None:
    rows = {row.case.name: row for row in stance.study(plant=plant)}
    for gains in ("vendor", "stiff"):
        pd, one, two = (rows[f"{gains}, {name}"] for name in ("PD", "a0 = 1", "order 2 at 2 rad/s"))
        assert one.sag < 0.12 * pd.sag
        assert one.modulus_margin < pd.modulus_margin
        assert one.damping < pd.damping
        # The same integral gain, p/2 for two poles at p, and less of it where the trunk sways.
        assert two.sag == pytest.approx(one.sag, rel=0.1)
        assert two.modulus_margin > one.modulus_margin
        assert two.damping > one.damping
    assert not rows["vendor, a0 = 5"].stands
    assert rows["vendor, band-pass 0.2 to 1 rad/s"].sag > 0.6 * rows["vendor, PD"].sag


@pytest.mark.parametrize("factor", [0.9, 1.6, 2.5])
def test_simulated_stance_breaks_where_the_linear_one_does(plant: object, factor: float) -> None:
    """Below the limit a kick dies out; above it what is left of it grows as the unstable pole says."""
    bandwidth = factor * stance.largest_bandwidth(*STIFF, plant=plant)
    case = stance.Case("", PhyFilter([bandwidth]), *STIFF)
    rates = np.linalg.norm(deviations(case, 10.0, np.zeros(3), kick=1e-3)[:, 3:], axis=1)
    seconds = rates.reshape(10, -1).max(axis=1)
    (row,) = stance.study([case], plant=plant)
    assert row.stands == (factor < 1.0)
    if row.stands:
        assert seconds[-1] < 1e-4 * seconds[0]
    else:
        growth = np.log(seconds[-1] / seconds[-3]) / 2.0
        assert growth == pytest.approx(np.log(row.radius) / params().control.dt, rel=GROWTH)


def test_table_names_what_does_not_stand(plant: object) -> None:
    rows = stance.study(plant=plant)
    limits = {"vendor": (1.6, 3.1)}
    text = stance.table(rows, limits)
    assert "largest pole that stands, vendor: order 1 1.60 rad/s" in text
    data = stance.figures(rows, limits)
    assert data["stance"]["vendor, a0 = 5"]["sag_m_per_N"] is None
