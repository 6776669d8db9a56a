"""C of scalar CasADi functions in a form that a compiler gets through fast: no questions, and in pieces.

CasADi asks for each number whether its vector is there, and writes one body however long; with tens of thousands of
statements gcc's time goes into branches and into registers, and grows with the square of their number.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import casadi as ca

from .exact_time import TIME, with_exact_time

__all__ = ["APART", "scalar_entry", "signature"]

APART = """\
#if defined(__GNUC__)
#define PF_APART __attribute__((noinline))
#else
#define PF_APART
#endif

"""
_READ = re.compile(r"arg\[(\d+)\]\? arg\[\1\]\[(\d+)\] : 0")
_WRITTEN = re.compile(r"if \(res\[(\d+)\]!=0\) res\[\1\]\[(\d+)\]=")
_LOCAL = re.compile(r"\b[ad]\d+\b")
_ASSIGNED = re.compile(r"\s*([ad]\d+)\s*=(?!=)")
# Statements of one piece: half as many or twice as many take gcc as long.
_PIECE = 500


def signature(name: str, function: ca.Function, prefix: str) -> str:
    """``static int <prefix>_<name>(const pf_real *argument, ..., pf_real *result, ...)``."""
    return f"static int {prefix}_{name}({', '.join(_parameters(function))})"


def kind(argument: str) -> str:
    """C type of an argument: time is double whatever the others are."""
    return "pf_time" if argument == TIME else "pf_real"


def _parameters(function: ca.Function) -> list[str]:
    into = [f"const {kind(function.name_in(i))} *{function.name_in(i)}" for i in range(function.n_in())]
    return into + [f"pf_real *{function.name_out(i)}" for i in range(function.n_out())]


def scalar_entry(
    text: str, name: str, function: ca.Function, prefix: str, body: str, single: bool = False
) -> tuple[str, str]:
    """CasADi's text without the body of a scalar function, and that as a function of its arguments; "" if it is none.

    Parameters
    ----------
    text : str
        C code by CasADi.
    name : str
        Of the function, behind the prefix.
    function : casadi.Function
    prefix : str
        Of all symbols.
    body : str
        CasADi's name of the body.
    single : bool
        Whether the numbers will be float: then what time enters is computed in double.

    Returns
    -------
    text, entry : str
    """
    if not function.is_a("SXFunction") or text.count(f"{body}(") > 1:
        return text, ""
    place = re.search(rf"/\* [^\n]*\*/\nstatic int {body}\([^\n]*\{{\n(.*?)\n\}}\n", text, re.S)
    if place is None:
        return text, ""
    inside = _READ.sub(
        lambda read: f"{function.name_in(int(read.group(1)))}[{read.group(2)}]", place.group(1)
    )
    inside = _WRITTEN.sub(lambda to: f"{function.name_out(int(to.group(1)))}[{to.group(2)}]=", inside)
    if re.search(r"\b(arg|res|iw|w|mem)\b", inside):
        return text, ""
    statements = [line for line in inside.splitlines() if not line.startswith("  casadi_real ")]
    if statements.pop() != "  return 0;" or not all(line.endswith(";") for line in statements):
        return text, ""
    if single:
        statements = with_exact_time(statements)
    pieces = [statements[i : i + _PIECE] for i in range(0, len(statements), _PIECE)]
    before, lines = (
        _in_pieces(pieces, f"{prefix}_{name}", function) if len(pieces) > 1 else ("", _whole(statements))
    )
    unread = [f"  (void){p.rsplit('*', 1)[1]};" for p in _parameters(function)]
    entry = "\n".join(
        [f"{before}{signature(name, function, prefix)} {{", *unread, *lines, "  return PF_OK;", "}", ""]
    )
    return text.replace(place.group(), ""), entry


def _whole(statements: Sequence[str]) -> list[str]:
    return [*_declared(_locals(statements)), *statements]


def _locals(statements: Sequence[str]) -> set[str]:
    return {name for line in statements for name in _LOCAL.findall(line)}


def _declared(variables: set[str]) -> list[str]:
    lines = []
    for letter, real in (("a", "pf_real"), ("d", "pf_time")):
        names = sorted(name for name in variables if name.startswith(letter))
        lines += [f"  {real} {', '.join(names[i : i + 12])};" for i in range(0, len(names), 12)]
    return lines


def _in_pieces(pieces: Sequence[Sequence[str]], name: str, function: ca.Function) -> tuple[str, list[str]]:
    """A function for each piece; what one hands to later ones goes through an array."""
    needs, gives = zip(*map(_traffic, pieces), strict=True)
    later: set[str] = set()
    handed: list[set[str]] = []
    for need, give in zip(reversed(needs), reversed(gives), strict=True):
        handed.append(give & later)
        later = need | (later - give)
    place = {local: i for i, local in enumerate(sorted(set().union(*handed)))}
    exact = any(local.startswith("d") for local in place)
    real = "pf_time" if exact else "pf_real"
    parameters = [*_parameters(function), f"{real} *kept"]
    arguments = ", ".join(p.rsplit("*", 1)[1] for p in parameters)
    functions = []
    for i, (piece, need, give) in enumerate(zip(pieces, needs, reversed(handed), strict=True)):
        lines = [
            f"PF_APART static void {name}_{i}({', '.join(parameters)}) {{",
            *(f"  (void){p.rsplit('*', 1)[1]};" for p in parameters),
            *_declared(_locals(piece)),
            *(
                f"  {local}={'(pf_real)' if exact and local[0] == 'a' else ''}kept[{place[local]}];"
                for local in sorted(need)
            ),
            *piece,
            *(
                f"  kept[{place[local]}]={'(pf_time)' if exact and local[0] == 'a' else ''}{local};"
                for local in sorted(give)
            ),
            "}\n",
        ]
        functions.append("\n".join(lines))
    calls = [f"  {name}_{i}({arguments});" for i in range(len(pieces))]
    return "\n".join(functions) + "\n", [f"  {real} kept[{max(len(place), 1)}];", *calls]


def _traffic(statements: Sequence[str]) -> tuple[set[str], set[str]]:
    """Locals that statements read before they set them, and those that they set."""
    need: set[str] = set()
    give: set[str] = set()
    for line in statements:
        assigned = _ASSIGNED.match(line)
        read = line[assigned.end() :] if assigned else line
        need |= set(_LOCAL.findall(read)) - give
        if assigned:
            give.add(assigned.group(1))
    return need, give
