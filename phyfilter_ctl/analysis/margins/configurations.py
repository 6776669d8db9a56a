"""The inertia matrices of a robot over its joint range, as a polytope that is certain to hold them all."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from ... import _signals
from ..._sections import FloatArray

__all__ = ["configuration_hull"]

# Rounding of inertia matrices against their trigonometric polynomial.
_SAME = 1e-9
# Configurations beyond which a grid is refused.
_MOST = 200_000


def configuration_hull(
    inertia: Callable[[FloatArray], ArrayLike],
    lower: ArrayLike,
    upper: ArrayLike,
    *,
    points: int = 7,
    degree: int = 2,
) -> tuple[FloatArray, FloatArray]:
    """A polytope and a deviation from it that hold M(q) for every q within joint limits.

    Parameters
    ----------
    inertia : callable
        From joint angles (k,) in rad to the symmetric inertia matrix (n, n).
    lower, upper : (k,) arrays
        Limits of the joints that M depends on, rad. Joints that M does not depend on are better left out.
    points : int
        Configurations sampled of each joint, at least 2: points^k vertices, and a deviation that falls as 1/points^2.
    degree : int
        M is a trigonometric polynomial of this degree in each joint: 2 for revolute joints.

    Returns
    -------
    vertices : (J, n, n) array
        M at the sampled configurations.
    deviation : (n, n) array
        How far M between them may lie off their convex hull, entry by entry.

    Raises
    ------
    ValueError
        If limits contradict each other, there are too many configurations, or M is no such polynomial (a sliding
        joint, a base that was eliminated): then no bound between samples is known.

    Notes
    -----
    Within a cell of the grid M is the multilinear interpolation of the corners, a convex combination, up to
    sum_i delta_i^2/8 max |d^2 M/dq_i^2|; the second derivatives are bounded by the sum of k_i^2 |c_k| over the Fourier
    coefficients c_k of M, which 2 degree + 1 samples of each joint give exactly.

    Examples
    --------
    A double pendulum depends on its second joint alone:

    >>> def inertia(q):
    ...     c = np.cos(q[0])
    ...     return [[3.0 + 2.0 * c, 1.0 + c], [1.0 + c, 1.0]]
    >>> vertices, deviation = configuration_hull(inertia, [-2.0], [2.0], points=9)
    >>> vertices.shape, deviation.round(4).tolist()
    ((9, 2, 2), [[0.0625, 0.0313], [0.0313, 0.0]])
    """
    low = _signals.array("lower", lower, ("k",))
    high = _signals.array("upper", upper, low.shape)
    if np.any(high <= low):
        raise ValueError(f"upper: expected limits above {low.tolist()}, got {high.tolist()}")
    points = _signals.count("points", points, least=2)
    degree = _signals.count("degree", degree, least=1)
    k, per_turn = len(low), 2 * degree + 1
    if max(points, per_turn) ** k > _MOST:
        raise ValueError(
            f"points: {max(points, per_turn)} configurations of each of {k} joints are more than {_MOST}; leave out "
            "joints that M does not depend on, or take fewer points"
        )

    def matrix(q: FloatArray) -> FloatArray:
        return _signals.array("inertia(q)", inertia(q), ("n", "n"))

    turn = 2.0 * np.pi / per_turn * np.arange(per_turn)
    samples = np.array([matrix(np.array(q)) for q in product(turn, repeat=k)])
    n = samples.shape[-1]
    spectrum = np.fft.fftn(samples.reshape(*[per_turn] * k, n, n), axes=range(k)) / per_turn**k
    order = np.fft.fftfreq(per_turn, 1.0 / per_turn)

    def at(angles: list[FloatArray]) -> FloatArray:
        found = spectrum
        for q in angles:  # each joint's axis goes to the front and out again at the back
            found = np.tensordot(found, np.exp(1j * np.outer(order, q)), axes=(0, 0))
        return np.moveaxis(np.real(found), (0, 1), (-2, -1))

    largest = float(np.abs(samples).max())
    for q in np.random.default_rng(0).uniform(low, high, (4, k)):
        if np.abs(at([q[i : i + 1] for i in range(k)]).reshape(n, n) - matrix(q)).max() > _SAME * largest:
            raise ValueError(
                f"inertia: M(q) is no trigonometric polynomial of degree {degree} in each joint (at q = "
                f"{q.round(3).tolist()}); joints must be revolute and angles in rad"
            )
    grids = [np.linspace(a, b, points) for a, b in zip(low, high, strict=True)]
    deviation = np.zeros((n, n))
    for i, width in enumerate((high - low) / (points - 1)):
        bend = np.square(order).reshape(-1, *[1] * (k + 1 - i)) * np.abs(spectrum)
        deviation += width**2 / 8.0 * bend.sum(axis=tuple(range(k)))
    return at(grids).reshape(-1, n, n), deviation
