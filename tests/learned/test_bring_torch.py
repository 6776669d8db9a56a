"""PyTorch's modules as learned models, against their own forward passes and the reference evaluator of onnx."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.learned.onnx import OnnxNetwork

torch = pytest.importorskip("torch", reason="PyTorch is not installed (extra: torch)")
onnx = pytest.importorskip("onnx", reason="the package onnx is not installed (extra: onnx)")
pytest.importorskip("onnxscript", reason="the package onnxscript is not installed (extra: torch)")

# An export takes about a second.
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("default")]

nn = torch.nn
# Single precision there, double here, some twenty terms; and double on both sides, where constants such as epsilon
# are stored in single.
SINGLE, DOUBLE = 1e-5, 1e-7

Z = np.random.default_rng(0).standard_normal((20, 6))


class Branches(nn.Module):  # type: ignore[misc,name-defined]  # PyTorch's own metaclass
    """Paths beside each other, and a choice between two by the features."""

    def __init__(self) -> None:
        super().__init__()
        self.first, self.norm, self.second = nn.Linear(6, 16), nn.LayerNorm(16), nn.Linear(16, 16)
        self.last = nn.Linear(22, 3)
        self.register_buffer("mean", torch.full((6,), 0.25))

    def forward(self, z: torch.Tensor) -> torch.Tensor:
        h = nn.functional.silu(self.first((z - self.mean) / 2.0))
        h = h + nn.functional.gelu(self.second(self.norm(h)), approximate="tanh")
        f = self.last(torch.cat([h, z], -1)).clamp(-1.0, 1.0) * torch.linalg.norm(z, dim=-1, keepdim=True)
        return torch.where(z[:, :1] > 0.0, f, torch.atan2(z[:, 1:2], z[:, 2:3]) * f.mean(-1, keepdim=True))


def sequence(*middle: nn.Module) -> nn.Module:
    return nn.Sequential(nn.Linear(6, 16), *middle, nn.Linear(16, 3))


def modules() -> dict[str, nn.Module]:
    torch.manual_seed(0)
    return {
        "silu": sequence(nn.SiLU()),
        "gelu": sequence(nn.GELU(), nn.LayerNorm(16), nn.Softmax(-1)),
        "batch": sequence(nn.BatchNorm1d(16), nn.Dropout(0.5), nn.Hardswish(), nn.Mish()),
        "kinks": sequence(nn.ELU(), nn.PReLU(), nn.Hardtanh(), nn.Softplus()),
        "branches": Branches(),
        "attention": nn.Sequential(
            nn.Unflatten(1, (3, 2)), nn.TransformerEncoderLayer(2, 1, 8, batch_first=True), nn.Flatten()
        ),
    }


@pytest.mark.parametrize("name", modules())
@pytest.mark.parametrize("kind", [torch.float32, torch.float64])
def test_predictions_and_expression(name: str, kind: torch.dtype) -> None:
    module = modules()[name].to(kind)
    model = pf.learned_model(module, z=Z)
    assert module.training  # as it was
    expected = module.eval()(torch.from_numpy(Z).to(kind)).detach().numpy()
    atol = SINGLE if kind is torch.float32 else DOUBLE
    np.testing.assert_allclose(model.predict(Z), expected, rtol=0.0, atol=atol)
    np.testing.assert_allclose(model.casadi().map(20)(Z.T).full().T, model.predict(Z), rtol=0.0, atol=1e-12)


def test_gradient_is_that_of_torch() -> None:
    module = modules()["silu"].double()
    cotangent = np.random.default_rng(1).standard_normal((20, 3))
    module(torch.from_numpy(Z)).backward(torch.from_numpy(cotangent))
    expected = np.concatenate([p.grad.numpy().ravel() for p in module.parameters()])
    model = pf.learned_model(module)  # the first layer tells the number of features
    np.testing.assert_allclose(
        model.vjp(Z, cotangent), expected, rtol=0.0, atol=1e-12 * np.abs(expected).max()
    )


@pytest.mark.parametrize("samples", [1, 5])
def test_files_as_torch_writes_them(samples: int, tmp_path: Path) -> None:
    """By default: the newer exporter, weights in a file beside the model, sizes as in the example."""
    module = modules()["branches"].eval()
    example = torch.zeros(samples, 6)
    program = torch.onnx.export(module, (example,), tmp_path / "model.onnx", dynamo=True, verbose=False)
    assert (tmp_path / "model.onnx.data").exists()
    expected = module(torch.from_numpy(Z).float()).detach().numpy()
    for model in (pf.learned_model(tmp_path / "model.onnx"), pf.learned_model(program)):
        np.testing.assert_allclose(model.predict(Z), expected, rtol=0.0, atol=SINGLE)
    reference = importlib.import_module("onnx.reference").ReferenceEvaluator(
        onnx.load(str(tmp_path / "model.onnx"))
    )
    rows = Z[:samples].astype(np.float32)
    (by_reference,) = reference.run(None, {reference.input_names[0]: rows})
    found = OnnxNetwork.read(tmp_path / "model.onnx").predict(rows.astype(float))
    np.testing.assert_allclose(found, by_reference, rtol=0.0, atol=SINGLE)
    with pytest.raises(ValueError, match="is in an external file: give the path of the model"):
        pf.learned_model((tmp_path / "model.onnx").read_bytes())


def test_without_the_extra_its_name_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    with pytest.raises(ModuleNotFoundError, match=r"onnxscript: pip install 'phyfilter-ctl\[torch\]'"):
        pf.learned_model(nn.Linear(6, 3))


class Mean(nn.Module):  # type: ignore[misc,name-defined]
    def forward(self, z: torch.Tensor) -> torch.Tensor:
        return z - z.mean(0)


class Choice(nn.Module):  # type: ignore[misc,name-defined]
    def forward(self, z: torch.Tensor) -> torch.Tensor:
        return z if z.sum() > 0.0 else -z


class Convolution(nn.Module):  # type: ignore[misc,name-defined]
    def __init__(self) -> None:
        super().__init__()
        self.inner = nn.Conv1d(1, 2, 3)

    def forward(self, z: torch.Tensor) -> torch.Tensor:
        return self.inner(z[:, None]).flatten(1)


@pytest.mark.parametrize(
    ("module", "z", "words"),
    [
        (nn.GRU(6, 3), None, r"GRU: the number of features is unknown; give z of shape \(N, n_z\)"),
        (Mean(), Z, "translation of Mean differs from its own predictions"),
        (Choice(), Z, r"Choice: torch\.onnx\.export cannot translate it .*; export it to ONNX yourself"),
        (Convolution(), Z, r"operator 'Conv' is not supported \(node '.*'\); fit a Network"),
    ],
)
def test_what_is_refused_names_a_way_round(module: nn.Module, z: np.ndarray | None, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        pf.learned_model(module, z=z)
