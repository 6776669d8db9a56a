"""What a filter meets as it runs: each term against closed forms, the course that attains it, and the filter itself."""

import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl import Bounded, Implementation, error_bound

# Rounding of a simulation of a few hundred steps.
ROUNDING = 1e-9
SHAPES = pf.place_poles([-9.0, -12 + 10j, -12 - 10j])


def answer(sampled, count=400):
    """h_i: what u = 1 at one step leaves, from ``run`` on a step of the residual."""
    return np.diff(sampled.run(sampled.dt * np.arange(count + 1.0))[:, 0])


@pytest.mark.parametrize(("h", "held", "straight"), [(0.01, 5.09, 1.004), (0.02, 9.58, 1.093)])
def test_a_g_that_moves_between_the_samples(h, held, straight):
    """Known g = 8 sin 6t, gamma = 0.5 sin 2t, one pole at 20 rad/s: beyond the ideal bound, within the whole one."""
    for rule, times in (("hold", held), ("average", straight)):
        sampled = pf.PhyFilter([20.0]).sampled(h, g=rule)
        t = h * np.arange(int(4.0 * np.pi / h))
        x = 0.25 * (1.0 - np.cos(2.0 * t)) + 8.0 / 6.0 * (1.0 - np.cos(6.0 * t))
        f_hat = sampled.run(x[:, None], 8.0 * np.sin(6.0 * t)[:, None])[:, 0]
        error = np.abs(0.5 * np.sin(2.0 * t) - f_hat)[len(t) // 2 :].max()
        ideal = error_bound(sampled, {1: 1.0})
        whole = error_bound(sampled, Bounded({1: 1.0}, implementation=Implementation(g={1: 48.0, 2: 288.0})))
        assert error / ideal.bound == pytest.approx(times, abs=0.005)
        assert error <= whole.bound
        # Sines of one frequency are not the worst; the straight rule's h^2 is small beside all of |gamma'|.
        assert whole.bound <= 1.19 * error


@pytest.mark.parametrize("rule", ["hold", "average"])
def test_the_worst_g_attains_its_term(rule):
    """Slopes g' in the sign of the impulse response (hold), of that times 1 - 2 s/h (average)."""
    sampled = SHAPES.sampled(0.02, g=rule)
    n, h = 300, sampled.dt
    signs = np.sign(answer(sampled, n)[::-1])
    rise = 7.0 * signs * (0.5 * h if rule == "average" else h)  # over the half step, or the whole
    if rule == "hold":
        before = np.concatenate([[0.0], np.cumsum(rise)])
        samples, area = before[:-1], h * (before[:-1] + 0.5 * rise)
    else:  # up and down again: at the samples nothing is seen of it
        samples, area = np.zeros(n), 0.5 * h * rise
    x = np.concatenate([[0.0], np.cumsum(area)])
    f_hat = sampled.run(x, np.append(samples, 0.0))[-1, 0]
    term = error_bound(sampled, Bounded({1: 0.0}, implementation=Implementation(g={1: 7.0}))).bound
    assert abs(f_hat) == pytest.approx(term, rel=1e-7)  # of the enclosure


def test_one_pole_in_closed_form():
    """Positive impulse response of sum 1, whose steps add up to 2 a, a = 1 - exp(-20 h)."""
    h, a = 0.01, 1.0 - np.exp(-0.2)
    sampled = pf.PhyFilter([20.0]).sampled(h, limit=4.0)
    given = Implementation(
        g={1: 6.0},
        f_theta={1: 8.0, 2: 30.0},
        inertia={1: 0.5},
        f=4.5,
        jitter=1e-4,
        delay_error=2e-3,
        x_step=0.01,
        g_step=0.2,
        x={2: 11.0},
    )
    found = error_bound(sampled, Bounded({1: 1.0}, noise=0.1, rate=3.0, implementation=given), inertia=2.0)
    of_x = 2.0 * a / h * 2.0 + 0.5  # |M_hat| = 2, and |M_hat'| of the change between the steps
    expected = {
        "g between samples": 0.5 * h * 6.0,
        "f_theta between samples": h * h / 12.0 * 30.0,
        "inertia between samples": h / np.pi * 0.5 * 3.0 + 0.5 * 0.1,
        "jitter": of_x * 1e-4 * 3.0 + (6.0 + 0.5 * 3.0 + 2.0 * 8.0) * 1e-4,
        "delay": 2.0 * 11.0 * 2e-3,
        "quantisation": of_x * 0.005 + 0.1,
        "limit": 0.5,
    }
    assert found.implementation == pytest.approx(expected, rel=1e-7)
    assert found.bound == pytest.approx(sum(found.parts.values()))


def test_an_inertia_that_turns_attains_its_share():
    """M_hat of two axes whose part without trace turns by pi in a step, x' on it: h/pi |M_hat'| |x'|, one pole."""
    h, size, speed = 0.02, 0.3, 5.0
    sampled = pf.PhyFilter([20.0]).sampled(h)
    nodes, weights = np.polynomial.legendre.leggauss(24)
    s = 0.5 * h * (nodes + 1.0)

    def turned(t):
        angle = np.pi * t / h
        c, d = np.cos(angle), np.sin(angle)
        return size * np.array([[c, d], [d, -c]])

    # Over each step x' = speed R(t) r with M_hat(t) - (mean of its ends, 0) along one direction of f.
    pull = np.stack([turned(t) @ np.array([1.0, 0.0]) for t in s])  # M symmetric: rows times x'
    x_step, missed = np.zeros(2), np.zeros(2)
    for weight, row, t in zip(weights, pull, s, strict=True):
        v = speed * row / size
        x_step += 0.5 * h * weight * v
        missed += 0.5 * weight * (turned(t) @ v)
    n = 200
    x, M = [np.zeros(2)], [2.0 * np.eye(2) + turned(0.0)]
    for k in range(n):
        sign = (-1.0) ** k  # so does M_hat
        x.append(x[-1] + sign * x_step)
        M.append(2.0 * np.eye(2) - sign * turned(0.0))
    # f_theta is what makes gamma = 0: mean of M_hat x' over the step, handed over as held.
    held = np.array(
        [
            sum(
                0.5 * w * ((2.0 * np.eye(2) + (-1.0) ** k * turned(t)) @ ((-1.0) ** k * speed * row / size))
                for w, row, t in zip(weights, pull, s, strict=True)
            )
            for k in range(n)
        ]
    )
    f_hat = sampled.run(np.array(x), np.vstack([held, held[-1:]]), inertia=np.array(M))
    rate = size * np.pi / h
    given = Implementation(inertia={1: rate})
    term = error_bound(sampled, Bounded({1: 0.0}, rate=speed, implementation=given)).implementation
    reached = np.linalg.norm(f_hat[-1])
    assert np.linalg.norm(missed) == pytest.approx(h / np.pi * rate * speed, rel=1e-9)
    assert reached == pytest.approx(term["inertia between samples"], rel=1e-6)


@pytest.mark.parametrize("sizes", [(1.0, 3.0, 0.0), (50.0, 5.0, 10.0)])
def test_float32_stays_within_its_rounding(sizes):
    """A step of f_hat in float32 against the same recursion, with the same coefficients, in double."""
    X, V, G = sizes
    rng = np.random.default_rng(4)
    for poles in ([-20.0], [-3.0, -8 + 30j, -8 - 30j], [-0.5, -1.0]):
        f = pf.place_poles(poles, type=len(poles))
        sampled, h = f.sampled(0.002, precision="float32", g="average"), 0.002
        n, lanes = 300, 40
        x = X - V * h * n / 2 + np.cumsum(V * h * rng.choice([-1.0, 1.0], (n, lanes)), axis=0)
        g = G * np.sin(np.linspace(0.0, 9.0, n))[:, None] * np.ones(lanes)
        state = sampled.start(x[0], g0=g[0])
        dA, e, C = sampled.transition
        w, worst = np.zeros((lanes, len(C))), 0.0
        for k in range(1, n):
            state, f_hat = sampled.step(state, x[k], g[k])
            u = (x[k] - x[k - 1]) / h - 0.5 * (g[k] + g[k - 1])
            w = w + (w - u[:, None] * e) @ dA.T
            worst = max(worst, float(np.abs(f_hat - w @ C).max()))
        given = Implementation(x={0: float(np.abs(x).max())}, g={0: G})
        term = error_bound(sampled, Bounded({1: 0.0}, rate=V, implementation=given)).implementation[
            "rounding"
        ]
        assert worst <= term
        if n * h * min(np.abs(poles)) > 5.0:  # some 1000 roundings, all of one sign; at random they cancel
            assert term <= 100.0 * worst


def test_a_limit_never_adds_to_the_error_where_f_is_within_it():
    f = pf.lowpass(2, 15.0, family="butterworth")
    t = 0.01 * np.arange(800)
    gamma = 3.0 * np.sin(2.0 * t) * np.sign(np.sin(0.7 * t) + 0.3)
    gamma = np.clip(np.cumsum(np.diff(gamma, prepend=0.0).clip(-0.06, 0.06)), -3.0, 3.0)
    x = np.concatenate([[0.0], np.cumsum(0.005 * (gamma[1:] + gamma[:-1]))])
    free = f.sampled(0.01)
    clipped = f.sampled(0.01, limit=3.0)
    assert np.all(np.abs(gamma - clipped.run(x)[:, 0]) <= np.abs(gamma - free.run(x)[:, 0]) + ROUNDING)
    assert np.any(clipped.run(x) != free.run(x))
    within = error_bound(clipped, Bounded({1: 6.0}, implementation=Implementation(f=3.0)))
    assert within.bound == error_bound(free, {1: 6.0}).bound
    assert "f_hat at its limit, |f| up to 3" in within.covered
    assert "f_hat stays within its limit, or |f| does" in error_bound(clipped, {1: 6.0}).assumptions


def test_fixed_point_adds_its_rounding_and_its_converter():
    """In 32 bits over a range of a kilometre a second, so that both show."""
    sampled = pf.PhyFilter([20.0]).sampled(0.01)
    fixed = pf.fixed_point(sampled, x=1000.0)
    bit = 2.0 ** -fixed.fraction["x"]
    found = error_bound(
        sampled, Bounded({1: 1e-4}, implementation=Implementation(x_step=bit, rounding=fixed.error_bound))
    )
    quantised = 2.0 * -np.expm1(-0.2) / 0.01 * 0.5 * bit  # noise of half a bit through 2 (1 - a) / h
    assert found.implementation == pytest.approx(
        {"quantisation": quantised, "rounding": fixed.error_bound}, rel=1e-6
    )
    assert "rounding that moves f_hat" in found.covered[-1]
    t = 0.01 * np.arange(1000.0)
    gamma, x = 5e-5 * np.sin(2.0 * t), -2.5e-5 * np.cos(2.0 * t) + 900.0
    f_hat = fixed.reals("f_hat", fixed.run(fixed.integers("x", x[:, None]))[0])[:, 0]
    error = np.abs(gamma - f_hat)[200:].max()
    assert error_bound(sampled, {1: 1e-4}).bound < error <= found.bound


def test_what_is_covered_and_what_is_assumed_is_said():
    f = pf.PhyFilter([20.0])
    ideal = error_bound(f.sampled(0.01), {1: 1.0})
    assert ideal.covered == ()
    assert ideal.assumptions == (
        "g is held between the samples",
        "f_theta is linear between the samples",
        "M_hat is constant over a step",
        "samples come every 0.01 s, on time",
        "x is measured without delay",
        "what x is rounded to counts as its noise",
        "rounding of the recursion (float64) is left out",
    )
    assert all(text in ideal.describe() for text in ideal.assumptions)
    given = Implementation(
        g={0: 9.0, 1: 6.0},
        f_theta={2: 1.0},
        inertia={1: 0.1},
        x={0: 3.0},
        jitter=1e-4,
        delay_error=1e-3,
        x_step=0.01,
    )
    whole = error_bound(f.sampled(0.01), Bounded({1: 1.0}, rate=1.0, implementation=given))
    assert whole.assumptions == ()
    assert whole.covered == (
        "|g'| up to 6 between the samples",
        "|f_theta''| up to 1 between the samples",
        "|M_hat'| up to 0.1",
        "sampling instants up to 0.0001 s off the grid",
        "a delay of x off by up to 0.001 s",
        "x in steps of 0.01",
        "rounding in float64 of up to 6 axes, |x| up to 3, |g| up to 9, |f_theta| up to 0",
    )
    assert error_bound(f, {1: 1.0}).assumptions == ()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (lambda: Implementation(g={3: 1.0}), "order"),
        (lambda: Implementation(x={1: 1.0}), "`rate`"),
        (lambda: Implementation(g={1: -1.0}), ">= 0"),
        (lambda: Implementation(jitter=float("nan")), "jitter"),
        (lambda: Implementation(g=3.0), "by order"),
        (lambda: Implementation(x={0: 1.0}, rounding=1e-6), "without x"),
        (lambda: run_with(jitter=1e-3), "rate="),
        (lambda: run_with(g={2: 1.0}), "taken as held"),
        (lambda: run_with(rate=1.0, inertia={2: 1.0}), "M_hat'"),
        (lambda: run_with(rate=1.0, x={0: 1.0}, delay=0.01), "without delay"),
        (
            lambda: error_bound(
                pf.PhyFilter([2.0]), Bounded({1: 1.0}, implementation=Implementation(jitter=1e-3))
            ),
            "sampled",
        ),
    ],
)
def test_bounds_that_say_nothing_are_refused(given, message):
    with pytest.raises(ValueError, match=message):
        given()


def run_with(rate=0.0, delay=0.0, **given):
    sampled = pf.PhyFilter([20.0]).sampled(0.01, delay=delay)
    return error_bound(sampled, Bounded({1: 1.0}, rate=rate, implementation=Implementation(**given)))
