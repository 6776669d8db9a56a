"""The blocks a diagram ends in, each as CasADi functions."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import casadi as ca
import control as ct
import numpy as np
from numpy.typing import ArrayLike

from ..blocks.functions import BlockFunctions, Variable
from .tracing import trace

__all__ = ["block_functions", "linear_functions", "with_values"]


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
    if isinstance(system, ct.InputOutputSystem) and isinstance(system, _HasFunctions):
        return with_values(system.functions, {**getattr(system, "params", {}), **given})
    if isinstance(system, ct.TransferFunction):
        try:
            system = ct.tf2ss(system)
        except (ValueError, NotImplementedError) as error:
            raise ValueError(
                f"block {path}: python-control finds no state space for the transfer function ({error}); it must be "
                "proper, and several inputs or outputs need one block each or a state space"
            ) from error
    if isinstance(system, ct.StateSpace):
        return linear_functions(system, path)
    if isinstance(system, ct.NonlinearIOSystem):
        return trace(system, path, given, missing)
    raise TypeError(
        f"block {path}: expected a python-control system (StateSpace, TransferFunction, NonlinearIOSystem, "
        f"InterconnectedSystem), got {type(system).__name__}; a delay is ct.pade(T, n) or a sampled block"
    )


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
    n, m, k = system.nstates, system.ninputs, system.noutputs
    matrices = (system.A, system.B, system.C, system.D)
    if not all(np.isrealobj(M) and np.all(np.isfinite(M)) for M in matrices):
        raise ValueError(f"block {path}: its state-space matrices are not real and finite")
    A, B, C, D = (
        _sparse(M, rows, columns)
        for M, rows, columns in zip(matrices, (n, n, k, k), (n, m, n, m), strict=True)
    )
    t, x, u, p = ca.SX.sym("t"), ca.SX.sym("x", n), ca.SX.sym("u", m), ca.SX(0, 1)
    return BlockFunctions(
        states=tuple(Variable(label) for label in system.state_labels),
        inputs=tuple(Variable(label) for label in system.input_labels),
        outputs=tuple(Variable(label) for label in system.output_labels),
        parameters=(),
        dynamics=ca.Function("dynamics", [t, x, u, p], [ca.densify(ca.mtimes(A, x) + ca.mtimes(B, u))]),
        output=ca.Function("output", [t, x, u, p], [ca.densify(ca.mtimes(C, x) + ca.mtimes(D, u))]),
    )


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
