"""Inputs of a running FMU, of which discrete ones wait for Event Mode and clocked ones for a tick."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from .inspect import FmuVariable
from .signals import Callee, Signals

__all__ = ["HeldInputs", "is_continuous"]


def is_continuous(variable: FmuVariable) -> bool:
    """Whether it may change at any time; only numbers of floating point can.

    Parameters
    ----------
    variable : FmuVariable
    """
    return variable.variability in ("continuous", "") and variable.type.startswith("Float")


class HeldInputs(Signals):
    """Inputs as one vector: continuous ones are set at once, the others as soon as FMI allows it.

    Discrete inputs belong to Event Mode, and to the initialisation; those of a clock to the events at its ticks.

    Parameters
    ----------
    variables : sequence of FmuVariable
    fmi : str
        "2.0" or "3.0".

    Attributes
    ----------
    held : bool
        Whether the FMU runs: discrete inputs wait.
    """

    def __init__(self, variables: Sequence[FmuVariable], fmi: str) -> None:
        super().__init__(variables, fmi)
        self.held: bool = False
        kinds = [None if is_continuous(v) and not v.clocks else v.clocks for v in variables]
        places = np.repeat(np.arange(len(variables)), [len(v.labels) for v in variables])
        self._parts: dict[tuple[str, ...] | None, tuple[Signals, NDArray[np.intp]]] = {}
        for kind in dict.fromkeys(kinds):
            mine = [i for i, other in enumerate(kinds) if other == kind]
            signals = Signals([variables[i] for i in mine], fmi)
            self._parts[kind] = signals, np.flatnonzero(np.isin(places, mine))
        self._wanted = np.full(len(self.labels), np.nan)
        self._in_force = self._wanted.copy()
        self._own = self._wanted.copy()

    def adopt(self, vector: FloatArray) -> None:
        """These are what a fresh instance has by itself.

        Parameters
        ----------
        vector : (len(self),) array
        """
        self._own[:] = self._in_force[:] = vector

    def release(self) -> None:
        """The instance is a fresh one again."""
        self.held = False
        self._in_force[:] = self._own

    @property
    def discrete(self) -> NDArray[np.intp]:
        """Places of the discrete inputs that belong to no clock."""
        return self._parts[()][1] if () in self._parts else np.zeros(0, np.intp)

    @property
    def changed(self) -> bool:
        """Whether discrete inputs wait with another value than the FMU has."""
        return self.would_change(self._wanted)

    @property
    def state(self) -> object:
        """What is wanted and what the FMU has, to be put back."""
        return self._wanted.copy(), self._in_force.copy(), self.held

    @state.setter
    def state(self, value: object) -> None:
        assert isinstance(value, tuple)
        self._wanted, self._in_force, self.held = value[0].copy(), value[1].copy(), value[2]

    def would_change(self, vector: FloatArray) -> bool:
        """Whether discrete inputs differ from those that the FMU has.

        Parameters
        ----------
        vector : (len(self),) array
        """
        places = self.discrete
        return not np.array_equal(vector[places], self._in_force[places], equal_nan=True)

    def write(self, instance: Callee, vector: FloatArray | NDArray[np.object_]) -> None:
        """Set the continuous ones, and before the run the discrete ones; keep the others for :meth:`set_discrete`.

        Parameters
        ----------
        instance : FmuInstance
        vector : (len(self),) array

        Raises
        ------
        ValueError
            If a value does not fit the type of its variable: nothing is set then.
        """
        self.check(vector)
        self._wanted[:] = vector
        self._set(instance, None)
        if not self.held:
            self._set(instance, ())

    def set_discrete(self, instance: Callee, ticking: Collection[str]) -> None:
        """In Event Mode: set the discrete inputs that changed, and those of clocks that tick.

        Parameters
        ----------
        instance : FmuInstance
        ticking : collection of str
            Names of clocks.
        """
        if self.changed:
            self._set(instance, ())
        for clocks in self._parts:
            if clocks and not set(clocks).isdisjoint(ticking):
                self._set(instance, clocks)

    def _set(self, instance: Callee, kind: tuple[str, ...] | None) -> None:
        if kind in self._parts:
            signals, places = self._parts[kind]
            values = self._wanted[places]
            if not np.isnan(values).all():  # nobody has wanted anything yet
                signals.write(instance, values)
                self._in_force[places] = values
