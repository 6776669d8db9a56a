/* The master's inner loop: communication steps, Jacobi or Gauss-Seidel, over given points or by step doubling. FMUs of
 * FMI 2.0 and 3.0 and linear systems are run here, other parts by calls into Python. It does what cosimulation_run.py
 * does, call for call, except that a part whose inputs have not changed is not told them again. */
#include "pf_master.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#ifndef _WIN32
#include <pthread.h>
#include <sched.h>
#endif

#ifdef _WIN32
#define PF_API __declspec(dllexport)
#else
#define PF_API __attribute__((visibility("default")))
#endif

/* -- steps ------------------------------------------------------------------------------------------------------ */

static void step_linear(Master *m, int64_t p, double t, double end)
{
  Part *part = &m->parts[p];
  const int64_t n = part->n_x, n_u = part->u_end - part->u_begin, width = n + n_u;
  const double *u = m->u + part->u_begin;
  int64_t slot = 0;
  if (n == 0) return;
  while (slot < SPANS && part->spans[slot] != end - t) slot++;
  if (slot == SPANS) {
    slot = part->slot;
    if ((part->code = m->python(PY_TRANSITION, p, t, end))) return;
    part->spans[slot] = end - t;
    part->slot = (slot + 1) % SPANS;
  }
  const double *row = part->transitions + slot * n * width;
  for (int64_t i = 0; i < n; i++, row += width) {
    double sum = 0.0;
    for (int64_t k = 0; k < n; k++) sum += row[k] * part->x[k];
    for (int64_t k = 0; k < n_u; k++) sum += row[n + k] * u[k];
    part->work[i] = sum;
  }
  memcpy(part->x, part->work, (size_t)n * sizeof(double));
}

/* FMI 2.0: whether a step was discarded because the FMU asks to end the run. */
static bool asks_to_end(const Part *part)
{
  typedef int (*Ask)(void *, int, int *);
  const int terminated = 3; /* of fmi2StatusKind */
  int answer = 0;
  return part->ended && ((Ask)part->ended)(part->instance, terminated, &answer) <= STATUS_WARNING && answer;
}

/* FMI 2.0: the time that it came to in a step that was discarded; the begin of the step where it does not say. */
static double came_to(const Part *part, double t)
{
  typedef int (*Ask)(void *, int, double *);
  const int last_time = 2; /* of fmi2StatusKind */
  double answer = t;
  return ((Ask)part->told)(part->instance, last_time, &answer) <= STATUS_WARNING ? answer : t;
}

static int64_t where_ended(const Part *part, double t, double end)
{
  const double same = 1e-6; /* part of a step */
  return fabs(part->reached - end) <= same * (end - t) ? ENDED_AT_END : ENDED;
}

static void do_step(Master *m, int64_t p, double t, double end, bool final)
{
  typedef int (*Two)(void *, double, double, int);
  typedef int (*Three)(void *, double, double, bool, bool *, bool *, bool *, double *);
  Part *part = &m->parts[p];
  const double rest = 1e-9 * (end - t);
  double before = t;
  part->terminated = RUNS;
  part->status = 0;
  part->code = FINE;
  switch (part->kind) {
  case LINEAR: step_linear(m, p, t, end); return;
  case IN_PYTHON:
    part->code = m->python(final ? PY_STEP : PY_STEP_BACK, p, t, end);
    if (part->code != CALL_FAILED) return;
    part->code = FINE;
    part->status = STATUS_DISCARD;
    return;
  case FMI2:
    part->status = ((Two)part->step)(part->instance, t, end - t, final);
    if (part->status != STATUS_DISCARD || !asks_to_end(part)) return;
    part->reached = came_to(part, t);
    part->terminated = where_ended(part, t, end);
    if (part->terminated == ENDED_AT_END) part->status = 0;
    return;
  default: break;
  }
  do { /* an FMU that returns early, at an event, goes on from there */
    bool event = false, terminate = false, early = false;
    part->reached = end;
    part->status = ((Three)part->step)(part->instance, before, end - before, final, &event, &terminate, &early,
                                       &part->reached);
    if (part->status > STATUS_WARNING || !(early || terminate)) return;
    part->terminated = terminate ? where_ended(part, t, end) : RUNS;
    if (part->reached <= before) part->status = terminate ? 0 : STATUS_DISCARD;
    if (terminate || part->reached <= before) return;
    before = part->reached;
  } while (before < end - rest);
}

static int64_t stepped(Master *m, int64_t p, double t)
{
  const Part *part = &m->parts[p];
  if (part->code) return part->code;
  if (part->status > STATUS_WARNING) return pf_master_failed(m, p, CALL_STEP, 0, part->status, t);
  if (part->terminated == ENDED) {
    pf_master_failed(m, p, CALL_STEP, 0, 0, part->reached);
    return TERMINATED;
  }
  return FINE;
}

#ifndef _WIN32
typedef struct Pool Pool;
typedef struct { Pool *pool; int64_t number; pthread_t thread; } Worker;
struct Pool {
  Master *master;
  int64_t count, round, done, stop; /* count: workers beside the caller */
  double t, end;
  bool final;
  Worker *workers;
};

static void share(Pool *pool, int64_t number)
{
  Master *m = pool->master;
  for (int64_t p = 0, fmu = 0; p < m->n_parts; p++) { /* what may call Python is the caller's */
    const bool mine = m->parts[p].kind < FMI2 ? number == 0 : fmu++ % (pool->count + 1) == number;
    if (mine) do_step(m, p, pool->t, pool->end, pool->final);
  }
}

static void await(const int64_t *value, int64_t least)
{
  for (int64_t k = 0; __atomic_load_n(value, __ATOMIC_ACQUIRE) < least; k++)
    if (k > 2000) sched_yield();
}

static void *work(void *argument)
{
  Worker *worker = argument;
  Pool *pool = worker->pool;
  for (int64_t round = 1;; round++) {
    await(&pool->round, round);
    if (pool->stop) return NULL;
    share(pool, worker->number);
    __atomic_fetch_add(&pool->done, 1, __ATOMIC_ACQ_REL);
  }
}

static void release(Pool *pool, int64_t stop)
{
  pool->stop = stop;
  __atomic_fetch_add(&pool->round, 1, __ATOMIC_ACQ_REL);
}

static void end_pool(Pool *pool)
{
  release(pool, 1);
  for (int64_t k = 0; k < pool->count; k++) pthread_join(pool->workers[k].thread, NULL);
  free(pool->workers);
  free(pool);
}

static Pool *start_pool(Master *m)
{
  Pool *pool = calloc(1, sizeof *pool);
  Worker *workers = calloc((size_t)m->threads, sizeof *workers);
  if (!pool || !workers) {
    free(pool);
    free(workers);
    return NULL;
  }
  pool->master = m;
  pool->workers = workers;
  for (int64_t k = 0; k < m->threads - 1; k++) {
    workers[k].pool = pool;
    workers[k].number = k + 1;
    if (pthread_create(&workers[k].thread, NULL, work, &workers[k])) break;
    pool->count++; /* the workers read it after the first release only */
  }
  return pool;
}

static void step_all(Master *m, double t, double end, bool final)
{
  Pool *pool = m->pool;
  pool->t = t;
  pool->end = end;
  pool->final = final;
  pool->done = 0;
  release(pool, 0);
  share(pool, 0);
  await(&pool->done, pool->count);
}
#endif

/* Before a step: where the lines begin that inputs follow. */
static int64_t begin_lines(Master *m, double t, double end)
{
  int64_t code = pf_master_outside(m, t);
  if (m->n_outside) {
    memcpy(m->base, m->now, (size_t)m->n_outside * sizeof(double));
    if (!code) code = pf_master_outside(m, end);
    for (int64_t j = 0; j < m->n_outside; j++) m->rate[j] = (m->now[j] - m->base[j]) / (end - t);
  }
  memcpy(m->y_begin, m->y, (size_t)m->n_y * sizeof(double));
  return code;
}

static void slopes_of(Master *m, int64_t begin, int64_t end, double h)
{
  for (int64_t j = begin; j < end; j++) m->y_slope[j] = (m->y[j] - m->y_begin[j]) / h;
}

/* A part's inputs for a step, and how they move. */
static int64_t give(Master *m, int64_t p, double t, double end)
{
  typedef int (*Slopes)(void *, const uint32_t *, size_t, const int *, const double *);
  Part *part = &m->parts[p];
  int64_t code = pf_master_aim(m, p, t, end);
  if (!code) code = pf_master_put(m, p, t);
  if (code || !part->follows) return code;
  if (part->kind == IN_PYTHON) {
    part->stale = 1;
    return m->python(PY_SLOPES, p, t, end);
  }
  const Group *group = part->sloped;
  double *values = group->values;
  for (int64_t k = 0; k < group->n; k++) {
    values[k] = m->u_slope[group->places[k]];
    part->stale |= values[k] != 0.0;
  }
  const int status = ((Slopes)part->slopes)(part->instance, group->references, (size_t)group->n, part->orders, values);
  return status > STATUS_WARNING ? pf_master_failed(m, p, CALL_SLOPES, 0, status, t) : FINE;
}

/* After a step: the end of the line, where outputs show it. */
static int64_t arrive(Master *m, int64_t p, double t, double end)
{
  const Part *part = &m->parts[p];
  const double left = (part->follows ? 1.0 : 0.5) * (end - t);
  if (!part->feedthrough) return FINE;
  for (int64_t i = part->u_begin; i < part->u_end; i++) m->v[i] = m->u[i] + (m->moves[i] ? left * m->u_slope[i] : 0.0);
  return pf_master_put(m, p, end);
}

static int64_t in_turn(Master *m, int64_t p, double t, double end, bool final)
{
  Part *part = &m->parts[p];
  int64_t code;
  if (m->first) code = give(m, p, t, end);
  else if (!(code = pf_master_wired(m, t, part->u_begin, part->u_end))) code = pf_master_put(m, p, t);
  if (code) return code;
  do_step(m, p, t, end, final);
  if ((code = stepped(m, p, t)) || (m->first && (code = arrive(m, p, t, end)))) return code;
  if ((code = pf_master_get(m, p, end))) return code;
  if (m->first) slopes_of(m, part->y_begin, part->y_end, end - t);
  return FINE;
}

static int64_t advance(Master *m, double t, double end, bool final)
{
  int64_t code;
  if (m->first && (code = begin_lines(m, t, end))) return code;
  if (m->sequence) {
    for (int64_t k = 0; k < m->n_parts; k++)
      if ((code = in_turn(m, m->sequence[k], t, end, final))) return code;
  } else {
    for (int64_t p = 0; m->first && p < m->n_parts; p++)
      if ((code = give(m, p, t, end))) return code;
#ifndef _WIN32
    if (m->pool) step_all(m, t, end, final);
    else
#endif
    for (int64_t p = 0; p < m->n_parts; p++) {
      do_step(m, p, t, end, final);
      if ((code = stepped(m, p, t))) return code;
    }
    for (int64_t p = 0; p < m->n_parts; p++)
      if ((code = stepped(m, p, t))) return code;
  }
  if ((code = pf_master_settle(m, end))) return code;
  if (m->first) slopes_of(m, 0, m->n_y, end - t);
  return FINE;
}

/* After a step: whether a part ended the run at its end. */
static int64_t over(Master *m)
{
  for (int64_t p = 0; p < m->n_parts; p++)
    if (m->parts[p].terminated == ENDED_AT_END) {
      pf_master_failed(m, p, CALL_STEP, 0, 0, m->parts[p].reached);
      return TERMINATED;
    }
  return FINE;
}

/* -- step control ----------------------------------------------------------------------------------------------- */

typedef int (*OfState)(void *, void **);

static int64_t save(Master *m, double t)
{
  int64_t code;
  for (int64_t p = 0; p < m->n_parts; p++) {
    Part *part = &m->parts[p];
    if (part->kind == LINEAR) memcpy(part->saved_x, part->x, (size_t)part->n_x * sizeof(double));
    else if (part->kind == IN_PYTHON) {
      if ((code = m->python(PY_SAVE, p, t, t))) return code;
    } else {
      const int status = ((OfState)part->save)(part->instance, &part->state);
      if (status > STATUS_WARNING) return pf_master_failed(m, p, CALL_SAVE, 0, status, t);
    }
  }
  memcpy(m->saved_u, m->u, (size_t)m->n_u * sizeof(double));
  memcpy(m->saved_y, m->y, (size_t)m->n_y * sizeof(double));
  memcpy(m->saved_slope, m->y_slope, (size_t)m->n_y * sizeof(double));
  return FINE;
}

static int64_t back(Master *m, double t)
{
  typedef int (*Restore)(void *, void *);
  int64_t code;
  for (int64_t p = 0; p < m->n_parts; p++) {
    Part *part = &m->parts[p];
    part->stale = 0;
    part->terminated = RUNS;
    if (part->kind == LINEAR) memcpy(part->x, part->saved_x, (size_t)part->n_x * sizeof(double));
    else if (part->kind == IN_PYTHON) {
      if ((code = m->python(PY_RESTORE, p, t, t))) return code;
    } else {
      const int status = ((Restore)part->restore)(part->instance, part->state);
      if (status > STATUS_WARNING) return pf_master_failed(m, p, CALL_RESTORE, 0, status, t);
    }
  }
  memcpy(m->u, m->saved_u, (size_t)m->n_u * sizeof(double));
  memcpy(m->y, m->saved_y, (size_t)m->n_y * sizeof(double));
  memcpy(m->y_slope, m->saved_slope, (size_t)m->n_y * sizeof(double));
  return FINE;
}

static void forget(Master *m, int64_t code)
{
  if (code == CALL_FAILED && m->failed_status == STATUS_FATAL) return; /* after it no function may be called */
  for (int64_t p = 0; p < m->n_parts; p++) {
    Part *part = &m->parts[p];
    if (part->kind == IN_PYTHON) m->python(PY_FORGET, p, 0.0, 0.0);
    if (!part->state) continue;
    ((OfState)part->forget)(part->instance, &part->state);
    part->state = NULL;
  }
}

/* What is no number is left in `coarse`, for the message. */
static int64_t finite(Master *m, double t)
{
  for (int64_t j = 0; j < m->n_y; j++)
    if (m->watched[j] && !isfinite(m->y[j])) {
      memcpy(m->coarse, m->y, (size_t)m->n_y * sizeof(double));
      m->failed_time = t;
      return NOT_FINITE;
    }
  return FINE;
}

/* One step, then two halves from the same state; the error over what is allowed. A discarded step is wrong beyond
 * measure, and one without a solution or to what is no number: `wrong` says which. */
static int64_t twice(Master *m, double t, double end, double *error, int64_t *wrong)
{
  const double middle = t + 0.5 * (end - t);
  int64_t code = advance(m, t, end, true);
  if (!code) {
    memcpy(m->coarse, m->y, (size_t)m->n_y * sizeof(double));
    code = back(m, t);
  }
  if (!code) code = advance(m, t, middle, true);
  if (!code) code = advance(m, middle, end, false); /* t, which comes before, may be gone back to */
  if (!code) code = finite(m, end);
  *error = INFINITY;
  *wrong = code == NOT_FINITE || code == STUCK ? code : FINE;
  const bool discarded = code == CALL_FAILED && m->failed_call == CALL_STEP && m->failed_status == STATUS_DISCARD
    && !m->parts[m->failed_part].terminated;
  if (*wrong || discarded) return FINE;
  if (code) return code;
  *error = 0.0;
  for (int64_t j = 0; j < m->n_y; j++) {
    const double part = fabs(m->y[j] - m->coarse[j]) / (m->atol + m->rtol * fabs(m->y[j]));
    if (!(part <= *error)) *error = isfinite(part) ? part : INFINITY;
  }
  return FINE;
}

static int64_t controlled(Master *m, double t, double end)
{
  const double safety = 0.9, shrink = 0.2, grow = 4.0; /* usual */
  while (t < end) {
    const double target = t + m->step > end - m->smallest ? end : t + m->step;
    double error = 0.0;
    int64_t wrong = FINE;
    int64_t code = save(m, t);
    if (!code) code = twice(m, t, target, &error, &wrong);
    const bool accepted = error <= 1.0;
    if (!code && !accepted) code = back(m, t);
    forget(m, code);
    if (code) return code;
    const double change = error > 0.0 ? safety / (m->first ? cbrt(error) : sqrt(error)) : grow;
    const double proposal = (target - t) * fmin(fmax(change, shrink), grow);
    m->step = accepted && target == end ? fmax(m->step, proposal) : proposal;
    if (accepted) {
      t = target;
      m->steps++;
      if (t < end && (code = over(m))) return code;
    } else {
      m->rejected++;
      if (m->step < m->smallest) {
        if (wrong) return wrong;
        m->failed_time = t;
        return STEP_TOO_SMALL;
      }
    }
  }
  return FINE;
}

/* From points[0] to points[n]; after each step whose `keep` is set, a row of the chosen outputs. */
PF_API int64_t pf_master_run(Master *m, const double *points, int64_t n, const uint8_t *keep, const int64_t *chosen,
                             int64_t n_chosen, double *rows)
{
  int64_t code = FINE;
#ifndef _WIN32
  if (m->threads > 1 && !m->sequence && !(m->pool = start_pool(m))) return NO_THREADS;
#endif
  for (int64_t k = 0; k < n && !code; k++) {
    if (m->step > 0.0) code = controlled(m, points[k], points[k + 1]);
    else if (!(code = advance(m, points[k], points[k + 1], true))) m->steps++;
    if (code) break;
    if (keep[k])
      for (int64_t j = 0; j < n_chosen; j++) *rows++ = m->y[chosen[j]];
    if (!(code = finite(m, points[k + 1]))) code = over(m);
  }
#ifndef _WIN32
  if (m->pool) end_pool(m->pool);
  m->pool = NULL;
#endif
  return code;
}
