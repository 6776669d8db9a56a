"""The layer for PyTorch: the same values and gradients, and PyTorch's own check of them."""

from __future__ import annotations

import importlib

import numpy as np
import pytest

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.design.adjoint import Adam
from phyfilter_ctl.design.adjoint.rollout import Rollout

torch = pytest.importorskip("torch", reason="the layer needs the extra torch")
torch_layer = importlib.import_module("phyfilter_ctl.design.torch_layer")
PhyFilterLayer, filter_signals = torch_layer.PhyFilterLayer, torch_layer.filter_signals

AGREE = 1e-9
H = 0.01
METHODS = ["exact", "euler", "tustin"]


def signals(*shape: int, seed: int = 0) -> list:
    rng = np.random.default_rng(seed)
    return [torch.from_numpy(0.1 * rng.standard_normal(shape)).requires_grad_() for _ in range(3)]


def coefficients(form: str) -> tuple:
    a = torch.tensor([100.0, 45.0, 12.0], dtype=torch.float64, requires_grad=True)
    b = torch.tensor([80.0, 20.0, 5.0], dtype=torch.float64, requires_grad=True)
    return a, b if form == "general" else None


@pytest.mark.parametrize("form", ["lowpass", "general"])
@pytest.mark.parametrize("method", METHODS)
def test_gradcheck(form, method):
    a, b = coefficients(form)
    sampled = PhyFilter([1.0]).sampled(H, method=method, g="average")
    # Coefficients of one size, so that one perturbation suits all.
    powers = torch.tensor([100.0, 10.0, 1.0], dtype=torch.float64)
    given = [part.detach() / powers for part in (a, b) if part is not None]
    given = [part.requires_grad_() for part in given]

    def layer(x, g, f_theta, *ab):
        return filter_signals(
            x, g, f_theta, a=ab[0] * powers, b=ab[1] * powers if len(ab) > 1 else None, sampled=sampled
        )

    assert torch.autograd.gradcheck(layer, (*signals(12, 2), *given), eps=1e-6, atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("form", ["lowpass", "general"])
@pytest.mark.parametrize("method", METHODS)
def test_same_gradient_as_the_rollout(form, method):
    a, b = coefficients(form)
    x, g, f_theta = signals(4, 90, 2)
    filter = PhyFilter(a.detach().numpy(), None if b is None else b.detach().numpy())
    sampled = filter.sampled(H, method=method)
    f_hat = filter_signals(x, g, f_theta, a=a, b=b, sampled=sampled)
    weights = torch.from_numpy(np.random.default_rng(3).standard_normal(f_hat.shape))
    (weights * f_hat).sum().backward()
    total_a, total_b = np.zeros(3), np.zeros(3)
    for i in range(4):
        rollout = Rollout(sampled)
        here = [part.detach().numpy()[i] for part in (x, g, f_theta)]
        trace = rollout.forward(rollout.inputs(*here))
        assert np.max(np.abs(trace.f_hat - f_hat.detach().numpy()[i])) < 1e-13
        back = rollout.backward(trace, weights.numpy()[i], signals=True)
        total_a += back.a
        total_b += 0.0 if back.b is None else back.b
        for tensor, reference in ((x, back.x), (g, back.g), (f_theta, back.f_theta)):
            assert np.linalg.norm(tensor.grad.numpy()[i] - reference) < AGREE * np.linalg.norm(reference)
    assert np.linalg.norm(a.grad.numpy() - total_a) < AGREE * np.linalg.norm(total_a)
    if b is not None:
        assert np.linalg.norm(b.grad.numpy() - total_b) < AGREE * np.linalg.norm(total_b)


@pytest.mark.parametrize("form", ["lowpass", "general"])
def test_same_gradient_as_a_loop_of_tensors(form):
    """PyTorch's own differentiation of the recursion, sample by sample."""
    a, b = coefficients(form)
    x, g, f_theta = signals(60, 2)
    sampled = PhyFilter(a.detach().numpy()).sampled(H, method="tustin")
    f_hat = filter_signals(x, g, f_theta, a=a, b=b, sampled=sampled)
    (f_hat**2).sum().backward()
    found = [part.grad.clone() for part in (x, g, f_theta, a, *([] if b is None else [b]))]
    for part in (x, g, f_theta, a, *([] if b is None else [b])):
        part.grad = None

    A = torch.cat([torch.eye(3, dtype=torch.float64)[1:], -a[None]])
    B = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    C = b if b is not None else torch.cat([a[:1], torch.zeros(2, dtype=torch.float64)])
    left = torch.eye(3, dtype=torch.float64) - 0.5 * H * A
    E, drive = (
        torch.linalg.solve(left, torch.eye(3, dtype=torch.float64) + 0.5 * H * A),
        torch.linalg.solve(left, H * B),
    )
    w, total = torch.zeros(3, 2, dtype=torch.float64), (f_theta[0] ** 2).sum()
    for k in range(1, len(x)):
        u = (x[k] - x[k - 1]) / H - g[k - 1] - 0.5 * (f_theta[k] + f_theta[k - 1])
        w = E @ w + drive[:, None] * u
        total = total + ((f_theta[k] + C @ w) ** 2).sum()
    total.backward()
    for one, part in zip(found, (x, g, f_theta, a, *([] if b is None else [b])), strict=True):
        assert torch.linalg.norm(one - part.grad) < AGREE * torch.linalg.norm(part.grad)


@pytest.mark.parametrize("coordinates", ["hurwitz", "coefficients"])
@pytest.mark.parametrize("b", [None, [80.0, 20.0, 5.0]])
def test_layer_starts_at_its_filter_and_learns(coordinates, b):
    filter = PhyFilter([100.0, 45.0, 12.0], b)
    layer = PhyFilterLayer(filter, H, coordinates=coordinates)
    assert np.allclose(layer.filter().a, filter.a, rtol=1e-12)
    assert np.allclose(layer.filter().b, filter.b, rtol=1e-12)
    t = H * torch.arange(500, dtype=torch.float64)
    f = torch.stack([torch.sin(2.0 * t), torch.cos(3.0 * t)], dim=1)
    x = H * torch.cumsum(f, dim=0)
    optimiser = torch.optim.Adam(layer.parameters(), lr=0.05)
    losses = []
    for _ in range(20):
        optimiser.zero_grad()
        loss = ((layer(x) - f) ** 2).mean()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    assert losses[-1] < losses[0]
    assert np.all(layer.filter().poles.real < 0.0)


def test_layer_behind_a_network_in_single_precision():
    model = torch.nn.Sequential(torch.nn.Linear(2, 4), torch.nn.Tanh(), torch.nn.Linear(4, 2))
    layer = PhyFilterLayer(PhyFilter([25.0, 8.0]), H)
    z = torch.randn(3, 50, 2, generator=torch.Generator().manual_seed(0))
    f_hat = layer(torch.cumsum(z, dim=1) * H, None, model(z))
    assert f_hat.dtype == torch.float32
    f_hat.square().sum().backward()
    assert all(torch.isfinite(p.grad).all() and p.grad.abs().sum() > 0 for p in model.parameters())
    assert set(layer.state_dict()) == {"theta"}


def test_adam_is_that_of_pytorch():
    rng = np.random.default_rng(0)
    p = rng.standard_normal(4)
    tensor = torch.from_numpy(p.copy()).requires_grad_()
    theirs = torch.optim.Adam([tensor], lr=0.03, eps=1e-12)
    ours, memory = Adam(0.03), None
    for _ in range(20):
        gradient = rng.standard_normal(4)
        tensor.grad = torch.from_numpy(gradient)
        theirs.step()
        p, memory = ours.step(p, gradient, memory)
    assert np.allclose(p, tensor.detach().numpy(), rtol=1e-12)


def test_what_is_refused():
    a = torch.tensor([20.0])
    sampled = PhyFilter([20.0]).sampled(H)
    with pytest.raises(ValueError, match="N, n_x"):
        filter_signals(torch.zeros(5), None, None, a=a, sampled=sampled)
    with pytest.raises(ValueError, match="g: expected the shape"):
        filter_signals(torch.zeros(5, 2), torch.zeros(5, 1), None, a=a, sampled=sampled)
    with pytest.raises(ValueError, match="Hurwitz"):
        filter_signals(torch.zeros(5, 2), None, None, a=-a, sampled=sampled)
    with pytest.raises(ValueError, match="coordinates"):
        PhyFilterLayer(PhyFilter([20.0]), H, coordinates="poles")
