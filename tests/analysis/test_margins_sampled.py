"""Sampled loops: closed forms, loops that run SampledPhyFilter.step, and the limit of fast sampling."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from phyfilter_ctl import Loop, PhyFilter, SampledPhyFilter, margins
from phyfilter_ctl.analysis.margins import FilterMargins, largest_bandwidth

# Closed forms and refined figures.
CLOSE = 1e-9
# A limit read off how fast simulated loops on both sides of it grow and decay.
SIMULATED = 3e-3
# Growth per step below which a simulation of this length does not tell.
UNDECIDED = 5e-3


def repeated(n: int, w: float = 20.0, *, full: bool = False) -> PhyFilter:
    a = PhyFilter.from_poles([-w] * n).a
    return PhyFilter.from_poles([-w] * n, a if full else None)


def growth(
    sampled: SampledPhyFilter,
    ratios: np.ndarray,
    *,
    lag: float | None = None,
    delay: float = 0.0,
    kp: float = 0.0,
    kd: float = 0.0,
    steps: int = 1200,
) -> np.ndarray:
    """Growth per step of the loop tau = -M_hat (kp p + kd x) - f_hat around unit masses, one channel per ratio.

    The command is held; it reaches the plant after the delay, between two samples if need be, and acts through a
    first-order lag solved in closed form. The measurement is late by the filter's own delay, p and x alike.
    """
    h, channels = sampled.dt, len(ratios)
    rng = np.random.default_rng(1)
    p, x, a = np.zeros(channels), np.zeros(channels), np.zeros(channels)
    kick = rng.standard_normal((5, channels))
    whole, part = divmod(
        (delay + sampled.sampling.delay) / h, 1.0
    )  # plant and measurement late together: linear
    line = [np.zeros(channels)] * (int(whole) + 2)
    state = sampled.start(x, inertia0=ratios)
    command, size = np.zeros(channels), np.zeros((steps, channels))
    f_hat, gone = np.zeros(channels), np.zeros(channels, dtype=bool)
    for k in range(steps):
        if k:
            state, f_hat = sampled.step(state, x, command)
        command = -ratios * (kp * p + kd * x) - f_hat
        if k < len(kick):
            command = command + kick[k]
        gone |= np.abs(command) > 1e60
        command[gone] = 0.0
        line = [command, *line[:-1]]
        for sent, span in ((line[int(whole) + 1], part * h), (line[int(whole)], (1.0 - part) * h)):
            if lag is None:
                gained, moved = sent * span, 0.5 * sent * span**2
            else:
                left = 1.0 - np.exp(-span / lag)
                gained = sent * span + (a - sent) * lag * left
                moved = 0.5 * sent * span**2 + (a - sent) * lag * (span - lag * left)
                a = a + (sent - a) * left
            p, x = p + x * span + moved, x + gained
        size[k] = np.abs(command)
    third = steps // 3
    early, late = (np.max(part, axis=0) for part in (size[third : 2 * third], size[2 * third :]))
    assert np.all((early > 0.0) | gone)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(gone, 1.0, np.log(late / early) / third)


# -- closed forms ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("w", [1e-3, 20.0, 200.0])
def test_first_order_is_lost_at_the_nyquist_frequency(w: float):
    """w_k = (1 - mu q) w_{k-1}: stable below 2/q, q = 1 - e^(-w h); 51 at w h = 0.04."""
    h = 0.002
    gains = {"exact": -np.expm1(-w * h), "euler": w * h, "tustin": w * h / (1.0 + 0.5 * w * h)}
    for method, q in gains.items():
        margin = margins(PhyFilter([w]).sampled(h, method=method))
        assert margin.stable_ratios == ((0.0, pytest.approx(2.0 / q, rel=CLOSE)),)
        assert margin.ratio_crossings[-1].omega == pytest.approx(np.pi / h, rel=1e-6)
        # L = q/(z - 1).
        assert margin.modulus_margin == pytest.approx(1.0 - 0.5 * q, rel=CLOSE)
        theta = 2.0 * np.arcsin(0.5 * q)
        assert margin.gain_crossings == pytest.approx([theta / h], rel=1e-7)
        assert margin.phase_margin == pytest.approx(0.5 * np.pi - 0.5 * theta, rel=1e-7)
    assert margins(PhyFilter([20.0]), dt=0.002).max_ratio == pytest.approx(51.0067, abs=1e-4)


@pytest.mark.parametrize("whole", [1, 3, 10])
def test_first_order_with_whole_steps_of_delay(whole: int):
    """Q = (z - 1)/(z - 1 + q), P = z^-m q/(z - 1 + q): z^m (z - 1) + mu q."""
    h, w = 0.01, 20.0
    q = -np.expm1(-w * h)
    margin = margins(PhyFilter([w]), Loop(delay=whole * h), dt=h)
    limit = margin.stable_ratios[0][1]
    for mu, inside in ((0.999999 * limit, True), (1.000001 * limit, False)):
        polynomial = np.zeros(whole + 2)
        polynomial[:2] = 1.0, -1.0
        polynomial[-1] += mu * q
        assert (np.max(np.abs(np.roots(polynomial))) < 1.0) == inside


@pytest.mark.slow
@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("n", [1, 3])
def test_fast_sampling_tends_to_the_continuous_margins(n: int, full: bool):
    filter = repeated(n, full=full)
    options = {"kp": 10.0, "kd": 6.0, "actuator": ct.tf(1, [0.02, 1]), "delay": 0.005}
    continuous = margins(filter, Loop(**options))
    for h, tolerance in ((1e-4, 2e-2), (1e-5, 2e-3)):
        fast = margins(filter, Loop(**options), dt=h)
        assert fast.max_ratio == pytest.approx(continuous.max_ratio, rel=tolerance)
        assert fast.min_ratio == pytest.approx(continuous.min_ratio, rel=tolerance)
        assert fast.modulus_margin == pytest.approx(continuous.modulus_margin, rel=tolerance)
    assert margins(filter, Loop(**options), dt=1e-4).delay_margin == pytest.approx(
        continuous.delay_margin, rel=2e-2
    )


# -- against simulation ---------------------------------------------------------------------------------------------


def simulated_limit(
    sampled: SampledPhyFilter, limit: float, *, spread: float = 0.04, steps: int = 6000, **loop: float
) -> float:
    """Where the growth crosses zero, from loops a few percent to either side."""
    ratios = limit * np.linspace(1.0 - spread, 1.0 + spread, 9)
    rate = growth(sampled, ratios, steps=steps, **loop)
    if rate[0] > rate[-1]:
        ratios, rate = ratios[::-1], rate[::-1]
    assert rate[0] < 0.0 < rate[-1]
    return float(np.interp(0.0, rate, ratios))


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_upper_limits_by_simulation(n: int):
    sampled = repeated(n).sampled(0.005)
    margin = margins(sampled)
    # Lost at the Nyquist frequency the first-order loop decays to rounding within a few hundred steps.
    found = simulated_limit(
        sampled, margin.max_ratio, spread=0.01 if n == 1 else 0.04, steps=1200 if n == 1 else 6000
    )
    assert found == pytest.approx(margin.max_ratio, rel=SIMULATED)


@pytest.mark.parametrize("n", [3, 4, 5])
def test_lower_limits_by_simulation(n: int):
    sampled = repeated(n, full=True).sampled(0.005)
    margin = margins(sampled)
    assert simulated_limit(sampled, margin.min_ratio) == pytest.approx(margin.min_ratio, rel=SIMULATED)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["exact", "euler", "tustin"])
@pytest.mark.parametrize("delay", [0.0, 0.0137, 0.03])
def test_lag_delay_and_outer_loop_by_simulation(method: str, delay: float):
    sampled = PhyFilter.from_poles([-9.0, -9.0]).sampled(0.01, method=method)
    loop = {"kp": 10.0, "kd": 6.0, "delay": delay}
    margin = margins(sampled, Loop(actuator=0.05, **loop))
    found = simulated_limit(sampled, margin.max_ratio, lag=0.05, **loop)
    assert found == pytest.approx(margin.max_ratio, rel=SIMULATED)


@pytest.mark.slow
def test_measurement_delay_by_simulation():
    """The filter knows its measurement to be late and delays g alike."""
    sampled = PhyFilter([15.0]).sampled(0.01, delay=0.025)
    margin = margins(sampled, Loop(4.0, 3.0, actuator=0.05, delay=0.013))
    found = simulated_limit(sampled, margin.max_ratio, lag=0.05, delay=0.013, kp=4.0, kd=3.0)
    assert found == pytest.approx(margin.max_ratio, rel=SIMULATED)


@pytest.mark.slow
@given(
    poles=st.lists(st.floats(2.0, 60.0), min_size=1, max_size=4),
    shares=st.lists(st.integers(-50, 150), min_size=4, max_size=4),  # percent
    general=st.booleans(),
    lag=st.sampled_from([None, 0.03]),
    delay=st.floats(0.0, 0.04),
    outer=st.booleans(),
    method=st.sampled_from(["exact", "tustin"]),
)
@settings(max_examples=25, deadline=None)
def test_verdict_is_that_of_a_simulation(poles, shares, general, lag, delay, outer, method):
    low = PhyFilter.from_poles([-p for p in poles])
    filter = PhyFilter.from_poles(low.poles, 0.01 * low.a * np.array(shares)[: low.order]) if general else low
    assume(outer or np.any(filter.b))  # else nothing is fed back
    sampled = filter.sampled(0.01, method=method)
    kp, kd = (10.0, 6.0) if outer else (0.0, 0.0)
    actuator = None if lag is None else ct.tf(1, [lag, 1])
    ratios = np.array([0.05, 0.4, 1.0, 2.5, 8.0])
    margin = margins(sampled, Loop(kp, kd, actuator=actuator, delay=delay))
    rate = growth(sampled, ratios, lag=lag, delay=delay, kp=kp, kd=kd, steps=1200)
    assume(np.any(np.abs(rate) > UNDECIDED))
    for mu, each in zip(ratios, rate, strict=True):
        if abs(each) > UNDECIDED:
            assert margin.stable(mu) == (each < 0.0)
            assert any(a < mu < b for a, b in margin.stable_ratios) == margin.stable(mu)


# -- margins --------------------------------------------------------------------------------------------------------


def sample_loop(**changes: float) -> FilterMargins:
    options = {"kp": 10.0, "kd": 6.0, "delay": 0.013, **changes}
    return margins(repeated(2, 9.0), Loop(actuator=0.05, **options), dt=0.01)


def test_just_within_each_margin_is_stable_and_just_beyond_is_not():
    margin = sample_loop()
    assert margin.is_stable
    for share in (1.0 - 1e-5, 1.0 + 1e-5):
        assert sample_loop(delay=0.013 + share * margin.delay_margin).is_stable == (share < 1.0)
        assert margin.stable(share * margin.gain_margin[1]) == (share < 1.0)
        assert margin.stable(np.exp(1j * share * margin.phase_margin)) == (share < 1.0)
    disc = 1.0 + margin.ratio_radius * np.exp(1j * np.linspace(0.0, np.pi, 2000))
    assert all(margin.stable(1.0 + 0.9999 * (mu - 1.0)) for mu in disc[::40])
    assert not all(margin.stable(1.0 + 1.001 * (mu - 1.0)) for mu in disc)


def test_delay_margin_of_many_steps():
    """L = q/(z - 1) tolerates (pi/theta - 1)/2 steps, theta = 2 asin(q/2), thousands; nothing is built of that size."""
    margin = margins(PhyFilter([1.0]), dt=5e-4)
    theta = 2.0 * np.arcsin(-0.5 * np.expm1(-5e-4))
    assert margin.delay_margin == pytest.approx(5e-4 * 0.5 * (np.pi / theta - 1.0), rel=1e-5)


@pytest.mark.parametrize("gains", [(0.0, 0.0), (0.0, 6.0), (10.0, 6.0)])
def test_long_delays_are_counted_along_the_circle(gains: tuple[float, float]):
    """More than a hundred steps: the turns of chi against the eigenvalues of the large matrix."""
    kp, kd = gains
    margin = margins(repeated(3, 8.0), Loop(kp, kd, actuator=0.05, delay=0.1203), dt=0.001)
    counts = []
    for mu in (0.05, 0.4, 1.0, 2.0, 5.0, 40.0, 0.5j, 1.0 + 1.0j):
        counts.append(margin.loop.unstable(mu))
        assert counts[-1] == np.count_nonzero(np.abs(margin.loop.roots(mu)) >= 1.0)
    assert len(set(counts)) > 2


def test_a_loop_below_one_bears_any_delay():
    margin = margins(PhyFilter([20.0], [8.0]), dt=0.01)  # |L| < 0.4/0.6 at all frequencies
    assert margin.delay_margin == np.inf
    assert margin.phase_margin == np.inf
    assert not len(margin.gain_crossings)


@pytest.mark.parametrize("delay", [0.0, 0.0137])
def test_every_crossing_puts_a_pole_on_the_circle(delay: float):
    sampled = repeated(3, 6.0, full=True).sampled(0.02)
    margin = margins(sampled, Loop(10.0, 6.0, actuator=0.05, delay=delay))
    assert len(margin.ratio_crossings) >= 2
    for ratio, omega, _ in margin.ratio_crossings:
        poles = margin.loop.roots(ratio)
        assert poles is not None
        assert np.min(np.abs(poles - np.exp(1j * omega * sampled.dt))) < 1e-7


def test_order_of_the_closed_loop():
    """States of filter, actuator and outer loop, one command of the past and the step of x."""
    assert len(margins(repeated(3), dt=0.01).poles) == 3 + 1 + 1
    assert len(sample_loop(delay=0.0).poles) == 2 + 1 + 2 + 1 + 1


@pytest.mark.slow
def test_largest_bandwidth_sampled_tends_to_the_continuous_one():
    loop = Loop(10.0, 6.0, actuator=0.1, delay=0.02)
    continuous, fast, slow = (
        largest_bandwidth(lambda w: PhyFilter([w]), loop, dt=dt, modulus_margin=0.0, low=5.0, high=60.0).limit
        for dt in (None, 1e-3, 1e-2)
    )
    assert fast == pytest.approx(continuous, rel=5e-2)
    assert slow < fast


# -- what is refused ------------------------------------------------------------------------------------------------


def test_bad_input():
    sampled = PhyFilter([20.0]).sampled(0.01)
    with pytest.raises(ValueError, match=r"dt: 0\.02 s contradicts"):
        margins(sampled, dt=0.02)
    with pytest.raises(ValueError, match="g='average'"):
        margins(PhyFilter([20.0]).sampled(0.01, g="average"))
    with pytest.raises(ValueError, match="dt: expected a finite number > 0 s"):
        margins(PhyFilter([20.0]), dt=0.0)
    with pytest.raises(ValueError, match="forward Euler diverges"):
        margins(PhyFilter([300.0]).sampled(0.01, method="euler"))
    with pytest.raises(ValueError, match="delay"):
        margins(sampled, Loop(delay=-0.01))
    assert margins(sampled, dt=0.01).filter is sampled
