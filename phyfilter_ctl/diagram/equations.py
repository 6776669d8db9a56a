"""What a flat model consists of; :class:`FlatModel <phyfilter_ctl.diagram.FlatModel>` adds what one does with it."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from ..blocks.functions import BlockFunctions, Variable
from ..blocks.sampled import FilterLaw

__all__ = ["Equations", "Task"]


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
    continuous : BlockFunctions, optional
        Its continuous equivalent, for :meth:`FlatModel.linearize`; parameters of the law's names are the law's.
    """

    name: str
    period: float
    law: BlockFunctions
    signals: ca.Function
    held: slice
    parameters: slice
    filter: FilterLaw | None = None
    continuous: BlockFunctions | None = None


@dataclass(frozen=True, eq=False)
class Equations:
    """Fields of a flat model, as :class:`FlatModel <phyfilter_ctl.diagram.FlatModel>` says."""

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
