"""Table and JSON of a comparison."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .comparison import Comparison, Scores
from .params import params
from .terrain import RANDOM, Kind

__all__ = ["figures", "ground_differences", "mean_interval", "table"]

FloatArray = NDArray[np.float64]

# What the paper prints: velocity error at 60 % of the weight, m/s, at most.
_PAPER_PAYLOAD = 0.2


def table(found: Comparison) -> str:
    """The table that is printed.

    Parameters
    ----------
    found : Comparison
    """
    plan, scores = found.plan, found.scores
    walks = len(plan.seeds) * plan.phases
    contact = "" if plan.contact is None else f"; filters with the contact force in g: {plan.contact}"
    lines = [
        f"quadruped of {params().robot.mass} kg, trained on flat ground with payloads of {_range('payload')} kg and "
        f"{_range('velocity')} m/s;",
        f"{len(plan.seeds)} policies x {plan.phases} phases of the gait = {walks} walks a column, those to 3 m/s fewer"
        + contact,
        "",
        "velocity error |mean v - command|, m/s [policy with the least, with the largest] (falls, %)",
        _row("", [f"{100 * part:.0f} %" for part in plan.payloads], "payload, 1 m/s"),
    ]
    for name, score in scores.items():
        lines.append(_row(found.methods[name].label, _cells(score.payload, score.payload_fallen)))
    lines += ["", _row("", [f"{speed:g}" for speed in plan.speeds], "commanded speed, m/s")]
    for name, score in scores.items():
        lines.append(_row(found.methods[name].label, _cells(score.speed, score.speed_fallen)))
    heaviest = f"{100 * max(plan.payloads):.0f} %"
    test = params().test
    lines += [
        "",
        _row(
            "", ["no load", heaviest, "push"], f"motors at {100 * test.strength:.0f} %; push: part that stood"
        ),
    ]
    for name, score in scores.items():
        cells = [_over_policies(values) for values in (*score.strength, score.push)]
        lines.append(_row(found.methods[name].label, cells))
    if plan.terrains:
        lines += [
            "",
            _row(
                "",
                list(plan.terrains),
                f"part that passed {test.distance:g} m; difficulties {_list(plan.difficulties)}; "
                f"{', '.join(RANDOM)}: {plan.grounds} grounds, one walk of a policy on each",
            ),
        ]
        for name, score in scores.items():
            cells = [_list(score.terrain[kind].mean(axis=(1, 2))) for kind in plan.terrains]
            lines.append(_row(found.methods[name].label, cells, width=18))
        lines += ["", _row("", list(plan.terrains), "the same, mean of the difficulties, of the policies")]
        for name, score in scores.items():
            cells = [_over_policies(score.terrain[kind].mean(axis=0)) for kind in plan.terrains]
            lines.append(_row(found.methods[name].label, cells))
        lines += _over_grounds(found)
    lines += ["", *_verdict(found)]
    speed = found.throughput
    lines += [
        "",
        f"steps of 5 ms per second, {speed.robots} robots: MuJoCo alone {speed.bare:.0f}, with the joint loop "
        f"{speed.loop:.0f}, with the filter {speed.filtered:.0f}",
    ]
    return "\n".join(lines)


def _over_grounds(found: Comparison) -> list[str]:
    """Paired differences from the first method on the same grounds, where there are several."""
    plan = found.plan
    kinds: list[Kind] = [kind for kind in plan.terrains if kind in RANDOM and plan.grounds > 1]
    if not kinds:
        return []
    first, *others = found.scores
    lines = [
        "",
        _row(
            "",
            [f"{kind} {difficulty:g}" for kind in kinds for difficulty in plan.difficulties],
            f"part that passed, less that of {found.methods[first].label}: mean over {plan.grounds} grounds with 95 % "
            "of these policies, * beyond 0",
        ),
    ]
    for name in others:
        cells = [_signed(values) for kind in kinds for values in ground_differences(found, name, first, kind)]
        lines.append(_row(found.methods[name].label, cells))
    return lines


def ground_differences(found: Comparison, name: str, first: str, kind: Kind) -> FloatArray:
    """Part of the walks that passed, method ``name`` less ``first``, on the same grounds; (difficulties, grounds).

    Parameters
    ----------
    found : Comparison
    name, first : str
        Methods.
    kind : str
        Of ``RANDOM``.
    """
    mine, base = (found.scores[each].terrain[kind].mean(axis=1) for each in (name, first))
    return mine - base


def mean_interval(values: FloatArray) -> tuple[float, float]:
    """95 % bootstrap interval of the mean of independent values (n,), by 4,000 draws of a fixed seed.

    Parameters
    ----------
    values : (n,) array

    Examples
    --------
    >>> mean_interval(np.ones(10))
    (1.0, 1.0)
    """
    drawn = np.random.default_rng(0).integers(len(values), size=(4000, len(values)))
    low, high = np.quantile(values[drawn].mean(axis=1), (0.025, 0.975))
    return float(low), float(high)


def _signed(values: FloatArray) -> str:
    low, high = mean_interval(values)
    return f"{values.mean():+.2f} [{low:+.2f}, {high:+.2f}]{'*' if low > 0.0 or high < 0.0 else ''}"


def _range(name: str) -> str:
    low, high = getattr(params().randomisation, name)
    return f"{low:g}..{high:g}"


def _list(values: tuple[float, ...] | FloatArray) -> str:
    return "/".join(f"{value:.2f}".lstrip("0") if value < 1.0 else f"{value:.1f}" for value in values)


def _row(label: str, cells: list[str], note: str = "", width: int = 25) -> str:
    text = f"{label:<28}" + "".join(f"{cell:>{width}}" for cell in cells)
    return f"{text}   {note}" if note else text


def _cells(errors: FloatArray, fallen: FloatArray) -> list[str]:
    return [
        _over_policies(values) + (f" ({100 * part:.0f})" if part else "")
        for values, part in zip(errors, fallen, strict=True)
    ]


def _over_policies(values: FloatArray) -> str:
    """Of (policies, phases): the mean, and between which policies it lies."""
    each = values.mean(axis=1)
    if len(each) < 2:
        return f"{each.mean():.2f}"
    low, high = (f"{value:.2f}" for value in (each.min(), each.max()))
    return f"{each.mean():.2f} [{low}, {high}]"


def columns(score: Scores, found: Comparison) -> dict[str, FloatArray]:
    """One number a column and policy; terrains and push count as failures, so that less is better everywhere.

    Parameters
    ----------
    score : Scores
    found : Comparison

    Returns
    -------
    dict of str to (policies,) array
    """
    plan = found.plan
    result = {
        f"payload {100 * part:.0f} %": value.mean(axis=1)
        for part, value in zip(plan.payloads, score.payload, strict=True)
    }
    result |= {
        f"{speed:g} m/s": value.mean(axis=1) for speed, value in zip(plan.speeds, score.speed, strict=True)
    }
    result |= {
        "weak motors": score.strength[0].mean(axis=1),
        "weak motors, loaded": score.strength[1].mean(axis=1),
        "push": 1.0 - score.push.mean(axis=1),
    }
    return result | {kind: 1.0 - values.mean(axis=(0, 2)) for kind, values in score.terrain.items()}


def _verdict(found: Comparison) -> list[str]:
    """Against the first method, column by column, and against the paper's figure."""
    first = next(iter(found.scores))
    base = columns(found.scores[first], found)
    lines = [
        f"against {found.methods[first].label}: columns where every policy is better, or worse, than every one of it"
    ]
    for name, score in found.scores.items():
        if name == first:
            continue
        mine = columns(score, found)
        better = [key for key in base if mine[key].max() < base[key].min() - _EQUAL]
        worse = [key for key in base if mine[key].min() > base[key].max() + _EQUAL]
        lines.append(
            f"{found.methods[name].label}: better in {len(better)} of {len(base)}"
            + (f" ({', '.join(better)})" if better else "")
            + f", worse in {len(worse)}"
            + (f" ({', '.join(worse)})" if worse else "")
        )
    if max(found.plan.payloads) >= 0.6:
        for name in ("filter", "improved"):
            if name in found.scores:
                reached = float(found.scores[name].payload[-1].mean())
                verb = "holds" if reached <= _PAPER_PAYLOAD else "does not hold"
                lines.append(
                    f"paper, 60 % payload: at most {_PAPER_PAYLOAD} m/s with the filter; {found.methods[name].label}: "
                    f"{reached:.2f} m/s, {verb}"
                )
    return lines


# Columns that differ by less are equal: m/s, and parts of the robots.
_EQUAL = 0.01


def figures(found: Comparison) -> dict[str, object]:
    """The content of the JSON file.

    Parameters
    ----------
    found : Comparison
    """
    plan = found.plan
    return {
        "seeds": list(plan.seeds),
        "phases": plan.phases,
        "grounds": plan.grounds,
        "payloads": list(plan.payloads),
        "speeds": list(plan.speeds),
        "difficulties": list(plan.difficulties),
        "methods": {name: _figures(score) for name, score in found.scores.items()},
        "contact": plan.contact,
        "columns": {name: _listed(score, found) for name, score in found.scores.items()},
        "training_reward": found.curves,
        "steps_per_second": {
            "robots": found.throughput.robots,
            "mujoco": found.throughput.bare,
            "loop": found.throughput.loop,
            "filter": found.throughput.filtered,
        },
    }


def _listed(score: Scores, found: Comparison) -> dict[str, list[float]]:
    return {key: values.tolist() for key, values in columns(score, found).items()}


def _figures(score: Scores) -> dict[str, object]:
    return {
        "payload_error": score.payload.mean(axis=(1, 2)).tolist(),
        "payload_fallen": score.payload_fallen.tolist(),
        "speed_error": score.speed.mean(axis=(1, 2)).tolist(),
        "speed_fallen": score.speed_fallen.tolist(),
        "weak_motors_error": score.strength.mean(axis=(1, 2)).tolist(),
        "push_survival": float(score.push.mean()),
        "terrain_success": {
            kind: values.mean(axis=(1, 2)).tolist() for kind, values in score.terrain.items()
        },
        "terrain_success_by_policy": {
            kind: values.mean(axis=2).tolist() for kind, values in score.terrain.items()
        },
        "terrain_success_by_walk": {kind: values.tolist() for kind, values in score.terrain.items()},
        "mean_abs_f_hat": score.estimate.tolist(),
    }
