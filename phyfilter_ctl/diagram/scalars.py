"""Numbers and arrays that a Python function computes with as if they were numpy's, and that leave CasADi expressions.

They refuse what would lose the expression (``float(x)`` of Python's own, a compiled routine), and ask
:class:`branches.Path <phyfilter_ctl.diagram.branches.Path>` where a number has to be known: at ``if`` and in an index.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, TypeAlias, cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from .branches import UntraceableError, current

__all__ = [
    "CIRCULAR",
    "OVERRIDES",
    "Array",
    "Traced",
    "applied",
    "as_array",
    "has_traced",
    "plain",
    "ufunc_call",
]

OVERRIDES: dict[Any, Callable[..., Any]] = {}
"""What stands for functions of numpy that are no ufuncs; :mod:`shim` fills it."""
Number: TypeAlias = "Traced | float"


def _rint(a: ca.SX) -> ca.SX:
    up = ca.floor(a + 0.5)
    return up - ca.logic_and(up == a + 0.5, ca.fmod(up, 2) != 0)


def _trunc(a: ca.SX) -> ca.SX:
    return ca.if_else(a < 0, ca.ceil(a), ca.floor(a))


def _extreme(past: Callable[..., Any], reaches: Callable[..., Any]) -> Callable[..., ca.SX]:
    """The greater or less of two numbers: not-a-number where one of them is, which C's fmax and fmin pass over."""

    def chosen(a: Any, b: Any) -> ca.SX:
        if not isinstance(a, ca.SX):
            a, b = b, a
        if not isinstance(b, ca.SX) and not math.isnan(b):
            return ca.if_else(past(b, a), b, a)
        return ca.if_else(past(b, a), b, ca.if_else(reaches(a, b), a, a + b))

    return chosen


def _is_nan(a: ca.SX) -> ca.SX:
    return ca.logic_not(ca.logic_or(a <= 0, a > 0))  # CasADi takes a == a for granted


def _unchanged(a: ca.SX) -> ca.SX:
    return a


CIRCULAR = ("sin", "cos", "tan", "sinh", "cosh", "tanh")
_SAME_NAME = (
    "exp", "expm1", "log", "log10", "log1p", "sqrt", "sign", "floor", "ceil", "fmod", "fmax", "fmin",
)  # fmt: skip
# By the names of numpy's ufuncs.
_FUNCTIONS: dict[str, Callable[..., ca.SX]] = {
    **{name: getattr(ca, name) for name in (*CIRCULAR, *_SAME_NAME)},
    **{f"arc{name}": getattr(ca, f"a{name}") for name in CIRCULAR},
    "arctan2": ca.atan2,
    "add": lambda a, b: a + b,
    "subtract": lambda a, b: a - b,
    "multiply": lambda a, b: a * b,
    "divide": lambda a, b: a / b,
    "power": ca.power,
    "float_power": ca.power,
    "floor_divide": lambda a, b: ca.floor(a / b),
    "remainder": lambda a, b: a - b * ca.floor(a / b),
    "maximum": _extreme(operator.gt, operator.ge),
    "minimum": _extreme(operator.lt, operator.le),
    "hypot": lambda a, b: ca.sqrt(a * a + b * b),
    "copysign": ca.copysign,
    "heaviside": lambda a, b: ca.if_else(a == 0, b, (ca.sign(a) + 1) / 2),
    "less": lambda a, b: a < b,
    "less_equal": lambda a, b: a <= b,
    "greater": lambda a, b: a > b,
    "greater_equal": lambda a, b: a >= b,
    "equal": lambda a, b: a == b,
    "not_equal": lambda a, b: a != b,
    "logical_and": ca.logic_and,
    "logical_or": ca.logic_or,
    "logical_xor": lambda a, b: (a != 0) != (b != 0),
    "bitwise_and": ca.logic_and,
    "bitwise_or": ca.logic_or,
    "logical_not": ca.logic_not,
    "invert": ca.logic_not,
    "negative": lambda a: -a,
    "positive": _unchanged,
    "conjugate": _unchanged,
    "absolute": ca.fabs,
    "fabs": ca.fabs,
    "square": lambda a: a * a,
    "reciprocal": lambda a: 1 / a,
    "exp2": lambda a: 2**a,
    "log2": lambda a: ca.log(a) / math.log(2.0),
    "cbrt": lambda a: ca.sign(a) * ca.fabs(a) ** (1.0 / 3.0),
    "degrees": lambda a: a * (180.0 / math.pi),
    "rad2deg": lambda a: a * (180.0 / math.pi),
    "radians": lambda a: a * (math.pi / 180.0),
    "deg2rad": lambda a: a * (math.pi / 180.0),
    "rint": _rint,
    "trunc": _trunc,
    "isfinite": lambda a: ca.fabs(a) < math.inf,
    "isnan": _is_nan,
    "isinf": lambda a: ca.fabs(a) == math.inf,
}  # fmt: skip
_COMPARISONS = {"less", "less_equal", "greater", "greater_equal", "equal", "not_equal"}
_NAMES = {"mod": "remainder", "true_divide": "divide", "pow": "power", "abs": "absolute"}
_UFUNCS: Any = np


def applied(name: str, *operands: Any) -> Any:
    """A function of numpy, by the name of its ufunc, of numbers of which some are traced."""
    name = _NAMES.get(name, name)
    operands = tuple(
        item.item() if isinstance(item, np.ndarray) and not item.ndim else item for item in operands
    )
    if not any(isinstance(item, Traced) for item in operands):
        with np.errstate(all="ignore"):
            value = getattr(_UFUNCS, name)(*operands)
        return value.item() if isinstance(value, np.generic) else value
    if name not in _FUNCTIONS:
        raise UntraceableError(f"numpy's {name} has no counterpart in CasADi")
    expressions: Any = [item.expression if isinstance(item, Traced) else float(item) for item in operands]
    result = _FUNCTIONS[name](*expressions)
    margin = expressions[0] - expressions[1] if name in _COMPARISONS else None
    return float(result) if result.is_constant() else Traced(result, margin)


def _forward(name: str) -> Any:
    def method(self: Traced, *others: Any) -> Any:
        if any(isinstance(other, np.ndarray | list | tuple | ca.SX | ca.DM) for other in others):
            return NotImplemented
        return applied(name, self, *others)

    return method


def _backward(name: str) -> Any:
    def method(self: Traced, other: Any) -> Any:
        return NotImplemented if isinstance(other, np.ndarray) else applied(name, other, self)

    return method


class Traced:
    """A number that is a CasADi expression; a truth value is one too.

    Parameters
    ----------
    expression : casadi.SX
    margin : casadi.SX, optional
        Of a comparison: what changes its sign where the truth value changes.
    """

    __slots__ = ("expression", "margin")
    __hash__: ClassVar[None] = None  # pyright: ignore[reportIncompatibleMethodOverride]
    shape: tuple[int, ...] = ()
    ndim: int = 0
    size: int = 1

    def __init__(self, expression: ca.SX, margin: ca.SX | None = None) -> None:
        self.expression: ca.SX = expression
        self.margin: ca.SX | None = margin

    def __bool__(self) -> bool:
        return current().decide(self.expression, self.margin)

    def __index__(self) -> int:
        return current().index(self.expression)

    def __float__(self) -> float:
        raise UntraceableError("a signal or parameter is turned into a plain number here")

    __int__ = __float__

    def __complex__(self) -> complex:
        return float(self)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **keywords: Any) -> Any:
        return ufunc_call(ufunc, method, inputs, keywords)

    def __round__(self, digits: int | None = None) -> Any:
        return applied("rint", self) if not digits else applied("rint", self * 10**digits) / 10**digits

    def __divmod__(self, other: Any) -> Any:
        return self // other, self % other

    def __getitem__(self, key: Any) -> Any:
        if key == () or key is Ellipsis:
            return self
        raise IndexError("a number is indexed like an array")

    @property
    def real(self) -> Traced:
        return self

    T = real

    @property
    def imag(self) -> float:
        return 0.0

    def item(self) -> Traced:
        """Itself: it is a number."""
        return self

    def copy(self) -> Traced:
        """Itself: it does not change."""
        return self

    def __deepcopy__(self, memo: object) -> Traced:
        return self

    def astype(self, kind: Any) -> Any:
        """As a number of another kind: int and bool are traced."""
        return _as_kind(self, kind)


_OPERATORS = {
    "add": "add", "sub": "subtract", "mul": "multiply", "truediv": "divide", "floordiv": "floor_divide",
    "mod": "remainder", "pow": "power", "and": "logical_and", "or": "logical_or", "xor": "logical_xor",
}  # fmt: skip
for _short, _name in _OPERATORS.items():
    setattr(Traced, f"__{_short}__", _forward(_name))
    setattr(Traced, f"__r{_short}__", _backward(_name))
for _short, _name in {
    "lt": "less", "le": "less_equal", "gt": "greater", "ge": "greater_equal", "eq": "equal", "ne": "not_equal",
    "neg": "negative", "pos": "positive", "abs": "absolute", "invert": "logical_not", "trunc": "trunc",
    "floor": "floor", "ceil": "ceil",
}.items():  # fmt: skip
    setattr(Traced, f"__{_short}__", _forward(_name))
for _name in _FUNCTIONS:  # numpy's own loops over arrays of objects look for them
    if not hasattr(Traced, _name):
        setattr(Traced, _name, _forward(_name))


def _as_kind(value: Any, kind: Any) -> Any:
    found = np.dtype(object if isinstance(kind, type) and issubclass(kind, float) else kind).kind
    if found in "iu":
        return applied("trunc", value)
    if found in "Of":
        return value
    if found == "b":
        return applied("not_equal", value, 0.0)
    raise UntraceableError(f"a signal or parameter is turned into {kind}")


class Array(np.ndarray):
    """An array of numbers that may be traced; its type is object."""

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **keywords: Any) -> Any:
        return ufunc_call(ufunc, method, inputs, keywords)

    def __array_function__(self, func: Any, types: Any, args: Any, kwargs: Any) -> Any:
        if func in OVERRIDES:
            return OVERRIDES[func](*args, **kwargs)
        return super().__array_function__(func, types, args, kwargs)

    def astype(self, dtype: Any, *args: Any, **keywords: Any) -> Any:
        """Entries as numbers of another kind."""
        return as_array(np.frompyfunc(lambda value: _as_kind(value, dtype), 1, 1)(plain(self)))

    def round(self, decimals: Any = 0, out: Any = None) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Entries rounded."""
        return as_array(np.frompyfunc(lambda value: round(value, decimals), 1, 1)(plain(self)))

    def clip(self, min: Any = None, max: Any = None, *args: Any, **keywords: Any) -> Any:
        """Entries within bounds."""
        return OVERRIDES[np.clip](self, min, max)


def as_array(value: Any) -> Any:
    """An array as one of ours; a number stays one."""
    if isinstance(value, np.ndarray):
        return value.astype(object).view(Array) if value.ndim else value.item()
    return value


def plain(value: Any) -> Any:
    """An array as numpy's own, of objects."""
    if isinstance(value, np.ndarray):
        return np.asarray(value.view(np.ndarray), dtype=object)
    if isinstance(value, Traced):
        array = np.empty((), dtype=object)
        array[()] = value
        return array
    return np.asarray(value, dtype=object)


def has_traced(value: Any) -> bool:
    """Whether a traced number stands somewhere inside."""
    if isinstance(value, Traced):
        return True
    if isinstance(value, np.ndarray):
        return value.dtype == object and any(has_traced(entry) for entry in value.ravel().tolist())
    if isinstance(value, list | tuple):
        return any(has_traced(entry) for entry in value)
    return isinstance(value, dict) and any(has_traced(entry) for entry in value.values())


def ufunc_call(ufunc: np.ufunc, method: str, inputs: Sequence[Any], keywords: dict[str, Any]) -> Any:
    """What numpy's ufunc does, entry by entry."""
    out = keywords.get("out")
    if keywords.get("where", True) is not True or ufunc.nout != 1:
        raise UntraceableError(f"numpy's {ufunc.__name__} is called in a way that cannot be traced")
    arrays = [plain(item) for item in inputs]
    each = np.frompyfunc(functools.partial(applied, ufunc.__name__), ufunc.nin, 1)

    def entry(*parts: Any) -> Any:
        return each(*map(plain, parts))

    if ufunc.signature is not None:
        result = ufunc(*arrays)
    elif ufunc.__name__ == "clip":
        result = np.frompyfunc(_clipped, 3, 1)(*arrays)
    elif method == "__call__":
        result = entry(*arrays)
    elif method == "outer":
        result = entry(arrays[0].reshape(arrays[0].shape + (1,) * arrays[1].ndim), arrays[1])
    elif method == "reduce":
        result = _reduced(entry, ufunc, plain(inputs[0]), keywords)
    elif method == "accumulate":
        slices = np.moveaxis(arrays[0], keywords.get("axis", 0), 0)
        rows = list(slices[:1])
        for row in slices[1:]:
            rows.append(entry(rows[-1], row))
        result = np.moveaxis(np.array(rows, dtype=object), 0, keywords.get("axis", 0))
    else:
        raise UntraceableError(f"numpy's {ufunc.__name__}.{method} cannot be traced")
    if out is not None and out[0] is not None:
        if out[0].dtype != object:
            raise UntraceableError(
                "a signal is written into an array of plain numbers from outside the function"
            )
        out[0].view(np.ndarray)[...] = result
        return out[0]
    return as_array(result)


def _clipped(value: Number, low: Number | None, high: Number | None) -> Number:
    value = value if low is None else applied("maximum", value, low)
    return value if high is None else applied("minimum", value, high)


def _reduced(entry: Any, ufunc: np.ufunc, array: NDArray[np.object_], keywords: dict[str, Any]) -> Any:
    axis = keywords.get("axis", 0)
    axes = tuple(range(array.ndim)) if axis is None else (axis,) if isinstance(axis, int) else tuple(axis)
    axes = tuple(a % array.ndim for a in axes)
    moved = np.moveaxis(array, axes, range(len(axes)))
    slices = list(moved.reshape(-1, *moved.shape[len(axes) :]))
    start = keywords.get("initial", np._NoValue)
    if start is not np._NoValue and start is not None:
        slices = [np.full(moved.shape[len(axes) :], start, dtype=object), *slices]
    if not slices:
        slices = [np.full(moved.shape[len(axes) :], cast(Any, ufunc).identity, dtype=object)]
    result = functools.reduce(entry, slices)
    if keywords.get("keepdims"):
        kept = [1 if i in axes else n for i, n in enumerate(array.shape)]
        result = plain(result).reshape(kept)
    return result
