"""Shapes of filters, poles of geometric mean 1 and N, free of constraints; and the filters of a shape at a speed.

A shape of order n and type t is an array of 2n - 1 - t numbers or, where N has the t lowest coefficients of D alone, of
n - 1:

* logarithms of the dampings of the n // 2 second-order sections;
* logarithms of the speeds of all sections but the last, relative to the last one's;
* weights of the first n - t states of the chain of these sections in the output. The last t make F of type t.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize
from scipy.signal import ss2tf

from ..._sections import FloatArray
from ...filter import PhyFilter
from ..placement import lowpass, place_poles

__all__ = ["at_speed", "best_shape", "chains", "descend", "outputs", "sections", "starts"]

# Parameters of a shape stay within these: damping 1/8 to 8, speeds of the sections 1/8 to 8 of the last one's. A search
# that ends there has found that a section is better left out.
_LIMIT = np.log(8.0)
# Step of the differences that stand for the gradient.
_DIFFERENCE = 1e-6


def at_speed(shape: FloatArray, order: int, type: int, speed: float) -> PhyFilter:
    """The filter of a shape whose poles have the geometric mean ``speed`` (rad/s)."""
    dampings, speeds = sections(shape[None], order)
    poles = speed * _poles(dampings[0], speeds[0])
    filter = place_poles(poles, type=type)
    weights = shape[order - 1 :]
    if not len(weights):
        return filter
    A, equilibrium = chains(dampings, speeds)
    C = outputs(A, equilibrium, weights[None], type)
    numerator, _ = ss2tf(A[0], -A[0] @ equilibrium[0][:, None], C, np.zeros((1, 1)))
    b = np.asarray(numerator)[0, :0:-1] * speed ** np.arange(order, 0, -1.0)
    return PhyFilter.from_poles(poles, np.concatenate([filter.a[:type], b[type:]]))


def sections(shapes: FloatArray, order: int) -> tuple[FloatArray, FloatArray]:
    """Dampings (m, order // 2) of the pairs and speeds (m, (order + 1) // 2) of all sections of m shapes."""
    pairs = order // 2
    weights = np.array([2.0] * pairs + [1.0] * (order % 2))
    logs = np.zeros((len(shapes), len(weights)))
    logs[:, :-1] = shapes[:, pairs : order - 1]
    return np.exp(shapes[:, :pairs]), np.exp(logs - (logs @ weights / order)[:, None])


def chains(dampings: FloatArray, speeds: FloatArray) -> tuple[FloatArray, FloatArray]:
    """State matrices (m, n, n) and equilibria (m, n), for a unit input, of m chains of sections.

    A pair of damping z and speed r is ``w1' = -z r w1 - (1 - z^2) r w2 + r v``, ``w2' = r w1 - z r w2``: smooth where
    its poles meet on the axis.
    """
    m, pairs = dampings.shape
    n = pairs + speeds.shape[1]
    A, equilibrium = np.zeros((m, n, n)), np.ones((m, n))
    for j, r in enumerate(speeds.T):
        i = 2 * j
        if i:
            A[:, i, i - 1] = r
        if j < pairs:
            z = dampings[:, j]
            A[:, i, i] = A[:, i + 1, i + 1] = -z * r
            A[:, i, i + 1] = (z * z - 1.0) * r
            A[:, i + 1, i] = r
            equilibrium[:, i] = z
        else:
            A[:, i, i] = -r
    return A, equilibrium


def outputs(A: FloatArray, equilibrium: FloatArray, weights: FloatArray, type: int) -> FloatArray:
    """Output rows (m, n) of type t: C e = 1, C A^-j e = 0 for j < t, by the last t entries."""
    m, n = equilibrium.shape
    C = np.zeros((m, n))
    C[:, : weights.shape[1]] = weights
    moments = [equilibrium]
    for _ in range(type - 1):
        moments.append(np.asarray(np.linalg.solve(A, moments[-1][..., None])[..., 0], dtype=float))
    E = np.stack(moments, axis=1)
    missing = np.eye(type)[0] - (E @ C[..., None])[..., 0]
    C[:, n - type :] = np.linalg.solve(E[:, :, n - type :], missing[..., None])[..., 0]
    return C


def _poles(damping: FloatArray, speeds: FloatArray) -> FloatArray:
    poles: list[complex] = (-speeds[len(damping) :]).tolist()
    for z, w in zip(damping, speeds, strict=False):
        root = np.sqrt(complex(z * z - 1.0))
        poles += (
            [w * (-z + root), w * (-z - root)] if root.imag else [-w / (z + root.real), -w * (z + root.real)]
        )
    return np.array(poles)


def starts(order: int) -> list[FloatArray]:
    """Shapes of well-known families to start a search from."""
    shapes: list[FloatArray] = []
    for family in ("binomial", "butterworth", "bessel") if order > 1 else ():
        poles = lowpass(order, 1.0, family=family).poles
        poles = poles / np.exp(np.mean(np.log(np.abs(poles))))
        pairs = poles[poles.imag > 0.0]
        real = np.sort(poles[poles.imag == 0.0].real)
        damping, speeds = list(-pairs.real / np.abs(pairs)), list(np.abs(pairs))
        while len(real) > 1:
            damping.append(-(real[0] + real[-1]) / (2.0 * np.sqrt(real[0] * real[-1])))
            speeds.append(float(np.sqrt(real[0] * real[-1])))
            real = real[1:-1]
        logs = np.log(np.append(speeds, -real))
        shapes.append(np.concatenate([np.log(damping), logs[:-1] - logs[-1]]))
    return shapes or [np.zeros(0)]


def descend(
    costs: Callable[[FloatArray], FloatArray], first: list[FloatArray], *, free: int = 0
) -> tuple[FloatArray, float]:
    """The least of smooth costs of shapes, by L-BFGS-B from many starts, which have ``free`` weights at their ends.

    ``costs`` takes (m, p) and gives (m,): what the gradient needs is evaluated at once.
    """
    best, least = first[0], float(costs(first[0][None])[0])
    unit = least
    for start in first if len(best) else ():
        p = len(start)
        steps = _DIFFERENCE * np.vstack([np.zeros(p), np.eye(p)])

        def with_gradient(shape: FloatArray, steps: FloatArray = steps) -> tuple[float, FloatArray]:
            values = costs(shape + steps)
            return float(values[0] / unit), (values[1:] - values[0]) / (unit * _DIFFERENCE)

        found = minimize(
            with_gradient,
            start,
            jac=True,
            method="L-BFGS-B",
            bounds=[(-_LIMIT, _LIMIT)] * (p - free) + [(None, None)] * free,
            options={"maxcor": 2 * p, "ftol": 1e-8, "gtol": 1e-5},
        )
        if found.fun * unit < least:
            best, least = np.asarray(found.x, dtype=float), float(found.fun * unit)
    return best, least


def best_shape(
    cost: Callable[[FloatArray], float], first: list[FloatArray], *, free: int = 0, accuracy: float = 1e-4
) -> tuple[FloatArray, float]:
    """The least cost over shapes and ``free`` further coordinates, by Nelder and Mead's simplex from many starts."""
    best, least = first[0], cost(first[0])
    if not len(best):
        return best, least

    def bounded(shape: FloatArray) -> float:
        return cost(shape) if np.all(np.abs(shape[: len(shape) - free]) <= _LIMIT) else np.inf

    for start in first:
        simplex = np.vstack([start, start + 0.15 * np.eye(len(start))])
        found = minimize(
            bounded,
            start,
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "xatol": accuracy**0.5, "fatol": accuracy * abs(least)},
        )
        if found.fun < least:
            best, least = np.asarray(found.x, dtype=float), float(found.fun)
    return best, least
