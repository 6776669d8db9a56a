/* Poles from coefficients: see pf_tune.h. */
#include "pf_arithmetic.h"
#include "pf_tune.h"

#define SAME_POLYNOMIAL 1e-14 /* rounding n coefficients once and forming the product of n factors: about n eps */
#define SAME_SIZE 1e-10       /* |p| this close count as equal when poles are sorted: rounding must not order them */
#define SWEEPS 300

typedef struct {
  double hi, lo;
} pf_pair; /* the unevaluated sum of two doubles, 106 bits */

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
    d = pf_product_(d, z);
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

/* Starts on circles whose radii are the slopes of the upper hull of (i, log2 c_i): the sizes of the roots (Bini). */
static void first_guesses(int n, const double *c, pf_complex *z) {
  pf_complex direction = {0.76484218728448842, 0.64421768723769105}; /* e^(0.7 j) */
  const pf_complex turn = {-0.73736887807831991, 0.67549029426152362}; /* the golden angle: no two alike */
  int left = 0;
  while (left < n) {
    int right = left + 1;
    double best = -1e9;
    for (int i = left + 1; i <= n; i++) {
      const double slope = (double)(pf_exponent_(c[i]) - pf_exponent_(c[left])) / (i - left);
      if (slope >= best) best = slope, right = i;
    }
    const double radius = pf_power_of_two_((int)(-best + (best > 0.0 ? -0.5 : 0.5)));
    for (int i = left; i < right; i++) {
      z[i].re = radius * direction.re;
      z[i].im = radius * direction.im;
      direction = pf_product_(direction, turn);
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
      newton = pf_quotient_(value, slope);
      for (int j = 0; j < n; j++) {
        const pf_complex gap = {z[i].re - z[j].re, z[i].im - z[j].im};
        if (j == i || (gap.re == 0.0 && gap.im == 0.0)) continue;
        const pf_complex inverse = pf_quotient_(one, gap);
        sum.re += inverse.re;
        sum.im += inverse.im;
      }
      divisor = pf_product_(newton, sum);
      divisor.re = 1.0 - divisor.re;
      divisor.im = -divisor.im;
      step = divisor.re == 0.0 && divisor.im == 0.0 ? newton : pf_quotient_(newton, divisor);
      if (!pf_finite_(step.re) || !pf_finite_(step.im)) continue;
      z[i].re -= step.re;
      z[i].im -= step.im;
      moving |= pf_magnitude_(step.re, step.im) > 2.0 * DBL_EPSILON * pf_magnitude_(z[i].re, z[i].im);
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
    change = pf_quotient_(value, slope);
    if (!pf_finite_(change.re) || !pf_finite_(change.im)) break;
    z.re -= change.re;
    z.im -= change.im;
  }
  return z;
}

/* Roots that hang together within `radius` (relative) replaced by their centre. 0 where none do. */
static int merge(int n, const double *c, const pf_complex *z, double radius, pf_complex *merged) {
  int label[PF_MAX_ORDER], changed = 1, clusters = 0;
  for (int i = 0; i < n; i++) label[i] = i;
  while (changed) {
    changed = 0;
    for (int i = 0; i < n; i++)
      for (int j = 0; j < n; j++) {
        const double far = pf_magnitude_(z[i].re - z[j].re, z[i].im - z[j].im);
        if (label[j] > label[i] && (far <= radius * pf_magnitude_(z[i].re, z[i].im) ||
                                    far <= radius * pf_magnitude_(z[j].re, z[j].im)))
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
    if (pf_absolute_(mean.im) <= 4.0 * DBL_EPSILON * pf_magnitude_(mean.re, mean.im)) mean.im = 0.0;
    merged[i] = m > 1 ? centre(n, c, m, mean) : mean;
    clusters++;
  }
  return clusters < n;
}

static int reproduces(int n, const double *c, const pf_complex *z) {
  double a[PF_MAX_ORDER];
  pf_expand_(n, z, a);
  for (int i = 0; i < n; i++)
    if (!(pf_absolute_(a[i] - c[i]) <= n * SAME_POLYNOMIAL * pf_absolute_(c[i]))) return 0;
  return 1;
}

int drone_filter_pf_roots(int n, const double *a, double *poles) {
  double c[PF_MAX_ORDER + 1], unit, power = 1.0, radius = 0.1;
  pf_complex z[PF_MAX_ORDER], merged[PF_MAX_ORDER];
  if (n < 1 || n > PF_MAX_ORDER) return 0;
  for (int i = 0; i < n; i++)
    if (!(a[i] > 0.0) || !pf_finite_(a[i])) return 0;
  /* In s / unit, a power of two near the geometric mean of the roots, the coefficients are of one size, and exact. */
  unit = pf_power_of_two_(pf_exponent_(a[0]) / n);
  c[n] = 1.0;
  for (int i = n - 1; i >= 0; i--) {
    power /= unit;
    c[i] = a[i] * power;
  }
  for (int i = 0; i <= n; i++)
    if (!(c[i] > 0.0) || !pf_finite_(c[i])) return 0; /* roots of sizes that no double holds */
  first_guesses(n, c, z);
  iterate(n, c, z);
  for (int i = 0; i < n; i++) { /* exact mirror images, so that clusters have real means */
    int partner = i;
    double nearest = 2.0 * pf_absolute_(z[i].im);
    for (int j = 0; j < n; j++) {
      const double far = pf_magnitude_(z[i].re - z[j].re, z[i].im + z[j].im);
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
  return drone_filter_pf_sort_poles(n, poles);
}

static int comes_before(const double *p, const double *q) {
  const double a = pf_magnitude_(p[0], p[1]), b = pf_magnitude_(q[0], q[1]), alike = SAME_SIZE * (a + b);
  if (pf_absolute_(a - b) > alike) return a < b;
  if (pf_absolute_(p[0] - q[0]) > alike) return p[0] < q[0];
  return p[1] < q[1];
}

int drone_filter_pf_sort_poles(int n, double *poles) {
  double kept[2 * PF_MAX_ORDER];
  int count = 0, taken[PF_MAX_ORDER] = {0}, size = 0;
  if (n < 1 || n > PF_MAX_ORDER) return 0;
  for (int i = 0; i < n; i++) {
    const double re = poles[2 * i], im = poles[2 * i + 1], size_i = pf_magnitude_(re, im);
    double nearest = 1e-9 * size_i;
    int partner = -1;
    if (!(re < 0.0) || !pf_finite_(re) || !pf_finite_(im)) return 0;
    if (taken[i]) continue;
    kept[2 * count] = re;
    if (pf_absolute_(im) <= 4.0 * DBL_EPSILON * size_i) {
      kept[2 * count++ + 1] = 0.0;
      size += 1;
      continue;
    }
    for (int j = i + 1; j < n; j++) {
      const double far = pf_magnitude_(re - poles[2 * j], im + poles[2 * j + 1]);
      if (!taken[j] && far <= nearest) nearest = far, partner = j;
    }
    if (partner < 0) return 0;
    taken[partner] = 1;
    kept[2 * count] = 0.5 * (re + poles[2 * partner]);
    kept[2 * count++ + 1] = 0.5 * pf_absolute_(im - poles[2 * partner + 1]);
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
