"""A sampled filter as C in 32-bit integers: numbers beside the runtime of pf_q31.h, which is the same for all."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ..analysis import FixedPoint
from .filter_code import describe, runtime_files, which_g, wrapped
from .identifiers import checked_identifier

__all__ = ["fixed_source"]

_FORMAT = 1  # PF_Q31_FORMAT
_SAMPLES = 40
_SIGNALS = ("x", "g", "f_theta", "f_hat")

_MAIN = """\
/* Runs {name} on the integers in {name}_vectors.h: f_hat and flags must be the recorded ones, bit by bit.
 *
 * Build all files of this folder:   cc -std=c99 -O2 *.c -o {name}
 * In a product: leave out this file and {name}_vectors.h.
 *
 * In a loop, every {dt:g} s, after {name}_init(&filter, &{name}_parameters), which must be 0:
 *
 *   flags = {name}_step(&filter, x, g, f_theta, f_hat);     g: {g_text}
 */
#include <stdio.h>

#include "{name}.h"
#include "{name}_vectors.h"

int main(void) {{
  static {name} filter;
  int32_t f_hat[{name}_N];
  const int code = {name}_init(&filter, &{name}_parameters);
  int wrong = 0;
  for (int k = 0; !code && k < {samples}; k++) {{
    const int flags = {name}_step(&filter, {name}_x[k], {name}_g[k], {name}_f_theta[k], f_hat);
    wrong += flags != {name}_flags[k][0];
    for (int i = 0; i < {name}_N; i++) wrong += f_hat[i] != {name}_f_hat[k][i];
  }}
  printf("{name}: {samples} samples, %d numbers other than the recorded ones, init %d\\n", wrong, code);
  return code || wrong;
}}
"""


def fixed_source(fixed: FixedPoint, channels: int, *, name: str = "phyfilter") -> dict[str, str]:
    """C sources of a filter in fixed point, with a program that checks itself on recorded integers.

    Parameters
    ----------
    fixed : FixedPoint
    channels : int
        Number of channels of x, g, f_theta and f_hat.
    name : str
        C identifier, prefix of all symbols.

    Returns
    -------
    dict of str to str
        File name to text.

    Raises
    ------
    ValueError
        For a name that is no C identifier, fewer channels than one, or other than the filter's limits.

    Examples
    --------
    >>> from phyfilter_ctl import PhyFilter, fixed_point
    >>> files = fixed_source(fixed_point(PhyFilter([20.0]).sampled(0.01), x=8.0), 3, name="wing")
    >>> sorted(files)
    ['main.c', 'pf_crc.h', 'pf_q31.h', 'pf_q31_code.h', 'wing.c', 'wing.h', 'wing_vectors.h']
    >>> "#define wing_X_FRACTION 26" in files["wing.h"]
    True
    """
    name = checked_identifier(name)
    if channels < 1:
        raise ValueError(f"channels: expected at least 1, got {channels}")
    fixed.sampled.recursion.channels(channels)
    sampling = fixed.sampled.sampling
    main = _MAIN.format(
        name=name,
        dt=sampling.dt,
        samples=_SAMPLES,
        g_text=which_g(fixed.sampled),
    )
    return {
        f"{name}.h": _header(fixed, channels, name),
        f"{name}.c": _code(fixed, channels, name),
        f"{name}_vectors.h": _vectors(fixed, channels, name),
        "main.c": main,
        **runtime_files(["pf_crc.h", "pf_q31.h", "pf_q31_code.h"]),
    }


def _header(fixed: FixedPoint, channels: int, name: str) -> str:
    sampled, order = fixed.sampled, fixed.sampled.order
    above = np.diagonal(fixed.dA, 1)
    lowpass = not np.any(sampled.transition[2] - np.eye(order)[-1])
    options = {
        "N": channels,
        "ORDER": order,
        "PAIRS": sum(1 << j for j in range(order - 1) if above[j]),
        "LOWPASS": int(lowpass),
        "G_AVERAGE": int(sampled.sampling.g == "average"),
        "F_THETA_AVERAGE": int(sampled.sampling.f_theta == "average"),
        **{f"SHIFT_{key.upper()}": bits for key, bits in fixed.shifts.items()},
        **({"SHIFT_W": int(fixed.C[-1]).bit_length() - 1} if lowpass else {}),
        **{f"{key.upper()}_FRACTION": fixed.fraction[key] for key in _SIGNALS},
    }
    defines = [f"#define {name}_{option} {value}" for option, value in options.items()]
    defines += [
        f"#define {name}_{key.upper()}_SCALE {2.0 ** fixed.fraction[key]!r} /* largest: {fixed.ranges[key]:.6g} */"
        for key in _SIGNALS
    ]
    text = "\n".join(defines)
    guard = f"PF_GENERATED_{name.upper()}_H"
    return f"""\
/* {name}: a sampled PhyFilter in 32-bit integers. pf_q31.h says how it is used.
 *
{describe(sampled, channels, channels, "32-bit integers")}
 *
 * Integers of x, g, f_theta and f_hat are in steps of {", ".join(_step(fixed, key) for key in _SIGNALS)}.
 * For inputs on these steps and within their ranges |f_hat - f_hat of exact arithmetic| <= {fixed.error_bound:.3g}.
 */
#ifndef {guard}
#define {guard}
#ifdef __cplusplus
extern "C" {{
#endif

{text}
#define PF_NAME {name}
#include "pf_q31.h"

extern const {name}_params {name}_parameters;

#ifdef __cplusplus
}}
#endif
#endif
"""


def _step(fixed: FixedPoint, name: str) -> str:
    return f"2^{-fixed.fraction[name]}"


def _code(fixed: FixedPoint, channels: int, name: str) -> str:
    numbers = {
        **{key: np.asarray(fixed.most(key)) for key in ("x", "g", "f_theta")},
        "f_hat": fixed.limit(channels),
        "of_g": np.asarray(fixed.of_g),
        "of_f_theta": np.asarray(fixed.of_f_theta),
        "dA": fixed.dA,
        "b": fixed.b,
        "C": fixed.C,
    }
    data = [int(value) for values in numbers.values() for value in values.reshape(-1)]
    crc = zlib.crc32(struct.pack(f"<{len(data)}i", *data))
    lines = [f"  .version = {_FORMAT}u,", f"  .crc = 0x{crc:08x}u,"]
    lines += [line for key, values in numbers.items() for line in wrapped(f"  .{key} = {_braces(values)},")]
    table = "\n".join(lines)
    return f"""\
#include "{name}.h"

#define PF_NAME {name}
#include "pf_q31_code.h"

const {name}_params {name}_parameters = {{
{table}
}};
"""


def _vectors(fixed: FixedPoint, channels: int, name: str) -> str:
    """Signals over all of their ranges, and a little beyond."""
    rng = np.random.default_rng(1)
    ends = [fixed.most(key) + fixed.most(key) // 256 for key in _SIGNALS[:3]]
    x, g, f_theta = (rng.integers(-end, end + 1, (_SAMPLES, channels)) for end in ends)
    g[-1] = 0  # acts after the record where it is held
    f_hat, flags = fixed.run(x, g, f_theta)
    given = np.roll(g, 1, axis=0) if fixed.sampled.sampling.g == "hold" else g
    recorded = {"x": x, "g": given, "f_theta": f_theta, "f_hat": f_hat, "flags": flags[:, None]}
    arrays = "\n".join(
        f"static const int32_t {name}_{key}[{_SAMPLES}][{values.shape[1]}] = {{\n{_rows(values)}\n}};\n"
        for key, values in recorded.items()
    )
    guard = f"PF_GENERATED_{name.upper()}_VECTORS_H"
    return f"""\
/* Integers and what {name} makes of them, for a test on the target. g: as it is given to {name}_step. */
#ifndef {guard}
#define {guard}

{arrays}
#endif
"""


def _rows(values: Iterable[NDArray[np.int64]]) -> str:
    return "\n".join(f"  {_braces(row)}," for row in values)


def _braces(values: NDArray[np.int64]) -> str:
    if values.ndim == 0:
        return str(int(values))
    return "{" + ", ".join(_braces(np.asarray(entry)) for entry in values) + "}"
