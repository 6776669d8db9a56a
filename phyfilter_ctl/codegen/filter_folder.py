"""A sampled filter as a folder of C: header, sources, recorded vectors and a program that checks itself on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..analysis import fixed_point
from ..filter import SampledPhyFilter
from .export_folder import own_order, own_symbols, write_folder
from .filter_code import FilterSource, InertiaInput, braces, filter_source, which_g
from .fixed_source import fixed_source

__all__ = ["export_filter"]

_SAMPLES = 40
# Some dozen sums in another order: last places of the largest f_hat.
_AGREE = 64

_MAIN = """\
/* Runs {name} on the signals in {name}_vectors.h and compares f_hat with what Python computed.
 *
 * Build all files of this folder:   cc -std=c99 -O2 -ffp-contract=off *.c -o {name}
 * In a product: leave out this file and {name}_vectors.h.
 *
 * In a loop, every {dt:g} s:
 *
 *   static {name} filter;
 *   {name}_init(&filter, &{name}_parameters);                  once; not 0: see pf_filter.h
 *   {name}_step(&filter, x, g, f_theta, {inertia}, f_hat);{pad}g: {g_text}
 *
 * The first step is the start: f_hat = f_theta. A jump of the estimate of x (a reset): {name}_shift_x.
 */
#include "pf_ieee.h"

#include <stdio.h>

#include "{name}.h"
#include "{name}_vectors.h"

int main(void) {{
  static {name} filter;
  {name}_real f_hat[{capital}_N_F], worst = 0;
  int code = {name}_init(&filter, &{name}_parameters);
  for (int k = 0; !code && k < {capital}_SAMPLES; k++) {{
    code = {name}_step(&filter, {name}_x[k], {name}_g[k], {name}_f_theta[k], {argument}, f_hat);
    for (int i = 0; !code && i < {capital}_N_F; i++) {{
      const {name}_real off = f_hat[i] - {name}_f_hat[k][i];
      if (!(off <= worst && -off <= worst)) worst = off < 0 ? -off : off;
    }}
  }}
  if (code) {{
    printf("{name}: %s\\n", pf_filter_message(code));
    return 1;
  }}
  printf("{name}: %d samples, f_hat within %g of the recorded one, allowed %g\\n", {capital}_SAMPLES, (double)worst,
         (double){capital}_ALLOWED);
  return worst <= {capital}_ALLOWED ? 0 : 1;
}}
"""

_VECTORS = """\
/* Signals and what {name} makes of them, for a test on the target. g: as it is given to {name}_step. */
#ifndef PF_GENERATED_{capital}_VECTORS_H
#define PF_GENERATED_{capital}_VECTORS_H

#define {capital}_N_F {n_f}
#define {capital}_SAMPLES {samples}
#define {capital}_ALLOWED (({name}_real){allowed!r})

#include "pf_ieee.h" /* tables follow */
{arrays}
#endif
"""


def export_filter(
    sampled: SampledPhyFilter,
    folder: str | Path,
    channels: int,
    *,
    real: Literal["double", "float", "q31"] | None = None,
    ranges: Mapping[str, float] | None = None,
    inertia: ArrayLike | InertiaInput | None = None,
    name: str = "phyfilter",
    variable: bool = True,
    tunable: bool = True,
    past: int | None = None,
) -> Path:
    """Writes the C sources of a sampled filter, with a program that checks itself on recorded signals.

    Parameters
    ----------
    sampled : SampledPhyFilter
    folder : str or Path
        As :func:`write_folder`.
    channels : int
        Number n_x of channels of x.
    real : {"double", "float", "q31"}, optional
        Numbers of the C code; by default those of ``sampled.sampling.precision``. "q31": 32-bit integers, with fixed
        coefficients and step.
    ranges : mapping of str to float, optional
        Of "q31": largest |x|, |g| and |f_theta|, as :func:`fixed_point`.
    inertia, name, variable, tunable, past
        As :func:`filter_source`; an inertia that is not given is that of the filter's ``sampling``.
        For the smallest and fastest code, ``variable=False, tunable=False``.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    FileExistsError
        If the folder holds files that no export wrote.
    FileNotFoundError
        If there is no folder for it to be in.
    ValueError
        As :func:`filter_source` and :func:`fixed_point`.

    Examples
    --------
    >>> import tempfile
    >>> from phyfilter_ctl import PhyFilter
    >>> with tempfile.TemporaryDirectory() as parent:
    ...     written = export_filter(PhyFilter([20.0]).sampled(0.002), Path(parent, "wing"), 3, name="wing")
    ...     sorted(path.name for path in written.iterdir() if path.name.startswith(("wing", "main")))
    ['main.c', 'wing.c', 'wing.h', 'wing_vectors.h']
    """
    if (real == "q31") != (ranges is not None):
        raise ValueError(
            "ranges: expected with real='q31', and only there: the largest |x|, |g| and |f_theta|, such as "
            "ranges={'x': 10.0, 'g': 20.0, 'f_theta': 20.0}"
        )
    inertia = sampled.sampling.inertia if inertia is None else inertia
    if ranges is not None:
        return write_folder(folder, _fixed(sampled, channels, ranges, inertia, name))
    if real is not None:
        precision = "float32" if real == "float" else "float64"
        sampled = replace(sampled, sampling=replace(sampled.sampling, precision=precision))
    source = filter_source(
        sampled,
        channels,
        name=name,
        inertia=inertia,
        variable=variable,
        tunable=tunable,
        past=past,
    )
    vectors = {f"{name}_vectors.h": _vectors(source, inertia), "main.c": _main(source)}
    return write_folder(folder, own_symbols(own_order(source.sources), name) | vectors)


def _fixed(
    sampled: SampledPhyFilter,
    channels: int,
    ranges: Mapping[str, float],
    inertia: ArrayLike | InertiaInput | None,
    name: str,
) -> dict[str, str]:
    unknown = set(ranges) - {"x", "g", "f_theta"}
    if unknown or "x" not in ranges:
        raise ValueError(f"ranges: expected x, and g and f_theta where they are not 0, got {sorted(ranges)}")
    if inertia is not None:
        raise ValueError(
            "q31 has no inertia, and the filter or the call gives one: give M x as x to a filter without, or export "
            "float or double"
        )
    return fixed_source(fixed_point(sampled, **ranges), channels, name=name)


def _main(source: FilterSource) -> str:
    given = source.inertia_entries > 0
    return _MAIN.format(
        name=source.name,
        capital=source.name.upper(),
        dt=source.sampled.dt,
        inertia="M" if given else "NULL",
        argument=f"{source.name}_inertia[k]" if given else "NULL",
        pad=" " * 12,
        g_text=which_g(source.sampled),
    )


def _vectors(source: FilterSource, inertia: ArrayLike | InertiaInput | None) -> str:
    sampled, n_x, n_f = source.sampled, source.n_x, source.n_f
    rng = np.random.default_rng(1)
    dtype = np.dtype(sampled.sampling.precision)
    x = (2.0 * sampled.dt * np.cumsum(rng.standard_normal((_SAMPLES, n_x)), axis=0)).astype(dtype)
    g = rng.standard_normal((_SAMPLES, n_x)).astype(dtype)
    f_theta = rng.standard_normal((_SAMPLES, n_f)).astype(dtype)
    signals = {"x": x, "g": g, "f_theta": f_theta}
    M: NDArray[np.floating] | None = None
    if isinstance(inertia, str):
        entries = np.eye(n_x).reshape(-1) if inertia == "full" else np.ones(source.inertia_entries)
        M = (entries + 0.05 * rng.standard_normal((_SAMPLES, source.inertia_entries))).astype(dtype)
        signals["inertia"] = M
    signals["f_hat"] = f_hat = _expected(sampled, x, g, f_theta, inertia, M)
    arrays = "".join(
        f"static const {source.name}_real {source.name}_{key}[{_SAMPLES}][{values.shape[1]}] = {_rows(values)};\n\n"
        for key, values in signals.items()
    )
    return _VECTORS.format(
        name=source.name,
        capital=source.name.upper(),
        n_f=n_f,
        samples=_SAMPLES,
        allowed=float(_AGREE * np.finfo(dtype).eps * max(1.0, float(np.abs(f_hat).max()))),
        arrays=arrays,
    )


def _rows(values: NDArray[np.floating]) -> str:
    single = values.dtype == np.float32
    return "{\n" + "".join(f"  {braces(row.astype(float), single)},\n" for row in values) + "}"


def _expected(
    sampled: SampledPhyFilter,
    x: NDArray[np.floating],
    g: NDArray[np.floating],
    f_theta: NDArray[np.floating],
    inertia: ArrayLike | InertiaInput | None,
    M: NDArray[np.floating] | None,
) -> NDArray[np.floating]:
    def at(k: int) -> ArrayLike | None:
        if M is None:
            return None
        if inertia == "full":
            return M[k].reshape(x.shape[1], -1)
        return M[k, 0] if inertia == "scalar" else M[k]

    constant = None if isinstance(inertia, str) else inertia
    first = constant if M is None else at(0)
    state = sampled.start(x[0], f_theta0=f_theta[0], inertia0=first, g0=g[0])
    f_hat = f_theta.copy()
    for k in range(1, len(x)):
        state, f_hat[k] = sampled.step(state, x[k], g[k], f_theta[k], inertia=at(k))
    return sampled.recursion.limited(f_hat)
