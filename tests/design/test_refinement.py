"""Refinement: known truths recovered without labels, gradients by differences, loop against run, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.design.refinement import last_layer, offline_problem, refine, regression, score_model
from phyfilter_ctl.design.refinement.online import OnlineRefiner
from phyfilter_ctl.learned import Chebyshev, Network
from phyfilter_ctl.recording import Recording

Array = NDArray[np.float64]

DT = 0.01
BOUNDS = np.array([[-3.0, 3.0], [-3.0, 3.0]])
# One sum of some 10^3 products, each side in another order.
ROUNDING = 1e-11
# A loop and a record differ by the order of sums, times the condition of the information (trust 1e-3 against 1).
LOOP = 1e-8
# Central differences at 1e-6 of a smooth cost: truncation 1e-12, rounding 1e-16 / 1e-6.
DIFFERENCES = 1e-6


def truth(v: Array) -> Array:
    """In the class of Chebyshev(2)."""
    return np.column_stack([-0.4 * v[:, 0] + 0.15 * v[:, 0] * v[:, 1], 0.2 - 0.3 * v[:, 1] ** 2])


def flight(
    seed: int, *, seconds: float = 8.0, gust: float = 0.0, noise: float = 0.0, size: float = 1.0
) -> Recording:
    rng = np.random.default_rng(seed)
    t = DT * np.arange(round(seconds / DT))[:, None]
    v, slope, blown = np.zeros((len(t), 2)), np.zeros((len(t), 2)), np.zeros((len(t), 2))
    for _ in range(5):
        omega, phase = rng.uniform(0.3, 4.0, 2), rng.uniform(0.0, 6.3, 2)
        v += 0.6 * size * np.sin(omega * t + phase)
        slope += 0.6 * size * omega * np.cos(omega * t + phase)
        blown += gust * np.sin(rng.uniform(0.2, 3.0, 2) * t + rng.uniform(0.0, 6.3, 2))
    f = truth(v) + blown
    x = v + noise * rng.standard_normal(v.shape)
    return Recording.from_arrays(x=x, dt=DT, g=slope - f, label=f, features=v)


@pytest.fixture(scope="module")
def wrong() -> Chebyshev:
    """Fitted to a line through the data: no curvature."""
    z = np.random.default_rng(0).uniform(-1.0, 1.0, (300, 2))
    return Chebyshev(2, n_d=0, bounds=BOUNDS).fit(z, -0.2 * z).model


@pytest.fixture(scope="module")
def network() -> Network:
    z = np.random.default_rng(1).uniform(-1.5, 1.5, (300, 2))
    return Network((6,), seed=2, max_iterations=60).fit(z, -0.2 * z).model


SAMPLED = PhyFilter.from_poles([-6.0, -9.0]).sampled(DT, g="average")


# --- the parts


@pytest.mark.parametrize("rule", ["average", "hold"])
@pytest.mark.parametrize("poles", [[-6.0], [-4.0 + 3.0j, -4.0 - 3.0j]])
def test_adjoint_is_the_transpose(rule: str, poles: list[complex]) -> None:
    sampled = PhyFilter.from_poles(poles).sampled(DT, f_theta=rule)  # type: ignore[arg-type]  # a str parameter
    rng = np.random.default_rng(3)
    one, other = rng.standard_normal((2, 400, 3))
    forward = np.sum(other * regression.filtered(sampled, one))
    assert abs(forward - np.sum(one * regression.filtered_adjoint(sampled, other))) < ROUNDING


def test_filtered_is_what_the_filter_takes_off(wrong: Chebyshev) -> None:
    log = flight(4)
    shift = np.random.default_rng(5).standard_normal((log.n, 2))
    f_theta = wrong.predict(regression.features_of(log))
    difference = regression.correction(SAMPLED, log, f_theta) - regression.correction(
        SAMPLED, log, f_theta + shift
    )
    np.testing.assert_allclose(regression.filtered(SAMPLED, shift), difference, atol=ROUNDING)


def test_regressors_of_a_record_are_those_of_its_samples(wrong: Chebyshev) -> None:
    tuned = regression.Tuned.of(wrong, [0, 3, 11])
    z = flight(4).x[::100]
    whole = tuned.regressors(z)
    for row, columns in zip(z, whole, strict=True):
        np.testing.assert_allclose(tuned.regressors_at(row), columns, atol=ROUNDING)


def test_gradient_of_the_cost(network: Network) -> None:
    logs = (flight(6, seconds=2.0), flight(7, seconds=1.5))
    tuned = regression.Tuned.of(network, None)
    memory = np.random.default_rng(8).uniform(-1.0, 1.0, (20, 2))
    problem = offline_problem.Problem(tuned, SAMPLED, logs, 0.5, memory)
    rng = np.random.default_rng(9)
    masks = [rng.random(log.n) < 0.7 for log in logs]
    change, direction = 0.1 * rng.standard_normal((2, tuned.count))
    _, gradient = problem._cost(change, 1e-2, masks)
    ahead, behind = (problem._cost(change + step * direction, 1e-2, masks)[0] for step in (1e-6, -1e-6))
    assert (ahead - behind) / 2e-6 == pytest.approx(gradient @ direction, rel=DIFFERENCES)


# --- offline


def test_refinement_recovers_a_known_truth_without_labels(wrong: Chebyshev) -> None:
    training, unseen = [flight(20 + i).with_signals(label=None) for i in range(5)], flight(30)
    result = refine(wrong, training, SAMPLED, trust=1e-12)
    score = score_model(result.model, unseen, SAMPLED)
    assert result.status == "converged"
    assert result.iterations == 1
    assert np.isnan(result.before.f_theta_rmse)
    # The record is sampled at h w = 0.04: g and f_theta straight between samples, off by some (h w)^2 / 12.
    assert score.f_theta_rmse < 1e-3
    assert score_model(wrong, unseen, SAMPLED).f_theta_rmse > 0.2
    assert score.share < 1e-3


def test_refinement_lags_less_than_a_fit_to_the_estimate(wrong: Chebyshev) -> None:
    slow = PhyFilter.from_poles([-3.0, -3.0]).sampled(DT, g="average")
    training, unseen = [flight(20 + i) for i in range(5)], [flight(30 + i) for i in range(2)]
    estimates = [slow.run(log.x, log.g, wrong.predict(log.x)) for log in training]
    fitted = wrong.fit(np.concatenate([log.x for log in training]), np.concatenate(estimates)).model
    refined = refine(wrong, training, slow, trust=1e-9).model
    errors = [score_model(model, unseen, slow).f_theta_rmse for model in (refined, fitted)]
    assert 20.0 * errors[0] < errors[1]


def test_refinement_helps_on_unseen_flights_in_gusts_and_noise(wrong: Chebyshev) -> None:
    training = [flight(40 + i, gust=0.1, noise=2e-3) for i in range(6)]
    unseen = [flight(50 + i, gust=0.1, noise=2e-3) for i in range(4)]
    before = score_model(wrong, unseen, SAMPLED)
    after = score_model(refine(wrong, training, SAMPLED).model, unseen, SAMPLED)
    # The gusts, 0.16 of the unrefined 0.37, are no function of the features and stay.
    assert after.f_theta_rmse < 0.6 * before.f_theta_rmse
    assert after.share < 0.6 * before.share
    assert after.f_hat_rmse < before.f_hat_rmse


def test_cross_validation_refuses_to_learn_gusts() -> None:
    # The model is right already; all that is left are gusts, which no feature tells of.
    z = np.random.default_rng(0).uniform(-3.0, 3.0, (300, 2))
    right = Chebyshev(2, n_d=0, bounds=BOUNDS).fit(z, truth(z)).model
    training, unseen = (
        [flight(60 + i, gust=0.3) for i in range(4)],
        [flight(70 + i, gust=0.3) for i in range(4)],
    )
    loose = refine(right, training, SAMPLED, trust=1e-9)
    careful = refine(right, training, SAMPLED)

    def model_error(model: Chebyshev) -> float:
        return float(np.sqrt(np.mean([(model.predict(log.x) - truth(log.x)) ** 2 for log in unseen])))

    assert model_error(loose.model) > 0.05
    assert model_error(careful.model) < 0.5 * model_error(loose.model)


@pytest.mark.slow
def test_network_is_refined_by_descent(network: Network) -> None:
    training = [flight(80 + i) for i in range(3)]
    unseen = flight(90)
    before, result = (
        score_model(network, unseen, SAMPLED),
        refine(network, training, SAMPLED, max_iterations=60),
    )
    assert result.status in ("converged", "iteration_limit")
    after = score_model(result.model, unseen, SAMPLED)
    assert after.f_theta_rmse < 0.6 * before.f_theta_rmse
    assert after.share < before.share


def test_only_the_trainable_parameters_move(network: Network) -> None:
    result = refine(network, [flight(80)], SAMPLED, trainable=last_layer(network), trust=1e-6)
    moved = result.model.parameters != network.parameters
    where = np.arange(len(moved))[last_layer(network)]
    assert moved[where].all()
    assert moved.sum() == len(where) == 7 * 2


def test_memory_keeps_what_the_model_knew(wrong: Chebyshev) -> None:
    # Where the flight is, the model is wrong; far from it, the memory holds it.
    training = [flight(20 + i, size=0.3) for i in range(4)]
    far = np.random.default_rng(1).uniform(-3.0, 3.0, (200, 2))

    def moved(keep: float) -> float:
        refined = refine(wrong, training, SAMPLED, memory=far, keep=keep, trust=1e-9).model
        return float(np.sqrt(np.mean((refined.predict(far) - wrong.predict(far)) ** 2)))

    assert moved(100.0) < 0.2 * moved(0.0)


def test_held_out_flights_can_reject(wrong: Chebyshev) -> None:
    # Held-out flights on which the old model is right: whatever is learned elsewhere is worse there.
    other = flight(21)
    assert other.g is not None
    f_theta = wrong.predict(regression.features_of(other))
    other = other.with_signals(g=other.g + truth(other.x) - f_theta, label=f_theta)
    result = refine(wrong, [flight(20)], SAMPLED, held_out=other)
    assert result.status == "rejected"
    assert result.model is wrong
    assert "held-out" in result.message
    assert result.held_out_before is not None
    assert result.held_out_after is not None
    assert result.held_out_after.share > result.held_out_before.share


# --- online


def test_online_run_is_the_loop(wrong: Chebyshev) -> None:
    refiner = OnlineRefiner(wrong, SAMPLED, forgetting=2.0, every=7)
    first, second = flight(100, seconds=0.6, gust=0.2), flight(101, seconds=0.5, gust=0.2)
    seen = refiner.run(first)
    again = refiner.run(second, knowledge=seen.knowledge)
    knowledge = None
    for log, whole in ((first, seen), (second, again)):
        assert log.g is not None
        z = regression.features_of(log)
        state = refiner.start(log.x[0], knowledge=knowledge)
        for k in range(log.n):
            state, f_theta, f_hat = refiner.step(state, log.x[k], log.g[k], z=z[k])
            np.testing.assert_allclose(f_theta, whole.f_theta[k], atol=LOOP)
            np.testing.assert_allclose(f_hat, whole.f_hat[k], atol=LOOP)
        np.testing.assert_allclose(state.knowledge.information, whole.knowledge.information, atol=LOOP)
        knowledge = state.knowledge
    np.testing.assert_allclose(
        refiner.refined(knowledge).parameters, refiner.refined(again.knowledge).parameters, atol=LOOP
    )


def test_one_filter_for_each_channel_online(wrong: Chebyshev) -> None:
    both = SAMPLED.with_filter([PhyFilter([5.0]), PhyFilter([40.0, 14.0])])
    refiner = OnlineRefiner(wrong, both, trainable=[0, 4, 12], every=3)
    log = flight(102, seconds=0.4)
    whole = refiner.run(log)
    assert log.g is not None
    state = refiner.start(log.x[0])
    for k in range(log.n):
        state, _, f_hat = refiner.step(state, log.x[k], log.g[k], z=regression.features_of(log)[k])
        np.testing.assert_allclose(f_hat, whole.f_hat[k], atol=LOOP)


def test_batches_of_blocks_change_nothing(wrong: Chebyshev, monkeypatch: pytest.MonkeyPatch) -> None:
    from phyfilter_ctl.design.refinement import online

    log = flight(103, seconds=3.0)
    refiner = OnlineRefiner(wrong, SAMPLED, every=4)
    whole = refiner.run(log)
    monkeypatch.setattr(online, "_BATCH", 1)
    np.testing.assert_allclose(refiner.run(log).parameters, whole.parameters, atol=LOOP)


def test_online_is_weighted_least_squares(wrong: Chebyshev) -> None:
    log = flight(104, seconds=3.0, gust=0.1)
    refiner = OnlineRefiner(wrong, SAMPLED, forgetting=1.5, every=10, trust=1e-2)
    z = regression.features_of(log)
    Phi = regression.filtered(SAMPLED, refiner.tuned.regressors(z))[1:]
    y = regression.correction(SAMPLED, log, wrong.predict(z))[1:]
    q = np.exp(-DT / 1.5)
    root = np.sqrt((1.0 - q) * q ** np.arange(len(y) - 1.0, -1.0, -1.0))[:, None]
    p = refiner.tuned.count
    rows = np.vstack([(root[..., None] * Phi).reshape(-1, p), 0.1 * np.eye(p)])
    wanted = np.linalg.lstsq(rows, np.append((root * y).ravel(), np.zeros(p)), rcond=None)[0]
    np.testing.assert_allclose(refiner.change(refiner.run(log).knowledge), wanted, atol=LOOP)


def test_online_refinement_improves_flight_after_flight(wrong: Chebyshev) -> None:
    logs = [flight(110 + i, noise=2e-3) for i in range(5)]
    result = refine(wrong, logs, SAMPLED, mode="online", trust=1e-5)
    errors = [
        np.sqrt(np.mean((seen.f_theta - log.label) ** 2)) / score_model(wrong, log, SAMPLED).f_theta_rmse
        for seen, log in zip(result.flights, logs, strict=True)
        if log.label is not None
    ]
    assert errors[-1] < 0.1
    assert errors[-1] < 0.3 * errors[0]
    unseen = flight(120, noise=2e-3)
    assert (
        score_model(result.model, unseen, SAMPLED).f_theta_rmse
        < 0.1 * score_model(wrong, unseen, SAMPLED).f_theta_rmse
    )


def test_unexcited_directions_return_instead_of_winding_up(wrong: Chebyshev) -> None:
    # A flight that stands still after one that taught: with time the model returns to the one given where unexcited.
    refiner = OnlineRefiner(wrong, SAMPLED, forgetting=1.0, trust=1e-4)
    taught = refiner.run(flight(20)).knowledge
    still = np.zeros((6000, 2))
    hover = Recording.from_arrays(x=still, dt=DT, g=-truth(still), features=still)
    after = refiner.run(hover, knowledge=taught)
    assert np.all(np.isfinite(after.parameters))
    far = np.array([[2.0, 2.0]])
    there = [
        np.linalg.norm(refiner.refined(k).predict(far) - wrong.predict(far))
        for k in (taught, after.knowledge)
    ]
    assert there[1] < there[0]
    np.testing.assert_allclose(
        refiner.refined(after.knowledge).predict(still[:1]), truth(still[:1]), atol=1e-3
    )


def test_an_update_moves_the_estimate_less_than_a_jump_of_f_theta_in_a_running_filter(
    wrong: Chebyshev,
) -> None:
    refiner = OnlineRefiner(wrong, SAMPLED, forgetting=5.0, every=50, trust=1e-5)
    for seed in range(20, 25):
        log = flight(seed)
        assert log.label is not None
        seen = refiner.run(log)
        passed_on = SAMPLED.run(log.x, log.g, seen.f_theta)
        at = seen.updates[1:-1]
        kicks = [np.max(np.abs(f_hat[at + 1] - f_hat[at])) for f_hat in (seen.f_hat, passed_on)]
        errors = [np.mean((f_hat - log.label) ** 2) for f_hat in (seen.f_hat, passed_on)]
        assert kicks[0] < 0.8 * kicks[1]
        assert errors[0] < errors[1]


# --- refusals


def test_bad_input_is_named(wrong: Chebyshev, network: Network) -> None:
    log = flight(20, seconds=1.0)
    with pytest.raises(ValueError, match=r"logs\[1\] has no features"):
        refine(wrong, [log, log.with_signals(features=None)], SAMPLED)
    with pytest.raises(TypeError, match=r"logs\[0\]: expected a Recording, got ndarray"):
        refine(wrong, [log.x], SAMPLED)  # type: ignore[list-item]  # the value under test
    with pytest.raises(ValueError, match="at least one flight"):
        refine(wrong, [], SAMPLED)
    with pytest.raises(ValueError, match=r"expected samples every 0.01 s"):
        refine(wrong, log.decimate(2), SAMPLED)
    with pytest.raises(ValueError, match="fit it first"):
        refine(Chebyshev(2), log, SAMPLED)
    with pytest.raises(ValueError, match="linear in its moving parameters"):
        refine(network, log, SAMPLED, mode="online")
    with pytest.raises(ValueError, match="no delay"):
        refine(wrong, log, PhyFilter([5.0]).sampled(DT, delay=0.02))
    with pytest.raises(ValueError, match="different indices from 0 to 17"):
        refine(wrong, log, SAMPLED, trainable=[18])
    with pytest.raises(ValueError, match="at least one parameter"):
        refine(wrong, log, SAMPLED, trainable=slice(0, 0))
    with pytest.raises(ValueError, match="no weights yet"):
        last_layer(Network((3,)))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("trust", 0.0),
        ("trust", -1.0),
        ("forgetting", 0.0),
        ("keep", np.nan),
        ("every", 0),
        ("memory", np.zeros(3)),
    ],
)
def test_options_out_of_range(wrong: Chebyshev, name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected"):
        refine(wrong, flight(20, seconds=1.0), SAMPLED, **{name: value})  # type: ignore[arg-type]  # values under test


@pytest.mark.parametrize(("name", "value"), [("mode", "later"), ("max_iterations", 0)])
def test_choices_out_of_range(wrong: Chebyshev, name: str, value: object) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected"):
        refine(wrong, flight(20, seconds=1.0), SAMPLED, **{name: value})  # type: ignore[arg-type]  # values under test
