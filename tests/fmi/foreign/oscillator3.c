/* The oscillators as an FMU of FMI 3.0 with array variables, model exchange and co-simulation. */
#include "fmi3FunctionTypes.h"
#include "oscillator.h"

#if defined _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
#define MODEL(c) (&((Instance *)(c))->m)
/* Functions this FMU has no use for; importers look all of them up. */
#define REFUSE(name) \
  EXPORT int name(void) { return fmi3Error; }
#define ACCEPT(name)                          \
  EXPORT fmi3Status name(fmi3Instance c) {    \
    return c ? fmi3OK : fmi3Error;            \
  }

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }

EXPORT fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[]) {
  (void)c, (void)on, (void)n, (void)categories;
  return fmi3OK;
}

static fmi3Instance instantiate(fmi3String name, fmi3String token, fmi3InstanceEnvironment environment,
                                fmi3LogMessageCallback log) {
  if (strcmp(token, "oscillator") != 0) {
    log(environment, fmi3Error, "error", "the token is another model's");
    return NULL;
  }
  Instance *self = calloc(1, sizeof *self);
  model_reset(&self->m);
  self->logger = *(void **)&log;
  self->environment = environment;
  strncpy(self->name, name, sizeof self->name - 1);
  return self;
}

EXPORT fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                                 fmi3Boolean visible, fmi3Boolean logging,
                                                 fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
  (void)resources, (void)visible, (void)logging;
  return instantiate(name, token, environment, log);
}

EXPORT fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                                fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean events,
                                                fmi3Boolean early, const fmi3ValueReference required[], size_t n,
                                                fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                                fmi3IntermediateUpdateCallback intermediate) {
  (void)resources, (void)visible, (void)logging, (void)events, (void)early, (void)required, (void)n,
      (void)intermediate;
  return instantiate(name, token, environment, log);
}

EXPORT void fmi3FreeInstance(fmi3Instance c) { free(c); }

EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean td, fmi3Float64 tolerance,
                                              fmi3Float64 start, fmi3Boolean sd, fmi3Float64 stop) {
  (void)td, (void)tolerance, (void)sd, (void)stop;
  MODEL(c)->time = start;
  return fmi3OK;
}

ACCEPT(fmi3ExitInitializationMode)
ACCEPT(fmi3EnterEventMode)
ACCEPT(fmi3Terminate)
ACCEPT(fmi3EnterContinuousTimeMode)
ACCEPT(fmi3EnterStepMode)

EXPORT fmi3Status fmi3Reset(fmi3Instance c) {
  model_reset(MODEL(c));
  return fmi3OK;
}

EXPORT fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 value[],
                                 size_t room) {
  size_t used = 0;
  for (size_t i = 0; i < n; i++) {
    double found[N];
    const int count = get(MODEL(c), vr[i], found);
    if (!count || used + (size_t)count > room) return fmi3Error;
    memcpy(value + used, found, (size_t)count * sizeof *value);
    used += (size_t)count;
  }
  return used == room ? fmi3OK : fmi3Error;
}

EXPORT fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 value[],
                                 size_t room) {
  size_t used = 0;
  if (ENDED(MODEL(c))) return fmi3Error;
  for (size_t i = 0; i < n; i++) {
    const int count = set(MODEL(c), vr[i], value + used);
    if (!count) return fmi3Error;
    used += (size_t)count;
  }
  return used == room ? fmi3OK : fmi3Error;
}

#define ONE(TYPE, REFERENCE, FIELD)                                                                                  \
  EXPORT fmi3Status fmi3Get##TYPE(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3##TYPE value[],         \
                                  size_t room) {                                                                       \
    if (n != 1 || room != 1 || vr[0] != REFERENCE) return fmi3Error;                                                   \
    value[0] = (fmi3##TYPE)MODEL(c)->FIELD;                                                                            \
    return fmi3OK;                                                                                                     \
  }                                                                                                                    \
  EXPORT fmi3Status fmi3Set##TYPE(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3##TYPE value[],   \
                                  size_t room) {                                                                       \
    if (n != 1 || room != 1 || vr[0] != REFERENCE) return fmi3Error;                                                   \
    MODEL(c)->FIELD = value[0];                                                                                        \
    return fmi3OK;                                                                                                     \
  }
ONE(Int32, COUNT, count)
ONE(Int8, TINY, tiny)
ONE(UInt8, POSITIVE, positive)
ONE(Int64, MODE, mode)
ONE(Boolean, FLAG, flag)

/* Of outputs by place: force alone moves with it. */
EXPORT fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknown[], size_t n,
                                               const fmi3ValueReference known[], size_t n_known,
                                               const fmi3Float64 seed[], size_t n_seed, fmi3Float64 value[],
                                               size_t room) {
  if (n_known != 1 || known[0] != PLACE || n_seed != N || room != n * N) return fmi3Error;
  for (size_t i = 0; i < room; i++) value[i] = unknown[i / N] == FORCE ? MODEL(c)->coupling * seed[i % N] : 0.0;
  return fmi3OK;
}

EXPORT fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference unknown[], size_t n,
                                           const fmi3ValueReference known[], size_t n_known, const fmi3Float64 seed[],
                                           size_t n_seed, fmi3Float64 value[], size_t room) {
  if (n_known != 1 || known[0] != PLACE || n_seed != n * N || room != N) return fmi3Error;
  for (size_t i = 0; i < N; i++) value[i] = 0.0;
  for (size_t i = 0; i < n_seed; i++)
    if (unknown[i / N] == FORCE) value[i % N] += MODEL(c)->coupling * seed[i];
  return fmi3OK;
}

EXPORT fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state) {
  if (!*state) *state = malloc(sizeof(Model));
  memcpy(*state, MODEL(c), sizeof(Model));
  return fmi3OK;
}

EXPORT fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state) {
  memcpy(MODEL(c), state, sizeof(Model));
  return fmi3OK;
}

EXPORT fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state) {
  (void)c;
  free(*state);
  *state = NULL;
  return fmi3OK;
}

EXPORT fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *end, fmi3Boolean *nominals,
                                           fmi3Boolean *values, fmi3Boolean *timed, fmi3Float64 *next) {
  (void)c, (void)next;
  *again = *end = *nominals = *values = *timed = fmi3False;
  return fmi3OK;
}

EXPORT fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean final, fmi3Boolean *event,
                                              fmi3Boolean *end) {
  (void)c, (void)final;
  *event = *end = fmi3False;
  return fmi3OK;
}

EXPORT fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time) {
  MODEL(c)->time = time;
  return fmi3OK;
}

EXPORT fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) {
  if (n != 2 * N) return fmi3Error;
  memcpy(MODEL(c)->x, x, N * sizeof *x);
  memcpy(MODEL(c)->v, x + N, N * sizeof *x);
  return fmi3OK;
}

EXPORT fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 dx[], size_t n) {
  if (n != 2 * N) return fmi3Error;
  rates(MODEL(c), dx, dx + N);
  return fmi3OK;
}

EXPORT fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
  if (n != 2 * N) return fmi3Error;
  memcpy(x, MODEL(c)->x, N * sizeof *x);
  memcpy(x + N, MODEL(c)->v, N * sizeof *x);
  return fmi3OK;
}

EXPORT fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
  (void)c;
  for (size_t i = 0; i < n; i++) x[i] = 1.0;
  return fmi3OK;
}

EXPORT fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) {
  (void)c;
  *n = 2 * N;
  return fmi3OK;
}

EXPORT fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) {
  (void)c;
  *n = 0;
  return fmi3OK;
}

EXPORT fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean final, fmi3Boolean *event,
                             fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *reached) {
  Instance *self = c;
  *event = *end = *early = fmi3False;
#ifdef TELLS
  fmi3LogMessageCallback tell;
  *(void **)&tell = self->logger;
  tell(self->environment, fmi3OK, "step", final ? "no way back" : "may go back");
#endif
  (void)final;
  if (t + h > FAIL_AT) {
    fmi3LogMessageCallback log;
    *(void **)&log = self->logger;
    log(self->environment, fmi3Error, "error", "spring broke");
    return fmi3Error;
  }
  if (h > DISCARD_ABOVE) return fmi3Discard;
  *end = t + h > ENDS_AT + 1e-9;
  *early = !*end && t < RETURNS_AT && t + h > RETURNS_AT;
  if (*end || *early) {
    *reached = *end ? ENDS_AT : RETURNS_AT;
    advance(&self->m, *reached - t);
    return fmi3OK;
  }
  mischief(&self->m, t + h);
  advance(&self->m, h);
  self->m.count++;
  *reached = t + h;
  *end = ENDED(&self->m);
  return fmi3OK;
}

REFUSE(fmi3InstantiateScheduledExecution)
REFUSE(fmi3GetFloat32) REFUSE(fmi3GetInt16) REFUSE(fmi3GetUInt16)
REFUSE(fmi3GetUInt32) REFUSE(fmi3GetUInt64) REFUSE(fmi3GetString)
REFUSE(fmi3GetBinary) REFUSE(fmi3GetClock)
REFUSE(fmi3SetFloat32) REFUSE(fmi3SetInt16) REFUSE(fmi3SetUInt16)
REFUSE(fmi3SetUInt32) REFUSE(fmi3SetUInt64)
REFUSE(fmi3SetString) REFUSE(fmi3SetBinary) REFUSE(fmi3SetClock)
REFUSE(fmi3GetNumberOfVariableDependencies) REFUSE(fmi3GetVariableDependencies)
REFUSE(fmi3SerializedFMUStateSize) REFUSE(fmi3SerializeFMUState) REFUSE(fmi3DeserializeFMUState)
REFUSE(fmi3EnterConfigurationMode) REFUSE(fmi3ExitConfigurationMode)
REFUSE(fmi3GetIntervalDecimal) REFUSE(fmi3GetIntervalFraction) REFUSE(fmi3GetShiftDecimal)
REFUSE(fmi3GetShiftFraction) REFUSE(fmi3SetIntervalDecimal) REFUSE(fmi3SetIntervalFraction)
REFUSE(fmi3SetShiftDecimal) REFUSE(fmi3SetShiftFraction)
REFUSE(fmi3EvaluateDiscreteStates) REFUSE(fmi3GetEventIndicators) REFUSE(fmi3GetOutputDerivatives)
REFUSE(fmi3ActivateModelPartition)
