/* FMI 2.0: the functions of the standard, on top of pf_fmi.h. */
#include "fmi2Functions.h"
#include "pf_fmi.h"

#define SELF                                   \
  pf_fmi *const self = (pf_fmi *)component;    \
  if (!self) return fmi2Error;

#define NOT_NULL(pointer, call) \
  if (!(pointer)) return (fmi2Status)pf_fmi_say(self, PF_FMI_ERROR, call ": an argument is NULL");

#define REFUSED(call) return (fmi2Status)pf_fmi_say(self, PF_FMI_ERROR, call ": not provided by this FMU")

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

static void log_message(pf_fmi *self, int status, const char *category, const char *message) {
  ((fmi2CallbackLogger)self->callback)(self->environment, self->name, (fmi2Status)status, category, message);
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging_on) {
  (void)resources;
  (void)visible;
  if (type != fmi2ModelExchange && type != fmi2CoSimulation) return NULL;
  pf_fmi *const self = pf_fmi_new(name, guid, type == fmi2CoSimulation ? PF_FMI_CO_SIMULATION : PF_FMI_MODEL_EXCHANGE,
                                  functions ? (void (*)(void))functions->logger : NULL,
                                  functions ? functions->componentEnvironment : NULL, log_message);
  if (self) (void)pf_fmi_log_categories(self, logging_on, 0, NULL);
  return self;
}

void fmi2FreeInstance(fmi2Component component) {
  if (component) pf_fmi_delete((pf_fmi *)component);
}

fmi2Status fmi2SetDebugLogging(fmi2Component component, fmi2Boolean on, size_t n, const fmi2String categories[]) {
  SELF
  return (fmi2Status)pf_fmi_log_categories(self, on, n, categories);
}

/* ---- initialization ---- */

fmi2Status fmi2SetupExperiment(fmi2Component component, fmi2Boolean tolerance_defined, fmi2Real tolerance,
                               fmi2Real start, fmi2Boolean stop_defined, fmi2Real stop) {
  SELF
  const int status = pf_fmi_enter_initialization(self, tolerance_defined, tolerance, start, stop_defined, stop);
  if (status == PF_FMI_OK) self->saved->mode = PF_FMI_INSTANTIATED; /* entering is a call of its own in FMI 2 */
  return (fmi2Status)status;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component component) {
  SELF
  const pf_fmi_saved *const saved = self->saved;
  return (fmi2Status)pf_fmi_enter_initialization(self, 0, 0, saved->start, (int)saved->stop_defined, saved->stop);
}

fmi2Status fmi2ExitInitializationMode(fmi2Component component) {
  SELF
  return (fmi2Status)pf_fmi_exit_initialization(self);
}

fmi2Status fmi2Terminate(fmi2Component component) {
  SELF
  if (!pf_fmi_in(self, PF_FMI_RUNNING, "terminate")) return fmi2Error;
  self->saved->mode = PF_FMI_TERMINATED;
  return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component component) {
  SELF
  pf_fmi_reset(self);
  return fmi2OK;
}

/* ---- variables ---- */

fmi2Status fmi2GetReal(fmi2Component component, const fmi2ValueReference refs[], size_t n, fmi2Real values[]) {
  SELF
  return (fmi2Status)pf_fmi_get(self, refs, n, values, n);
}

fmi2Status fmi2SetReal(fmi2Component component, const fmi2ValueReference refs[], size_t n, const fmi2Real values[]) {
  SELF
  return (fmi2Status)pf_fmi_set(self, refs, n, values, n);
}

#define NO_VARIABLES(Type, type)                                                                                   \
  fmi2Status fmi2Get##Type(fmi2Component component, const fmi2ValueReference refs[], size_t n, type values[]) {    \
    SELF(void) refs;                                                                                               \
    (void)values;                                                                                                  \
    if (n) return (fmi2Status)pf_fmi_say(self, PF_FMI_ERROR, "get" #Type ": there are no such variables");         \
    return fmi2OK;                                                                                                 \
  }                                                                                                                \
  fmi2Status fmi2Set##Type(fmi2Component component, const fmi2ValueReference refs[], size_t n, const type values[]) { \
    SELF(void) refs;                                                                                               \
    (void)values;                                                                                                  \
    if (n) return (fmi2Status)pf_fmi_say(self, PF_FMI_ERROR, "set" #Type ": there are no such variables");         \
    return fmi2OK;                                                                                                 \
  }

NO_VARIABLES(Integer, fmi2Integer)
NO_VARIABLES(Boolean, fmi2Boolean)
NO_VARIABLES(String, fmi2String)

/* ---- states and derivatives ---- */

fmi2Status fmi2GetFMUstate(fmi2Component component, fmi2FMUstate *state) {
  SELF
  return (fmi2Status)pf_fmi_get_state(self, state);
}

fmi2Status fmi2SetFMUstate(fmi2Component component, fmi2FMUstate state) {
  SELF
  return (fmi2Status)pf_fmi_set_state(self, state);
}

fmi2Status fmi2FreeFMUstate(fmi2Component component, fmi2FMUstate *state) {
  SELF
  return (fmi2Status)pf_fmi_free_state(self, state);
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component component, fmi2FMUstate state, size_t *size) {
  SELF
  return (fmi2Status)pf_fmi_serialized_size(self, state, size);
}

fmi2Status fmi2SerializeFMUstate(fmi2Component component, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
  SELF
  return (fmi2Status)pf_fmi_serialize(self, state, bytes, size);
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component component, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
  SELF
  return (fmi2Status)pf_fmi_deserialize(self, bytes, size, state);
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component component, const fmi2ValueReference unknowns[], size_t n_unknowns,
                                        const fmi2ValueReference knowns[], size_t n_knowns, const fmi2Real seed[],
                                        fmi2Real result[]) {
  SELF
  return (fmi2Status)pf_fmi_directional(self, unknowns, n_unknowns, knowns, n_knowns, seed, n_knowns, result,
                                        n_unknowns);
}

/* ---- model exchange ---- */

fmi2Status fmi2EnterEventMode(fmi2Component component) {
  SELF
  if (!pf_fmi_in(self, PF_FMI_CONTINUOUS | PF_FMI_EVENT, "enterEventMode")) return fmi2Error;
  self->saved->mode = PF_FMI_EVENT;
  return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component component, fmi2EventInfo *info) {
  SELF
  int changed, defined;
  double next;
  NOT_NULL(info, "newDiscreteStates")
  const int status = pf_fmi_update_discrete(self, &changed, &defined, &next);
  info->newDiscreteStatesNeeded = fmi2False;
  info->terminateSimulation = fmi2False;
  info->nominalsOfContinuousStatesChanged = fmi2False;
  info->valuesOfContinuousStatesChanged = changed;
  info->nextEventTimeDefined = defined;
  info->nextEventTime = next;
  return (fmi2Status)status;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component component) {
  SELF
  if (!pf_fmi_in(self, PF_FMI_EVENT, "enterContinuousTimeMode")) return fmi2Error;
  self->saved->mode = PF_FMI_CONTINUOUS;
  return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component component, fmi2Boolean no_set_state, fmi2Boolean *event,
                                       fmi2Boolean *terminate) {
  SELF
  (void)no_set_state;
  NOT_NULL(event && terminate, "completedIntegratorStep")
  int due;
  const int status = pf_fmi_completed_step(self, &due);
  *event = due != 0;
  *terminate = fmi2False;
  return (fmi2Status)status;
}

fmi2Status fmi2SetTime(fmi2Component component, fmi2Real time) {
  SELF
  return (fmi2Status)pf_fmi_set_time(self, time);
}

fmi2Status fmi2SetContinuousStates(fmi2Component component, const fmi2Real x[], size_t n) {
  SELF
  return (fmi2Status)pf_fmi_set_states(self, x, n);
}

fmi2Status fmi2GetDerivatives(fmi2Component component, fmi2Real derivatives[], size_t n) {
  SELF
  return (fmi2Status)pf_fmi_get_derivatives(self, derivatives, n);
}

fmi2Status fmi2GetEventIndicators(fmi2Component component, fmi2Real indicators[], size_t n) {
  SELF
  return (fmi2Status)pf_fmi_indicators(self, indicators, n);
}

fmi2Status fmi2GetContinuousStates(fmi2Component component, fmi2Real x[], size_t n) {
  SELF
  return (fmi2Status)pf_fmi_get_states(self, x, n);
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component component, fmi2Real nominals[], size_t n) {
  SELF
  return (fmi2Status)pf_fmi_nominals(self, nominals, n);
}

/* ---- co-simulation ---- */

fmi2Status fmi2SetRealInputDerivatives(fmi2Component component, const fmi2ValueReference refs[], size_t n,
                                       const fmi2Integer orders[], const fmi2Real values[]) {
  SELF
  if (!pf_fmi_in(self, PF_FMI_STEP | PF_FMI_BEFORE, "setRealInputDerivatives")) return fmi2Error;
  return (fmi2Status)pf_fmi_set_slopes(self, refs, n, orders, values);
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component component, const fmi2ValueReference refs[], size_t n,
                                        const fmi2Integer orders[], fmi2Real values[]) {
  SELF
  (void)refs;
  (void)n;
  (void)orders;
  (void)values;
  REFUSED("getRealOutputDerivatives");
}

fmi2Status fmi2DoStep(fmi2Component component, fmi2Real t, fmi2Real h, fmi2Boolean no_set_state) {
  SELF
  double reached;
  int event;
  (void)no_set_state;
  return (fmi2Status)pf_fmi_step(self, t, h, &reached, &event);
}

fmi2Status fmi2CancelStep(fmi2Component component) {
  SELF
  REFUSED("cancelStep");
}

fmi2Status fmi2GetStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Status *value) {
  SELF
  NOT_NULL(value, "getStatus")
  if (kind != fmi2DoStepStatus) REFUSED("getStatus");
  *value = fmi2OK; /* steps are never pending */
  return fmi2OK;
}

fmi2Status fmi2GetRealStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Real *value) {
  SELF
  NOT_NULL(value, "getRealStatus")
  if (kind != fmi2LastSuccessfulTime) REFUSED("getRealStatus");
  *value = self->saved->time;
  return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Integer *value) {
  SELF
  (void)kind;
  (void)value;
  REFUSED("getIntegerStatus");
}

fmi2Status fmi2GetBooleanStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Boolean *value) {
  SELF
  NOT_NULL(value, "getBooleanStatus")
  if (kind != fmi2Terminated) REFUSED("getBooleanStatus");
  *value = fmi2False;
  return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component component, const fmi2StatusKind kind, fmi2String *value) {
  SELF
  (void)kind;
  (void)value;
  REFUSED("getStringStatus");
}
