"""Lookup tables with one or two inputs, as static blocks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from .function_block import FunctionBlock, function_block
from .functions import BlockFunctions, Variable

__all__ = ["interpolated", "lookup_table"]


def lookup_table(
    breakpoints: ArrayLike | Sequence[ArrayLike],
    table: ArrayLike,
    *,
    extrapolation: Literal["hold", "linear"] = "hold",
    inputs: str | Sequence[str] = "u",
    outputs: str = "y",
    name: str = "table",
    unit: str = "",
) -> FunctionBlock:
    """A table read by one or two signals, with straight lines between its entries.

    Parameters
    ----------
    breakpoints : (n,) array, or two arrays (n,) and (m,)
        Increasing values of the inputs, two at least for each.
    table : (n,) or (n, m) array
        The output at the breakpoints; its entries are parameters of the block, ``table[i]`` or ``table[i,j]``.
    extrapolation : {"hold", "linear"}
        Beyond the breakpoints: the value at the last, or the last line prolonged.
    inputs : str or sequence of str
        Labels; for two inputs "u" stands for u[0] and u[1].
    outputs : str
        Label.
    name : str
        Name of the block.
    unit : str
        SI unit of the table.

    Returns
    -------
    FunctionBlock
        Without states; it goes with continuous and with discrete blocks.

    Raises
    ------
    ValueError
        For breakpoints that do not increase, a table of another shape than theirs, or another number of labels.

    Notes
    -----
    ``np.interp`` in a function of ``control.nlsys`` does the same for one input. Two inputs: bilinear,
    ``y = (1 - a) (1 - b) T[i,j] + a (1 - b) T[i+1,j] + (1 - a) b T[i,j+1] + a b T[i+1,j+1]`` with a and b the places
    between the breakpoints.

    Examples
    --------
    >>> torque = lookup_table([[0.0, 100.0, 300.0], [0.0, 1.0]], [[0.0, 50.0], [0.0, 80.0], [0.0, 60.0]])
    >>> torque.output(0.0, [], [200.0, 0.5]).tolist()
    [35.0]
    """
    values = _signals.real("table", table)
    axes: list[Any] = [breakpoints]
    if values.ndim == 2 and isinstance(breakpoints, list | tuple):
        axes = list(breakpoints)
    grids = [_grid(i, axis, len(axes)) for i, axis in enumerate(axes)]
    if values.shape != tuple(map(len, grids)) or not np.isfinite(values).all():
        raise ValueError(
            f"table: expected finite numbers of shape {tuple(map(len, grids))}, as the breakpoints are, got shape "
            f"{values.shape}"
        )
    if extrapolation not in ("hold", "linear"):
        raise ValueError(f"extrapolation: expected 'hold' or 'linear', got {extrapolation!r}")
    labels = [inputs] if isinstance(inputs, str) else list(inputs)
    labels = [f"{labels[0]}[{i}]" for i in range(2)] if len(labels) == 1 and len(grids) == 2 else labels
    if len(labels) != len(grids):
        raise ValueError(f"inputs: expected {len(grids)} labels, got {len(labels)}")
    t, x, u, p = ca.SX.sym("t"), ca.SX(0, 1), ca.SX.sym("u", len(grids)), ca.SX.sym("table", values.size)
    rows = ca.vertsplit(ca.reshape(p, *values.shape[::-1]).T if values.ndim == 2 else p)
    if len(grids) == 2:
        rows = [interpolated(u[1], grids[1], ca.vertsplit(row.T), extrapolation) for row in rows]
    y = interpolated(u[0], grids[0], rows, extrapolation)
    entries = [
        Variable(f"table[{','.join(map(str, index))}]", float(values[index]), unit)
        for index in np.ndindex(values.shape)
    ]
    arguments = [t, x, u, p]
    functions = BlockFunctions(
        (),
        tuple(Variable(label) for label in labels),
        (Variable(outputs, unit=unit),),
        tuple(entries),
        ca.Function("dynamics", arguments, [ca.SX(0, 1)]),
        ca.Function("output", arguments, [y]),
    )
    return function_block(functions, name=name, dt=None)


def interpolated(
    place: ca.SX,
    points: FloatArray,
    values: Sequence[ca.SX],
    extrapolation: Literal["hold", "linear"] = "hold",
) -> ca.SX:
    """Straight lines through points, as a sum of ramps: no search, and no entry is read outside the table.

    Parameters
    ----------
    place : casadi.SX
        Where.
    points : (n,) array
        Increasing.
    values : sequence of n casadi.SX
    extrapolation : {"hold", "linear"}

    Returns
    -------
    casadi.SX
    """
    result, last = values[0], len(points) - 2
    for i, span in enumerate(np.diff(points).tolist()):
        inside = place - float(points[i])
        if extrapolation == "hold" or i > 0:
            inside = ca.fmax(inside, 0.0)
        if extrapolation == "hold" or i < last:
            inside = ca.fmin(inside, span)
        result = result + (values[i + 1] - values[i]) / span * inside
    # C's fmax and fmin pass over what is not a number.
    known = ca.logic_or(place <= float(points[0]), place > float(points[0]))
    return ca.if_else(known, result, place)


def _grid(i: int, axis: ArrayLike, count: int) -> FloatArray:
    name = f"breakpoints[{i}]" if count > 1 else "breakpoints"
    grid = _signals.real(name, axis)
    if grid.ndim != 1 or len(grid) < 2 or not np.isfinite(grid).all() or not np.all(np.diff(grid) > 0.0):
        raise ValueError(
            f"{name}: expected two or more finite numbers that increase, got {np.asarray(axis).tolist()}"
        )
    return grid
