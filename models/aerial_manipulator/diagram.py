"""The closed loop as a python-control diagram.

    references (inputs) --> position --F--> attitude --thrust--> delay --> platform with arm --> sensors --+
                |              ^               ^                               ^    ^                      |
                |              +-- f_hat ------+-- tau_hat -- filters          |    wind, load             |
                +--> arm control -------------------------- joint commands ----+                           |
                        ^-- q, omega --------------------------------------------------------------------- +

Force:   x = m v,         g = thrust that acts - m g e_z - R D R' v,        f = f_coupling + f_payload + f_wind
Torque:  x = J omega,     g = tau that acts - omega x J omega + trim,       f = tau_coupling - trim + tau_payload
with m and J of platform and arm at home, and trim the torque of the arm's weight there.
"""

from __future__ import annotations

import control as ct
import numpy as np

from phyfilter_ctl.blocks import FunctionBlock, delay_line, learned_block, sampled_block, signal_names, wired
from phyfilter_ctl.plants import Columns, plant
from phyfilter_ctl.plants.algebra import Array
from phyfilter_ctl.plants.factory import Results

from .controller import controller_part
from .features import (
    FEATURES,
    HISTORY,
    features_block,
    prediction_block,
    spacing_steps,
    tip_block,
    trim_torque,
)
from .methods import Method
from .params import params
from .seer import Seer
from .vehicle import (
    MEASURED,
    NOISES,
    SHOWN,
    level_thrusts,
    nominal,
    vehicle_part,
)

__all__ = ["REFERENCES", "build", "filter_part"]

REFERENCES = ("r_ref", "v_ref", "a_ref", "j_ref", "d_ref", "d_rate_ref")
"""Inputs of three entries each: what the planner gives."""


def momenta() -> FunctionBlock:
    """m v and J omega with the nominal mass and inertia."""

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        return {}, {"linear": p.mass * u.v, "angular": p.J * u.omega}

    return plant(
        equations,
        name="momenta",
        states={},
        inputs={"v": (np.zeros(3), "m/s"), "omega": (np.zeros(3), "rad/s")},
        outputs={"linear": "kg m/s", "angular": "N m s"},
        params={"mass": (nominal().mass, "kg"), "J": (nominal().J, "kg m^2")},
    )


def nothing(name: str) -> FunctionBlock:
    """No force and no torque, for what takes one and is given none."""
    return plant(lambda t, x, u, p: ({}, {"zero": np.zeros(3)}), name=name, states={}, outputs={"zero": "N"})


def seer_part(seer: Seer) -> ct.InterconnectedSystem:
    """SEER-I: force and torque of the arm from the measurements and their past."""
    dt, spacing = params().sampling.dt, spacing_steps()
    past = [
        delay_line(
            [f"x[{k}]" for k in range(3)],
            spacing,
            dt,
            name=f"{signal}_{i}",
            outputs=[f"y[{k}]" for k in range(3)],
        )
        for signal in HISTORY
        for i in range(1, 4)
    ]
    models = [
        learned_block(seer.force, name="force", inputs=seer.force_features.labels),
        learned_block(seer.torque, name="torque", inputs=seer.torque_features.labels),
    ]
    wires = {f"features.{name}": f"tip.{name}" for name in ("tip", "outward")}
    wires |= {"features.tip_v_0": "tip.tip_v", "tip_v_1.x": "tip.tip_v", "prediction.outward": "tip.outward"}
    for signal in HISTORY:
        wires |= {f"features.{signal}_{i}": f"{signal}_{i}.y" for i in range(1, 4)}
        wires |= {f"{signal}_{i}.x": f"{signal}_{i - 1}.y" for i in range(2, 4)}
    for name, chosen in (("force", seer.force_features), ("torque", seer.torque_features)):
        wires |= {
            f"{name}.{feature}": f"features.{feature}" for feature in FEATURES if feature in chosen.names
        }
    wires |= {f"prediction.{name}": f"{name}.f_theta" for name in ("force", "torque")}
    return wired(
        [tip_block(), *past, features_block(), *models, prediction_block()],
        wires,
        inputs={
            "v_m": ["features.v_0", "v_1.x"],
            "q_m": ["features.q", "prediction.q"],
            "omega_m": ["features.omega_0", "omega_1.x"],
            "joint_m": "tip.joint",
            "joint_rate_m": "tip.joint_rate",
        },
        outputs={name: f"prediction.{name}" for name in ("f_theta", "tau_theta")},
        name="seer",
    )


def filter_part(method: Method, seer: Seer | None = None) -> ct.InterconnectedSystem | None:
    """What estimates the unknown force and torque; None where the method does not.

    Parameters
    ----------
    method : Method
    seer : Seer, optional
        SEER-I's models, for the methods that use them.

    Raises
    ------
    ValueError
        If the method needs models and none are given.
    """
    if not (method.filters or method.uses_seer):
        return None
    systems: list[ct.InputOutputSystem] = []
    inputs: dict[str, list[str]] = {name: [] for name in (*MEASURED[1:], "thrust", "F")}
    if method.uses_seer:
        if seer is None:
            raise ValueError(
                f"{method.name}: expected trained SEER-I models, got None; training.train() makes them"
            )
        systems.append(seer_part(seer))
        for name in MEASURED[1:]:
            inputs[name].append(f"seer.{name}")
        theta = {"f_theta": "seer.f_theta", "tau_theta": "seer.tau_theta"}
    else:
        systems.append(nothing("no_model"))
        theta = dict.fromkeys(("f_theta", "tau_theta"), "no_model.zero")
    if not method.filters:
        outputs = theta | {"f_hat": theta["f_theta"], "tau_hat": theta["tau_theta"]}
        return wired(
            systems, {}, inputs={k: v for k, v in inputs.items() if v}, outputs=outputs, name="estimator"
        )
    dt = params().sampling.dt
    systems += [
        momenta(),
        *priors(),
        sampled_block(method.force_filter().sampled(dt, g="average"), 3, name="force_filter"),
        sampled_block(method.torque_filter().sampled(dt, g="average"), 3, name="torque_filter"),
    ]
    wires = {
        "force_filter.x": "momenta.linear",
        "force_filter.g": "prior.g",
        "force_filter.f_theta": theta["f_theta"],
        "torque_filter.x": "momenta.angular",
        "torque_filter.g": "prior_torque.g",
        "torque_filter.f_theta": theta["tau_theta"],
    }
    inputs["v_m"] += ["momenta.v", "prior.v"]
    inputs["q_m"] += ["prior.q"]
    inputs["omega_m"] += ["momenta.omega", "prior_torque.omega"]
    inputs["thrust"] += ["prior.thrust", "prior_torque.thrust"]
    inputs["F"] += ["prior.F"]
    outputs = theta | {"f_hat": "force_filter.f_hat", "tau_hat": "torque_filter.f_hat"}
    outputs |= {"g": "prior.g", "g_tau": "prior_torque.g"}
    return wired(
        systems, wires, inputs={k: v for k, v in inputs.items() if v}, outputs=outputs, name="estimator"
    )


def priors() -> list[ct.InputOutputSystem]:
    """The known force and torque."""
    dt = params().sampling.dt
    return [
        nominal().known_force(dt),
        nominal().known_torque(dt, trim=trim_torque(), start=level_thrusts()),
    ]


def build(
    method: Method | None = None, seer: Seer | None = None, *, probed: bool = False
) -> ct.InterconnectedSystem:
    """The whole closed loop.

    Parameters
    ----------
    method : Method, optional
        None: the observer at 4 and 12 rad/s, which needs no training.
    seer : Seer, optional
        SEER-I's models, for the methods that use them.
    probed : bool
        As for :func:`controller_part`.

    Returns
    -------
    control.InterconnectedSystem
        Named "aerial_manipulator". Inputs: the references r_ref, v_ref, a_ref, j_ref, d_ref and d_rate_ref, the share
        of the load that hangs, taken, and white noise of unit variance, each value held for a sample. Outputs: state
        and end effector, the unknown forces and torques, wind, measurements, commands, and where the method has them
        f_theta, tau_theta, f_hat, tau_hat and what is known, g and g_tau.

    Examples
    --------
    >>> system = build()
    >>> system.name, system.ninputs, system.output_labels[:3]
    ('aerial_manipulator', 44, ['r[0]', 'r[1]', 'r[2]'])
    """
    method = Method("observer", 2.0, 4.0, 12.0) if method is None else method
    vehicle, controller = vehicle_part(), controller_part(method, probed=probed)
    estimator = filter_part(method, seer)
    signals = {name: f"vehicle.{name}" for name in (*SHOWN, "wind", *MEASURED)}
    commands = ("F", "thrust", "joint_ref", "joint_rate_ref", *(["tau"] if probed else []))
    signals |= {name: f"controller.{name}" for name in commands}
    systems: list[ct.InputOutputSystem] = [vehicle, controller]
    if estimator is not None:
        systems.append(estimator)
        signals |= {name: f"estimator.{name}" for name in signal_names(estimator.output_labels)}
    return wired(
        systems,
        signals,
        inputs=[*REFERENCES, "taken", *NOISES, *(["d_F", "d_tau"] if probed else [])],
        outputs=[*signals],
        name="aerial_manipulator",
    )
