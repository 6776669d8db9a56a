"""Affine diagrams without sampled blocks: one product of a matrix by the state a step.

x' = A x + B u + d t + c with u on straight lines between the times is integrated exactly by
x+ = e^{A h} x + h phi_1(A h) n + h phi_2(A h) (n+ - n), n = B u + d t + c at both ends of the step.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from .._sections import FloatArray
from ..diagram import FlatModel, structure
from .arguments import Run
from .exponential import phi_functions
from .limits import Limits
from .response import Outcome
from .steps import KEPT
from .vm import diverged, step_lengths

__all__ = ["is_affine", "is_plain", "run_linear", "suits"]

# Of different lengths of steps: each has matrices of its own.
_MOST_LENGTHS = 8
# A matrix exponential of more states costs more than it saves.
_MOST_STATES = 1000
# Measured, in seconds: a step of the loop and an entry of its matrix; an operation in the virtual machine, whose
# functions have to be made first, and whose matrices are seven.
_STEP, _ENTRY = 1.3e-6, 0.15e-9
_VM_ENTRY, _VM_MAKING, _VM_MAKING_EACH = 20e-9, 5e-3, 60e-6
_SPARSE = 0.1  # of all entries: below, products leave out the others
_CHUNK = 4096
_KEPT_MATRICES = 16

_Matrix: TypeAlias = FloatArray | csr_array


class _Affine(NamedTuple):
    """x' = A x + B (1, t, u), y = C x + D (1, t, u)."""

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray


@lru_cache(maxsize=KEPT)
def is_affine(flat: FlatModel) -> bool:
    """Whether time, states and inputs enter dynamics and outputs linearly, whatever the parameters."""
    if flat.tasks or flat.loops or flat.events or flat.callbacks or flat.dt > 0.0 or not flat.states:
        return False
    return all(structure.is_affine(function, (0, 1, 2)) for function in (flat.dynamics, flat.output))


def is_plain(flat: FlatModel, run: Run, max_step: float | None) -> bool:
    """Whether a run can be made so."""
    if max_step is not None or not is_affine(flat):
        return False
    lengths = np.unique(np.round(np.diff(run.times) / max(float(np.ptp(run.times)), 1e-300), 12))
    return len(lengths) <= _MOST_LENGTHS and len(flat.states) <= _MOST_STATES


def suits(flat: FlatModel, run: Run, max_step: float | None, runs: int = 1) -> bool:
    """Whether this is the fastest way for a run that the exponential method takes.

    Parameters
    ----------
    flat : FlatModel
    run : Run
    max_step : float, optional
    runs : int
        As many like it on several threads, which a loop in Python would keep waiting for each other.
    """
    if not is_plain(flat, run, max_step):
        return False
    steps, n = len(run.times) - 1, len(flat.states)
    entries = min(n**2, flat.dynamics.n_instructions())
    virtual = _VM_MAKING + entries * (_VM_MAKING_EACH + steps * _VM_ENTRY * runs)
    return steps * runs * (_STEP * min(runs, 2) + n**2 * _ENTRY) < virtual


def run_linear(flat: FlatModel, run: Run, limits: Limits) -> Outcome:
    """Such a run."""
    times, parameters = run.times, run.parameters.tobytes()
    model = _matrices(flat, parameters)
    given = np.column_stack([np.ones(len(times)), times, run.inputs])
    x = np.empty((len(times), len(flat.states)))
    x[0] = run.start
    lengths, index = (
        step_lengths(np.diff(times), times) if len(times) > 1 else ([], np.zeros(0, dtype=np.intp))
    )
    steps = [_step(flat, parameters, float(h)) for h in lengths]
    failed_at, message = np.inf, ""
    for start in range(0, len(times) - 1, _CHUNK):
        rows = np.arange(start, min(start + _CHUNK, len(times) - 1))
        granted, refusal = limits.grant(len(rows))
        rows = rows[:granted]
        if refusal:
            failed_at = float(times[start + granted])
            x[start + granted + 1 :] = np.nan
            message = f"{refusal} at t = {failed_at:.9g} s: fewer times need fewer, max_steps and time_limit allow more"
        _push(x, given, steps, index, rows, run.interpolation == "hold")
        with np.errstate(over="ignore", invalid="ignore"):
            _advance(x, [power for power, _, _ in steps], index, rows)
        bad = rows[~np.isfinite(x[rows + 1]).all(axis=1)] + 1
        if len(bad):
            failed_at = float(times[bad[0]])
            x[bad[0] :] = np.nan
            message = diverged(flat, x, failed_at)
        if message:
            break
    y = x @ model.C.T + given @ model.D.T
    return Outcome(x, y, len(times) - 1, message, failed_at)


def _push(
    x: FloatArray, given: FloatArray, steps: list[tuple[_Matrix, FloatArray, FloatArray]], index: NDArray[np.intp],
    rows: NDArray[np.intp], held: bool,
) -> None:  # fmt: skip
    """x[k + 1] = h phi_1 n + h phi_2 (n+ - n) for all rows k."""
    for part, (_, value, change) in enumerate(steps):
        here = rows[index[rows] == part]
        after = given[here + 1].copy()
        if held:
            after[:, 2:] = given[here, 2:]
        x[here + 1] = given[here] @ value.T + (after - given[here]) @ change.T


def _advance(x: FloatArray, powers: list[_Matrix], index: NDArray[np.intp], rows: NDArray[np.intp]) -> None:
    """x[k + 1] = E x[k] + x[k + 1] for all rows k."""
    for k, part in zip(rows.tolist(), index[rows].tolist(), strict=True):
        x[k + 1] += powers[part] @ x[k]


@lru_cache(maxsize=_KEPT_MATRICES)
def _matrices(flat: FlatModel, parameters: bytes) -> _Affine:
    """By evaluation at unit vectors, which is exact."""
    n, m, p = len(flat.states), len(flat.inputs), np.frombuffer(parameters)
    units = np.eye(n + m + 1, n + m + 2, 1)  # x, t, u; a column for each, after that of zeros
    x, t, u = np.split(units, [n, n + 1])
    found = []
    for function in (flat.dynamics, flat.output):
        if not function.size1_out(0):
            found += [np.zeros((0, n)), np.zeros((0, m + 2))]
            continue
        columns = units.shape[1]
        values = function.map(columns)(t, x, u, np.tile(p[:, None], columns), np.zeros((0, columns)))
        constant, *rest = np.split(np.asarray(values, dtype=float), [1, 1 + n], axis=1)
        state, given = (part - constant for part in rest)
        found += [state, np.hstack([constant, given])]
    A, B, C, D = found
    return _Affine(A, B, C, D)


@lru_cache(maxsize=_KEPT_MATRICES)
def _step(flat: FlatModel, parameters: bytes, h: float) -> tuple[_Matrix, FloatArray, FloatArray]:
    """e^{A h}, and h phi_1 B and h phi_2 B."""
    A, B, _, _ = _matrices(flat, parameters)
    power, value, change = np.zeros_like(A), np.zeros_like(B), np.zeros_like(B)
    _, label = connected_components(csr_array(A), directed=False)
    order = np.argsort(label, kind="stable")
    entries = 0
    groups: list[NDArray[np.intp]] = np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
    for group in groups:
        place = (group[:, None], group)
        power[place], first, second, _ = phi_functions(A[place] * h)
        value[group], change[group] = h * first @ B[group], h * second @ B[group]
        entries += len(group) ** 2
    return csr_array(power) if entries < _SPARSE * A.size else power, value, change
