"""Model-exchange FMUs as python-control systems, and as functions that CasADi calls back in any diagram."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Literal

import numpy as np

from .._sections import FloatArray
from ..blocks.functions import BlockEvent, BlockFunctions
from ..blocks.interpreted import Interpreted
from .clock_schedule import ClockTimes
from .importing_blocks import FmuBlock, input_starts
from .inspect import Scalar
from .instance import FmuError
from .signals import Signals, recorded
from .unpacked import UnpackedFmu

__all__ = ["FmuModel"]

# What the integrator's arithmetic may leave between a time and the event that it was to meet.
_ROUNDING = 1e-12


class FmuModel(FmuBlock):
    """A model-exchange FMU as a continuous system; made by :func:`import_fmu`.

    Parameters
    ----------
    fmu : UnpackedFmu
    name, parameters, start_time, tolerance, events, outputs, clocks
        As for :func:`import_fmu`.

    Attributes
    ----------
    start_state : (n,) array
        Start values of its states, for ``initial_state`` of python-control's simulations.

    start_inputs : (m,) array
        Start values of its inputs.

    Notes
    -----
    :func:`simulate` runs it in any diagram, with its events. python-control's simulations evaluate x' = f(t, x, u) at
    times of their choice and know no events: with event indicators evaluation raises, and beyond a time event that
    the FMU announces, unless ``events="ignore"``.

    Discrete inputs are set at events, which happen where they change. A clock that ticks at the instant of a jump of an
    input (``interpolation="hold"``) sees what was held until then.
    """

    def __init__(
        self,
        fmu: UnpackedFmu,
        *,
        name: str,
        parameters: Mapping[str, Scalar] | None = None,
        start_time: float = 0.0,
        tolerance: float | None = None,
        events: Literal["raise", "ignore"] = "raise",
        outputs: Sequence[str] | None = None,
        clocks: ClockTimes | None = None,
    ) -> None:
        super().__init__(
            fmu,
            "me",
            name=name,
            parameters=parameters or {},
            start_time=start_time,
            tolerance=tolerance,
            dt=0.0,
            states=fmu.description.state_labels,
            outputs=outputs,
            clocks=clocks,
        )
        self._events: Literal["raise", "ignore"] = events
        self._restart(start_time, self.params)
        present = self._inputs.read(self.instance)
        if self.instance.inputs is not None:
            self.instance.inputs.adopt(present)
        starts = input_starts(self.description, self._inputs.labels, self._fixed)
        self.start_inputs: FloatArray = np.where(np.isnan(starts), present, starts)
        self._has_events: bool = (
            self.description.event_indicators > 0
            or self.instance.next_event is not None
            or self.has_discrete_inputs
            or len(self.instance.schedule.inputs) > 0
        )
        self.start_state: FloatArray = self.instance.states()
        self.start_state.flags.writeable = False
        self._begins, self._latest = start_time, self.start_inputs
        self._start_values = {entry.name for entry in self.description.variables if entry.start}

    @property
    def has_events(self) -> bool:
        """Whether it announces any: by indicators, a time, clocks, or discrete inputs."""
        return self._has_events

    @property
    def has_discrete_inputs(self) -> bool:
        """Whether inputs of it are taken in at events alone."""
        return self.instance.inputs is not None and len(self.instance.inputs.discrete) > 0

    @property
    def functions(self) -> BlockFunctions:
        """Equations and events as functions that CasADi calls back; new ones each time, on this one instance."""
        return _functions(self)

    def rewind(self, t: float | None) -> None:
        """It starts anew where it is used next.

        Parameters
        ----------
        t : float, optional
            Seconds; its own start time by default.
        """
        self._begins = self._start_time if t is None else t
        self.instance.next_event = None
        self._let_go()

    def start_at(self, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        """Initialise with these inputs, from x where that is not the FMU's own start; returns where it starts.

        Parameters
        ----------
        x : (n,) array
        u : (m,) array
        params : mapping
        """
        own = np.array_equal(x, self.start_state)
        labels = self.description.state_labels
        owners = {label: entry.name for entry in self.description.variables for label in entry.labels}
        given = {} if own else dict(zip(labels, x.tolist(), strict=True))
        starts = {label: value for label, value in given.items() if owners[label] in self._start_values}
        self._restart(self._begins, params, starts, u)
        if not own:
            self.instance.set_point(self._begins, x)
        return self.instance.states() if own else x

    def move(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> None:
        """Set parameters, time, states and inputs; inputs that are not-a-number stay as they are.

        Parameters
        ----------
        t : float
        x : (n,) array
        u : (m,) array
        params : mapping
        """
        if not self._running or self._changed(params):
            self._restart(self._begins, params)
        self.instance.set_point(t, x)
        if len(u):
            self._latest = np.where(np.isnan(u), self._latest, u)
            self._inputs.write(self.instance, self._latest)

    def rates_at(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        """State derivatives between events.

        Parameters
        ----------
        t : float
        x : (n,) array
        u : (m,) array
        params : mapping
        """
        self.move(t, x, u, params)
        return self.instance.derivatives(t, x)

    def outputs_at(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        """Outputs between events.

        Parameters
        ----------
        t : float
        x : (n,) array
        u : (m,) array
        params : mapping
        """
        self.move(t, x, u, params)
        return self._outputs.read(self.instance)

    def outputs_now(self) -> FloatArray:
        """Outputs as the FMU stands."""
        return self._outputs.read(self.instance)

    def __deepcopy__(self, memo: dict[int, object]) -> FmuModel:
        return FmuModel(
            self._fmu,
            name=self.name or "fmu",
            parameters=self.values,
            start_time=self._start_time,
            tolerance=self._tolerance,
            events=self._events,
            outputs=self._patterns,
            clocks=self.clocks,
        )

    def _signals(self) -> tuple[Signals, Signals]:
        for entry in recorded(self.description, self._patterns, numeric=False):
            if entry.name in (self._patterns or ()):
                raise ValueError(
                    f"outputs: {entry.name} is {entry.type}, which no signal of python-control can be; "
                    "cosimulate records it where the FMU has co-simulation"
                )
        return super()._signals()

    def _place(self, t: float, u: FloatArray, params: Mapping[str, float]) -> None:
        count = self.description.event_indicators
        if count and self._events == "raise":
            raise ValueError(
                f"{self.description.path}: has {count} event indicators; python-control's simulation handles no "
                'events. Use phyfilter_ctl.simulate, which does, or import it with kind="cs" if it has co-simulation, '
                'or with events="ignore" where no event is reached'
            )
        u = np.asarray(u, dtype=float).reshape(-1)
        inputs = self.instance.inputs
        jumped = inputs is not None and self._running and inputs.would_change(u)
        if not self._running or self._changed(params) or (jumped and t == self._start_time):
            self._restart(self._start_time, params, None, u)
            jumped = False
        event = self.instance.next_time
        if (jumped or t >= event) and self._events == "raise":
            what = (
                "a discrete input changes at" if jumped else f"it has a time event at t = {event:g}, before"
            )
            raise FmuError(
                self.instance.name,
                "evaluate",
                "refused",
                f"{what} t = {t:g}, and python-control's simulation handles no events: use "
                'phyfilter_ctl.simulate, which does, or import with events="ignore"',
            )
        self._inputs.write(self.instance, u)

    def _next(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        self._place(t, u, params)
        return self.instance.derivatives(t, np.asarray(x, dtype=float))

    def _now(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        self._place(t, u, params)
        self.instance.set_point(t, np.asarray(x, dtype=float))
        return self._outputs.read(self.instance)


class _FmuMemory:
    """The discrete states of an FMU: what happens to them in a run.

    Parameters
    ----------
    block : FmuModel
    """

    def __init__(self, block: FmuModel) -> None:
        self._block = block
        self._fresh = False
        self._ended = ""
        self._final = np.zeros(0)  # outputs where the FMU asked to end the run

    @property
    def ended(self) -> str:
        """What to say where the FMU asked to end the run."""
        return self._ended

    @property
    def next_event(self) -> float:
        """Time of the next event, inf for none."""
        return self._block.instance.next_time

    def restart(self, t: float) -> None:
        """The event that follows initialises the FMU at this time."""
        self._block.rewind(t)
        self._fresh, self._ended = True, ""

    @contextmanager
    def running(self) -> Iterator[None]:
        """Keeps others from the FMU; afterwards it starts anew where it is used."""
        with self._block.lock:
            try:
                yield
            finally:
                self._block.rewind(None)

    def happen(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        """Event mode at a point, or the start of the run: x after it, and 1 where the run is to end."""
        block = self._block
        if self._fresh:
            self._fresh = False
            return np.append(block.start_at(x, u, params), 0.0)
        event = self.next_event
        block.move(event if abs(event - t) <= _ROUNDING * max(abs(t), 1.0) else t, x, u, params)
        end = block.instance.run_events()
        self._say(end, t)
        # An FMU that asks to end the run tells its outputs, and no more states.
        return np.append(x if end else block.instance.states(), float(end))

    def output(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        """Outputs between events, and the last ones of an FMU that asked to end the run."""
        return self._final if self._ended else self._block.outputs_at(t, x, u, params)

    def condition(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        """Event indicators; 0 counts as below 0, as FMI has it."""
        self._block.move(t, x, u, params)
        values = self._block.instance.indicators()
        return np.where(values > 0.0, values, np.minimum(values, -np.finfo(float).tiny))

    def completed(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        """1 where the FMU wants an event after this step, 2 where the run is to end."""
        self._block.move(t, x, u, params)
        event, end = self._block.instance.complete_step()
        self._say(end, t)
        return np.array([2.0 if end else float(event)])

    def changed(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        """1 where discrete inputs differ from those that the FMU has."""
        inputs = self._block.instance.inputs
        return np.array([float(not self._fresh and inputs is not None and inputs.would_change(u))])

    def _say(self, end: bool, t: float) -> None:
        if end:
            self._final = self._block.outputs_now()
            self._ended = f"block {self._block.name}: the FMU asked to end the run at t = {t:.9g} s"


def _functions(block: FmuModel) -> BlockFunctions:
    """Equations and events of an imported model-exchange FMU.

    Parameters
    ----------
    block : FmuModel

    Returns
    -------
    BlockFunctions
        Callbacks into the FMU, which stay in force as long as they are held. They move one and the same instance.
    """
    memory = _FmuMemory(block)
    states, size = len(block.state_labels), len(block.output_labels)
    description = block.description
    through = description.feedthrough(*block.labels)
    wants_steps = description.kinds["me"].completed_step
    event = BlockEvent(
        "event",
        0,
        block.callback("condition", memory.condition, description.event_indicators),
        block.callback("event", memory.happen, states + 1),
        memory,
        block.callback("completed", memory.completed, 1) if wants_steps else None,
        block.callback("changed", memory.changed, 1) if block.has_discrete_inputs else None,
    )
    dynamics = block.callback("update", block.rates_at, states)
    output = block.callback("output", memory.output, size, through)
    made = (dynamics, output, event.condition, event.reset, event.completed, event.changed)
    return BlockFunctions(
        states=block.variables(block.state_labels, block.start_state.tolist()),
        inputs=block.variables(block.input_labels, block.start_inputs.tolist()),
        outputs=block.variables(block.output_labels, [0.0] * size),
        parameters=block.variables(list(block.params), list(block.params.values())),
        dynamics=dynamics,
        output=output,
        callbacks=tuple(function for function in made if isinstance(function, Interpreted)),
        events=(event,),
        keeps_starts=True,
    )
