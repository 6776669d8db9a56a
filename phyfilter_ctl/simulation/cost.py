"""How long a run will take in the virtual machine, in C and in numpy: which of them ``backend="auto"`` takes.

A fixed rule: its rates were measured once, and the same call takes the same backend wherever there is a compiler.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..diagram import FlatModel
from .arguments import Run
from .steps import has_common_parts

__all__ = ["Cost", "expected_cost", "operations"]

# Seconds of a scalar operation of the virtual machine; what follows is in such operations.
_OPERATION = 1.35e-9
# The functions of a step with error control, at all and for each operation of the diagram, with the search for common
# parts and without; those of a fixed step.
_MAKING, _MAKING_EACH, _MAKING_APART, _FIXED_MAKING = 11e6, 250e3, 30e3, 0.25
# Evaluations of a step of order 8, and its handling in Python.
_STAGES, _OVERHEAD = 15.0, 12e3
_COMPILE, _COMPILE_EACH = 0.22e9, 75e3
# Order 5 takes four times as many steps at the default rtol.
_C_STAGES, _C_OPERATION, _C_ROW = 7.0 * 4.0, 0.25, 1.5e3
# Steps of order 8 per radian of the fastest mode, at the default rtol.
_STEPS_PER_RADIAN = 0.5
# And radians of it in a step of fixed length, which takes four evaluations and one of the outputs.
_RADIANS, _FIXED_STAGES = 0.2, 5.0


class Cost(NamedTuple):
    """Predicted seconds of a run or a batch.

    Attributes
    ----------
    vm, c : float
        The latter with compilation.
    steps : float
        Expected of one run.
    """

    vm: float
    c: float
    steps: float

    def explained(self, backend: str) -> str:
        """Why one of them was taken."""
        return f"{backend}: about {self.steps:.2g} steps a run, predicted {self.vm:.2g} s in the virtual machine and " \
               f"{self.c:.2g} s in C with its compilation"  # fmt: skip


def operations(flat: FlatModel) -> float:
    """Of one evaluation of a diagram, its sampled blocks included; infinite where they cannot be counted."""
    functions = [flat.dynamics, flat.output, *(task.signals for task in flat.tasks)]
    functions += [f for task in flat.tasks for f in (task.law.dynamics, task.law.output)]
    if not all(function.is_a("SXFunction") for function in functions):
        return np.inf
    return float(sum(function.n_instructions() for function in functions))


def expected_cost(
    flat: FlatModel, run: Run, rate: float, *, fixed: bool, max_step: float | None, runs: int
) -> Cost:
    """Seconds that a run, or several like it, will take.

    Parameters
    ----------
    flat : FlatModel
    run : Run
    rate : float
        Of the fastest mode at the start, rad/s.
    fixed : bool
        Steps of fixed length.
    max_step : float or None
    runs : int
    """
    length = float(run.times[-1] - run.times[0])
    instants = sum(length / task.period for task in flat.tasks)
    steps = max(_STEPS_PER_RADIAN * rate * length, instants + _kinks(run), 1.0)
    if max_step is not None:
        steps = max(steps, length / max_step)
    rows = float(len(run.times))
    if flat.dt > 0.0:
        steps = rows
    elif fixed and max_step is None:
        steps = max(rate * length / _RADIANS, instants + rows)
    each = operations(flat)
    if not np.isfinite(each):
        each = 1e3  # instructions of unknown size
    made = _FIXED_MAKING if fixed else 1.0
    once = steps * (_FIXED_STAGES * each if fixed else _STAGES * each + _OVERHEAD)
    making = _MAKING_EACH if has_common_parts(flat) else _MAKING_APART
    vm = made * (_MAKING + making * each) + runs * (once + rows * each)
    c = _COMPILE + _COMPILE_EACH * each
    stages = _FIXED_STAGES if fixed else _C_STAGES
    c += runs * (_C_OPERATION * each * (stages * steps + rows) + rows * _C_ROW)
    return Cost(vm * _OPERATION, c * _OPERATION, steps)


def _kinks(run: Run) -> int:
    """Times at which inputs bend or jump: there an integrator starts anew."""
    if len(run.times) < 3 or not run.inputs.shape[1]:
        return 0
    change = np.diff(run.inputs, axis=0)
    if run.interpolation == "hold":
        return int(np.count_nonzero(np.any(change != 0.0, axis=1)))
    slopes = change / np.diff(run.times)[:, None]
    bend = np.abs(np.diff(slopes, axis=0)) * np.diff(run.times)[1:, None]
    size = np.abs(run.inputs).max(axis=0)
    return int(np.count_nonzero(np.any(bend > 1e-12 * (size + 1e-300), axis=1)))
