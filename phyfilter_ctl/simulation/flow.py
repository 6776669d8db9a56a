"""Diagrams that are affine between instants: one exact step from node to node, a product of a matrix by the state.

x' = A x + B w with w = (1, t, u, z): t and u run on straight lines through a step (or u is held), z is held. Then

    x+ = e^{A h} x + h phi_1(A h) B w + h phi_2(A h) B (w+ - w),

with matrices that depend on parameters and on the length h alone: they are computed once for each length. Without
sampled blocks numpy runs the record; with them the product stands in the chain of steps, between two instants.
"""

from __future__ import annotations

from functools import lru_cache
from math import factorial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matrix_balance
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from .._sections import FloatArray
from ..diagram import FlatModel
from ..diagram.structure import is_affine
from .arguments import Run
from .limits import Budget, diverged, progress_bar
from .response import Outcome
from .schedule import nodes
from .steps import KEPT, SYMBOLS, Layout, Results, compose, cut, outputs_at, renewed

__all__ = [
    "SAME_LENGTH",
    "advance_flow",
    "exponential_step",
    "is_flow",
    "run_flow",
    "runs_in_numpy",
    "step_lengths",
    "suits",
    "tables",
]

# Lengths that agree to this are one: the times themselves are no better known.
SAME_LENGTH = 1e-12
# Cubes of the states that A couples, over all lengths, whose exponentials cost less than other methods would.
_MOST_CUBES = 1e9
# The series ends where its terms are less than this, relative.
_NEGLIGIBLE = 1e-17
_KEPT_MATRICES = 16
# Steps that are looked at together; fewer where there are more lengths, by entries of their matrices.
# Of as many states a product of matrices costs little more than the call.
_SMALL = 64
_CHUNK, _FEW_LENGTHS, _AT_ONCE = 4096, 16, 4_000_000
_SPARSE = 0.1  # of all entries: below, products in numpy leave out the others
_DENSE = 0.5  # of those in columns that are used: above, products in the chain take all


class Flow(NamedTuple):
    """x' = A x + B (1, t, u, z); ``groups`` of states that A couples, directly or through others."""

    A: FloatArray
    B: FloatArray
    groups: list[NDArray[np.intp]]


class Transition(NamedTuple):
    """Over one length: e^{A h}, h phi_1(A h) B and h phi_2(A h) B."""

    power: FloatArray | csr_array
    value: FloatArray
    change: FloatArray


@lru_cache(maxsize=KEPT)
def is_flow(flat: FlatModel) -> bool:
    """Whether the derivatives are affine in time, states, inputs and held outputs, with constant coefficients."""
    if flat.events or flat.dt > 0.0 or not flat.states:
        return False
    return flat.matrices is not None or is_affine(flat.dynamics, (0, 1, 2, 4))


def suits(flat: FlatModel, run: Run) -> bool:
    """Whether such a diagram is of a size for matrix exponentials, by the steps of its first window."""
    times = run.times
    if flat.tasks:
        times = next(nodes(times, [task.period for task in flat.tasks])).times
    lengths = len(step_lengths(np.diff(times), run.times)[0])
    cubes = sum(len(group) ** 3 for group in _flow(flat, run.parameters.tobytes()).groups)
    return lengths * cubes <= _MOST_CUBES


def step_lengths(h: FloatArray, times: FloatArray) -> tuple[FloatArray, NDArray[np.intp]]:
    """The different step lengths, and which of them each step has."""
    rounding = 8 * np.finfo(float).eps * max(abs(times[0]), abs(times[-1]))
    if len(h) == 0 or h.max() - h.min() <= rounding:
        return np.full(min(len(h), 1), h.mean() if len(h) else 0.0), np.zeros(len(h), dtype=np.intp)
    order = np.argsort(h)
    ranked = h[order]
    slack = SAME_LENGTH * ranked[1:] + rounding
    group = np.concatenate([[0], np.cumsum(np.diff(ranked) > slack)])
    index = np.empty(len(h), dtype=np.intp)
    index[order] = group
    counts = np.bincount(group)
    return np.bincount(group, ranked) / counts, index


def affine_part(function: ca.Function, p: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients of x and of (1, t, u, z) in a function (t, x, u, p, z), by evaluation at unit vectors."""
    _, n, m, _, k = (function.size1_in(i) for i in range(5))
    rows = function.size1_out(0)
    if not rows:
        return np.zeros((0, n)), np.zeros((0, 2 + m + k))
    units = np.eye(n + 1 + m + k, n + 2 + m + k, 1)  # x, t, u, z; a column for each, after that of zeros
    x, t, u, z = np.split(units, [n, n + 1, n + 1 + m])
    columns = units.shape[1]
    values = np.asarray(function.map(columns)(t, x, u, np.tile(p[:, None], columns), z), dtype=float)
    values[:, 1:] -= values[:, :1]
    return values[:, 1 : 1 + n].copy(), np.hstack([values[:, :1], values[:, 1 + n :]])


@lru_cache(maxsize=_KEPT_MATRICES)
def _flow(flat: FlatModel, parameters: bytes) -> Flow:
    if flat.matrices is None:
        A, B = affine_part(flat.dynamics, np.frombuffer(parameters))
    else:
        A, B = flat.matrices[0], _by_input(flat.matrices[1])
    return Flow(A, B, _groups(A))


def _groups(A: FloatArray) -> list[NDArray[np.intp]]:
    """States that A couples."""
    if np.all((A[0] != 0.0) | (A[:, 0] != 0.0) | (np.arange(len(A)) == 0)):
        return [np.arange(len(A))]
    _, label = connected_components(csr_array(A), directed=False)
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def _by_input(matrix: FloatArray) -> FloatArray:
    """Coefficients of u among those of (1, t, u)."""
    return np.hstack([np.zeros((len(matrix), 2)), matrix])


@lru_cache(maxsize=_KEPT_MATRICES)
def _stacks(flat: FlatModel, parameters: bytes, lengths: bytes) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Transitions over some lengths, one behind the other."""
    A, B, groups = _flow(flat, parameters)
    h = np.frombuffer(lengths)
    if len(groups) == 1:
        whole = exponential_step(A[None], B[None], h)
        return whole[0][:, 0], whole[1][:, 0], whole[2][:, 0]
    power = np.zeros((len(h), *A.shape))
    value, change = np.zeros((2, len(h), *B.shape))
    for size in {len(group) for group in groups}:
        alike = np.array([group for group in groups if len(group) == size])  # (groups, size)
        place = alike[:, :, None], alike[:, None, :]
        power[:, *place], value[:, alike], change[:, alike] = exponential_step(A[place], B[alike], h)
    return power, value, change


def transitions(flat: FlatModel, p: FloatArray, lengths: FloatArray) -> list[Transition]:
    """Matrices of steps of some lengths."""
    parameters = p.tobytes()
    power, value, change = _stacks(flat, parameters, lengths.tobytes())
    few = sum(len(group) ** 2 for group in _flow(flat, parameters).groups) < _SPARSE * power[0].size
    powers = [csr_array(one) for one in power] if few else power
    return [Transition(*parts) for parts in zip(powers, value, change, strict=True)]


def exponential_step(
    A: FloatArray, B: FloatArray, h: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """e^{A h}, h phi_1(A h) B and h phi_2(A h) B of several matrices and lengths.

    Parameters
    ----------
    A : (g, n, n) array
    B : (g, n, m) array
    h : (k,) array
        Seconds.

    Returns
    -------
    (k, g, n, n), (k, g, n, m) and (k, g, n, m) arrays

    Notes
    -----
    phi_k(Z) = sum_j Z^j / (j + k)!. Scaling and doubling, with e^Z - I in place of e^Z: a slow pole beside a fast one
    survives that many squarings. Powers of Z are shared as by Paterson and Stockmeyer (SIAM J. Comput. 2, 1973).
    """
    n = A.shape[-1]
    factors = np.ones(A.shape[:2])
    if n > 1:
        balanced = [matrix_balance(one, permute=False, separate=True) for one in A]
        A = np.array([one for one, _ in balanced])
        factors = np.array([scaling for _, (scaling, _) in balanced])
    rows = factors[:, :, None]
    B = B / rows
    norm = float(np.abs(A).sum(axis=-2).max(initial=0.0) * np.abs(h).max(initial=0.0))
    doublings = max(0, int(np.ceil(np.log2(max(norm, 1e-300)))) + 1)
    size = norm / 2.0**doublings  # at most 1/2
    length = h[:, None, None, None]
    Z = A * (length / 2.0**doublings)
    terms = next(m for m in range(1, 20) if size**m / factorial(m + 1) <= _NEGLIGIBLE)
    delta, first, second = _series(Z, length * B, terms)
    for _ in range(doublings):
        second = (delta @ second + 2.0 * second + first) / 4.0
        first = first + delta @ first / 2.0
        delta = 2.0 * delta + delta @ delta
    power = (rows * delta / factors[:, None, :]) + np.eye(n)
    return power, rows * first, rows * second


def _series(Z: FloatArray, B: FloatArray, terms: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """e^Z - I, phi_1(Z) B and phi_2(Z) B by so many terms."""
    step = max(1, round(np.sqrt(terms)))
    powers = [Z]
    while len(powers) < step:
        powers.append(powers[-1] @ Z)
    delta: FloatArray | None = None
    for start in reversed(range(0, terms, step)):
        part = powers[0] / factorial(start + 1)
        for j in range(1, min(step, terms - start)):
            part += powers[j] / factorial(start + j + 1)
        delta = part if delta is None else delta @ powers[-1] + part
    assert delta is not None
    second = B / factorial(terms + 1)
    for j in range(terms - 2, -1, -1):
        second = Z @ second + B / factorial(j + 2)
    return delta, B + Z @ second, second


class Tables(NamedTuple):
    """One matrix for each length, of (x, z, 1, t, u, u+): column by column where ``pattern`` is true."""

    pattern: NDArray[np.bool_]
    columns: FloatArray  # (lengths, entries)


def tables(flat: FlatModel, p: FloatArray, lengths: FloatArray) -> Tables:
    """Matrices of steps of some lengths, as the chain takes them."""
    parameters = p.tobytes()
    power, value, change = _stacks(flat, parameters, lengths.tobytes())
    m = len(flat.inputs)
    time, u, z = 1, slice(2, 2 + m), slice(2 + m, None)
    constant = value[:, :, :1] + lengths[:, None, None] * change[:, :, time : time + 1]
    parts = [power, value[:, :, z], constant, value[:, :, time : time + 1], value[:, :, u] - change[:, :, u]]
    parts.append(change[:, :, u])
    whole = np.concatenate(parts, axis=2)
    pattern = np.any(whole != 0.0, axis=0)
    used = pattern.any(axis=0)
    if np.mean(pattern[:, used]) > _DENSE:
        pattern[:, used] = True
    return Tables(pattern, np.ascontiguousarray(whole.transpose(0, 2, 1)[:, pattern.T]))


@lru_cache(maxsize=KEPT)
def advance_flow(flat: FlatModel, pattern: bytes, capacity: int) -> ca.Function:
    """A step whose p is followed by ``capacity`` tables; data[table] chooses one of them."""
    layout, n_p = Layout(flat), len(flat.parameters)
    n_x, _, n_z = layout.sizes
    where = np.frombuffer(pattern, dtype=bool).reshape(n_x, -1)
    used = np.flatnonzero(where.any(axis=0))
    columns, rows = np.nonzero(where[:, used].T)
    size = len(rows)
    sparsity = ca.Sparsity.triplet(n_x, len(used), rows.tolist(), columns.tolist())

    def body(state: ca.SX, data: ca.SX, p: ca.SX) -> Results:
        if capacity == 1:
            entries = cut(p, slice(n_p, None))
        else:
            all_tables: Any = p[n_p:]  # casadi's types do not know indices that are computed
            entries = all_tables.get_nz(False, ca.Slice(0, size), size * data[layout.table])
        x, z = cut(state, slice(n_x)), cut(state, slice(layout.state - n_z, None))
        begin, end = cut(data, layout.input(0)), cut(data, layout.input(2))
        known = ca.vertcat(x, z, 1.0, data[0], begin, end)[used.tolist()]
        after = ca.mtimes(type(state)(sparsity, entries), known)
        s, given = cut(state, slice(n_x, layout.state - n_z)), cut(p, slice(n_p))
        return (ca.vertcat(after, s, renewed(flat, data[0] + data[1], after, end, given, z)),)

    return compose("pf_flow", [layout.state, layout.data, n_p + capacity * size], body, SYMBOLS[1:])


def runs_in_numpy(flat: FlatModel) -> bool:
    """Whether nothing but the flow happens from time to time."""
    return is_flow(flat) and not flat.tasks and not flat.loops


def run_flow(flat: FlatModel, run: Run, limits: Budget, progress: bool) -> Outcome:
    """Such a run, time by time."""
    times, n = run.times, len(flat.states)
    given = np.column_stack([np.ones(len(times)), times, run.inputs])
    x = np.empty((len(times), n))
    x[0] = run.start
    steps = len(times) - 1
    lengths, index = step_lengths(np.diff(times), times) if steps else (np.zeros(0), np.zeros(0, np.intp))
    chunk = _CHUNK if len(lengths) <= _FEW_LENGTHS else max(1, min(_CHUNK, _AT_ONCE // n**2))
    failed_at, message = np.inf, ""
    with progress_bar(run, progress) as bar:
        for start in range(0, steps, chunk):
            rows = np.arange(start, min(start + chunk, steps))
            granted, refusal = limits.grant(len(rows))
            rows = rows[:granted]
            if refusal:
                failed_at = float(times[start + granted])
                x[start + granted + 1 :] = np.nan
                message = (
                    f"{refusal} at t = {failed_at:.9g} s: fewer times need fewer, "
                    "max_steps and time_limit in limits= allow more"
                )
            used, which = np.unique(index[rows], return_inverse=True)
            matrices = transitions(flat, run.parameters, lengths[used])
            _push(x, given, matrices, which, rows, run.interpolation == "hold")
            with np.errstate(over="ignore", invalid="ignore"):
                powers = [one.power for one in matrices]
                if len(powers) == 1 and isinstance(powers[0], np.ndarray) and n <= _SMALL and len(rows):
                    _march(x[rows[0] : rows[-1] + 2], powers[0])
                else:
                    for k, part in zip(rows.tolist(), which.tolist(), strict=True):
                        x[k + 1] += powers[part] @ x[k]
            bad = rows[~np.isfinite(x[rows + 1]).all(axis=1)] + 1
            if len(bad):
                failed_at = float(times[bad[0]])
                x[bad[0] :] = np.nan
                message = diverged(flat, x, failed_at)
            if message:
                break
            bar.update(float(times[rows[-1] + 1] - bar.n - times[0]))
    return Outcome(x, _outputs(flat, run, x, given), steps, message, failed_at)


def _march(x: FloatArray, power: FloatArray) -> None:
    """x[k + 1] += P x[k] in turn: within blocks from 0, then from block to block, then what each begins with."""
    steps, n = len(x) - 1, x.shape[1]
    size = max(int(np.sqrt(steps)), 1)
    blocks = steps // size
    parts = x[1 : 1 + blocks * size].reshape(blocks, size, n)
    across = power.T
    for j in range(1, size):
        parts[:, j] += parts[:, j - 1] @ across
    over = np.linalg.matrix_power(power, size)
    begin = np.empty((blocks, n))
    begin[0] = x[0]
    for block in range(1, blocks):
        begin[block] = over @ begin[block - 1] + parts[block - 1, -1]
    for j in range(size):
        begin = begin @ across
        parts[:, j] += begin
    for k in range(blocks * size, steps):
        x[k + 1] += power @ x[k]


def _push(
    x: FloatArray, given: FloatArray, matrices: list[Transition], which: NDArray[np.intp], rows: NDArray[np.intp],
    held: bool,
) -> None:  # fmt: skip
    """x[k + 1] = h phi_1 B w + h phi_2 B (w+ - w) for all rows k."""
    width = given.shape[1]
    order = np.argsort(which, kind="stable")
    for part, here in enumerate(np.split(rows[order], np.cumsum(np.bincount(which))[:-1])):
        after = given[here + 1].copy()
        if held:
            after[:, 2:] = given[here, 2:]
        _, value, change = matrices[part]
        x[here + 1] = given[here] @ value[:, :width].T + (after - given[here]) @ change[:, :width].T


def _outputs(flat: FlatModel, run: Run, x: FloatArray, given: FloatArray) -> FloatArray:
    if not _has_affine_outputs(flat):
        return outputs_at(
            flat, run, x, np.zeros((len(x), len(flat.held))), np.asarray(np.isfinite(x).all(axis=1))
        )
    C, D = _output_matrices(flat, run.parameters.tobytes())
    return x @ C.T + given @ D.T


@lru_cache(maxsize=KEPT)
def _has_affine_outputs(flat: FlatModel) -> bool:
    return flat.matrices is not None or is_affine(flat.output, (0, 1, 2))


@lru_cache(maxsize=_KEPT_MATRICES)
def _output_matrices(flat: FlatModel, parameters: bytes) -> tuple[FloatArray, FloatArray]:
    if flat.matrices is not None:
        return flat.matrices[2], _by_input(flat.matrices[3])
    return affine_part(flat.output, np.frombuffer(parameters))
