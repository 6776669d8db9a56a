"""A filter as matrices: python-control's form of it, from the signals x, g and f_theta to f_hat.

Here for both who need them, the sampled filter itself and the blocks of diagrams.
"""

from __future__ import annotations

from collections.abc import Sequence

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray, continuous_matrices, side_by_side
from . import windows
from .recursion import Recursion

Matrices = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


def refuse_nonlinear(recursion: Recursion) -> None:
    """Options that no linear system has."""
    for option in ("limit", "g_limit", "nonfinite"):
        if option in recursion.sampling.unusual:
            raise ValueError(
                f"{option}={recursion.sampling.unusual[option]!r} has no linear block: clamp or check the signals "
                f"around the block, or leave {option} at its default"
            )


def signal_labels(n_x: int, n_f: int, f_theta: bool = True) -> tuple[list[str], list[str]]:
    """Inputs and outputs, with or without f_theta."""
    counts = (("x", n_x), ("g", n_x), ("f_theta", n_f if f_theta else 0))
    inputs = [f"{signal}[{i}]" for signal, count in counts for i in range(count)]
    return inputs, [f"f_hat[{i}]" for i in range(n_f)]


def sampled_matrices(
    recursion: Recursion, momentum: FloatArray, E_left: FloatArray, f_theta: bool = True
) -> tuple[Matrices, FloatArray]:
    """q_k: what samples up to k - 1 add to w_k. w_k = q_k + B P_0 in_k, q_{k+1} = A w_k + B (P_1 in_k + register).

    in_k = (x, g, f_theta), or (x, g) without ``f_theta``, which is then 0.
    """
    transitions = recursion.transitions
    dA, B, C = side_by_side(transitions * len(E_left) if len(transitions) == 1 else transitions)
    A = np.eye(len(dA)) + dA
    n_f, n_x = E_left.shape
    steps = recursion.sampling.delay_steps
    weights_g = windows.mean_weights(recursion.sampling.g, steps)
    weights_f = windows.mean_weights(recursion.sampling.f_theta, steps)
    taps = max(2, len(weights_g), len(weights_f) if f_theta else 0)
    weights_g = np.pad(weights_g, (0, taps - len(weights_g)))
    weights_f = np.pad(weights_f, (0, max(0, taps - len(weights_f))))[:taps]
    eye = np.eye(n_f)[:, : n_f if f_theta else 0]
    P = [
        np.hstack([0.0 * momentum, -wg * E_left, -wf * eye])
        for wg, wf in zip(weights_g, weights_f, strict=True)
    ]
    P[0][:, :n_x] += momentum / recursion.sampling.dt
    P[1][:, :n_x] -= momentum / recursion.sampling.dt

    # Register of the inputs in_{k-1}, in_{k-2}, ... that a delay still needs: r_1 is the newest.
    width, kept = n_x + n_x + eye.shape[1], taps - 2
    size = len(A) + kept * width
    state, inputs = np.zeros((size, size)), np.zeros((size, width))
    states = len(A)
    state[:states, :states] = A
    inputs[:states] = A @ B @ P[0] + B @ P[1]
    for j in range(kept):
        columns = slice(states + j * width, states + (j + 1) * width)
        state[:states, columns] = B @ P[j + 2]
        if j == 0:
            inputs[columns] = np.eye(width)
        else:
            state[columns, states + (j - 1) * width : states + j * width] = np.eye(width)
    output = np.hstack([C, np.zeros((n_f, size - states))])
    through = C @ B @ P[0] + np.hstack([np.zeros((n_f, 2 * n_x)), eye])
    # At rest on constant inputs: w_0 = 0 and every register filled with the first sample.
    rest = np.vstack([-B @ P[0], *([np.eye(width)] * kept)])
    return (state, inputs, output, through), rest


def channel_counts(filters: int, direction: FloatArray | None, channels: int | None) -> tuple[int, int]:
    """n_x and n_f of a block, from what tells them: E, one filter for each channel, or ``channels``."""
    if channels is not None and channels < 1:
        raise ValueError(f"channels: expected at least 1, got {channels}")
    n_x = direction.shape[0] if direction is not None else channels or (filters if filters > 1 else None)
    if n_x is None:
        raise ValueError("channels: expected the number of channels of x; one filter alone does not tell it")
    if channels is not None and channels != n_x:
        raise ValueError(
            f"channels: {channels} contradicts the {n_x} {'filters' if direction is None else 'rows of E'}"
        )
    n_f = direction.shape[1] if direction is not None else n_x
    if filters not in (1, n_f):
        raise ValueError(f"{filters} filters for {n_f} channels: expected one, or one per channel")
    return n_x, n_f


def checked_learned(f_theta: object) -> bool:
    """Whether a block has inputs for f_theta."""
    if not isinstance(f_theta, bool):
        raise TypeError(
            f"f_theta: expected True (the block has inputs for a learned model) or False (it has none), got {f_theta!r}"
        )
    return f_theta


def constant_inertia(inertia: ArrayLike | None, n_x: int) -> FloatArray:
    """M_hat as a matrix (n_x, n_x), I for None."""
    M = _signals.real("inertia", 1.0 if inertia is None else inertia)
    if M.ndim < 2:
        M = np.diag(np.broadcast_to(M, (n_x,))) if M.shape in ((), (n_x,)) else M
    if M.shape != (n_x, n_x) or not np.all(np.isfinite(M)):
        raise ValueError(
            f"inertia: expected a finite number or shape ({n_x},) or ({n_x}, {n_x}), constant, got shape {M.shape}; "
            "an inertia that changes is an input of the sampled filter's run and step"
        )
    return M


def state_labels(orders: Sequence[int], count: int) -> list[str]:
    """Section states of channels of these orders, and what a delay remembers."""
    labels = [f"w[{i},{j}]" for i, order in enumerate(orders) for j in range(order)]
    return labels + [f"past[{j}]" for j in range(count - len(labels))]


def sampled_state_space(
    recursion: Recursion, channels: int | None, inertia: ArrayLike | None
) -> ct.StateSpace:
    """See :meth:`SampledPhyFilter.to_ss`."""
    refuse_nonlinear(recursion)
    count, direction = len(recursion.chains), recursion.E
    channels, inertia = recursion.sampling.channels_or(channels), recursion.sampling.inertia_or(inertia)
    alone = channels is None and count == 1 and direction is None
    n_x, n_f = channel_counts(count, direction, 1 if alone else channels)
    E_left = np.eye(n_x) if recursion.E_left is None else recursion.E_left
    matrices, _ = sampled_matrices(recursion, E_left @ constant_inertia(inertia, n_x), E_left)
    orders = [len(chain.C) for chain in recursion.chains] * (n_f if count == 1 else 1)
    inputs, outputs = signal_labels(n_x, n_f)
    return ct.StateSpace(
        *matrices,
        recursion.sampling.dt,
        inputs=inputs,
        outputs=outputs,
        states=state_labels(orders, len(matrices[0])),
        name="phyfilter",
        remove_useless_states=False,
    )


def continuous_state_space(sections: Sequence[tuple[FloatArray, FloatArray, FloatArray]]) -> ct.StateSpace:
    """See :meth:`PhyFilter.state_space`; one chain of sections per channel."""
    eye = np.eye(len(sections))
    matrices, _ = continuous_matrices(sections, eye, eye)
    inputs, outputs = signal_labels(len(eye), len(eye))
    return ct.StateSpace(
        *matrices,
        inputs=inputs,
        outputs=outputs,
        states=state_labels([len(C) for _, _, C in sections], len(matrices[0])),
        name="phyfilter",
        remove_useless_states=False,
    )
