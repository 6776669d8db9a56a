"""A filter behind real signals, in C: time stamps, missing samples, parameters from another thread (pf_guard.h)."""

from __future__ import annotations

from .export_folder import own_symbols
from .filter_code import runtime_files

__all__ = ["guard_costs", "guard_sources", "guard_stack"]

_LIBRARY = 64  # bytes: division of doubles in software, memcpy
# Instructions on a Cortex-M4F by order, three channels with one filter, gcc -O2, from benchmarks/firmware_table.py: a
# step in time, after missing samples, with other poles.
_COSTS = {
    "float": (
        (649, 13_986, 66_884),
        (734, 62_987, 339_395),
        (824, 121_487, 614_541),
        (971, 236_093, 1_115_903),
        (1_108, 376_446, 1_648_903),
        (1_235, 592_094, 2_420_452),
    ),
    "double": (
        (5_866, 18_869, 72_170),
        (8_241, 70_126, 346_180),
        (10_964, 131_109, 624_520),
        (14_493, 248_820, 1_129_115),
        (18_302, 392_476, 1_666_587),
        (22_962, 612_287, 2_442_744),
    ),
}


def guard_costs(order: int, real: str) -> tuple[int, int, int] | None:
    """Most instructions of a guard's step on a Cortex-M4F: in time, after missing samples, with other poles.

    For three channels that share a filter, as measured by ``benchmarks/firmware_table.py``, which fails where a step
    takes 5 % more.

    Parameters
    ----------
    order : int
        Of the filter; None comes back beyond 6.
    real : {"float", "double"}

    Examples
    --------
    >>> guard_costs(3, "float")
    (824, 121487, 614541)
    """
    return _COSTS[real][order - 1] if order <= 6 else None


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


def guard_sources(name: str, stack: int, costs: tuple[int, int, int] | None = None) -> dict[str, str]:
    """C files that put a guard around an exported filter.

    Parameters
    ----------
    name : str
        C name of the filter, exported with steps of any length: a missing sample is one longer step.
    stack : int
        Of :func:`guard_stack`, for the comments.
    costs : tuple of int, optional
        Of :func:`guard_costs`, for the comments.

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
    took = (
        ""
        if costs is None
        else f"""
 *
 * Instructions of a step on a Cortex-M4F, at most: {costs[0]:,} in time, {costs[1]:,} after missing samples,
 * {costs[2]:,} with other poles, which that core computes in software doubles."""
    )
    header = f"""\
/* {name} behind real signals. pf_guard.h says how it is used.
 *
 * Stack of any call, {name}_guard_step above all: at most {stack:,} bytes on a Cortex-M (gcc -Os, -O2 or -O3), most of
 * it where other poles take over.{took}
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
