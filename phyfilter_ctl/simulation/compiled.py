"""Runs of compiled C."""

from __future__ import annotations

from functools import lru_cache
from typing import Literal

import numpy as np
from tqdm import tqdm

from ..codegen import CompiledModel, CompilerError, compile_model
from ..diagram import FlatModel
from ..diagram.discrete import as_sampled
from .arguments import Run
from .limits import Budget
from .response import Outcome
from .steps import KEPT, start_state
from .vm import chattering_from

__all__ = ["compiles", "run_compiled"]

# Statuses of a run that was not going to end.
_GIVEN_UP = (3, 4, 101)
_WAY_OUT = "max_steps and time_limit in limits= allow more; for a stiff diagram try method='stiff'"


def compiles(flat: FlatModel) -> bool:
    """Compile a model, or find that there is no compiler, or no C code for a part of it."""
    try:
        _compiled(flat)
    except (CompilerError, ValueError):
        return False
    return True


@lru_cache(maxsize=KEPT)
def _compiled(flat: FlatModel) -> CompiledModel:
    return compile_model(as_sampled(flat))


def run_compiled(
    flat: FlatModel,
    run: Run,
    *,
    method: Literal["rk4", "adaptive"],
    max_step: float | None,
    rtol: float,
    atol: float,
    limits: Budget,
    progress: bool,
) -> Outcome:
    """A run in one call of C."""
    try:
        model = _compiled(flat)
    except CompilerError as error:
        raise CompilerError(f"{error}; or simulate with backend='vm', which needs none") from error
    discrete = flat.dt > 0.0
    with tqdm(total=len(run.times), disable=not progress, unit="row", desc="simulated") as bar:

        def show(rows: int) -> None:
            bar.update(rows - bar.n)

        answer = model.simulate(
            run.times,
            run.inputs if flat.inputs else None,
            initial_state=None if discrete else run.start,
            sampled_state=start_state(flat, run.start) if discrete else None,
            params={v.name: float(p) for v, p in zip(flat.parameters, run.parameters, strict=True)},
            method=method,
            max_step=max_step,
            rtol=rtol,
            atol=atol,
            interpolation=run.interpolation,
            progress=show if progress else None,
            limits={"max_steps": limits.steps, "time_limit": limits.seconds},
        )
    # A sampled law has advanced its states when a row is filled; a discrete diagram records them before.
    states = (
        np.vstack([run.start, answer.sampled_states[:-1, : len(run.start)]]) if discrete else answer.states
    )
    message = "" if answer.success else answer.message
    if answer.status in _GIVEN_UP and not discrete:
        message += f"; {chattering_from(flat, run, answer.t_reached, answer.last_state) or _WAY_OUT}"
    failed_at = np.inf if answer.success else answer.t_reached
    return Outcome(states, answer.outputs, 0, message, failed_at)
