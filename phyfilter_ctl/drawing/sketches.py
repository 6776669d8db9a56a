"""What is no python-control diagram as one: a filter in its loop, a flat model, an FMU, a package of FMUs."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..diagram import FlatModel
from ..filter import FilterBank, PhyFilter, SampledPhyFilter
from .names import polynomial
from .reading import Sketch, sketch_of
from .symbols import Box, Symbol, filter_note, rate_note

if TYPE_CHECKING:
    from ..fmi import FmuDescription
    from ..fmi.ssp_geometry import SspGeometry

__all__ = ["Package", "sketched"]

_WRITTEN = 4  # order of a filter whose fraction is written out


@dataclass(frozen=True, eq=False)
class Package(Sketch):
    """A package of FMUs, and where its description says that everything stands."""

    geometry: SspGeometry | None = None


def sketched(thing: Any) -> Sketch | None:
    """A sketch of what has one; None of all else.

    Parameters
    ----------
    thing : object
        A filter, a FlatModel, an FMU's description, or the path of an FMU, a package or a filter's file.

    Raises
    ------
    ValueError
        For a path with another ending, and what reading the file raises.
    """
    from ..fmi import FmuDescription

    if isinstance(thing, str | os.PathLike):
        return _of_file(Path(thing))
    if isinstance(thing, PhyFilter | FilterBank | SampledPhyFilter):
        return _of_filter(thing)
    if isinstance(thing, FlatModel):
        periods = sorted({task.period for task in thing.tasks} | ({thing.dt} if thing.dt else set()))
        notes = [f"{len(thing.states)} states"] if thing.states else []
        note = ", ".join(notes + [rate_note(period) for period in periods])
        inputs, outputs = ([variable.name for variable in side] for side in (thing.inputs, thing.outputs))
        units = {variable.name: variable.unit for variable in (*thing.inputs, *thing.outputs)}
        return _of_one(thing.name, inputs, outputs, note, units)
    if isinstance(thing, FmuDescription):
        inputs, outputs = (
            [label for v in thing.of(side) for label in v.labels] for side in ("input", "output")
        )
        return _of_one(thing.name, inputs, outputs, f"FMI {thing.fmi}", _units(thing))
    return None


def _of_file(path: Path) -> Sketch | None:
    from ..filterfile import load
    from ..fmi import describe

    match path.suffix.lower():
        case ".fmu":
            return sketched(describe(path))
        case ".ssp":
            return _of_package(path)
        case ".toml":
            return sketched(load(path))
    raise ValueError(f"system: expected the path of an .fmu, an .ssp or a filter's .toml, got {path.name!r}")


def _units(thing: FmuDescription) -> dict[str, str]:
    return {label: variable.unit for variable in thing.variables for label in variable.labels}


def _of_one(
    name: str, inputs: Sequence[str], outputs: Sequence[str], note: str, units: Mapping[str, str]
) -> Sketch:
    box = Box(name, tuple(inputs), tuple(outputs), Symbol("block", note=note), units)
    wires = {f"{name}.{label}": {label: 1.0} for label in inputs}
    return sketch_of(name, [box], wires, inputs, {label: {f"{name}.{label}": 1.0} for label in outputs})


def _of_package(path: Path) -> Package:
    from ..fmi import describe
    from ..fmi.ssp_read import read_package

    package = read_package(path)
    system = package.system
    boxes = []
    for name, file in package.files.items():
        found = describe(file)
        ins, outs = (
            tuple(label for v in found.of(side) for label in v.labels) for side in ("input", "output")
        )
        boxes.append(Box(name, ins, outs, Symbol("block", note=f"FMI {found.fmi}"), _units(found)))
    wires: dict[str, dict[str, float]] = {}
    for wire in package.wires:
        wires.setdefault(wire.sink, {})[wire.source] = wire.gain
    for label, sinks in system.ends.items():
        for wire in sinks:
            wires.setdefault(wire.sink, {})[label] = wire.gain
    outputs = {label: {source: 1.0} for label, source in system.outputs.items()}
    sketch = sketch_of(package.name, boxes, wires, tuple(system.inputs), outputs)
    return Package(**vars(sketch), geometry=package.geometry)


def _of_filter(filter: PhyFilter | FilterBank | SampledPhyFilter) -> Sketch:
    """M x' = g + f with g = u - f_hat, and f_hat = f_theta + F(s) (M x' - g - f_theta)."""
    sampled = isinstance(filter, SampledPhyFilter)
    filters = filter.filters if sampled else (filter,) if isinstance(filter, PhyFilter) else tuple(filter)
    channels = (filter.sampling.n_x or 1) if sampled and len(filters) == 1 else len(filters)
    lines = ("F(s)",)
    if len(filters) == 1 and filters[0].order <= _WRITTEN:
        top = np.trim_zeros(filters[0].b[::-1], "f").tolist()
        lines = polynomial(top, "s"), polynomial([1.0, *filters[0].a[::-1].tolist()], "s")
    note = ", ".join(text for text in (filter_note(filters), rate_note(filter.dt) if sampled else "") if text)

    def entries(label: str) -> tuple[str, ...]:
        return (label,) if channels == 1 else tuple(f"{label}[{k}]" for k in range(channels))

    def box(name: str, inputs: Sequence[str], output: str, symbol: Symbol) -> Box:
        return Box(
            name, tuple(entry for label in inputs for entry in entries(label)), entries(output), symbol
        )

    boxes = [
        box("known", ["u", "f_hat"], "g", Symbol("sum", signs=(1, -1))),
        box("sum", ["g", "f"], "y", Symbol("sum", signs=(1, 1))),
        box("robot", ["force"], "x", Symbol("fraction", ("1", "M s"))),
        box("inertia", ["x"], "y", Symbol("fraction", ("M s", "1"))),
        box("residual", ["rate", "g", "f_theta"], "residual", Symbol("sum", signs=(1, -1, -1))),
        box("F", ["residual"], "y", Symbol("filter", lines, note, period=filter.dt if sampled else 0.0)),
        box("estimate", ["f", "f_theta"], "f_hat", Symbol("sum", signs=(1, 1))),
        box("model", ["x"], "f_theta", Symbol("learned")),
    ]
    joined = {
        "known.u": "u", "known.f_hat": "estimate.f_hat", "sum.g": "known.g", "sum.f": "f", "robot.force": "sum.y",
        "inertia.x": "robot.x", "residual.rate": "inertia.y", "residual.g": "known.g", "model.x": "robot.x",
        "residual.f_theta": "model.f_theta", "F.residual": "residual.residual", "estimate.f": "F.y",
        "estimate.f_theta": "model.f_theta",
    }  # fmt: skip
    shown = {"x": "robot.x"}
    wires, outputs = (
        {
            a: {b: 1.0}
            for sink, source in some.items()
            for a, b in zip(entries(sink), entries(source), strict=True)
        }
        for some in (joined, shown)
    )
    return sketch_of("PhyFilter", boxes, wires, (*entries("u"), *entries("f")), outputs)
