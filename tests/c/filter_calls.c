/* Random calls of one filter, right and wrong ones, then a correct run that must still be right.
 *
 * Build with -DNAME=<filter> -DHEADER="<filter>.h" under sanitizers. Argument: number of calls. Prints a CRC-32 of all
 * f_hat of the run, which must be the same from every compiler. Returns 1 where a refused call changed anything.
 */
#include "pf_ieee.h"

#include <float.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include HEADER
#include "pf_crc.h"

#define PF_NAME NAME
#define REAL PF_P(real)
#define N_X PF_P(N_X)
#define N_F PF_P(N_F)
#define N PF_P(ORDER)
#define BANKS PF_P(FILTERS)
#define N_M (PF_P(INERTIA) < 2 ? 1 : PF_P(INERTIA) == 2 ? N_X : N_X * N_X)
#define SAMPLES 400

static uint64_t random_state = 88172645463325252u;

static uint32_t random_bits(void) { /* xorshift64*, Vigna 2016 */
  random_state ^= random_state >> 12;
  random_state ^= random_state << 25;
  random_state ^= random_state >> 27;
  return (uint32_t)((random_state * 2685821657736338717u) >> 32);
}

static double uniform(void) { return (double)random_bits() / 2147483648.0 - 1.0; }

static double wild(void) {
  const double zero = 0.0;
  switch (random_bits() % 40) {
    case 0: return zero / zero;
    case 1: return 1.0 / zero;
    case 2: return -1.0 / zero;
    case 3: return 1e30 * uniform();
    case 4: return 1e-40 * uniform();
    default: return uniform();
  }
}

static void fill(REAL *values, int count, double (*source)(void)) {
  for (int i = 0; i < count; i++) values[i] = (REAL)source();
}

static PF_NAME self, before;
static REAL x[N_X], g[N_X], f_theta[N_F], inertia[N_M], f_hat[N_F];

static const REAL *maybe(const REAL *values) { return random_bits() % 3 ? values : NULL; }

/* One after the other: C leaves the order of arguments to the compiler. */
static int start(const REAL *estimate) {
  const REAL *const first = maybe(f_theta), *const M = maybe(inertia), *const known = maybe(g);
  return PF_P(start)(&self, x, estimate, first, M, known);
}

#if PF_P(TUNABLE)
/* Half of them stable: (s + p) to some power, which is a repeated pole too. */
static int tune(void) {
  double a[BANKS][N] = {{0}}, b[BANKS][N] = {{0}};
  for (int i = 0; i < BANKS; i++) {
    const int n = (int)PF_P(parameters).order[i];
    const double pole = 1.0 + 60.0 * (uniform() + 1.0);
    a[i][0] = pole;
    for (int k = 1; k < n; k++)
      for (int j = k; j >= 0; j--) a[i][j] = pole * a[i][j] + (j > 0 ? a[i][j - 1] : 0.0) + (j == k ? pole : 0.0);
    for (int j = 0; j < n; j++) {
      if (random_bits() % 4 == 0) a[i][j] *= 1.0 + 0.3 * uniform();
      if (random_bits() % 30 == 0) a[i][j] = wild() * 1e4;
      b[i][j] = random_bits() % 3 ? a[i][j] : wild() * a[i][j];
    }
  }
  return PF_P(retune)(&self, a[0], b[0]);
}

static int place(void) {
  double poles[BANKS][N][2] = {{{0}}}, b[BANKS][N] = {{0}};
  for (int i = 0; i < BANKS; i++)
    for (int j = 0; j < (int)PF_P(parameters).order[i]; j++) {
      const int second = j % 2 == 1 && random_bits() % 2;
      poles[i][j][0] = second ? poles[i][j - 1][0] : -50.0 * (uniform() + 1.05);
      poles[i][j][1] = second ? -poles[i][j - 1][1] : (random_bits() % 2 ? 0.0 : 40.0 * wild());
      b[i][j] = wild();
    }
  return PF_P(retune_poles)(&self, &poles[0][0][0], b[0]);
}
#endif

static int call(void) {
  fill(x, N_X, wild);
  fill(g, N_X, wild);
  fill(f_theta, N_F, wild);
  fill(inertia, N_M, wild);
  switch (random_bits() % 24) {
    case 0: PF_P(reset)(&self); return 0;
    case 1: return start(NULL);
    case 2: return start(f_hat);
    case 3: return PF_P(shift_x)(&self, x);
    case 4: PF_P(remember)(&self, g); return 0;
    case 5: return PF_P(output)(&self, x, g, f_theta, maybe(inertia), f_hat);
#if PF_P(LIMIT)
    case 6: return PF_P(set_limit)(&self, f_theta);
#endif
#if PF_P(TUNABLE)
    case 7:
    case 8: return tune();
    case 9: return place();
#endif
#if PF_P(VARIABLE)
    case 10: return PF_P(output_after)(&self, x, g, f_theta, inertia, 0.02 * wild(), f_hat);
    case 11: return PF_P(step_after)(&self, x, g, f_theta, NULL, wild(), f_hat);
    case 12:
    case 13:
    case 14: return PF_P(step_after)(&self, x, g, f_theta, inertia, 0.004 * (uniform() + 1.0), f_hat);
#endif
    default: return PF_P(step)(&self, x, g, f_theta, maybe(inertia), f_hat);
  }
}

static uint32_t correct_run(PF_NAME *filter) {
  uint32_t crc = 0;
  random_state = 99u;
  memset(x, 0, sizeof x);
  for (int k = 0; k < SAMPLES; k++) {
    for (int i = 0; i < N_X; i++) x[i] += (REAL)(0.004 * uniform());
    fill(g, N_X, uniform);
    fill(f_theta, N_F, uniform);
    for (int i = 0; i < N_M; i++) inertia[i] = (REAL)(1.0 + 0.1 * uniform());
    if (PF_P(HOLD_BAD) && k % 50 == 49) x[0] += (REAL)(1.0 / 0.0 * 0.0);
    if (PF_P(step)(filter, x, g, f_theta, inertia, f_hat)) return 0;
    if (PF_P(HOLD_BAD) && k % 50 == 49) x[0] = (REAL)0.01;
#if PF_P(FLOAT)
    crc = pf_crc32_float(crc, f_hat, N_F);
#else
    crc = pf_crc32_double(crc, f_hat, N_F);
#endif
  }
  return crc;
}

static int check_init(void) {
  PF_P(params) damaged = PF_P(parameters);
  damaged.version++;
  if (PF_P(init)(&self, &damaged) != PF_FILTER_VERSION) return 1;
  damaged = PF_P(parameters);
  damaged.dt *= 2.0;
  if (PF_P(init)(&self, &damaged) != PF_FILTER_CORRUPT) return 1;
  if (PF_P(step)(&self, x, g, f_theta, inertia, f_hat) != PF_FILTER_INVALID) return 1; /* it does not run */
  return PF_P(init)(&self, &PF_P(parameters)) != PF_FILTER_OK;
}

int main(int count, char **arguments) {
  const long calls = count > 1 ? strtol(arguments[1], NULL, 10) : 1000;
  long refused = 0;
  uint32_t crc;
  memset(f_hat, 0, sizeof f_hat);
  if (check_init()) return 2;
  crc = correct_run(&self);
  if (PF_P(init)(&self, &PF_P(parameters))) return 2;
  random_state = 88172645463325252u;
  for (long k = 0; k < calls; k++) {
    memcpy(&before, &self, sizeof self);
    if (call()) {
      refused++;
      if (memcmp(&before, &self, sizeof self)) {
        printf("call %ld was refused but changed the filter\n", k);
        return 1;
      }
    }
  }
  if (PF_P(init)(&self, &PF_P(parameters))) return 2;
  if (correct_run(&self) != crc) {
    printf("the run after %ld calls is another\n", calls);
    return 1;
  }
  printf("%08lx %ld\n", (unsigned long)crc, refused);
  return 0;
}
