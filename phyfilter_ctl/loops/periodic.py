"""A diagram with sampled blocks as a linear system whose period H is the common multiple of all sampling periods.

At its instants the sampled blocks run, a linear map of (x, s, z); between them x' = fx x + fz z + fu u, integrated by
the matrix exponential.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias, cast

import numpy as np
from scipy.linalg import expm

from .._sections import FloatArray
from .hyperperiod import Instants

__all__ = ["Flow", "Instant", "Law", "Matrix", "PeriodicModel", "Wired", "held", "replaced", "scaled"]


class Instant(NamedTuple):
    """Derivatives at an instant: of the state (x, s, z) after it, and of the outputs, by state and inputs before."""

    J: FloatArray
    K: FloatArray
    C: FloatArray
    D: FloatArray


class Flow(NamedTuple):
    """Derivatives between instants: of x' and of the outputs, by x, z and u."""

    fx: FloatArray
    fz: FloatArray
    fu: FloatArray
    gx: FloatArray
    gz: FloatArray
    gu: FloatArray


# Checked as if real; complex where the factor is.
Matrix: TypeAlias = FloatArray
# (C, D) of outputs y = C state + D d -> (P, R): what the inputs are then, d = P state + R w.
Law: TypeAlias = Callable[[FloatArray, FloatArray], tuple[Matrix, Matrix]]


def held(C: FloatArray, D: FloatArray) -> tuple[Matrix, Matrix]:
    """d = w."""
    return np.zeros((D.shape[1], C.shape[1])), np.eye(D.shape[1])


def replaced(C: FloatArray, D: FloatArray) -> tuple[Matrix, Matrix]:
    """y + d = w: what reads the signal reads w instead."""
    inverse = np.linalg.inv(np.eye(len(D)) + D)
    return -(inverse @ C), np.asarray(inverse, dtype=float)


def scaled(factor: complex) -> Law:
    """y + d = factor y: what reads the signal reads it times the factor."""

    def law(C: FloatArray, D: FloatArray) -> tuple[Matrix, Matrix]:
        extra = cast(float, factor) - 1.0
        inverse = np.linalg.inv(np.eye(len(D)) - extra * D)
        return extra * inverse @ C, np.zeros((len(D), 0))

    return law


@dataclass(frozen=True, eq=False)
class PeriodicModel:
    """Linear at the instants of a hyperperiod and between them; made by ``settled``.

    Parameters
    ----------
    instants : Instants
    sizes : tuple of int
        Numbers of x, s and z.
    at : sequence of Instant
        One for each instant.
    between : sequence of Flow
        After each instant; one and the same object where nothing changes.
    """

    instants: Instants
    sizes: tuple[int, int, int]
    at: Sequence[Instant]
    between: Sequence[Flow]

    def wired(self, inputs: slice, outputs: slice, law: Law) -> Wired:
        """The model with these inputs made from these outputs and what is held, w; the other inputs at rest."""
        n_x, n_s, _ = self.sizes
        at, flows, known = [], [], {}
        for instant, flow in zip(self.at, self.between, strict=True):
            J, K, C, D = instant.J, instant.K[:, inputs], instant.C[outputs], instant.D[outputs, inputs]
            P, R = law(C, D)
            at.append((J + K @ P, K @ R, C + D @ P, D @ R))
            if id(flow) not in known:
                g = np.hstack([flow.gx[outputs], np.zeros((len(D), n_s)), flow.gz[outputs]])
                gu = flow.gu[outputs, inputs]
                P, R = law(g, gu)
                f = np.hstack([flow.fx, np.zeros((n_x, n_s)), flow.fz])
                M = np.hstack([f + flow.fu[:, inputs] @ P, flow.fu[:, inputs] @ R])
                known[id(flow)] = M, np.hstack([g + gu @ P, gu @ R])
            flows.append(known[id(flow)])
        return Wired(self.instants, n_x, at, flows)


@dataclass(frozen=True, eq=False)
class Wired:
    """Steps of the state (x, s, z), with w held: after = A state + B w at an instant, y = C state + D w there.

    Parameters
    ----------
    instants : Instants
    n_x : int
        Continuous states, the first ones.
    at : sequence of (A, B, C, D)
    flows : sequence of pairs of arrays
        x' (n_x, states + w) and y (outputs, states + w) by state and w after each instant.
    """

    instants: Instants
    n_x: int
    at: Sequence[tuple[Matrix, Matrix, Matrix, Matrix]]
    flows: Sequence[tuple[Matrix, Matrix]]
    _known: dict[tuple[int, float], Matrix] = field(default_factory=dict, repr=False)

    @property
    def order(self) -> int:
        return len(self.at[0][0])

    @property
    def width(self) -> int:
        """Entries of w."""
        return self.at[0][1].shape[1]

    def passed(self, state: Matrix, w: Matrix, j: int, length: float) -> Matrix:
        """The state some time after instant j."""
        key = id(self.flows[j]), round(length / self.instants.period, 14)
        if key not in self._known:
            flow = self.flows[j][0]
            padded = np.zeros((flow.shape[1],) * 2, dtype=flow.dtype)
            np.multiply(flow, length, out=padded[: self.n_x])
            self._known[key] = cast(Matrix, expm(padded)[: self.n_x])
        return np.concatenate([self._known[key] @ np.concatenate([state, w]), state[self.n_x :]])

    def lifted(self, grid: Sequence[int]) -> tuple[Matrix, Matrix, Matrix, Matrix]:
        """(A, B, C, D) over a hyperperiod: w held from each instant of the grid to the next, y there.

        Ordered by instant, then by signal.
        """
        n, m = self.order, self.width
        size = n + m * len(grid)
        state: Matrix = np.eye(n, size)
        w: Matrix = np.zeros((m, size))
        rows = []
        for j, (A, B, C, D) in enumerate(self.at):
            if j in grid:
                w = np.eye(m, size, n + m * list(grid).index(j))
                rows.append(C @ state + D @ w)
            state = A @ state + B @ w
            state = self.passed(state, w, j, float(self.instants.lengths[j]))
        y = np.concatenate(rows)
        return state[:, :n], state[:, n:], y[:, :n], y[:, n:]

    def monodromy(self) -> Matrix:
        """The state after a hyperperiod by that before it, w = 0."""
        state: Matrix = np.eye(self.order)
        w = np.zeros((self.width, self.order))
        for j, (A, _, _, _) in enumerate(self.at):
            state = self.passed(A @ state, w, j, float(self.instants.lengths[j]))
        return state
