"""What error control needs to know of a one-step method."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

import casadi as ca

from .._sections import FloatArray
from ..diagram import FlatModel
from .response import Method

__all__ = ["Pair", "Stage", "sizes"]

# x, (t, h, rtol, atol), u at t, rates of u, p, z.
Stage: TypeAlias = Sequence[ca.SX]


def sizes(flat: FlatModel) -> list[int]:
    """Lengths of what a stage is computed from."""
    n_u = len(flat.inputs)
    return [len(flat.states), 4, n_u, n_u, len(flat.parameters), len(flat.held)]


class Pair(NamedTuple):
    """A method with an estimate of its error and a polynomial inside the step.

    Attributes
    ----------
    method : str
    order : int
        The error of a step grows with this power of its length.
    inside : float
        Part of the tolerance that a step gets, so that the polynomial inside keeps the whole.
    factors : (safety, least, most)
        Of the step length from step to step.
    trial : casadi.Function
        Stage and first slope -> x at its end, error over the tolerance, stages (n_x, k), and the slope there, or the
        first again where there is none.
    dense : callable
        Makes the function stage, x at the end, stages -> coefficients of the polynomial; not every run looks inside.
    evaluate : callable
        Coefficients, parts (k,) of the step -> changes of x (k, n_x).
    """

    method: Method
    order: int
    inside: float
    factors: tuple[float, float, float]
    trial: ca.Function
    dense: Callable[[], ca.Function]
    evaluate: Callable[[FloatArray, FloatArray], FloatArray]
