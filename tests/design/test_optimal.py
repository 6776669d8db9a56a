"""Designs from promises against closed forms, sweeps and the Kalman filter; statistics against known processes."""

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.signal import residue

import phyfilter_ctl as pf
from phyfilter_ctl import Bounded, Gaussian, error_bound, gauss_markov, trade_off
from phyfilter_ctl.analysis import error_variance
from phyfilter_ctl.design.optimal import (
    error_floor,
    kalman_filter,
    kalman_variance,
    least_bound,
    least_variance,
    residual_statistics,
)
from phyfilter_ctl.design.optimal.floor import _fastest_motion
from phyfilter_ctl.design.optimal.shapes import at_speed
from phyfilter_ctl.design.optimal.statistics import step_mean_spectrum
from phyfilter_ctl.design.optimal.worst_case import worst_gains
from tests.cpu_budget import release_but, slow_but

# A simplex ends where the cost is flat to 1e-4 of it.
SEARCH = 1e-3
PROCESS = gauss_markov(1.0, 0.5)


def test_first_order_in_closed_form():
    """delta / w + 2 w nu is least at w = sqrt(delta / (2 nu))."""
    found = least_bound(1, residual={1: 3.0}, noise=0.02, inertia_error=0.1, rate=2.0)
    assert found.filter.a[0] == pytest.approx(np.sqrt(3.0 / 0.04), rel=1e-6)
    assert found.bound.bound == pytest.approx(2.0 * np.sqrt(2.0 * 3.0 * 0.02) + 0.2, rel=1e-6)
    assert found.status == "converged"


@pytest.mark.parametrize(("type", "k"), release_but(((2, 1),), ((1, 1), (2, 1), (2, 2))))
def test_no_second_order_filter_on_a_grid_is_better(type, k):
    found = least_bound(2, residual={k: 30.0}, noise=0.01, type=type)
    w0 = np.sqrt(found.filter.a[0])
    for damping in np.linspace(0.3, 1.6, 14):
        for speed in w0 * np.geomspace(0.5, 2.0, 15):
            other = pf.place_poles(np.roots([1.0, 2 * damping * speed, speed**2]), type=type)
            assert (
                error_bound(other, Bounded({k: 30.0}, noise=0.01)).bound >= (1 - SEARCH) * found.bound.bound
            )


@pytest.mark.slow
def test_a_third_order_low_pass_promises_no_more_than_a_second():
    found = least_bound(3, residual={1: 8.0}, noise=0.01)
    assert found.filter.order == 2
    assert found.status == "order_adds_nothing"
    assert "order 2 suffices" in found.message
    best = min(
        error_bound(
            pf.place_poles([*(w * np.roots([1.0, 2 * z, 1.0])), -w * r]), Bounded({1: 8.0}, noise=0.01)
        ).bound
        for z in (0.6, 0.8, 1.0)
        for w in found.bound.bound * np.array([40.0, 60.0, 80.0, 110.0])
        for r in (1.0, 3.0, 8.0)
    )
    assert best >= (1 - SEARCH) * found.bound.bound


def test_the_floor_by_the_polynomials_that_attain_it():
    """On the half line Chebyshev's T_2 and T_3, continued at rest, have |z| <= 1 and the fastest end."""
    for k, slope, highest in ((1, 4.0, 4.0), (2, 9.0, 24.0)):
        constant = slope / highest ** (1.0 / (k + 1))
        assert error_floor(residual={k: 1.0}, noise=1.0) == pytest.approx(constant, rel=1e-12)
    scaled = error_floor(residual={2: 5.0}, noise=0.3, inertia=2.0)
    assert scaled == pytest.approx((243.0 / 8.0 * 0.6**2 * 5.0) ** (1.0 / 3.0), rel=1e-12)
    assert error_floor(residual={0: 0.1, 1: 5.0}, noise=1.0) == 0.1
    assert error_floor(residual={1: 5.0}, noise=0.0) == 0.0


@pytest.mark.parametrize(("k", "constant"), [(1, 2.0), (2, (243.0 / 8.0) ** (1.0 / 3.0)), (3, 4.2885)])
def test_splines_come_up_to_the_published_constants_and_not_above(k, constant):
    """Landau 1913, Matorin 1955, Schoenberg and Cavaretta 1970 (4.288)."""
    assert (1.0 - 1e-3) * constant <= _fastest_motion({k: 1.0}) <= constant


def test_floors_of_several_derivatives():
    """Another bound takes motions away: a lower floor, and none that is loose changes it (splines lose 1e-3)."""
    one = error_floor(residual={1: 8.0}, noise=0.01)
    both = [error_floor(residual={1: 8.0, 2: d}, noise=0.01) for d in (10.0, 100.0, 1e5)]
    assert np.all(np.diff(both) > 0.0)
    assert (1.0 - 2e-3) * one <= both[-1] <= one
    assert both[0] <= error_floor(residual={2: 10.0}, noise=0.01)


@pytest.mark.parametrize("k", [1, 2])
def test_no_filter_undercuts_the_floor(k):
    rng = np.random.default_rng(20)
    least = np.inf
    for n in (2, 3, 4, 5) * 4:
        shape = np.concatenate([rng.uniform(-1.0, 0.7, n - 1), 0.4 * rng.standard_normal(n - k)])
        unit = error_bound(at_speed(shape, n, k, 1.0), Bounded({k: 1.0}, noise=1.0))
        best = (k * unit.intrinsic / unit.noise) ** (1.0 / (k + 1))
        least = min(least, unit.intrinsic / best**k + unit.noise * best)
    floor = error_floor(residual={k: 1.0}, noise=1.0)
    assert floor < least < 2.0 * floor


def test_how_far_filters_are_above_the_floor():
    """2 sqrt(delta nu): what a finite difference over 2 sqrt(nu / delta) reaches."""
    assert 1.18 <= least_bound(2, residual={1: 8.0}, noise=0.01).ratio <= 1.20
    found = least_bound(4, residual={1: 8.0}, noise=0.01, form="general")
    assert found.filter.order == 4
    assert found.filter.dc_gain == pytest.approx(1.0, abs=1e-12)
    assert 1.0 < found.ratio <= 1.045
    assert found.floor == pytest.approx(2.0 * np.sqrt(0.08), rel=1e-12)
    assert found.to_dict()["ratio"] == found.ratio
    assert "4.2 % above" in found.message


def test_units_do_not_matter():
    one = least_bound(3, residual={1: 1.0}, noise=1.0, form="general")
    other = least_bound(3, residual={1: 3e5}, noise=2e-7, inertia=5.0, form="general")
    assert other.ratio == pytest.approx(one.ratio, rel=1e-4)


def test_no_other_numerator_is_better_for_the_poles_found():
    """The bound is convex in N: a linear programme over partial fractions, integrals by the trapezoidal rule."""
    found = least_bound(3, residual={1: 1.0}, noise=1.0, form="general")
    a, b = found.filter.a, found.filter.b
    D = np.r_[1.0, a[::-1]]
    t = np.linspace(0.0, 25.0 / -found.filter.poles.real.max(), 400)

    def response(numerator):
        r, p, _ = residue(numerator, D)
        return (np.exp(np.outer(t, p)) @ r).real

    # Kernels of 1/s - F/s and of s F without its direct part b_2, affine in (b_1, b_2).
    def kernels(b1, b2):
        error = response(np.array([1.0, a[2] - b2, a[1] - b1]))
        return np.r_[error, response(np.array([b1 - b2 * a[2], a[0] - b2 * a[1], -b2 * a[0]]))]

    offset = kernels(0.0, 0.0)
    columns = np.column_stack([kernels(1.0, 0.0) - offset, kernels(0.0, 1.0) - offset])
    weights = np.tile(np.full(len(t), t[1]) * np.r_[0.5, np.ones(len(t) - 2), 0.5], 2)
    # Unknowns b_1, b_2, |b_2| and the absolute values of the kernels.
    m = len(offset)
    upper = np.block([[columns, np.zeros((m, 1)), -np.eye(m)], [-columns, np.zeros((m, 1)), -np.eye(m)]])
    direct = np.zeros((2, m + 3))
    direct[:, 1:3] = [[1.0, -1.0], [-1.0, -1.0]]
    best = linprog(
        np.r_[0.0, 0.0, 1.0, weights],
        A_ub=np.vstack([upper, direct]),
        b_ub=np.r_[-offset, offset, 0.0, 0.0],
        bounds=(None, None),
    )
    given = weights @ np.abs(kernels(b[1], b[2])) + abs(b[2])
    assert given == pytest.approx(found.bound.bound, rel=2e-3)
    assert best.fun >= (1.0 - SEARCH) * given


def test_gains_in_the_search_with_poles_ten_thousand_apart():
    """Two real poles: both kernels but s F keep their sign; its norm is twice the peak of F's response."""
    damping = 0.5 * (100.0 + 0.01)
    gains = worst_gains(np.array([[np.log(damping)]]), 2, 1, 1)
    fast, slow = 100.0, 0.01
    peak = np.log(fast / slow) / (fast - slow)
    height = (np.exp(-slow * peak) - np.exp(-fast * peak)) / (fast - slow)
    assert gains.following[0] == pytest.approx(2.0 * damping, rel=1e-4)
    assert gains.noise[0] == pytest.approx(2.0 * height, rel=1e-4)
    assert gains.inertia[0] == pytest.approx(1.0, rel=1e-4)


@pytest.mark.slow
def test_limits_hold_and_are_named():
    free = least_bound(2, residual={1: 8.0}, noise=0.01)
    quiet = least_bound(2, residual={1: 8.0}, noise=0.01, noise_limit=0.5 * free.bound.noise)
    assert quiet.active == "noise_limit"
    assert quiet.bound.noise <= 0.5 * free.bound.noise * (1 + 1e-6)
    slow = least_bound(2, residual={1: 8.0}, fastest=10.0)
    assert slow.active == "fastest"
    assert np.exp(np.mean(np.log(np.abs(slow.filter.poles)))) == pytest.approx(10.0)
    kept = least_bound(2, residual={1: 8.0}, accept=lambda f: bool(f.a[-1] < 30.0))
    assert kept.active == "accept"
    assert 29.9 < kept.filter.a[-1] < 30.0


def test_trade_off_is_a_front_of_best_designs():
    """All best designs for one bounded derivative have one shape: its parts scale as 1/w and w."""
    found, factors = least_bound(2, residual={1: 8.0}, noise=0.01), np.geomspace(0.1, 10.0, 21)
    bounds = Bounded({1: 8.0}, noise=0.01)
    curve = trade_off(found.filter.faster, factors, cost=lambda filter: error_bound(filter, bounds))
    assert curve.label == "bound"
    np.testing.assert_allclose(curve.costs["residual"], found.bound.intrinsic / factors, rtol=1e-6)
    np.testing.assert_allclose(curve.costs["noise"], found.bound.noise * factors, rtol=1e-6)
    assert curve.best == curve.results[10] == found.filter.faster(1.0)
    assert sum(curve.costs.values())[10] == pytest.approx(0.67463, abs=1e-4)
    assert curve.plot().axes.shape == (1, 1)


def test_trade_off_takes_what_has_an_error():
    limits = [0.1, 0.2]
    found = trade_off(lambda n: least_bound(1, residual={1: 8.0}, noise=0.01, noise_limit=n), limits)
    np.testing.assert_allclose(found.costs["noise"], limits, rtol=1e-6)
    assert found.best is found.results[1]
    kinds = trade_off(lambda n: {"a": n, "b": -2.0 * n, "c": 0.0}, limits)
    assert kinds.best == kinds.results[1]
    with pytest.raises(ValueError, match="one or two to plot"):
        kinds.plot()
    alone = trade_off(lambda n: n if n < 0.2 else float("nan"), limits, label="Limit")
    assert alone.best == 0.1
    assert alone.plot().axes[0, 0].get_xlabel() == "Limit"
    assert trade_off(lambda n: float("nan"), limits).best is None
    with pytest.raises(TypeError, match="design: expected what has an error"):
        trade_off(lambda n: "none", limits)
    with pytest.raises(ValueError, match="same names"):
        trade_off(lambda n: {str(n): n}, limits)
    with pytest.raises(ValueError, match="values"):
        trade_off(lambda n: n, [np.nan])


@pytest.mark.parametrize("tau", [0.05, 0.5, 50.0])
def test_the_kalman_filter_is_a_phyfilter(tau):
    process = gauss_markov(2.0, tau)
    filter = kalman_filter(residual=process, noise=0.03)
    variance = error_variance(filter, Gaussian(process, noise=0.03))
    assert variance.error == pytest.approx(kalman_variance(residual=process, noise=0.03), rel=1e-8)


def test_a_random_walk_gives_butterworth():
    """gamma' = white of density q, noise density r: poles of s^4 + q / r."""
    filter = kalman_filter(residual=gauss_markov(np.sqrt(9.0 * 1e8 / 2.0), 1e8), noise=0.01)
    w = (9.0 / 1e-4) ** 0.25
    np.testing.assert_allclose(filter.a, [w**2, np.sqrt(2.0) * w], rtol=1e-4)
    assert filter.dc_gain == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize("dt", slow_but([None], [None, 0.01]))
def test_nothing_beats_kalman_and_the_best_comes_close(dt):
    found = least_variance(3, residual=PROCESS, noise=0.01, dt=dt)
    assert 1.0 <= found.ratio < 1.1
    for w in found.filter.a[0] ** (1 / found.filter.order) * np.geomspace(0.4, 2.5, 9):
        for z in (0.5, 0.7, 0.87, 1.0, 1.3):
            other = pf.place_poles(w * np.roots([1.0, 2 * z, 1.0]))
            other = other if dt is None else other.sampled(dt)
            assert (
                error_variance(other, Gaussian(PROCESS, noise=0.01)).error
                >= (1 - SEARCH) * found.variance.error
            )


def test_the_sampled_kalman_variance_against_its_own_recursion():
    h, tau, sigma = 0.02, 0.5, 0.01
    a = np.exp(-h / tau)
    fine = 2000
    A = np.array([[1 - h / fine / tau, 0.0], [h / fine, 1.0]])
    step, cov = np.eye(2), np.zeros((2, 2))
    for _ in range(fine):
        step, cov = A @ step, A @ cov @ A.T + np.diag([2.0 / tau * h / fine, 0.0])
    assert step[0, 0] == pytest.approx(a, rel=1e-4)
    P = np.eye(2)
    for _ in range(3000):
        P = step @ P @ step.T + cov
        K = P[:, 1] / (P[1, 1] + sigma**2)
        P = P - np.outer(K, P[1])
    assert kalman_variance(residual=PROCESS, noise=sigma, dt=h) == pytest.approx(P[0, 0], rel=1e-3)


def test_trade_off_of_variances():
    best = least_variance(2, residual=PROCESS, noise=0.01, dt=0.01).filter
    data, factors = Gaussian(PROCESS, noise=0.01), np.geomspace(0.1, 10.0, 11)
    curve = trade_off(best.faster, factors, cost=lambda filter: error_variance(filter.sampled(0.01), data))
    assert curve.label == "standard deviation"
    assert np.all(np.diff(curve.costs["noise"]) > 0.0)
    assert curve.best in curve.results[1:-1]


def test_step_mean_spectrum_is_the_transform_of_the_covariance():
    q, theta = 0.3, np.linspace(0.1, 3.0, 7)
    k = np.arange(1, 400)
    covariance = ((1 - np.exp(-q)) / q) ** 2 * np.exp(-q * (k - 1))
    expected = 2 * (q - 1 + np.exp(-q)) / q**2 + 2 * np.cos(np.outer(theta, k)) @ covariance
    np.testing.assert_allclose(step_mean_spectrum(theta, q), expected, rtol=1e-12)


def flight(seed, n=8000, h=0.01, s=1.0, tau=0.4, sigma=0.003):
    rng = np.random.default_rng(seed)
    fine = 10
    a = np.exp(-h / fine / tau)
    drive = s * np.sqrt(1 - a**2) * rng.standard_normal(n * fine)
    gamma = np.zeros(n * fine + 1)
    gamma[0] = s * rng.standard_normal()
    for i in range(n * fine):
        gamma[i + 1] = a * gamma[i] + drive[i]
    x = np.r_[0.0, np.cumsum(0.5 * (gamma[1:] + gamma[:-1]))] * h / fine
    return pf.Recording.from_arrays(x=(x[::fine] + sigma * rng.standard_normal(n + 1))[:, None], dt=h), gamma


@pytest.mark.release
def test_intervals_cover_the_truth():
    """Of 20 seeds at 95 %, 16 or more of each: fewer would have a chance of 0.3 %."""
    covered = np.zeros(3)
    for seed in range(20):
        found = residual_statistics(flight(seed, n=3000)[0])
        for i, (interval, truth) in enumerate(
            ((found.noise, 0.003), (found.deviation, 1.0), (found.time_constant, 0.4))
        ):
            covered[i] += interval.low <= truth <= interval.high
    assert np.all(covered >= 16)


@pytest.mark.slow
def test_peaks_and_their_share():
    log, gamma = flight(3)
    found = residual_statistics(log)
    assert found.magnitude.value == pytest.approx(np.abs(gamma).max(), rel=0.15)
    assert found.magnitude.share == pytest.approx(0.05 ** (1.0 / found.blocks))
    # Blocks of flights that were not looked at: at least the share stays below.
    below = [
        residual_statistics(flight(100 + i, n=1500)[0]).magnitude.value <= found.magnitude.value
        for i in range(10)
    ]
    assert sum(below) >= 5


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: least_bound(7, residual={1: 1.0}, noise=0.1), "1 to 6"),
        (lambda: least_bound(2, residual={1: 1.0}), "infinitely fast"),
        (lambda: least_bound(2, residual={1: 1.0}, noise=-1.0), "noise"),
        (
            lambda: least_bound(2, residual={1: 1.0}, noise=0.1, form="none"),  # pyright: ignore[reportArgumentType]
            "form: expected one of lowpass",
        ),
        (lambda: error_floor(residual={}, noise=0.1), "no residual|got none"),
        (lambda: error_floor(residual={1: -1.0}, noise=0.1), r"residual\[1\]"),
        (lambda: least_bound(2, residual={0: 1.0}, noise=0.1), "derivative of order 1"),
        (lambda: least_bound(2, residual={1: 1.0}, type=3, noise=0.1), "type"),
        (lambda: least_bound(1, residual={1: 1.0}, noise=0.1, accept=lambda f: False), "every speed"),
        (lambda: least_variance(1, residual=PROCESS, noise=0.1), "infinite variance"),
        (lambda: least_variance(2, residual=PROCESS, noise=0.0), "positive"),
        (
            lambda: residual_statistics(pf.Recording.from_arrays(x=np.arange(50.0)[:, None], dt=0.1)),
            "200 samples",
        ),
        (lambda: residual_statistics(flight(0, n=300)[0], confidence=1.0), "between 0 and 1"),
    ],
)
def test_bad_problems(call, message):
    with pytest.raises(ValueError, match=message):
        call()
