"""Dormand and Prince's 8(5,3) pair, one call of a CasADi function for each step.

Hairer, Norsett, Wanner, "Solving Ordinary Differential Equations I", II.5 and II.6; the coefficients are SciPy's.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import casadi as ca
import numpy as np
from scipy.integrate import DOP853

from .._sections import FloatArray
from ..diagram import FlatModel
from .pair import Pair, Stage, sizes
from .steps import KEPT, Results, compose, has_common_parts

__all__ = ["dormand_prince"]

_STAGES = 12
# The polynomial inside a step errs by up to ten times the end of the step (measured on a lag).
_INSIDE = 0.1


def _weighted(weights: FloatArray, slopes: Sequence[ca.SX]) -> ca.SX:
    return ca.mtimes(ca.horzcat(*slopes), ca.sparsify(ca.DM(weights)))


def _stages(
    flat: FlatModel, given: Stage, slopes: list[ca.SX], table: FloatArray, nodes: FloatArray
) -> list[ca.SX]:
    """More slopes: at each node, on the weighted sum of those before."""
    x, q, u, rate, p, z = given
    for row, node in zip(table, nodes.tolist(), strict=True):
        at = x + q[1] * _weighted(row[: len(slopes)], slopes)
        slopes = [*slopes, flat.dynamics(q[0] + node * q[1], at, u + node * q[1] * rate, p, z)]
    return slopes


@lru_cache(maxsize=KEPT)
def _trial(flat: FlatModel) -> ca.Function:
    """One step: x at its end, its error over the tolerance, the slopes of all stages, and the last of them."""

    def body(*arguments: ca.SX) -> Results:
        *given, first = arguments
        x, q, u, rate, p, z = given
        slopes = _stages(flat, given, [first], DOP853.A[1:], DOP853.C[1:])
        after = x + q[1] * _weighted(DOP853.B, slopes)
        slopes.append(flat.dynamics(q[0] + q[1], after, u + q[1] * rate, p, z))
        scale = q[3] + q[2] * ca.fmax(ca.fabs(x), ca.fabs(after))
        fifth, third = (ca.sumsqr(_weighted(E, slopes) / scale) for E in (DOP853.E5, DOP853.E3))
        bound = (fifth + 0.01 * third) * len(flat.states)
        error = q[1] * ca.if_else(bound > 0.0, fifth / ca.sqrt(bound), bound)
        return after, error, ca.horzcat(*slopes), slopes[-1]

    return compose("pf_dop853", [*sizes(flat), len(flat.states)], body, share=has_common_parts(flat))


@lru_cache(maxsize=KEPT)
def _interpolant(flat: FlatModel) -> ca.Function:
    """Coefficients of the polynomial of seventh order in a step."""
    n_x = len(flat.states)

    def body(*arguments: ca.SX) -> Results:
        *given, after, stages = arguments
        x, h = given[0], given[1][1]
        slopes = list(ca.horzsplit(ca.reshape(stages, n_x, _STAGES + 1)))
        slopes = _stages(flat, given, slopes, DOP853.A_EXTRA, DOP853.C_EXTRA)
        change = after - x
        first = [change, h * slopes[0] - change, 2 * change - h * (slopes[_STAGES] + slopes[0])]
        return (ca.horzcat(*first, *(h * _weighted(row, slopes) for row in DOP853.D)),)

    return compose(
        "pf_dop853_dense", [*sizes(flat), n_x, n_x * (_STAGES + 1)], body, share=has_common_parts(flat)
    )


def _inside(coefficients: FloatArray, part: FloatArray) -> FloatArray:
    """Change of x at parts of the step, (k, n_x)."""
    value = np.zeros((len(part), coefficients.shape[1]))
    for i, row in enumerate(coefficients[::-1]):
        value += row
        value *= (part if i % 2 == 0 else 1 - part)[:, None]
    return value


def dormand_prince(flat: FlatModel) -> Pair:
    """The pair for a model."""
    return Pair("adaptive", 8, _INSIDE, (0.9, 0.2, 10.0), _trial(flat), _interpolant(flat), _inside)
