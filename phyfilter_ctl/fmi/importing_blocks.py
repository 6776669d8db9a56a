"""FMUs as python-control systems: what they share, and model exchange."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Literal

import control as ct
import numpy as np

from .._sections import FloatArray
from ..blocks.functions import BlockFunctions
from .importing_functions import model_functions
from .inspect import FmuDescription, Kind, Scalar
from .instance import FmuError, FmuInstance
from .signals import Signals, recorded
from .unpacked import UnpackedFmu

__all__ = ["FmuBlock", "FmuModel", "ct_names"]

_NUMERIC = ("Float64", "Float32", "Int", "UInt", "Enumeration", "Boolean")


class FmuBlock(ct.NonlinearIOSystem, ABC):
    """An FMU as a python-control system; what model exchange and co-simulation have in common.

    Parameters
    ----------
    fmu : UnpackedFmu
    kind : {"me", "cs"}
    name : str
    parameters : dict of str to number or text
        Parameters and start values that differ from the FMU's.
    start_time : float
        Seconds.
    tolerance : float, optional
        Relative, of the FMU's own solver.
    dt : float
        0, or the communication step in seconds.
    states : sequence of str
        Names.
    outputs : sequence of str, optional
        Names or patterns of the variables that it puts out; None for the FMU's outputs.

    Attributes
    ----------
    description : FmuDescription
    instance : FmuInstance
    units : dict of str to str
        Unit by input, output, state and parameter, where the FMU gives one.

    Notes
    -----
    Made by :func:`import_fmu`. A copy (python-control makes one where a system is used twice) is an instance of its
    own. The instance is freed and its files removed with the block, or by :meth:`close`.
    """

    def __init__(
        self,
        fmu: UnpackedFmu,
        kind: Kind,
        *,
        name: str,
        parameters: Mapping[str, Scalar],
        start_time: float,
        tolerance: float | None,
        dt: float,
        states: Sequence[str],
        outputs: Sequence[str] | None = None,
    ) -> None:
        self._patterns = outputs
        self._fmu = fmu
        self._fixed = dict(parameters)
        self._start_time = start_time
        self._tolerance = tolerance
        self.instance: FmuInstance = FmuInstance(fmu, kind, name)
        self._inputs, self._outputs = self._signals()
        numbers = _parameters(self.description, kind)
        numbers |= {key: float(value) for key, value in parameters.items() if key in numbers}
        inputs, outputs = ct_names(self._inputs.labels), ct_names(self._outputs.labels)
        super().__init__(
            self._next,
            self._now,
            inputs=inputs,
            outputs=outputs,
            states=list(states),
            name=name,
            dt=dt,
            params=numbers,
        )
        units = dict(zip(inputs, self._inputs.units, strict=True)) | dict(
            zip(outputs, self._outputs.units, strict=True)
        )
        others = {label: entry.unit for entry in self.description.variables for label in entry.labels}
        self.units: dict[str, str] = {key: others[key] for key in [*states, *numbers] if others.get(key)}
        self.units |= {key: unit for key, unit in units.items() if unit}
        self._in_force: dict[str, float] = {}
        self._running = False

    @property
    def description(self) -> FmuDescription:
        """What the FMU says of itself."""
        return self._fmu.description

    @property
    def source(self) -> UnpackedFmu:
        """The unpacked FMU."""
        return self._fmu

    @property
    def values(self) -> dict[str, Scalar]:
        """Parameters and start values that it was imported with."""
        return self._fixed | self.params

    @property
    def messages(self) -> tuple[str, ...]:
        """What the FMU logged, oldest first."""
        return self.instance.messages

    def close(self) -> None:
        """Free the instance. The block cannot be used afterwards."""
        self.instance.close()

    def _signals(self) -> tuple[Signals, Signals]:
        return self.instance.signals("input"), self._recorded()

    def _recorded(self) -> Signals:
        return Signals(recorded(self.description, self._patterns), self.description.fmi)

    @property
    def patterns(self) -> Sequence[str] | None:
        """Names or patterns of what it puts out; None for the FMU's outputs."""
        return self._patterns

    @abstractmethod
    def _next(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        """Derivatives, or the next state."""

    @abstractmethod
    def _now(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        """Outputs."""

    def _restart(
        self,
        time: float,
        params: Mapping[str, float],
        starts: Mapping[str, float] | None = None,
        inputs: FloatArray | None = None,
    ) -> None:
        """Initialise anew: the one way to change a fixed parameter."""
        # python-control passes the parameters of all blocks to each of them.
        values = {key: params.get(key, value) for key, value in self.params.items()}
        if self._running:
            self._running = False
            self.instance.reset()
        given = self._fixed | values | dict(starts or {})
        self.instance.initialise(time, tolerance=self._tolerance, values=given)
        if inputs is not None and len(self._inputs):
            self._inputs.write(self.instance, inputs)
        self.instance.begin()
        self._in_force = values
        self._running = True

    def _changed(self, params: Mapping[str, float]) -> dict[str, float]:
        wanted = {key: params.get(key, value) for key, value in self.params.items()}
        return {key: value for key, value in wanted.items() if value != self._in_force.get(key)}


class FmuModel(FmuBlock):
    """A model-exchange FMU as a continuous system; made by :func:`import_fmu`.

    Parameters
    ----------
    fmu : UnpackedFmu
    name, parameters, start_time, tolerance, events, outputs
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
        )
        self._events: Literal["raise", "ignore"] = events
        self._restart(start_time, self.params)
        self.start_state: FloatArray = self.instance.states()
        self.start_state.flags.writeable = False
        starts = {
            label: float(value)
            for entry in self.description.of("input")
            for label, value in zip(entry.labels, entry.starts, strict=False)
            if not isinstance(value, str)
        }
        self.start_inputs: FloatArray = np.array([starts.get(label, 0.0) for label in self._inputs.labels])
        self._begins, self._latest = start_time, self.start_inputs
        self._start_values = {entry.name for entry in self.description.variables if entry.start}
        self.lock: threading.RLock = threading.RLock()

    @property
    def functions(self) -> BlockFunctions:
        """Equations and events as functions that CasADi calls back; new ones each time, on this one instance."""
        return model_functions(self)

    @property
    def labels(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """The FMU's own names of the inputs and the outputs."""
        return self._inputs.labels, self._outputs.labels

    def rewind(self, t: float | None) -> None:
        """It starts anew where it is used next.

        Parameters
        ----------
        t : float, optional
            Seconds; its own start time by default.
        """
        self._begins = self._start_time if t is None else t
        self.instance.next_event = None
        if self._running:
            self._running = False
            self.instance.reset()

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

    def __deepcopy__(self, memo: dict[int, object]) -> FmuModel:
        return FmuModel(
            self._fmu,
            name=self.name or "fmu",
            parameters=self.values,
            start_time=self._start_time,
            tolerance=self._tolerance,
            events=self._events,
            outputs=self._patterns,
        )

    def _signals(self) -> tuple[Signals, Signals]:
        description = self.description
        inputs = [entry for entry in description.of("input") if entry.variability == "continuous"]
        return Signals(inputs, description.fmi), self._recorded()

    def _place(self, t: float, u: FloatArray, params: Mapping[str, float]) -> None:
        count = self.description.event_indicators
        if count and self._events == "raise":
            raise ValueError(
                f"{self.description.path}: has {count} event indicators; python-control's simulation handles no "
                'events. Use phyfilter_ctl.simulate, which does, or import it with kind="cs" if it has co-simulation, '
                'or with events="ignore" where no event is reached'
            )
        if not self._running or self._changed(params):
            self._restart(self._start_time, params)
        event = self.instance.next_event
        if event is not None and t >= event and self._events == "raise":
            raise FmuError(
                self.instance.name,
                "evaluate",
                "refused",
                f"it has a time event at t = {event:g}, before t = {t:g}, and python-control's simulation handles no "
                'events: use phyfilter_ctl.simulate, which does, or import with events="ignore"',
            )
        self._inputs.write(self.instance, np.asarray(u, dtype=float).reshape(-1))

    def _next(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        self._place(t, u, params)
        return self.instance.derivatives(t, np.asarray(x, dtype=float))

    def _now(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        self._place(t, u, params)
        self.instance.set_point(t, np.asarray(x, dtype=float))
        return self._outputs.read(self.instance)


def ct_names(labels: Sequence[str]) -> list[str]:
    """Signal names that python-control takes: it allows no dots.

    Parameters
    ----------
    labels : sequence of str

    Examples
    --------
    >>> ct_names(["arm.q[0]", "u"])
    ['arm_q[0]', 'u']
    """
    names = [label.replace(".", "_") for label in labels]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(
            f"signal names that differ in a dot only: {twice}; python-control allows no dots in them"
        )
    return names


def _parameters(description: FmuDescription, kind: Kind) -> dict[str, float]:
    """Numeric parameters; in model exchange also the discrete inputs, which stay constant in continuous time."""
    entries = list(description.of("parameter"))
    if kind == "me":
        entries += [entry for entry in description.of("input") if entry.variability != "continuous"]
    return {
        label: float(start)
        for entry in entries
        if entry.type.startswith(_NUMERIC)
        for label, start in zip(entry.labels, entry.starts, strict=True)
    }
