"""Model and filter learned together: the joint gradient for every kind of model, and what learning gains."""

from __future__ import annotations

import numpy as np
import pytest

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.design.adjoint import adjoint_gradient
from phyfilter_ctl.design.joint import joint_gradient, learn_jointly
from phyfilter_ctl.filter import PaperFilter
from phyfilter_ctl.learned import Chebyshev, Dictionary, Koopman, LearnedModel, Network, NeuralOde
from phyfilter_ctl.recording import Recording
from tests.cpu_budget import slow_but

# Sixth-order central differences along one direction; what is left is their own rounding over the step.
DIFFERENCES = 1e-9
H = 0.01


def log_of(count: int = 300, seed: int = 0) -> Recording:
    """A drag that the model can know from z, and a gust that only the filter sees, with noise on x."""
    rng = np.random.default_rng(seed)
    t = H * np.arange(count)
    z = np.column_stack([np.sin(0.7 * t + seed), np.cos(1.1 * t)])
    drag = np.column_stack([-z[:, 0] * np.abs(z[:, 0]) - z[:, 1], z[:, 0] * z[:, 1]])
    gust = np.column_stack([0.4 * np.sin(2.0 * t), 0.3 * np.cos(2.6 * t)])
    x = H * np.cumsum(drag + gust, axis=0) + 2e-3 * rng.standard_normal((count, 2))
    return Recording.from_arrays(x=x, dt=H, label=drag + gust, features=z)


def fitted(model: LearnedModel, log: Recording) -> LearnedModel:
    return model.fit(log.features, log.label).model


MODELS = {
    "network": Network((5,), max_iterations=20),
    "chebyshev": Chebyshev(3, n_d=0),
    "koopman": Koopman(Dictionary(2, degree=2), 2, dt=H),
    "neural ode": NeuralOde((4,), max_iterations=20),
}


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("form", ["lowpass", "general"])
@pytest.mark.parametrize("method", slow_but(["exact", "paper"], ["exact", "euler", "tustin", "paper"]))
def test_joint_gradient(name, form, method):
    log = log_of()
    model = fitted(MODELS[name], log)
    filter = PhyFilter([30.0, 9.0]) if form == "lowpass" else PhyFilter([30.0, 9.0], [20.0, 5.0])
    sampled = PaperFilter(filter, H) if method == "paper" else filter.sampled(H, method)
    gradient = joint_gradient(log, model, sampled, segments=1 if method == "paper" else 2)
    rng = np.random.default_rng(1)
    theta = model.parameters
    along_theta = rng.standard_normal(theta.shape) * 1e-2
    along_a = rng.standard_normal(2) * 1e-2 * filter.a
    along_b = rng.standard_normal(2) * 1e-2 * filter.a if form == "general" else None

    def cost(s: float) -> float:
        moved = PhyFilter(filter.a + s * along_a, None if along_b is None else filter.b + s * along_b)
        f_theta = model.with_parameters(theta + s * along_theta).predict(log.features)
        f_hat = (PaperFilter(moved, H) if method == "paper" else moved.sampled(H, method)).run(
            log.x, f_theta=f_theta
        )
        return float(np.sum((f_hat - log.label)[1:] ** 2))

    weights = {1: 3.0 / 4.0, 2: -3.0 / 20.0, 3: 1.0 / 60.0}
    step = 0.25
    slope = sum(w * (cost(k * step) - cost(-k * step)) for k, w in weights.items()) / step
    predicted = gradient.model @ along_theta + gradient.a @ along_a
    if along_b is not None:
        predicted += gradient.b @ along_b
    size = np.linalg.norm(gradient.model) * np.linalg.norm(along_theta) + np.linalg.norm(gradient.a * along_a)
    assert abs(slope - predicted) < DIFFERENCES * size
    assert abs(gradient.value - cost(0.0)) < 1e-12 * gradient.value


def test_filter_part_is_the_adjoint_gradient():
    log = log_of()
    model, sampled = fitted(MODELS["network"], log), PhyFilter([30.0, 9.0], [20.0, 5.0]).sampled(H)
    joint = joint_gradient(log, model, sampled)
    alone = adjoint_gradient(log.with_signals(f_theta=model.predict(log.features)), sampled)
    assert np.allclose(joint.a, alone.a, rtol=1e-12, atol=0.0)
    assert np.allclose(joint.b, alone.b, rtol=1e-12, atol=0.0)


@pytest.mark.slow
@pytest.mark.parametrize("strategy", ["simultaneous", "alternating"])
@pytest.mark.parametrize("form", slow_but(("general",), ("lowpass", "general")))
def test_together_is_better_than_one_after_the_other(strategy, form):
    """Started from the best fit of the model alone: the filter and the model both move, on flights unseen too."""
    logs, others = [log_of(600, seed) for seed in (0, 1)], [log_of(600, 7)]
    model = Chebyshev(2, n_d=0)
    model = model.fit(
        np.concatenate([log.features for log in logs]), np.concatenate([log.label for log in logs])
    ).model
    start = PhyFilter([1.0, 2.0])
    only_filter = learn_jointly(logs, _Fixed(model), start, form=form, strategy=strategy, max_iterations=100)
    result = learn_jointly(
        logs, model, start, form=form, strategy=strategy, max_iterations=150, held_out=others
    )
    assert result.status in ("converged", "iteration_limit"), result.message
    assert result.rmse < only_filter.rmse < only_filter.history[0]
    assert result.held_out[0] > 1.2 * min(result.held_out)
    assert np.all(np.diff(result.history) <= 1e-12)


class _Fixed(Chebyshev):
    """A model that has nothing to learn any more: one parameter of no effect."""

    def __init__(self, model: LearnedModel) -> None:
        object.__setattr__(self, "_model", model)

    @property
    def parameters(self):
        return np.zeros(1)

    def with_parameters(self, parameters):
        return self

    def predict(self, z):
        return self._model.predict(z)

    def vjp(self, z, cotangent):
        return np.zeros(1)


def test_unfitted_model_is_fitted_first_and_result_is_deterministic():
    log = log_of(400)
    results = [
        learn_jointly(log, Network((4,), max_iterations=5), PhyFilter([3.0]), max_iterations=10) for _ in "ab"
    ]
    assert results[0].filter == results[1].filter
    assert np.array_equal(results[0].model.parameters, results[1].model.parameters)
    assert len(results[0].history) <= 11
    assert results[0].rmse == min(results[0].history)


def test_callback_stops():
    seen = []

    def watch(iteration, rmse):
        seen.append((iteration, rmse))
        return iteration == 2

    result = learn_jointly(log_of(), Chebyshev(2, n_d=0), PhyFilter([3.0]), callback=watch)
    assert result.status == "cancelled"
    assert [rmse for _, rmse in seen] == list(result.history[1:3])


def test_what_is_refused():
    log = log_of(50)
    with pytest.raises(ValueError, match="features"):
        learn_jointly(log.with_signals(features=None), Chebyshev(2, n_d=0), PhyFilter([3.0]))
    with pytest.raises(ValueError, match="label"):
        learn_jointly(log.with_signals(label=None), Chebyshev(2, n_d=0), PhyFilter([3.0]))
    with pytest.raises(ValueError, match="euler"):
        learn_jointly(log, Chebyshev(2, n_d=0), PhyFilter([3.0]).sampled(H, method="euler"))
    with pytest.raises(ValueError, match="strategy"):
        learn_jointly(log, Chebyshev(2, n_d=0), PhyFilter([3.0]), strategy="both")
