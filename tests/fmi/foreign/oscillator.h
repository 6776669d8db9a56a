/* N decoupled oscillators, each tied by a spring to a place given from outside:
 * m x'' = -k x - d x' + c (place - x). Written apart from the library, as a peer it must get on with. */
#ifndef OSCILLATOR_H
#define OSCILLATOR_H
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifndef N
#define N 1
#endif
/* Further peculiarities: NO_STATE (cannot give its state), FORGETS (leaves x out when the state is put back), EVENT_AT
 * (announces a time event), WARNS (takes a damping below 0 for 0, and calls a spring above 5 N/m stiff). */
#ifndef FAIL_AT
#define FAIL_AT 1e300 /* doStep answers Error from this time on */
#endif
/* From this time on doStep does MISCHIEF to its process: SEGFAULT, ABORT, EXIT, HANG; or NOT_A_NUMBER to its state. */
#ifndef MISCHIEF_AT
#define MISCHIEF_AT 1e300
#endif
#ifndef MISCHIEF
#define MISCHIEF SEGFAULT
#endif
#ifndef ENDS_AT
#define ENDS_AT 1e300 /* a step past this time ends there, and the run with it */
#endif
#ifndef ENDS_ON
#define ENDS_ON 1e300 /* a step that comes to this time ends the run there; no input is taken from then on */
#endif
#define ENDED(m) ((m)->time >= ENDS_ON - 1e-9)
#ifndef RETURNS_AT
#define RETURNS_AT 1e300 /* a step past this time returns early, there (FMI 3.0) */
#endif
#ifndef DISCARD_ABOVE
#define DISCARD_ABOVE 1e300 /* doStep discards longer steps */
#endif

enum { TIME, PLACE, X, V, DX, DV, FORCE, MASS, STIFFNESS, DAMPING, COUPLING, LABEL, COUNT, TINY, POSITIVE, MODE, FLAG, VARIABLES };

typedef struct {
  double time, place[N], slope[N], x[N], v[N], mass, stiffness, damping, coupling;
  int count, tiny, positive, mode, flag;
  int stepping; /* for one that keeps count of what it was asked */
} Model;

typedef struct {
  Model m;
  void *logger, *environment;
  char name[64];
  int dead;
} Instance;

static void model_reset(Model *m) {
  memset(m, 0, sizeof *m);
  for (int i = 0; i < N; i++) m->x[i] = 1.0 + i;
  m->mass = 2.0;
  m->stiffness = 8.0;
  m->damping = 0.4;
  m->coupling = 3.0;
}

static double force(const Model *m, int i) { return m->coupling * (m->place[i] - m->x[i]); }

static void rates(const Model *m, double *dx, double *dv) {
  for (int i = 0; i < N; i++) {
    dx[i] = m->v[i];
    dv[i] = (force(m, i) - m->stiffness * m->x[i] - m->damping * m->v[i]) / m->mass;
  }
}

enum { SEGFAULT, ABORT, EXIT, HANG, NOT_A_NUMBER };

static void mischief(Model *m, double end) {
  static int *volatile nowhere;
  if (end <= MISCHIEF_AT) return;
  if (MISCHIEF != NOT_A_NUMBER) puts("mischief on standard output");
  fflush(stdout);
  switch (MISCHIEF) {
  case SEGFAULT: *nowhere = 1; break;
  case ABORT: abort();
  case EXIT: exit(3);
  case HANG: for (volatile int i = 0;; i = !i) {}
  default: m->x[0] = NAN; break;
  }
}

/* Classical Runge-Kutta with steps of at most 1 ms. */
static void advance(Model *m, double h) {
  const int steps = (int)(h / 1e-3) + 1;
  const double part = h / steps;
  const double node[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0 / 6, 1.0 / 3, 1.0 / 3, 1.0 / 6};
  for (int step = 0; step < steps; step++) {
    Model stage = *m;
    double dx[N] = {0}, dv[N] = {0}, x[N], v[N];
    memcpy(x, m->x, sizeof x);
    memcpy(v, m->v, sizeof v);
    for (int k = 0; k < 4; k++) {
      for (int i = 0; i < N; i++) {
        stage.x[i] = m->x[i] + node[k] * part * dx[i];
        stage.v[i] = m->v[i] + node[k] * part * dv[i];
        stage.place[i] = m->place[i] + node[k] * part * m->slope[i];
      }
      rates(&stage, dx, dv);
      for (int i = 0; i < N; i++) {
        x[i] += weight[k] * part * dx[i];
        v[i] += weight[k] * part * dv[i];
      }
    }
    memcpy(m->x, x, sizeof x);
    memcpy(m->v, v, sizeof v);
    for (int i = 0; i < N; i++) m->place[i] += part * m->slope[i];
  }
  memset(m->slope, 0, sizeof m->slope); /* told for one step */
  m->time += h;
}

/* 0 where there is no such variable of N (or 1) doubles. */
static int get(const Model *m, unsigned reference, double *value) {
  double dx[N], dv[N];
  rates(m, dx, dv);
  for (int i = 0; i < N; i++) {
    switch (reference) {
    case PLACE: value[i] = m->place[i]; break;
    case X: value[i] = m->x[i]; break;
    case V: value[i] = m->v[i]; break;
    case DX: value[i] = dx[i]; break;
    case DV: value[i] = dv[i]; break;
    case FORCE: value[i] = force(m, i); break;
    default: break;
    }
  }
  switch (reference) {
  case TIME: *value = m->time; return 1;
  case MASS: *value = m->mass; return 1;
  case STIFFNESS: *value = m->stiffness; return 1;
  case DAMPING: *value = m->damping; return 1;
  case COUPLING: *value = m->coupling; return 1;
  default: return reference >= PLACE && reference <= FORCE ? N : 0;
  }
}

static int set(Model *m, unsigned reference, const double *value) {
  switch (reference) {
  case PLACE: memcpy(m->place, value, sizeof m->place); return N;
  case X: memcpy(m->x, value, sizeof m->x); return N;
  case V: memcpy(m->v, value, sizeof m->v); return N;
  case MASS: m->mass = *value; return 1;
  case STIFFNESS: m->stiffness = *value; return 1;
  case DAMPING: m->damping = *value; return 1;
  case COUPLING: m->coupling = *value; return 1;
  default: return 0;
  }
}
#endif
