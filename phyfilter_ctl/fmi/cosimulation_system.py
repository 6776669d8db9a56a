"""python-control systems as participants of a co-simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import control as ct
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from .. import _signals
from .._sections import FloatArray
from ..blocks import SampledBlock
from ..blocks.functions import BlockFunctions
from .cosimulation_part import Part, StuckError
from .units import FmuUnit, understood_unit

__all__ = ["SystemPart"]

# A python-control part is to count as exact beside communication errors of 1e-3 ... 1e-6.
_RTOL, _ATOL = 1e-9, 1e-11
_PROBES = 3


class SystemPart(Part):
    """A python-control system; inputs are held over a communication step.

    Parameters
    ----------
    name : str
    system : control.InputOutputSystem
        A linear one is advanced exactly, another continuous one by DOP853 with rtol 1e-9; a discrete one makes the
        updates that fit into the step.
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
        self._x, self._t = np.array(x, dtype=float), 0.0
        self._u = self.start
        self.can_go_back = True
        dt = self._system.dt
        self._discrete = dt is True or bool(dt)
        self.variable_step = True
        self.interval: float | None = float(dt) if dt and dt is not True else None
        self.linear: bool = isinstance(self._system, ct.StateSpace)
        self._transitions: dict[float, FloatArray] = {}
        self.feedthrough: NDArray[np.bool_] = self._probed()

    @property
    def in_python(self) -> str:
        """Linear systems need no Python."""
        return "" if self.linear else super().in_python

    @property
    def moving(self) -> NDArray[np.bool_]:
        """A discrete system holds its inputs."""
        return np.full(len(self.inputs), not self._discrete)

    @property
    def state(self) -> FloatArray:
        """States now; a linear part's array may be written to."""
        return self._x

    @property
    def output_matrix(self) -> FloatArray:
        """[C D] of a linear system, (outputs, states + inputs)."""
        assert isinstance(self._system, ct.StateSpace)
        return np.hstack([self._system.C, self._system.D])

    def transition(self, h: float) -> FloatArray:
        """[A B] of a linear system over a communication step: x(t + h) = A x(t) + B u, u held.

        Parameters
        ----------
        h : float
            Seconds.

        Returns
        -------
        (states, states + inputs) array
        """
        assert isinstance(self._system, ct.StateSpace)
        if h not in self._transitions:
            n, m = len(self._x), len(self.inputs)
            block = np.eye(n + m) if self._discrete else np.zeros((n + m, n + m))
            block[:n] = np.hstack([self._system.A, self._system.B])
            if len(self._transitions) > 64:  # steps of their own each: nothing to gain from remembering
                self._transitions.clear()
            power = np.linalg.matrix_power(block, self._updates(h)) if self._discrete else expm(block * h)
            self._transitions[h] = np.asarray(power, dtype=np.float64)[:n]
        return self._transitions[h]

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
        if self.linear:
            self._x = self.transition(h) @ np.concatenate([self._x, self._u])
        elif self._discrete:
            self._update(t, h)
        elif len(self._x):
            self._x = self._integrated(t, h)
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

    def _updates(self, h: float) -> int:
        return 1 if self.interval is None else round(h / self.interval)

    def _update(self, t: float, h: float) -> None:
        count = self._updates(h)
        period = h / count
        for k in range(count):
            now = t + k * period
            self._x = _vector(self._system.dynamics(now, self._x, self._u, params=self._params or None))

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
