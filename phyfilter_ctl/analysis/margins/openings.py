"""The inner loop opened where the inertia acts: from s = M_hat x' as measured to p, the force that the actuators give.

    s = mu p,    mu = M_hat M^-1

M moves or not, what is left is linear and time-invariant: (A, B, C) from s to p, closed by mu. With tau = -f_hat

    continuous      w' = A_F w + B_F (s - tau),  f_hat = C_F w,  p = Act tau
    sampled         s_k = M_hat (x_k - x_{k-1})/h,  w_k = w_{k-1} + dA (w_{k-1} - e (s_k - mean of tau)),
                    p the force over the step to come, of which s_{k+1} is the mean of mu p
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag, matrix_balance

from ..._sections import FloatArray, expm1
from ...filter import PhyFilter
from ...filter.windows import mean_weights
from ...values.actuator import Actuator
from ._continuous import ContinuousLoop
from .sampled import SampledLoop
from .sweep import Characteristic

__all__ = ["Opening", "open_at_inertia", "side_by_side"]

# Nodes for the mean square of the force over a step, and the decay over which one set of them is enough.
_NODES, _DECAY = 16, 4.0
# Directions of the force within a step that are smaller than this come from rounding.
_NOTHING = 1e-14


@dataclass(frozen=True, eq=False)
class Opening:
    """x' or x+ = A x + B s, p = C x, one s and p for each axis; dt is None in continuous time.

    Sampled, p is the mean of the actuator's force over the coming step, and |spread x|^2 its mean square: while M moves
    within the step, s differs from mu C x by no more than the deviation of mu times |spread x|.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    spread: FloatArray
    dt: float | None

    @property
    def axes(self) -> int:
        return len(self.C)

    @property
    def is_even(self) -> bool:
        """Whether the force keeps to one value over the step, so that only the mean of mu over the step counts."""
        return len(self.spread) == self.axes

    @property
    def clock(self) -> float:
        """A power of two near the loop's speed in rad/s; 1 sampled."""
        if self.dt is not None:
            return 1.0
        size = float(np.abs(self.closed(np.eye(self.axes))).max())
        return float(np.exp2(np.round(np.log2(size))))

    def by_clock(self) -> Opening:
        """The same with time counted in 1/clock: a Lyapunov function of one is one of the other."""
        return replace(self, A=self.A / self.clock, B=self.B / self.clock)

    def closed(self, mu: FloatArray | float) -> FloatArray:
        """State matrix at a constant mu = M_hat M^-1."""
        return self.A + self.B @ np.atleast_2d(mu) @ self.C

    def growth(self, matrix: FloatArray) -> float:
        """Rate in 1/s at which the slowest state of a closed loop dies out or grows."""
        values = np.linalg.eigvals(matrix)
        if self.dt is None:
            return float(values.real.max())
        return float(np.log(max(float(np.abs(values).max()), 1e-300))) / self.dt


def open_at_inertia(loop: Characteristic) -> Opening:
    """One axis: a loop without outer gains, in coordinates scaled by powers of two (nothing is rounded).

    Raises
    ------
    ValueError
        If the loop is continuous with delay: it has no finite state.
    """
    if isinstance(loop, ContinuousLoop):
        if loop.delay:
            raise ValueError(
                f"delay: {loop.delay:g} s in continuous time leaves the loop without a finite state; give dt, the step "
                "at which the filter runs"
            )
        return _balanced(_continuous(loop.filter, loop.actuator))
    if isinstance(loop, SampledLoop):
        return _balanced(_sampled(loop))
    raise TypeError(f"loop: expected one of a filter, got {type(loop).__name__}")


def side_by_side(openings: Sequence[Opening]) -> Opening:
    """Several axes, each with its own filter."""
    parts = ([getattr(each, name) for each in openings] for name in ("A", "B", "C", "spread"))
    A, B, C, spread = (np.asarray(block_diag(*part), dtype=float) for part in parts)
    return Opening(A, B, C, spread, openings[0].dt)


def _continuous(filter: PhyFilter, actuator: Actuator) -> Opening:
    n, (Aa, Ba, Ca, Da) = filter.order, actuator.matrices
    A = np.diag(np.ones(n - 1), 1)
    A[-1] = -filter.a
    B = np.zeros((n, 1))
    B[-1] = 1.0
    F = filter.b[None]
    whole = np.block([[A + B @ F, np.zeros((n, len(Aa)))], [-Ba @ F, Aa]])
    C = np.hstack([-Da @ F, Ca])
    return Opening(whole, np.vstack([B, np.zeros_like(Ba)]), C, C, None)


def _sampled(loop: SampledLoop) -> Opening:
    """States: actuator, w of the step before, the commands sent before, s."""
    transition, newer, older, whole = loop.plant
    h, m = loop.sampled.dt, len(transition) - 2
    dA, equilibrium, F = loop.sampled.transition
    late = (loop.delay + loop.sampled.sampling.delay) / h
    weights = mean_weights("hold", loop.sampled.sampling.delay / h)
    n, past = len(dA), max(whole + 1, len(weights) - 1)
    size = m + n + past + 1
    unit = np.eye(size)
    x, w, sent, s = unit[:m], unit[m : m + n], unit[m + n : -1], unit[-1]
    change = dA @ w - np.outer(dA @ equilibrium, s - weights[1:] @ sent[: len(weights) - 1])
    line = np.concatenate([[-F @ (w + change)], sent])  # commands sent at k, k - 1, ...

    def force(row: int) -> FloatArray:
        return transition[row, :m] @ x + newer[row] * line[whole] + older[row] * line[whole + 1]

    steps = [x[i] + force(i) for i in range(m)]
    A = np.array([*steps, *(w + change), *line[:past], np.zeros(size)])
    parts = _root_mean_square(loop.actuator, h, (late - whole) * h)
    spread = parts @ np.array([*x, line[whole], line[whole + 1]])
    C = (force(m) / h)[None]
    return Opening(A, unit[:, -1:], C, C if len(parts) == 1 else spread, h)


def _root_mean_square(actuator: Actuator, h: float, late: float) -> FloatArray:
    """R with mean over a step of p(t)^2 = |R (x, newer, older)|^2: p from the actuator's state and the commands.

    The older command acts for the first ``late`` seconds.
    """
    A, B, C, D = actuator.matrices
    m = len(A)
    flow = np.zeros((m + 1, m + 1))
    flow[:m, :m], flow[:m, m:] = A, B
    out = np.append(C[0], D[0, 0])
    pieces = max(1, int(np.ceil(h * np.abs(A).sum(axis=1).max(initial=0.0) / _DECAY)))
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    fractions = 0.5 * (nodes + 1.0)
    rows, before = [], np.eye(m + 2)[:m]  # the actuator's state at the beginning of the piece
    for column, length in ((m + 1, late), (m, h - late)):
        held = np.eye(m + 2)[column : column + 1]
        for _ in range(pieces if length > 0.0 else 0):
            start = np.vstack([before, held])
            flows = np.eye(m + 1) + expm1(flow, np.append(fractions, 1.0) * (length / pieces))
            rows += list(np.sqrt(0.5 * weights * length / (pieces * h))[:, None] * (out @ flows[:-1] @ start))
            before = (flows[-1] @ start)[:-1]
    _, sizes, directions = np.linalg.svd(np.array(rows), full_matrices=False)
    return (sizes[:, None] * directions)[sizes > _NOTHING * sizes[0]]


def _balanced(opening: Opening) -> Opening:
    _, (scale, _) = matrix_balance(opening.closed(1.0), permute=False, separate=True)
    B, C, spread = opening.B / scale[:, None], opening.C * scale, opening.spread * scale
    share = float(np.exp2(np.round(0.5 * np.log2(np.abs(C).max() / np.abs(B).max()))))
    return Opening(opening.A * scale / scale[:, None], share * B, C / share, spread / share, opening.dt)
