"""What can take part in a co-simulation: FMUs, and python-control systems beside them."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import control as ct
import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._sections import FloatArray
from .clock_schedule import ClockTimes
from .cosimulation_model import ModelPart
from .cosimulation_part import Part
from .cosimulation_system import SystemPart
from .fmu import Fmu
from .importing import import_fmu
from .importing_blocks import input_starts
from .importing_model import FmuModel
from .importing_steps import FmuSteps
from .inspect import Kind, Scalar
from .instance import FmuError, FmuInstance
from .signals import Signals, recorded
from .units import FmuUnit, understood_unit
from .unpacked import UnpackedFmu
from .values import Opaque, by_element, opaque

__all__ = ["FmuPart", "SystemPart", "make_part"]

_REAL = ("Float64", "Float32")


class Slopes(NamedTuple):
    """Inputs that an FMU of FMI 2.0 takes slopes of: their places, and the arguments of the call."""

    places: NDArray[np.intp]
    references: ctypes.Array[ctypes.c_uint]
    orders: ctypes.Array[ctypes.c_int]
    values: ctypes.Array[ctypes.c_double]


class FmuPart(Part):
    """A co-simulation FMU, or one of scheduled execution.

    Parameters
    ----------
    name : str
    fmu : UnpackedFmu
    owned : bool
        Whether to remove its files at the end.
    values : dict
        Parameters and start values.
    outputs : sequence of str, optional
        Names or patterns of what it puts out; None for the FMU's outputs.
    clocks : dict of str to float or sequence of float, optional
        Intervals of its clocks, instants of triggered ones.
    kind : {"cs", "se"}
    intermediate : bool
        Whether it is to tell of its outputs inside steps, where it does that.
    tolerance : float, optional
        Of its own solver; None: that of its default experiment.
    """

    def __init__(
        self,
        name: str,
        fmu: UnpackedFmu,
        *,
        owned: bool,
        values: Mapping[str, Scalar],
        outputs: Sequence[str] | None = None,
        clocks: ClockTimes | None = None,
        kind: Kind = "cs",
        intermediate: bool = False,
        tolerance: float | None = None,
    ) -> None:
        self.name = name
        self._tolerance = fmu.description.tolerance if tolerance is None else tolerance
        values = by_element(fmu.description, values)
        self._fmu, self._owned, self._values = fmu, owned, values
        entries = recorded(fmu.description, outputs)
        tells = intermediate and kind == "cs" and fmu.description.kinds["cs"].intermediate_update
        watched = [entry for entry in entries if tells and entry.type == "Float64" and not entry.clocks]
        self.instance: FmuInstance = FmuInstance(fmu, kind, name, clocks, watched)
        self.input_signals: Signals = self.instance.signals("input")
        self.output_signals: Signals = Signals(entries, fmu.description.fmi)
        self.inputs: tuple[str, ...] = self.input_signals.labels
        self.outputs: tuple[str, ...] = self.output_signals.labels
        description = fmu.description
        self.start: FloatArray = input_starts(description, self.inputs, values)
        self._unsaid: NDArray[np.bool_] = np.isnan(self.start)
        self.feedthrough: NDArray[np.bool_] = description.feedthrough(self.inputs, self.outputs)
        self.can_go_back: bool = self.instance.ability.state
        self.variable_step: bool = self.instance.ability.variable_step
        self.interval: float | None = self.instance.ability.fixed_step
        self._variables = {
            label: entry
            for entry in description.variables
            if entry.causality in ("input", "output")
            for label in entry.labels
        }
        self._texts_in = opaque(description.of("input"))
        self._texts_out = opaque(recorded(description, outputs, numeric=False))
        self.text_inputs: Mapping[str, str] = {label: entry.type for label, entry in self._texts_in.items()}
        self.text_outputs: Mapping[str, str] = {label: entry.type for label, entry in self._texts_out.items()}
        self._units = dict(
            zip(self.inputs + self.outputs, self.input_signals.units + self.output_signals.units, strict=True)
        )
        self.slope_signals: Slopes | None = self._slope_signals()
        self._over = False  # it has ended the run, and takes no more inputs

    def _slope_signals(self) -> Slopes | None:
        places = np.flatnonzero(self.moving)
        if not (len(places) and self.instance.ability.interpolates and self._fmu.description.fmi == "2.0"):
            return None
        count = len(places)
        references = (ctypes.c_uint * count)(*(self._variables[self.inputs[j]].reference for j in places))
        return Slopes(places, references, (ctypes.c_int * count)(*[1] * count), (ctypes.c_double * count)())

    @property
    def interpolates(self) -> bool:
        """An FMU of FMI 2.0 may take slopes."""
        return self.slope_signals is not None

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Inputs that are continuous."""
        entries = [self._variables[label] for label in self.inputs]
        return np.array([e.type in _REAL and e.variability in ("", "continuous") for e in entries], bool)

    def unit(self, label: str) -> tuple[str, FmuUnit | None]:
        """Unit of an input or output, and its meaning: as the FMU defines it, else as its name says."""
        name = self._units[label]
        return name, self._fmu.description.units.get(name) or understood_unit(name)

    def type(self, label: str) -> str:
        """Type of an input or output."""
        return self._variables[label].type

    def slopes(self, columns: NDArray[np.intp]) -> FloatArray | None:
        """By directional or adjoint derivatives, where the FMU has them and all are numbers of double precision.

        Of both the kind that takes fewer calls: one for each column, or one for each output.
        """
        entries = {
            self._variables[label].name: self._variables[label] for label in self.inputs + self.outputs
        }
        ability = self.instance.ability
        if any(entry.type != "Float64" for entry in entries.values()):
            return None
        fewer = len(self.outputs) < len(columns)
        if ability.adjoint_derivatives and (fewer or not ability.directional_derivatives):
            return self._adjoint_slopes(columns)
        if not ability.directional_derivatives:
            return None
        owners = [self._variables[self.inputs[j]] for j in columns]
        seeds = [
            np.array([label == self.inputs[j] for label in entry.labels], float)
            for j, entry in zip(columns, owners, strict=True)
        ]
        unknowns = self.output_signals.references
        return np.column_stack(
            [
                self.instance.directional(unknowns, [entry.reference], seed, len(self.outputs))
                for entry, seed in zip(owners, seeds, strict=True)
            ]
        )

    def _adjoint_slopes(self, columns: NDArray[np.intp]) -> FloatArray:
        knowns = {self._variables[self.inputs[j]].name: self._variables[self.inputs[j]] for j in columns}
        places = {label: k for k, label in enumerate(label for e in knowns.values() for label in e.labels)}
        references = [entry.reference for entry in knowns.values()]
        unknowns = self.output_signals.references
        rows = [
            self.instance.adjoint(unknowns, references, seed, len(places))
            for seed in np.eye(len(self.outputs))
        ]
        return np.array(rows).reshape(-1, len(places))[:, [places[self.inputs[j]] for j in columns]]

    def initialise(self, start_time: float, stop_time: float) -> None:
        """Enter the initialisation with the parameters and start values."""
        self._over = False
        self.instance.initialise(
            start_time,
            stop_time=stop_time,
            tolerance=self._tolerance,
            values=self._values,
        )
        if self._unsaid.any():
            self.start = np.where(self._unsaid, self.input_signals.read(self.instance), self.start)

    def begin(self) -> None:
        """Leave the initialisation."""
        self.instance.begin()

    def put(self, u: FloatArray) -> None:
        """Set all inputs."""
        if self._over:
            return
        try:
            self.input_signals.write(self.instance, u)
        except ValueError as error:
            detail = f"{error}, at t = {self.instance.time:g}"
            raise FmuError(self.name, "set inputs", "refused", detail) from error

    def incline(self, slopes: FloatArray) -> None:
        """By fmi2SetRealInputDerivatives."""
        assert self.slope_signals is not None
        places, references, orders, values = self.slope_signals
        values[:] = slopes[places].tolist()
        self.instance.call_raw("fmi2SetRealInputDerivatives", references, len(places), orders, values)

    @property
    def in_python(self) -> str:
        """The loop in C cannot call another process, and looks at no items of enumerations."""
        if self.instance.source.isolation is not None:
            return "in a process of its own"
        if self.has_events:
            return "with events"
        if self.instance.watched:
            return "with values inside steps"
        return "with enumerations" * any(entry.items for entry in self._fmu.description.of("input"))

    def get_text(self, label: str) -> Opaque:
        """Read a String or Binary output."""
        entry = self._texts_out[label]
        return self.instance.get_opaque(entry)[entry.labels.index(label)]

    def put_text(self, label: str, value: Opaque) -> None:
        """Set a String or Binary input."""
        entry = self._texts_in[label]
        values = list(self.instance.get_opaque(entry)) if entry.shape else [value]
        values[entry.labels.index(label)] = value
        self.instance.set_opaque(entry, values)

    def get(self) -> FloatArray:
        """Read all outputs."""
        return self.output_signals.read(self.instance)

    def advance(self, t: float, h: float, *, final: bool) -> None:
        """One step of the FMU."""
        try:
            self.instance.do_step(t, h, final=final)
        except FmuError as error:
            self._over = error.ends_at(t + h, h)
            raise

    @property
    def has_events(self) -> bool:
        """Clocks, or discrete inputs that wait for its Event Mode."""
        return self.instance.event_mode or self.instance.kind == "se"

    def happen(self, t: float) -> bool:
        """Clocks that tick at t, and discrete inputs that changed."""
        self.instance.time = t
        return not self._over and self.instance.happen()

    @property
    def clocks(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Names of triggered input clocks, and of output clocks."""
        return self.instance.schedule.ends

    def trigger(self, clock: str, t: float) -> None:
        """A triggered input clock is to tick at t, when events happen."""
        self.instance.schedule.trigger(clock, t)

    @property
    def ticks(self) -> Sequence[tuple[float, str]]:
        """Time in seconds and name of each tick of a clock."""
        return self.instance.ticks

    @property
    def intermediate(self) -> tuple[tuple[str, ...], Sequence[Sequence[float]]]:
        """Outputs that it told of inside steps, and each time t and their values."""
        return tuple(label for entry in self.instance.watched for label in entry.labels), self.instance.told

    def save(self) -> object:
        """A state of the FMU."""
        return self.instance.save()

    def restore(self, state: object) -> None:
        """Put a state of the FMU back."""
        self._over = False
        self.instance.restore(state)

    def forget(self, state: object) -> None:
        """Free a state of the FMU."""
        self.instance.forget(state)

    def messages(self) -> tuple[str, ...]:
        """What the FMU logged so far."""
        return self.instance.messages

    def close(self) -> None:
        """Free the instance, and remove the files where they are its own."""
        self.instance.close()
        if self._owned:
            self._fmu.close()


def make_part(
    name: str,
    thing: str | Path | Fmu | ct.InputOutputSystem,
    values: Mapping[str, Scalar],
    *,
    initial_state: ArrayLike | None = None,
    intermediate: bool = False,
) -> Part:
    """A participant from what the user gave.

    Parameters
    ----------
    name : str
    thing : str, Path, Fmu or control.InputOutputSystem
        FMU file, with its choices or without, imported FMU, or python-control system.
    values : dict
        Its parameters and start values.
    initial_state : array_like, optional
        Of a python-control system.
    intermediate : bool
        Whether an FMU is to tell of its outputs inside steps.

    Raises
    ------
    TypeError
        If it is none of these.
    """
    owned = isinstance(thing, str | Path | Fmu)
    if isinstance(thing, str | Path | Fmu):
        fmu = Fmu.of(thing).told(values)
        unpacked = UnpackedFmu(fmu)
        kinds = unpacked.description.kinds
        kind: Kind = "me" if "me" in kinds else "se"
        if "cs" in kinds or not kinds:
            kind = "cs"
        if kind != "me":
            return _fmu_part(
                name,
                unpacked,
                True,
                unpacked.values,
                fmu.outputs,
                fmu.clocks,
                kind,
                intermediate,
                fmu.tolerance,
            )
        unpacked.close()
        thing = import_fmu(fmu, kind="me", name=name)
        values = {}
    if isinstance(thing, FmuSteps):
        return _fmu_part(
            name,
            thing.source,
            False,
            thing.values | dict(values),
            thing.patterns,
            thing.clocks,
            thing.instance.kind,
            intermediate,
        )
    if isinstance(thing, FmuModel) and thing.has_events and not values:
        return ModelPart(name, thing, owned=owned)
    if isinstance(thing, ct.InputOutputSystem):
        numbers = {key: float(value) for key, value in values.items()}
        return SystemPart(name, thing, params=numbers, initial_state=initial_state)
    raise TypeError(
        f"{name}: expected an FMU file, an imported FMU or a python-control system, got {type(thing)}"
    )


def _fmu_part(
    name: str,
    fmu: UnpackedFmu,
    owned: bool,
    values: Mapping[str, Scalar],
    outputs: Sequence[str] | None = None,
    clocks: ClockTimes | None = None,
    kind: Kind = "cs",
    intermediate: bool = False,
    tolerance: float | None = None,
) -> FmuPart:
    try:
        return FmuPart(
            name,
            fmu,
            owned=owned,
            values=values,
            outputs=outputs,
            clocks=clocks,
            kind=kind,
            intermediate=intermediate,
            tolerance=tolerance,
        )
    except BaseException:
        if owned:
            fmu.close()
        raise
