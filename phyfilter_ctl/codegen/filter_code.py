"""A sampled PhyFilter as C: its options and numbers beside the runtime of pf_filter.h, which is the same for all."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from math import ceil, isinf
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _signals
from .._sections import FloatArray
from ..filter import SampledPhyFilter
from .identifiers import checked_identifier

__all__ = ["LEAST", "FilterSource", "describe", "filter_source", "runtime_files", "wrapped"]

# Of parameters: a Hurwitz D has positive coefficients, a limit of 0 would be no filter.
LEAST = {"a": 0.0, "limit": 0.0}

InertiaInput = Literal["scalar", "diagonal", "full"]

# Matched sampling is the exact one of a filter with another numerator: ``SampledPhyFilter.realised``.
_METHODS = {"exact": 0, "matched": 0, "euler": 1, "tustin": 2}
_INERTIA = {"scalar": 1, "diagonal": 2, "full": 3}
_FORMAT = 1  # PF_FILTER_FORMAT
_MAX_ORDER = 12  # PF_MAX_ORDER
# Intervals that a delay keeps beyond delay / dt: the one just finished, the one before the record, one for rounding.
_SPARE_INTERVALS = 3


@dataclass(frozen=True, eq=False)
class FilterSource:
    """C99 sources of one sampled filter.

    Parameters
    ----------
    name : str
        Name of the C struct, and prefix of all its symbols; ``<name>_parameters`` holds its numbers.
    sources : dict of str to str
        ``<name>.h``, ``<name>.c`` and the files of the runtime. Each ``.c`` is compiled.
    sampled : SampledPhyFilter
        What they were made from, in the precision of the C code.
    n_x, n_f : int
        Channels of x and g, and of f_theta and f_hat.
    orders : tuple of int
        Order of each filter: one for all channels, or one per channel of f.
    inertia_entries : int
        Numbers in the inertia that is given at every step; 0 where none is.
    variable, tunable : bool
        Whether steps of other lengths, and other coefficients, are possible while running.
    fixed : bool
        Whether the numbers stay where they are constant, and the state has none of them.
    """

    name: str
    sources: dict[str, str]
    sampled: SampledPhyFilter
    n_x: int
    n_f: int
    orders: tuple[int, ...]
    inertia_entries: int
    variable: bool
    tunable: bool
    fixed: bool = False

    @property
    def real(self) -> Literal["float", "double"]:
        """C type of its numbers."""
        return "float" if self.sampled.sampling.precision == "float32" else "double"

    @property
    def limits(self) -> dict[str, FloatArray]:
        """Those it has: ``limit`` (n_f,), ``g_low`` and ``g_high`` (n_x,), as the C code holds them."""
        return {name: kept(ends, self.real) for name, ends in _limits(self.sampled, self.n_x).items()}


def filter_source(
    sampled: SampledPhyFilter,
    channels: int,
    *,
    name: str = "phyfilter",
    inertia: ArrayLike | InertiaInput | None = None,
    variable: bool = True,
    tunable: bool = True,
    fixed: bool = False,
    past: int | None = None,
    long_steps: bool = False,
) -> FilterSource:
    """The C sources of a sampled filter.

    Parameters
    ----------
    sampled : SampledPhyFilter
        ``precision`` decides between float (compensated) and double.
    channels : int
        Number n_x of channels of x.
    name : str
        C identifier, prefix of all its symbols.
    inertia : float, (n_x,) or (n_x, n_x) array, {"scalar", "diagonal", "full"} or None
        Constant inertia, or the kind of inertia given at every step, or None for I.
    variable : bool
        Whether steps of other lengths than dt must be possible.
    tunable : bool
        Whether a and b (and the poles) may be set while running. Without it, less memory and fewer instructions.
    fixed : bool
        Whether the numbers may stay in ``<name>_parameters``, whose only filter it is then, limits fixed: least memory.
        Of no effect where something else needs them: ``variable``, ``tunable``, a delay, ``nonfinite="hold"``.
    past : int, optional
        Intervals kept for a delay; by default as many as nominal steps need. More keep every detail where steps are
        shorter than dt.
    long_steps : bool
        Whether every good sample after a good one makes a step, however long, as an FMU's communication steps do; then
        only bad samples make gaps.

    Returns
    -------
    FilterSource

    Raises
    ------
    ValueError
        For an order above 12, numbers of channels that contradict each other, an inertia of
        another shape, a name that is no C identifier, or a ``past`` that is too small.

    Examples
    --------
    >>> from phyfilter_ctl import PhyFilter
    >>> source = filter_source(PhyFilter([400.0, 40.0]).sampled(0.002), 3, name="wing")
    >>> [file for file in sorted(source.sources) if file.endswith(".c")]
    ['pf_roots.c', 'pf_tune.c', 'wing.c']
    """
    name = checked_identifier(name)
    if sampled.order > _MAX_ORDER:
        raise ValueError(
            f"order {sampled.order}: the C runtime holds orders up to {_MAX_ORDER}; lower the order"
        )
    if channels < 1:
        raise ValueError(f"channels: expected at least 1, got {channels}")
    n_f = sampled.recursion.channels(channels)
    kind, constant = inertia_kind(inertia, channels)
    needed = ceil(sampled.sampling.delay / sampled.dt) + _SPARE_INTERVALS if sampled.sampling.delay else 0
    if past is not None and past < needed:
        raise ValueError(
            f"past: {past} intervals for a delay of {sampled.sampling.delay:g} s: expected at least {needed}"
        )
    numbers = _Numbers.of(sampled, channels, constant, variable=variable, tunable=tunable)
    fixed = fixed and not (variable or tunable or needed or sampled.sampling.nonfinite == "hold")
    options = {
        "N_X": channels,
        "N_F": n_f,
        "ORDER": sampled.order,
        "FILTERS": len(sampled.filters),
        "FLOAT": int(sampled.sampling.precision == "float32"),
        "METHOD": _METHODS[sampled.sampling.method],
        "G_AVERAGE": int(sampled.sampling.g == "average"),
        "F_THETA_AVERAGE": int(sampled.sampling.f_theta == "average"),
        "INERTIA": kind,
        "INERTIA_INPUT": int(kind > 0 and constant is None),
        "DIRECTION": int(sampled.E is not None),
        "PAST": 0 if not needed else past or needed,
        "LIMIT": int(sampled.sampling.limit is not None),
        "G_LIMIT": int(sampled.sampling.g_limit is not None),
        "HOLD_BAD": int(sampled.sampling.nonfinite == "hold"),
        "PAIRS": numbers.pairs,
        "LOWPASS": int(numbers.lowpass),
        "VARIABLE": int(variable),
        "TUNABLE": int(tunable),
        "CONSTANT": int(fixed),
    }
    runtime = ["pf_crc.h", "pf_filter.h", "pf_filter_code.h", "pf_hurwitz.h", "pf_ieee.h"]
    if needed or sampled.sampling.nonfinite == "hold":
        runtime += ["pf_filter_late.h"]
    if variable or tunable or sampled.sampling.nonfinite == "hold":
        runtime += ["pf_arithmetic.h", "pf_tune.c", "pf_tune.h"]
    if tunable:
        runtime += ["pf_filter_retune.h", "pf_roots.c"]
    sources = {
        f"{name}.h": _header(name, sampled, options, long_steps),
        f"{name}.c": _code(name, numbers),
        **runtime_files(runtime),
    }
    entries = 0 if constant is not None else (0, 1, channels, channels**2)[kind]
    orders = tuple(entry.order for entry in sampled.filters)
    return FilterSource(name, sources, sampled, channels, n_f, orders, entries, variable, tunable, fixed)


def runtime_files(names: Iterable[str]) -> dict[str, str]:
    """Texts of the runtime's static C files.

    Parameters
    ----------
    names : iterable of str

    Examples
    --------
    >>> "PF_MODEL_H" in runtime_files(["pf_model.h"])["pf_model.h"]
    True
    """
    return {name: _runtime(name) for name in sorted(names)}


@lru_cache(maxsize=32)
def _runtime(name: str) -> str:
    return files(__name__.rpartition(".")[0]).joinpath("runtime", name).read_text(encoding="utf-8")


def inertia_kind(inertia: ArrayLike | InertiaInput | None, n_x: int) -> tuple[int, FloatArray | None]:
    """Its kind as in pf_filter.h, and its entries where it is constant."""
    if inertia is None:
        return 0, None
    if isinstance(inertia, str):
        if inertia not in _INERTIA:
            raise ValueError(f"inertia: expected one of {', '.join(_INERTIA)} or numbers, got {inertia!r}")
        return _INERTIA[inertia], None
    M = _signals.inertia("inertia", inertia, n_x)
    return M.ndim + 1, M.reshape(-1)


# -- numbers --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Numbers:
    """The parameter struct, member by member in its order."""

    real: Literal["float", "double"]
    orders: tuple[int, ...]
    members: dict[str, tuple[str, NDArray[np.float64]]]  # name -> ("double" or "real", values)
    pairs: int
    lowpass: bool

    @classmethod
    def of(
        cls,
        sampled: SampledPhyFilter,
        n_x: int,
        inertia: FloatArray | None,
        *,
        variable: bool,
        tunable: bool,
    ) -> _Numbers:
        n, filters = sampled.order, sampled.realised
        a, b, equilibrium, C = np.zeros((4, len(filters), n))
        dA, poles = np.zeros((len(filters), n, n)), np.zeros((len(filters), n, 2))
        for i, (entry, transition) in enumerate(zip(filters, sampled.recursion.transitions, strict=True)):
            own = slice(entry.order)
            a[i, own], b[i, own] = entry.a, entry.b
            dA[i, own, own], equilibrium[i, own], C[i, own] = transition
            poles[i, own] = np.stack([entry.poles.real, entry.poles.imag], axis=1)
        members = {
            "dt": ("double", np.asarray(sampled.dt)),
            "delay": ("double", np.asarray(sampled.sampling.delay)),
            "a": ("double", a),
        }
        if tunable:
            members["b"] = ("double", b)
        if tunable or variable or sampled.sampling.nonfinite == "hold":
            members["poles"] = ("double", poles)
        members |= {"dA": ("real", dA), "equilibrium": ("real", equilibrium), "C": ("real", C)}
        members |= {name: ("real", ends) for name, ends in _limits(sampled, n_x).items()}
        if sampled.recursion.E_left is not None:
            members["E_left"] = ("real", sampled.recursion.E_left)
        if inertia is not None:
            members["inertia"] = ("real", inertia)
        real = "float" if sampled.sampling.precision == "float32" else "double"
        members = {
            name: (kind, kept(values, real if kind == "real" else "double"))
            for name, (kind, values) in members.items()
        }
        above = np.any(dA != 0.0, axis=0)
        pairs = sum(1 << j for j in range(n - 1) if tunable or above[j, j + 1])
        only_last = np.append(np.zeros(n - 1), 1.0)
        lowpass = not tunable and not np.any(C - only_last)
        return cls(real, tuple(entry.order for entry in filters), members, pairs, lowpass)

    @property
    def crc(self) -> int:
        data = struct.pack(f"<{len(self.orders)}I", *self.orders)
        for kind, values in self.members.values():
            single = kind == "real" and self.real == "float"
            data += values.astype("<f4" if single else "<f8").tobytes()
        return zlib.crc32(data)

    def text(self) -> str:
        lines = [f"  .version = {_FORMAT}u,", f"  .crc = 0x{self.crc:08x}u,"]
        lines.append(f"  .order = {{{', '.join(f'{order}u' for order in self.orders)}}},")
        for name, (kind, values) in self.members.items():
            single = kind == "real" and self.real == "float"
            lines += wrapped(f"  .{name} = {braces(values, single)},")
        return "\n".join(lines)


def _limits(sampled: SampledPhyFilter, n_x: int) -> dict[str, FloatArray]:
    """One bound or pair of ends for each channel."""
    found, (limit, ends) = {}, (sampled.sampling.limit, sampled.sampling.g_limit)
    if limit is not None:
        found["limit"] = np.broadcast_to(limit, (sampled.recursion.channels(n_x),))
    if ends is not None:
        found |= {
            name: np.broadcast_to(end, (n_x,)) for name, end in zip(("g_low", "g_high"), ends, strict=True)
        }
    return found


def kept(values: NDArray[np.floating], real: Literal["float", "double"]) -> NDArray[np.float64]:
    """Values as the C type holds them; a bound without end is its largest number, which is the same to a clamp."""
    dtype = np.dtype(np.float32 if real == "float" else np.float64)
    largest = float(np.finfo(dtype).max)
    with np.errstate(over="ignore"):
        rounded = np.asarray(values, dtype=float).astype(dtype)
    return np.clip(rounded.astype(float), -largest, largest)


def braces(values: NDArray[np.float64], single: bool) -> str:
    """An array as C initialises one, in float where ``single``."""
    if values.ndim == 0:
        return _literal(float(values), single)
    return "{" + ", ".join(braces(entry, single) for entry in values) + "}"


def _literal(value: float, single: bool) -> str:
    """A constant of C that reads back as the same number."""
    assert not isinf(value)
    text = str(np.float32(value)) if single else repr(value)
    return f"{text}f" if single else text


def wrapped(line: str, width: int = 110) -> list[str]:
    """A line of numbers as several."""
    if len(line) <= width:
        return [line]
    cut = line.rfind(", ", 0, width) + 1
    return [line[:cut], *wrapped("      " + line[cut + 1 :], width)]


# -- text -----------------------------------------------------------------------------------------------------------


def _header(name: str, sampled: SampledPhyFilter, options: dict[str, int], long_steps: bool) -> str:
    defines = "\n".join(f"#define {name}_{option} {value}" for option, value in options.items())
    if options["VARIABLE"] or options["HOLD_BAD"]:
        longest = sampled.recursion.longest_gap / sampled.dt
        defines += f"\n#define {name}_LONGEST {longest!r}\n#define {name}_LONG_STEPS {int(long_steps)}"
    if options["CONSTANT"]:
        single = bool(options["FLOAT"])
        rate = kept(np.asarray(1.0 / sampled.dt), "float" if single else "double")
        defines += f"\n#define {name}_RATE {_literal(float(rate), single)}"
    guard = f"PF_GENERATED_{name.upper()}_H"
    return f"""\
/* {name}: a sampled PhyFilter. pf_filter.h says how it is used.
 *
{describe(sampled, options["N_X"], options["N_F"])}
 */
#ifndef {guard}
#define {guard}
#ifdef __cplusplus
extern "C" {{
#endif

{defines}
#define PF_NAME {name}
#include "pf_filter.h"

extern const {name}_params {name}_parameters;

#ifdef __cplusplus
}}
#endif
#endif
"""


def which_g(sampled: SampledPhyFilter) -> str:
    """The g that a step in C takes."""
    return "the g that acted since the last sample" if sampled.sampling.g == "hold" else "g at this sample"


def describe(sampled: SampledPhyFilter, n_x: int, n_f: int, numbers: str | None = None) -> str:
    """Formula, signals, units and options as lines of a C comment; ``numbers`` in words, where not the filter's."""
    shared = len(sampled.filters) == 1
    lines = [
        f"F{'' if shared else i}(s) = {entry.formula()}" + ("" if shared else f"   for f_hat[{i}]")
        for i, entry in enumerate(sampled.filters)
    ]
    direction = ", in M x' = g + E f" if sampled.E is not None else ""
    sampling = sampled.sampling
    unit_x, unit_g, unit_f = (sampling.units.get(signal) for signal in ("x", "g", "f"))
    lines += [
        "",
        f"x[{n_x}]        measured state, {unit_x or 'in its SI unit'}",
        f"g[{n_x}]        known part of M x', {unit_g or 'in the unit of M x / s'}: {which_g(sampled)}",
        f"f_theta[{n_f}]  learned model of f{direction}, {unit_f or 'in the unit of g'}",
        f"f_hat[{n_f}]    estimate of f, {unit_f or 'in the unit of g'}",
    ]
    if sampling.names:
        lines.append(f"channels: {', '.join(sampling.names)}")
    lines += [
        "",
        f"dt = {sampling.dt:g} s, method {sampling.method}, g {sampling.g}, f_theta {sampling.f_theta}, "
        f"{numbers or f'{sampling.precision}, a sample that is not finite: {sampling.nonfinite}'}",
    ]
    if sampling.delay:
        lines.append(f"delay of the measurement x: {sampling.delay:g} s")
    if sampling.limit is not None:
        lines.append(f"|f_hat| <= {np.array2string(sampling.limit, max_line_width=90)}")
    if sampling.g_limit is not None:
        low, high = (np.array2string(end, max_line_width=90) for end in sampling.g_limit)
        lines.append(f"what acts of g: {low} <= g <= {high}")
    text = [line.replace("*/", "* /").replace("/*", "/ *") for entry in lines for line in entry.split("\n")]
    return "\n".join(f" * {line}".rstrip() for line in text)


def _code(name: str, numbers: _Numbers) -> str:
    return f"""\
#include "pf_ieee.h"

#include "{name}.h"

#define PF_NAME {name}
#include "pf_filter_code.h"

#include "pf_ieee.h" /* a table follows */
const {name}_params {name}_parameters = {{
{numbers.text()}
}};
"""
