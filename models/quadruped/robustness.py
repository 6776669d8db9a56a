"""How policies of one robot walk under loads, speeds, weak and dead motors, pushes, slopes, stairs, random grounds.

Policies of several trainings with the same seeds are compared seed by seed: every figure is a mean over the walks of
one policy, every interval one over policies, and differences are of the same seed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl.study import Report, median_interval, silent

from .adaptive import AdaptiveChoice
from .evaluation import Case, Group, Outcome, phases, walk
from .kept import Cells, keep
from .loop import FilterChoice, paper_filter
from .methods import IMPROVED, RIVAL, TUNED
from .params import params
from .policy import FOLDER, Policy, load
from .terrain import Kind, Terrain

__all__ = [
    "ARMS",
    "FIGURES",
    "Arm",
    "Condition",
    "Judged",
    "conditions",
    "figures",
    "judge",
    "judge_each",
    "policies",
    "table",
]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Arm:
    """What walks.

    Attributes
    ----------
    label : str
    family : str
        Which training.
    choice : FilterChoice or AdaptiveChoice, optional
        The filter while walking, or the rival; None: none.
    longer : int
        Its training may be as long as the first arm's, or so many times as long.
    """

    label: str
    family: str
    choice: FilterChoice | AdaptiveChoice | None = None
    longer: int = 1


# The first one is what the others are compared with.
ARMS: dict[str, Arm] = {
    "base": Arm("no filter, in training or test", "base"),
    "put_on": Arm("base policies, paper's filter put on, contact left out of g", "base", paper_filter()),
    "put_known": Arm("base policies, paper's filter, true contact in g", "base", paper_filter("known")),
    "put_est": Arm(
        "base policies, paper's filter, estimated contact in g", "base", paper_filter("estimated")
    ),
    "tuned": Arm("base policies, filter put on, tuned beside the rival", "base", TUNED),
    "rival": Arm("base policies, adaptive rival", "base", RIVAL),
    "filter": Arm("trained with the paper's filter, contact left out of g", "filter", paper_filter()),
    "known": Arm("the same policies, true contact in g", "filter", paper_filter("known")),
    "est": Arm("the same policies, estimated contact in g", "filter", paper_filter("estimated")),
    "improved": Arm("the same policies, improved filter", "filter", IMPROVED),
    "off": Arm("the same policies, filter off", "filter"),
    "full": Arm("full domain randomisation, no filter", "basefull", longer=2),
}
# Of an outcome, and how they are printed: what they are, factor, digits.
FIGURES = {
    "fallen": ("falls, %", 100.0, 0),
    "error": ("velocity error |mean v - command|, cm/s", 100.0, 1),
    "ripple": ("ripple of the velocity, cm/s", 100.0, 1),
    "clearance": ("foot clearance, mm", 1000.0, 0),
    "transport": ("cost of transport, positive work", 1.0, 2),
}


@dataclass(frozen=True)
class Condition:
    """One row of the table.

    Attributes
    ----------
    label : str
    case : Case
    ground : Terrain, optional
        None: flat.
    """

    label: str
    case: Case
    ground: Terrain | None = None


def conditions(robot: str, *, quick: bool = False) -> tuple[Condition, ...]:
    """The rows of the table.

    Parameters
    ----------
    robot : str
        Of ``params.ROBOTS``.
    quick : bool
        A few.
    """
    p = params(robot)
    weight, weak = p.robot.mass, p.test.strength

    def flat(label: str, part: float = 0.0, speed: float = 1.0, **rest: object) -> Condition:
        return Condition(label, Case(part * weight, speed, robot=robot, **rest))  # pyright: ignore[reportArgumentType]

    def on(label: str, kind: Kind, difficulty: float, seeds: int = 1, speed: float = 1.0) -> Condition:
        return Condition(label, Case(speed=speed, robot=robot), Terrain(kind, difficulty, count=seeds))

    if quick:
        return flat("nothing"), flat("payload 60 %", 0.6), on("rough 0.3", "rough", 0.3)
    leg = p.robot.joints[:3]
    return (
        *(flat(f"payload {100 * part:.0f} %", part) for part in (0.0, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9)),
        *(flat(f"{speed:g} m/s", speed=speed) for speed in (0.5, 1.5, 2.0, 2.4, 2.83)),
        *(
            flat(f"{100 * part:.0f} %, {v:g} m/s", part, v)
            for part, v in ((0.3, 1.5), (0.3, 2.0), (0.6, 1.5), (0.6, 2.0))
        ),
        *(
            flat(f"motors {100 * weak:.0f} %, payload {100 * part:.0f} %", part, strength=weak)
            for part in (0.0, 0.3, 0.6)
        ),
        *(flat(f"no motor at {name}, 0.5 m/s", speed=0.5, disabled=name) for name in leg),
        *(
            flat(f"push from the {side}", push=p.push.force, push_from=side)
            for side in ("left", "right", "front", "back")
        ),
        *(on(f"up {20 * d:g} degrees, 0.5 m/s", "slope", d, speed=0.5) for d in (0.25, 0.5, 0.75)),
        *(on(f"down {20 * d:g} degrees, 0.5 m/s", "descent", d, speed=0.5) for d in (0.25, 0.5)),
        *(on(f"stairs {rise} cm", "tall", (rise - 6.0) / 11.0) for rise in (6, 10, 14, 17)),
        *(on(f"rough {d:g}, 10 grounds", "rough", d, 10) for d in (0.2, 0.5)),
        *(on(f"wave {d:g}, 10 walks", "wave", d, 10) for d in (0.2, 0.5)),
        *(on(f"gravel {d:g}", "gravel", d, 2) for d in (0.5, 1.0)),
    )


def policies(
    robot: str, *, folder: Path | None = None, families: Sequence[str] | None = None
) -> dict[str, tuple[Policy, ...]]:
    """The policies of each training, seeds that all of them have.

    Parameters
    ----------
    robot : str
    folder : Path, optional
        Of files FAMILY-SEED.json; None: those shipped, which are called ROBOT_FAMILY-SEED.json.
    families : sequence of str, optional
        None: those of ``ARMS``.

    Raises
    ------
    ValueError
        If there is no seed that all trainings have, or policies of another robot or of lengths of training that do
        not compare: all are as long as the first arm's, or a whole training as many times as its arm says.
    """
    if families is None:
        families = list(dict.fromkeys(arm.family for arm in ARMS.values()))
    where, prefix = (folder, "") if folder is not None else (FOLDER, f"{robot}_")
    seeds = {
        family: {int(path.stem.rsplit("-", 1)[1]) for path in where.glob(f"{prefix}{family}-[0-9]*.json")}
        for family in families
    }
    common = sorted(set.intersection(*seeds.values()))
    if not common:
        names = ", ".join(f"{prefix}{family}-0.json" for family in families)
        raise ValueError(
            f"{where}: no seed with policies of all trainings ({names}, ...); train them with run quadruped --train "
            f"--robot {robot}, --filter and --full"
        )
    found = {
        family: tuple(load(where / f"{prefix}{family}-{seed}.json") for seed in common) for family in families
    }
    others = {policy.robot for entries in found.values() for policy in entries} - {robot}
    lengths = {
        family: {int(policy.record["steps"]) for policy in entries} for family, entries in found.items()
    }
    usual = min(lengths[families[0]])
    longer = {arm.family: arm.longer for arm in ARMS.values()}
    alike = all(steps in ({usual}, {usual * longer.get(family, 1)}) for family, steps in lengths.items())
    if others or not alike:
        told = "; ".join(f"{family} {', '.join(map(str, sorted(each)))}" for family, each in lengths.items())
        raise ValueError(
            f"{where}: expected policies of {robot} that trained equally long, or a whole training "
            f"{' or '.join(f'{family} {count} times as long' for family, count in longer.items() if count > 1)}; got "
            f"robots {', '.join(sorted(others | {robot}))}, steps: {told}"
        )
    return found


@dataclass(frozen=True)
class Judged:
    """All walks of all arms.

    Attributes
    ----------
    robot : str
    seeds : tuple of int
        Of the policies.
    steps : dict
        Family to steps of training, each.
    values : dict
        Condition and arm to figure and (policies,) array; nan where all walks of a policy ended in a fall.
    """

    robot: str
    seeds: tuple[int, ...]
    steps: dict[str, int]
    values: Cells = field(default_factory=Cells)


def judge(
    found: Mapping[str, Sequence[Policy]],
    wanted: Sequence[Condition],
    *,
    arms: Mapping[str, Arm] | None = None,
    starts: int = 4,
    validation: bool = False,
    report: Report = silent,
    threads: int = 2,
    duration: float | None = None,
) -> Judged:
    """Let every arm walk under every condition.

    Parameters
    ----------
    found : mapping
        Family to policies, the same seeds in the same order: see :func:`policies`.
    wanted : sequence of Condition
    arms : mapping, optional
        What is compared; None: ``ARMS``.
    starts : int
        Phases of the gait from which every ground is walked on; one for each of several that lie side by side.
    validation : bool
        Phases between those of the test.
    report : callable
        Told of every ground.
    threads : int
        Of the simulator.
    duration : float, optional
        Of a walk, s; None: as in ``params.toml``.
    """
    first = next(iter(found.values()))
    seeds = tuple(int(policy.record["seed"]) for policy in first)
    judged = Judged(first[0].robot, seeds, _lengths({family: each[0] for family, each in found.items()}))
    arms = ARMS if arms is None else arms
    # Arms that are corrected alike walk next to one another.
    choices = list(dict.fromkeys(arm.choice for arm in arms.values()))
    order = sorted(arms, key=lambda name: choices.index(arms[name].choice))
    groups = [Group(found[arms[name].family], arms[name].choice) for name in order]

    def let(cases: Sequence[Case], count: int, ground: Terrain | None) -> list[Outcome]:
        start = phases(validation=validation, count=count)
        return walk(groups, cases, starts=start, terrain=ground, duration=duration, threads=threads)

    flat = [entry for entry in wanted if entry.ground is None]
    if flat:
        report("flat")
        outcomes = let([entry.case for entry in flat], starts, None)
        for number, entry in enumerate(flat):
            _note(judged, entry.label, order, outcomes, number)
    for entry in wanted:
        if entry.ground is not None:
            report(entry.label)
            outcomes = let([entry.case], max(starts, entry.ground.count), entry.ground)
            _note(judged, entry.label, order, outcomes, 0)
    return judged


def judge_each(
    found: Mapping[str, Sequence[Policy]],
    wanted: Sequence[Condition],
    *,
    starts: int = 4,
    report: Report = silent,
    threads: int = 2,
    duration: float | None = None,
    folder: Path | None = None,
) -> Judged:
    """As :func:`judge`, seed by seed: no policy's figures depend on which others are judged.

    Parameters
    ----------
    found, wanted, starts, report, threads, duration
        As for :func:`judge`.
    folder : Path, optional
        Figures of every seed on flat ground and on each other one are kept here, and taken from here if they are there.
    """
    flat = tuple(entry for entry in wanted if entry.ground is None)
    batches = [*([flat] if flat else []), *((entry,) for entry in wanted if entry.ground is not None)]
    how: dict[str, Any] = {"starts": starts, "duration": duration}
    each: list[Judged] = []
    for k in range(len(next(iter(found.values())))):
        one = {family: policies[k] for family, policies in found.items()}
        first = next(iter(one.values()))
        seed, cells = int(first.record["seed"]), Cells()
        for batch in batches:
            name = "flat" if batch[0].ground is None else batch[0].label.split(",")[0].replace(" ", "_")
            asked = (version("mujoco"), params(first.robot), ARMS, batch, how)
            let = partial(_cells, one, batch, report=report, threads=threads, **how)
            cells |= keep(folder, f"{first.robot}-{seed}-{name}", one, asked, let)
        each.append(Judged(first.robot, (seed,), _lengths(one), cells))
    values = {
        cell: {figure: np.concatenate([one.values[cell][figure] for one in each]) for figure in FIGURES}
        for cell in each[0].values
    }
    return Judged(each[0].robot, tuple(one.seeds[0] for one in each), each[0].steps, values)


def _lengths(one: Mapping[str, Policy]) -> dict[str, int]:
    return {family: int(policy.record["steps"]) for family, policy in one.items()}


def _cells(one: Mapping[str, Policy], batch: Sequence[Condition], **options: Any) -> Cells:
    return judge({family: (policy,) for family, policy in one.items()}, batch, **options).values


def _note(judged: Judged, label: str, names: Sequence[str], outcomes: Sequence[Outcome], number: int) -> None:
    for name, outcome in zip(names, outcomes, strict=True):
        judged.values[label, name] = {
            figure: _of_policies(getattr(outcome, figure)[number]) for figure in FIGURES
        }


def _of_policies(walks: NDArray[np.generic]) -> FloatArray:
    """Mean over the walks (policies, walks) that have the figure; nan without any."""
    value = walks.astype(float)
    there = np.isfinite(value)
    count = there.sum(axis=1)
    total = np.where(there, value, 0.0).sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


# Columns of the table that labels take.
_WIDE = 42


def table(judged: Judged) -> str:
    """One block a figure: medians over policies; and where all differences from the first arm have one sign.

    Parameters
    ----------
    judged : Judged
    """
    labels = list(dict.fromkeys(label for label, _ in judged.values))
    n, seeds = len(judged.seeds), ", ".join(map(str, judged.seeds))
    usual = next(iter(judged.steps.values()))
    longer = "".join(f" ({family} {steps})" for family, steps in judged.steps.items() if steps != usual)
    lines = [
        f"{judged.robot}: {n} policies an arm, seeds {seeds}, trained for {usual} steps{longer}; medians over policies",
        "[least, greatest], each policy's figure the mean over its walks; < or >: below or above base for every seed,",
        f"which chance does in {100 * 0.5 ** (n - 1):.0f} % of the cells where nothing differs",
        *(f"  {name:<10}{arm.label}" for name, arm in ARMS.items()),
    ]
    for figure, (words, scale, digits) in FIGURES.items():
        lines += ["", f"{words:<{_WIDE}}" + "".join(f"{name:>24}" for name in ARMS)]
        for label in labels:
            base = judged.values[label, next(iter(ARMS))][figure]
            cells = [_cell(judged.values[label, name][figure], base, scale, digits) for name in ARMS]
            lines.append(f"{label:<{_WIDE}}" + "".join(f"{cell:>24}" for cell in cells))
        for sign, mark in ((-1.0, "<"), (1.0, ">")):
            counts = [sum(_all(judged, label, name, figure, sign) for label in labels) for name in ARMS]
            lines.append(f"{f'rows with {mark}':<{_WIDE}}" + "".join(f"{count:>22}  " for count in counts))
    return "\n".join(lines)


def _all(judged: Judged, label: str, name: str, figure: str, sign: float) -> bool:
    """Whether every seed differs from the first arm in this direction."""
    change = judged.values[label, name][figure] - judged.values[label, next(iter(ARMS))][figure]
    return len(change) > 1 and bool(np.all(sign * change > 0.0))


def _cell(values: FloatArray, base: FloatArray, scale: float, digits: int) -> str:
    there = values[np.isfinite(values)]
    if not len(there):
        return "-"
    text = median_interval(there).text(scale, digits) if len(there) > 1 else f"{scale * there[0]:.{digits}f}"
    change = values - base
    if len(change) > 1 and np.all(change < 0.0):
        return f"{text} <"
    return f"{text} >" if len(change) > 1 and np.all(change > 0.0) else f"{text}  "


def figures(judged: Judged) -> dict[str, object]:
    """The content of the JSON file: each policy's figure.

    Parameters
    ----------
    judged : Judged
    """
    rows: dict[str, dict[str, dict[str, list[float | None]]]] = {}
    for (label, name), values in judged.values.items():
        rows.setdefault(label, {})[name] = {
            figure: [None if np.isnan(value) else float(value) for value in each]
            for figure, each in values.items()
        }
    return {"robot": judged.robot, "seeds": list(judged.seeds), "steps": judged.steps, "conditions": rows}
