"""Continuous loops: closed forms, eigenvalues of the wired-up loop, python-control's margins, simulated searches."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import control as ct
import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.optimize import brentq

from phyfilter_ctl import FilterMargins, InertiaCertificate, Loop, PhyFilter, inertia_tolerance, margins
from phyfilter_ctl.analysis.margins import _winding, largest_bandwidth
from phyfilter_ctl.analysis.margins._factors import Factors, roots_of

# Closed forms and refined figures: repeated poles leave about 1e-14.
CLOSE = 1e-9
# Limits found by watching a simulation grow or decay over a finite time, and by its finite step.
SIMULATED = 1e-2
# A closed-loop pole closer to the axis than this share of the fastest one may fall on either side by rounding.
MARGINAL = 1e-6

LAG = ct.tf(1, [0.1, 1])
SECOND = ct.tf([900.0], [1.0, 36.0, 900.0])


def held(margin: FilterMargins, **sets: Any) -> InertiaCertificate:
    """A constant M of a set, in the loop of these margins."""
    return inertia_tolerance(margin.filter, margin.around, rate=0.0, **sets)


def repeated(n: int, w: float = 20.0, *, full: bool = False) -> PhyFilter:
    """Low-pass form, or N = D - s^n."""
    a = PhyFilter.from_poles([-w] * n).a
    return PhyFilter.from_poles([-w] * n, a if full else None)


def wired(
    filter: PhyFilter, M_hat: np.ndarray, M: np.ndarray, act: ct.StateSpace, kp: float, kd: float
) -> np.ndarray:
    """State matrix of M x' = act(tau), tau = -M_hat (kp p + kd x) - f_hat over [z, x, p, actuator], block by block."""
    n_x = len(M)
    block = filter.state_space(n_x)
    n, m = block.nstates, act.nstates * n_x
    Aa, Ba, Ca, Da = (np.kron(np.eye(n_x), part) for part in (act.A, act.B, act.C, act.D))
    Z = np.hstack([np.eye(n), np.zeros((n, 2 * n_x + m))])
    X = np.hstack([np.zeros((n_x, n)), np.eye(n_x), np.zeros((n_x, n_x + m))])
    P = np.roll(X, n_x, axis=1)
    H = np.hstack([np.zeros((m, n + 2 * n_x)), np.eye(m)])
    measured = M_hat @ X
    f_hat = block.C @ Z + block.D[:, :n_x] @ measured
    tau = -M_hat @ (kp * P + kd * X) - f_hat
    return np.vstack(
        [
            block.A @ Z + block.B[:, :n_x] @ measured + block.B[:, n_x : 2 * n_x] @ tau,
            np.linalg.solve(M, Ca @ H + Da @ tau),
            X,
            Aa @ H + Ba @ tau,
        ]
    )


def reference_poles(
    filter: PhyFilter, mu: float, act: ct.StateSpace, kp: float = 0.0, kd: float = 0.0
) -> np.ndarray:
    """Closed-loop poles without the free integrators that no gain acts on."""
    poles = np.linalg.eigvals(wired(filter, np.array([[mu]]), np.eye(1), act, kp, kd))
    free = 0 if kp else 1 if kd else 2
    return poles[np.argsort(np.abs(poles))][free:]


IDEAL = ct.StateSpace([], [], [], [[1.0]])


# -- limits that are known ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("n", "limit"), [(1, np.inf), (2, np.inf), (3, 9.0), (4, 5.0)])
def test_repeated_poles_lowpass(n: int, limit: float):
    margin = margins(repeated(n))
    assert margin.min_ratio == 0.0
    assert margin.max_ratio == pytest.approx(limit, rel=CLOSE)
    assert len(margin.stable_ratios) == 1


# (s+1)^n - s^n over s^n is -1/mu where both binomials line up: 1/9 and 1/5 in closed form, n = 5 from its polynomial.
@pytest.mark.parametrize(("n", "limit"), [(1, 0.0), (2, 0.0), (3, 1 / 9), (4, 1 / 5), (5, 0.257371227781806)])
def test_repeated_poles_full_type(n: int, limit: float):
    margin = margins(repeated(n, full=True))
    assert margin.min_ratio == pytest.approx(limit, rel=CLOSE)
    assert margin.max_ratio == np.inf


@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("n", [3, 4, 5, 6])
def test_limits_by_eigenvalues(n: int, full: bool):
    """Bisection on the eigenvalues of the wired-up loop."""
    filter = repeated(n, full=full)

    def growth(mu: float) -> float:
        return float(np.max(reference_poles(filter, mu, IDEAL).real))

    margin = margins(filter)
    limit, bracket = (margin.min_ratio, (0.05, 0.6)) if full else (margin.max_ratio, (1.5, 12.0))
    assert limit == pytest.approx(brentq(growth, *bracket, xtol=1e-12), rel=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("n", "full", "limit"), [(3, False, 9.0), (4, False, 5.0), (3, True, 1 / 9), (4, True, 0.2)]
)
def test_limits_by_simulation(n: int, full: bool, limit: float):
    """Runge-Kutta on the equations as they stand, a few ratios around the limit at once."""
    filter = repeated(n, 1.0, full=full)
    ratios = limit * np.array([1.0 - 3 * SIMULATED, 1.0 + 3 * SIMULATED])
    a, b = filter.a, filter.b

    def slope(state: np.ndarray) -> np.ndarray:
        # Companion form of F driven by M_hat x' - tau with x' = tau / M and tau = -f_hat.
        f_hat = b @ state
        w = np.empty_like(state)
        w[:-1] = state[1:]
        w[-1] = -a @ state - (ratios - 1.0) * f_hat
        return w

    state, h, sizes = np.ones((n, 2)), 0.02, []
    for k in range(40_000):
        k1 = slope(state)
        k2 = slope(state + 0.5 * h * k1)
        state = state + h * slope(state + 0.5 * h * k2)
        if k % 400 == 399:
            sizes.append(np.max(np.abs(state), axis=0))
            state = state / sizes[-1]
    rate = np.log(np.array(sizes[10:])).mean(axis=0)
    assert (rate < 0.0).tolist() == [not full, full]


@pytest.mark.parametrize("delay", [1e-4, 0.01, 0.3])
def test_first_order_with_delay(delay: float):
    """s + mu w e^(-s d) = 0: Hayes' limit mu w d = pi/2, and for complex mu |mu| w d = pi/2 - |arg mu|."""
    margin = margins(PhyFilter([20.0]), Loop(delay=delay))
    limit = np.pi / (2.0 * 20.0 * delay)
    assert [c.ratio for c in margin.ratio_crossings[:1]] == pytest.approx([limit], rel=CLOSE)
    assert margin.stable_ratios == ((0.0, pytest.approx(limit, rel=CLOSE)),)
    for angle in (0.0, 0.7, -1.2):
        turned = limit * (1.0 - abs(angle) / (0.5 * np.pi)) * np.exp(1j * angle)
        assert margin.stable(0.999999 * turned)
        assert not margin.stable(1.000001 * turned)


def test_delay_of_several_turns():
    """Delay of several turns within the bandwidth: islands of stability would show here."""
    margin = margins(PhyFilter([20.0]), Loop(delay=5.0))
    assert margin.stable_ratios == ((0.0, pytest.approx(np.pi / 200.0, rel=CLOSE)),)
    assert not margin.is_stable
    assert (margin.phase_margin, margin.delay_margin, margin.modulus_margin) == (0.0, 0.0, 0.0)
    assert margin.sensitivity_peak == np.inf
    assert np.isnan(margin.max_ratio)
    assert np.isnan(margin.gain_margin[0])
    assert "unstable" in margin.describe()


# -- against eigenvalues --------------------------------------------------------------------------------------------


@st.composite
def filters(draw: st.DrawFn, most: int = 5) -> PhyFilter:
    poles: list[complex] = []
    for _ in range(draw(st.integers(1, (most + 1) // 2))):
        size = draw(st.floats(1.0, 60.0))
        if draw(st.booleans()):
            poles += [-size] * draw(st.integers(1, 2))
        else:
            angle = draw(st.floats(0.1, 1.4))
            poles += [-size * np.exp(1j * angle), -size * np.exp(-1j * angle)]
    low = PhyFilter.from_poles(poles)
    kind = draw(st.sampled_from(["lowpass", "full", "general", "bandpass"]))
    shares = draw(st.lists(st.floats(-1.5, 2.5), min_size=low.order, max_size=low.order))
    if kind == "lowpass":
        return low
    b = low.a * (1.0 if kind == "full" else np.array(shares))
    if kind == "bandpass":
        b[0] = 0.0
    return PhyFilter.from_poles(low.poles, b)


ACTUATORS = {"none": None, "lag": LAG, "second": SECOND, "lead": ct.tf([0.02, 1.0], [0.1, 1.0])}
GAINS = {"inner": (0.0, 0.0), "velocity": (0.0, 6.0), "pd": (10.0, 6.0)}


@pytest.mark.slow
@given(
    filter=filters(),
    mu=st.floats(0.02, 20.0),
    actuator=st.sampled_from(sorted(ACTUATORS)),
    gains=st.sampled_from(sorted(GAINS)),
)
@settings(max_examples=150, deadline=None)
def test_verdict_is_that_of_the_eigenvalues(filter: PhyFilter, mu: float, actuator: str, gains: str):
    kp, kd = GAINS[gains]
    act = ACTUATORS[actuator]
    margin = margins(filter, Loop(kp, kd, actuator=act, inertia_ratio=mu))
    poles = reference_poles(filter, mu, IDEAL if act is None else ct.tf2ss(act), kp, kd)
    assume(np.min(np.abs(poles.real)) > MARGINAL * np.max(np.abs(poles)))
    assert margin.is_stable == bool(np.max(poles.real) < 0.0)
    ours = margin.poles
    assert ours is not None
    assert len(ours) == len(poles)
    # The intervals say the same, and so does the count of turns, which no eigenvalue enters.
    assert any(low < mu < high for low, high in margin.stable_ratios) == margin.is_stable
    tiny = margins(filter, Loop(kp, kd, actuator=act, delay=1e-12 / np.max(np.abs(poles))))
    assert tiny.stable(mu) == margin.is_stable


POLES = [-1.0, -np.exp(1j), -np.exp(-1j)]  # with b = -a the loop passes 0 slowly where mu is just below 2


@example(filter=PhyFilter.from_poles(POLES, -PhyFilter.from_poles(POLES).a), delay=1e-3, gains="inner")
@given(filter=filters(3), delay=st.floats(1e-3, 0.2), gains=st.sampled_from(sorted(GAINS)))
@settings(max_examples=40, deadline=None)
def test_delay_against_many_small_lags(filter: PhyFilter, delay: float, gains: str):
    """e^(-s d) as a Pade approximant of high order: an independent verdict away from the boundary."""
    kp, kd = GAINS[gains]
    num, den = ct.pade(delay, 8)
    assume(delay * np.max(np.abs(filter.poles)) < 2.0)
    margin = margins(filter, Loop(kp, kd, delay=delay))
    assert margin.poles is None
    for mu in (0.1, 0.6, 1.0, 3.0):
        poles = reference_poles(filter, mu, ct.tf2ss(ct.tf(num, den)), kp, kd)
        slow = poles[np.abs(poles) < 6.0 / delay]
        if np.min(np.abs(slow.real), initial=1.0) > 1e-3 * np.max(np.abs(filter.poles)):
            assert margin.stable(mu) == bool(np.max(poles.real) < 0.0)
            assert any(low < mu < high for low, high in margin.stable_ratios) == margin.stable(mu)


def test_every_crossing_puts_a_pole_on_the_axis():
    filter = PhyFilter.from_poles([-5.0, -12.0 + 9.0j, -12.0 - 9.0j], [900.0, 100.0, 30.0])
    margin = margins(filter, Loop(10.0, 6.0, actuator=SECOND, delay=0.03))
    assert len(margin.ratio_crossings) > 2
    for ratio, omega, _ in margin.ratio_crossings:
        s = 1j * omega
        value = filter.error(s) + ratio * SECOND(s) * np.exp(-0.03 * s) * (filter(s) + 10.0 / s**2 + 6.0 / s)
        assert abs(value) < CLOSE * (1.0 + ratio * abs(SECOND(s)))


def test_internal_model_and_zero_filter():
    """Zeros of 1 - F on the axis, and F = 0."""
    poles = [-10.0, -10.0 + 5.0j, -10.0 - 5.0j]
    a = PhyFilter.from_poles(poles).a
    tuned = PhyFilter.from_poles(poles, [a[0], a[1] - 49.0, a[2]])  # 1 - F = s (s^2 + 49) / D
    margin = margins(tuned)
    for mu in (0.01, 0.3, 1.0, 4.0, 50.0):
        assert margin.stable(mu) == bool(np.max(reference_poles(tuned, mu, IDEAL).real) < 0.0)
    nothing = margins(PhyFilter([4.0, 4.0], [0.0, 0.0]), Loop(actuator=LAG, delay=0.1))
    assert nothing.stable_ratios == ((0.0, np.inf),)
    assert nothing.modulus_margin == 1.0
    assert nothing.ratio_radius == np.inf


def test_positive_feedback_at_zero_frequency():
    """F(0) = 3: the loop is lost at s = 0 above no ratio, and below 2/3."""
    margin = margins(PhyFilter([20.0], [60.0]))
    assert margin.stable_ratios == ((pytest.approx(2.0 / 3.0, rel=CLOSE), np.inf),)
    assert margin.ratio_crossings[0].omega == 0.0


# -- gain, phase, delay, modulus ------------------------------------------------------------------------------------


def open_loop(
    filter: PhyFilter, act: ct.TransferFunction, kp: float, kd: float, mu: float
) -> ct.TransferFunction:
    s = ct.tf("s")
    F = filter.transfer_function
    gain = F + (kp + kd * s) / s**2 if kp else F
    return ct.minreal(mu * act * gain / (1 - F), 1e-6, verbose=False)


@pytest.mark.parametrize("mu", [0.7, 1.0, 1.6])
@pytest.mark.parametrize("gains", ["inner", "pd"])
def test_margins_are_those_of_python_control(mu: float, gains: str):
    kp, kd = GAINS[gains]
    filter = PhyFilter.from_poles([-15.0, -8.0 + 6.0j, -8.0 - 6.0j])
    margin = margins(filter, Loop(kp, kd, actuator=SECOND, inertia_ratio=mu))
    assert margin.is_stable
    L = open_loop(filter, SECOND, kp, kd, mu)
    gm, pm, sm, _, _, wms = ct.stability_margins(L)
    # python-control names one of the two.
    assert min(abs(np.array(margin.gain_margin) / gm - 1.0)) < 1e-5
    assert np.rad2deg(margin.phase_margin) == pytest.approx(pm, rel=1e-5)
    assert margin.modulus_margin == pytest.approx(sm, rel=1e-5)
    assert margin.modulus_frequency == pytest.approx(wms, rel=1e-3)
    assert margin.sensitivity_peak == pytest.approx(1.0 / sm, rel=1e-5)
    s = 1j * margin.gain_crossings
    np.testing.assert_allclose(np.abs(L(s)), 1.0, rtol=1e-6)


@pytest.mark.parametrize("delay", [0.0, 0.015])
def test_just_within_each_margin_is_stable_and_just_beyond_is_not(delay: float):
    filter = repeated(3, 12.0)
    settings = {"kp": 10.0, "kd": 6.0, "actuator": SECOND}
    margin = margins(filter, Loop(delay=delay, **settings))
    assert margin.is_stable
    for share in (1.0 - 1e-6, 1.0 + 1e-6):
        later = margins(filter, Loop(delay=delay + share * margin.delay_margin, **settings))
        assert later.is_stable == (share < 1.0)
        for turn in (1j, -1j):
            # A turn of every frequency by one phase is a complex ratio.
            turned = margin.stable(np.exp(turn * share * margin.phase_margin))
            assert turned == (share < 1.0)
        assert margin.stable(share * margin.gain_margin[1]) == (share < 1.0)
        around = 1.0 + share * margin.ratio_radius * np.exp(2j * np.pi * np.arange(2000) / 2000)
        if share < 1.0:
            assert all(margin.stable(mu) for mu in around[::100])
    # The disc of the largest radius touches the boundary.
    wider = 1.0 + 1.001 * margin.ratio_radius * np.exp(1j * np.linspace(0.0, np.pi, 400))
    assert not all(margin.stable(mu) for mu in wider)


def test_ideal_inner_loop_has_the_sensitivity_of_the_filter():
    """At mu = 1 without lag S = 1 - F."""
    from phyfilter_ctl.analysis import frequency_response

    for filter in (repeated(4), repeated(3, full=True)):
        margin = margins(filter)
        assert margin.sensitivity_peak == pytest.approx(frequency_response(filter).error_peak.value, rel=1e-9)
    assert margins(PhyFilter([20.0])).modulus_margin == 1.0


# -- matrices -------------------------------------------------------------------------------------------------------


def random_definite(rng: np.random.Generator, n: int) -> np.ndarray:
    root = rng.standard_normal((n, n))
    return root @ root.T + 0.2 * np.eye(n)


@given(seed=st.integers(0, 10**6), n=st.integers(2, 3), symmetric=st.booleans(), full=st.booleans())
@settings(max_examples=40, deadline=None)
def test_matrices_against_the_full_block_loop(seed: int, n: int, symmetric: bool, full: bool):
    rng = np.random.default_rng(seed)
    M = random_definite(rng, n)
    M_hat = random_definite(rng, n) if symmetric else M + 0.8 * rng.standard_normal((n, n))
    assume(np.linalg.cond(M_hat) < 1e6)
    filter = repeated(3, 8.0, full=full)
    verdict = held(margins(filter, Loop(actuator=LAG)), M_hat=M_hat, vertices=[M])
    poles = np.linalg.eigvals(wired(filter, M_hat, M, ct.tf2ss(LAG), 0.0, 0.0))
    poles = poles[np.argsort(np.abs(poles))][2 * n :]  # x and position of each axis are free
    assume(np.min(np.abs(poles.real)) > MARGINAL * np.max(np.abs(poles)))
    assert (verdict.status == "proven") == bool(np.max(poles.real) < 0.0)
    assert verdict.method == "eigenvalues"


def test_rotation_is_a_complex_ratio():
    """M_hat rotated by 40 degrees against M: eigenvalues e^(+-0.7j), decided as a phase."""
    angle = np.deg2rad(40.0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    margin = margins(repeated(2), Loop(delay=0.01))
    verdict = held(margin, M_hat=turn, vertices=[[1.0, 1.0]])
    np.testing.assert_allclose(verdict.ratios, np.cos(angle), rtol=1e-12)
    assert (verdict.status == "proven") == (margin.phase_margin > angle)


@pytest.mark.slow
@given(seed=st.integers(0, 10**6), share=st.floats(0.05, 1.5))
@settings(max_examples=40, deadline=None)
def test_sets_of_matrices_are_sound(seed: int, share: float):
    """Whatever is declared stable is so for every sampled member."""
    rng = np.random.default_rng(seed)
    margin = margins(repeated(3), Loop(actuator=0.02, delay=0.005))
    M_hat = random_definite(rng, 3)
    least = float(np.linalg.eigvalsh(M_hat)[0])

    low, extra = share * M_hat, random_definite(rng, 3)
    if held(margin, M_hat=M_hat, between=(low, low + extra)).status == "proven":
        for _ in range(10):
            root = rng.uniform(0.0, 1.0) * np.linalg.qr(rng.standard_normal((3, 3)))[0]
            part = np.linalg.cholesky(extra)
            assert (
                held(margin, M_hat=M_hat, vertices=[low + part @ root @ root.T @ part.T]).status == "proven"
            )

    radius = share * least
    if held(margin, M_hat=M_hat, within=radius).status == "proven":
        for _ in range(10):
            error = rng.standard_normal((3, 3))
            assert (
                held(margin, M_hat=M_hat, vertices=[M_hat + radius * error / np.linalg.norm(error, 2)]).status
                == "proven"
            )

    bounds = rng.uniform(0.0, 0.3 * share * least, (3, 3))
    bounds = np.maximum(bounds, bounds.T)
    verdict = held(margin, M_hat=M_hat, within=bounds)
    if verdict.status == "proven":
        for _ in range(10):
            error = bounds * rng.choice([-1.0, 1.0], (3, 3))
            error = np.triu(error) + np.triu(error, 1).T
            found = held(margin, M_hat=M_hat, vertices=[M_hat + error])
            assert found.status == "proven"
            assert np.all(found.ratios.real >= verdict.ratios[0].real * (1.0 - CLOSE))
            assert np.all(found.ratios.real <= verdict.ratios[1].real * (1.0 + CLOSE))


@pytest.mark.parametrize("seed", range(6))
def test_boxes_of_matrices_are_exact_whatever_the_units(seed: int):
    """Both ends of the range are those of a vertex, found by trying all; a congruence of units changes nothing."""
    rng, n = np.random.default_rng(seed), 3
    margin = margins(repeated(3))
    M_hat = np.eye(n) + 0.2 * random_definite(rng, n)
    bounds = rng.uniform(0.0, 0.1, (n, n)) * np.sqrt(np.outer(np.diag(M_hat), np.diag(M_hat)))
    bounds = np.maximum(bounds, bounds.T)
    rows, columns = np.triu_indices(n)
    found = []
    for signs in itertools.product((-1.0, 1.0), repeat=len(rows)):
        error = np.zeros((n, n))
        error[rows, columns] = error[columns, rows] = signs * bounds[rows, columns]
        found.append(np.linalg.eigvals(M_hat @ np.linalg.inv(M_hat + error)).real)
    verdict = held(margin, M_hat=M_hat, within=bounds)
    assert verdict.ratios.real == pytest.approx([np.min(found), np.max(found)], rel=1e-10)
    units = np.diag([1.0, 1e-3, 1e4])
    again = held(margin, M_hat=units @ M_hat @ units, within=units @ bounds @ units)
    np.testing.assert_allclose(again.ratios, verdict.ratios, rtol=1e-9)


def test_many_axes_and_mixed_units():
    margin = margins(repeated(3))
    mixed = held(margin, M_hat=[10.0, 0.01], within=np.diag([1.0, 0.001]))
    assert mixed.ratios.real == pytest.approx([1.0 / 1.1, 1.0 / 0.9], rel=1e-12)
    rng, n = np.random.default_rng(1), 15
    M_hat = np.eye(n) + 0.02 * random_definite(rng, n)
    bounds = 0.2 / n * np.sqrt(np.outer(np.diag(M_hat), np.diag(M_hat)))
    verdict, few = (
        held(margin, M_hat=M_hat, within=bounds),
        held(margin, M_hat=M_hat[:5, :5], within=bounds[:5, :5]),
    )
    signs = rng.choice([-1.0, 1.0], n)
    for sign in (-1.0, 1.0):
        ratios = held(
            margin, M_hat=M_hat, vertices=[M_hat + sign * signs * bounds * signs[:, None]]
        ).ratios.real
        assert verdict.ratios[0].real <= ratios.min() <= ratios.max() <= verdict.ratios[1].real
    # A part of the axes is less uncertain than all.
    assert verdict.ratios[0].real <= few.ratios[0].real


def test_sets_that_fit_are_accepted_and_others_explained():
    margin = margins(repeated(3))
    assert held(margin, M_hat=np.eye(2), between=(0.12 * np.eye(2), 50.0 * np.eye(2))).status == "proven"
    assert held(margin, M_hat=np.eye(2), between=(0.11 * np.eye(2), 50.0 * np.eye(2))).status != "proven"
    small = held(margin, M_hat=np.eye(2), within=0.9 * margin.modulus_margin)
    assert (small.status, small.method) == ("proven", "small gain")
    assert held(margin, M_hat=np.eye(2), within=1.1 * margin.modulus_margin).status != "proven"
    assert "singular" in held(margin, M_hat=np.eye(2), within=np.full((2, 2), 0.6)).message
    # The small-gain bound is attained by a pair of axes that turn into each other.
    frequency = 1j * margin.modulus_frequency
    F = complex(repeated(3)(frequency))
    direction = -1.0 / (1.0 - F)  # -1 - 1/L ... : 1 + z (1 - F) = 0
    z = 1.001 * direction
    turned = np.array([[z.real, -z.imag], [z.imag, z.real]])
    assert abs(direction) == pytest.approx(margin.modulus_margin, rel=1e-6)
    assert held(margin, M_hat=np.eye(2), vertices=[np.eye(2) + turned]).status != "proven"


# -- bandwidth ------------------------------------------------------------------------------------------------------


def first(w: float) -> PhyFilter:
    return PhyFilter([w])


def simulated_limit(delay: float, kp: float, kd: float, candidates: np.ndarray) -> float:
    """Bandwidth at which the oscillation neither grows nor decays: n = 1, lag of 100 ms, all candidates at once.

    Every part is stepped exactly on a fine grid with the command held over its steps.
    """
    h, w = 2e-4, candidates
    late = round(delay / h)
    decay, forget = np.exp(-h / 0.1), np.exp(-w * h)
    p, x, a, f_hat = (np.zeros_like(w) for _ in range(4))
    x, a = x + 1.0, a + 1.0
    line, top, growth = [np.zeros_like(w)] * (late + 1), np.zeros_like(w), []
    for k in range(60_000):
        command = -kp * p - kd * x - f_hat
        line = [command, *line[:late]]
        sent = 0.5 * (line[late - 1] + line[late])  # a command held over a step is half a step late by itself
        # Actuator a' = (sent - a)/T, x' = a, p' = x over the step.
        gained = sent * h + (a - sent) * 0.1 * (1.0 - decay)
        p, a = p + h * (x + 0.5 * gained), sent + (a - sent) * decay
        x = x + gained
        f_hat = forget * f_hat + (1.0 - forget) * (gained / h - command)
        top = np.maximum(top, np.abs(a))
        if k % 6000 == 5999:
            growth.append(np.log(top))
            p, x, a, f_hat, line = p / top, x / top, a / top, f_hat / top, [each / top for each in line]
            top = np.zeros_like(w)
    return float(np.interp(0.0, np.mean(growth[4:], axis=0), candidates))


@pytest.mark.slow
@pytest.mark.parametrize("gains", ["inner", "pd"])
def test_largest_bandwidth_against_a_simulated_search(gains: str):
    kp, kd = GAINS[gains]
    found = largest_bandwidth(first, Loop(kp, kd, actuator=LAG, delay=0.02), modulus_margin=0.0)
    assert (found.status, found.islands) == ("limited", ())
    candidates = found.limit * np.linspace(0.9, 1.1, 41)
    assert simulated_limit(0.02, kp, kd, candidates) == pytest.approx(found.limit, rel=SIMULATED)


def test_largest_bandwidth_in_closed_form():
    """Inner loop, n = 1: arctan(T omega) + d omega = pi/2, w = omega |1 + j T omega|."""
    found = largest_bandwidth(first, Loop(actuator=LAG, delay=0.02), modulus_margin=0.0)
    omega = brentq(lambda v: np.arctan(0.1 * v) + 0.02 * v - 0.5 * np.pi, 1.0, 70.0, xtol=1e-13)
    assert found.limit == pytest.approx(omega * np.hypot(1.0, 0.1 * omega), rel=1e-8)


@pytest.mark.slow
def test_the_inner_loop_alone_overestimates():
    complete = largest_bandwidth(first, Loop(10.0, 6.0, actuator=LAG, delay=0.02), modulus_margin=0.0).limit
    inner = largest_bandwidth(first, Loop(actuator=LAG, delay=0.02), modulus_margin=0.0).limit
    assert 1.7 < inner / complete < 4.7


def test_largest_bandwidth_with_a_modulus_margin():
    loop = {"kp": 10.0, "kd": 6.0, "actuator": LAG, "delay": 0.02}
    found = largest_bandwidth(first, Loop(**loop))
    assert found.modulus_margin == 0.5
    at = margins(PhyFilter([found.limit]), Loop(**loop))
    assert at.modulus_margin == pytest.approx(0.5, abs=1e-6)
    assert found.limit < largest_bandwidth(first, Loop(**loop), modulus_margin=0.0).limit


@pytest.mark.parametrize("wanted", [0.0, 0.5])
@pytest.mark.parametrize("dt", [None, 0.01])
def test_a_loop_on_the_boundary_is_not_borne(wanted: float, dt: float | None):
    """kp alone and an ideal actuator: closed-loop poles at +-2j for every bandwidth; sampled they are outside."""
    found = largest_bandwidth(first, Loop(kp=4.0), dt=dt, modulus_margin=wanted)
    assert (found.status, found.islands) == ("infeasible", ())
    assert f"modulus margin 0, {wanted:g} is asked for" in found.message


@pytest.mark.parametrize("kp", [1e-4, 4.0, 1e4])
@pytest.mark.parametrize("n", [1, 4])
def test_poles_on_the_axis_are_not_stable(kp: float, n: int):
    for w in np.geomspace(0.1, 1e3, 41):
        margin = margins(repeated(n, w), Loop(kp, 0.0))
        assert not margin.is_stable
        assert margin.modulus_margin == 0.0
        assert not margin.stable(1.0)


@pytest.mark.parametrize("dt", [None, 1e-3])
def test_slow_and_lightly_damped_loops_are_stable(dt: float | None):
    """The boundary is relative to the pole: 0.05 rad/s next to a lag of 10 us, damping 1e-4 at 0.05 rad/s."""
    fast = ct.tf(1, [1e-5, 1])
    assert margins(PhyFilter([0.05]), Loop(actuator=fast), dt=dt).is_stable
    # Held for a step and lagging, the command costs kp (h/2 + T) of damping.
    late = (0.5 * dt if dt else 0.0) + 1e-5
    damped = margins(
        PhyFilter([5.0]), Loop(0.05**2, 2.0 * 1e-4 * 0.05 + 0.05**2 * late, actuator=fast), dt=dt
    )
    assert damped.is_stable
    assert not margins(PhyFilter([5.0]), Loop(0.05**2, 0.0, actuator=fast), dt=dt).is_stable


def test_bandwidth_status():
    assert largest_bandwidth(first, high=100.0).status == "unlimited"
    assert largest_bandwidth(first, high=100.0).limit == 100.0
    none = largest_bandwidth(first, Loop(actuator=LAG, delay=0.02), low=60.0, high=100.0)
    assert none.status == "infeasible"
    assert np.isnan(none.limit)
    assert "start lower" in none.message


@pytest.mark.slow
def test_islands_are_reported():
    """A family whose bandwidth overshoots within a band narrower than the scan: only a dip of the margin tells."""

    def family(w: float) -> PhyFilter:
        return PhyFilter([5.0 + 55.0 * np.exp(-((np.log(w / 10.0) / 0.1) ** 2))])

    found = largest_bandwidth(family, Loop(actuator=LAG, delay=0.02), modulus_margin=0.0, low=1.0, high=100.0)
    borne = largest_bandwidth(first, Loop(actuator=LAG, delay=0.02), modulus_margin=0.0).limit
    half = 0.1 * np.sqrt(np.log(55.0 / (borne - 5.0)))
    assert found.status == "limited"
    assert found.limit == pytest.approx(10.0 * np.exp(-half), rel=1e-7)
    assert found.islands == ((pytest.approx(10.0 * np.exp(half), rel=1e-7), 100.0),)
    assert "cut off" in found.message


# -- what is refused ------------------------------------------------------------------------------------------------

ONE = PhyFilter([20.0])


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: margins(ONE, Loop(delay=-0.1)), ValueError, "delay: expected a finite number >= 0"),
        (lambda: margins(ONE, Loop(delay=float("nan"))), ValueError, "delay"),
        (lambda: margins(ONE, Loop(inertia_ratio=0.0)), ValueError, "inertia_ratio: expected a positive"),
        (
            lambda: margins(ONE, Loop(actuator=ct.tf(1, [1, -1]))),
            ValueError,
            "actuator: pole 1.*open left half",
        ),
        (lambda: margins(ONE, Loop(actuator=ct.tf(1, [1, 0]))), ValueError, "actuator: pole 0"),
        (lambda: margins(ONE, Loop(actuator=ct.tf([1, 0], [1]))), ValueError, "not proper"),
        (lambda: margins(ONE, Loop(actuator=ct.tf(1, [1, 0.5], 0.1))), ValueError, "continuous-time"),
        (
            lambda: margins(ONE, Loop(actuator=ct.ss([[1.0]], [[1.0]], [[1.0]], [[0.0]]))),
            ValueError,
            "pole 1",
        ),
        (
            lambda: margins(ONE, Loop(actuator=ct.ss(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2))))),
            ValueError,
            "one input and one output",
        ),
        (lambda: margins(ONE, Loop(actuator="fast")), TypeError, "TransferFunction"),
        (lambda: margins([20.0]), TypeError, "system: expected a filter"),
        (lambda: margins(ONE, 10.0), TypeError, "loop: expected a Loop"),
        (lambda: margins(ONE, at="u"), ValueError, "at: not for a filter"),
        (lambda: margins(LAG, dt=0.01), ValueError, "dt: not for a python-control system"),
        (lambda: margins(ONE).stable(np.inf), ValueError, "ratio: expected a finite"),
        (
            lambda: held(margins(ONE), M_hat=np.ones((2, 3)), vertices=[np.eye(2)]),
            ValueError,
            "M_hat: expected a square",
        ),
        (
            lambda: held(margins(ONE), M_hat=np.eye(2), vertices=[np.ones((2, 2))]),
            ValueError,
            "vertices: singular",
        ),
        (lambda: held(margins(ONE), M_hat=np.eye(2), vertices=[np.eye(3)]), ValueError, "expected the same"),
        (lambda: held(margins(ONE), M_hat=[np.nan], vertices=[[1.0]]), ValueError, "finite"),
        (lambda: held(margins(ONE), M_hat=1.0, between=(2.0, 1.0)), ValueError, "exchanged"),
        (lambda: held(margins(ONE), M_hat=np.eye(2), between=(1.0, 2.0)), ValueError, "one shape"),
        (lambda: held(margins(ONE), M_hat=1.0, between=(-1.0, 1.0)), ValueError, "positive definite"),
        (
            lambda: held(margins(ONE), M_hat=[[1.0, 0.5], [0.0, 1.0]], between=(np.eye(2), np.eye(2))),
            ValueError,
            "symmetric",
        ),
        (lambda: held(margins(ONE), M_hat=1.0, within=-1.0), ValueError, "within: expected finite"),
        (lambda: held(margins(ONE), M_hat=np.eye(2), within=[1.0]), ValueError, r"shape \(2, 2\)"),
        (
            lambda: held(margins(ONE, Loop(inertia_ratio=2.0)), M_hat=1.0, within=0.1),
            ValueError,
            "expected 1, as the set says",
        ),
        (lambda: margins(ONE, Loop(-1.0, 1.0)), ValueError, "kp"),
        (lambda: margins(ONE, Loop(1.0, float("inf"))), ValueError, "kd"),
        (lambda: largest_bandwidth(first, low=2.0, high=1.0), ValueError, "low < high"),
        (lambda: largest_bandwidth(first, modulus_margin=1.0), ValueError, "modulus_margin"),
        (
            lambda: largest_bandwidth(ONE, Loop(kp=1.0)),
            TypeError,
            "make: expected a callable.*got PhyFilter; write",
        ),
        (
            lambda: margins(ONE, Loop(actuator=ct.tf(1, [1e-14, 2e-14, 1]), delay=10.0)).stable_ratios,
            ValueError,
            "too often to search",
        ),
    ],
)
def test_bad_input(call: Callable[[], object], error: type[Exception], words: str):
    with pytest.raises(error, match=words):
        call()


def test_actuator_forms_agree():
    as_tf = margins(repeated(2), Loop(actuator=SECOND, delay=0.01))
    as_ss = margins(repeated(2), Loop(actuator=ct.tf2ss(SECOND), delay=0.01))
    assert as_tf.max_ratio == pytest.approx(as_ss.max_ratio, rel=CLOSE)
    static = margins(PhyFilter([20.0]), Loop(actuator=ct.tf([2.0], [1.0]), delay=0.01))
    assert static.max_ratio == pytest.approx(np.pi / 0.8, rel=CLOSE)


def test_roots_of_keeps_zeros_exact():
    gain, roots = roots_of(np.array([0.0, 0.0, 6.0, 3.0, 0.0]))
    assert gain == 3.0
    np.testing.assert_allclose(sorted(roots.real), [-2.0, 0.0, 0.0])
    assert np.count_nonzero(roots) == 1
    assert roots_of(np.zeros(3))[0] == 0.0


def test_block_matrix_of_the_tests_is_right():
    """The reference itself: the wired-up loop simulates as the equations say (n = 1, ideal actuator)."""
    A = wired(PhyFilter([5.0]), np.array([[2.0]]), np.eye(1), IDEAL, 0.0, 0.0)
    # z = w - B M_hat x with w = f_hat: x' = -f_hat, f_hat' = 5 ((2 - 1) x' - f_hat) = -10 f_hat.
    state = expm(0.1 * A) @ np.array([1.0 - 10.0 * 0.3, 0.3, 0.0])
    f_hat = state[0] + 10.0 * state[1]
    assert f_hat == pytest.approx(np.exp(-1.0), rel=1e-12)


def test_counting_poles_has_an_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """A delay that turns the loop a hundred thousand times is refused after a bounded number of evaluations."""
    looked_at = 0
    bounds = Factors.bounds

    def counted(self: Factors, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        nonlocal looked_at
        looked_at += len(low) * len(self.poles)
        return bounds(self, low, high)

    monkeypatch.setattr(Factors, "bounds", counted)
    with pytest.raises(ValueError, match="shorten the delay"):
        _ = margins(repeated(7, 99990.0, full=True), Loop(delay=10.0)).is_stable
    # The pieces of the last halving are counted before they are refused, no more than twice the rest.
    assert looked_at <= 3 * _winding._MOST_WORK
