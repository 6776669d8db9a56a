"""What a flat model consists of; :class:`FlatModel <phyfilter_ctl.diagram.FlatModel>` adds what one does with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..blocks.functions import BlockFunctions, Memory, Variable
from ..blocks.interpreted import Interpreted
from ..blocks.sampled import FilterLaw

__all__ = ["AlgebraicLoop", "Equations", "FlatEvent", "Task", "late"]


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
class AlgebraicLoop:
    """A nonlinear algebraic loop of a diagram.

    Parameters
    ----------
    path : str
        Signals along it, from block to block.
    held : slice
        Its unknowns as they were at the last instant, where the search for them begins: a part of z.
    solutions : (k, n) array
        Those found at the start values; a run starts from the first.
    """

    path: str
    held: slice
    solutions: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FlatEvent:
    """An event of a diagram.

    Parameters
    ----------
    name : str
        ``block.event``.
    direction : {-1, 0, 1}
        Of its condition at 0: falling, either way, rising.
    reset : casadi.Function, optional
        (t, x, u, p, z) -> all x after the event; None where they stay. With a memory then 1 where the run is to end.
    rows : int
        Conditions of its own.
    memory : Memory, optional
        What the event changes beside x.
    completed : casadi.Function, optional
        (t, x, u, p, z) -> 1 where it is to happen after a step of integration, 2 where the run is to end.
    changed : casadi.Function, optional
        (t, x, u, p, z) -> 1 where inputs of its block jumped.
    switch : bool
        Whether it is the jump of a switch in the equations, and none that a block declares.
    """

    name: str
    direction: int
    reset: ca.Function | None
    rows: int = 1
    memory: Memory | None = None
    completed: ca.Function | None = None
    changed: ca.Function | None = None
    switch: bool = False


class _Late:
    """A function of a flat model, or what makes it when it is first asked for."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, model: object | None, owner: type | None = None) -> ca.Function:
        if model is None:
            raise AttributeError(self._name)  # no default
        found = vars(model)[self._name]
        if not isinstance(found, ca.Function):
            found = vars(model)[self._name] = found()
        return found

    def __set__(self, model: object, value: object) -> None:
        vars(model)[self._name] = value


def late(make: Callable[[], ca.Function]) -> ca.Function:
    """A function of a flat model that is made when it is first asked for.

    Parameters
    ----------
    make : callable
        Of a module, since models are pickled.

    Returns
    -------
    casadi.Function
        To be given to the model.
    """
    return cast(ca.Function, make)


@dataclass(frozen=True, eq=False)
class Equations:
    """Fields of a flat model, as :class:`FlatModel <phyfilter_ctl.diagram.FlatModel>` says."""

    name: str
    states: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    parameters: tuple[Variable, ...]
    held: tuple[Variable, ...]
    dynamics: ca.Function = cast(ca.Function, _Late())  # noqa: RUF009
    output: ca.Function = cast(ca.Function, _Late())  # noqa: RUF009
    tasks: tuple[Task, ...] = ()
    loops: tuple[AlgebraicLoop, ...] = ()
    unknowns: ca.Function | None = None
    dt: float = 0.0
    order: tuple[str, ...] = ()
    callbacks: tuple[Interpreted, ...] = ()
    events: tuple[FlatEvent, ...] = ()
    conditions: ca.Function | None = None
    turns: tuple[int, ...] = ()
    matrices: tuple[NDArray[np.float64], ...] | None = None
