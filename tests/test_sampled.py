"""SampledPhyFilter: exactness, order of accuracy, digits at slow poles and in float32, refusals."""

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phyfilter_ctl import PhyFilter, SampledPhyFilter, stack
from phyfilter_ctl.filter import PaperFilter
from tests.cpu_budget import slow_but

# What is promised for every pole with |p| h >= 1e-3 ...
EXACT = 1e-10
# ... and what the delta form keeps at any pole: some tens of eps.
EXACT_ANYWHERE = 2e-14
# Observed order of the error under halving; 2 up to the next term of the expansion.
SECOND_ORDER = 1.9


def exact_solution(filter: PhyFilter, h: float, u):
    """f_hat - f_theta of the continuous filter for inputs constant over each step: companion form in 50 digits,
    carried along in long double. Shares nothing with the chain of sections."""
    n = filter.order
    with mpmath.workdps(50):
        generator = mpmath.zeros(n + 1)
        for i in range(n - 1):
            generator[i, i + 1] = 1
        product = [mpmath.mpc(1)]  # D in full precision from the poles
        for pole in filter.poles:
            shifted = [mpmath.mpc(0), *product]
            scaled = [-mpmath.mpc(pole) * c for c in product] + [mpmath.mpc(0)]
            product = [s + t for s, t in zip(scaled, shifted, strict=True)]
        for j in range(n):
            generator[n - 1, j] = -product[j].real
        generator[n - 1, n] = 1
        step = mpmath.expm(generator * mpmath.mpf(h))
        gain = (
            [product[0].real] + [0] * (n - 1)
            if filter.is_lowpass
            else [mpmath.mpf(float(c)) for c in filter.b]
        )
        Ad = np.array([[np.longdouble(mpmath.nstr(step[i, j], 25)) for j in range(n)] for i in range(n)])
        Bd = np.array([np.longdouble(mpmath.nstr(step[i, n], 25)) for i in range(n)])
        C = np.array([np.longdouble(mpmath.nstr(mpmath.mpf(c), 25)) for c in gain])
    w = np.zeros((n, u.shape[1]), dtype=np.longdouble)
    y = np.zeros((len(u) + 1, u.shape[1]), dtype=np.longdouble)
    for k in range(len(u)):
        w = Ad @ w + Bd[:, None] * u[k]
        y[k + 1] = C @ w
    return y


def held_signals(h, N=1500, seed=3):
    """x linear between samples, g and f_theta constant between them; u is their measured residual."""
    rng = np.random.default_rng(seed)
    u = (2.0 + rng.standard_normal((N, 2))).astype(np.longdouble)
    g, f_theta = rng.standard_normal((2, N + 1, 2))
    x = np.zeros((N + 1, 2), dtype=np.longdouble)
    x[1:] = np.cumsum((u + g[:-1] + f_theta[:-1]) * h, axis=0)
    x = x.astype(float)
    u = np.diff(x.astype(np.longdouble), axis=0) / np.longdouble(h) - g[:-1] - f_theta[:-1]
    return x, g, f_theta, u


def slow_filters(slow):
    w = slow
    pair = [w * complex(-0.6, 0.8), w * complex(-0.6, -0.8)]
    return {
        "one": PhyFilter.from_poles([-w]),
        "four equal": PhyFilter.from_poles([-w] * 4),
        "pair and fast": PhyFilter.from_poles([*pair, -50.0 * w, -7.0 * w]),
        "general": PhyFilter.from_poles([*pair, -2.0 * w], [w**3, 2.0 * w**2, 0.5 * w]),
    }


@pytest.mark.parametrize("slow", [1e-3, 1e-2, 0.3])
@pytest.mark.parametrize("kind", ["one", "four equal", "pair and fast", "general"])
def test_exact_between_samples(slow, kind):
    h = 0.002
    filter = slow_filters(slow / h)[kind]
    x, g, f_theta, u = held_signals(h)
    expected = f_theta + exact_solution(filter, h, u)
    sampled = filter.sampled(h, f_theta="hold")
    run = sampled.run(x, g, f_theta)
    scale = float(np.abs(expected).max())
    assert np.abs(run - expected).max() < EXACT * scale
    state = sampled.start(x[0], f_theta0=f_theta[0])
    for k in range(1, len(x)):
        state, f_hat = sampled.step(state, x[k], g[k - 1], f_theta[k])
        assert np.abs(f_hat - expected[k]).max() < EXACT * scale
    stretched = (
        np.arange(len(x)) * h * (1 + 1e-12)
    )  # not the nominal grid to the last digit: the banded route
    assert np.abs(sampled.run(x, g, f_theta, times=stretched) - expected).max() < EXACT * scale


@pytest.mark.parametrize("slow", slow_but([1e-6], [1e-6, 1e-5, 1e-4]))
@pytest.mark.parametrize("kind", ["one", "four equal", "pair and fast"])
def test_slow_poles_keep_their_digits(slow, kind):
    # x' = u exactly representable, so that the comparison is about the filter and not about differences of x.
    h = 0.001953125
    filter = slow_filters(slow / h)[kind]
    N = 10_000
    x = np.arange(N + 1)[:, None] * (h * np.array([1.0, 3.0]))
    expected = exact_solution(filter, h, np.tile(np.array([[1.0, 3.0]], dtype=np.longdouble), (N, 1)))
    scale = 3.0  # the residual that f_hat is on its way to
    sampled = filter.sampled(h)
    assert np.abs(sampled.run(x) - expected).max() < EXACT_ANYWHERE * scale
    times = np.arange(N + 1) * h
    times[1:] += 1e-13
    irregular = sampled.run(x, times=times)
    assert np.abs(irregular - expected).max() < 1e-9 * scale  # the first step is longer by 5e-11 of itself
    state = sampled.start(x[0])
    for k in range(1, N + 1):
        state, f_hat = sampled.step(state, x[k])
    assert np.abs(f_hat - expected[-1]).max() < EXACT_ANYWHERE * scale


def smooth_problem(t):
    """M(t) x' = g + f with everything smooth: x = sin 2t, M = 2 + sin t, g = cos 3t."""
    x, dx = np.sin(2 * t), 2 * np.cos(2 * t)
    inertia, g = 2 + np.sin(t), np.cos(3 * t)
    f_theta = 0.3 * np.sin(5 * t)
    return x, g, f_theta, inertia, inertia * dx - g


@pytest.mark.parametrize("method", ["exact", "tustin"])
@pytest.mark.parametrize("irregular", [False, True])
def test_second_order_for_smooth_signals(method, irregular):
    filter = PhyFilter.from_poles([-3 + 4j, -3 - 4j, -6.0])

    def solve(N):
        t = np.linspace(0.0, 2.0, N + 1)
        if irregular:
            t = t + 0.2 / N * np.sin(7 * t) * np.sin(np.pi * t / 2)
        x, g, f_theta, inertia, _ = smooth_problem(t)
        sampled = filter.sampled(2.0 / N, method, g="average")
        return sampled.run(x[:, None], g[:, None], f_theta[:, None], inertia[:, None], t)[-1, 0]

    reference = solve(2**14)
    errors = np.abs([solve(N) - reference for N in (64, 128, 256, 512)])
    assert np.all(np.log2(errors[:-1] / errors[1:]) > SECOND_ORDER), errors


def test_the_wrong_hold_costs_what_the_right_one_saves():
    """A smooth g taken as held: first order only. The option is worth having."""
    filter = PhyFilter.from_poles([-20.0, -20.0])
    h = 0.018
    t = np.arange(400) * h
    x, g, f_theta, _, _ = smooth_problem(t)
    fine = np.arange(400 * 64) * (h / 64)
    xf, gf, ff, _, _ = smooth_problem(fine)
    exact = filter.sampled(h / 64, g="average").run(xf[:, None], gf[:, None], ff[:, None])[::64, 0]
    error = {
        rule: np.abs(
            filter.sampled(h, g=rule).run(x[:, None], g[:, None], f_theta[:, None])[:, 0] - exact
        ).max()
        for rule in ("hold", "average")
    }
    assert error["average"] < 0.1 * error["hold"]


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.floats(0.5, 100.0), min_size=1, max_size=4),
    st.integers(1, 300),
    st.sampled_from([0.0, 0.004, 0.0073]),
    st.integers(0, 2**32 - 1),
)
def test_any_partition_of_the_time_gives_the_same_estimate_of_a_line(speeds, N, delay, seed):
    """x linear, g and f_theta constant: the exact filter does not care where the samples lie."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(1e-4, 0.02, N + 1))
    filter = PhyFilter.from_poles([-w for w in speeds])
    slope, g, f_theta = rng.standard_normal(3)
    x = slope * (times - times[0])
    sampled = filter.sampled(0.002, delay=delay)
    ours = sampled.run(x[:, None], np.full((N + 1, 1), g), np.full((N + 1, 1), f_theta), times=times)[:, 0]
    whole = filter.sampled(times[-1] - times[0]).run(x[[0, -1], None], [[g], [g]], [[f_theta], [f_theta]])[
        -1, 0
    ]
    assert ours[-1] == pytest.approx(whole, rel=1e-10, abs=1e-11)


@pytest.mark.parametrize("order", slow_but([2], [1, 2, 3, 4]))
@pytest.mark.parametrize("pole", slow_but((0.5,), (0.5, 20.0, 100.0)))
def test_float32_keeps_its_digits(order, pole):
    """The short twin of benchmarks/float32_drift.py: 20,000 steps against long double, paper's form beside it."""
    h, N = 0.002, 20_000
    rng = np.random.default_rng(order)
    noise = np.float32(5.0 + 0.5 * rng.standard_normal((N, 1)))
    constant = np.full((N, 1), np.float32(5.0))
    g = -np.hstack([constant, noise])  # x stays 0: the residual is -g, in float32 exactly
    sampled = PhyFilter.from_poles([-pole] * order).sampled(h, precision="float32")
    dA, equilibrium, C = (part.astype(np.longdouble) for part in sampled.recursion.transitions[0])
    state = sampled.start([0.0, 0.0])
    w = np.zeros((2, order), dtype=np.longdouble)
    worst = top = 0.0
    for k in range(N):
        state, f_hat = sampled.step(state, [0.0, 0.0], g[k])
        w = w + (w + g[k][:, None] * equilibrium) @ dA.T
        y = w @ C
        worst, top = max(worst, float(np.abs(f_hat - y).max())), max(top, float(np.abs(y).max()))
    assert f_hat.dtype == np.float32
    assert worst < 1e-6 * max(1.0, top / 8)
    if order >= 3 and pole == 20.0:
        paper = PaperFilter(sampled.filter, h, precision="float32")
        lost = paper.run(np.zeros((N, 2), np.float32), g)
        euler = sampled.filter.sampled(h, "euler", f_theta="hold").run(np.zeros((N, 2)), g)
        assert np.abs(lost - euler).max() > 1e-3


def test_float32_record_is_the_float32_loop():
    rng = np.random.default_rng(5)
    x = np.cumsum(0.01 * rng.standard_normal((3000, 3)), axis=0)
    sampled = PhyFilter.from_poles([-20.0] * 3).sampled(0.002, precision="float32")
    record = sampled.run(x)
    state = sampled.start(x[0])
    for k in range(1, len(x)):
        state, f_hat = sampled.step(state, x[k])
        assert np.abs(f_hat - record[k]).max() < 2e-6 * max(1.0, np.abs(record).max())


def test_the_estimate_has_no_bump_at_the_start():
    sampled = PhyFilter.from_poles([-20.0] * 3).sampled(0.002)
    f_hat = sampled.run(np.full((100, 1), 7.0))
    np.testing.assert_array_equal(f_hat, 0.0)


def test_memory_of_a_long_record_is_bounded():
    """The arrays of a run besides its result do not grow with the record."""
    import tracemalloc

    sampled = PhyFilter.from_poles([-20.0] * 4).sampled(0.002)

    def peak(N):
        x = np.zeros((N, 3))
        sampled.run(x[:100])
        tracemalloc.start()
        sampled.run(x)
        top = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return top - x.nbytes  # the result is as large as x

    assert peak(400_000) < peak(40_000) + 2**20


def test_step_does_not_change_what_it_is_given():
    sampled = PhyFilter([400.0, 40.0]).sampled(0.002)
    state = sampled.start([0.0, 1.0])
    x, g = np.array([0.1, 1.1]), np.array([1.0, 2.0])
    before = [np.copy(part) for part in (state.w, state.x, x, g)]
    sampled.step(state, x, g, None)
    for now, then in zip((state.w, state.x, x, g), before, strict=True):
        np.testing.assert_array_equal(now, then)


def test_inertia_forms_agree():
    rng = np.random.default_rng(0)
    x = np.cumsum(rng.standard_normal((50, 3)), axis=0)
    sampled = PhyFilter([20.0]).sampled(0.01)
    reference = sampled.run(x, inertia=2.0)
    for inertia in ([2.0] * 3, 2 * np.eye(3), np.full((50, 3), 2.0), np.tile(2 * np.eye(3), (50, 1, 1))):
        np.testing.assert_allclose(sampled.run(x, inertia=inertia), reference, rtol=1e-13, atol=1e-13)


# -- refusals: a clear error, and nothing changed ----------------------------------------------------------------------

PLAIN = PhyFilter([400.0, 40.0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dt": 0.0}, "dt: expected"),
        ({"dt": -1.0}, "dt: expected"),
        ({"dt": np.nan}, "dt: expected"),
        ({"method": "rk4"}, "method: expected one of exact, matched, euler, tustin"),
        ({"g": "linear"}, "g: expected one of hold, average"),
        ({"precision": "float16"}, "precision"),
        ({"nonfinite": "skip"}, "nonfinite"),
        ({"delay": -0.1}, "delay"),
        ({"limit": 0.0}, "limit"),
        ({"limit": [1.0, -1.0]}, "limit"),
        ({"E": [[1.0, 2.0], [2.0, 4.0]]}, "rank 1 for 2 columns"),
        ({"E": [1.0]}, "E: expected"),
        ({"E": [[np.nan]]}, "E: expected finite"),
        ({"method": "euler", "dt": 0.1}, "Euler diverges.*pole -20.*expected h < 0.1 s"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        PLAIN.sampled(**{"dt": 0.002, **options})


def test_euler_names_the_case_of_the_theory():
    # Butterworth of order 4 at 50 rad/s and 18 ms diverges.
    poles = 50.0 * np.exp(1j * np.pi * np.array([5, 7, 9, 11]) / 8)
    with pytest.raises(ValueError, match="method='exact'"):
        PhyFilter.from_poles(poles).sampled(0.018, "euler")
    sampled = PhyFilter.from_poles([-700.0]).sampled(0.002, "euler")  # 1 - 700 h: -0.4, and -1.8 of two steps
    with pytest.raises(ValueError, match="Euler diverges"):
        sampled.run(np.zeros((3, 1)), times=[0.0, 0.002, 0.006])
    with pytest.raises(ValueError, match="Euler diverges"):
        sampled.step(sampled.start([0.0]), [0.0], dt=0.004)


X = np.zeros((5, 2))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"x": np.zeros((0, 2))}, "non-empty"),
        ({"x": np.zeros((2, 2, 2))}, "samples first"),
        ({"x": X, "g": np.zeros((4, 2))}, r"g: expected shape \(5, 2\)"),
        ({"x": X, "f_theta": np.zeros((5, 3))}, r"f_theta: expected shape \(5, 2\)"),
        ({"x": np.where(np.arange(10).reshape(5, 2) == 6, np.nan, 0.0)}, "x: .*got nan in row 3, column 0"),
        ({"x": X, "f_theta": np.full((5, 2), np.inf)}, "f_theta: .*got inf in row 0, column 0; 10 such"),
        (
            {"x": X, "g": np.where(np.arange(10).reshape(5, 2) == 6, np.nan, 0.0)},
            "g: .*got nan in row 3, column 0",
        ),
        (
            {"x": np.where(np.arange(10).reshape(5, 2) == 8, -1e200, 0.0), "g": np.full((5, 2), 1e308)},
            r"g: expected finite numbers up to 1e\+150, got .* in row 0",
        ),
        ({"x": X, "times": [0.0, 1e-310, 1.0, 2.0, 3.0]}, "row 1 .*stands still"),
        ({"x": X, "times": [0.0, 1.0, 2.0, 3.0, 1e308]}, "times: .* in row 4"),
        ({"x": X, "inertia": np.full(2, np.nan)}, "inertia: expected finite numbers"),
        ({"x": X, "inertia": np.zeros(3)}, "inertia: expected a number or shape"),
        ({"x": np.zeros((2, 2)), "inertia": np.eye(2)}, "ambiguous where N == n_x"),
        ({"x": X, "times": [0, 1, 1, 2, 3]}, "row 2 .*stands still"),
        ({"x": X, "times": [0, 1, 2, 1.5, 3]}, "row 3 .*runs back"),
        ({"x": X, "times": [0, 1, np.nan, 3, 4]}, "times: .*got nan in row 2"),
        ({"x": X, "times": [0, 1]}, r"times: expected shape \(5,\)"),
    ],
)
def test_bad_records_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        PLAIN.sampled(0.002).run(**arguments)


def test_bad_steps_are_refused_and_leave_the_state():
    sampled = PLAIN.sampled(0.002)
    state = sampled.start([0.0, 0.0])
    kept = (state.w.copy(), state.x.copy())
    for arguments, message in (
        (([0.0],), "x, g, f_theta: expected shapes"),
        (([0.0, np.nan],), "finite.*state is unchanged"),
        (([0.0, 0.0], [0.0, np.inf]), "finite"),
        (([0.0, -1e308],), "expected finite numbers up to 1e\\+150"),
        (([0.0, 0.0], None, [0.0]), "f_theta: expected shapes"),
    ):
        with pytest.raises(ValueError, match=message):
            sampled.step(state, *arguments)
    for dt in (0.0, -0.1, np.nan):
        with pytest.raises(ValueError, match="dt: expected"):
            sampled.step(state, [0.0, 0.0], dt=dt)
    with pytest.raises(ValueError, match="inertia: expected"):
        sampled.step(state, [0.0, 0.0], inertia=np.zeros(3))
    with pytest.raises(ValueError, match="finite"):
        sampled.step(state, [0.0, 0.0], inertia=[np.nan, 1.0])
    with pytest.raises(ValueError, match="dx: expected finite"):
        sampled.shift_x(state, [np.nan, 0.0])
    np.testing.assert_array_equal(state.w, kept[0])
    np.testing.assert_array_equal(state.x, kept[1])


def test_bad_starts_are_refused():
    bandpass = PhyFilter([400.0, 40.0], [0.0, 40.0]).sampled(0.002)
    with pytest.raises(ValueError, match=r"F\(0\) = 0"):
        bandpass.start([0.0], f_hat0=[1.0])
    with pytest.raises(ValueError, match="x0: expected finite"):
        bandpass.start([np.nan])
    with pytest.raises(ValueError, match="x0: expected shape"):
        bandpass.start(0.0)
    with pytest.raises(ValueError, match="f_theta0: expected shape"):
        bandpass.start([0.0], f_theta0=[1.0, 2.0])


def test_channels_must_fit():
    two = stack([PLAIN.sampled(0.002), PhyFilter([3.0]).sampled(0.002)])
    with pytest.raises(ValueError, match="2 filters for 3 channels"):
        two.run(np.zeros((4, 3)))
    with pytest.raises(ValueError, match="2 filters for 3 channels"):
        two.start(np.zeros(3))
    with pytest.raises(ValueError, match="its own filter"):
        _ = two.filter
    with pytest.raises(ValueError, match="E has 3 rows"):
        PLAIN.sampled(0.002, E=np.eye(3)[:, :2]).run(np.zeros((4, 2)))
    with pytest.raises(ValueError, match="2 bounds for 3 channels"):
        PLAIN.sampled(0.002, limit=[1.0, 2.0]).run(np.zeros((4, 3)))
    with pytest.raises(ValueError, match="channel 1 has dt"):
        stack([PLAIN.sampled(0.002), PLAIN.sampled(0.001)])
    with pytest.raises(ValueError, match="at least one"):
        stack([])
    with pytest.raises(TypeError, match=r"channel 1 is PhyFilter\(.*sample all, F.sampled\(dt\), or none"):
        stack([PLAIN.sampled(0.002), PLAIN])  # type: ignore[list-item]  # wrong on purpose
    with pytest.raises(TypeError, match=r"channel 0 is 1.0, expected a PhyFilter"):
        stack([1.0, PLAIN])  # type: ignore[list-item]  # wrong on purpose
    with pytest.raises(TypeError, match="PhyFilter"):
        SampledPhyFilter([1.0], 0.1)  # type: ignore[list-item]  # wrong on purpose
    one = PLAIN.sampled(0.002)
    with pytest.raises(ValueError, match="retune: the new filter has 2 channels"):
        one.retune(one.start(np.zeros(3)), PLAIN.sampled(0.002, E=np.eye(3)[:, :2]))


def test_the_papers_realisation_refuses_what_it_has_not():
    with pytest.raises(ValueError, match="Euler diverges"):
        PaperFilter(PLAIN, 0.2)
    with pytest.raises(ValueError, match="finite"):
        PaperFilter(PLAIN, 0.002).run(np.full((4, 1), np.nan))


def test_equality_and_text():
    one = PLAIN.sampled(0.002, limit=2.0)
    assert one == PLAIN.sampled(0.002, limit=2.0)
    assert one != PLAIN.sampled(0.002, limit=3.0)
    assert one != PLAIN.sampled(0.002)
    assert hash(one) == hash(PLAIN.sampled(0.002, limit=2.0))
    assert repr(one) == "PhyFilter(a=[400.0, 40.0]).sampled(0.002, limit=2.0)"
    assert "SampledPhyFilter([" in repr(stack([one, one]))


def test_bounds_for_other_channels_are_refused_at_once():
    E = np.eye(3)[:, :2]
    two = PLAIN.sampled(0.002, E=E, limit=[1.0, 2.0])
    assert two.sampling.limit.tolist() == [1.0, 2.0]
    assert not two.sampling.limit.flags.writeable
    with pytest.raises(ValueError, match="limit: 3 bounds for 2 channels; expected one number or 2"):
        PLAIN.sampled(0.002, E=E, limit=[1.0, 2.0, 3.0])
