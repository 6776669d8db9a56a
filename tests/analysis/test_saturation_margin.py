"""How far beyond its limit a command may go: the circle criterion against matrices, closed forms, clipped flights."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest

from phyfilter_ctl import Loop, PhyFilter, lowpass, margins, place_poles, saturation_margin, stack
from tests.peers.saturation import (
    ATTACKS,
    Batch,
    attacked,
    clipped,
    random_cases,
    switched,
    without_position,
    wrong,
)

FIRST = PhyFilter([20.0])
FILTERS = [FIRST, lowpass(2, 20.0, family="butterworth"), place_poles([-20.0] * 2, type=2)]
# Dips of Re S are refined to 1e-7 of their frequency, about which they are flat.
FLAT = 1e-9


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_k_is_where_the_common_lyapunov_function_ends(seed):
    cases = random_cases(40 if seed == 1 else 300, seed)
    assert {(case.told, case.h > 0.0, case.late > 0) for case in cases} >= {
        ("saturated", True, True),
        ("commanded", True, True),
        ("saturated", False, False),
        ("commanded", False, False),
    }
    assert [case for case in cases if wrong(case)] == []


@pytest.mark.slow
def test_attacks_within_the_sector_die_out():
    rng = np.random.default_rng(5)
    cases, least = attacked(random_cases(60, 5), "commanded")
    batch = Batch.of([without_position(case) for case in cases])
    omega_h = np.array([max(case.margin().frequency * case.h, 0.01) for case in cases])
    assert not switched(batch, 1.001 * least, omega_h, rng).any()
    assert switched(batch, 0.2 * least, omega_h, rng).sum() > ATTACKS  # they are attacks
    largest, fell = clipped(batch, rng)
    assert np.all(fell[largest < 1.0 / least[:, None]])
    assert not np.all(fell)


@pytest.mark.parametrize("filter", FILTERS)
def test_told_what_acts_the_filter_is_not_in_the_loop(filter):
    """Exact model, ideal actuator: S of the PD loop alone, s^2/(s^2 + kd s + kp), whose least real part is known."""
    kp, kd = 10.0, 6.0
    # With y = omega^2/kp and c = kd^2/kp: Re S = y (y - 1)/((1 - y)^2 + c y), least where (c - 1) y^2 + 2 y = 1.
    c = kd**2 / kp
    y = (np.sqrt(c) - 1.0) / (c - 1.0)
    least = y * (y - 1.0) / ((1.0 - y) ** 2 + c * y)
    found = saturation_margin(filter, Loop(kp, kd))
    assert found.command_excess == pytest.approx(1.0 - 1.0 / least, rel=FLAT)
    assert found.frequency == pytest.approx(np.sqrt(kp * y), rel=1e-4)
    omega = np.array([0.3, 4.0, 70.0])
    s = 1j * omega
    np.testing.assert_allclose(found.sensitivity(omega), s**2 / (s**2 + kd * s + kp), rtol=1e-12)


@pytest.mark.parametrize("filter", FILTERS)
@pytest.mark.parametrize("dt", [None, 0.01])
def test_k_is_no_less_than_the_lower_gain_margin(filter, dt):
    settings = {"kp": 12.0, "kd": 5.0, "actuator": ct.tf(1.0, [0.03, 1.0]), "delay": 0.01}
    linear = margins(filter, Loop(**settings), dt=dt)
    told = saturation_margin(filter, Loop(**settings), g="commanded", dt=dt)
    assert linear.is_stable == told.is_stable
    if told.is_stable:
        assert 1.0 > told.least_gain >= linear.gain_margin[0]
        assert linear.gain_margin[0] > 0.0  # three integrators


def flight(sampled, position, seconds=30.0, limit=1.0):
    """PD and f_hat on a mass of 1 kg: largest command over the limit, largest position of the last fifth."""
    h = sampled.dt
    state, speed, command, largest, end = sampled.start([0.0]), 0.0, 0.0, 0.0, 0.0
    for k in range(round(seconds / h)):
        f_hat = 0.0
        if k:
            state, out = sampled.step(state, [speed], [command])
            f_hat = float(out[0])
        command = -10.0 * position - 6.0 * speed - f_hat
        largest = max(largest, abs(command) / limit)
        force = min(max(command, -limit), limit)
        position += h * speed + 0.5 * h**2 * force
        speed += h * force
        if k * h > 0.8 * seconds:
            end = max(end, abs(position))
    return largest, end


def test_told_the_command_it_diverges_told_what_acts_it_does_not():
    h, loop = 0.01, Loop(10.0, 6.0)
    commanded, saturated = (saturation_margin(FIRST, loop, g=g, dt=h) for g in ("commanded", "saturated"))
    ignorant, knowing = FIRST.sampled(h), FIRST.sampled(h, g_limit=(-1.0, 1.0))
    excess, end = flight(ignorant, 0.2)
    assert 1.5 < excess < commanded.command_excess
    assert end < 1e-6
    excess, end = flight(ignorant, 3.0)
    assert excess > commanded.command_excess
    assert end > 10.0
    excess, end = flight(knowing, 3.0)
    assert excess > saturated.command_excess  # sufficient, not necessary
    assert end < 1e-6


def test_sampled_is_continuous_for_short_steps():
    settings = {
        "kp": 10.0,
        "kd": 6.0,
        "actuator": ct.tf(1.0, [0.02, 1.0]),
        "delay": 0.005,
        "inertia_ratio": 0.7,
    }
    for g in ("saturated", "commanded"):
        fine, limit = (
            saturation_margin(FILTERS[1], Loop(**settings), g=g, dt=dt).least_gain for dt in (1e-4, None)
        )
        assert fine == pytest.approx(limit, rel=5e-3)  # half a step of delay and more, of 10 ms that count


def test_the_filter_alone():
    """Without an outer loop: 1/chi has a positive real part for one pole, whatever the ratio below 2 and no lag."""
    told = saturation_margin(FIRST, Loop(inertia_ratio=1.7))
    assert told.least_gain == 0.0
    assert told.command_excess == np.inf
    assert "commands of any size" in told.describe()
    lagging = saturation_margin(FIRST, Loop(actuator=0.1, delay=0.02), g="commanded")
    assert 1.0 < lagging.command_excess < 10.0
    assert f"up to {lagging.command_excess:.4g} times" in lagging.describe()


def test_what_is_unstable_or_wrong():
    lost = saturation_margin(PhyFilter([60.0]), Loop(10.0, 6.0, actuator=0.1, delay=0.02))
    assert not lost.is_stable
    assert np.isnan(lost.command_excess)
    assert "unstable" in lost.describe()
    with pytest.raises(ValueError, match="g: expected 'saturated', 'commanded', 'applied', got 'hold'"):
        saturation_margin(FIRST, g="hold")  # type: ignore[arg-type]  # wrong on purpose
    with pytest.raises(ValueError, match="use g='hold'"):
        saturation_margin(FIRST.sampled(0.01, g="average"))
    each = saturation_margin(stack(FILTERS), [Loop(10.0, kd) for kd in (6.0, 7.0, 8.0)], g="commanded")
    assert [one.command_excess for one in each] == [
        saturation_margin(F, Loop(10.0, kd), g="commanded").command_excess
        for F, kd in zip(FILTERS, (6.0, 7.0, 8.0), strict=True)
    ]
