"""The filter as python-control blocks, to be wired with ``control.interconnect`` like any other system."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray, continuous_matrices, side_by_side
from ..filter import PhyFilter, SampledPhyFilter, windows

__all__ = ["PhyFilterBlock", "phyfilter_block"]


class PhyFilterBlock(ct.StateSpace):
    """A PhyFilter as a python-control state-space system; made by :func:`phyfilter_block`.

    It behaves as any ``control.StateSpace``; beyond that it knows the state of a bumpless start.

    Parameters
    ----------
    matrices : tuple of arrays
        A, B, C and D.
    rest : (states, inputs) array
        Maps the first inputs to the state of rest.
    dt : float
        0 for a continuous block, else the sampling interval in seconds.
    **names
        ``inputs``, ``outputs``, ``states`` and ``name`` as for ``control.ss``.
    """

    def __init__(self, matrices: tuple[FloatArray, ...], rest: FloatArray, dt: float, **names: Any) -> None:
        super().__init__(*matrices, dt, remove_useless_states=False, **names)
        self._rest = rest

    def rest_state(
        self, x0: ArrayLike, g0: ArrayLike | None = None, f_theta0: ArrayLike | None = None
    ) -> FloatArray:
        """Initial state for ``control.input_output_response`` with which f_hat starts at f_theta.

        Parameters
        ----------
        x0, g0 : (n_x,) arrays
            Measurement and known part at the first sample; None means 0.
        f_theta0 : (n_f,) array, optional
            Learned model at the first sample.

        Returns
        -------
        (states,) array

        Raises
        ------
        ValueError
            For wrong shapes.

        Examples
        --------
        >>> block = phyfilter_block(PhyFilter([20.0]), 1)
        >>> block.rest_state([3.0]).tolist()
        [-60.0]
        """
        counts = [sum(label.startswith(signal + "[") for label in self.input_labels) for signal in _INPUTS]
        first = []
        for signal, count, value in zip(_INPUTS, counts, (x0, g0, f_theta0), strict=True):
            given = np.zeros(count) if value is None else np.atleast_1d(_signals.real(f"{signal}0", value))
            first.append(_signals.array(f"{signal}0", given, (count,)))
        return self._rest @ np.concatenate(first)


_INPUTS = ("x", "g", "f_theta")


def phyfilter_block(
    filter: PhyFilter | SampledPhyFilter | Sequence[PhyFilter],
    channels: int | None = None,
    *,
    name: str = "phyfilter",
    inertia: ArrayLike | None = None,
) -> PhyFilterBlock:
    """A filter as a python-control system with named signals.

    Parameters
    ----------
    filter : PhyFilter, SampledPhyFilter or sequence of PhyFilter
        A continuous filter gives a continuous block, a sampled one a discrete block at its rate; a sequence one
        filter per channel.
    channels : int, optional
        Number n_x of channels of x; needed where neither E nor one filter per channel tells it.
    name : str
        Name of the block.
    inertia : float, (n_x,) or (n_x, n_x) array, optional
        Constant inertia M_hat; None means I.

    Returns
    -------
    PhyFilterBlock
        Inputs x[0] ..., g[0] ..., f_theta[0] ...; outputs f_hat[0] ...

    Raises
    ------
    ValueError
        For a missing or contradictory number of channels, a wrong inertia, or a sampled filter with an option that no
        linear block has (limit, nonfinite="hold").

    Notes
    -----
    Continuous: z = w - B M x takes the place of the section states w, so x is not differentiated. Sampled: the n
    states of a channel are what the samples up to now add to the next one; a delayed measurement adds a shift
    register of g and f_theta.

    Examples
    --------
    A mass pushed by an unknown constant 3 N; the filter finds it.

    >>> import control as ct
    >>> plant = ct.ss([[0.0]], [[1.0]], [[1.0]], [[0.0]], inputs="f[0]", outputs="x[0]", name="mass")
    >>> loop = ct.interconnect([plant, phyfilter_block(PhyFilter([20.0]), 1)],
    ...                        inputs=["f[0]", "g[0]", "f_theta[0]"], outputs=["f_hat[0]"])
    >>> response = ct.forced_response(loop, [0.0, 1.0], [[3.0, 3.0], [0.0, 0.0], [0.0, 0.0]])
    >>> float(response.outputs[0, -1].round(6))
    3.0
    """
    if isinstance(filter, SampledPhyFilter):
        for option in ("limit", "nonfinite"):
            if option in filter.sampling.unusual:
                raise ValueError(
                    f"{option}={filter.sampling.unusual[option]!r} has no linear block: clamp or check the signals "
                    f"around the block, or leave {option} at its default"
                )
        filters, direction = filter.filters, filter.E
    else:
        filters = (filter,) if isinstance(filter, PhyFilter) else tuple(filter)
        direction = None
    n_x, n_f = channel_counts(len(filters), direction, channels)
    filters = filters * n_f if len(filters) == 1 else filters
    E_left = filter.recursion.E_left if isinstance(filter, SampledPhyFilter) else None
    E_left = np.eye(n_x) if E_left is None else E_left
    momentum = E_left @ constant_inertia(inertia, n_x)
    if isinstance(filter, SampledPhyFilter):
        matrices, rest = _sampled_matrices(filter, momentum, E_left)
        dt = filter.dt
    else:
        matrices, rest = continuous_matrices([entry.sections for entry in filters], momentum, E_left)
        dt = 0.0
    labels = (
        [f"x[{i}]" for i in range(n_x)]
        + [f"g[{i}]" for i in range(n_x)]
        + [f"f_theta[{i}]" for i in range(n_f)]
    )
    return PhyFilterBlock(
        matrices,
        rest,
        dt,
        inputs=labels,
        outputs=[f"f_hat[{i}]" for i in range(n_f)],
        states=_state_labels(filters, len(matrices[0])),
        name=name,
    )


def _sampled_matrices(
    sampled: SampledPhyFilter, momentum: FloatArray, E_left: FloatArray
) -> tuple[tuple[FloatArray, ...], FloatArray]:
    """q_k: what samples up to k - 1 add to w_k. w_k = q_k + B P_0 in_k, q_{k+1} = A w_k + B (P_1 in_k + register)."""
    transitions = sampled.recursion.transitions
    dA, B, C = side_by_side(transitions * len(E_left) if len(transitions) == 1 else transitions)
    A = np.eye(len(dA)) + dA
    n_f, n_x = E_left.shape
    steps = sampled.sampling.delay_steps
    weights_g = windows.mean_weights(sampled.sampling.g, steps)
    weights_f = windows.mean_weights(sampled.sampling.f_theta, steps)
    taps = max(2, len(weights_g), len(weights_f))
    weights_g = np.pad(weights_g, (0, taps - len(weights_g)))
    weights_f = np.pad(weights_f, (0, taps - len(weights_f)))
    eye = np.eye(n_f)
    P = [
        np.hstack([0.0 * momentum, -wg * E_left, -wf * eye])
        for wg, wf in zip(weights_g, weights_f, strict=True)
    ]
    P[0][:, :n_x] += momentum / sampled.dt
    P[1][:, :n_x] -= momentum / sampled.dt

    # Register of the inputs in_{k-1}, in_{k-2}, ... that a delay still needs: r_1 is the newest.
    width, kept = n_x + n_x + n_f, taps - 2
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
        raise ValueError(f"channels: {channels} contradicts the {n_x} rows of E")
    n_f = direction.shape[1] if direction is not None else n_x
    if filters not in (1, n_f):
        raise ValueError(f"{filters} filters for {n_f} channels: expected one, or one per channel")
    return n_x, n_f


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


def _state_labels(filters: tuple[PhyFilter, ...], count: int) -> list[str]:
    labels = [f"w[{i},{j}]" for i, entry in enumerate(filters) for j in range(entry.order)]
    return labels + [f"past[{j}]" for j in range(count - len(labels))]
