"""Expressions of robot files: arithmetic on arrays by Python's own grammar, of which nothing else is let in.

A value is an array (N, ...) or (1, ...): the sample comes first and is not seen by the expression, in which a signal of
three columns is a vector of three. ``[0, 0, thrust]`` stacks, ``q[0]`` and ``M[0, 1]`` pick, ``A @ v`` multiplies a
matrix with a vector.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .._sections import FloatArray
from .frames import rotated

__all__ = ["FUNCTIONS", "Expression", "constant"]

Values = Mapping[str, FloatArray]
Function = Callable[..., FloatArray]

_LONGEST = 4000  # characters
_DAMAGE = (SyntaxError, ValueError, RecursionError, MemoryError)


def constant(value: float | list[float] | list[list[float]]) -> FloatArray:
    """A number, vector or matrix as a value: one sample that stands for all."""
    return np.asarray(value, dtype=float)[None]


def _aligned(*values: FloatArray) -> list[FloatArray]:
    """With as many axes behind the sample as the longest, ones put in front, as numpy does without samples."""
    most = max(value.ndim for value in values)
    return [v.reshape(len(v), *[1] * (most - v.ndim), *v.shape[1:]) for v in values]


def _elementwise(function: Function) -> Function:
    return lambda *values: np.asarray(function(*_aligned(*values)), dtype=float)


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
    return A @ b


def _diagonal(vector: FloatArray) -> FloatArray:
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


@dataclass(frozen=True)
class Expression:
    """An expression that was checked: parsed, of the parts allowed, each function known and with its arguments.

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
    functions: Mapping[str, tuple[Function, int]]

    def __init__(self, text: str, functions: Mapping[str, tuple[Function, int]] | None = None) -> None:
        object.__setattr__(self, "text", text)
        object.__setattr__(self, "functions", FUNCTIONS | dict(functions or {}))
        _check(self._tree, self.functions)

    @cached_property
    def _tree(self) -> ast.expr:
        if len(self.text) > _LONGEST:
            raise ValueError(f"expected an expression of at most {_LONGEST} characters, got {len(self.text)}")
        try:
            return ast.parse(self.text.strip(), mode="eval").body
        except _DAMAGE as error:
            raise ValueError(f"no expression: {error}") from error

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
                return _value(self._tree, values, self.functions)
        except (ValueError, IndexError) as error:
            raise ValueError(f"{self.text!r}: {error}") from error


def _check(node: ast.expr, functions: Mapping[str, tuple[Function, int]]) -> None:
    for part in ast.walk(node):
        if isinstance(part, ast.Call):
            name = part.func.id if isinstance(part.func, ast.Name) else ast.unparse(part.func)
            if name not in functions:
                raise ValueError(f"unknown function {name!r}; there are {', '.join(sorted(functions))}")
            expected = functions[name][1]
            if part.keywords or len(part.args) != expected:
                raise ValueError(f"{name}: expected {expected} arguments, got {ast.unparse(part)}")
        elif isinstance(part, ast.Constant):
            if isinstance(part.value, bool) or not isinstance(part.value, int | float):
                raise ValueError(f"expected numbers, got {part.value!r}")
        elif isinstance(part, ast.Subscript):
            _index(part.slice)
        elif isinstance(part, ast.BinOp):
            if type(part.op) not in _BINARY:
                raise ValueError(f"{ast.unparse(part)!r}: expected one of + - * / ** @")
        elif isinstance(part, ast.UnaryOp):
            if not isinstance(part.op, ast.USub | ast.UAdd):
                raise ValueError(f"{ast.unparse(part)!r}: expected + or -")
        elif not isinstance(
            part, ast.Name | ast.List | ast.Tuple | ast.Slice | ast.Load | ast.operator | ast.unaryop
        ):
            raise ValueError(
                f"{ast.unparse(part)!r} is not allowed: numbers, names, [..], + - * / ** @, f(..)"
            )


def _index(node: ast.expr) -> tuple[int | slice, ...]:
    """Whole numbers and slices of them."""
    parts = node.elts if isinstance(node, ast.Tuple) else [node]

    def whole(part: ast.expr | None) -> int | None:
        if part is None:
            return None
        sign, inner = (-1, part.operand) if isinstance(part, ast.UnaryOp) else (1, part)
        if not (isinstance(inner, ast.Constant) and type(inner.value) is int):
            raise ValueError(f"[{ast.unparse(node)}]: expected whole numbers, as in v[0], v[0:2], M[0, 1]")
        return sign * inner.value

    def entry(part: ast.expr) -> int | slice:
        if isinstance(part, ast.Slice):
            return slice(whole(part.lower), whole(part.upper), whole(part.step))
        found = whole(part)
        return 0 if found is None else found

    return tuple(entry(part) for part in parts)


def _value(node: ast.expr, values: Values, functions: Mapping[str, tuple[Function, int]]) -> FloatArray:
    def of(part: ast.expr) -> FloatArray:
        return _value(part, values, functions)

    if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        return constant(float(node.value))
    if isinstance(node, ast.Name):
        return constant(_NUMBERS[node.id]) if node.id in _NUMBERS else values[node.id]
    if isinstance(node, ast.List | ast.Tuple):
        return _stacked([of(part) for part in node.elts])
    if isinstance(node, ast.Subscript):
        return of(node.value)[(slice(None), *_index(node.slice))]
    if isinstance(node, ast.UnaryOp):
        return -of(node.operand) if isinstance(node.op, ast.USub) else of(node.operand)
    if isinstance(node, ast.BinOp):
        return _BINARY[type(node.op)](of(node.left), of(node.right))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        return functions[node.func.id][0](*map(of, node.args))
    raise ValueError(f"{ast.unparse(node)!r} is not allowed")


def _stacked(parts: list[FloatArray]) -> FloatArray:
    if not parts:
        raise ValueError("expected at least one entry in [ ]")
    if len({part.shape[1:] for part in parts}) > 1:
        raise ValueError(f"[..]: expected entries of one shape, got {[part.shape[1:] for part in parts]}")
    n = max(map(len, parts))
    return np.stack([np.broadcast_to(part, (n, *part.shape[1:])) for part in parts], axis=1)
