/* A ball that bounces, with every kind of event, as a model-exchange FMU of FMI 2.0 or 3.0 (-DFMI=2 or 3).
 *
 * State event: h <= 0 while it falls turns v into -e v. Time events: every `tick` seconds `ticks` grows by one, in two
 * iterations. Step event: the first completed step after `from` asks for one, which sets `noticed`. At `last` ticks it
 * asks to end the run. The input `push` accelerates. What FMI forbids is answered by Error: a time beyond the announced
 * event, calls in a wrong mode. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#if FMI == 2
#include "fmi2FunctionTypes.h"
#define OK fmi2OK
#define BAD fmi2Error
typedef fmi2Status Status;
typedef fmi2Component Self;
typedef fmi2ValueReference Ref;
typedef fmi2Boolean Bool;
#define F(name) fmi2##name
#else
#include "fmi3FunctionTypes.h"
#define OK fmi3OK
#define BAD fmi3Error
typedef fmi3Status Status;
typedef fmi3Instance Self;
typedef fmi3ValueReference Ref;
typedef fmi3Boolean Bool;
#define F(name) fmi3##name
#endif
#define EXPORT __attribute__((visibility("default")))
/* Functions this FMU has no use for; importers look all of them up. */
#define REFUSE(name) \
  EXPORT int F(name)(void) { return BAD; }

enum { TIME, H, V, DH, DV, PUSH, G, E, TICK, FROM, LAST, TICKS, NOTICED, ENERGY };
enum { FRESH, INITIALISING, EVENT, CONTINUOUS, ENDED };

typedef struct {
  double time, h, v, push, g, e, tick, from, next;
  int ticks, last, noticed, wants, mode, again;
} Ball;

static void fresh(Ball *b) {
  memset(b, 0, sizeof *b);
  b->h = 1.0;
  b->g = 9.81;
  b->e = 0.7;
  b->tick = 0.25;
  b->from = 0.1;
  b->last = 1000;
  b->next = HUGE_VAL;
}

static Status get_real(Ball *b, Ref reference, double *value) {
  switch (reference) {
  case TIME: *value = b->time; break;
  case H: *value = b->h; break;
  case V: case DH: *value = b->v; break;
  case DV: *value = b->push - b->g; break;
  case PUSH: *value = b->push; break;
  case G: *value = b->g; break;
  case E: *value = b->e; break;
  case TICK: *value = b->tick; break;
  case FROM: *value = b->from; break;
  case ENERGY: *value = b->g * b->h + 0.5 * b->v * b->v; break;
  default: return BAD;
  }
  return OK;
}

static Status set_real(Ball *b, Ref reference, double value) {
  const int starting = b->mode == FRESH || b->mode == INITIALISING;
  switch (reference) {
  case PUSH: b->push = value; return OK;
  case H: b->h = value; break;
  case V: b->v = value; break;
  case G: b->g = value; break;
  case E: b->e = value; break;
  case TICK: b->tick = value; break;
  case FROM: b->from = value; break;
  default: return BAD;
  }
  return starting ? OK : BAD;
}

static Status get_int(Ball *b, Ref reference, int *value) {
  if (reference == TICKS) *value = b->ticks;
  else if (reference == NOTICED) *value = b->noticed;
  else if (reference == LAST) *value = b->last;
  else return BAD;
  return OK;
}

static Status set_int(Ball *b, Ref reference, int value) {
  if (reference != LAST || b->mode != FRESH) return BAD;
  b->last = value;
  return OK;
}

/* One event iteration; the second of two leaves nothing to do. */
static Status update(Ball *b, int *again, int *end) {
  if (b->mode != EVENT) return BAD;
  *again = *end = 0;
  if (b->again) {
    b->again = 0;
    b->ticks++;
    b->next += b->tick;
    if (b->ticks >= b->last) {
      *end = 1;
      b->mode = ENDED;
    }
    return OK;
  }
  if (b->next == HUGE_VAL) b->next = b->time + b->tick;
  if (b->h <= 0.0 && b->v < 0.0) {
    b->h = 0.0;
    b->v = -b->e * b->v;
  }
  if (b->wants) {
    b->wants = 0;
    b->noticed++;
  }
  if (b->time == b->next) *again = b->again = 1;
  else if (b->time > b->next) return BAD;
  return OK;
}

static Status completed(Ball *b, int *event, int *end) {
  if (b->mode != CONTINUOUS) return BAD;
  if (!b->noticed && b->time > b->from) b->wants = 1;
  *event = b->wants;
  *end = 0;
  return OK;
}

static Status mode(Self c, int from, int to) {
  Ball *b = c;
  if (b->mode != from) return BAD;
  b->mode = to;
  return OK;
}

/* Its events are part of the state. */
static Status take(Self c, void **state) {
  if (!*state) *state = malloc(sizeof(Ball));
  memcpy(*state, c, sizeof(Ball));
  return OK;
}

static Status put_back(Self c, void *state) {
  memcpy(c, state, sizeof(Ball));
  return OK;
}

static Status forget(Self c, void **state) {
  (void)c;
  free(*state);
  *state = NULL;
  return OK;
}

EXPORT Status F(EnterEventMode)(Self c) { return mode(c, CONTINUOUS, EVENT); }
EXPORT Status F(EnterContinuousTimeMode)(Self c) { return mode(c, EVENT, CONTINUOUS); }
EXPORT Status F(ExitInitializationMode)(Self c) { return mode(c, INITIALISING, EVENT); }
EXPORT Status F(Terminate)(Self c) { return c ? OK : BAD; }
EXPORT void F(FreeInstance)(Self c) { free(c); }

EXPORT Status F(Reset)(Self c) {
  fresh(c);
  return OK;
}

EXPORT Status F(SetTime)(Self c, double time) {
  Ball *b = c;
  if (b->mode != CONTINUOUS || time > b->next) return BAD;
  b->time = time;
  return OK;
}

EXPORT Status F(SetContinuousStates)(Self c, const double x[], size_t n) {
  Ball *b = c;
  if (b->mode != CONTINUOUS || n != 2) return BAD;
  b->h = x[0];
  b->v = x[1];
  return OK;
}

EXPORT Status F(GetContinuousStates)(Self c, double x[], size_t n) {
  if (n != 2) return BAD;
  x[0] = ((Ball *)c)->h;
  x[1] = ((Ball *)c)->v;
  return OK;
}

EXPORT Status F(GetNominalsOfContinuousStates)(Self c, double x[], size_t n) {
  (void)c;
  for (size_t i = 0; i < n; i++) x[i] = 1.0;
  return OK;
}

EXPORT Status F(GetEventIndicators)(Self c, double z[], size_t n) {
  const Ball *b = c;
  if (n != 1) return BAD;
  /* On the ground and going up it is above it. */
  z[0] = b->h == 0.0 && b->v > 0.0 ? 1e-300 : b->h;
  return OK;
}

#if FMI == 2
EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

EXPORT fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
  (void)name, (void)type, (void)guid, (void)resources, (void)callbacks, (void)visible, (void)logging;
  Ball *b = malloc(sizeof *b);
  fresh(b);
  return b;
}

EXPORT fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean td, fmi2Real tolerance, fmi2Real start, fmi2Boolean sd,
                               fmi2Real stop) {
  (void)td, (void)tolerance, (void)sd, (void)stop;
  ((Ball *)c)->time = start;
  return OK;
}

EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return mode(c, FRESH, INITIALISING); }

EXPORT fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) {
  (void)n;
  get_real(c, DH, dx);
  return get_real(c, DV, dx + 1);
}

EXPORT fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
  int again = 0, end = 0;
  const Status status = update(c, &again, &end);
  memset(info, 0, sizeof *info);
  info->newDiscreteStatesNeeded = again;
  info->terminateSimulation = end;
  info->valuesOfContinuousStatesChanged = fmi2True;
  info->nextEventTimeDefined = fmi2True;
  info->nextEventTime = ((Ball *)c)->next;
  return status;
}

EXPORT fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean prior, fmi2Boolean *event, fmi2Boolean *end) {
  (void)prior;
  return completed(c, event, end);
}

#define ACCESS(kind, type, one)                                                                                        \
  EXPORT fmi2Status fmi2Get##kind(fmi2Component c, const fmi2ValueReference vr[], size_t n, type value[]) {                   \
    for (size_t i = 0; i < n; i++)                                                                                     \
      if (get_##one(c, vr[i], &value[i]) != OK) return BAD;                                                            \
    return OK;                                                                                                         \
  }                                                                                                                    \
  EXPORT fmi2Status fmi2Set##kind(fmi2Component c, const fmi2ValueReference vr[], size_t n, const type value[]) {             \
    for (size_t i = 0; i < n; i++)                                                                                     \
      if (set_##one(c, vr[i], value[i]) != OK) return BAD;                                                             \
    return OK;                                                                                                         \
  }
ACCESS(Real, fmi2Real, real)
ACCESS(Integer, fmi2Integer, int)
EXPORT Status fmi2GetFMUstate(Self c, void **state) { return take(c, state); }
EXPORT Status fmi2SetFMUstate(Self c, void *state) { return put_back(c, state); }
EXPORT Status fmi2FreeFMUstate(Self c, void **state) { return forget(c, state); }
REFUSE(SetDebugLogging) REFUSE(GetBoolean) REFUSE(SetBoolean) REFUSE(GetString) REFUSE(SetString)
REFUSE(SerializedFMUstateSize) REFUSE(SerializeFMUstate)
REFUSE(DeSerializeFMUstate) REFUSE(GetDirectionalDerivative)
#else
EXPORT const char *fmi3GetVersion(void) { return "3.0"; }

EXPORT fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                                 fmi3Boolean visible, fmi3Boolean logging,
                                                 fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
  (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
  Ball *b = malloc(sizeof *b);
  fresh(b);
  return b;
}

EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean td, fmi3Float64 tolerance, fmi3Float64 start,
                                              fmi3Boolean sd, fmi3Float64 stop) {
  (void)td, (void)tolerance, (void)sd, (void)stop;
  ((Ball *)c)->time = start;
  return mode(c, FRESH, INITIALISING);
}

EXPORT fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 dx[], size_t n) {
  (void)n;
  get_real(c, DH, dx);
  return get_real(c, DV, dx + 1);
}

EXPORT fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *end, fmi3Boolean *nominals,
                                           fmi3Boolean *values, fmi3Boolean *timed, fmi3Float64 *next) {
  int more = 0, over = 0;
  const Status status = update(c, &more, &over);
  *again = more;
  *end = over;
  *nominals = fmi3False;
  *values = *timed = fmi3True;
  *next = ((Ball *)c)->next;
  return status;
}

EXPORT fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean prior, fmi3Boolean *event, fmi3Boolean *end) {
  int wants = 0, over = 0;
  (void)prior;
  const Status status = completed(c, &wants, &over);
  *event = wants;
  *end = over;
  return status;
}

EXPORT fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) {
  (void)c;
  *n = 1;
  return OK;
}

EXPORT fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) {
  (void)c;
  *n = 2;
  return OK;
}

#define ACCESS(kind, type, one)                                                                                        \
  EXPORT fmi3Status fmi3Get##kind(fmi3Instance c, const fmi3ValueReference vr[], size_t n, type value[], size_t m) {   \
    for (size_t i = 0; i < n && i < m; i++)                                                                            \
      if (get_##one(c, vr[i], &value[i]) != OK) return BAD;                                                            \
    return OK;                                                                                                         \
  }                                                                                                                    \
  EXPORT fmi3Status fmi3Set##kind(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const type value[],         \
                                  size_t m) {                                                                          \
    for (size_t i = 0; i < n && i < m; i++)                                                                            \
      if (set_##one(c, vr[i], value[i]) != OK) return BAD;                                                             \
    return OK;                                                                                                         \
  }
ACCESS(Float64, fmi3Float64, real)
ACCESS(Int32, fmi3Int32, int)
EXPORT Status fmi3GetFMUState(Self c, void **state) { return take(c, state); }
EXPORT Status fmi3SetFMUState(Self c, void *state) { return put_back(c, state); }
EXPORT Status fmi3FreeFMUState(Self c, void **state) { return forget(c, state); }
REFUSE(SetDebugLogging) REFUSE(InstantiateCoSimulation) REFUSE(InstantiateScheduledExecution) REFUSE(GetFloat32)
REFUSE(GetInt8) REFUSE(GetUInt8) REFUSE(GetInt16) REFUSE(GetUInt16) REFUSE(GetUInt32) REFUSE(GetInt64)
REFUSE(GetUInt64) REFUSE(GetBoolean) REFUSE(GetString) REFUSE(GetBinary) REFUSE(GetClock) REFUSE(SetFloat32)
REFUSE(SetInt8) REFUSE(SetUInt8) REFUSE(SetInt16) REFUSE(SetUInt16) REFUSE(SetUInt32) REFUSE(SetInt64)
REFUSE(SetUInt64) REFUSE(SetBoolean) REFUSE(SetString) REFUSE(SetBinary) REFUSE(SetClock)
REFUSE(GetNumberOfVariableDependencies) REFUSE(GetVariableDependencies)
REFUSE(SerializedFMUStateSize) REFUSE(SerializeFMUState) REFUSE(DeserializeFMUState)
REFUSE(GetDirectionalDerivative) REFUSE(GetAdjointDerivative) REFUSE(EnterConfigurationMode)
REFUSE(ExitConfigurationMode) REFUSE(GetIntervalDecimal) REFUSE(GetIntervalFraction) REFUSE(GetShiftDecimal)
REFUSE(GetShiftFraction) REFUSE(SetIntervalDecimal) REFUSE(SetIntervalFraction) REFUSE(SetShiftDecimal)
REFUSE(SetShiftFraction) REFUSE(EvaluateDiscreteStates) REFUSE(EnterStepMode) REFUSE(GetOutputDerivatives)
REFUSE(DoStep) REFUSE(ActivateModelPartition)
#endif
