/* Error of the float32 filter over days of samples: the compensated recursion and the paper's Eq. (5), both in float,
 * against the same recursion in long double on the same rounded inputs and coefficients.
 *
 * Reads from standard input: order, steps, seed, noise of x (m/s), residual (m/s^2), rate (1/s), then dA (n x n, row by
 * row), equilibrium, C, and a_0 ... a_{n-1}. Prints one line per time bin: end of the bin (steps), greatest error of
 * the two forms in it, greatest |f_hat| so far; then the first outputs of the compensated form for comparison.
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>

#define MAX_ORDER 6
#define CHECKED 2000

static uint64_t state_of_random;

static uint32_t next_random(void) { /* xorshift64*, Vigna 2016 */
  state_of_random ^= state_of_random >> 12;
  state_of_random ^= state_of_random << 25;
  state_of_random ^= state_of_random >> 27;
  return (uint32_t)((state_of_random * 2685821657736338717ULL) >> 32);
}

static double next_normal(void) { /* sum of twelve uniforms: bounded, which a sensor is too */
  double sum = -6.0;
  for (int i = 0; i < 12; i++) sum += next_random() / 4294967296.0;
  return sum;
}

typedef struct {
  int n;
  float dA[MAX_ORDER][MAX_ORDER], equilibrium[MAX_ORDER], C[MAX_ORDER], a[MAX_ORDER], rate, h;
} Coefficients;

static float compensated_step(const Coefficients *c, float *w, float *carry, float u) {
  float distance[MAX_ORDER], y = 0.0f;
  for (int i = 0; i < c->n; i++) distance[i] = (w[i] - u * c->equilibrium[i]) + carry[i];
  for (int i = 0; i < c->n; i++) {
    float change = 0.0f;
    for (int j = 0; j < c->n; j++) change += c->dA[i][j] * distance[j];
    change += carry[i];
    const float sum = w[i] + change, taken = sum - w[i];
    carry[i] = (w[i] - (sum - taken)) + (change - taken);
    w[i] = sum;
  }
  for (int i = 0; i < c->n; i++) y += c->C[i] * (w[i] + carry[i]);
  return y;
}

static long double reference_step(const Coefficients *c, long double *w, long double u) {
  long double distance[MAX_ORDER], y = 0.0L;
  for (int i = 0; i < c->n; i++) distance[i] = w[i] - u * c->equilibrium[i];
  for (int i = 0; i < c->n; i++)
    for (int j = 0; j < c->n; j++) w[i] += c->dA[i][j] * distance[j];
  for (int i = 0; i < c->n; i++) y += c->C[i] * w[i];
  return y;
}

/* Eq. (5), low-pass form, forward Euler: xi and its derivatives, integrals of f_hat and of x (f_theta is 0 here). */
#define PAPER_FORM(REAL, NAME)                                                                          \
  typedef struct {                                                                                      \
    REAL xi[MAX_ORDER], alpha[MAX_ORDER], x[MAX_ORDER];                                                 \
  } NAME##_state;                                                                                       \
  static REAL NAME##_step(const Coefficients *c, NAME##_state *s, float x, float g) {                   \
    const int n = c->n;                                                                                 \
    const REAL h = (REAL)c->h;                                                                          \
    for (int i = 0; i < n - 1; i++) s->xi[i] += h * s->xi[i + 1];                                       \
    s->xi[n - 1] += h * (-(REAL)g - s->alpha[0]);                                                       \
    for (int i = n - 1; i > 0; i--) {                                                                   \
      s->alpha[i] += h * s->alpha[i - 1];                                                               \
      s->x[i] += h * s->x[i - 1];                                                                       \
    }                                                                                                   \
    s->x[0] = x;                                                                                        \
    REAL y = (REAL)c->a[0] * s->xi[0] + (REAL)c->a[0] * s->x[n - 1];                                    \
    for (int i = 1; i < n; i++) y -= (REAL)c->a[n - i] * s->alpha[i];                                   \
    s->alpha[0] = y;                                                                                    \
    return y;                                                                                           \
  }

PAPER_FORM(float, paper)

/* The same Euler filter without the growing states, in long double: xi~ = f_hat as the companion form of 1/D. */
static long double euler_step(const Coefficients *c, long double *w, long double u) {
  const int n = c->n;
  const long double h = c->h;
  long double top = u;
  for (int i = 0; i < n; i++) top -= c->a[i] * w[i];
  for (int i = 0; i < n - 1; i++) w[i] += h * w[i + 1];
  w[n - 1] += h * top;
  return c->a[0] * w[0];
}

int main(void) {
  Coefficients c;
  long long steps;
  unsigned long long seed;
  double noise, residual, value;
  if (scanf("%d %lld %llu %lf %lf %lf", &c.n, &steps, &seed, &noise, &residual, &value) != 6) return 2;
  if (c.n < 1 || c.n > MAX_ORDER || seed == 0) return 2;
  c.rate = (float)value;
  c.h = (float)(1.0 / value);
  for (int i = 0; i < c.n * c.n; i++) {
    if (scanf("%lf", &value) != 1) return 2;
    c.dA[i / c.n][i % c.n] = (float)value;
  }
  float *const vectors[3] = {c.equilibrium, c.C, c.a};
  for (int k = 0; k < 3; k++)
    for (int i = 0; i < c.n; i++) {
      if (scanf("%lf", &value) != 1) return 2;
      vectors[k][i] = (float)value;
    }
  state_of_random = seed;
  float w[MAX_ORDER] = {0}, carry[MAX_ORDER] = {0}, first[CHECKED], x_first[CHECKED], x_before;
  long double exact[MAX_ORDER] = {0}, euler[MAX_ORDER] = {0};
  paper_state paper = {{0}, {0}, {0}};
  const float g = (float)-residual;
  double worst[2] = {0.0, 0.0}, top = 0.0, bin_end = 1000.0;
  x_before = (float)(noise * next_normal());
  x_first[0] = x_before;
  paper.xi[c.n - 1] = -x_before;
  paper.x[0] = x_before;
  for (long long k = 1; k <= steps; k++) {
    const float x = noise > 0.0 ? (float)(noise * next_normal()) : 0.0f;
    const float u = (x - x_before) * c.rate - g;
    const long double u_exact = ((long double)x - x_before) * c.rate - g;
    const float y = compensated_step(&c, w, carry, u);
    const long double y_exact = reference_step(&c, exact, u_exact);
    const float y_paper = paper_step(&c, &paper, x, g);
    const long double y_euler = euler_step(&c, euler, u_exact);
    if (k < CHECKED) {
      first[k] = y;
      x_first[k] = x;
    }
    x_before = x;
    worst[0] = fmax(worst[0], (double)fabsl(y - y_exact));
    worst[1] = fmax(worst[1], isfinite(y_paper) ? (double)fabsl(y_paper - y_euler) : INFINITY);
    top = fmax(top, (double)fabsl(y_exact));
    if (k >= (long long)bin_end || k == steps) {
      printf("bin %lld %.9g %.9g %.9g\n", k, worst[0], worst[1], top);
      while (k >= (long long)bin_end) bin_end *= 1.25892541179416721; /* ten bins a decade */
      worst[0] = worst[1] = 0.0;
    }
  }
  for (int k = 0; k < CHECKED && k <= steps; k++) printf("first %.9g %.9g\n", x_first[k], k ? first[k] : 0.0f);
  return 0;
}
