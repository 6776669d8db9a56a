"""The master algorithms: Jacobi and Gauss-Seidel, equal steps and steps by the error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from .._sections import FloatArray
from .cosimulation_clocks import ClockWires
from .cosimulation_loops import Loop, find_loops
from .cosimulation_outside import Outside
from .cosimulation_part import (
    SETTLED,
    SMALLEST,
    Part,
    StepControl,
    StuckError,
    step_counts,
    too_small,
    unsettled,
)
from .cosimulation_texts import TextExchange
from .cosimulation_wiring import Wiring, block_feedthrough
from .instance import FmuError
from .master import FastMaster

__all__ = ["Run"]

# Forward differences around a loop, of an input's size: rounding and truncation are about alike.
_DIFFERENCE = 1e-7
_ROUNDS = 100  # of events at one instant, after which they count as endless
# Step control: safety, and how much a step may change; the usual values.
_SAFETY, _SHRINK, _GROW = 0.9, 0.2, 4.0

_State = tuple[list[object], FloatArray, FloatArray, FloatArray]


@dataclass
class _Lines:
    """That inputs follow over a step: all outputs and inputs at its begin, slopes from outside and of all inputs."""

    y: FloatArray
    level: FloatArray
    outside: FloatArray
    slope: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self.slope = np.zeros_like(self.level)


@dataclass
class Run:
    """A co-simulation in progress; u and y are all inputs and outputs.

    Parameters
    ----------
    parts : sequence of Part
    wiring : Wiring
    outside : Outside
    sequence : sequence of int or None
        Parts in the order of Gauss-Seidel; None for Jacobi.
    chosen : dict of str to int
        Name and place of the outputs wanted.
    texts : TextExchange
    clocks : ClockWires
    threads : int
        For the steps of Jacobi in C.
    first : bool
        Whether continuous inputs follow lines over a step, instead of being held.

    Attributes
    ----------
    rows : (N, len(chosen)) array
        Results; NaN from where the run could not go on.
    watched : (outputs,) bool array
        Outputs that must be numbers: those that are wanted or handed on.
    loops : tuple of Loop
        Of direct feedthrough.
    moves : (inputs,) bool array
        Inputs that do follow lines.
    master : str
        "C" or "Python", and what it could not do or why.
    in_c : bool
        Of the class: False keeps every run in Python.
    """

    parts: Sequence[Part]
    wiring: Wiring
    outside: Outside
    sequence: Sequence[int] | None
    chosen: Mapping[str, int]
    texts: TextExchange
    clocks: ClockWires
    threads: int = 1
    first: bool = False
    in_c: ClassVar[bool] = True
    u: FloatArray = field(init=False)
    y: FloatArray = field(init=False)
    rows: FloatArray = field(init=False)
    watched: NDArray[np.bool_] = field(init=False)
    steps: int = 0
    rejected: int = 0
    message: str = ""
    master: str = "Python"
    _wrong: StuckError | None = None
    _ended: FmuError | None = None  # at the end of the present step, whose outputs are still wanted

    def __post_init__(self) -> None:
        self._close_loops(self.wiring.through)
        continuous = np.concatenate([np.zeros(0, bool), *(part.moving for part in self.parts)])
        self.moves: NDArray[np.bool_] = self.first & continuous & (self.wiring.driven | self.outside.driven)

    def _close_loops(self, through: NDArray[np.bool_]) -> None:
        self.loops: tuple[Loop, ...] = find_loops(self.parts, self.wiring, through)
        self._on_loops = np.concatenate([np.zeros(0, np.intp), *(loop.inputs for loop in self.loops)])
        self._believed = through is self.wiring.through

    def over(
        self, times: FloatArray, step: float | None, control: StepControl | None, progress: bool
    ) -> None:
        """Fill ``rows``.

        Parameters
        ----------
        times : (N,) array
        step : float, optional
        control : StepControl, optional
        progress : bool
        """
        self.rows = np.full((len(times), len(self.chosen)), np.nan)
        self._initialise(times)
        places = list(self.chosen.values())
        self.rows[0] = self.y[places]
        self.texts.record()
        self.watched = np.isin(np.arange(len(self.y)), places) | np.any(self.wiring.weights != 0.0, axis=0)
        if control is not None:
            control.step = step or float(np.min(np.diff(times)))
        self._slope = np.zeros_like(self.y)
        fast = FastMaster.of(self, controlled=control is not None) if self.in_c else None
        with tqdm(total=len(times) - 1, disable=not progress, desc="co-simulation") as bar:
            try:
                self.refuse_nonfinite(float(times[0]))
                if fast is not None:
                    fast.over(times, step, control, self.rows, bar)
                    return
                for k, (t, end) in enumerate(pairwise(times.tolist()), start=1):
                    if control is None:
                        self._equal_steps(t, end, step)
                    else:
                        self._controlled(t, end, control, float(times[-1] - times[0]))
                    self.rows[k] = self.y[places]
                    self.texts.record()
                    self.refuse_nonfinite(end)
                    bar.update()
                    if self._ended is not None:
                        raise self._ended
            except StuckError as error:
                self.message = str(error)

    def refuse_nonfinite(self, t: float) -> None:
        """Raise where an output that is wanted or handed on is NaN or infinite.

        Parameters
        ----------
        t : float
        """
        bad = np.flatnonzero(~np.isfinite(self.y) & self.watched)
        if len(bad):
            names = [f"{self.wiring.sources[j]} is {self.y[j]:g}" for j in bad]
            shown = ", ".join(names[:3]) + f" and {len(names) - 3} more" * (len(names) > 3)
            raise StuckError(
                f"{shown} at t = {t:g}: look at inputs and parameters there, or try shorter steps; outputs= leaves out "
                "one that has no value yet"
            )

    @property
    def passes(self) -> int:
        """How often signals are handed on at one instant: what comes from outside has yet to reach the outputs that it
        passes through to."""
        return self.wiring.passes + bool(np.any(self.outside.driven))

    def _initialise(self, times: FloatArray) -> None:
        start, stop = float(times[0]), float(times[-1])
        for part in self.parts:
            part.initialise(start, stop)
        self.u = np.concatenate([np.zeros(0), *(part.start for part in self.parts)])
        try:
            self.settle(start, fresh=True)
            for part in self.parts:
                part.begin()
            self.settle(start, fresh=True)
            self.clocks.forget()
            self._happen(start)
        except StuckError as error:
            raise ValueError(str(error)) from error

    def _wired(self, y: FloatArray, t: float) -> FloatArray:
        u = np.where(self.wiring.driven, self.wiring.weights @ y + self.wiring.offset, self.u)
        outside = self.outside
        return np.where(outside.driven, outside.matrix @ outside.at(t) + outside.offset, u)

    def _put(self, u: FloatArray) -> None:
        for part, place in zip(self.parts, self.wiring.input_slices, strict=True):
            part.put(u[place])
        self.u = u

    def _get(self) -> FloatArray:
        return np.concatenate([np.zeros(0), *(part.get() for part in self.parts)])

    def settle(self, t: float, *, fresh: bool = False) -> None:
        """Hand signals on at one instant.

        Parameters
        ----------
        t : float
        fresh : bool
            Whether parts are to be told their inputs also where these have not changed.
        """
        for _ in self.texts.until_rest(t):
            self._settle_numbers(t, fresh=fresh)

    def _settle_numbers(self, t: float, *, fresh: bool) -> None:
        self.y = self._get()
        for loop in self.loops:
            self._hand_on(t, len(self.y) + 1, fresh)
            fresh = False
            self.solve(loop, t)
        if self._hand_on(t, len(self.y) + 1 if self.loops else self.passes, fresh):
            return
        if not self._believed:
            raise StuckError(unsettled(t))
        # An output depends on an input that its FMU's description leaves out: from now on all are taken to.
        self._close_loops(block_feedthrough([np.ones_like(part.feedthrough) for part in self.parts]))
        self._settle_numbers(t, fresh=True)

    def _hand_on(self, t: float, passes: int, fresh: bool) -> bool:
        """Along direct feedthrough, inputs on loops left as they are; whether the signals rest then."""
        held = self._on_loops
        while True:
            u = self._wired(self.y, t)
            u[held] = self.u[held]
            if not fresh and (not passes or np.array_equal(u, self.u, equal_nan=True)):
                break
            self._put(u)
            self.y = self._get()
            fresh, passes = False, passes - 1
        allowed = SETTLED * np.max(np.abs(u), initial=0.0, where=np.isfinite(u))
        return bool(np.all((np.abs(u - self.u) <= allowed) | ~np.isfinite(u) | (u == self.u)))

    def solve(self, loop: Loop, t: float) -> None:
        """Solve an algebraic loop, in place.

        Parameters
        ----------
        loop : Loop
        t : float
        """
        places = [
            (self.parts[p], self.wiring.input_slices[p], self.wiring.output_slices[p]) for p in loop.parts
        ]

        def residual(v: FloatArray) -> FloatArray:
            self.u[loop.inputs] = v
            for part, inputs, outputs in places:
                part.put(self.u[inputs])
                self.y[outputs] = part.get()
            return self._wired(self.y, t)[loop.inputs] - v

        def slope() -> FloatArray:
            result = np.zeros((len(self.y), len(loop.inputs)))
            for part, inputs, outputs in places:
                mine = (loop.inputs >= inputs.start) & (loop.inputs < inputs.stop)
                columns = loop.inputs[mine] - inputs.start
                known = part.slopes(columns)
                result[outputs, mine] = (
                    known if known is not None else self._differences(part, inputs, columns, loop)
                )
            return self.wiring.weights[loop.inputs] @ result

        v = self.u[loop.inputs].copy()
        loop.solve(v, self._wired(self.y, t)[loop.inputs] - v, residual, slope, t)

    def _differences(self, part: Part, inputs: slice, columns: NDArray[np.intp], loop: Loop) -> FloatArray:
        """Forward differences of a part's outputs by some of its inputs, which stay as they are."""
        u, real = self.u[inputs], dict(zip(loop.inputs.tolist(), loop.real.tolist(), strict=True))
        before = part.get()
        result = np.zeros((len(before), len(columns)))
        for k, j in enumerate(columns.tolist()):
            if real[inputs.start + j]:
                moved = u.copy()
                moved[j] += _DIFFERENCE * max(abs(u[j]), loop.scale)
                part.put(moved)
                result[:, k] = (part.get() - before) / (moved[j] - u[j])
        part.put(u)
        part.get()
        return result

    def _advance(self, t: float, end: float, *, final: bool = True) -> None:
        h = end - t
        lines = self._lines(t, end) if self.first else None
        if self.sequence is None:
            for i in range(len(self.parts)) if lines is not None else ():
                self._give(i, self.u, lines, h)
            for part in self.parts:
                self._step(part, t, h, final=final)
        else:
            for i in self.sequence:
                self._give(i, self._wired(self.y, t), lines, h)
                self.texts.hand_on(self.parts[i])
                self._step(self.parts[i], t, h, final=final)
                if lines is not None:
                    self._arrive(i, lines, h)
                place = self.wiring.output_slices[i]
                self.y[place] = self.parts[i].get()
                if lines is not None:
                    self._slope[place] = (self.y[place] - lines.y[place]) / h
        self.settle(end, fresh=self.first)
        if lines is not None:
            self._slope = (self.y - lines.y) / h
        self._happen(end)

    def _step(self, part: Part, t: float, h: float, *, final: bool) -> None:
        try:
            part.advance(t, h, final=final)
        except FmuError as error:
            if not error.ends_at(t + h, h):
                raise
            self._ended = error

    def _lines(self, t: float, end: float) -> _Lines:
        outside = self.outside
        rate = (outside.at(end) - outside.at(t)) / (end - t)
        return _Lines(self.y.copy(), self._wired(self.y, t), outside.matrix @ rate)

    def _give(self, i: int, u: FloatArray, lines: _Lines | None, h: float) -> None:
        """What a part is to hold over a step, or to follow: where it takes no slopes, the line's value in the middle
        of the step, whose integral is the line's."""
        part, place = self.parts[i], self.wiring.input_slices[i]
        told = u[place]
        if lines is not None:
            slope = np.where(self.outside.driven, lines.outside, self.wiring.weights @ self._slope)
            lines.slope[place] = np.where(self.moves[place], slope[place], 0.0)
            middle = 0.0 if part.interpolates else 0.5 * h
            told = np.where(self.moves[place], lines.level[place] + middle * lines.slope[place], told)
        self.u[place] = told
        part.put(told)
        if lines is not None and part.interpolates:
            part.incline(lines.slope[place])

    def _arrive(self, i: int, lines: _Lines, h: float) -> None:
        """After a step: the end of the line, where outputs show it."""
        part, place = self.parts[i], self.wiring.input_slices[i]
        if np.any(part.feedthrough):
            self.u[place] += (1.0 if part.interpolates else 0.5) * h * lines.slope[place]
            part.put(self.u[place])

    def _happen(self, t: float) -> None:
        """Events at a communication point, and those that their outputs set off elsewhere."""
        for _ in range(_ROUNDS):
            happened = [part.happen(t) for part in self.parts]  # of all of them, whichever comes first
            if not self.clocks.ring(t) and not any(happened):
                return
            self.settle(t)
        raise StuckError(
            f"events at t = {t:g} set off each other without end: look for a loop of discrete signals"
        )

    def _equal_steps(self, t: float, end: float, step: float | None) -> None:
        points = np.linspace(t, end, int(step_counts(np.array([end - t]), step)[0]) + 1)
        for a, b in pairwise(points.tolist()):
            self._advance(a, b)
            self.steps += 1
            if b < end:
                self.refuse_nonfinite(b)
                if self._ended is not None:
                    raise self._ended

    def _controlled(self, t: float, end: float, control: StepControl, span: float) -> None:
        while t < end:
            target = end if t + control.step > end - SMALLEST * span else t + control.step
            state = [part.save() for part in self.parts], self.u.copy(), self.y.copy(), self._slope.copy()
            error = self._twice(t, target, state, control)
            accepted = error <= 1.0
            if not accepted:
                self._back(state)
            for part, saved in zip(self.parts, state[0], strict=True):
                part.forget(saved)
            root = np.cbrt(error) if self.first else np.sqrt(error)
            change = _SAFETY / root if error > 0.0 else _GROW
            proposal = (target - t) * float(np.clip(change, _SHRINK, _GROW))
            # A step cut short to land on a result is no reason for small steps after it.
            control.step = max(control.step, proposal) if accepted and target == end else proposal
            if accepted:
                t = target
                self.steps += 1
                if self._ended is not None and t < end:
                    raise self._ended
            else:
                self.rejected += 1
                if control.step < SMALLEST * span:
                    raise self._wrong or StuckError(too_small(t, SMALLEST * span))

    def _twice(self, t: float, end: float, state: _State, control: StepControl) -> float:
        """One step, then two halves from the same state; the error over what is allowed. A discarded step is wrong
        beyond measure, and one to something that is no number."""
        middle = t + 0.5 * (end - t)
        self._wrong = None
        try:
            self._advance(t, end)
            coarse = self.y.copy()
            self._back(state)
            self._advance(t, middle)
            self._advance(middle, end, final=False)  # t, which comes before, may be gone back to
            self.refuse_nonfinite(end)
        except StuckError as error:
            self._wrong = error
            return np.inf
        except FmuError as error:
            if error.status == "discard":
                return np.inf
            raise
        error = np.abs(self.y - coarse) / (control.atol + control.rtol * np.abs(self.y))
        return float(np.max(np.where(np.isfinite(error), error, np.inf), initial=0.0))

    def _back(self, state: _State) -> None:
        for part, saved in zip(self.parts, state[0], strict=True):
            part.restore(saved)
        self.clocks.forget()
        self.texts.forget()
        self._ended = None
        self.u, self.y, self._slope = state[1].copy(), state[2].copy(), state[3].copy()
