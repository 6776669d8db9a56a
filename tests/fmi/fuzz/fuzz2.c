/* Random sequences of FMI 2.0 calls; see fuzz3.c. Usage: fuzz2 SEQUENCES SEED */
#include "fmi2Functions.h"
#include "fuzz.h"

static void on_log(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                   fmi2String message, ...) {
  (void)environment;
  if (!name || !category || !message || !*message || strchr(message, '%')) exit(2);
  messages += status != fmi2OK;
}

static const fmi2CallbackFunctions CALLBACKS = {on_log, calloc, free, NULL, NULL};
static const fmi2CallbackFunctions SILENT = {NULL, NULL, NULL, NULL, NULL};

static fmi2Component make(void) {
  const char *const token = chance(95) ? pf_fmu_here.token : chance(50) ? "{%s%n}" : NULL;
  const char *const name = chance(97) ? "fuzz" : chance(50) ? "" : NULL;
  const fmi2CallbackFunctions *const functions = chance(90) ? &CALLBACKS : chance(50) ? &SILENT : NULL;
  const fmi2Type type = chance(60) ? fmi2CoSimulation : fmi2ModelExchange;
  return fmi2Instantiate(name, type, token, NULL, functions, 0, chance(10));
}

static fmi2Status forward(fmi2Component it) {
  fmi2EventInfo info;
  const double now = ((pf_fmi *)it)->saved->time;
  switch (((pf_fmi *)it)->saved->mode) {
    case PF_FMI_INSTANTIATED:
      if (chance(50)) return fmi2SetupExperiment(it, chance(20), 1e-6, chance(80) ? 0.0 : uniform(), 0, 0);
      return fmi2EnterInitializationMode(it);
    case PF_FMI_INITIALIZATION: return fmi2ExitInitializationMode(it);
    case PF_FMI_EVENT: return chance(50) ? fmi2NewDiscreteStates(it, &info) : fmi2EnterContinuousTimeMode(it);
    case PF_FMI_CONTINUOUS: return chance(30) ? fmi2EnterEventMode(it) : fmi2SetTime(it, now + step_size());
    case PF_FMI_STEP: return fmi2DoStep(it, now, step_size(), 0);
    default: return fmi2Reset(it);
  }
}

static void *states[POOL][2];

static fmi2Status state_call(fmi2Component it, uint32_t who) {
  static char bytes[1 << 16];
  void **const state = &states[who][below(2)];
  size_t size = 0;
  switch (below(6)) {
    case 0: return fmi2GetFMUstate(it, chance(95) ? state : NULL);
    case 1: return fmi2SetFMUstate(it, chance(80) ? *state : chance(50) ? states[below(POOL)][0] : (void *)bytes);
    case 2: return fmi2FreeFMUstate(it, chance(95) ? state : NULL);
    case 3: return fmi2SerializedFMUstateSize(it, *state, chance(90) ? &size : NULL);
    default:
      if (!*state || fmi2SerializedFMUstateSize(it, *state, &size) != fmi2OK || size > sizeof bytes) return fmi2OK;
      if (fmi2SerializeFMUstate(it, *state, bytes, size) != fmi2OK) exit(3);
      if (chance(50)) bytes[below((uint32_t)size)] ^= (char)(1 + below(100));
      if (chance(10)) size = below((uint32_t)size + 10);
      return fmi2DeSerializeFMUstate(it, chance(95) ? bytes : NULL, size, state);
  }
}

static fmi2Status any_call(fmi2Component it, uint32_t who) {
  size_t n_values;
  const size_t n = arguments(&n_values), m = below(5);
  const uint32_t *const refs = chance(97) ? references : NULL;
  double *const values = chance(97) ? numbers : NULL;
  const uint32_t other[] = {reference(), reference(), reference(), reference()};
  const fmi2String categories[] = {chance(50) ? "logEvents" : "%s%s%n", chance(50) ? "logAll" : NULL};
  int orders[ROOM], flags[2];
  fmi2EventInfo info;
  fmi2Status status;
  fmi2String text;
  double t;
  for (int i = 0; i < ROOM; i++) orders[i] = chance(90) ? 1 : (int)below(4) - 1;
  switch (below(31)) {
    case 0: case 1: case 2: return fmi2GetReal(it, refs, n, values);
    case 3: case 4: case 5: return fmi2SetReal(it, refs, n, values);
    case 6: return fmi2SetupExperiment(it, chance(50), number(), number(), chance(50), number());
    case 7: return fmi2EnterInitializationMode(it);
    case 8: return fmi2ExitInitializationMode(it);
    case 9: return fmi2EnterEventMode(it);
    case 10: return fmi2EnterContinuousTimeMode(it);
    case 11: return fmi2NewDiscreteStates(it, chance(95) ? &info : NULL);
    case 12: return fmi2SetTime(it, number());
    case 13: return fmi2SetContinuousStates(it, values, chance(70) ? (size_t)pf_fmu_here.model->n_x : below(ROOM));
    case 14: return fmi2GetContinuousStates(it, values, chance(70) ? (size_t)pf_fmu_here.model->n_x : below(ROOM));
    case 15: return fmi2GetDerivatives(it, values, chance(70) ? (size_t)pf_fmu_here.model->n_x : below(ROOM));
    case 16: return fmi2DoStep(it, number(), step_size(), 0);
    case 17: return fmi2Terminate(it);
    case 18: return fmi2Reset(it);
    case 19: return fmi2GetDirectionalDerivative(it, refs, n, other, m, chance(95) ? numbers : NULL, more_numbers);
    case 20: return fmi2SetRealInputDerivatives(it, refs, n, orders, values);
    case 21: return fmi2GetRealOutputDerivatives(it, refs, n, orders, values);
    case 22: return fmi2SetDebugLogging(it, chance(50), below(3), chance(90) ? categories : NULL);
    case 23: return fmi2GetEventIndicators(it, values, below(2));
    case 24: return fmi2GetNominalsOfContinuousStates(it, values, below(9));
    case 25: return fmi2CompletedIntegratorStep(it, 0, chance(95) ? flags : NULL, flags + 1);
    case 26: return chance(50) ? fmi2GetInteger(it, refs, n, NULL) : fmi2SetString(it, refs, n, NULL);
    case 27:
      if (chance(50)) return fmi2GetRealStatus(it, (fmi2StatusKind)below(6), chance(90) ? &t : NULL);
      return fmi2GetStatus(it, (fmi2StatusKind)below(6), chance(90) ? &status : NULL);
    case 28: return chance(50) ? fmi2CancelStep(it) : fmi2GetStringStatus(it, fmi2PendingStatus, &text);
    default: return state_call(it, who);
  }
}

static double correct_run(fmi2Component it) {
  double sum = 0, value;
  if (fmi2EnterInitializationMode(it) || fmi2ExitInitializationMode(it)) return NAN;
  for (int k = 0; k < 4; k++) {
    for (uint32_t i = 0; i < pf_fmu_here.n_variables; i++) {
      value = 0.1 * k + 0.01 * i;
      if (pf_fmu_here.variables[i].kind == PF_FMI_INPUT && fmi2SetReal(it, &i, 1, &value)) return NAN;
    }
    if (fmi2DoStep(it, 0.01 * k, 0.01, 1)) return NAN;
    for (uint32_t i = 0; i < pf_fmu_here.n_variables; i++) {
      if (pf_fmu_here.variables[i].kind != PF_FMI_OUTPUT) continue;
      if (fmi2GetReal(it, &i, 1, &value)) return NAN;
      sum += value * (k + 1);
    }
  }
  return sum;
}

static fmi2Component fresh(void) {
  return fmi2Instantiate("right", fmi2CoSimulation, pf_fmu_here.token, NULL, &CALLBACKS, 0, 0);
}

int main(int n, char **argument) {
  const long sequences = n > 1 ? atol(argument[1]) : 1000;
  const uint64_t first = n > 2 ? strtoull(argument[2], NULL, 10) : 1;
  fmi2Component it = fresh();
  const double expected = correct_run(it);
  fmi2FreeInstance(it);
  if (expected - expected != 0) return 4;
  for (long s = 0; s < sequences; s++) {
    fmi2Component pool[POOL] = {0};
    const uint64_t seed = first + (uint64_t)s;
    seed_now = seed * 0x9E3779B97F4A7C15ULL + 1;
    memset(states, 0, sizeof states);
    for (int call = 0; call < CALLS; call++) {
      const uint32_t who = below(POOL);
      const long before = messages;
      if (!pool[who]) pool[who] = chance(97) ? make() : NULL;
      const fmi2Status status = pool[who] && chance(50) ? forward(pool[who]) : any_call(pool[who], who);
      if (status > fmi2Error) fail("a status that is none", seed);
      if (status >= fmi2Discard) {
        errors++;
        if (pool[who] && ((pf_fmi *)pool[who])->callback && messages == before) fail("a refusal without a word", seed);
      }
      if (pool[who] && chance(3)) {
        fmi2FreeInstance(pool[who]);
        pool[who] = NULL;
        memset(states[who], 0, sizeof states[who]);
      }
    }
    for (int i = 0; i < POOL; i++) {
      if (pool[i] && ((pf_fmi *)pool[i])->saved->interface == PF_FMI_CO_SIMULATION)
        if (fmi2Reset(pool[i]) != fmi2OK || correct_run(pool[i]) != expected) fail("a wrong run afterwards", seed);
      fmi2FreeInstance(pool[i]);
    }
  }
  printf("%ld sequences, %ld calls refused\n", sequences, errors);
  return 0;
}
