"""FMUs as python-control systems: what model exchange and co-simulation share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

import control as ct

from .._sections import FloatArray
from .clock_schedule import ClockTimes
from .inspect import FmuDescription, Kind, Scalar
from .instance import FmuInstance
from .signals import Signals, recorded
from .unpacked import UnpackedFmu
from .values import by_element, numbers_among

__all__ = ["FmuBlock", "ct_names"]

_NUMERIC = ("Float64", "Float32", "Int", "UInt", "Enumeration", "Boolean")


class FmuBlock(ct.NonlinearIOSystem, ABC):
    """An FMU as a python-control system; what model exchange and co-simulation have in common.

    Parameters
    ----------
    fmu : UnpackedFmu
    kind : {"me", "cs", "se"}
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
    clocks : dict of str to float or sequence of float, optional
        Intervals of its clocks, instants of triggered ones.

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
        clocks: ClockTimes | None = None,
    ) -> None:
        self._patterns, self._clocks = outputs, dict(clocks or {})
        self._fmu = fmu
        self._fixed = by_element(fmu.description, parameters)
        self._start_time = start_time
        self._tolerance = tolerance
        self.instance: FmuInstance = FmuInstance(fmu, kind, name, self._clocks)
        self._inputs, self._outputs = self._signals()
        numbers = _parameters(self.description)
        given = numbers_among(fmu.description, self._fixed)
        numbers |= {key: value for key, value in given.items() if key in numbers}
        # Integers of 64 bits have more digits than python-control's parameters.
        self._exact = {key: (value, self._fixed[key]) for key, value in given.items()}
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
        return self._fixed | self._in_full(self.params)

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

    @property
    def clocks(self) -> ClockTimes:
        """Intervals of clocks and instants of triggered ones that it was imported with."""
        return self._clocks

    @property
    def ticks(self) -> tuple[tuple[float, str], ...]:
        """Time in seconds and name of each tick of a clock of the FMU since the run began."""
        return tuple(self.instance.ticks)

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
        given = self._fixed | self._in_full(values) | dict(starts or {})
        self.instance.initialise(time, tolerance=self._tolerance, values=given)
        if inputs is not None and len(self._inputs):
            self._inputs.write(self.instance, inputs)
        self.instance.begin()
        self._in_force = values
        self._running = True

    def _in_full(self, values: Mapping[str, float]) -> dict[str, Scalar]:
        """Parameters with all the digits that they were given."""
        exact = {key: given for key, (number, given) in self._exact.items() if values.get(key) == number}
        return {**values, **exact}

    def _changed(self, params: Mapping[str, float]) -> dict[str, float]:
        wanted = {key: params.get(key, value) for key, value in self.params.items()}
        return {key: value for key, value in wanted.items() if value != self._in_force.get(key)}


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


def _parameters(description: FmuDescription) -> dict[str, float]:
    """Numeric parameters; not those that are declared constant, which FMI forbids, and no FMU lets itself be told."""
    return {
        label: float(start)
        for entry in description.of("parameter")
        if entry.type.startswith(_NUMERIC) and entry.variability != "constant"
        if len(entry.starts) == len(entry.labels)  # not so of arrays with another size than by default
        for label, start in zip(entry.labels, entry.starts, strict=True)
    }
