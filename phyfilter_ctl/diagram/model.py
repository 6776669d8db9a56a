"""A diagram made flat: one continuous model, and the sampled blocks that act on it at their own instants."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass

import control as ct
import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _signals
from ..blocks.functions import Memory, Variable, dependencies
from .equations import Equations, Task
from .linearisation import is_linear, linear_model
from .naming import override, table, without_constants

__all__ = ["FlatModel", "Task"]


@dataclass(frozen=True, eq=False)
class FlatModel(Equations):
    """One model of a whole diagram; made by :func:`flatten`.

    Parameters
    ----------
    name : str
    states, inputs, outputs, parameters : tuple of Variable
        Scalars with their full names: states and parameters ``block.name``, inputs and outputs as the diagram's.
    held : tuple of Variable
        z: what the sampled blocks put out, held from one of their instants to the next; then the unknowns of nonlinear
        algebraic loops as they were at the last instant, where the search for them begins.
    dynamics : casadi.Function
        (t, x, u, p, z) -> x'; the next x where dt > 0.
    output : casadi.Function
        (t, x, u, p, z) -> y.
    tasks : tuple of Task
        In the order in which they run at a coinciding instant.
    loops : tuple of AlgebraicLoop
        Nonlinear ones; those affine in their signals are solved in the equations.
    unknowns : casadi.Function, optional
        (t, x, u, p, z) -> the unknowns of the loops, which are the last entries of z; None without loops.
    dt : float
        0 for a continuous diagram (with or without sampled blocks); else a discrete one, all of whose blocks share
        this sampling interval in seconds.
    order : tuple of str
        Blocks in evaluation order.
    callbacks : tuple of Interpreted
        Functions of blocks that run as Python, since they cannot be traced; a model with some has no C code.
    events : tuple of FlatEvent
    conditions : casadi.Function, optional
        (t, x, u, p, z) -> the conditions of the events; None where there are none.
    turns : tuple of int
        Which tasks put out at a coinciding instant, one after the other, where one of them has to more than once, since
        some of its outputs wait for a task that waits for others of it. Empty: each once, in their order; models with C
        code have no other.
    undriven : tuple of str
        Inputs of blocks that nothing drives, ``block.input``: they are 0 (``flatten(..., unconnected="zero")``).
    matrices : tuple of arrays, optional
        A, B, C, D of what is a continuous linear system as a whole.
    constants : tuple of (str, object)
        Parameters of blocks that are no numbers, ``block.name``, as they were when the model was made.

    Notes
    -----
    At an instant all tasks due put out first, in their order, each on inputs that see the outputs before it; then
    all of them advance their states on inputs that see all outputs. Tasks that are not due keep their outputs.
    Instants that are within 1e-9 of the shorter period of each other coincide.

    Where no solution of a nonlinear algebraic loop is found, all that depends on it is not-a-number.
    """

    undriven: tuple[str, ...] = ()
    constants: tuple[tuple[str, object], ...] = ()

    def _repr_svg_(self) -> str:
        """What notebooks show: its inputs and outputs."""
        import phyfilter_ctl as pf  # the room that draws is a later one

        return pf.draw(self).svg

    @property
    def feedthrough(self) -> NDArray[np.bool_]:
        """Which input acts on which output without delay, (outputs, inputs)."""
        return dependencies(self.output, 2)

    @property
    def memories(self) -> tuple[Memory, ...]:
        """Of blocks that keep something from event to event beside their states, such as imported FMUs."""
        return tuple(event.memory for event in self.events if event.memory is not None)

    @property
    def exclusive(self) -> tuple[Callable[[], AbstractContextManager[object]], ...]:
        """What a run enters before it begins: blocks that keep something from call to call are had by one at a time."""
        callbacks = [callback.running for callback in self.callbacks if callback.running is not None]
        return tuple(dict.fromkeys([*(memory.running for memory in self.memories), *callbacks]))

    @property
    def is_linear(self) -> bool:
        """Whether dynamics and outputs are linear in states, inputs and held outputs; the sampled laws aside."""
        return is_linear(self)

    def start_state(self) -> NDArray[np.float64]:
        """Starts of the states, (states,)."""
        return _starts(self.states)

    def start_inputs(self) -> NDArray[np.float64]:
        """Defaults of the inputs, (inputs,)."""
        return _starts(self.inputs)

    def start_parameters(self, overrides: Mapping[str, ArrayLike] | None = None) -> NDArray[np.float64]:
        """Parameter vector p.

        Parameters
        ----------
        overrides : mapping, optional
            Values by name: ``block.k``, or ``k`` where only one block has it; an array for all entries of
            ``block.k[0]``, ``block.k[1]`` ...

        Returns
        -------
        (parameters,) array

        Raises
        ------
        ValueError
            For names that are unknown or stand for several parameters, values of the wrong shape, and what is no number
            and was another thing when the model was made.

        Examples
        --------
        >>> import control as ct
        >>> from phyfilter_ctl.diagram import flatten
        >>> plant = ct.nlsys(lambda t, x, u, p: p["k"] * (u - x), None, inputs=1, outputs=1, states=1,
        ...                  params={"k": 2.0}, name="plant")
        >>> flatten(plant * 3.0).start_parameters({"k": 5.0})
        array([5.])
        """
        return override(self.parameters, without_constants(self.constants, overrides or {}))

    def linearize(
        self,
        x0: ArrayLike | None = None,
        u0: ArrayLike | None = None,
        params: Mapping[str, ArrayLike] | None = None,
        t: float = 0.0,
    ) -> ct.StateSpace:
        """Linear model around a point, by exact derivatives.

        Parameters
        ----------
        x0 : (states,) array, optional
            States; None means the start. Those of the continuous equivalents of sampled blocks may follow.
        u0 : (inputs,) array, optional
            Inputs; None means their defaults.
        params : mapping, optional
            As for :meth:`start_parameters`.
        t : float
            Time in seconds.

        Returns
        -------
        control.StateSpace
            With the model's names, "_" for ".". Sampled blocks are replaced by their continuous equivalents, whose
            states follow the model's.

        Raises
        ------
        ValueError
            For wrong shapes, unknown parameters, or a sampled block without a continuous equivalent.

        Examples
        --------
        >>> import control as ct
        >>> from phyfilter_ctl.diagram import flatten
        >>> plant = ct.nlsys(lambda t, x, u, p: [u[0] - x[0] ** 2], None, inputs=1, outputs=1, states=1, name="plant")
        >>> flatten(plant).linearize([3.0]).A.tolist()
        [[-6.0]]
        """
        extra = sum(len(task.continuous.states) for task in self.tasks if task.continuous is not None)
        n = len(self.states)
        x = self.start_state() if x0 is None else _vector("x0", x0, {n, n + extra})
        u = self.start_inputs() if u0 is None else _vector("u0", u0, {len(self.inputs)})
        return linear_model(self, x, u, self.start_parameters(params), float(t))

    def describe(self) -> str:
        """Table of all that the model consists of, as text."""
        return table(self)


def _starts(variables: tuple[Variable, ...]) -> NDArray[np.float64]:
    return np.array([variable.start for variable in variables], dtype=float)


def _vector(name: str, value: ArrayLike, sizes: set[int]) -> NDArray[np.float64]:
    vector = np.atleast_1d(_signals.real(name, value))
    _signals.refuse_unusable(name, vector)
    if vector.ndim != 1 or len(vector) not in sizes:
        expected = " or ".join(f"({size},)" for size in sorted(sizes))
        raise ValueError(f"{name}: expected shape {expected}, got {vector.shape}")
    return vector
