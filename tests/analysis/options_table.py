"""What every analysis makes of every option that a filter runs with: ``python -m tests.analysis.options_table``.

An option is changed, and the cell is what comes of it: "refused" where the analysis raises, "counted" where a figure
changes, "named" where only the assumptions do, "-"
where nothing does. ``largest_bandwidth`` asks ``loop_margin`` about filters that its caller makes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from functools import cache
from typing import Any

import control as ct
import numpy as np

import phyfilter_ctl as pf
from phyfilter_ctl import SampledPhyFilter, Sampling

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
    return FILTER.sampled(replace(Sampling(H), **{option: CHANGES[option]}))


ANALYSES: Mapping[str, Callable[[SampledPhyFilter], Any]] = {
    "frequency_response": lambda f: pf.frequency_response(f, np.array([1.0, 5.0, 20.0])),
    "margins, inner loop": lambda f: pf.margins(f, pf.Loop(**INNER)),
    "margins, complete loop": lambda f: pf.margins(f, pf.Loop(**LOOP)),
    "saturation_margin": lambda f: pf.saturation_margin(f, pf.Loop(**LOOP)),
    "inertia_tolerance": lambda f: pf.inertia_tolerance(f, pf.Loop(**INNER), ratios=[0.7, 1.4]),
    "error_bound": lambda f: pf.error_bound(
        f, pf.Bounded({0: 1.0, 1: 3.0}, noise=0.01, inertia_error=0.1, rate=2.0)
    ),
    "error_variance": lambda f: pf.error_variance(f, pf.Gaussian(pf.gauss_markov(1.0, 0.5), noise=0.01)),
    "tracking_error, bounds": lambda f: pf.tracking_error(
        f, pf.Loop(**LOOP), pf.Bounded({0: 1.0}, noise=0.01)
    ),
    "tracking_error, spectra": lambda f: pf.tracking_error(
        f, pf.Loop(**LOOP), pf.Gaussian(pf.gauss_markov(1.0, 0.5), noise=0.01)
    ),
}


def figures(result: Any) -> dict[str, object]:
    """Numbers of a result: what must change where an option counts."""
    if isinstance(result, pf.FilterResponse):
        return {"F": np.abs(result.F).tolist(), "noise": result.noise_gain, "bandwidth": result.bandwidth}
    found = result.to_dict()
    return {name: value for name, value in found.items() if name not in _NO_FIGURES}


_NO_FIGURES = ("assumptions", "system", "unit", "units", "covered", "filter", "message")


@cache
def usual_of(analysis: str) -> Any:
    """The result for a filter whose options nobody changed."""
    return ANALYSES[analysis](sampled())


def cell(analysis: str, option: str) -> str:
    """What the analysis makes of the option."""
    run, usual = ANALYSES[analysis], usual_of(analysis)
    try:
        other = run(sampled(option))
    except ValueError:
        return "refused"
    if figures(usual) != figures(other):
        return "counted"
    return "named" if getattr(usual, "assumptions", ()) != getattr(other, "assumptions", ()) else "-"


def options() -> list[str]:
    """Every option, a new one too."""
    return [entry.name for entry in fields(Sampling)]


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
