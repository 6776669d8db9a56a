"""What every analysis makes of every option that a filter runs with: ``python -m tests.analysis.options_table``.

An option is changed, and the cell is what comes of it: "refused" where the analysis raises, "counted" where a figure
changes, "named" where only the assumptions do, "-" where nothing does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from typing import Any

import control as ct
import numpy as np

import phyfilter_ctl as pf
from phyfilter_ctl import PhyFilter, SampledPhyFilter, Sampling

H = 0.01
FILTER = pf.lowpass(2, 12.0)
LOOP: dict[str, Any] = {"kp": 10.0, "kd": 6.0, "actuator": ct.tf(1.0, [0.02, 1.0])}
INNER = {"actuator": LOOP["actuator"]}

# The loops take one channel; so does E here.
CHANGES: Mapping[str, object] = {
    "dt": 0.02,
    "method": "tustin",
    "g": "average",
    "f_theta": "hold",
    "precision": "float32",
    "delay": 0.01,
    "limit": 0.5,
    "g_limit": (-2.0, 2.0),
    "nonfinite": "hold",
    "channels": ("v",),
    "inertia": 3.0,
    "units": {"x": "m/s", "f": "N"},
    "E": [[0.1]],
}


def sampled(option: str | None = None) -> SampledPhyFilter:
    """The filter, with one option changed."""
    if option is None:
        return FILTER.sampled(H)
    if option == "E":
        return FILTER.sampled(H, E=np.array(CHANGES["E"]))
    return FILTER.sampled(replace(Sampling(H), **{option: CHANGES[option]}))


def _response(filter: SampledPhyFilter) -> tuple[object, ...]:
    found = pf.frequency_response(filter, np.array([1.0, 5.0, 20.0]))
    return found.F, found.noise_gain, found.bandwidth


ANALYSES: Mapping[str, Callable[[SampledPhyFilter], Any]] = {
    "frequency_response": lambda f: pf.frequency_response(f, np.array([1.0, 5.0, 20.0])),
    "prior_margin": lambda f: pf.prior_margin(f, **INNER),
    "loop_margin": lambda f: pf.loop_margin(f, **LOOP),
    "saturation_margin": lambda f: pf.saturation_margin(f, **LOOP),
    "largest_bandwidth": lambda f: pf.largest_bandwidth(
        lambda w: pf.lowpass(2, w).sampled(f.sampling, E=f.E), low=1.0, high=300.0, **LOOP
    ),
    "moving_inertia": lambda f: pf.moving_inertia(f, ratios=[0.7, 1.4], **INNER),
    "ultimate_bound": lambda f: pf.ultimate_bound(
        f, residual={0: 1.0, 1: 3.0}, noise=0.01, inertia_error=0.1, rate=2.0
    ),
    "error_variance": lambda f: pf.error_variance(f, noise=0.01, residual=pf.gauss_markov(1.0, 0.5)),
    "tracking_tube": lambda f: pf.tracking_tube(f, residual={0: 1.0}, noise=0.01, **LOOP),
    "tracking_deviation": lambda f: pf.tracking_deviation(
        f, residual=pf.gauss_markov(1.0, 0.5), noise=0.01, **LOOP
    ),
}


def figures(result: Any) -> dict[str, object]:
    """Numbers of a result: what must change where an option counts."""
    if isinstance(result, pf.FilterResponse):
        return {"F": np.abs(result.F).tolist(), "noise": result.noise_gain, "bandwidth": result.bandwidth}
    found = result.to_dict()
    return {name: value for name, value in found.items() if name not in _NO_FIGURES}


_NO_FIGURES = ("assumptions", "system", "unit", "units", "covered", "filter", "message")


def cell(analysis: str, option: str) -> str:
    """What the analysis makes of the option."""
    run = ANALYSES[analysis]
    usual = run(sampled())
    try:
        other = run(sampled(option))
    except ValueError:
        return "refused"
    if figures(usual) != figures(other):
        return "counted"
    return "named" if getattr(usual, "assumptions", ()) != getattr(other, "assumptions", ()) else "-"


def options() -> list[str]:
    """Every option, a new one too."""
    return [*(entry.name for entry in fields(Sampling)), "E"]


def table() -> dict[str, dict[str, str]]:
    """Cells by option and analysis."""
    return {option: {name: cell(name, option) for name in ANALYSES} for option in options()}


def main() -> None:
    """Print the table, and how many cells are named."""
    found, width = table(), max(map(len, ANALYSES)) + 2
    print(" " * 12 + "".join(f"{name:>{width}}" for name in ANALYSES))
    for option, cells in found.items():
        print(f"{option:<12}" + "".join(f"{cells[name]:>{width}}" for name in ANALYSES))
    named = sum(list(cells.values()).count("named") for cells in found.values())
    print(f"named: {named} of {len(found) * len(ANALYSES)}")


if __name__ == "__main__":
    main()
