"""The study as text and as JSON."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from phyfilter_ctl.results import plain

from .flights import Scenario
from .methods import NAMES
from .params import params
from .study import Outcome, Spread, Study
from .study_points import SCENARIOS, AxisName

__all__ = ["TITLES", "figures", "label", "table"]

TITLES: dict[AxisName, str] = {
    "g": "choice of g, over the filter's bandwidth [rad/s]",
    "order": "order and type, over the bandwidth of equal poles [rad/s]",
    "learned": "filters learned on the tuning flights",
    "delay": "delay of the commands that nobody was told [ms]",
    "wind": "factor on the wind",
    "mass": "factor on the added mass",
    "map": "least error, speed on the circle [m/s] by bandwidth [rad/s]",
}
_IN: dict[Scenario, str] = {"wind": "mass and wind", "mass": "mass only"}
_LETTERS = {"seer": "S", "observer": "O", "phyfilter": "P"}
_WIDTH = 26


def label(axis: AxisName, family: str) -> str:
    """What a curve is called."""
    if axis == "learned":
        return "tuned (placed)" if family == "tuned" else family
    return NAMES.get(family, family)


def table(study: Study) -> str:
    """Medians in cm, axis by axis.

    Parameters
    ----------
    study : Study
    """
    grid = study.grid
    lines = [
        f"study: mean |e| in cm, median of {len(grid.seeds)} flights a point ({len(grid.map_seeds)} on the map), inf "
        "where most failed"
    ]
    for axis in study.axes:
        lines += ["", TITLES[axis]]
        if axis == "learned":
            lines += _learned(study)
        elif axis == "map":
            for scenario in SCENARIOS[::-1]:
                lines += _map(study, scenario)
        else:
            lines += _blocks(axis, study.curves(axis))
        if axis == "g" and study.limits is not None:
            lines += _limits(study)
    return "\n".join(lines)


def _blocks(axis: AxisName, curves: Mapping[str, Sequence[Outcome]]) -> list[str]:
    """One block for each scenario, one for margins: curves are rows."""
    first = next(iter(curves.values()))
    scale = 1e3 if axis == "delay" else 1.0
    lines = []
    for scenario in SCENARIOS[::-1]:
        if scenario in first[0].errors:
            lines.append(_row(_IN[scenario], [f"{scale * outcome.point.value:.3g}" for outcome in first]))
            lines += _rows(axis, curves, lambda outcome, s=scenario: _cm(outcome.spread(s).median))
    if first[0].margin is not None:
        lines.append(_row("modulus margin", []))
        lines += _rows(axis, curves, lambda outcome: f"{outcome.margin:.2f}")
    return lines


def _rows(
    axis: AxisName, curves: Mapping[str, Sequence[Outcome]], text: Callable[[Outcome], str]
) -> list[str]:
    return [
        _row(f"  {label(axis, name)}", [text(outcome) for outcome in curve]) for name, curve in curves.items()
    ]


def _row(name: str, cells: Sequence[str]) -> str:
    return f"{name:<{_WIDTH}}" + "".join(f"{cell:>8}" for cell in cells)


def _cm(value: float) -> str:
    return f"{100.0 * value:.2f}" if value < 10.0 else "inf"


def _learned(study: Study) -> list[str]:
    rmse = {found.name: f"{found.rmse:.4f}" for found in study.learned}
    lines = [_row("", ["wind", "mass", "margin", "outer", "rmse N"])]
    for family, (outcome,) in study.curves("learned").items():
        errors = [_cm(outcome.spread(s).median) if outcome.errors else "not" for s in SCENARIOS[::-1]]
        found = [f"{outcome.margin:.3f}", f"{outcome.position_bandwidth:.2f}", rmse.get(family, "")]
        lines.append(_row(f"  {label('learned', family)}", [*errors, *found]))
    wanted = params().tuning.modulus_margin
    lines.append(
        f"  outer: its bandwidth in rad/s, the fastest with a margin of {wanted:g}; not: none has it"
    )
    return lines


def _map(study: Study, scenario: Scenario) -> list[str]:
    winners = study.winners(scenario)
    least = study.least(scenario)
    lines = [_row(_IN[scenario], [f"{w:.3g}" for w in study.map_bandwidths])]
    for speed in sorted({speed for _, speed in winners}):
        cells = [
            f"{_LETTERS[winners[w, speed]]} {_cm(least[w, speed]):>5}" if (w, speed) in winners else ""
            for w in study.map_bandwidths
        ]
        lines.append(_row(f"  {speed:.2f}", cells))
    lines.append("  P PhyFilter, O observer, S SEER-I; each with the fastest outer loop that has the margin")
    return lines


def _limits(study: Study) -> list[str]:
    found = study.limits
    if found is None:
        return []
    formula = found.predicted
    lines = [
        f"where the loop of a filter of order 1 breaks, rad/s, outer loop of {found.position_bandwidth:g} rad/s",
        _row("", ["flight", "linear", "vehicle"]),
    ]
    lines += [
        _row(f"  {known}", [_rate(part[known]) for part in (found.simulated, found.vertical, found.all)])
        for known in found.simulated
    ]
    return [
        *lines,
        "  flight, linear: vertical axis, simulated and linearised; vehicle: all axes; held: the force commanded",
        f"  formula for held: inner loop {formula.inner:.1f}, complete {formula.complete:.1f}, complete and sampled "
        f"{formula.sampled:.1f}",
    ]


def _rate(value: float) -> str:
    return f"{value:.1f}" if np.isfinite(value) else "none"


def figures(study: Study) -> dict[str, object]:
    """The content of the JSON file: m, s, rad/s; null for what failed, was not flown, or has no limit.

    Parameters
    ----------
    study : Study
    """
    axes = {
        axis: {
            family: [_outcome(outcome) for outcome in curve] for family, curve in study.curves(axis).items()
        }
        for axis in study.axes
    }
    found: dict[str, object] = {
        "seeds": list(study.grid.seeds),
        "map_seeds": list(study.grid.map_seeds),
        "axes": axes,
        "learned": [
            {
                "name": entry.name,
                "a": list(entry.coefficients[0]),
                "b": list(entry.coefficients[1]),
                "rmse": entry.rmse,
                "message": entry.message,
            }
            for entry in study.learned
        ],
    }
    if "map" in study.axes:
        found["winners"] = {
            scenario: [
                {"bandwidth": w, "speed": speed, "winner": name}
                for (w, speed), name in sorted(study.winners(scenario).items())
            ]
            for scenario in SCENARIOS
        }
    if study.limits is not None:
        where = study.limits
        found["limits"] = {
            "position_bandwidth": where.position_bandwidth,
            "formula": {
                "inner": plain(where.predicted.inner, infinite=True),
                "complete": plain(where.predicted.complete, infinite=True),
                "sampled": plain(where.predicted.sampled, infinite=True),
            },
            "simulated": plain(where.simulated, infinite=True),
            "vertical": plain(where.vertical, infinite=True),
            "vehicle": plain(where.all, infinite=True),
        }
    return found


def _outcome(outcome: Outcome) -> dict[str, object]:
    found: dict[str, object] = {
        "value": outcome.point.value,
        "margin": outcome.margin,
        "position_bandwidth": outcome.position_bandwidth,
    }
    if outcome.point.speed is not None:
        found["speed"] = outcome.point.speed
    return found | {scenario: _spread(outcome.spread(scenario)) for scenario in outcome.errors}


def _spread(spread: Spread) -> dict[str, float | str | None]:
    return {
        "low": plain(spread.low, infinite=True),
        "median": plain(spread.median, infinite=True),
        "high": plain(spread.high, infinite=True),
    }
