"""Every result honours one contract: a status out of one enumeration, one screen, and a way into JSON."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import json
import pkgutil

import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl import PhyFilter, Recording, Result, Status, baselines, design, learned
from phyfilter_ctl.controllers import CooperativePlanner, PlannerLimits, follow
from phyfilter_ctl.design import optimal

SCREEN = (40, 430)  # lines, and characters of the longest one


def public_results() -> dict[str, type]:
    """What the rooms offer and calls itself a result, or has a status."""
    rooms = [
        f"phyfilter_ctl.{info.name}" for info in pkgutil.iter_modules(pf.__path__) if info.name[0] != "_"
    ]
    found = {}
    for room in [*rooms, "phyfilter_ctl.design.optimal", "phyfilter_ctl.controllers.planner"]:
        module = importlib.import_module(room)
        for name in getattr(module, "__all__", ()):
            thing = getattr(module, name)
            if not (inspect.isclass(thing) and dataclasses.is_dataclass(thing)):
                continue
            status = {field.name: field.type for field in dataclasses.fields(thing)}.get("status")
            if name.endswith("Result") or status not in (None, "int") or issubclass(thing, Result):
                found[name] = thing
    return found


RESULTS = public_results()


@pytest.mark.parametrize("name", sorted(RESULTS))
def test_a_result_shows_itself_and_its_status_in_one_way(name: str) -> None:
    kind = RESULTS[name]
    assert issubclass(kind, Result), f"{name}: derive it from phyfilter_ctl.Result"
    assert "__repr__" not in vars(kind), f"{name}: declare the dataclass with repr=False"
    types = {field.name: field.type for field in dataclasses.fields(kind)}
    if "status" in types and types["status"] != "int":  # the codes of C are C's
        assert types["status"] == "Status"
        assert "message" in types


def test_the_list_is_not_empty() -> None:
    expected = {"LearnResult", "TrainResult", "JointResult", "FitResult", "TuneResult", "ErrorBound", "Plan"}
    assert expected <= set(RESULTS)


def test_statuses_are_words_that_say_what_they_mean() -> None:
    for status in Status:
        assert str(status) == status.value == status.name.lower()
        assert status.value.replace("_", "").isalpha()
        assert len(status.meaning) > 20
        assert Status(status.value) is status
    assert json.loads(json.dumps({"status": Status.AT_BOUND})) == {"status": "at_bound"}


def record() -> Recording:
    rng = np.random.default_rng(0)
    x = np.cumsum(rng.standard_normal((600, 1)), axis=0)
    return Recording.from_arrays(x=x, dt=0.01, label=PhyFilter([400.0, 30.0]).sampled(0.01).run(x))


SAMPLED = PhyFilter([400.0, 40.0]).sampled(0.01)
LIMITS = PlannerLimits([[-3, -3, 0.3], [3, 3, 2.5]], [[0.2, -0.15, -0.3], [0.4, 0.15, -0.1]])
AT_REST = [0.0, 0.0, 1.3, 0.0, 0.0, 0.0, 0.3, 0.0, -0.15, 0.0, 0.0, 0.0]
Z = np.linspace(-1.0, 1.0, 40)[:, None]
# One of each kind that is made in little time.
MADE = {
    "learn": lambda log: pf.learn(log, 1, search=pf.Search(starts=0)),
    "train": lambda log: design.train(
        log, PhyFilter([10.0]), segment=200, optimiser=design.Adam(max_epochs=2)
    ),
    "fit": lambda log: learned.Chebyshev(degree=2, n_d=0).fit(Z, Z**2),
    "tune": lambda log: baselines.tune(
        baselines.LowpassDifference, [(log.x, log.label, 0.01, 10)], max_evaluations=5
    ),
    "error_bound": lambda log: pf.error_bound(SAMPLED, pf.Bounded({1: 3.0}, noise=0.01)),
    "error_variance": lambda log: pf.error_variance(SAMPLED, pf.Gaussian(noise=0.01)),
    "error_budget": lambda log: pf.error_budget(
        [pf.error_bound(PhyFilter([w]), {1: 1.0}) for w in (5.0, 20.0)]
    ),
    "margins, inner loop": lambda log: pf.margins(SAMPLED),
    "margins, complete loop": lambda log: pf.margins(SAMPLED, pf.Loop(4.0, 3.0)),
    "largest_bandwidth": lambda log: pf.largest_bandwidth(
        lambda w: PhyFilter([w]), pf.Loop(delay=0.02), high=200.0
    ),
    "least_bound": lambda log: optimal.least_bound(1, residual={1: 8.0}, noise=0.01),
    "residual_statistics": lambda log: optimal.residual_statistics([log]),
    "follow": lambda log: follow(
        CooperativePlanner(LIMITS), AT_REST, targets=lambda t: [0.3, 0.0, 0.8], steps=2
    ),
    "compare": lambda log: log.compare({"nothing": np.zeros_like(log.x)}),
}


@pytest.mark.parametrize("name", MADE)
def test_a_result_fits_a_screen_and_json(name: str) -> None:
    result = MADE[name](record())
    lines = repr(result).splitlines()
    assert (len(lines), max(map(len, lines))) <= SCREEN
    assert lines[0] == f"{type(result).__name__}("
    assert lines[-1] == ")"
    table = result._repr_html_()
    assert table.startswith("<table>")
    assert table.count("<tr>") == table.count("</tr>") == len(lines) - 2
    found = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert found == result.to_dict()
    status = getattr(result, "status", None)
    if status is not None:
        assert isinstance(status, Status)
        assert found["status"] == status.value
        assert status.meaning.split(":")[0].split("'")[0] in table
