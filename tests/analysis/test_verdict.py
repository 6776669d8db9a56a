"""The verdict in words: what it says holds, and is rounded to the safe side."""

import math
import re

import numpy as np
import pytest

from phyfilter_ctl import Loop, PhyFilter, error_bound, margins, place_poles
from phyfilter_ctl.analysis.verdict import on_error, on_limit, on_loop


def said(margin, delay_margin):
    return " ".join(sentence.text for sentence in on_loop(margin, delay_margin))


def closed_loop_is_stable(poles, mass, delay):
    """D - N + N Pade(delay) / mass in polynomials: a route of its own, Pade of order 8 for the delay."""
    a = np.real(np.poly(poles))
    N, E = a[-1:], np.append(a[:-1], 0.0)
    k = 8
    den = [math.factorial(2 * k - j) / (math.factorial(j) * math.factorial(k - j)) for j in range(k, -1, -1)]
    den = np.array(den) * delay ** np.arange(k, -1, -1)
    num = den * (-1.0) ** np.arange(k, -1, -1)
    return bool(np.all(np.roots(np.polyadd(np.polymul(E, den), np.polymul(N, num) / mass)).real < 0.0))


def test_what_it_promises_of_delay_and_mass_holds_and_little_more_does():
    poles, lag = [-20.0, -20.0], 0.05
    margin = margins(PhyFilter.from_poles(poles), Loop(delay=lag))
    text = said(margin, margin.delay_margin)
    found = re.fullmatch(
        r"Stable\. Tolerates ([\d.]+) ms more delay, masses from ([\d.]+) times yours\.", text
    )
    assert found, text
    more, least = 1e-3 * float(found[1]), float(found[2])
    assert closed_loop_is_stable(poles, 1.0, lag + more)
    assert not closed_loop_is_stable(poles, 1.0, lag + 1.01 * more)
    assert closed_loop_is_stable(poles, least, lag)
    assert not closed_loop_is_stable(poles, 0.99 * least, lag)


def test_an_unstable_loop_is_said_with_the_masses_that_help():
    margin = margins(PhyFilter.from_poles([-20.0, -20.0]), Loop(delay=0.3))
    sentences = on_loop(margin, 0.0)
    assert {sentence.level for sentence in sentences} == {"bad"}
    found = re.search(r"Stable for masses from ([\d.]+) times yours only", sentences[1].text)
    assert found
    least = float(found[1])
    assert least > 1.0
    assert closed_loop_is_stable([-20.0, -20.0], least, 0.3)
    assert not closed_loop_is_stable([-20.0, -20.0], 0.99 * least, 0.3)


def test_three_poles_without_delay_tolerate_a_ninth_of_the_mass():
    # (s + p)^3 - p^3 + mu p^3 is stable for mu < 9, by Routh.
    margin = margins(PhyFilter.from_poles([-7.0] * 3))
    assert "masses from 0.112 times yours" in said(margin, margin.delay_margin)  # 1/9 = 0.1111 rounded up


def test_the_bound_is_never_rounded_below():
    bound = error_bound(PhyFilter([30.0]), {1: 1.0}).bound
    assert bound == pytest.approx(1.0 / 30.0)
    assert on_error(bound, "N").text == "Error at most 0.03334 N."
    assert on_error(0.25, "", 2.0).text == "Error at most 0.25 while |γ′| ≤ 2 per s."
    for lost in (None, math.inf, math.nan):
        assert on_error(lost, "N", 1.0, "F(0) is not 1").text == "No bound of the error: F(0) is not 1."


@pytest.mark.parametrize(("kind", "omega"), [("error", 12.0), ("estimate", 60.0)])
def test_the_excess_over_a_limit_is_that_of_the_worst_frequency(kind, omega):
    filter = place_poles([-3.0 + 40.0j, -3.0 - 40.0j, -20.0], type=1)
    grid = np.linspace(0.0, omega, 40_001) if kind == "error" else np.geomspace(omega, 1e5, 40_001)
    s = 1j * grid
    D, N = np.polyval(np.append(filter.a, 1.0)[::-1], s), np.polyval(filter.b[::-1], s)
    gains = np.abs((D - N) / D if kind == "error" else N / D)
    excess = 20.0 * math.log10(float(gains.max()) / 0.05)
    assert excess > 0.0
    text = on_limit(filter, kind, omega, 0.05).text
    found = re.match(r"([\d.]+) dB above your limit on \|\S+\| at ([\d.]+) rad/s\.", text)
    assert found, text
    assert excess <= float(found[1]) <= 1.1 * excess  # two digits, upward
    assert float(found[2]) == pytest.approx(grid[gains.argmax()], rel=0.01)
    within = on_limit(filter, kind, omega, 1e3)
    assert within.level == "good"
    spare = excess - 20.0 * math.log10(1e3 / 0.05)
    left = re.match(r"([\d.]+) dB below", within.text)
    assert left
    assert 0.9 * -spare <= float(left[1]) <= -spare * (1.0 + 1e-6)  # two digits, downward
