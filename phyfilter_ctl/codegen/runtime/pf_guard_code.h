/* A filter behind real signals: the functions. pf_guard.h says what they do. */
#include "pf_ieee.h"

#include "pf_crc.h"
#include "pf_tune.h"

/* Steps that differ less from the nominal one are nominal: clocks jitter, and another length costs an exponential. What
 * it costs in accuracy: a velocity difference over h (1 + e) is divided by h, so M x' is wrong by the share e. */
#define PF_JITTER 0.05
#define PF_LONGEST 20.0 /* nominal steps */
#if PF_P(INERTIA)
#define PF_GUARD_ENTRIES ((int)(sizeof((PF_NAME *)0)->inertia / sizeof(PF_P(real))))
#endif

static uint32_t PF_P(guard_crc_)(const PF_NAME *filter) {
  uint32_t crc = 0;
  for (int i = 0; i < PF_P(FILTERS); i++) {
#if PF_P(FLOAT)
#define PF_GUARD_CRC pf_crc32_float
#else
#define PF_GUARD_CRC pf_crc32_double
#endif
    for (int j = 0; j < PF_P(ORDER); j++) crc = PF_GUARD_CRC(crc, filter->dA[i][j], PF_P(ORDER));
    crc = PF_GUARD_CRC(crc, filter->equilibrium[i], PF_P(ORDER));
    crc = PF_GUARD_CRC(crc, filter->C[i], PF_P(ORDER));
    for (int j = 0; j < PF_P(ORDER); j++) crc = pf_crc32_double(crc, filter->poles[i][j], 2);
#if PF_P(TUNABLE)
    crc = pf_crc32_double(crc, filter->a[i], PF_P(ORDER));
    crc = pf_crc32_double(crc, filter->b[i], PF_P(ORDER));
    crc = pf_crc32_double(crc, filter->a_home[i], PF_P(ORDER));
    for (int j = 0; j < PF_P(ORDER); j++) crc = pf_crc32_double(crc, filter->poles_home[i][j], 2);
#endif
    crc = pf_crc32_bits(crc, (uint32_t)filter->order[i], 4);
  }
#if PF_P(LIMIT)
  crc = PF_GUARD_CRC(crc, filter->limit, PF_P(N_F));
#endif
#if PF_P(G_LIMIT)
  crc = PF_GUARD_CRC(crc, filter->g_low, PF_P(N_X));
  crc = PF_GUARD_CRC(crc, filter->g_high, PF_P(N_X));
#endif
#if PF_P(DIRECTION)
  for (int i = 0; i < PF_P(N_F); i++) crc = PF_GUARD_CRC(crc, filter->E_left[i], PF_P(N_X));
#endif
#if PF_P(INERTIA) && !PF_P(INERTIA_INPUT)
  crc = PF_GUARD_CRC(crc, filter->inertia, PF_GUARD_ENTRIES);
#endif
#if PF_P(PAST)
  crc = pf_crc32_double(crc, &filter->delay, 1);
#endif
  crc = PF_GUARD_CRC(crc, &filter->rate, 1);
#undef PF_GUARD_CRC
  return pf_crc32_double(crc, &filter->dt, 1);
}

static int PF_P(guard_finite_)(const PF_P(real) *values, int count) {
  for (int i = 0; i < count; i++)
    if (!(values[i] - values[i] == (PF_P(real))0)) return 0;
  return 1;
}

int PF_P(guard_init)(PF_P(guard) *self, const PF_P(params) *params) {
  memset(self, 0, sizeof *self);
  const int code = PF_P(init)(&self->filter, params);
  if (code) return code;
  self->params = params;
  const double longest = PF_LONGEST * 1e6 * params->dt + 0.5;
  self->longest = longest < 4294967295.0 ? (uint32_t)longest : UINT32_MAX; /* more than an hour is no fault */
  self->crc = PF_P(guard_crc_)(&self->filter);
  return PF_FILTER_OK;
}

/* At rest on an estimate: where no constant residual gives it, at f_theta. An inertia that is not given stays. */
static int PF_P(guard_start_)(PF_P(guard) *self, const PF_P(real) *x, const PF_P(real) *g, const PF_P(real) *f_theta,
                              const PF_P(real) *inertia, const PF_P(real) *f_hat) {
#if PF_P(INERTIA_INPUT)
  PF_P(real) last[PF_GUARD_ENTRIES];
  memcpy(last, self->filter.inertia, sizeof last);
  if (!inertia && self->filter.has_inertia) inertia = last;
#endif
  const int code = PF_P(start)(&self->filter, x, f_hat, f_theta, inertia, g);
  if (code != PF_FILTER_NO_REST) return code;
  memset(self->correction, 0, sizeof self->correction);
  return PF_P(start)(&self->filter, x, NULL, f_theta, inertia, g);
}

#if PF_P(TUNABLE)
static uint32_t PF_P(guard_tuning_crc_)(const PF_P(tuning) *tuning) {
  uint32_t crc = 0;
  for (int i = 0; i < PF_P(FILTERS); i++) {
    for (int j = 0; j < PF_P(ORDER); j++) crc = pf_crc32_double(crc, tuning->poles[i][j], 2);
    crc = pf_crc32_double(crc, tuning->b[i], PF_P(ORDER));
  }
  return crc;
}

static int PF_P(guard_refuse_)(const PF_P(tuning) *tuning) {
  if (tuning->version != PF_FILTER_FORMAT) return PF_FILTER_VERSION;
  return tuning->crc == PF_P(guard_tuning_crc_)(tuning) ? PF_FILTER_OK : PF_FILTER_CORRUPT;
}

void PF_P(guard_seal)(PF_P(tuning) *tuning) {
  tuning->version = PF_FILTER_FORMAT;
  tuning->crc = PF_P(guard_tuning_crc_)(tuning);
}

int PF_P(guard_send)(PF_P(guard) *self, const PF_P(tuning) *tuning) {
  const int code = PF_P(guard_refuse_)(tuning);
  const uint32_t sent = self->sent;
  double sorted[PF_P(ORDER)][2];
  if (code) return code;
  if (!self->params || sent != self->seen) return PF_FILTER_INVALID;
  for (int i = 0; i < PF_P(FILTERS); i++) {
    memcpy(sorted, tuning->poles[i], sizeof sorted);
    if (!pf_sort_poles((int)self->params->order[i], &sorted[0][0])) return PF_FILTER_NOT_HURWITZ;
  }
  self->tunings[sent & 1u] = *tuning;
#if defined(__GNUC__)
  __sync_synchronize(); /* the tuning before its number */
#endif
  self->sent = sent + 1u;
  return PF_FILTER_OK;
}

static uint32_t PF_P(guard_receive_)(PF_P(guard) *self) {
#if defined(__GNUC__)
  __sync_synchronize(); /* its number before the tuning */
#endif
  const PF_P(tuning) tuning = self->tunings[self->seen & 1u];
  int code = PF_P(guard_refuse_)(&tuning);
  if (!code) code = PF_P(retune_poles)(&self->filter, &tuning.poles[0][0][0], &tuning.b[0][0]);
  self->seen = self->seen + 1u;
  if (code) {
    self->refused++;
    return PF_HEALTH_REFUSED;
  }
  self->in_force = tuning;
  self->tuned = 1u;
  self->crc = PF_P(guard_crc_)(&self->filter);
  return PF_HEALTH_OK;
}
#endif

/* What is put out where there is no step: f_theta, or the last that was finite, and the correction. */
static void PF_P(guard_hold_)(PF_P(guard) *self, const PF_P(real) *f_theta, PF_P(real) *f_hat) {
  for (int i = 0; i < PF_P(N_F); i++) {
    if (f_theta[i] - f_theta[i] == (PF_P(real))0) self->f_theta[i] = f_theta[i];
    f_hat[i] = self->f_theta[i] + self->correction[i];
  }
}

static int PF_P(guard_plausible_)(const PF_P(guard) *self) {
  const PF_NAME *const filter = &self->filter;
  for (int i = 0; i < PF_P(N_F); i++) {
    PF_P(real) sum = 0;
    for (int j = 0; j < PF_P(ORDER); j++) sum += filter->C[PF_P(FILTERS) == 1 ? 0 : i][j] * filter->w[i][j];
    if (!(sum - sum == (PF_P(real))0)) return 0;
    if (sum < (PF_P(real))0) sum = -sum;
    if (self->plausible[i] > (PF_P(real))0 && sum > self->plausible[i]) return 0;
  }
  return 1;
}

/* Again at rest on the last estimate. */
static int PF_P(guard_resume_)(PF_P(guard) *self, const PF_P(real) *x, const PF_P(real) *g, const PF_P(real) *f_theta,
                               const PF_P(real) *inertia, PF_P(real) *f_hat) {
  PF_P(real) last[PF_P(N_F)];
  for (int i = 0; i < PF_P(N_F); i++) last[i] = f_theta[i] + self->correction[i];
  const int code = PF_P(guard_start_)(self, x, g, f_theta, inertia, last);
  for (int i = 0; !code && i < PF_P(N_F); i++) f_hat[i] = f_theta[i] + self->correction[i];
  return code;
}

/* One sample at its time: nominal, longer, or a start where time makes no sense. */
static int PF_P(guard_take_)(PF_P(guard) *self, uint64_t time, const PF_P(real) *x, const PF_P(real) *g,
                             const PF_P(real) *f_theta, const PF_P(real) *inertia, PF_P(real) *f_hat,
                             uint32_t *health) {
  const double h = self->filter.dt;
  double dt;
  int code, late;
  if (!self->running) return PF_P(step)(&self->filter, x, g, f_theta, inertia, f_hat);
  if (!self->filter.started) return PF_P(guard_resume_)(self, x, g, f_theta, inertia, f_hat); /* repaired */
  if (time <= self->time || time - self->time > self->longest) {
    /* As after any gap: no step, and the states stay. */
    code = PF_P(step_after)(&self->filter, x, g, f_theta, inertia, 2.0 * PF_P(LONGEST) * h, f_hat);
    if (!code) *health |= PF_HEALTH_TIME, self->jumps++;
    return code;
  }
  dt = 1e-6 * (double)(time - self->time);
  if (dt > (1.0 - PF_JITTER) * h && dt < (1.0 + PF_JITTER) * h)
    return PF_P(step)(&self->filter, x, g, f_theta, inertia, f_hat);
  code = PF_P(step_after)(&self->filter, x, g, f_theta, inertia, dt, f_hat);
  late = code == PF_FILTER_STEP; /* forward Euler would diverge */
  if (late) code = PF_P(guard_resume_)(self, x, g, f_theta, inertia, f_hat);
  if (!code && (late || dt > 1.5 * h)) *health |= PF_HEALTH_MISSED, self->missed += (uint32_t)(dt / h - 0.5);
  return code;
}

/* Within the limit, where there is one; whether f_hat is at it. */
static uint32_t PF_P(guard_limited_)(const PF_P(guard) *self, PF_P(real) *f_hat) {
  uint32_t health = PF_HEALTH_OK;
#if PF_P(LIMIT)
  for (int i = 0; i < PF_P(N_F); i++) {
    const PF_P(real) limit = self->filter.limit[i];
    if (f_hat[i] < limit && f_hat[i] > -limit) continue;
    if (!(limit > (PF_P(real))0)) continue; /* stopped, or never started */
    f_hat[i] = f_hat[i] < (PF_P(real))0 ? -limit : limit;
    health = PF_HEALTH_LIMIT;
  }
#else
  (void)self;
  (void)f_hat;
#endif
  return health;
}

uint32_t PF_P(guard_step)(PF_P(guard) *self, uint64_t time, const PF_P(real) *x, const PF_P(real) *g,
                          const PF_P(real) *f_theta_now, const PF_P(real) *inertia, PF_P(real) *f_hat) {
  PF_P(real) f_theta[PF_P(N_F)]; /* f_hat may be in its memory */
  uint32_t health = self->repaired;
  int code = PF_FILTER_NOT_FINITE;
  memcpy(f_theta, f_theta_now, sizeof f_theta);
  self->repaired = PF_HEALTH_OK;
#if PF_P(TUNABLE)
  if (self->sent != self->seen) health |= PF_P(guard_receive_)(self);
#endif
  if (PF_P(guard_finite_)(x, PF_P(N_X)) && PF_P(guard_finite_)(g, PF_P(N_X)) &&
      PF_P(guard_finite_)(f_theta, PF_P(N_F))
#if PF_P(INERTIA_INPUT)
      && (!inertia || PF_P(guard_finite_)(inertia, PF_GUARD_ENTRIES))
#endif
  )
    code = PF_P(guard_take_)(self, time, x, g, f_theta, inertia, f_hat, &health);
  if (code) {
    if (code == PF_FILTER_NOT_FINITE)
      health |= PF_HEALTH_NOT_FINITE, self->bad++;
    else
      health |= PF_HEALTH_DAMAGED;
    PF_P(guard_hold_)(self, f_theta, f_hat);
    return self->health = health | PF_P(guard_limited_)(self, f_hat);
  }
  self->time = time;
  self->running = 1u;
  if (!PF_P(guard_plausible_)(self)) {
    self->implausible++;
    health |= PF_HEALTH_STATE;
    memset(self->correction, 0, sizeof self->correction);
    (void)PF_P(guard_start_)(self, x, g, f_theta, inertia, NULL);
    PF_P(guard_hold_)(self, f_theta, f_hat);
    return self->health = health | PF_P(guard_limited_)(self, f_hat);
  }
  health |= PF_P(guard_limited_)(self, f_hat);
  for (int i = 0; i < PF_P(N_F); i++) {
    self->correction[i] = f_hat[i] - f_theta[i];
    self->f_theta[i] = f_theta[i];
  }
  return self->health = health;
}

void PF_P(guard_check)(PF_P(guard) *self) {
  PF_NAME *const filter = &self->filter;
  if (!self->params) return; /* guard_init was not called, or has refused: every step says so */
  filter->dt_other = 0.0;    /* dA_other is computed anew */
  if (PF_P(guard_crc_)(filter) == self->crc) return;
#if PF_P(INERTIA_INPUT)
  const int8_t has_inertia = filter->has_inertia;
  PF_P(real) inertia[PF_GUARD_ENTRIES];
  memcpy(inertia, filter->inertia, sizeof inertia);
#endif
  if (PF_P(init)(filter, self->params)) { /* nothing to go back to: stopped, see PF_HEALTH_DAMAGED */
    memset(self->correction, 0, sizeof self->correction);
    return;
  }
#if PF_P(INERTIA_INPUT)
  memcpy(filter->inertia, inertia, sizeof inertia);
  filter->has_inertia = has_inertia;
#endif
  self->repaired = PF_HEALTH_REPAIRED;
#if PF_P(TUNABLE)
  if (self->tuned && (PF_P(guard_refuse_)(&self->in_force) ||
                      PF_P(retune_poles)(filter, &self->in_force.poles[0][0][0], &self->in_force.b[0][0]))) {
    self->refused++;
    self->repaired |= PF_HEALTH_REFUSED; /* those as exported */
  }
#endif
  self->crc = PF_P(guard_crc_)(filter);
}

#undef PF_GUARD_ENTRIES
#undef PF_JITTER
#undef PF_LONGEST
