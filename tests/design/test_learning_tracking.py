"""The closed loop's own cost is that of the loop simulated step by step, and its derivatives are differences."""

import control as ct
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter

from phyfilter_ctl import (
    Loop,
    LoopGoal,
    PhyFilter,
    Reading,
    Recording,
    SampledPhyFilter,
    Search,
    learn,
    margins,
)
from phyfilter_ctl.design.learning import tracking as module
from phyfilter_ctl.design.learning.parametrisation import chain_of
from phyfilter_ctl.design.learning.residuals import flights_of
from phyfilter_ctl.design.learning.tracking import Tracking, spectra_of
from phyfilter_ctl.filter import Sampling

H, LAG, KP, KD = 0.01, 0.05, 10.0, 6.0
LOOP = {"kp": KP, "kd": KD, "actuator": ct.tf(1, [LAG, 1])}
# What the loop still remembers when the zeros behind the record end, and rounding of spectra: relative. The noise of
# the speed has a mean, which no line holds.
SAME, WITH_NOISE = 1e-6, 1e-4
# Lines within 1/384 of their frequency together, in a loop that keeps a margin.
POOLED = 1e-4
# Central differences with steps of 1e-5.
DIFFERENCE = 1e-5


def simulated(filter, f, noise, reference, kp, late):
    """Tracking error at the samples; f linear between them, the command ``late`` whole steps late, g the command."""
    A = np.array([[-1.0 / LAG, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    whole = np.zeros((6, 6))  # states, command, f, slope of f
    whole[:3, :3], whole[0, 3], whole[1, 4], whole[4, 5] = A, 1.0 / LAG, 1.0, 1.0
    step = expm(whole * H)[:3]
    # Of the reference: place and speed of its acceleration, linear between samples.
    free = expm(np.array([[0.0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1], [0, 0, 0, 0]]) * H)[:2]
    state, wanted = np.zeros(3), np.zeros(2)
    memory, command, line, errors = filter.start(np.array([noise[0]])), 0.0, [0.0] * late, []
    for k in range(1, len(f)):
        line.append(command)
        slope = (f[k] - f[k - 1]) / H
        state = step @ np.array([*state, line.pop(0), f[k - 1], slope])
        wanted = free @ np.array([*wanted, reference[k - 1], (reference[k] - reference[k - 1]) / H])
        memory, f_hat = filter.step(memory, state[1:2] + noise[k], np.array([command]))
        errors.append([state[1] - wanted[0], state[2] - wanted[1]])
        back = kp * errors[-1][1] + KD * (errors[-1][0] + noise[k])
        command = reference[k] - back - float(f_hat[0])
    return np.array(errors)


def signals(seed=0, n=300, rest=700):
    """Residual, noise of the speed and a reference's acceleration, which begin and end at 0 and have no mean."""
    rng = np.random.default_rng(seed)
    made = lfilter([0.2], [1.0, -0.95], rng.standard_normal((2, n)), axis=1)
    window = np.sin(np.pi * np.arange(n) / (n - 1)) ** 2
    f, reference = (window * (each - window @ each / np.sum(window)) for each in made)
    noise = 2e-3 * rng.standard_normal(n) * window
    return [np.append(each, np.zeros(rest)) for each in (f, noise, reference)]


def tracking(kp, late, *, reference=False, noisy=True):
    f, noise, wanted = signals()
    noise = noise * noisy
    speed = np.append(0.0, np.cumsum(0.5 * H * (f[1:] + f[:-1]))) + noise
    log = Recording.from_arrays(x=speed[:, None], dt=H, label=f[:, None])
    flights = flights_of([log])
    sampling = Sampling(H)
    omega, spectra = spectra_of(flights, H, wanted if reference else None, offset=False)
    loop = margins(PhyFilter([5.0]), Loop(delay=late * H, **LOOP | {"kp": kp}), dt=H).loop
    return Tracking.of(loop, omega, spectra, sampling), (f, noise, wanted), sampling


@pytest.fixture
def alone(monkeypatch):
    """Every line of the spectra by itself."""
    monkeypatch.setattr(module, "_ALONE", 1 << 20)


@pytest.mark.parametrize(("kp", "late", "noisy"), [(KP, 0, True), (KP, 2, False), (0.0, 1, True)])
@pytest.mark.usefixtures("alone")
def test_cost_is_that_of_the_simulated_loop(kp, late, noisy):
    cost, (f, noise, _), sampling = tracking(kp, late, noisy=noisy)
    filter = PhyFilter([150.0, 30.0], [150.0, 8.0])
    chain = chain_of(filter.poles)
    errors = simulated(SampledPhyFilter(filter, sampling), f, noise, np.zeros_like(f), kp, late)
    expected = np.mean(errors[:, 1 if kp else 0] ** 2)
    tolerance = WITH_NOISE if noisy else SAME
    assert abs(cost.cost(chain, chain.output(filter.b)) - expected) < tolerance * expected


@pytest.mark.usefixtures("alone")
def test_a_reference_adds_what_the_simulated_loop_misses_of_it():
    alone, (_, _, wanted), sampling = tracking(KP, 1)
    both, _, _ = tracking(KP, 1, reference=True)
    filter = PhyFilter([10.0])
    chain, zero = chain_of(filter.poles), np.zeros_like(wanted)
    c = chain.output(filter.b)
    errors = simulated(SampledPhyFilter(filter, sampling), zero, zero, wanted, KP, 1)
    expected = np.sum(errors[:, 1] ** 2) / len(wanted)
    assert abs(both.cost(chain, c) - alone.cost(chain, c) - expected) < SAME * expected


def test_lines_together_are_those_alone(monkeypatch):
    chain = chain_of(PhyFilter([150.0, 30.0]).poles)
    c = chain.output(np.array([150.0, 8.0]))
    pooled = tracking(KP, 1)[0]
    monkeypatch.setattr(module, "_ALONE", 1 << 20)
    alone = tracking(KP, 1)[0]
    assert len(pooled.omega) < 0.8 * len(alone.omega)
    assert abs(pooled.cost(chain, c) / alone.cost(chain, c) - 1.0) < POOLED


def test_slopes_are_central_differences():
    cost, _, _ = tracking(KP, 1, reference=True)
    chain = chain_of(PhyFilter([600.0, 45.0]).poles)
    c = chain.output(np.array([600.0, 20.0]))
    n, step = chain.order, 1e-5
    # theta moves the states by the chain's sensitivities, c the output row.
    rows = np.concatenate([c @ chain.sensitivities, np.pad(np.eye(n), [(0, 0), (0, n)])])
    gradient, curvature = cost.model(chain, c, rows)
    for i in range(2 * n):
        ends = []
        for sign in (1.0, -1.0):
            theta, moved = chain.theta.copy(), c.copy()
            (theta if i < n else moved)[i % n] += sign * step
            ends.append(cost.cost(type(chain)(theta, chain.floor), moved))
        difference = (ends[0] - ends[1]) / (2.0 * step)
        assert abs(gradient[i] - difference) < DIFFERENCE * np.max(np.abs(gradient))
    assert np.all(np.linalg.eigvalsh(curvature) > 0.0)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"cost": "tracking"}, "kp or kd"),
        ({"cost": "nothing", "loop": Loop(kd=1.0)}, "expected one of estimation, tracking"),
        ({"loop": Loop(kd=1.0), "reference": [0.0, 1.0]}, "leave it out"),
    ],
)
def test_wrong_costs_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        LoopGoal(**wrong)


def test_steps_that_differ_are_refused():
    times = np.cumsum([0.0, *([0.01, 0.02] * 50)])
    log = Recording.from_arrays(x=np.sin(times)[:, None], times=times, label=np.cos(times)[:, None])
    with pytest.raises(ValueError, match="equal steps"):
        learn(log, 1, loop=LoopGoal(Loop(kd=1.0), cost="tracking"))


@pytest.mark.slow
def test_flights_that_are_read_give_the_answer_of_those_in_memory():
    f, noise, wanted = signals(n=900, rest=100)
    log = Recording.from_arrays(x=(np.cumsum(H * f) + noise)[:, None], dt=H, label=f[:, None])
    loop = LoopGoal(Loop(delay=H, **LOOP), cost="tracking", reference=wanted)
    plain = {"loop": loop, "search": Search(cross_validate=False)}
    kept, read = learn(log, 1, **plain), learn([lambda: log], 1, reading=Reading(workers=1), **plain)
    assert np.array_equal(kept.filter.a, read.filter.a)
    assert kept.loop.tracking == read.loop.tracking


@pytest.mark.slow
def test_the_filter_learned_for_tracking_tracks_better_on_another_record():
    def record(seed):
        rng = np.random.default_rng(seed)
        f = lfilter([0.22], [1.0, -0.975], rng.standard_normal(2000))
        noise = 3e-3 * rng.standard_normal(2000)
        return f, noise

    f, noise = record(0)
    speed = np.cumsum(H * f) + noise
    log = Recording.from_arrays(x=speed[:, None], dt=H, label=f[:, None])
    found = [
        learn(log, 2, loop=LoopGoal(Loop(delay=H, **LOOP), cost=cost), shape="general")
        for cost in ("estimation", "tracking")
    ]
    assert found[1].loop.tracking < 0.9 * found[1].loop.tracking_of_estimator
    f, noise = record(1)
    errors = [simulated(each.sampled(), f, noise, np.zeros(2000), KP, 1)[:, 1] for each in found]
    assert np.std(errors[1]) < 0.9 * np.std(errors[0])
    assert all(each.loop.spare["modulus margin"] >= 0.0 for each in found)
