"""The observers in their own differential equations: a route to f_hat that shares nothing with the filter.

The states written here are the ones integrated, exactly for x (and the integral of SEER-II) straight between samples
and everything else held at its mean over the step, in a loop over the samples by the matrix exponential.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Array = NDArray[np.float64]


def disturbance_observer(gain: float, x: Array, g: Array, times: Array) -> Array:
    """z' = -a_0 z - a_0 (a_0 x + g), f_hat = z + a_0 x; g (N - 1, n_x) held over the steps."""
    z = _integrated([[-gain]], times, (-(gain**2) * x)[..., None], (-gain * g)[..., None], -gain * x[:1].T)
    return z[..., 0] + gain * x


def linear_eso(w: float, x: Array, g: Array, times: Array) -> Array:
    """z_1' = z_2 + g + 2 w (x - z_1), z_2' = w^2 (x - z_1), f_hat = z_2."""
    A = [[-2.0 * w, 1.0], [-(w**2), 0.0]]
    start = np.stack([x[0], np.zeros_like(x[0])], axis=-1)
    return _integrated(A, times, x[..., None] * [2.0 * w, w**2], g[..., None] * [1.0, 0.0], start)[..., 1]


def feedback_neural_network(
    gain: float, x: Array, g: Array, times: Array, f_theta: Array, held_f_theta: Array
) -> Array:
    """xh' = g + f_theta + a_0 (x - xh), f_hat = f_theta + a_0 (x - xh); held_f_theta (N - 1, n_x) over the steps."""
    x_hat = _integrated([[-gain]], times, gain * x[..., None], (g + held_f_theta)[..., None], x[0][:, None])
    return f_theta + gain * (x - x_hat[..., 0])


def evolver(
    gain: float,
    x: Array,
    g: Array,
    times: Array,
    slope: Array,
    start: Array,
    path: Array | None = None,
    jumps: Array | None = None,
) -> Array:
    """xi' = slope - a_0 (g + xi + path + a_0 x), f_hat = xi + path + a_0 x, from f_hat(0) = start.

    slope (N - 1, n_x) held over the steps; path (N, n_x), the integral of SEER-II, straight between samples; jumps
    (N, n_x) of xi at the samples.
    """
    beside = gain * x if path is None else gain * x + path
    kicks = None if jumps is None else jumps[1:, :, None]
    first = (start - beside[0])[:, None]
    xi = _integrated(
        [[-gain]], times, (-gain * beside)[..., None], (slope - gain * g)[..., None], first, kicks
    )
    return xi[..., 0] + beside


def _integrated(
    A: list[list[float]], times: Array, straight: Array, held: Array, start: Array, kicks: Array | None = None
) -> Array:
    """States q (N, K, n) of q' = A q + straight(t) + held, exact; ``kicks`` are added at the ends of the steps."""
    n = len(A)
    states = [start]
    for k, h in enumerate(np.diff(times)):
        # The exponential of [[A, I, 0], [0, 0, I], [0, 0, 0]] h: e^{Ah}, int e^{As} ds, int e^{A(h-s)} s ds.
        augmented = np.zeros((3 * n, 3 * n))
        augmented[:n, :n] = A
        augmented[: 2 * n, n:] += np.eye(2 * n)
        E, constant, ramp = np.split(expm(augmented * h)[:n], 3, axis=1)
        q = states[-1] @ E.T + (held[k] + straight[k]) @ constant.T
        q = q + ((straight[k + 1] - straight[k]) / h) @ ramp.T
        states.append(q if kicks is None else q + kicks[k])
    return np.array(states)
