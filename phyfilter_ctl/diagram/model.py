"""A diagram made flat: one continuous model, and the sampled blocks that act on it at their own instants."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..blocks.functions import BlockFunctions, Variable, dependencies
from ..blocks.sampled import FilterLaw

__all__ = ["FlatModel", "Task"]


@dataclass(frozen=True, eq=False)
class Task:
    """A sampled block of a diagram.

    Parameters
    ----------
    name : str
        Path of the block.
    period : float
        Seconds between its instants, the first at the start of a run.
    law : BlockFunctions
        output (t, s, v, q) -> its part of z; dynamics (t, s, v, q) -> next s. s are its states, v its inputs and q its
        parameters. States start at ``law.states[i].start``.
    signals : casadi.Function
        (t, x, u, p, z) -> v.
    held : slice
        Its part of z.
    parameters : slice
        Its part q of p.
    filter : FilterLaw, optional
        What the law is made from where the block is a sampled PhyFilter; C code runs that instead of the law.
    """

    name: str
    period: float
    law: BlockFunctions
    signals: ca.Function
    held: slice
    parameters: slice
    filter: FilterLaw | None = None


@dataclass(frozen=True, eq=False)
class FlatModel:
    """One model of a whole diagram; made by :func:`flatten`.

    Parameters
    ----------
    name : str
    states, inputs, outputs, parameters : tuple of Variable
        Scalars with their full names: states and parameters ``block.name``, inputs and outputs as the diagram's.
    held : tuple of Variable
        z: what the sampled blocks put out, held from one of their instants to the next.
    dynamics : casadi.Function
        (t, x, u, p, z) -> x'; the next x where dt > 0.
    output : casadi.Function
        (t, x, u, p, z) -> y.
    tasks : tuple of Task
        In the order in which they run at a coinciding instant.
    dt : float
        0 for a continuous diagram (with or without sampled blocks); else a discrete one, all of whose blocks share
        this sampling interval in seconds.
    order : tuple of str
        Blocks in evaluation order.

    Notes
    -----
    At an instant all tasks due put out first, in their order, each on inputs that see the outputs before it; then
    all of them advance their states on inputs that see all outputs. Tasks that are not due keep their outputs.
    Instants that are within 1e-9 of the shorter period of each other coincide.
    """

    name: str
    states: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    parameters: tuple[Variable, ...]
    held: tuple[Variable, ...]
    dynamics: ca.Function
    output: ca.Function
    tasks: tuple[Task, ...] = ()
    dt: float = 0.0
    order: tuple[str, ...] = ()

    @property
    def feedthrough(self) -> NDArray[np.bool_]:
        """Which input acts on which output without delay, (outputs, inputs)."""
        return dependencies(self.output, 2)
