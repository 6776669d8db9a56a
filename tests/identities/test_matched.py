"""Matched sampling: the zeros of 1 - F at the samples, by 40 digits, by records, in blocks, C, bounds and responses."""

import control as ct
import numpy as np
import pytest
from mpmath import matrix as mp_matrix
from mpmath import mp, mpc, mpf

import phyfilter_ctl as pf
from phyfilter_ctl.design.adjoint.rollout import Rollout
from phyfilter_ctl.filter.matching import followed_frequencies, matched_output
from tests.cpu_budget import slow_but

AT_THE_SAMPLES = 1e-10
# n, type and number of frequencies, as many as the order takes.
SHAPES = [(n, k, (n - k) // 2) for n in range(1, 9) for k in sorted({1, (n + 1) // 2, n})]


def designed(n, kind, count, pole=-20.0):
    return pf.place_poles([pole] * n, type=kind, zeros_at=[4.0 + 3.0 * i for i in range(count)])


def answer(sampled):
    """1 - C X(s) for samples of e^(s t), by mpmath; X of the chain (A, e) and of the row C that ``run`` takes."""
    _, A, e, C = sampled.recursion.chains[0]
    h, eye, e = mpf(sampled.dt), mp.eye(len(e)), mp_matrix(e.tolist())
    grown = mp.expm(mp_matrix(A.tolist()) * h)
    drive = (eye - grown) * e

    def missing(s):
        z = mp.exp(s * h)
        X = mp.lu_solve(z * eye - grown, drive * ((z - 1) / (s * h)))
        return 1 - sum(mpf(float(c)) * x for c, x in zip(C, X, strict=True))

    return missing


@pytest.mark.parametrize(("n", "kind", "count"), SHAPES)
@pytest.mark.parametrize("share", slow_but([0.5], [0.04, 0.5]))
def test_zeros_hold_at_the_samples(n, kind, count, share):
    """Each frequency to 1e-10; each power of t by a contour integral, in units of the n time constants together."""
    sampled = designed(n, kind, count).sampled(share / 20.0, "matched")
    with mp.workdps(30):
        missing = answer(sampled)
        for w in 4.0 + 3.0 * np.arange(count):
            assert abs(missing(mpc(0, w))) < AT_THE_SAMPLES
        # Real on the real axis: the upper half of the circle is enough.
        turn = [mp.expjpi(mpf(2 * i + 1) / 24) for i in range(12)]
        around = [missing(4 * z) for z in turn]
        for power in range(kind):
            taylor = sum((value * z ** (-power)).real for value, z in zip(around, turn, strict=True)) / 12
            assert abs(taylor) * (5.0 / n) ** power < AT_THE_SAMPLES


@pytest.mark.parametrize("g", ["hold", "average"])
@pytest.mark.parametrize("f_theta", ["hold", "average"])
def test_a_record_under_both_rules(g, f_theta):
    """What x brings leaves no error; a learned sine leaves its own, by what a rule's mean is not the sine's."""
    w, h = 6.0, 0.018
    t = h * np.arange(400)
    filter = pf.place_poles([-20.0] * 3, zeros_at=[w])
    exact, sampled = (filter.sampled(h, m, g=g, f_theta=f_theta) for m in ("exact", "matched"))
    x = -np.cos(w * t) / w
    left = [np.abs(np.sin(w * t) - one.run(x)[:, 0])[-100:].max() for one in (exact, sampled)]
    assert left[0] > 9e-3
    assert left[1] < 1e-12
    learned = 0.4 * np.sin(w * t)
    error = (np.sin(w * t) - sampled.run(x, f_theta=learned[:, None])[:, 0])[-100:]
    z = np.exp(1j * w * h)
    mean = {"hold": 1.0 / z, "average": 0.5 * (1.0 + 1.0 / z)}[f_theta]
    of_the_rule = np.imag(-0.4 * (1.0 - mean * 1j * w * h / (1.0 - 1.0 / z)) * np.exp(1j * w * t))[-100:]
    assert np.abs(error - of_the_rule).max() < 1e-12


def test_what_is_chosen_by_default():
    for filter, method in (
        (pf.lowpass(3, 20.0), "exact"),
        (pf.place_poles([-20.0] * 3, type=2), "matched"),
        (pf.place_poles([-20.0] * 3, zeros_at=[6.0]), "matched"),
        (pf.bandpass(4, 4.0, 9.0), "matched"),
        (pf.bandpass(2, 4.0, 9.0), "exact"),  # F(0) = 0 and the centre are three conditions
    ):
        assert filter.sampled(0.01).sampling.method == method
        assert pf.SampledPhyFilter(filter, 0.01).sampling.method == method
        assert f"method={method!r}" in repr(filter.sampled(0.01)) or method == "exact"
    beyond = pf.place_poles([-20.0] * 3, zeros_at=[6.0])
    assert beyond.sampled(0.6).sampling.method == "exact"
    with pytest.raises(ValueError, match=r"Nyquist frequency pi/h = 5\.2"):
        beyond.sampled(0.6, "matched")
    with pytest.raises(ValueError, match="order 2 cannot keep both"):
        pf.bandpass(2, 4.0, 9.0).sampled(0.01, "matched")


def test_nothing_to_keep_leaves_exact_sampling():
    filter = pf.lowpass(3, 20.0, family="butterworth")
    exact, sampled = (filter.sampled(0.01, method) for method in ("exact", "matched"))
    assert np.array_equal(exact.transition[2], sampled.transition[2])
    assert sampled.realised == (filter,)


def test_a_band_pass_keeps_its_centre_and_nothing_at_zero():
    sampled = pf.bandpass(4, 4.0, 9.0).sampled(0.05)
    assert followed_frequencies(sampled.filter) == pytest.approx([6.0], rel=1e-12)
    response = pf.frequency_response(sampled, [1e-6, 6.0])
    assert abs(response.error[1]) < 1e-12
    assert abs(1.0 - response.error[0]) < 1e-5
    assert np.abs(sampled.run(5.0 * 0.05 * np.arange(400))[-1]) < 1e-9


def test_exact_sampling_of_the_realised_filter_is_it():
    """A numerator is all that differs, so a bank, a delay, a record of uneven steps and the state space agree."""
    filters = [designed(3, 1, 1), pf.lowpass(2, 15.0), designed(4, 4, 0)]
    sampled = pf.SampledPhyFilter(filters, 0.02)
    other = pf.SampledPhyFilter(sampled.realised, pf.Sampling(0.02, "exact"))
    rng = np.random.default_rng(1)
    x, g, f_theta = rng.standard_normal((3, 80, 3))
    times = np.cumsum(rng.uniform(0.01, 0.03, 80))
    for given in (None, times):
        assert np.allclose(
            sampled.run(x, g, f_theta, times=given),
            other.run(x, g, f_theta, times=given),
            rtol=1e-9,
            atol=1e-9,
        )
    stacked = pf.stack([filter.sampled(0.02) for filter in filters])
    assert stacked == sampled
    state, block = sampled.start(x[0], f_theta0=f_theta[0]), pf.phyfilter_block(sampled)
    for k in range(1, 80):
        state, f_hat = sampled.step(state, x[k], g[k - 1], f_theta[k])
    expected = sampled.run(x, g, f_theta)
    assert np.allclose(f_hat, expected[-1], rtol=1e-12)
    response = ct.forced_response(
        block, 0.02 * np.arange(80), np.hstack([x, g, f_theta]).T, X0=block.rest_state(x[0], g[0], f_theta[0])
    )
    assert np.allclose(response.outputs.T, expected, atol=1e-9 * np.abs(expected).max())


def test_the_frequency_response_knows_it():
    filter = pf.place_poles([-20.0] * 3, zeros_at=[6.0])
    exact, sampled = (filter.sampled(0.05, method) for method in ("exact", "matched"))
    left = [abs(pf.frequency_response(one, [6.0]).error[0]) for one in (exact, sampled)]
    assert left[0] == pytest.approx(0.0712, abs=5e-4)
    assert left[1] < 1e-12
    peaks = [pf.frequency_response(one).peak.value for one in (exact, sampled)]
    assert peaks == pytest.approx([1.197, 1.420], abs=2e-3)


def test_learning_by_gradients_refuses_it():
    sampled = designed(3, 2, 0).sampled(0.01)
    with pytest.raises(ValueError, match="got 'matched', whose output row follows from the zeros"):
        Rollout(sampled)


@pytest.mark.parametrize(("damping", "kept"), [(1e-7, True), (1e-5, False), (1e-3, False)])
def test_a_zero_beside_the_axis_is_followed_only_where_it_was_meant_to_be_on_it(damping, kept):
    """1 - F = s (s^2 + 2 damping w s + w^2) / (s + 20)^3."""
    a = np.array([8000.0, 1200.0, 60.0])
    filter = pf.PhyFilter(a, a - [0.0, 16.0, 8.0 * damping])
    assert followed_frequencies(filter) == pytest.approx([4.0] if kept else [], rel=1e-9)


def test_a_step_too_long_for_the_states_is_refused():
    """Of this filter the row grows 13 times at 0.15 s and 400 times at 0.25 s."""
    filter = designed(3, 1, 1)
    assert matched_output(filter, 0.15).shape == (3,)
    with pytest.raises(ValueError, match=r"a step of 0.25 s is too long for poles of up to 20 rad/s"):
        matched_output(filter, 0.25)
