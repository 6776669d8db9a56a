"""An instance of an FMU, as far as its life, its calls and what they answer go."""

from __future__ import annotations

import ctypes
import warnings
import weakref
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, TypeVar

import control as ct
import numpy as np
from fmpy.fmi1 import FMICallException

from .._sections import FloatArray
from .binding import BindingError, bind
from .clock_schedule import ClockSchedule, ClockTimes
from .foreign import ForeignFmu, ForeignProcessError
from .inspect import FmuDescription, FmuKind, FmuVariable, Kind, Scalar
from .messages import MessageLog, claim_messages, status_word
from .unpacked import UnpackedFmu

__all__ = ["FmuError", "InstanceCalls", "Snapshot"]

T = TypeVar("T")
_SAME_TIME = 1e-6  # part of a step
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
    ended_at : float, optional
        With status "ended": the time in seconds that the FMU came to.

    Attributes
    ----------
    results : CosimulationResponse or None
        Of :func:`cosimulate`: what there was before.
    """

    results: ct.TimeResponseData | None = None

    def __init__(
        self, instance: str, call: str, status: str, detail: str = "", ended_at: float | None = None
    ) -> None:
        super().__init__(f"FMU {instance!r}: {call}: {status}{f': {detail}' if detail else ''}")
        self.instance = instance
        self.call = call
        self.status = status
        self.ended_at = ended_at

    def ends_at(self, t: float, h: float) -> bool:
        """Whether it says that the FMU ended the run at a time, the end of a step: it then has outputs for that time.

        Parameters
        ----------
        t : float
        h : float
            Length of the step that ends there.
        """
        return self.ended_at is not None and abs(self.ended_at - t) <= _SAME_TIME * h


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A state of the FMU, and what is kept beside it.

    Parameters
    ----------
    state : object
        The FMU's pointer.
    time : float
    next_event : float or None
    schedule, inputs : object
        States of these.
    ticks, told : int
        How many there had been.
    """

    state: Any
    time: float
    next_event: float | None
    schedule: object
    inputs: object
    ticks: int
    told: int


class InstanceCalls:
    """The binding of an instance, and its calls; see ``FmuInstance``.

    Parameters
    ----------
    fmu : UnpackedFmu
    kind : {"me", "cs", "se"}
    name : str
    clocks : dict, optional
    intermediate : sequence of FmuVariable
    """

    def __init__(
        self,
        fmu: UnpackedFmu,
        kind: Kind,
        name: str,
        clocks: ClockTimes | None = None,
        intermediate: Sequence[FmuVariable] = (),
    ) -> None:
        self.source = fmu  # keeps the folder
        self.description: FmuDescription = fmu.description
        self.name = name
        self.kind: Kind = kind
        self.ability: FmuKind = self._ability()
        self.schedule: ClockSchedule = ClockSchedule(
            self.description.clocks, clocks or {}, self.description.path
        )
        # Whether discrete inputs and clocks are for its Event Mode alone.
        self.event_mode: bool = kind == "me" or (
            kind == "cs" and self.ability.event_mode and _wants_events(self.description)
        )
        if clocks and not self.event_mode and kind != "se":
            raise ValueError(
                f"{self.description.path}: clocks: this FMU's co-simulation has no Event Mode to tick them in"
            )
        self.time: float = 0.0
        self.next_event: float | None = None
        self.ticks: list[tuple[float, str]] = []
        self.told: list[list[float]] = []
        self.watched: tuple[FmuVariable, ...] = tuple(intermediate)
        self._log = MessageLog()
        self._snapshots: list[Snapshot] = []
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

    def call_raw(self, function: str, *arguments: object) -> None:
        """An FMI function by its name, the instance first.

        Parameters
        ----------
        function : str
        arguments
            After the instance.
        """
        self._call(function, getattr(self._fmu, function), self._fmu.component, *arguments)

    # -- inside -----------------------------------------------------------------------------------------------

    def _ability(self) -> FmuKind:
        kinds = self.description.kinds
        if self.kind not in kinds:
            words = {"me": "model exchange", "cs": "co-simulation", "se": "scheduled execution"}
            has = " and ".join(words[kind] for kind in kinds) or "none of the three kinds"
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
            "event_mode": self.kind == "cs" and self.event_mode,
        }
        if self.watched:
            references = [entry.reference for entry in self.watched]
            what["intermediate"] = references, sum(len(entry.labels) for entry in self.watched)
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
        return FmuError(self.name, function, "ended", f"the FMU asks to end the run at t = {t:.9g}", t)

    def _vector(self, function: Callable[..., object], name: str, count: int) -> FloatArray:
        if count == 0:
            return np.zeros(0)
        values = (ctypes.c_double * count)()
        self._call(name, function, values, count)
        return np.ctypeslib.as_array(values).copy()


def _wants_events(description: FmuDescription) -> bool:
    """Whether it has clocks to be ticked, or discrete inputs, which Event Mode exists for."""
    discrete = any(
        entry.variability != "continuous" and entry.type != "Clock" for entry in description.of("input")
    )
    return discrete or any(clock.causality == "input" for clock in description.clocks)


def _release(fmu: Any, snapshots: list[Snapshot], fmi: str) -> None:
    """Free what an instance holds, whatever happened before."""
    for snapshot in snapshots:
        with suppress(Exception):
            (fmu.freeFMUstate if fmi == "2.0" else fmu.freeFMUState)(snapshot.state)
    snapshots.clear()
    with suppress(Exception):
        fmu.freeInstance()
