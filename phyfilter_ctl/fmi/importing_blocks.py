"""FMUs as python-control systems: what they share, and model exchange."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Literal

import control as ct
import numpy as np

from .._sections import FloatArray
from .inspect import FmuDescription, Kind, Scalar
from .instance import FmuError, FmuInstance
from .signals import Signals
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
    ) -> None:
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
        return self.instance.signals("input"), self.instance.signals("output")

    @abstractmethod
    def _next(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        """Derivatives, or the next state."""

    @abstractmethod
    def _now(self, t: float, x: FloatArray, u: FloatArray, params: Mapping[str, float]) -> FloatArray:
        """Outputs."""

    def _restart(self, time: float, params: Mapping[str, float]) -> None:
        """Initialise anew: the one way to change a fixed parameter."""
        # python-control passes the parameters of all blocks to each of them.
        values = {key: params.get(key, value) for key, value in self.params.items()}
        if self._running:
            self._running = False
            self.instance.reset()
        self.instance.initialise(time, tolerance=self._tolerance, values=self._fixed | values)
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
    name, parameters, start_time, tolerance, events
        As for :func:`import_fmu`.

    Attributes
    ----------
    start_state : (n,) array
        Start values of its states, for ``initial_state`` of python-control's simulations.

    Notes
    -----
    python-control's simulations evaluate x' = f(t, x, u) at times of their choice and know no events. Where the FMU
    announces a time event, evaluation beyond it raises unless ``events="ignore"``.
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
    ) -> None:
        description = fmu.description
        if description.event_indicators and events == "raise":
            raise ValueError(
                f"{description.path}: has {description.event_indicators} event indicators; python-control's simulation "
                'handles no events. Import it with kind="cs" if it has co-simulation, or with events="ignore" where '
                "no event is reached"
            )
        super().__init__(
            fmu,
            "me",
            name=name,
            parameters=parameters or {},
            start_time=start_time,
            tolerance=tolerance,
            dt=0.0,
            states=description.state_labels,
        )
        self._events: Literal["raise", "ignore"] = events
        self._restart(start_time, self.params)
        self.start_state: FloatArray = self.instance.states()
        self.start_state.flags.writeable = False

    def __deepcopy__(self, memo: dict[int, object]) -> FmuModel:
        return FmuModel(
            self._fmu,
            name=self.name or "fmu",
            parameters=self.values,
            start_time=self._start_time,
            tolerance=self._tolerance,
            events=self._events,
        )

    def _signals(self) -> tuple[Signals, Signals]:
        description = self.description
        inputs = [entry for entry in description.of("input") if entry.variability == "continuous"]
        return Signals(inputs, description.fmi), self.instance.signals("output")

    def _place(self, t: float, u: FloatArray, params: Mapping[str, float]) -> None:
        if not self._running or self._changed(params):
            self._restart(self._start_time, params)
        event = self.instance.next_event
        if event is not None and t >= event and self._events == "raise":
            raise FmuError(
                self.instance.name,
                "evaluate",
                "refused",
                f"it has a time event at t = {event:g}, before t = {t:g}, and python-control's simulation handles no "
                'events: import it with kind="cs" and use cosimulate, or import with events="ignore"',
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
