"""numpy, math and Python's own functions as a traced function sees them.

:func:`rebound` makes a copy of a function in which the names ``np``, ``math``, ``float``, ``int``, ... mean what is
defined here, in the functions that it calls too. The original and the modules stay as they are.
"""

from __future__ import annotations

import builtins
import functools
import math
import types
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from typing import Any

import casadi as ca
import control as ct
import numpy as np

from ..blocks.lookup import interpolated
from .branches import UntraceableError
from .scalars import CIRCULAR, OVERRIDES, Array, Traced, applied, as_array, has_traced, plain, ufunc_call

__all__ = ["USES_CASADI", "rebound"]

USES_CASADI = -1  # key of what rebound has seen, beside the identities of functions
_Any: Any = np  # numpy's stubs know no arrays of traced numbers


def _expression(value: Any) -> ca.SX:
    return value.expression if isinstance(value, Traced) else ca.SX(float(value))


def _matrix(value: Any) -> ca.SX:
    """Rows and columns as CasADi's matrix; a vector as a column."""
    array = np.atleast_1d(plain(value))
    if array.ndim > 2:
        raise UntraceableError("a stack of matrices cannot be traced")
    rows = array.reshape(len(array), -1)
    return ca.vertcat(*(ca.horzcat(*map(_expression, row)) for row in rows))


def _from_matrix(matrix: ca.SX, shape: Sequence[int]) -> Any:
    array = np.empty(matrix.shape, dtype=object)
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            entry = matrix[i, j]
            array[i, j] = float(entry) if entry.is_constant() else Traced(entry)
    return as_array(array.reshape(tuple(shape)))


def _where(condition: Any, yes: Any = None, no: Any = None) -> Any:
    if yes is None:
        raise UntraceableError("np.where with a condition alone gives as many indices as there are")
    return as_array(np.frompyfunc(_chosen, 3, 1)(plain(condition), plain(yes), plain(no)))


def _chosen(condition: Any, yes: Any, no: Any) -> Any:
    if not isinstance(condition, Traced):
        return yes if condition else no
    first, second = (
        side.expression if isinstance(side, Traced) else ca.SX(float(side)) for side in (yes, no)
    )
    return Traced(ca.if_else(condition.expression, first, second))


def _select(conditions: Any, choices: Any, default: Any = 0) -> Any:
    result = default
    for condition, choice in reversed(list(zip(conditions, choices, strict=True))):
        result = _where(condition, choice, result)
    return result


def _clip(value: Any, low: Any = None, high: Any = None, **bounds: Any) -> Any:
    low, high = bounds.pop("min", low), bounds.pop("max", high)
    value = value if low is None else ufunc_call(np.maximum, "__call__", (value, low), {})
    return value if high is None else ufunc_call(np.minimum, "__call__", (value, high), {})


def _nan_to_num(x: Any, copy: bool = True, nan: Any = 0.0, posinf: Any = None, neginf: Any = None) -> Any:
    largest = float(np.finfo(float).max)
    x = _where(_called(np.isnan, x), nan, x)
    x = _where(_called(np.equal, x, math.inf), largest if posinf is None else posinf, x)
    return _where(_called(np.equal, x, -math.inf), -largest if neginf is None else neginf, x)


def _interp(x: Any, xp: Any, fp: Any, left: Any = None, right: Any = None, period: Any = None) -> Any:
    if period is not None or has_traced(xp):
        raise UntraceableError("np.interp with a period, or at places that are signals, cannot be traced")
    places, values = np.asarray(plain(xp), dtype=float), [_expression(value) for value in plain(fp)]

    def at(place: Any) -> Any:
        result = interpolated(_expression(place), places, values)
        result = Traced(result) if not result.is_constant() else float(result)
        result = result if left is None else _chosen(place < places[0], left, result)
        return result if right is None else _chosen(place > places[-1], right, result)

    return as_array(np.frompyfunc(at, 1, 1)(plain(x)))


def _norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
    array = plain(x)
    if axis is None and array.ndim == 2 and ord not in (None, "fro"):
        raise UntraceableError(f"the {ord}-norm of a matrix cannot be traced")
    if axis is None and array.ndim != 1:
        array, ord = array.reshape(-1), None
    array, along = array.view(Array), {"axis": axis, "keepdims": keepdims}
    if ord in (None, 2, "fro"):
        return np.sqrt(_Any.add.reduce(array * array, **along))
    if ord in (1, math.inf, -math.inf):
        ufunc = {1: np.add, math.inf: np.maximum, -math.inf: np.minimum}[ord]
        return _Any.ufunc.reduce(ufunc, np.abs(array), **along)
    return _Any.add.reduce(np.abs(array) ** ord, **along) ** (1.0 / ord)


def _solve(a: Any, b: Any) -> Any:
    return _from_matrix(ca.solve(_matrix(a), _matrix(b)), np.shape(plain(b)))


def _inverse(a: Any) -> Any:
    return _from_matrix(ca.inv(_matrix(a)), np.shape(plain(a)))


def _determinant(a: Any) -> Any:
    result = ca.det(_matrix(a))
    return float(result) if result.is_constant() else Traced(result)


def _matrix_power(a: Any, n: int) -> Any:
    return functools.reduce(np.matmul, [a if n > 0 else _inverse(a)] * abs(n), as_array(np.eye(len(a))))


def _sum_of_products(*arguments: Any) -> Any:
    return as_array(np.einsum(arguments[0], *map(plain, arguments[1:]), optimize=False))


OVERRIDES |= {
    np.where: _where,
    np.select: _select,
    np.clip: _clip,
    np.interp: _interp,
    np.round: lambda a, decimals=0: a.round(decimals) if isinstance(a, Array) else round(a, decimals),
    np.nan_to_num: _nan_to_num,
    np.einsum: _sum_of_products,
    np.linalg.norm: _norm,
    np.linalg.solve: _solve,
    np.linalg.inv: _inverse,
    np.linalg.det: _determinant,
    np.linalg.matrix_power: _matrix_power,
}
# What takes several arrays in a list, and what makes arrays.
_SEVERAL = {
    np.concatenate, np.hstack, np.vstack, np.stack, np.column_stack, np.dstack, np.block, np.select, np.einsum,
    np.append, np.where, np.linalg.multi_dot,
}  # fmt: skip
_MAKERS = {"array", "asarray", "asanyarray", "ascontiguousarray", "atleast_1d", "atleast_2d", "copy"}


def _constant(value: Any) -> Any:
    """Our arrays without traced numbers as numpy's own."""
    if isinstance(value, np.ndarray) and value.dtype == object:
        return np.array(value.tolist())
    if isinstance(value, list | tuple):
        return type(value)(_constant(entry) for entry in value)
    return value


def _called(function: Callable[..., Any], *arguments: Any, **keywords: Any) -> Any:
    """A function of numpy on what may be traced."""
    if function is np.isscalar:
        return isinstance(arguments[0], Traced) or np.isscalar(arguments[0])
    keywords = {key: _plain_type(value) if key == "dtype" else value for key, value in keywords.items()}
    if not has_traced([*arguments, keywords]):
        into = keywords.get("out")
        keywords = {key: value if key == "out" else _constant(value) for key, value in keywords.items()}
        if into is not None:
            raise UntraceableError("out= with plain numbers cannot be traced")
        result = function(*map(_constant, arguments), **keywords)
        return as_array(result) if isinstance(result, np.ndarray) and result.dtype.kind in "iuf" else result
    keywords.pop("dtype", None)
    if isinstance(function, np.ufunc):
        return ufunc_call(function, "__call__", arguments, keywords)
    inner = _each_held if function in _SEVERAL else _held
    arguments = tuple(inner(argument) for argument in arguments)
    return as_array(OVERRIDES.get(function, function)(*arguments, **keywords))


def _held(value: Any) -> Any:
    """Traced numbers, and lists of them, as arrays, which numpy's functions then leave to ours."""
    return plain(value).view(Array) if has_traced(value) else value


def _each_held(value: Any) -> Any:
    return [_held(entry) for entry in value] if isinstance(value, list | tuple) else _held(value)


def _plain_type(kind: Any) -> Any:
    return float if kind is _Float else int if kind is _Integer else kind


def _made(function: Any, *arguments: Any, **keywords: Any) -> Any:
    """An array that traced numbers can be written into."""
    kind = _plain_type(keywords.pop("dtype", None))
    if has_traced(arguments):
        held = plain(arguments[0]).view(Array)
        ready = as_array(function(held, *arguments[1:], **keywords))
        return ready if kind is None else ready.astype(kind)
    result = function(*map(_constant, arguments), **keywords, **({} if kind is None else {"dtype": kind}))
    return (
        as_array(result)
        if isinstance(result, np.ndarray) and result.dtype.kind in "iuf" and result.ndim
        else result
    )


class _Seen:
    """A module or an object whose functions take traced numbers; what they set on it stays here."""

    def __init__(self, original: Any, seen: dict[int, Any]) -> None:
        self.__dict__ |= {"_shim_original": original, "_shim_seen": seen}

    def __getattr__(self, name: str) -> Any:
        original, seen = self.__dict__["_shim_original"], self.__dict__["_shim_seen"]
        value = getattr(original, name)
        if isinstance(value, types.MethodType) and value.__self__ is original:
            return types.MethodType(_counterpart(value.__func__, seen), self)
        return _counterpart(value, seen)


class _Kind(type):
    """Type of what stands for ``float`` or ``int``: those count as its instances."""

    def __instancecheck__(cls, instance: object) -> bool:
        return isinstance(instance, (cls.__mro__[1], Traced))

    def __eq__(cls, other: object) -> bool:
        return other is cls or other is cls.__mro__[1]

    def __hash__(cls) -> int:
        return hash(cls.__mro__[1])


class _Float(float, metaclass=_Kind):
    def __new__(cls, value: Any = 0.0) -> Any:
        value = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
        return value if isinstance(value, Traced) else float(value)


class _Integer(int, metaclass=_Kind):
    def __new__(cls, value: Any = 0, *base: Any) -> Any:
        value = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
        return applied("trunc", value) if isinstance(value, Traced) else int(value, *base)


def _extreme(ufunc: str, original: Callable[..., Any]) -> Callable[..., Any]:
    def chosen(*values: Any, **keywords: Any) -> Any:
        entries = list(values[0]) if len(values) == 1 else list(values)
        if keywords or not has_traced(entries):
            return original(entries, **keywords)
        return functools.reduce(functools.partial(applied, ufunc), entries)

    return chosen


def _round(value: Any, digits: int | None = None) -> Any:
    return value.__round__(digits) if isinstance(value, Traced) else round(value, digits)


def _logarithm(value: Any, base: Any = None) -> Any:
    result = applied("log", value)
    return result if base is None else result / applied("log", base)


_SAME_NAME = (
    *CIRCULAR, "exp", "expm1", "log10", "log1p", "log2", "sqrt", "fabs", "copysign", "fmod", "degrees", "radians",
    "floor", "ceil", "trunc", "isfinite", "isnan", "isinf", "cbrt", "exp2",
)  # fmt: skip
_OF_MATH: dict[str, Any] = {
    **{name: functools.partial(applied, name) for name in _SAME_NAME},
    **{f"a{name}": functools.partial(applied, f"arc{name}") for name in CIRCULAR},
    "atan2": functools.partial(applied, "arctan2"),
    "pow": functools.partial(applied, "power"),
    "log": _logarithm,
    "hypot": lambda *values: _norm(list(values)),
    "dist": lambda p, q: _norm([a - b for a, b in zip(p, q, strict=True)]),
    "prod": lambda values, start=1: functools.reduce(lambda a, b: a * b, values, start),
    "fsum": lambda values: sum(values),
}  # fmt: skip
_BUILTINS: dict[Any, Any] = {
    float: _Float, int: _Integer, max: _extreme("maximum", max), min: _extreme("minimum", min), round: _round,
}  # fmt: skip


def _either(original: Callable[..., Any], ours: Callable[..., Any]) -> Callable[..., Any]:
    """Python's own function on numbers, ours where one is traced."""

    def called(*arguments: Any, **keywords: Any) -> Any:
        return (ours if has_traced(arguments) else original)(*arguments, **keywords)

    return called


def _counterpart(value: Any, seen: dict[int, Any]) -> Any:
    """What a function sees in place of a module, function or container."""
    named = value.__name__ if isinstance(value, types.ModuleType) else getattr(value, "__module__", None)
    home = named.partition(".")[0] if isinstance(named, str) else ""
    if home == "casadi":
        seen[USES_CASADI] = True
    if home in ("casadi", "phyfilter_ctl"):
        return value
    if isinstance(value, types.ModuleType):
        return _Seen(value, seen)
    if isinstance(value, list | dict | set | ct.InputOutputSystem):
        return seen[id(value)] if id(value) in seen else _copied(value, seen)
    if isinstance(value, types.MethodType):
        own = value.__self__
        own = own if isinstance(own, type | types.ModuleType) else _Seen(own, seen)
        return types.MethodType(_counterpart(value.__func__, seen), own)
    if isinstance(value, functools.partial):
        return functools.partial(_counterpart(value.func, seen), *value.args, **value.keywords)
    if isinstance(value, np.ufunc):
        return _Ufunc(value)
    if isinstance(value, type):
        kinds = {np.floating: _Float, np.integer: _Integer}
        return next(
            (ours for kind, ours in kinds.items() if issubclass(value, kind)), _BUILTINS.get(value, value)
        )
    if home == "math" and value.__name__ in _OF_MATH:
        return _either(value, _OF_MATH[value.__name__])
    if home == "numpy" and callable(value):
        return functools.partial(_made if getattr(value, "__name__", "") in _MAKERS else _called, value)
    if isinstance(value, types.FunctionType):
        return rebound(value, seen)
    return _BUILTINS.get(value, value) if isinstance(value, types.BuiltinFunctionType) else value


def _copied(value: Any, seen: dict[int, Any]) -> Any:
    """A container or a system of its own: what a function keeps in it, the original does not see."""
    if isinstance(value, ct.InputOutputSystem):
        seen[id(value)] = _Seen(value, seen)
    elif isinstance(value, list):
        seen[id(value)] = copies = []
        copies += [_counterpart(entry, seen) for entry in value]
    elif isinstance(value, dict):
        seen[id(value)] = entries = {}
        entries |= {key: _counterpart(entry, seen) for key, entry in value.items()}
    else:
        seen[id(value)] = copy(value)
    return seen[id(value)]


class _Ufunc:
    def __init__(self, ufunc: np.ufunc) -> None:
        self._ufunc = ufunc

    def __call__(self, *arguments: Any, **keywords: Any) -> Any:
        return _called(self._ufunc, *arguments, **keywords)

    def __getattr__(self, name: str) -> Any:
        return functools.partial(_called, getattr(self._ufunc, name))


def rebound(function: Any, seen: dict[int, Any] | None = None) -> Any:
    """A copy of a function that can be called with traced numbers.

    Parameters
    ----------
    function : function, method or callable
    seen : dict, optional
        Copies made before, by the identity of their originals.

    Returns
    -------
    callable
        What is no Python function comes back as it is.
    """
    seen = {} if seen is None else seen
    if not isinstance(function, types.FunctionType):
        return _counterpart(function, seen)
    if id(function) in seen:
        return seen[id(function)]
    scope: dict[str, Any] = {
        "__builtins__": _own_builtins(seen)
    }  # Python looks for them when it makes the function
    cells = tuple(types.CellType() for _ in function.__closure__ or ())
    twin = types.FunctionType(
        function.__code__, scope, function.__name__, function.__defaults__, cells or None
    )
    twin.__kwdefaults__ = function.__kwdefaults__
    seen[id(function)] = twin
    given: Mapping[str, Any] = function.__globals__
    scope |= {name: _counterpart(given[name], seen) for name in _names(function.__code__) if name in given}
    scope["__name__"] = given.get("__name__")
    for cell, original in zip(cells, function.__closure__ or (), strict=True):
        try:
            cell.cell_contents = _counterpart(original.cell_contents, seen)
        except ValueError:  # not filled yet
            continue
    return twin


def _names(code: types.CodeType) -> set[str]:
    """Global names of a function and of those inside it."""
    inner = [_names(constant) for constant in code.co_consts if isinstance(constant, types.CodeType)]
    return set(code.co_names).union(*inner)


def _own_builtins(seen: dict[int, Any]) -> dict[str, Any]:
    def imported(name: str, *arguments: Any, **keywords: Any) -> Any:
        return _counterpart(builtins.__import__(name, *arguments, **keywords), seen)

    own: dict[str, Any] = dict(vars(builtins))
    for original, ours in _BUILTINS.items():
        own[original.__name__] = ours
    own["__import__"] = imported
    return own
