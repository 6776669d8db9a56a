"""The comparison as text and as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypedDict

import numpy as np

from phyfilter_ctl.results import Interval, plain

from .comparison import SCENARIOS, Comparison, Estimation
from .methods import NAMES, MethodName
from .params import params

__all__ = ["figures", "reductions", "table"]

# What the paper's real flights showed, in per cent.
_PAPER = {"seer": 30.22, "baseline": 50.17}
_OVER: tuple[MethodName, ...] = ("seer", "baseline", "integral", "observer")


class _Reduction(TypedDict):
    over: MethodName
    wind: Interval
    mass: Interval


def reductions(comparison: Comparison) -> list[_Reduction]:
    """PhyFilter's reduction of the mean error over other methods, with wind and without."""
    if "phyfilter" not in comparison.methods:
        return []
    return [
        {
            "over": over,
            "wind": comparison.reduction("wind", over),
            "mass": comparison.reduction("mass", over),
        }
        for over in _OVER
        if over in comparison.methods
    ]


def table(comparison: Comparison) -> str:
    """Errors, gains, reductions and estimates as text.

    Parameters
    ----------
    comparison : Comparison
    """
    mission = comparison.mission
    of_paper = _PAPER if mission == params().mission else {}
    lines = [
        f"circle of {mission.radius:g} m at {mission.speed:g} m/s, {len(comparison.seeds)} simulated flights a method, "
        "mean |e| in cm: median of the flights [its 95 % interval]",
        "",
        f"{'':<26}{'mass only':>22}{'mass and wind':>22}{'horizontal':>12}{'vertical':>10}",
    ]
    best = {
        kind: min(v.value for name, v in comparison.mae(kind).items() if name != "known_mass")
        for kind in SCENARIOS
    }
    columns = {kind: comparison.mae(kind) for kind in SCENARIOS}
    names: list[MethodName] = list(comparison.methods)
    horizontal, vertical = (comparison.mae("wind", part) for part in ("horizontal", "vertical"))
    for name in names:
        cells = ""
        for kind in SCENARIOS:
            mark = " *" if columns[kind][name].value == best[kind] else "  "
            cells += f"{columns[kind][name].text(100.0) + mark:>22}"
        lines.append(
            f"{NAMES[name]:<26}{cells}{100.0 * horizontal[name].value:>12.2f}{100.0 * vertical[name].value:>10.2f}"
        )
    lines += [
        "",
        "* least of those that are not told the mass; horizontal and vertical are those of the flights in wind",
        "all know the nominal mass and carry its weight by feed-forward; what no method but the last is trimmed for is",
        "the payload",
    ]
    head = f"{'PhyFilter below, %':<26}{'mass only':>22}{'mass and wind':>22}"
    lines += ["", head + (f"{'paper':>12}" if of_paper else "")]
    for entry in reductions(comparison):
        over = entry["over"]
        paper = f"{of_paper[over]:>12.2f}" if over in of_paper else ""
        still, windy = (f"{value.text(1.0, 1)}  " for value in (entry["mass"], entry["wind"]))
        lines.append(f"{NAMES[over]:<26}{still:>22}{windy:>22}{paper}")
    lines += ["", f"{'RMSE of the force, N':<26}{'whole':>8}{'mass part':>11}{'wind part':>11}   in the wind"]
    for (kind, name), found in comparison.estimation.items():
        if kind == "wind":
            parts = (found.force, found.mass_part, found.wind_part)
            lines.append(
                f"{NAMES[name]:<26}"
                + "".join(f"{_median(v):>{w}}" for v, w in zip(parts, (8, 11, 11), strict=True))
            )
    lines += [
        "",
        f"{'tuned':<26}{'outer loop':>11}{'estimator':>11}{'margin':>8}{'jitter':>8}   rad/s; SEER-I's rate 1/s",
    ]
    lines += [
        f"{NAMES[name]:<26}{entry.method.position_bandwidth:>11.2f}"
        f"{entry.method.bandwidth if entry.method.tunable else '':>11}{entry.modulus_margin:>8.3f}{entry.jitter:>8.3f}"
        + ("" if entry.interior else "   edge of the search")
        for name, entry in comparison.methods.items()
    ]
    return "\n".join(lines)


def _median(values: np.ndarray | None) -> str:
    return "" if values is None else f"{np.median(values):.3f}"


def figures(comparison: Comparison) -> dict[str, object]:
    """The content of the JSON file: medians over the test flights, m, m/s, N and per cent."""
    found: dict[str, object] = {
        "seeds": list(comparison.seeds),
        "circle": {"radius": comparison.mission.radius, "speed": comparison.mission.speed},
        "mae": {kind: _medians(comparison.mae(kind)) for kind in SCENARIOS},
        "mae_horizontal": {kind: _medians(comparison.mae(kind, "horizontal")) for kind in SCENARIOS},
        "mae_vertical": {kind: _medians(comparison.mae(kind, "vertical")) for kind in SCENARIOS},
        "mae_interval": {
            kind: {n: [v.low, v.high] for n, v in comparison.mae(kind).items()} for kind in SCENARIOS
        },
    }
    for entry in reductions(comparison):
        key = f"reduction_vs_{entry['over']}"
        found |= {
            f"{key}_pct": entry["wind"].value,
            f"{key}_interval_pct": [entry["wind"].low, entry["wind"].high],
            f"{key}_mass_only_pct": entry["mass"].value,
        }
    found["force_rmse"] = {
        kind: {name: _estimation(value) for (k, name), value in comparison.estimation.items() if k == kind}
        for kind in SCENARIOS
    }
    found["seer_training"] = {"rmse": comparison.training.rmse, "label_rms": comparison.training.label_rms}
    found["tuned"] = {
        name: {
            "position_bandwidth": entry.method.position_bandwidth,
            "bandwidth": entry.method.bandwidth,
            "seer_rate": entry.method.seer_rate,
            "modulus_margin": entry.modulus_margin,
            "jitter": entry.jitter,
            "interior": entry.interior,
        }
        for name, entry in comparison.methods.items()
    }
    return found


def _medians(values: Mapping[MethodName, Interval]) -> dict[str, float | str | None]:
    """For JSON, where most flights failed as the word Infinity."""
    return {name: plain(value.value, infinite=True) for name, value in values.items()}


def _estimation(value: Estimation) -> dict[str, float]:
    parts = {"force": value.force, "mass_part": value.mass_part, "wind_part": value.wind_part}
    return {key: float(np.median(part)) for key, part in parts.items() if part is not None}
