"""What SEER-I sees of the arm and the platform: histories of measured signals, made into a few features.

Of linear velocity, attitude, angular velocity, joint angles and joint rates the paper takes the present and three past
values, 96 numbers here; products of their Chebyshev polynomials would be more than any flight determines. What the
coupling depends on is in them as slopes over the history: with x_0 the present sample and x_1, x_2, x_3 the past ones,
s apart,

    x' = (3 x_0 + x_1 - x_2 - 3 x_3)/(10 s)                                the least-squares slope over four samples

And an arm that turns about its base does the same in every direction, so everything is seen along the arm: x outward in
the vertical plane of the arm, which the base yaw tells, z along the body's.

    place   end effector from the arm's base, outward and up           m, from the joint angles
    rate    its velocity relative to the platform                      m/s, from joint angles and rates
    acc     its acceleration                                           m/s^2, slope of the velocity
    turn    angular acceleration of the platform                       rad/s^2, slope of omega
    felt    R' (v' + g e_z) outward and across, over g                 slope of v, and the attitude

Only lengths of the arm are needed for these, no masses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl.blocks import FunctionBlock
from phyfilter_ctl.plants import Columns, cross, plant, rotate, rotate_back, stack
from phyfilter_ctl.plants.algebra import Array
from phyfilter_ctl.plants.factory import Results

from .mission import arm
from .params import params

__all__ = [
    "FEATURES",
    "HISTORY",
    "SIZES",
    "FeatureName",
    "FeatureSet",
    "along_arm",
    "features_block",
    "from_arm",
    "prediction_block",
    "spacing_steps",
    "tip_block",
    "trim_torque",
]

FloatArray = NDArray[np.float64]

FeatureName = Literal["place", "rate", "acc", "turn", "felt"]
FEATURES: tuple[FeatureName, ...] = get_args(FeatureName)
SIZES: dict[FeatureName, int] = {"place": 2, "rate": 3, "acc": 3, "turn": 3, "felt": 2}

HISTORY = ("tip_v", "omega", "v")
"""Signals of three entries of which past values are kept."""

_WEIGHTS = (3.0, 1.0, -1.0, -3.0)


@dataclass(frozen=True)
class FeatureSet:
    """Features of a Chebyshev model, and its degree.

    Parameters
    ----------
    names : tuple of str
        Of ``FEATURES``.
    degree : int
        Of each feature.
    """

    names: tuple[FeatureName, ...]
    degree: int

    @property
    def labels(self) -> list[str]:
        """Labels of the entries."""
        return [f"{name}[{i}]" for name in self.names for i in range(SIZES[name])]


def spacing_steps() -> int:
    """Samples between two of a history."""
    return round(params().training.spacing / params().sampling.dt)


def tip_block(name: str = "tip") -> FunctionBlock:
    """End effector and its velocity from joint angles and rates, body axes, and the heading of the arm."""
    links = arm()

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        motion = links.motion(u.joint, u.joint_rate)
        outward = links.base_axes @ stack(np.cos(u.joint[0]), np.sin(u.joint[0]), 0.0)
        return {}, {"tip": motion.tip, "tip_v": motion.tip_velocity, "outward": outward[:2]}

    return plant(
        equations,
        name=name,
        states={},
        inputs={"joint": (links.home, "rad"), "joint_rate": (np.zeros(links.joints), "rad/s")},
        outputs={"tip": "m", "tip_v": "m/s", "outward": ""},
    )


def features_block(name: str = "features") -> FunctionBlock:
    """All features from present and past signals."""
    zero, spacing = np.zeros(3), spacing_steps() * params().sampling.dt
    gravity, mount = params().vehicle.gravity, arm().mount

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        def slope(signal: str) -> Array:
            samples = [getattr(u, f"{signal}_{i}") for i in range(4)]
            weighted = [weight * sample for weight, sample in zip(_WEIGHTS, samples, strict=True)]
            return (weighted[0] + weighted[1] + weighted[2] + weighted[3]) / (10.0 * p.spacing)

        place = along_arm(u.outward, u.tip - mount)
        felt = along_arm(u.outward, rotate_back(u.q, slope("v") + stack(0.0, 0.0, gravity)) / gravity)
        return {}, {
            "place": stack(place[0], place[2]),
            "rate": along_arm(u.outward, u.tip_v_0),
            "acc": along_arm(u.outward, slope("tip_v")),
            "turn": along_arm(u.outward, slope("omega")),
            "felt": felt[:2],
        }

    units = {"tip_v": "m/s", "omega": "rad/s", "v": "m/s"}
    return plant(
        equations,
        name=name,
        states={},
        inputs={
            "tip": (zero, "m"),
            "outward": [1.0, 0.0],
            "q": [1.0, 0.0, 0.0, 0.0],
            **{f"{signal}_{i}": (zero, units[signal]) for signal in HISTORY for i in range(4)},
        },
        outputs={"place": "m", "rate": "m/s", "acc": "m/s^2", "turn": "rad/s^2", "felt": ""},
        params={"spacing": (spacing, "s")},
    )


def prediction_block(name: str = "prediction") -> FunctionBlock:
    """What the models say, from along the arm back to where force and torque are wanted.

    The force model gives that of the arm along the arm, the torque model that about the arm's base. About the
    platform's centre of mass the force turns with the lever of the base, and so does the arm's weight.
    """
    links, zero = arm(), np.zeros(3)
    at_base = -np.cross(links.mount, [0.0, 0.0, links.mass * params().vehicle.gravity])

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        force = from_arm(u.outward, u.force)
        torque = from_arm(u.outward, u.torque) + cross(stack(*links.mount), force) + at_base - trim_torque()
        return {}, {"f_theta": rotate(u.q, force), "tau_theta": torque}

    return plant(
        equations,
        name=name,
        states={},
        inputs={
            "force": (zero, "N", "of the arm, along the arm"),
            "torque": (zero, "N m", "about the arm's base, along the arm"),
            "outward": [1.0, 0.0],
            "q": [1.0, 0.0, 0.0, 0.0],
        },
        outputs={"f_theta": ("N", "world"), "tau_theta": ("N m", "body, less that at home")},
    )


def trim_torque() -> FloatArray:
    """Torque of the arm's weight at home, level, body axes, N m."""
    moment = arm().mass * np.asarray(arm().centre_of_mass(arm().home), dtype=float)
    return -np.cross(moment, [0.0, 0.0, params().vehicle.gravity])


def along_arm(outward: Array, vector: Array) -> Array:
    """A vector of the body seen along the arm: outward, to the left of that, up.

    Parameters
    ----------
    outward : (2,) array
        Direction of the arm in the body's x-y plane.
    vector : (3,) array
    """
    c, s = outward[0], outward[1]
    return stack(c * vector[0] + s * vector[1], c * vector[1] - s * vector[0], vector[2])


def from_arm(outward: Array, vector: Array) -> Array:
    """The inverse of :func:`along_arm`.

    Parameters
    ----------
    outward, vector
        As there.
    """
    return along_arm(stack(outward[0], -outward[1]), vector)
