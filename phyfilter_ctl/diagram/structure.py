"""What a CasADi function is made of: which results are affine in which arguments, and where they switch.

Derivatives do not see a jump: that of ``where(x < 1, 1, 2)`` is 0 nearly everywhere. The instructions of a function do.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import casadi as ca

from .branches import key_of

__all__ = ["Structure", "Switch", "has_switches", "is_affine", "structure_of"]

_OP: dict[str, int] = {name[3:]: getattr(ca, name) for name in dir(ca) if name.startswith("OP_")}


def _operations(*names: str) -> frozenset[int]:
    return frozenset(_OP[name] for name in names)


_LINEAR = _operations("ASSIGN", "NEG", "TWICE", "LIFT", "PRINTME", "ADD", "SUB")
_COMPARISONS, _EQUALITIES = _operations("LT", "LE"), _operations("EQ", "NE")
_LOGIC = _operations("AND", "OR", "NOT")
_BENDS = _operations("FABS", "FMIN", "FMAX")
_WHOLE = _operations("FLOOR", "CEIL", "FMOD", "REMAINDER")
_SWITCHING = (
    _COMPARISONS | _EQUALITIES | _LOGIC | _BENDS | _WHOLE | _operations("SIGN", "COPYSIGN", "IF_ELSE_ZERO")
)


class _Value(NamedTuple):
    """Of a slot of the work vector: what is in it, and on what it depends."""

    expression: ca.SX
    degree: int = 0  # in the signals, with all switches where they are: 0 constant, 1 affine, 2 curved
    on: int = 0  # mask of the signals' arguments, those of its switches among them
    switched: bool = False


@dataclass(frozen=True, eq=False)
class Switch:
    """An instruction that jumps.

    Parameters
    ----------
    position : casadi.SX
        Symbol that stands for it in the frozen expressions.
    level : casadi.SX
        Where it passes one of its borders the switch jumps; it may contain positions of switches before.
    borders : {"zero", "whole"}
        0, or all whole numbers. Between two of them lies a range; range n begins at border n: with one border, -1 is
        below it and 0 above.
    value : callable
        Range n (casadi.SX) -> the position there.
    at_border : {"below", "above", "between"}
        The range whose position it has on a border.
    now : casadi.SX
        The position as the instruction has it.
    on : int
        Mask of the arguments that act on its level.
    """

    position: ca.SX
    level: ca.SX
    borders: Literal["zero", "whole"]
    value: Callable[[ca.SX], ca.SX]
    at_border: Literal["below", "above", "between"]
    now: ca.SX
    on: int


@dataclass(frozen=True, eq=False)
class Structure:
    """Outcome of :func:`structure_of`.

    Parameters
    ----------
    arguments : list of casadi.SX
    results : list of casadi.SX
        The function's results with the positions of the switches as symbols: smooth, but for bends.
    switches : list of Switch
        Later ones may depend on earlier ones.
    degrees : list of int
        Largest degree of the entries of each result in the signals: 0 constant, 1 affine, 2 curved.
    switched : bool
        Whether a signal acts on a result through a switch or a bend.
    """

    arguments: list[ca.SX]
    results: list[ca.SX]
    switches: list[Switch]
    degrees: list[int]
    switched: bool


def is_affine(function: ca.Function, signals: Sequence[int]) -> bool:
    """Whether all results are jointly affine in some arguments, by what they are made of.

    Parameters
    ----------
    function : casadi.Function
    signals : sequence of int
        Those arguments; the others count as constant.

    Returns
    -------
    bool
        False where they act through a switch (comparison, sign, floor ...) or a bend (abs, min, max), and where a
        solver or a callback inside cannot be looked into.

    Examples
    --------
    >>> x = ca.SX.sym("x")
    >>> is_affine(ca.Function("f", [x], [3 * x + 1]), [0])
    True
    >>> is_affine(ca.Function("f", [x], [ca.if_else(x < 1, 1, 2)]), [0])
    False
    """
    try:
        expanded = _scalar(function)
    except RuntimeError:
        return False
    if not has_switches(expanded):
        arguments = [ca.SX.sym(f"a{i}", expanded.sparsity_in(i)) for i in range(expanded.n_in())]
        result = ca.veccat(*expanded.call(arguments))
        by = ca.veccat(*(arguments[i] for i in signals))
        return not (result.numel() and by.numel() and any(ca.which_depends(result, by, 2)))
    try:
        found = structure_of(expanded, signals)
    except (RuntimeError, NotImplementedError):  # scalar instructions may call a solver too
        return False
    return not found.switched and max(found.degrees, default=0) < 2


def has_switches(function: ca.Function) -> bool:
    """Whether there is a switch or a bend among the scalar instructions of a function, whatever it acts on."""
    return any(function.instruction_id(k) in _SWITCHING for k in range(function.n_instructions()))


def structure_of(function: ca.Function, signals: Sequence[int]) -> Structure:
    """Walks over the instructions of a function.

    Parameters
    ----------
    function : casadi.Function
    signals : sequence of int
        Arguments that vary; the others count as constant.

    Returns
    -------
    Structure

    Raises
    ------
    RuntimeError
        For a function that has no scalar instructions: with a solver, an interpolant or a callback inside.
    """
    return _Walk(_scalar(function), signals).structure()


def _scalar(function: ca.Function) -> ca.Function:
    expanded = function if function.is_a("SXFunction") else function.expand()
    if any(expanded.instruction_id(k) == _OP["CALL"] for k in range(expanded.n_instructions())):
        raise RuntimeError(f"{function.name()} calls a function that cannot be looked into")
    return expanded


class _Walk:
    def __init__(self, function: ca.Function, signals: Sequence[int]) -> None:
        self._function, self._signals = function, set(signals)
        self._switches: list[Switch] = []
        self._known: dict[tuple[str, str], Switch] = {}

    def structure(self) -> Structure:
        function = self._function
        arguments = [ca.SX.sym(f"a{i}", function.sparsity_in(i)) for i in range(function.n_in())]
        entries: list[Any] = [argument.nz for argument in arguments]
        found: list[list[_Value]] = [
            [_Value(ca.SX(0))] * function.nnz_out(i) for i in range(function.n_out())
        ]
        work: list[_Value] = [_Value(ca.SX(0))] * function.sz_w()
        for k in range(function.n_instructions()):
            operation = function.instruction_id(k)
            read, written = function.instruction_input(k), function.instruction_output(k)
            if operation == _OP["CONST"]:
                work[written[0]] = _Value(ca.SX(function.instruction_constant(k)))
            elif operation == _OP["INPUT"]:
                varies = read[0] in self._signals
                entry = entries[read[0]][read[1]]
                work[written[0]] = _Value(entry, int(varies), (1 << read[0]) if varies else 0)
            elif operation == _OP["OUTPUT"]:
                found[written[0]][written[1]] = work[read[0]]
            else:
                work[written[0]] = self._apply(operation, [work[i] for i in read])
        results = [
            ca.SX(function.sparsity_out(i), ca.densify(ca.vertcat(*(v.expression for v in row))))
            if row
            else ca.SX(function.sparsity_out(i))
            for i, row in enumerate(found)
        ]
        degrees = [max((value.degree for value in row), default=0) for row in found]
        switched = any(value.switched for row in found for value in row)
        return Structure(arguments, results, self._switches, degrees, switched)

    def _apply(self, operation: int, values: list[_Value]) -> _Value:
        first, last = values[0], values[-1]
        degree, on = max(v.degree for v in values), 0
        for value in values:
            on |= value.on
        switched = any(value.switched for value in values)
        expression = _applied(operation, [value.expression for value in values])
        if not degree or operation in _LINEAR:  # what depends on positions only jumps with them
            return _Value(expression, degree, on, switched)
        if operation == _OP["IF_ELSE_ZERO"]:
            chosen = self._truth(first)
            # Not the product alone: the side that is not taken may be infinite.
            blended = chosen.expression * ca.if_else(chosen.expression != 0, last.expression, 0)
            return _Value(blended, last.degree, on, switched or chosen.switched)
        if operation in (_OP["MUL"], _OP["DIV"]):
            curved = (first.degree and last.degree) or (operation == _OP["DIV"] and last.degree)
            return _Value(expression, 2 if curved else degree, on, switched)
        if operation not in _SWITCHING:
            return _Value(expression, 2, on, switched)
        if operation in _BENDS:
            return _Value(expression, degree, on, True)
        if operation == _OP["COPYSIGN"]:  # its size is a bend, its sign a switch
            sign = self._switch(
                last.expression,
                "zero",
                lambda n: 2 * n + 1,
                "above",
                ca.if_else(last.expression < 0, -1, 1),
                last.on,
            )
            return _Value(sign * ca.fabs(first.expression), first.degree, on, True)
        if operation in _LOGIC:
            truths = [self._truth(value).expression for value in values]
            return _Value(_applied(operation, truths), 0, on, True)
        if operation in _EQUALITIES:
            # With a position, on the border of its switch: never between. With a number, at points only: as it stands.
            beside = any(not value.degree and value.on for value in values)
            return _Value(ca.SX(operation == _OP["NE"]) if beside else expression, 0, on, True)
        return self._jump(operation, values, on)

    def _jump(self, operation: int, values: list[_Value], on: int) -> _Value:
        first, last = values[0].expression, values[-1].expression
        plain = _applied(operation, [value.expression for value in values])
        if operation in _COMPARISONS:
            border = "above" if operation == _OP["LT"] else "below"
            return _Value(self._switch(first - last, "zero", lambda n: -n, border, plain, on), 0, on, True)
        if operation == _OP["SIGN"]:
            return _Value(self._switch(first, "zero", lambda n: 2 * n + 1, "between", plain, on), 0, on, True)
        if operation == _OP["FLOOR"]:
            return _Value(self._switch(first, "whole", lambda n: n, "above", plain, on), 0, on, True)
        if operation == _OP["CEIL"]:
            return _Value(self._switch(first, "whole", lambda n: n + 1, "below", plain, on), 0, on, True)
        quotient, degree = first / last, 2 if values[-1].degree else values[0].degree
        if operation == _OP["FMOD"]:  # a - b times the whole part of a / b, towards 0
            now = ca.if_else(quotient < 0, ca.ceil(quotient), ca.floor(quotient))
            whole = self._switch(quotient, "whole", lambda n: ca.if_else(n < 0, n + 1, n), "above", now, on)
        else:  # a - b times the whole number next to a / b
            whole = self._switch(quotient + 0.5, "whole", lambda n: n, "above", ca.floor(quotient + 0.5), on)
        return _Value(first - whole * last, degree, on, True)

    def _truth(self, value: _Value) -> _Value:
        """A value as 0 or 1: a number that varies is true but at points."""
        return _Value(ca.SX(1), 0, value.on, True) if value.degree else value

    def _switch(
        self,
        level: ca.SX,
        borders: Literal["zero", "whole"],
        value: Callable[[ca.SX], ca.SX],
        at_border: Literal["below", "above", "between"],
        now: ca.SX,
        on: int,
    ) -> ca.SX:
        """The symbol of its position; one for equal levels and positions."""
        key = key_of(level), key_of(now)
        if key not in self._known:
            position = ca.SX.sym(f"m{len(self._switches)}")
            self._known[key] = Switch(position, level, borders, value, at_border, now, on)
            self._switches.append(self._known[key])
        return self._known[key].position


def _applied(operation: int, parts: Sequence[ca.SX]) -> ca.SX:
    return ca.SX.unary(operation, parts[0]) if len(parts) == 1 else ca.SX.binary(operation, *parts)
