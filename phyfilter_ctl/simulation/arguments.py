"""What a run is asked for, checked and in one form."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from ..diagram import FlatModel
from ..diagram.naming import override

__all__ = ["Inputs", "Interpolation", "Parameters", "Run", "Start", "prepare"]

Interpolation = Literal["linear", "hold"]
Inputs: TypeAlias = ArrayLike | Sequence[ArrayLike]
Start: TypeAlias = ArrayLike | Sequence[ArrayLike] | Mapping[str, ArrayLike]
Parameters: TypeAlias = Mapping[str, ArrayLike]


@dataclass(frozen=True, eq=False)
class Run:
    """Arguments of one run.

    Parameters
    ----------
    times : (N,) array
    inputs : (N, n_u) array
    start : (n_x,) array
    parameters : (n_p,) array
    interpolation : {"linear", "hold"}
        Inputs between the times: on straight lines, or each held until the next.
    """

    times: FloatArray
    inputs: FloatArray
    start: FloatArray
    parameters: FloatArray
    interpolation: Interpolation


def prepare(
    flat: FlatModel,
    timepts: ArrayLike,
    inputs: Inputs | None,
    initial_state: Start | None,
    params: Parameters | None,
    interpolation: Interpolation,
) -> Run:
    """Check and complete the arguments of a run."""
    if interpolation not in ("linear", "hold"):
        raise ValueError(f"interpolation: expected 'linear' or 'hold', got {interpolation!r}")
    times = _times(flat, timepts)
    parameters = flat.start_parameters(params)
    if np.any(np.isnan(parameters)):  # an infinite one is a limit that never acts
        wrong = [v.name for v, value in zip(flat.parameters, parameters, strict=True) if np.isnan(value)]
        raise ValueError(f"params: expected numbers, got nan for {', '.join(wrong)}")
    return Run(
        times, _inputs(flat, inputs, len(times)), start_vector(flat, initial_state), parameters, interpolation
    )


def _times(flat: FlatModel, timepts: ArrayLike) -> FloatArray:
    times = _signals.sample_times("timepts", timepts)
    spacing = np.diff(times)
    if flat.dt > 0.0 and not np.allclose(spacing, flat.dt, rtol=1e-6):
        raise ValueError(
            f"timepts: expected the sampling interval {flat.dt:g} s of the discrete diagram between all times, "
            f"got {spacing.min():g} to {spacing.max():g} s"
        )
    shortest = min((task.period for task in flat.tasks), default=0.0)
    if spacing.size and spacing.min() < 1e-8 * shortest:
        raise ValueError(
            f"timepts: two times are {spacing.min():g} s apart, which is nothing beside the period {shortest:g} s of "
            "a sampled block; leave one of them out"
        )
    return times


def _inputs(flat: FlatModel, inputs: Inputs | None, N: int) -> FloatArray:
    """The conventions of ``control.input_output_response``, time-major."""
    if inputs is None:
        return np.tile(flat.start_inputs(), (N, 1))
    n_u = len(flat.inputs)
    names = ", ".join(variable.name for variable in flat.inputs)
    wanted = f"a number, shape ({n_u}, {N}) or a list of numbers and ({N},) arrays, one per input ({names})"
    if isinstance(inputs, (list, tuple)) and (len(inputs) != N or len(inputs) == n_u > 1):
        parts: list[FloatArray] = []
        for entry in inputs:
            part = _signals.real("inputs", entry)
            if part.ndim == 0 or (part.ndim == 1 and len(part) != N):
                part = np.outer(part, np.ones(N))
            part = np.atleast_2d(part)
            if part.ndim != 2 or part.shape[1] != N:
                raise ValueError(f"inputs: expected {wanted}, got an entry of shape {np.shape(entry)}")
            parts.append(part)
        table = np.vstack(parts) if parts else np.zeros((0, N))
    else:
        table = _signals.real("inputs", inputs)
        if table.ndim == 0:
            table = np.full((n_u, N), float(table))
        elif table.ndim == 1 and n_u == 1 and len(table) == N:
            table = table[None]
    if table.shape != (n_u, N):
        raise ValueError(f"inputs: expected {wanted}, got shape {table.shape}")
    if not np.all(np.isfinite(table)):
        row, column = np.argwhere(~np.isfinite(table))[0]
        raise ValueError(
            f"inputs: expected finite values, got {table[row, column]} in {flat.inputs[row].name} at row {column}"
        )
    return np.ascontiguousarray(table.T)


def start_vector(flat: FlatModel, initial_state: Start | None) -> FloatArray:
    """States (n_x,) from what the user gave; None means the start values of the diagram."""
    start = flat.start_state()
    n_x = len(start)
    if initial_state is None:
        return start
    if isinstance(initial_state, Mapping):
        try:
            start = override(flat.states, initial_state)
        except ValueError as error:
            names = ", ".join(variable.name for variable in flat.states)
            raise ValueError(
                f"initial_state: expected states out of {names}, got {', '.join(initial_state)}"
            ) from error
    else:
        given = (
            np.concatenate([np.ravel(_signals.real("initial_state", part)) for part in initial_state])
            if isinstance(initial_state, (list, tuple)) and not all(map(np.isscalar, initial_state))
            else _signals.real("initial_state", initial_state)
        )
        if given.ndim == 0:
            given = np.full(n_x, float(given))
        given = given.ravel()
        if 0 < given.size < n_x and given[-1] == 0.0:  # python-control's [first block's states, 0]
            given = np.concatenate([given, np.zeros(n_x - given.size)])
        if given.size != n_x:
            names = ", ".join(variable.name for variable in flat.states[:8]) + (", ..." if n_x > 8 else "")
            raise ValueError(
                f"initial_state: expected {n_x} numbers ({names}), or the first ones and a closing 0, "
                f"got {given.size}"
            )
        start[:] = given
    if not np.all(np.isfinite(start)):
        raise ValueError("initial_state: expected finite values")
    return start
