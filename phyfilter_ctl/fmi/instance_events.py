"""Events of an instance: Event Mode, clocks that tick, partitions that are scheduled; and continuous time."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import numpy as np

from .._sections import FloatArray
from .clock_schedule import FmuClock
from .held_inputs import HeldInputs
from .instance_calls import FmuError, InstanceCalls

__all__ = ["InstanceEvents"]

_CHANGED = 2  # of fmi3IntervalQualifier
_MOST = 100  # updates of one event, or events at one time, after which they count as endless


class InstanceEvents(InstanceCalls):
    """Events and continuous time of an instance; see ``FmuInstance``.

    Attributes
    ----------
    inputs : HeldInputs or None
        Its inputs, where some of them can be set in Event Mode only.
    ticks : list of tuple of float and str
        Time in seconds and name of each tick of a clock since the run began, input and output clocks alike.
    """

    time: float
    next_event: float | None

    inputs: HeldInputs | None = None

    def states(self) -> FloatArray:
        """Continuous states now."""
        return self._vector(self._fmu.getContinuousStates, "GetContinuousStates", self.description.states)

    def derivatives(self, t: float, x: FloatArray) -> FloatArray:
        """State derivatives at a time and a state, on the inputs set.

        Parameters
        ----------
        t : float
        x : (states,) array
        """
        self.set_point(t, x)
        fmi3_name = self.description.fmi == "3.0"
        function = self._fmu.getContinuousStateDerivatives if fmi3_name else self._fmu.getDerivatives
        return self._vector(function, "GetDerivatives", self.description.states)

    def directional(
        self, unknowns: Sequence[int], knowns: Sequence[int], seed: FloatArray, count: int
    ) -> FloatArray:
        """Directional derivative of the unknowns along a seed of the knowns.

        Parameters
        ----------
        unknowns, knowns : sequence of int
            Value references.
        seed : array
            One value per scalar of the knowns.
        count : int
            Scalars of the unknowns.
        """
        arguments = (list(unknowns), list(knowns), seed.tolist())
        sizes = () if self.description.fmi == "2.0" else (count,)
        return np.array(
            self._call("GetDirectionalDerivative", self._fmu.getDirectionalDerivative, *arguments, *sizes)
        )

    def adjoint(
        self, unknowns: Sequence[int], knowns: Sequence[int], seed: FloatArray, count: int
    ) -> FloatArray:
        """Adjoint derivative: what a seed of the unknowns gives back at the knowns.

        Parameters
        ----------
        unknowns, knowns : sequence of int
            Value references.
        seed : array
            One value per scalar of the unknowns.
        count : int
            Scalars of the knowns.
        """
        arguments = (list(unknowns), list(knowns), seed.tolist(), count)
        return np.array(self._call("GetAdjointDerivative", self._fmu.getAdjointDerivative, *arguments))

    def set_point(self, t: float, x: FloatArray) -> None:
        """Set time and continuous states.

        Parameters
        ----------
        t : float
        x : (states,) array
        """
        self.time = t
        self._call("SetTime", self._fmu.setTime, t)
        if len(x):
            values = (ctypes.c_double * len(x))(*x)
            self._call("SetContinuousStates", self._fmu.setContinuousStates, values, len(x))

    def complete_step(self) -> tuple[bool, bool]:
        """A step of integration ends at the point set: whether the FMU wants event mode, and to end the run."""
        final = not self._snapshots  # while there are states to go back to, one may be put back
        return self._call("CompletedIntegratorStep", self._fmu.completedIntegratorStep, final)

    def indicators(self) -> FloatArray:
        """Event indicators at the point set."""
        return self._vector(
            self._fmu.getEventIndicators, "GetEventIndicators", self.description.event_indicators
        )

    # -- events -----------------------------------------------------------------------------------------------

    @property
    def next_time(self) -> float:
        """When the next event is that is known beforehand, in seconds; inf for none."""
        return min(np.inf if self.next_event is None else self.next_event, self.schedule.next)

    def run_events(self) -> bool:
        """Event mode at the time, states and inputs set, and back; clocks that are due tick.

        Returns
        -------
        bool
            Whether the FMU asks to end the run.

        Raises
        ------
        FmuError
            If a call fails, or the discrete states do not settle.
        """
        return self._event(self.schedule.due(self.time))

    def happen(self) -> bool:
        """Events due at the present time: clocks that tick, discrete inputs that changed. Whether there were any.

        Raises
        ------
        FmuError
            With status "ended" where the FMU asks to end the run.
        """
        for count in range(_MOST):
            due = self.schedule.due(self.time)
            if not due and not (self.inputs is not None and self.inputs.changed):
                return count > 0
            if self.kind == "se":
                self._activate(due[0])
            elif self._event(due):
                raise self.ended(self.time)
        names = ", ".join(clock.name for clock in self.schedule.due(self.time)) or "discrete inputs"
        where = f"{names}: {_MOST} events at t = {self.time:g} without time in between"
        raise FmuError(self.name, "UpdateDiscreteStates", "refused", where)

    def _begin_events(self) -> None:
        """Clocks and discrete inputs from the start of a run on; from event mode, where the FMU is in it."""
        self.ticks.clear()
        self.told.clear()
        if not self.event_mode and self.kind != "se":
            return
        self.schedule.begin(self.time)
        self._ask_intervals(running=False)
        if unknown := self.schedule.unknown:
            where = f"{', '.join(unknown)}: nobody has told the interval; give it by clocks="
            raise FmuError(self.name, "GetIntervalDecimal", "refused", where)
        if self.event_mode and self._iterate_events():
            raise FmuError(self.name, "UpdateDiscreteStates", "ended", "the FMU asks to end the run")
        if self.inputs is not None:
            self.inputs.held = True

    def _event(self, due: Sequence[FmuClock]) -> bool:
        self._call("EnterEventMode", self._fmu.enterEventMode)
        if due:
            self._call("SetClock", self._fmu.setClock, [clock.reference for clock in due], [True] * len(due))
            for clock in due:
                self._ticked(clock)
        if self.inputs is not None:
            self.inputs.set_discrete(self, [clock.name for clock in due])
        return self._iterate_events()

    def _iterate_events(self) -> bool:
        """From event mode to continuous time or step mode, unless the FMU asks to end the run."""
        update = getattr(
            self._fmu, "newDiscreteStates" if self.description.fmi == "2.0" else "updateDiscreteStates"
        )
        outputs = self.schedule.outputs
        for _ in range(_MOST):
            if outputs:
                rung = self._call("GetClock", self._fmu.getClock, [clock.reference for clock in outputs])
                self.ticks.extend((self.time, c.name) for c, on in zip(outputs, rung, strict=True) if on)
            self._ask_intervals()
            again, terminate, _, _, timed, event = self._call("UpdateDiscreteStates", update)
            if terminate:
                return True
            self.next_event = event if timed else None
            if not again:
                self._ask_intervals()
                if self.kind == "me":
                    self._call("EnterContinuousTimeMode", self._fmu.enterContinuousTimeMode)
                else:
                    self._call("EnterStepMode", self._fmu.enterStepMode)
                return False
        where = f"discrete states do not settle in {_MOST} updates at t = {self.time:g}"
        raise FmuError(self.name, "UpdateDiscreteStates", "refused", where)

    def _activate(self, clock: FmuClock) -> None:
        """Scheduled execution: one partition of the model, and what it tells of other clocks."""
        self._ticked(clock)
        asked = {other.reference: other for other in self.schedule.told(running=True)}
        outputs = {other.reference: other.name for other in self.schedule.outputs}
        arguments = (clock.reference, self.time, list(asked), list(outputs))
        told, rung = self._call("ActivateModelPartition", self._fmu.activate, *arguments)
        for reference, interval in told:
            self._tell(asked[reference], interval)
        self.ticks.extend((self.time, outputs[reference]) for reference in rung)

    def _ticked(self, clock: FmuClock) -> None:
        self.schedule.ticked(clock, self.time)
        self.ticks.append((self.time, clock.name))

    def _ask_intervals(self, *, running: bool = True) -> None:
        """Of the clocks whose intervals the FMU tells as it runs."""
        clocks = self.schedule.told(running=running)
        if not clocks:
            return
        references = (ctypes.c_uint * len(clocks))(*(clock.reference for clock in clocks))
        intervals, qualifiers = (ctypes.c_double * len(clocks))(), (ctypes.c_int * len(clocks))()
        ask = self._fmu.getIntervalDecimal
        self._call("GetIntervalDecimal", ask, references, intervals, qualifiers)
        for clock, interval, qualifier in zip(clocks, intervals, qualifiers, strict=True):
            if qualifier == _CHANGED:
                self._tell(clock, interval)

    def _tell(self, clock: FmuClock, interval: float) -> None:
        try:
            self.schedule.tell(clock, interval, self.time)
        except ValueError as error:
            raise FmuError(self.name, "GetIntervalDecimal", "refused", str(error)) from error
