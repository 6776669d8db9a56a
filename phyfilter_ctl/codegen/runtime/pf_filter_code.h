/* A sampled PhyFilter, for every set of options: the functions. pf_filter.h says what they do and how both are used.
 *
 *   u_k = M_k' (x_k - x_{k-1}) / h - mean of (g + f_theta) over the step     (M_k': mean of the inertia at both ends)
 *   w_k = w_{k-1} + dA (w_{k-1} - equilibrium u_k)
 *   f_hat_k = f_theta_k + C w_k
 */
#include "pf_ieee.h"

#include "pf_crc.h"
#include "pf_hurwitz.h"

/* Loops of few and fixed turns: without it half of the instructions would count. */
#if defined(__clang__)
#define PF_UNROLL _Pragma("unroll")
#elif defined(__GNUC__)
#define PF_UNROLL _Pragma("GCC unroll 16")
#else
#define PF_UNROLL
#endif

#if defined(__GNUC__) /* kept apart, else its registers are saved at every step */
#define PF_RARE __attribute__((noinline)) static
#else
#define PF_RARE static
#endif
#if defined(__GNUC__) && !PF_P(VARIABLE) /* one caller */
#define PF_INLINE static inline __attribute__((always_inline))
#else
#define PF_INLINE static
#endif

#define PF_N_X PF_P(N_X)
#define PF_N_F PF_P(N_F)
#define PF_N PF_P(ORDER)
#define PF_BANKS PF_P(FILTERS)
#if PF_P(INERTIA) == 2
#define PF_ENTRIES PF_N_X
#elif PF_P(INERTIA) == 3
#define PF_ENTRIES (PF_N_X * PF_N_X)
#else
#define PF_ENTRIES 1
#endif
#define PF_WIDE (PF_P(VARIABLE) || PF_P(HOLD_BAD))
#define PF_ALIGNED (PF_P(HOLD_BAD) || PF_P(PAST))
#define PF_T PF_P(real)
#define PF_BANK(i) (PF_BANKS == 1 ? 0 : (i))
/* PF_K(self)->...: the numbers in force */
#if PF_P(CONSTANT)
#define PF_K(self) (&PF_P(parameters))
#define PF_NOMINAL_RATE(self) PF_P(RATE)
#define PF_READY(self) ((self)->ready)
#define PF_NOMINAL_STEP(self) 0.0 /* nobody looks */
#else
#define PF_K(self) (self)
#define PF_NOMINAL_RATE(self) ((self)->rate)
#define PF_READY(self) ((self)->dt > 0.0)
#define PF_NOMINAL_STEP(self) ((self)->dt)
#endif
#if PF_WIDE || PF_P(TUNABLE)
#include "pf_tune.h"
#endif

static inline int PF_P(finite_)(const PF_T *values, int count) {
  for (int i = 0; i < count; i++)
    if (!(values[i] - values[i] == (PF_T)0)) return 0;
  return 1;
}

static inline void PF_P(copy_)(const PF_T *from, PF_T *to, int count) {
  PF_UNROLL for (int i = 0; i < count; i++) to[i] = from[i];
}

/* -- parameters ----------------------------------------------------------------------------------------------------- */

static uint32_t PF_P(crc_)(const PF_P(params) *p) {
#if PF_P(FLOAT)
#define PF_CRC_REAL pf_crc32_float
#else
#define PF_CRC_REAL pf_crc32_double
#endif
  uint32_t crc = pf_crc32_uint(0, p->order, PF_BANKS);
  crc = pf_crc32_double(crc, &p->dt, 1);
  crc = pf_crc32_double(crc, &p->delay, 1);
  for (int i = 0; i < PF_BANKS; i++) crc = pf_crc32_double(crc, p->a[i], PF_N);
#if PF_P(TUNABLE)
  for (int i = 0; i < PF_BANKS; i++) crc = pf_crc32_double(crc, p->b[i], PF_N);
#endif
#if PF_WIDE || PF_P(TUNABLE)
  for (int i = 0; i < PF_BANKS; i++)
    for (int j = 0; j < PF_N; j++) crc = pf_crc32_double(crc, p->poles[i][j], 2);
#endif
  for (int i = 0; i < PF_BANKS; i++)
    for (int j = 0; j < PF_N; j++) crc = PF_CRC_REAL(crc, p->dA[i][j], PF_N);
  for (int i = 0; i < PF_BANKS; i++) crc = PF_CRC_REAL(crc, p->equilibrium[i], PF_N);
  for (int i = 0; i < PF_BANKS; i++) crc = PF_CRC_REAL(crc, p->C[i], PF_N);
#if PF_P(LIMIT)
  crc = PF_CRC_REAL(crc, p->limit, PF_N_F);
#endif
#if PF_P(G_LIMIT)
  crc = PF_CRC_REAL(crc, p->g_low, PF_N_X);
  crc = PF_CRC_REAL(crc, p->g_high, PF_N_X);
#endif
#if PF_P(DIRECTION)
  for (int i = 0; i < PF_N_F; i++) crc = PF_CRC_REAL(crc, p->E_left[i], PF_N_X);
#endif
#if PF_P(INERTIA) && !PF_P(INERTIA_INPUT)
  crc = PF_CRC_REAL(crc, p->inertia, PF_ENTRIES);
#endif
#undef PF_CRC_REAL
  return crc;
}

int PF_P(init)(PF_NAME *self, const PF_P(params) *params) {
  memset(self, 0, sizeof *self); /* refused: it does not start */
  if (!pf_ieee_holds_()) return PF_FILTER_ARITHMETIC;
  if (params->version != PF_FILTER_FORMAT) return PF_FILTER_VERSION;
  if (params->crc != PF_P(crc_)(params)) return PF_FILTER_CORRUPT;
  if (!(params->dt > 0.0) || !(params->dt < 1e30)) return PF_FILTER_INVALID;
  if (!(params->delay >= 0.0) || !(params->delay < 1e30)) return PF_FILTER_INVALID;
  for (int i = 0; i < PF_BANKS; i++) {
    if (params->order[i] < 1u || params->order[i] > (uint32_t)PF_N) return PF_FILTER_INVALID;
    if (!pf_hurwitz((int)params->order[i], params->a[i])) return PF_FILTER_NOT_HURWITZ;
  }
#if PF_P(CONSTANT)
  if (params != &PF_P(parameters)) return PF_FILTER_INVALID;
  self->ready = 1;
#else
#if PF_P(LIMIT)
  if (PF_P(set_limit)(self, params->limit) != PF_FILTER_OK) return PF_FILTER_INVALID;
#endif
#if PF_P(G_LIMIT)
  if (PF_P(set_g_limit)(self, params->g_low, params->g_high) != PF_FILTER_OK) return PF_FILTER_INVALID;
#endif
  self->dt = params->dt;
  self->rate = (PF_T)(1.0 / params->dt);
  memcpy(self->dA, params->dA, sizeof self->dA);
  memcpy(self->equilibrium, params->equilibrium, sizeof self->equilibrium);
  memcpy(self->C, params->C, sizeof self->C);
#if PF_P(DIRECTION)
  memcpy(self->E_left, params->E_left, sizeof self->E_left);
#endif
#if PF_P(INERTIA) && !PF_P(INERTIA_INPUT)
  memcpy(self->inertia, params->inertia, sizeof self->inertia);
#endif
#endif
#if PF_WIDE || PF_P(TUNABLE)
  for (int i = 0; i < PF_BANKS; i++) self->order[i] = (int32_t)params->order[i];
  memcpy(self->poles, params->poles, sizeof self->poles);
#endif
#if PF_P(TUNABLE)
  memcpy(self->a, params->a, sizeof self->a);
  memcpy(self->b, params->b, sizeof self->b);
  memcpy(self->a_home, params->a, sizeof self->a_home);
  memcpy(self->poles_home, params->poles, sizeof self->poles_home);
#endif
#if PF_P(PAST)
  self->delay = params->delay;
#endif
  PF_P(reset)(self);
  return PF_FILTER_OK;
}

#if PF_P(LIMIT) && !PF_P(CONSTANT)
int PF_P(set_limit)(PF_NAME *self, const PF_T *limit) {
  for (int i = 0; i < PF_N_F; i++)
    if (!(limit[i] > (PF_T)0)) return PF_FILTER_INVALID;
  PF_P(copy_)(limit, self->limit, PF_N_F);
  return PF_FILTER_OK;
}
#endif

#if PF_P(G_LIMIT) && !PF_P(CONSTANT)
int PF_P(set_g_limit)(PF_NAME *self, const PF_T *low, const PF_T *high) {
  for (int i = 0; i < PF_N_X; i++)
    if (!(low[i] < high[i])) return PF_FILTER_INVALID;
  PF_P(copy_)(low, self->g_low, PF_N_X);
  PF_P(copy_)(high, self->g_high, PF_N_X);
  return PF_FILTER_OK;
}
#endif

#if PF_P(G_LIMIT)
/* What acts of g; a number that is not finite stays one. */
static inline void PF_P(acting_)(const PF_NAME *self, const PF_T *g, PF_T *acting) {
  (void)self;
  PF_UNROLL for (int i = 0; i < PF_N_X; i++) {
    const PF_T low = PF_K(self)->g_low[i], high = PF_K(self)->g_high[i];
    const PF_T within = g[i] < low ? low : (g[i] > high ? high : g[i]);
    acting[i] = g[i] - g[i] == (PF_T)0 ? within : g[i];
  }
}
#endif

static inline PF_T PF_P(limited_)(const PF_NAME *self, int i, PF_T f_hat) {
#if PF_P(LIMIT)
  const PF_T limit = PF_K(self)->limit[i];
  if (f_hat > limit) return limit;
  if (f_hat < -limit) return -limit;
#endif
  (void)self;
  (void)i;
  return f_hat;
}

/* -- start ---------------------------------------------------------------------------------------------------------- */

void PF_P(reset)(PF_NAME *self) {
  memset(self->w, 0, sizeof self->w);
#if PF_P(FLOAT)
  memset(self->carry, 0, sizeof self->carry);
#endif
  memset(self->x, 0, sizeof self->x);
  memset(self->g, 0, sizeof self->g);
  memset(self->f_theta, 0, sizeof self->f_theta);
#if !PF_P(G_AVERAGE)
  memset(self->g_held, 0, sizeof self->g_held);
#endif
#if PF_P(INERTIA_INPUT)
  for (int i = 0; i < PF_ENTRIES; i++) /* I, until one is given */
    self->inertia[i] = (PF_T)(PF_P(INERTIA) < 3 || i % (PF_N_X + 1) == 0);
#endif
  self->started = self->held = self->has_g = self->has_inertia = 0;
#if PF_ALIGNED
  self->gap = 0.0;
  memset(self->sum_g, 0, sizeof self->sum_g);
  memset(self->sum_f_theta, 0, sizeof self->sum_f_theta);
#if PF_P(INERTIA)
  PF_P(copy_)(self->inertia, self->inertia_then, PF_ENTRIES);
#endif
#endif
#if PF_P(PAST)
  memset(self->past, 0, sizeof self->past);
  self->count = 0;
#endif
}

/* State with output C w = y: at rest on a constant residual. */
static int PF_P(rest_)(const PF_T *equilibrium, const PF_T *C, PF_T y, PF_T *w) {
  double rest = 0.0;
  for (int j = 0; j < PF_N; j++) rest += (double)C[j] * (double)equilibrium[j];
  if (rest < 1e-9 && rest > -1e-9) return 0;
  for (int j = 0; j < PF_N; j++) w[j] = (PF_T)((double)y * (double)equilibrium[j] / rest);
  return 1;
}

int PF_P(start)(PF_NAME *self, const PF_T *x0, const PF_T *f_hat0, const PF_T *f_theta0, const PF_T *inertia0,
                const PF_T *g0) {
  PF_T w[PF_N_F][PF_N], f_theta[PF_N_F];
  int away = 0;
  memset(w, 0, sizeof w);
  if (!PF_READY(self)) return PF_FILTER_INVALID;
  for (int i = 0; i < PF_N_F; i++) f_theta[i] = f_theta0 ? f_theta0[i] : (PF_T)0;
  if (!PF_P(finite_)(x0, PF_N_X) || !PF_P(finite_)(f_theta, PF_N_F)) return PF_FILTER_NOT_FINITE;
  if (g0 && !PF_P(finite_)(g0, PF_N_X)) return PF_FILTER_NOT_FINITE;
  if (f_hat0 && !PF_P(finite_)(f_hat0, PF_N_F)) return PF_FILTER_NOT_FINITE;
#if PF_P(INERTIA_INPUT)
  if (inertia0 && !PF_P(finite_)(inertia0, PF_ENTRIES)) return PF_FILTER_NOT_FINITE;
#endif
  for (int i = 0; f_hat0 && i < PF_N_F; i++) away |= f_hat0[i] - f_theta[i] != (PF_T)0;
  for (int i = 0; away && i < PF_N_F; i++)
    if (!PF_P(rest_)(PF_K(self)->equilibrium[PF_BANK(i)], PF_K(self)->C[PF_BANK(i)], f_hat0[i] - f_theta[i],
                     w[i]))
      return PF_FILTER_NO_REST;
  PF_P(reset)(self);
  memcpy(self->w, w, sizeof w);
  PF_P(copy_)(x0, self->x, PF_N_X);
  PF_P(copy_)(f_theta, self->f_theta, PF_N_F);
  if (g0) {
#if PF_P(G_LIMIT)
    PF_T acting[PF_N_X];
    PF_P(acting_)(self, g0, acting);
    g0 = acting;
#endif
    PF_P(copy_)(g0, self->g, PF_N_X);
#if !PF_P(G_AVERAGE)
    PF_P(copy_)(g0, self->g_held, PF_N_X);
#endif
    self->has_g = 1;
  }
#if PF_P(INERTIA_INPUT)
  if (inertia0) {
    PF_P(copy_)(inertia0, self->inertia, PF_ENTRIES);
    self->has_inertia = 1;
  }
#if PF_ALIGNED
  PF_P(copy_)(self->inertia, self->inertia_then, PF_ENTRIES);
#endif
#else
  (void)inertia0;
#endif
  self->started = 1;
  return PF_FILTER_OK;
}

/* -- the measured residual ------------------------------------------------------------------------------------------ */

#if PF_P(INERTIA) == 0
#define PF_TIMES(M, v, i) ((v)[i])
#elif PF_P(INERTIA) == 1
#define PF_TIMES(M, v, i) ((M)[0] * (v)[i])
#elif PF_P(INERTIA) == 2
#define PF_TIMES(M, v, i) ((M)[i] * (v)[i])
#else
#define PF_TIMES(M, v, i) PF_P(row_)(&(M)[(i)*PF_N_X], v)
static inline PF_T PF_P(row_)(const PF_T *row, const PF_T *v) {
  PF_T sum = row[0] * v[0];
  for (int j = 1; j < PF_N_X; j++) sum += row[j] * v[j];
  return sum;
}
#endif

/* Channel by channel, u of the last step without gap or delay. */
static inline void PF_P(residual_)(const PF_NAME *self, const PF_T *x, const PF_T *g, const PF_T *f_theta,
                                   const PF_T *inertia, PF_T rate, PF_T *u) {
  PF_T dx[PF_N_X], of_x[PF_N_X];
  PF_UNROLL for (int i = 0; i < PF_N_X; i++) dx[i] = x[i] - self->x[i];
#if PF_P(INERTIA_INPUT)
  PF_T mean[PF_ENTRIES];
  PF_UNROLL for (int i = 0; i < PF_ENTRIES; i++)
    mean[i] = ((self->has_inertia ? self->inertia[i] : inertia[i]) + inertia[i]) * (PF_T)0.5;
  inertia = mean;
#endif
  (void)inertia;
  PF_UNROLL for (int i = 0; i < PF_N_X; i++) {
    of_x[i] = PF_TIMES(inertia, dx, i) * rate;
#if PF_P(G_AVERAGE)
    of_x[i] -= (g[i] + (self->has_g ? self->g[i] : g[i])) * (PF_T)0.5;
#else
    of_x[i] -= g[i];
#endif
  }
  PF_UNROLL for (int i = 0; i < PF_N_F; i++) {
#if PF_P(DIRECTION)
    u[i] = PF_K(self)->E_left[i][0] * of_x[0];
    PF_UNROLL for (int j = 1; j < PF_N_X; j++) u[i] += PF_K(self)->E_left[i][j] * of_x[j];
#else
    u[i] = of_x[i];
#endif
#if PF_P(F_THETA_AVERAGE)
    u[i] -= (f_theta[i] + self->f_theta[i]) * (PF_T)0.5;
#else
    (void)f_theta;
    u[i] -= self->f_theta[i];
#endif
  }
}

#if PF_WIDE
#define PF_GAP_ROUNDING 1.000001 /* a gap is a sum of steps */

/* Whether the last good sample is too long ago, h seconds after the last one, to make one step. */
static int PF_P(is_gap_)(const PF_NAME *self, double h) {
#if PF_P(LONG_STEPS) && !PF_ALIGNED
  return 0;
#elif PF_P(LONG_STEPS)
  if (self->gap == 0.0) return 0;
#endif
#if PF_ALIGNED
  h += self->gap;
#endif
  return h > PF_P(LONGEST) * PF_GAP_ROUNDING * self->dt;
}
#undef PF_GAP_ROUNDING

/* f_hat where there is no step: the estimate of the residual stays. */
PF_RARE void PF_P(keep_)(const PF_NAME *self, const PF_T *f_theta, PF_T *f_hat) {
  for (int i = 0; i < PF_N_F; i++) {
    PF_T y = 0;
    for (int j = 0; j < PF_N; j++) {
#if PF_P(FLOAT)
      y += (self->w[i][j] + self->carry[i][j]) * self->C[PF_BANK(i)][j];
#else
      y += self->w[i][j] * self->C[PF_BANK(i)][j];
#endif
    }
    f_hat[i] = PF_P(limited_)(self, i, f_theta[i] + y);
  }
}
#endif

#if PF_ALIGNED
#include "pf_filter_late.h"
#endif

/* -- the recursion -------------------------------------------------------------------------------------------------- */

/* Advances the sections of all channels, side by side: a coefficient is loaded once for all of them. dA is block lower
 * triangular, above the diagonal only pairs have entries. */
static inline void PF_P(advance_)(PF_NAME *self, const PF_T (*dA)[PF_N][PF_N], const PF_T *u, const PF_T *f_theta,
                                  PF_T *f_hat) {
  PF_T distance[PF_N_F][PF_N], change[PF_N_F], y[PF_N_F];
  PF_UNROLL for (int j = 0; j < PF_N; j++) {
    PF_UNROLL for (int i = 0; i < PF_N_F; i++) {
      /* The equilibrium of a real section is 1. */
      distance[i][j] = self->w[i][j] - (((unsigned)PF_P(PAIRS) >> (unsigned)j & 1u) != 0u
                                            ? u[i] * PF_K(self)->equilibrium[PF_BANK(i)][j]
                                            : u[i]);
#if PF_P(FLOAT)
      distance[i][j] += self->carry[i][j];
#endif
    }
  }
  PF_UNROLL for (int j = 0; j < PF_N; j++) {
    const int last = j + 1 < PF_N && ((unsigned)PF_P(PAIRS) >> (unsigned)j & 1u) != 0u ? j + 1 : j;
    PF_UNROLL for (int i = 0; i < PF_N_F; i++) change[i] = dA[PF_BANK(i)][j][0] * distance[i][0];
    PF_UNROLL for (int k = 1; k < PF_N; k++) {
      if (k > last) break;
      PF_UNROLL for (int i = 0; i < PF_N_F; i++) change[i] += dA[PF_BANK(i)][j][k] * distance[i][k];
    }
    PF_UNROLL for (int i = 0; i < PF_N_F; i++) {
      PF_T total;
#if PF_P(FLOAT)
      /* Two-sum: what the addition rounds away, whichever of the two is larger, waits in the carry. */
      const PF_T change_i = change[i] + self->carry[i][j], before = self->w[i][j];
      const PF_T sum = before + change_i, taken = sum - before;
      const PF_T carry = (before - (sum - taken)) + (change_i - taken);
      self->w[i][j] = sum;
      self->carry[i][j] = carry;
      total = sum + carry;
#else
      total = self->w[i][j] + change[i];
      self->w[i][j] = total;
#endif
#if PF_P(LOWPASS)
      y[i] = total;
#else
      y[i] = j == 0 ? total * PF_K(self)->C[PF_BANK(i)][0] : y[i] + total * PF_K(self)->C[PF_BANK(i)][j];
#endif
    }
  }
  PF_UNROLL for (int i = 0; i < PF_N_F; i++) f_hat[i] = PF_P(limited_)(self, i, f_theta[i] + y[i]);
}

#if PF_WIDE
/* self->dA_other becomes the transition over `dt` seconds. */
static void PF_P(prepare_)(PF_NAME *self, double dt) {
  if (self->dt_other == dt) return;
  for (int i = 0; i < PF_BANKS; i++) {
    double dA[PF_N * PF_N];
    const int n = (int)self->order[i];
    pf_transition(n, &self->poles[i][0][0], PF_P(METHOD), dt, dA);
    for (int j = 0; j < PF_N; j++)
      for (int k = 0; k < PF_N; k++) self->dA_other[i][j][k] = j < n && k < n ? (PF_T)dA[j * n + k] : (PF_T)0;
  }
  self->dt_other = dt;
}
#endif

PF_RARE int PF_P(all_finite_)(const PF_T *x, const PF_T *g, const PF_T *f_theta, const PF_T *inertia) {
#if PF_P(INERTIA_INPUT)
  if (!PF_P(finite_)(inertia, PF_ENTRIES)) return 0;
#else
  (void)inertia;
#endif
  return PF_P(finite_)(x, PF_N_X) && PF_P(finite_)(g, PF_N_X) && PF_P(finite_)(f_theta, PF_N_F);
}

/* The first sample by itself: at rest, f_hat = f_theta. */
PF_RARE int PF_P(begin_)(PF_NAME *self, const PF_T *x, const PF_T *g, const PF_T *f_theta, const PF_T *inertia,
                         PF_T *f_hat) {
  if (!PF_READY(self)) return PF_FILTER_INVALID; /* init has refused, or was not called */
#if PF_P(HOLD_BAD)
  PF_T last[PF_N_F]; /* good f_theta so far */
  for (int i = 0; i < PF_N_F; i++) last[i] = PF_P(finite_)(&f_theta[i], 1) ? f_theta[i] : self->f_theta[i];
  if (PF_P(start)(self, x, NULL, f_theta, inertia, g) != PF_FILTER_OK) {
    self->held = 1;
    PF_P(copy_)(last, self->f_theta, PF_N_F);
  }
#else
  const int code = PF_P(start)(self, x, NULL, f_theta, inertia, g);
  if (code != PF_FILTER_OK) return code;
#endif
  for (int i = 0; i < PF_N_F; i++) f_hat[i] = PF_P(limited_)(self, i, self->f_theta[i]);
  return PF_FILTER_OK;
}

#if PF_WIDE
/* A good sample after a gap: the filter goes on from it with the states that it has, without a step to it. */
PF_RARE int PF_P(resume_)(PF_NAME *self, const PF_T *f_theta, const PF_T *inertia, PF_T *f_hat) {
#if PF_ALIGNED
  memset(self->sum_g, 0, sizeof self->sum_g);
  memset(self->sum_f_theta, 0, sizeof self->sum_f_theta);
  PF_P(copy_)(inertia, self->inertia_then, PF_ENTRIES);
#else
  (void)inertia;
#endif
#if PF_P(PAST)
  self->count = 0;
#endif
  PF_P(keep_)(self, f_theta, f_hat);
  return PF_FILTER_OK;
}
#endif

/* One sample after h seconds; a nominal step needs no look at h. */
PF_INLINE int PF_P(take_)(PF_NAME *self, const PF_T *x_now, const PF_T *g, const PF_T *f_theta_now,
                          const PF_T *inertia, int nominal, double h, PF_T *f_hat) {
  /* Read once: the compiler must expect f_hat, or self, in the same memory. */
  PF_T u[PF_N_F], x[PF_N_X], f_theta[PF_N_F], watch;
  const PF_T(*dA)[PF_N][PF_N] = (const PF_T(*)[PF_N][PF_N])PF_K(self)->dA;
  PF_P(copy_)(x_now, x, PF_N_X);
  PF_P(copy_)(f_theta_now, f_theta, PF_N_F);
#if PF_P(G_LIMIT)
  PF_T acting[PF_N_X];
  PF_P(acting_)(self, g, acting);
  g = acting;
#endif
#if PF_P(INERTIA_INPUT)
  const int inertia_given = inertia != NULL;
  if (!inertia_given) inertia = self->inertia;
#elif PF_P(INERTIA)
  inertia = PF_K(self)->inertia;
#elif PF_ALIGNED
  const PF_T unity = (PF_T)1;
  inertia = &unity;
#endif
#if PF_WIDE
  const PF_T rate = nominal ? PF_NOMINAL_RATE(self) : (PF_T)(1.0 / h);
#else
  const PF_T rate = PF_NOMINAL_RATE(self);
#endif
  PF_P(residual_)(self, x, g, f_theta, inertia, rate, u);
  /* One number shows whether all are finite; where a finite sample overflows it the slow look decides. */
  watch = u[0];
  PF_UNROLL for (int i = 1; i < PF_N_F; i++) watch += u[i];
#if !PF_P(F_THETA_AVERAGE)
  PF_UNROLL for (int i = 0; i < PF_N_F; i++) watch += f_theta[i];
#endif
  if (!(watch - watch == (PF_T)0) && !PF_P(all_finite_)(x, g, f_theta, inertia)) {
#if PF_P(HOLD_BAD)
    return PF_P(hold_)(self, g, f_theta, inertia, h, f_hat);
#else
    return PF_FILTER_NOT_FINITE;
#endif
  }
#if PF_P(HOLD_BAD)
  const int gap = (!nominal || self->gap != 0.0) && PF_P(is_gap_)(self, h);
#elif PF_WIDE
  const int gap = !nominal && PF_P(is_gap_)(self, h);
#else
  const int gap = 0;
#endif
#if PF_P(PAST)
  if (!gap) h = PF_P(aligned_residual_)(self, x, g, f_theta, inertia, h, u);
  nominal = nominal && h == self->dt;
#elif PF_P(HOLD_BAD)
  if (self->gap != 0.0 && !gap) {
    h = PF_P(aligned_residual_)(self, x, g, f_theta, inertia, h, u);
    nominal = 0;
  }
#endif
#if PF_WIDE
  if (!nominal && !gap && h != self->dt) {
    PF_P(prepare_)(self, h);
    dA = (const PF_T(*)[PF_N][PF_N])self->dA_other;
  }
#else
  (void)nominal;
  (void)h;
  (void)gap;
#endif
  PF_P(copy_)(x, self->x, PF_N_X);
#if PF_P(G_AVERAGE) || PF_P(HOLD_BAD)
  PF_P(copy_)(g, self->g, PF_N_X);
  self->has_g = 1;
#endif
#if PF_P(INERTIA_INPUT)
  if (inertia_given) {
    PF_P(copy_)(inertia, self->inertia, PF_ENTRIES);
    self->has_inertia = 1;
  }
#endif
#if PF_P(HOLD_BAD)
  self->held = 0;
  self->gap = 0.0;
#endif
  PF_P(copy_)(f_theta, self->f_theta, PF_N_F);
#if PF_WIDE
  if (gap) return PF_P(resume_)(self, f_theta, inertia, f_hat);
#endif
  PF_P(advance_)(self, dA, u, f_theta, f_hat);
  return PF_FILTER_OK;
}

int PF_P(step)(PF_NAME *self, const PF_T *x, const PF_T *g, const PF_T *f_theta, const PF_T *inertia, PF_T *f_hat) {
  if (!self->started) return PF_P(begin_)(self, x, g, f_theta, inertia, f_hat);
  return PF_P(take_)(self, x, g, f_theta, inertia, 1, PF_NOMINAL_STEP(self), f_hat);
}

int PF_P(output)(PF_NAME *self, const PF_T *x, const PF_T *g, const PF_T *f_theta, const PF_T *inertia, PF_T *f_hat) {
#if !PF_P(G_AVERAGE)
  if (self->started) g = self->g_held;
#endif
  return PF_P(step)(self, x, g, f_theta, inertia, f_hat);
}

#if PF_P(VARIABLE)
int PF_P(step_after)(PF_NAME *self, const PF_T *x, const PF_T *g, const PF_T *f_theta, const PF_T *inertia, double dt,
                     PF_T *f_hat) {
  if (!self->started) return PF_P(begin_)(self, x, g, f_theta, inertia, f_hat);
  if (dt == self->dt) return PF_P(take_)(self, x, g, f_theta, inertia, 1, dt, f_hat);
  if (!(dt > 0.0) || !(dt < 1e30)) return PF_FILTER_STEP;
#if PF_P(METHOD) == 1
  for (int i = 0; i < PF_BANKS; i++)
    if (!PF_P(is_gap_)(self, dt) && pf_euler_diverges((int)self->order[i], &self->poles[i][0][0], dt))
      return PF_FILTER_STEP;
#endif
  return PF_P(take_)(self, x, g, f_theta, inertia, 0, dt, f_hat);
}

int PF_P(output_after)(PF_NAME *self, const PF_T *x, const PF_T *g, const PF_T *f_theta, const PF_T *inertia,
                       double dt, PF_T *f_hat) {
#if !PF_P(G_AVERAGE)
  if (self->started) g = self->g_held;
#endif
  return PF_P(step_after)(self, x, g, f_theta, inertia, dt, f_hat);
}
#endif

void PF_P(remember)(PF_NAME *self, const PF_T *g) {
#if PF_P(G_AVERAGE)
  (void)self;
  (void)g;
#else
  PF_P(copy_)(g, self->g_held, PF_N_X);
#endif
}

int PF_P(shift_x)(PF_NAME *self, const PF_T *dx) {
  if (!PF_P(finite_)(dx, PF_N_X)) return PF_FILTER_NOT_FINITE;
  for (int i = 0; i < PF_N_X; i++) self->x[i] += dx[i];
  return PF_FILTER_OK;
}

#if PF_P(TUNABLE)
#include "pf_filter_retune.h"
#endif

#undef PF_K
#undef PF_NOMINAL_RATE
#undef PF_NOMINAL_STEP
#undef PF_READY
#undef PF_INLINE
#undef PF_RARE
#undef PF_UNROLL
#undef PF_TIMES
#undef PF_BANK
#undef PF_T
#undef PF_ALIGNED
#undef PF_WIDE
#undef PF_ENTRIES
#undef PF_BANKS
#undef PF_N
#undef PF_N_F
#undef PF_N_X
#undef PF_NAME
