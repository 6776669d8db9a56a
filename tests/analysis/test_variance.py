"""Variances against control.norm, Monte Carlo and sums of the impulse response."""

import control as ct
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl import Gaussian, gauss_markov
from phyfilter_ctl.analysis.variance import error_variance

SHAPE = gauss_markov(1.3, 0.2)
FILTERS = [
    pf.PhyFilter([20.0]),
    pf.lowpass(3, 20.0, family="butterworth"),
    pf.place_poles([-9.0, -9.0], type=2),
]


@pytest.mark.parametrize("f", FILTERS, ids=repr)
def test_residual_against_the_h2_norm(f):
    variance = error_variance(f, Gaussian(SHAPE))
    assert variance.residual_error == pytest.approx(
        ct.norm(ct.ss(f.error_transfer_function) * SHAPE, 2) ** 2, rel=1e-6
    )
    assert variance.residual_estimate == pytest.approx(
        ct.norm(ct.ss(f.transfer_function) * SHAPE, 2) ** 2, rel=1e-6
    )


def test_noise_against_the_h2_norm():
    f = FILTERS[1]
    rate = ct.ss(ct.tf([1.0, 0.0], [1.0]) * f.transfer_function)
    assert error_variance(f, Gaussian(noise=0.01), inertia=2.0).noise == pytest.approx(
        (0.02 * ct.norm(rate, 2)) ** 2, rel=1e-6
    )
    coloured = gauss_markov(0.1, 0.03)
    first = FILTERS[0]
    series = ct.ss(ct.tf([1.0, 0.0], [1.0]) * first.transfer_function) * coloured
    assert error_variance(first, Gaussian(noise=coloured)).noise == pytest.approx(
        ct.norm(series, 2) ** 2, rel=1e-6
    )


@pytest.mark.parametrize("f", FILTERS, ids=repr)
@pytest.mark.parametrize("method", ["exact", "tustin", "euler"])
def test_sampled_noise_is_the_sum_of_squares_of_the_pulse_response(f, method):
    sampled = f.sampled(0.01, method)
    pulse = sampled.run(np.r_[0.0, 1.0, np.zeros(3000)][:, None])[1:, 0]
    assert error_variance(sampled, Gaussian(noise=0.5)).noise == pytest.approx(
        0.25 * np.sum(pulse**2), rel=1e-9
    )


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.013])
def test_sampled_residual_against_monte_carlo(delay):
    """Exact samples of the process every 1 ms, its integral by the trapezoid, the real filter every 10 ms."""
    rng = np.random.default_rng(5)
    h, fine, n, runs = 0.01, 10, 6000, 24
    a = np.exp(-h / fine / 0.2)
    drive = rng.standard_normal((n * fine, runs)) * 1.3 * np.sqrt(1.0 - a**2)
    gamma = np.empty((n * fine + 1, runs))
    gamma[0] = 1.3 * rng.standard_normal(runs)
    for k in range(n * fine):
        gamma[k + 1] = a * gamma[k] + drive[k]
    x = np.concatenate([np.zeros((1, runs)), np.cumsum(0.5 * (gamma[1:] + gamma[:-1]), axis=0)]) * h / fine
    shift = round(delay / h * fine)
    late = np.concatenate([np.zeros((shift, runs)), x[: len(x) - shift]])
    sampled = FILTERS[1].sampled(h, delay=delay)
    f_hat = sampled.run(late[::fine])
    error = (gamma[::fine] - f_hat)[500:]
    expected = error_variance(sampled, Gaussian(SHAPE))
    # 24 runs of 55 s of a process with a correlation time below 0.3 s: some 4,400 independent values, 3 sigma.
    assert np.mean(error**2) == pytest.approx(expected.residual_error, rel=0.07)
    assert np.mean(f_hat[500:] ** 2) == pytest.approx(expected.residual_estimate, rel=0.07)


def test_a_fast_sampled_filter_tends_to_the_continuous_one():
    f = FILTERS[1]
    exact = error_variance(f, Gaussian(SHAPE)).residual_error
    errors = [
        abs(error_variance(f.sampled(h), Gaussian(SHAPE)).residual_error - exact) for h in (4e-3, 2e-3, 1e-3)
    ]
    assert errors[2] < errors[1] < errors[0] < 0.01 * exact


@pytest.mark.parametrize(
    ("filter", "arguments", "message"),
    [
        (FILTERS[0], {"noise": 0.1}, "infinite variance"),
        (FILTERS[0], {"noise": -0.1}, ">= 0"),
        (FILTERS[0].sampled(0.01), {"noise": SHAPE}, "standard deviation"),
        (FILTERS[0], {"residual": ct.ss(1.0, 1.0, 1.0, 0.0)}, "stable"),
        (FILTERS[0], {"residual": ct.ss(0.0, 1.0, 1.0, 0.0)}, "stable"),  # wanders off: no steady variance
        (FILTERS[0], {"residual": ct.ss(-1.0, 1.0, 1.0, 1.0)}, "strictly proper"),
        (FILTERS[0], {"residual": ct.ss(0.5, 1.0, 1.0, 0.0, 0.01)}, "continuous"),
    ],
)
def test_bad_input(filter, arguments, message):
    with pytest.raises(ValueError, match=message):
        error_variance(filter, Gaussian(**arguments))


def test_bad_process():
    with pytest.raises(ValueError, match="time_constant: expected a finite number > 0 s, got 0"):
        gauss_markov(1.0, 0.0)
