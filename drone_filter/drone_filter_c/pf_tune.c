/* From poles to the matrices of the recursion: see pf_tune.h. */
#include "pf_ieee.h"

#include "pf_arithmetic.h"
#include "pf_tune.h"

#define TERMS 18 /* of the Taylor series below a norm of 0.5: 0.5^18 / 19! < 1e-22 of the result */

void drone_filter_pf_polynomial(int n, const double *poles, double *a) {
  pf_complex z[PF_MAX_ORDER];
  for (int i = 0; i < n; i++) {
    z[i].re = poles[2 * i];
    z[i].im = poles[2 * i + 1];
  }
  pf_expand_(n, z, a);
}

/* -- the chain of sections ------------------------------------------------------------------------------------------ */

/* Pole i of the chain, which begins with the fastest: slowest first, weights of the states would grow with the ratio of
 * the poles, and cancel. Of a pair the positive imaginary part again comes first. */
static pf_complex chained(int n, const double *poles, int i) {
  const double *const pole = &poles[2 * (n - 1 - i)];
  const pf_complex p = {pole[0], -pole[1]};
  return p;
}

void drone_filter_pf_chain(int n, const double *poles, double *A, double *equilibrium) {
  for (int i = 0; i < n * n; i++) A[i] = 0.0;
  for (int i = 0; i < n; i++) {
    const pf_complex p = chained(n, poles, i);
    const double re = p.re, im = p.im;
    equilibrium[i] = 1.0;
    A[i * n + i] = re;
    if (im == 0.0) {
      if (i > 0) A[i * n + i - 1] = -re;
      continue;
    }
    const double r = pf_magnitude_(re, im);
    if (i > 0) A[i * n + i - 1] = r;
    equilibrium[i] = -re / r;
    A[i * n + i + 1] = -(im * im) / r;
    i++; /* its conjugate */
    A[i * n + i] = re;
    A[i * n + i - 1] = r;
    equilibrium[i] = 1.0;
  }
}

/* prod (s - p) of the poles of the chain from `first` on, ascending with the leading 1, in units of `unit`. */
static void denominator(int n, int first, const double *poles, double unit, double *d) {
  pf_complex z[PF_MAX_ORDER];
  for (int i = first; i < n; i++) {
    const pf_complex p = chained(n, poles, i);
    z[i - first].re = p.re / unit;
    z[i - first].im = p.im / unit;
  }
  pf_expand_(n - first, z, d);
  d[n - first] = 1.0;
}

void drone_filter_pf_chain_output(int n, const double *poles, const double *a, const double *b, double *C) {
  double columns[PF_MAX_ORDER * PF_MAX_ORDER], equilibrium[PF_MAX_ORDER];
  double later[PF_MAX_ORDER + 1], right[PF_MAX_ORDER], gain = 1.0, power = 1.0, rest = 0.0, unit;
  int lowpass = b[0] == a[0];
  for (int i = 1; i < n; i++) lowpass &= b[i] == 0.0;
  for (int i = 0; i < n; i++) C[i] = 0.0;
  if (lowpass) {
    C[n - 1] = 1.0;
    return;
  }
  /* In s / unit all coefficients are of one size. Numerator of state i: the gains up to it times the denominators after
   * it, so its degree falls by one a state and the system is triangular. */
  unit = pf_power_of_two_(pf_exponent_(a[0]) / n);
  for (int i = 0; i < n * n; i++) columns[i] = 0.0;
  for (int i = 0; i < n; i++) {
    const pf_complex p = chained(n, poles, i);
    const double re = p.re / unit, im = p.im / unit;
    if (im == 0.0) {
      gain *= -re;
      denominator(n, i + 1, poles, unit, later);
      for (int k = 0; k < n - i; k++) columns[k * n + i] = gain * later[k];
      continue;
    }
    const double r = pf_magnitude_(re, im);
    denominator(n, i + 2, poles, unit, later);
    for (int k = 0; k < n - i - 1; k++) {
      columns[k * n + i] += gain * r * -re * later[k];
      columns[(k + 1) * n + i] += gain * r * later[k];
    }
    gain *= r * r;
    for (int k = 0; k < n - i - 1; k++) columns[k * n + i + 1] = gain * later[k];
    i++;
  }
  for (int i = n - 1; i >= 0; i--) {
    power /= unit;
    right[i] = b[i] * power;
  }
  for (int i = 0; i < n; i++) { /* s^(n-1) first: only C[0] reaches it, then C[1], ... */
    const int row = n - 1 - i;
    double sum = right[row];
    for (int j = 0; j < i; j++) sum -= columns[row * n + j] * C[j];
    C[i] = sum / columns[row * n + i];
  }
  drone_filter_pf_chain(n, poles, columns, equilibrium); /* the matrix is not needed */
  for (int i = 0; i < n; i++) rest += C[i] * equilibrium[i];
  C[n - 1] += b[0] / a[0] - rest; /* F(0) to the last digit */
}

/* result = A (I + X) / divisor, result other than X */
static void apply(int n, const double *A, const double *X, double divisor, double *result) {
  for (int i = 0; i < n; i++)
    for (int j = 0; j < n; j++) {
      double sum = A[i * n + j];
      for (int k = 0; k < n; k++) sum += A[i * n + k] * X[k * n + j];
      result[i * n + j] = sum / divisor;
    }
}

static void copy(int count, const double *from, double *to) {
  for (int i = 0; i < count; i++) to[i] = from[i];
}

/* X = exp(A) - I; A is used up. */
static void exponential(int n, double *A, double *X) {
  double next[PF_MAX_ORDER * PF_MAX_ORDER], norm = 0.0, factor = 1.0;
  int squarings = 0;
  for (int i = 0; i < n; i++) {
    double row = 0.0;
    for (int j = 0; j < n; j++) row += pf_absolute_(A[i * n + j]);
    if (row > norm) norm = row;
  }
  for (; norm > 0.5 && squarings < 2000; norm *= 0.5, factor *= 0.5) squarings++;
  for (int i = 0; i < n * n; i++) {
    A[i] *= factor;
    X[i] = A[i] / TERMS;
  }
  for (int j = TERMS - 1; j >= 1; j--) {
    apply(n, A, X, (double)j, next);
    copy(n * n, next, X);
  }
  for (; squarings > 0; squarings--) { /* (I + X)^2 - I: nothing is ever subtracted from I, slow poles keep digits */
    apply(n, X, X, 1.0, next);
    for (int i = 0; i < n * n; i++) X[i] += next[i];
  }
}

/* (I - M/2) X = M by elimination with row exchanges. */
static void trapezoidal(int n, const double *M, double *X) {
  double L[PF_MAX_ORDER * PF_MAX_ORDER];
  copy(n * n, M, X);
  for (int i = 0; i < n * n; i++) L[i] = (i % (n + 1) == 0 ? 1.0 : 0.0) - 0.5 * M[i];
  for (int k = 0; k < n; k++) {
    int pivot = k;
    for (int i = k + 1; i < n; i++)
      if (pf_absolute_(L[i * n + k]) > pf_absolute_(L[pivot * n + k])) pivot = i;
    for (int j = 0; j < n; j++) {
      const double l = L[k * n + j], x = X[k * n + j];
      L[k * n + j] = L[pivot * n + j];
      X[k * n + j] = X[pivot * n + j];
      L[pivot * n + j] = l;
      X[pivot * n + j] = x;
    }
    for (int i = 0; i < n; i++) {
      const double factor = i == k ? 0.0 : L[i * n + k] / L[k * n + k];
      if (factor == 0.0) continue;
      for (int j = k; j < n; j++) L[i * n + j] -= factor * L[k * n + j];
      for (int j = 0; j < n; j++) X[i * n + j] -= factor * X[k * n + j];
    }
  }
  for (int i = 0; i < n * n; i++) X[i] /= L[(i / n) * (n + 1)];
}

void drone_filter_pf_transition(int n, const double *poles, int method, double h, double *dA) {
  double A[PF_MAX_ORDER * PF_MAX_ORDER], equilibrium[PF_MAX_ORDER];
  drone_filter_pf_chain(n, poles, A, equilibrium);
  for (int i = 0; i < n * n; i++) A[i] *= h;
  if (method == PF_EULER)
    copy(n * n, A, dA);
  else if (method == PF_TUSTIN)
    trapezoidal(n, A, dA);
  else
    exponential(n, A, dA);
}

int drone_filter_pf_euler_diverges(int n, const double *poles, double h) {
  for (int i = 0; i < n; i++) {
    const double re = poles[2 * i], im = poles[2 * i + 1];
    if (!(2.0 * re + h * (re * re + im * im) < 0.0)) return 1; /* |1 + p h|^2 - 1, over h */
  }
  return 0;
}

/* -- a state of another filter -------------------------------------------------------------------------------------- */

/* Covariance of the states of two chains less equilibrium times input, the input a random walk with white noise on it:
 * A X + X A_other' + e e_other' + noise b b_other' = 0. Section by section from the first: with re I + N for each,
 * N^2 = -im^2 I, a block of X is a polynomial of the two N over a number. */
static void covariance(int n, const double *poles, const double *other, double noise, double *X) {
  for (int i = 0, rows = 1; i < n; i += rows) {
    const pf_complex p = chained(n, poles, i);
    const double r = pf_magnitude_(p.re, p.im), back = -(p.im * p.im) / r;
    rows = p.im == 0.0 ? 1 : 2;
    for (int j = 0, columns = 1; j < n; j += columns) {
      const pf_complex q = chained(n, other, j);
      const double t = pf_magnitude_(q.re, q.im), square = q.im * q.im, s = p.re + q.re;
      const double alpha = s * s + (p.im - q.im) * (p.im + q.im);
      double R[2][2] = {{0.0}}, RN[2][2], rest[2][2];
      columns = q.im == 0.0 ? 1 : 2;
      for (int k = 0; k < rows; k++)
        for (int l = 0; l < columns; l++) {
          R[k][l] = (k ? 1.0 : -p.re / r) * (l ? 1.0 : -q.re / t);
          if (k == 0 && i > 0) R[k][l] += r * X[(i - 1) * n + j + l];
          if (l == 0 && j > 0) R[k][l] += t * X[(i + k) * n + j - 1];
        }
      if (i == 0 && j == 0) R[0][0] += noise * r * t;
      for (int k = 0; k < 2; k++) {
        RN[k][0] = -square / t * R[k][1];
        RN[k][1] = t * R[k][0];
        for (int l = 0; l < 2; l++) rest[k][l] = 2.0 * s * RN[k][l] - alpha * R[k][l];
      }
      for (int k = 0; k < rows; k++)
        for (int l = 0; l < columns; l++)
          X[(i + k) * n + j + l] = -(s * (alpha + 2.0 * square) * R[k][l] + (alpha - 2.0 * s * s) * RN[k][l] +
                                     (k ? r * rest[0][l] : back * rest[1][l])) /
                                   (alpha * alpha + 4.0 * s * s * square);
    }
  }
}

/* P = L D L' in place: L D below the diagonal, 1 / D on it; 0 where a state follows from the others but for rounding. */
static void factors(int n, double *P) {
  for (int k = 0; k < n; k++) {
    const double size = P[k * n + k];
    for (int i = k; i < n; i++)
      for (int j = 0; j < k; j++) P[i * n + k] -= P[i * n + j] * (P[k * n + j] * P[j * n + j]);
    P[k * n + k] = P[k * n + k] > 1e-8 * size ? 1.0 / P[k * n + k] : 0.0;
  }
}

static void solve(int n, const double *P, double *x) {
  for (int i = 0; i < n; i++)
    for (int j = 0; j < i; j++) x[i] -= P[i * n + j] * P[j * n + j] * x[j];
  for (int i = n - 1; i >= 0; i--) {
    x[i] *= P[i * n + i];
    for (int j = i + 1; j < n; j++) x[i] -= P[j * n + i] * P[i * n + i] * x[j];
  }
}

/* y' X z */
static double form(int n, const double *y, const double *X, const double *z) {
  double sum = 0.0;
  for (int i = 0; i < n; i++)
    for (int j = 0; j < n; j++) sum += y[i] * X[i * n + j] * z[j];
  return sum;
}

void drone_filter_pf_move_state(int n, const double *old_poles, const double *old_equilibrium, const double *old_C,
                   const double *poles, const double *equilibrium, const double *C, double *w) {
  const double noise = 1.0 / (poles[0] * poles[0] + poles[1] * poles[1]);
  double P[PF_MAX_ORDER * PF_MAX_ORDER], weights[PF_MAX_ORDER], away[PF_MAX_ORDER], level = 0.0, unit = 0.0;
  double jump = 0.0, size, sizes, alike;
  drone_filter_pf_chain(n, old_poles, P, weights); /* the equilibrium not as rounded: P knows those that are likely */
  covariance(n, old_poles, old_poles, noise, P);
  sizes = form(n, old_C, P, old_C);
  factors(n, P);
  solve(n, P, weights);
  for (int i = 0; i < n; i++) {
    level += weights[i] * w[i];
    unit += weights[i] * old_equilibrium[i];
    jump += old_C[i] * w[i];
  }
  level /= unit;
  for (int i = 0; i < n; i++) away[i] = w[i] - level * old_equilibrium[i];
  solve(n, P, away);
  covariance(n, poles, poles, noise, P);
  size = form(n, C, P, C);
  sizes *= size;
  for (int i = 0; i < n; i++) {
    weights[i] = 0.0;
    for (int j = 0; j < n; j++) weights[i] += P[i * n + j] * C[j];
  }
  covariance(n, poles, old_poles, noise, P);
  alike = form(n, C, P, old_C);
  alike = sizes > 0.0 ? alike * alike / sizes : 0.0;
  for (int i = 0; i < n; i++) {
    w[i] = 0.0;
    for (int j = 0; j < n; j++) w[i] += P[i * n + j] * away[j];
    w[i] = level * equilibrium[i] + alike * w[i];
    jump -= C[i] * w[i];
  }
  for (int i = 0; size > 0.0 && i < n; i++) w[i] += jump / size * weights[i]; /* size 0: F = 0 */
}
