"""A robot file turns a raw log into a recording that the filter recovers the unknown force from."""

from itertools import pairwise

import numpy as np
import pytest

import phyfilter_ctl as pf
from tests.robot.flight import MASS, SLOPE, fly, log_of, px4_topics, wind

FLIGHT = fly()
SHORT = fly(12.0)
FILTER = pf.lowpass(1, 8.0)
SETTLED = 3.0  # s, e^-24 of the start


def estimate(log, dt=0.02, filter=FILTER):
    sampled = filter.sampled(dt, nonfinite="hold")
    return sampled.run(log.x, log.g, log.f_theta, log.inertia, log.times)


def test_the_wind_is_recovered_to_what_the_theory_says(px4):
    """PX4's topics at their own rates, in NED and FRD, a velocity with dropouts and a motor command that changes."""
    log = px4.read(log_of("flight.ulg", px4_topics(FLIGHT)))
    error = estimate(log) - wind(log.times)
    settled = log.times > SETTLED
    # A dropout doubles or trebles a step: the bound is that of the longest.
    longest = float(np.max(np.diff(log.times)))
    assert longest > 0.039
    bounds = [pf.error_bound(FILTER.sampled(longest), {1: slope}).bound for slope in SLOPE]
    assert np.all(np.abs(error[settled]).max(axis=0) <= bounds)
    assert np.all(np.abs(error[settled]).max(axis=0) >= 0.5 * np.array(bounds))  # and the bound is near


def test_noise_adds_what_the_theory_says(px4):
    noise = 0.02
    clean, noisy = (
        px4.read(log_of("f.ulg", px4_topics(FLIGHT, noise=s, dropouts=False))) for s in (0.0, noise)
    )
    added = (estimate(noisy) - estimate(clean))[clean.times > SETTLED]
    expected = pf.error_variance(FILTER.sampled(0.02), pf.Gaussian(noise=noise * MASS)).noise
    # 1,850 samples of three channels, correlated over 1/8 s: some 900 independent ones.
    assert np.mean(added**2) == pytest.approx(expected, rel=4.0 * np.sqrt(2.0 / 900))


def test_g_is_integrated_over_the_steps_of_x_not_sampled(px4):
    """x at 10 Hz, motors at 250 Hz."""
    log = px4.read(log_of("f.ulg", px4_topics(FLIGHT, every=100, dropouts=False)))
    t, ends = FLIGHT.times, np.round(log.times / 1e-3).astype(int)
    means = np.array([np.trapezoid(wind(t[a : b + 1]), t[a : b + 1], axis=0) for a, b in pairwise(ends)])
    u = np.diff(log.x, axis=0) * MASS / 0.1 - log.g[:-1]
    assert np.max(np.abs(u - means / 0.1)) < 2e-3  # of a line between attitudes 8 ms apart; the wind is 1 N
    sampled = g_at_the_samples(px4, log)
    assert np.sqrt(np.mean((np.diff(log.x, axis=0) * MASS / 0.1 - sampled - means / 0.1) ** 2)) > 0.1


def g_at_the_samples(robot, log):
    motors = FLIGHT.motors[np.searchsorted(FLIGHT.motor_times, log.times[:-1], side="right") - 1]
    from tests.robot.flight import GRAVITY, MOTOR_THRUST, attitude

    thrust = motors.sum(axis=1) * MOTOR_THRUST
    return attitude(log.times[:-1]).apply(thrust[:, None] * [0.0, 0.0, 1.0]) - [0.0, 0.0, MASS * GRAVITY]


TWO = """
format = "phyfilter-robot"
version = 1
signals.x = { topic = "slow", field = "x", unit = "m/s" }
signals.u = { topic = "fast", field = "u", unit = "N", between = "BETWEEN" }
signals.z = { topic = "model", field = "z", unit = "1", gap = 1.0 }
model = { x = "x", M = "2", g = "u - 1", f_theta = "3*z", unit = "m/s" }
"""


@pytest.mark.parametrize("between", ["hold", "linear"])
def test_two_clocks_leave_nothing(load, between):
    """x' = (u - 1 + 3 z) / 2 exactly: the residual of every step is zero, f_theta's own mean included."""
    rng = np.random.default_rng(3)
    fast = np.unique(np.concatenate([[0.0], np.sort(rng.uniform(0.0, 10.0, 2500)), [10.0]]))
    u = rng.standard_normal(len(fast))
    model = np.linspace(0.0, 10.0, 61)
    z = np.sin(model)
    slow = np.sort(rng.uniform(0.5, 9.5, 91))

    def integral(times, values, held):
        inner = np.diff(times) * (values[:-1] if held else 0.5 * (values[1:] + values[:-1]))
        total = np.append(0.0, np.cumsum(inner))

        def at(t):
            k = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
            part = t - times[k]
            slope = 0.0 if held else (values[k + 1] - values[k]) / np.diff(times)[k]
            return total[k] + part * (values[k] + 0.5 * slope * part)

        return at(slow)

    x = 0.5 * (integral(fast, u, between == "hold") - slow + 3.0 * integral(model, z, False))
    topics = {"slow": (slow, {"x": x}), "fast": (fast, {"u": u}), "model": (model, {"z": z})}
    log = load(TWO.replace("BETWEEN", between)).read(log_of("two.ulg", topics))
    assert len(log) == 91
    f_hat = estimate(log, dt=0.1)
    assert np.max(np.abs(f_hat - log.f_theta)) < 1e-11


@pytest.mark.slow
def test_wrong_frames_are_noticed_and_the_right_ones_named(load):
    from tests.robot.conftest import PX4

    log = log_of("f.ulg", px4_topics(SHORT, noise=0.02))
    assert load(PX4).check(log).findings == ()
    for wrong, right in (
        ('signals.q = { rotation = "xyzw" }', 'q: rotation = "wxyz", frames = ["FRD", "NED"]'),
        ('signals.q = { frames = ["NED", "FRD"] }', 'q: rotation = "wxyz", frames = ["FRD", "NED"]'),
        ('signals.v = { frame = "ENU" }', 'v: frame = "NED"'),
    ):
        (finding,) = load(PX4 + wrong).check(log).findings
        assert finding.suspicion == "wrong_frame"
        assert right in finding.message


def test_a_wrong_mass_is_noticed(load):
    from tests.robot.conftest import PX4

    found = load(PX4.replace("mass = 1.5", "mass = 3.0")).check(log_of("f.ulg", px4_topics(SHORT)))
    (finding,) = found.findings
    assert finding.suspicion == "wrong_mass"
    fits = float(finding.message.split("mass = ")[1].split()[0])
    assert fits == pytest.approx(1.5, rel=0.1)


def test_gaps_stay_gaps(px4):
    """Motors that say nothing for a second: their steps are NaN, not bridged; x that is missing is a longer step."""
    topics = px4_topics(FLIGHT, dropouts=False)
    times, columns = topics["actuator_motors"]
    kept = (times < 10.0) | (times > 11.0)
    topics["actuator_motors"] = times[kept], {name: values[kept] for name, values in columns.items()}
    times, columns = topics["vehicle_local_position"]
    columns["vx"][300:310] = np.nan
    log = px4.read(log_of("f.ulg", topics))
    hole = np.isnan(log.g).any(axis=1)
    silent = (log.times > 9.95) & (log.times < 11.01)
    assert 49 <= hole[silent].sum() <= 52
    assert hole[~silent].sum() <= 11  # of the drag, which takes v
    assert np.isnan(log.x).any(axis=1).sum() == 10
    assert int(log.missing.sum()) == int(hole.sum())
    assert np.all(np.isfinite(estimate(log)))
    pieces = log.pieces()
    assert [len(p) > 100 and not p.missing.any() for p in pieces] == [True] * 3
    with pytest.raises(ValueError, match="pieces"):
        pf.learn(log.with_signals(label=log.x), 1)


def test_a_clock_offset_and_a_delay_shift_the_signal(load):
    t = np.arange(0.0, 2.0, 0.01)
    topics = {"a": (t, {"x": 0.0 * t}), "b": (t, {"u": t})}
    text = """
    format = "phyfilter-robot"
    version = 1
    clocks = { b = 0.5 }
    signals.x = { topic = "a", field = "x", unit = "m/s" }
    signals.u = { topic = "b", field = "u", unit = "N", delay = 0.25 }
    model = { x = "x", g = "u" }
    """
    log = load(text).read(log_of("f.ulg", topics))
    assert log.times[0] == pytest.approx(0.75)
    assert log.g[:-1, 0] == pytest.approx(log.times[:-1] + 0.005 - 0.75, abs=1e-12)
