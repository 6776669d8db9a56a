"""Dormand and Prince's 8(5,3) pair, one call of a CasADi function for each step.

Hairer, Norsett, Wanner, "Solving Ordinary Differential Equations I", II.5 and II.6; the coefficients are SciPy's.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache, partial

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


def _columns(rows: Iterable[FloatArray], *before: float) -> list[ca.DM]:
    """Weights without their zeros; ``before`` are those of what stands in front."""
    return [ca.sparsify(ca.DM([*before, *np.trim_zeros(row, "b").tolist()])) for row in rows]


# Of x and of the slopes times h.
_A, _A_EXTRA = (
    _columns([row[: first + k] for k, row in enumerate(table)], 1.0)
    for table, first in ((DOP853.A[1:], 1), (DOP853.A_EXTRA, _STAGES + 1))
)
_B, _E5, _E3, *_D = (
    *_columns([DOP853.B], 1.0),
    *_columns([DOP853.E5, DOP853.E3], 0.0),
    *_columns(DOP853.D, 0.0),
)


class _Stages:
    """x and the slopes times h that are known, side by side."""

    def __init__(self, flat: FlatModel, given: Stage, nodes: FloatArray) -> None:
        x, q, u, rate, self._p, self._z = given
        self._dynamics, self._h, self._known = flat.dynamics, q[1], x
        column = ca.DM(nodes.tolist())
        self._times = ca.vertsplit(q[0] + self._h * column)
        moving = ca.mtimes(self._h * rate, column.T) if u.numel() else type(x)(0, len(nodes))
        self._inputs = [u + part for part in ca.horzsplit(moving)] if u.numel() else [u] * len(nodes)

    def weighted(self, weights: ca.DM) -> ca.SX:
        """Of the first of them."""
        count = weights.numel()
        known = self._known
        return ca.mtimes(known[:, :count] if count < known.shape[1] else known, weights)

    def slope(self, node: int, at: ca.SX) -> ca.SX:
        """At a node."""
        return self._dynamics(self._times[node], at, self._inputs[node], self._p, self._z)

    def add(self, slopes: ca.SX) -> None:
        """To what is known."""
        self._known = ca.horzcat(self._known, self._h * slopes)

    def go_on(self, table: Sequence[ca.DM]) -> list[ca.SX]:
        """More slopes: at each node, on the weighted sum of those before."""
        found = []
        for node, weights in enumerate(table):
            found.append(self.slope(node, self.weighted(weights)))
            self.add(found[-1])
        return found


@lru_cache(maxsize=KEPT)
def _trial(flat: FlatModel) -> ca.Function:
    """One step: x at its end, its error over the tolerance, the slopes of all stages, and the last of them."""

    def body(*arguments: ca.SX) -> Results:
        *given, first = arguments
        x, q = given[:2]
        stages = _Stages(flat, given, np.append(DOP853.C[1:], 1.0))
        stages.add(first)
        slopes = [first, *stages.go_on(_A)]
        after = stages.weighted(_B)
        slopes.append(stages.slope(len(_A), after))
        stages.add(slopes[-1])
        scale = q[3] + q[2] * ca.fmax(ca.fabs(x), ca.fabs(after))
        fifth, third = (ca.sumsqr(stages.weighted(E) / scale) for E in (_E5, _E3))
        bound = (fifth + 0.01 * third) * len(flat.states)
        error = ca.if_else(bound > 0.0, fifth / ca.sqrt(bound), bound)
        return after, error, ca.horzcat(*slopes), slopes[-1]

    return compose("pf_dop853", [*sizes(flat), len(flat.states)], body, share=has_common_parts(flat))


@lru_cache(maxsize=KEPT)
def _interpolant(flat: FlatModel) -> ca.Function:
    """Coefficients of the polynomial of seventh order in a step."""
    n_x = len(flat.states)

    def body(*arguments: ca.SX) -> Results:
        *given, after, slopes = arguments
        x, h = given[0], given[1][1]
        slopes = ca.reshape(slopes, n_x, _STAGES + 1)
        stages = _Stages(flat, given, DOP853.C_EXTRA)
        stages.add(slopes)
        stages.go_on(_A_EXTRA)
        change, begin, end = after - x, h * slopes[:, 0], h * slopes[:, _STAGES]
        first = [change, begin - change, 2 * change - end - begin]
        return (ca.horzcat(*first, *(stages.weighted(row) for row in _D)),)

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
    return Pair("adaptive", 8, _INSIDE, (0.9, 0.2, 10.0), _trial(flat), partial(_interpolant, flat), _inside)
