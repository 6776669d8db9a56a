"""A filter behind real signals, in C: time stamps, missing samples, parameters from another thread (pf_guard.h)."""

from __future__ import annotations

from .filter_source import FilterSource, runtime_files

__all__ = ["guard_sources"]


def guard_sources(source: FilterSource) -> dict[str, str]:
    """C files that put a guard around a filter.

    Parameters
    ----------
    source : FilterSource
        Made with ``variable=True``: a missing sample is one longer step.

    Returns
    -------
    dict of str to str
        To be compiled beside ``source.sources``.

    Raises
    ------
    ValueError
        If the filter takes steps of one length only.

    Examples
    --------
    >>> from phyfilter_ctl import PhyFilter
    >>> from phyfilter_ctl.codegen.filter_source import filter_source
    >>> sorted(guard_sources(filter_source(PhyFilter([20.0]).sampled(0.002), 3, name="wing")))
    ['pf_guard.h', 'pf_guard_code.h', 'wing_guard.c', 'wing_guard.h']
    """
    if not source.variable:
        raise ValueError("source: a guarded filter makes up for missing samples; expected variable=True")
    name, guard = source.name, f"PF_GENERATED_{source.name.upper()}_GUARD_H"
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
    return {
        f"{name}_guard.h": header,
        f"{name}_guard.c": code,
        **runtime_files(["pf_guard.h", "pf_guard_code.h"]),
    }
