/* Instances, modes, messages, variables. See pf_fmi.h. */
#include "pf_fmi.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef char real_must_be_double[sizeof(pf_real) == sizeof(double) ? 1 : -1];

enum { MESSAGE = 512, ALIGNMENT = 16 };
#define LOOKED_AHEAD (1u << 31) /* in pf_fmi.fresh: the copy is ahead, at the start of the run */

static const char *const CATEGORIES[] = {"logEvents", "logStatusWarning", "logStatusDiscard", "logStatusError"};

static size_t aligned(size_t bytes) { return (bytes + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT; }

/* ---- messages ---- */

static void say(pf_fmi *self, int status, const char *category, const char *format, va_list arguments) {
  char text[MESSAGE];
  if (!self->callback) return;
  vsnprintf(text, sizeof text, format, arguments);
  /* Some importers run the message of FMI 2 through printf, some do not: no percent sign suits both. */
  for (char *c = text; *c; c++)
    if (*c == '%') *c = ' ';
  self->log(self, status, category, text);
}

int pf_fmi_say(pf_fmi *self, int status, const char *format, ...) {
  va_list arguments;
  va_start(arguments, format);
  say(self, status, CATEGORIES[status], format, arguments);
  va_end(arguments);
  return status;
}

void pf_fmi_event(pf_fmi *self, const char *format, ...) {
  va_list arguments;
  if (!(self->categories & 1u)) return;
  va_start(arguments, format);
  say(self, PF_FMI_OK, CATEGORIES[0], format, arguments);
  va_end(arguments);
}

int pf_fmi_log_categories(pf_fmi *self, int on, size_t n, const char *const *categories) {
  uint32_t chosen = n ? 0 : 1;
  if (n && !categories) return pf_fmi_say(self, PF_FMI_ERROR, "setDebugLogging: categories is NULL");
  for (size_t i = 0; i < n; i++) {
    size_t k = 0;
    while (k < 4 && (!categories[i] || strcmp(categories[i], CATEGORIES[k]) != 0)) k++;
    if (k == 0 || (categories[i] && strcmp(categories[i], "logAll") == 0))
      chosen = 1;
    else if (k == 4)
      return pf_fmi_say(self, PF_FMI_ERROR, "setDebugLogging: no category '%.80s'",
                        categories[i] ? categories[i] : "NULL");
  }
  self->categories = on ? chosen : 0; /* what fails is logged in any case */
  return PF_FMI_OK;
}

static const char *mode_name(uint32_t mode) {
  switch (mode) {
    case PF_FMI_INSTANTIATED: return "Instantiated";
    case PF_FMI_INITIALIZATION: return "Initialization Mode";
    case PF_FMI_EVENT: return "Event Mode";
    case PF_FMI_CONTINUOUS: return "Continuous-Time Mode";
    case PF_FMI_STEP: return "Step Mode";
    case PF_FMI_INTERMEDIATE: return "Intermediate Update Mode";
    case PF_FMI_CONFIGURATION: return "Configuration Mode";
    default: return "Terminated";
  }
}

int pf_fmi_in(pf_fmi *self, uint32_t modes, const char *call) {
  if (self->saved->mode & modes) return 1;
  pf_fmi_say(self, PF_FMI_ERROR, "%s is not allowed in %s", call, mode_name(self->saved->mode));
  return 0;
}

/* ---- instances ---- */

static pf_fmi *complain(const char *name, void (*callback)(void), void *environment,
                        void (*log)(pf_fmi *, int, const char *, const char *), const char *text) {
  pf_fmi stub = {0};
  char no_name[] = "";
  stub.name = no_name;
  stub.callback = callback;
  stub.environment = environment;
  stub.log = log;
  pf_fmi_say(&stub, PF_FMI_ERROR, "instantiation of '%.80s' refused: %s", name ? name : "", text);
  return NULL;
}

pf_fmi *pf_fmi_new(const char *name, const char *token, int interface, void (*callback)(void), void *environment,
                   void (*log)(pf_fmi *, int, const char *, const char *)) {
  const pf_model *const model = pf_fmu_here.model;
  const size_t x = (size_t)model->n_x, u = (size_t)model->n_u, y = (size_t)model->n_y, p = (size_t)model->n_p;
  if (!name || !*name) return complain(name, callback, environment, log, "the instance has no name");
  if (!token || strcmp(token, pf_fmu_here.token) != 0)
    return complain(name, callback, environment, log, "the token (GUID) is not that of this FMU");
  if (!(pf_fmu_here.kinds & interface))
    return complain(name, callback, environment, log, "the FMU was exported without this interface type");
  const size_t saved = aligned(sizeof(pf_fmi_saved)), size = aligned(model->size);
  const size_t slopes = aligned(u * sizeof(pf_real));
  const size_t clocks = pf_fmu_here.clocks ? aligned((size_t)model->n_tasks) : 0;
  const size_t vector = x + y > x + u + p ? x + y : x + u + p; /* of knowns or unknowns */
  const size_t g = model->events ? (size_t)model->events->count : 0;
  const size_t reals = pf_work_reals(model) + y + x + (size_t)model->n_s + g + 2 * vector;
  const size_t head = aligned(sizeof(pf_fmi));
  const size_t scratch = size + aligned(reals * sizeof(pf_real));
  char *const block = calloc(1, head + saved + size + slopes + clocks + scratch + strlen(name) + 1);
  if (!block) return complain(name, callback, environment, log, "out of memory");
  pf_fmi *const self = (pf_fmi *)(void *)block;
  self->model = model;
  self->saved = (pf_fmi_saved *)(void *)(block + head);
  self->self = block + head + saved;
  self->slopes = (pf_real *)(void *)(self->self + size);
  self->saved_size = saved + size + slopes + clocks;
  self->active = (unsigned char *)(void *)self->slopes + slopes;
  self->spare = (char *)(void *)self->slopes + slopes + clocks;
  self->work = (pf_real *)(void *)(self->spare + size);
  self->y = self->work + pf_work_reals(model);
  self->dx = self->y + y;
  self->s = self->dx + x;
  self->g = self->s + model->n_s;
  self->seed = self->g + g;
  self->result = self->seed + vector;
  self->name = self->spare + scratch;
  memcpy(self->name, name, strlen(name) + 1);
  self->x = model->x(self->self);
  self->u = model->u(self->self);
  self->values[PF_FMI_TIME] = &self->saved->time;
  self->values[PF_FMI_INPUT] = self->u;
  self->values[PF_FMI_OUTPUT] = self->y;
  self->values[PF_FMI_PARAMETER] = self->values[PF_FMI_FIXED] = model->p(self->self);
  self->values[PF_FMI_STATE] = self->x;
  self->values[PF_FMI_DERIVATIVE] = self->dx;
  self->values[PF_FMI_SAMPLED] = self->s;
  self->values[PF_FMI_CONDITION] = self->g;
  self->values[PF_FMI_SOLVER_STEP] = &self->saved->solver.step;
  self->values[PF_FMI_SOLVER_RTOL] = &self->saved->solver.rtol;
  self->values[PF_FMI_SOLVER_ATOL] = &self->saved->solver.atol;
  self->callback = callback;
  self->environment = environment;
  self->log = log;
  self->saved->interface = (uint32_t)interface;
  pf_fmi_reset(self);
  if (pf_fmu_here.page) pf_fmu_here.page->claim(self);
  return self;
}

void pf_fmi_reset(pf_fmi *self) {
  const uint32_t interface = self->saved->interface, event_mode = self->saved->event_mode;
  const uint32_t early_return = self->saved->early_return;
  memset(self->saved, 0, self->saved_size);
  self->saved->mode = PF_FMI_INSTANTIATED;
  self->saved->interface = interface;
  self->saved->event_mode = event_mode;
  self->saved->early_return = early_return;
  self->saved->solver = pf_fmu_here.solver;
  self->saved->channels = pf_fmu_here.channels;
  (void)self->model->init(self->self); /* start says it again */
  self->fresh = 0;
  if (pf_fmu_here.page) pf_fmu_here.page->show(self);
}

void pf_fmi_delete(pf_fmi *self) {
  void *state;
  if (pf_fmu_here.page) pf_fmu_here.page->leave(self);
  while ((state = self->states) != NULL) pf_fmi_free_state(self, &state);
  free(self);
}

/* ---- variables ---- */

uint32_t pf_fmi_count(const pf_fmi *self, pf_fmi_variable variable) {
  return variable.each ? variable.each * self->saved->channels : variable.count;
}

size_t pf_fmi_n_x(const pf_fmi *self) {
  const size_t all = (size_t)self->model->n_x;
  return pf_fmu_here.channels ? all / pf_fmu_here.most_channels * self->saved->channels : all;
}

static const uint32_t SETTABLE[PF_FMI_KINDS] = {
    [PF_FMI_INPUT] = PF_FMI_BEFORE | PF_FMI_RUNNING | PF_FMI_INTERMEDIATE,
    [PF_FMI_PARAMETER] = PF_FMI_BEFORE | PF_FMI_EVENT | PF_FMI_STEP,
    [PF_FMI_FIXED] = PF_FMI_BEFORE,
    [PF_FMI_STATE] = PF_FMI_BEFORE,
    [PF_FMI_SOLVER_STEP] = PF_FMI_BEFORE,
    [PF_FMI_SOLVER_RTOL] = PF_FMI_BEFORE,
    [PF_FMI_SOLVER_ATOL] = PF_FMI_BEFORE};

/* The model whose results are to be shown: before the run a copy that has taken its first samples, so that outputs are
 * right in Initialization Mode too; while clocks tick one that has taken theirs. */
char *pf_fmi_view(pf_fmi *self) {
  const pf_model *const model = self->model;
  const pf_fmi_saved *const saved = self->saved;
  const int before = (saved->mode & PF_FMI_BEFORE) != 0;
  if (!before && !pf_fmi_ticking(self)) return self->self;
  if (!(self->fresh & LOOKED_AHEAD)) {
    memcpy(self->spare, self->self, model->size);
    if (saved->staged) (void)model->apply(self->spare);
    if (before ? model->start(self->spare, saved->time)
               : pf_catch_up(model, self->spare, saved->last_event, saved->time))
      return NULL;
    self->fresh |= LOOKED_AHEAD;
  }
  return self->spare;
}

int pf_fmi_bad_input(const pf_fmi *self) { /* index of the first that is not finite, or -1 */
  pf_real sum = 0;
  for (int i = 0; i < self->model->n_u; i++) sum += self->u[i] - self->u[i];
  if (sum == 0) return -1;
  for (int i = 0; i < self->model->n_u; i++)
    if (self->u[i] - self->u[i] != 0) return i;
  return -1;
}

int pf_fmi_failure(pf_fmi *self, const char *call, int code) {
  const int bad = pf_fmi_bad_input(self);
  if (bad >= 0)
    return pf_fmi_say(self, PF_FMI_DISCARD, "%s at %.9g s: input '%s' is not finite", call, self->saved->time,
                      pf_fmu_here.inputs[bad]);
  if (pf_fmu_here.why)
    return pf_fmi_say(self, PF_FMI_DISCARD, "%s at %.9g s: %.400s", call, self->saved->time, pf_fmu_here.why());
  return pf_fmi_say(self, PF_FMI_DISCARD, "%s at %.9g s: %s", call, self->saved->time,
                    code == PF_UNUSABLE         ? "damaged parameters, or a build without IEEE arithmetic"
                    : code == PF_NO_CONVERGENCE ? "an equation inside was not solved"
                    : code == PF_STEP_TOO_SMALL && !self->model->n_x
                        ? "a step of this length is not possible; forward Euler would diverge"
                    : code == PF_TOO_MANY_STEPS ? "the solver took 1e7 steps; the model is stiff or chatters"
                    : code == PF_ENDLESS_EVENTS ? "events follow each other without time in between"
                    : code == PF_STEP_TOO_SMALL ? "the solver's steps became too short; the model is stiff or diverges"
                                                : "a number is no longer finite");
}

static int refresh(pf_fmi *self, uint32_t kind) {
  const pf_model *const model = self->model;
  char *const view = pf_fmi_view(self);
  int code = view ? PF_OK : PF_NOT_FINITE;
  if (view && kind == PF_FMI_OUTPUT) code = model->outputs(view, self->saved->time, model->x(view), self->y);
  if (view && kind == PF_FMI_DERIVATIVE) code = model->derivatives(view, self->saved->time, model->x(view), self->dx);
  if (view && kind == PF_FMI_SAMPLED) model->s(view, self->s);
  if (view && kind == PF_FMI_CONDITION)
    code = model->events->conditions(view, self->saved->time, model->x(view), self->g);
  if (code) return pf_fmi_failure(self, "evaluation", code);
  self->fresh |= 1u << kind;
  return PF_FMI_OK;
}

static int wrong(pf_fmi *self, const char *call, uint32_t reference, const char *why) {
  return pf_fmi_say(self, PF_FMI_ERROR, "%s: value reference %lu %s", call, (unsigned long)reference, why);
}

static int wrong_count(pf_fmi *self, const char *call, size_t n_values) {
  return pf_fmi_say(self, PF_FMI_ERROR, "%s: %lu values do not fit the variables asked for", call,
                    (unsigned long)n_values);
}

int pf_fmi_get(pf_fmi *self, const uint32_t *references, size_t n, double *values, size_t n_values) {
  const uint32_t computed = 1u << PF_FMI_OUTPUT | 1u << PF_FMI_DERIVATIVE | 1u << PF_FMI_SAMPLED |
                            1u << PF_FMI_CONDITION;
  size_t done = 0;
  if ((n && !references) || (n_values && !values)) return pf_fmi_say(self, PF_FMI_ERROR, "get: an argument is NULL");
  for (size_t i = 0; i < n; i++) {
    if (!pf_fmi_exists(references[i])) return wrong(self, "get", references[i], "does not exist");
    const pf_fmi_variable variable = pf_fmu_here.variables[references[i]];
    const uint32_t bit = 1u << variable.kind;
    const uint32_t count = pf_fmi_count(self, variable);
    if (variable.kind == PF_FMI_CLOCK) return wrong(self, "get", references[i], "is a clock");
    if (variable.kind == PF_FMI_STRUCTURE) return wrong(self, "get", references[i], "is of type UInt64");
    if (count > n_values - done) return wrong_count(self, "get", n_values);
    if ((bit & computed) && !(self->fresh & bit)) {
      const int status = refresh(self, variable.kind);
      if (status) return status;
    }
    const pf_real *const from = self->values[variable.kind] + variable.first;
    for (uint32_t k = 0; k < count; k++) values[done++] = from[k];
  }
  return done == n_values ? PF_FMI_OK : wrong_count(self, "get", n_values);
}

static int may_set(pf_fmi *self, const uint32_t *references, size_t n, size_t n_values) {
  size_t total = 0;
  for (size_t i = 0; i < n; i++) {
    if (!pf_fmi_exists(references[i])) return wrong(self, "set", references[i], "does not exist");
    const pf_fmi_variable variable = pf_fmu_here.variables[references[i]];
    if (!(SETTABLE[variable.kind] & self->saved->mode)) return wrong(self, "set", references[i], "cannot be set now");
    total += pf_fmi_count(self, variable);
  }
  return total == n_values ? PF_FMI_OK : wrong_count(self, "set", n_values);
}

int pf_fmi_set(pf_fmi *self, const uint32_t *references, size_t n, const double *values, size_t n_values) {
  if ((n && !references) || (n_values && !values)) return pf_fmi_say(self, PF_FMI_ERROR, "set: an argument is NULL");
  const int status = may_set(self, references, n, n_values);
  if (status) return status;
  for (size_t i = 0; i < n; i++) {
    const pf_fmi_variable variable = pf_fmu_here.variables[references[i]];
    pf_real *const to = self->values[variable.kind] + variable.first;
    const uint32_t count = pf_fmi_count(self, variable);
    for (uint32_t k = 0; k < count; k++) to[k] = values[k];
    values += count;
    if (variable.kind == PF_FMI_PARAMETER || variable.kind == PF_FMI_FIXED) self->saved->staged = 1;
  }
  self->fresh = 0;
  return PF_FMI_OK;
}

static int sizes(pf_fmi *self, const char *call, const uint32_t *references, size_t n, const void *values,
                 size_t n_values) {
  if ((n && !references) || (n_values && !values)) return pf_fmi_say(self, PF_FMI_ERROR, "%s: an argument is NULL", call);
  for (size_t i = 0; i < n; i++) {
    if (!pf_fmi_exists(references[i])) return wrong(self, call, references[i], "does not exist");
    if (pf_fmu_here.variables[references[i]].kind != PF_FMI_STRUCTURE)
      return wrong(self, call, references[i], "is not of type UInt64");
  }
  return n == n_values ? PF_FMI_OK : wrong_count(self, call, n_values);
}

int pf_fmi_get_sizes(pf_fmi *self, const uint32_t *references, size_t n, uint64_t *values, size_t n_values) {
  const int status = sizes(self, "get", references, n, values, n_values);
  for (size_t i = 0; i < n && status == PF_FMI_OK; i++) values[i] = self->saved->channels;
  return status;
}

int pf_fmi_set_sizes(pf_fmi *self, const uint32_t *references, size_t n, const uint64_t *values, size_t n_values) {
  const int status = sizes(self, "set", references, n, values, n_values);
  if (status || !n) return status;
  if (!pf_fmi_in(self, PF_FMI_CONFIGURATION, "set of the number of channels")) return PF_FMI_ERROR;
  for (size_t i = 0; i < n; i++)
    if (values[i] < 1 || values[i] > pf_fmu_here.most_channels)
      return pf_fmi_say(self, PF_FMI_ERROR, "set: %llu channels; expected 1 to %lu", (unsigned long long)values[i],
                        (unsigned long)pf_fmu_here.most_channels);
  self->saved->channels = (uint32_t)values[n - 1];
  self->fresh = 0;
  return PF_FMI_OK;
}

int pf_fmi_set_slopes(pf_fmi *self, const uint32_t *references, size_t n, const int *orders, const double *values) {
  if (n && (!references || !orders || !values)) return pf_fmi_say(self, PF_FMI_ERROR, "slopes: an argument is NULL");
  for (size_t i = 0; i < n; i++) {
    const uint32_t reference = references[i];
    if (!pf_fmi_exists(reference) || pf_fmu_here.variables[reference].kind != PF_FMI_INPUT)
      return wrong(self, "slopes", reference, "is no input");
    if (orders[i] != 1) return wrong(self, "slopes", reference, "has derivatives of order 1 only");
    if (values[i] - values[i] != 0) return wrong(self, "slopes", reference, "cannot have a slope that is not finite");
  }
  if (!self->saved->sloped) memset(self->slopes, 0, (size_t)self->model->n_u * sizeof(pf_real));
  self->saved->sloped = 1;
  for (size_t i = 0; i < n; i++) self->slopes[pf_fmu_here.variables[references[i]].first] = values[i];
  return PF_FMI_OK;
}
