/* A sampled PhyFilter as a pf_model, once for all filters. After the filter's own header:
 *
 *   #define wing_COMMUNICATION 1     1: one sample per communication step, over the time elapsed; 0: every dt seconds
 *   #define wing_COEFFICIENTS 2      sum of the orders
 *   #define PF_NAME wing
 *   #include "pf_filter_model.h"
 *
 * defines `const pf_model wing_model`. u: x, g, f_theta, the inertia if it is an input; y: f_hat; p, where TUNABLE: a of
 * all filters, b of all, limit, g_low, g_high; s: w of the sections. A held g is the g that acts from this sample on: it
 * is kept for the next one, and f_hat does not depend on g without delay. b[0] of a low-pass filter (b = a[0], 0, ...)
 * follows a[0] unless b is set with it.
 */
#include <string.h>

#include "pf_model.h"

#define PF_N_X PF_P(N_X)
#define PF_N_F PF_P(N_F)
#define PF_N PF_P(ORDER)
#define PF_BANKS PF_P(FILTERS)
#define PF_N_A PF_P(COEFFICIENTS)
#define PF_T PF_P(real)
#if !PF_P(INERTIA_INPUT)
#define PF_N_M 0
#elif PF_P(INERTIA) == 1
#define PF_N_M 1
#elif PF_P(INERTIA) == 2
#define PF_N_M PF_N_X
#else
#define PF_N_M (PF_N_X * PF_N_X)
#endif
#define PF_N_U (2 * PF_N_X + PF_N_F + PF_N_M)
#define PF_N_P (PF_P(TUNABLE) * (2 * PF_N_A + PF_P(LIMIT) * PF_N_F + PF_P(G_LIMIT) * 2 * PF_N_X))

typedef struct {
  PF_NAME filter;
  pf_real x[1], u[PF_N_U], y[PF_N_F], p[PF_N_P + 1], p_used[PF_N_P + 1];
  pf_time begun; /* PF_NEVER before the run */
  pf_time ticks;
} PF_P(model_instance);

static int PF_P(model_status)(int code) {
  if (code == PF_FILTER_OK) return PF_OK;
  if (code == PF_FILTER_INVALID) return PF_UNUSABLE;
  return code == PF_FILTER_STEP ? PF_STEP_TOO_SMALL : PF_NOT_FINITE;
}

static int PF_P(model_init)(void *instance) {
  PF_P(model_instance) *const self = (PF_P(model_instance) *)instance;
  memset(self, 0, sizeof *self);
  if (PF_P(init)(&self->filter, &PF_P(parameters))) return PF_UNUSABLE;
  self->begun = PF_NEVER;
#if PF_N_M
  for (int i = 0; i < PF_N_M; i++) /* I */
    self->u[2 * PF_N_X + PF_N_F + i] = (pf_real)(PF_P(INERTIA) < 3 || i % (PF_N_X + 1) == 0);
#endif
#if PF_N_P
  pf_real *p = self->p;
  for (int i = 0; i < PF_BANKS; i++)
    for (uint32_t j = 0; j < PF_P(parameters).order[i]; j++) *p++ = (pf_real)PF_P(parameters).a[i][j];
  for (int i = 0; i < PF_BANKS; i++)
    for (uint32_t j = 0; j < PF_P(parameters).order[i]; j++) *p++ = (pf_real)PF_P(parameters).b[i][j];
#if PF_P(LIMIT)
  for (int i = 0; i < PF_N_F; i++) *p++ = (pf_real)PF_P(parameters).limit[i];
#endif
#if PF_P(G_LIMIT)
  for (int i = 0; i < PF_N_X; i++) *p++ = (pf_real)PF_P(parameters).g_low[i];
  for (int i = 0; i < PF_N_X; i++) *p++ = (pf_real)PF_P(parameters).g_high[i];
#endif
  memcpy(self->p_used, self->p, sizeof self->p);
#endif
  return PF_OK;
}

static pf_real *PF_P(model_x)(void *self) { return ((PF_P(model_instance) *)self)->x; }

static pf_real *PF_P(model_u)(void *self) { return ((PF_P(model_instance) *)self)->u; }

static pf_real *PF_P(model_p)(void *self) { return ((PF_P(model_instance) *)self)->p; }

static void PF_P(model_s)(const void *instance, pf_real *s) {
  const PF_NAME *const filter = &((const PF_P(model_instance) *)instance)->filter;
  for (int i = 0; i < PF_N_F; i++)
    for (uint32_t j = 0; j < PF_P(parameters).order[PF_BANKS == 1 ? 0 : i]; j++) *s++ = (pf_real)filter->w[i][j];
}

static const char *PF_P(model_apply)(void *instance) {
#if PF_N_P
  PF_P(model_instance) *const self = (PF_P(model_instance) *)instance;
  PF_NAME trial = self->filter;
  pf_real *const set_a = self->p, *const set_b = set_a + PF_N_A;
  const pf_real *const used_a = self->p_used, *const used_b = used_a + PF_N_A;
  double a[PF_BANKS][PF_N], b[PF_BANKS][PF_N];
  int code = PF_FILTER_OK;
  if (!memcmp(self->p, self->p_used, sizeof self->p)) return NULL;
  memset(a, 0, sizeof a);
  memset(b, 0, sizeof b);
  for (int i = 0, k = 0; i < PF_BANKS; i++) {
    const int n = (int)PF_P(parameters).order[i];
    int follows = used_b[k] == used_a[k] && !memcmp(set_b + k, used_b + k, sizeof(pf_real) * (size_t)n);
    for (int j = 1; j < n; j++) follows &= used_b[k + j] == (pf_real)0;
    if (follows) set_b[k] = set_a[k];
    for (int j = 0; j < n; j++, k++) {
      a[i][j] = (double)set_a[k];
      b[i][j] = (double)set_b[k];
    }
  }
  if (memcmp(self->p, self->p_used, sizeof(pf_real) * 2 * PF_N_A)) code = PF_P(retune)(&trial, a[0], b[0]);
#if PF_P(LIMIT)
  PF_T limit[PF_N_F];
  for (int i = 0; i < PF_N_F; i++) limit[i] = (PF_T)self->p[2 * PF_N_A + i];
  if (code == PF_FILTER_OK) code = PF_P(set_limit)(&trial, limit);
#endif
#if PF_P(G_LIMIT)
  PF_T ends[2][PF_N_X];
  for (int i = 0; i < 2 * PF_N_X; i++)
    ends[i / PF_N_X][i % PF_N_X] = (PF_T)self->p[2 * PF_N_A + PF_P(LIMIT) * PF_N_F + i];
  if (code == PF_FILTER_OK) code = PF_P(set_g_limit)(&trial, ends[0], ends[1]);
#endif
  if (code != PF_FILTER_OK) {
    memcpy(self->p, self->p_used, sizeof self->p);
    return pf_filter_message(code);
  }
  self->filter = trial;
  memcpy(self->p_used, self->p, sizeof self->p);
#else
  (void)instance;
#endif
  return NULL;
}

static int PF_P(model_take)(PF_P(model_instance) *self, pf_time elapsed) {
  PF_T u[PF_N_U], f_hat[PF_N_F];
  const PF_T *const g = u + PF_N_X, *const f_theta = g + PF_N_X;
  const PF_T *const inertia = PF_N_M ? f_theta + PF_N_F : NULL;
  for (int i = 0; i < PF_N_U; i++) u[i] = (PF_T)self->u[i];
#if PF_P(COMMUNICATION)
  const int code = PF_P(output_after)(&self->filter, u, g, f_theta, inertia, elapsed, f_hat);
#else
  const int code = PF_P(output)(&self->filter, u, g, f_theta, inertia, f_hat);
  (void)elapsed;
#endif
  if (code != PF_FILTER_OK) return PF_P(model_status)(code);
  PF_P(remember)(&self->filter, g);
  for (int i = 0; i < PF_N_F; i++) self->y[i] = (pf_real)f_hat[i];
  return PF_OK;
}

static int PF_P(model_start)(void *instance, pf_time t) {
  PF_P(model_instance) *const self = (PF_P(model_instance) *)instance;
  PF_P(reset)(&self->filter);
  const int status = PF_P(model_take)(self, (pf_time)PF_P(parameters).dt);
  if (status != PF_OK) return status;
  self->begun = t;
  self->ticks = 1;
  return PF_OK;
}

static int PF_P(model_derivatives)(void *self, pf_time t, const pf_real *x, pf_real *dx) {
  (void)self;
  (void)t;
  (void)x;
  (void)dx;
  return PF_OK;
}

static int PF_P(model_outputs)(void *instance, pf_time t, const pf_real *x, pf_real *y) {
  const PF_P(model_instance) *const self = (const PF_P(model_instance) *)instance;
  (void)t;
  (void)x;
  if (self->begun < PF_NEVER) {
    for (int i = 0; i < PF_N_F; i++) y[i] = self->y[i];
    return PF_OK;
  }
  for (int i = 0; i < PF_N_F; i++) { /* what the first sample will give */
    y[i] = (pf_real)(PF_T)self->u[2 * PF_N_X + i];
#if PF_P(LIMIT)
    const pf_real limit = (pf_real)self->filter.limit[i];
    y[i] = y[i] > limit ? limit : (y[i] < -limit ? -limit : y[i]);
#endif
  }
  return PF_OK;
}

static pf_time PF_P(model_next)(const void *instance) {
#if PF_P(COMMUNICATION)
  (void)instance;
  return PF_NEVER;
#else
  const PF_P(model_instance) *const self = (const PF_P(model_instance) *)instance;
  return self->begun < PF_NEVER ? self->begun + self->ticks * (pf_time)PF_P(parameters).dt : PF_NEVER;
#endif
}

static int PF_P(model_sample)(void *instance, pf_time t, const pf_real *x) {
#if PF_P(COMMUNICATION)
  (void)instance;
  (void)t;
  (void)x;
  return PF_OK;
#else
  PF_P(model_instance) *const self = (PF_P(model_instance) *)instance;
  (void)x;
  if (!(PF_P(model_next)(self) <= t)) return PF_OK;
  const int status = PF_P(model_take)(self, 0.0);
  if (status == PF_OK) self->ticks += 1.0;
  return status;
#endif
}

static int PF_P(model_update)(void *instance, pf_time t, pf_time elapsed) {
#if PF_P(COMMUNICATION)
  (void)t;
  return PF_P(model_take)((PF_P(model_instance) *)instance, elapsed);
#else
  (void)instance;
  (void)t;
  (void)elapsed;
  return PF_OK;
#endif
}

/* f_hat is held between samples: it counts as constant. */
static int PF_P(model_directional)(void *self, pf_time t, const pf_real *seed_x, const pf_real *seed_u,
                                   const pf_real *seed_p, pf_real *dx, pf_real *y) {
  (void)self;
  (void)t;
  (void)seed_x;
  (void)seed_u;
  (void)seed_p;
  (void)dx;
  for (int i = 0; i < PF_N_F; i++) y[i] = (pf_real)0;
  return PF_OK;
}

static int PF_P(model_adjoint)(void *self, pf_time t, const pf_real *seed_dx, const pf_real *seed_y, pf_real *x,
                               pf_real *u, pf_real *p) {
  (void)self;
  (void)t;
  (void)seed_dx;
  (void)seed_y;
  (void)x;
  for (int i = 0; i < PF_N_U; i++) u[i] = (pf_real)0;
  for (int i = 0; i < PF_N_P; i++) p[i] = (pf_real)0;
  return PF_OK;
}

extern const pf_model PF_P(model);
const pf_model PF_P(model) = {
  .name = PF_P(MODEL_NAME),
  .size = sizeof(PF_P(model_instance)),
  .n_x = 0,
  .n_u = PF_N_U,
  .n_y = PF_N_F,
  .n_p = PF_N_P,
  .n_s = PF_BANKS == 1 ? PF_N_F * PF_N : PF_N_A,
  .n_tasks = !PF_P(COMMUNICATION),
  .communication = PF_P(COMMUNICATION),
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

#undef PF_N_P
#undef PF_N_U
#undef PF_N_M
#undef PF_T
#undef PF_N_A
#undef PF_BANKS
#undef PF_N
#undef PF_N_F
#undef PF_N_X
#undef PF_NAME
