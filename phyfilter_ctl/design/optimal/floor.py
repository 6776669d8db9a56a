"""What no causal estimator can beat: Landau and Kolmogorov's inequality on the half line."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.optimize import linprog

__all__ = ["error_floor"]

# Landau's (1913) and Matorin's (1955) constants by the order k of the bounded derivative of the residual.
_CONSTANTS = {1: 2.0, 2: (243.0 / 8.0) ** (1.0 / 3.0)}
# Intervals of the spline, ratio of the last one's length to the first one's, and their sum in units of the longest
# (noise / delta_k)^(1/(k + 1)).
_INTERVALS, _GRADING, _HORIZON = 120, 6.0, 16.0


def error_floor(*, residual: Mapping[int, float], noise: float, inertia: float = 1.0) -> float:
    """The worst-case error that no causal estimator of f can do without, linear or not.

    Parameters
    ----------
    residual : dict of int to float
        delta_k: bounds of derivatives of gamma = f - f_theta, which all hold.
    noise : float
        Bound nu of the noise of x.
    inertia : float
        |M_hat|, by which noise of x counts.

    Returns
    -------
    float
        The largest for one derivative of order 1 or 2, with or without a bound of gamma itself; else a lower bound of
        it, 0.1 to 2 % less.

    Raises
    ------
    ValueError
        For bounds that are negative or not finite, or no residual at all.

    Notes
    -----
    Let z be a motion with |M_hat z| <= nu and M_hat z' within the bounds of gamma. Measured with the noise -z it looks
    like rest, and so does -z measured with the noise z: with one of the two any estimator errs by |M_hat z'| or more.
    The largest z' at the end of a half line is Landau's and Kolmogorov's,

        |f_err| >= C_k (|M_hat| nu)^(k/(k+1)) delta_k^(1/(k+1)),    C_1 = 2,    C_2 = (243/8)^(1/3),

    C_1 by E. Landau (Proc. London Math. Soc. 13, 1913), C_2 by A. P. Matorin (Ukrain. Mat. Zh. 7, 1955); I. J.
    Schoenberg and A. Cavaretta (MRC Report 1050, Univ. of Wisconsin, 1970) have the higher ones, C_3 = 4.288. Where
    several derivatives are bounded or one of order 3 or more, a linear programme finds a spline z. Its control points
    and those of its derivatives stay within the bounds, and so does z itself. Some linear estimator attains
    the floor (C. A. Micchelli and T. J. Rivlin, A Survey of Optimal Recovery, 1977).

    Examples
    --------
    A residual of slope 8 and noise of 0.01: 2 sqrt(8 x 0.01).

    >>> round(error_floor(residual={1: 8.0}, noise=0.01), 6)
    0.565685

    Where gamma itself is smaller than that, f_hat = f_theta does as well as anything:

    >>> error_floor(residual={0: 0.5, 1: 8.0}, noise=0.01)
    0.5
    """
    bounds = {f"residual[{k}]": value for k, value in residual.items()} | {"noise": noise, "inertia": inertia}
    for name, value in bounds.items():
        if not (np.isfinite(value) and value >= 0.0):
            raise ValueError(f"{name}: expected a bound of 0 or more, got {value}")
    if not residual:
        raise ValueError(
            "residual: expected a bound of gamma or of a derivative of it, e.g. {1: 2.0}; got none"
        )
    if 0.0 in bounds.values():
        return 0.0
    noise = noise * inertia
    largest = float(residual.get(0, np.inf))
    slopes = {int(k): float(delta) for k, delta in residual.items() if k > 0}
    if not slopes:
        return largest
    unit = max((noise / delta) ** (1.0 / (k + 1)) for k, delta in slopes.items())
    constant = _CONSTANTS.get(max(slopes)) if len(slopes) == 1 else None
    if constant is None:
        constant = _fastest_motion({k: delta * unit ** (k + 1) / noise for k, delta in slopes.items()})
    return min(largest, constant * noise / unit)


def _fastest_motion(limits: Mapping[int, float]) -> float:
    """Largest |z'(0)| of splines with |z| <= 1, |z^(k+1)| <= limits[k] that come from rest; time runs backwards."""
    degree = max(limits) + 1
    course = np.expm1(np.log(_GRADING) * np.linspace(0.0, 1.0, _INTERVALS + 1)) / (_GRADING - 1.0)
    knots = _HORIZON * np.pad(course, degree, mode="edge")
    # From the unknowns to the control points, of which the last are equal, and on to those of the derivatives.
    derivatives = [np.eye(_INTERVALS + 1)[np.minimum(range(_INTERVALS + degree), _INTERVALS)]]
    for left in range(degree, 0, -1):
        knots = knots[1:-1]
        gaps = (knots[left:] - knots[:-left]) / left
        derivatives.append(np.diff(derivatives[-1], axis=0) / gaps[:, None])
    limited = np.concatenate([derivatives[k + 1] / limit for k, limit in limits.items()])
    goal = derivatives[1][0]
    found = linprog(
        -goal,
        A_ub=np.concatenate([limited, -limited]),
        b_ub=np.ones(2 * len(limited)),
        bounds=(-1.0, 1.0),
        method="highs",
        options={"primal_feasibility_tolerance": 1e-10},
    )
    z = np.asarray(found.x if found.success else 0.0 * goal, dtype=float)
    return float(goal @ z / max(1.0, np.abs(z).max(), np.abs(limited @ z).max()))
