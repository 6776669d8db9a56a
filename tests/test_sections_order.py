"""Chains of sections whose poles lie decades apart, with general numerators, against arithmetic of many digits.

The output row weighs the states of all sections. With the slowest section first its entries would grow with the ratio
of the poles and cancel; with the fastest first they stay of the size of F.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpmath import mp
from numpy.typing import NDArray

from phyfilter_ctl import Gaussian, PhyFilter, SampledPhyFilter
from phyfilter_ctl.analysis import error_variance, frequency_response

# Sampled F relative to its largest value: some tens of roundings, whatever lies between the poles.
SAMPLED_F = 1e-13
# Variances are squares, and a Lyapunov equation solved in between costs a digit.
VARIANCE = 1e-11
# Weights of the states over the largest value of F: at most a digit cancels.
CANCELLATION = 10.0
# Records: some hundred roundings of sums over as many samples, relative to the largest value.
RECORD = 1e-12
DIGITS = 80
APART = (2.0, 3.0, 4.0, 5.0)  # decades from the slowest pole to the fastest
ORDERS = (2, 3, 5, 8)
FREQUENCIES = 25

Complex = NDArray[np.complex128]


def spread(order: int, decades: float, seed: int) -> SampledPhyFilter:
    """Real poles and pairs in turn, evenly over the decades; b is a share of each a, either sign."""
    rng = np.random.default_rng([order, int(10 * decades), seed])
    sections = max(2, order - order // 3)
    pairs = order - sections
    sizes = 10.0 ** (np.linspace(-decades, 0.0, sections) + rng.uniform(1.0, 3.0))
    paired = set(rng.permutation(sections)[:pairs].tolist())
    poles: list[complex] = []
    for i, size in enumerate(sizes):
        angle = rng.uniform(0.1, 1.4)
        pole = size * complex(-np.cos(angle), np.sin(angle))
        poles += [pole, pole.conjugate()] if i in paired else [complex(-size)]
    low = PhyFilter.from_poles(poles)
    shares = rng.uniform(0.2, 1.5, order) * rng.choice([-1.0, 1.0], order)
    step = 0.3 / sizes[-1] * 10.0 ** rng.uniform(-1.0, 0.5)
    return PhyFilter(low.a, low.a * shares, poles=low.poles).sampled(float(step))


def fractions(sampled: SampledPhyFilter) -> tuple[list[Any], list[Any]]:
    """(g, l) with C w = sum g_i u / (1 - l_i / z): l_i = e^(p_i h) and g_i = r_i (l_i - 1) / p_i, r_i residues of F."""
    h, poles = mp.mpf(sampled.dt), [mp.mpc(complex(p)) for p in sampled.filter.poles]
    b = [mp.mpf(float(value)) for value in sampled.filter.b]
    lambdas, gains = [mp.exp(p * h) for p in poles], []
    for i, p in enumerate(poles):
        residue = mp.polyval(b[::-1], p) / mp.fprod(p - q for j, q in enumerate(poles) if j != i)
        gains.append(residue * (lambdas[i] - 1) / p)
    return gains, lambdas


def by_partial_fractions(sampled: SampledPhyFilter, omega: NDArray[np.float64]) -> tuple[Complex, float]:
    """F_d(z) sinc e^(-j theta/2) and the variance of f_hat for unit white noise on x: distinct poles only.

    Noise enters as (nu_k - nu_{k-1}) / h: with the weight sum g_i / h at once and sum c_i l_i^(k-1), c_i = g_i (l_i -
    1) / h, after k steps. The squares add up to geometric series.
    """
    with mp.workdps(DIGITS):
        h, values = mp.mpf(sampled.dt), []
        gains, lambdas = fractions(sampled)
        for w in omega:
            half = mp.mpf(float(w)) * h / 2
            turned = mp.expj(-2 * half)
            F = mp.fsum(g / (1 - v * turned) for g, v in zip(gains, lambdas, strict=True))
            values.append(complex(F * mp.sin(half) / half * mp.expj(-half)))
        later = [g * (v - 1) / h for g, v in zip(gains, lambdas, strict=True)]
        tail = mp.fsum(
            c * d / (1 - v * w)
            for c, v in zip(later, lambdas, strict=True)
            for d, w in zip(later, lambdas, strict=True)
        )
        return np.array(values), float(mp.re(tail + (mp.fsum(gains) / h) ** 2))


def frequencies(sampled: SampledPhyFilter) -> NDArray[np.float64]:
    slowest = float(np.min(np.abs(sampled.filter.poles)))
    return np.geomspace(slowest / 10.0, np.pi / sampled.dt, FREQUENCIES)


@pytest.mark.parametrize("decades", APART)
@pytest.mark.parametrize("order", ORDERS)
def test_sampled_f_keeps_its_digits(order: int, decades: float) -> None:
    for seed in range(2):
        sampled = spread(order, decades, seed)
        omega = frequencies(sampled)
        expected, _ = by_partial_fractions(sampled, omega)
        found = frequency_response(sampled, omega).F
        assert np.max(np.abs(found - expected)) < SAMPLED_F * np.max(np.abs(expected))


@pytest.mark.parametrize("decades", APART)
@pytest.mark.parametrize("order", ORDERS)
def test_noise_variance_keeps_its_digits(order: int, decades: float) -> None:
    for seed in range(2):
        sampled = spread(order, decades, seed)
        _, expected = by_partial_fractions(sampled, np.zeros(0))
        assert frequency_response(sampled).noise_gain ** 2 == pytest.approx(expected, rel=VARIANCE)
        assert error_variance(sampled, Gaussian(noise=1.0)).noise == pytest.approx(expected, rel=VARIANCE)


@pytest.mark.parametrize("decades", APART)
@pytest.mark.parametrize("order", ORDERS)
def test_weights_are_of_the_size_of_f(order: int, decades: float) -> None:
    for seed in range(10):
        filter = spread(order, decades, seed).filter
        sizes = np.abs(filter.poles)
        largest = np.max(np.abs(filter(1j * np.geomspace(sizes[0] / 10.0, sizes[-1] * 10.0, 200))))
        assert np.max(np.abs(filter.sections[2])) < CANCELLATION * largest


@pytest.mark.parametrize("order", ORDERS)
def test_a_numerator_of_one_power_keeps_its_digits(order: int) -> None:
    """N = a_k s^k alone: band-pass filters, and for k = n - 1 the fastest pole alone is left to bound F."""
    low = spread(order, APART[-1], 0)
    omega = frequencies(low)
    for k in range(order):
        share = np.zeros(order)
        share[k] = 1.0
        sampled = PhyFilter(low.filter.a, low.filter.a * share, poles=low.filter.poles).sampled(low.dt)
        expected, variance = by_partial_fractions(sampled, omega)
        error = np.max(np.abs(frequency_response(sampled, omega).F - expected))
        assert error < SAMPLED_F * np.max(np.abs(expected))
        assert frequency_response(sampled).noise_gain ** 2 == pytest.approx(variance, rel=VARIANCE)


@pytest.mark.parametrize("decades", APART)
def test_a_record_keeps_its_digits(decades: float) -> None:
    """f_hat after a jump of x by one, u = 1 / h for one step."""
    sampled = spread(5, decades, 0)
    x = np.zeros((400, 1))
    x[1:] = 1.0
    found = sampled.run(x)[1:, 0]
    with mp.workdps(DIGITS):
        gains, lambdas = fractions(sampled)
        expected = np.empty(len(found))
        for k in range(len(found)):
            expected[k] = float(mp.re(mp.fdot(gains, [v**k for v in lambdas])) / mp.mpf(sampled.dt))
    assert np.max(np.abs(found - expected)) < RECORD * np.max(np.abs(expected))


def test_poles_stay_slowest_first_and_the_chain_begins_with_the_fastest() -> None:
    filter = PhyFilter.from_poles([-300.0, -3.0 + 4.0j, -3.0 - 4.0j, -0.01])
    assert filter.poles.tolist() == [-0.01, -3.0 + 4.0j, -3.0 - 4.0j, -300.0]
    A, equilibrium, _ = filter.sections
    expected = [
        [-300.0, 0.0, 0.0, 0.0],
        [5.0, -3.0, -3.2, 0.0],
        [0.0, 5.0, -3.0, 0.0],
        [0.0, 0.0, 0.01, -0.01],
    ]
    assert A.tolist() == expected
    assert equilibrium.tolist() == [1.0, 0.6, 1.0, 1.0]
