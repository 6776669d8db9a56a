"""The same low-pass filter as others would write it for a core in float: what tested.c of steps.c is made from."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
from scipy import signal

from phyfilter_ctl import SampledPhyFilter

__all__ = ["TESTED_H", "casadi_source", "cmsis_source", "direct_form"]

# What steps.c calls. {extra} declares what a variant needs beyond that.
TESTED_H = """\
#ifndef TESTED_H
#define TESTED_H
#include <stddef.h>
#include <stdint.h>
typedef {real} real;
#define SCHEDULE "{schedule}"
int begin(void);
void step(uint64_t now, const real *x, const real *g, const real *f_theta, real *f_hat);
void tune(void);
void check(void);
size_t state_bytes(void);
#endif
"""
_AROUND = """\
#include "tested.h"
{include}
typedef struct {{
  float x[3], f_theta[3];
  int running;
{state}}} filter;
static filter self;

int begin(void) {{ return 0; }}
void tune(void) {{}}
void check(void) {{}}
size_t state_bytes(void) {{ return sizeof self; }}

void step(uint64_t now, const real *x, const real *g, const real *f_theta, real *f_hat) {{
  (void)now;
  float u[3], y[3] = {{0}};
  if (!self.running) {{
    self.running = 1;
{start}  }} else {{
    for (int i = 0; i < 3; i++) u[i] = (x[i] - self.x[i]) * {rate} - g[i] - 0.5f * (f_theta[i] + self.f_theta[i]);
{body}  }}
  for (int i = 0; i < 3; i++) {{
    f_hat[i] = f_theta[i] + y[i];
    self.x[i] = x[i], self.f_theta[i] = f_theta[i];
  }}
}}
"""


def _numbers(values: object) -> str:
    return ", ".join(f"{float(value)!r}f" for value in np.ravel(np.asarray(values)))


def _rational(sampled: SampledPhyFilter) -> tuple[np.ndarray, np.ndarray]:
    """Numerator and denominator in z^-1 of C z (z I - A)^-1 B, the filter of the residual over a step."""
    dA, equilibrium, C = (np.asarray(part) for part in sampled.transition)
    A = np.eye(len(dA)) + dA
    numerator, denominator = signal.ss2tf(
        A, (-dA @ equilibrium)[:, None], (C @ A)[None, :], [[C @ -dA @ equilibrium]]
    )
    return np.asarray(numerator)[0], np.asarray(denominator)


def direct_form(sampled: SampledPhyFilter) -> str:
    """Transposed direct form II of the sampled filter's polynomials, by hand."""
    b, a = _rational(sampled)
    n = sampled.order
    return _AROUND.format(
        include=f"static const float B[] = {{{_numbers(b)}}}, A[] = {{{_numbers(a)}}};",
        state=f"  float s[3][{n}];\n",
        start="",
        rate=f"{1.0 / sampled.dt!r}f",
        body=f"""\
    for (int i = 0; i < 3; i++) {{
      float *const s = self.s[i];
      y[i] = B[0] * u[i] + s[0];
      for (int j = 0; j < {n - 1}; j++) s[j] = B[j + 1] * u[i] - A[j + 1] * y[i] + s[j + 1];
      s[{n - 1}] = B[{n}] * u[i] - A[{n}] * y[i];
    }}
""",
    )


def cmsis_source(sampled: SampledPhyFilter) -> str:
    """CMSIS-DSP's cascade of biquads, transposed direct form II, one sample a call."""
    b, a = _rational(sampled)
    zeros = np.roots(b)
    sections = signal.zpk2sos(np.append(zeros, np.zeros(len(a) - 1 - len(zeros))), np.roots(a), b[0])
    rows = [(row[0], row[1], row[2], -row[4], -row[5]) for row in sections]
    count = len(rows)
    return _AROUND.format(
        include=f'#include "dsp/filtering_functions.h"\nstatic const float S[] = {{{_numbers(rows)}}};',
        state=f"  arm_biquad_cascade_df2T_instance_f32 instance[3];\n  float s[3][{2 * count}];\n",
        start="    for (int i = 0; i < 3; i++)\n"
        f"      arm_biquad_cascade_df2T_init_f32(&self.instance[i], {count}, S, self.s[i]);\n",
        rate=f"{1.0 / sampled.dt!r}f",
        body="    for (int i = 0; i < 3; i++) arm_biquad_cascade_df2T_f32(&self.instance[i], &u[i], &y[i], 1);\n",
    )


def casadi_source(sampled: SampledPhyFilter, folder: Path) -> str:
    """CasADi's C of the state equations, their coefficients constants; writes equations.c into the folder."""
    dA, equilibrium, C = (np.asarray(part) for part in sampled.transition)
    n = sampled.order
    w, u = ca.SX.sym("w", n, 3), ca.SX.sym("u", 1, 3)
    following = w + ca.DM(dA) @ (w - ca.DM(equilibrium) @ u)
    function = ca.Function("equations", [w, u], [following, ca.DM(C).T @ following])
    generator = ca.CodeGenerator("equations.c", {"casadi_real": "float"})
    generator.add(function)
    (folder / "equations.h").write_text(generator.dump())
    return _AROUND.format(
        include='#include "equations.h"',
        state=f"  float w[{3 * n}];\n",
        start="",
        rate=f"{1.0 / sampled.dt!r}f",
        body=f"""\
    float work[{max(function.sz_w(), 1)}];
    const float *arg[{function.sz_arg()}] = {{self.w, u}};
    float *res[{function.sz_res()}] = {{self.w, y}};
    equations(arg, res, NULL, work, 0);
""",
    )
