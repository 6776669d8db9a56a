"""What tracks: outer loop, attitude loop and arm."""

from __future__ import annotations

import control as ct
import numpy as np

from phyfilter_ctl.blocks import FunctionBlock, SampledBlock, sampled_block, wired
from phyfilter_ctl.controllers import arm_controller
from phyfilter_ctl.plants import Columns, allocation_matrix, plant
from phyfilter_ctl.plants.algebra import Array
from phyfilter_ctl.plants.factory import Results

from .features import trim_torque
from .methods import Method
from .mission import arm
from .params import params
from .vehicle import level_thrusts, nominal

__all__ = ["controller_part"]


def controller_part(method: Method, *, probed: bool = False) -> ct.InterconnectedSystem:
    """What tracks: outer loop, attitude loop and arm.

    Parameters
    ----------
    method : Method
    probed : bool
        With inputs d_F and d_tau that are added to the wanted force and torque, and an output tau, for margins.
    """
    vehicle, dt = params().vehicle, params().sampling.dt
    drone, gains, outer = nominal(), method.attitude, method.gains
    position = drone.position(dt, kp=outer["kp"], kd=outer["kd"], ki=outer["ki"], gains=gains)
    # Half a sample earlier than the default, as it was when all methods were tuned.
    lead = drone.motor_lag + (drone.delay + 0.5 * dt) + 0.5 * dt
    attitude = drone.attitude(dt, gains=gains, thrust_lead=lead, trim=trim_torque(), torque_estimate=True)
    systems: list[ct.InputOutputSystem] = [position, smoothing(), attitude]
    systems.append(arm_controller(arm(), tilt_bandwidth=vehicle.tilt_bandwidth, dt=dt))
    wires, thrust = {"smoothing.F": "position.F", "attitude.F": "smoothing.smooth"}, "attitude.thrust"
    probes: dict[str, str] = {}
    if probed:
        systems += [pushed(), mixed()]
        wires |= {"attitude.F": "pushed.sum", "pushed.F": "smoothing.smooth", "mixed.wanted": thrust}
        thrust, probes = "mixed.thrust", {"d_F": "pushed.d", "d_tau": "mixed.d"}
    return wired(
        systems,
        wires,
        inputs={
            "r_m": ["position.r", "arm.r"],
            "v_m": "position.v",
            "q_m": ["position.q", "attitude.q", "arm.q"],
            "omega_m": "attitude.omega",
            "f_hat": "position.f_hat",
            "tau_hat": "attitude.tau_hat",
            "r_ref": ["position.r_ref", "arm.r_ref"],
            "v_ref": "position.v_ref",
            "a_ref": "position.a_ref",
            "j_ref": "attitude.j_ref",
            "d_ref": "arm.d_ref",
            "d_rate_ref": "arm.d_rate_ref",
            **probes,
        },
        outputs={
            "F": "smoothing.smooth",
            "thrust": thrust,
            "joint_ref": "arm.joint_ref",
            "joint_rate_ref": "arm.joint_rate_ref",
            **({"tau": "mixed.tau"} if probed else {}),
        },
        name="controller",
    )


def smoothing() -> SampledBlock:
    """The wanted force behind a low-pass filter: its noise would turn into tilt, and that into torque."""
    period, weight = params().sampling.dt, np.array([0.0, 0.0, 4.0 * nominal().hover])

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        smooth = x.before + (1.0 - np.exp(-p.corner * period)) * (u.F - x.before)
        return {"before": smooth}, {"smooth": smooth}

    law = plant(
        equations,
        name="smoothing",
        states={"before": (weight, "N")},
        inputs={"F": (weight, "N")},
        outputs={"smooth": "N"},
        params={"corner": (params().vehicle.force_smoothing, "rad/s")},
        dt=period,
    )
    return sampled_block(law, name="smoothing")


def pushed() -> FunctionBlock:
    """The wanted force, with something added."""

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        return {}, {"sum": u.F + u.d}

    inputs = {"F": ([0.0, 0.0, 4.0 * nominal().hover], "N"), "d": (np.zeros(3), "N")}
    return plant(equations, name="pushed", states={}, inputs=inputs, outputs={"sum": "N"})


def mixed() -> FunctionBlock:
    """The torque of the commanded thrusts, and the thrusts with something added to it."""
    A = allocation_matrix(params().vehicle.rotor_arm, params().vehicle.torque_ratio)
    back = np.linalg.inv(A)[:, 1:]

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        return {}, {"tau": A[1:] @ u.wanted, "thrust": u.wanted + back @ u.d}

    inputs = {"wanted": (level_thrusts(), "N"), "d": (np.zeros(3), "N m")}
    return plant(equations, name="mixed", states={}, inputs=inputs, outputs={"tau": "N m", "thrust": "N"})
