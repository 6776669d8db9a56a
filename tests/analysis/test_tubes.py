"""Tubes and bands of tracking errors: loops assembled by hand, courses that reach the bound, integrals of spectra."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import control as ct
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import expm

from phyfilter_ctl import (
    Bounded,
    Gaussian,
    Loop,
    PhyFilter,
    gauss_markov,
    lowpass,
    place_poles,
    tracking_error,
)
from tests.peers.saturation import Case, sampled

FIRST = PhyFilter([8.0])
CASES = [
    Case(FIRST, 10.0, 6.0, 1.0, 0.0, 0.01, 0, "commanded"),
    Case(lowpass(2, 9.0, family="butterworth"), 6.0, 4.0, 0.8, 0.05, 0.02, 2, "commanded"),
    Case(place_poles([-7.0] * 2, type=2), 9.0, 5.0, 1.3, 0.03, 0.005, 1, "commanded"),
]


def tube(case, residual, *, inertia=None, **limits):
    return tracking_error(
        case.filter.sampled(case.h, "exact"),
        Loop(
            case.kp,
            case.kd,
            actuator=ct.tf(1.0, [case.lag, 1.0]) if case.lag else None,
            delay=case.late * case.h,
            inertia_ratio=case.mu,
            **limits,
        ),
        Bounded(residual) if isinstance(residual, list) else residual,
        inertia=inertia,
    )


@pytest.mark.parametrize("case", CASES, ids=["ideal", "late", "type 2"])
def test_a_course_by_hand_reaches_the_radius(case):
    """Force, or its slope, of either sign over each step: the l1 sum of the loop by hand is near the L1 norm, below."""
    hand, h = sampled(case), case.h
    A = hand.at(1.0)
    n = len(A)
    held = np.zeros(n)
    held[:2] = case.mu * h**2 / 2.0, case.mu * h  # position, velocity, of a force of 1 over a step
    ramp = np.zeros((n + 1, n + 1))  # with the force itself, of slope 1
    ramp[:n, :n], ramp[:n, n], ramp[n, n] = A, held, 1.0
    risen = np.append(case.mu * np.array([h**3 / 6.0, h**2 / 2.0]), np.zeros(n - 2))
    steps = int(8.0 / (h * 0.8))
    state, forced, slopes = held, [], []
    rising = np.append(risen, h)
    for _ in range(steps):
        forced.append(abs(state[0]))
        slopes.append(abs(rising[0]))
        state, rising = A @ state, ramp @ rising
    for k, reached in ((0, sum(forced)), (1, sum(slopes))):
        radius = tube(case, residual={k: 1.0}).radius
        assert reached <= radius * (1.0 + 1e-6)  # the enclosure's own gap
        assert reached >= 0.98 * radius  # signs change within steps, and the start counts
    if case.late == 0:
        assert slopes[-1] < 1e-6


def test_steady_error_and_largest_command():
    """Slow changes: p = f'/(mu kp a_0) by the final value theorem of F of order 1; no lag, so v answers within kp p."""
    slow = tube(CASES[0], residual={1: 1.0})
    # 1/(kp a_0), and h/2 of sampling.
    steady = (1.0 / 8.0 + 0.005) / 10.0
    assert steady <= slow.radius < 1.001 * steady  # it hardly overshoots
    assert slow.command == np.inf
    assert not slow.is_linear or slow.command_limit == np.inf
    both = tube(CASES[0], residual={0: 1.0, 1: 5.0}, command_limit=1.5)
    assert both.derivatives == {"residual": [0], "actuation": []}
    assert 1.0 <= both.command <= 1.5  # v = -f at rest, and some overshoot
    assert both.is_linear
    tight = tube(CASES[0], residual={0: 1.0}, command_limit=1.0)
    assert not tight.is_linear
    assert "not proved" in tight.describe()
    assert tight.radius == np.inf


def test_a_limit_of_f_hat_is_counted():
    """A force of 1 N that f_hat may answer with 0.001 N only: the position strays as without the filter."""
    filter, loop, one = PhyFilter([8.0]), Loop(10.0, 6.0), {0: 1.0}
    free = tracking_error(filter.sampled(0.01), loop, one)
    wide = tracking_error(filter.sampled(0.01, limit=1.5, g_limit=(-2.5, 2.5)), loop, one)
    assert wide.radius == free.radius
    assert 1.0 <= free.estimate <= 1.5
    tight = tracking_error(filter.sampled(0.01, limit=0.001), loop, one)
    assert not tight.is_linear
    assert tight.radius == np.inf
    assert "limit of estimate" in tight.describe()
    slope = tracking_error(filter.sampled(0.01, limit=0.5), Loop(10.0, 6.0), {1: 0.1})
    assert "no bound on f itself" in slope.describe()
    held = tracking_error(filter.sampled(0.01, g_limit=(-0.5, 3.0)), loop, one)
    assert held.command_limit == 0.5
    assert not held.is_linear
    with pytest.raises(ValueError, match="g_limit"):
        tracking_error(filter.sampled(0.01, g_limit=(1.0, 3.0)), loop, one)
    with pytest.raises(ValueError, match="g_limit"):
        tracking_error(filter.sampled(0.01, g_limit=(-1.0, 3.0)), replace(loop, g="applied"), one)


def test_inertia_and_direction_of_the_filter_count():
    """A filter that knows M_hat and E answers as one that is given M_hat, for a force of E f."""
    filter, loop = PhyFilter([8.0]), Loop(10.0, 6.0)
    own = filter.sampled(0.01, inertia=4.0, E=[[0.1]])
    told = tracking_error(filter.sampled(0.01), loop, Bounded({0: 0.1, 1: 2.0}, noise=0.01), inertia=4.0)
    found = tracking_error(own, loop, Bounded({0: 1.0, 1: 20.0}, noise=0.01))
    assert found.parts == pytest.approx(told.parts, rel=1e-12)
    assert found.command == pytest.approx(told.command, rel=1e-12)
    assert found.estimate == pytest.approx(10.0 * told.estimate, rel=1e-12)
    gusts = gauss_markov(1.0, 0.5)
    one = tracking_error(own, loop, Gaussian(gusts, noise=0.01))
    two = tracking_error(
        filter.sampled(0.01), loop, Gaussian(gauss_markov(0.1, 0.5), noise=0.01), inertia=4.0
    )
    assert (one.residual, one.noise, one.command) == pytest.approx(
        (two.residual, two.noise, two.command), rel=1e-9
    )
    with pytest.raises(ValueError, match="E: expected one channel"):
        tracking_error(filter.sampled(0.01, E=[[1.0], [0.0]]), loop, {0: 1.0})


@pytest.mark.parametrize(
    ("told", "late"), [("commanded", 0), ("applied", 0), ("commanded", 2), ("commanded", 5)]
)
def test_flights_stay_within_and_come_near(told, late):
    """Worst courses of each term by the kernel's signs, flown by the filter's own steps and a plant by expm.

    x and the position are measured late, by so many halves of a step.
    """
    h, kp, kd, lag, M = 0.01, 8.0, 5.0, 0.04, 3.0
    filter = PhyFilter([6.0]).sampled(h, delay=0.5 * late * h)
    loop = Loop(kp, kd, actuator=lag, delay=h, g=told)
    found = tracking_error(
        filter,
        loop,
        Bounded({0: 3.0}, noise=0.01, actuation={0: 0.5}, position_noise=0.002),
        inertia=M,
    )
    motion = np.zeros((6, 6))  # position, velocity, lag's force, its integral, command, f + d
    motion[0, 1], motion[1, 2], motion[1, 5], motion[3, 2] = 1.0, 1.0 / M, 1.0 / M, 1.0
    motion[2, 2], motion[2, 4] = -1.0 / lag, 1.0 / lag
    half = expm(motion * h / 2.0)

    def flown(f, d, n_x, n_p):
        z, state, g, sent, positions = np.zeros(6), filter.start([n_x[0]], inertia0=M), 0.0, [0.0, 0.0], []
        passed = [np.zeros(6)] * (late + 1)
        for k in range(len(n_x)):
            f_hat, (p, x) = 0.0, passed[-1 - late][:2]
            if k:
                state, out = filter.step(state, [x + n_x[k]], [g])
                f_hat = float(out[0])
            v = -M * (kp * (p + n_p[k]) + kd * (x + n_x[k])) - f_hat
            sent = [v, sent[0]]
            positions.append(p)
            z[3:] = 0.0, sent[1], f[k] + d[k]
            for _ in range(2):
                z = half @ z
                passed.append(z)
            g = v if told == "commanded" else z[3] / h + d[k]
        return np.array(positions)

    N, begun, sizes = 500, 3, (3.0, 0.5, 0.01, 0.002)
    courses = []
    for i, size in enumerate(sizes):  # the answer to one step's worth of each, turned round in time
        impulse = np.zeros((4, N))
        impulse[i, begun] = 1.0
        courses.append(size * np.sign(flown(*impulse)[begun:][::-1]))
    reached = abs(flown(*courses)[-1])
    assert 0.97 * found.radius < reached <= found.radius * (1.0 + 1e-6)


def test_the_envelope_tends_to_the_radius():
    found = tube(CASES[1], Bounded({1: 1.0}, noise=0.001))
    times = np.array([0.0, 0.1, 1.0, 30.0])
    inside = found.envelope(times)
    assert np.all(np.diff(inside) >= 0.0)
    assert inside[-1] == pytest.approx(found.radius, rel=1e-5)
    off = found.envelope(times, position=0.2, velocity=0.3, residual=2.0)
    assert off[0] >= 0.2
    assert off[-1] == pytest.approx(found.radius, rel=1e-5)
    assert np.all(off >= inside)


def test_parts_add_up_and_the_best_derivative_counts():
    slow, rough = tube(CASES[0], residual={1: 2.0}), tube(CASES[0], residual={0: 0.3})
    both = tube(CASES[0], residual=[{1: 2.0}, {0: 0.3}])
    assert both.radius == pytest.approx(slow.radius + rough.radius, rel=1e-12)
    assert both.derivatives["residual"] == [1, 0]
    two = tube(CASES[0], residual={0: 100.0, 1: 2.0})
    assert two.radius == slow.radius
    # Of type 2, but its command is held while a ramp goes on.
    with pytest.raises(ValueError, match="residual: no bound on its derivative 2 alone"):
        tracking_error(CASES[2].filter, Loop(9.0, 5.0), {2: 1.0}, dt=0.005)
    scaled = tube(CASES[0], {1: 6.0}, inertia=3.0)
    assert scaled.radius == pytest.approx(slow.radius, rel=1e-12)


def test_the_band_is_the_integral_of_the_spectrum():
    """Short steps against |G|^2 S of the continuous loop; the autocovariance of the same process against both."""
    a, kp, kd, lag, deviation, memory, h = 8.0, 10.0, 6.0, 0.05, 1.5, 0.3, 0.001

    def density(omega):
        s = 1j * omega
        F, act = a / (s + a), 1.0 / (lag * s + 1.0)
        chi = 1.0 - F + act * (F + kp / s**2 + kd / s)
        S = 2.0 * deviation**2 / memory / (omega**2 + memory**-2)
        return abs((1.0 - F) / (s**2 * chi)) ** 2 * S / np.pi

    wanted = np.sqrt(quad(density, 1e-6, 20.0, limit=200)[0] + quad(density, 20.0, 2e3, limit=200)[0])
    loop = Loop(kp, kd, actuator=lag)
    shaped = tracking_error(PhyFilter([a]), loop, Gaussian(gauss_markov(deviation, memory)), dt=h)
    lags = deviation**2 * np.exp(-h * np.arange(4000) / memory)
    measured = tracking_error(PhyFilter([a]), loop, Gaussian(lags), dt=h)
    assert shaped.residual == pytest.approx(wanted, rel=8e-3)  # half a step of delay beside 50 ms of lag
    assert measured.residual == pytest.approx(shaped.residual, rel=1e-4)  # straight between samples
    assert shaped.band(0.95) == pytest.approx(1.959964 * shaped.position, rel=1e-6)
    assert shaped.command > 0.9 * deviation


def test_the_band_of_white_noise():
    """Against the squares of the loop's answer to one sample of noise, by hand."""
    case = CASES[0]
    found = tracking_error(case.filter, Loop(case.kp, case.kd), Gaussian(noise=0.03), inertia=2.0, dt=case.h)
    hand = sampled(case)
    n, h, a = len(hand.A), case.h, 8.0
    fade = 1.0 - np.exp(-a * h)  # of w, for u of 1; companion state of the hand's loop is w/a
    into = np.zeros((2, n))
    into[0, :2] = -case.kd * np.array([h**2 / 2.0, h])  # noise in the command of the sample
    # In u: 1/h at the sample, -1/h at the next; f_hat adds to the command with the sign of -1.
    into[0, :2] -= fade / h * np.array([h**2 / 2.0, h])
    into[0, 4], into[0, 5] = fade / h / a, -case.kd - fade / h
    into[1, 4], answer = 0.0, []
    into[1, :2] = fade / h * np.array([h**2 / 2.0, h])
    into[1, 4], into[1, 5] = -fade / h / a, fade / h
    state = into[0]
    for k in range(3000):
        answer.append(state[0])
        state = hand.at(1.0) @ state + (into[1] if k == 0 else 0.0)
    assert found.noise == pytest.approx(0.03 * np.linalg.norm(answer), rel=1e-9)
    assert found.position == found.noise


def test_what_is_refused():
    loop = Loop(10.0, 6.0)
    for residual, message in (
        ({2: 1.0}, "residual: no bound on its derivative 2 alone"),
        ({-1: 1.0}, "residual: expected derivative orders"),
        ({0: np.inf}, r"residual\[0\]: expected a finite"),
    ):
        with pytest.raises(ValueError, match=message):
            tracking_error(FIRST, loop, residual, dt=0.01)
    with pytest.raises(ValueError, match="for each part, got none"):
        Bounded([{}])
    with pytest.raises(ValueError, match="dt: expected the sampling interval"):
        tracking_error(FIRST, Loop(10.0, 6.0), {0: 1.0})
    with pytest.raises(ValueError, match="kp: expected a positive gain"):
        tracking_error(FIRST, Loop(0.0, 6.0), {0: 1.0}, dt=0.01)
    with pytest.raises(ValueError, match="the loop is not stable: a pole of magnitude"):
        tracking_error(PhyFilter([90.0]), Loop(10.0, 6.0, actuator=0.1, delay=0.02), {0: 1.0}, dt=0.01)
    with pytest.raises(ValueError, match="g: expected 'commanded' or 'applied', got 'told'"):
        Loop(g="told")  # type: ignore[arg-type]  # on purpose
    with pytest.raises(ValueError, match="delay: "):
        tracking_error(FIRST.sampled(0.01, delay=0.02), Loop(10.0, 6.0, g="applied"), {0: 1.0})
    with pytest.raises(ValueError, match="command_limit: expected a positive force"):
        Loop(command_limit=0.0)
    with pytest.raises(ValueError, match="probability: expected one between"):
        tracking_error(FIRST, loop, Gaussian(noise=0.1), dt=0.01).band(1.0)
    with pytest.raises(ValueError, match="inertia_error, rate, implementation: a tube does not count"):
        tracking_error(FIRST, loop, Bounded({0: 1.0}, rate=2.0), dt=0.01)


@pytest.mark.parametrize("page", ["tubes", "saturation"])
def test_the_blocks_of_the_page_run(page, capsys):
    text = (Path(__file__).parents[2] / f"docs/{page}.md").read_text()
    names: dict[str, object] = {}
    for block in re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        exec(compile(block, f"docs/{page}.md", "exec"), names)
    assert ("radius" in capsys.readouterr().out) == (page == "tubes")
