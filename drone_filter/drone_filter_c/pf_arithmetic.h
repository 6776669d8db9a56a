/* Numbers without libm, for pf_roots.c and pf_tune.c. */
#ifndef PF_ARITHMETIC_H
#define PF_ARITHMETIC_H
#include "pf_ieee.h"

#include "pf_hurwitz.h" /* PF_MAX_ORDER */

typedef struct {
  double re, im;
} pf_complex;

static inline double pf_absolute_(double v) { return v < 0.0 ? -v : v; }

static inline int pf_finite_(double v) { return v - v == 0.0; }

static inline double pf_square_root_(double v) {
  double root, scale = 1.0;
  if (!(v > 0.0) || !pf_finite_(v)) return v > 0.0 ? v : 0.0;
  while (v >= 0x1p64) v *= 0x1p-64, scale *= 0x1p32;
  while (v < 0x1p-64) v *= 0x1p64, scale *= 0x1p-32;
  while (v >= 4.0) v *= 0.25, scale *= 2.0;
  while (v < 1.0) v *= 4.0, scale *= 0.5;
  root = 0.5 * (1.0 + v); /* within 25 % of the root; Newton squares the error */
  for (int i = 0; i < 6; i++) root = 0.5 * (root + v / root);
  return root * scale;
}

static inline double pf_magnitude_(double re, double im) {
  const double a = pf_absolute_(re), b = pf_absolute_(im), big = a > b ? a : b, small = a > b ? b : a;
  if (small == 0.0) return big;
  return big * pf_square_root_(1.0 + (small / big) * (small / big));
}

static inline pf_complex pf_quotient_(pf_complex a, pf_complex b) {
  const double norm = b.re * b.re + b.im * b.im;
  const pf_complex q = {(a.re * b.re + a.im * b.im) / norm, (a.im * b.re - a.re * b.im) / norm};
  return q;
}

static inline pf_complex pf_product_(pf_complex a, pf_complex b) {
  const pf_complex p = {a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re};
  return p;
}

static inline int pf_exponent_(double v) { /* v > 0: floor(log2 v) */
  int e = 0;
  while (v >= 0x1p32) v *= 0x1p-32, e += 32;
  while (v < 0x1p-32) v *= 0x1p32, e -= 32;
  while (v >= 2.0) v *= 0.5, e += 1;
  while (v < 1.0) v *= 2.0, e -= 1;
  return e;
}

static inline double pf_power_of_two_(int e) {
  double v = 1.0;
  for (; e > 0; e--) v *= 2.0;
  for (; e < 0; e++) v *= 0.5;
  return v;
}

/* prod (s - z), ascending without the leading 1. */
static inline void pf_expand_(int n, const pf_complex *z, double *a) {
  pf_complex c[PF_MAX_ORDER + 1]; /* ascending, monic */
  c[0].re = 1.0;
  c[0].im = 0.0;
  for (int k = 0; k < n; k++) {
    c[k + 1] = c[k];
    for (int i = k; i >= 0; i--) {
      const pf_complex part = pf_product_(c[i], z[k]);
      c[i].re = (i > 0 ? c[i - 1].re : 0.0) - part.re;
      c[i].im = (i > 0 ? c[i - 1].im : 0.0) - part.im;
    }
  }
  for (int i = 0; i < n; i++) a[i] = c[i].re;
}

#endif
