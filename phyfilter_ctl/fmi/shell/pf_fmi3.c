/* FMI 3.0: the functions of the standard, on top of pf_fmi.h. */
#include "fmi3Functions.h"
#include "pf_fmi.h"

#define SELF                                \
  pf_fmi *const self = (pf_fmi *)instance;  \
  if (!self) return fmi3Error;

#define NOT_NULL(pointer, call) \
  if (!(pointer)) return (fmi3Status)pf_fmi_say(self, PF_FMI_ERROR, call ": an argument is NULL");

#define REFUSED(call) return (fmi3Status)pf_fmi_say(self, PF_FMI_ERROR, call ": not provided by this FMU")

const char *fmi3GetVersion(void) { return fmi3Version; }

/* ---- instances ---- */

static void log_message(pf_fmi *self, int status, const char *category, const char *message) {
  ((fmi3LogMessageCallback)self->callback)(self->environment, (fmi3Status)status, category, message);
}

static int pause(pf_fmi *self, pf_time t, pf_time *until) {
  fmi3Boolean back = fmi3False;
  fmi3Float64 when = *until;
  ((fmi3IntermediateUpdateCallback)self->intermediate)(self->environment, t, fmi3True, fmi3True, fmi3True,
                                                       self->saved->early_return != 0, &back, &when);
  if (!back || !self->saved->early_return) return 0;
  *until = when;
  return 1;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging_on, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log) {
  (void)resources;
  (void)visible;
  pf_fmi *const self = pf_fmi_new(name, token, PF_FMI_MODEL_EXCHANGE, (void (*)(void))log, environment, log_message);
  if (self) (void)pf_fmi_log_categories(self, logging_on, 0, NULL);
  return self;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging_on, fmi3Boolean event_mode, fmi3Boolean early_return,
                                         const fmi3ValueReference required[], size_t n_required,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback intermediate) {
  (void)resources;
  (void)visible;
  pf_fmi *const self = pf_fmi_new(name, token, PF_FMI_CO_SIMULATION, (void (*)(void))log, environment, log_message);
  if (!self) return NULL;
  (void)pf_fmi_log_categories(self, logging_on, 0, NULL);
  for (size_t i = 0; i < n_required; i++)
    if (!required || !pf_fmi_exists(required[i])) {
      pf_fmi_say(self, PF_FMI_ERROR, "instantiation refused: a required intermediate variable does not exist");
      pf_fmi_delete(self);
      return NULL;
    }
  self->saved->event_mode = event_mode;
  self->saved->early_return = early_return;
  self->intermediate = (void (*)(void))intermediate;
  self->pause = pause;
  return self;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean logging_on,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                               fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock) {
  (void)resources;
  (void)visible;
  (void)logging_on;
  (void)update;
  (void)lock;
  (void)unlock;
  return pf_fmi_new(name, token, 0, (void (*)(void))log, environment, log_message); /* logs, and is NULL */
}

void fmi3FreeInstance(fmi3Instance instance) {
  if (instance) pf_fmi_delete((pf_fmi *)instance);
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t n, const fmi3String categories[]) {
  SELF
  return (fmi3Status)pf_fmi_log_categories(self, on, n, categories);
}

/* ---- modes ---- */

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean stop_defined, fmi3Float64 stop) {
  SELF
  return (fmi3Status)pf_fmi_enter_initialization(self, tolerance_defined, tolerance, start, stop_defined, stop);
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
  SELF
  return (fmi3Status)pf_fmi_exit_initialization(self);
}

static fmi3Status enter(fmi3Instance instance, uint32_t from, uint32_t mode, const char *call) {
  SELF
  if (!pf_fmi_in(self, from, call)) return fmi3Error;
  if (pf_fmi_ticking(self)) self->fresh = 0;
  pf_fmi_end_ticks(self);
  self->saved->mode = mode;
  return fmi3OK;
}

fmi3Status fmi3EnterEventMode(fmi3Instance instance) {
  SELF
  const uint32_t from = PF_FMI_CONTINUOUS | PF_FMI_EVENT | (self->saved->event_mode ? PF_FMI_STEP : 0u);
  return enter(instance, from, PF_FMI_EVENT, "enterEventMode");
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance) {
  SELF
  const int exchange = self->saved->interface == PF_FMI_MODEL_EXCHANGE;
  return enter(instance, exchange ? PF_FMI_EVENT : 0, PF_FMI_CONTINUOUS, "enterContinuousTimeMode");
}

fmi3Status fmi3EnterStepMode(fmi3Instance instance) {
  SELF
  const int exchange = self->saved->interface == PF_FMI_MODEL_EXCHANGE;
  return enter(instance, exchange ? 0 : PF_FMI_EVENT, PF_FMI_STEP, "enterStepMode");
}

fmi3Status fmi3EnterConfigurationMode(fmi3Instance instance) {
  SELF
  if (!pf_fmu_here.channels) REFUSED("enterConfigurationMode");
  return enter(instance, PF_FMI_INSTANTIATED, PF_FMI_CONFIGURATION, "enterConfigurationMode");
}

fmi3Status fmi3ExitConfigurationMode(fmi3Instance instance) {
  SELF
  if (!pf_fmu_here.channels) REFUSED("exitConfigurationMode");
  return enter(instance, PF_FMI_CONFIGURATION, PF_FMI_INSTANTIATED, "exitConfigurationMode");
}

fmi3Status fmi3Terminate(fmi3Instance instance) {
  return enter(instance, PF_FMI_RUNNING, PF_FMI_TERMINATED, "terminate");
}

fmi3Status fmi3Reset(fmi3Instance instance) {
  SELF
  const uint32_t modes = (PF_FMI_ANY & ~(uint32_t)PF_FMI_INTERMEDIATE) | PF_FMI_CONFIGURATION;
  if (!pf_fmi_in(self, modes, "reset")) return fmi3Error;
  pf_fmi_reset(self);
  return fmi3OK;
}

/* ---- variables ---- */

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference refs[], size_t n, fmi3Float64 values[],
                          size_t n_values) {
  SELF
  return (fmi3Status)pf_fmi_get(self, refs, n, values, n_values);
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference refs[], size_t n, const fmi3Float64 values[],
                          size_t n_values) {
  SELF
  return (fmi3Status)pf_fmi_set(self, refs, n, values, n_values);
}

static fmi3Status no_variables(fmi3Instance instance, size_t n, const char *type) {
  SELF
  if (n) return (fmi3Status)pf_fmi_say(self, PF_FMI_ERROR, "there are no variables of type %s", type);
  return fmi3OK;
}

#define NO_VARIABLES(Type)                                                                                        \
  fmi3Status fmi3Get##Type(fmi3Instance instance, const fmi3ValueReference refs[], size_t n, fmi3##Type values[], \
                           size_t n_values) {                                                                     \
    (void)refs;                                                                                                   \
    (void)values;                                                                                                 \
    return no_variables(instance, n + n_values, #Type);                                                           \
  }                                                                                                               \
  fmi3Status fmi3Set##Type(fmi3Instance instance, const fmi3ValueReference refs[], size_t n,                      \
                           const fmi3##Type values[], size_t n_values) {                                          \
    (void)refs;                                                                                                   \
    (void)values;                                                                                                 \
    return no_variables(instance, n + n_values, #Type);                                                           \
  }

NO_VARIABLES(Float32)
NO_VARIABLES(Int8)
NO_VARIABLES(UInt8)
NO_VARIABLES(Int16)
NO_VARIABLES(UInt16)
NO_VARIABLES(Int32)
NO_VARIABLES(UInt32)
NO_VARIABLES(Int64)
NO_VARIABLES(Boolean)
NO_VARIABLES(String)

fmi3Status fmi3GetUInt64(fmi3Instance instance, const fmi3ValueReference refs[], size_t n, fmi3UInt64 values[],
                         size_t n_values) {
  SELF
  return (fmi3Status)pf_fmi_get_sizes(self, refs, n, values, n_values);
}

fmi3Status fmi3SetUInt64(fmi3Instance instance, const fmi3ValueReference refs[], size_t n, const fmi3UInt64 values[],
                         size_t n_values) {
  SELF
  return (fmi3Status)pf_fmi_set_sizes(self, refs, n, values, n_values);
}

fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference refs[], size_t n, size_t sizes[],
                         fmi3Binary values[], size_t n_values) {
  (void)refs;
  (void)sizes;
  (void)values;
  return no_variables(instance, n + n_values, "Binary");
}

fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference refs[], size_t n, const size_t sizes[],
                         const fmi3Binary values[], size_t n_values) {
  (void)refs;
  (void)sizes;
  (void)values;
  return no_variables(instance, n + n_values, "Binary");
}

fmi3Status fmi3GetClock(fmi3Instance instance, const fmi3ValueReference refs[], size_t n, fmi3Clock values[]) {
  SELF
  return (fmi3Status)pf_fmi_get_clocks(self, refs, n, values);
}

fmi3Status fmi3SetClock(fmi3Instance instance, const fmi3ValueReference refs[], size_t n, const fmi3Clock values[]) {
  SELF
  return (fmi3Status)pf_fmi_set_clocks(self, refs, n, values);
}

/* Of intervals and shifts alike: the first tick is one interval after the start. */
static fmi3Status in_seconds(fmi3Instance instance, const fmi3ValueReference refs[], size_t n, fmi3Float64 seconds[],
                             const char *call) {
  SELF
  if (n && (!refs || !seconds)) return (fmi3Status)pf_fmi_say(self, PF_FMI_ERROR, "%s: an argument is NULL", call);
  for (size_t i = 0; i < n; i++) {
    const pf_fmi_clock *const clock = pf_fmi_clock_of(self, refs[i], call);
    if (!clock) return fmi3Error;
    seconds[i] = clock->period;
  }
  return fmi3OK;
}

static fmi3Status as_fraction(fmi3Instance instance, const fmi3ValueReference refs[], size_t n, fmi3UInt64 counters[],
                              fmi3UInt64 resolutions[], const char *call) {
  SELF
  if (n && (!refs || !counters || !resolutions))
    return (fmi3Status)pf_fmi_say(self, PF_FMI_ERROR, "%s: an argument is NULL", call);
  for (size_t i = 0; i < n; i++) {
    const pf_fmi_clock *const clock = pf_fmi_clock_of(self, refs[i], call);
    if (!clock) return fmi3Error;
    if (!clock->resolution)
      return (fmi3Status)pf_fmi_say(self, PF_FMI_ERROR, "%s: '%.80s' has no fraction", call, clock->name);
    counters[i] = clock->counter;
    resolutions[i] = clock->resolution;
  }
  return fmi3OK;
}

static fmi3Status qualified(fmi3Instance instance, fmi3Status status, size_t n, fmi3IntervalQualifier qualifiers[]) {
  SELF
  NOT_NULL(qualifiers || !n, "getInterval")
  const int before = (self->saved->mode & PF_FMI_BEFORE) != 0;
  for (size_t i = 0; i < n && status == fmi3OK; i++)
    qualifiers[i] = before ? fmi3IntervalChanged : fmi3IntervalUnchanged;
  return status;
}

fmi3Status fmi3GetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference refs[], size_t n,
                                  fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[]) {
  return qualified(instance, in_seconds(instance, refs, n, intervals, "getIntervalDecimal"), n, qualifiers);
}

fmi3Status fmi3GetIntervalFraction(fmi3Instance instance, const fmi3ValueReference refs[], size_t n,
                                   fmi3UInt64 counters[], fmi3UInt64 resolutions[],
                                   fmi3IntervalQualifier qualifiers[]) {
  const fmi3Status status = as_fraction(instance, refs, n, counters, resolutions, "getIntervalFraction");
  return qualified(instance, status, n, qualifiers);
}

fmi3Status fmi3GetShiftDecimal(fmi3Instance instance, const fmi3ValueReference refs[], size_t n, fmi3Float64 shifts[]) {
  return in_seconds(instance, refs, n, shifts, "getShiftDecimal");
}

fmi3Status fmi3GetShiftFraction(fmi3Instance instance, const fmi3ValueReference refs[], size_t n, fmi3UInt64 counters[],
                                fmi3UInt64 resolutions[]) {
  return as_fraction(instance, refs, n, counters, resolutions, "getShiftFraction");
}

static fmi3Status constant(fmi3Instance instance, size_t n) {
  SELF
  if (n) return (fmi3Status)pf_fmi_say(self, PF_FMI_ERROR, "intervals and shifts of clocks are constant here");
  return fmi3OK;
}

fmi3Status fmi3SetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference refs[], size_t n,
                                  const fmi3Float64 intervals[]) {
  (void)refs;
  (void)intervals;
  return constant(instance, n);
}

fmi3Status fmi3SetIntervalFraction(fmi3Instance instance, const fmi3ValueReference refs[], size_t n,
                                   const fmi3UInt64 counters[], const fmi3UInt64 resolutions[]) {
  (void)refs;
  (void)counters;
  (void)resolutions;
  return constant(instance, n);
}

fmi3Status fmi3SetShiftDecimal(fmi3Instance instance, const fmi3ValueReference refs[], size_t n,
                               const fmi3Float64 shifts[]) {
  (void)refs;
  (void)shifts;
  return constant(instance, n);
}

fmi3Status fmi3SetShiftFraction(fmi3Instance instance, const fmi3ValueReference refs[], size_t n,
                                const fmi3UInt64 counters[], const fmi3UInt64 resolutions[]) {
  (void)refs;
  (void)counters;
  (void)resolutions;
  return constant(instance, n);
}

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance instance, fmi3ValueReference reference, size_t *n) {
  SELF
  return (fmi3Status)pf_fmi_dependencies(self, reference, n);
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance instance, fmi3ValueReference dependent,
                                       size_t dependent_elements[], fmi3ValueReference independents[],
                                       size_t independent_elements[], fmi3DependencyKind kinds[], size_t n) {
  SELF
  NOT_NULL(kinds || !n, "getVariableDependencies")
  const int status = pf_fmi_dependency(self, dependent, dependent_elements, independents, independent_elements, n);
  for (size_t i = 0; i < n && status == PF_FMI_OK; i++) kinds[i] = fmi3Dependent;
  return (fmi3Status)status;
}

/* ---- states and derivatives ---- */

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *state) {
  SELF
  return (fmi3Status)pf_fmi_get_state(self, state);
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state) {
  SELF
  return (fmi3Status)pf_fmi_set_state(self, state);
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *state) {
  SELF
  return (fmi3Status)pf_fmi_free_state(self, state);
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState state, size_t *size) {
  SELF
  return (fmi3Status)pf_fmi_serialized_size(self, state, size);
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
  SELF
  return (fmi3Status)pf_fmi_serialize(self, state, bytes, size);
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
  SELF
  return (fmi3Status)pf_fmi_deserialize(self, bytes, size, state);
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t n_unknowns,
                                        const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[],
                                        size_t n_seed, fmi3Float64 result[], size_t n_result) {
  SELF
  return (fmi3Status)pf_fmi_directional(self, unknowns, n_unknowns, knowns, n_knowns, seed, n_seed, result, n_result);
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t n_unknowns,
                                    const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[],
                                    size_t n_seed, fmi3Float64 result[], size_t n_result) {
  SELF
  return (fmi3Status)pf_fmi_adjoint(self, unknowns, n_unknowns, knowns, n_knowns, seed, n_seed, result, n_result);
}

/* ---- events and model exchange ---- */

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance) {
  SELF
  REFUSED("evaluateDiscreteStates");
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *need_update, fmi3Boolean *terminate,
                                    fmi3Boolean *nominals_changed, fmi3Boolean *states_changed,
                                    fmi3Boolean *next_defined, fmi3Float64 *next) {
  SELF
  int changed, defined;
  NOT_NULL(need_update && terminate && nominals_changed && states_changed && next_defined && next,
           "updateDiscreteStates")
  const int status = pf_fmi_update_discrete(self, &changed, &defined, next);
  *need_update = *terminate = *nominals_changed = fmi3False;
  *states_changed = changed != 0;
  *next_defined = defined != 0;
  return (fmi3Status)status;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean no_set_state, fmi3Boolean *event,
                                       fmi3Boolean *terminate) {
  SELF
  (void)no_set_state;
  NOT_NULL(event && terminate, "completedIntegratorStep")
  int due;
  const int status = pf_fmi_completed_step(self, &due);
  *event = due != 0;
  *terminate = fmi3False;
  return (fmi3Status)status;
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time) {
  SELF
  return (fmi3Status)pf_fmi_set_time(self, time);
}

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 x[], size_t n) {
  SELF
  return (fmi3Status)pf_fmi_set_states(self, x, n);
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 derivatives[], size_t n) {
  SELF
  return (fmi3Status)pf_fmi_get_derivatives(self, derivatives, n);
}

fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 indicators[], size_t n) {
  SELF
  return (fmi3Status)pf_fmi_indicators(self, indicators, n);
}

fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 x[], size_t n) {
  SELF
  return (fmi3Status)pf_fmi_get_states(self, x, n);
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance instance, fmi3Float64 nominals[], size_t n) {
  SELF
  return (fmi3Status)pf_fmi_nominals(self, nominals, n);
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *n) {
  SELF
  NOT_NULL(n, "getNumberOfEventIndicators")
  *n = self->model->events ? (size_t)self->model->events->count : 0;
  return fmi3OK;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *n) {
  SELF
  NOT_NULL(n, "getNumberOfContinuousStates")
  *n = pf_fmi_n_x(self);
  return fmi3OK;
}

/* ---- co-simulation ---- */

fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance, const fmi3ValueReference refs[], size_t n,
                                    const fmi3Int32 orders[], fmi3Float64 values[], size_t n_values) {
  SELF
  (void)refs;
  (void)n;
  (void)orders;
  (void)values;
  (void)n_values;
  REFUSED("getOutputDerivatives");
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no_set_state,
                      fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early_return, fmi3Float64 *reached) {
  SELF
  int event_here;
  (void)no_set_state;
  NOT_NULL(event && terminate && early_return && reached, "doStep")
  const int status = pf_fmi_step(self, t, h, reached, &event_here);
  *event = event_here != 0;
  *terminate = fmi3False;
  *early_return = status <= PF_FMI_WARNING && *reached < t + h;
  return (fmi3Status)status;
}

fmi3Status fmi3ActivateModelPartition(fmi3Instance instance, fmi3ValueReference clock, fmi3Float64 time) {
  SELF
  (void)clock;
  (void)time;
  REFUSED("activateModelPartition");
}
