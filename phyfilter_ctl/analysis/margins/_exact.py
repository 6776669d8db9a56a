"""Positive definiteness in exact arithmetic: what makes the outcome of a solver a proof.

Every double is a rational number, so a matrix inequality in doubles is true or false; here it is decided, without
rounding, by Sylvester's criterion on integers.
"""

from __future__ import annotations

from fractions import Fraction
from math import lcm

import numpy as np
from numpy.typing import NDArray

from ..._sections import FloatArray

__all__ = ["Exact", "exact", "is_positive_definite"]

Exact = NDArray[np.object_]


def exact(matrix: FloatArray | float) -> Exact:
    """The same numbers as fractions."""
    found = np.asarray(matrix, dtype=float)
    return np.array([Fraction(value) for value in found.ravel().tolist()], dtype=object).reshape(found.shape)


def is_positive_definite(matrix: Exact) -> bool:
    """Whether the symmetric part of a matrix of fractions is positive definite.

    The leading principal minors are the pivots of elimination without fractions (E. H. Bareiss, "Sylvester's identity
    and multistep integer-preserving Gaussian elimination", Mathematics of Computation 22 (1968)).
    """
    symmetric = matrix + matrix.T
    common = lcm(*(value.denominator for value in symmetric.ravel().tolist()))
    rows = [[int(value * common) for value in row] for row in symmetric.tolist()]
    before = 1
    for k, top in enumerate(rows):
        pivot = top[k]
        if pivot <= 0:
            return False
        for row in rows[k + 1 :]:
            factor = row[k]
            for j in range(k + 1, len(rows)):
                row[j] = (row[j] * pivot - factor * top[j]) // before
        before = pivot
    return True
