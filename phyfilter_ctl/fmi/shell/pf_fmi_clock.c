/* Periodic clocks, one for each sampled block with instants of its own, that the importer ticks in Event Mode. See
 * pf_fmi.h.
 *
 * The first sample belongs to initialization; ticks follow at start + k * period, k >= 1. An importer that has never
 * set a clock finds the instants as time events instead. */
#include <string.h>

#include "pf_fmi.h"

#define SAME_INSTANT 1e-9     /* of the period */
#define TIME_ROUNDING 8.9e-16 /* 4 eps */

static pf_time magnitude(pf_time t) { return t < 0 ? -t : t; }

static pf_time nearest_tick(const pf_fmi *self, uint32_t clock, pf_time t) {
  const pf_time period = pf_fmu_here.clocks[clock].period, ratio = (t - self->saved->start) / period + 0.5;
  const pf_time k = ratio < 9e15 ? (pf_time)(int64_t)ratio : ratio;
  return self->saved->start + (k < 1 ? 1 : k) * period;
}

/* Whether a clock ticks now and has not yet, and none has been left out before. */
static int is_due(const pf_fmi *self, uint32_t clock) {
  const pf_time t = self->saved->time, slack = SAME_INSTANT * pf_fmu_here.clocks[clock].period;
  const pf_time room = slack + TIME_ROUNDING * magnitude(t);
  return magnitude(t - nearest_tick(self, clock, t)) <= room && magnitude(self->model->next(self->self) - t) <= room;
}

const pf_fmi_clock *pf_fmi_clock_of(pf_fmi *self, uint32_t reference, const char *call) {
  if (pf_fmi_exists(reference) && pf_fmu_here.variables[reference].kind == PF_FMI_CLOCK)
    return pf_fmu_here.clocks + pf_fmu_here.variables[reference].first;
  pf_fmi_say(self, PF_FMI_ERROR, "%s: value reference %lu is no clock", call, (unsigned long)reference);
  return NULL;
}

int pf_fmi_get_clocks(pf_fmi *self, const uint32_t *references, size_t n, _Bool *values) {
  if (n && (!references || !values)) return pf_fmi_say(self, PF_FMI_ERROR, "getClock: an argument is NULL");
  for (size_t i = 0; i < n; i++) {
    if (!pf_fmi_clock_of(self, references[i], "getClock")) return PF_FMI_ERROR;
    values[i] = self->active[pf_fmu_here.variables[references[i]].first];
  }
  return PF_FMI_OK;
}

int pf_fmi_set_clocks(pf_fmi *self, const uint32_t *references, size_t n, const _Bool *values) {
  if (n && (!references || !values)) return pf_fmi_say(self, PF_FMI_ERROR, "setClock: an argument is NULL");
  if (!pf_fmi_in(self, PF_FMI_EVENT, "setClock")) return PF_FMI_ERROR;
  for (size_t i = 0; i < n; i++) {
    const pf_fmi_clock *const clock = pf_fmi_clock_of(self, references[i], "setClock");
    if (!clock) return PF_FMI_ERROR;
    const uint32_t at = pf_fmu_here.variables[references[i]].first;
    if (values[i] && !is_due(self, at))
      return pf_fmi_say(self, PF_FMI_ERROR, "setClock at %.9g s: '%.80s' ticks once at start + k * %.9g s, k >= 1, such "
                        "as %.9g s", self->saved->time, clock->name, clock->period,
                        nearest_tick(self, at, self->saved->time));
  }
  for (size_t i = 0; i < n; i++) self->active[pf_fmu_here.variables[references[i]].first] = values[i];
  self->saved->ticked |= n > 0;
  self->fresh = 0;
  return PF_FMI_OK;
}

int pf_fmi_ticking(const pf_fmi *self) {
  return pf_fmu_here.clocks && memchr(self->active, 1, (size_t)self->model->n_tasks) != NULL;
}

int pf_fmi_check_ticks(pf_fmi *self) {
  const pf_time t = self->saved->time, next = self->model->next(self->self);
  const int ticking = pf_fmi_ticking(self);
  for (uint32_t i = 0; i < (uint32_t)self->model->n_tasks; i++) {
    const pf_fmi_clock *const clock = pf_fmu_here.clocks + i;
    if (next < t - SAME_INSTANT * clock->period - TIME_ROUNDING * magnitude(t))
      return pf_fmi_say(self, PF_FMI_ERROR, "updateDiscreteStates at %.9g s: a clock that was to tick at %.9g s did not",
                        t, next);
    if (ticking && !self->active[i] && is_due(self, i))
      return pf_fmi_say(self, PF_FMI_ERROR, "updateDiscreteStates at %.9g s: '%.80s' ticks at this instant too; expected "
                        "all its clocks to be set", t, clock->name);
  }
  return PF_FMI_OK;
}

void pf_fmi_end_ticks(pf_fmi *self) {
  if (pf_fmu_here.clocks) memset(self->active, 0, (size_t)self->model->n_tasks);
}
