"""Sensors: the truth with white noise, as a block."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .algebra import Array, quaternion_product, stack
from .declaration import Columns
from .factory import Plant, Results, plant

__all__ = ["Sensor", "sensors"]


@dataclass(frozen=True, eq=False)
class Sensor:
    """What measures one signal.

    Parameters
    ----------
    name : str
        Of the parameter that is the noise's standard deviation.
    deviation : float
        In ``unit``; of the noise of each sample.
    unit : str
        SI unit of the signal; of a quaternion that of the angles by which it is turned off, rad.
    start : (n,) array
        Default of the signal.
    quaternion : bool
        Whether the signal is an attitude, turned off by three small angles about the body's axes.
    """

    name: str
    deviation: float
    unit: str = ""
    start: ArrayLike = (0.0, 0.0, 0.0)
    quaternion: bool = False


def sensors(signals: Mapping[str, Sensor], *, name: str = "sensors") -> Plant:
    """What is measured: every signal s as s_m = s + deviation n_s, with n_s white noise of unit variance from outside.

    An attitude is q_m = q * (1, deviation n_q / 2), of unit length.

    Parameters
    ----------
    signals : dict of str to Sensor
    name : str
        Name of the block.

    Returns
    -------
    Plant
        Static. Inputs each signal s, and its noise n_s of as many entries (of an attitude three); outputs s_m;
        parameters the deviations.

    Examples
    --------
    >>> block = sensors({"v": Sensor("velocity", 0.1, "m/s"), "q": Sensor("attitude", 0.01, "rad", quaternion=True)})
    >>> block.output_labels[::3], block.parameters
    (['v_m[0]', 'q_m[0]', 'q_m[3]'], {'velocity': 0.1, 'attitude': 0.01})
    >>> block.output(0.0, [], [1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.0])[:3].tolist()
    [1.1, 2.0, 2.9]
    """

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        measured = {}
        for signal, sensor in signals.items():
            truth, noise = getattr(u, signal), getattr(p, sensor.name) * getattr(u, f"n_{signal}")
            if sensor.quaternion:
                tilt = stack(ca.SX(1.0), 0.5 * noise)
                measured[f"{signal}_m"] = quaternion_product(truth, tilt) / ca.norm_2(tilt)
            else:
                measured[f"{signal}_m"] = truth + noise
        return {}, measured

    inputs: dict[str, tuple[ArrayLike, str]] = {}
    for signal, sensor in signals.items():
        inputs[signal] = ([1.0, 0.0, 0.0, 0.0], "") if sensor.quaternion else (sensor.start, sensor.unit)
    for signal, sensor in signals.items():
        start = _signals.real(f"{signal}: start", sensor.start)
        if start.ndim > 1:
            raise ValueError(f"{signal}: start: expected a number or shape (n,), got shape {start.shape}")
        inputs[f"n_{signal}"] = (np.zeros(3 if sensor.quaternion else start.size), "")
    return plant(
        equations,
        name=name,
        states={},
        inputs=inputs,
        outputs={f"{signal}_m": "" if s.quaternion else s.unit for signal, s in signals.items()},
        params={sensor.name: (sensor.deviation, sensor.unit) for sensor in signals.values()},
    )
