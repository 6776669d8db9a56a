"""The adaptive rival and the filter, both put on policies that were trained without: numbers of equal right.

As many variants of each, on the same walks: base policies of the first two seeds only, and payloads, speeds, weak
motors, pushes and grounds that the table of ``robustness`` does not have, from phases between its own. Score: the
velocity error as part of the command, a fall counting as 1, mean over conditions, policies and walks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from phyfilter_ctl.study import Report, silent

from .adaptive import AdaptiveChoice
from .evaluation import Case
from .loop import FilterChoice, paper_filter
from .methods import RIVAL, TUNED
from .params import params
from .policy import Policy
from .robustness import Arm, Condition, Judged, judge
from .terrain import Kind, Terrain

__all__ = ["FILTERS", "RIVALS", "conditions", "figures", "scores", "table", "tune"]

# How many policies the choice sees: the first ones.
_SEEN = 2
# Of grounds, beyond those of every table.
_GROUND = 100

_OMITTED: dict[str, FilterChoice] = {
    "a0 = 0.3": FilterChoice((0.3,)),
    "a0 = 1, the paper's": paper_filter(),
    "a0 = 2": FilterChoice((2.0,)),
    "a0 = 4": FilterChoice((4.0,)),
    "a0 = 1, limit 8 N m": FilterChoice((1.0,), limit=8.0),
    "a0 = 1, limit 4 N m": FilterChoice((1.0,), limit=4.0),
    "a0 = 1, leak 1 rad/s": FilterChoice((1.0,), leak=1.0),
    "a0 = 1, half of f_hat used": FilterChoice((1.0,), gain=0.5),
    "a0 = 1, residual limited to 8 N m": FilterChoice((1.0,), limit=8.0, anti_windup="residual"),
    "a0 = 1, dies while not calm": FilterChoice((1.0,), gate="tilt", gate_action="scale"),
    "a0 = 4, residual 8 N m, dies": FilterChoice(
        (4.0,), limit=8.0, anti_windup="residual", gate="tilt", gate_action="scale"
    ),
    "order 2, a = (4, 4)": FilterChoice((4.0, 4.0)),
}
# Contact left out of g, and estimated.
FILTERS: dict[str, FilterChoice] = {
    f"{label}, contact {contact}": replace(choice, contact=contact)
    for contact in ("omitted", "estimated")
    for label, choice in _OMITTED.items()
}
RIVALS: dict[str, AdaptiveChoice] = {
    **{f"rate {rate:g}": AdaptiveChoice(rate) for rate in (0.3, 1.0, 2.0, 4.0, 10.0)},
    **{f"rate {rate:g}, mix 0.2": AdaptiveChoice(rate, mix=0.2) for rate in (0.3, 1.0, 4.0)},
    **{f"rate {rate:g}, mix 1": AdaptiveChoice(rate, mix=1.0) for rate in (0.3, 1.0)},
    **{f"rate {rate:g}, leak 0.5 rad/s": AdaptiveChoice(rate, leak=0.5) for rate in (1.0, 4.0)},
    **{f"rate {rate:g}, leak 2 rad/s": AdaptiveChoice(rate, leak=2.0) for rate in (1.0, 4.0, 10.0)},
    **{f"rate 1, limit {limit:g} N m": AdaptiveChoice(1.0, limit=limit) for limit in (8.0, 4.0)},
    **{f"rate 4, limit {limit:g} N m": AdaptiveChoice(4.0, limit=limit) for limit in (8.0, 4.0)},
    "rate 1, corner 5 rad/s": AdaptiveChoice(1.0, corner=5.0),
    "rate 1, corner 100 rad/s": AdaptiveChoice(1.0, corner=100.0),
    "rate 4, corner 100 rad/s": AdaptiveChoice(4.0, corner=100.0),
    "rate 1, mix 0.2, limit 8 N m": AdaptiveChoice(1.0, mix=0.2, limit=8.0),
    "rate 1, no contact": AdaptiveChoice(1.0, contact=False),
}
_NOTHING = "no filter"


def conditions(robot: str, *, quick: bool = False) -> tuple[Condition, ...]:
    """What is walked: nothing of the table that is judged later.

    Parameters
    ----------
    robot : str
        Of ``params.ROBOTS``.
    quick : bool
        Two of them.
    """
    weight = params(robot).robot.mass

    def flat(label: str, part: float, speed: float, **rest: float) -> Condition:
        return Condition(label, Case(part * weight, speed, robot=robot, **rest))  # pyright: ignore[reportArgumentType]

    walks = (
        flat("+20 %", 0.2, 1.0),
        flat("+50 %", 0.5, 1.0),
        flat("+40 %, 1.2", 0.4, 1.2),
        flat("1.75 m/s", 0.0, 1.75),
        flat("2.2 m/s", 0.0, 2.2),
        flat("weak 80 %", 0.2, 1.0, strength=0.8),
        flat("50 N", 0.0, 1.0, push=50.0),
    )
    kinds: tuple[Kind, ...] = ("rough", "wave", "gravel")
    grounds = tuple(
        Condition(f"{kind} 0.3", Case(speed=0.8, robot=robot), Terrain(kind, 0.3, _GROUND)) for kind in kinds
    )
    return (walks[1], grounds[0]) if quick else (*walks, *grounds)


def tune(
    policies: Sequence[Policy], *, quick: bool = False, report: Report = silent, threads: int = 2
) -> Judged:
    """Let every variant walk.

    Parameters
    ----------
    policies : sequence of Policy
        Trained without a filter; the first two are used.
    quick : bool
        Few conditions, short walks.
    report : callable
        Told of every ground.
    threads : int
        Of the simulator.
    """
    arms = {
        label: Arm(label, "base", choice) for label, choice in ({_NOTHING: None} | FILTERS | RIVALS).items()
    }
    return judge(
        {"base": policies[:_SEEN]},
        conditions(policies[0].robot, quick=quick),
        arms=arms,
        starts=1 if quick else 2,
        validation=True,
        duration=1.0 if quick else 6.0,
        report=report,
        threads=threads,
    )


def scores(judged: Judged) -> dict[str, dict[str, float]]:
    """Velocity error as part of the command, by variant and condition, and the mean as "score".

    Parameters
    ----------
    judged : Judged
        Of :func:`tune`.
    """
    speed = {entry.label: entry.case.speed for entry in conditions(judged.robot)}
    found: dict[str, dict[str, float]] = {}
    for (label, name), values in judged.values.items():
        found.setdefault(name, {})[label] = float(values["error"].mean()) / speed[label]
    return {name: {"score": float(np.mean(list(row.values()))), **row} for name, row in found.items()}


def table(judged: Judged) -> str:
    """The variants of each kind, the best first.

    Parameters
    ----------
    judged : Judged
    """
    found = scores(judged)
    columns = list(found[_NOTHING])
    head = (
        f"{judged.robot}, base policies of seeds {', '.join(map(str, judged.seeds))}, {judged.steps['base']} steps: "
        "velocity error as part of the command, falls count as 1"
    )
    lines = [head, "", f"{'':<52}" + "".join(f"{name:>12}" for name in columns)]
    kinds: Sequence[tuple[str, Mapping[str, FilterChoice | AdaptiveChoice | None]]] = (
        ("", {_NOTHING: None}),
        ("filter put on", FILTERS),
        ("adaptive rival", RIVALS),
    )
    for title, entries in kinds:
        lines += ["", title] if title else []
        for name in sorted(entries, key=lambda label: found[label]["score"]):
            mark = " *" if entries[name] in (RIVAL, TUNED) else ""
            lines.append(
                f"{name + mark:<52}" + "".join(f"{found[name][column]:>12.3f}" for column in columns)
            )
    return "\n".join([*lines, "", f"*: the arms of the table; {len(FILTERS)} filters, {len(RIVALS)} rivals"])


def figures(judged: Judged) -> dict[str, object]:
    """The content of the JSON file.

    Parameters
    ----------
    judged : Judged
    """
    return {"seeds": list(judged.seeds), "steps": judged.steps["base"], "variants": scores(judged)}
