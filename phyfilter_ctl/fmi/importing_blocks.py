"""FMUs as python-control systems: what model exchange and co-simulation share."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import cast

import casadi as ca
import control as ct
import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from ..blocks.functions import Variable
from ..blocks.interpreted import Interpreted
from .clock_schedule import ClockTimes
from .inspect import FmuDescription, Kind, Scalar
from .instance import FmuInstance
from .signals import Signals, recorded
from .unpacked import UnpackedFmu
from .values import by_element, numbers_among

__all__ = ["FmuBlock", "ct_names", "input_starts"]

_NUMERIC = ("Float64", "Float32", "Int", "UInt", "Enumeration", "Boolean")
_REMEDY = (
    "Its binary cannot be merged into other code: hand over the rest as an FMU of its own and both as a package "
    "(cut_diagram, write_ssp), or run the diagram with simulate"
)


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
    lock : threading.RLock
        Held by the run that has the instance.

    Notes
    -----
    Made by :func:`import_fmu`. A copy (python-control makes one where a system is used twice) is an instance of its
    own. The instance is freed and its files removed with the block, or by :meth:`close`.
    """

    start_state: FloatArray
    """Start values of its states, for ``initial_state`` of python-control's simulations; (n,)."""

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
        self._running = self._used = False
        self.lock: threading.RLock = threading.RLock()

    @property
    def labels(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """The FMU's own names of the inputs and the outputs."""
        return self._inputs.labels, self._outputs.labels

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
        if self._used:  # a new run: after Reset some FMUs start elsewhere than a fresh instance does
            self._used = self._running = False
            held, name, kind = self.instance.inputs, self.instance.name, self.instance.kind
            self.instance.close()
            self.instance = FmuInstance(self._fmu, kind, name, self._clocks)
            self.instance.inputs = held  # the block writes to this one
            if held is not None:
                held.release()
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

    def _let_go(self) -> None:
        """It starts anew where it is used next."""
        self._used = self._used or self._running
        self._running = False

    def callback(
        self,
        which: str,
        evaluate: Callable[[float, FloatArray, FloatArray, Mapping[str, float]], FloatArray],
        size: int,
        depends: NDArray[np.bool_] | None = None,
        running: Callable[[], AbstractContextManager[object]] | None = None,
    ) -> ca.Function:
        """A function (t, x, u, p) of the block that CasADi calls back.

        Parameters
        ----------
        which : str
            Name of the function.
        evaluate : callable
            (t, x, u, params) -> ``size`` numbers.
        size : int
        depends, running
            As for ``Interpreted``.

        Returns
        -------
        casadi.Function
        """
        keys = list(self.params)
        sizes = (self.nstates or 0, len(self._inputs), len(keys))
        if not size:
            symbols = [ca.SX.sym(letter, count) for letter, count in zip("txup", (1, *sizes), strict=True)]
            return ca.Function(which, symbols, [ca.SX(0, 1)])
        function = Interpreted(
            which,
            lambda t, x, u, p: evaluate(t, x, u, dict(zip(keys, p.tolist(), strict=True))),
            (*sizes, size),
            self.name or "fmu",
            f"it is the imported FMU {self.description.path}",
            depends,
            remedy=_REMEDY,
            running=running,
        )
        return cast(ca.Function, function)

    def variables(self, labels: Sequence[str], starts: Sequence[float]) -> tuple[Variable, ...]:
        """States, inputs, outputs or parameters as a diagram has them.

        Parameters
        ----------
        labels : sequence of str
        starts : sequence of float
        """
        return tuple(
            Variable(label, float(start), self.units.get(label, ""))
            for label, start in zip(labels, starts, strict=True)
        )

    def _in_full(self, values: Mapping[str, float]) -> dict[str, Scalar]:
        """Parameters with all the digits that they were given."""
        exact = {key: given for key, (number, given) in self._exact.items() if values.get(key) == number}
        return {**values, **exact}

    def _changed(self, params: Mapping[str, float]) -> dict[str, float]:
        wanted = {key: params.get(key, value) for key, value in self.params.items()}
        return {key: value for key, value in wanted.items() if value != self._in_force.get(key)}


def input_starts(
    description: FmuDescription, labels: Sequence[str], given: Mapping[str, Scalar]
) -> FloatArray:
    """Start values of inputs: as given, else as the description says, else not-a-number: then the FMU alone knows.

    Parameters
    ----------
    description : FmuDescription
    labels : sequence of str
    given : dict
        By element.

    Returns
    -------
    (len(labels),) array
    """
    starts = {
        label: float(value)
        for entry in description.of("input")
        if not 1 < len(entry.start) != len(entry.labels)  # an array of another size than by default
        for label, value in zip(
            entry.labels, entry.starts or entry.items[:1] * len(entry.labels), strict=False
        )
        if not isinstance(value, str | bytes)
    }
    starts |= numbers_among(description, given)
    return np.array([starts.get(label, np.nan) for label in labels])


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
