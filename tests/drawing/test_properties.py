"""Drawings of random and of well-known diagrams: no fault that the checker knows, few crossings, always the same."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import control as ct
import pytest

import phyfilter_ctl as pf
from tests.drawing.checker import crossings, faults
from tests.drawing.diagrams import random_diagram, suite
from tests.drawing.gallery import CASES

ROOT = Path(__file__).resolve().parents[2]
DEFAULT, DEEP = 40, 200
LARGE = {"drone", "drone, opened", "arm, opened", "random, 40 blocks"}
# Faults that are known and not yet repaired: as soon as one is, its line here fails.
OPEN = {"arm, opened": "a vector's size, 3, on the name of a port, wind"}
# What a child prints, under another hash seed.
DIGESTS = """
from tests.drawing.test_properties import digests
print(*digests(), sep="\\n")
"""


def check(system: ct.InterconnectedSystem, deepest: int) -> list[str]:
    """All faults, closed and opened."""
    found: list[str] = []
    for depth in range(deepest + 1):
        drawing = pf.draw(system, depth=depth)
        found += [f"depth {depth}: {fault}" for fault in faults(drawing, system if depth == 0 else None)]
        if pf.draw(system, depth=depth) != drawing:
            found.append(f"depth {depth}: two draws differ")
    return found


@pytest.mark.parametrize(("name", "given"), [pytest.param(*case, id=case[0]) for case in suite(DEFAULT)])
def test_random_diagrams(name: str, given: dict[str, Any]):
    assert not check(random_diagram(**given), given.get("nested", 0))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "given"), [pytest.param(*case, id=case[0]) for case in suite(DEEP)])
def test_many_random_diagrams(name: str, given: dict[str, Any]):
    assert not check(random_diagram(**given), given.get("nested", 0))


def test_the_suite_has_what_it_says():
    """Sizes, nesting, vectors, several rates and algebraic loops are there."""
    deep = [given for _, given in suite(DEEP)]
    assert {2, 40} <= {given["count"] for given in deep}
    diagrams = [random_diagram(**given) for _, given in suite(DEFAULT)]
    inner = [
        part for system in diagrams for part in system.syslist if isinstance(part, ct.InterconnectedSystem)
    ]
    assert any(isinstance(part, ct.InterconnectedSystem) for system in inner for part in system.syslist)
    assert any("[2]" in label for system in diagrams for label in system.input_labels)
    rates = [{part.period for part in s.syslist if isinstance(part, pf.SampledBlock)} for s in diagrams]
    assert any(len(periods) > 1 for periods in rates)


def marked(name: str) -> list[pytest.MarkDecorator]:
    marks = [pytest.mark.slow] * (name in LARGE)
    if name in OPEN:
        marks.append(pytest.mark.xfail(reason=OPEN[name], strict=True))
    return marks


@pytest.mark.parametrize("name", [pytest.param(name, marks=marked(name)) for name in CASES])
def test_known_diagrams(name: str):
    case = CASES[name]
    system = case.build()
    drawing = pf.draw(system, depth=case.depth)
    maps = system if case.depth == 0 and isinstance(system, ct.InterconnectedSystem) else None
    assert not faults(drawing, maps)
    if case.crossings is not None:
        assert crossings(drawing) <= case.crossings


def digests() -> list[str]:
    drawings = [pf.draw(random_diagram(**given), depth=1) for _, given in suite(DEFAULT)[:8]]
    drawings += [pf.draw(CASES[name].build()) for name in ("cascade", "phyfilter loop", "steering")]
    return [hashlib.sha256(drawing.svg.encode()).hexdigest() for drawing in drawings]


@pytest.mark.parametrize(
    "seed", ["1", pytest.param("0", marks=pytest.mark.slow), pytest.param("7", marks=pytest.mark.slow)]
)
def test_the_hash_seed_changes_nothing(seed: str):
    told = subprocess.run(
        [sys.executable, "-c", DIGESTS], capture_output=True, text=True, check=True, cwd=ROOT,
        env=os.environ | {"PYTHONHASHSEED": seed, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert told.stdout.split() == digests()
