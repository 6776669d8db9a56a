/* An FMU of FMI 3.0 with clocks of every kind, as model exchange, in co-simulation with Event Mode and in scheduled
 * execution. x' = u; at `jump_at` x jumps by 1 (a time event, or an early return). Clocks: `fast` every 0.1 s from 0 on,
 * `slow` with intervals 0.2, 0.3, 0.4, ... s that it tells as it ticks, `soon` once 0.05 s after the third tick of
 * `fast`, `hand` triggered from outside, `own` with an interval that the importer sets, and `rings`, which the FMU ticks
 * itself with every fifth tick. `sample` belongs to `fast`, `level` is a discrete input. What FMI forbids is answered by
 * Error: ticks that are none or left out, values set in a wrong mode. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3FunctionTypes.h"

#define EXPORT __attribute__((visibility("default")))
/* Functions this FMU has no use for; importers look all of them up. */
#define REFUSE(name) \
  EXPORT int fmi3##name(void) { return fmi3Error; }

enum { TIME, X, DX, U, SAMPLE, LEVEL, HELD, SEEN, JUMP_AT, TICKS, FAST = 20, SLOW, SOON, HAND, OWN, RINGS };
enum { CLOCKS = 6 };
enum { FRESH, INITIALISING, EVENT, CONTINUOUS, STEPPING, SCHEDULED };
enum { ME, CS, SE };

typedef struct {
  double time, x, u, sample, held, jump_at, next[CLOCKS], own_interval, told[CLOCKS];
  int level, seen, ticks[CLOCKS], active[CLOCKS], qualifier[CLOCKS], jumped, mode, kind, total;
  fmi3IntermediateUpdateCallback tell;
  fmi3ClockUpdateCallback clocks;
  fmi3InstanceEnvironment environment;
} Model;

static void fresh(Model *m) {
  const Model kept = *m;
  memset(m, 0, sizeof *m);
  m->kind = kept.kind;
  m->tell = kept.tell;
  m->clocks = kept.clocks;
  m->environment = kept.environment;
  m->jump_at = 1e300;
  for (int i = 0; i < CLOCKS; i++) m->next[i] = HUGE_VAL;
}

static int clock_of(fmi3ValueReference reference) {
  return reference >= FAST && reference <= RINGS ? (int)(reference - FAST) : -1;
}

static int same(double a, double b) { return fabs(a - b) < 1e-9; }

/* What a tick does. */
static int tick(Model *m, int i) {
  if (i == RINGS - FAST || (i != HAND - FAST && !same(m->time, m->next[i]))) return 0;
  m->ticks[i]++;
  m->total++;
  if (i == FAST - FAST) {
    m->held = m->sample;
    m->next[i] = 0.1 * m->ticks[i];
    if (m->ticks[i] == 3) {
      m->told[SOON - FAST] = 0.05;
      m->next[SOON - FAST] = m->time + 0.05;
      m->qualifier[SOON - FAST] = fmi3IntervalChanged;
    }
  } else if (i == SLOW - FAST) {
    m->told[i] = 0.1 * (m->ticks[i] + 1);
    m->next[i] += m->told[i];
    m->qualifier[i] = fmi3IntervalChanged;
  } else if (i == OWN - FAST) {
    m->next[i] += m->own_interval;
  } else {
    m->next[i] = HUGE_VAL;
  }
  if (m->total % 5 == 0) {
    m->active[RINGS - FAST] = 1;
    m->ticks[RINGS - FAST]++;
  }
  return 1;
}

static double first_tick(const Model *m) {
  double first = HUGE_VAL;
  for (int i = 0; i < CLOCKS; i++) first = fmin(first, m->next[i]);
  return first;
}

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }

static fmi3Instance made(fmi3String token, int kind) {
  if (strcmp(token, "clocks") != 0) return NULL;
  Model *m = calloc(1, sizeof *m);
  m->kind = kind;
  fresh(m);
  return m;
}

EXPORT fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                                 fmi3Boolean visible, fmi3Boolean logging,
                                                 fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
  (void)name, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
  return made(token, ME);
}

EXPORT fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                                fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean events,
                                                fmi3Boolean early, const fmi3ValueReference required[], size_t n,
                                                fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                                fmi3IntermediateUpdateCallback intermediate) {
  (void)name, (void)resources, (void)visible, (void)logging, (void)required, (void)n, (void)log;
  Model *m = events && early ? made(token, CS) : NULL;
  if (m) m->tell = intermediate, m->environment = environment;
  return m;
}

EXPORT fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                                      fmi3Boolean visible, fmi3Boolean logging,
                                                      fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                                      fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
                                                      fmi3UnlockPreemptionCallback unlock) {
  (void)name, (void)resources, (void)visible, (void)logging, (void)log;
  Model *m = made(token, SE);
  if (m) m->clocks = update, m->environment = environment;
  lock();
  unlock();
  return m;
}

EXPORT void fmi3FreeInstance(fmi3Instance c) { free(c); }

static fmi3Status mode(fmi3Instance c, int from, int to) {
  Model *m = c;
  if (m->mode != from) return fmi3Error;
  m->mode = to;
  return fmi3OK;
}

EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean td, fmi3Float64 tolerance,
                                              fmi3Float64 start, fmi3Boolean sd, fmi3Float64 stop) {
  (void)td, (void)tolerance, (void)sd, (void)stop;
  Model *m = c;
  m->time = m->next[FAST - FAST] = start;
  m->next[SLOW - FAST] = start + 0.2;
  m->told[SLOW - FAST] = 0.2;
  m->qualifier[SLOW - FAST] = fmi3IntervalChanged;
  return mode(c, FRESH, INITIALISING);
}

EXPORT fmi3Status fmi3ExitInitializationMode(fmi3Instance c) {
  return mode(c, INITIALISING, ((Model *)c)->kind == SE ? SCHEDULED : EVENT);
}
EXPORT fmi3Status fmi3EnterEventMode(fmi3Instance c) {
  return mode(c, ((Model *)c)->kind == CS ? STEPPING : CONTINUOUS, EVENT);
}
EXPORT fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) { return mode(c, EVENT, CONTINUOUS); }
EXPORT fmi3Status fmi3EnterStepMode(fmi3Instance c) { return mode(c, EVENT, STEPPING); }
EXPORT fmi3Status fmi3Terminate(fmi3Instance c) { return c ? fmi3OK : fmi3Error; }
EXPORT fmi3Status fmi3Reset(fmi3Instance c) { return fresh(c), fmi3OK; }

EXPORT fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 value[],
                                 size_t room) {
  const Model *m = c;
  for (size_t i = 0; i < n && i < room; i++) {
    switch (vr[i]) {
    case TIME: value[i] = m->time; break;
    case X: value[i] = m->x; break;
    case DX: case U: value[i] = m->u; break;
    case SAMPLE: value[i] = m->sample; break;
    case HELD: value[i] = m->held; break;
    case JUMP_AT: value[i] = m->jump_at; break;
    default: return fmi3Error;
    }
  }
  return fmi3OK;
}

EXPORT fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 value[],
                                 size_t room) {
  Model *m = c;
  for (size_t i = 0; i < n && i < room; i++) {
    if (vr[i] == U) m->u = value[i];
    else if (vr[i] == JUMP_AT && m->mode == FRESH) m->jump_at = value[i];
    else if (vr[i] == X && m->mode == FRESH) m->x = value[i];
    else if (vr[i] == SAMPLE && ((m->mode == EVENT && m->active[FAST - FAST]) || m->kind == SE)) m->sample = value[i];
    else return fmi3Error;
  }
  return fmi3OK;
}

EXPORT fmi3Status fmi3GetInt32(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Int32 value[],
                               size_t room) {
  const Model *m = c;
  for (size_t i = 0; i < n; i++) {
    if (vr[i] == TICKS && room - i >= CLOCKS) return memcpy(value + i, m->ticks, sizeof m->ticks), fmi3OK;
    if (vr[i] != LEVEL && vr[i] != SEEN) return fmi3Error;
    value[i] = vr[i] == LEVEL ? m->level : m->seen;
  }
  return fmi3OK;
}

EXPORT fmi3Status fmi3SetInt32(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Int32 value[],
                               size_t room) {
  Model *m = c;
  if (n != 1 || room != 1 || vr[0] != LEVEL || m->mode == CONTINUOUS || m->mode == STEPPING) return fmi3Error;
  m->seen += m->mode != FRESH && m->mode != INITIALISING && value[0] != m->level;
  m->level = value[0];
  return fmi3OK;
}

EXPORT fmi3Status fmi3SetClock(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Clock value[]) {
  Model *m = c;
  if (m->mode != EVENT) return fmi3Error;
  for (size_t i = 0; i < n; i++) {
    const int clock = clock_of(vr[i]);
    if (clock < 0 || vr[i] == RINGS || (vr[i] != HAND && !same(m->time, m->next[clock]))) return fmi3Error;
    m->active[clock] = value[i];
  }
  return fmi3OK;
}

EXPORT fmi3Status fmi3GetClock(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Clock value[]) {
  Model *m = c;
  for (size_t i = 0; i < n; i++) {
    if (vr[i] != RINGS) return fmi3Error;
    value[i] = m->active[RINGS - FAST];
    m->active[RINGS - FAST] = 0;
  }
  return fmi3OK;
}

EXPORT fmi3Status fmi3GetIntervalDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n,
                                         fmi3Float64 interval[], fmi3IntervalQualifier qualifier[]) {
  Model *m = c;
  for (size_t i = 0; i < n; i++) {
    const int clock = clock_of(vr[i]);
    if (clock != SLOW - FAST && clock != SOON - FAST) return fmi3Error;
    interval[i] = m->told[clock];
    qualifier[i] = (fmi3IntervalQualifier)m->qualifier[clock];
    if (qualifier[i] == fmi3IntervalChanged) m->qualifier[clock] = fmi3IntervalUnchanged;
  }
  return fmi3OK;
}

EXPORT fmi3Status fmi3SetIntervalDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n,
                                         const fmi3Float64 interval[]) {
  Model *m = c;
  if (n != 1 || vr[0] != OWN || m->mode != INITIALISING) return fmi3Error;
  m->own_interval = interval[0];
  m->next[OWN - FAST] = m->time;
  return fmi3OK;
}

EXPORT fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *end, fmi3Boolean *nominals,
                                           fmi3Boolean *values, fmi3Boolean *timed, fmi3Float64 *next) {
  Model *m = c;
  *again = *end = *nominals = *values = *timed = fmi3False;
  if (m->mode != EVENT) return fmi3Error;
  if (m->kind == ME && m->time > first_tick(m) + 1e-9) return fmi3Error;
  for (int i = 0; i < RINGS - FAST; i++)
    if (m->active[i]) {
      m->active[i] = 0;
      if (!tick(m, i)) return fmi3Error;
      *again = fmi3True; /* what rings is heard in the next iteration */
    }
  if (!m->jumped && m->time >= m->jump_at) {
    m->jumped = 1;
    m->x += 1.0;
    *values = fmi3True;
  }
  *timed = !m->jumped && m->jump_at < 1e300;
  *next = m->jump_at;
  return fmi3OK;
}

/* Told of halfway too; a step past the jump returns there. */
EXPORT fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean final, fmi3Boolean *event,
                             fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *reached) {
  Model *m = c;
  (void)final;
  *event = *end = *early = fmi3False;
  if (m->mode != STEPPING || !same(t, m->time) || t + h > first_tick(m) + 1e-9 || first_tick(m) < t + 1e-9)
    return fmi3Error;
  const double half = t + 0.5 * h, x = m->x;
  if (m->tell && !(!m->jumped && m->jump_at <= t + h)) {
    fmi3Boolean wants = fmi3False;
    double at = 0.0;
    m->x = x + 0.5 * h * m->u;
    m->tell(m->environment, half, fmi3False, fmi3True, fmi3False, fmi3False, &wants, &at);
    m->x = x;
  }
  *event = !m->jumped && m->jump_at <= t + h;
  *early = *event && m->jump_at < t + h;
  *reached = *early ? m->jump_at : t + h;
  m->x += (*reached - t) * m->u;
  m->time = *reached;
  return fmi3OK;
}

EXPORT fmi3Status fmi3ActivateModelPartition(fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time) {
  Model *m = c;
  if (m->mode != SCHEDULED || clock_of(clock) < 0 || time > first_tick(m) + 1e-9) return fmi3Error;
  m->time = time;
  if (!tick(m, clock_of(clock))) return fmi3Error;
  if (m->qualifier[SOON - FAST] == fmi3IntervalChanged || m->active[RINGS - FAST]) m->clocks(m->environment);
  return fmi3OK;
}

EXPORT fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time) {
  Model *m = c;
  if (m->mode != CONTINUOUS || time > first_tick(m) + 1e-9) return fmi3Error;
  m->time = time;
  return fmi3OK;
}

EXPORT fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) {
  if (n != 1 || ((Model *)c)->mode != CONTINUOUS) return fmi3Error;
  ((Model *)c)->x = x[0];
  return fmi3OK;
}

EXPORT fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
  return n == 1 ? (x[0] = ((Model *)c)->x, fmi3OK) : fmi3Error;
}

EXPORT fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 dx[], size_t n) {
  return n == 1 ? (dx[0] = ((Model *)c)->u, fmi3OK) : fmi3Error;
}

EXPORT fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean final, fmi3Boolean *event,
                                              fmi3Boolean *end) {
  (void)c, (void)final;
  *event = *end = fmi3False;
  return fmi3OK;
}

EXPORT fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state) {
  if (!*state) *state = malloc(sizeof(Model));
  memcpy(*state, c, sizeof(Model));
  return fmi3OK;
}

EXPORT fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state) { return memcpy(c, state, sizeof(Model)), fmi3OK; }

EXPORT fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state) {
  (void)c;
  free(*state);
  *state = NULL;
  return fmi3OK;
}

REFUSE(SetDebugLogging) REFUSE(GetFloat32) REFUSE(GetInt8) REFUSE(GetUInt8) REFUSE(GetInt16) REFUSE(GetUInt16)
REFUSE(GetUInt32) REFUSE(GetInt64) REFUSE(GetUInt64) REFUSE(GetBoolean) REFUSE(GetString) REFUSE(GetBinary)
REFUSE(SetFloat32) REFUSE(SetInt8) REFUSE(SetUInt8) REFUSE(SetInt16) REFUSE(SetUInt16) REFUSE(SetUInt32)
REFUSE(SetInt64) REFUSE(SetUInt64) REFUSE(SetBoolean) REFUSE(SetString) REFUSE(SetBinary)
REFUSE(GetNumberOfVariableDependencies) REFUSE(GetVariableDependencies) REFUSE(SerializedFMUStateSize)
REFUSE(SerializeFMUState) REFUSE(DeserializeFMUState) REFUSE(GetDirectionalDerivative) REFUSE(GetAdjointDerivative)
REFUSE(EnterConfigurationMode) REFUSE(ExitConfigurationMode) REFUSE(GetIntervalFraction) REFUSE(GetShiftDecimal)
REFUSE(GetShiftFraction) REFUSE(SetIntervalFraction) REFUSE(SetShiftDecimal) REFUSE(SetShiftFraction)
REFUSE(EvaluateDiscreteStates) REFUSE(GetEventIndicators) REFUSE(GetNominalsOfContinuousStates)
REFUSE(GetNumberOfContinuousStates) REFUSE(GetNumberOfEventIndicators) REFUSE(GetOutputDerivatives)
