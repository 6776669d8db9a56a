"""Views of the loop: against formulas in z by hand, with python-control's plant, and against the margins' search."""

from __future__ import annotations

import math

import control as ct
import numpy as np
import pytest
from designer_messages import answered, message_of, refused
from numpy.typing import NDArray

import phyfilter_ctl as pf
from phyfilter_ctl.app.handling import Session

POLES = [-20.0, -12 + 9j, -12 - 9j]
STEP, LAG, DELAY, RATIO = 0.002, 0.03, 0.006, 1.4
ROUNDING = 1e-9  # of sums over a few hundred samples, and of an inverse of size 3


def design(**more: float) -> dict[str, object]:
    given = {"numerator": {"kind": "type", "type": 2}, "dt": STEP, "method": "exact"}
    return message_of(POLES, **given, **({"lag": LAG, "delay": DELAY, "ratio": RATIO} | more))  # type: ignore[arg-type]


def filter_and_plant(
    z: NDArray[np.complex128], *, lag: float = LAG, delay: float = DELAY
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """F_d(z), and H(z): from the command to the mean of a unit mass' acceleration over the step that ends."""
    F = pf.design.place_poles(POLES, type=2)
    dA, equilibrium, C = F.sampled(STEP, "exact").transition
    B = -dA @ equilibrium
    F_d = np.array([v * C @ np.linalg.solve((v - 1.0) * np.eye(len(C)) - dA, B) for v in z])
    act = ct.tf(1, [lag, 1]) if lag else ct.tf(1, 1)
    velocity = ct.sample_system(ct.ss(act * ct.tf(1, [1, 0])), STEP, "zoh")
    X = np.array([ct.evalfr(velocity, v) for v in z])
    return F_d, (1.0 - 1.0 / z) / STEP * X * z ** -round(delay / STEP)


@pytest.mark.slow
def test_the_loop_s_gains_are_those_of_the_sampled_loop_by_hand() -> None:
    reply = answered(Session(), "loop", design=design(ratio_spread=0.3, lag_spread=0.01, delay_spread=0.002))
    omega = np.array(reply["omega"])
    assert omega[-1] == pytest.approx(math.pi / STEP)
    z = np.exp(1j * omega * STEP)

    def gain(ratio: float, lag: float, delay: float) -> NDArray[np.complex128]:
        F, H = filter_and_plant(z, lag=lag, delay=delay)
        return ratio * F * H / (1.0 - F / z)

    L = gain(RATIO, LAG, DELAY)
    for key, expected in (("L", L), ("S", 1.0 / (1.0 + L)), ("T", L / (1.0 + L))):
        found = np.array(reply[key][0]) + 1j * np.array(reply[key][1])
        # 1 - F/z cancels at low frequencies by hand: compared where it does not.
        seen = np.abs(L) < 1e4
        assert np.max(np.abs(found - expected)[seen] / np.abs(expected[seen])) < 1e-8
    band = reply["band"]
    assert (band["members"], band["unstable"], len(band["corners"])) == (45, 2, 8)
    assert "45 loops on a grid" in reply["message"]
    assert "unstable at 2 of them" in reply["message"]
    for corner in band["corners"]:
        expected = gain(corner["ratio"], corner["lag"], corner["delay"])
        found = np.array(corner["L"][0]) + 1j * np.array(corner["L"][1])
        assert np.max(np.abs(found - expected)[seen] / np.abs(expected[seen])) < 1e-8
        for side, sign in ((0, 1.0), (1, -1.0)):
            assert np.all(sign * np.array(band["L"][side]) <= sign * np.abs(found) * (1.0 + sign * 1e-12))
    ends = {corner["ratio"] for corner in band["corners"]}
    assert sorted(ends) == pytest.approx([RATIO / 1.3, RATIO * 1.3])


def test_time_responses_have_the_transfer_functions_of_the_loop_by_hand() -> None:
    reply = answered(Session(), "responses", design=design(noise=1.0))
    t = np.array(reply["t"])
    assert reply["dt"] == STEP
    # Outside the unit circle the samples left out are below the rounding.
    radius = 10.0 ** (12.0 / len(t))
    z = radius * np.exp(1j * np.linspace(0.05, 3.0, 12))
    F, H = filter_and_plant(z)
    chi = 1.0 - F / z + RATIO * H * F
    difference = 1.0 - 1.0 / z
    k = np.arange(1, len(t) + 1)
    powers = z[:, None] ** -k
    expected = {
        "command": RATIO * H / chi / difference,
        # Over the first step the residual acts on x and nothing is known of it yet.
        "disturbance": (1.0 - F / z) / chi / z / difference,
    }
    for key, value in expected.items():
        found = powers @ np.array(reply[key]["value"])
        assert np.max(np.abs(found - value)) < ROUNDING * np.max(np.abs(value)), key
    noise = np.array(reply["noise"]["value"])
    found = (z[:, None] ** (1 - k)) @ noise
    value = -F * difference / STEP / chi
    assert np.max(np.abs(found - value)) < ROUNDING * np.max(np.abs(value))
    assert reply["noise_sd"] == pytest.approx(math.sqrt(np.sum(noise**2)))
    assert reply["command"]["value"][-1] == pytest.approx(1.0, abs=0.02)
    assert reply["disturbance"]["value"][-1] == pytest.approx(0.0, abs=0.02)


@pytest.mark.slow
def test_a_locus_ends_where_the_margins_end_and_its_poles_solve_the_loop() -> None:
    reply = answered(Session(), "locus", design=design(), over="ratio")
    sampled = pf.design.place_poles(POLES, type=2).sampled(STEP, "exact")
    margin = pf.margins(sampled, pf.Loop(actuator=LAG, delay=DELAY))
    leaving = [each for each in reply["limits"] if each["leaving"]]
    assert leaving[0]["at"] == pytest.approx(margin.max_ratio, rel=1e-8)
    now = np.array([complex(*each) for each in reply["now"]])
    z = np.exp(now * STEP)
    F, H = filter_and_plant(z)
    assert np.max(np.abs(1.0 - F / z + RATIO * H * F) / (1.0 + np.abs(F))) < 1e-7
    at = np.array(reply["at"])
    here = int(np.argmin(np.abs(at - RATIO)))
    drawn = {tuple(branch[here]) for branch in reply["branches"] if branch[here]}
    assert drawn == {tuple(each) for each in reply["now"]}
    for branch in reply["branches"]:  # a branch goes on: no jump to another one's place
        points = np.array([complex(*each) if each else np.nan for each in branch])
        steps = np.abs(np.diff(points)) / np.abs(points[1:])
        assert np.nanmax(steps, initial=0.0) < 0.5


@pytest.mark.slow
def test_a_locus_over_the_bandwidth_finds_where_the_loop_is_lost() -> None:
    reply = answered(Session(), "locus", design=design(), over="bandwidth")
    (limit,) = reply["limits"]
    stable = []
    for factor in (0.999 * limit["at"], 1.001 * limit["at"]):
        filter = pf.design.place_poles([factor * p for p in POLES], type=2)
        margin = pf.margins(
            filter.sampled(STEP, "exact"), pf.Loop(actuator=LAG, delay=DELAY, inertia_ratio=RATIO)
        )
        stable.append(margin.is_stable)
    assert stable == [True, False]


@pytest.mark.slow
def test_what_cannot_be_drawn_is_said() -> None:
    session = Session()
    late = answered(session, "locus", design=design(delay=0.5), over="ratio")
    assert late["branches"] == []
    assert "250 steps" in late["message"]
    assert answered(session, "loop", design=design(delay=0.5))["note"].startswith("continuous loop")
    euler = message_of([-2000.0, -1000.0], dt=STEP, method="euler")
    assert answered(session, "responses", design=euler)["t"] == []
    assert "unstable" in answered(session, "locus", design=euler, over="bandwidth")["message"]
    slow = answered(session, "responses", design=message_of([-0.01], lag=0.0, delay=0.0))
    assert "sampled every" in slow["message"]
    assert refused(session, "locus", design=design(), over="all")["where"] == "over"
    assert refused(session, "loop", design=design(lag_spread=-1.0))["where"] == "design.assume.lag_spread"
