"""What can take part in a co-simulation: FMUs, and python-control systems beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import control as ct
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from .. import _signals
from .._sections import FloatArray
from ..blocks import SampledBlock
from ..blocks.functions import BlockFunctions
from .archive import ArchiveLimits
from .cosimulation_model import ModelPart
from .cosimulation_part import Part, StuckError
from .foreign import Isolation
from .importing import import_fmu
from .importing_model import FmuModel
from .importing_steps import FmuSteps
from .inspect import Scalar
from .instance import FmuError, FmuInstance
from .signals import Signals, recorded
from .units import FmuUnit, understood_unit
from .unpacked import UnpackedFmu
from .values import Opaque, by_element, numbers_among, opaque

__all__ = ["FmuPart", "SystemPart", "make_part"]

# A python-control part is to count as exact beside communication errors of 1e-3 ... 1e-6.
_RTOL, _ATOL = 1e-9, 1e-11
_PROBES = 3


class FmuPart(Part):
    """A co-simulation FMU.

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
    """

    def __init__(
        self,
        name: str,
        fmu: UnpackedFmu,
        *,
        owned: bool,
        values: Mapping[str, Scalar],
        outputs: Sequence[str] | None = None,
    ) -> None:
        self.name = name
        values = by_element(fmu.description, values)
        self._fmu, self._owned, self._values = fmu, owned, values
        self.instance: FmuInstance = FmuInstance(fmu, "cs", name)
        self.input_signals: Signals = self.instance.signals("input")
        self.output_signals: Signals = Signals(recorded(fmu.description, outputs), fmu.description.fmi)
        self.inputs: tuple[str, ...] = self.input_signals.labels
        self.outputs: tuple[str, ...] = self.output_signals.labels
        description = fmu.description
        starts = {
            label: float(value)
            for entry in description.of("input")
            for label, value in zip(
                entry.labels, entry.starts or entry.items[:1] * len(entry.labels), strict=False
            )
            if not isinstance(value, str | bytes)
        }
        # The FMU alone knows how arrays start that have another size than by default.
        resized = [entry for entry in description.of("input") if 1 < len(entry.start) != len(entry.labels)]
        unsaid = {label for entry in resized for label in entry.labels} - values.keys()
        self._unsaid: NDArray[np.bool_] = np.array([label in unsaid for label in self.inputs], bool)
        starts |= numbers_among(description, values)
        self.start: FloatArray = np.array([starts.get(label, 0.0) for label in self.inputs])
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

    def unit(self, label: str) -> tuple[str, FmuUnit | None]:
        """Unit of an input or output, and its meaning: as the FMU defines it, else as its name says."""
        name = self._units[label]
        return name, self._fmu.description.units.get(name) or understood_unit(name)

    def type(self, label: str) -> str:
        """Type of an input or output."""
        return self._variables[label].type

    def slopes(self, columns: NDArray[np.intp]) -> FloatArray | None:
        """By directional derivatives, where the FMU has them and all are numbers of double precision."""
        entries = {
            self._variables[label].name: self._variables[label] for label in self.inputs + self.outputs
        }
        if not self.instance.ability.directional_derivatives or any(
            entry.type != "Float64" for entry in entries.values()
        ):
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

    def initialise(self, start_time: float, stop_time: float) -> None:
        """Enter the initialisation with the parameters and start values."""
        self.instance.initialise(start_time, stop_time=stop_time, values=self._values)
        if self._unsaid.any():
            self.start = np.where(self._unsaid, self.input_signals.read(self.instance), self.start)

    def begin(self) -> None:
        """Leave the initialisation."""
        self.instance.begin()

    def put(self, u: FloatArray) -> None:
        """Set all inputs."""
        try:
            self.input_signals.write(self.instance, u)
        except ValueError as error:
            detail = f"{error}, at t = {self.instance.time:g}"
            raise FmuError(self.name, "set inputs", "refused", detail) from error

    @property
    def in_reach_of_c(self) -> bool:
        """Whether the loop in C can call the instance: in this process, and without items of enumerations to check."""
        checked = any(entry.items for entry in self._fmu.description.of("input"))
        return self.instance.source.isolation is None and not checked

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
        self.instance.do_step(t, h, final=final)

    def save(self) -> object:
        """A state of the FMU."""
        return self.instance.save()

    def restore(self, state: object) -> None:
        """Put a state of the FMU back."""
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


class SystemPart(Part):
    """A python-control system; inputs are held over a communication step.

    Parameters
    ----------
    name : str
    system : control.InputOutputSystem
        A linear continuous one is advanced exactly, another continuous one by DOP853 with rtol 1e-9; a discrete one
        makes the updates that fit into the step.
    params : dict of str to float
    initial_state : (n,) array_like, optional
    """

    def __init__(
        self,
        name: str,
        system: ct.InputOutputSystem,
        *,
        params: Mapping[str, float],
        initial_state: ArrayLike | None = None,
    ) -> None:
        self.name = name
        if isinstance(system, ct.TransferFunction):
            system = ct.tf2ss(system)
        if not isinstance(system, ct.NonlinearIOSystem):
            raise TypeError(f"{name}: expected a system with states and outputs, got {type(system).__name__}")
        leaves = _leaves(system)
        sampled = [block.name for block in leaves if isinstance(block, SampledBlock)]
        if sampled:
            raise TypeError(
                f"{name}: {sampled[0]!r} is a sampled block, which python-control cannot run; export the part with "
                "export_fmu and give the FMU"
            )
        self._system = system
        self.inputs: tuple[str, ...] = tuple(self._system.input_labels)
        self.outputs: tuple[str, ...] = tuple(self._system.output_labels)
        self.start: FloatArray = np.zeros(len(self.inputs))
        n = self._system.nstates or 0
        x = (
            _start(leaves)
            if initial_state is None
            else _signals.real(f"{name}: initial_state", initial_state)
        )
        if x.shape != (n,) or not np.all(np.isfinite(x)):
            raise ValueError(f"{name}: initial_state: expected {n} finite values, got shape {x.shape}")
        known = _parameters(system, leaves)
        unknown = sorted(set(params) - known)
        if unknown:
            raise ValueError(f"{name}: there is no parameter {unknown[0]!r}; there are {sorted(known)}")
        self._params = dict(params)  # None where empty: python-control warns when linear systems get any
        self._x, self._t = x, 0.0
        self._u = self.start
        self.can_go_back = True
        dt = self._system.dt
        self._discrete = dt is True or bool(dt)
        self.variable_step = True
        self.interval: float | None = float(dt) if dt and dt is not True else None
        self._linear = isinstance(self._system, ct.StateSpace)
        self._powers: dict[float, tuple[FloatArray, FloatArray]] = {}
        self.feedthrough: NDArray[np.bool_] = self._probed()

    def unit(self, label: str) -> tuple[str, FmuUnit | None]:
        """Unit of an input or output, where the block gives one, and its meaning."""
        functions = getattr(self._system, "functions", None)
        if isinstance(functions, BlockFunctions):
            units = {entry.name: entry.unit for entry in (*functions.inputs, *functions.outputs)}
        else:
            units = getattr(self._system, "units", {})
        name = str(units.get(label, ""))
        return name, understood_unit(name)

    def type(self, label: str) -> str:
        """Any number."""
        return ""

    def slopes(self, columns: NDArray[np.intp]) -> FloatArray | None:
        """Known of a linear system."""
        return np.asarray(self._system.D)[:, columns] if isinstance(self._system, ct.StateSpace) else None

    def initialise(self, start_time: float, stop_time: float) -> None:
        """Set the clock; the states are there."""
        self._t = start_time

    def begin(self) -> None:
        """Nothing to do: the state is there."""

    def put(self, u: FloatArray) -> None:
        """Hold these inputs from now on."""
        self._u = u.copy()

    def get(self) -> FloatArray:
        """Outputs at the present time, state and inputs."""
        return _vector(self._system.output(self._t, self._x, self._u, params=self._params or None))

    def advance(self, t: float, h: float, *, final: bool) -> None:
        """Over h seconds: exactly where linear, else integrated; a discrete one by the updates that fit."""
        if self._discrete:
            self._update(t, h)
        elif len(self._x):
            self._x = self._exactly(h) if self._linear else self._integrated(t, h)
        self._t = t + h

    def save(self) -> object:
        """Time, state and inputs."""
        return self._t, self._x.copy(), self._u.copy()

    def restore(self, state: object) -> None:
        """Put time, state and inputs back."""
        assert isinstance(state, tuple)
        self._t, self._x, self._u = state[0], state[1].copy(), state[2].copy()

    def forget(self, state: object) -> None:
        """Nothing to free."""

    def messages(self) -> tuple[str, ...]:
        """None."""
        return ()

    def close(self) -> None:
        """Nothing to free."""

    def _update(self, t: float, h: float) -> None:
        count = 1 if self.interval is None else round(h / self.interval)
        period = h / count
        for k in range(count):
            now = t + k * period
            self._x = _vector(self._system.dynamics(now, self._x, self._u, params=self._params or None))

    def _exactly(self, h: float) -> FloatArray:
        assert isinstance(self._system, ct.StateSpace)
        if h not in self._powers:
            n, m = len(self._x), len(self.inputs)
            block = np.zeros((n + m, n + m))
            block[:n] = np.hstack([self._system.A, self._system.B])
            power = np.asarray(expm(block * h), dtype=np.float64)
            if len(self._powers) > 64:  # steps of their own each: nothing to gain from remembering
                self._powers.clear()
            self._powers[h] = power[:n, :n], power[:n, n:]
        A, B = self._powers[h]
        return A @ self._x + B @ self._u

    def _integrated(self, t: float, h: float) -> FloatArray:
        def rate(now: float, x: FloatArray) -> FloatArray:
            return _vector(self._system.dynamics(now, x, self._u, params=self._params or None))

        solution = solve_ivp(
            rate, (t, t + h), self._x, method="DOP853", rtol=_RTOL, atol=_ATOL, t_eval=[t + h]
        )
        if not solution.success:
            raise StuckError(f"{self.name}: no solution from t = {t:g} to {t + h:g}: {solution.message}")
        return solution.y[:, -1]

    def _probed(self) -> NDArray[np.bool_]:
        """Feedthrough: known of a linear system, else from outputs at random points."""
        if isinstance(self._system, ct.StateSpace):
            return np.asarray(self._system.D) != 0.0
        found = np.zeros((len(self.outputs), len(self.inputs)), dtype=bool)
        rng = np.random.default_rng(0)
        before = self._x, self._u
        for _ in range(_PROBES):
            self._x = before[0] + rng.standard_normal(len(before[0]))
            u = rng.standard_normal(len(self.inputs))
            self._u = u
            base = self.get()
            for j in range(len(u)):
                self._u = u + np.eye(len(u))[j]
                found[:, j] |= self.get() != base
        self._x, self._u = before
        return found


def _leaves(system: ct.InputOutputSystem) -> list[ct.InputOutputSystem]:
    """Blocks of a diagram, inner diagrams opened, in the order of the states."""
    if isinstance(system, ct.InterconnectedSystem):
        return [leaf for block in system.syslist for leaf in _leaves(block)]
    return [system]


def _start(leaves: Sequence[ct.InputOutputSystem]) -> FloatArray:
    """Start values that blocks know of, else zero."""
    parts = [getattr(block, "start_state", np.zeros(block.nstates or 0)) for block in leaves]
    return np.concatenate([np.zeros(0), *parts])


def _parameters(system: ct.NonlinearIOSystem, leaves: Sequence[ct.InputOutputSystem]) -> set[str]:
    known = set(system.params)
    for block in leaves:
        known |= set(getattr(block, "params", {}))
        functions = getattr(block, "functions", None)
        if isinstance(functions, BlockFunctions):
            names = {entry.name for entry in functions.parameters}
            names |= {name.partition("[")[0] for name in names}
            known |= names | {f"{block.name}.{name}" for name in names}
    return known


def _vector(value: ArrayLike) -> FloatArray:
    return np.asarray(value, dtype=float).reshape(-1)


def make_part(
    name: str,
    thing: str | Path | ct.InputOutputSystem,
    values: Mapping[str, Scalar],
    *,
    initial_state: ArrayLike | None = None,
    limits: ArchiveLimits | None = None,
    isolated: bool | Isolation = False,
) -> Part:
    """A participant from what the user gave.

    Parameters
    ----------
    name : str
    thing : str, Path or control.InputOutputSystem
        FMU file, imported FMU, or python-control system.
    values : dict
        Its parameters and start values.
    initial_state : array_like, optional
        Of a python-control system.
    limits : ArchiveLimits, optional
    isolated : bool or Isolation
        Of an FMU file: whether it runs in a process of its own.

    Raises
    ------
    TypeError
        If it is none of these.
    """
    owned = isinstance(thing, str | Path)
    if isinstance(thing, str | Path):
        fmu = UnpackedFmu(thing, limits=limits, isolated=isolated, structure=values)
        if "cs" in fmu.description.kinds:
            rest = {key: value for key, value in values.items() if key not in fmu.structure}
            return _fmu_part(name, fmu, True, rest)
        fmu.close()
        thing = import_fmu(thing, kind="me", name=name, parameters=values, limits=limits, isolated=isolated)
        values = {}
    if isinstance(thing, FmuSteps):
        return _fmu_part(name, thing.source, False, thing.values | dict(values), thing.patterns)
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
) -> FmuPart:
    try:
        return FmuPart(name, fmu, owned=owned, values=values, outputs=outputs)
    except BaseException:
        if owned:
            fmu.close()
        raise
