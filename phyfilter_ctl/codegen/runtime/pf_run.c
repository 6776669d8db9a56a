/* See pf_run.h. No libm: finiteness is x - x == 0, roots are Newton's. */
#include "pf_ieee.h"

#include "pf_run.h"

enum { STAGES = 7, RK4_VECTORS = 3, ADAPTIVE_VECTORS = STAGES + 1, EVENT_VECTORS = 4, EVENT_MARKS = 5 };

#define TIME_ROUNDING 8.9e-16 /* 4 eps: what k * period may differ from the same instant on another grid */
#define SAME_STOP 1e-9        /* of the way since the last stop */
#define MOST_STEPS 100000000L /* between two stops: a stiff model under an explicit method, not a long run */

static pf_time magnitude(pf_time t) { return t < 0.0 ? -t : t; }

static pf_time tolerance(pf_time since, pf_time t) {
  return SAME_STOP * magnitude(t - since) + TIME_ROUNDING * magnitude(t);
}

size_t pf_work_reals(const pf_model *model) {
  const size_t vectors = (size_t)ADAPTIVE_VECTORS * (size_t)model->n_x + (size_t)model->n_u + 1;
#if PF_EVENTS
  if (model->events)
    return vectors + (size_t)EVENT_VECTORS * (size_t)model->n_x + (size_t)EVENT_MARKS * (size_t)model->events->count;
#endif
  return vectors;
}

/* One way from stop to stop. */
typedef struct {
  const pf_model *model;
  void *self;
  pf_real *x, *u;
  const pf_real *u_begin, *slope; /* at `begin` */
  pf_time begin;
} segment;

static void set_inputs(const segment *way, pf_time t) {
  if (!way->slope) return;
  const pf_real elapsed = (pf_real)(t - way->begin);
  for (int i = 0; i < way->model->n_u; i++) way->u[i] = way->u_begin[i] + elapsed * way->slope[i];
}

static int slopes_at(const void *of, pf_time t, const pf_real *x, pf_real *dx) {
  const segment *const way = (const segment *)of;
  set_inputs(way, t);
  return way->model->derivatives(way->self, t, x, dx);
}

static void accept(const segment *way, pf_time t) {
  if (way->model->accepted) way->model->accepted(way->self, t);
}

static int rk4_step(const segment *way, pf_real *work, pf_time t, pf_time t_next) {
  const int n = way->model->n_x;
  return pf_rk4_(slopes_at, way, n, t, t_next, (pf_real)(t_next - t), way->x, work, work + n, work + 2 * n);
}

/* Dormand and Prince 1980, RK5(4)7M; the last stage is the first of the next step. */
static const pf_time NODE[STAGES] = {0.0, 1.0 / 5, 3.0 / 10, 4.0 / 5, 8.0 / 9, 1.0, 1.0};
static const pf_time STAGE[STAGES][STAGES - 1] = {
    {0},
    {1.0 / 5},
    {3.0 / 40, 9.0 / 40},
    {44.0 / 45, -56.0 / 15, 32.0 / 9},
    {19372.0 / 6561, -25360.0 / 2187, 64448.0 / 6561, -212.0 / 729},
    {9017.0 / 3168, -355.0 / 33, 46732.0 / 5247, 49.0 / 176, -5103.0 / 18656},
    {35.0 / 384, 0.0, 500.0 / 1113, 125.0 / 192, -2187.0 / 6784, 11.0 / 84}};
static const pf_time DIFFERENCE[STAGES] = {71.0 / 57600,      0.0,          -71.0 / 16695, 71.0 / 1920,
                                           -17253.0 / 339200, 22.0 / 525, -1.0 / 40};

/* The stages of a step, on the first of them; the last and the trial are those at its end. */
static int stages(const segment *way, pf_real *work, pf_time t, pf_time next) {
  const int n = way->model->n_x;
  pf_real *const trial = work + STAGES * n;
  const pf_time h = next - t;
  int status = PF_OK;
  for (int s = 1; s < STAGES && !status; s++) {
    for (int i = 0; i < n; i++) {
      pf_real sum = 0;
      for (int j = 0; j < s; j++) sum += (pf_real)STAGE[s][j] * work[j * n + i];
      trial[i] = way->x[i] + (pf_real)h * sum;
    }
    status = slopes_at(way, NODE[s] < 1.0 ? t + NODE[s] * h : next, trial, work + s * n);
  }
  return status;
}

#if PF_EVENTS
static int attempt(const segment *way, pf_real *work, int method, pf_time t, pf_time next) {
  return method == PF_RK4 ? rk4_step(way, work, t, next) : stages(way, work, t, next);
}

static pf_real *trial_of(const pf_model *model, pf_real *work, int method) {
  return work + (method == PF_RK4 ? 2 : STAGES) * model->n_x;
}

#include "pf_events.h"
#endif

static int spend(pf_solver *solver) {
  if (solver->budget < 0) return PF_TOO_MANY_STEPS;
  if (solver->budget == 1) solver->budget = -1;
  if (solver->budget > 1) solver->budget--;
  return PF_OK;
}

static int rk4(const segment *way, pf_real *work, pf_solver *solver, pf_time t_end, pf_time *t_reached) {
  const pf_time length = t_end - way->begin;
  long steps = 1;
  if (solver->step > 0.0) {
    const pf_time ratio = length / solver->step - SAME_STOP;
    if (!(ratio < (pf_time)MOST_STEPS)) return PF_TOO_MANY_STEPS;
    steps = (long)ratio; /* rounded up, but not for rounding's sake */
    if ((pf_time)steps < ratio) steps++;
    if (steps < 1) steps = 1;
  }
  for (long i = 1; i <= steps; i++) {
    const pf_time next = i == steps ? t_end : way->begin + length * (pf_time)i / (pf_time)steps;
    while (*t_reached < next) {
      pf_time end = next;
      int happened = 0, status = spend(solver);
      if (!status) status = rk4_step(way, work, *t_reached, end);
#if PF_EVENTS
      if (!status && way->model->events) status = cut_by_event(way, work, PF_RK4, *t_reached, &end, &happened);
#endif
      if (status) return status;
      for (int j = 0; j < way->model->n_x && !happened; j++) way->x[j] = work[2 * way->model->n_x + j];
      *t_reached = end;
      accept(way, end);
    }
  }
  return PF_OK;
}

static pf_time square_root(pf_time value) { /* of 1e-2 ... 1e2 */
  pf_time root = 0.5 * (1.0 + value);
  for (int i = 0; i < 7; i++) root = 0.5 * (root + value / root);
  return root;
}

/* value^(1/20) for the step control, within 1e-3 of it; 1e-8 ... 1e8, what is outside counts as the bound. */
static pf_time twentieth_root(pf_time value) {
  pf_time scale = 1.0;
  if (!(value > 1e-8)) value = 1e-8;
  if (!(value < 1e8)) value = 1e8;
  for (; value >= 32.0; value /= 32.0) scale *= 2.0;
  for (; value < 1.0; value *= 32.0) scale /= 2.0;
  pf_time root = 1.5;
  for (int i = 0; i < 8; i++) root = (4.0 * root + value / (root * root * root * root)) / 5.0;
  return square_root(square_root(root * scale));
}

static pf_time weight(const pf_solver *solver, pf_real one, pf_real other) {
  const pf_time a = magnitude((pf_time)one), b = magnitude((pf_time)other);
  return (pf_time)solver->atol + (pf_time)solver->rtol * (a > b ? a : b) + 1e-300; /* 0 / 0 is no error */
}

/* Hairer, Norsett, Wanner I, II.4: a step that moves x by about one hundredth of itself. */
static pf_time first_step(const pf_solver *solver, const pf_real *x, const pf_real *dx, int n, pf_time length) {
  pf_time size = 0.0, speed = 0.0;
  for (int i = 0; i < n; i++) {
    const pf_time scale = weight(solver, x[i], x[i]);
    const pf_time a = magnitude((pf_time)x[i]) / scale, b = magnitude((pf_time)dx[i]) / scale;
    if (a > size) size = a;
    if (b > speed) speed = b;
  }
  const pf_time h = size > 1e-5 && speed > 1e-5 ? 0.01 * size / speed : 1e-6;
  return h < length ? h : length;
}

static int adaptive(const segment *way, pf_real *work, pf_solver *solver, pf_time t_end, pf_time *t_reached) {
  const int n = way->model->n_x;
  pf_real *const trial = work + STAGES * n;
  pf_real *k[STAGES];
  for (int s = 0; s < STAGES; s++) k[s] = work + s * n;
  pf_time before = 1.0; /* 20th root of the last accepted error */
  int status = slopes_at(way, *t_reached, way->x, k[0]);
  if (status) return status;
  if (!pf_all_finite_(k[0], n)) return PF_NOT_FINITE;
  if (!(solver->h > 0.0)) solver->h = first_step(solver, way->x, k[0], n, t_end - *t_reached);
  int rejected = 0;
  for (long steps = 0; *t_reached < t_end; steps++) {
    const pf_time t = *t_reached, left = t_end - t;
    if (steps >= MOST_STEPS || spend(solver)) return PF_TOO_MANY_STEPS;
    if (solver->step > 0.0 && solver->h > solver->step) solver->h = solver->step;
    /* Never a sliver at the end: what is left is one step, or at least two halves. */
    pf_time h = solver->h >= left * (1.0 - SAME_STOP) ? left : solver->h > 0.5 * left ? 0.5 * left : solver->h;
    pf_time next = h == left ? t_end : t + h;
    h = next - t;
    if (!(h > 0.0)) return PF_STEP_TOO_SMALL;
    status = stages(way, work, t, next);
    pf_time error = 0.0;
    for (int i = 0; i < n && !status; i++) {
      pf_real sum = 0;
      for (int s = 0; s < STAGES; s++) sum += (pf_real)DIFFERENCE[s] * k[s][i];
      const pf_time part = magnitude(h * (pf_time)sum) / weight(solver, way->x[i], trial[i]);
      if (!(part <= error)) error = part;
    }
    const int finite = !status && error - error == 0.0 && pf_all_finite_(trial, n) && pf_all_finite_(k[STAGES - 1], n);
    if (finite && error <= 1.0) {
      const pf_time root = twentieth_root(error);
      pf_time factor = 0.9 * before / (root * root * root); /* PI control: e^(-3/20) e_before^(1/20) */
      if (factor > 5.0) factor = 5.0;
      if (factor < 0.2) factor = 0.2;
      if (rejected && factor > 1.0) factor = 1.0;
      /* A step cut short by a stop says nothing against the longer one. */
      if (h >= solver->h * (1.0 - SAME_STOP) || h * factor > solver->h) solver->h = h * factor;
      before = root;
      rejected = 0;
#if PF_EVENTS
      if (way->model->events) {
        int happened = 0; /* the last stage is lost where the end of the step was looked at */
        status = cut_by_event(way, work, PF_ADAPTIVE, t, &next, &happened);
        if (!status && happened) status = slopes_at(way, next, way->x, trial);
        if (!status && !happened) status = slopes_at(way, next, trial, k[STAGES - 1]);
        if (status) return status;
        if (happened)
          for (int i = 0; i < n; i++) {
            k[STAGES - 1][i] = trial[i];
            trial[i] = way->x[i];
          }
        if (!pf_all_finite_(k[STAGES - 1], n)) return PF_NOT_FINITE;
      }
#endif
      for (int i = 0; i < n; i++) {
        way->x[i] = trial[i];
        k[0][i] = k[STAGES - 1][i];
      }
      *t_reached = next;
      accept(way, next);
      continue;
    }
    const pf_time root = finite ? twentieth_root(error) : 1.0;
    pf_time factor = finite ? 0.9 / (root * root * root * root) : 0.1;
    if (!(factor > 0.1)) factor = 0.1;
    solver->h = h * factor;
    if (solver->h <= TIME_ROUNDING * magnitude(t) || solver->h < 1e-250) {
      solver->h = 0.0;
      return status ? status : finite ? PF_STEP_TOO_SMALL : PF_NOT_FINITE;
    }
    status = PF_OK;
    rejected = 1;
  }
  return PF_OK;
}

static int integrate(const segment *way, pf_real *work, pf_solver *solver, pf_time t_end, pf_time *t_reached) {
  int status = PF_OK;
  if (way->model->n_x == 0 || t_end <= way->begin)
    *t_reached = t_end;
  else if (solver->method == PF_ADAPTIVE)
    status = adaptive(way, work, solver, t_end, t_reached);
  else
    status = rk4(way, work, solver, t_end, t_reached);
  set_inputs(way, *t_reached);
  if (!status && way->model->n_x == 0) accept(way, *t_reached);
  return status;
}

int pf_catch_up(const pf_model *model, void *self, pf_time since, pf_time t) {
  if (!model->n_tasks) return PF_OK;
  const pf_time limit = t + tolerance(since, t);
  for (pf_time next = model->next(self); next <= limit; next = model->next(self)) {
    const int status = model->sample(self, next > t ? next : t, model->x(self));
    if (status) return status;
    if (!(model->next(self) > next)) return PF_STEP_TOO_SMALL; /* a period lost in the rounding of t */
  }
  return PF_OK;
}

static int run(const pf_model *model, void *self, pf_real *work, pf_solver *solver, pf_time t, pf_time t_end,
               const pf_real *slope, pf_time *t_reached, int with_end) {
  segment way = {model, self, model->x(self), model->u(self), NULL, slope, t};
  pf_real *const u_begin = work + (size_t)ADAPTIVE_VECTORS * (size_t)model->n_x;
  *t_reached = t;
  if (!(t_end >= t) || !(t_end < PF_NEVER)) return PF_STEP_TOO_SMALL;
  way.u_begin = u_begin;
  for (;;) {
    for (int i = 0; i < model->n_u; i++) u_begin[i] = way.u[i];
    way.begin = *t_reached;
    const pf_time next = model->n_tasks ? model->next(self) : PF_NEVER;
    const int last = !(next < t_end - tolerance(way.begin, t_end));
    const pf_time stop = last ? t_end : next > way.begin ? next : way.begin;
    int status = PF_OK;
#if PF_EVENTS
    if (model->events) status = settle_here(&way, work, solver->method, way.begin);
#endif
    if (!status) status = integrate(&way, work, solver, stop, t_reached);
    if (!status && (!last || with_end)) status = pf_catch_up(model, self, way.begin, stop);
    if (status || last) return status;
  }
}

#if PF_EVENTS
int pf_events_here(const pf_model *model, void *self, pf_real *work, pf_time t) {
  const segment way = {model, self, model->x(self), model->u(self), NULL, NULL, t};
  const look at = look_at(&way, work, PF_RK4, t, 0.0);
  const int status = model->events->conditions(self, t, way.x, at.g);
  for (int i = 0; i < model->events->count; i++) at.fired[i] = (pf_real)(!status && fires(&at, at.g, i));
  return status ? status : settle(&at);
}

int pf_events_seen(const pf_model *model, void *self, pf_real *work, pf_time t, int *due) {
  const segment way = {model, self, model->x(self), model->u(self), NULL, NULL, t};
  const look at = look_at(&way, work, PF_RK4, t, 0.0);
  const int status = model->events->conditions(self, t, way.x, at.g);
  *due = !status && first_fired(&at, at.g) >= 0;
  if (status || *due) return status;
  see(&at, at.g);
  return missed(&at) < 0 ? PF_OK : PF_ENDLESS_EVENTS;
}
#endif

int pf_advance(const pf_model *model, void *self, pf_real *work, pf_solver *solver, pf_time t, pf_time t_end,
               const pf_real *slope, pf_time *t_reached) {
  return run(model, self, work, solver, t, t_end, slope, t_reached, 1);
}

int pf_approach(const pf_model *model, void *self, pf_real *work, pf_solver *solver, pf_time t, pf_time t_end,
                const pf_real *slope, pf_time *t_reached) {
  return run(model, self, work, solver, t, t_end, slope, t_reached, 0);
}
