"""Which filter is better than the paper's: variants on walks that are kept apart for the choice.

The policies are those trained with the paper's filter. The phases lie between those of the test, terrains have seeds of
their own. Score: the mean over columns (velocity errors over the command; pushes and terrains as part that failed).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from phyfilter_ctl.controllers.joint_torque import AntiWindup
from phyfilter_ctl.study import Report, silent

from .comparison import Plan, Scores, score
from .evaluation import phases
from .learned import learn_filter
from .loop import FilterChoice, paper_filter
from .methods import IMPROVED, SEEDS, Method
from .params import params

__all__ = ["CANDIDATES", "Candidate", "choose", "figures", "steps", "table"]


@dataclass(frozen=True)
class Candidate:
    """A variant and what it scored.

    Attributes
    ----------
    label : str
    choice : FilterChoice, optional
    columns : dict
        Parts of the command, and parts that failed.
    """

    label: str
    choice: FilterChoice | None
    columns: dict[str, float]

    @property
    def score(self) -> float:
        """Mean of the columns; less is better."""
        return float(np.mean(list(self.columns.values())))


# Seconds in which f_hat is taken from the motors, and given back.
_FADE = (0.05, 0.5)


def _gated(
    a0: float,
    limit: float = 20.0,
    *,
    fade: tuple[float, float] = (0.0, 0.0),
    windup: AntiWindup = "clamp",
) -> FilterChoice:
    return FilterChoice((a0,), limit=limit, anti_windup=windup, gate="tilt", gate_action="scale", fade=fade)


CANDIDATES: dict[str, FilterChoice | None] = {
    "no filter": None,
    "the paper's: order 1, a0 = 1": paper_filter(),
    "a0 = 2": FilterChoice((2.0,)),
    "a0 = 4": FilterChoice((4.0,)),
    "a0 = 6": FilterChoice((6.0,)),
    "a0 = 4, limit 8 N m": FilterChoice((4.0,), limit=8.0),
    "a0 = 4, residual limited to 8 N m": FilterChoice((4.0,), limit=8.0, anti_windup="residual"),
    "a0 = 4, leak 0.5 rad/s": FilterChoice((4.0,), leak=0.5),
    "a0 = 4, 80 % of f_hat used": FilterChoice((4.0,), gain=0.8),
    "a0 = 4, foot in the air: f_hat stays": FilterChoice((4.0,), gate="contact"),
    "a0 = 4, foot in the air: f_hat dies": FilterChoice((4.0,), gate="contact", gate_action="scale"),
    "a0 = 4, trunk not calm: f_hat stays": FilterChoice((4.0,), gate="tilt"),
    "a0 = 2, trunk not calm: f_hat dies": _gated(2.0),
    "a0 = 3, trunk not calm: f_hat dies": _gated(3.0),
    "a0 = 4, trunk not calm: f_hat dies": _gated(4.0),
    "the same, limit 8 N m": _gated(4.0, limit=8.0),
    "residual 8 N m, trunk not calm: dies": _gated(4.0, 8.0, windup="residual"),
    "residual 8 N m, trunk not calm: fades": _gated(4.0, 8.0, fade=_FADE, windup="residual"),
    "a0 = 2, trunk not calm: fades in 50 ms": _gated(2.0, fade=_FADE),
    "a0 = 3, trunk not calm: fades in 50 ms": _gated(3.0, fade=_FADE),
    "a0 = 4, trunk not calm: fades in 50 ms": _gated(4.0, fade=_FADE),
    "the same, limit of 8 N m": _gated(4.0, 8.0, fade=_FADE),
    "order 2, a = (16, 8)": FilterChoice((16.0, 8.0)),
    "order 2, type 2, a = b = (4, 4)": FilterChoice((4.0, 4.0), (4.0, 4.0)),
    "band-pass 0.1 to 4 rad/s": FilterChoice((0.4, 4.1), (0.0, 4.0)),
}


def plan(*, quick: bool = False) -> Plan:
    """The validation walks.

    Parameters
    ----------
    quick : bool
        One policy and few walks.
    """
    return Plan(
        methods=("filter",),
        seeds=SEEDS[:1] if quick else SEEDS,
        phases=2 if quick else params().test.phases,
        payloads=(0.0, 0.6) if quick else (0.0, 0.3, 0.6),
        speeds=(0.5,) if quick else (0.5, 1.5, 2.0),
        difficulties=(0.4,) if quick else (0.3, 0.7),
        duration=params().test.duration,
        terrains=("rough",) if quick else ("rough", "wave"),
    )


def steps() -> int:
    """How often :func:`choose` reports."""
    return -(-(len(CANDIDATES) + 2) // _TOGETHER)


def choose(*, quick: bool = False, report: Report = silent, threads: int = 2) -> list[Candidate]:
    """Score every variant.

    Parameters
    ----------
    quick : bool
    report : callable
        Told of every variant.
    threads : int
        Of the simulator.

    Returns
    -------
    list of Candidate
        The best first.
    """
    wanted = plan(quick=quick)
    starts = phases(validation=True, count=wanted.phases)
    found = []
    everyone = {label: Method(label, "filter", choice) for label, choice in CANDIDATES.items()}
    everyone[BASE] = Method(BASE, "base", None)
    learned = learn_filter()
    label = f"learned from logs, a0 = {learned.choice.a[0]:.0f}"
    everyone[label] = Method(label, "filter", learned.choice)
    names = list(everyone)
    for labels in (names[k : k + _TOGETHER] for k in range(0, len(names), _TOGETHER)):
        methods = {label: everyone[label] for label in labels}
        report(labels[0])
        scores = score(methods, wanted, starts=starts, terrain_seed=_TERRAIN_SEED, threads=threads)
        found += [
            Candidate(label, everyone[label].choice, _columns(wanted, scores[label])) for label in labels
        ]
    return sorted(found, key=lambda entry: entry.score)


def _columns(wanted: Plan, result: Scores) -> dict[str, float]:
    errors = {
        f"payload {100 * part:.0f} %": float(value.mean())
        for part, value in zip(wanted.payloads, result.payload, strict=True)
    }
    errors |= {
        f"{speed:g} m/s": float(value.mean()) / speed
        for speed, value in zip(wanted.speeds, result.speed, strict=True)
    }
    errors |= {
        "weak motors": float(result.strength[0].mean()),
        "weak, loaded": float(result.strength[1].mean()),
        "push": 1.0 - float(result.push.mean()),
    }
    errors |= {kind: 1.0 - float(values.mean()) for kind, values in result.terrain.items()}
    return errors


_TERRAIN_SEED = 1
# The yardstick: no column should be worse than without any filter, in training or test.
BASE = "base policy, no filter"
# Columns that are worse by less than this are as good: one walk of 24.
_ONE_WALK = 0.045
# Variants that walk in one batch.
_TOGETHER = 5


def table(found: Sequence[Candidate]) -> str:
    """The variants, the best first.

    Parameters
    ----------
    found : sequence of Candidate
    """
    names = list(found[0].columns)
    lines = [
        "variants of the filter on validation walks, policies trained with the paper's; velocity errors as part of the",
        "command, push and terrains as part that failed",
        "",
        f"{'':<40}{'score':>7}{'worse':>7}" + "".join(f"{_short(name):>9}" for name in names),
    ]
    worse = _worse(found)
    for entry in found:
        mark = " *" if entry.choice == IMPROVED else ""
        cells = "".join(f"{entry.columns[name]:>9.2f}" for name in names)
        lines.append(f"{entry.label + mark:<40}{entry.score:>7.3f}{worse[entry.label]:>7}{cells}")
    lines += [
        "",
        "worse: columns that are worse than the base policy's by one walk or more; chosen: the least score among those",
        "with none (*: the improved filter of the comparison)",
    ]
    return "\n".join(lines)


def _worse(found: Sequence[Candidate]) -> dict[str, int]:
    base = next(entry.columns for entry in found if entry.label == BASE)
    return {
        entry.label: sum(value > base[name] + _ONE_WALK for name, value in entry.columns.items())
        for entry in found
    }


def _short(name: str) -> str:
    return name.replace("payload ", "+").replace("weak motors", "weak").replace("weak, loaded", "weak+")


def figures(found: Sequence[Candidate]) -> dict[str, object]:
    """The content of the JSON file.

    Parameters
    ----------
    found : sequence of Candidate
    """
    return {entry.label: {"score": entry.score, **entry.columns} for entry in found}
