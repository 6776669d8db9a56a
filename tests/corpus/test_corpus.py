"""The corpus in the suite: a few systems always, five families without a compiler with -m slow, all with -m release.

The whole of it, with its table, is ``python -m tests.corpus --fmu``.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.corpus.random_systems import random_system
from tests.corpus.reference import Exit, Hybrid, filippov, smooth, stepped, switched
from tests.corpus.run import MOST_AMPLIFIED, SHORT_ROUTES, Case, examined, main
from tests.corpus.systems import FAMILIES, all_systems
from tests.cpu_budget import release_but

# What the reference may be off where a closed form is known: it is asked for 1e-11 a step.
EXACT = 1e-9
SHORT = [each for each in all_systems() if each.short]


def assert_none_wrong(system, cells):
    wrong = {route: cell.message for route, cell in cells.items() if cell.outcome in ("wrong", "crash")}
    assert not wrong, f"{system.name}: {wrong}"


# -- the reference itself -----------------------------------------------------------------------------------------


def test_reference_crosses_a_switch():
    times = np.linspace(0.0, 2.0, 9)
    found = switched(lambda t, x: x[0] - 1.0, lambda t, x: [2.0], lambda t, x: [1.0])(times, [0.0])
    np.testing.assert_allclose(found[0], np.where(times < 1.0, times, 2.0 * times - 1.0), atol=EXACT)


def test_reference_climbs_a_staircase():
    # x' = 1 + floor(x): 1 s for the first step, 1/2 for the second, 1/3 for the third.
    found = stepped(lambda t, x: x[0], lambda t, x, k: [1.0 + k])(
        np.array([0.0, 1.0, 1.5, 11.0 / 6.0]), [0.0]
    )
    np.testing.assert_allclose(found[0], [0.0, 1.0, 2.0, 3.0], atol=EXACT)


def test_reference_sticks_and_breaks_away():
    # A mass under a force t / 2 and friction 1: at rest until 2 s, then v' = t / 2 - 1.
    system = filippov(lambda t, x, s: [0.5 * t - s[0]], lambda t, x: [x[0]], lambda t, x, s: [0.5 * t - s[0]])
    times = np.linspace(0.0, 5.0, 11)
    np.testing.assert_allclose(system(times, [0.0])[0], 0.25 * np.maximum(times - 2.0, 0.0) ** 2, atol=EXACT)
    # Thrown at 1 m/s without a force it stops after 1 s, having gone 1/2 m.
    thrown = filippov(lambda t, x, s: [x[1], -s[0]], lambda t, x: [x[1]], lambda t, x, s: [-s[0]])
    np.testing.assert_allclose(
        thrown(np.array([0.0, 1.0, 3.0]), [0.0, 1.0]), [[0.0, 0.5, 0.5], [1.0, 0.0, 0.0]], atol=EXACT
    )


def test_reference_bounces():
    ball = Hybrid(
        lambda t, x, mode: [x[1], -10.0],
        lambda mode: (Exit(lambda t, x: -x[0], "", lambda t, x: [0.0, -0.5 * x[1]]),),
    )
    # From 5 m it lands after 1 s at 10 m/s, and at 5 m/s again after another second.
    found = ball(np.array([0.0, 0.5, 1.5, 2.25]), [5.0, 0.0])
    np.testing.assert_allclose(found[0], [5.0, 3.75, 1.25, 0.25 * 2.5 - 5.0 * 0.0625], atol=EXACT)


def test_reference_samples():
    # Every second x is halved; between x' = 0.
    found = smooth(lambda t, x: [0.0], instants=[(1.0, lambda t, x: [0.5 * x[0]])])(
        np.array([0.0, 0.5, 1.0, 2.7]), [8.0]
    )
    np.testing.assert_array_equal(found[0], [4.0, 4.0, 2.0, 1.0])


# -- the corpus ---------------------------------------------------------------------------------------------------


def test_size():
    systems = all_systems()
    assert len(systems) >= 150
    assert len({each.name for each in systems}) == len(systems)
    assert len({each.structure for each in systems}) >= 30
    assert sum(bool(each.source) for each in systems) >= 40


@pytest.mark.release
def test_answers_are_well_posed():
    amplified = {each.name: Case(each).amplification for each in all_systems()}
    assert {name: value for name, value in amplified.items() if value > MOST_AMPLIFIED} == {}


@pytest.mark.parametrize("system", SHORT, ids=lambda each: each.name)
def test_short(system):
    cells = examined(system, ("simulate",))
    assert cells["simulate"].outcome == ("right" if system.solvable else "status"), cells["simulate"].message


@pytest.mark.parametrize(
    "family", release_but({"events", "friction", "loops", "motors", "switches"}, FAMILIES)
)
def test_family(family):
    for system in FAMILIES[family]:
        assert_none_wrong(system, examined(system, SHORT_ROUTES))


@pytest.mark.release
def test_whole():
    assert main(["--fmu"]) == 0


@pytest.mark.slow
@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_random_systems(seed):
    system = random_system(seed)
    assert_none_wrong(system, examined(system, ("simulate", "stiff-vm")))
