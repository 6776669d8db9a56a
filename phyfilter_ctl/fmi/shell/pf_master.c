/* The master's inner loop: communication steps of co-simulation FMUs of FMI 2.0 and 3.0, Jacobi or Gauss-Seidel, over
 * given points or by step doubling. It does what cosimulation_run.py does, call for call, except that a part whose
 * inputs have not changed is not told them again. master.py fills the structures and reads what failed. */
#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
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

enum { FLOAT64, FLOAT32, INT8, UINT8, INT16, UINT16, INT32, UINT32, INT64, UINT64, BOOLEAN2, BOOLEAN3 };
enum { FINE, CALL_FAILED, OUT_OF_RANGE, STEP_TOO_SMALL, TERMINATED, NOT_FINITE, NO_THREADS, UNSETTLED };
enum { CALL_GET, CALL_SET, CALL_STEP, CALL_SAVE, CALL_RESTORE };
enum { STATUS_WARNING = 1, STATUS_DISCARD = 2 };

typedef void (*Function)(void);

typedef struct {                /* variables of one type */
  int64_t type;
  Function get, set;
  const uint32_t *references;
  int64_t n_references, n;
  void *values;
  const int64_t *places;      /* in u or y */
} Group;

typedef struct {
  void *instance;
  int64_t fmi;
  Function step, save, restore, forget;
  Group *inputs, *outputs;
  int64_t n_inputs, n_outputs, u_begin, u_end;
  int64_t feedthrough, changed;
  void *state;
  int64_t status, terminated;
  double reached;
} Part;

typedef struct {                /* rows of a sparse matrix, and what is added */
  const int64_t *row, *column;
  const double *weight, *offset;
  const uint8_t *driven;
} Wires;

typedef struct {
  int64_t n_parts;
  Part *parts;
  const int64_t *sequence;    /* NULL: Jacobi */
  int64_t n_u, n_y;
  Wires wires, outside;
  int64_t n_outside, n_table, place;
  const double *table_t, *table; /* what comes from outside, linear in between */
  double *now;                   /* (n_outside) */
  int64_t passes;
  double *u, *y, *v, *saved_u, *saved_y, *coarse;
  const uint8_t *watched; /* outputs that must be numbers */
  double rtol, atol, step, smallest;
  int64_t steps, rejected, threads;
  void *pool;
  int64_t failed_part, failed_call, failed_place, failed_status; /* place: of the group, or in y */
  double failed_time;
} Master;

static int64_t failed(Master *m, int64_t part, int64_t call, int64_t place, int64_t status, double t)
{
  m->failed_part = part;
  m->failed_call = call;
  m->failed_place = place;
  m->failed_status = status;
  m->failed_time = t;
  return CALL_FAILED;
}

/* -- values ----------------------------------------------------------------------------------------------------- */

static int call(Function f, const Part *part, const Group *group)
{
  typedef int (*Two)(void *, const uint32_t *, size_t, void *);
  typedef int (*Three)(void *, const uint32_t *, size_t, void *, size_t);
  return part->fmi == 2
    ? ((Two)f)(part->instance, group->references, (size_t)group->n_references, group->values)
    : ((Three)f)(part->instance, group->references, (size_t)group->n_references, group->values, (size_t)group->n);
}

#define READ(TYPE) for (int64_t k = 0; k < group->n; k++) to[group->places[k]] = (double)((const TYPE *)group->values)[k]

static void unpack(const Group *group, double *to)
{
  switch (group->type) {
  case FLOAT64: READ(double); break;
  case FLOAT32: READ(float); break;
  case INT8: READ(int8_t); break;
  case UINT8: READ(uint8_t); break;
  case INT16: READ(int16_t); break;
  case UINT16: READ(uint16_t); break;
  case INT32: case BOOLEAN2: READ(int32_t); break;
  case UINT32: READ(uint32_t); break;
  case INT64: READ(int64_t); break;
  case UINT64: READ(uint64_t); break;
  default: READ(bool); break;
  }
}

/* 2^63 and 2^64 are no values of the type, what is below them is. */
#define WRITE(TYPE, LOW, BEYOND) \
  for (int64_t k = 0; k < group->n; k++) { \
    const double value = from[group->places[k]]; \
    if (!(value >= (LOW) && value < (BEYOND) && value == floor(value))) return k; \
    ((TYPE *)group->values)[k] = (TYPE)value; \
  }

static int64_t pack(const Group *group, const double *from)
{
  switch (group->type) {
  case FLOAT64: for (int64_t k = 0; k < group->n; k++) ((double *)group->values)[k] = from[group->places[k]]; break;
  case FLOAT32:
    for (int64_t k = 0; k < group->n; k++) {
      const double value = from[group->places[k]];
      if (isfinite(value) && fabs(value) > FLT_MAX) return k;
      ((float *)group->values)[k] = (float)value;
    }
    break;
  case INT8: WRITE(int8_t, -128.0, 128.0) break;
  case UINT8: WRITE(uint8_t, 0.0, 256.0) break;
  case INT16: WRITE(int16_t, -32768.0, 32768.0) break;
  case UINT16: WRITE(uint16_t, 0.0, 65536.0) break;
  case INT32: WRITE(int32_t, -2147483648.0, 2147483648.0) break;
  case UINT32: WRITE(uint32_t, 0.0, 4294967296.0) break;
  case INT64: WRITE(int64_t, -9223372036854775808.0, 9223372036854775808.0) break;
  case UINT64: WRITE(uint64_t, 0.0, 18446744073709551616.0) break;
  case BOOLEAN2: WRITE(int32_t, 0.0, 2.0) break;
  default: WRITE(bool, 0.0, 2.0) break;
  }
  return -1;
}

static int64_t get(Master *m, int64_t p, double t)
{
  Part *part = &m->parts[p];
  for (int64_t g = 0; g < part->n_outputs; g++) {
    const Group *group = &part->outputs[g];
    const int status = call(group->get, part, group);
    if (status > STATUS_WARNING) return failed(m, p, CALL_GET, g, status, t);
    unpack(group, m->y);
  }
  return FINE;
}

static int64_t put(Master *m, int64_t p, double t)
{
  Part *part = &m->parts[p];
  const size_t bytes = (size_t)(part->u_end - part->u_begin) * sizeof(double);
  part->changed = memcmp(m->u + part->u_begin, m->v + part->u_begin, bytes) != 0;
  if (!part->changed) return FINE;
  memcpy(m->u + part->u_begin, m->v + part->u_begin, bytes);
  for (int64_t g = 0; g < part->n_inputs; g++) {
    const Group *group = &part->inputs[g];
    const int64_t wrong = pack(group, m->u);
    if (wrong >= 0) {
      failed(m, p, CALL_SET, group->places[wrong], 0, t);
      return OUT_OF_RANGE;
    }
    const int status = call(group->set, part, group);
    if (status > STATUS_WARNING) return failed(m, p, CALL_SET, g, status, t);
  }
  return FINE;
}

/* -- wires ------------------------------------------------------------------------------------------------------ */

static double along(const Wires *wires, int64_t i, const double *from)
{
  double sum = 0.0;
  for (int64_t k = wires->row[i]; k < wires->row[i + 1]; k++) sum += wires->weight[k] * from[wires->column[k]];
  return sum + wires->offset[i];
}

static void from_outside(Master *m, double t)
{
  const int64_t n = m->n_outside, last = m->n_table - 1;
  if (n == 0) return;
  while (m->place < last - 1 && t >= m->table_t[m->place + 1]) m->place++;
  while (m->place > 0 && t < m->table_t[m->place]) m->place--;
  const double *a = m->table + m->place * n, *b = a + n;
  const double start = m->table_t[m->place], end = m->table_t[m->place + 1];
  for (int64_t j = 0; j < n; j++)
    m->now[j] = t <= start ? a[j] : t >= end ? b[j] : (b[j] - a[j]) / (end - start) * (t - start) + a[j];
}

static void wired(Master *m, double t, int64_t begin, int64_t end)
{
  from_outside(m, t);
  for (int64_t i = begin; i < end; i++)
    m->v[i] = m->outside.driven[i] ? along(&m->outside, i, m->now)
        : m->wires.driven[i] ? along(&m->wires, i, m->y)
                                     : m->u[i];
}

/* Whether another pass would move nothing. */
static int64_t rests(Master *m, double t)
{
  double largest = 0.0, moved = 0.0;
  wired(m, t, 0, m->n_u);
  for (int64_t i = 0; i < m->n_u; i++) {
    if (!isfinite(m->v[i])) continue;
    largest = fmax(largest, fabs(m->v[i]));
    moved = fmax(moved, fabs(m->v[i] - m->u[i]));
  }
  m->failed_time = t;
  return moved <= 1e-6 * largest ? FINE : UNSETTLED;
}

/* Signals handed on at one instant, until they rest or feedthrough has reached the last output. */
static int64_t settle(Master *m, double t)
{
  int64_t code;
  for (int64_t p = 0; p < m->n_parts; p++)
    if ((code = get(m, p, t))) return code;
  for (int64_t pass = 0; pass < m->passes; pass++) {
    int64_t changed = 0;
    wired(m, t, 0, m->n_u);
    for (int64_t p = 0; p < m->n_parts; p++) {
      if ((code = put(m, p, t))) return code;
      changed |= m->parts[p].changed;
    }
    if (!changed) return FINE;
    for (int64_t p = 0; p < m->n_parts; p++)
      if (m->parts[p].changed && m->parts[p].feedthrough && (code = get(m, p, t))) return code;
  }
  return rests(m, t);
}

/* -- steps ------------------------------------------------------------------------------------------------------ */

static void do_step(Part *part, double t, double end, bool final)
{
  typedef int (*Two)(void *, double, double, int);
  typedef int (*Three)(void *, double, double, bool, bool *, bool *, bool *, double *);
  const double rest = 1e-9 * (end - t);
  double before = t;
  part->terminated = 0;
  if (part->fmi == 2) {
    part->status = ((Two)part->step)(part->instance, t, end - t, final);
    return;
  }
  do { /* an FMU that returns early, at an event, goes on from there */
    bool event = false, terminate = false, early = false;
    part->reached = end;
    part->status = ((Three)part->step)(part->instance, before, end - before, final, &event, &terminate, &early,
                                           &part->reached);
    if (part->status > STATUS_WARNING || !(early || terminate)) return;
    part->terminated = terminate;
    if (part->reached <= before) part->status = terminate ? 0 : STATUS_DISCARD;
    if (terminate || part->reached <= before) return;
    before = part->reached;
  } while (before < end - rest);
}

static int64_t stepped(Master *m, int64_t p, double t)
{
  const Part *part = &m->parts[p];
  if (part->status > STATUS_WARNING) return failed(m, p, CALL_STEP, 0, part->status, t);
  if (part->terminated) {
    failed(m, p, CALL_STEP, 0, 0, part->reached);
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
  for (int64_t p = number; p < pool->master->n_parts; p += pool->count + 1)
    do_step(&pool->master->parts[p], pool->t, pool->end, pool->final);
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

static int64_t advance(Master *m, double t, double end, bool final)
{
  int64_t code;
  if (m->sequence) {
    for (int64_t k = 0; k < m->n_parts; k++) {
      const int64_t p = m->sequence[k];
      wired(m, t, m->parts[p].u_begin, m->parts[p].u_end);
      if ((code = put(m, p, t))) return code;
      do_step(&m->parts[p], t, end, final);
      if ((code = stepped(m, p, t)) || (code = get(m, p, end))) return code;
    }
    return settle(m, end);
  }
#ifndef _WIN32
  if (m->pool) step_all(m, t, end, final);
  else
#endif
  for (int64_t p = 0; p < m->n_parts; p++) {
    do_step(&m->parts[p], t, end, final);
    if ((code = stepped(m, p, t))) return code;
  }
  for (int64_t p = 0; p < m->n_parts; p++)
    if ((code = stepped(m, p, t))) return code;
  return settle(m, end);
}

/* -- step control ----------------------------------------------------------------------------------------------- */

typedef int (*OfState)(void *, void **);

static int64_t save(Master *m, double t)
{
  for (int64_t p = 0; p < m->n_parts; p++) {
    const int status = ((OfState)m->parts[p].save)(m->parts[p].instance, &m->parts[p].state);
    if (status > STATUS_WARNING) return failed(m, p, CALL_SAVE, 0, status, t);
  }
  memcpy(m->saved_u, m->u, (size_t)m->n_u * sizeof(double));
  memcpy(m->saved_y, m->y, (size_t)m->n_y * sizeof(double));
  return FINE;
}

static int64_t back(Master *m, double t)
{
  typedef int (*Restore)(void *, void *);
  for (int64_t p = 0; p < m->n_parts; p++) {
    const int status = ((Restore)m->parts[p].restore)(m->parts[p].instance, m->parts[p].state);
    if (status > STATUS_WARNING) return failed(m, p, CALL_RESTORE, 0, status, t);
  }
  memcpy(m->u, m->saved_u, (size_t)m->n_u * sizeof(double));
  memcpy(m->y, m->saved_y, (size_t)m->n_y * sizeof(double));
  return FINE;
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

/* One step, then two halves from the same state; the error over what is allowed. */
static int64_t twice(Master *m, double t, double end, double *error, bool *wrong)
{
  const double middle = t + 0.5 * (end - t);
  int64_t code = advance(m, t, end, true);
  if (!code) {
    memcpy(m->coarse, m->y, (size_t)m->n_y * sizeof(double));
    code = back(m, t);
  }
  if (!code) code = advance(m, t, middle, true);
  if (!code) code = advance(m, middle, end, false); /* t, which comes before, may be gone back to */
  *error = INFINITY; /* a discarded step is wrong beyond measure, and one to what is no number */
  *wrong = !code && finite(m, end);
  if (*wrong) return FINE;
  if (code == CALL_FAILED && m->failed_call == CALL_STEP && m->failed_status == STATUS_DISCARD) return FINE;
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
  const double safety = 0.9, shrink = 0.2, grow = 4.0; /* usual for a method of order one */
  while (t < end) {
    const double target = t + m->step > end - m->smallest ? end : t + m->step;
    double error = 0.0;
    bool wrong = false;
    int64_t code = save(m, t);
    if (!code) code = twice(m, t, target, &error, &wrong);
    const bool accepted = error <= 1.0;
    if (!code && !accepted) code = back(m, t);
    for (int64_t p = 0; p < m->n_parts; p++)
      if (m->parts[p].state) {
        ((OfState)m->parts[p].forget)(m->parts[p].instance, &m->parts[p].state);
        m->parts[p].state = NULL;
      }
    if (code) return code;
    const double change = error > 0.0 ? safety / sqrt(error) : grow;
    const double proposal = (target - t) * fmin(fmax(change, shrink), grow);
    m->step = accepted && target == end ? fmax(m->step, proposal) : proposal;
    if (accepted) {
      t = target;
      m->steps++;
    } else {
      m->rejected++;
      if (m->step < m->smallest) {
        if (wrong) return NOT_FINITE;
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
    code = finite(m, points[k + 1]);
  }
#ifndef _WIN32
  if (m->pool) end_pool(m->pool);
  m->pool = NULL;
#endif
  return code;
}
