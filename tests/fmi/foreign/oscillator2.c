/* The oscillator as an FMU of FMI 2.0, model exchange and co-simulation. */
#include "fmi2Functions.h"
#include "oscillator.h"

#ifndef FAILS_WITH
#define FAILS_WITH fmi2Error
#endif
#define MODEL(c) (&((Instance *)(c))->m)

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
  (void)c, (void)on, (void)n, (void)categories;
  return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
  (void)type, (void)resources, (void)visible, (void)logging;
  if (strcmp(guid, "oscillator") != 0) {
    callbacks->logger(callbacks->componentEnvironment, name, fmi2Error, "error", "guid is %s, not %s", guid, "oscillator");
    return NULL;
  }
  Instance *self = calloc(1, sizeof *self);
  model_reset(&self->m);
  self->logger = *(void **)&callbacks->logger;
  self->environment = callbacks->componentEnvironment;
  strncpy(self->name, name, sizeof self->name - 1);
  return self;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean td, fmi2Real tolerance, fmi2Real start, fmi2Boolean sd,
                               fmi2Real stop) {
  (void)td, (void)tolerance, (void)sd, (void)stop;
  MODEL(c)->time = start;
#ifdef TOLERANCE
  if (!td || tolerance != TOLERANCE) return fmi2Error;
#endif
  return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return c ? fmi2OK : fmi2Error; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
#ifdef WARNS
  Instance *self = c;
  const char *what = MODEL(c)->damping < 0 ? "no damping below 0" : MODEL(c)->stiffness > 5 ? "stiff spring" : NULL;
  if (MODEL(c)->damping < 0) MODEL(c)->damping = 0;
  if (what) {
    fmi2CallbackLogger log;
    *(void **)&log = self->logger;
    log(self->environment, self->name, fmi2Warning, "warning", "%s", what);
    return fmi2Warning;
  }
#endif
  return c ? fmi2OK : fmi2Error;
}
fmi2Status fmi2Terminate(fmi2Component c) { return c ? fmi2OK : fmi2Error; }

fmi2Status fmi2Reset(fmi2Component c) {
  model_reset(MODEL(c));
#ifdef RESETS_TO_0
  MODEL(c)->x[0] = 0;
#endif
  return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
  for (size_t i = 0; i < n; i++)
    if (!get(MODEL(c), vr[i], &value[i])) return fmi2Error;
  return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
  if (ENDED(MODEL(c))) return fmi2Error;
  for (size_t i = 0; i < n; i++)
    if (!set(MODEL(c), vr[i], &value[i])) return fmi2Error;
  return fmi2OK;
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[]) {
  for (size_t i = 0; i < n; i++) value[i] = vr[i] == COUNT ? MODEL(c)->count : 0;
  return fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[]) {
  for (size_t i = 0; i < n; i++)
    if (vr[i] == COUNT) MODEL(c)->count = value[i];
  return fmi2OK;
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[]) {
  (void)c, (void)vr, (void)value;
  return n ? fmi2Error : fmi2OK;
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[]) {
  (void)c, (void)vr, (void)value;
  return n ? fmi2Error : fmi2OK;
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]) {
  (void)c, (void)vr, (void)value;
  return n ? fmi2Error : fmi2OK;
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) {
  (void)c, (void)vr, (void)value;
  return n ? fmi2Error : fmi2OK;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
#ifdef NO_STATE
  (void)c, (void)state;
  return fmi2Error;
#else
  if (!*state) *state = malloc(sizeof(Model));
  memcpy(*state, MODEL(c), sizeof(Model));
  return fmi2OK;
#endif
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
#ifdef FORGETS
  const double x = MODEL(c)->x[0];
#endif
  memcpy(MODEL(c), state, sizeof(Model));
#ifdef FORGETS
  MODEL(c)->x[0] = x;
#endif
  return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
  Instance *self = c;
  if (self->dead) {
    fmi2CallbackLogger log;
    *(void **)&log = self->logger;
    log(self->environment, self->name, fmi2Error, "error", "called after a fatal error");
  }
  free(*state);
  *state = NULL;
  return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate s, size_t *n) {
  (void)c, (void)s, (void)n;
  return fmi2Error;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate s, fmi2Byte b[], size_t n) {
  (void)c, (void)s, (void)b, (void)n;
  return fmi2Error;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte b[], size_t n, fmi2FMUstate *s) {
  (void)c, (void)s, (void)b, (void)n;
  return fmi2Error;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference u[], size_t nu,
                                        const fmi2ValueReference k[], size_t nk, const fmi2Real dk[], fmi2Real du[]) {
  (void)c, (void)u, (void)nu, (void)k, (void)nk, (void)dk, (void)du;
  return fmi2Error;
}

fmi2Status fmi2EnterEventMode(fmi2Component c) { return c ? fmi2OK : fmi2Error; }

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
  (void)c;
  memset(info, 0, sizeof *info);
#ifdef EVENT_AT
  info->nextEventTimeDefined = fmi2True;
  info->nextEventTime = EVENT_AT;
#endif
  return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return c ? fmi2OK : fmi2Error; }

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean final, fmi2Boolean *event, fmi2Boolean *end) {
  (void)c, (void)final;
  *event = *end = fmi2False;
  return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
  MODEL(c)->time = time;
  return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
  if (n != 2) return fmi2Error;
  MODEL(c)->x[0] = x[0];
  MODEL(c)->v[0] = x[1];
  return fmi2OK;
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) {
  if (n != 2) return fmi2Error;
  rates(MODEL(c), &dx[0], &dx[1]);
  return fmi2OK;
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) {
  for (size_t i = 0; i < n; i++) z[i] = MODEL(c)->x[0];
  return fmi2OK;
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
  if (n != 2) return fmi2Error;
  x[0] = MODEL(c)->x[0];
  x[1] = MODEL(c)->v[0];
  return fmi2OK;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
  (void)c;
  for (size_t i = 0; i < n; i++) x[i] = 1.0;
  return fmi2OK;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[]) {
  if (n != 1 || vr[0] != PLACE || order[0] != 1) return fmi2Error;
  MODEL(c)->slope[0] = value[0];
  return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[]) {
  (void)c, (void)vr, (void)n, (void)order, (void)value;
  return fmi2Error;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean final) {
  (void)final;
  Instance *self = c;
  if (t + h > FAIL_AT) {
    fmi2CallbackLogger log;
    *(void **)&log = self->logger;
    log(self->environment, self->name, fmi2Error, "error", "spring broke at t = %g: %s", t, "too long");
    self->dead = FAILS_WITH == fmi2Fatal;
    return FAILS_WITH;
  }
  if (h > DISCARD_ABOVE) return fmi2Discard;
  if (t + h > ENDS_AT + 1e-9) {
    advance(&self->m, ENDS_AT - t);
    return fmi2Discard;
  }
  mischief(&self->m, t + h);
  advance(&self->m, h);
  self->m.count++;
  return ENDED(&self->m) ? fmi2Discard : fmi2OK;
}

fmi2Status fmi2CancelStep(fmi2Component c) {
  (void)c;
  return fmi2Error;
}

#define STATUS(name, type)                                                    \
  fmi2Status name(fmi2Component c, const fmi2StatusKind kind, type *value) {  \
    (void)c, (void)kind, (void)value;                                         \
    return fmi2Discard;                                                       \
  }
STATUS(fmi2GetStatus, fmi2Status)
STATUS(fmi2GetIntegerStatus, fmi2Integer)
STATUS(fmi2GetStringStatus, fmi2String)

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
  *value = kind == fmi2Terminated && (MODEL(c)->time >= ENDS_AT || ENDED(MODEL(c)));
  return fmi2OK;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
  *value = MODEL(c)->time;
  return kind == fmi2LastSuccessfulTime ? fmi2OK : fmi2Discard;
}
