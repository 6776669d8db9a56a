"""Expressions of robot files: arithmetic on arrays by Python's own grammar, of which nothing else is let in.

A value is an array (N, ...) or (1, ...): the sample comes first and is not seen by the expression, in which a signal of
three columns is a vector of three. ``[0, 0, thrust]`` stacks, ``q[0]`` and ``M[0, 1]`` pick, ``A @ v`` multiplies a
matrix with a vector.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from .._intake import LARGEST, check_count, limited
from .._sections import FloatArray
from .frames import rotated

__all__ = ["FUNCTIONS", "Evaluated", "Expression", "Function", "Functions", "constant"]

Values = Mapping[str, FloatArray]
Function = Callable[..., FloatArray]
Evaluated = Callable[[Values], FloatArray]

_LONGEST = 4000  # characters
_SHOWN = 60  # of them, in a message
_DEEP = (RecursionError, MemoryError)  # what a parser or a walk runs into


def constant(value: float | list[float] | list[list[float]]) -> FloatArray:
    """A number, vector or matrix as a value: one sample that stands for all."""
    return np.asarray(value, dtype=float)[None]


def _aligned(*values: FloatArray) -> list[FloatArray]:
    """With as many axes behind the sample as the longest, ones put in front, as numpy does without samples."""
    most = max(value.ndim for value in values)
    return [v.reshape(len(v), *[1] * (most - v.ndim), *v.shape[1:]) for v in values]


def _fits(shape: Sequence[int]) -> None:
    check_count(8 * math.prod(shape), LARGEST, f"bytes for a value of shape {tuple(shape)}, samples first")


def _elementwise(function: Function) -> Function:
    def of(*values: FloatArray) -> FloatArray:
        aligned = _aligned(*values)
        _fits(np.broadcast_shapes(*(value.shape for value in aligned)))
        return np.asarray(function(*aligned), dtype=float)

    return of


def _over_vector(function: Callable[..., FloatArray]) -> Function:
    def of(vector: FloatArray) -> FloatArray:
        if vector.ndim < 2:
            raise ValueError("expected a vector, got a number")
        return np.asarray(function(vector, axis=-1), dtype=float)

    return of


def _matmul(A: FloatArray, b: FloatArray) -> FloatArray:
    if A.ndim == 3 and b.ndim == 2:
        return (A @ b[..., None])[..., 0]
    if A.ndim == b.ndim == 2:
        return np.sum(A * b, axis=-1)
    _fits((max(len(A), len(b)), *A.shape[1:-1], *b.shape[2:]))
    return A @ b


def _diagonal(vector: FloatArray) -> FloatArray:
    _fits((*vector.shape, vector.shape[-1]))
    return vector[:, :, None] * np.eye(vector.shape[1])


def _unrotated(q: FloatArray, v: FloatArray) -> FloatArray:
    return rotated(q * np.array([1.0, -1.0, -1.0, -1.0]), v)


# Name: function, number of arguments.
FUNCTIONS: dict[str, tuple[Function, int]] = {
    **{
        name: (_elementwise(getattr(np, name)), 1)
        for name in ("sqrt", "exp", "log", "sin", "cos", "tan", "arcsin", "arccos", "arctan", "tanh")
    },
    "abs": (_elementwise(np.abs), 1),
    "sign": (_elementwise(np.sign), 1),
    "arctan2": (_elementwise(np.arctan2), 2),
    "minimum": (_elementwise(np.minimum), 2),
    "maximum": (_elementwise(np.maximum), 2),
    "clip": (_elementwise(np.clip), 3),
    "sum": (_over_vector(np.sum), 1),
    "mean": (_over_vector(np.mean), 1),
    "norm": (_over_vector(np.linalg.norm), 1),
    "cross": (_elementwise(np.cross), 2),
    "diag": (_diagonal, 1),
    "transpose": (lambda A: np.swapaxes(A, 1, 2), 1),
    "rotate": (rotated, 2),
    "unrotate": (_unrotated, 2),
}
_BINARY: dict[type[ast.operator], Function] = {
    ast.Add: _elementwise(operator.add),
    ast.Sub: _elementwise(operator.sub),
    ast.Mult: _elementwise(operator.mul),
    ast.Div: _elementwise(operator.truediv),
    ast.Pow: _elementwise(operator.pow),
    ast.MatMult: _matmul,
}
_NUMBERS = {"pi": np.pi}


Functions = Mapping[str, tuple[Function, int]]


@dataclass(frozen=True)
class Expression:
    """An expression: parsed, checked and ready to be evaluated.

    Parameters
    ----------
    text : str
    functions : mapping
        Further functions by name: (function, number of arguments).

    Raises
    ------
    ValueError
        Naming the part that is not allowed.

    Examples
    --------
    >>> e = Expression("sum(k * u**2) - [0, 1]")
    >>> sorted(e.names)
    ['k', 'u']
    >>> e({"k": constant(2.0), "u": np.array([[1.0, 2.0], [0.0, 3.0]])}).tolist()
    [[10.0, 9.0], [18.0, 17.0]]
    """

    text: str
    functions: Functions = field(default_factory=dict)

    def __post_init__(self) -> None:
        _ = self._evaluate

    @cached_property
    def _tree(self) -> ast.expr:
        if len(self.text) > _LONGEST:
            raise ValueError(f"expected an expression of at most {_LONGEST} characters, got {len(self.text)}")
        try:
            return ast.parse(self.text.strip(), mode="eval").body
        except _DEEP as error:
            raise self._too_deep() from error
        except (SyntaxError, ValueError) as error:
            raise ValueError(f"no expression: {error}") from error

    @cached_property
    def _evaluate(self) -> Evaluated:
        try:
            return _made(self._tree, FUNCTIONS | dict(self.functions))
        except _DEEP as error:
            raise self._too_deep() from error

    def _too_deep(self) -> ValueError:
        return ValueError(f"expected an expression less deep: {self.text[:_SHOWN]!r}...")

    @cached_property
    def names(self) -> frozenset[str]:
        """Signals, constants and other expressions that it takes."""
        called = {id(node.func) for node in ast.walk(self._tree) if isinstance(node, ast.Call)}
        named = {n.id for n in ast.walk(self._tree) if isinstance(n, ast.Name) and id(n) not in called}
        return frozenset(named - set(_NUMBERS))

    def __call__(self, values: Values) -> FloatArray:
        """Its value at every sample.

        Raises
        ------
        ValueError
            If shapes do not go together.
        """
        try:
            with np.errstate(all="ignore"):  # what is not finite is told by those who know why
                return self._evaluate(values)
        except (ValueError, IndexError, OverflowError, MemoryError, RecursionError) as error:
            text = self.text if len(self.text) <= _SHOWN else f"{self.text[:_SHOWN]}..."
            raise ValueError(f"{text!r}: {error or 'out of memory'}") from error


def _made(node: ast.expr, functions: Functions) -> Evaluated:
    """A function of the values for one part of the grammar; what is not named here is not let in."""
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        with limited("a number"):
            number = constant(float(node.value))  # pyright: ignore[reportArgumentType]
        return lambda values: number
    if isinstance(node, ast.Name):
        name = node.id
        return lambda values: constant(_NUMBERS[name]) if name in _NUMBERS else values[name]
    if isinstance(node, ast.Subscript):
        index = _index(node.slice)
        return _applied(lambda value: value[(slice(None), *index)], [node.value], functions)
    if isinstance(node, ast.List | ast.Tuple):
        return _applied(_stacked, node.elts, functions)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        return _applied(
            np.negative if isinstance(node.op, ast.USub) else np.positive, [node.operand], functions
        )
    if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        return _applied(_BINARY[type(node.op)], [node.left, node.right], functions)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        if node.func.id not in functions:
            raise ValueError(f"unknown function {node.func.id!r}; there are {', '.join(sorted(functions))}")
        function, count = functions[node.func.id]
        if node.keywords or len(node.args) != count:
            raise ValueError(f"{node.func.id}: expected {count} arguments, got {ast.unparse(node)}")
        return _applied(function, node.args, functions)
    raise ValueError(f"{ast.unparse(node)!r} is not allowed: numbers, names, [..], + - * / ** @, f(..)")


def _applied(function: Function, parts: Sequence[ast.expr], functions: Functions) -> Evaluated:
    inner = [_made(part, functions) for part in parts]
    return lambda values: function(*(part(values) for part in inner))


def _index(node: ast.expr) -> tuple[int | slice, ...]:
    """Whole numbers and slices of them."""

    def whole(part: ast.expr | None) -> int | None:
        if part is None:
            return None
        try:
            found = ast.literal_eval(part)
        except ValueError:
            found = None
        if type(found) is not int:
            raise ValueError(f"[{ast.unparse(node)}]: expected whole numbers, as in v[0], v[0:2], M[0, 1]")
        return found

    def entry(part: ast.expr) -> int | slice:
        if isinstance(part, ast.Slice):
            return slice(whole(part.lower), whole(part.upper), whole(part.step))
        return whole(part) or 0

    return tuple(map(entry, node.elts if isinstance(node, ast.Tuple) else [node]))


def _stacked(*parts: FloatArray) -> FloatArray:
    if not parts:
        raise ValueError("expected at least one entry in [ ]")
    if len({part.shape[1:] for part in parts}) > 1:
        raise ValueError(f"[..]: expected entries of one shape, got {[part.shape[1:] for part in parts]}")
    n = max(map(len, parts))
    _fits((n, len(parts), *parts[0].shape[1:]))
    return np.stack([np.broadcast_to(part, (n, *part.shape[1:])) for part in parts], axis=1)
