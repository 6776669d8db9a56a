/* An FMU of FMI 3.0 with a variable of every type, and arrays as long as a structural parameter says. Each output is
 * what its input is; text and blob are passed on by the next step only. x' = a. */
#include "fmi3FunctionTypes.h"
#include <stdlib.h>
#include <string.h>

#define EXPORT __attribute__((visibility("default")))
#define REFUSE(name) \
  EXPORT int name(void) { return fmi3Error; }
#define ACCEPT(name)                       \
  EXPORT fmi3Status name(fmi3Instance c) { \
    return c ? fmi3OK : fmi3Error;         \
  }
enum { MOST = 5, ROOM = 32, CHANNELS = 1, A = 2, X = 3, DX = 4, SUM = 5, GAIN = 6, ENUMERATION = 13 };

/* Of type i: parameter 10 i, input 10 i + 1, output 10 i + 2. */
typedef struct {
  double time, a[MOST], x[MOST], gain[MOST];
  fmi3UInt64 n;
  int configuring;
  unsigned char numbers[ENUMERATION][2][8];
  char text[3][ROOM], blob[3][ROOM];
  size_t sizes[3];
} Model;

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }

static void begin(Model *m) {
  memset(m, 0, sizeof *m);
  m->n = 2;
  for (int i = 0; i < MOST; i++) m->gain[i] = 1.0 + i, m->a[i] = 0.5 * (i + 1);
  strcpy(m->text[0], "as delivered");
}

EXPORT fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                                 fmi3Boolean visible, fmi3Boolean logging,
                                                 fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
  (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
  Model *m = malloc(sizeof *m);
  begin(m);
  return m;
}

EXPORT fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                                fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean events,
                                                fmi3Boolean early, const fmi3ValueReference required[], size_t n,
                                                fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                                fmi3IntermediateUpdateCallback intermediate) {
  (void)events, (void)early, (void)required, (void)n, (void)intermediate;
  return fmi3InstantiateModelExchange(name, token, resources, visible, logging, environment, log);
}

EXPORT void fmi3FreeInstance(fmi3Instance c) { free(c); }

EXPORT fmi3Status fmi3Reset(fmi3Instance c) {
  begin(c);
  return fmi3OK;
}

EXPORT fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) {
  ((Model *)c)->configuring = 1;
  return fmi3OK;
}

EXPORT fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) {
  ((Model *)c)->configuring = 0;
  return fmi3OK;
}

EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean td, fmi3Float64 tolerance, fmi3Float64 start,
                                              fmi3Boolean sd, fmi3Float64 stop) {
  (void)td, (void)tolerance, (void)sd, (void)stop;
  ((Model *)c)->time = start;
  return fmi3OK;
}

/* The value of a number of type `type`: parameter or input; outputs are inputs. */
static void *number(Model *m, unsigned reference, unsigned type) {
  const unsigned found = reference / 10;
  if ((found != type && !(type == 8 && found == ENUMERATION)) || reference % 10 > 2) return NULL;
  return m->numbers[found - 1][reference % 10 ? 1 : 0];
}

#define NUMBERS(TYPE, PLACE)                                                                                         \
  EXPORT fmi3Status fmi3Get##TYPE(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3##TYPE value[],         \
                                  size_t room) {                                                                       \
    for (size_t i = 0; i < n; i++) {                                                                                   \
      const void *const from = number(c, vr[i], PLACE);                                                                \
      if (!from || i >= room) return fmi3Error;                                                                        \
      memcpy(value + i, from, sizeof *value);                                                                          \
    }                                                                                                                  \
    return fmi3OK;                                                                                                     \
  }                                                                                                                    \
  EXPORT fmi3Status fmi3Set##TYPE(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3##TYPE value[],   \
                                  size_t room) {                                                                       \
    for (size_t i = 0; i < n; i++) {                                                                                   \
      void *const to = number(c, vr[i], PLACE);                                                                        \
      if (!to || i >= room) return fmi3Error;                                                                          \
      memcpy(to, value + i, sizeof *value);                                                                            \
    }                                                                                                                  \
    return fmi3OK;                                                                                                     \
  }
NUMBERS(Float32, 1)
NUMBERS(Int8, 2)
NUMBERS(UInt8, 3)
NUMBERS(Int16, 4)
NUMBERS(UInt16, 5)
NUMBERS(Int32, 6)
NUMBERS(UInt32, 7)
NUMBERS(Int64, 8)
NUMBERS(Boolean, 10)

EXPORT fmi3Status fmi3GetUInt64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3UInt64 value[],
                                size_t room) {
  for (size_t i = 0; i < n; i++) {
    const void *const from = vr[i] == CHANNELS ? &((Model *)c)->n : number(c, vr[i], 9);
    if (!from || i >= room) return fmi3Error;
    memcpy(value + i, from, sizeof *value);
  }
  return fmi3OK;
}

EXPORT fmi3Status fmi3SetUInt64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 value[],
                                size_t room) {
  Model *const m = c;
  for (size_t i = 0; i < n; i++) {
    if (i >= room || (vr[i] == CHANNELS && (!m->configuring || value[i] < 1 || value[i] > MOST))) return fmi3Error;
    void *const to = vr[i] == CHANNELS ? &m->n : number(m, vr[i], 9);
    if (!to) return fmi3Error;
    memcpy(to, value + i, sizeof *value);
  }
  return fmi3OK;
}

static double *numbers(Model *m, unsigned reference) {
  return reference == A || reference == DX ? m->a : reference == X ? m->x : reference == GAIN ? m->gain : NULL;
}

EXPORT fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 value[],
                                 size_t room) {
  Model *const m = c;
  size_t used = 0;
  for (size_t i = 0; i < n; i++) {
    const double *const from = numbers(m, vr[i]);
    if (vr[i] == SUM) {
      if (used >= room) return fmi3Error;
      value[used] = 0.0;
      for (fmi3UInt64 k = 0; k < m->n; k++) value[used] += m->gain[k] * m->x[k];
      used++;
    } else if (!from || room - used < m->n) {
      return fmi3Error;
    } else {
      memcpy(value + used, from, m->n * sizeof *value);
      used += m->n;
    }
  }
  return used == room ? fmi3OK : fmi3Error;
}

EXPORT fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 value[],
                                 size_t room) {
  Model *const m = c;
  size_t used = 0;
  for (size_t i = 0; i < n; i++) {
    double *const to = numbers(m, vr[i]);
    if (!to || room - used < m->n) return fmi3Error;
    memcpy(to, value + used, m->n * sizeof *value);
    used += m->n;
  }
  return used == room ? fmi3OK : fmi3Error;
}

/* 110: parameter, 111: input, 112: output of type String; 120 to 122 of type Binary. */
EXPORT fmi3Status fmi3GetString(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3String value[],
                                size_t room) {
  for (size_t i = 0; i < n; i++) {
    if (i >= room || vr[i] < 110 || vr[i] > 112) return fmi3Error;
    value[i] = ((Model *)c)->text[vr[i] - 110];
  }
  return fmi3OK;
}

EXPORT fmi3Status fmi3SetString(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3String value[],
                                size_t room) {
  for (size_t i = 0; i < n; i++) {
    if (i >= room || vr[i] < 110 || vr[i] > 111 || strlen(value[i]) >= ROOM) return fmi3Error;
    strcpy(((Model *)c)->text[vr[i] - 110], value[i]);
  }
  return fmi3OK;
}

EXPORT fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, size_t sizes[],
                                fmi3Binary value[], size_t room) {
  Model *const m = c;
  for (size_t i = 0; i < n; i++) {
    if (i >= room || vr[i] < 120 || vr[i] > 122) return fmi3Error;
    sizes[i] = m->sizes[vr[i] - 120];
    value[i] = sizes[i] ? (fmi3Binary)m->blob[vr[i] - 120] : NULL;
  }
  return fmi3OK;
}

EXPORT fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const size_t sizes[],
                                const fmi3Binary value[], size_t room) {
  Model *const m = c;
  for (size_t i = 0; i < n; i++) {
    if (i >= room || vr[i] < 120 || vr[i] > 121 || sizes[i] > ROOM) return fmi3Error;
    memcpy(m->blob[vr[i] - 120], value[i], sizes[i]);
    m->sizes[vr[i] - 120] = sizes[i];
  }
  return fmi3OK;
}

static void pass_on(Model *m) { /* the parameter in front of what came in: one letter more each time around */
  const size_t room = ROOM - 1, front = strlen(m->text[0]), length = strlen(m->text[1]);
  char joined[2 * ROOM];
  memcpy(joined, m->text[0], front);
  memcpy(joined + front, m->text[1], length + 1);
  joined[room] = 0;
  strcpy(m->text[2], joined);
  const size_t head = m->sizes[0], tail = m->sizes[1];
  memcpy(joined, m->blob[0], head);
  memcpy(joined + head, m->blob[1], tail);
  m->sizes[2] = head + tail > room ? room : head + tail;
  memcpy(m->blob[2], joined, m->sizes[2]);
}

EXPORT fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no_back, fmi3Boolean *event,
                             fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *reached) {
  Model *const m = c;
  (void)no_back;
  for (fmi3UInt64 i = 0; i < m->n; i++) m->x[i] += h * m->a[i];
  pass_on(m);
  *event = *terminate = *early = fmi3False;
  *reached = m->time = t + h;
  return fmi3OK;
}

EXPORT fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state) {
  if (!*state) *state = malloc(sizeof(Model));
  memcpy(*state, c, sizeof(Model));
  return fmi3OK;
}

EXPORT fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state) {
  memcpy(c, state, sizeof(Model));
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

EXPORT fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time) {
  ((Model *)c)->time = time;
  return fmi3OK;
}

EXPORT fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
  return fmi3GetFloat64(c, (const fmi3ValueReference[]){X}, 1, x, n);
}

EXPORT fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) {
  return fmi3SetFloat64(c, (const fmi3ValueReference[]){X}, 1, x, n);
}

EXPORT fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 dx[], size_t n) {
  return fmi3GetFloat64(c, (const fmi3ValueReference[]){DX}, 1, dx, n);
}

EXPORT fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) {
  *n = (size_t)((Model *)c)->n;
  return fmi3OK;
}

EXPORT fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[]) {
  (void)c, (void)on, (void)n, (void)categories;
  return fmi3OK;
}

EXPORT fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean no_back, fmi3Boolean *event,
                                              fmi3Boolean *end) {
  (void)c, (void)no_back;
  *event = *end = fmi3False;
  return fmi3OK;
}

ACCEPT(fmi3ExitInitializationMode)
ACCEPT(fmi3EnterEventMode)
ACCEPT(fmi3Terminate)
ACCEPT(fmi3EnterContinuousTimeMode)
ACCEPT(fmi3EnterStepMode)
/* Functions this FMU has no use for; importers look all of them up. */
REFUSE(fmi3InstantiateScheduledExecution)
REFUSE(fmi3GetClock) REFUSE(fmi3SetClock)
REFUSE(fmi3GetNumberOfVariableDependencies) REFUSE(fmi3GetVariableDependencies)
REFUSE(fmi3SerializedFMUStateSize) REFUSE(fmi3SerializeFMUState) REFUSE(fmi3DeserializeFMUState)
REFUSE(fmi3GetDirectionalDerivative) REFUSE(fmi3GetAdjointDerivative)
REFUSE(fmi3GetIntervalDecimal) REFUSE(fmi3GetIntervalFraction) REFUSE(fmi3GetShiftDecimal)
REFUSE(fmi3GetShiftFraction) REFUSE(fmi3SetIntervalDecimal) REFUSE(fmi3SetIntervalFraction)
REFUSE(fmi3SetShiftDecimal) REFUSE(fmi3SetShiftFraction)
REFUSE(fmi3EvaluateDiscreteStates) REFUSE(fmi3GetEventIndicators) REFUSE(fmi3GetOutputDerivatives)
REFUSE(fmi3GetNumberOfEventIndicators) REFUSE(fmi3GetNominalsOfContinuousStates)
REFUSE(fmi3ActivateModelPartition)
