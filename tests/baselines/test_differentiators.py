"""What holds for every differentiator, and each against a closed form or the published recursion run by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are
from scipy.optimize import brentq
from scipy.signal import lsim

from phyfilter_ctl.baselines import (
    BASELINES,
    BackwardDifference,
    KalmanDifferentiator,
    LowpassDifference,
    RobustDifferentiator,
    TrackingDifferentiator,
    TunableDifferentiator,
    robust,
    tracking,
)
from phyfilter_ctl.baselines.protocol import Differentiator

# The same arithmetic in another order: some 1,000 steps of rounding, on estimates of size up to 100.
ROUNDING = 1e-10
# The plain loop does the operations of the recursion one by one; contraction keeps the difference at a few eps.
LOOP = 1e-11
# 1,000 steps are more than 30 time constants of every linear filter below.
STEADY = 1e-8

EVERY = [
    BackwardDifference(3),
    TrackingDifferentiator(r=50.0, h0=4.0),
    RobustDifferentiator(k1=3.0, k2=4.0, mu=300.0),
    RobustDifferentiator(k1=0.1, k2=0.01, mu=1e3),
    KalmanDifferentiator(q=50.0, r=1e-4),
    LowpassDifference(20.0),
    LowpassDifference(20.0, order=2),
]
LINEAR = [d for d in EVERY if isinstance(d, BackwardDifference | KalmanDifferentiator | LowpassDifference)]
every = pytest.mark.parametrize("differentiator", EVERY, ids=repr)


def velocity(n: int = 1300, channels: int = 3, seed: int = 0, dt: float = 0.01) -> np.ndarray:
    """Sines with noise from a start that is not zero; longer than two blocks of the recursions."""
    rng = np.random.default_rng(seed)
    t = np.arange(n)[:, None] * dt
    omega = rng.uniform(0.5, 4.0, channels)
    return (
        1.0 + np.sin(omega * t + rng.uniform(0.0, 6.0, channels)) + 0.01 * rng.standard_normal((n, channels))
    )


# ---------------------------------------------------------------------------------------------- for every one of them


@every
def test_is_a_tunable_differentiator(differentiator: Differentiator) -> None:
    assert isinstance(differentiator, Differentiator)
    assert isinstance(differentiator, TunableDifferentiator)
    assert type(differentiator) in BASELINES.values()


@every
@given(cut=st.integers(1, 1299), seed=st.integers(0, 100))
@settings(max_examples=5, deadline=None)
def test_is_causal(differentiator: Differentiator, cut: int, seed: int) -> None:
    v = velocity(seed=seed)
    changed = v.copy()
    changed[cut:] += 1.0
    before, after = differentiator.estimate(v, 0.01), differentiator.estimate(changed, 0.01)
    assert np.array_equal(before[:cut], after[:cut])
    # and it uses the sample at hand: no delay is hidden in the indexing
    assert not np.any(before[cut] == after[cut])


@every
def test_channels_do_not_mix(differentiator: Differentiator) -> None:
    v = velocity()
    together = differentiator.estimate(v, 0.01)
    apart = [differentiator.estimate(v[:, [i]], 0.01) for i in range(3)]
    assert together.shape == v.shape
    np.testing.assert_array_equal(together, np.hstack(apart))


@every
def test_starts_without_a_bump_and_ignores_an_offset(differentiator: Differentiator) -> None:
    v = velocity()
    estimate = differentiator.estimate(v, 0.01)
    assert np.all(estimate[0] == 0.0)
    assert np.all(differentiator.estimate(np.full((700, 2), 7.0), 0.01) == 0.0)
    assert np.all(differentiator.estimate([[3.0, 4.0]], 0.01) == 0.0)
    np.testing.assert_allclose(differentiator.estimate(v + 8.0, 0.01), estimate, rtol=0.0, atol=1e-8)


@every
def test_input_is_left_alone(differentiator: Differentiator) -> None:
    v = velocity(50)
    kept = v.copy()
    differentiator.estimate(v, 0.01)[:] = 9.0
    assert np.array_equal(v, kept)


@every
@pytest.mark.parametrize(
    ("v", "dt", "error", "words"),
    [
        (np.zeros(5), 0.01, ValueError, r"\(N, n_x\).*got \(5,\); for one channel give v\[:, None\]"),
        (np.zeros((0, 3)), 0.01, ValueError, r"got \(0, 3\)"),
        (np.zeros((2, 2, 2)), 0.01, ValueError, r"got \(2, 2, 2\)"),
        ([[0.0, 1.0], [np.nan, 1.0]], 0.01, ValueError, "nan in row 1, column 0"),
        ([[0.0, np.inf]], 0.01, ValueError, "inf in row 0, column 1"),
        ([["a"]], 0.01, TypeError, "real numbers"),
        ([[1j]], 0.01, TypeError, "real numbers"),
        ([[0.0]], 0.0, ValueError, "dt: expected a finite number > 0"),
        ([[0.0]], -0.1, ValueError, "dt"),
        ([[0.0]], math.nan, ValueError, "dt"),
        ([[0.0]], "fast", ValueError, "dt"),
        ([[0.0]], None, TypeError, "dt: expected a number"),
    ],
)
def test_bad_input(
    differentiator: Differentiator, v: object, dt: float, error: type[Exception], words: str
) -> None:
    if dt == "fast":
        error = TypeError
    with pytest.raises(error, match=words):
        differentiator.estimate(v, dt)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (lambda: BackwardDifference(0), ValueError, "samples: expected at least 1, got 0"),
        (lambda: BackwardDifference(1.5), TypeError, "samples: expected a whole number"),  # pyright: ignore[reportArgumentType]
        (lambda: BackwardDifference(True), TypeError, "samples"),
        (lambda: TrackingDifferentiator(r=0.0), ValueError, "r: expected a finite number > 0"),
        (lambda: TrackingDifferentiator(h0=-1.0), ValueError, "h0"),
        (lambda: RobustDifferentiator(k1=-1.0), ValueError, "k1"),
        (lambda: RobustDifferentiator(k2=math.inf), ValueError, "k2"),
        (lambda: RobustDifferentiator(mu=0.0), ValueError, "mu"),
        (lambda: KalmanDifferentiator(q=0.0), ValueError, "q"),
        (lambda: KalmanDifferentiator(r=math.nan), ValueError, "r"),
        (lambda: LowpassDifference(0.0), ValueError, "cutoff: expected a finite number > 0 rad/s"),
        (lambda: LowpassDifference(1.0, order=3), ValueError, "order: expected 1 or 2, got 3"),  # pyright: ignore[reportArgumentType]
    ],
)
def test_bad_parameters(make: Callable[[], object], error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        make()


@pytest.mark.parametrize("kind", BASELINES.values())
@pytest.mark.parametrize("dt", [0.0005, 0.002, 0.018, 0.5, 2.0])
def test_every_corner_of_the_search_space_is_allowed(kind: type[TunableDifferentiator], dt: float) -> None:
    for end in ("low", "high"):
        values = {
            r.name: int(getattr(r, end)) if r.integer else getattr(r, end) for r in kind.search_space(dt)
        }
        assert kind(**values).estimate([[0.0], [0.0]], dt).shape == (2, 1)


# ----------------------------------------------------------------------------------------------------- the linear ones


@pytest.mark.parametrize("differentiator", LINEAR, ids=repr)
@given(slope=st.floats(-50.0, 50.0), start=st.floats(-10.0, 10.0))
@settings(max_examples=10, deadline=None)
def test_ramp_is_followed_exactly(differentiator: Differentiator, slope: float, start: float) -> None:
    v = start + slope * 0.01 * np.arange(1000.0)[:, None]
    assert abs(differentiator.estimate(v, 0.01)[-1, 0] - slope) < STEADY


@pytest.mark.parametrize("m", [1, 2, 7, 40, 60])
def test_backward_difference_is_its_definition(m: int) -> None:
    v = velocity(50)
    expected = [[(v[k, i] - v[max(k - m, 0), i]) / (m * 0.01) for i in range(3)] for k in range(50)]
    np.testing.assert_allclose(BackwardDifference(m).estimate(v, 0.01), expected, rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("cutoff", [0.5, 20.0, 300.0])
def test_lowpass_is_the_exact_response_to_straight_lines(order: int, cutoff: float) -> None:
    v = velocity(400, channels=1)[:, 0]
    t = 0.01 * np.arange(400)
    denominator = np.poly([-cutoff] * order)
    _, expected, _ = lsim(([cutoff**order, 0.0], denominator), v - v[0], t, interp=True)
    estimate = LowpassDifference(cutoff, order=1 if order == 1 else 2).estimate(v[:, None], 0.01)[:, 0]
    np.testing.assert_allclose(estimate, expected, rtol=0.0, atol=ROUNDING * max(1.0, cutoff))


def model(q: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
    return np.array([[1.0, dt], [0.0, 1.0]]), q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])


@pytest.mark.parametrize("dt", [0.002, 0.02])
@pytest.mark.parametrize("q", [0.1, 10.0, 1e4, 1e9])
def test_kalman_gain_is_the_limit_of_the_riccati_recursion(q: float, dt: float) -> None:
    r = 1e-5
    F, Q = model(q, dt)
    P, K = np.diag([1.0, 100.0]), np.zeros(2)
    for _ in range(5000):
        K = P[:, 0] / (P[0, 0] + r)
        P = F @ (P - np.outer(K, P[0])) @ F.T + Q
        P = (P + P.T) / 2.0
    # 5,000 steps forget the start; what is left is the recursion's own rounding
    np.testing.assert_allclose(KalmanDifferentiator(q, r).gain(dt), K, rtol=1e-9)


@given(st.floats(-2.5, 2.5))
@settings(max_examples=50, deadline=None)
def test_kalman_gain_solves_the_riccati_equation(exponent: float) -> None:
    q = 10.0 ** (4.0 * exponent)  # bandwidth times dt from 3e-3 to 3e2
    F, Q = model(q, 1.0)
    P = solve_discrete_are(F.T, np.array([[1.0], [0.0]]), Q, np.eye(1))
    # the solver loses digits of the small entries of an ill-scaled P; its gain is good to this
    np.testing.assert_allclose(KalmanDifferentiator(q, 1.0).gain(1.0), P[:, 0] / (P[0, 0] + 1.0), rtol=1e-7)


def test_kalman_only_the_ratio_matters_and_the_limits_are_refused() -> None:
    v = velocity(200)
    one, other = KalmanDifferentiator(3.0, 1e-5), KalmanDifferentiator(3e3, 1e-2)
    np.testing.assert_allclose(one.estimate(v, 0.01), other.estimate(v, 0.01), rtol=1e-9, atol=1e-12)
    with pytest.raises(ValueError, match="change q / r"):
        KalmanDifferentiator(1e300, 1e-300).estimate(v, 0.01)
    # q without bound leaves a line through the last two samples whose slope still remembers the one before
    K1, K2 = KalmanDifferentiator(1e60, 1e-5).gain(0.01)
    assert abs(K1 - 1.0) < 1e-12
    assert abs(K2 * 0.01 - (3.0 - math.sqrt(3.0))) < 1e-12


def test_kalman_is_predict_and_correct() -> None:
    v, dt = velocity(300), 0.01
    filter_ = KalmanDifferentiator(20.0, 1e-4)
    K1, K2 = filter_.gain(dt)
    for i in range(3):
        speed, slope, expected = v[0, i], 0.0, []
        for sample in v[:, i]:
            predicted = speed + dt * slope if expected else speed
            innovation = sample - predicted
            speed, slope = predicted + K1 * innovation, slope + K2 * innovation
            expected.append(slope)
        np.testing.assert_allclose(filter_.estimate(v, dt)[:, i], expected, rtol=0.0, atol=ROUNDING)


# ---------------------------------------------------------------------------------------------- tracking differentiator


def sgn(x: float) -> float:
    return 0.0 if x == 0.0 else math.copysign(1.0, x)


def fhan_by_hand(x1: float, x2: float, r: float, h0: float) -> float:
    d = r * h0**2
    a0 = h0 * x2
    y = x1 + a0
    a1 = math.sqrt(d * (d + 8.0 * abs(y)))
    # the two-branch form of the same law: a = a0 + y inside |y| <= d, else the square-root branch
    a = a0 + y if abs(y) <= d else a0 + sgn(y) * (a1 - d) / 2.0
    return -r * a / d if abs(a) <= d else -r * sgn(a)


@pytest.mark.parametrize(("r", "h0"), [(5.0, 1.0), (50.0, 4.0), (1e4, 10.0), (2.0, 30.0)])
def test_tracking_differentiator_is_hans_recursion(r: float, h0: float) -> None:
    v, dt = velocity(), 0.01
    expected = np.zeros_like(v)
    for i in range(3):
        x1, x2 = v[0, i], 0.0
        for k in range(len(v)):
            x1, x2 = x1 + dt * x2, x2 + dt * fhan_by_hand(x1 - v[k, i], x2, r, h0 * dt)
            expected[k, i] = x2
    estimate = TrackingDifferentiator(r, h0).estimate(v, dt)
    np.testing.assert_allclose(estimate, expected, rtol=0.0, atol=LOOP * max(1.0, r))


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("r", [4.0, 100.0])
def test_tracking_differentiator_reaches_a_set_point_in_least_time_without_overshoot(
    side: float, r: float
) -> None:
    dt, jump = 0.001, 2.0
    v = np.full((4000, 1), side * jump)
    v[0] = 0.0
    slope = side * TrackingDifferentiator(r, h0=1.0).estimate(v, dt)[:, 0]
    position = dt * np.concatenate([[0.0], np.cumsum(slope)[:-1]])
    assert np.max(np.abs(np.diff(slope))) <= r * dt * (1.0 + 1e-9)
    # fhan's curve is reached to within a step: what is left is a tenth of what one step at the limit r moves
    assert np.max(position) <= jump + 0.1 * r * dt**2
    assert np.min(slope) >= -0.1 * r * dt
    # full acceleration to the middle, full braking to the end
    least, peak = 2.0 * math.sqrt(jump / r), math.sqrt(jump * r)
    arrival = dt * np.argmax(position > jump * (1.0 - 1e-6))
    assert least * 0.99 <= arrival <= least + 5.0 * dt
    assert abs(np.max(slope) - peak) <= 2.0 * r * dt
    assert abs(position[-1] - jump) < 1e-9


def test_tracking_differentiator_settles_on_a_ramp() -> None:
    v = 1.0 - 3.0 * 0.01 * np.arange(1000.0)[:, None]
    assert abs(TrackingDifferentiator(r=50.0, h0=4.0).estimate(v, 0.01)[-1, 0] + 3.0) < STEADY


# ------------------------------------------------------------------------------------------------ robust differentiator


@pytest.mark.parametrize(
    ("k1", "k2", "mu"), [(5.0, 10.0, 0.5), (1.0, 1.0, 5.0), (0.03, 0.02, 2e4), (5.0, 300.0, 0.5)]
)
def test_robust_differentiator_solves_the_equations_of_backward_euler(
    k1: float, k2: float, mu: float
) -> None:
    """Each step against a root finder that knows only that the left side rises with e."""
    v, h = velocity(200), 0.01
    expected = np.zeros_like(v)
    for i in range(3):
        z0, z1 = v[0, i], 0.0
        for k in range(len(v)):

            def phi1(e: float) -> float:
                return (abs(e) ** 0.5 + mu * abs(e) ** 1.5) * sgn(e)

            def phi2(e: float) -> float:
                return sgn(e) / 2.0 + 2.0 * mu * e + 1.5 * mu**2 * e**2 * sgn(e)

            ahead = z0 + h * z1 - v[k, i]
            if abs(ahead) <= 0.5 * k2 * h**2:
                z0, z1 = v[k, i], (v[k, i] - z0) / h
            else:
                e = brentq(
                    lambda e, ahead=ahead: e + h * k1 * phi1(e) + h**2 * k2 * phi2(e) - ahead,
                    -abs(ahead),
                    abs(ahead),
                    xtol=1e-300,
                    rtol=1e-15,
                    maxiter=1000,
                )
                z0, z1 = v[k, i] + e, z1 - h * k2 * phi2(e)
            expected[k, i] = z1
    estimate = RobustDifferentiator(k1, k2, mu=mu).estimate(v, h)
    np.testing.assert_allclose(estimate, expected, rtol=0.0, atol=1e-9)


def convergence_time(mu: float, error: float, dt: float = 1e-3, n: int = 12_000) -> float:
    """When |z1 - v'| falls below 0.1 for good, from an error of this size in both states; v = sin, so |v''| <= 1."""
    t = dt * np.arange(n)[:, None]
    differentiator = RobustDifferentiator(k1=2.5, k2=4.0, mu=mu)
    start = np.array([error])
    _, z1 = differentiator._states(np.sin(t), dt, start, start)
    outside = np.abs(z1 - np.cos(t))[:, 0] > 0.1
    assert not outside[-1]
    return dt * float(n - np.argmax(outside[::-1]))


def test_robust_differentiator_converges_within_a_time_that_no_error_exceeds() -> None:
    times = [convergence_time(1.0, error) for error in (1.0, 1e1, 1e2, 1e3, 1e4)]
    # From 1e2 on, two decades of error cost next to nothing more ...
    assert times[-1] < 1.1 * times[2]
    assert max(times) < 3.0
    # ... whereas without the terms in mu (the super-twisting differentiator) the time grows with the error.
    plain = [convergence_time(1e-9, error) for error in (1.0, 4.0, 16.0)]
    assert plain[2] > 3.0 * plain[1] > 7.0 * plain[0]


def test_robust_differentiator_is_exact_without_noise_and_does_not_chatter() -> None:
    """It ends on the backward difference, on a ramp and on what bends by less than k2 / 2."""
    t = 0.002 * np.arange(3000.0)[:, None]
    for v in (1.0 - 3.0 * t, np.sin(2.0 * t)):
        tail = RobustDifferentiator(5.0, 10.0, mu=1.0).estimate(v, 0.002)[-500:, 0]
        np.testing.assert_allclose(tail, np.diff(v[-501:, 0]) / 0.002, rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize("dt", [5e-4, 0.01, 2.0])
def test_robust_differentiator_never_diverges(dt: float) -> None:
    """At every corner of the search space, on steps and on noise of any size: no gain was tuned for them."""
    rng = np.random.default_rng(0)
    v = np.hstack([10.0**size * rng.standard_normal((300, 1)) for size in (-6, 0, 3, 50)])
    v[150:, 0] += 1e3
    ends = [(r.low, r.high) for r in RobustDifferentiator.search_space(dt)]
    for k1, k2, mu in product(*ends):
        estimate = RobustDifferentiator(k1, k2, mu=mu).estimate(v, dt)
        assert np.isfinite(estimate).all()
        # e is no larger than where it was ahead, so that no step of z1 exceeds that over dt.
        assert np.all(np.abs(estimate) < 100.0 * np.max(np.abs(v), axis=0) / dt)


def test_robust_differentiator_is_at_its_limit_where_the_search_for_mu_ends() -> None:
    """There only k1 mu and k2 mu^2 count, the gains of its higher powers: a larger mu changes nothing."""
    (mu,) = (r.high for r in RobustDifferentiator.search_space(0.01) if r.name == "mu")
    t = 0.01 * np.arange(600.0)[:, None]
    v = np.sin(3.0 * t) + 0.005 * np.random.default_rng(1).standard_normal((600, 1))
    at_end, beyond = (
        RobustDifferentiator(830.0 / m, 1.2e7 / m**2, mu=m).estimate(v, 0.01) for m in (mu, 100.0 * mu)
    )
    assert np.std(at_end - beyond) < 1e-3 * np.std(at_end)


def test_compiled_recursions_are_kept() -> None:
    assert tracking._block(3) is tracking._block(3)
    assert robust._block(2) is robust._block(2)
    assert robust._block(2) is not robust._block(3)
