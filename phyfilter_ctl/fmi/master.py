"""The master's inner loop in C: what `Run` does step by step in Python, for FMUs of this process."""

from __future__ import annotations

import ctypes as ct
import time
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, NoReturn, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from .._sections import FloatArray
from ..codegen import CompilerError
from ..codegen.compiler import cached_library
from .cosimulation_loops import Loop
from .cosimulation_outside import Outside
from .cosimulation_part import SMALLEST, Part, StepControl, StuckError, step_counts, too_small, unsettled
from .cosimulation_parts import FmuPart
from .cosimulation_wiring import Wiring
from .instance import FmuInstance
from .messages import claim_messages
from .signals import Group

if TYPE_CHECKING:
    from tqdm import tqdm

__all__ = ["FastMaster"]

# The structures of pf_master.c, all of whose members have 8 bytes.
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
            "instance", "fmi", "step", "save", "restore", "forget", "inputs", "outputs", "n_inputs", "n_outputs",
            "u_begin", "u_end", "feedthrough", "changed", "state", "status", "terminated",
        )
    ]
    + [("reached", np.float64)]
)  # fmt: skip
_MASTER = np.dtype(
    [(name, np.int64) for name in ("n_parts", "parts", "sequence", "n_u", "n_y")]
    + [("wires", _WIRES), ("outside", _WIRES)]
    + [(name, np.int64) for name in ("n_outside", "n_table", "place", "table_t", "table", "now", "passes")]
    + [(name, np.int64) for name in ("u", "y", "v", "saved_u", "saved_y", "coarse", "watched")]
    + [(name, np.float64) for name in ("rtol", "atol", "step", "smallest")]
    + [(name, np.int64) for name in ("steps", "rejected", "threads", "pool")]
    + [(name, np.int64) for name in ("failed_part", "failed_call", "failed_place", "failed_status")]
    + [("failed_time", np.float64)]
)
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
_FINE, _CALL_FAILED, _OUT_OF_RANGE, _STEP_TOO_SMALL, _TERMINATED, _NOT_FINITE, _NO_THREADS, _UNSETTLED = (
    range(8)
)
_STEP = 2  # calls: get, set, step, save, restore
_CHUNK = 0.05  # s of running between two updates of the progress bar
_PIECE = 20_000  # steps of a call


@cache
def _library() -> ct.CDLL | None:
    """The compiled loop; None where there is no C compiler, or pointers have not 8 bytes."""
    if ct.sizeof(ct.c_void_p) != 8:
        return None
    text = (resources.files("phyfilter_ctl.fmi") / "shell" / "pf_master.c").read_text(encoding="utf-8")
    try:
        library = ct.CDLL(str(cached_library({"pf_master.c": text}, name="the master", flags=["-pthread"])))
    except (CompilerError, OSError):
        return None
    library.pf_master_run.argtypes = [
        ct.c_void_p,
        ct.c_void_p,
        ct.c_int64,
        *[ct.c_void_p] * 2,
        ct.c_int64,
        ct.c_void_p,
    ]
    library.pf_master_run.restype = ct.c_int64
    return library


class Course(Protocol):
    """What the loop needs to know of a run."""

    parts: Sequence[Part]
    wiring: Wiring
    outside: Outside
    sequence: Sequence[int] | None
    chosen: Mapping[str, int]
    loops: tuple[Loop, ...]
    u: FloatArray
    y: FloatArray
    watched: NDArray[np.bool_]
    steps: int
    rejected: int

    @property
    def passes(self) -> int:
        """How often signals are handed on at one instant."""
        ...

    def refuse_nonfinite(self, t: float) -> None:
        """Raise where an output has no value."""
        ...


class FastMaster:
    """A run's inner loop in C.

    Parameters
    ----------
    run : Course
        Initialised; its inputs and outputs are those of the C loop from now on.
    library : ctypes.CDLL
    threads : int
        For the steps of Jacobi.
    """

    def __init__(self, run: Course, library: ct.CDLL, threads: int) -> None:
        self._run, self._library = run, library
        self._kept: list[NDArray[np.generic]] = []  # what the structures point to
        self._vectors: dict[str, FloatArray] = {}
        self._parts: list[FmuPart] = [part for part in run.parts if isinstance(part, FmuPart)]
        wiring, outside = run.wiring, run.outside
        self._record = np.zeros(1, _MASTER)
        master = self._record[0]
        master["n_parts"], master["n_u"], master["n_y"] = len(self._parts), len(run.u), len(run.y)
        records = np.zeros(len(self._parts), _PART)
        places = zip(wiring.input_slices, wiring.output_slices, strict=True)
        for record, part, (inputs, outputs) in zip(records, self._parts, places, strict=True):
            self._describe(record, part, inputs, outputs)
        master["parts"] = self._address(records)
        if run.sequence is not None:
            master["sequence"] = self._address(np.array(run.sequence, np.int64))
        master["wires"] = self._wires(wiring.weights, wiring.offset, wiring.driven)
        master["outside"] = self._wires(outside.matrix, outside.offset, outside.driven)
        master["n_outside"] = len(outside.labels)
        master["now"] = self._address(np.zeros(len(outside.labels)))
        master["passes"] = run.passes
        master["u"], master["y"] = self._address(run.u), self._address(run.y)
        for name, like in (("v", run.u), ("saved_u", run.u), ("saved_y", run.y), ("coarse", run.y)):
            self._vectors[name] = np.zeros_like(like)
            master[name] = self._address(self._vectors[name])
        master["watched"] = self._address(run.watched.astype(np.uint8))
        master["threads"] = min(threads, len(self._parts))
        self._chosen = np.array(list(run.chosen.values()), np.int64)

    @classmethod
    def of(cls, run: Course, *, controlled: bool, threads: int) -> FastMaster | None:
        """The C loop of a run, where all its parts are FMUs of this process, no signals depend on themselves, and there
        is a C compiler.

        Parameters
        ----------
        run : Course
        controlled : bool
            Whether steps go by the error, at times that are not known before.
        threads : int
        """
        here = all(isinstance(part, FmuPart) and part.in_reach_of_c for part in run.parts)
        if not here or run.loops or (controlled and run.outside.has_functions):
            return None
        library = _library()
        return None if library is None else cls(run, library, threads)

    def over(
        self,
        times: FloatArray,
        step: float | None,
        control: StepControl | None,
        rows: FloatArray,
        progress: tqdm[NoReturn],
    ) -> None:
        """Fill the rows of results at times[1:], as far as the run goes.

        Parameters
        ----------
        times : (N,) array
        step : float, optional
        control : StepControl, optional
        rows : (N, chosen) array
        progress : tqdm

        Raises
        ------
        FmuError
            If an FMU fails.
        StuckError
            If the run cannot go on.
        """
        master = self._record[0]
        if control is not None:
            master["rtol"], master["atol"], master["step"] = control.rtol, control.atol, control.step
            master["smallest"] = SMALLEST * (times[-1] - times[0])
        claim_messages()
        done, count, code = 0, 1, _FINE
        while done < len(times) - 1 and code == _FINE:
            count = min(count, len(times) - 1 - done)
            ends = np.ascontiguousarray(times[done : done + count + 1])
            points, keep = _points(ends, step if control is None else None)
            self._drive(times if control else points)
            filled = np.full((count, rows.shape[1]), np.nan)
            began = time.perf_counter()
            code = self._call(points, keep, filled)
            took = time.perf_counter() - began
            rows[done + 1 : done + 1 + count] = filled
            progress.update(count)
            done += count
            count = max(1, min(2 * count, int(count * _CHUNK / max(took, 1e-9))))
        self._run.steps, self._run.rejected = int(master["steps"]), int(master["rejected"])
        if code != _FINE:
            self._failed(code)

    def _call(self, points: FloatArray, keep: NDArray[np.uint8], filled: FloatArray) -> int:
        """Steps from point to point, in pieces: between them Python sees a key that is pressed."""
        row = 0
        for first in range(0, len(keep), _PIECE):
            part = keep[first : first + _PIECE]
            code = self._library.pf_master_run(
                self._record.ctypes.data, points[first:].ctypes.data, len(part), part.ctypes.data,
                self._chosen.ctypes.data, len(self._chosen), filled[row:].ctypes.data,
            )  # fmt: skip
            row += int(np.count_nonzero(part))
            if code != _FINE:
                return int(code)
        return _FINE

    def _failed(self, code: int) -> None:
        master, run = self._record[0], self._run
        place, t = int(master["failed_place"]), float(master["failed_time"])
        part = self._parts[int(master["failed_part"])]
        if code == _CALL_FAILED:
            call = int(master["failed_call"])
            if call < _STEP:
                group = (part.output_signals, part.input_signals)[call].groups[place]
                function = (group.get, group.set)[call]
            else:
                function = _calls(part)[call - _STEP]
            raise part.instance.failure(function, int(master["failed_status"]), t)
        if code == _NO_THREADS:
            raise MemoryError("no memory for threads; expected threads=1")
        if code == _TERMINATED:
            raise part.instance.ended(t)
        if code == _OUT_OF_RANGE:
            part.instance.time = t
            part.put(
                self._vectors["v"][run.wiring.input_slices[int(master["failed_part"])]]
            )  # raises, with words
        if code == _NOT_FINITE:
            run.y[:] = self._vectors["coarse"]
            run.refuse_nonfinite(t)
        if code == _UNSETTLED:
            raise StuckError(unsettled(t))
        raise StuckError(too_small(t, float(master["smallest"])))

    def _drive(self, times: FloatArray) -> None:
        """What comes from outside at these times."""
        master = self._record[0]
        if master["n_outside"]:
            self._driven = np.ascontiguousarray(times), self._run.outside.over(times)
            master["n_table"], master["place"] = len(times), 0
            master["table_t"], master["table"] = (values.ctypes.data for values in self._driven)

    def _describe(self, entry: np.void, part: FmuPart, inputs: slice, outputs: slice) -> None:
        """Fill the structure of a part."""
        instance = part.instance
        entry["instance"], entry["fmi"] = instance.component, int(instance.description.fmi[0])
        for name, field in zip(_calls(part), ("step", "save", "restore", "forget"), strict=False):
            entry[field] = instance.function_address(name)
        sides = (("inputs", part.input_signals, inputs), ("outputs", part.output_signals, outputs))
        for field, signals, place in sides:
            groups = np.zeros(len(signals.groups), _GROUP)
            for record, group in zip(groups, signals.groups, strict=True):
                self._describe_group(record, instance, group, place.start)
            entry[field], entry[f"n_{field}"] = self._address(groups), len(groups)
        entry["u_begin"], entry["u_end"] = inputs.start, inputs.stop
        entry["feedthrough"] = bool(np.any(part.feedthrough))

    def _describe_group(self, record: np.void, instance: FmuInstance, group: Group, start: int) -> None:
        record["type"] = _TYPES.index(_NAMES.get(group.get, group.get.removeprefix("fmi3Get")))
        record["get"], record["set"] = map(instance.function_address, (group.get, group.set))
        record["references"] = self._address(np.array(group.references, np.uint32))
        record["n_references"], record["n"] = len(group.references), len(group.places)
        record["values"] = self._address(group.view)
        record["places"] = self._address(group.places.astype(np.int64) + start)

    def _wires(self, weights: FloatArray, offset: FloatArray, driven: NDArray[np.bool_]) -> np.void:
        sparse = csr_array(weights)
        record = np.zeros(1, _WIRES)[0]
        record["row"] = self._address(sparse.indptr.astype(np.int64))
        record["column"] = self._address(sparse.indices.astype(np.int64))
        record["weight"], record["offset"] = self._address(sparse.data), self._address(offset)
        record["driven"] = self._address(driven.astype(np.uint8))
        return record

    def _address(self, values: NDArray[np.generic]) -> int:
        values = np.ascontiguousarray(values)
        self._kept.append(values)
        return values.ctypes.data


def _calls(part: FmuPart) -> tuple[str, ...]:
    """Functions of a step and of the state, in the order of the C code."""
    prefix, state = f"fmi{part.instance.description.fmi[0]}", "FMUState"
    if prefix == "fmi2":
        state = "FMUstate"
    verbs = ("Get", "Set", "Free") if part.can_go_back else ()
    return (f"{prefix}DoStep", *(f"{prefix}{verb}{state}" for verb in verbs))


def _points(ends: FloatArray, step: float | None) -> tuple[FloatArray, NDArray[np.uint8]]:
    """Communication points with the ends of intervals among them, and which steps arrive at an end."""
    spans = np.diff(ends)
    counts = step_counts(spans, step)
    last = np.cumsum(counts)
    keep = np.zeros(last[-1], np.uint8)
    keep[last - 1] = 1
    inside = np.arange(last[-1]) - np.repeat(last - counts, counts)
    points = np.append(np.repeat(ends[:-1], counts) + inside * np.repeat(spans / counts, counts), ends[-1])
    return points, keep
