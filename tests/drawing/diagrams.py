"""Random diagrams: scalar and vector, nested, of several rates, with algebraic loops; the same for the same seed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import control as ct
import numpy as np

import phyfilter_ctl as pf

Rng = np.random.Generator
# Periods in seconds of sampled blocks.
PERIODS = (0.01, 0.02, 0.05)
GAINS = (1.0, 1.0, 1.0, -1.0, -1.0, 2.5, -0.4)


@dataclass(frozen=True)
class _Port:
    """A vector of a block: number of the block, first row among all signals, and how many."""

    block: int
    first: int
    size: int

    @property
    def rows(self) -> np.ndarray:
        return self.first + np.arange(self.size)


def random_diagram(
    seed: int, count: int, *, size: int = 1, nested: int = 0, sampled: float = 0.2, name: str = "loop"
) -> ct.InterconnectedSystem:
    """A diagram of some blocks: a chain as far as sizes fit, the rest wired at random, so with loops of all kinds.

    Vectors have that size; diagrams inside, two or three blocks each, are nested that deep; a share of the blocks is
    sampled, at one of three periods.
    """
    rng = np.random.default_rng(seed)
    parts = [_part(rng, f"b{k}", size, nested, sampled) for k in range(count)]
    into, out = (
        _ports([getattr(part, kind) for part in parts]) for kind in ("input_labels", "output_labels")
    )
    n_u, n_y = (sum(port.size for port in ports) for ports in (into, out))
    connect = np.zeros((n_u, n_y))
    for port in into:
        _wire(rng, connect, port, out)
    inputs, entering = [], np.zeros((n_u, 0))
    for label in ("r", "d") if rng.random() < 0.5 else ("r",):
        fitting = [port for port in into if port.size == into[0].size]
        port = into[0] if label == "r" else fitting[int(rng.integers(len(fitting)))]
        inputs += _labels(label, port.size)
        entering = np.hstack([entering, np.eye(n_u)[:, port.rows]])
    read = [next(port for port in out if port.block == count - 1)]
    if rng.random() < 0.5:
        read.append(out[int(rng.integers(len(out)))])
    outputs = [label for k, port in enumerate(read) for label in _labels(f"y{k}", port.size)]
    leaving = np.eye(n_y, n_y + n_u)[np.concatenate([port.rows for port in read])]
    diagram = ct.InterconnectedSystem(parts, inputs=inputs, outputs=outputs, name=name)
    diagram.connect_map, diagram.input_map, diagram.output_map = connect, entering, leaving
    return diagram


def _wire(rng: Rng, connect: np.ndarray, port: _Port, out: Sequence[_Port]) -> None:
    """Drive an input by the block before it, by another too at times; a vector that has no match by its entries."""
    fitting = [other for other in out if other.size == port.size]
    terms = [other for other in fitting if other.block == port.block - 1][:1]
    if fitting and (not terms or rng.random() < 0.35):
        terms.append(fitting[int(rng.integers(len(fitting)))])
    for k, other in enumerate(terms):
        connect[port.rows, other.rows] = float(rng.choice(GAINS)) if k else 1.0
    if not terms:
        connect[port.rows, rng.integers(connect.shape[1], size=port.size)] = 1.0


def _part(rng: Rng, name: str, size: int, nested: int, sampled: float) -> ct.InputOutputSystem:
    if nested and rng.random() < 0.3:
        return random_diagram(
            int(rng.integers(1 << 30)), int(rng.integers(2, 4)), size=size, nested=nested - 1, sampled=sampled,
            name=name,
        )  # fmt: skip
    wide = size if rng.random() < 0.6 else 1
    if rng.random() < sampled:
        law = ct.ss(
            0.5 * np.eye(wide), np.eye(wide), np.eye(wide), 0.0 * np.eye(wide), dt=float(rng.choice(PERIODS)),
            inputs=_labels("e", wide), outputs=_labels("u", wide), name=name,
        )  # fmt: skip
        return pf.sampled_block(law)
    kinds: list[Callable[..., ct.InputOutputSystem]] = [_nonlinear, _matrix]
    return kinds[int(rng.integers(2))](rng, name, wide) if wide > 1 else _scalar(rng, name)


def _scalar(rng: Rng, name: str) -> ct.InputOutputSystem:
    kind = int(rng.integers(8))
    one = {"inputs": "u", "outputs": "y", "name": name}
    if kind == 0:
        return ct.tf([1.0], [1.0, 0.0], **one)
    if kind == 1:
        return ct.tf([round(float(rng.uniform(-5, 5)), 2)], [1.0], **one)
    if kind == 2:
        order = int(rng.integers(1, 5))
        return ct.tf(
            [1.0, *rng.uniform(0.1, 2, order - 1).round(2)],
            [1.0, *rng.uniform(0.1, 40, order).round(2)],
            **one,
        )
    if kind == 3:
        return pf.transport_delay(["u"], 0.1, name=name)
    if kind == 4:
        return ct.summing_junction(["a", "-b"], "e", name=name)
    if kind == 5:
        return ct.ss(
            -np.eye(2), np.ones((2, 2)), np.ones((1, 2)), 0, inputs=["u", "d"], outputs=["y"], name=name
        )
    if kind == 6:
        return pf.lookup_table([-1.0, 0.0, 1.0], [-0.5, 0.0, 2.0], name=name)
    return _nonlinear(rng, name, 1)


def _nonlinear(rng: Rng, name: str, wide: int) -> ct.InputOutputSystem:
    return ct.nlsys(
        lambda t, x, u, params: -x + np.tanh(u[:wide]) + u[wide:],
        lambda t, x, u, params: np.concatenate([x, x**2]),
        inputs=[*_labels("force", wide), *_labels("wind", wide)],
        outputs=[*_labels("speed", wide), *_labels("power", wide)], states=wide, name=name,
    )  # fmt: skip


def _matrix(rng: Rng, name: str, wide: int) -> ct.InputOutputSystem:
    gain = rng.choice([-1.0, 0.0, 1.0, 2.5], size=(wide, wide)) + np.eye(wide)
    return ct.ss([], [], [], gain, inputs=_labels("u", wide), outputs=_labels("y", wide), name=name)


def _labels(name: str, wide: int) -> list[str]:
    return [name] if wide == 1 else [f"{name}[{k}]" for k in range(wide)]


def _ports(labels: Sequence[Sequence[str]]) -> list[_Port]:
    """Labels of one base are a vector."""
    sizes = [(k, len(list(group))) for k, own in enumerate(labels) for _, group in groupby(own, _base)]
    starts = np.cumsum([0, *(size for _, size in sizes)])
    return [_Port(k, int(start), size) for (k, size), start in zip(sizes, starts, strict=False)]


def _base(label: str) -> str:
    return label.split("[")[0]


def suite(count: int) -> list[tuple[str, dict[str, Any]]]:
    """(name, arguments) of so many random diagrams, each kind in turn; of 40 or fewer all are small."""
    cases: list[tuple[str, dict[str, Any]]] = []
    sizes, most = (
        ((2, 3, 4, 5, 6, 7, 8, 10), 4) if count <= 40 else ((2, 4, 6, 8, 12, 16, 20, 25, 30, 40), 20)
    )
    for seed in range(count):
        kind = ("scalar", "vector", "nested", "nested vector")[seed % 4]
        blocks = sizes[seed // 4 % len(sizes)]
        given: dict[str, Any] = {"seed": seed, "count": blocks if kind == "scalar" else min(blocks, 2 * most)}
        if "vector" in kind:
            given["size"] = 3
        if "nested" in kind:
            given |= {"nested": 2, "count": min(given["count"], most)}
        cases.append((f"{kind}, {given['count']} blocks, seed {seed}", given))
    return cases
