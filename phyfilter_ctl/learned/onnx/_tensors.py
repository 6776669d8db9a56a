"""Tensors of any shape on columns, by rows.

Whatever only moves numbers about is done by numpy on an array of their places, and one index into the column.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._columns import Column, fmax, product, stacked
from .graph import MOST_NUMBERS, Array, RefusedError

Places = NDArray[np.intp]
# Multiplications in one product of matrices, and numbers in one tensor.
_MOST_PRODUCTS = 1 << 26
# Numbers that one entry of a reduction is made of.
_MOST_REDUCED = 1 << 13


@dataclass(frozen=True, eq=False)
class Tensor:
    """A column with a shape.

    Attributes
    ----------
    column : (size, N) column
    shape : tuple of int
    known : bool
        Whether it depends on constants of the graph alone.
    whole : bool
        Whether its numbers are whole ones: shapes, axes, indices.
    source : str
        Name of the constant of the graph that it is, rearranged or not; "" where it is none.
    """

    column: Column
    shape: tuple[int, ...]
    known: bool = False
    whole: bool = False
    source: str = ""

    @classmethod
    def of(cls, values: ArrayLike, *, source: str = "") -> Tensor:
        """Of known numbers."""
        array = np.asarray(values)
        column = array.astype(float).reshape(-1, 1)
        return cls(column, array.shape, True, array.dtype.kind in "iub", source)

    @property
    def size(self) -> int:
        return math.prod(self.shape)

    @property
    def places(self) -> Places:
        """Places in the column, in the shape of the tensor."""
        return np.arange(self.size).reshape(self.shape)

    def numbers(self, what: str) -> Array:
        """The numbers as an array; refused where they depend on the input."""
        if not self.known:
            raise RefusedError(f"expected {what} as a constant, got one that depends on the input")
        array = self.column.reshape(self.shape)
        return array.astype(np.int64) if self.whole else array

    def whole_numbers(self, what: str) -> list[int]:
        """Known whole numbers."""
        if not self.whole:
            raise RefusedError(f"expected whole numbers as {what}")
        return [int(n) for n in self.numbers(what).ravel()]

    def reshaped(self, shape: Sequence[int]) -> Tensor:
        """The same numbers in another shape."""
        if math.prod(shape) != self.size:
            raise RefusedError(f"expected a shape of {self.size} numbers, got {list(shape)}")
        return replace(self, shape=tuple(int(n) for n in shape))

    def moved(self, places: Places) -> Tensor:
        """The numbers at these places, in the shape of ``places``."""
        return replace(self, column=_picked(self.column, limited(places)), shape=places.shape)

    def moved_to(self, shape: tuple[int, ...]) -> Tensor:
        """Repeated along axes of size 1, as numpy broadcasts."""
        if shape == self.shape:
            return self
        return self.moved(np.broadcast_to(self.places, shape))


def limited(places: Places) -> Places:
    """Refuse more places than a tensor may have: they may be a view of a few, and cost nothing yet."""
    if places.size > MOST_NUMBERS:
        raise RefusedError(f"a tensor of shape {places.shape} has more than {MOST_NUMBERS} numbers")
    return places


def elementwise(function: Callable[..., Column], *operands: Tensor) -> Tensor:
    """A function of numbers, entry by entry, of operands that are broadcast as numpy does."""
    shape = np.broadcast_shapes(*(operand.shape for operand in operands))
    size = limited(np.broadcast_to(np.intp(0), shape)).size
    # Single numbers are repeated by the arithmetic itself.
    columns = [o.column if o.size in (1, size) else o.moved_to(shape).column for o in operands]
    if any(isinstance(column, ca.MX) for column in columns):
        columns = [ca.DM(column) if isinstance(column, np.ndarray) else column for column in columns]
    return Tensor(function(*columns), shape, *_both(operands))


def matmul(a: Tensor, b: Tensor) -> Tensor:
    """Product of matrices, stacks of them and vectors, as numpy's."""
    if not a.shape or not b.shape:
        raise RefusedError("expected matrices or vectors, got a single number")
    left = a.reshaped((1, *a.shape)) if len(a.shape) == 1 else a
    right = b.reshaped((*b.shape, 1)) if len(b.shape) == 1 else b
    (m, k), (inner, n) = left.shape[-2:], right.shape[-2:]
    if k != inner:
        raise RefusedError(f"expected {k} rows in the second operand, got its shape {b.shape}")
    stack = np.broadcast_shapes(left.shape[:-2], right.shape[:-2])
    count = math.prod(stack)
    if max(count, 1) * m * max(k, 1) * n > _MOST_PRODUCTS:
        raise RefusedError(f"a product of {a.shape} and {b.shape} takes more than {_MOST_PRODUCTS} products")
    left, right = left.moved_to((*stack, m, k)), right.moved_to((*stack, k, n))
    products = [
        product(A, B, m, k, n)
        for A, B in zip(_pieces(left.column, count), _pieces(right.column, count), strict=True)
    ]
    shape = (*stack, *((m,) if len(a.shape) > 1 else ()), *((n,) if len(b.shape) > 1 else ()))
    return Tensor(products[0] if count == 1 else stacked(products), shape, a.known and b.known)


def total(tensor: Tensor, axes: Sequence[int], *, keep: bool = True) -> Tensor:
    """Sum over axes."""
    return _along(
        lambda column, count: product(column, np.ones((count, 1)), column.shape[0] // count, count, 1),
        tensor,
        axes,
        keep,
    )


def folded(
    function: Callable[[Column, Column], Column], tensor: Tensor, axes: Sequence[int], *, keep: bool = True
) -> Tensor:
    """A function of two numbers, over the entries along axes one after the other."""
    return _along(
        lambda column, count: reduce(function, (column[i::count] for i in range(count))), tensor, axes, keep
    )


greatest = partial(folded, fmax)


def joined(tensors: Sequence[Tensor], axis: int) -> Tensor:
    """One after the other along an axis."""
    firsts = np.cumsum([0, *(tensor.size for tensor in tensors)])
    if firsts[-1] > MOST_NUMBERS:
        raise RefusedError(f"the tensors joined have more than {MOST_NUMBERS} numbers")
    places = np.concatenate(
        [tensor.places + first for tensor, first in zip(tensors, firsts[:-1], strict=True)], axis=axis
    )
    column = _picked(stacked([tensor.column for tensor in tensors]), places)
    return Tensor(column, places.shape, *_both(tensors))


def count_over(tensor: Tensor, axes: Sequence[int]) -> int:
    """How many numbers one entry of a reduction is made of."""
    return math.prod(tensor.shape[axis] for axis in axes)


def axis_of(axis: int, rank: int) -> int:
    """An axis counted from the front."""
    if not -rank <= axis < rank:
        raise RefusedError(f"expected an axis of {rank}, got {axis}")
    return axis % rank


def _along(
    function: Callable[[Column, int], Column], tensor: Tensor, axes: Sequence[int], keep: bool
) -> Tensor:
    """A function of a column and of how many of its numbers in a row become one."""
    if len(set(axes)) != len(axes):
        raise RefusedError(f"expected different axes, got {list(axes)}")
    kept = [axis for axis in range(len(tensor.shape)) if axis not in axes]
    count = count_over(tensor, axes)
    if not 0 < count <= _MOST_REDUCED:
        raise RefusedError(f"expected 1 to {_MOST_REDUCED} numbers to reduce, got {count}")
    column = tensor.moved(tensor.places.transpose([*kept, *axes])).column
    sizes = [1 if axis in axes else n for axis, n in enumerate(tensor.shape) if keep or axis not in axes]
    return Tensor(function(column, count), tuple(sizes), tensor.known, tensor.whole)


def _both(operands: Sequence[Tensor]) -> tuple[bool, bool]:
    """Whether all are known, and whether all are whole numbers."""
    return all(operand.known for operand in operands), all(operand.whole for operand in operands)


def _picked(column: Column, places: Places) -> Column:
    flat = places.ravel()
    if flat.size == column.shape[0] and np.array_equal(flat, np.arange(flat.size)):
        return column
    # CasADi picks a row from a single number.
    return ca.vec(column[flat.tolist()]) if isinstance(column, ca.MX) else column[flat]


def _pieces(column: Column, count: int) -> list[Column]:
    if count == 1:
        return [column]
    size = column.shape[0] // max(count, 1)
    return [column[i * size : (i + 1) * size] for i in range(count)]
