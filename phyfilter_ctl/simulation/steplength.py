"""How long the steps of a run may be where nobody says it."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import ArpackError, eigs

from ..diagram import FlatModel
from .arguments import Run
from .exponential import linear_part
from .steps import KEPT, start_state

__all__ = ["default_step"]

# h times the fastest pole. RK4 is stable up to 2.78; here it errs by (0.2)^4 / 120 of a mode for each of its time
# constants, 1.3e-5.
_REACH = 0.2
# Beyond this many states a few eigenvalues are sought instead of all.
_MANY = 250


def default_step(flat: FlatModel, run: Run, *, without_linear: bool) -> float | None:
    """A fifth of the shortest time constant at the start of the run; None where there is none.

    ``without_linear`` leaves out what the exponential method integrates exactly.
    """
    if not flat.states or (without_linear and linear_part(flat).complete):
        return None
    held = start_state(flat, run.start)[len(run.start) :]
    z = held[len(held) - len(flat.held) :]
    values = _jacobian(flat)(run.times[0], run.start, run.inputs[0], run.parameters, z)
    rows, columns = (np.array(part, dtype=np.intp) for part in values.sparsity().get_triplet())
    entries = np.array(values.nonzeros(), dtype=float)
    if without_linear:
        part = linear_part(flat)
        known = set(zip(part.rows.tolist(), part.columns.tolist(), strict=True))
        kept = [pair not in known for pair in zip(rows.tolist(), columns.tolist(), strict=True)]
        rows, columns, entries = rows[kept], columns[kept], entries[kept]
    matrix = csc_array((entries, (rows, columns)), shape=(len(flat.states),) * 2)
    if not np.all(np.isfinite(entries)):
        return None
    radius = _radius(matrix, len(flat.states))
    return _REACH / radius if radius > 0.0 else None


@lru_cache(maxsize=KEPT)
def _jacobian(flat: FlatModel) -> ca.Function:
    symbols = [ca.MX.sym(name, flat.dynamics.size1_in(i)) for i, name in enumerate("txupz")]
    return ca.Function("jacobian", symbols, [ca.jacobian(flat.dynamics(*symbols), symbols[1])])


def _radius(matrix: csc_array, n: int) -> float:
    """Greatest absolute eigenvalue."""
    if n <= _MANY:
        return float(np.abs(np.linalg.eigvals(matrix.toarray())).max())
    try:
        found = eigs(matrix, k=1, which="LM", v0=np.ones(n), return_eigenvectors=False)
        return float(np.abs(np.asarray(found)).max())
    except (ArpackError, RuntimeError):
        return float(abs(matrix).sum(axis=0).max())  # a norm bounds it
