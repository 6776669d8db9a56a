"""A filter behind real signals, in C: time stamps, missing samples, parameters from another thread (pf_guard.h)."""

from __future__ import annotations

from .export_folder import own_symbols
from .filter_source import runtime_files

__all__ = ["guard_sources", "guard_stack"]

_LIBRARY = 64  # bytes: division of doubles in software, memcpy


def guard_stack(order: int, *, filters: int = 1, channels: int = 3, inertia: int = 0) -> int:
    """Bytes of stack that no call of a guard exceeds on a Cortex-M, when gcc optimises.

    Most of it is where other poles take over: three matrices of the filter's order in double. It is an upper bound on
    what ``gcc -fcallgraph-info=su`` says of the deepest path (``tests/codegen/test_package_stack.py``).

    Parameters
    ----------
    order : int
        Largest order of the filters.
    filters, channels : int
        Number of filters (1 if all channels share one), and of channels of x.
    inertia : int
        Entries of an inertia that is given at every step.

    Examples
    --------
    >>> guard_stack(3), guard_stack(6)
    (1396, 2284)
    """
    wide = 8 * (order + 8) * max(0, channels - 6)
    return 876 + _LIBRARY + 24 * order**2 + 80 * order * filters + wide + 16 * inertia


def guard_sources(name: str, stack: int) -> dict[str, str]:
    """C files that put a guard around an exported filter.

    Parameters
    ----------
    name : str
        C name of the filter, exported with steps of any length: a missing sample is one longer step.
    stack : int
        Of :func:`guard_stack`, for the comments.

    Returns
    -------
    dict of str to str
        To be compiled beside the filter's own.

    Examples
    --------
    >>> sorted(guard_sources("wing", 1396))
    ['pf_guard.h', 'pf_guard_code.h', 'wing_guard.c', 'wing_guard.h']
    """
    guard = f"PF_GENERATED_{name.upper()}_GUARD_H"
    header = f"""\
/* {name} behind real signals. pf_guard.h says how it is used.
 *
 * Stack of any call, {name}_guard_step above all: at most {stack:,} bytes on a Cortex-M (gcc -Os, -O2 or -O3), most of
 * it where other poles take over.
 */
#ifndef {guard}
#define {guard}
#include "{name}.h"

#ifdef __cplusplus
extern "C" {{
#endif

#define PF_NAME {name}
#include "pf_guard.h"

#ifdef __cplusplus
}}
#endif
#endif
"""
    code = f"""\
#include "pf_ieee.h"

#include "{name}_guard.h"

#define PF_NAME {name}
#include "pf_guard_code.h"
"""
    files = {
        f"{name}_guard.h": header,
        f"{name}_guard.c": code,
        **runtime_files(["pf_guard.h", "pf_guard_code.h"]),
    }
    renamed = own_symbols(runtime_files(["pf_roots.c", "pf_tune.c"]) | files, name)
    return {file: renamed[file] for file in files}
