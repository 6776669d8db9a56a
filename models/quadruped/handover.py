"""The robot and its joint loop handed over as FMUs.

    policy --target--> [joint loop: PD and filter] --torque--> [robot: MuJoCo] --q, q'--> both

The damping is known by its impulse: with x = M q' + d (q - h q'/2) the difference of x over a step is that of M q' plus
h d times the mean velocity of its ends, as MuJoCo advances q with the new velocity. g is the motors' torque alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import casadi as ca
import control as ct
import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl.blocks import FunctionBlock, sampled_block, wired
from phyfilter_ctl.filter import PhyFilter
from phyfilter_ctl.fmi import FmuExperiment, export_fmu, export_mujoco_fmu
from phyfilter_ctl.fmi.description import Fmi
from phyfilter_ctl.plants import Columns, plant
from phyfilter_ctl.plants.algebra import Array
from phyfilter_ctl.plants.factory import Results

from .gait import neutral
from .params import params
from .robot import joint_inertia, mjcf
from .terrain import Terrain

__all__ = ["Gains", "joint_loop_fmu", "joint_loop_system", "quadruped_fmu", "resting", "robot_xml"]

FloatArray = NDArray[np.float64]

_JOINTS = 12


@dataclass(frozen=True)
class Gains:
    """Of the joints' PD law.

    Parameters
    ----------
    kp : float
        N m/rad.
    kd : float
        N m s/rad.
    """

    kp: float
    kd: float


def robot_xml(terrain: Terrain | None = None) -> str:
    """MJCF of the robot on a ground, with its friction.

    Parameters
    ----------
    terrain : Terrain, optional
        None: flat.
    """
    p = params()
    if terrain is None:
        return mjcf(p)
    # Where robots are stepped in process, the ground's factor is put on their feet.
    feet = replace(p.robot, friction=p.robot.friction * terrain.friction)
    return mjcf(replace(p, robot=feet), terrain=terrain)


def resting(joints: FloatArray) -> FloatArray:
    """Positions (19,) of a robot at rest at the origin.

    Parameters
    ----------
    joints : (12,) array
        Angles, rad.
    """
    p = params()
    return np.concatenate([[0.0, 0.0, p.gait.height + p.robot.foot_radius, 1.0, 0.0, 0.0, 0.0], joints])


def quadruped_fmu(
    path: str | Path, *, terrain: Terrain | None = None, joints: FloatArray | None = None, fmi: Fmi = "3.0"
) -> Path:
    """Write the robot as a co-simulation FMU with MuJoCo inside; torques in, motion and foot loads out.

    Parameters
    ----------
    path : str or Path
    terrain : Terrain, optional
        None: flat.
    joints : (12,) array, optional
        Angles at the start, rad; None: the neutral stance.
    fmi : {"3.0", "2.0"}

    Returns
    -------
    Path

    Raises
    ------
    ImportError
        Without the extra ``mujoco``.
    CompilerError
        Without a C compiler, or on another system than Linux.
    """
    return export_mujoco_fmu(
        robot_xml(terrain),
        path,
        fmi=fmi,
        name="quadruped",
        body="trunk",
        start=resting(neutral() if joints is None else joints),
        experiment=FmuExperiment(
            stop=2.0,
            step=params().control.dt,
            description=f"Quadruped of {params().robot.mass:g} kg, torque-controlled; force acts on the trunk",
        ),
    )


def _momentum() -> FunctionBlock:
    """x of the filter: momentum of the joints and what their damping took away."""
    p = params()
    zeros = np.zeros(_JOINTS)

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        return {}, {"x": p.inertia * u.qd + p.damping * (u.q - 0.5 * p.period * u.qd)}

    return plant(
        equations,
        name="momentum",
        states={},
        inputs={"q": (zeros, "rad"), "qd": (zeros, "rad/s")},
        outputs={"x": "N m s"},
        params={
            "inertia": (joint_inertia(), "kg m^2"),
            "damping": (p.robot.damping, "N m s/rad"),
            "period": (p.control.dt, "s"),
        },
    )


def _law(gains: Gains) -> FunctionBlock:
    """tau = Kp (q_d - f_hat/Kp - q) - Kd q', cut at the motors' limits."""
    zeros = np.zeros(_JOINTS)

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        torque = p.kp * (u.target - u.f_hat / p.kp - u.q) - p.kd * u.qd
        return {}, {"torque": ca.fmin(ca.fmax(torque, -p.limit), p.limit), "estimate": u.f_hat}

    return plant(
        equations,
        name="law",
        states={},
        inputs={
            "target": (neutral(), "rad"),
            "q": (zeros, "rad"),
            "qd": (zeros, "rad/s"),
            "f_hat": (zeros, "N m"),
        },
        outputs={"torque": "N m", "estimate": "N m"},
        params={
            "kp": (gains.kp, "N m/rad"),
            "kd": (gains.kd, "N m s/rad"),
            "limit": (np.tile(params().robot.torque_limits, 4), "N m"),
        },
    )


def joint_loop_system(gains: Gains | None = None) -> ct.InterconnectedSystem:
    """PD law and filter of all joints at 200 Hz: target, q and q' in, torque and f_hat out.

    Parameters
    ----------
    gains : Gains, optional
        None: the vendor's.
    """
    p = params()
    chosen = Gains(p.control.kp, p.control.kd) if gains is None else gains
    sampled = PhyFilter([p.filter.a0]).sampled(p.control.dt, limit=p.filter.limit)
    return wired(
        [_momentum(), _law(chosen), sampled_block(sampled, _JOINTS, f_theta=False, name="filter")],
        {
            "filter.x": "momentum.x",
            "filter.g": "law.torque",
            "law.f_hat": "filter.f_hat",
        },
        inputs={"target": "law.target", "q": ["momentum.q", "law.q"], "qd": ["momentum.qd", "law.qd"]},
        outputs={"torque": "law.torque", "f_hat": "law.estimate"},
        name="joint_loop",
    )


def joint_loop_fmu(path: str | Path, *, gains: Gains | None = None, fmi: Fmi = "3.0") -> Path:
    """Write the joint loop as a co-simulation FMU.

    Parameters
    ----------
    path : str or Path
    gains : Gains, optional
        None: the vendor's.
    fmi : {"3.0", "2.0"}

    Returns
    -------
    Path

    Raises
    ------
    CompilerError
        If the compiler fails.
    """
    return export_fmu(
        joint_loop_system(gains),
        path,
        fmi=fmi,
        kinds=("cs",),
        experiment=FmuExperiment(stop=2.0, step=params().control.dt),
    )
