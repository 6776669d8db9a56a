/* A continuous PhyFilter as a pf_model, once for all filters.
 *
 *   #define wing_N_X 3             channels                     #define wing_COEFFICIENTS 2   sum of the orders
 *   #define wing_ORDER 2           largest order                #define wing_INERTIA 0        0 I, 2 diagonal, 3 full
 *   #define wing_FILTERS 1         1 shared, or N_X             #define wing_TUNABLE 1        a, b are parameters
 *   #define wing_MODEL_NAME "wing"
 *   #define PF_NAME wing
 *   #include "pf_filter_continuous.h"
 *
 * declares wing_numbers, of which there must be a `static const wing_numbers wing_parameters`, and defines
 * `const pf_model wing_model` (PF_FILTER_MODEL set, the second time).
 *
 *   z' = A w + A equilibrium (g + f_theta),   f_hat = f_theta + C w,   w = z - A equilibrium M (x - x(0))
 *
 * so that x is never differentiated, and z = 0 is rest: f_hat starts at f_theta, whatever x(0). u: x, g, f_theta; y:
 * f_hat; p: a of all filters, then b. b[0] of a low-pass filter follows a[0] unless b is set with it.
 */
#ifndef PF_FILTER_CONTINUOUS_COMMON
#define PF_FILTER_CONTINUOUS_COMMON
#include <stdint.h>
#include <string.h>

#include "pf_model.h"
#include "pf_tune.h"
#define PF_CAT_(a, b) a##_##b
#define PF_CAT(a, b) PF_CAT_(a, b)
#define PF_P(member) PF_CAT(PF_NAME, member)
#endif

#define PF_N_X PF_P(N_X)
#define PF_N PF_P(ORDER)
#define PF_BANKS PF_P(FILTERS)

#ifndef PF_FILTER_MODEL
typedef struct {
  int order[PF_BANKS];
  double a[PF_BANKS][PF_N], b[PF_BANKS][PF_N]; /* ascending */
  double poles[PF_BANKS][PF_N][2];
#if PF_P(INERTIA) == 2
  double inertia[PF_N_X];
#elif PF_P(INERTIA) == 3
  double inertia[PF_N_X * PF_N_X];
#endif
} PF_P(numbers);

#else

#define PF_N_A PF_P(COEFFICIENTS)
#define PF_N_U (3 * PF_N_X)
#define PF_N_P (PF_P(TUNABLE) * 2 * PF_N_A)
#define PF_N_Z (PF_BANKS == 1 ? PF_N_X * PF_N : PF_N_A)
#define PF_BANK(i) (PF_BANKS == 1 ? 0 : (i))

typedef struct { /* one filter's section chain, in force */
  double a[PF_N], b[PF_N], poles[PF_N][2], equilibrium[PF_N];
  pf_real A[PF_N * PF_N], B[PF_N], C[PF_N]; /* B = -A equilibrium */
} PF_P(chain);

typedef struct {
  pf_real x[PF_N_X * PF_N], u[PF_N_U], p[PF_N_P + 1], p_used[PF_N_P + 1];
  pf_real origin[PF_N_X]; /* M x at the start */
  int32_t started;
  PF_P(chain) chains[PF_BANKS];
} PF_P(model_instance);

static int PF_P(order_of)(int i) { return PF_P(parameters).order[PF_BANK(i)]; }

static void PF_P(build)(PF_P(chain) *chain, int n, const double *a, const double *b, const double *poles) {
  double A[PF_N * PF_N], C[PF_N];
  memcpy(chain->a, a, sizeof(double) * (size_t)n);
  memcpy(chain->b, b, sizeof(double) * (size_t)n);
  memcpy(chain->poles, poles, sizeof(double) * 2 * (size_t)n);
  pf_chain(n, poles, A, chain->equilibrium);
  pf_chain_output(n, poles, a, b, C);
  for (int j = 0; j < n; j++) {
    double B = 0.0;
    for (int k = 0; k < n; k++) {
      chain->A[j * n + k] = (pf_real)A[j * n + k];
      B -= A[j * n + k] * chain->equilibrium[k];
    }
    chain->B[j] = (pf_real)(j == 0 ? B : 0.0); /* the others are 0 but for rounding */
    chain->C[j] = (pf_real)C[j];
  }
}

/* M x, channel by channel */
static void PF_P(momentum)(const pf_real *x, pf_real *v) {
  for (int i = 0; i < PF_N_X; i++) {
#if PF_P(INERTIA) == 0
    v[i] = x[i];
#elif PF_P(INERTIA) == 2
    v[i] = (pf_real)PF_P(parameters).inertia[i] * x[i];
#else
    v[i] = (pf_real)0;
    for (int j = 0; j < PF_N_X; j++) v[i] += (pf_real)PF_P(parameters).inertia[i * PF_N_X + j] * x[j];
#endif
  }
}

/* M (x - x(0)); 0 before the start, which makes any x the first one. */
static void PF_P(moved)(const PF_P(model_instance) *self, pf_real *v) {
  PF_P(momentum)(self->u, v);
  for (int i = 0; i < PF_N_X; i++) v[i] = self->started ? v[i] - self->origin[i] : (pf_real)0;
}

/* z' and f_hat for z, M (x - x(0)), g and f_theta; linear in them. */
static void PF_P(flow)(const PF_P(model_instance) *self, const pf_real *z, const pf_real *v, const pf_real *u,
                       pf_real *dz, pf_real *f_hat) {
  const pf_real *const g = u + PF_N_X, *const f_theta = g + PF_N_X;
  pf_real w[PF_N];
  for (int i = 0, first = 0; i < PF_N_X; i++) {
    const PF_P(chain) *const chain = &self->chains[PF_BANK(i)];
    const int n = PF_P(order_of)(i);
    pf_real y = f_theta[i];
    for (int j = 0; j < n; j++) {
      w[j] = z[first + j] + chain->B[j] * v[i];
      y += chain->C[j] * w[j];
    }
    if (f_hat) f_hat[i] = y;
    for (int j = 0; dz && j < n; j++) {
      pf_real sum = -chain->B[j] * (g[i] + f_theta[i]);
      for (int k = 0; k < n; k++) sum += chain->A[j * n + k] * w[k];
      dz[first + j] = sum;
    }
    first += n;
  }
}

static int PF_P(model_init)(void *instance) {
  PF_P(model_instance) *const self = (PF_P(model_instance) *)instance;
  memset(self, 0, sizeof *self);
  for (int i = 0; i < PF_BANKS; i++)
    PF_P(build)(&self->chains[i], PF_P(parameters).order[i], PF_P(parameters).a[i], PF_P(parameters).b[i],
                &PF_P(parameters).poles[i][0][0]);
#if PF_N_P
  pf_real *p = self->p;
  for (int i = 0; i < PF_BANKS; i++)
    for (int j = 0; j < PF_P(parameters).order[i]; j++) *p++ = (pf_real)PF_P(parameters).a[i][j];
  for (int i = 0; i < PF_BANKS; i++)
    for (int j = 0; j < PF_P(parameters).order[i]; j++) *p++ = (pf_real)PF_P(parameters).b[i][j];
  memcpy(self->p_used, self->p, sizeof self->p);
#endif
  return pf_ieee_holds_() ? PF_OK : PF_UNUSABLE;
}

static pf_real *PF_P(model_x)(void *self) { return ((PF_P(model_instance) *)self)->x; }

static pf_real *PF_P(model_u)(void *self) { return ((PF_P(model_instance) *)self)->u; }

static pf_real *PF_P(model_p)(void *self) { return ((PF_P(model_instance) *)self)->p; }

static void PF_P(model_s)(const void *self, pf_real *s) {
  (void)self;
  (void)s;
}

#if PF_N_P
/* The states as states of the new chains: f_hat does not jump, and rest stays rest, as in a sampled filter. */
static void PF_P(exchange)(PF_P(model_instance) *self, const PF_P(chain) *chains) {
  pf_real v[PF_N_X];
  PF_P(moved)(self, v);
  for (int i = 0, first = 0; i < PF_N_X; i++) {
    const PF_P(chain) *const old = &self->chains[PF_BANK(i)], *const next = &chains[PF_BANK(i)];
    const int n = PF_P(order_of)(i);
    double w[PF_N], old_C[PF_N], C[PF_N];
    const double moved = (double)v[i];
    for (int j = 0; j < n; j++) {
      w[j] = (double)self->x[first + j] + (double)old->B[j] * moved;
      old_C[j] = (double)old->C[j];
      C[j] = (double)next->C[j];
    }
    pf_move_state(n, &old->poles[0][0], old->equilibrium, old_C, &next->poles[0][0], next->equilibrium, C, w);
    for (int j = 0; j < n; j++) self->x[first + j] = (pf_real)(w[j] - (double)next->B[j] * moved);
    first += n;
  }
  memcpy(self->chains, chains, sizeof self->chains);
}
#endif

static const char *PF_P(model_apply)(void *instance) {
#if PF_N_P
  PF_P(model_instance) *const self = (PF_P(model_instance) *)instance;
  pf_real *const set_a = self->p, *const set_b = set_a + PF_N_A;
  const pf_real *const used_a = self->p_used, *const used_b = used_a + PF_N_A;
  PF_P(chain) chains[PF_BANKS];
  const char *refusal = NULL;
  if (!memcmp(self->p, self->p_used, sizeof self->p)) return NULL;
  for (int i = 0, k = 0; !refusal && i < PF_BANKS; i++) {
    const int n = PF_P(parameters).order[i];
    double a[PF_N], b[PF_N], poles[2 * PF_N];
    int follows = used_b[k] == used_a[k] && !memcmp(set_b + k, used_b + k, sizeof(pf_real) * (size_t)n);
    for (int j = 1; j < n; j++) follows &= used_b[k + j] == (pf_real)0;
    if (follows) set_b[k] = set_a[k];
    for (int j = 0; j < n; j++, k++) {
      a[j] = (double)set_a[k];
      b[j] = (double)set_b[k];
      if (!(a[j] - a[j] == 0.0) || !(b[j] - b[j] == 0.0)) refusal = "a coefficient is not finite";
    }
    if (refusal) break;
    if (!memcmp(a, self->chains[i].a, sizeof(double) * (size_t)n)) /* only b is new */
      memcpy(poles, self->chains[i].poles, sizeof(double) * 2 * (size_t)n);
    else if (!memcmp(a, PF_P(parameters).a[i], sizeof(double) * (size_t)n)) /* known exactly */
      memcpy(poles, PF_P(parameters).poles[i], sizeof(double) * 2 * (size_t)n);
    else if (!pf_hurwitz(n, a) || !pf_roots(n, a, poles))
      refusal = "D is not Hurwitz: a pole on or right of the imaginary axis";
    if (!refusal) PF_P(build)(&chains[i], n, a, b, poles);
  }
  if (refusal) {
    memcpy(self->p, self->p_used, sizeof self->p);
    return refusal;
  }
  PF_P(exchange)(self, chains);
  memcpy(self->p_used, self->p, sizeof self->p);
#else
  (void)instance;
#endif
  return NULL;
}

static int PF_P(model_start)(void *instance, pf_time t) {
  PF_P(model_instance) *const self = (PF_P(model_instance) *)instance;
  (void)t;
  PF_P(momentum)(self->u, self->origin);
  self->started = 1;
  return PF_OK;
}

static int PF_P(finite)(const pf_real *values, int count) {
  for (int i = 0; i < count; i++)
    if (!(values[i] - values[i] == (pf_real)0)) return 0;
  return 1;
}

static int PF_P(model_derivatives)(void *instance, pf_time t, const pf_real *x, pf_real *dx) {
  const PF_P(model_instance) *const self = (const PF_P(model_instance) *)instance;
  (void)t;
  pf_real v[PF_N_X];
  PF_P(moved)(self, v);
  PF_P(flow)(self, x, v, self->u, dx, NULL);
  return PF_P(finite)(dx, PF_N_Z) ? PF_OK : PF_NOT_FINITE;
}

static int PF_P(model_outputs)(void *instance, pf_time t, const pf_real *x, pf_real *y) {
  const PF_P(model_instance) *const self = (const PF_P(model_instance) *)instance;
  (void)t;
  pf_real v[PF_N_X];
  PF_P(moved)(self, v);
  PF_P(flow)(self, x, v, self->u, NULL, y);
  return PF_P(finite)(y, PF_N_X) ? PF_OK : PF_NOT_FINITE;
}

static pf_time PF_P(model_next)(const void *self) {
  (void)self;
  return PF_NEVER;
}

static int PF_P(model_sample)(void *self, pf_time t, const pf_real *x) {
  (void)self;
  (void)t;
  (void)x;
  return PF_OK;
}

static int PF_P(model_update)(void *self, pf_time t, pf_time elapsed) {
  (void)self;
  (void)t;
  (void)elapsed;
  return PF_OK;
}

static int PF_P(model_directional)(void *self, pf_time t, const pf_real *seed_x, const pf_real *seed_u,
                                   const pf_real *seed_p, pf_real *dx, pf_real *y) {
  (void)t;
  (void)seed_p;
  pf_real v[PF_N_X];
  PF_P(momentum)(seed_u, v);
  PF_P(flow)((const PF_P(model_instance) *)self, seed_x, v, seed_u, dx, y);
  return PF_OK;
}

static int PF_P(model_adjoint)(void *instance, pf_time t, const pf_real *seed_dx, const pf_real *seed_y, pf_real *x,
                               pf_real *u, pf_real *p) {
  const PF_P(model_instance) *const self = (const PF_P(model_instance) *)instance;
  pf_real moved[PF_N_X];
  (void)t;
  for (int i = 0, first = 0; i < PF_N_X; i++) {
    const PF_P(chain) *const chain = &self->chains[PF_BANK(i)];
    const int n = PF_P(order_of)(i);
    pf_real driven = (pf_real)0;
    moved[i] = (pf_real)0;
    for (int j = 0; j < n; j++) {
      pf_real sum = chain->C[j] * seed_y[i];
      for (int k = 0; k < n; k++) sum += chain->A[k * n + j] * seed_dx[first + k];
      x[first + j] = sum;
      moved[i] += chain->B[j] * sum;
      driven -= chain->B[j] * seed_dx[first + j];
    }
    u[PF_N_X + i] = driven;
    u[2 * PF_N_X + i] = driven + seed_y[i];
    first += n;
  }
  for (int i = 0; i < PF_N_X; i++) {
#if PF_P(INERTIA) == 0
    u[i] = moved[i];
#elif PF_P(INERTIA) == 2
    u[i] = (pf_real)PF_P(parameters).inertia[i] * moved[i];
#else
    u[i] = (pf_real)0;
    for (int j = 0; j < PF_N_X; j++) u[i] += (pf_real)PF_P(parameters).inertia[j * PF_N_X + i] * moved[j];
#endif
  }
  for (int i = 0; i < PF_N_P; i++) p[i] = (pf_real)0;
  return PF_OK;
}

extern const pf_model PF_P(model);
const pf_model PF_P(model) = {
  .name = PF_P(MODEL_NAME),
  .size = sizeof(PF_P(model_instance)),
  .n_x = PF_N_Z,
  .n_u = PF_N_U,
  .n_y = PF_N_X,
  .n_p = PF_N_P,
  .n_s = 0,
  .n_tasks = 0,
  .communication = 0,
  .init = PF_P(model_init),
  .x = PF_P(model_x),
  .u = PF_P(model_u),
  .p = PF_P(model_p),
  .s = PF_P(model_s),
  .apply = PF_P(model_apply),
  .start = PF_P(model_start),
  .derivatives = PF_P(model_derivatives),
  .outputs = PF_P(model_outputs),
  .next = PF_P(model_next),
  .sample = PF_P(model_sample),
  .update = PF_P(model_update),
  .directional = PF_P(model_directional),
  .adjoint = PF_P(model_adjoint),
};

#undef PF_BANK
#undef PF_N_Z
#undef PF_N_P
#undef PF_N_U
#undef PF_N_A
#undef PF_FILTER_MODEL
#endif

#undef PF_BANKS
#undef PF_N
#undef PF_N_X
#undef PF_NAME
