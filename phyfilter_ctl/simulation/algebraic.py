"""What became of a diagram's nonlinear algebraic loops in a run: branches that end, and loops without a solution."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from .._sections import FloatArray
from ..diagram import FlatModel
from .arguments import Run
from .chains import Chain
from .steps import KEPT, SYMBOLS, cut, renewed

__all__ = ["jumps", "unsolved"]

# Changes between two times that are smaller, relative to the size, are not looked into; and not more than the largest.
_LARGE = 1e-2
_MOST = 20
# Halvings of an interval: a change that goes with the square or cube root of time shrinks by 1e6 or 1e4.
_HALVINGS = 40
_JUMP = 0.1  # of the change, left after that


@lru_cache(maxsize=KEPT)
def _follow(flat: FlatModel) -> ca.Function:
    """(z, (t, x, u), p) -> z with the loops solved from where they stood, twice."""
    MX = SYMBOLS[1]
    n_x, n_u = len(flat.states), len(flat.inputs)
    z, data, p = MX.sym("z", len(flat.held)), MX.sym("data", 1 + n_x + n_u), MX.sym("p", len(flat.parameters))
    x, u = cut(data, slice(1, 1 + n_x)), cut(data, slice(1 + n_x, None))
    after = renewed(flat, data[0], x, u, p, z)
    return ca.Function("pf_follow", [z, data, p], [after, after])


def _start(flat: FlatModel) -> FloatArray:
    return np.array([variable.start for variable in flat.held])


def jumps(flat: FlatModel, run: Run, x: FloatArray) -> tuple[str, ...]:
    """Where a loop's solution ended and the run went on from another, as sentences.

    Diagrams with sampled blocks are not looked at: what those hold is not recorded.
    """
    known = int(np.argmin(np.append(np.isfinite(x).all(axis=1), False)))
    if not flat.loops or flat.tasks or known < 2:
        return ()
    data = np.column_stack([run.times[:known, None], x[:known], run.inputs[:known]])
    w = Chain(_follow(flat), _start(flat), run.parameters).run(data)
    found = []
    for loop in flat.loops:
        change = np.max(np.abs(np.diff(w[:, loop.held], axis=0)), axis=1)
        size = 1.0 + np.max(np.abs(w[:-1, loop.held]), axis=1)
        largest = np.argsort(-change / size)[:_MOST]
        for k in sorted(int(k) for k in largest if change[k] > _LARGE * size[k]):
            time = _discontinuity(flat, run, data[k : k + 2], w[k], w[k + 1], loop.held)
            if time is not None:
                names = ", ".join(variable.name for variable in flat.held[loop.held])
                before, after = (", ".join(f"{v:.6g}" for v in row[loop.held]) for row in (w[k], w[k + 1]))
                found.append(
                    f"algebraic loop {loop.path}: the branch of solutions that the run followed ends at "
                    f"t = {time:.9g} s; it goes on from another one, {names} = {before} becoming {after}"
                )
                break
    return tuple(found)


def _discontinuity(
    flat: FlatModel, run: Run, ends: FloatArray, w: FloatArray, w_next: FloatArray, part: slice
) -> float | None:
    """Time of a jump between two rows; None where the solution gets from one to the other without."""
    low, high = ends[0], ends[1]
    whole = np.max(np.abs(w_next[part] - w[part]))
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        between = Chain(_follow(flat), w, run.parameters).run(middle[None])[0]
        if np.max(np.abs(between[part] - w[part])) >= np.max(np.abs(w_next[part] - between[part])):
            high, w_next = middle, between
        else:
            low, w = middle, between
    left = np.max(np.abs(w_next[part] - w[part]))
    return float(high[0]) if left > _JUMP * whole else None


def unsolved(flat: FlatModel, run: Run, x: FloatArray, failed_at: float) -> str:
    """Loops for which no solution is found where a run failed, as the end of its message; "" where all have one.

    With sampled blocks, whose outputs are not recorded, all loops are named.
    """
    if not flat.loops:
        return ""
    paths = " and ".join(loop.path for loop in flat.loops)
    if flat.tasks or not np.isfinite(failed_at):
        return f"; its algebraic loops: {paths}"
    good = np.asarray(np.isfinite(x).all(axis=1), dtype=bool)
    known = int(np.argmin(np.append(good & (run.times < failed_at), False)))
    data = np.column_stack([run.times[:known, None], x[:known], run.inputs[:known]])
    w = Chain(_follow(flat), _start(flat), run.parameters).run(data)[-1] if known else _start(flat)
    last, here = max(known - 1, 0), min(known, len(x) - 1)
    states = [x[last] if known else run.start, *([x[here]] if good[here] else [])]
    left, right = run.inputs[last], run.inputs[here]
    assert flat.unknowns is not None
    missing = []
    for u in (left, 0.5 * (left + right), right):
        slope = np.asarray(
            flat.dynamics(run.times[last], states[0], u, run.parameters, w), dtype=float
        ).ravel()
        ahead = states[0] + (failed_at - run.times[last]) * np.where(np.isfinite(slope), slope, 0.0)
        for state in (*states, ahead):
            value = np.asarray(flat.unknowns(failed_at, state, u, run.parameters, w), dtype=float).ravel()
            missing += [loop.path for loop in flat.loops if not np.isfinite(value[loop.held]).all()]
    names = " and ".join(dict.fromkeys(missing))
    return f"; no solution of algebraic loop {names} was found there" if names else ""
