"""The payload's part of f as f_theta: its mass as it is told, or as the separation block knows it in flight.

    f_mass = -dm (v' + g e_z),    f_theta = -dm a,    a = (g + m G e_z)/(m + dm) - G e_z

G is gravity, g the known force; a is the acceleration that the forces known give the whole mass: nothing is
differentiated. The weight -dm G e_z is left to the filter: 1 - F takes out what is constant, and while dm is being
found nothing jumps. The block watches the payload: were a drop followed slowly, the model would be wrong for seconds.
"""

from __future__ import annotations

from collections.abc import Sequence

import control as ct
import numpy as np

from phyfilter_ctl.blocks import FunctionBlock, separation_block
from phyfilter_ctl.estimation import ColouredForce, Part, Payload, SteadyForce
from phyfilter_ctl.plants import Columns, plant
from phyfilter_ctl.plants.algebra import Array
from phyfilter_ctl.plants.factory import Results

from .flights import Conditions
from .params import params

__all__ = ["NOISE", "parts", "payload_systems", "windy_payloads"]

NOISE = params().vehicle.mass * params().sensors.velocity
"""Deviation of the noise of m v, N s."""

# Prior deviations of the payload in kg, of the mean wind's force and of the gusts' in N, and the gusts' bandwidth in
# rad/s: 15 % of a wind of 8 m/s, eddies of 0.5 m at 5 m/s. Were weaker gusts declared, those would raise alarms.
_MASS, _MEAN, _GUSTS, _BANDWIDTH = 1.0, (5.0, 5.0, 0.5), 1.1, 10.0
# The payload is used from the deviation on that is this share of the nominal mass.
_KNOWN = 0.05


def windy_payloads(seeds: Sequence[int]) -> Conditions:
    """Payloads of 5 to 60 % of the nominal mass in a mean wind of 0 to 8 m/s from any side, with its turbulence.

    Parameters
    ----------
    seeds : sequence of int
        One a flight.
    """
    drawn = np.array([np.random.default_rng([seed, 1]).random(3) for seed in seeds])
    angle, none = 2.0 * np.pi * drawn[:, 2], np.zeros(len(drawn))
    mean = 8.0 * drawn[:, 1:2] * np.column_stack([np.cos(angle), np.sin(angle), none])
    return Conditions(tuple(seeds), params().vehicle.mass * (0.05 + 0.55 * drawn[:, 0]), none, mean)


def parts(gusts: float = _GUSTS) -> list[Part]:
    """What f is declared to be made of.

    Parameters
    ----------
    gusts : float
        Deviation of their force, N.
    """
    return [
        Payload(_MASS, x_per_velocity=params().vehicle.mass),
        SteadyForce(_MEAN, name="mean wind"),
        ColouredForce(gusts, _BANDWIDTH, name="gusts"),
    ]


def payload_systems(told: bool) -> tuple[list[ct.InputOutputSystem], dict[str, str]]:
    """Blocks between the signals x and g and ``payload_model.f_theta``, and the signal between them.

    Parameters
    ----------
    told : bool
        Whether the mass is the parameter ``told.mass``; else it is 0 until the data identify it.
    """
    if told:
        source = plant(
            lambda t, x, u, p: ({}, {"payload": p.mass}),
            name="told",
            states={},
            outputs={"payload": "kg"},
            params={"mass": (0.0, "kg")},
        )
        return [source, _model()], {"payload": "told.payload"}
    values = params()
    separation = separation_block(
        parts(),
        3,
        dt=values.sampling.dt,
        noise=NOISE,
        fraction={"payload": _KNOWN * values.vehicle.mass / _MASS},
        g="average",
        watch="payload",
    )
    return [separation, _model()], {"payload": "separation.payload"}


def _model() -> FunctionBlock:
    vehicle, up = params().vehicle, np.array([0.0, 0.0, 1.0])

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        a = (u.g + p.mass * p.gravity * up) / (p.mass + u.payload) - p.gravity * up
        return {}, {"f_theta": -u.payload * a}

    return plant(
        equations,
        name="payload_model",
        states={},
        inputs={"g": (np.zeros(3), "N", "known force"), "payload": (0.0, "kg", "beyond the nominal mass")},
        outputs={"f_theta": "N"},
        params={"mass": (vehicle.mass, "kg"), "gravity": (vehicle.gravity, "m/s^2")},
    )
