"""What a run is asked for, checked and in one form."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias, cast

import control as ct
import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _signals
from .._sections import FloatArray
from ..diagram import FlatModel
from ..diagram.naming import override

__all__ = [
    "Inputs",
    "Interpolation",
    "Parameters",
    "Run",
    "Start",
    "Times",
    "completed",
    "given_times",
    "prepare",
]

Interpolation = Literal["linear", "hold"]
Inputs: TypeAlias = ArrayLike | Sequence[ArrayLike]
Start: TypeAlias = ArrayLike | Sequence[ArrayLike] | Mapping[str, ArrayLike]
Parameters: TypeAlias = Mapping[str, ArrayLike]
Times: TypeAlias = ArrayLike | tuple[ArrayLike, ArrayLike]

# Times of the inputs and of the response that differ by rounding only are one, relative to the largest.
_SAME_TIME = 1e-12


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
    shown : (k,) array, optional
        Which times the response has; None: all.
    """

    times: FloatArray
    inputs: FloatArray
    start: FloatArray
    parameters: FloatArray
    interpolation: Interpolation
    shown: NDArray[np.intp] | None = None


def prepare(
    flat: FlatModel,
    timepts: ArrayLike,
    inputs: Inputs | None,
    initial_state: Start | None,
    params: Parameters | None,
    interpolation: Interpolation,
    shown: ArrayLike | None = None,
) -> Run:
    """Check and complete the arguments of a run."""
    if interpolation not in ("linear", "hold"):
        raise ValueError(f"interpolation: expected 'linear' or 'hold', got {interpolation!r}")
    times = _signals.sample_times("timepts", timepts)
    parameters = flat.start_parameters(params)
    if np.any(np.isnan(parameters)):  # an infinite one is a limit that never acts
        wrong = [v.name for v, value in zip(flat.parameters, parameters, strict=True) if np.isnan(value)]
        raise ValueError(f"params: expected numbers, got nan for {', '.join(wrong)}")
    run = Run(
        times, _inputs(flat, inputs, len(times)), start_vector(flat, initial_state), parameters, interpolation
    )
    if shown is not None:
        run = _shown(run, _signals.sample_times("timepts", shown), discrete=flat.dt > 0.0)
    _check_spacing(flat, run.times)
    return run


def given_times(timepts: Times) -> tuple[ArrayLike, ArrayLike | None]:
    """Times of the inputs, and those of the response where they are others.

    Parameters
    ----------
    timepts : (N,) array, or a pair of arrays

    Examples
    --------
    >>> given_times((0.0, 1.0)), given_times(([0.0, 1.0], [0.5]))
    (((0.0, 1.0), None), ([0.0, 1.0], [0.5]))
    """
    if isinstance(timepts, tuple) and len(timepts) == 2 and np.ndim(timepts[0]) == np.ndim(timepts[1]) == 1:
        return timepts[0], timepts[1]
    return cast(ArrayLike, timepts), None


def _shown(run: Run, at: FloatArray, discrete: bool) -> Run:
    """The run with its response at other times; a discrete one makes its steps from one of them to the next."""
    times = run.times
    if not times[0] <= at[0] <= at[-1] <= times[-1]:
        raise ValueError(
            f"timepts: expected times of the response from {times[0]:g} to {times[-1]:g} s, those of the inputs, got "
            f"{at[0]:g} to {at[-1]:g} s"
        )
    after = np.clip(np.searchsorted(times, at), 1, max(len(times) - 1, 1)) % len(times)
    near = np.where(at - times[after - 1] < times[after] - at, times[after - 1], times[after])
    at = np.where(np.abs(near - at) <= _SAME_TIME * np.abs(times).max(), near, at)
    every = at if discrete else np.union1d(times, at)
    if run.interpolation == "hold":
        inputs = run.inputs[np.searchsorted(times, every, side="right") - 1]
    else:
        columns = [np.interp(every, times, column) for column in run.inputs.T]
        inputs = np.array(columns).reshape(-1, len(every)).T
    return replace(run, times=every, inputs=np.ascontiguousarray(inputs), shown=np.searchsorted(every, at))


def _check_spacing(flat: FlatModel, times: FloatArray) -> None:
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


def completed(
    sys: ct.InputOutputSystem,
    times: ArrayLike,
    inputs: Inputs | None,
    initial_state: Start | None,
    params: Parameters | None,
) -> ct.InputOutputSystem:
    """The system with what python-control takes from the call: numbers of signals, and a sampling interval, left open.

    Parameters
    ----------
    sys : control.InputOutputSystem
    times : (N,) array
        Of the response.
    inputs, initial_state, params
        As for :func:`simulate`.

    Returns
    -------
    control.InputOutputSystem
        The same where nothing is open. Nothing given counts as one input, one state; as many outputs as the output
        function gives, or as states without one.

    Raises
    ------
    ValueError
        For ``dt=True`` and times that are not evenly spaced, or an output function that fails where the run starts.

    Examples
    --------
    >>> lag = ct.nlsys(lambda t, x, u, params: u - x, None)
    >>> completed(lag, [0.0, 1.0], 1.0, [0.0, 0.0], None).nstates
    2
    """
    if isinstance(sys, ct.NonlinearIOSystem) and None in (sys.nstates, sys.ninputs, sys.noutputs):
        n_x = _size(initial_state) if sys.nstates is None else sys.nstates
        n_u = _rows(inputs, np.size(times)) if sys.ninputs is None else sys.ninputs
        n_y = n_x if sys.noutputs is None and sys.outfcn is None else sys.noutputs
        if n_y is None and n_x is not None and sys.outfcn is not None:
            try:
                given = {**sys.params, **(params or {})}
                n_y = np.size(sys.outfcn(float(np.ravel(times)[0]), np.zeros(n_x), np.zeros(n_u), given))
            except Exception as error:
                raise ValueError(
                    f"block {sys.name}: the number of its outputs is not set, and its output function fails for "
                    f"{n_x} states and {n_u} inputs that are 0 ({error}); give outputs= where it is made"
                ) from error
        sys = ct.nlsys(
            sys.updfcn,
            sys.outfcn,
            name=sys.name,
            states=n_x if sys.nstates is None else sys.state_labels,
            inputs=n_u if sys.ninputs is None else sys.input_labels,
            outputs=n_y if sys.noutputs is None else sys.output_labels,
            params=sys.params,
            dt=sys.dt,
        )
    if sys.dt is True:
        spacing = np.diff(_signals.sample_times("timepts", times))
        if not spacing.size or not np.allclose(spacing, spacing[0], rtol=1e-6):
            raise ValueError(
                f"timepts: expected two times or more, evenly spaced, for {sys.name}, which is discrete with "
                f"dt=True and takes its sampling interval from them, got {np.size(times)} times"
                + (f", {spacing.min():g} to {spacing.max():g} s apart" if spacing.size else "")
            )
        sys = copy(sys)
        sys.dt = float(spacing[0])
    return sys


def _size(initial_state: Start | None) -> int | None:
    """How many states are given; None where they are given by names."""
    if isinstance(initial_state, Mapping):
        return None
    parts = initial_state if isinstance(initial_state, (list, tuple)) else [initial_state]
    return sum(1 if part is None else np.asarray(part).size for part in parts)


def _rows(inputs: Inputs | None, N: int) -> int:
    """How many inputs are given."""
    if isinstance(inputs, (list, tuple)) and len(inputs) != N:
        return sum(len(part) if np.ndim(part) == 2 else 1 for part in map(np.asarray, inputs))
    table = np.asarray(inputs)
    return len(table) if table.ndim == 2 else 1


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
        if 0 < given.size < n_x:  # as in python-control
            if given[-1] != 0.0:
                warnings.warn(
                    f"initial_state: {given.size} of {n_x} states are given, the others start at 0; a closing 0 says "
                    "that this is meant",
                    UserWarning,
                    stacklevel=5,
                )
            given = np.concatenate([given, np.zeros(n_x - given.size)])
        if given.size != n_x:
            names = ", ".join(variable.name for variable in flat.states[:8]) + (", ..." if n_x > 8 else "")
            raise ValueError(
                f"initial_state: expected {n_x} numbers ({names}), or the first ones, got {given.size}"
            )
        start[:] = given
    if not np.all(np.isfinite(start)):
        raise ValueError("initial_state: expected finite values")
    return start
