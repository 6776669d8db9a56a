"""Other coefficients while the filter runs: rest stays rest for every change, f_hat never jumps, the error is small."""

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_continuous_lyapunov

from phyfilter_ctl import PhyFilter, _sections, stack

H = 0.002
# Up to order 6 the least-squares level weighs the states by numbers of both signs, whose sizes add up to as much as 99
# times their sum (six equal poles); so many times the rounding of a state shows in the level.
WEIGHTS = 100
LEVELS = np.array([5.0, -0.25])  # exact in float32 too


@st.composite
def filters(draw, dc=True, frequencies=(2.0, 9.0, 20.0, 20.5, 200.0), damping=0.05):
    """Orders 1 to 6, also of repeated poles, frequencies of 1 to 100, any zeros; F(0) = 1 if dc."""
    poles = []
    for _ in range(draw(st.integers(1, 4))):
        omega, zeta = draw(st.sampled_from(frequencies)), draw(st.floats(damping, 1.2))
        pair = omega * (-zeta + 1j * np.sqrt(complex(1.0 - zeta**2)))
        poles += [-omega] if pair.imag == 0.0 else [pair, pair.conjugate()]
    assume(len(poles) <= 6)
    filter = PhyFilter.from_poles(poles)
    if draw(st.booleans()) and dc:
        return filter
    share = np.array([draw(st.floats(-1.0, 2.0)) for _ in poles])
    share[0] = 1.0 if dc else draw(st.sampled_from([0.0, 1e-9, -0.5, 1.7]))
    return PhyFilter(filter.a, share * filter.a, poles=filter.poles)


@st.composite
def sampled_filters(draw):
    filter, dt = draw(filters()), draw(st.sampled_from([0.001, 0.002, 0.015]))
    method = draw(st.sampled_from(["exact", "tustin", "euler"]))
    if method == "euler" and np.any(np.abs(1.0 + filter.poles * dt) >= 1.0):
        method = "exact"
    return filter.sampled(dt, method, precision=draw(st.sampled_from(["float64", "float32"])))


def advance(sampled, state, u):
    """The state after the residuals u (N, channels), and all f_hat; x = 0 and g = -u, so that u is exact."""
    zero, found = np.zeros(u.shape[1]), []
    for row in u:
        state, f_hat = sampled.step(state, zero, -row, zero)
        found.append(f_hat)
    return state, np.array(found, dtype=float)


BUTTERWORTH = PhyFilter([400.0, 800.0**0.5])


@settings(max_examples=60, deadline=None)
@given(sampled_filters(), sampled_filters())
@example(PhyFilter([400.0, 40.0]).sampled(H), BUTTERWORTH.sampled(H))
@example(
    PhyFilter.from_poles([-20.0] * 3).sampled(H), PhyFilter.from_poles([-4 + 19.6j, -4 - 19.6j]).sampled(H)
)
def test_rest_stays_rest(old, new):
    """For every change of poles, zeros, order, step, method and precision, hundreds of samples long."""
    state, _ = advance(old, old.start(np.zeros(2), f_hat0=LEVELS), np.tile(LEVELS, (3, 1)))
    _, f_hat = advance(new, old.retune(state, new), np.tile(LEVELS, (200, 1)))
    rounding = 0.0
    for sampled in (old, new):
        terms = max(1.0, sum(float(np.sum(np.abs(C * rest))) for _, rest, C in sampled.recursion.transitions))
        rounding = max(rounding, terms * float(np.finfo(sampled.sampling.precision).eps))
    np.testing.assert_allclose(f_hat / LEVELS, 1.0, rtol=0.0, atol=WEIGHTS * rounding)


@settings(max_examples=60, deadline=None)
@given(filters(dc=False), filters(dc=False))
@example(PhyFilter([400.0, 40.0]), PhyFilter([400.0, 40.0], [0.0, 40.0]))
@example(PhyFilter([400.0, 40.0], [0.0, 40.0]), PhyFilter([400.0, 40.0]))
def test_another_gain_at_rest_is_approached(old, new):
    """f_hat stays at the instant of the change, is never farther from its new value again, and reaches it."""
    assume(np.max(np.abs(new.b / new.a)) > 1e-3)  # some output to keep
    one, other = old.sampled(H), new.sampled(H)
    state = one.start([0.0])._replace(w=old.sections[1][None])  # at rest on the residual 1
    state = one.retune(state, other)
    C = other.transition[2]
    rounding = WEIGHTS * np.finfo(float).eps * float(np.abs(C).sum() + np.abs(old.sections[2]).sum())
    assert abs(float(C @ state.w[0]) - old.dc_gain) <= rounding
    _, f_hat = advance(other, state, np.ones((100, 1)))
    assert np.all(np.abs(f_hat - new.dc_gain) <= abs(old.dc_gain - new.dc_gain) + rounding)
    settled = new.sampled(60.0 / float(np.min(-new.poles.real))).step(state, [0.0], [-1.0], [0.0])[1]
    assert abs(float(settled[0]) - new.dc_gain) <= rounding


def test_without_a_numerator_there_is_no_output_to_keep():
    nothing, some = PhyFilter([20.0], [0.0]).sampled(H), PhyFilter([20.0]).sampled(H)
    state = some.start([0.0], f_hat0=[2.0])
    away = some.retune(state, nothing)
    np.testing.assert_allclose(away.w, state.w, rtol=1e-15)
    np.testing.assert_allclose(nothing.retune(away, some).w, 0.0, atol=1e-15)


@settings(max_examples=60, deadline=None)
@given(filters(), filters(), st.floats(0.0, 1e-2))
def test_covariances_solve_lyapunovs_equation(one, other, noise):
    """The blocks of the covariance of both chains together, by scipy, which knows no sections."""
    (A, e, _), (B, f, _) = one.sections, other.sections
    n = len(e)
    both = np.zeros((n + len(f), n + len(f)))
    both[:n, :n], both[n:, n:] = A, B
    level = np.concatenate([e, f])
    forcing = np.outer(level, level) + noise * np.outer(both @ level, both @ level)
    expected = solve_continuous_lyapunov(both, -forcing)
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    for i, (poles, rows) in enumerate(((one.poles, slice(0, n)), (other.poles, slice(n, None)))):
        for j, (others, columns) in enumerate(((one.poles, slice(0, n)), (other.poles, slice(n, None)))):
            ours = _sections.covariance(poles, others, noise)
            # Lyapunov's equation by Schur vectors loses the ratio of the poles, 100, for each of up to 6 poles' chains.
            np.testing.assert_allclose(
                ours / size[rows, columns], (expected / size)[rows, columns], atol=1e-8, err_msg=f"{i}{j}"
            )


MOVING = {
    "the same poles": PhyFilter([400.0, 40.0]),
    "Butterworth": BUTTERWORTH,
    "little damping": PhyFilter([400.0, 8.0]),
    "third order": PhyFilter.from_poles([-20.0] * 3),
    "fourth order, faster": PhyFilter.from_poles(30.0 * np.exp(1j * np.pi * np.array([5, 7, 9, 11]) / 8)),
    "slower": PhyFilter.from_poles([-5.0, -5.0]),
    "first order": PhyFilter([20.0]),
}


@pytest.mark.parametrize("name", MOVING)
def test_a_moving_residual(name):
    """RMS error after the change, against the better of the states kept and a restart at rest on the output.

    benchmarks/retune.py has the distribution over hundreds of changes.
    """
    old, new = PhyFilter([400.0, 40.0]).sampled(H), MOVING[name].sampled(H)
    t = H * np.arange(1200)[:, None] + np.linspace(0.0, 3.0, 16)
    u = np.sin(4.0 * t) + 0.3 * np.sin(12.0 * t + 1.0)
    state, f_hat = advance(old, old.start(np.zeros(16), f_hat0=u[0]), u[:600])
    ways = {"retune": old.retune(state, new), "rest": new.start(np.zeros(16), f_hat0=f_hat[-1])}
    if old.order == new.order:
        _, equilibrium, C = new.transition
        ways["kept"] = state._replace(w=state.w + np.outer(f_hat[-1] - state.w @ C, equilibrium))
    errors = {way: np.sqrt(np.mean((advance(new, s, u[600:])[1] - u[600:]) ** 2)) for way, s in ways.items()}
    assert errors.pop("retune") <= 1.02 * min(errors.values())


SLOW = 0.0125
# Sums over samples are not integrals over time: of poles at up to half a sample.
AS_SUMS = 0.02


def restlessness(old, new, way):
    """How far f_hat is from the new filter's that ran all the time: mean square over residuals, summed over time.

    A random walk is steps at all times before the change, and white noise on it impulses: their squares add up.
    """
    slowest = float(min(np.abs(filter.poles.real).min() for filter in (old.filter, new.filter)))
    N = int(6.0 / (slowest * SLOW))
    since = np.tri(N)  # one column for each time of the step
    state, f_hat = advance(old, old.start(np.zeros(N), f_hat0=np.zeros(N)), since)
    ever, _ = advance(new, new.start(np.zeros(N), f_hat0=np.zeros(N)), since)
    steps = np.subtract(*(advance(new, begun, np.ones((N, N)))[1] for begun in (way(state, f_hat[-1]), ever)))
    impulses = np.diff(steps, axis=1) / SLOW / np.abs(new.filter.poles).min()
    return float(np.sum(steps**2) + np.sum(impulses**2))


@settings(max_examples=15, deadline=None)
@given(*[filters(frequencies=(5.0, 9.0, 20.0, 20.5, 40.0), damping=0.4) for _ in range(2)])
@example(PhyFilter.from_poles([-20.0] * 2), PhyFilter.from_poles([-20.0] * 3))
@example(BUTTERWORTH, PhyFilter.from_poles([-20.0] * 3))
def test_another_order_is_at_least_as_calm_as_a_start_at_rest(old, new):
    assume(old.order != new.order)
    old, new = old.sampled(SLOW), new.sampled(SLOW)
    retuned = restlessness(old, new, lambda state, _: old.retune(state, new))
    rest = restlessness(old, new, lambda state, f_hat: new.start(state.x, f_hat0=f_hat, g0=state.g))
    assert retuned <= (1.0 + AS_SUMS) * rest


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_filters_of_channels(precision):
    """Each channel as by itself, whatever the orders before and after; from a shared filter too."""
    rng = np.random.default_rng(1)
    general = PhyFilter([1780.0, 289.0, 30.0], [1780.0, 200.0, 12.0])
    before = [PhyFilter([3.0]), PhyFilter([400.0, 40.0]), general]
    after = [BUTTERWORTH, general, PhyFilter([20.0])]
    u = np.cumsum(rng.standard_normal((90, 3)), axis=0)
    for first, second in ((before, after), ([BUTTERWORTH] * 3, after), (before, [BUTTERWORTH] * 3)):
        old, new = (
            stack([entry.sampled(H, precision=precision) for entry in filters])
            if len(set(filters)) > 1
            else filters[0].sampled(H, precision=precision)
            for filters in (first, second)
        )
        state, _ = advance(old, old.start(np.zeros(3)), u[:60])
        _, f_hat = advance(new, old.retune(state, new), u[60:])
        for i, pair in enumerate(zip(first, second, strict=True)):
            one, other = (entry.sampled(H, precision=precision) for entry in pair)
            state, _ = advance(one, one.start([0.0]), u[:60, [i]])
            _, alone = advance(other, one.retune(state, other), u[60:, [i]])
            rounding = WEIGHTS * float(np.finfo(precision).eps) * np.abs(alone).max()
            np.testing.assert_allclose(f_hat[:, [i]], alone, rtol=0.0, atol=rounding)


def test_the_state_of_another_filter_is_refused():
    second, third = PhyFilter([400.0, 40.0]).sampled(H), PhyFilter.from_poles([-20.0] * 3).sampled(H)
    single = second.filter.sampled(H, precision="float32")
    two = stack([second, third])
    state = second.start(np.zeros(3))
    for other, message in (
        (third, "of order 2 with 3 channels of f in float64, given to one of order 3"),
        (two, "2 filters for 3 channels"),
        (single, "given to one of order 2 with 3 in float32"),
        (second.filter.sampled(H, E=np.eye(3)[:, :2]), "given to one of order 2 with 2"),
    ):
        with pytest.raises(ValueError, match=message):
            other.step(state, np.zeros(3))
        with pytest.raises(ValueError, match=message):
            other.retune(state, third)


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_nothing_changes_for_the_same_filter(precision):
    """In float32 with the compensation words: their digits are the state's too, and double has none."""
    sampled = PhyFilter([400.0, 40.0]).sampled(0.002, precision=precision)
    state = sampled.start([0.0])
    for k in range(1, 200):
        state, _ = sampled.step(state, [0.3 * np.sin(0.05 * k)])
    after = sampled.retune(state, sampled)
    if precision == "float64":
        assert state.carry is None
        assert after.carry is None
        np.testing.assert_allclose(after.w, state.w, rtol=1e-13)
        return
    assert np.any(state.carry != 0.0)
    exact, kept = (np.float64(each.w) + np.float64(each.carry) for each in (state, after))
    np.testing.assert_allclose(kept, exact, rtol=1e-12)  # beyond float32's own 6e-8
