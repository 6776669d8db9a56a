"""The blocks a diagram ends in, each as CasADi functions."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import Protocol, cast, runtime_checkable

import casadi as ca
import control as ct
import numpy as np
from numpy.typing import ArrayLike

from ..blocks.functions import BlockEvent, BlockFunctions, Variable
from ..blocks.hybrid import HybridBlock
from ..blocks.phyfilter import PhyFilterBlock
from .branches import DefaultsError
from .probing import different_defaults
from .tracing import trace

__all__ = ["block_functions", "linear_function", "linear_functions", "state_space", "with_values"]


@runtime_checkable
class _HasFunctions(Protocol):
    functions: BlockFunctions


def block_functions(
    system: object, path: str, given: Mapping[str, object], missing: Mapping[str, object] | None = None
) -> BlockFunctions:
    """Equations of one block that is no diagram.

    Parameters
    ----------
    system : control.InputOutputSystem
    path : str
        Name of the block in messages.
    given : mapping
        Parameter values set by the diagrams around it.
    missing : mapping, optional
        Values of parameters that it reads and that have none.

    Returns
    -------
    BlockFunctions

    Raises
    ------
    TypeError
        For something that is no time-domain python-control system.
    ValueError
        For an improper transfer function, or functions that fail wherever they are called.

    Examples
    --------
    >>> functions = block_functions(ct.tf([1.0], [1.0, 2.0]), "lag", {})
    >>> functions.dynamics(0, 3.0, 1.0, []).full().item()
    -5.0
    """
    if isinstance(system, ct.FrequencyResponseData):
        raise TypeError(
            f"block {path}: frequency response data has no states to run in time; fit a transfer function to it"
        )
    if isinstance(system, HybridBlock):
        return _with_events(system, path, given, missing)
    if isinstance(system, ct.InputOutputSystem) and isinstance(system, _HasFunctions):
        return with_values(system.functions, {**getattr(system, "params", {}), **given})
    if isinstance(system, ct.TransferFunction | ct.StateSpace):
        return linear_functions(state_space(system, path), path)
    if isinstance(system, ct.NonlinearIOSystem):
        return trace(system, path, given, missing)
    raise TypeError(
        f"block {path}: expected a python-control system (StateSpace, TransferFunction, NonlinearIOSystem, "
        f"InterconnectedSystem), got {type(system).__name__}; a delay is phyfilter_ctl.transport_delay"
    )


def _with_events(
    block: HybridBlock, path: str, given: Mapping[str, object], missing: Mapping[str, object] | None
) -> BlockFunctions:
    """Equations and events on one vector of parameters."""
    functions = block_functions(block.system, path, {**block.params, **given}, missing)
    traced = [(entry, trace(part, f"{path}.{entry.name}", given, missing)) for entry, part in block.parts()]
    parameters = {variable.name: variable for variable in functions.parameters}
    for variable in (variable for _, part in traced for variable in part.parameters):
        before = parameters.setdefault(variable.name, variable)
        if before.start != variable.start:
            raise DefaultsError(
                f"block {path}: {different_defaults(variable.name, before.start, variable.start)}"
            )
    shared = tuple(parameters.values())
    events = tuple(
        BlockEvent(
            name=entry.name,
            direction=entry.direction,
            condition=_on(part.output, part.parameters, shared),
            reset=None if entry.reset is None else _on(part.dynamics, part.parameters, shared),
        )
        for entry, part in traced
    )
    return dataclasses.replace(
        functions,
        parameters=shared,
        dynamics=_on(functions.dynamics, functions.parameters, shared),
        output=_on(functions.output, functions.parameters, shared),
        events=events,
        callbacks=functions.callbacks + tuple(c for _, part in traced for c in part.callbacks),
    )


def _on(function: ca.Function, own: Sequence[Variable], shared: Sequence[Variable]) -> ca.Function:
    """The function with the parameters of a longer vector."""
    kind = ca.SX if function.is_a("SXFunction") else cast(type[ca.SX], ca.MX)
    t, x, u = (kind.sym(name, function.numel_in(i)) for i, name in enumerate("txu"))
    p = kind.sym("p", len(shared))
    names = [variable.name for variable in shared]
    read = ca.vertcat(*(p[names.index(variable.name)] for variable in own)) if own else kind(0, 1)
    return ca.Function(function.name(), [t, x, u, p], function.call([t, x, u, read]))


def state_space(system: ct.StateSpace | ct.TransferFunction, path: str) -> ct.StateSpace:
    """A linear block as a state space with real, finite matrices.

    Parameters
    ----------
    system : control.StateSpace or control.TransferFunction
    path : str
        Name of the block in messages.

    Returns
    -------
    control.StateSpace

    Raises
    ------
    ValueError
        For an improper transfer function, one of several inputs or outputs that python-control cannot convert, or
        matrices that are not real and finite.

    Examples
    --------
    >>> state_space(ct.tf([1.0], [1.0, 2.0]), "lag").A.tolist()
    [[-2.0]]
    """
    if isinstance(system, ct.StateSpace):
        space = system
    else:
        try:
            space = cast(ct.StateSpace, ct.tf2ss(system))
        except (ValueError, NotImplementedError) as error:
            raise ValueError(
                f"block {path}: python-control finds no state space for the transfer function ({error}); it must be "
                "proper, and several inputs or outputs need one block each or a state space"
            ) from error
    if not all(np.isrealobj(M) and np.all(np.isfinite(M)) for M in (space.A, space.B, space.C, space.D)):
        raise ValueError(f"block {path}: its state-space matrices are not real and finite")
    return space


def linear_functions(system: ct.StateSpace, path: str) -> BlockFunctions:
    """x' = A x + B u, y = C x + D u with the zeros left out.

    Parameters
    ----------
    system : control.StateSpace
    path : str
        Name of the block in messages.

    Returns
    -------
    BlockFunctions

    Raises
    ------
    ValueError
        For matrices that are not real and finite.

    Examples
    --------
    >>> linear_functions(ct.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), "lag").feedthrough.tolist()
    [[False]]
    """
    optional = system.optional_inputs if isinstance(system, PhyFilterBlock) else ()
    system = state_space(system, path)
    return BlockFunctions(
        states=tuple(Variable(label) for label in system.state_labels),
        inputs=tuple(Variable(label, optional=label in optional) for label in system.input_labels),
        outputs=tuple(Variable(label) for label in system.output_labels),
        parameters=(),
        dynamics=linear_function("dynamics", "txup", system.A, system.B),
        output=linear_function("output", "txup", system.C, system.D),
    )


def linear_function(
    name: str, letters: Sequence[str], by_state: ArrayLike, by_input: ArrayLike
) -> ca.Function:
    """(t, x, u, ...) -> M x + N u; there is nothing in further arguments.

    Parameters
    ----------
    name : str
    letters : sequence of str
        Of the arguments.
    by_state, by_input : (k, n), (k, m) arrays

    Returns
    -------
    casadi.Function

    Examples
    --------
    >>> linear_function("f", "txup", np.array([[2.0]]), np.array([[1.0]]))(0, 3, 4, []).full().item()
    10.0
    """
    (rows, n), m = np.shape(by_state), np.shape(by_input)[1]
    x, u = ca.SX.sym("x", n), ca.SX.sym("u", m)
    value = ca.mtimes(_sparse(by_state, rows, n), x) + ca.mtimes(_sparse(by_input, rows, m), u)
    arguments = [ca.SX.sym("t"), x, u, *(ca.SX(0, 1) for _ in letters[3:])]
    return ca.Function(name, arguments, [ca.densify(value)], list(letters), ["value"])


def _sparse(matrix: ArrayLike, rows: int, columns: int) -> ca.DM:
    return ca.sparsify(ca.DM(np.asarray(matrix, dtype=float))) if rows and columns else ca.DM(rows, columns)


def with_values(functions: BlockFunctions, values: Mapping[str, object]) -> BlockFunctions:
    """Functions whose parameters start at the values of a python-control ``params`` dict, where it names them.

    Parameters
    ----------
    functions : BlockFunctions
    values : mapping
        By name, or arrays by name without the index.

    Returns
    -------
    BlockFunctions
    """
    parameters = tuple(
        dataclasses.replace(variable, start=_value(variable, values)) for variable in functions.parameters
    )
    return dataclasses.replace(functions, parameters=parameters)


def _value(variable: Variable, values: Mapping[str, object]) -> float:
    value: object = values.get(variable.name)
    indexed = re.fullmatch(r"(.+)\[([\d,]+)\]", variable.name)
    if value is None and indexed and indexed[1] in values:
        array = np.asarray(values[indexed[1]], dtype=float)
        value = array[tuple(int(i) for i in indexed[2].split(","))] if array.ndim else array
    return variable.start if value is None else float(np.asarray(value, dtype=float))
