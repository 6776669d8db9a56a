"""The quadruped's cells in README, results and on its page: alike, and what the walks give."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import numpy as np
import pytest

from phyfilter_ctl import models
from tests.result_cells import row_of

ROOM = f"{models.__name__}.quadruped"
evaluation, methods, params = (
    importlib.import_module(f"{ROOM}.{name}") for name in ("evaluation", "methods", "params")
)
PAGE = "models/quadruped/README.md"
# Labels of results.md, in the order of the page's.
RESULTS = {
    "base": "trained without",
    "observer": "the same, filter put on",
    "filter": "trained with the filter",
    "off": "the same, filter off",
    "improved": "the same, improved filter",
    "basewide": "without, commands to 3 m/s",
    "wide": "with a filter, to 3 m/s",
}
SHARED = {
    "0 %": "payload 0",
    "30 %": "30 %",
    "60 % payload": "60 %",
    "1.5 m/s": "1.5 m/s",
    "2.83 m/s": "2.83 m/s",
    "weak motors": "motors 70 %",
    "push": "push 75 N",
}
# Half a digit of a cell. Walks repeat on every processor, so nothing else is allowed for.
HALF = 0.005 + 1e-9


def numbers(cell: str) -> tuple[float, float, float]:
    """Mean, least and largest policy; the last two are the mean where there is one policy."""
    values = [float(text) for text in re.findall(r"\d*\.\d+", cell)]
    mean, low, high = values if len(values) == 3 else values * 3
    return mean, low, high


def of_page(name: str, column: str) -> tuple[float, float, float]:
    return numbers(row_of("## What came out", methods.METHODS[name].label, PAGE)[column])


def of_results(name: str, column: str) -> float:
    cell = row_of("**The quadruped** (`run quadruped`", RESULTS[name])[column]
    return float(cell.split(" (")[0].strip("*"))


def test_cells_are_alike_and_within_their_intervals():
    for name in methods.USUAL:
        for column, other in SHARED.items():
            mean, low, high = of_page(name, column)
            assert low <= mean <= high
            assert of_results(name, other) == mean
    readme = (Path(__file__).parents[3] / "README.md").read_text(encoding="utf-8")
    row = next(line for line in readme.splitlines() if line.startswith("| [quadruped]"))
    assert [float(text) for text in re.findall(r"\d\.\d\d", row)] == [
        *of_page("base", "60 % payload"),
        *of_page("filter", "60 % payload"),
        of_page("basewide", "60 % payload")[0],
    ]


def test_contact_left_out_is_the_filter_as_it_is():
    for name, label in (
        ("observer", "base, filter put on, omitted"),
        ("filter", "trained with the filter, omitted"),
    ):
        row = row_of("## The forces on the feet", label, PAGE)
        assert row == {
            column: row_of("## What came out", methods.METHODS[name].label, PAGE)[column] for column in row
        }


@pytest.mark.slow
def test_walks_under_the_heaviest_payload_give_the_cells():
    """Those of the README, and of the filter that is told of the forces on the feet."""
    pytest.importorskip("mujoco", reason="mujoco is not installed: nothing walks")
    cells = {name: of_page(name, "60 % payload") for name in ("base", "filter", "basewide")}
    compared = {name: methods.METHODS[name] for name in cells}
    for contact in ("known", "estimated"):
        row = row_of("## The forces on the feet", f"trained with the filter, {contact}", PAGE)
        cells[contact] = numbers(row["60 % payload"])
        compared[contact] = methods.told(methods.METHODS["filter"], contact)
    case = evaluation.Case(0.6 * params.params().robot.mass)
    found = evaluation.walk([evaluation.Group(m.policies(), m.choice) for m in compared.values()], [case])
    for name, outcome in zip(compared, found, strict=True):
        policies = outcome.error[0].mean(axis=1)
        given = [policies.mean(), policies.min(), policies.max()]
        assert np.abs(np.array(given) - cells[name]).max() < HALF, name
