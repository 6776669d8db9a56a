"""What a block does, as CasADi functions with named variables: the form that diagrams are flattened from."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from math import inf
from typing import Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from .interpreted import Interpreted

__all__ = ["BlockEvent", "BlockFunctions", "Memory", "Variable", "dependencies"]


@dataclass(frozen=True)
class Variable:
    """A scalar state, input, output or parameter.

    Parameters
    ----------
    name : str
        As the user reads it, e.g. ``plant.v[0]``.
    start : float
        Start value of a state, default of an input or a parameter.
    unit : str
        SI unit such as "m/s" or "rad/s"; "" where none is known.
    description : str
        One line.
    minimum, maximum : float
        Between which it is meant to be; infinite where nobody said.
    nominal : float
        Its usual size, above 0; 0 where nobody said.
    optional : bool
        Of an input: a diagram may leave it open, it is then at ``start``.

    Examples
    --------
    >>> Variable("mass", 1.2, unit="kg").unit
    'kg'
    """

    name: str
    start: float = 0.0
    unit: str = ""
    description: str = ""
    minimum: float = -inf
    maximum: float = inf
    nominal: float = 0.0
    optional: bool = False


class Memory(Protocol):
    """What a block keeps from event to event beside its states, such as the discrete states of an imported FMU."""

    @property
    def next_event(self) -> float:
        """Seconds at which the next event is due; inf where none is."""
        ...

    @property
    def ended(self) -> str:
        """Why the block asked to end the run; "" while it did not."""
        ...

    def restart(self, t: float) -> None:
        """A run begins at t; the event that follows is its start."""
        ...

    def running(self) -> AbstractContextManager[object]:
        """One run at a time has the block."""
        ...


@dataclass(frozen=True, eq=False)
class BlockEvent:
    """An event of a block as CasADi functions.

    Parameters
    ----------
    name : str
    direction : {-1, 0, 1}
        Of the condition at 0: falling, either way, rising.
    condition : casadi.Function
        (t, x, u, p) -> number; several, or none, of an event with a memory.
    reset : casadi.Function, optional
        (t, x, u, p) -> x after the event; None where it stays. With a memory: x, and 1 where the run is to end, else 0.
    memory : Memory, optional
        What the reset changes beside x; the event then happens at its next event too.
    completed : casadi.Function, optional
        (t, x, u, p) -> 1 where the event is to happen after this step of integration, 2 where the run is to end.
    changed : casadi.Function, optional
        (t, x, u, p) -> 1 where inputs jumped, which the event is to take in.
    """

    name: str
    direction: int
    condition: ca.Function
    reset: ca.Function | None
    memory: Memory | None = None
    completed: ca.Function | None = None
    changed: ca.Function | None = None


@dataclass(frozen=True, eq=False)
class BlockFunctions:
    """Equations of one block.

    Parameters
    ----------
    states, inputs, outputs, parameters : tuple of Variable
        Scalar by scalar, in the order of the vectors below; names without the block's own.
    dynamics : casadi.Function
        (t, x, u, p) -> x' of a continuous block, the next x of a sampled one; column vectors.
    output : casadi.Function
        (t, x, u, p) -> y.
    callbacks : tuple of Interpreted
        What in them runs as Python.
    events : tuple of BlockEvent
    keeps_starts : bool
        Whether all inputs that nothing drives stay at their start values, as FMI has it; else the optional ones do.
    constants : tuple of (str, object)
        Parameters that were read and are no numbers, such as a bool or a name: they stay as they were.
    """

    states: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    parameters: tuple[Variable, ...]
    dynamics: ca.Function
    output: ca.Function
    callbacks: tuple[Interpreted, ...] = ()
    events: tuple[BlockEvent, ...] = ()
    keeps_starts: bool = False
    constants: tuple[tuple[str, object], ...] = ()

    @property
    def feedthrough(self) -> NDArray[np.bool_]:
        """Which input acts on which output without delay, (outputs, inputs)."""
        return dependencies(self.output, 2)


def dependencies(function: ca.Function, argument: int) -> NDArray[np.bool_]:
    """Which entry of an argument the first result depends on, from the structure.

    Parameters
    ----------
    function : casadi.Function
    argument : int
        Number of the argument.

    Returns
    -------
    (results, arguments) bool array

    Examples
    --------
    >>> x = ca.SX.sym("x", 2)
    >>> dependencies(ca.Function("f", [x], [ca.vertcat(x[1], 3.0)]), 0).tolist()
    [[False, True], [False, False]]
    """
    pattern = function.jac_sparsity(0, argument)
    result = np.zeros(pattern.shape, dtype=bool)
    rows, columns = pattern.get_triplet()
    result[rows, columns] = True
    return result
