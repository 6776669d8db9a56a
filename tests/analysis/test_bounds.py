"""Ultimate bounds against closed forms, against simulated worst cases, and never below any simulated error."""

import math

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import cont2discrete

import phyfilter_ctl as pf
from phyfilter_ctl import Bounded, error_bound
from phyfilter_ctl.analysis.bounds.sampled_kernels import SampledKernels
from tests.cpu_budget import slow_but

# What an exact bound is enclosed to, relative.
CERTIFIED = 1e-6
# Rounding of a simulation of a few hundred steps.
ROUNDING = 1e-9

FAMILIES = ("binomial", "butterworth", "bessel", "itae")


def family(name, order, cutoff=20.0):
    return pf.lowpass(order, cutoff, family="binomial" if order == 1 else name)


@pytest.mark.parametrize("order", range(1, 7))
def test_real_poles_in_closed_form(order):
    """Real poles: no kernel of F or (1 - F)/s changes its sign, so the L1 norms are the gains at s = 0."""
    f = pf.place_poles([-4.0 * 1.7**i for i in range(order)])
    assert error_bound(f, {1: 2.0}).bound == pytest.approx(2.0 * f.a[1] / f.a[0] if order > 1 else 0.5)
    result = error_bound(f, Bounded({0: 0.0}, inertia_error=0.3, rate=2.0))
    assert result.inertia == pytest.approx(0.6, rel=CERTIFIED)
    assert error_bound(f, {0: 1.0}).bound == pytest.approx(2.0, rel=CERTIFIED)


def test_the_bound_is_the_sum_of_its_parts():
    """One pole at -4: slope 2 costs 2/4, a prior off by 0.3 at rate 2 costs 0.6, noise 0.1 on x costs 2 a_0 0.1."""
    f = pf.place_poles([-4.0])
    result = error_bound(f, Bounded({1: 2.0}, noise=0.1, inertia_error=0.3, rate=2.0))
    parts = (result.intrinsic, result.inertia, result.noise)
    assert parts == pytest.approx((0.5, 0.6, 0.8), rel=CERTIFIED)
    assert result.bound == pytest.approx(1.9, rel=CERTIFIED)


def test_textbook_bounds_of_sampled_filters_are_refused():
    with pytest.raises(ValueError, match="is for continuous filters"):
        error_bound(pf.place_poles([-4.0]).sampled(0.01), {1: 2.0}, method="lyapunov")


@pytest.mark.parametrize("damping", [0.05, 0.2, 0.5, 0.9, 0.999])
def test_an_oscillating_pair_in_closed_form(damping):
    """||w^2/(s^2 + 2 z w s + w^2)||_1 = coth(pi z / (2 sqrt(1 - z^2)))."""
    f = pf.PhyFilter([900.0, 60.0 * damping])
    result = error_bound(f, Bounded({0: 0.0}, inertia_error=1.0, rate=1.0))
    exact = 1.0 / np.tanh(np.pi * damping / (2.0 * np.sqrt(1.0 - damping**2)))
    assert exact <= result.inertia * (1.0 + 1e-13) <= exact * (1.0 + CERTIFIED)


@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.parametrize("order", range(1, 7))
def test_every_bound_is_certified(name, order):
    f = family(name, order)
    for numerator in ({1: 1.0}, {0: 1.0}):
        certificate = error_bound(f, numerator).certificate
        assert certificate.gap <= CERTIFIED
        assert certificate.tail <= CERTIFIED * certificate.upper


def simulate(system, h, inputs):
    """Samples of a system under inputs held over steps h: (runs, steps) -> (runs, steps)."""
    A, B, C, _, _ = cont2discrete((system.A, system.B, system.C, system.D), h)
    x = np.zeros((len(A), len(inputs)))
    out = np.empty_like(inputs)
    for k in range(inputs.shape[1]):
        out[:, k] = (C @ x)[0]
        x = A @ x + B * inputs[:, k]
    return out


def error_system(f, k):
    """(1 - F)/s^k from its polynomials, without the library's kernels."""
    return ct.tf2ss(ct.tf(f.error_numerator[k:][::-1], np.append(f.a, 1.0)[::-1]))


@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.parametrize("order", slow_but([1, 3], [1, 2, 3, 5, 6]))
def test_a_bang_bang_residual_reaches_the_bound(name, order):
    f = family(name, order, 3.0)
    result = error_bound(f, {1: 2.0})
    t = np.linspace(0.0, result.certificate.horizon, 20001)
    reached = simulate(error_system(f, 1), t[1], result.worst_residual(t)[None, :])
    assert 0.999 * result.bound <= np.abs(reached).max() <= result.bound * (1.0 + ROUNDING)
    assert result.exact


def test_a_bang_bang_residual_reaches_the_bound_of_a_second_derivative():
    f = pf.place_poles([-2.0, -3.0, -4 + 5j, -4 - 5j], type=3)
    for k in (1, 2, 3):
        result = error_bound(f, {k: 1.0})
        t = np.linspace(0.0, result.certificate.horizon, 20001)
        reached = simulate(error_system(f, k), t[1], result.worst_residual(t)[None, :])
        assert 0.999 * result.bound <= np.abs(reached).max() <= result.bound * (1.0 + ROUNDING)


poles = st.lists(
    st.tuples(st.floats(0.3, 8.0), st.floats(0.0, 10.0), st.booleans()), min_size=1, max_size=3
).map(
    lambda parts: [
        p
        for real, imag, pair in parts
        for p in ([complex(-real, imag), complex(-real, -imag)] if pair else [-real])
    ]
)


@pytest.mark.slow
@settings(max_examples=200, deadline=None, derandomize=True)
@given(
    poles,
    st.lists(st.floats(-1.5, 1.5).map(lambda v: round(v, 3)), min_size=6, max_size=6),
    st.integers(0, 3),
    st.integers(0, 10**6),
)
def test_no_simulated_error_is_above_any_bound(chosen, shape, k, seed):
    """64 random residuals an example, each with switches at random and at the kernel's own changes of sign."""
    f = pf.place_poles(chosen)
    k = min(k, f.order)
    b = f.a * np.array(shape[: f.order]) if k == 0 else f.a * np.r_[np.ones(k), shape[k : f.order]]
    if not np.any(b):
        return
    f = pf.PhyFilter(f.a, b, poles=f.poles)
    k = min(k, f.type)
    rng = np.random.default_rng(seed)
    h, n = 0.15 / np.abs(f.poles).max(), 400
    dwell = rng.integers(1, 40, 64)
    signal = np.sign(rng.standard_normal((64, n)))
    signal = np.stack([row[np.arange(n) // d] for row, d in zip(signal, dwell, strict=True)])
    results = {m: error_bound(f, {k: 1.0}, method=m) for m in ("exact", "ellipsoid", "lyapunov")}
    signal[0] = results["exact"].worst_residual(h * np.arange(n))
    output = (
        simulate(error_system(f, k), h, signal)
        if k
        else signal - simulate(ct.ss(f.transfer_function), h, signal)
    )
    reached = float(np.abs(output).max())
    bounds = [results[m].bound for m in ("exact", "ellipsoid", "lyapunov")]
    assert reached <= bounds[0] * (1.0 + ROUNDING)
    assert bounds[0] <= bounds[1] * (1.0 + CERTIFIED)
    assert bounds[1] <= bounds[2] * (1.0 + CERTIFIED)


@pytest.mark.slow
@settings(max_examples=200, deadline=None, derandomize=True)
@given(
    poles,
    st.floats(0.01, 0.6),
    st.sampled_from(["exact", "tustin"]),
    st.booleans(),
    st.integers(0, 3),
    st.integers(0, 10**6),
)
def test_no_simulated_error_of_a_sampled_filter_is_above_its_bound(
    chosen, share, method, general, delay, seed
):
    """The residual changes its slope four times a step; x is its exact integral and the filter is the real one."""
    f = pf.place_poles(chosen)
    rng = np.random.default_rng(seed)
    if general:
        f = pf.PhyFilter(f.a, f.a * np.r_[1.0, rng.uniform(-1.0, 1.5, f.order - 1)], poles=f.poles)
    h = share / np.abs(f.poles).max()
    sampled = f.sampled(h, method, delay=delay * h)
    result = error_bound(sampled, {1: 1.0})
    n, fine = 300, 4
    slope = np.sign(rng.standard_normal((16, n * fine)))
    slope = np.stack(
        [row[np.arange(n * fine) // d] for row, d in zip(slope, rng.integers(1, 99, 16), strict=True)]
    )
    slope[0] = 1.0
    gamma = np.concatenate([np.zeros((16, 1)), np.cumsum(slope, axis=1) * h / fine], axis=1)
    # Integral of a signal on straight lines; the filter starts on a residual that was 0 before.
    x = (
        np.concatenate([np.zeros((16, 1)), np.cumsum(0.5 * (gamma[:, 1:] + gamma[:, :-1]), axis=1)], axis=1)
        * h
        / fine
    )
    late = np.concatenate([np.zeros((16, delay * fine)), x[:, : x.shape[1] - delay * fine]], axis=1)
    f_hat = sampled.run(late[:, ::fine].T).T
    at_samples = np.abs(gamma[:, ::fine] - f_hat).max()
    held = np.repeat(f_hat[:, :-1], fine, axis=1)
    between = np.abs(gamma[:, 1:] - held).max()
    assert at_samples <= result.bound * (1.0 + ROUNDING)
    assert between <= result.between_samples * (1.0 + ROUNDING)


def left_of_a_ramp(sampled):
    """Error at the last sample of gamma = t, M x' = gamma, long after the start."""
    t = sampled.dt * np.arange(1 + int(60.0 / (sampled.dt * np.abs(sampled.filter.poles.real).min())))
    return t[-1] - sampled.run(0.5 * t[:, None] ** 2)[-1, 0]


@pytest.mark.parametrize("poles", [[-20.0, -25.0], [-20.0, -30.0, -40.0], [-15.0, -20.0, -10 + 5j, -10 - 5j]])
@pytest.mark.parametrize("h", [0.002, 0.02])
def test_what_a_sampled_filter_leaves_of_a_ramp(poles, h):
    """C A^-2 (A h/2 coth(A h/2) - I) B of the slope: b_(n-1) h^2/12 and terms of h^4, from the mean over a step.

    A staircase of step means is the ramp plus a sawtooth, whose answer at the samples that is; half a step early with
    Euler's method, nothing with the trapezoidal rule.
    """
    f = pf.place_poles(poles, type=len(poles))
    p, n = f.poles, f.order
    numerator, slope = np.polyval(f.b[::-1], p), np.polyval(np.polyder(np.append(f.a, 1.0)[::-1]), p)
    exact = np.sum(numerator / slope * (0.5 * p * h / np.tanh(0.5 * p * h) - 1.0) / p**2).real
    rounding = 1e-15 * (60.0 / np.abs(p.real).min()) ** 2 / h  # of x = t^2/2, over a step
    assert left_of_a_ramp(f.sampled(h, "exact")) == pytest.approx(exact, abs=rounding)
    assert left_of_a_ramp(f.sampled(h, "matched")) == pytest.approx(0.0, abs=rounding)
    assert left_of_a_ramp(f.sampled(h, "euler")) == pytest.approx(-0.5 * h, abs=rounding)
    assert left_of_a_ramp(f.sampled(h, "tustin")) == pytest.approx(0.0, abs=rounding)
    # z coth z = 1 + z^2/3 - 2 z^4 sum 1/((k pi)^2 (z^2 + (k pi)^2)), the last below |z|^4/45 where Re z^2 >= 0.
    rest = np.sum(np.abs(numerator / slope * p**2)) * h**4 / 720.0
    assert abs(exact - f.b[n - 1] * h**2 / 12.0) <= rest


def test_the_ramp_that_a_sampled_filter_does_not_follow_is_named():
    f = pf.place_poles([-5.0, -5.0], type=2)
    for options, left in (
        ({"method": "exact"}, r"infinite: .* leaves b_1 h\^2/12 times the slope .*; use method='matched'"),
        ({"method": "euler"}, "infinite: .* leaves -h/2 times the slope"),
        ({"delay": 0.02}, "infinite: .* leaves its delay times the slope"),
    ):
        with pytest.raises(ValueError, match=left):
            error_bound(f.sampled(0.01, **options), {2: 1.0})
    third = pf.place_poles([-5.0] * 3, type=3).sampled(0.01, "tustin")
    with pytest.raises(ValueError, match=r"leaves an error of residuals t\^2; use 'matched'"):
        error_bound(third, {3: 1.0})
    with pytest.raises(ValueError, match=r"type 1, .* up to order 1$"):
        error_bound(pf.lowpass(2, 5.0).sampled(0.01), {2: 1.0})


@pytest.mark.slow
@settings(max_examples=15, deadline=None, derandomize=True)
@given(poles, st.integers(2, 4), st.floats(0.02, 0.6), st.integers(0, 10**6))
def test_higher_derivatives_bound_a_matched_filter(chosen, kind, share, seed):
    """gamma^(k) jumps between +-1 every few steps, gamma and x are its exact integrals; the worst course reaches it."""
    f = pf.place_poles(chosen)
    kind = min(kind, f.order)
    f = pf.place_poles(chosen, type=kind)
    h = share / np.abs(f.poles).max()
    sampled, n = f.sampled(h, "matched"), 300
    result = error_bound(sampled, {kind: 1.0})
    rng = np.random.default_rng(seed)
    highest = np.sign(rng.standard_normal((8, n)))
    highest = np.stack(
        [row[np.arange(n) // d] for row, d in zip(highest, rng.integers(1, 60, 8), strict=True)]
    )
    # The worst: the sign of the kernel, seen from the last sample; constant between samples it comes close only.
    X = sampled.transition[1]
    kernel, piece = [], SampledKernels(sampled).pieces[kind - 1][0]
    for _ in range(n):
        kernel.append(float(piece @ X))
        X = X + sampled.transition[0] @ X
    highest[0] = np.sign(kernel)[::-1]
    parts = [np.zeros((8, n + 1)) for _ in range(kind + 1)]  # x, gamma, gamma', ...
    for j in range(n):
        ahead = [p[:, j] for p in parts] + [highest[:, j]]
        for i, part in enumerate(parts):
            part[:, j + 1] = sum(ahead[m] * h ** (m - i) / math.factorial(m - i) for m in range(i, kind + 2))
    error = np.abs(parts[1] - sampled.run(parts[0].T).T)
    rounding = 1e-13 * np.abs(parts[0]).max() / h * np.abs(sampled.realised[0].b / f.a).max()
    assert error.max() <= result.bound * (1.0 + ROUNDING) + rounding
    if share < 0.1 and n * h * np.abs(f.poles).min() > 10.0:
        assert error[0, -1] >= 0.9 * result.bound - rounding
    assert (result.between_samples == np.inf) == (kind > 1)


def test_a_sum_over_samples_is_no_bound():
    """A ramp through one pole of 20 rad/s sampled every 18 ms: h/2 + h q/(1 - q), q = exp(-0.36)."""
    h, q = 0.018, np.exp(-0.36)
    result = error_bound(pf.PhyFilter([20.0]).sampled(h), {1: 1.0})
    assert result.bound == pytest.approx(h / 2 + h * q / (1 - q), rel=1e-12)
    assert h * q / (1 - q) < 0.0416 < 0.0505 < result.bound


def test_noise_of_a_sampled_filter_is_attained():
    sampled = pf.lowpass(3, 20.0, family="butterworth").sampled(0.01)
    result = error_bound(sampled, Bounded({0: 0.0}, noise=0.1))
    pulse = sampled.run(np.r_[0.0, 1.0, np.zeros(2000)][:, None])[1:, 0]
    worst = np.sign(pulse[::-1]) * 0.1
    reached = sampled.run(np.r_[0.0, worst][:, None])[-1, 0]
    assert reached == pytest.approx(result.bound, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("k", [1, 2])
def test_the_envelope_holds_from_the_start(k):
    f = pf.place_poles([-3.0, -2 + 4j, -2 - 4j], type=k)
    result = error_bound(f, {k: 1.0})
    start = dict.fromkeys(range(k), 0.7)
    rng = np.random.default_rng(3)
    t = np.linspace(0.0, 6.0, 1201)
    h = t[1]
    for _ in range(40):
        top = np.sign(rng.standard_normal(len(t)))[np.arange(len(t)) // rng.integers(1, 200)]
        signals = [top]
        for j in reversed(range(k)):
            first = 0.7 * rng.choice([-1.0, 1.0])
            steps = signals[-1][:-1] if j == k - 1 else 0.5 * (signals[-1][1:] + signals[-1][:-1])
            signals.append(np.r_[first, first + np.cumsum(steps) * h])
        response = ct.forced_response(ct.ss(f.transfer_function), t, signals[-1])
        error = np.abs(signals[-1] - response.outputs)
        # Between samples the second integral is a parabola, the response takes a straight line: h^2 / 8.
        assert np.all(error <= result.envelope(t, start) + h**2)
    assert result.envelope([50.0])[0] == pytest.approx(result.bound, rel=1e-3)


@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.parametrize("order", range(1, 6))
def test_how_far_ellipsoids_are_from_exact(name, order):
    f = family(name, order)
    exact = error_bound(f, {1: 1.0}).bound
    assert exact <= error_bound(f, {1: 1.0}, method="ellipsoid").bound * (1 + CERTIFIED) <= 1.1 * exact
    # N = D - s^n: (1 - F)/s^n = 1/D.
    most = pf.place_poles(f.poles, type=order)
    exact = error_bound(most, {order: 1.0}).bound
    assert (
        exact <= error_bound(most, {order: 1.0}, method="ellipsoid").bound * (1 + CERTIFIED) <= 1.55 * exact
    )


def test_the_textbook_radius_depends_on_coordinates():
    """Published in no paper, computed with 80 digits: factors over the exact gain of 1/D, binomial."""
    for order, speed, raw, scaled in ((2, 10.0, 5e3, 8.0), (5, 50.0, 1e25, 1.5e3)):
        f = pf.place_poles([-speed] * order, type=order)
        exact = error_bound(f, {order: 1.0}).bound
        ratio = error_bound(f, {order: 1.0}, method="lyapunov-raw").bound / exact
        assert raw / 3 < ratio < raw * 3
        ratio = error_bound(f, {order: 1.0}, method="lyapunov").bound / exact
        assert scaled / 2 < ratio < scaled * 2


@pytest.mark.parametrize(
    ("residual", "method", "message"),
    [
        ({0: -1.0}, "exact", ">= 0"),
        ({}, "exact", "got none"),
        ({0.5: 1.0}, "exact", "derivative orders"),
        ({2: 1.0}, "exact", "infinite: the filter is of type 1"),
        ({0: 1.0}, "guess", "method"),
    ],
)
def test_bad_bounds_are_refused(residual, method, message):
    with pytest.raises(ValueError, match=message):
        error_bound(pf.lowpass(2, 20.0), residual, method=method)


def test_what_only_a_loop_sees_is_refused():
    for residual, name in (([{1: 1.0}, {0: 0.1}], "parts"), ({1: 1.0}, "actuation")):
        with pytest.raises(ValueError, match=name):
            error_bound(
                pf.lowpass(2, 20.0), pf.Bounded(residual, actuation={0: 1.0} if name == "actuation" else ())
            )
    with pytest.raises(ValueError, match="noise"):
        pf.Bounded({0: 1.0}, noise=-1.0)


def test_a_type_0_filter_has_no_bound_from_derivatives():
    f = pf.PhyFilter([20.0], [18.0])
    with pytest.raises(ValueError, match="type 0"):
        error_bound(f, {1: 1.0})


def test_plot_shows_kernel_and_growth():
    plot = error_bound(pf.lowpass(2, 20.0), {1: 1.0}).plot()
    assert plot.axes.shape == (2, 1)


def test_too_many_samples_for_a_certificate_are_refused():
    with pytest.raises(ValueError, match="longer step"):
        error_bound(pf.PhyFilter([1e-4]).sampled(1e-4), {1: 1.0})


def test_sampled_filters_that_forget_at_once_have_a_bound() -> None:
    """Nothing is divided by the 0 that a pole leaves of itself in a step, with no warning on the way."""
    for f, h, method in (
        (pf.PhyFilter.from_poles([-1e5] * 5), 1e-5, "euler"),  # 1 + p h = 0
        (pf.PhyFilter([1e5]), 1.0, "exact"),
    ):
        result = error_bound(f.sampled(h, method), {1: 1.0})
        # One sample per pole with Euler, half a step of averaging less; f_hat is the last mean otherwise.
        assert result.bound == pytest.approx((f.order - 0.5) * h, rel=1e-6)
    with pytest.raises(ValueError, match="too unlike in size for a certificate"):
        error_bound(pf.PhyFilter.from_poles([-0.5 + 99990j, -0.5 - 99990j] * 4).sampled(1.0), {1: 1.0})


@pytest.mark.parametrize("damping", [0.1, 0.4])
@pytest.mark.parametrize("h", [0.02, 0.1])
def test_sampled_bound_against_quadrature(damping, h):
    """The bound is the area under the error's step response, straight between the samples: here by fine summation.

    The response is that of ``run`` to a residual of 1 from rest, and crosses zero between nearly every two samples.
    """
    sampled = pf.PhyFilter([400.0, 40.0 * damping]).sampled(h)
    t = h * np.arange(2000)
    distance = 1.0 - sampled.run(t)[:, 0]
    fine = np.linspace(0.0, t[-1], 1 + 1000 * (len(t) - 1))
    area = np.trapezoid(np.abs(np.interp(fine, t, distance)), fine)
    assert np.count_nonzero(np.diff(np.sign(distance[:40]))) > 3
    assert error_bound(sampled, {1: 1.0}).bound == pytest.approx(area, rel=1e-5)  # of the summation
