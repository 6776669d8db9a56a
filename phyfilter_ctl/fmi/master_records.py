"""The structures of the master's loop in C (pf_master.h), filled from the parts of a run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from .._sections import FloatArray
from .cosimulation_loops import Loop
from .cosimulation_part import Part
from .cosimulation_parts import FmuPart
from .cosimulation_system import SystemPart
from .instance import FmuInstance
from .signals import Group

__all__ = ["MASTER", "PYTHON_PART", "SPANS", "Records", "calls_of"]

# All members have 8 bytes.
_WIRES = np.dtype([(name, np.int64) for name in ("row", "column", "weight", "offset", "driven")])
_GROUP = np.dtype(
    [
        (name, np.int64)
        for name in ("type", "get", "set", "references", "n_references", "n", "values", "places")
    ]
)
_PART = np.dtype(
    [
        (name, np.int64)
        for name in (
            "kind", "instance", "step", "save", "restore", "forget", "ended", "told", "slopes", "inputs", "outputs",
            "sloped", "n_inputs", "n_outputs", "u_begin", "u_end", "y_begin", "y_end", "feedthrough", "follows",
            "changed", "stale", "state", "status", "terminated", "code",
        )
    ]
    + [("reached", np.float64)]
    + [
        (name, np.int64)
        for name in ("n_x", "x", "saved_x", "work", "output", "orders", "transitions", "spans", "slot")
    ]
)  # fmt: skip
_LOOP = np.dtype(
    [
        (name, np.int64)
        for name in (
            "n", "ready", "inputs", "real", "n_parts", "parts", "inverse", "v", "r", "step", "fresh", "left",
        )
    ]
    + [("scale", np.float64)]
)  # fmt: skip
MASTER = np.dtype(
    [(name, np.int64) for name in ("n_parts", "parts", "sequence", "n_u", "n_y")]
    + [("wires", _WIRES), ("outside", _WIRES)]
    + [
        (name, np.int64)
        for name in (
            "n_outside", "n_table", "place", "functions", "table_t", "table", "now", "base", "rate", "passes",
            "n_loops", "loops", "held", "settled_in_python", "loops_in_python", "u", "y", "v", "saved_u", "saved_y",
            "coarse", "watched", "first", "moves", "y_begin", "y_slope", "saved_slope", "u_slope",
        )
    ]
    + [(name, np.float64) for name in ("rtol", "atol", "step", "smallest")]
    + [(name, np.int64) for name in ("steps", "rejected", "threads", "pool", "python")]
    + [(name, np.int64) for name in ("failed_part", "failed_call", "failed_place", "failed_status")]
    + [("failed_time", np.float64)]
)  # fmt: skip
_TYPES = (
    "Float64", "Float32", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64", "fmi2Boolean",
    "fmi3Boolean",
)  # fmt: skip
_NAMES = {
    "fmi2GetReal": "Float64",
    "fmi2GetInteger": "Int32",
    "fmi2GetBoolean": "fmi2Boolean",
    "fmi3GetBoolean": "fmi3Boolean",
}
PYTHON_PART, _LINEAR, _FMI2, _FMI3 = range(4)
SPANS = 8


class Records:
    """Makes structures and keeps what they point to.

    Attributes
    ----------
    transitions : dict of int to (SPANS, states, states + inputs) array
        Of the linear parts, by their place.
    inverses : list of (k, k) array
        Of the loops.
    """

    def __init__(self) -> None:
        self._kept: list[NDArray[np.generic]] = []
        self.transitions: dict[int, FloatArray] = {}
        self.inverses: list[FloatArray] = []

    def address(self, values: NDArray[np.generic]) -> int:
        """Where an array is, which lives as long as this object.

        Parameters
        ----------
        values : array
        """
        values = np.ascontiguousarray(values)
        self._kept.append(values)
        return values.ctypes.data

    def parts(
        self, parts: Sequence[Part], inputs: Sequence[slice], outputs: Sequence[slice]
    ) -> NDArray[np.void]:
        """Structures of parts.

        Parameters
        ----------
        parts : sequence of Part
        inputs, outputs : sequence of slice
            Their places in u and y.
        """
        records = np.zeros(len(parts), _PART)
        for p, (entry, part, u, y) in enumerate(zip(records, parts, inputs, outputs, strict=True)):
            entry["u_begin"], entry["u_end"], entry["y_begin"], entry["y_end"] = (
                u.start,
                u.stop,
                y.start,
                y.stop,
            )
            entry["feedthrough"] = bool(np.any(part.feedthrough))
            entry["kind"], entry["follows"] = PYTHON_PART, part.interpolates
            if part.in_python:
                continue
            if isinstance(part, FmuPart):
                self._fmu(entry, part, u.start, y.start)
            elif isinstance(part, SystemPart):
                self._linear(entry, p, part)
        return records

    def loops(self, loops: Sequence[Loop]) -> NDArray[np.void]:
        """Structures of algebraic loops.

        Parameters
        ----------
        loops : sequence of Loop
        """
        records = np.zeros(len(loops), _LOOP)
        for entry, loop in zip(records, loops, strict=True):
            n = len(loop.inputs)
            self.inverses.append(np.eye(n))
            entry["n"], entry["n_parts"], entry["scale"] = n, len(loop.parts), loop.scale
            entry["inputs"], entry["parts"] = (
                self.address(np.array(places, np.int64)) for places in (loop.inputs, loop.parts)
            )
            entry["real"] = self.address(loop.real.astype(np.uint8))
            entry["inverse"] = self.address(self.inverses[-1])
            for name in ("v", "r", "step", "fresh", "left"):
                entry[name] = self.address(np.zeros(n))
        return records

    def wires(self, weights: FloatArray, offset: FloatArray, driven: NDArray[np.bool_]) -> np.void:
        """Structure of a sparse matrix.

        Parameters
        ----------
        weights : (n, m) array
        offset : (n,) array
        driven : (n,) bool array
        """
        sparse = csr_array(weights)
        record = np.zeros(1, _WIRES)[0]
        record["row"] = self.address(sparse.indptr.astype(np.int64))
        record["column"] = self.address(sparse.indices.astype(np.int64))
        record["weight"], record["offset"] = self.address(sparse.data), self.address(offset)
        record["driven"] = self.address(driven.astype(np.uint8))
        return record

    def _fmu(self, entry: np.void, part: FmuPart, u: int, y: int) -> None:
        instance = part.instance
        two = instance.description.fmi == "2.0"
        entry["kind"], entry["instance"] = _FMI2 if two else _FMI3, instance.component
        for name, field in zip(calls_of(part), ("step", "save", "restore", "forget"), strict=False):
            entry[field] = instance.function_address(name)
        for field, signals, start in (("inputs", part.input_signals, u), ("outputs", part.output_signals, y)):
            groups = np.zeros(len(signals.groups), _GROUP)
            for record, group in zip(groups, signals.groups, strict=True):
                self._group(record, instance, group, start)
            entry[field], entry[f"n_{field}"] = self.address(groups), len(groups)
        if two:
            entry["ended"] = instance.function_address("fmi2GetBooleanStatus")
            entry["told"] = instance.function_address("fmi2GetRealStatus")
        if part.slope_signals is not None:
            places, references, orders, values = part.slope_signals
            group = np.zeros(1, _GROUP)
            group["references"], group["values"] = (
                self.address(np.ctypeslib.as_array(array)) for array in (references, values)
            )
            group["n"] = group["n_references"] = len(places)
            group["places"] = self.address(places.astype(np.int64) + u)
            entry["sloped"], entry["orders"] = (
                self.address(group),
                self.address(np.ctypeslib.as_array(orders)),
            )
            entry["slopes"] = instance.function_address("fmi2SetRealInputDerivatives")

    def _group(self, record: np.void, instance: FmuInstance, group: Group, start: int) -> None:
        record["type"] = _TYPES.index(_NAMES.get(group.get, group.get.removeprefix("fmi3Get")))
        record["get"], record["set"] = map(instance.function_address, (group.get, group.set))
        record["references"] = self.address(np.array(group.references, np.uint32))
        record["n_references"], record["n"] = len(group.references), len(group.places)
        record["values"] = self.address(group.view)
        record["places"] = self.address(group.places.astype(np.int64) + start)

    def _linear(self, entry: np.void, p: int, part: SystemPart) -> None:
        n = len(part.state)
        entry["kind"], entry["n_x"] = _LINEAR, n
        entry["x"] = self.address(part.state)  # shared: Python sees the states, where it solves a loop
        entry["saved_x"], entry["work"] = self.address(np.zeros(n)), self.address(np.zeros(n))
        entry["output"] = self.address(part.output_matrix)
        self.transitions[p] = np.zeros((SPANS, n, n + len(part.inputs)))
        entry["transitions"] = self.address(self.transitions[p])
        entry["spans"] = self.address(np.zeros(SPANS))


def calls_of(part: FmuPart) -> tuple[str, ...]:
    """Functions of a step and of the state, in the order of the C code.

    Parameters
    ----------
    part : FmuPart
    """
    prefix, state = f"fmi{part.instance.description.fmi[0]}", "FMUState"
    if prefix == "fmi2":
        state = "FMUstate"
    verbs = ("Get", "Set", "Free") if part.can_go_back else ()
    return (f"{prefix}DoStep", *(f"{prefix}{verb}{state}" for verb in verbs))
