/* Events in a step of integration: which condition passes 0 first, where, and what its reset sets off. For pf_run.c.
 *
 * A condition has a side, the sign it was last seen with. One that was 0 but for rounding waits: its side is where it is
 * heading, and its sign counts from when it was seen there. Inside a step a cubic polynomial shows what to look for;
 * where it is, steps of the method itself decide, down to the rounding of time. One that an event leaves beyond 0 on its
 * way back, and that does not get there, has met events too fast for the rounding of time: they are endless. */
enum { LOOKS = 8, MOST_ROUNDS = 100, MOST_IN_A_ROW = 40 };

static const pf_time LOOK[LOOKS] = {1.0 / 1048576, 1.0 / 1024, 1.0 / 32, 0.125, 0.25, 0.5, 0.75, 1.0};
/* Before the first of them, for what comes back sooner still. */
static const pf_time EARLY[LOOKS] = {0x1p-48, 0x1p-44, 0x1p-40, 0x1p-36, 0x1p-32, 0x1p-28, 0x1p-24, 0x1p-20};

#define EVENT_EPS (sizeof(pf_real) == 8 ? 2.2e-16 : 1.2e-7)
#define LOST (sizeof(pf_real) == 8 ? (pf_real)1e-9 : (pf_real)1e-4)

typedef struct {
  const segment *way;
  const pf_event_table *events;
  pf_side *sides;
  pf_real *work, *x1, *f0, *f1, *x, *g, *g0, *fired, *before; /* before: sides and waiting */
  int method;
  pf_time t, h;
} look;

static look look_at(const segment *way, pf_real *work, int method, pf_time t, pf_time h) {
  const pf_event_table *const events = way->model->events;
  const int n = way->model->n_x, count = events->count;
  pf_real *const area = work + (size_t)ADAPTIVE_VECTORS * (size_t)n + (size_t)way->model->n_u + 1;
  pf_real *const g = area + EVENT_VECTORS * n;
  return (look){way, events, events->sides(way->self), work, area, area + n, area + 2 * n, area + 3 * n,
                g, g + count, g + 2 * count, g + 3 * count, method, t, h};
}

static int past(const pf_side *side, pf_real g) { return (side->side > 0 && g <= 0) || (side->side < 0 && g >= 0); }

static int fires(const look *at, const pf_real *g, int i) {
  return past(at->sides + i, g[i]) && !at->sides[i].waiting && at->events->directions[i] * at->sides[i].side <= 0;
}

static int first_fired(const look *at, const pf_real *g) {
  for (int i = 0; i < at->events->count; i++)
    if (fires(at, g, i)) return i;
  return -1;
}

static void see(const look *at, const pf_real *g) {
  for (int i = 0; i < at->events->count; i++) {
    pf_side *const side = at->sides + i;
    if (side->waiting) side->waiting = (signed char)past(side, g[i]);
    if (!side->waiting && (g[i] < 0 || g[i] > 0)) side->side = g[i] > 0 ? 1 : -1;
  }
}

static void keep_sides(const look *at, int restore) {
  for (int i = 0; i < at->events->count; i++) {
    pf_real *const kept = at->before + 2 * i;
    if (restore) {
      at->sides[i].side = (signed char)kept[0];
      at->sides[i].waiting = (signed char)kept[1];
    } else {
      kept[0] = at->sides[i].side;
      kept[1] = at->sides[i].waiting;
    }
  }
}

/* A condition that was on its way back to its side after an event and fell away from it, at the end of a step; -1 for
 * none. */
static int missed(const look *at) {
  for (int i = 0; i < at->events->count; i++) {
    pf_side *const side = at->sides + i;
    const pf_real beyond = (pf_real)at->events->directions[i] * at->g[i];
    if (!side->back) continue;
    if (beyond < 0) side->back = 0;
    if (at->h > 0.0 && !(at->h > at->events->clock(at->way->self)->soon)) continue;
    if (beyond > 1000 * side->depth && beyond > LOST * side->largest) return i;
  }
  return -1;
}

static int conditions_at(const look *at, pf_time part, pf_real *g) {
  const pf_time t = at->t + part * at->h;
  set_inputs(at->way, t);
  return at->events->conditions(at->way->self, t, at->x, g);
}

/* x at a part of the step: on the polynomial, or by a step of the method that ends there. */
static int place(const look *at, pf_time part, int exact) {
  const int n = at->way->model->n_x;
  const pf_real *const x0 = at->way->x, *found = at->x1;
  if (part < 1.0 && !exact) {
    const pf_real s = (pf_real)part, r = 1 - s, h = (pf_real)at->h;
    for (int i = 0; i < n; i++)
      at->x[i] = (1 + 2 * s) * r * r * x0[i] + s * s * (3 - 2 * s) * at->x1[i] +
                 s * r * h * (r * at->f0[i] - s * at->f1[i]);
    return PF_OK;
  }
  if (part < 1.0) {
    const int status = attempt(at->way, at->work, at->method, at->t, at->t + part * at->h);
    if (status) return status;
    found = trial_of(at->way->model, at->work, at->method);
  }
  for (int i = 0; i < n; i++) at->x[i] = found[i];
  return PF_OK;
}

static int seek(const look *at, const pf_time *parts, int from, int exact, int *found) {
  *found = -1;
  for (int j = from; j < LOOKS && *found < 0; j++) {
    int status = place(at, parts[j], exact);
    if (!status) status = conditions_at(at, parts[j], at->g);
    if (status) return status;
    if (first_fired(at, at->g) >= 0)
      *found = j;
    else
      see(at, at->g);
  }
  return PF_OK;
}

/* The rounding of time as a part of the step. */
static pf_time least_part(const look *at) {
  return TIME_ROUNDING * (magnitude(at->t) > at->h ? magnitude(at->t) : at->h) / at->h;
}

/* Narrows a bracket of parts that the first event lies in; the conditions at its end are in g. */
static int narrow(const look *at, pf_time begin, pf_time *end) {
  const pf_time least = least_part(at);
  for (int round = 0; *end - begin > least && round < 200; round++) {
    const int i = first_fired(at, at->g);
    const pf_time length = *end - begin, a = (pf_time)at->g0[i], b = (pf_time)at->g[i];
    pf_time part = begin + 0.5 * length;
    if (round % 3 && ((a < 0 && b > 0) || (a > 0 && b < 0)))
      part = begin + length * a / (a - b) + (round % 3 == 1 ? 1e-4 : -1e-4) * length;
    if (!(part > begin && part < *end)) part = begin + 0.5 * length;
    pf_real *const g = at->fired; /* free until the end */
    int status = place(at, part, 1);
    if (!status) status = conditions_at(at, part, g);
    if (status) return status;
    const int here = first_fired(at, g) >= 0;
    if (here)
      *end = part;
    else {
      begin = part;
      see(at, g);
    }
    for (int j = 0; j < at->events->count; j++) *(here ? at->g + j : at->g0 + j) = g[j];
  }
  return PF_OK;
}

/* The first event in the step just tried, whose end is in the method's trial: *part of it, with x there; else -1. */
static int first_event(const look *at, pf_time *part) {
  const segment *const way = at->way;
  const pf_event_table *const events = at->events;
  const pf_real *const trial = trial_of(way->model, at->work, at->method);
  const pf_time *parts = LOOK;
  int found, waits = 0, status;
  *part = -1.0;
  for (int i = 0; i < way->model->n_x; i++) at->x1[i] = trial[i];
  status = slopes_at(way, at->t, way->x, at->f0);
  if (!status) status = slopes_at(way, at->t + at->h, at->x1, at->f1);
  keep_sides(at, 0);
  if (!status) status = seek(at, parts, 0, 0, &found);
  if (status) return status;
  pf_events *const clock = events->clock(way->self);
  const int lost = found < 0 ? missed(at) : -1;
  for (int i = 0; i < events->count; i++) waits |= at->sides[i].waiting && events->directions[i] * at->sides[i].side < 0;
  if (found < 0 && waits && at->h > clock->soon) { /* back, and through 0 again, sooner than was looked */
    parts = EARLY;
    keep_sides(at, 1);
    status = seek(at, parts, 0, 0, &found);
    if (!status && found < 0) { /* so soon that no time is between */
      for (int i = 0; i < events->count; i++)
        at->fired[i] = (pf_real)(at->sides[i].waiting && events->directions[i] * at->sides[i].side < 0);
      for (int i = 0; i < way->model->n_x; i++) at->x[i] = way->x[i];
      *part = 0.0;
    }
  }
  if (!status && found < 0 && lost >= 0) {
    clock->latest = lost;
    return PF_ENDLESS_EVENTS;
  }
  if (status || found < 0) return status;
  pf_time begin = found ? parts[found - 1] : 0.0;
  status = seek(at, parts, found, 1, &found);
  if (status || found < 0) return status;
  pf_time end = parts[found];
  if (found && parts[found - 1] > begin) begin = parts[found - 1];
  if (begin > 0.0)
    status = place(at, begin, 1);
  else
    for (int i = 0; i < way->model->n_x; i++) at->x[i] = way->x[i];
  if (!status) status = conditions_at(at, begin, at->g0);
  if (!status) status = narrow(at, begin, &end);
  for (int again = 1; again >= 0 && !status; again--) {
    status = place(at, end, 1);
    if (!status) status = conditions_at(at, end, at->g);
    const int i = status ? -1 : first_fired(at, at->g);
    if (i < 0 || at->g[i] < 0 || at->g[i] > 0 || !(end < 1.0)) break;
    end += least_part(at); /* just past 0, as a reset that asks for the sign expects it */
    if (!(end < 1.0)) end = 1.0;
  }
  for (int i = 0; i < events->count; i++) at->fired[i] = (pf_real)fires(at, at->g, i);
  *part = end;
  return status;
}

/* Sides after events; which others have been set off. */
static void arm(const look *at, pf_events *clock, pf_time step) {
  clock->soon = (10 * EVENT_EPS > 1e-9 ? 10 * EVENT_EPS : 1e-9) * clock->h + 1e4 * 2.2e-16 * magnitude(at->t);
  for (int i = 0; i < at->events->count; i++) {
    pf_side *const side = at->sides + i;
    const pf_real g = at->g[i], rate = (at->g0[i] - g) / (pf_real)step;
    const int seen = (g > 0) - (g < 0), moves = (rate > 0) - (rate < 0), was = side->side;
    const int direction = at->events->directions[i], fired = at->fired[i] > 0;
    at->fired[i] = 0;
    if (!(magnitude((pf_time)g) <= (pf_time)side->largest)) side->largest = g < 0 ? -g : g;
    if (fired) {
      side->back = (signed char)(direction && moves == -direction && seen != -direction);
      side->depth = g < 0 ? -g : g;
    }
    if (!clock->armed) {
      side->side = (signed char)(seen ? seen : moves);
      side->waiting = 0;
    } else if (fired && magnitude((pf_time)g) <= magnitude((pf_time)rate) * clock->soon) {
      const int heading = !moves || !direction ? -was : moves, again = !direction && moves * was > 0;
      side->side = (signed char)heading;
      side->waiting = (signed char)(!again && seen != heading);
    } else if (fired) {
      side->side = (signed char)seen;
      side->waiting = 0;
    } else if (!side->waiting && was && seen == -was) {
      at->fired[i] = (pf_real)(direction * was <= 0);
      side->side = (signed char)seen;
    }
  }
  clock->armed = 1;
}

/* Runs the events in `fired` at t, and those that they, or a jump of inputs and held signals, set off. */
static int settle(const look *at) {
  const segment *const way = at->way;
  pf_events *const clock = at->events->clock(way->self);
  const int n = way->model->n_x;
  pf_time step = (sizeof(pf_real) == 8 ? 1e-6 : 1e-2) * (clock->h > 0.0 ? clock->h : 1.0);
  for (int round = 0; round < MOST_ROUNDS; round++) {
    int status = PF_OK, again = 0;
    for (int i = 0; i < at->events->count && !status; i++) {
      if (!(at->fired[i] > 0)) continue;
      const pf_time scale = magnitude(at->t) > 1.0 ? magnitude(at->t) : 1.0, since = at->t - clock->last;
      if (clock->count && since > 0.0 && 1e-3 * since < step) step = 1e-3 * since; /* rates of what is as quick */
      clock->in_a_row = clock->count && at->t - clock->last <= 1e-12 * scale ? clock->in_a_row + 1 : 0;
      clock->last = at->t;
      clock->latest = i;
      clock->count++;
      if (clock->in_a_row > MOST_IN_A_ROW) return PF_ENDLESS_EVENTS;
      status = at->events->reset(way->self, at->t, i, way->x);
    }
    if (!status) accept(way, at->t);
    if (!status) status = slopes_at(way, at->t, way->x, at->f0);
    for (int i = 0; i < n; i++) at->x[i] = way->x[i];
    if (!status) status = at->events->conditions(way->self, at->t, at->x, at->g);
    for (int i = 0; i < n; i++) at->x[i] += (pf_real)step * at->f0[i];
    set_inputs(way, at->t + step);
    if (!status) status = at->events->conditions(way->self, at->t + step, at->x, at->g0);
    set_inputs(way, at->t);
    if (status) return status;
    arm(at, clock, step);
    for (int i = 0; i < at->events->count; i++) again |= at->fired[i] > 0;
    if (!again) return PF_OK;
  }
  return PF_ENDLESS_EVENTS;
}

/* Events that no step led to: at the start, and where inputs or held signals jumped. */
static int settle_here(const segment *way, pf_real *work, int method, pf_time t) {
  const look at = look_at(way, work, method, t, 0.0);
  for (int i = 0; i < at.events->count; i++) at.fired[i] = 0;
  return settle(&at);
}

/* After a step from t to *next was tried: 1 in *happened where an event cuts it short. Then *next is the event's time,
 * and x is what it is after it. */
static int cut_by_event(const segment *way, pf_real *work, int method, pf_time t, pf_time *next, int *happened) {
  const look at = look_at(way, work, method, t, *next - t);
  pf_time part;
  int status = first_event(&at, &part);
  *happened = 0;
  set_inputs(way, *next);
  if (status || part < 0.0) {
    pf_real *const trial = trial_of(way->model, work, method);
    for (int i = 0; i < way->model->n_x; i++) trial[i] = at.x1[i];
    return status;
  }
  look here = at;
  here.t = part < 1.0 ? t + part * at.h : *next;
  *next = here.t;
  *happened = 1;
  at.events->clock(way->self)->h = at.h;
  for (int i = 0; i < way->model->n_x; i++) way->x[i] = at.x[i];
  set_inputs(way, here.t);
  return settle(&here);
}
