"""Rollouts, costates and training: segments, signals, general costs, statuses."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phyfilter_ctl import PhyFilter, SampledPhyFilter
from phyfilter_ctl.design.adjoint import (
    Adam,
    CasadiCost,
    SquaredError,
    adjoint_gradient,
    train,
)
from phyfilter_ctl.design.adjoint.block_map import CHUNK
from phyfilter_ctl.design.adjoint.rollout import Rollout
from phyfilter_ctl.design.learning.residuals import flights_of
from phyfilter_ctl.design.learning.samples import Samples
from phyfilter_ctl.design.learning.sensitivity import coefficient_gradient
from phyfilter_ctl.filter import PaperFilter
from phyfilter_ctl.recording import Recording

# Sums over the same samples in another order.
ROUNDING = 1e-11
# Against central differences of a smooth cost, fourth order: their own error.
DIFFERENCES = 1e-8
H = 0.004


def log_of(count: int, seed: int = 0, channels: int = 2, **signals) -> Recording:
    rng = np.random.default_rng(seed)
    x = np.cumsum(0.01 * rng.standard_normal((count, channels)), axis=0)
    g, f_theta, label = rng.standard_normal((3, count, channels))
    return Recording.from_arrays(x=x, dt=H, g=g, f_theta=f_theta, label=label, **signals)


def learnable(count: int = 3000, seed: int = 1, dt: float = 0.01) -> Recording:
    """Slow sines under noise: a filter that is too fast or too slow is worse."""
    rng = np.random.default_rng(seed)
    t = dt * np.arange(count)
    f = np.column_stack([np.sin(2.0 * t), np.cos(1.3 * t) + 0.5 * np.sin(5.0 * t)])
    x = dt * np.cumsum(f, axis=0) + 3e-3 * rng.standard_normal(f.shape)
    return Recording.from_arrays(x=x, dt=dt, label=f)


def relative(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.linalg.norm(one - other) / np.linalg.norm(other))


# --- rollouts


@pytest.mark.parametrize("method", ["exact", "euler", "tustin"])
def test_rollout_is_the_sampled_filter(method):
    log = log_of(1000)
    sampled = PhyFilter([400.0, 30.0], [100.0, 20.0]).sampled(H, method=method, g="average")
    rollout = Rollout(sampled)
    trace = rollout.forward(rollout.inputs(log.x, log.g, log.f_theta))
    assert np.max(np.abs(trace.f_hat - sampled.run(log.x, log.g, log.f_theta))) < ROUNDING


@settings(max_examples=25, deadline=None)
@given(
    count=st.integers(2, 700),
    segments=st.integers(2, 40),
    poles=st.lists(st.floats(0.01, 100.0), min_size=1, max_size=4),
    workers=st.sampled_from([1, 2]),
)
def test_segments_side_by_side_are_exact(count, segments, poles, workers):
    log = log_of(count, seed=count)
    sampled = PhyFilter.from_poles([-p for p in poles]).sampled(H)
    whole = adjoint_gradient(log, sampled)
    pieces = adjoint_gradient(log, sampled, segments=segments, workers=workers)
    powers = sampled.filter.a[0] ** (np.arange(len(poles), 0, -1) / len(poles))
    assert abs(whole.value - pieces.value) <= ROUNDING * whole.value
    assert np.linalg.norm((whole.a - pieces.a) * powers) <= ROUNDING * np.linalg.norm(whole.a * powers)


def test_segments_longer_than_a_chunk():
    log = log_of(3 * CHUNK + 777, channels=1)
    filter = PhyFilter([400.0, 30.0], [100.0, 20.0])
    sampled = filter.sampled(H)
    whole = adjoint_gradient(log, sampled)
    for segments in (2, 5):
        pieces = adjoint_gradient(log, sampled, segments=segments, workers=2)
        assert relative(pieces.vector, whole.vector) < ROUNDING
    (flight,) = flights_of([log])
    _, by_a, by_b = coefficient_gradient(Samples(flight, "exact"), filter, "general", 1.0)
    sensitivities = np.concatenate([by_a, by_b]) * flight.samples
    assert relative(whole.vector, sensitivities) < 1e-9


def test_a_batch_of_flights_is_the_sum():
    logs = [log_of(300, 1), log_of(41, 2), log_of(2, 3)]
    sampled = PhyFilter([400.0, 30.0]).sampled(H)
    together = adjoint_gradient(logs, sampled, segments=3)
    alone = [adjoint_gradient(log, sampled) for log in logs]
    assert together.samples == 299 + 40 + 1
    assert abs(together.value - sum(one.value for one in alone)) < ROUNDING * together.value
    assert relative(together.a, np.sum([one.a for one in alone], axis=0)) < ROUNDING


def test_truncated_rollouts_are_off_by_what_the_borders_cut():
    log, sampled = learnable(6400), PhyFilter([25.0, 8.0]).sampled(0.01)
    exact = adjoint_gradient(log, sampled).a
    errors = [
        relative(adjoint_gradient(log, sampled, segments=n, carry="none").a, exact) for n in (50, 10, 3)
    ]
    assert errors[0] > 0.1
    assert errors[0] > errors[1] > errors[2] > 1e-4


@pytest.mark.parametrize("inertia", [None, 2.0, "diagonal", "full", "diagonal(t)", "full(t)"])
@pytest.mark.parametrize("rules", [("hold", "average"), ("average", "hold")])
@pytest.mark.parametrize("with_E", [False, True])
def test_cotangents_of_the_signals_are_the_transpose(inertia, rules, with_E):
    """<r, L v> = <L' r, v> for the linear map from (x, g, f_theta) to f_hat, which starts from 0 at x = 0."""
    rng = np.random.default_rng(5)
    count = 100
    kinds = {
        "diagonal": (2,),
        "full": (2, 2),
        "diagonal(t)": (count, 2),
        "full(t)": (count, 2, 2),
    }
    M = rng.uniform(0.5, 2.0, kinds[inertia]) if isinstance(inertia, str) else inertia
    E = np.array([[1.0], [0.5]]) if with_E else None
    sampled = PhyFilter([400.0, 30.0], [100.0, 20.0]).sampled(H, g=rules[0], f_theta=rules[1], E=E)
    x, g = rng.standard_normal((2, count, 2))
    f_theta, r = rng.standard_normal((2, count, 1 if with_E else 2))
    rollout = Rollout(sampled, segments=2)
    trace = rollout.forward(rollout.inputs(x, g, f_theta, M))
    back = rollout.backward(trace, r, signals=True)
    forwards = np.vdot(r, sampled.run(x, g, f_theta, M))
    backwards = np.vdot(back.x, x) + np.vdot(back.g, g) + np.vdot(back.f_theta, f_theta)
    assert abs(forwards - backwards) < ROUNDING * abs(np.vdot(back.x, x))


@pytest.mark.parametrize("b", [None, [100.0, 20.0, 3.0]])
def test_cotangents_of_the_signals_in_the_papers_realisation(b):
    rng = np.random.default_rng(5)
    x, g, f_theta, r = rng.standard_normal((4, 60, 2))
    sampled = PaperFilter(PhyFilter([1000.0, 300.0, 30.0], b), H)
    rollout = Rollout(sampled)
    back = rollout.backward(rollout.forward(rollout.inputs(x, g, f_theta)), r, signals=True)
    backwards = np.vdot(back.x, x) + np.vdot(back.g, g) + np.vdot(back.f_theta, f_theta)
    assert abs(np.vdot(r, sampled.run(x, g, f_theta)) - backwards) < ROUNDING * abs(np.vdot(back.x, x))


def test_cotangent_of_f_theta_is_the_error_filter_run_backwards():
    """With everything held and f_theta averaged over no step, y = (1 - F) f_theta is Toeplitz: its transpose."""
    sampled = PhyFilter([400.0, 30.0]).sampled(H, f_theta="hold")
    r = np.random.default_rng(1).standard_normal((200, 1))
    zero = np.zeros_like(r)
    rollout = Rollout(sampled)
    back = rollout.backward(rollout.forward(rollout.inputs(zero)), r, signals=True)
    # The first sample of a record is f_theta_0 itself, so a reversed run sees one sample more.
    backwards = sampled.run(np.zeros((201, 1)), f_theta=np.concatenate([[[0.0]], r[::-1]]))[1:][::-1]
    assert np.max(np.abs(back.f_theta - backwards)) < ROUNDING


# --- costs


def fourth_order(function, p: np.ndarray, step: np.ndarray) -> np.ndarray:
    def along(d: np.ndarray) -> float:
        return (8.0 * (function(p + d) - function(p - d)) - function(p + 2 * d) + function(p - 2 * d)) / 12.0

    return np.array([along(step * unit) / size for unit, size in zip(np.eye(len(p)), step, strict=True)])


@pytest.mark.parametrize("realisation", [SampledPhyFilter, PaperFilter])
def test_any_stage_and_terminal_cost(realisation):
    f, f_hat, a = ca.SX.sym("f", 2), ca.SX.sym("f_hat", 2), ca.SX.sym("a", 2)
    huber = ca.sum1(ca.sqrt(1.0 + (f - f_hat) ** 2)) + 1e-4 * a[0] ** 1.5 / a[1]
    stage = CasadiCost(ca.Function("stage", [f, f_hat, a], [huber]))
    end = CasadiCost(ca.Function("end", [f, f_hat, a], [100.0 * ca.sumsqr(f - f_hat)]))
    log = log_of(80)

    def cost(p: np.ndarray, *, gradient: bool = False):
        sampled = realisation(PhyFilter(p), H)
        found = adjoint_gradient(log, sampled, cost=stage, terminal=end)
        return found.a if gradient else found.value

    p = np.array([400.0, 30.0])
    assert relative(cost(p, gradient=True), fourth_order(cost, p, 1e-3 * p)) < DIFFERENCES
    # written out
    f_hat_now = realisation(PhyFilter(p), H).run(log.x, log.g, log.f_theta)
    error = (f_hat_now - log.label)[1:]
    direct = np.sum(np.sqrt(1.0 + error[:-1] ** 2)) + (len(error) - 1) * 1e-4 * p[0] ** 1.5 / p[1]
    assert abs(cost(p) - direct - 100.0 * np.sum(error[-1] ** 2)) < ROUNDING * direct


def test_weights_of_channels():
    log, sampled = log_of(200), PhyFilter([400.0, 30.0]).sampled(H)
    weighted = adjoint_gradient(log, sampled, cost=SquaredError([3.0, 0.0]))
    first = Recording.from_arrays(
        x=log.x[:, :1], dt=H, g=log.g[:, :1], f_theta=log.f_theta[:, :1], label=log.label[:, :1]
    )
    alone = adjoint_gradient(first, sampled)
    assert abs(weighted.value - 3.0 * alone.value) < ROUNDING * weighted.value
    assert relative(weighted.a, 3.0 * alone.a) < ROUNDING


# --- training


def sweep(log: Recording) -> tuple[float, float]:
    """Best first-order pole of a dense sweep, and its mean squared error summed over channels."""
    poles = np.geomspace(0.5, 40.0, 300)
    costs = [adjoint_gradient(log, PhyFilter([p]).sampled(log.dt)) for p in poles]
    means = [cost.value / cost.samples for cost in costs]
    return float(poles[np.argmin(means)]), float(min(means))


@pytest.mark.slow
@pytest.mark.parametrize("coordinates", ["coefficients", "hurwitz"])
def test_training_finds_the_best_pole_of_a_sweep(coordinates):
    log = learnable()
    _, best = sweep(log)
    result = train(
        log,
        PhyFilter([1.0]),
        segment=600,
        warmup=200,
        optimiser=Adam(0.1 if coordinates == "hurwitz" else 4.0, batch=2, max_epochs=150, patience=15),
        coordinates=coordinates,
        validation=0.0,
    )
    assert result.status == "converged", result.message
    assert min(result.validation) < 1.01 * best
    assert result.validation[result.best_epoch] == min(result.validation)
    assert abs(2.0 * result.rmse**2 - min(result.validation)) < ROUNDING


def test_training_is_reproducible_and_the_order_counts():
    log = learnable()
    one, same, other = (
        train(log, PhyFilter([1.0]), segment=200, optimiser=Adam(0.3, max_epochs=3, seed=seed))
        for seed in (1, 1, 2)
    )
    assert one.filter == same.filter
    assert one.history == same.history
    assert one.history != other.history


def test_the_papers_realisation_trains_alike():
    """Eq. (5) rolled out and the increment recursion under Euler with held inputs are one map."""
    log = learnable(400)
    start = PhyFilter([4.0, 4.0])
    options = {"segment": 100, "optimiser": Adam(0.2, max_epochs=5)}
    paper = train(log, PaperFilter(start, 0.01), **options)
    euler = train(log, start.sampled(0.01, method="euler", f_theta="hold"), **options)
    assert relative(np.array(paper.history), np.array(euler.history)) < 1e-9


@pytest.mark.parametrize("method", ["exact", "euler"])
def test_divergence_is_a_status(method):
    result = train(
        learnable(500),
        PhyFilter([1000.0, 300.0, 30.0]).sampled(0.01, method=method),
        optimiser=Adam(200.0, max_epochs=50),
    )
    assert result.status == "diverged"
    assert "smaller rate" in result.message
    assert np.isfinite(result.rmse)
    assert np.all(np.isfinite(result.validation))
    assert result.validation[result.best_epoch] == min(result.validation)


def test_logarithms_cannot_leave_the_stable_region():
    result = train(
        learnable(500),
        PhyFilter([1000.0, 300.0, 30.0], [900.0, 200.0, 10.0]),
        optimiser=Adam(0.5, max_epochs=30, patience=30),
        coordinates="hurwitz",
    )
    assert result.status == "iteration_limit"
    assert np.all(result.filter.poles.real < 0.0)


def test_callback_stops_and_default_rate_learns():
    met = []

    def watch(epoch, cost, filter):
        met.append((epoch, cost, filter.order))
        return epoch == 3

    result = train(learnable(1000), PhyFilter([1.0, 2.0]), segment=100, callback=watch)
    assert result.status == "cancelled"
    assert [epoch for epoch, _, _ in met] == [1, 2, 3]
    assert result.validation[1:] == tuple(cost for _, cost, _ in met)
    assert result.history[-1] < result.history[0]


def test_adam_by_hand():
    adam = Adam(0.1, beta1=0.5, beta2=0.75)
    p, memory = adam.step(np.array([0.0]), np.array([2.0]), None)
    p, _ = adam.step(p, np.array([-1.0]), memory)
    # m = 0.5 (0.5 2) - 0.5 = 0, so the second step does not move
    assert np.allclose(p, [-0.1])


# --- bad input


def test_what_is_refused():
    log, sampled = log_of(50), PhyFilter([20.0]).sampled(H)
    with pytest.raises(ValueError, match="a label"):
        adjoint_gradient(log.with_signals(label=None), sampled)
    with pytest.raises(ValueError, match=r"resample\(0.002\)"):
        adjoint_gradient(log, PhyFilter([20.0]).sampled(0.002))
    with pytest.raises(ValueError, match="at least one flight"):
        adjoint_gradient([], sampled)
    with pytest.raises(ValueError, match="no delay"):
        adjoint_gradient(log, PhyFilter([20.0]).sampled(H, delay=0.1))
    with pytest.raises(ValueError, match="form"):
        adjoint_gradient(log, PhyFilter([20.0], [10.0]).sampled(H), form="lowpass")
    with pytest.raises(ValueError, match="segments"):
        adjoint_gradient(log, sampled, segments=0)
    with pytest.raises(ValueError, match="carry"):
        Rollout(sampled, carry="some")  # pyright: ignore[reportArgumentType]  # refused at run time too
    with pytest.raises(ValueError, match="row 3"):
        Rollout(sampled).inputs(np.array([[0.0]] * 3 + [[np.nan]]))
    with pytest.raises(ValueError, match="shorten segment"):
        train(log, PhyFilter([20.0]), segment=100)
    with pytest.raises(ValueError, match="weights"):
        SquaredError([-1.0])
    with pytest.raises(ValueError, match="rate"):
        Adam(0.0)
    for name in ("batch", "patience", "max_epochs"):
        with pytest.raises(ValueError, match=f"{name}: expected a whole number of at least 1, got 0"):
            Adam(**{name: 0})
    f, f_hat, a = ca.SX.sym("f", 3), ca.SX.sym("f_hat", 3), ca.SX.sym("a", 1)
    cost = CasadiCost(ca.Function("l", [f, f_hat, a], [ca.sumsqr(f - f_hat) + a]))
    with pytest.raises(ValueError, match="written for"):
        adjoint_gradient(log, sampled, cost=cost)
