"""What a run may cost, and who is to blame where it costs more."""

from __future__ import annotations

from dataclasses import dataclass
from time import monotonic
from typing import NoReturn

import numpy as np
from tqdm import tqdm

from .._sections import FloatArray
from ..diagram import FlatModel
from .arguments import Run

__all__ = ["LOOKED_AT", "Budget", "chattering", "diverged", "progress_bar", "steps_allowed"]

# Steps allowed where nobody says it: of error control, and of fixed length; and for each node of the run.
_ADAPTIVE_STEPS, _FIXED_STEPS, _NODE_STEPS = 1_000_000, 100_000_000, 20
# Derivatives of as many steps are looked at for chattering.
LOOKED_AT = 64
# A derivative chatters that goes up and down this often over its range, which is that part of its size, at the cost of
# so many trials a step: those that meet a jump are rejected.
_TURNS, _RANGE, _TRIALS = 8.0, 0.05, 1.2


def steps_allowed(flat: FlatModel, run: Run, max_steps: int | None, adaptive: bool) -> int:
    """Steps of integration that a run may take."""
    if max_steps is not None:
        return max_steps
    length = float(run.times[-1] - run.times[0])
    count = len(run.times) + sum(length / task.period for task in flat.tasks)
    return int((_ADAPTIVE_STEPS if adaptive else _FIXED_STEPS) + _NODE_STEPS * count)


@dataclass(eq=False)
class Budget:
    """Steps and seconds that are left to a run.

    Parameters
    ----------
    steps : int
    seconds : float, optional
        Of this machine's time, from now on.
    """

    steps: int
    seconds: float | None = None

    def __post_init__(self) -> None:
        self.left: int = self.steps
        self._deadline = np.inf if self.seconds is None else monotonic() + self.seconds

    def grant(self, steps: int) -> tuple[int, str]:
        """How many of these steps may be taken, and why not all of them; "" where they may."""
        left = max(self.left, 0)
        refusal = self.spend(steps)
        return (steps if not refusal else min(left, steps) if self.left < 0 else 0), refusal

    def spend(self, steps: int) -> str:
        """Why these steps may not be taken; "" where they may."""
        self.left -= steps
        if self.left < 0:
            return f"the {self.steps} steps allowed (max_steps) are spent"
        if monotonic() >= self._deadline:
            return f"the time limit of {self.seconds:g} s is reached"
        return ""


def chattering(flat: FlatModel, slopes: FloatArray, trials: int) -> str:
    """Which state is driven to and fro, by its derivatives (64, n_x) after successive steps; "" for none."""
    if trials < _TRIALS * LOOKED_AT or not slopes.size or not np.all(np.isfinite(slopes)):
        return ""
    spread = np.ptp(slopes, axis=0)
    turns = np.abs(np.diff(slopes, axis=0)).sum(axis=0) / np.where(spread > 0.0, spread, 1.0)
    size = np.abs(slopes).max(axis=0)
    jumps = np.where(
        (turns >= _TURNS) & (spread > _RANGE * size), spread / np.where(size > 0.0, size, 1.0), 0.0
    )
    if not jumps.any():
        return ""
    i = int(np.argmax(jumps))
    name = flat.states[i].name
    block = name.rpartition(".")[0]
    return (
        f"{f'Block {block} chatters' if block else 'It chatters'}: the derivative of {name} jumps between "
        f"{slopes[:, i].min():.3g} and {slopes[:, i].max():.3g} from step to step, a sliding mode of a switch that "
        "acts on it. Give the switch a boundary layer (x / (abs(x) + eps), a saturation) or hysteresis, or sample it"
    )


def diverged(flat: FlatModel, x: FloatArray, failed_at: float) -> str:
    """What to say of a state that is no longer finite."""
    known = x[np.all(np.isfinite(x), axis=1)]
    which = ""
    if len(known) and known.shape[1]:
        which = f"; the largest state before was {flat.states[int(np.argmax(np.abs(known[-1])))].name}"
    return (
        f"the state is no longer finite at t = {failed_at:.9g} s{which}. Either the diagram is unstable, or the step "
        "is too long for it: try a smaller max_step, method='adaptive', or 'stiff' where fast modes die out"
    )


def progress_bar(run: Run, progress: bool) -> tqdm[NoReturn]:
    """Over the seconds of a run."""
    return tqdm(
        total=float(run.times[-1] - run.times[0]), disable=not progress, unit="s", desc="simulated",
        bar_format="{desc}: {percentage:3.0f}%|{bar}| {n:.1f}/{total:.1f} s [{elapsed}<{remaining}]",
    )  # fmt: skip
