"""The master's inner loop in C: what `Run` does step by step in Python."""

from __future__ import annotations

import ctypes as ct
import time
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, NoReturn, Protocol

import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from ..codegen import CompilerError
from ..codegen.compiler import cached_library
from .cosimulation_loops import Loop
from .cosimulation_outside import Outside
from .cosimulation_part import SMALLEST, Part, StepControl, StuckError, step_counts, too_small
from .cosimulation_parts import FmuPart
from .cosimulation_system import SystemPart
from .cosimulation_texts import TextExchange
from .cosimulation_wiring import Wiring
from .instance import FmuError
from .master_records import MASTER, Records, calls_of
from .messages import claim_messages

if TYPE_CHECKING:
    from tqdm import tqdm

__all__ = ["FastMaster"]

(
    _FINE,
    _CALL_FAILED,
    _OUT_OF_RANGE,
    _STEP_TOO_SMALL,
    _TERMINATED,
    _NOT_FINITE,
    _NO_THREADS,
    _STUCK,
    _RAISED,
) = range(9)
_STEP, _SLOPES = 2, 5  # calls: get, set, step, save, restore, slopes
_CALLBACK = ct.CFUNCTYPE(ct.c_int64, ct.c_int64, ct.c_int64, ct.c_double, ct.c_double)
_FILES = ("pf_master.h", "pf_master.c", "pf_master_values.c")
_CHUNK = 0.05  # s of running between two updates of the progress bar
_ENDED_AT_END = 2  # of a part
_PIECE = 20_000  # steps of a call


@cache
def _library() -> ct.CDLL | None:
    """The compiled loop; None where there is no C compiler, or pointers have not 8 bytes."""
    if ct.sizeof(ct.c_void_p) != 8:
        return None
    shell = resources.files("phyfilter_ctl.fmi") / "shell"
    texts = {name: (shell / name).read_text(encoding="utf-8") for name in _FILES}
    try:
        library = ct.CDLL(str(cached_library(texts, name="the master", flags=["-pthread"])))
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
    texts: TextExchange
    threads: int
    first: bool
    loops: tuple[Loop, ...]
    moves: NDArray[np.bool_]
    u: FloatArray
    y: FloatArray
    watched: NDArray[np.bool_]
    steps: int
    rejected: int
    master: str

    @property
    def passes(self) -> int:
        """How often signals are handed on at one instant."""
        ...

    def settle(self, t: float, *, fresh: bool = False) -> None:
        """Hand signals on at one instant."""
        ...

    def solve(self, loop: Loop, t: float) -> None:
        """Solve an algebraic loop, in place."""
        ...

    def refuse_nonfinite(self, t: float) -> None:
        """Raise where an output has no value."""
        ...


class FastMaster:
    """A run's inner loop in C; what it cannot do itself it asks Python for.

    Parameters
    ----------
    run : Course
        Initialised; its inputs and outputs are those of the C loop from now on.
    library : ctypes.CDLL
    asked : bool
        Whether Python is asked what comes from outside, at times that are not known before.
    """

    def __init__(self, run: Course, library: ct.CDLL, *, asked: bool) -> None:
        self._run, self._library = run, library
        self._records = Records()
        self._vectors: dict[str, FloatArray] = {}
        wiring, outside = run.wiring, run.outside
        self._parts = self._records.parts(run.parts, wiring.input_slices, wiring.output_slices)
        self._loops = self._records.loops(run.loops)
        self._record = np.zeros(1, MASTER)
        master, address = self._record[0], self._records.address
        master["n_parts"], master["n_u"], master["n_y"] = len(self._parts), len(run.u), len(run.y)
        master["parts"], master["loops"] = address(self._parts), address(self._loops)
        if run.sequence is not None:
            master["sequence"] = address(np.array(run.sequence, np.int64))
        master["wires"] = self._records.wires(wiring.weights, wiring.offset, wiring.driven)
        master["outside"] = self._records.wires(outside.matrix, outside.offset, outside.driven)
        master["n_outside"], master["functions"] = len(outside.labels), asked
        self._now = np.zeros(len(outside.labels))
        master["now"] = address(self._now)
        master["passes"], master["n_loops"] = run.passes, len(run.loops)
        held = np.zeros(len(run.u), np.uint8)
        for loop in run.loops:
            held[loop.inputs] = 1
        master["held"], master["moves"] = address(held), address(run.moves.astype(np.uint8))
        master["watched"], master["first"] = address(run.watched.astype(np.uint8)), run.first
        master["u"], master["y"] = address(run.u), address(run.y)
        for like, names in (
            (run.u, ("v", "saved_u", "u_slope")),
            (run.y, ("saved_y", "coarse", "y_begin", "y_slope", "saved_slope")),
            (self._now, ("base", "rate")),
        ):
            for name in names:
                self._vectors[name] = np.zeros_like(like)
                master[name] = address(self._vectors[name])
        master["threads"] = min(run.threads, len(self._parts))
        self._chosen = np.array(list(run.chosen.values()), np.int64)
        self._states: list[object] = [None] * len(self._parts)
        self._raised: BaseException | None = None
        self._ended: dict[int, FmuError] = {}
        self._tasks: tuple[Callable[[int, float, float], None], ...] = (
            self._put, self._get, self._step, self._step_back, self._incline, self._save, self._restore,
            self._forget, self._transition, self._outside, self._solve, self._settle,
        )  # fmt: skip
        self._callback = _CALLBACK(self._answer)
        master["python"] = ct.cast(self._callback, ct.c_void_p).value

    @classmethod
    def of(cls, run: Course, *, controlled: bool) -> FastMaster | None:
        """The C loop of a run, where it can run one of its parts without Python and there is a C compiler; and in
        ``run.master`` what it cannot do, or why there is none.

        Parameters
        ----------
        run : Course
        controlled : bool
            Whether steps go by the error, at times that are not known before.
        """
        slow = [f"{part.name} ({part.in_python})" for part in run.parts if part.in_python]
        events = any(part.has_events for part in run.parts)
        here = len(slow) < len(run.parts) and not run.texts.there and not events
        library = _library() if here else None
        if library is None:
            why = "texts or bytes" if run.texts.there else "events" if events else "no C compiler for 64 bits"
            run.master = f"Python: {'no part that C runs' if len(slow) == len(run.parts) else why}"
            return None
        run.master = "C" + f", calling Python for {', '.join(slow)}" * bool(slow)
        return cls(run, library, asked=controlled and run.outside.has_functions)

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
        if master["settled_in_python"]:
            self._run.master += (
                ", and to hand on signals: an output depends on an input that its FMU leaves out"
            )
        elif master["loops_in_python"]:
            self._run.master += f", and {master['loops_in_python']} times to solve an algebraic loop anew"
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
        part = run.parts[int(master["failed_part"])]
        if code == _TERMINATED and part.in_python:
            raise self._ended[int(master["failed_part"])]
        if code in (_STUCK, _RAISED) or (code == _CALL_FAILED and part.in_python):
            assert self._raised is not None
            raise self._raised
        if code == _NO_THREADS:
            raise MemoryError("no memory for threads; expected threads=1")
        if code == _NOT_FINITE:
            run.y[:] = self._vectors["coarse"]
            run.refuse_nonfinite(t)
        if isinstance(part, FmuPart) and code in (_CALL_FAILED, _TERMINATED, _OUT_OF_RANGE):
            if code == _CALL_FAILED:
                function = _function(part, int(master["failed_call"]), place)
                raise part.instance.failure(function, int(master["failed_status"]), t)
            if code == _TERMINATED:
                raise part.instance.ended(t)
            part.instance.time = t
            inputs = run.wiring.input_slices[int(master["failed_part"])]
            part.put(self._vectors["v"][inputs])  # raises, with words
        raise StuckError(too_small(t, float(master["smallest"])))

    # -- what C asks for; all act on the run's own u and y ------------------------------------------------------

    def _answer(self, what: int, which: int, t: float, end: float) -> int:
        try:
            self._tasks[what](which, t, end)
        except BaseException as error:  # none may pass through C; raised again behind it
            self._raised = error
            if isinstance(error, StuckError):
                return _STUCK
            stepping = self._tasks[what] in (self._step, self._step_back)
            discarded = stepping and isinstance(error, FmuError) and error.status == "discard"
            return _CALL_FAILED if discarded else _RAISED
        return _FINE

    def _put(self, p: int, t: float, end: float) -> None:
        self._run.parts[p].put(self._run.u[self._run.wiring.input_slices[p]])

    def _get(self, p: int, t: float, end: float) -> None:
        self._run.y[self._run.wiring.output_slices[p]] = self._run.parts[p].get()

    def _step(self, p: int, t: float, end: float) -> None:
        self._advance(p, t, end, final=True)

    def _step_back(self, p: int, t: float, end: float) -> None:
        self._advance(p, t, end, final=False)

    def _advance(self, p: int, t: float, end: float, *, final: bool) -> None:
        """A step, whose outputs are still wanted where the part ends the run at its end."""
        try:
            self._run.parts[p].advance(t, end - t, final=final)
        except FmuError as error:
            if not error.ends_at(end, end - t):
                raise
            self._ended[p] = error
            self._parts[p]["terminated"], self._parts[p]["reached"] = _ENDED_AT_END, end

    def _incline(self, p: int, t: float, end: float) -> None:
        self._run.parts[p].incline(self._vectors["u_slope"][self._run.wiring.input_slices[p]])

    def _save(self, p: int, t: float, end: float) -> None:
        self._states[p] = self._run.parts[p].save()

    def _restore(self, p: int, t: float, end: float) -> None:
        self._run.parts[p].restore(self._states[p])

    def _forget(self, p: int, t: float, end: float) -> None:
        state, self._states[p] = self._states[p], None
        if state is not None:
            self._run.parts[p].forget(state)

    def _transition(self, p: int, t: float, end: float) -> None:
        part = self._run.parts[p]
        assert isinstance(part, SystemPart)
        self._records.transitions[p][self._parts[p]["slot"]] = part.transition(end - t)

    def _outside(self, _: int, t: float, end: float) -> None:
        self._now[:] = self._run.outside.at(t)

    def _solve(self, k: int, t: float, end: float) -> None:
        self._tell_time(t)
        loop, entry = self._run.loops[k], self._loops[k]
        loop.scale = float(entry["scale"])
        self._run.solve(loop, t)
        entry["scale"] = loop.scale
        self._records.inverses[k][:] = np.linalg.inv(np.eye(len(loop.inputs)) - loop.slope)
        entry["ready"] = 1

    def _tell_time(self, t: float) -> None:
        """Where instances are that C has stepped, for what their errors say."""
        for part in self._run.parts:
            if isinstance(part, FmuPart):
                part.instance.time = t

    def _settle(self, _: int, t: float, end: float) -> None:
        self._tell_time(t)
        run, u, y = self._run, self._run.u, self._run.y
        try:
            run.settle(t, fresh=True)
        finally:
            u[:], y[:] = run.u, run.y
            run.u, run.y = u, y

    def _drive(self, times: FloatArray) -> None:
        """What comes from outside at these times."""
        master = self._record[0]
        if master["n_outside"]:
            self._driven = np.ascontiguousarray(times), self._run.outside.over(times)
            master["n_table"], master["place"] = len(times), 0
            master["table_t"], master["table"] = (values.ctypes.data for values in self._driven)


def _function(part: FmuPart, call: int, place: int) -> str:
    """Name of an FMI function, by the numbers of the C code."""
    if call < _STEP:
        group = (part.output_signals, part.input_signals)[call].groups[place]
        return (group.get, group.set)[call]
    return "fmi2SetRealInputDerivatives" if call == _SLOPES else calls_of(part)[call - _STEP]


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
