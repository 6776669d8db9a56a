"""Columns of numbers in three forms, and the few functions that all operators are made of.

* an array (size, N): a column for each of N samples, or one for all of them (N = 1);
* a CasADi expression (size, 1): one sample, for diagrams and C;
* :class:`Traced`: an array that remembers where it came from, for the gradient in the weights.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any, cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf as _erf

from ..._sections import FloatArray

# Multiplications in one product of matrices: no BLAS splits it over threads, and the last digits do not depend on
# their number.
_PRODUCT = 1 << 18

Index = NDArray[np.intp] | slice
Pull = Callable[[FloatArray], FloatArray]


class Traced:
    """An array (size, N) with the way back: for each origin, from the cotangent of this to that of the origin."""

    __array_ufunc__ = None  # so that numpy leaves mixed arithmetic to the methods below

    def __init__(
        self,
        value: FloatArray,
        origins: Sequence[tuple[Traced, Pull]] = (),
        *,
        tape: list[Traced] | None = None,
    ) -> None:
        self.value, self.origins = value, origins
        self.tape: list[Traced] = origins[0][0].tape if origins else ([] if tape is None else tape)
        self.cotangent: FloatArray | None = None
        self.tape.append(self)

    @property
    def shape(self) -> tuple[int, ...]:
        return self.value.shape

    def pull(self, cotangent: FloatArray) -> None:
        """Set the cotangents of all that this was made of."""
        self.cotangent = cotangent
        for traced in reversed(self.tape):
            if traced.cotangent is None:
                continue
            for origin, way in traced.origins:
                part = _summed(way(traced.cotangent), origin.shape)
                origin.cotangent = part if origin.cotangent is None else origin.cotangent + part

    def __getitem__(self, index: Index) -> Traced:
        def back(cotangent: FloatArray) -> FloatArray:
            spread = np.zeros((len(self.value), cotangent.shape[1]))
            if isinstance(index, slice):
                spread[index] = cotangent
            else:
                np.add.at(spread, index, cotangent)
            return spread

        return Traced(self.value[index], [(self, back)])

    def __add__(self, other: Column) -> Traced:
        return _binary(np.add, self, other, lambda a, b: 1.0, lambda a, b: 1.0)

    def __sub__(self, other: Column) -> Traced:
        return _binary(np.subtract, self, other, lambda a, b: 1.0, lambda a, b: -1.0)

    def __rsub__(self, other: Column) -> Traced:
        return _binary(np.subtract, other, self, lambda a, b: 1.0, lambda a, b: -1.0)

    def __mul__(self, other: Column) -> Traced:
        return _binary(np.multiply, self, other, lambda a, b: b, lambda a, b: a)

    def __truediv__(self, other: Column) -> Traced:
        return _binary(np.divide, self, other, lambda a, b: 1.0 / b, lambda a, b: -a / b**2)

    def __rtruediv__(self, other: Column) -> Traced:
        return _binary(np.divide, other, self, lambda a, b: 1.0 / b, lambda a, b: -a / b**2)

    def __neg__(self) -> Traced:
        return Traced(-self.value, [(self, np.negative)])

    __radd__, __rmul__ = __add__, __mul__


_SYMBOLIC = ca.MX | ca.DM
Column = Any  # FloatArray | ca.MX | Traced: arithmetic between them is what CasADi and numpy make of it


def _unary(
    name: str, function: Callable[..., FloatArray], slope: Callable[[FloatArray, FloatArray], FloatArray]
) -> Callable[[Column], Column]:
    """A function of each number; ``slope`` from the number and its value."""
    symbolic = getattr(ca, name)

    def apply(v: Column) -> Column:
        if isinstance(v, Traced):
            value = function(v.value)
            return Traced(value, [(v, lambda cotangent: cotangent * slope(v.value, value))])
        return symbolic(v) if isinstance(v, _SYMBOLIC) else function(v)

    return apply


fabs = _unary("fabs", np.abs, lambda v, y: np.sign(v))
sign = _unary("sign", np.sign, lambda v, y: np.zeros_like(v))
exp = _unary("exp", np.exp, lambda v, y: y)
expm1 = _unary("expm1", np.expm1, lambda v, y: y + 1.0)
log = _unary("log", np.log, lambda v, y: 1.0 / v)
log1p = _unary("log1p", np.log1p, lambda v, y: 1.0 / (1.0 + v))
sqrt = _unary("sqrt", np.sqrt, lambda v, y: 0.5 / y)
tanh = _unary("tanh", np.tanh, lambda v, y: 1.0 - y**2)
sin = _unary("sin", np.sin, lambda v, y: np.cos(v))
cos = _unary("cos", np.cos, lambda v, y: -np.sin(v))
atan = _unary("atan", np.arctan, lambda v, y: 1.0 / (1.0 + v**2))
erf = _unary("erf", _erf, lambda v, y: 2.0 / np.sqrt(np.pi) * np.exp(-(v**2)))


def fmax(a: Column, b: Column) -> Column:
    """The greater one, entry by entry; at a tie the slope is that between."""
    if isinstance(a, _SYMBOLIC) or isinstance(b, _SYMBOLIC):
        return ca.fmax(a, b)
    return _binary(np.maximum, a, b, _above, lambda a, b: _above(b, a))


def fmin(a: Column, b: Column) -> Column:
    """The lesser one, likewise."""
    if isinstance(a, _SYMBOLIC) or isinstance(b, _SYMBOLIC):
        return ca.fmin(a, b)
    return _binary(np.minimum, a, b, lambda a, b: _above(b, a), _above)


def compared(name: str, function: Callable[..., NDArray[np.bool_]]) -> Callable[[Column, Column], Column]:
    """A comparison, 1 where it holds and 0 elsewhere; it has no slope."""
    symbolic = getattr(operator, name)

    def apply(a: Column, b: Column) -> Column:
        if isinstance(a, _SYMBOLIC) or isinstance(b, _SYMBOLIC):
            return symbolic(a, b)
        return function(array(a), array(b)).astype(float)

    return apply


def where(condition: Column, a: Column, b: Column) -> Column:
    """a where the condition holds, b elsewhere, entry by entry; what is not taken has no slope."""
    if any(isinstance(v, _SYMBOLIC) for v in (condition, a, b)):
        return ca.if_else(condition, a, b)
    holds = array(condition) != 0.0
    value = np.where(holds, array(a), array(b))
    origins: list[tuple[Traced, Pull]] = []
    for v, taken in ((a, holds), (b, ~holds)):
        if isinstance(v, Traced):
            origins.append((v, lambda cotangent, taken=taken: np.where(taken, cotangent, 0.0)))
    return Traced(value, origins) if origins else value


def power(a: Column, b: Column) -> Column:
    """a to the power of b, entry by entry."""
    if isinstance(a, _SYMBOLIC) or isinstance(b, _SYMBOLIC):
        return ca.power(a, b)
    return _binary(np.power, a, b, lambda a, b: b * a ** (b - 1.0), lambda a, b: a**b * np.log(a))


def stacked(columns: Sequence[Column]) -> Column:
    """One below the other."""
    if any(isinstance(column, ca.MX) for column in columns):
        return ca.vertcat(*columns)
    samples = max(column.shape[1] for column in columns)
    value = np.concatenate([np.broadcast_to(array(c), (c.shape[0], samples)) for c in columns])
    ends = np.cumsum([column.shape[0] for column in columns])
    traced = [
        (column, lambda cotangent, rows=slice(end - column.shape[0], end): cotangent[rows])
        for column, end in zip(columns, ends.tolist(), strict=True)
        if isinstance(column, Traced)
    ]
    return Traced(value, traced) if traced else value


def product(A: Column, B: Column, m: int, k: int, n: int) -> Column:
    """Matrix product by rows, (m, k) times (k, n)."""
    if isinstance(A, ca.MX) or isinstance(B, ca.MX):
        # By columns in CasADi: a matrix read back is its transpose. Constants are turned once, and then read along.
        left, right = ca.reshape(_symbolic(A), k, m).T, ca.reshape(_symbolic(B), n, k).T
        return ca.vec(ca.mtimes(left, right).T)
    value = _product(array(A), array(B), m, k, n)
    origins: list[tuple[Traced, Pull]] = []
    if isinstance(A, Traced):
        turned = _turned(array(B), k, n)
        origins.append((A, lambda cotangent: _product(cotangent, turned, m, n, k, shared=A.shape[1] == 1)))
    if isinstance(B, Traced):
        turned_A = _turned(array(A), m, k)
        origins.append((B, lambda cotangent: _product(turned_A, cotangent, k, m, n, shared=B.shape[1] == 1)))
    return Traced(value, origins) if origins else value


def array(column: Column) -> FloatArray:
    """The numbers, without where they came from."""
    return column.value if isinstance(column, Traced) else cast(FloatArray, column)


def _product(A: FloatArray, B: FloatArray, m: int, k: int, n: int, *, shared: bool = False) -> FloatArray:
    """The product for every sample; ``shared`` sums it over the samples."""
    a, b = A.reshape(m, k, -1), B.reshape(k, n, -1)
    if shared and a.shape[2] == b.shape[2]:
        return np.tensordot(a, b, axes=((1, 2), (0, 2))).reshape(m * n, 1)
    if m > 1 or b.shape[2] > 1:
        samples = max(a.shape[2], b.shape[2])
        a, b = (np.broadcast_to(each, (*each.shape[:2], samples)) for each in (a, b))
        return np.einsum("mks,kns->mns", a, b).reshape(m * n, samples)
    width = max(1, _PRODUCT // (k * n))
    W, x = b[:, :, 0].T, a[0]
    blocks = [W @ x[:, first : first + width] for first in range(0, x.shape[1], width)]
    return blocks[0] if len(blocks) == 1 else np.concatenate(blocks, axis=1)


def _turned(A: FloatArray, m: int, k: int) -> FloatArray:
    """The transpose by rows of an (m, k) matrix by rows, of every sample."""
    return np.ascontiguousarray(A.reshape(m, k, -1).swapaxes(0, 1)).reshape(A.shape)


def _symbolic(column: Column) -> ca.DM | ca.MX:
    return column if isinstance(column, ca.MX) else ca.DM(column)


def _above(a: FloatArray, b: FloatArray) -> FloatArray:
    return 0.5 * (1.0 + np.sign(a - b))


def _binary(
    function: Callable[..., FloatArray],
    a: Column,
    b: Column,
    slope_a: Callable[[FloatArray, FloatArray], FloatArray | float],
    slope_b: Callable[[FloatArray, FloatArray], FloatArray | float],
) -> Column:
    left, right = array(a), array(b)
    value = function(left, right)
    origins: list[tuple[Traced, Pull]] = []
    if isinstance(a, Traced):
        origins.append((a, lambda cotangent: cotangent * slope_a(left, right)))
    if isinstance(b, Traced):
        origins.append((b, lambda cotangent: cotangent * slope_b(left, right)))
    return Traced(value, origins) if origins else value


def _summed(cotangent: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """The cotangent of what was repeated: summed over the copies."""
    for axis in (0, 1):
        if shape[axis] == 1 and cotangent.shape[axis] > 1:
            cotangent = cotangent.sum(axis=axis, keepdims=True)
    return cotangent
