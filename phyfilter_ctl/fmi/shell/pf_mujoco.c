/* A MuJoCo model as a pf_model. pf_mujoco_model.h, generated, has its MJCF, its sizes and its start.
 *
 * An instance holds what MuJoCo's next step depends on (mjSTATE_INTEGRATION, the warm start included), not mjData: one
 * mjModel and one mjData serve all instances, one after the other. Errors of MuJoCo, which by default end the process,
 * come back here. */
#define _POSIX_C_SOURCE 200809L
#include <mujoco/mujoco.h>
#include <pthread.h>
#include <setjmp.h>
#include <stdio.h>
#include <string.h>

#include "pf_model.h"
#include "pf_mujoco_model.h"

typedef char numbers_must_be_double[sizeof(mjtNum) == sizeof(pf_real) ? 1 : -1];

enum {
  N_CTRL = PF_MUJOCO_NU,
  N_U = PF_MUJOCO_NU + (PF_MUJOCO_BODY ? 3 : 0),
  N_Q = PF_MUJOCO_NQ,
  N_V = PF_MUJOCO_NV,
  N_SENSOR = PF_MUJOCO_NSENSORDATA,
  N_Y = N_Q + N_V + N_SENSOR,
  REASON = 400
};
#define MOST_TIMESTEPS 1e7  /* in a communication step: more is a slip in somebody's units */
#define SAME_TIMESTEP 1e-6  /* of a timestep */
#define TIME_ROUNDING 8.9e-16

typedef struct {
  pf_real x[1], u[N_U + 1], y[N_Y], p[N_Q], p_used[N_Q];
  mjtNum state[PF_MUJOCO_STATE];
} instance;

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER; /* of the two below */
static mjModel *model;
static mjData *data;
static __thread char reason[REASON];
static __thread jmp_buf *landing;

const char *pf_mujoco_why(void);
const char *pf_mujoco_why(void) { return reason; }

/* ---- errors ---- */

/* MuJoCo's own bindings hear the errors of one thread this way; where there is no such thing, the handler is everyone's
 * for the time of a call. */
extern mjfLogHandler _mjPRIVATE_setTlsLogHandler(mjfLogHandler handler) __attribute__((weak));

static mjfLogHandler listen_with(mjfLogHandler handler) {
  return _mjPRIVATE_setTlsLogHandler ? _mjPRIVATE_setTlsLogHandler(handler) : mju_setLogHandler(handler);
}

static void heard(const mjLogMessage *message) {
  if (message->level < mjLOG_ERROR) return; /* warnings are counted in mjData */
  snprintf(reason, sizeof reason, "MuJoCo: %.380s", message->subject);
  if (landing) longjmp(*landing, 1);
}

static int load(void) {
  char error[REASON - 50] = "";
  if (model && data) return PF_OK;
  if (mj_version() != mjVERSION_HEADER) {
    snprintf(reason, sizeof reason, "expected MuJoCo %d, got %d", mjVERSION_HEADER, mj_version());
    return PF_NO_CONVERGENCE;
  }
  if (!model) {
    mjSpec *const spec = mj_parseXMLString(PF_MUJOCO_XML, NULL, error, sizeof error);
    mjModel *const made = spec ? mj_compile(spec, NULL) : NULL;
    if (!made) snprintf(reason, sizeof reason, "MuJoCo: %.380s", spec ? mjs_getError(spec) : error);
    if (spec) mj_deleteSpec(spec);
    if (!made) return PF_NO_CONVERGENCE;
    if (made->nq != N_Q || made->nv != N_V || made->nu != N_CTRL || made->nsensordata != N_SENSOR ||
        mj_stateSize(made, mjSTATE_INTEGRATION) != PF_MUJOCO_STATE || made->opt.timestep != PF_MUJOCO_TIMESTEP) {
      snprintf(reason, sizeof reason, "the model compiles to other sizes here than where the FMU was made");
      mj_deleteModel(made);
      return PF_NO_CONVERGENCE;
    }
    model = made;
  }
  data = mj_makeData(model);
  if (!data) snprintf(reason, sizeof reason, "MuJoCo: no memory for its data");
  return data ? PF_OK : PF_NO_CONVERGENCE;
}

typedef int job(instance *self, pf_time t, long timesteps);

/* Runs a job on the shared data; an error of MuJoCo's ends it. */
static int guarded(job *what, instance *self, pf_time t, long timesteps) {
  jmp_buf here;
  volatile int code;
  pthread_mutex_lock(&lock);
  const mjfLogHandler before = listen_with(heard);
  landing = &here;
  if (!setjmp(here)) {
    code = load();
    if (!code) code = what(self, t, timesteps);
  } else {
    code = PF_NO_CONVERGENCE;
    data = NULL; /* in the midst of something; a leak is better than a second error */
  }
  landing = NULL;
  (void)listen_with(before);
  pthread_mutex_unlock(&lock);
  return code;
}

__attribute__((destructor)) static void unload(void) {
  if (data) mj_deleteData(data);
  if (model) mj_deleteModel(model);
}

/* ---- steps ---- */

static void set_inputs(const instance *self) {
  memcpy(data->ctrl, self->u, N_CTRL * sizeof(mjtNum));
#if PF_MUJOCO_BODY
  memcpy(data->xfrc_applied + 6 * PF_MUJOCO_BODY, self->u + N_CTRL, 3 * sizeof(mjtNum));
#endif
}

/* Of MuJoCo's warnings, those after which the result is not that of the model: for the first four it goes back to the
 * start, for the others it leaves contacts or constraints out. */
static int is_bad(void) {
  static const struct {
    int warning;
    const char *text;
  } ENDS[] = {{mjWARN_BADQPOS, "a position is not finite or beyond 1e10: the simulation is unstable"},
              {mjWARN_BADQVEL, "a velocity is not finite or beyond 1e10: the simulation is unstable"},
              {mjWARN_BADQACC, "an acceleration is not finite or beyond 1e10: the simulation is unstable"},
              {mjWARN_BADCTRL, "a control is beyond 1e10"},
              {mjWARN_CONTACTFULL, "no memory for all contacts: the model needs more, <size memory>"},
              {mjWARN_CNSTRFULL, "no memory for all constraints: the model needs more, <size memory>"}};
  for (size_t i = 0; i < sizeof ENDS / sizeof *ENDS; i++)
    if (data->warning[ENDS[i].warning].number) {
      snprintf(reason, sizeof reason, "%s", ENDS[i].text);
      return 1;
    }
  return 0;
}

static int keep(instance *self) {
  const int n = N_Q + N_V;
  mjtNum sum = 0;
  for (int i = 0; i < N_Q; i++) sum += data->qpos[i] - data->qpos[i];
  for (int i = 0; i < N_V; i++) sum += data->qvel[i] - data->qvel[i];
  for (int i = 0; i < N_SENSOR; i++) sum += data->sensordata[i] - data->sensordata[i];
  if (sum != 0) {
    snprintf(reason, sizeof reason, "a position, velocity or sensor is no longer finite");
    return PF_NOT_FINITE;
  }
  memcpy(self->y, data->qpos, N_Q * sizeof(mjtNum));
  memcpy(self->y + N_Q, data->qvel, N_V * sizeof(mjtNum));
  if (N_SENSOR) memcpy(self->y + n, data->sensordata, N_SENSOR * sizeof(mjtNum));
  return PF_OK;
}

static int begin(instance *self, pf_time t, long timesteps) {
  mjtNum state[PF_MUJOCO_STATE];
  (void)timesteps;
  mj_resetData(model, data);
  memcpy(data->qpos, self->p_used, sizeof self->p_used);
  data->time = t;
  set_inputs(self);
  mj_getState(model, data, state, mjSTATE_INTEGRATION); /* before what forward leaves as warm start */
  mj_forward(model, data);
  const int code = is_bad() ? PF_NOT_FINITE : keep(self);
  if (code == PF_OK) memcpy(self->state, state, sizeof state);
  return code;
}

static int advance(instance *self, pf_time t, long timesteps) {
  (void)t;
  mj_setState(model, data, self->state, mjSTATE_INTEGRATION);
  memset(data->warning, 0, sizeof data->warning);
  set_inputs(self);
  for (long i = 0; i < timesteps; i++) {
    mj_step(model, data);
    if (is_bad()) return PF_NOT_FINITE;
  }
  const int code = keep(self);
  if (code == PF_OK) mj_getState(model, data, self->state, mjSTATE_INTEGRATION);
  return code;
}

/* ---- pf_model ---- */

static int init(void *pointer) {
  static const double START[] = PF_MUJOCO_START;
  instance *const self = (instance *)pointer;
  memset(self, 0, sizeof *self);
  memcpy(self->p, START, sizeof self->p);
  memcpy(self->p_used, START, sizeof self->p);
  return PF_OK;
}

static pf_real *x_of(void *self) { return ((instance *)self)->x; }
static pf_real *u_of(void *self) { return ((instance *)self)->u; }
static pf_real *p_of(void *self) { return ((instance *)self)->p; }

static void s_of(const void *self, pf_real *s) {
  (void)self;
  (void)s;
}

static const char *apply(void *pointer) {
  instance *const self = (instance *)pointer;
  pf_real sum = 0;
  for (int i = 0; i < N_Q; i++) sum += self->p[i] - self->p[i];
  if (sum != 0) {
    memcpy(self->p, self->p_used, sizeof self->p);
    return "expected start positions that are finite";
  }
  memcpy(self->p_used, self->p, sizeof self->p);
  return NULL;
}

static int start(void *self, pf_time t) { return guarded(begin, (instance *)self, t, 0); }

static int derivatives(void *self, pf_time t, const pf_real *x, pf_real *dx) {
  (void)self;
  (void)t;
  (void)x;
  (void)dx;
  return PF_OK;
}

static int outputs(void *self, pf_time t, const pf_real *x, pf_real *y) {
  (void)t;
  (void)x;
  memcpy(y, ((const instance *)self)->y, N_Y * sizeof(pf_real));
  return PF_OK;
}

static pf_time next(const void *self) {
  (void)self;
  return PF_NEVER;
}

static int sample(void *self, pf_time t, const pf_real *x) {
  (void)self;
  (void)t;
  (void)x;
  return PF_OK;
}

static int update(void *self, pf_time t, pf_time elapsed) {
  const pf_time h = PF_MUJOCO_TIMESTEP, ratio = elapsed / h;
  if (!(ratio <= MOST_TIMESTEPS)) {
    snprintf(reason, sizeof reason, "a step of %.9g s; expected at most 1e7 timesteps of %.9g s", elapsed, h);
    return PF_STEP_TOO_SMALL;
  }
  const long timesteps = (long)(ratio + 0.5);
  const pf_time rest = elapsed - (pf_time)timesteps * h, slack = SAME_TIMESTEP * h + TIME_ROUNDING * (t < 0 ? -t : t);
  if (timesteps < 1 || rest > slack || rest < -slack) {
    snprintf(reason, sizeof reason, "a step of %.9g s; expected a whole number of timesteps of %.9g s", elapsed, h);
    return PF_STEP_TOO_SMALL;
  }
  return guarded(advance, (instance *)self, t, timesteps);
}

extern const pf_model pf_mujoco;
const pf_model pf_mujoco = {
    .name = PF_MUJOCO_NAME,
    .size = sizeof(instance),
    .n_u = N_U,
    .n_y = N_Y,
    .n_p = N_Q,
    .communication = 1,
    .init = init,
    .x = x_of,
    .u = u_of,
    .p = p_of,
    .s = s_of,
    .apply = apply,
    .start = start,
    .derivatives = derivatives,
    .outputs = outputs,
    .next = next,
    .sample = sample,
    .update = update};
