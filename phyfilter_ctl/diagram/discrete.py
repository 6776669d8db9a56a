"""A purely discrete model as a sampled block: of one task, or of another diagram."""

from __future__ import annotations

import dataclasses
from typing import cast

import casadi as ca

from ..blocks.functions import BlockFunctions
from .model import FlatModel, Task

__all__ = ["as_sampled", "law_of"]


def as_sampled(flat: FlatModel) -> FlatModel:
    """A purely discrete model as one task of a model without continuous states.

    Parameters
    ----------
    flat : FlatModel

    Returns
    -------
    FlatModel
        With dt = 0, one task of period ``flat.dt`` and the task's held outputs as outputs; a continuous model is
        returned as it is.

    Examples
    --------
    >>> import control as ct
    >>> from phyfilter_ctl.diagram import flatten
    >>> flat = as_sampled(flatten(ct.tf([1.0], [1.0, -0.5], 0.1, name="lag")))
    >>> flat.dt, len(flat.states), flat.tasks[0].period, [s.name for s in flat.tasks[0].law.states]
    (0.0, 0, 0.1, ['x[0]'])
    """
    if flat.dt == 0.0:
        return flat
    law = law_of(flat)
    t, x = ca.SX.sym("t"), ca.SX(0, 1)
    u, p = ca.SX.sym("u", len(flat.inputs)), ca.SX.sym("p", len(flat.parameters))
    z = ca.SX.sym("z", len(flat.outputs))
    arguments = [t, x, u, p, z]
    task = Task(
        name=flat.name,
        period=flat.dt,
        law=law,
        signals=ca.Function("signals", arguments, [u]),
        held=slice(0, len(flat.outputs)),
        parameters=slice(0, len(flat.parameters)),
    )
    return dataclasses.replace(
        flat,
        states=(),
        held=flat.outputs,
        dynamics=ca.Function("dynamics", arguments, [ca.SX(0, 1)]),
        output=ca.Function("output", arguments, [z]),
        tasks=(task,),
        loops=(),
        unknowns=None,
        dt=0.0,
    )


def law_of(flat: FlatModel) -> BlockFunctions:
    """A purely discrete model as the law of one sampled block; its algebraic loops' unknowns become states.

    Parameters
    ----------
    flat : FlatModel
        With ``dt`` > 0.

    Returns
    -------
    BlockFunctions

    Examples
    --------
    >>> import control as ct
    >>> from phyfilter_ctl.diagram import flatten
    >>> law_of(flatten(ct.tf([1.0], [1.0, -0.5], 0.1))).dynamics(0, 2.0, 1.0, []).full().item()
    2.0
    """
    kind = (
        ca.SX
        if flat.dynamics.is_a("SXFunction") and flat.output.is_a("SXFunction")
        else cast(type[ca.SX], ca.MX)
    )
    t = kind.sym("t")
    x, u, p = (
        kind.sym(name, len(part))
        for name, part in zip("xup", (flat.states, flat.inputs, flat.parameters), strict=True)
    )
    z = kind(0, 1)
    if flat.unknowns is not None:  # the law keeps them from instant to instant as states
        return _with_unknowns(flat, flat.unknowns)
    return BlockFunctions(
        states=flat.states,
        inputs=flat.inputs,
        outputs=flat.outputs,
        parameters=flat.parameters,
        dynamics=ca.Function("dynamics", [t, x, u, p], [flat.dynamics(t, x, u, p, z)]),
        output=ca.Function("output", [t, x, u, p], [flat.output(t, x, u, p, z)]),
        callbacks=flat.callbacks,
        constants=flat.constants,
    )


def _with_unknowns(flat: FlatModel, unknowns: ca.Function) -> BlockFunctions:
    MX = cast(type[ca.SX], ca.MX)
    t, s = MX.sym("t"), MX.sym("s", len(flat.states) + len(flat.held))
    u, p = MX.sym("u", len(flat.inputs)), MX.sym("p", len(flat.parameters))
    x, z = ca.vertsplit(s, [0, len(flat.states), s.shape[0]])
    after = ca.vertcat(flat.dynamics(t, x, u, p, z), unknowns(t, x, u, p, z))
    return BlockFunctions(
        states=flat.states + flat.held,
        inputs=flat.inputs,
        outputs=flat.outputs,
        parameters=flat.parameters,
        dynamics=ca.Function("dynamics", [t, s, u, p], [after]),
        output=ca.Function("output", [t, s, u, p], [flat.output(t, x, u, p, z)]),
        callbacks=flat.callbacks,
        constants=flat.constants,
    )
