"""Co-simulation FMUs as discrete python-control systems, and as laws of sampled blocks in any diagram."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _signals
from .._sections import FloatArray
from ..blocks.functions import BlockFunctions
from ..blocks.interpreted import Interpreted, RunEndedError
from .clock_schedule import ClockTimes
from .importing_blocks import FmuBlock, input_starts
from .inspect import FmuVariable, Kind, Scalar
from .instance import FmuError
from .unpacked import UnpackedFmu

__all__ = ["FmuSteps"]

# A step count, and an integer input, that arithmetic has passed through are integers to this.
_COUNT, _INTEGER = 1e-9, 1e-6
# States kept for going back: the step that is being evaluated, and the one before it.
_KEPT_STATES = 2
# Less than that part of a step after the last communication point, a diagram asks between two of them.
_BETWEEN = 0.999


class FmuSteps(FmuBlock):
    """A co-simulation FMU, or one of scheduled execution, as a discrete system; made by :func:`import_fmu`.

    The FMU keeps its state to itself. The one state of this system counts communication steps: x = k at
    t = t_0 + k dt, and the next x is k + 1 after one ``doStep``.

    Parameters
    ----------
    fmu : UnpackedFmu
    name, step, parameters, start_time, tolerance, outputs, kind, clocks
        As for :func:`import_fmu`.

    Attributes
    ----------
    start_state : (1,) array
        0: no step done.
    in_run : bool
        Whether a run of :func:`simulate` has it, which goes forward only: no states are kept to go back to.

    Notes
    -----
    * :func:`simulate` runs it alone and in discrete diagrams of the same ``dt``; in continuous ones as
      ``sampled_block(block)``, which holds its outputs from one communication point to the next.
    * Outputs at step k see the inputs at step k where the FMU recomputes them on reading; else those of the step.
      Which do is taken from its description and tried out on an instance at its start.
    * Clocks that tick at the time of step k, and discrete inputs that changed, come into force as the step from there
      begins, with the inputs of step k: outputs at step k know nothing of them yet. :func:`cosimulate` hands on what
      they change at the instant itself.
    * Inputs that nothing drives stay at their start values in :func:`simulate`. python-control makes them 0; only an
      enumeration without a 0 keeps its start there.
    * The step from k is made where something of step k + 1 is asked for. An FMU that ends the run there still has its
      outputs at that time.
    * From step 0 any run can be repeated: x = 0 initialises the FMU. Going back otherwise needs an FMU that can put
      back its state, and reaches one step; anything else raises and says so.
    * Fixed parameters change at x = 0 only, tunable ones at any step.
    * Its linearisation means nothing (the state is a count) and raises.
    """

    def __init__(
        self,
        fmu: UnpackedFmu,
        *,
        name: str,
        step: float,
        parameters: Mapping[str, Scalar] | None = None,
        start_time: float = 0.0,
        tolerance: float | None = None,
        outputs: Sequence[str] | None = None,
        kind: Kind = "cs",
        clocks: ClockTimes | None = None,
    ) -> None:
        super().__init__(
            fmu,
            kind,
            name=name,
            parameters=parameters or {},
            start_time=start_time,
            tolerance=tolerance,
            dt=step,
            states=["step"],
            outputs=outputs,
            clocks=clocks,
        )
        self._h = step
        self._k = 0
        self._noted: FloatArray | None = None  # inputs of the step from here, which is yet to be made
        self._last: tuple[int, bytes] = (-1, b"")
        self._saved: dict[int, object] = {}
        self._ended: FmuError | None = None
        self._through: NDArray[np.bool_] | None = None
        self.start_state: FloatArray = np.zeros(1)
        self.start_state.flags.writeable = False
        self._starts = input_starts(self.description, self._inputs.labels, self._fixed)
        owners = {label: entry for entry in self.description.of("input") for label in entry.labels}
        self._owners: list[FmuVariable] = [owners[label] for label in self._inputs.labels]
        self._whole: NDArray[np.bool_] = np.array(
            [not e.type.startswith("Float") for e in self._owners], bool
        )
        self._never_0: NDArray[np.bool_] = np.array(
            [bool(entry.items) and 0 not in entry.items for entry in self._owners], bool
        )
        self._latest: FloatArray = self._starts
        self.in_run: bool = False

    def __deepcopy__(self, memo: dict[int, object]) -> FmuSteps:
        return FmuSteps(
            self._fmu,
            name=self.name or "fmu",
            step=self._h,
            parameters=self.values,
            start_time=self._start_time,
            tolerance=self._tolerance,
            outputs=self.patterns,
            kind=self.instance.kind,
            clocks=self.clocks,
        )

    @property
    def steps_done(self) -> int:
        """Communication steps since the start."""
        return self._k

    @property
    def interval(self) -> float:
        """Communication step in seconds."""
        return self._h

    @property
    def start_inputs(self) -> FloatArray:
        """Start values of its inputs, (inputs,); the FMU is initialised where it alone knows them."""
        if np.isnan(self._starts).any():
            self._begin(self._start_time, {}, None)
        return self._starts

    @property
    def functions(self) -> BlockFunctions:
        """What it does as functions that CasADi calls back; new ones each time, on this one instance."""
        calls = _Calls(self)
        output = self.callback("output", calls.output, len(self._outputs), self.feedthrough(), self.running)
        dynamics = self.callback("update", calls.following, 1, None, self.running)
        return BlockFunctions(
            states=self.variables(self.state_labels, [0.0]),
            inputs=self.variables(self.input_labels, self.start_inputs.tolist()),
            outputs=self.variables(self.output_labels, [0.0] * len(self._outputs)),
            parameters=self.variables(list(self.params), list(self.params.values())),
            dynamics=dynamics,
            output=output,
            callbacks=tuple(made for made in (output, dynamics) if isinstance(made, Interpreted)),
            keeps_starts=True,
        )

    def feedthrough(self) -> NDArray[np.bool_]:
        """Which input acts on which output at the same communication point.

        Returns
        -------
        (outputs, inputs) bool array
            What the description says, and what the FMU shows at its start, which may be more.
        """
        if self._through is None:
            owners = {label: entry.name for entry in self.description.variables for label in entry.labels}
            said = [self.description.dependencies.get(owners[label]) is not None for label in self.labels[1]]
            declared = self.description.feedthrough(*self.labels) & np.array(said, bool)[:, None]
            self._through = declared | self._tried_out() if declared.size else declared
        return self._through

    def restart(
        self, start_time: float | None = None, *, params: Mapping[str, float] | None = None
    ) -> FloatArray:
        """Initialise the FMU; returns its outputs.

        Parameters
        ----------
        start_time : float, optional
            Seconds; the block's own by default.
        params : dict of str to float, optional

        Returns
        -------
        (outputs,) array
        """
        self._begin(self._start_time if start_time is None else start_time, params or {}, None)
        return self._outputs.read(self.instance)

    def step(self, inputs: ArrayLike) -> FloatArray:
        """One communication step, outside any simulation.

        Parameters
        ----------
        inputs : (inputs,) array_like
            Held over the step.

        Returns
        -------
        (outputs,) array
            At the end of the step.
        """
        u = _signals.array("inputs", np.atleast_1d(_signals.real("inputs", inputs)), (len(self._inputs),))
        if not self._running:
            self._begin(self._start_time, {}, None)
        self._noted = self.completed(u)
        self._forget(lambda k: True)  # a run by hand goes forward only
        self._advance(going_back=False)
        return self._outputs.read(self.instance)

    @contextmanager
    def running(self) -> Iterator[None]:
        """Keeps others from the FMU, which starts anew and goes forward only; afterwards it starts anew too."""
        with self.lock:
            self.rewind()
            self.in_run = True
            try:
                yield
            finally:
                self.rewind()
                self.in_run = False

    def rewind(self) -> None:
        """It starts anew where it is used next."""
        self._let_go()
        self._noted, self._ended = None, None
        self._latest = self._starts

    @property
    def latest(self) -> FloatArray:
        """Inputs as the FMU has them; (inputs,)."""
        return self._latest

    @property
    def noted(self) -> bool:
        """Whether the step from here has its inputs."""
        return self._noted is not None

    def completed(self, u: ArrayLike) -> FloatArray:
        """Inputs as the FMU is to get them.

        Parameters
        ----------
        u : (inputs,) array_like

        Returns
        -------
        (inputs,) array
        """
        values = np.asarray(u, dtype=float).reshape(-1)
        near = np.rint(values)
        values = np.where(self._whole & (np.abs(values - near) <= _INTEGER), near, values)
        return np.where(self._never_0 & (values == 0.0), self._starts, values)

    def outputs_at(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        """Outputs at a communication point.

        Parameters
        ----------
        t : float
        x : (1,) array
        u : (inputs,) array
        params : mapping
        """
        self._go_to(t, x, u, params)
        if self._ended is None:  # an FMU that has ended the run takes no more inputs
            values = self.completed(u)
            self._inputs.write(self.instance, values)
            self._latest = values
        return self._outputs.read(self.instance)

    def note(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        """The inputs of the step from a communication point; what is noted there before is replaced.

        Parameters
        ----------
        t : float
        x : (1,) array
        u : (inputs,) array
        params : mapping

        Returns
        -------
        (1,) array
            The next x.
        """
        values = self.completed(u)
        asked = (self._count(x), values.tobytes())
        if not (
            self._running and asked == self._last and self._k == asked[0] + 1 and not self._changed(params)
        ):
            self._go_to(t, x, u, params)
            self._noted = self.completed(u)
        return np.array([asked[0] + 1.0])

    _now, _next = outputs_at, note

    def _advance(self, *, going_back: bool) -> None:
        """The step from here, on the inputs noted."""
        if self._ended is not None:
            raise self._ended
        assert self._noted is not None
        t = self._start_time + self._k * self._h
        self._inputs.write(self.instance, self._noted)
        self._latest = self._noted
        if going_back and self._k not in self._saved:
            self._saved[self._k] = self.instance.save()
            self._forget(lambda k: k <= self._k - _KEPT_STATES)
        try:
            self.instance.do_step(t, self._h, final=not going_back)
        except FmuError as error:
            if error.status == "ended":
                self._ended = error
            if not error.ends_at(t + self._h, self._h):
                raise
        self._last = (self._k, self._noted.tobytes())
        self._k += 1
        self._noted = None

    def _forget(self, which: Callable[[int], bool]) -> None:
        for key in [key for key in self._saved if which(key)]:
            self.instance.forget(self._saved.pop(key))

    def _count(self, x: FloatArray) -> int:
        value = float(np.asarray(x, dtype=float).reshape(-1)[0])
        if not (np.isfinite(value) and value >= 0.0 and abs(value - round(value)) <= _COUNT):
            raise ValueError(
                f"{self.name}: the state of a co-simulation FMU counts communication steps; expected 0, 1, 2, ..., got "
                f"{value:g}. It cannot be linearised; use a model-exchange FMU for that"
            )
        return round(value)

    def _go_to(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> None:
        k = self._count(x)
        changed = self._changed(params)
        if k == 0 and (not self._running or self._k > 0 or changed or t != self._start_time):
            self._begin(t, params, u)
            return
        if not self._running:
            raise FmuError(self.instance.name, "step", "refused", f"asked for step {k} before step 0")
        if k == self._k + 1 and self._noted is not None:
            self._advance(going_back=not self.in_run and self.instance.state_is_usable)
        elif k != self._k:
            self._go_back(k)
        if changed:
            self._tune(changed)

    def _go_back(self, k: int) -> None:
        if k not in self._saved:
            why = (
                f"it goes back {_KEPT_STATES} steps at most"
                if self._saved
                else "it cannot put back its state"
            )
            raise FmuError(
                self.instance.name,
                "step",
                "refused",
                f"it stands at step {self._k} and was asked for step {k}; {why}. Runs go forward, from state 0",
            )
        self.instance.restore(self._saved[k])
        self._forget(lambda key: key > k)
        self._k = k
        self._last = (-1, b"")
        self._noted, self._ended = None, None

    def _tune(self, changed: Mapping[str, float]) -> None:
        tunable = {
            label: entry.variability == "tunable"
            for entry in self.description.of("parameter")
            for label in entry.labels
        }
        fixed = [key for key in changed if not tunable.get(key, False)]
        if fixed:
            raise ValueError(
                f"{self.name}: {', '.join(fixed)} cannot change during a run, only at its start (state 0)"
            )
        self.instance.set_values(changed)
        self._in_force |= changed

    def _begin(self, time: float, params: Mapping[str, float], u: FloatArray | None) -> None:
        self.rewind()
        self._start_time = time
        self._saved = {}
        self._k, self._last = 0, (-1, b"")
        first = None if u is None else self.completed(u)
        known = first is not None and not np.isnan(first).any()
        self._restart(time, params, None, first if known else None)
        if np.isnan(self._starts).any():
            self._starts = np.where(np.isnan(self._starts), self._inputs.read(self.instance), self._starts)
        self._latest = self._starts if first is None else first

    def _tried_out(self) -> NDArray[np.bool_]:
        """Which outputs move where an input does at the start, (outputs, inputs); all where the FMU does not let it."""
        result = np.zeros((len(self._outputs), len(self._inputs)), dtype=bool)
        with self.lock:
            base = self.start_inputs
            self._begin(self._start_time, {}, base)
            for j, entry in enumerate(self._owners):
                try:
                    self._inputs.write(self.instance, base)
                    before = self._outputs.read(self.instance)
                    for value in _others(entry, float(base[j])):
                        moved = base.copy()
                        moved[j] = value
                        self._inputs.write(self.instance, moved)
                        after = self._outputs.read(self.instance)
                        result[:, j] |= ~((after == before) | (np.isnan(after) & np.isnan(before)))
                except (FmuError, ValueError):
                    result[:, j] = True
                    self._begin(self._start_time, {}, base)
            self.rewind()
        return result


class _Calls:
    """Calls of a diagram: at communication points, more than once there and in any order, and between them.

    Parameters
    ----------
    block : FmuSteps
    """

    def __init__(self, block: FmuSteps) -> None:
        self._block = block
        self._unused = ~block.feedthrough().any(
            axis=0
        )  # inputs that no output sees: they come as not-a-number
        self._noted_at = -np.inf
        self._kept = np.zeros(0)

    def output(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        """Outputs at a communication point, and between two of them those of the last."""
        if not self._block.in_run and not float(x[0]).is_integer():
            x = np.zeros(1)  # a diagram that is looked at before any run, as it is at its start
        if not self._is_between(t, x):
            with self._telling():
                given = np.where(self._unused, self._block.latest, u)
                self._kept = self._block.outputs_at(t, x, given, params)
        return self._kept

    def following(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        """The count of steps after the one from here, whose inputs these are."""
        if self._is_between(t, x):
            return x + 1.0
        with self._telling():
            result = self._block.note(t, x, u, params)
        self._noted_at = t
        return result

    def _is_between(self, t: float, x: FloatArray) -> bool:
        """Whether the step that leads to x has begun, and has yet to end."""
        block = self._block
        begun = block.in_run and block.noted and float(x[0]) == block.steps_done + 1
        return begun and t < self._noted_at + _BETWEEN * block.interval

    @contextmanager
    def _telling(self) -> Iterator[None]:
        try:
            yield
        except FmuError as error:
            if error.status != "ended":
                raise
            when = f" at t = {error.ended_at:.9g} s" if error.ended_at is not None else ""
            raise RunEndedError(f"block {self._block.name}: the FMU asked to end the run{when}") from error


def _others(variable: FmuVariable, value: float) -> list[float]:
    """Values near one that an input may take."""
    if variable.type == "Boolean":
        return [1.0 - value]
    if variable.items:
        return [float(item) for item in variable.items if item != value][:2]
    small = (1e-3 * (1.0 + abs(value)), 0.7) if variable.type.startswith("Float") else (1.0,)
    least = -np.inf if variable.minimum is None else variable.minimum
    most = np.inf if variable.maximum is None else variable.maximum
    moved = [value + sign * change for change in small for sign in (1.0, -1.0)]
    return [other for other in moved if least <= other <= most]
