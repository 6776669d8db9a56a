/* Whether a polynomial is Hurwitz. */
#ifndef PF_HURWITZ_H
#define PF_HURWITZ_H

#ifndef PF_MAX_ORDER
#define PF_MAX_ORDER 2
#endif

/* Whether all roots of s^n + a[n-1] s^(n-1) + ... + a[0] are in the open left half plane: the first column of Routh's
 * array is positive. */
static inline int pf_hurwitz(int n, const double *a) {
  double c[PF_MAX_ORDER + 1] = {0}; /* descending; one row of the array after the other in place */
  if (n < 1 || n > PF_MAX_ORDER) return 0;
  c[0] = 1.0;
  for (int i = 0; i < n; i++) c[i + 1] = a[n - 1 - i];
  for (int k = 0; k < n; k++) {
    if (!(c[k + 1] > 0.0) || !(c[k + 1] - c[k + 1] == 0.0)) return 0;
    const double ratio = c[k] / c[k + 1];
    for (int i = k + 2; i + 1 <= n; i += 2) c[i] -= ratio * c[i + 1];
  }
  return 1;
}

#endif
