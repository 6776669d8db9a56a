/* Time of one communication step of an FMU of a second-order, three-channel filter: set, doStep and get through the
 * binary's standard functions, and the same recursion written by hand as a plain loop. See fmu_step.py.
 *
 * Reads from standard input: FMI version, path of the binary, token, steps, repetitions, value references of x, g,
 * f_theta and f_hat (first of each), then dA (2 x 2), equilibrium (2), C (2) and the step in seconds. Prints
 * nanoseconds per step of the FMU and of the loop, best of the repetitions, and the greatest difference of f_hat.
 */
#define _POSIX_C_SOURCE 199309L
#include <dlfcn.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fmi2Functions.h"
#include "fmi3Functions.h"

enum { N = 3, SAMPLES = 1024 }; /* channels; inputs that are repeated */

static double x[SAMPLES][N], g[SAMPLES][N], f_theta[SAMPLES][N];
static double dA[2][2], equilibrium[2], C[2], h;

typedef struct {
  double w[N][2], x[N], g[N], f_theta[N];
} loop;

/* In a function that is not inlined: the host of an FMU calls one, too. */
__attribute__((noinline)) static void loop_step(loop *self, const double *x_now, const double *g_now,
                                                const double *f_theta_now, double *f_hat) {
  for (int i = 0; i < N; i++) {
    const double u = (x_now[i] - self->x[i]) / h - self->g[i] - 0.5 * (self->f_theta[i] + f_theta_now[i]);
    const double d0 = self->w[i][0] - equilibrium[0] * u, d1 = self->w[i][1] - equilibrium[1] * u;
    self->w[i][0] += dA[0][0] * d0 + dA[0][1] * d1;
    self->w[i][1] += dA[1][0] * d0 + dA[1][1] * d1;
    f_hat[i] = f_theta_now[i] + C[0] * self->w[i][0] + C[1] * self->w[i][1];
    self->x[i] = x_now[i];
    self->g[i] = g_now[i];
    self->f_theta[i] = f_theta_now[i];
  }
}

static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void *symbol(void *library, const char *name) {
  void *const found = dlsym(library, name);
  if (!found) {
    fprintf(stderr, "%s is missing\n", name);
    exit(1);
  }
  return found;
}

static void check(int status) {
  if (status == 0) return;
  fprintf(stderr, "a call was refused\n");
  exit(1);
}

static void log2_to_stderr(void *environment, const char *name, fmi2Status status, const char *category,
                           const char *text, ...) {
  (void)environment;
  (void)name;
  (void)status;
  fprintf(stderr, "%s: %s\n", category, text);
}

static void log3_to_stderr(void *environment, fmi3Status status, const char *category, const char *text) {
  (void)environment;
  (void)status;
  fprintf(stderr, "%s: %s\n", category, text);
}

/* One run of so many steps; the last f_hat and the sum of all that came before, so that none can be left out. */
static double run2(void *library, const char *token, const unsigned *refs, long steps, double *sum) {
  static const fmi2CallbackFunctions callbacks = {log2_to_stderr, calloc, free, NULL, NULL};
  fmi2InstantiateTYPE *const instantiate = (fmi2InstantiateTYPE *)symbol(library, "fmi2Instantiate");
  fmi2SetRealTYPE *const set = (fmi2SetRealTYPE *)symbol(library, "fmi2SetReal");
  fmi2GetRealTYPE *const get = (fmi2GetRealTYPE *)symbol(library, "fmi2GetReal");
  fmi2DoStepTYPE *const step = (fmi2DoStepTYPE *)symbol(library, "fmi2DoStep");
  fmi2Component it = instantiate("bench", fmi2CoSimulation, token, NULL, &callbacks, 0, 0);
  unsigned in[3 * N], out[N];
  double values[3 * N], f_hat[N];
  if (!it) check(1);
  for (unsigned i = 0; i < N; i++) {
    for (unsigned k = 0; k < 3; k++) in[k * N + i] = refs[k] + i;
    out[i] = refs[3] + i;
  }
  check(((fmi2EnterInitializationModeTYPE *)symbol(library, "fmi2EnterInitializationMode"))(it));
  check(((fmi2ExitInitializationModeTYPE *)symbol(library, "fmi2ExitInitializationMode"))(it));
  const double begin = now();
  for (long k = 0; k < steps; k++) {
    memcpy(values, x[k % SAMPLES], sizeof x[0]);
    memcpy(values + N, g[k % SAMPLES], sizeof g[0]);
    memcpy(values + 2 * N, f_theta[k % SAMPLES], sizeof f_theta[0]);
    if (set(it, in, 3 * N, values) || step(it, (double)k * h, h, 1) || get(it, out, N, f_hat)) check(1);
    for (int i = 0; i < N; i++) *sum += f_hat[i];
  }
  const double elapsed = now() - begin;
  ((fmi2FreeInstanceTYPE *)symbol(library, "fmi2FreeInstance"))(it);
  return elapsed;
}

static double run3(void *library, const char *token, const unsigned *refs, long steps, double *sum) {
  fmi3InstantiateCoSimulationTYPE *const instantiate =
      (fmi3InstantiateCoSimulationTYPE *)symbol(library, "fmi3InstantiateCoSimulation");
  fmi3SetFloat64TYPE *const set = (fmi3SetFloat64TYPE *)symbol(library, "fmi3SetFloat64");
  fmi3GetFloat64TYPE *const get = (fmi3GetFloat64TYPE *)symbol(library, "fmi3GetFloat64");
  fmi3DoStepTYPE *const step = (fmi3DoStepTYPE *)symbol(library, "fmi3DoStep");
  fmi3Instance it = instantiate("bench", token, NULL, 0, 0, 0, 0, NULL, 0, NULL, log3_to_stderr, NULL);
  double values[3 * N], f_hat[N], reached;
  fmi3Boolean event, terminate, early;
  if (!it) check(1);
  check(((fmi3EnterInitializationModeTYPE *)symbol(library, "fmi3EnterInitializationMode"))(it, 0, 0, 0, 0, 0));
  check(((fmi3ExitInitializationModeTYPE *)symbol(library, "fmi3ExitInitializationMode"))(it));
  const double begin = now();
  for (long k = 0; k < steps; k++) {
    memcpy(values, x[k % SAMPLES], sizeof x[0]);
    memcpy(values + N, g[k % SAMPLES], sizeof g[0]);
    memcpy(values + 2 * N, f_theta[k % SAMPLES], sizeof f_theta[0]);
    if (set(it, refs, 3, values, 3 * N) || step(it, (double)k * h, h, 1, &event, &terminate, &early, &reached) ||
        get(it, refs + 3, 1, f_hat, N))
      check(1);
    for (int i = 0; i < N; i++) *sum += f_hat[i];
  }
  const double elapsed = now() - begin;
  ((fmi3FreeInstanceTYPE *)symbol(library, "fmi3FreeInstance"))(it);
  return elapsed;
}

static double run_loop(long steps, double *sum) {
  loop self = {0};
  double f_hat[N];
  const double begin = now();
  for (long k = 0; k < steps; k++) {
    loop_step(&self, x[k % SAMPLES], g[k % SAMPLES], f_theta[k % SAMPLES], f_hat);
    for (int i = 0; i < N; i++) *sum += f_hat[i];
  }
  return now() - begin;
}

int main(void) {
  char version[8], path[4096], token[128];
  unsigned refs[4];
  long steps, repetitions;
  double fmu = 1e9, plain = 1e9, difference = 0;
  if (scanf("%7s %4095s %127s %ld %ld", version, path, token, &steps, &repetitions) != 5) return 1;
  for (int i = 0; i < 4; i++)
    if (scanf("%u", refs + i) != 1) return 1;
  for (int i = 0; i < 9; i++) {
    double *const numbers[] = {&dA[0][0], &dA[0][1], &dA[1][0], &dA[1][1], equilibrium, equilibrium + 1, C, C + 1, &h};
    if (scanf("%lf", numbers[i]) != 1) return 1;
  }
  for (int k = 1; k < SAMPLES; k++) /* from 0: the first sample of the FMU is at its start values */
    for (int i = 0; i < N; i++) {
      x[k][i] = 0.1 * sin(0.006135923151542565 * k * (i + 1)); /* 2 pi / 1024: repeats without a jump */
      g[k][i] = cos(0.006135923151542565 * k) - 1.0;
      f_theta[k][i] = sin(0.006135923151542565 * k);
    }
  void *const library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
  if (!library) {
    fprintf(stderr, "%s\n", dlerror());
    return 1;
  }
  for (long r = 0; r < repetitions; r++) {
    double of_fmu = 0, of_loop = 0;
    const double a = (version[0] == '2' ? run2 : run3)(library, token, refs, steps, &of_fmu);
    const double b = run_loop(steps, &of_loop);
    if (a < fmu) fmu = a;
    if (b < plain) plain = b;
    if (fabs(of_fmu - of_loop) > difference) difference = fabs(of_fmu - of_loop);
  }
  printf("%.17g %.17g %.17g\n", 1e9 * fmu / (double)steps, 1e9 * plain / (double)steps, difference / (double)steps);
  return 0;
}
