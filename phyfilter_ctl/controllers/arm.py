"""The arm's control: where the end effector shall be from the platform, as commands to the joints."""

from __future__ import annotations

import numpy as np

from ..blocks import SampledBlock, sampled_block
from ..plants import (
    Columns,
    SerialArm,
    cross,
    norm,
    plant,
    rotate_back,
    stack,
)
from ..plants.algebra import Array, quaternion_product
from ..plants.factory import Results

__all__ = ["arm_controller"]


def arm_controller(
    arm: SerialArm, *, tilt_bandwidth: float, share: float = 0.0, dt: float, name: str = "arm"
) -> SampledBlock:
    """Joint commands that hold the end effector where it shall be from the platform, however that tilts in the wind.

        p = R' (d_ref + share (r_ref - r)),     p' = R' d_rate_ref - omega x p
        joint_ref = inverse(p),                 joint_rate_ref = inverse_rates(joint_ref, p')

    with the gripper level in body axes. R and omega are those of the measured attitude behind a low-pass filter,

        q_low' = tilt_bandwidth (q - q_low),    omega = 2 tilt_bandwidth vec(conj(q_low) q).

    An arm that follows every turn of the platform takes its inertia out of the attitude loop and puts the lag of its
    servos in; followed slowly, it takes out the tilt that a wind asks for and leaves the loop alone.

    Parameters
    ----------
    arm : SerialArm
        Of five joints.
    tilt_bandwidth : float
        Corner of the low-pass filter of the attitude in rad/s.
    share : float
        Of the measured position error of the platform that the arm makes up, 0 to 1.
    dt : float
        Sampling interval in seconds.
    name : str
        Name of the block.

    Returns
    -------
    SampledBlock
        Inputs d_ref and d_rate_ref (end effector less platform, m and m/s, world axes; optional: at home and at rest),
        q, r and r_ref (m, world);
        outputs joint_ref and joint_rate_ref. Parameters tilt_bandwidth and share. It starts level.

    Raises
    ------
    ValueError
        For a bandwidth that is not positive, a share outside 0 to 1, or an arm of another kind.

    Examples
    --------
    >>> from phyfilter_ctl.plants import small_arm
    >>> arm_controller(small_arm(), tilt_bandwidth=5.0, dt=0.002).output_labels[::5]
    ['joint_ref[0]', 'joint_rate_ref[0]']
    """
    if not (np.isfinite(tilt_bandwidth) and tilt_bandwidth > 0.0):
        raise ValueError(f"tilt_bandwidth: expected a positive number of rad/s, got {tilt_bandwidth}")
    if not 0.0 <= share <= 1.0:
        raise ValueError(f"share: expected 0 to 1, got {share}")
    home, zero = np.asarray(arm.end_effector(arm.home), dtype=float), np.zeros(3)

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        low = x.low / norm(x.low)
        ahead = quaternion_product(stack(low[0], -low[1:]), u.q)
        point = rotate_back(low, u.d_ref + p.share * (u.r_ref - u.r))
        moving = rotate_back(low, u.d_rate_ref) - cross(2.0 * p.tilt_bandwidth * ahead[1:], point)
        joint = arm.inverse(point)
        following = low + (1.0 - np.exp(-p.tilt_bandwidth * dt)) * (u.q - low)
        return {"low": following}, {"joint_ref": joint, "joint_rate_ref": arm.inverse_rates(joint, moving)}

    law = plant(
        equations,
        name=name,
        states={"low": ([1.0, 0.0, 0.0, 0.0], "", "attitude behind the low-pass filter")},
        inputs={
            "d_ref": (home, "m", "wanted end effector less platform, world"),
            "d_rate_ref": (zero, "m/s", "its derivative"),
            "q": ([1.0, 0.0, 0.0, 0.0], "", "attitude quaternion, body to world"),
            "r": (zero, "m", "position of the platform, world"),
            "r_ref": (zero, "m", "wanted position of the platform"),
        },
        optional=["d_ref", "d_rate_ref"],
        outputs={"joint_ref": ("rad", "commanded angles"), "joint_rate_ref": ("rad/s", "commanded rates")},
        params={
            "tilt_bandwidth": (tilt_bandwidth, "rad/s", "corner of the attitude's low-pass filter"),
            "share": (share, "", "share of the platform's error that the arm makes up"),
        },
        dt=dt,
    )
    return sampled_block(law, name=name)
