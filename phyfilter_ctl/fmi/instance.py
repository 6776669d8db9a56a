"""One running instance of an FMU, the same for FMI 2.0 and 3.0, model exchange and co-simulation."""

from __future__ import annotations

import ctypes
import warnings
import weakref
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, TypeVar

import control as ct
import numpy as np
from fmpy.fmi1 import FMICallException

from .._sections import FloatArray
from .binding import BindingError, bind
from .foreign import ForeignFmu, ForeignProcessError
from .inspect import FmuDescription, FmuKind, FmuVariable, Kind, Scalar
from .messages import MessageLog, claim_messages, status_word
from .signals import Signals, is_numeric
from .unpacked import UnpackedFmu
from .values import Opaque, refused_parameters, set_values

__all__ = ["FmuError", "FmuInstance"]

T = TypeVar("T")
_LAST_TIME, _TERMINATED = 2, 3  # of fmi2StatusKind


class FmuError(RuntimeError):
    """A call into an FMU failed.

    Parameters
    ----------
    instance, call : str
        Name of the instance, FMI function.
    status : str
        "discard", "error", "fatal"; "refused" where the importer itself stopped; "crashed" or "time limit" where its
        process ended (isolated FMUs).
    detail : str
        What the FMU logged, or what to do.

    Attributes
    ----------
    results : CosimulationResponse or None
        Of :func:`cosimulate`: what there was before.
    """

    results: ct.TimeResponseData | None = None

    def __init__(self, instance: str, call: str, status: str, detail: str = "") -> None:
        super().__init__(f"FMU {instance!r}: {call}: {status}{f': {detail}' if detail else ''}")
        self.instance = instance
        self.call = call
        self.status = status


class FmuInstance:
    """An instance of an FMU; frees itself.

    Parameters
    ----------
    fmu : UnpackedFmu
        Its code is loaded and run in this process, or in one of its own where ``fmu.isolation`` says so.
    kind : {"me", "cs"}
    name : str
        Instance name, for the FMU's log and for messages.

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

    def __init__(self, fmu: UnpackedFmu, kind: Kind, name: str) -> None:
        self.source = fmu  # keeps the folder
        self.description: FmuDescription = fmu.description
        self.name = name
        self.kind: Kind = kind
        self.ability: FmuKind = self._ability()
        self.time: float = 0.0
        self.next_event: float | None = None
        self._log = MessageLog()
        self._snapshots: list[Any] = []
        self._broken = ""
        self._initialised = False
        self._given: dict[str, Scalar] = {}
        self._fmu: Any = self._bound()
        self._free = weakref.finalize(self, _release, self._fmu, self._snapshots, self.description.fmi)

    @property
    def messages(self) -> tuple[str, ...]:
        """What the FMU logged, oldest first."""
        return tuple(self._log.messages)

    @property
    def state_is_usable(self) -> bool:
        """Whether the state can be taken and put back."""
        return self.ability.state

    @property
    def component(self) -> int:
        """The instance's address, for calls past this class."""
        component = self._fmu.component
        return int(getattr(component, "value", component))

    def function_address(self, name: str) -> int:
        """Where a function of the FMU is, for calls past this class.

        Parameters
        ----------
        name : str
        """
        return ctypes.cast(getattr(self._fmu.dll, name), ctypes.c_void_p).value or 0

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

    def begin(self) -> None:
        """Leave initialisation; a model-exchange FMU is then in continuous time.

        Raises
        ------
        FmuError
            If the FMU fails, or a parameter that was set is not the one in force.
        """
        self._call("ExitInitializationMode", self._fmu.exitInitializationMode)
        self._initialised = True
        self._check_parameters()
        if self.kind == "me" and self._iterate_events():
            raise FmuError(self.name, "UpdateDiscreteStates", "ended", "the FMU asks to end the run")

    def reset(self) -> None:
        """Back to the state of a fresh instance."""
        self._drop_snapshots()
        self._call("Reset", self._fmu.reset)
        self._initialised = False

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
        """All numeric variables of one causality.

        Parameters
        ----------
        causality : str
        """
        fmi = self.description.fmi
        return Signals([entry for entry in self.description.of(causality) if is_numeric(entry, fmi)], fmi)

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

    def call_raw(self, function: str, *arguments: object) -> None:
        """An FMI function by its name, the instance first.

        Parameters
        ----------
        function : str
        arguments
            After the instance.
        """
        self._call(function, getattr(self._fmu, function), self._fmu.component, *arguments)

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
        end = t + h
        early = True
        while early:  # an FMU that returns early, at an event, goes on from there
            self.time = t
            answer = self._call(f"fmi{self.description.fmi[0]}DoStep", self._fmu.doStep, t, end - t, final)
            early = False
            if answer is not None:  # FMI 3.0: event, terminate, early return, last successful time
                _, terminate, early, reached = answer
                if terminate:
                    raise self.ended(reached)
                if early and not reached > t:
                    raise FmuError(self.name, "fmi3DoStep", "discard", f"returned early, at t = {reached:g}")
                t, early = reached, early and reached < end - 1e-9 * h
        self.time = end

    def save(self) -> object:
        """The whole state, to be given back to :meth:`restore` or :meth:`forget`."""
        names = ("getFMUstate", "getFMUState")
        state = self._call("GetFMUState", getattr(self._fmu, names[self.description.fmi == "3.0"]))
        self._snapshots.append(state)
        return state

    def restore(self, state: object) -> None:
        """Put a state back.

        Parameters
        ----------
        state : object
            From :meth:`save`.
        """
        names = ("setFMUstate", "setFMUState")
        self._call("SetFMUState", getattr(self._fmu, names[self.description.fmi == "3.0"]), state)

    def forget(self, state: object) -> None:
        """Free a state.

        Parameters
        ----------
        state : object
            From :meth:`save`.
        """
        if any(entry is state for entry in self._snapshots):
            self._snapshots[:] = [entry for entry in self._snapshots if entry is not state]
            names = ("freeFMUstate", "freeFMUState")
            self._call("FreeFMUState", getattr(self._fmu, names[self.description.fmi == "3.0"]), state)

    # -- model exchange ---------------------------------------------------------------------------------------

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

    def _vector(self, function: Callable[..., object], name: str, count: int) -> FloatArray:
        if count == 0:
            return np.zeros(0)
        values = (ctypes.c_double * count)()
        self._call(name, function, values, count)
        return np.ctypeslib.as_array(values).copy()

    def run_events(self) -> bool:
        """Event mode at the time, states and inputs set, and back; whether the FMU asks to end the run.

        Raises
        ------
        FmuError
            If a call fails, or the discrete states do not settle.
        """
        self._call("EnterEventMode", self._fmu.enterEventMode)
        return self._iterate_events()

    def complete_step(self) -> tuple[bool, bool]:
        """A step of integration ends at the point set: whether the FMU wants event mode, and to end the run."""
        return self._call("CompletedIntegratorStep", self._fmu.completedIntegratorStep)

    def indicators(self) -> FloatArray:
        """Event indicators at the point set."""
        return self._vector(
            self._fmu.getEventIndicators, "GetEventIndicators", self.description.event_indicators
        )

    def _iterate_events(self) -> bool:
        """From event mode to continuous time, unless the FMU asks to end the run."""
        update = getattr(
            self._fmu, "newDiscreteStates" if self.description.fmi == "2.0" else "updateDiscreteStates"
        )
        for _ in range(100):
            again, terminate, _, _, timed, event = self._call("UpdateDiscreteStates", update)
            if terminate:
                return True
            self.next_event = event if timed else None
            if not again:
                self._call("EnterContinuousTimeMode", self._fmu.enterContinuousTimeMode)
                return False
        where = f"discrete states do not settle in 100 updates at t = {self.time:g}"
        raise FmuError(self.name, "UpdateDiscreteStates", "refused", where)

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

    def _ability(self) -> FmuKind:
        kinds = self.description.kinds
        if self.kind not in kinds:
            words = {"me": "model exchange", "cs": "co-simulation"}
            has = " and ".join(words[kind] for kind in kinds) or "neither"
            raise ValueError(
                f"{self.description.path}: expected an FMU for {words[self.kind]}; it is for {has}"
            )
        if kinds[self.kind].needs_tool:
            tool = self.description.tool or "not named"
            warnings.warn(
                f"{self.description.path}: says that it needs the tool that made it ({tool}) on this machine; trying",
                stacklevel=4,
            )
        return kinds[self.kind]

    def _bound(self) -> Any:
        what: dict[str, Any] = {
            "fmi": self.description.fmi,
            "kind": self.kind,
            "folder": str(self.source.folder),
            "identifier": self.ability.identifier,
            "token": self.description.token,
            "name": self.name,
        }
        isolation = self.source.isolation
        try:
            return bind(self._log, **what) if isolation is None else ForeignFmu(self._log, isolation, **what)
        except BindingError as error:
            status = "refused" if error.call == "load the binary" else "error"
            raise FmuError(self.name, error.call, status, str(error)) from error
        except ForeignProcessError as error:
            raise FmuError(self.name, "Instantiate", error.status, self._last_words(str(error))) from error

    def _last_words(self, detail: str) -> str:
        logged = self._log.latest()
        return f"{detail}; {logged}" if logged else detail

    def _call(self, name: str, function: Callable[..., T], *arguments: object) -> T:
        if self._broken:
            raise FmuError(
                self.name, name, "refused", f"the instance has ended ({self._broken}); make a new one"
            )
        if self.description.fmi == "2.0" and self.source.isolation is None:
            claim_messages()
        try:
            return function(*arguments)
        except FMICallException as error:
            raise self.failure(error.function, error.status, self.time) from error
        except ForeignProcessError as error:
            self._broken, self._initialised = str(error), False
            detail = self._last_words(f"at t = {self.time:g} {error}")
            raise FmuError(self.name, name, error.status, detail) from error

    def failure(self, function: str, status: int, t: float) -> FmuError:
        """What to raise where a function answered with a status beyond a warning; only freeing is left after an error.

        Parameters
        ----------
        function : str
        status : int
        t : float
        """
        word = status_word(status)
        self._initialised = self._initialised and word == "discard"
        if word == "fatal":
            self._broken = "a fatal error"
        if word == "discard" and function == "fmi2DoStep" and (end := self._asked_end()) is not None:
            return self.ended(end)
        return FmuError(self.name, function, word, self._last_words(f"at t = {t:g}"))

    def _asked_end(self) -> float | None:
        """FMI 2.0: where the run is to end, if that is why a step was discarded."""
        with suppress(FMICallException):
            return (
                float(self._fmu.getRealStatus(_LAST_TIME))
                if self._fmu.getBooleanStatus(_TERMINATED)
                else None
            )
        return None

    def ended(self, t: float) -> FmuError:
        """What to raise where the FMU asks to end the run.

        Parameters
        ----------
        t : float
        """
        function = f"fmi{self.description.fmi[0]}DoStep"
        return FmuError(self.name, function, "ended", f"the FMU asks to end the run at t = {t:g}")

    def _check_parameters(self) -> None:
        """An FMU may refuse a parameter with a warning, which fmpy lets pass, and run on with another value."""
        if refused := refused_parameters(self, self._given):
            detail = "; ".join(refused) + (f": {logged}" if (logged := self._log.latest()) else "")
            raise FmuError(self.name, "set parameters", "refused", detail)

    def _drop_snapshots(self) -> None:
        for state in list(self._snapshots):
            self.forget(state)


def _release(fmu: Any, snapshots: list[Any], fmi: str) -> None:
    """Free what an instance holds, whatever happened before."""
    for state in snapshots:
        with suppress(Exception):
            (fmu.freeFMUstate if fmi == "2.0" else fmu.freeFMUState)(state)
    snapshots.clear()
    with suppress(Exception):
        fmu.freeInstance()
