"""The C table pf_model and the functions that run it, seen from Python; no Python code is called back."""

from __future__ import annotations

import ctypes as ct
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .model import CModel

__all__ = ["Library", "Progress", "address", "glue_source"]

_VECTOR = ct.c_void_p
_POINTER = ct.CFUNCTYPE(_VECTOR, ct.c_void_p)
_EVALUATE = ct.CFUNCTYPE(ct.c_int, ct.c_void_p, ct.c_double, _VECTOR, _VECTOR)

# Only what is named here leaves the library.
_GLUE = """\
#include "pf_simulate.h"
{include}
#if defined(_WIN32)
#define PF_EXPORT __declspec(dllexport)
#else
#define PF_EXPORT __attribute__((visibility("default")))
#endif

extern const pf_model {symbol};

PF_EXPORT const pf_model *pf_exported_model(void);
PF_EXPORT size_t pf_exported_work(void);
PF_EXPORT int pf_exported_real(void);
PF_EXPORT void pf_exported_set_states(void *self, const pf_real *s);
PF_EXPORT int pf_exported_advance(void *self, pf_real *work, pf_solver *solver, pf_time t, pf_time t_end,
                                  const pf_real *slope, pf_time *t_reached);
PF_EXPORT int pf_exported_simulate(void *self, pf_real *work, pf_solver *solver, long long n, const pf_time *times,
                                   const pf_real *u, int linear, pf_real *x, pf_real *y, pf_real *s,
                                   pf_progress *progress, pf_time *t_reached);

const pf_model *pf_exported_model(void) {{ return &{symbol}; }}

size_t pf_exported_work(void) {{ return pf_work_reals(&{symbol}) + (size_t){symbol}.n_u; }}

int pf_exported_real(void) {{ return (int)sizeof(pf_real); }}

void pf_exported_set_states(void *self, const pf_real *s) {{
  {set_states}
}}

int pf_exported_advance(void *self, pf_real *work, pf_solver *solver, pf_time t, pf_time t_end, const pf_real *slope,
                        pf_time *t_reached) {{
  return pf_advance(&{symbol}, self, work, solver, t, t_end, slope, t_reached);
}}

int pf_exported_simulate(void *self, pf_real *work, pf_solver *solver, long long n, const pf_time *times,
                         const pf_real *u, int linear, pf_real *x, pf_real *y, pf_real *s, pf_progress *progress,
                         pf_time *t_reached) {{
  return pf_simulate(&{symbol}, self, work, solver, n, times, u, linear, x, y, s, progress, t_reached);
}}
"""


class _EventClock(ct.Structure):
    _fields_ = (
        *((name, ct.c_double) for name in ("last", "soon", "h")),
        ("count", ct.c_longlong),
        *((name, ct.c_int) for name in ("in_a_row", "armed", "latest")),
    )


class _Events(ct.Structure):
    _fields_ = (
        ("count", ct.c_int),
        ("directions", ct.c_void_p),
        ("clock", ct.CFUNCTYPE(ct.POINTER(_EventClock), ct.c_void_p)),
    )


class _Table(ct.Structure):
    _fields_ = (
        ("name", ct.c_char_p),
        ("size", ct.c_size_t),
        *((name, ct.c_int) for name in ("n_x", "n_u", "n_y", "n_p", "n_s", "n_tasks", "communication")),
        ("init", ct.CFUNCTYPE(ct.c_int, ct.c_void_p)),
        *((name, _POINTER) for name in ("x", "u", "p")),
        ("s", ct.CFUNCTYPE(None, ct.c_void_p, _VECTOR)),
        ("apply", ct.CFUNCTYPE(ct.c_char_p, ct.c_void_p)),
        ("start", ct.CFUNCTYPE(ct.c_int, ct.c_void_p, ct.c_double)),
        ("derivatives", _EVALUATE),
        ("outputs", _EVALUATE),
        ("next", ct.CFUNCTYPE(ct.c_double, ct.c_void_p)),
        ("sample", ct.CFUNCTYPE(ct.c_int, ct.c_void_p, ct.c_double, _VECTOR)),
        ("update", ct.CFUNCTYPE(ct.c_int, ct.c_void_p, ct.c_double, ct.c_double)),
        ("directional", ct.CFUNCTYPE(ct.c_int, ct.c_void_p, ct.c_double, *[_VECTOR] * 5)),
        ("adjoint", ct.CFUNCTYPE(ct.c_int, ct.c_void_p, ct.c_double, *[_VECTOR] * 5)),
        ("accepted", ct.CFUNCTYPE(None, ct.c_void_p, ct.c_double)),
        ("events", ct.POINTER(_Events)),
    )


class _SolverDouble(ct.Structure):
    _fields_ = (
        ("method", ct.c_int),
        ("step", ct.c_double),
        ("rtol", ct.c_double),
        ("atol", ct.c_double),
        ("h", ct.c_double),
        ("budget", ct.c_longlong),
    )


class _SolverFloat(ct.Structure):
    _fields_ = (
        ("method", ct.c_int),
        ("step", ct.c_double),
        ("rtol", ct.c_float),
        ("atol", ct.c_float),
        ("h", ct.c_double),
        ("budget", ct.c_longlong),
    )


class Progress(ct.Structure):
    """Shared with a run in another thread: rows done so far; set ``cancel`` to 1 to end it."""

    _fields_ = (("rows", ct.c_longlong), ("cancel", ct.c_int))


class Library:
    """A loaded shared library of one model.

    Parameters
    ----------
    path : Path
        Made from the model's sources and the text of ``glue_source``.

    Attributes
    ----------
    table : Structure
        The model's pf_model.
    work_reals : int
        Numbers of working memory that a run needs.
    dtype : dtype
        Of all numbers but times: pf_real.
    """

    def __init__(self, path: Path) -> None:
        self._handle = ct.CDLL(str(path))
        exported = self._handle
        exported.pf_exported_model.restype = ct.POINTER(_Table)
        exported.pf_exported_work.restype = ct.c_size_t
        exported.pf_exported_real.restype = ct.c_int
        exported.pf_exported_set_states.argtypes = [ct.c_void_p, _VECTOR]
        exported.pf_exported_set_states.restype = None
        exported.pf_exported_advance.argtypes = [
            ct.c_void_p, _VECTOR, ct.c_void_p, ct.c_double, ct.c_double, _VECTOR, ct.c_void_p
        ]  # fmt: skip
        exported.pf_exported_simulate.argtypes = [
            ct.c_void_p, _VECTOR, ct.c_void_p, ct.c_longlong, _VECTOR, _VECTOR, ct.c_int, _VECTOR, _VECTOR, _VECTOR,
            ct.c_void_p, ct.c_void_p,
        ]  # fmt: skip
        self.set_states: Callable[[int, int | None], None] = exported.pf_exported_set_states
        self.advance: Callable[..., int] = exported.pf_exported_advance
        self.simulate: Callable[..., int] = exported.pf_exported_simulate
        self.table: ct.Structure = exported.pf_exported_model().contents
        self.work_reals: int = int(exported.pf_exported_work())
        double = exported.pf_exported_real() == 8
        self.dtype: np.dtype[np.floating] = np.dtype(np.float64 if double else np.float32)

    def solver(self, method: int, step: float, rtol: float, atol: float, budget: int = 0) -> ct.Structure:
        """A new pf_solver.

        Parameters
        ----------
        method : int
            0: RK4, 1: adaptive.
        step : float
            Longest step in seconds; 0: from stop to stop.
        rtol, atol : float
            Of the adaptive method.
        budget : int
            Steps that may be tried; 0: no bound.
        """
        kind = _SolverDouble if self.dtype == np.float64 else _SolverFloat
        return kind(method, step, rtol, atol, 0.0, budget)

    def view(self, instance: NDArray[np.uint8], pointer: int, length: int) -> NDArray[np.floating]:
        """The numbers at an address inside an instance, in place.

        Parameters
        ----------
        instance : (size,) array of bytes
        pointer : int
            The address.
        length : int
            Numbers from there on.
        """
        offset = pointer - instance.ctypes.data
        return instance[offset : offset + length * self.dtype.itemsize].view(self.dtype)


def address(array: NDArray[np.generic] | None) -> int | None:
    """Where an array's numbers begin; None for none."""
    return None if array is None else array.ctypes.data


def glue_source(model: CModel) -> str:
    """C text that exports one model's table and the runs of it from a shared library."""
    header = model.sources.get(f"{model.name}.h", "")
    settable = f"{model.name}_set_states(" in header
    return _GLUE.format(
        include=f'#include "{model.name}.h"\n' if settable else "",
        symbol=model.symbol,
        set_states=f"{model.name}_set_states(self, s);" if settable else "(void)self;\n  (void)s;",
    )
