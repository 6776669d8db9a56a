/* Random sequences of FMI 3.0 calls, legal and not, on up to three instances at a time; after each sequence an instance
 * that has been through it is reset and must then run as a fresh one does. Usage: fuzz3 SEQUENCES SEED
 */
#include "fmi3Functions.h"
#include "fuzz.h"

static void on_log(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message) {
  (void)environment;
  if (!category || !message || !*message) exit(2);
  messages += status != fmi3OK;
}

static fmi3Instance updating;

static void on_update(fmi3InstanceEnvironment environment, fmi3Float64 t, fmi3Boolean set, fmi3Boolean get,
                      fmi3Boolean finished, fmi3Boolean may_return, fmi3Boolean *early, fmi3Float64 *until) {
  size_t n_values;
  (void)environment;
  (void)set;
  (void)get;
  (void)finished;
  (void)may_return;
  const size_t n = arguments(&n_values);
  if (chance(50)) (void)fmi3GetFloat64(updating, references, n, numbers, n_values);
  if (chance(30)) (void)fmi3SetFloat64(updating, references, n, numbers, n_values);
  if (chance(5)) (void)fmi3Reset(updating);
  if (chance(5)) (void)fmi3Terminate(updating);
  if (chance(5)) (void)fmi3DoStep(updating, t, 0.1, 0, early, early, early, until);
  *early = chance(20);
  *until = t + number();
}

static fmi3Instance make(void) {
  const char *const token = chance(95) ? pf_fmu_here.token : chance(50) ? "{wrong}" : NULL;
  const char *const name = chance(97) ? "fuzz" : chance(50) ? "" : NULL;
  const fmi3LogMessageCallback log = chance(90) ? on_log : NULL;
  if (chance(40)) return fmi3InstantiateModelExchange(name, token, NULL, 0, chance(10), NULL, log);
  if (chance(3)) return fmi3InstantiateScheduledExecution(name, token, NULL, 0, 0, NULL, log, NULL, NULL, NULL);
  references[0] = reference();
  const fmi3IntermediateUpdateCallback update = chance(30) ? on_update : NULL;
  return fmi3InstantiateCoSimulation(name, token, NULL, 0, chance(10), chance(30), chance(50), references, chance(5),
                                     NULL, log, update);
}

static fmi3Status any_tick(fmi3Instance it);

static fmi3Status size_call(fmi3Instance it) { /* the number of channels, where it is a structural parameter */
  uint32_t which[2] = {chance(80) ? pf_fmu_here.n_variables : reference(), reference()};
  fmi3UInt64 sizes[2] = {chance(80) ? 1 + below(pf_fmu_here.most_channels + 1) : (fmi3UInt64)random_bits() << 32, 1};
  const size_t n = chance(90) ? 1 : below(3), n_values = chance(95) ? n : below(3);
  switch (below(5)) {
    case 0: return fmi3EnterConfigurationMode(it);
    case 1: return fmi3ExitConfigurationMode(it);
    case 2: return fmi3GetUInt64(it, which, n, chance(95) ? sizes : NULL, n_values);
    default: return fmi3SetUInt64(it, chance(97) ? which : NULL, n, sizes, n_values);
  }
}

static fmi3Status forward(fmi3Instance it) { /* the next step of a sensible run */
  fmi3Boolean a, b, c, d, e;
  fmi3Float64 t = 0;
  const int exchange = ((pf_fmi *)it)->saved->interface == PF_FMI_MODEL_EXCHANGE;
  const double now = ((pf_fmi *)it)->saved->time;
  switch (((pf_fmi *)it)->saved->mode) {
    case PF_FMI_INSTANTIATED:
      if (pf_fmu_here.channels && chance(40)) return fmi3EnterConfigurationMode(it);
      return fmi3EnterInitializationMode(it, chance(20), 1e-6, chance(80) ? 0.0 : uniform(), 0, 0);
    case PF_FMI_INITIALIZATION: return fmi3ExitInitializationMode(it);
    case PF_FMI_EVENT:
      if (pf_fmu_here.clocks && chance(40)) return any_tick(it);
      if (chance(50)) return fmi3UpdateDiscreteStates(it, &a, &b, &c, &d, &e, &t);
      return exchange ? fmi3EnterContinuousTimeMode(it) : fmi3EnterStepMode(it);
    case PF_FMI_CONTINUOUS:
      if (chance(30)) return fmi3EnterEventMode(it);
      return fmi3SetTime(it, now + step_size());
    case PF_FMI_STEP: return fmi3DoStep(it, now, step_size(), 0, &a, &b, &c, &t);
    case PF_FMI_CONFIGURATION: return chance(60) ? size_call(it) : fmi3ExitConfigurationMode(it);
    default: return fmi3Reset(it);
  }
}

static void *states[POOL][2];

static fmi3Status state_call(fmi3Instance it, uint32_t who) {
  static unsigned char bytes[1 << 16];
  void **const state = &states[who][below(2)];
  size_t size = 0;
  switch (below(6)) {
    case 0: return fmi3GetFMUState(it, chance(95) ? state : NULL);
    case 1: return fmi3SetFMUState(it, chance(80) ? *state : chance(50) ? states[below(POOL)][0] : (void *)bytes);
    case 2: return fmi3FreeFMUState(it, chance(95) ? state : NULL);
    case 3: return fmi3SerializedFMUStateSize(it, *state, chance(90) ? &size : NULL);
    default:
      if (!*state || fmi3SerializedFMUStateSize(it, *state, &size) != fmi3OK || size > sizeof bytes) return fmi3OK;
      if (fmi3SerializeFMUState(it, *state, bytes, size) != fmi3OK) exit(3);
      if (chance(50)) bytes[below((uint32_t)size)] ^= (unsigned char)(1 + below(255));
      if (chance(10)) size = below((uint32_t)size + 10);
      return fmi3DeserializeFMUState(it, chance(95) ? bytes : NULL, size, state);
  }
}

static fmi3Status clock_call(fmi3Instance it, const uint32_t *refs, size_t n) {
  fmi3Clock clocks[ROOM];
  fmi3Float64 seconds[ROOM];
  fmi3UInt64 counters[ROOM], resolutions[ROOM];
  fmi3IntervalQualifier qualifiers[ROOM];
  fmi3Clock *const set = chance(95) ? clocks : NULL;
  for (size_t i = 0; i < ROOM; i++) clocks[i] = chance(80);
  switch (below(6)) {
    case 0: return fmi3GetClock(it, refs, n, set);
    case 1: return fmi3GetIntervalDecimal(it, refs, n, chance(95) ? seconds : NULL, qualifiers);
    case 2: return fmi3GetIntervalFraction(it, refs, n, counters, resolutions, chance(95) ? qualifiers : NULL);
    case 3: return fmi3GetShiftDecimal(it, refs, n, seconds);
    case 4: return fmi3GetShiftFraction(it, refs, n, counters, chance(95) ? resolutions : NULL);
    default: return fmi3SetClock(it, refs, n, set);
  }
}

static fmi3Status any_tick(fmi3Instance it) { /* clocks of a sensible run, which may not be due */
  static const fmi3Clock active = fmi3True;
  fmi3Status status = fmi3OK;
  for (uint32_t i = 1; i <= pf_fmu_here.n_variables && status == fmi3OK; i++)
    if (pf_fmu_here.variables[i].kind == PF_FMI_CLOCK && chance(80)) status = fmi3SetClock(it, &i, 1, &active);
  return status;
}

static fmi3Status any_call(fmi3Instance it, uint32_t who) {
  size_t n_values, count = 0;
  const size_t n = arguments(&n_values);
  const uint32_t *const refs = chance(97) ? references : NULL;
  double *const values = chance(97) ? numbers : NULL;
  const uint32_t other[] = {reference(), reference()};
  const size_t others = below(3), n_x = chance(70) ? (size_t)pf_fmu_here.model->n_x : below(ROOM);
  const uint32_t width = pf_fmu_here.variables[other[0] % pf_fmu_here.n_variables].count;
  const size_t seeds = chance(90) && others ? width : below(9);
  fmi3Boolean flags[5];
  fmi3Boolean *const flag = chance(95) ? flags : NULL;
  size_t rows[ROOM], columns[ROOM];
  fmi3ValueReference knowns[ROOM];
  fmi3DependencyKind kinds[ROOM];
  const fmi3String categories[] = {chance(50) ? "logEvents" : "nonsense", chance(50) ? "logStatusError" : NULL};
  double t = number();
  switch (below(32)) {
    case 0: case 1: case 2: return fmi3GetFloat64(it, refs, n, values, n_values);
    case 3: case 4: case 5: return fmi3SetFloat64(it, refs, n, values, n_values);
    case 6: return fmi3EnterInitializationMode(it, chance(50), number(), number(), chance(50), number());
    case 7: return fmi3ExitInitializationMode(it);
    case 8: return fmi3EnterEventMode(it);
    case 9: return fmi3EnterContinuousTimeMode(it);
    case 10: return fmi3EnterStepMode(it);
    case 11: return fmi3UpdateDiscreteStates(it, flag, flags + 1, flags + 2, flags + 3, flags + 4, &t);
    case 12: return fmi3SetTime(it, number());
    case 13: return fmi3SetContinuousStates(it, values, n_x);
    case 14: return fmi3GetContinuousStates(it, values, n_x);
    case 15: return fmi3GetContinuousStateDerivatives(it, values, n_x);
    case 16: return fmi3DoStep(it, number(), step_size(), 0, flag, flags + 1, flags + 2, &t);
    case 17: return fmi3Terminate(it);
    case 18: return fmi3Reset(it);
    case 19: return fmi3GetDirectionalDerivative(it, refs, n, other, others, numbers, seeds, more_numbers, n_values);
    case 20: return fmi3GetAdjointDerivative(it, refs, n, other, others, numbers, n_values, more_numbers, seeds);
    case 21:
      if (fmi3GetNumberOfVariableDependencies(it, reference(), &count) == fmi3OK && count > ROOM) return fmi3OK;
      return fmi3GetVariableDependencies(it, reference(), rows, chance(95) ? knowns : NULL, columns, kinds,
                                         chance(60) ? count : below(ROOM));
    case 22: return fmi3SetDebugLogging(it, chance(50), below(3), chance(90) ? categories : NULL);
    case 23: return fmi3GetEventIndicators(it, values, below(2));
    case 24: return fmi3GetNominalsOfContinuousStates(it, values, below(9));
    case 25: return fmi3CompletedIntegratorStep(it, 0, flag, flags + 1);
    case 26: return fmi3GetInt32(it, refs, n, NULL, n_values);
    case 27: return fmi3GetOutputDerivatives(it, refs, n, NULL, values, n_values);
    case 28: return clock_call(it, refs, n);
    case 29: return size_call(it);
    default: return state_call(it, who);
  }
}

static double correct_run(fmi3Instance it) {
  fmi3Boolean event, terminate, early;
  double reached, sum = 0, inputs[ROOM];
  if (fmi3EnterInitializationMode(it, 0, 0, 0, 0, 0) || fmi3ExitInitializationMode(it)) return NAN;
  if (((pf_fmi *)it)->saved->mode == PF_FMI_EVENT && fmi3EnterStepMode(it)) return NAN;
  for (int k = 0; k < 4; k++) {
    for (uint32_t i = 0; i < pf_fmu_here.n_variables; i++) {
      const pf_fmi_variable variable = pf_fmu_here.variables[i];
      const uint32_t count = pf_fmi_count((pf_fmi *)it, variable);
      for (uint32_t j = 0; j < count; j++) inputs[j] = 0.1 * k + 0.01 * j;
      if (variable.kind == PF_FMI_INPUT && fmi3SetFloat64(it, &i, 1, inputs, count)) return NAN;
    }
    if (fmi3DoStep(it, 0.01 * k, 0.01, 1, &event, &terminate, &early, &reached)) return NAN;
    for (uint32_t i = 0; i < pf_fmu_here.n_variables; i++) {
      const pf_fmi_variable variable = pf_fmu_here.variables[i];
      if (variable.kind != PF_FMI_OUTPUT) continue;
      const uint32_t count = pf_fmi_count((pf_fmi *)it, variable);
      if (fmi3GetFloat64(it, &i, 1, inputs, count)) return NAN;
      for (uint32_t j = 0; j < count; j++) sum += inputs[j] * (k + 1);
    }
  }
  return sum;
}

static fmi3Instance fresh(int event_mode) { /* with it, instants at the end of a step are left to the importer */
  const char *const token = pf_fmu_here.token;
  return fmi3InstantiateCoSimulation("right", token, NULL, 0, 0, event_mode, 0, NULL, 0, NULL, on_log, NULL);
}

int main(int n, char **argument) {
  const long sequences = n > 1 ? atol(argument[1]) : 1000;
  const uint64_t first = n > 2 ? strtoull(argument[2], NULL, 10) : 1;
  double expected[2];
  for (int event_mode = 0; event_mode < 2; event_mode++) {
    fmi3Instance it = fresh(event_mode);
    expected[event_mode] = correct_run(it);
    fmi3FreeInstance(it);
    if (expected[event_mode] - expected[event_mode] != 0) return 4;
  }
  for (long s = 0; s < sequences; s++) {
    fmi3Instance pool[POOL] = {0};
    const uint64_t seed = first + (uint64_t)s;
    seed_now = seed * 0x9E3779B97F4A7C15ULL + 1;
    memset(states, 0, sizeof states);
    for (int call = 0; call < CALLS; call++) {
      const uint32_t who = below(POOL);
      const long before = messages;
      if (!pool[who]) pool[who] = chance(97) ? make() : NULL;
      updating = pool[who];
      const fmi3Status status = pool[who] && chance(50) ? forward(pool[who]) : any_call(pool[who], who);
      if (status > fmi3Error) fail("a status that is none", seed);
      if (status >= fmi3Discard) {
        errors++;
        if (pool[who] && ((pf_fmi *)pool[who])->callback && messages == before) fail("a refusal without a word", seed);
      }
      if (pool[who] && chance(3)) {
        fmi3FreeInstance(pool[who]);
        pool[who] = NULL;
        memset(states[who], 0, sizeof states[who]);
      }
    }
    for (int i = 0; i < POOL; i++) {
      if (pool[i] && ((pf_fmi *)pool[i])->saved->interface == PF_FMI_CO_SIMULATION) {
        pf_fmi *const self = (pf_fmi *)pool[i];
        self->intermediate = NULL;
        self->saved->early_return = 0;
        if (fmi3Reset(self) != fmi3OK || correct_run(self) != expected[self->saved->event_mode])
          fail("a wrong run afterwards", seed);
      }
      fmi3FreeInstance(pool[i]);
    }
  }
  printf("%ld sequences, %ld calls refused\n", sequences, errors);
  return 0;
}
