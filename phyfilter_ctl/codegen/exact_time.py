"""Time in float code: what an equation computes from it is double until nothing is lost any more.

A float has no digit for milliseconds left after a day, and sin(50 t) is anything then. So time comes in as double and
stays it, in sums, products and powers with anything; the value of a function that does not grow with it (sin, exp, a
comparison) goes on in float, and so does every result.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

__all__ = ["TIME", "plain_double", "with_exact_time"]

TIME = "t"  # the argument of that name
_MARK = "__exact"  # behind a number or a function that stays double when all others become float
_TIME_READ = f"{TIME}[0]"
_STATEMENT = re.compile(r"^  (a\d+|\w+\[\d+\])=(.*);$")
_NUMBER = r"\d+\.\d*(?:[eE][+-]?\d+)?|\d+[eE][+-]?\d+"
_CONSTANT = re.compile(rf"-?(?:{_NUMBER})")
_NUMBERS = re.compile(rf"(?<![\w.])({_NUMBER})(?![\w.])")
_OPERAND = re.compile(r"\ba\d+\b|(?<!\w)[a-z_]\w*\[\d+\]")
_HELPER = re.compile(r"\bcasadi_(\w+)\(")
_FUNCTION = re.compile(r"\b([a-z]\w*)\((?!pf_)")
_TRUTH = re.compile(r"[<>]|==|!=|&&|\|\||^\(!")
_FADES = re.compile(
    r"^(?:casadi_)?(?:sin|cos|tan|asin|acos|atan|atan2|sinh|cosh|tanh|asinh|acosh|atanh|exp|expm1|log|log1p|erf|sign)"
    r"\("
)


def with_exact_time(statements: Sequence[str]) -> list[str]:
    """The statements of a scalar function with what time enters in double, in locals d0, d1, ... of their own.

    Parameters
    ----------
    statements : sequence of str
        One operation each, on locals a0, a1, ... and arrays.

    Returns
    -------
    list of str
        Numbers and functions in double carry a mark that :func:`plain_double` takes away.

    Examples
    --------
    >>> lines = with_exact_time(["  a0=50.;", "  a1=t[0];", "  a0=(a0*a1);", "  a0=sin(a0);", "  y[0]=a0;"])
    >>> [plain_double(line).strip() for line in lines]
    ['d1=t[0];', 'd0=((50.)*d1);', 'a0=(pf_real)sin(d0);', 'y[0]=a0;']
    """
    if not any(_TIME_READ in line for line in statements):
        return list(statements)
    kinds: dict[str, str] = {}  # of a local: "d", or the constant that it is
    lines = []
    for line in statements:
        found = _STATEMENT.match(line)
        if found is None:
            raise RuntimeError(
                f"C code of CasADi is not laid out as expected: {line.strip()!r}; use CasADi 3.8"
            )
        target, value = found.groups()
        local = target.startswith("a") and target[1:].isdigit()
        if local and _CONSTANT.fullmatch(value):
            kinds[target] = value
            continue
        operands = set(_OPERAND.findall(value))
        exact = _TIME_READ in operands or any(kinds.get(operand) == "d" for operand in operands)
        text = _exact(value, kinds) if exact else _OPERAND.sub(lambda at: _single(at.group(), kinds), value)
        fades = bool(_FADES.match(value)) or not local
        if exact and not fades and not _TRUTH.search(value):
            lines.append(f"  d{target[1:]}={text};")
            kinds[target] = "d"
            continue
        kinds.pop(target, None)
        lines.append(f"  {target}={'(pf_real)' if exact and fades else ''}{text};")
    return lines


def plain_double(text: str) -> str:
    """Without the marks.

    Parameters
    ----------
    text : str

    Returns
    -------
    str
    """
    return text.replace(_MARK, "")


def _single(operand: str, kinds: dict[str, str]) -> str:
    constant = kinds.get(operand)
    return operand if constant is None else f"({constant})"


def _exact(value: str, kinds: dict[str, str]) -> str:
    """An expression with every operand in double."""

    def operand(at: re.Match[str]) -> str:
        name = at.group()
        kind = kinds.get(name)
        if name == _TIME_READ:
            return name
        if kind is None:
            return f"(pf_time){name}"
        return f"d{name[1:]}" if kind == "d" else f"({kind})"

    def helper(found: re.Match[str]) -> str:
        return f"{found.group(1)}("

    text = _OPERAND.sub(operand, value)
    of = re.fullmatch(r"casadi_(sq|sign)\((.*)\)", text)
    if of is not None:
        x = of.group(2)
        text = f"({x}*{x})" if of.group(1) == "sq" else f"({x}<0. ? -1. : {x}>0. ? 1. : {x})"
    text = _FUNCTION.sub(rf"\1{_MARK}(", _HELPER.sub(helper, text))
    return _NUMBERS.sub(rf"\1{_MARK}", text)
