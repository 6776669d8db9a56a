"""The comparison as text and as JSON."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from phyfilter_ctl import Status
from phyfilter_ctl.results import plain

from .comparison import Comparison
from .experiment import Score
from .methods import NAMES, MethodName
from .params import params

__all__ = ["figures", "table"]

# What the paper's flights showed over its baseline, in per cent.
_PAPER_MEAN, _PAPER_VARIANCE = 23.99, 55.04
_OVER: tuple[MethodName, ...] = ("baseline", "integral", "seer", "observer")


def table(comparison: Comparison) -> str:
    """Errors, what was grasped and placed, reductions, SEER-I, planner and gains as text."""
    parts = [
        _errors(comparison),
        _lift_off(comparison),
        _reductions(comparison),
        _seer(comparison),
        _planner(comparison),
        _tuned(comparison),
    ]
    return "\n\n".join(part for part in parts if part)


def _errors(comparison: Comparison) -> str:
    mission, n = comparison.mission, len(comparison.seeds)
    tolerance = 100.0 * mission.tolerance
    lines = [
        f"pick and place of {mission.payload:g} kg, {n} simulated missions a method; |e| of the end effector in cm, "
        "median [its 95 % interval]",
        f"jet of {params().wind.jet_speed:g} m/s with gusts of {100 * params().wind.turbulence:g} %, load within "
        f"{mission.transfer:g} s; grasp window {mission.grasp[0]:g} to {mission.grasp[1]:g} s (lift-off at "
        f"{mission.load:g} s), place window {mission.settle[0]:g} to {mission.settle[1]:g} s",
        f"grasped and placed: within {tolerance:g} cm for the whole window, of {n}; windows: largest |e| there, median "
        "and worst mission",
        "",
        f"{'':<25}{'mean':>20}{'std':>7}{'grasp window':>15}{'grasped':>9}{'place window':>15}{'placed':>8}"
        f"{'20 % gusts':>13}",
    ]
    for name in comparison.methods:
        score = comparison.scores["mission", name]
        lines.append(
            f"{NAMES[name]:<25}{comparison.interval('mission', name, 'mean').text(100.0):>20}"
            f"{100.0 * np.median(np.sqrt(score.variance)):>7.2f}{_pair(score.grasp):>15}{score.grasped.sum():>9}"
            f"{_pair(score.settle):>15}{score.placed.sum():>8}{_passed(comparison, name):>13}"
        )
    return "\n".join(lines)


def _passed(comparison: Comparison, name: MethodName) -> str:
    score = comparison.scores.get(("gusty", name))
    return "" if score is None else f"{score.grasped.sum()} / {score.placed.sum()}"


def _lift_off(comparison: Comparison) -> str:
    cases = {"quick_load": "0.2 s", "mission": f"{comparison.mission.transfer:g} s"}
    known = {
        case: text
        for case, text in cases.items()
        if (case, next(iter(comparison.methods))) in comparison.scores
    }
    lines = [
        f"{f'lift-off, {comparison.mission.lift_off:g} s, cm':<25}"
        + "".join(f"{f'load within {text}':>22}" for text in known.values())
        + "   largest |e|, median [interval]"
    ]
    for name in comparison.methods:
        cells = (f"{comparison.interval(case, name, 'lift_off').text(100.0):>22}" for case in known)
        lines.append(f"{NAMES[name]:<25}{''.join(cells)}")
    return "\n".join(lines)


def _reductions(comparison: Comparison) -> str:
    if "phyfilter" not in comparison.methods:
        return ""
    lines = [f"{'PhyFilter below, %':<25}{'mean |e|':>24}{'paper':>8}{'variance':>24}{'paper':>8}"]
    for over in _OVER:
        if over not in comparison.methods:
            continue
        found = comparison.reduction(over)
        paper = (f"{_PAPER_MEAN:.2f}", f"{_PAPER_VARIANCE:.2f}") if over == "baseline" else ("", "")
        lines.append(
            f"{NAMES[over]:<25}{found.mean.text(1.0, 1):>24}{paper[0]:>8}{found.variance.text(1.0, 1):>24}"
            f"{paper[1]:>8}"
        )
    return "\n".join(lines)


def _seer(comparison: Comparison) -> str:
    training = comparison.training
    lines = [
        f"SEER-I, rms of |error| / |label|: force from {', '.join(training.chosen_force.features.names)} (degree "
        f"{training.chosen_force.features.degree}), torque from {', '.join(training.chosen_torque.features.names)} "
        f"(degree {training.chosen_torque.features.degree})",
        f"{'':<25}{'force, N':>18}{'torque, N m':>18}",
        f"{'fitted flights':<25}{training.chosen_force.train:>10.3f}{'':>8}{training.chosen_torque.train:>10.3f}",
    ]
    for case, errors in comparison.off_distribution.items():
        force, torque = (f"{errors[key]:.3f} / {errors[key + '_label']:.3f}" for key in ("force", "torque"))
        lines.append(f"{_CASES[case]:<25}{force:>18}{torque:>18}")
    return "\n".join(lines)


_CASES = {
    "path": "path, other noise",
    "points": "between points",
    "faster": "path at 5 to 6.5 rad/s",
    "load": "path with the load",
    "wind": "path in the wind",
    "mission": "mission, still air",
}


def _planner(comparison: Comparison) -> str:
    statuses = comparison.planner_statuses
    return (
        f"planner: {len(statuses)} plans, {statuses.count(Status.OPTIMAL)} optimal; solve time p50 "
        f"{comparison.planner_ms(50):.2f} ms, p99 {comparison.planner_ms(99):.2f} ms, of a period of 70 ms"
    )


def _tuned(comparison: Comparison) -> str:
    lines = [
        f"{'tuned':<25}{'outer loop':>11}{'force':>9}{'torque':>9}{'margin':>8}{'jitter':>8}   rad/s; force of the "
        "integral: its corner"
    ]
    for name, entry in comparison.methods.items():
        method = entry.method
        lines.append(
            f"{NAMES[name]:<25}{method.position_bandwidth:>11.2f}{method.bandwidth or '':>9}"
            f"{method.torque_bandwidth or '':>9}{entry.modulus_margin:>8.3f}{entry.jitter:>8.3f}"
        )
    return "\n".join(lines)


def _pair(values: np.ndarray) -> str:
    return f"{100.0 * np.median(values):.2f} / {100.0 * values.max():.2f}"


def figures(comparison: Comparison) -> dict[str, object]:
    """The content of the JSON file: cm, numbers of missions, per cent, ms."""

    def each(value: Callable[[Score], float], case: str = "mission") -> dict[str, float | str | None]:
        found = {
            name: 100.0 * value(comparison.scores[case, name])
            for name in comparison.methods
            if (case, name) in comparison.scores
        }
        return plain(found, infinite=True)

    def count(field: str, case: str = "mission") -> dict[str, int]:
        return {
            name: int(getattr(comparison.scores[case, name], field).sum())
            for name in comparison.methods
            if (case, name) in comparison.scores
        }

    training = comparison.training
    found: dict[str, object] = {
        "seeds": list(comparison.seeds),
        "max_error_cm": each(lambda score: float(score.windows.max())),
        "mean_error_cm": each(lambda score: float(np.median(score.mean))),
        "std_error_cm": each(lambda score: float(np.median(np.sqrt(score.variance)))),
        "grasp_error_cm": each(lambda score: float(np.median(score.grasp))),
        "place_error_cm": each(lambda score: float(np.median(score.settle))),
        "grasped": count("grasped"),
        "placed": count("placed"),
        "lift_off_cm": {
            "1_s": each(lambda score: float(np.median(score.lift_off))),
            "0.2_s": each(lambda score: float(np.median(score.lift_off)), "quick_load"),
        },
        "gusty": {"grasped": count("grasped", "gusty"), "placed": count("placed", "gusty")},
        "planner_ms": {"p50": comparison.planner_ms(50), "p99": comparison.planner_ms(99)},
        "seer_training": {
            "force_rmse": training.chosen_force.train,
            "torque_rmse": training.chosen_torque.train,
            "off_distribution": {case: dict(errors) for case, errors in comparison.off_distribution.items()},
        },
        "tuned": {
            name: {
                "position_bandwidth": entry.method.position_bandwidth,
                "force_bandwidth": entry.method.bandwidth,
                "torque_bandwidth": entry.method.torque_bandwidth,
                "modulus_margin": entry.modulus_margin,
                "jitter": entry.jitter,
            }
            for name, entry in comparison.methods.items()
        },
    }
    if "phyfilter" in comparison.methods:
        for over in _OVER:
            if over in comparison.methods:
                reduction = comparison.reduction(over)
                found[f"reduction_vs_{over}_pct"] = {
                    part: [value.value, value.low, value.high]
                    for part, value in (("mean", reduction.mean), ("variance", reduction.variance))
                }
    return found
