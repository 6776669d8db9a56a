"""How long the steps of a run may be where nobody says it."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_array

from ..diagram import FlatModel
from ..diagram.fixed_step import fastest_modes, state_jacobian
from .arguments import Run
from .steps import start_state

__all__ = ["default_step"]

# h times the fastest pole. RK4 is stable up to 2.78; here it errs by (0.2)^4 / 120 of a mode for each of its time
# constants, 1.3e-5.
_REACH = 0.2


def default_step(flat: FlatModel, run: Run) -> float | None:
    """A fifth of the shortest time constant at the start of the run; None where there is none."""
    if not flat.states:
        return None
    held = start_state(flat, run.start)[len(run.start) :]
    z = held[len(held) - len(flat.held) :]
    values = state_jacobian(flat)(run.times[0], run.start, run.inputs[0], run.parameters, z)
    rows, columns = (np.array(part, dtype=np.intp) for part in values.sparsity().get_triplet())
    entries = np.array(values.nonzeros(), dtype=float)
    matrix = csc_array((entries, (rows, columns)), shape=(len(flat.states),) * 2)
    if not np.all(np.isfinite(entries)):
        return None
    radius = float(np.abs(fastest_modes(matrix)[0]).max())
    return _REACH / radius if radius > 0.0 else None
