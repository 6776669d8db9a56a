"""The paper's own realisation, Eq. (5): open integrators that grow and cancel in the output.

Kept for comparison and teaching; nothing else uses it. Forward Euler, inputs held over the step. A channel carries
4n - 3 states in the low-pass form (xi and its n - 1 derivatives, n - 1 integrals each of f_hat, f_theta and x), and
n - 1 integrals of g more in the general form, here with the supplement's two misprints put right (-b_0 g in the
equation of xi, b_1 as the last coefficient of chi_3).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .phyfilter import PhyFilter

Array = NDArray[np.floating]


class PaperState(NamedTuple):
    """Integrators of one sample, of a filter of order n.

    Attributes
    ----------
    xi : (n, n_x) array
        xi and its derivatives.
    alpha, beta, x : (n, n_x) arrays
        f_hat, f_theta and x, each with its integrals.
    g : (n - 1, n_x) array
        Integrals of g, used by the general form.
    """

    xi: Array
    alpha: Array
    beta: Array
    x: Array
    g: Array


def start(filter: PhyFilter, x0: Array, f_theta0: Array) -> PaperState:
    """Bumpless start: xi^(i)(0) = -b_{n-1-i} x(0) (for the low-pass form xi^(n-1)(0) = -x(0)), the rest 0."""
    n = filter.order
    zeros = np.zeros((n, len(x0)), dtype=x0.dtype)
    xi, alpha, beta, x, g = (zeros.copy() for _ in range(5))
    for i in range(n):
        xi[i] = -_weight(filter, n - 1 - i, x0.dtype) * x0
    alpha[0] = beta[0] = f_theta0
    x[0] = x0
    return PaperState(xi, alpha, beta, x, g[1:])


def step(filter: PhyFilter, state: PaperState, x: Array, g: Array, f_theta: Array, dt: float) -> PaperState:
    """Integrate over one step with everything held, then form f_hat (``alpha[0]`` of the result)."""
    a, b = filter.a.astype(x.dtype), filter.b.astype(x.dtype)
    h = x.dtype.type(dt)
    xi, alpha, beta, integrals, held = (array.copy() for array in state)
    xi[:-1] += h * state.xi[1:]
    for chain, before in ((alpha, state.alpha), (beta, state.beta), (integrals, state.x)):
        chain[1:] += h * before[:-1]
    if filter.is_lowpass:
        xi[-1] += h * (-g - state.alpha[0])
    else:
        xi[-1] += h * ((a[0] - b[0]) * state.beta[0] - b[0] * g - a[0] * state.alpha[0])
        held += h * np.concatenate([g[None], state.g[:-1]])[: len(held)]
    integrals[0], beta[0] = x, f_theta
    alpha[0] = _output(filter, a, b, PaperState(xi, alpha, beta, integrals, held))
    return PaperState(xi, alpha, beta, integrals, held)


def _output(filter: PhyFilter, a: Array, b: Array, state: PaperState) -> Array:
    falling = a[:0:-1, None]  # a_{n-1} ... a_1, for the first to the (n-1)-th integral
    chi1 = (falling * state.alpha[1:]).sum(axis=0)
    if filter.is_lowpass:
        chi2 = state.beta[0] + (falling * state.beta[1:]).sum(axis=0)
        return a[0] * state.xi[0] - chi1 + chi2 + a[0] * state.x[-1]
    gain = b[:0:-1, None]
    chi2 = state.beta[0] + ((falling - gain) * state.beta[1:]).sum(axis=0)
    chi3 = (gain * state.g).sum(axis=0)
    return state.xi[0] - chi1 + chi2 - chi3 + (b[::-1, None] * state.x).sum(axis=0)


def shift(filter: PhyFilter, state: PaperState, dx: Array) -> PaperState:
    """Move the origin of x by dx: as at the start, in the derivatives of xi."""
    n = filter.order
    xi, x = state.xi.copy(), state.x.copy()
    for i in range(n):
        xi[i] -= _weight(filter, n - 1 - i, dx.dtype) * dx
    x[0] += dx
    return state._replace(xi=xi, x=x)


def _weight(filter: PhyFilter, j: int, dtype: np.dtype) -> np.floating:
    """b_j, with which the (n-1-j)-th integral of x enters f_hat, over the scale of xi (a_0 in the low-pass form)."""
    if filter.is_lowpass:
        return dtype.type(1.0 if j == 0 else 0.0)
    return dtype.type(filter.b[j])
