"""Promises against simulation where options meet: between the samples, with E, and bad input."""

import numpy as np
import pytest

import phyfilter_ctl as pf

# Rounding of a simulation of a few hundred steps.
ROUNDING = 1e-9


@pytest.mark.parametrize(
    ("pole", "h", "bounds", "simulated"),
    [(5.0, 0.02, {0: 1.0, 1: 20.0}, 1.7198), (2.0, 0.1, {0: 1.0, 1: 4.0}, 1.5050)],
)
def test_a_residual_that_turns_inside_a_step_keeps_the_bound(pole, h, bounds, simulated):
    """gamma at -1 for long, then up at its greatest slope: largest just before the sample that shows it."""
    sampled = pf.PhyFilter([pole]).sampled(h)
    result = pf.ultimate_bound(sampled, residual=bounds)
    fine, steps = 200, 400
    rise = 2.0 * bounds[0] / bounds[1]
    t = np.arange(steps * fine + 1) * h / fine
    gamma = np.clip(bounds[1] * (t - t[-1]) + bounds[0], -bounds[0], bounds[0])
    assert rise < 10.0 * h
    x = np.append(0.0, np.cumsum(0.5 * (gamma[1:] + gamma[:-1]) * h / fine))
    f_hat = sampled.run(x[::fine], f_theta=None).ravel()
    error = gamma[-1] - f_hat[-2]  # just before the last sample
    assert error == pytest.approx(simulated, abs=2e-4)
    assert error <= result.between_samples * (1.0 + ROUNDING)
    assert result.between_samples == pytest.approx(error, rel=1e-2)


def test_gamma_and_its_second_derivative_bound_the_error_between_samples():
    sampled = pf.lowpass(2, 20.0).sampled(0.01)
    found = pf.ultimate_bound(sampled, residual={0: 1.0, 2: 3.0})
    assert found.bound <= found.between_samples < np.inf


@pytest.mark.parametrize("E", [[[0.1], [0.0]], [[3.0], [4.0]], [[0.02, 0.0], [0.0, 0.5]]])
def test_noise_passes_the_pseudo_inverse_of_E(E):
    """The worst signs of noise along the right singular vector of E^+ reach the bound; random noise the variance."""
    sampled = pf.PhyFilter([20.0]).sampled(0.01, E=E)
    bound = pf.ultimate_bound(sampled, residual={0: 0.0}, noise=0.01, inertia=2.0).bound
    way = np.linalg.svd(np.linalg.pinv(E))[2][0]
    x = 0.01 * np.outer(np.append(-np.ones(400), 1.0), way)
    reached = np.linalg.norm(sampled.run(x, inertia=2.0), axis=1).max()
    assert reached <= bound * (1.0 + ROUNDING)
    assert reached >= 0.99 * bound
    noise = 0.01 * np.random.default_rng(1).standard_normal((40_000, 2))
    f_hat = sampled.run(noise, inertia=2.0)[500:]
    variance = float(np.linalg.eigvalsh(np.atleast_2d(np.cov(f_hat.T)))[-1])
    # 40,000 samples: the estimate of a variance errs by about 1.5 %
    assert variance == pytest.approx(pf.error_variance(sampled, noise=0.01, inertia=2.0).noise, rel=0.05)


def test_inertia_error_without_rate_is_refused():
    with pytest.raises(ValueError, match=r"inertia_error.*rate"):
        pf.ultimate_bound(pf.PhyFilter([20.0]), residual={1: 1.0}, inertia_error=0.5)


@pytest.mark.parametrize(
    "bad", [{"residual": 3.0}, {"residual": [3.0]}, {"residual": {1: 1.0}, "noise": [0.1]}]
)
def test_bad_bounds_are_named(bad):
    with pytest.raises((TypeError, ValueError), match=r"residual|noise"):
        pf.ultimate_bound(pf.PhyFilter([20.0]), **bad)


def test_numbers_of_numpy_are_numbers():
    sampled = pf.PhyFilter([20.0]).sampled(0.01)
    assert pf.error_variance(sampled, noise=np.float32(0.5)) == pf.error_variance(sampled, noise=0.5)
    assert pf.error_variance(sampled, noise=np.int64(1)) == pf.error_variance(sampled, noise=1.0)


def test_the_envelope_tends_to_the_bound():
    found = pf.ultimate_bound(pf.lowpass(2, 20.0), residual={0: 1.0, 1: 12.0})
    assert found.envelope([10.0])[0] == pytest.approx(found.bound, rel=1e-6)


def test_a_continuous_filter_has_no_fixed_point():
    with pytest.raises(TypeError, match="expected a SampledPhyFilter"):
        pf.fixed_point(pf.PhyFilter([20.0]), x=1.0)
