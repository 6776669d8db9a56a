/* Initialization, events, model exchange and communication steps. See pf_fmi.h. */
#include <string.h>

#include "pf_fmi.h"

#define SAME_INSTANT 1e-9     /* of the time since the last one */
#define TIME_ROUNDING 8.9e-16 /* 4 eps */
#define MOST_STEPS 1e7        /* of the solver in a communication step: more is a slip in somebody's units */
#define LEAST_PIECE 1e-6      /* of a communication step: more often the importer is not called back */

static pf_time magnitude(pf_time t) { return t < 0 ? -t : t; }

static pf_time slack(pf_time since, pf_time t) {
  return SAME_INSTANT * magnitude(t - since) + TIME_ROUNDING * magnitude(t);
}

static int is_finite(double value) { return value - value == 0; }

/* To a calibration tool. */
static int shown(pf_fmi *self, int status) {
  if (pf_fmu_here.page) pf_fmu_here.page->show(self);
  return status;
}

static int apply_staged(pf_fmi *self) {
  if (pf_fmu_here.page) pf_fmu_here.page->take(self);
  if (!self->saved->staged) return PF_FMI_OK;
  self->saved->staged = 0;
  self->fresh = 0;
  const char *const why = self->model->apply(self->self);
  if (why) return pf_fmi_say(self, PF_FMI_WARNING, "parameters refused, those in force stay: %.400s", why);
  pf_fmi_event(self, "parameters in force at %.9g s", self->saved->time);
  return PF_FMI_OK;
}

/* ---- initialization ---- */

int pf_fmi_enter_initialization(pf_fmi *self, int tolerance_defined, double tolerance, double start, int stop_defined,
                                double stop) {
  if (!pf_fmi_in(self, PF_FMI_INSTANTIATED, "enterInitializationMode")) return PF_FMI_ERROR;
  if (!is_finite(start) || (stop_defined && !(stop > start)) || (tolerance_defined && !(tolerance > 0)))
    return pf_fmi_say(self, PF_FMI_ERROR, "experiment: start %.9g s, stop %.9g s, tolerance %.3g: expected numbers, "
                      "stop after start, tolerance above 0", start, stop, tolerance);
  pf_fmi_saved *const saved = self->saved;
  saved->time = saved->start = saved->last_event = start;
  saved->stop_defined = stop_defined != 0;
  saved->stop = stop_defined ? stop : 0;
  if (tolerance_defined && saved->solver.method == PF_ADAPTIVE) saved->solver.rtol = tolerance;
  saved->mode = PF_FMI_INITIALIZATION;
  self->fresh = 0;
  return PF_FMI_OK;
}

int pf_fmi_exit_initialization(pf_fmi *self) {
  pf_fmi_saved *const saved = self->saved;
  const pf_solver *const solver = &saved->solver;
  if (!pf_fmi_in(self, PF_FMI_INITIALIZATION, "exitInitializationMode")) return PF_FMI_ERROR;
  if (!(solver->step >= 0) || !is_finite(solver->step) || !(solver->rtol >= 0) || !(solver->atol >= 0))
    return pf_fmi_say(self, PF_FMI_ERROR, "solver: step %.3g s, tolerances %.3g and %.3g: expected numbers >= 0",
                      solver->step, solver->rtol, solver->atol);
  const int bad = pf_fmu_here.accept_bad_inputs ? -1 : pf_fmi_bad_input(self);
  if (bad >= 0) return pf_fmi_say(self, PF_FMI_ERROR, "start: input '%s' is not finite", pf_fmu_here.inputs[bad]);
  const int status = apply_staged(self);
  memcpy(self->spare, self->self, self->model->size);
  const int code = self->model->start(self->self, saved->time);
  self->fresh = 0;
  if (code) {
    memcpy(self->self, self->spare, self->model->size);
    (void)pf_fmi_failure(self, "start", code);
    return PF_FMI_ERROR;
  }
  saved->ticks = 0;
  saved->mode = saved->interface == PF_FMI_MODEL_EXCHANGE || saved->event_mode ? PF_FMI_EVENT : PF_FMI_STEP;
  return shown(self, status);
}

/* ---- events ---- */

/* Time since the last update, taken as the nominal interval where it is that but for rounding. */
static pf_time elapsed_since(pf_time elapsed, pf_time t) {
  const pf_time nominal = pf_fmu_here.communication;
  return magnitude(elapsed - nominal) <= SAME_INSTANT * nominal + TIME_ROUNDING * magnitude(t) ? nominal : elapsed;
}

/* Model exchange of a block that else updates once per communication step: at multiples of its nominal interval. */
static int update_due(pf_fmi *self) {
  pf_fmi_saved *const saved = self->saved;
  const pf_time interval = pf_fmu_here.communication, t = saved->time, since = saved->last_event;
  if (t + slack(since, t) < saved->start + (saved->ticks + 1) * interval) return PF_OK;
  const pf_time ticks = (t + slack(since, t) - saved->start) / interval;
  const int code = self->model->update(self->self, t, elapsed_since(t - since, t));
  if (code) return code;
  saved->ticks = ticks < 9e15 ? (pf_time)(int64_t)ticks : ticks;
  saved->last_event = t;
  return PF_OK;
}

int pf_fmi_update_discrete(pf_fmi *self, int *states_changed, int *next_defined, double *next) {
  const pf_model *const model = self->model;
  pf_fmi_saved *const saved = self->saved;
  const size_t states = (size_t)model->n_x * sizeof(pf_real);
  const int exchange = saved->interface == PF_FMI_MODEL_EXCHANGE && model->communication;
  int code = PF_OK;
  *states_changed = *next_defined = 0;
  *next = 0;
  if (!pf_fmi_in(self, PF_FMI_EVENT, "updateDiscreteStates")) return PF_FMI_ERROR;
  if (model->n_tasks && saved->time - saved->last_event > pf_fmu_here.longest_step)
    return pf_fmi_say(self, PF_FMI_ERROR, "updateDiscreteStates: %.9g s after the last event; expected a stop at every "
                      "time event", saved->time - saved->last_event);
  if (saved->ticked && pf_fmi_check_ticks(self)) return PF_FMI_ERROR;
  memcpy(self->dx, self->x, states); /* scratch: to be computed anew */
  const int status = apply_staged(self);
  memcpy(self->spare, self->self, model->size);
  if (!pf_fmu_here.accept_bad_inputs && (model->n_tasks || exchange) && pf_fmi_bad_input(self) >= 0)
    return pf_fmi_failure(self, "updateDiscreteStates", PF_NOT_FINITE);
  if (model->n_tasks && (!saved->ticked || pf_fmi_ticking(self))) {
    code = pf_catch_up(model, self->self, saved->last_event, saved->time);
    if (!code) saved->last_event = saved->time;
  }
  if (exchange) code = update_due(self);
#if PF_EVENTS
  if (!code && model->events) code = pf_events_here(model, self->self, self->work, saved->time);
#endif
  self->fresh = 0;
  if (code) {
    memcpy(self->self, self->spare, model->size);
    return pf_fmi_failure(self, "updateDiscreteStates", code);
  }
  *states_changed = memcmp(self->dx, self->x, states) != 0;
  pf_fmi_end_ticks(self);
  pf_time at = model->n_tasks && !saved->ticked ? model->next(self->self) : PF_NEVER;
  if (exchange) at = saved->start + (saved->ticks + 1) * pf_fmu_here.communication;
  *next_defined = at < PF_NEVER;
  *next = *next_defined ? at : 0;
  pf_fmi_event(self, "event at %.9g s; next at %.9g s", saved->time, *next);
  return shown(self, status);
}

/* ---- model exchange ---- */

int pf_fmi_set_time(pf_fmi *self, double t) {
  const uint32_t modes = self->saved->interface == PF_FMI_MODEL_EXCHANGE ? PF_FMI_EVENT | PF_FMI_CONTINUOUS : 0;
  if (!pf_fmi_in(self, modes, "setTime")) return PF_FMI_ERROR;
  if (!is_finite(t)) return pf_fmi_say(self, PF_FMI_ERROR, "setTime: %g is no time", t);
  pf_fmi_end_ticks(self); /* they were of another instant */
  self->saved->time = t;
  self->fresh = 0;
  return PF_FMI_OK;
}

static int fits(pf_fmi *self, const char *call, const void *values, size_t n) {
  if (n == pf_fmi_n_x(self) && (values || !n)) return 1;
  pf_fmi_say(self, PF_FMI_ERROR, "%s: expected %d values, got %lu%s", call, (int)pf_fmi_n_x(self), (unsigned long)n,
             values ? "" : " at NULL");
  return 0;
}

int pf_fmi_set_states(pf_fmi *self, const double *x, size_t n) {
  if (!pf_fmi_in(self, PF_FMI_CONTINUOUS, "setContinuousStates")) return PF_FMI_ERROR;
  if (!fits(self, "setContinuousStates", x, n)) return PF_FMI_ERROR;
  for (size_t i = 0; i < n; i++) self->x[i] = x[i];
  self->fresh = 0;
  return PF_FMI_OK;
}

int pf_fmi_get_states(pf_fmi *self, double *x, size_t n) {
  if (!pf_fmi_in(self, PF_FMI_INITIALIZATION | PF_FMI_EVENT | PF_FMI_CONTINUOUS, "getContinuousStates"))
    return PF_FMI_ERROR;
  if (!fits(self, "getContinuousStates", x, n)) return PF_FMI_ERROR;
  char *const view = pf_fmi_view(self);
  if (!view) return pf_fmi_failure(self, "getContinuousStates", PF_NOT_FINITE);
  const pf_real *const from = self->model->x(view);
  for (size_t i = 0; i < n; i++) x[i] = from[i];
  return PF_FMI_OK;
}

int pf_fmi_get_derivatives(pf_fmi *self, double *dx, size_t n) {
  if (!pf_fmi_in(self, PF_FMI_INITIALIZATION | PF_FMI_EVENT | PF_FMI_CONTINUOUS, "getDerivatives"))
    return PF_FMI_ERROR;
  if (!fits(self, "getDerivatives", dx, n)) return PF_FMI_ERROR;
  char *const view = pf_fmi_view(self);
  int code = view ? PF_OK : PF_NOT_FINITE;
  if (view && n) code = self->model->derivatives(view, self->saved->time, self->model->x(view), self->dx);
  pf_real sum = 0;
  for (size_t i = 0; i < n && !code; i++) sum += self->dx[i] - self->dx[i];
  if (code || sum != 0) return pf_fmi_failure(self, "getDerivatives", code ? code : PF_NOT_FINITE);
  for (size_t i = 0; i < n; i++) dx[i] = self->dx[i];
  return PF_FMI_OK;
}

int pf_fmi_indicators(pf_fmi *self, double *indicators, size_t n) {
  const pf_event_table *const events = self->model->events;
  const size_t count = events ? (size_t)events->count : 0;
  if (!pf_fmi_in(self, PF_FMI_INITIALIZATION | PF_FMI_EVENT | PF_FMI_CONTINUOUS, "getEventIndicators"))
    return PF_FMI_ERROR;
  if (n != count || (n && !indicators))
    return pf_fmi_say(self, PF_FMI_ERROR, "getEventIndicators: expected %lu values, got %lu", (unsigned long)count,
                      (unsigned long)n);
  char *const view = pf_fmi_view(self);
  int code = view ? PF_OK : PF_NOT_FINITE;
  if (!code && n) code = events->conditions(view, self->saved->time, self->model->x(view), self->g);
  if (code) return pf_fmi_failure(self, "getEventIndicators", code);
  for (size_t i = 0; i < n; i++) indicators[i] = self->g[i];
  return PF_FMI_OK;
}

int pf_fmi_completed_step(pf_fmi *self, int *event) {
  const pf_model *const model = self->model;
  int code = PF_OK;
  *event = 0;
  if (!pf_fmi_in(self, PF_FMI_CONTINUOUS, "completedIntegratorStep")) return PF_FMI_ERROR;
  if (model->accepted) model->accepted(self->self, self->saved->time);
#if PF_EVENTS
  if (model->events) code = pf_events_seen(model, self->self, self->work, self->saved->time, event);
#endif
  self->fresh = 0;
  return code ? pf_fmi_failure(self, "completedIntegratorStep", code) : shown(self, PF_FMI_OK);
}

int pf_fmi_nominals(pf_fmi *self, double *nominals, size_t n) {
  if (!fits(self, "getNominalsOfContinuousStates", nominals, n)) return PF_FMI_ERROR;
  for (size_t i = 0; i < n; i++) nominals[i] = pf_fmu_here.nominals ? pf_fmu_here.nominals[i] : 1.0;
  return PF_FMI_OK;
}

/* ---- co-simulation ---- */

/* Where the next piece of a step ends. Pieces are for the importer's eyes: it is shown the state after each. */
static pf_time piece_end(const pf_fmi *self, pf_time t, pf_time goal, pf_time least, int events) {
  const pf_model *const model = self->model;
  const pf_solver *const solver = &self->saved->solver;
  pf_time end = goal;
  if (self->intermediate && model->n_x) {
    const pf_time wanted = solver->method == PF_ADAPTIVE && solver->h > 0 ? solver->h : solver->step;
    const pf_time length = wanted > least ? wanted : least;
    if (wanted > 0 && t + length < end) end = t + length;
  }
  if (events) {
    const pf_time next = model->next(self->self);
    if (next > t && next < end) end = next;
  }
  return end > goal - slack(t, goal) ? goal : end;
}

/* From saved->time to `end`, or to where the importer wants back. */
static int advance(pf_fmi *self, pf_time end, double *reached, int *event) {
  const pf_model *const model = self->model;
  pf_fmi_saved *const saved = self->saved;
  const int events = saved->event_mode && model->n_tasks;
  const pf_time least = LEAST_PIECE * (end - saved->time) + TIME_ROUNDING * magnitude(end);
  pf_time t = saved->time, goal = end;
  int code = PF_OK;
  if (events) code = pf_catch_up(model, self->self, saved->last_event, t); /* an event the importer passed over */
  while (!code && t < goal) {
    const pf_time stop = piece_end(self, t, goal, least, events), before = t;
    const pf_real *const slopes = saved->sloped ? self->slopes : NULL;
    code = (events ? pf_approach : pf_advance)(model, self->self, self->work, &saved->solver, t, stop, slopes, &t);
    if (code) break;
    self->fresh = 0;
    t = stop;
    if (events && model->next(self->self) <= t + slack(before, t)) {
      *event = 1;
      if (t >= goal || saved->early_return) break;
      code = pf_catch_up(model, self->self, before, t);
      *event = 0;
    }
    if (self->intermediate && !code && t < goal) {
      pf_time until = goal;
      saved->time = t;
      saved->mode = PF_FMI_INTERMEDIATE;
      if (self->pause(self, t, &until)) goal = !(until > t) ? t : until < goal ? until : goal;
      saved->mode = PF_FMI_STEP;
    }
  }
  *reached = t;
  return code;
}

static int may_step(pf_fmi *self, double t, double h) {
  const pf_fmi_saved *const saved = self->saved;
  if (!pf_fmi_in(self, PF_FMI_STEP, "doStep")) return 0;
  if (!(h > 0) || !is_finite(h) || !is_finite(t)) {
    pf_fmi_say(self, PF_FMI_ERROR, "doStep: from %.9g s by %.9g s; expected numbers, the step above 0", t, h);
    return 0;
  }
  if (magnitude(t - saved->time) > 1e-6 * h + 1e-12 * magnitude(t)) {
    pf_fmi_say(self, PF_FMI_ERROR, "doStep: from %.9g s; expected %.9g s, where the last step ended", t, saved->time);
    return 0;
  }
  if (h > pf_fmu_here.longest_step || !(t + h > t)) {
    pf_fmi_say(self, PF_FMI_ERROR, "doStep: a step of %.9g s from %.9g s; expected at most %.9g s and more than "
               "rounding", h, t, pf_fmu_here.longest_step);
    return 0;
  }
  if (self->model->n_x && saved->solver.step > 0 && h > MOST_STEPS * saved->solver.step) {
    pf_fmi_say(self, PF_FMI_ERROR, "doStep: a step of %.9g s in solver steps of %.9g s; expected at most 1e7 of them",
               h, saved->solver.step);
    return 0;
  }
  if (saved->stop_defined && t + h > saved->stop + 1e-9 * h + slack(saved->start, saved->stop)) {
    pf_fmi_say(self, PF_FMI_ERROR, "doStep: to %.9g s, but the experiment stops at %.9g s", t + h, saved->stop);
    return 0;
  }
  return 1;
}

int pf_fmi_step(pf_fmi *self, double t, double h, double *reached, int *event) {
  const pf_model *const model = self->model;
  pf_fmi_saved *const saved = self->saved;
  const int continuous = model->n_x || model->n_tasks;
  *event = 0;
  *reached = saved->time;
  if (!may_step(self, t, h)) return PF_FMI_ERROR;
  const int status = apply_staged(self);
  const int bad = pf_fmu_here.accept_bad_inputs ? -1 : pf_fmi_bad_input(self);
  if (bad >= 0) return pf_fmi_failure(self, "doStep", PF_NOT_FINITE);
  const pf_solver solver = saved->solver;
  const pf_time begin = saved->time, end = t + h;
  int code = PF_OK;
  saved->solver.budget = (long long)MOST_STEPS;
  saved->time = t; /* the importer's clock rules: no drift of sums */
  if (continuous) {
    memcpy(self->spare, self->self, model->size);
    code = advance(self, end, reached, event);
  } else {
    *reached = end;
  }
  if (!code && model->communication) {
    const pf_time elapsed = *reached == end ? h : *reached - t; /* h itself: no rounding of a difference */
    code = model->update(self->self, *reached, elapsed_since(elapsed, end));
  }
  saved->solver.budget = 0;
  self->fresh = 0;
  saved->sloped = 0; /* slopes are those of one step */
  if (code) {
    if (continuous) memcpy(self->self, self->spare, model->size);
    saved->solver = solver;
    *event = 0;
    const double failed = *reached;
    saved->time = *reached = begin;
    if (pf_fmi_bad_input(self) < 0) pf_fmi_say(self, PF_FMI_DISCARD, "doStep: failed at %.9g s", failed);
    return pf_fmi_failure(self, "doStep", code);
  }
  saved->time = *reached;
  if (!saved->event_mode || !*event) saved->last_event = *reached;
  return shown(self, status);
}
