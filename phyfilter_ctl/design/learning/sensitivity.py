"""Cost, gradient and Gauss-Newton matrix of a filter on data, from moments of the chain with doubled poles.

    J(theta, c) = sum_k w_k (gamma*_k - c xi_k)^2

The sampled filter and all its sensitivities are fixed rows of the sampled doubled chain s = [xi; eta], because a
one-step rule commutes with a change of state: discretise the 2n states and the derivative of the sampled filter is
exact. So G = sum w s s' and m = sum w s gamma* hold everything a Gauss-Newton step needs, and where they come from
(samples, or correlations) does not matter here.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from ..._sections import FloatArray
from ...filter import PhyFilter
from .parametrisation import Chain, chain_of
from .shape import Form, Shape, condition_rows, tidied

# Directions of the states whose share in their covariance is below this carry no information on c.
_NO_INFORMATION = 1e-13


class Data(Protocol):
    """Recorded residuals and what to fit, reduced to what a cost needs."""

    @property
    def energy(self) -> float:
        """sum w gamma*^2."""
        ...

    @property
    def weight(self) -> float:
        """sum w."""
        ...

    def moments(self, doubled: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """G (2n, 2n) and m (2n,) of the chain [A2 B2; 0 0]; None where the sampled chain is not stable."""
        ...


class Evaluation(NamedTuple):
    """A cost and its derivatives by theta, the output row c solved for."""

    cost: float  # mean square, weighted
    gradient: FloatArray  # (n,)
    curvature: FloatArray  # (n, n): Gauss-Newton matrix
    c: FloatArray  # (n,): F = c xi


def evaluate(data: Data, chain: Chain, shape: Shape) -> Evaluation | None:
    """Cost, gradient and Gauss-Newton matrix by theta; None where the sampled filter is not stable, its sensitivities
    are not known, or a block that was taken out of the moments left only rounding.

    The general form solves for c by linear least squares, the conditions of the shape as equality constraints, and
    projects the sensitivities (Kaufman's variable projection, BIT 15 (1975)); its gradient is exact. In the low-pass
    form c is a function of theta.
    """
    found = data.moments(chain.doubled)
    if found is None:
        return None
    G, m = found
    if np.diag(G).min() <= 0.0 < np.diag(G).max():  # no covariance; a record of zeros has one, of zeros
        return None
    n = chain.order
    try:
        if shape.form == "lowpass":
            rows, c = _lowpass_rows(chain)
            curvature = rows @ G @ rows.T
        else:
            S, d = condition_rows(shape, chain.doubled)
            solver = Solver(G[:n, :n], S[:n])
            c = solver.least_squares(m[:n], d)
            rows = _general_rows(chain, c, solver, S)
            curvature = rows @ G @ rows.T
            across = rows @ G[:, :n]
            curvature -= across @ solver.free(across.T)
    except np.linalg.LinAlgError:
        return None
    residual = m - G[:, :n] @ c
    cost = data.energy - float(c @ (m[:n] + residual[:n]))
    scale = 1.0 / data.weight
    return Evaluation(scale * cost, -2.0 * scale * (rows @ residual), 2.0 * scale * curvature, c)


def jacobian(data: Data, chain: Chain, c: FloatArray, shape: Shape) -> FloatArray:
    """Rows (p, 2n) with d (F u) = row [xi; eta], by theta first, then by what the conditions leave free of c."""
    if shape.form == "lowpass":
        return _lowpass_rows(chain)[0]
    found = data.moments(chain.doubled)
    assert found is not None  # the filter has a cost on these data
    n = chain.order
    S, _ = condition_rows(shape, chain.doubled)
    solver = Solver(found[0][:n, :n], S[:n])
    free = np.pad(solver.basis.T / solver.sizes, [(0, 0), (0, n)])
    return np.concatenate([_general_rows(chain, c, solver, S), free])


def _lowpass_rows(chain: Chain) -> tuple[FloatArray, FloatArray]:
    kappa, slopes = chain.lowpass
    c = np.zeros(chain.order)
    c[-1] = kappa
    rows = kappa * chain.sensitivities[:, -1]
    rows[:, chain.order - 1] += slopes
    return rows, c


def _general_rows(chain: Chain, c: FloatArray, solver: Solver, S: FloatArray) -> FloatArray:
    """With c moving so that the conditions hold where the states have moved."""
    rows = c @ chain.sensitivities
    rows[:, : chain.order] -= solver.met(rows @ S)
    return rows


class Solver:
    """Least squares with equality constraints, min c G c' - 2 c m with c S = d, for a covariance G.

    The null space of S is taken in states of unit size, and G on it is inverted by its eigenvectors.
    """

    def __init__(self, G: FloatArray, S: FloatArray) -> None:
        self.sizes: FloatArray = np.sqrt(np.maximum(np.diag(G), np.finfo(float).tiny))
        self.G: FloatArray = G / np.outer(self.sizes, self.sizes)
        scaled = S / self.sizes[:, None]
        lengths = np.sqrt(np.sum(scaled**2, axis=0))
        Q, R = np.linalg.qr(scaled / lengths, mode="complete")
        count = S.shape[1]
        # Of least size, for each condition.
        self.forced: FloatArray = np.linalg.solve(R[:count], Q[:, :count].T).T / lengths
        values, vectors = np.linalg.eigh(Q[:, count:].T @ self.G @ Q[:, count:])
        kept = values > _NO_INFORMATION * np.max(values, initial=0.0)
        self.basis: FloatArray = (Q[:, count:] @ vectors)[:, kept]
        self.values: FloatArray = values[kept]

    def least_squares(self, m: FloatArray, d: FloatArray) -> FloatArray:
        """The minimiser c (n,)."""
        forced = self.forced @ d
        inner = self.basis.T @ (m / self.sizes - self.G @ forced)
        return (forced + self.basis @ (inner / self.values)) / self.sizes

    def met(self, d: FloatArray) -> FloatArray:
        """Rows c (q, n) of least size with c S = d (q, p)."""
        return d @ self.forced.T / self.sizes

    def free(self, m: FloatArray) -> FloatArray:
        """Z (Z' G Z)^-1 Z' m (n, q), Z spanning the rows with Z' S = 0."""
        inner = (self.basis.T @ (m.T / self.sizes).T).T / self.values
        return ((self.basis @ inner.T).T / self.sizes).T


def filter_of(chain: Chain, c: FloatArray, shape: Shape) -> PhyFilter:
    """The continuous filter c xi."""
    a, R, _, _ = chain.polynomials
    return PhyFilter(a, None if shape.form == "lowpass" else tidied(shape, a, R @ c), poles=chain.poles)


def coefficient_gradient(
    data: Data, filter: PhyFilter, form: Form, scale: float | None = None
) -> tuple[float, FloatArray, FloatArray]:
    """Cost of a filter and its gradient by scaled coefficients.

    Parameters
    ----------
    data : Data
    filter : PhyFilter
    form : {"lowpass", "general"}
        "lowpass": b_0 moves with a_0. "general": a and b move on their own.
    scale : float, optional
        w in rad/s of the scaled coefficients a_i / w^(n-i) and b_i / w^(n-i); None means a_0^(1/n).

    Returns
    -------
    cost : float
        Weighted mean of (gamma* - F u)^2.
    by_a, by_b : (n,) arrays
        d cost / d (a_i / w^(n-i)) and d cost / d (b_i / w^(n-i)); ``by_b`` is 0 in the low-pass form.

    Raises
    ------
    ValueError
        If the sampled filter is not stable.
    """
    n = filter.order
    chain = chain_of(filter.poles)
    c = chain.output(filter.b)
    found = data.moments(chain.doubled)
    if found is None:
        raise ValueError("the sampled filter is not stable at this step: use method='exact' or slower poles")
    G, m = found
    w = filter.a[0] ** (1.0 / n) if scale is None else scale
    powers = w ** np.arange(n, 0, -1)
    residual = m - G[:, :n] @ c
    by_theta = (c @ chain.sensitivities) @ residual
    _, R, a_slopes, R_slopes = chain.polynomials
    # J(theta, c) = J(a(theta), R(theta) c), so by_c = R' by_b and by_theta = a_slopes by_a + (R_slopes c) by_b.
    by_b = _solved((R / powers[:, None]).T, residual[:n])
    by_a = _solved(a_slopes / powers, by_theta - ((R_slopes @ c) / powers) @ by_b)
    if form == "lowpass":
        by_a[0] += by_b[0]
        by_b = np.zeros(n)
    factor = -2.0 / data.weight
    cost = (data.energy - c @ (m[:n] + residual[:n])) / data.weight
    return float(cost), factor * by_a, factor * by_b


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.solve(matrix, right), dtype=float)
