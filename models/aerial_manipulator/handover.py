"""Parts of the study handed over: vehicle with its arm, controller and filters as FMUs, each replayed on a mission."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Literal

import control as ct
import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl import fmi
from phyfilter_ctl.blocks import delay_line, signal_names, wired
from phyfilter_ctl.fmi import FmuSolver, HandOver, Reference
from phyfilter_ctl.study import Report, silent

from .controller import controller_part
from .diagram import REFERENCES, filter_part
from .experiment import Flights, fly
from .flights import noise
from .methods import Method
from .mission import arm, reference
from .params import params
from .seer import Seer
from .vehicle import MEASURED, NOISES, SHOWN, vehicle_part

__all__ = ["PARTS", "controller_system", "filter_system", "hand_over", "vehicle_system"]

FloatArray = NDArray[np.float64]
Fmi = Literal["2.0", "3.0"]
_FORMATS: dict[Fmi, Literal["FMI 2.0", "FMI 3.0"]] = {"2.0": "FMI 2.0", "3.0": "FMI 3.0"}

# A method that needs no training.
_PLAIN = Method("observer", 2.0, 4.0, 6.0)

PARTS: tuple[str, ...] = ("vehicle", "controller", "filter")
"""What is handed over."""


def vehicle_system() -> ct.InterconnectedSystem:
    """Platform and arm, load, wind and sensors, for export: commands and noise in, measurements and truth out.

    What acts between the instants is held there, as it is in a run of the whole diagram with held inputs.
    """
    part, dt = vehicle_part(), params().sampling.dt
    rest = np.zeros(arm().joints)
    held = {"joint_ref": arm().home, "joint_rate_ref": rest, "taken": np.zeros(1), "n_wind": np.zeros(3)}
    lines = [
        delay_line(
            [f"u[{i}]" for i in range(len(start))],
            0,
            dt,
            name=f"held_{name}",
            outputs=[f"y[{i}]" for i in range(len(start))],
            start=start,
        )
        for name, start in held.items()
    ]
    others = [name for name in signal_names(part.input_labels) if name not in held]
    return wired(
        [*lines, part],
        {f"vehicle.{name}": f"held_{name}.y" for name in held},
        inputs={name: f"vehicle.{name}" for name in others} | {name: f"held_{name}.u" for name in held},
        outputs={name: f"vehicle.{name}" for name in signal_names(part.output_labels)},
        name="vehicle_held",
    )


def controller_system() -> ct.InterconnectedSystem:
    """The controller at 2 rad/s, for export: measurements and the planner's references in, commands out."""
    return controller_part(_PLAIN)


def filter_system() -> ct.InterconnectedSystem:
    """The observers of force (4 rad/s) and torque (6 rad/s) with what they know, for export."""
    return _filters(_PLAIN, None)


def hand_over(
    method: Method,
    seer: Seer | None,
    folder: str | Path,
    *,
    seed: int = 0,
    samples: int | None = None,
    versions: Sequence[Fmi] = ("2.0", "3.0"),
    report: Report = silent,
) -> dict[str, HandOver]:
    """Export vehicle, controller and filters of a method as FMUs, and replay a mission through each.

    Parameters
    ----------
    method : Method
        One with filters.
    seer : Seer or None
        SEER-I's models, for the methods that use them: they go into the filter's FMU.
    folder : str or Path
        As for :func:`phyfilter_ctl.fmi.hand_over`; the files are called aerial_manipulator_vehicle and so on.
    seed : int
        Of the mission.
    samples : int, optional
        From its beginning; None: all.
    versions : sequence of {"2.0", "3.0"}
        Of FMI.
    report : callable
        Called at the beginning of every export.

    Returns
    -------
    dict of str to HandOver
        By part.

    Raises
    ------
    ValueError
        If the method has no filters.
    FileNotFoundError, FileExistsError, CompilerError
        As for :func:`phyfilter_ctl.fmi.hand_over`.
    """
    if not method.filters:
        raise ValueError(f"{method.name}: expected a method with filters (observer, phyfilter) to hand over")
    records = cache(lambda: _records(method, seer, seed, samples))
    beginning = {f"vehicle.manipulator.r[{i}]": float(r) for i, r in enumerate(reference().r[0])}

    def handed(part: str) -> HandOver:
        return fmi.hand_over(
            systems[part],
            folder,
            lambda: records()[part],
            name=f"aerial_manipulator_{part}",
            formats=[_FORMATS[version] for version in versions],
            solver=FmuSolver(step=params().sampling.max_step),
            parameters=beginning if part == "vehicle" else None,
            report=lambda form: report(f"{part}, {form}"),
        )

    systems = _systems(method, seer)
    return {part: handed(part) for part in PARTS}


def _systems(method: Method, seer: Seer | None) -> dict[str, ct.InterconnectedSystem]:
    parts = (vehicle_system(), controller_part(method), _filters(method, seer))
    return dict(zip(PARTS, parts, strict=True))


def _filters(method: Method, seer: Seer | None) -> ct.InterconnectedSystem:
    part = filter_part(method, seer)
    assert part is not None  # a method with filters
    return part


def _records(method: Method, seer: Seer | None, seed: int, samples: int | None) -> dict[str, Reference]:
    """What goes into every part and comes out of it on a mission, as the virtual machine flies it."""
    commands = ("F", "thrust", "joint_ref", "joint_rate_ref")
    kept = (*SHOWN, "wind", *MEASURED, *commands, "f_hat", "tau_hat", "g", "g_tau")
    flights = fly(method, (seed,), seer, keep=kept, backend="vm")
    signals = _signals(flights)
    count = len(flights.time) if samples is None else samples
    return {
        part: Reference(
            flights.time[:count],
            {label: signals[label][:count] for label in system.input_labels},
            {label: signals[label][:count] for label in system.output_labels if label in signals},
        )
        for part, system in _systems(method, seer).items()
    }


def _signals(flights: Flights) -> dict[str, FloatArray]:
    """Every signal of the first flight by its label."""
    found: dict[str, FloatArray] = {}
    for name, values in flights.signals.items():
        found |= {f"{name}[{i}]": values[0, :, i] for i in range(values.shape[2])}
    given = np.concatenate([flights.goals.inputs(), noise(flights.seeds[:1], len(flights.time))[0]])
    sizes = dict.fromkeys(REFERENCES, 3) | {"taken": 1} | NOISES
    labels = [
        label
        for name, size in sizes.items()
        for label in ([name] if name == "taken" else [f"{name}[{i}]" for i in range(size)])
    ]
    return found | dict(zip(labels, given, strict=True))
