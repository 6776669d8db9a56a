/* Signals between the parts of a co-simulation: read, set, handed on at one instant, around algebraic loops. */
#include "pf_master.h"

#include <float.h>
#include <math.h>
#include <string.h>

int64_t pf_master_failed(Master *m, int64_t part, int64_t call, int64_t place, int64_t status, double t)
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
  return part->kind == FMI2
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

int64_t pf_master_get(Master *m, int64_t p, double t)
{
  Part *part = &m->parts[p];
  if (part->kind == IN_PYTHON) return m->python(PY_GET, p, t, t);
  if (part->kind == LINEAR) {
    const double *row = part->output, *u = m->u + part->u_begin;
    const int64_t n_x = part->n_x, n_u = part->u_end - part->u_begin;
    for (int64_t j = part->y_begin; j < part->y_end; j++, row += n_x + n_u) {
      double sum = 0.0;
      for (int64_t k = 0; k < n_x; k++) sum += row[k] * part->x[k];
      for (int64_t k = 0; k < n_u; k++) sum += row[n_x + k] * u[k];
      m->y[j] = sum;
    }
    return FINE;
  }
  for (int64_t g = 0; g < part->n_outputs; g++) {
    const Group *group = &part->outputs[g];
    const int status = call(group->get, part, group);
    if (status > STATUS_WARNING) return pf_master_failed(m, p, CALL_GET, g, status, t);
    unpack(group, m->y);
  }
  return FINE;
}

int64_t pf_master_put(Master *m, int64_t p, double t)
{
  Part *part = &m->parts[p];
  const size_t bytes = (size_t)(part->u_end - part->u_begin) * sizeof(double);
  if (part->terminated) { /* takes no more inputs */
    part->changed = 0;
    return FINE;
  }
  part->changed = part->stale || memcmp(m->u + part->u_begin, m->v + part->u_begin, bytes) != 0;
  if (!part->changed) return FINE;
  part->stale = 0;
  memcpy(m->u + part->u_begin, m->v + part->u_begin, bytes);
  if (part->kind == IN_PYTHON) return m->python(PY_PUT, p, t, t);
  for (int64_t g = 0; g < part->n_inputs; g++) {
    const Group *group = &part->inputs[g];
    const int64_t wrong = pack(group, m->u);
    if (wrong >= 0) {
      pf_master_failed(m, p, CALL_SET, group->places[wrong], 0, t);
      return OUT_OF_RANGE;
    }
    const int status = call(group->set, part, group);
    if (status > STATUS_WARNING) return pf_master_failed(m, p, CALL_SET, g, status, t);
  }
  return FINE;
}

/* -- wires ------------------------------------------------------------------------------------------------------ */

static double weighted(const Wires *wires, int64_t i, const double *from)
{
  double sum = 0.0;
  for (int64_t k = wires->row[i]; k < wires->row[i + 1]; k++) sum += wires->weight[k] * from[wires->column[k]];
  return sum;
}

static double along(const Wires *wires, int64_t i, const double *from)
{
  return weighted(wires, i, from) + wires->offset[i];
}

int64_t pf_master_outside(Master *m, double t)
{
  const int64_t n = m->n_outside, last = m->n_table - 1;
  if (n == 0) return FINE;
  if (m->functions) return m->python(PY_OUTSIDE, 0, t, t);
  while (m->place < last - 1 && t >= m->table_t[m->place + 1]) m->place++;
  while (m->place > 0 && t < m->table_t[m->place]) m->place--;
  const double *a = m->table + m->place * n, *b = a + n;
  const double start = m->table_t[m->place], end = m->table_t[m->place + 1];
  for (int64_t j = 0; j < n; j++)
    m->now[j] = t <= start ? a[j] : t >= end ? b[j] : (b[j] - a[j]) / (end - start) * (t - start) + a[j];
  return FINE;
}

int64_t pf_master_wired(Master *m, double t, int64_t begin, int64_t end)
{
  const int64_t code = pf_master_outside(m, t);
  for (int64_t i = begin; i < end; i++)
    m->v[i] = m->outside.driven[i] ? along(&m->outside, i, m->now)
        : m->wires.driven[i] ? along(&m->wires, i, m->y)
                                     : m->u[i];
  return code;
}

/* What a part is to hold over a step to `end`, into v: an input that moves follows a line, or has the line's value in
 * the middle of the step where the part takes no slopes. */
int64_t pf_master_aim(Master *m, int64_t p, double t, double end)
{
  const Part *part = &m->parts[p];
  const double half = part->follows ? 0.0 : 0.5 * (end - t);
  const int64_t begin = part->u_begin;
  int64_t code = FINE;
  if (m->sequence) code = pf_master_wired(m, t, begin, part->u_end);
  else memcpy(m->v + begin, m->u + begin, (size_t)(part->u_end - begin) * sizeof(double));
  for (int64_t i = begin; i < part->u_end; i++) {
    if (!m->moves[i]) continue;
    const bool outside = m->outside.driven[i];
    const Wires *wires = outside ? &m->outside : &m->wires;
    m->u_slope[i] = weighted(wires, i, outside ? m->rate : m->y_slope);
    m->v[i] = along(wires, i, outside ? m->base : m->y_begin) + half * m->u_slope[i];
  }
  return code;
}

/* -- at one instant --------------------------------------------------------------------------------------------- */

static int64_t wired_off_loops(Master *m, double t)
{
  const int64_t code = pf_master_wired(m, t, 0, m->n_u);
  if (m->n_loops)
    for (int64_t i = 0; i < m->n_u; i++)
      if (m->held[i]) m->v[i] = m->u[i];
  return code;
}

/* Signals handed on until they rest, or feedthrough has reached the last output; inputs on loops stay. */
static int64_t hand_on(Master *m, double t, int64_t passes, bool *rest)
{
  int64_t code;
  *rest = true;
  for (int64_t pass = 0; pass < passes; pass++) {
    int64_t changed = 0;
    if ((code = wired_off_loops(m, t))) return code;
    for (int64_t p = 0; p < m->n_parts; p++) {
      if ((code = pf_master_put(m, p, t))) return code;
      changed |= m->parts[p].changed;
    }
    if (!changed) return FINE;
    for (int64_t p = 0; p < m->n_parts; p++) { /* an FMU is read whatever its description says of feedthrough */
      const Part *part = &m->parts[p];
      if (part->changed && (part->feedthrough || part->kind != LINEAR) && (code = pf_master_get(m, p, t))) return code;
    }
  }
  if ((code = wired_off_loops(m, t))) return code;
  double largest = 0.0, moved = 0.0;
  for (int64_t i = 0; i < m->n_u; i++) {
    if (!isfinite(m->v[i])) continue;
    const double by = fabs(m->v[i] - m->u[i]);
    largest = fmax(largest, fabs(m->v[i]));
    if (!(by <= moved)) moved = isfinite(by) ? by : INFINITY;
  }
  *rest = moved <= 1e-6 * largest;
  return FINE;
}

static double size(const double *values, int64_t n)
{
  double largest = 0.0;
  for (int64_t k = 0; k < n; k++)
    if (!(fabs(values[k]) <= largest)) largest = isfinite(values[k]) ? fabs(values[k]) : INFINITY;
  return largest;
}

/* r = w(v) - v, the parts on the loop told of v. */
static int64_t residual(Master *m, Loop *loop, double t, const double *v, double *r)
{
  int64_t code;
  for (int64_t k = 0; k < loop->n_parts; k++) {
    const Part *part = &m->parts[loop->parts[k]];
    memcpy(m->v + part->u_begin, m->u + part->u_begin, (size_t)(part->u_end - part->u_begin) * sizeof(double));
  }
  for (int64_t k = 0; k < loop->n; k++) m->v[loop->inputs[k]] = v[k];
  for (int64_t k = 0; k < loop->n_parts; k++) {
    const int64_t p = loop->parts[k];
    if ((code = pf_master_put(m, p, t))) return code;
    if (m->parts[p].changed && (code = pf_master_get(m, p, t))) return code;
  }
  for (int64_t k = 0; k < loop->n; k++) r[k] = along(&m->wires, loop->inputs[k], m->y) - v[k];
  return FINE;
}

/* Broyden's update of I - w' after a step that left the residual `fresh`, on its inverse (Sherman and Morrison). */
static bool update(Loop *loop)
{
  const int64_t n = loop->n;
  double length = 0.0, along_it = 0.0;
  for (int64_t i = 0; i < n; i++) {
    length += loop->step[i] * loop->step[i];
    double sum = 0.0;
    for (int64_t k = 0; k < n; k++) sum += loop->real[k] ? loop->inverse[i * n + k] * loop->fresh[k] : 0.0;
    loop->left[i] = sum;
    along_it += loop->real[i] ? loop->step[i] * sum : 0.0;
  }
  const double below = length - along_it;
  if (!(below > 1e-8 * length)) return false;
  for (int64_t k = 0; k < n; k++) {
    double sum = 0.0;
    for (int64_t i = 0; i < n; i++) sum += loop->real[i] ? loop->step[i] * loop->inverse[i * n + k] : 0.0;
    loop->r[k] = sum / below;
  }
  for (int64_t i = 0; i < n; i++)
    for (int64_t k = 0; k < n; k++) loop->inverse[i * n + k] += loop->left[i] * loop->r[k];
  return true;
}

/* Newton's steps with the inverse from before, as in cosimulation_loops.py; where these do not do, Python takes a new
 * one, by directional derivatives or differences, shortens steps, and says what is wrong. */
static int64_t solve(Master *m, int64_t which, double t)
{
  Loop *loop = &m->loops[which];
  const int64_t n = loop->n;
  int64_t code;
  for (int64_t k = 0; k < n; k++) {
    loop->v[k] = m->u[loop->inputs[k]];
    loop->r[k] = along(&m->wires, loop->inputs[k], m->y) - loop->v[k];
    loop->left[k] = loop->v[k] + loop->r[k];
  }
  loop->scale = fmax(loop->scale, fmax(size(loop->v, n), size(loop->left, n)));
  for (int64_t pass = 0; pass < 8; pass++) {
    const double before = size(loop->r, n);
    if (before <= 1e-10 * loop->scale) return FINE;
    if (!loop->ready || !isfinite(before)) break;
    for (int64_t i = 0; i < n; i++) {
      double sum = 0.0;
      for (int64_t k = 0; k < n; k++) sum += loop->inverse[i * n + k] * loop->r[k];
      loop->step[i] = sum;
      loop->left[i] = loop->v[i] + sum;
    }
    if (!(size(loop->left, n) <= 1e6 * loop->scale)) break;
    if ((code = residual(m, loop, t, loop->left, loop->fresh))) return code;
    if (!(size(loop->fresh, n) <= before)) {
      if ((code = residual(m, loop, t, loop->v, loop->r))) return code;
      break;
    }
    memcpy(loop->v, loop->left, (size_t)n * sizeof(double));
    const bool regular = size(loop->fresh, n) <= 1e-10 * loop->scale || update(loop);
    memcpy(loop->r, loop->fresh, (size_t)n * sizeof(double));
    if (!regular) break;
  }
  m->loops_in_python++;
  return m->python(PY_LOOP, which, t, t);
}

int64_t pf_master_settle(Master *m, double t)
{
  int64_t code;
  bool rest = true;
  if (m->settled_in_python) return m->python(PY_SETTLE, 0, t, t);
  for (int64_t p = 0; p < m->n_parts; p++)
    if ((code = pf_master_get(m, p, t))) return code;
  for (int64_t k = 0; k < m->n_loops; k++)
    if ((code = hand_on(m, t, m->n_y + 1, &rest)) || (code = solve(m, k, t))) return code;
  if ((code = hand_on(m, t, m->n_loops ? m->n_y + 1 : m->passes, &rest)) || rest) return code;
  /* An output depends on an input that its FMU's description leaves out; Python finds the loops anew. */
  m->settled_in_python = 1;
  return m->python(PY_SETTLE, 0, t, t);
}
