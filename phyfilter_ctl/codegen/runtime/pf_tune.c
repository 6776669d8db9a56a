#include "pf_tune.h"

#include <float.h>

#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif
#if defined(__FAST_MATH__) || (defined(FLT_EVAL_METHOD) && FLT_EVAL_METHOD == 2)
#error "pf_tune.c needs IEEE arithmetic: build without -ffast-math, and on 32-bit x86 with -msse2 -mfpmath=sse"
#endif

#define TERMS 18            /* of the Taylor series below a norm of 0.5: 0.5^18 / 19! < 1e-22 of the result */
#define SAME_POLYNOMIAL 1e-14 /* rounding n coefficients once and forming the product of n factors: about n eps */
#define SAME_SIZE 1e-10     /* |p| this close count as equal when poles are sorted: rounding must not order them */
#define SWEEPS 300

typedef struct {
  double re, im;
} pf_complex;

typedef struct {
  double hi, lo;
} pf_pair; /* the unevaluated sum of two doubles, 106 bits */

static double absolute(double v) { return v < 0.0 ? -v : v; }

static int finite(double v) { return v - v == 0.0; }

static double square_root(double v) {
  double root, scale = 1.0;
  if (!(v > 0.0) || !finite(v)) return v > 0.0 ? v : 0.0;
  while (v >= 0x1p64) v *= 0x1p-64, scale *= 0x1p32;
  while (v < 0x1p-64) v *= 0x1p64, scale *= 0x1p-32;
  while (v >= 4.0) v *= 0.25, scale *= 2.0;
  while (v < 1.0) v *= 4.0, scale *= 0.5;
  root = 0.5 * (1.0 + v); /* within 25 % of the root; Newton squares the error */
  for (int i = 0; i < 6; i++) root = 0.5 * (root + v / root);
  return root * scale;
}

static double magnitude(double re, double im) {
  const double a = absolute(re), b = absolute(im), big = a > b ? a : b, small = a > b ? b : a;
  if (small == 0.0) return big;
  return big * square_root(1.0 + (small / big) * (small / big));
}

static pf_complex quotient(pf_complex a, pf_complex b) {
  const double norm = b.re * b.re + b.im * b.im;
  const pf_complex q = {(a.re * b.re + a.im * b.im) / norm, (a.im * b.re - a.re * b.im) / norm};
  return q;
}

static pf_complex product(pf_complex a, pf_complex b) {
  const pf_complex p = {a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re};
  return p;
}

/* -- two doubles for one number (Dekker 1971) -------------------------------------------------------------------- */

static pf_pair sum_exactly(double a, double b) {
  const double sum = a + b, taken = sum - a;
  const pf_pair s = {sum, (a - (sum - taken)) + (b - taken)};
  return s;
}

static pf_pair multiply_exactly(double a, double b) {
  const double split_a = 134217729.0 * a, split_b = 134217729.0 * b; /* 2^27 + 1 */
  const double a1 = split_a - (split_a - a), a2 = a - a1, b1 = split_b - (split_b - b), b2 = b - b1;
  const double p = a * b;
  const pf_pair result = {p, ((a1 * b1 - p) + a1 * b2 + a2 * b1) + a2 * b2};
  return result;
}

static pf_pair add(pf_pair a, pf_pair b) {
  pf_pair s = sum_exactly(a.hi, b.hi);
  s.lo += a.lo + b.lo;
  return sum_exactly(s.hi, s.lo);
}

static pf_pair scale_pair(pf_pair a, double b) {
  pf_pair p = multiply_exactly(a.hi, b);
  p.lo += a.lo * b;
  return sum_exactly(p.hi, p.lo);
}

/* c[0] + c[1] z + ... + c[n] z^n in twice the precision, and its derivative. */
static pf_complex evaluate(int n, const double *c, pf_complex z, pf_complex *slope) {
  pf_pair re = {c[n], 0.0}, im = {0.0, 0.0};
  pf_complex d = {0.0, 0.0}, value;
  for (int i = n - 1; i >= 0; i--) {
    const pf_complex v = {re.hi, im.hi};
    const pf_pair constant = {c[i], 0.0};
    const pf_pair next = add(add(scale_pair(re, z.re), scale_pair(im, -z.im)), constant);
    d = product(d, z);
    d.re += v.re;
    d.im += v.im;
    im = add(scale_pair(re, z.im), scale_pair(im, z.re));
    re = next;
  }
  *slope = d;
  value.re = re.hi;
  value.im = im.hi;
  return value;
}

/* -- roots --------------------------------------------------------------------------------------------------------- */

static int exponent(double v) { /* v > 0: floor(log2 v) */
  int e = 0;
  while (v >= 0x1p32) v *= 0x1p-32, e += 32;
  while (v < 0x1p-32) v *= 0x1p32, e -= 32;
  while (v >= 2.0) v *= 0.5, e += 1;
  while (v < 1.0) v *= 2.0, e -= 1;
  return e;
}

static double power_of_two(int e) {
  double v = 1.0;
  for (; e > 0; e--) v *= 2.0;
  for (; e < 0; e++) v *= 0.5;
  return v;
}

/* Starts on circles whose radii are the slopes of the upper hull of (i, log2 c_i): the sizes of the roots (Bini). */
static void first_guesses(int n, const double *c, pf_complex *z) {
  pf_complex direction = {0.76484218728448842, 0.64421768723769105}; /* e^(0.7 j) */
  const pf_complex turn = {-0.73736887807831991, 0.67549029426152362}; /* the golden angle: no two alike */
  int left = 0;
  while (left < n) {
    int right = left + 1;
    double best = -1e9;
    for (int i = left + 1; i <= n; i++) {
      const double slope = (double)(exponent(c[i]) - exponent(c[left])) / (i - left);
      if (slope >= best) best = slope, right = i;
    }
    const double radius = power_of_two((int)(-best + (best > 0.0 ? -0.5 : 0.5)));
    for (int i = left; i < right; i++) {
      z[i].re = radius * direction.re;
      z[i].im = radius * direction.im;
      direction = product(direction, turn);
    }
    left = right;
  }
}

/* Ehrlich and Aberth's simultaneous iteration; the polynomial in twice the precision, so that even the members of a
 * cluster are found to full precision, as the roots of the very coefficients given. */
static void iterate(int n, const double *c, pf_complex *z) {
  for (int sweep = 0; sweep < SWEEPS; sweep++) {
    int moving = 0;
    for (int i = 0; i < n; i++) {
      pf_complex slope, newton, sum = {0.0, 0.0}, divisor, step;
      const pf_complex one = {1.0, 0.0}, value = evaluate(n, c, z[i], &slope);
      if (value.re == 0.0 && value.im == 0.0) continue;
      if (slope.re == 0.0 && slope.im == 0.0) slope.re = DBL_MIN;
      newton = quotient(value, slope);
      for (int j = 0; j < n; j++) {
        const pf_complex gap = {z[i].re - z[j].re, z[i].im - z[j].im};
        if (j == i || (gap.re == 0.0 && gap.im == 0.0)) continue;
        const pf_complex inverse = quotient(one, gap);
        sum.re += inverse.re;
        sum.im += inverse.im;
      }
      divisor = product(newton, sum);
      divisor.re = 1.0 - divisor.re;
      divisor.im = -divisor.im;
      step = divisor.re == 0.0 && divisor.im == 0.0 ? newton : quotient(newton, divisor);
      if (!finite(step.re) || !finite(step.im)) continue;
      z[i].re -= step.re;
      z[i].im -= step.im;
      moving |= magnitude(step.re, step.im) > 2.0 * DBL_EPSILON * magnitude(z[i].re, z[i].im);
    }
    if (!moving) return;
  }
}

/* A root of multiplicity m is a simple one of the (m-1)th derivative: Newton from the mean of its cluster. */
static pf_complex centre(int n, const double *c, int m, pf_complex z) {
  double derived[PF_MAX_ORDER + 1];
  for (int i = 0; i <= n - m + 1; i++) {
    double ways = 1.0; /* binomial(i + m - 1, i), an exact integer here */
    for (int k = 1; k < m; k++) ways = ways * (i + k) / k;
    derived[i] = ways * c[i + m - 1];
  }
  for (int step = 0; step < 4; step++) {
    pf_complex slope, change;
    const pf_complex value = evaluate(n - m + 1, derived, z, &slope);
    if (slope.re == 0.0 && slope.im == 0.0) break;
    change = quotient(value, slope);
    if (!finite(change.re) || !finite(change.im)) break;
    z.re -= change.re;
    z.im -= change.im;
  }
  return z;
}

static void expand(int n, const pf_complex *z, double *a) {
  pf_complex c[PF_MAX_ORDER + 1]; /* ascending, monic */
  c[0].re = 1.0;
  c[0].im = 0.0;
  for (int k = 0; k < n; k++) {
    c[k + 1] = c[k];
    for (int i = k; i >= 0; i--) {
      const pf_complex part = product(c[i], z[k]);
      c[i].re = (i > 0 ? c[i - 1].re : 0.0) - part.re;
      c[i].im = (i > 0 ? c[i - 1].im : 0.0) - part.im;
    }
  }
  for (int i = 0; i < n; i++) a[i] = c[i].re;
}

/* Roots that hang together within `radius` (relative) replaced by their centre. 0 where none do. */
static int merge(int n, const double *c, const pf_complex *z, double radius, pf_complex *merged) {
  int label[PF_MAX_ORDER], changed = 1, clusters = 0;
  for (int i = 0; i < n; i++) label[i] = i;
  while (changed) {
    changed = 0;
    for (int i = 0; i < n; i++)
      for (int j = 0; j < n; j++) {
        const double far = magnitude(z[i].re - z[j].re, z[i].im - z[j].im);
        if (label[j] > label[i] && (far <= radius * magnitude(z[i].re, z[i].im) ||
                                    far <= radius * magnitude(z[j].re, z[j].im)))
          label[j] = label[i], changed = 1;
      }
  }
  for (int i = 0; i < n; i++) {
    pf_complex mean = {0.0, 0.0};
    int m = 0;
    if (label[i] != i) {
      merged[i] = merged[label[i]]; /* the first of a cluster comes first */
      continue;
    }
    for (int j = 0; j < n; j++)
      if (label[j] == i) mean.re += z[j].re, mean.im += z[j].im, m++;
    mean.re /= m;
    mean.im /= m;
    /* A cluster that is its own mirror image has a real mean. */
    if (absolute(mean.im) <= 4.0 * DBL_EPSILON * magnitude(mean.re, mean.im)) mean.im = 0.0;
    merged[i] = m > 1 ? centre(n, c, m, mean) : mean;
    clusters++;
  }
  return clusters < n;
}

static int reproduces(int n, const double *c, const pf_complex *z) {
  double a[PF_MAX_ORDER];
  expand(n, z, a);
  for (int i = 0; i < n; i++)
    if (!(absolute(a[i] - c[i]) <= n * SAME_POLYNOMIAL * absolute(c[i]))) return 0;
  return 1;
}

int pf_roots(int n, const double *a, double *poles) {
  double c[PF_MAX_ORDER + 1], unit, power = 1.0, radius = 0.1;
  pf_complex z[PF_MAX_ORDER], merged[PF_MAX_ORDER];
  if (n < 1 || n > PF_MAX_ORDER) return 0;
  for (int i = 0; i < n; i++)
    if (!(a[i] > 0.0) || !finite(a[i])) return 0;
  /* In s / unit, a power of two near the geometric mean of the roots, the coefficients are of one size, and exact. */
  unit = power_of_two(exponent(a[0]) / n);
  c[n] = 1.0;
  for (int i = n - 1; i >= 0; i--) {
    power /= unit;
    c[i] = a[i] * power;
  }
  for (int i = 0; i <= n; i++)
    if (!(c[i] > 0.0) || !finite(c[i])) return 0; /* roots of sizes that no double holds */
  first_guesses(n, c, z);
  iterate(n, c, z);
  for (int i = 0; i < n; i++) { /* exact mirror images, so that clusters have real means */
    int partner = i;
    double nearest = 2.0 * absolute(z[i].im);
    for (int j = 0; j < n; j++) {
      const double far = magnitude(z[i].re - z[j].re, z[i].im + z[j].im);
      if (j != i && far < nearest) nearest = far, partner = j;
    }
    if (partner == i) z[i].im = 0.0;
    if (partner > i) {
      z[i].re = z[partner].re = 0.5 * (z[i].re + z[partner].re);
      z[i].im = 0.5 * (z[i].im - z[partner].im);
      z[partner].im = -z[i].im;
    }
  }
  for (int k = 0; k < 16; k++) { /* 10^-1, 10^-1.5, ..., 10^-8.5 */
    if (merge(n, c, z, radius, merged) && reproduces(n, c, merged)) {
      for (int i = 0; i < n; i++) z[i] = merged[i];
      break;
    }
    radius *= 0.31622776601683794;
  }
  for (int i = 0; i < n; i++) {
    poles[2 * i] = z[i].re * unit;
    poles[2 * i + 1] = z[i].im * unit;
  }
  return pf_sort_poles(n, poles);
}

static int comes_before(const double *p, const double *q) {
  const double a = magnitude(p[0], p[1]), b = magnitude(q[0], q[1]), alike = SAME_SIZE * (a + b);
  if (absolute(a - b) > alike) return a < b;
  if (absolute(p[0] - q[0]) > alike) return p[0] < q[0];
  return p[1] < q[1];
}

int pf_sort_poles(int n, double *poles) {
  double kept[2 * PF_MAX_ORDER];
  int count = 0, taken[PF_MAX_ORDER] = {0}, size = 0;
  if (n < 1 || n > PF_MAX_ORDER) return 0;
  for (int i = 0; i < n; i++) {
    const double re = poles[2 * i], im = poles[2 * i + 1], size_i = magnitude(re, im);
    double nearest = 1e-9 * size_i;
    int partner = -1;
    if (!(re < 0.0) || !finite(re) || !finite(im)) return 0;
    if (taken[i]) continue;
    kept[2 * count] = re;
    if (absolute(im) <= 4.0 * DBL_EPSILON * size_i) {
      kept[2 * count++ + 1] = 0.0;
      size += 1;
      continue;
    }
    for (int j = i + 1; j < n; j++) {
      const double far = magnitude(re - poles[2 * j], im + poles[2 * j + 1]);
      if (!taken[j] && far <= nearest) nearest = far, partner = j;
    }
    if (partner < 0) return 0;
    taken[partner] = 1;
    kept[2 * count] = 0.5 * (re + poles[2 * partner]);
    kept[2 * count++ + 1] = 0.5 * absolute(im - poles[2 * partner + 1]);
    size += 2;
  }
  if (size != n) return 0;
  for (int i = 1; i < count; i++) /* insertion: few and nearly in order */
    for (int j = i; j > 0 && comes_before(&kept[2 * j], &kept[2 * j - 2]); j--)
      for (int k = 0; k < 2; k++) {
        const double other = kept[2 * j + k];
        kept[2 * j + k] = kept[2 * j - 2 + k];
        kept[2 * j - 2 + k] = other;
      }
  for (int i = 0, j = 0; i < count; i++) {
    poles[2 * j] = kept[2 * i];
    poles[2 * j++ + 1] = kept[2 * i + 1];
    if (kept[2 * i + 1] > 0.0) {
      poles[2 * j] = kept[2 * i];
      poles[2 * j++ + 1] = -kept[2 * i + 1];
    }
  }
  return 1;
}

void pf_polynomial(int n, const double *poles, double *a) {
  pf_complex z[PF_MAX_ORDER];
  for (int i = 0; i < n; i++) {
    z[i].re = poles[2 * i];
    z[i].im = poles[2 * i + 1];
  }
  expand(n, z, a);
}

/* -- the chain of sections ------------------------------------------------------------------------------------------ */

void pf_chain(int n, const double *poles, double *A, double *equilibrium) {
  for (int i = 0; i < n * n; i++) A[i] = 0.0;
  for (int i = 0; i < n; i++) {
    const double re = poles[2 * i], im = poles[2 * i + 1];
    equilibrium[i] = 1.0;
    A[i * n + i] = re;
    if (im == 0.0) {
      if (i > 0) A[i * n + i - 1] = -re;
      continue;
    }
    const double r = magnitude(re, im);
    if (i > 0) A[i * n + i - 1] = r;
    equilibrium[i] = -re / r;
    A[i * n + i + 1] = -(im * im) / r;
    i++; /* its conjugate */
    A[i * n + i] = re;
    A[i * n + i - 1] = r;
    equilibrium[i] = 1.0;
  }
}

/* prod (s - p) of the poles from `first` on, ascending with the leading 1, in units of `unit`. */
static void denominator(int n, int first, const double *poles, double unit, double *d) {
  pf_complex z[PF_MAX_ORDER];
  for (int i = first; i < n; i++) {
    z[i - first].re = poles[2 * i] / unit;
    z[i - first].im = poles[2 * i + 1] / unit;
  }
  expand(n - first, z, d);
  d[n - first] = 1.0;
}

void pf_chain_output(int n, const double *poles, const double *a, const double *b, double *C) {
  double columns[PF_MAX_ORDER * PF_MAX_ORDER], A[PF_MAX_ORDER * PF_MAX_ORDER], equilibrium[PF_MAX_ORDER];
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
  unit = power_of_two(exponent(a[0]) / n);
  for (int i = 0; i < n * n; i++) columns[i] = 0.0;
  for (int i = 0; i < n; i++) {
    const double re = poles[2 * i] / unit, im = poles[2 * i + 1] / unit;
    if (im == 0.0) {
      gain *= -re;
      denominator(n, i + 1, poles, unit, later);
      for (int k = 0; k < n - i; k++) columns[k * n + i] = gain * later[k];
      continue;
    }
    const double r = magnitude(re, im);
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
  pf_chain(n, poles, A, equilibrium);
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

static void exponential(int n, const double *scaled, double *X) {
  double A[PF_MAX_ORDER * PF_MAX_ORDER], next[PF_MAX_ORDER * PF_MAX_ORDER], norm = 0.0, factor = 1.0;
  int squarings = 0;
  for (int i = 0; i < n; i++) {
    double row = 0.0;
    for (int j = 0; j < n; j++) row += absolute(scaled[i * n + j]);
    if (row > norm) norm = row;
  }
  for (; norm > 0.5 && squarings < 2000; norm *= 0.5, factor *= 0.5) squarings++;
  for (int i = 0; i < n * n; i++) {
    A[i] = scaled[i] * factor;
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
      if (absolute(L[i * n + k]) > absolute(L[pivot * n + k])) pivot = i;
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

void pf_transition(int n, const double *poles, int method, double h, double *dA) {
  double A[PF_MAX_ORDER * PF_MAX_ORDER], equilibrium[PF_MAX_ORDER];
  pf_chain(n, poles, A, equilibrium);
  for (int i = 0; i < n * n; i++) A[i] *= h;
  if (method == PF_EULER)
    copy(n * n, A, dA);
  else if (method == PF_TUSTIN)
    trapezoidal(n, A, dA);
  else
    exponential(n, A, dA);
}

int pf_euler_diverges(int n, const double *poles, double h) {
  for (int i = 0; i < n; i++) {
    const double re = poles[2 * i], im = poles[2 * i + 1];
    if (!(2.0 * re + h * (re * re + im * im) < 0.0)) return 1; /* |1 + p h|^2 - 1, over h */
  }
  return 0;
}

void pf_move_output(int n, const double *equilibrium, const double *C, double y, double *w) {
  double rest = 0.0, sum = 0.0, squares = 0.0;
  for (int i = 0; i < n; i++) {
    rest += C[i] * equilibrium[i];
    sum += absolute(C[i]);
    squares += C[i] * C[i];
  }
  const int use_rest = absolute(rest) > 1e-6 * sum;
  for (int i = 0; i < n; i++) w[i] += y * (use_rest ? equilibrium[i] : C[i]) / (use_rest ? rest : squares);
}
