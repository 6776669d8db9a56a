"""Filters that are told the force that acts: matrices by hand, python-control, flights with SampledPhyFilter.step."""

from __future__ import annotations

from typing import Literal

import control as ct
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl import Loop, PhyFilter, inertia_tolerance, margins
from phyfilter_ctl.analysis import saturation_margin
from phyfilter_ctl.analysis.tracking_loop import TrackingLoop

# Ends of an interval are refined to rounding; this far to either side of one the eigenvalues are sure.
NEAR = 1e-6
LAG = ct.tf(1, [0.05, 1])
SECOND = ct.tf([900.0], [1.0, 36.0, 900.0])
FILTERS = {
    "first": PhyFilter([12.0]),
    "butterworth": pf.lowpass(2, 15.0, family="butterworth"),
    "type 2": pf.place_poles([-8.0] * 3, type=2),
}
GAINS = {"inner": (0.0, 0.0), "velocity": (0.0, 5.0), "pd": (10.0, 4.0)}


def wired(F: PhyFilter, mu: float, act: ct.TransferFunction, kp: float, kd: float) -> np.ndarray:
    """M = 1: w' = A_F w + B (mu - 1) a, f_hat = N w, v = -f_hat - mu (kp p + kd x), a = act v."""
    n, lag = F.order, ct.tf2ss(act)
    size = n + 2 + lag.nstates
    unit = np.eye(size)
    w, p, x, z = unit[:n], unit[n], unit[n + 1], unit[n + 2 :]
    v = -F.b @ w - mu * (kp * p + kd * x)
    a = (lag.C @ z + np.outer(lag.D, v))[0]
    companion = np.diag(np.ones(n - 1), 1)
    companion[-1] = -F.a
    turned = companion @ w
    turned[-1] += (mu - 1.0) * a
    return np.vstack([turned, x[None], a[None], lag.A @ z + np.outer(lag.B, v)])


def growth(F: PhyFilter, mu: float, act: ct.TransferFunction, kp: float, kd: float) -> float:
    """Largest real part, but for the position and the velocity that nothing feeds back."""
    free = 0 if kp else 1 if kd else 2
    values = np.linalg.eigvals(wired(F, mu, act, kp, kd))
    kept = np.argsort(np.abs(values))[free:]
    return float(np.max(values[kept].real))


def is_inside(intervals: tuple[tuple[float, float], ...], value: float) -> bool:
    return any(low < value < high for low, high in intervals)


@pytest.mark.parametrize("gains", GAINS)
@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("act", [LAG, SECOND], ids=["lag", "second"])
def test_continuous_loops_against_a_matrix_by_hand(name: str, gains: str, act: ct.TransferFunction):
    F, (kp, kd) = FILTERS[name], GAINS[gains]
    for mu in (0.7, 1.0, 2.5):
        margin = margins(F, Loop(kp, kd, actuator=act, inertia_ratio=mu, g="applied"))
        assert margin.g == "applied"
        assert margin.is_stable == (growth(F, mu, act, kp, kd) < 0.0)
        ends = [end for pair in margin.stable_ratios for end in pair if 0.0 < end < np.inf]
        looked = [end * (1.0 + side * NEAR) for end in ends for side in (-1.0, 1.0)]
        for ratio in [*looked, 0.05, 0.5, 2.0, 50.0]:
            assert is_inside(margin.stable_ratios, ratio) == (growth(F, ratio, act, kp, kd) < 0.0)
        # A gain of the actuator acts on the filter too.
        for factor in (end for end in margin.gain_margin if 0.0 < end < np.inf):
            for side in (-1.0, 1.0):
                found = growth(F, mu, factor * (1.0 + side * NEAR) * act, kp, kd)
                assert is_inside((margin.gain_margin,), factor * (1.0 + side * NEAR)) == (found < 0.0)


@pytest.mark.parametrize("gains", GAINS)
@pytest.mark.parametrize("name", FILTERS)
def test_delay_against_its_pade_approximation(name: str, gains: str):
    """Both delays at once: of the eighth order it is exact to rounding where these loops cross."""
    F, (kp, kd), d = FILTERS[name], GAINS[gains], 0.02
    late = LAG * ct.tf(*ct.pade(d, 8))
    options = {"kp": kp, "kd": kd, "g": "applied", "inertia_ratio": 1.5}
    exact = margins(F, Loop(actuator=LAG, delay=d, **options))
    close = margins(F, Loop(actuator=late, **options))
    assert exact.is_stable == close.is_stable
    assert exact.stable_ratios[0] == pytest.approx(close.stable_ratios[0], rel=1e-5)
    assert exact.ratio_radius == pytest.approx(close.ratio_radius, rel=1e-5)
    for figure in ("gain_margin", "phase_margin", "delay_margin", "modulus_margin"):
        assert getattr(exact, figure) == pytest.approx(getattr(close, figure), rel=1e-5), figure
    low, high = exact.stable_ratios[0]
    for ratio in (0.99 * low, 1.01 * low, 0.99 * high, 1.01 * high):
        if 0.0 < ratio < np.inf:
            assert exact.stable(ratio) == (growth(F, ratio, late, kp, kd) < 0.0)


@pytest.mark.parametrize("dt", [None, 0.01])
@pytest.mark.parametrize("delay", [0.0, 0.02])
def test_complex_ratios_within_the_radius_are_stable(delay: float, dt: float | None):
    margin = margins(FILTERS["type 2"], Loop(10.0, 4.0, actuator=LAG, delay=delay, g="applied"), dt=dt)
    around = np.exp(2j * np.pi * np.arange(24) / 24)
    assert all(margin.stable(complex(1.0 + 0.999 * margin.ratio_radius * each)) for each in around)
    # Where it binds: Q + mu P = 0 there.
    grid = margin.loop.grid
    Q, P = margin.loop(grid)
    ratio = -Q / P
    nearest = ratio[np.argmin(np.abs(ratio - 1.0))]
    assert not margin.stable(complex(1.0 + (nearest - 1.0) * 1.01))


@pytest.mark.parametrize("delay", [0.0, 0.013])
def test_an_exact_inertia_takes_the_filter_out_of_the_loop(delay: float):
    """L = Act K: python-control's margins, whatever the filter."""
    K = ct.tf([4.0, 10.0], [1.0, 0.0, 0.0])
    _, phase, _, _, w_phase, _ = ct.stability_margins(LAG * K)
    for F in FILTERS.values():
        margin = margins(F, Loop(10.0, 4.0, actuator=LAG, delay=delay, g="applied"))
        left = np.deg2rad(phase) - w_phase * delay
        assert margin.phase_margin == pytest.approx(left, rel=1e-6)
        assert margin.delay_margin == pytest.approx(left / w_phase, rel=1e-6)
    inner = margins(F, Loop(actuator=LAG, delay=delay, g="applied"))
    assert (inner.modulus_margin, inner.delay_margin, inner.gain_margin) == (1.0, np.inf, (0.0, np.inf))


CASES = [
    (FILTERS["first"], 1.0, 0.0),
    (FILTERS["first"], 2.0, 0.034),
    (FILTERS["butterworth"], 0.8, 0.0),
    (FILTERS["type 2"], 1.6, 0.047),
]


@pytest.mark.parametrize(("F", "mu", "delay"), CASES)
def test_sampled_loops_against_the_matrix_of_the_tracking_loop(F: PhyFilter, mu: float, delay: float):
    """The same poles from other states, at the ends of the stable ratios, of the gain and of the delay too."""
    h = 0.02
    sampled = F.sampled(h)
    margin = margins(sampled, Loop(10.0, 4.0, actuator=LAG, delay=delay, inertia_ratio=mu, g="applied"))

    def radius(ratio: float, *, extra: float = 0.0, factor: float = 1.0) -> float:
        told: Literal["applied"] = "applied"
        other = margins(sampled, Loop(10.0, 4.0, actuator=factor * LAG, delay=delay + extra))
        return float(np.abs(np.linalg.eigvals(TrackingLoop(sampled, other.loop, ratio, 1.0, told).A)).max())

    assert np.abs(margin.poles).max() == pytest.approx(radius(mu), rel=1e-7)
    assert margin.is_stable
    ends = [end for pair in margin.stable_ratios for end in pair if 0.0 < end < np.inf]
    assert ends
    for ratio in [*(end * (1.0 + side * NEAR) for end in ends for side in (-1.0, 1.0)), 0.05, 0.5, 2.0, 50.0]:
        assert is_inside(margin.stable_ratios, ratio) == (radius(ratio) < 1.0)
    high = margin.gain_margin[1]
    assert radius(mu, factor=high * (1.0 - NEAR)) < 1.0 < radius(mu, factor=high * (1.0 + NEAR))
    spare = margin.delay_margin
    assert radius(mu, extra=spare * (1.0 - 1e-5)) < 1.0 < radius(mu, extra=spare * (1.0 + 1e-5))


@pytest.mark.parametrize(("F", "mu", "delay"), CASES)
def test_sampled_loops_in_flight(F: PhyFilter, mu: float, delay: float):
    """Flights with step, told the mean of the force: they die out within the stable ratios and grow beyond."""
    h, lag = 0.02, 0.05
    sampled = F.sampled(h)
    margin = margins(sampled, Loop(10.0, 4.0, actuator=LAG, delay=delay, inertia_ratio=mu, g="applied"))
    low, high = margin.stable_ratios[0]
    assert 0.0 < low < high < np.inf
    ratios = np.array([low * 0.97, low * 1.03, high * 0.97, high * 1.03])
    whole, part = divmod(delay / h, 1.0)
    p, x, a = (np.zeros(len(ratios)) for _ in range(3))
    line = [np.zeros(len(ratios))] * (int(whole) + 2)
    state, f_hat, mean = sampled.start(x, inertia0=ratios), 0.0 * ratios, 0.0 * ratios
    size = np.zeros((6000, len(ratios)))
    for k in range(len(size)):
        if k:
            state, f_hat = sampled.step(state, x, mean)
        command = -ratios * (10.0 * p + 4.0 * x) - f_hat + (k == 0)
        line = [command, *line[:-1]]
        before = x
        for sent, span in ((line[int(whole) + 1], part * h), (line[int(whole)], (1.0 - part) * h)):
            left = 1.0 - np.exp(-span / lag)
            moved = 0.5 * sent * span**2 + (a - sent) * lag * (span - lag * left)
            p, x = p + x * span + moved, x + sent * span + (a - sent) * lag * left
            a = a + (sent - a) * left
        mean, size[k] = (x - before) / h, np.abs(command)
    early, late = size[2000:4000].max(axis=0), size[4000:].max(axis=0)
    assert ((late < early) == [False, True, True, False]).all()


def test_a_long_delay_is_counted_along_the_circle():
    """More than a hundred steps: turns instead of eigenvalues."""
    options = {"kp": 0.01, "kd": 0.1, "actuator": LAG, "g": "applied", "inertia_ratio": 1.3}
    F = PhyFilter([0.5])
    counted = margins(F, Loop(delay=2.1, **options), dt=0.02)
    assert counted.is_stable
    assert np.abs(counted.poles).max() < 1.0
    assert not margins(F, Loop(delay=2.1 + counted.delay_margin * 1.001, **options), dt=0.02).is_stable


@pytest.mark.parametrize("dt", [None, 0.01])
def test_what_the_loop_leaves_of_the_residual(dt: float | None):
    """|1 - Act F|/|1 + L|, by transfer functions."""
    F, omega, mu = FILTERS["butterworth"], np.geomspace(0.1, 40.0, 20), 1.4
    found = margins(F, Loop(10.0, 4.0, actuator=LAG, inertia_ratio=mu, g="applied"), dt=dt).sensitivity(omega)
    s = 1j * omega
    act, passed = 1.0 / (1.0 + 0.05 * s), F(s)
    K = 10.0 / s**2 + 4.0 / s
    expected = np.abs(1.0 - act * passed) / np.abs(1.0 + act * ((mu - 1.0) * passed + mu * K))
    # A step of 10 ms shifts the phase by h/2 at most.
    assert found == pytest.approx(expected, rel=1e-9 if dt is None else 0.3)


@pytest.mark.parametrize("dt", [None, 0.01])
def test_inertia_within_a_deviation(dt: float | None):
    """min |Q + P|/|Q|, not the modulus margin: the nearest M is unstable, every nearer one is not."""
    margin = margins(FILTERS["type 2"], Loop(actuator=LAG, delay=0.02, g="applied"), dt=dt)
    assert margin.modulus_margin == 1.0
    Q, P = margin.loop(margin.loop.grid)
    limit = np.min(np.abs(Q + P) / np.abs(Q))
    assert limit < 0.9
    for share, status in ((0.999, "proven"), (1.01, "open")):
        found = inertia_tolerance(margin.filter, margin.around, M_hat=1.0, within=share * limit, rate=0.0)
        assert found.status == status
    # M/M_hat = 1 + that, complex, has a pole on the boundary.
    nearest = (-P / Q)[np.argmin(np.abs(Q + P) / np.abs(Q))]
    assert not margin.stable(complex(1.0 / (1.0 + 1.01 * (nearest - 1.0))))


def test_saturation_of_a_loop_that_is_told_what_acts():
    """An exact inertia: the loop without a filter. An ideal actuator: what is left of the command is what acts."""
    F = FILTERS["first"]
    alone = [
        saturation_margin(f, Loop(10.0, 4.0, actuator=LAG), g="applied").command_excess
        for f in FILTERS.values()
    ]
    assert alone == pytest.approx([alone[0]] * 3, rel=1e-6)
    left, acts = (
        saturation_margin(F, Loop(10.0, 4.0, inertia_ratio=1.3), g=g).command_excess
        for g in ("saturated", "applied")
    )
    assert left == pytest.approx(acts, rel=1e-6)


# -- a motor --------------------------------------------------------------------------------------------------------

# A DC motor of 0.02 kg m^2, current loop of 4 ms, 2 ms of delay; PI speed loop of 40 rad/s, damping 1.
INERTIA, CURRENT, LATE = 0.02, ct.tf(1, [0.004, 1]), 0.002
PROPORTIONAL, INTEGRAL = 2.0 * 40.0 * INERTIA, 40.0**2 * INERTIA


def test_a_PI_speed_loop_is_entered_by_its_gains_over_the_inertia():
    """J x' = a, a = 1/(T s + 1) u, u = -P x - I z, z' = x: the poles written by hand, with the filter's beside them."""
    J, T = INERTIA, 0.004
    by_hand = np.array([[-1.0 / T, -PROPORTIONAL / T, -INTEGRAL / T], [1.0 / J, 0.0, 0.0], [0.0, 1.0, 0.0]])
    margin = margins(PhyFilter([60.0]), Loop(INTEGRAL / J, PROPORTIONAL / J, actuator=CURRENT, g="applied"))
    expected = np.append(np.linalg.eigvals(by_hand), -60.0)
    assert np.sort_complex(margin.poles) == pytest.approx(np.sort_complex(expected), rel=1e-7)


def test_a_measured_current_gives_a_fast_filter_its_margin_back():
    loop = {
        "kp": INTEGRAL / INERTIA,
        "kd": PROPORTIONAL / INERTIA,
        "actuator": CURRENT,
        "delay": LATE,
    }
    command, current = (
        margins(PhyFilter([60.0]), Loop(g=g, **loop), dt=0.001).modulus_margin
        for g in ("commanded", "applied")
    )
    alone = margins(PhyFilter([1e-6]), Loop(**loop), dt=0.001).modulus_margin
    assert command < 0.6 * current
    assert current == pytest.approx(alone, rel=1e-4)


# -- what passes it on, what is refused -----------------------------------------------------------------------------


def test_analyze_passes_it_on():
    loop = {"kp": 10.0, "kd": 4.0, "actuator": LAG, "delay": 0.01}
    sampled = FILTERS["first"].sampled(0.01)
    page = pf.analyze(sampled, pf.Loop(g="applied", **loop), {1: 2.0})
    assert page.g == "applied"
    assert page.complete_loop.to_dict() == margins(sampled, Loop(g="applied", **loop)).to_dict()
    assert (
        page.inner_loop.stable_ratios
        == margins(sampled, Loop(actuator=LAG, delay=0.01, g="applied")).stable_ratios
    )
    assert page.tracking.radius == pf.tracking_error(sampled, pf.Loop(g="applied", **loop), {1: 2.0}).radius
    assert set(page.saturated_loop) == {"applied"}
    assert page.describe().count("filter is told") == 2


@pytest.mark.parametrize("bad", ["measured", "saturated", ""])
def test_another_g_is_refused(bad: str):
    with pytest.raises(ValueError, match="g: expected 'commanded' or 'applied', got"):
        margins(PhyFilter([5.0]), Loop(1.0, 1.0, g=bad))
    with pytest.raises(ValueError, match="g: expected"):
        pf.analyze(PhyFilter([5.0]), pf.Loop(g=bad))


def test_what_g_does_not_go_with():
    late = PhyFilter([5.0]).sampled(0.01, delay=0.005)
    with pytest.raises(ValueError, match=r"0\.005 s late, with g='applied' expected 0"):
        margins(late, Loop(1.0, 1.0, g="applied"))
    with pytest.raises(ValueError, match="leave ratios out"):
        pf.analyze(PhyFilter([5.0]), pf.Loop(g="applied"), ratios=(0.5, 2.0))
