"""A filter behind real signals, in C: time stamps, missing samples, parameters from another thread (pf_guard.h)."""

from __future__ import annotations

from .export_folder import own_symbols
from .filter_source import runtime_files

__all__ = ["guard_sources"]


def guard_sources(name: str) -> dict[str, str]:
    """C files that put a guard around an exported filter.

    Parameters
    ----------
    name : str
        C name of the filter, exported with steps of any length: a missing sample is one longer step.

    Returns
    -------
    dict of str to str
        To be compiled beside the filter's own.

    Examples
    --------
    >>> sorted(guard_sources("wing"))
    ['pf_guard.h', 'pf_guard_code.h', 'wing_guard.c', 'wing_guard.h']
    """
    guard = f"PF_GENERATED_{name.upper()}_GUARD_H"
    header = f"""\
/* {name} behind real signals. pf_guard.h says how it is used. */
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
