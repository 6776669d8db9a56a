"""One thing has one name in every signature: python-control's or scipy's where they have one."""

from __future__ import annotations

import dataclasses
import inspect

import pytest

from tests.meta.test_public_names import CALLABLES

NAMES = {
    "dt": {"period", "sample_time", "sampling_interval", "Ts", "timestep"},
    "max_iterations": {"iterations", "maxiter", "n_iter", "max_iter"},
    "max_epochs": {"epochs"},
    "params": {"parameters"},
    "tolerance": {"tol"},
    "omega": {"frequencies", "freq", "freqs"},
    "timepts or times": {"timepoints", "time_points", "t_eval"},
}
# FMI says parameters, as does a model of its theta; a sampled block's dt is that of the diagram around it.
OTHERS = ("phyfilter_ctl.fmi.", ".with_parameters", "phyfilter_ctl.blocks.sampled.SampledBlock")
# The time of one turn of the figure, no sampling interval.
BESIDE = {"phyfilter_ctl.plants.trajectories.lemniscate(period=)"}


@pytest.mark.parametrize("wanted", NAMES)
def test_one_thing_has_one_name(wanted: str) -> None:
    functions = {name: thing for name, thing in CALLABLES.items() if not dataclasses.is_dataclass(thing)}
    assert len(functions) > 300
    found = []
    for name, thing in functions.items():
        if name.startswith(OTHERS[0]) or name.endswith(OTHERS[1]) or name == OTHERS[2]:
            continue
        try:
            signature = inspect.signature(thing)
        except ValueError:
            continue
        found += [f"{name}({other}=)" for other in NAMES[wanted] & set(signature.parameters)]
    assert not set(found) - BESIDE, f"write {wanted}"
