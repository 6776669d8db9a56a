"""Parts of the study handed over: vehicle with its arm, controller and filters as FMUs, each replayed on a mission."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import control as ct
import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl.blocks import delay_line, wired
from phyfilter_ctl.codegen import find_compiler
from phyfilter_ctl.fmi import FmuExperiment, FmuSolver, export_fmu
from phyfilter_ctl.fmi.replay import Reference, replay
from phyfilter_ctl.fmi.unpacked import UnpackedFmu
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

__all__ = ["PARTS", "HandOver", "controller_system", "filter_system", "hand_over", "vehicle_system"]

FloatArray = NDArray[np.float64]
Fmi = Literal["2.0", "3.0"]

# A method that needs no training.
_PLAIN = Method("observer", 2.0, 4.0, 6.0)

PARTS: tuple[str, ...] = ("vehicle", "controller", "filter")
"""What is handed over."""


@dataclass(frozen=True)
class HandOver:
    """What was handed over, and how far each part is from what flew.

    Attributes
    ----------
    fmus : dict of str to Path
        By part and version, such as "vehicle, FMI 2.0".
    samples : int
        Of the mission that was replayed.
    differences : dict of str to dict of str to float
        By the same, the largest difference of every output from the one in flight: m, m/s, rad, rad/s, N, N m.
    """

    fmus: Mapping[str, Path]
    samples: int
    differences: Mapping[str, Mapping[str, float]]

    @property
    def largest(self) -> dict[str, float]:
        """The largest difference of each part, over its outputs and versions."""
        found: dict[str, float] = dict.fromkeys(PARTS, 0.0)
        for label, values in self.differences.items():
            part = label.split(",")[0]
            found[part] = max(found[part], *values.values())
        return found


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
    others = [name for name in _bases(part.input_labels) if name not in held]
    return wired(
        [*lines, part],
        {f"vehicle.{name}": f"held_{name}.y" for name in held},
        inputs={name: f"vehicle.{name}" for name in others} | {name: f"held_{name}.u" for name in held},
        outputs={name: f"vehicle.{name}" for name in _bases(part.output_labels)},
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
) -> HandOver:
    """Export vehicle, controller and filters of a method as FMUs, and replay a mission through each.

    Parameters
    ----------
    method : Method
        One with filters.
    seer : Seer or None
        SEER-I's models, for the methods that use them: they go into the filter's FMU.
    folder : str or Path
        Made if it is not there; its parent must be.
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
    HandOver

    Raises
    ------
    ValueError
        If the method has no filters.
    FileNotFoundError, FileExistsError
        If the folder cannot be made.
    CompilerError
        If this machine has no C compiler.
    """
    if not method.filters:
        raise ValueError(f"{method.name}: expected a method with filters (observer, phyfilter) to hand over")
    target = Path(folder)
    if not target.parent.is_dir():
        raise FileNotFoundError(f"{folder}: there is no folder {target.parent}")
    if target.exists() and not target.is_dir():
        raise FileExistsError(f"{folder}: is a file, expected a folder")
    find_compiler()
    records = _records(method, seer, seed, samples)
    target.mkdir(exist_ok=True)
    systems = dict(
        zip(PARTS, (vehicle_system(), controller_part(method), _filters(method, seer)), strict=True)
    )
    beginning = {f"vehicle.manipulator.r[{i}]": float(r) for i, r in enumerate(reference().r[0])}
    starts: dict[str, dict[str, float]] = {part: beginning if part == "vehicle" else {} for part in PARTS}
    fmus: dict[str, Path] = {}
    differences: dict[str, dict[str, float]] = {}
    for part, system in systems.items():
        for version in versions:
            label = f"{part}, FMI {version}"
            report(label)
            stop = float(records[part].times[-1])
            fmus[label] = export_fmu(
                system,
                target / f"aerial_manipulator_{part}_fmi{version[0]}.fmu",
                fmi=version,
                name=f"aerial_manipulator_{part}",
                solver=FmuSolver(step=params().sampling.max_step),
                experiment=FmuExperiment(stop=stop, step=params().sampling.dt),
            )
            differences[label] = _differences(fmus[label], records[part], starts[part])
    return HandOver(fmus, len(records["vehicle"].times), differences)


def _filters(method: Method, seer: Seer | None) -> ct.InterconnectedSystem:
    part = filter_part(method, seer)
    assert part is not None  # a method with filters
    return part


def _records(method: Method, seer: Seer | None, seed: int, samples: int | None) -> dict[str, Reference]:
    """What goes into every part and comes out of it on a mission, as the virtual machine flies it."""
    kept = (*SHOWN, "wind", *MEASURED, "F", "thrust", "joint_ref", "joint_rate_ref", "f_hat", "tau_hat")
    flights = fly(method, (seed,), seer, keep=kept, backend="vm")
    signals = _signals(flights)
    count = len(flights.time) if samples is None else samples
    systems = {
        "vehicle": vehicle_system(),
        "controller": controller_part(method),
        "filter": _filters(method, seer),
    }
    return {
        part: Reference(
            flights.time[:count],
            {label: signals[label][:count] for label in system.input_labels},
            {label: signals[label][:count] for label in system.output_labels if label in signals},
        )
        for part, system in systems.items()
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


def _differences(path: Path, record: Reference, start: Mapping[str, float]) -> dict[str, float]:
    fmu = UnpackedFmu(path)
    try:
        labels, outputs = replay(fmu, record, inputs_at="end", parameters=start)
    finally:
        fmu.close()
    return {
        label: float(np.abs(values - record.outputs[label]).max())
        for label, values in zip(labels, outputs.T, strict=True)
    }


def _bases(labels: Sequence[str]) -> list[str]:
    return list(dict.fromkeys(label.split("[")[0] for label in labels))
