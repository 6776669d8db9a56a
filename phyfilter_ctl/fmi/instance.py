"""One running instance of an FMU, the same for FMI 2.0 and 3.0, model exchange and co-simulation."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np

from .clock_schedule import same_time
from .held_inputs import HeldInputs
from .inspect import FmuVariable, Scalar
from .instance_calls import FmuError, Snapshot
from .instance_events import InstanceEvents
from .signals import Signals, is_numeric
from .values import Opaque, refused_parameters, set_values

__all__ = ["FmuError", "FmuInstance"]

_MOST = 100  # events at one time, after which they count as endless


class FmuInstance(InstanceEvents):
    """An instance of an FMU; frees itself.

    Parameters
    ----------
    fmu : UnpackedFmu
        Its code is loaded and run in this process, or in one of its own where ``fmu.isolation`` says so.
    kind : {"me", "cs", "se"}
    name : str
        Instance name, for the FMU's log and for messages.
    clocks : dict of str to float or sequence of float, optional
        Intervals of clocks whose interval is the importer's to choose, instants of triggered ones.
    intermediate : sequence of FmuVariable
        What co-simulation is to tell of inside its steps; variables of type Float64.

    Attributes
    ----------
    told : list of list of float
        Time in seconds and these values, each time that it told them since the run began.

    Raises
    ------
    ValueError
        If the FMU is not of this kind.
    FmuError
        If the binary cannot be loaded or refuses to make an instance.

    Warns
    -----
    UserWarning
        If the FMU says that it needs the tool that made it.
    """

    time: float
    next_event: float | None
    inputs: HeldInputs | None
    told: list[list[float]]

    # -- life -------------------------------------------------------------------------------------------------

    def initialise(
        self,
        start_time: float,
        *,
        stop_time: float | None = None,
        tolerance: float | None = None,
        values: Mapping[str, Scalar] | None = None,
    ) -> None:
        """Enter initialisation with these start values and parameters.

        Parameters
        ----------
        start_time, stop_time : float
        tolerance : float, optional
            Relative, of the FMU's own solver.
        values : dict of str to number or text, optional
            By variable, or by element for an array (``a[0]``).
        """
        self.time = start_time
        self._configure()
        self._given = dict(values or {})
        self.set_values(self._given)
        if self.description.fmi == "2.0":
            self._call("fmi2SetupExperiment", self._fmu.setupExperiment, tolerance, start_time, stop_time)
            self._call("fmi2EnterInitializationMode", self._fmu.enterInitializationMode)
        else:
            arguments = (tolerance, start_time, stop_time)
            self._call("fmi3EnterInitializationMode", self._fmu.enterInitializationMode, *arguments)
        for name, interval in self.schedule.chosen.items():
            setting = [
                (ctypes.c_uint * 1)(self.schedule.inputs[name].reference),
                (ctypes.c_double * 1)(interval),
            ]
            self._call("fmi3SetIntervalDecimal", self._fmu.setIntervalDecimal, *setting)

    def begin(self) -> None:
        """Leave initialisation; a model-exchange FMU is then in continuous time, one of co-simulation in step mode.

        Raises
        ------
        FmuError
            If the FMU fails, or a parameter that was set is not the one in force.
        """
        self._call("ExitInitializationMode", self._fmu.exitInitializationMode)
        self._initialised = True
        self._check_parameters()
        self._begin_events()

    def reset(self) -> None:
        """Back to the state of a fresh instance."""
        self._drop_snapshots()
        self._call("Reset", self._fmu.reset)
        self._initialised = False
        if self.inputs is not None:
            self.inputs.release()

    def close(self) -> None:
        """Terminate and free the instance. Calling it again does nothing."""
        if self._free.alive and self._initialised and not self._broken:
            with suppress(FmuError):
                self._call("Terminate", self._fmu.terminate)
        if self._broken == "a fatal error":
            self._free.detach()  # after a fatal error no function may be called, not even to free it
        else:
            self._free()
        self._broken = self._broken or "closed"

    # -- values -----------------------------------------------------------------------------------------------

    def signals(self, causality: str) -> Signals:
        """All numeric variables of one causality; of the inputs, discrete ones wait for events where there are any.

        Parameters
        ----------
        causality : str
        """
        fmi = self.description.fmi
        entries = [entry for entry in self.description.of(causality) if is_numeric(entry, fmi)]
        if causality == "input" and self.event_mode:
            self.inputs = HeldInputs(entries, fmi)
            return self.inputs
        return Signals(entries, fmi)

    def set_values(self, values: Mapping[str, Scalar]) -> None:
        """Set single variables.

        Parameters
        ----------
        values : dict of str to number, text or bytes
            By variable (one value fills an array), or by element of an array; the other elements stay as they are.

        Raises
        ------
        ValueError
            If there is no such variable, or a value does not fit its type or range. Nothing is set then.
        """
        set_values(self, values, running=self._initialised)

    def get_opaque(self, variable: FmuVariable) -> tuple[Opaque, ...]:
        """Elements of a String or Binary variable now.

        Parameters
        ----------
        variable : FmuVariable
        """
        arguments = (variable.type, [variable.reference], len(variable.labels))
        found: list[str] = self._call(f"Get{variable.type}", self._fmu.getOpaque, *arguments)
        return tuple(found) if variable.type == "String" else tuple(map(bytes.fromhex, found))

    def set_opaque(self, variable: FmuVariable, values: Sequence[Opaque]) -> None:
        """Set all elements of a String or Binary variable.

        Parameters
        ----------
        variable : FmuVariable
        values : sequence of str or bytes
        """
        words = [value.hex() if isinstance(value, bytes) else value for value in values]
        arguments = (variable.type, [variable.reference], words)
        self._call(f"Set{variable.type}", self._fmu.setOpaque, *arguments)

    # -- co-simulation ----------------------------------------------------------------------------------------

    def do_step(self, t: float, h: float, *, final: bool = True) -> None:
        """Advance from t by h on the inputs set.

        Parameters
        ----------
        t, h : float
            Seconds.
        final : bool
            False where a state of a time before t may be put back; the one at t always may.

        Raises
        ------
        FmuError
            With status "discard" where a smaller step may help.
        """
        end, stalled = t + h, 0
        self.time = t
        self.happen()
        while t < end:  # an FMU that returns early, at an event, goes on from there
            reached, event = self._stepped(t, self._tick_before(end), final)
            stalled = 0 if reached > t else stalled + 1
            if stalled > _MOST:
                where = f"{_MOST} events at t = {t:g} without time in between"
                raise FmuError(self.name, "fmi3DoStep", "refused", where)
            t = self.time = end if end - reached <= 1e-9 * h else reached
            due = self.schedule.due(t)
            if t == end and due:
                return  # the event is that of the ticks, which wait for the inputs there
            if self.kind == "se":
                self.happen()
            elif (event or due) and self._event(due):
                raise self.ended(t)

    def _tick_before(self, end: float) -> float:
        """Where a clock ticks before the end of a step; the end if none does."""
        tick = self.schedule.next
        if tick >= end or same_time(tick, end):
            return end
        if not self.ability.variable_step:
            names = ", ".join(clock.name for clock in self.schedule.due(tick))
            where = (
                f"{names}: ticks at t = {tick:g}, inside a communication step, and the FMU's steps are all equal; "
                "choose a step that the ticks are multiples of"
            )
            raise FmuError(self.name, "fmi3DoStep", "refused", where)
        return tick

    def _stepped(self, t: float, end: float, final: bool) -> tuple[float, bool]:
        """One doStep: where it got to, and whether the FMU wants event mode there."""
        if self.kind == "se":
            return end, False
        answer = self._call(f"fmi{self.description.fmi[0]}DoStep", self._fmu.doStep, t, end - t, final)
        if self.watched:
            self.told += self._call("IntermediateUpdate", self._fmu.takeHeard)
        if answer is None:  # FMI 2.0
            return end, False
        event, terminate, early, reached = answer
        event = event and self.event_mode
        if terminate:
            raise self.ended(reached)
        if early and not reached > t and not event:
            raise FmuError(self.name, "fmi3DoStep", "discard", f"returned early, at t = {reached:g}")
        return (reached if early else end), event

    def save(self) -> object:
        """The whole state, to be given back to :meth:`restore` or :meth:`forget`."""
        names = ("getFMUstate", "getFMUState")
        state = self._call("GetFMUState", getattr(self._fmu, names[self.description.fmi == "3.0"]))
        inputs = None if self.inputs is None else self.inputs.state
        snapshot = Snapshot(
            state, self.time, self.next_event, self.schedule.state, inputs, len(self.ticks), len(self.told)
        )
        self._snapshots.append(snapshot)
        return snapshot

    def restore(self, state: object) -> None:
        """Put a state back.

        Parameters
        ----------
        state : object
            From :meth:`save`.
        """
        assert isinstance(state, Snapshot)
        names = ("setFMUstate", "setFMUState")
        self._call("SetFMUState", getattr(self._fmu, names[self.description.fmi == "3.0"]), state.state)
        self.time, self.next_event, self.schedule.state = state.time, state.next_event, state.schedule
        if self.inputs is not None:
            self.inputs.state = state.inputs
        del self.ticks[state.ticks :]
        del self.told[state.told :]

    def forget(self, state: object) -> None:
        """Free a state.

        Parameters
        ----------
        state : object
            From :meth:`save`.
        """
        if isinstance(state, Snapshot) and any(entry is state for entry in self._snapshots):
            self._snapshots[:] = [entry for entry in self._snapshots if entry is not state]
            names = ("freeFMUstate", "freeFMUState")
            self._call("FreeFMUState", getattr(self._fmu, names[self.description.fmi == "3.0"]), state.state)

    # -- inside -----------------------------------------------------------------------------------------------

    def _configure(self) -> None:
        """Set the structural parameters."""
        structure = self.source.structure
        if not structure:
            return
        entries = [entry for entry in self.description.of("structuralParameter") if entry.name in structure]
        self._call("fmi3EnterConfigurationMode", self._fmu.enterConfigurationMode)
        Signals(entries, "3.0").write(self, np.array([entry.start[0] for entry in entries], dtype=object))
        self._call("fmi3ExitConfigurationMode", self._fmu.exitConfigurationMode)

    def _check_parameters(self) -> None:
        """An FMU may refuse a parameter with a warning, which fmpy lets pass, and run on with another value."""
        if refused := refused_parameters(self, self._given):
            detail = "; ".join(refused) + (f": {logged}" if (logged := self._log.latest()) else "")
            raise FmuError(self.name, "set parameters", "refused", detail)

    def _drop_snapshots(self) -> None:
        for state in list(self._snapshots):
            self.forget(state)
