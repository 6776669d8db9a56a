"""MuJoCo: an arm with a load that its prior does not know hangs where it should."""

import numpy as np
import pytest

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.wrappers import FeedForward, control_callback, mujoco_model

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: extra mujoco")

ARM = """
<mujoco><option timestep="0.002"/><worldbody><body><joint name="a" axis="0 1 0" damping="0.1"/>
<geom type="capsule" size=".03" fromto="0 0 0 .4 0 0" mass="1"/><body pos=".4 0 0"><joint name="b" axis="0 1 0"/>
<geom type="capsule" size=".03" fromto="0 0 0 .3 0 0" mass=".6"/><body pos=".3 0 0"><geom size=".03" mass="{load}"/>
</body></body></body></worldbody>
<actuator><motor joint="a" gear="2"/><motor joint="b" ctrlrange="-9 9" ctrllimited="true"/></actuator></mujoco>
"""


def test_the_arm_holds_an_unknown_load():
    robot, prior = (mujoco.MjModel.from_xml_string(ARM.format(load=load)) for load in (0.5, 1e-6))
    data, goal = mujoco.MjData(robot), np.array([0.3, -0.5])
    known = mujoco_model(prior)
    assert known.low.tolist() == [-np.inf, -9.0]

    def controller(model, data):
        """PD and the gravity of the prior."""
        hold = -np.asarray(known.g((data.qpos.copy(), np.zeros(2)), np.zeros(2)))
        return (hold - 30.0 * (data.qpos - goal) - 6.0 * data.qvel) / [2.0, 1.0]

    def error(callback):
        mujoco.mj_resetData(robot, data)
        mujoco.set_mjcb_control(callback)
        try:
            for _ in range(1500):
                mujoco.mj_step(robot, data)
        finally:
            mujoco.set_mjcb_control(None)
        return np.abs(data.qpos - goal).max()

    def plain(model, data):
        data.ctrl[:] = controller(model, data)

    feedforward = FeedForward(PhyFilter([15.0]).sampled(0.004).live(2), known)
    callback = control_callback(feedforward, controller)
    assert error(plain) > 0.05
    assert error(callback) < 1e-3
    assert feedforward.live.health.accepted == 750
    assert error(callback) < 1e-3  # the reset of the simulation is one of the filter
