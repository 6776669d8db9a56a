"""CasADi functions as C99 that compiles without a warning and calls nothing but <math.h>."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Literal, cast

import casadi as ca

from ..diagram.rootfinding import QUICK
from .exact_time import TIME, plain_double
from .scalar_source import APART, scalar_entry, signature

__all__ = ["Real", "casadi_header", "dense"]

Real = Literal["double", "float"]

# CasADi's C hands the addresses of its locals down in arrays of its caller, which nobody reads afterwards.
_OPENING = """\
#include <math.h>

#include "pf_model.h"

#if defined(__GNUC__) && !defined(__clang__) && __GNUC__ >= 12
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wdangling-pointer"
#endif

"""
_CLOSING = """
#if defined(__GNUC__) && !defined(__clang__) && __GNUC__ >= 12
#pragma GCC diagnostic pop
#endif
"""
_NO_CODE = (
    "{}: CasADi has no C code for a part of it ({}); solve implicit equations with casadi.rootfinder(..., "
    "'fast_newton', ...), or leave the block with it out of the export"
)
_EXPORTED = (
    r"\nint {0}\(const casadi_real\*\* arg.*?casadi_f(\d+)\(.*?"
    r"\nint {0}_work\(.*?\n}}\n(?:\nint {0}_work_bytes\(.*?\n}}\n)?"
)
_CONFIGURATION = re.compile(
    r"/\* Configuration this file was compiled with \*/\n.*?_real_size\(void\)[^\n]*\n", re.S
)
_LANGUAGE = re.compile(r"\n#ifdef __cplusplus\n.*?#endif\n", re.S)
_HELPER = re.compile(r"^(casadi_real|casadi_int|void|int) (casadi_\w+\()", re.M)
_BODY = re.compile(r"^(static int casadi_f\d+\(.*\) \{)$", re.M)
_TABLE = re.compile(r"^static const (?:pf|casadi)_real ", re.M)
_NEWTON = re.compile(
    r"(for \(iter=0; iter<)(\d+)(; \+\+iter\) \{.*?\n  \}\n)(  /\* Get the solution \*/)", re.S
)
_FUNCTION = re.compile(r"^/\* (\w+):[^\n]*\*/\nstatic int casadi_f\d+\(.*?^\}$", re.M | re.S)
# CasADi's C takes the last iterate as the solution whatever it is. Steps at the level of rounding are good enough.
_NEWTON_THAT_TELLS = (
    "\\1\\2\\3  if (iter>=\\2 && !(casadi_norm_inf(m.n, m.g) <= 1e-8*(1.+casadi_norm_inf(m.n, m.x))))\n"
    "    return 1;\n\\4"
)
_NORM = re.compile(r"(casadi_norm_inf\(casadi_int n, const casadi_real\* x\) \{\n).*?\n\}\n", re.S)
# fmax loses a NaN, and an iteration that starts from one would end at once as if it had converged.
_NORM_THAT_KEEPS_NAN = """\\1  casadi_real ret = 0;
  for (casadi_int i=0; i<n; ++i) {
    const casadi_real size = fabs(x[i]);
    if (!(size <= ret) && ret == ret) ret = size;
  }
  return ret;
}
"""
_FLOAT_MAX = 3.4028234e38
_FLOAT_MIN = 1.2e-38
_LITERAL = re.compile(r"(?<![\w.])(\d+\.\d*(?:[eE][+-]?\d+)?|\d+[eE][+-]?\d+)(?![\w.])")
_LIBM = re.compile(
    r"\b(sin|cos|tan|asin|acos|atan|sinh|cosh|tanh|asinh|acosh|atanh|exp|expm1|log|log1p|sqrt|pow|fmod|remainder|"
    r"floor|ceil|fabs|fmin|fmax|atan2|hypot|copysign|erf)\("
)


def dense(function: ca.Function, name: str) -> ca.Function:
    """The same function under another name, all its arguments and results dense.

    Examples
    --------
    >>> x = ca.SX.sym("x", 2)
    >>> sparse = ca.Function("f", [x], [ca.sparsify(ca.vertcat(x[0], 0))])
    >>> sparse.nnz_out(0), dense(sparse, "g").nnz_out(0)
    (1, 2)
    """
    # One way of typing for both kinds of expression.
    kind = ca.SX if function.is_a("SXFunction") else cast(type[ca.SX], ca.MX)
    arguments = [kind.sym(function.name_in(i), *function.size_in(i)) for i in range(function.n_in())]
    results = function.call(arguments)
    return ca.Function(
        name, arguments, [ca.densify(result) for result in results], function.name_in(), function.name_out()
    )


def casadi_header(functions: Mapping[str, ca.Function], prefix: str, real: Real = "double") -> str:
    """C text to be included once: ``static int <prefix>_<name>(const pf_real *argument, ..., pf_real *result, ...)``.

    Parameters
    ----------
    functions : mapping of str to casadi.Function
        By C name; all results are made dense. An argument called t is time, ``const pf_time *``. Each becomes a
        function that gives PF_OK or PF_NO_CONVERGENCE (of a Newton iteration inside).
    prefix : str
        Of all symbols.
    real : {"double", "float"}
        In float, constants and functions of <math.h> are float too, but for what time enters in a scalar function.

    Raises
    ------
    ValueError
        If CasADi has no C code for something inside a function, or Newton's method is inside and ``real`` is "float".

    Examples
    --------
    >>> x = ca.SX.sym("x")
    >>> text = casadi_header({"square": ca.Function("f", [x], [x * x], ["x"], ["y"])}, "demo")
    >>> "static int demo_square(const pf_real *x, pf_real *y)" in text
    True
    """
    ready = {name: dense(function, name) for name, function in functions.items()}
    text = _generate(ready, prefix)
    entries = []
    for name, function in ready.items():
        pattern = re.compile(_EXPORTED.format(name), re.S)
        found = pattern.search(text)
        if found is None:
            raise RuntimeError(
                f"C code of CasADi {ca.CasadiMeta.version()} is not laid out as expected; use CasADi 3.8"
            )
        body = f"casadi_f{found.group(1)}"
        text = pattern.sub("\n", text)
        text, entry = scalar_entry(text, name, function, prefix, body, real == "float")
        entries.append(entry or _entry(name, function, prefix, body, real))
    text = _LANGUAGE.sub("\n", _CONFIGURATION.sub("", text))
    text = _HELPER.sub(r"static inline \1 \2", text)
    text = _BODY.sub(r"\1\n  (void)arg; (void)res; (void)iw; (void)w; (void)mem;", text)
    text = _NORM.sub(_NORM_THAT_KEEPS_NAN, text)
    newtons = len(_NEWTON.findall(text))
    text = _FUNCTION.sub(_that_tells, text)
    if newtons != text.count("if (casadi_newton(&m)) break;"):
        raise RuntimeError(
            f"Newton's method in C of CasADi {ca.CasadiMeta.version()} is not as expected; use CasADi 3.8"
        )
    text = _TABLE.sub(r'#include "pf_ieee.h"\n\g<0>', text)
    text = re.sub(r"\n{3,}", "\n\n", text) + "\n" + "\n".join(entries)
    if real == "float":
        if newtons:
            raise ValueError(
                "a nonlinear algebraic loop is solved by Newton's method to 1e-13, which float does not reach: use "
                "real='double', or break the loop by a state or a sampled block"
            )
        text = _in_float(text)
    return f"{_OPENING}{APART if 'PF_APART' in text else ''}{text}{_CLOSING}"


def _that_tells(function: re.Match[str]) -> str:
    if function.group(1).startswith(QUICK):
        return function.group()  # what follows looks at its result
    return _NEWTON.sub(_NEWTON_THAT_TELLS, function.group())


def _generate(functions: Mapping[str, ca.Function], prefix: str) -> str:
    options = {
        "with_header": False,
        "casadi_int": "int",
        "casadi_real": "pf_real",
        "include_math": False,
        "with_export": False,
    }
    generator = ca.CodeGenerator(f"{prefix}_equations.c", options)
    for name, function in functions.items():
        try:
            generator.add(function)
        except RuntimeError as error:
            reasons = [line.strip() for line in str(error).splitlines() if line.strip()]
            raise ValueError(_NO_CODE.format(name, reasons[-1] if reasons else "no reason given")) from error
    text = generator.dump()
    missing = re.search(r"#error (.*)", text)
    if missing is not None:
        raise ValueError(_NO_CODE.format(", ".join(functions), missing.group(1)))
    return text


def _entry(name: str, function: ca.Function, prefix: str, body: str, real: Real) -> str:
    def room(count: int) -> int:
        return max(count, 1)

    arguments, now = function.name_in(), ""
    if real == "float" and TIME in arguments:
        now = f"  const pf_real now = {TIME} ? (pf_real)*{TIME} : 0;\n"
        arguments = ["&now" if argument == TIME else argument for argument in arguments]
    return (
        f"{signature(name, function, prefix)} {{\n{now}"
        f"  const pf_real *arg[{room(function.sz_arg())}] = {{{', '.join(arguments)}}};\n"
        f"  pf_real *res[{room(function.sz_res())}] = {{{', '.join(function.name_out())}}};\n"
        f"  pf_real w[{room(function.sz_w())}];\n"
        f"  int iw[{room(function.sz_iw())}];\n"
        f"  return {body}(arg, res, iw, w, 0) ? PF_NO_CONVERGENCE : PF_OK;\n"
        "}\n"
    )


def _in_float(text: str) -> str:
    def literal(found: re.Match[str]) -> str:
        value = float(found.group(1))
        if value > _FLOAT_MAX:
            return "INFINITY"
        return "0.f" if value < _FLOAT_MIN else found.group(1) + "f"

    return plain_double(_LIBM.sub(r"\1f(", _LITERAL.sub(literal, text)))
