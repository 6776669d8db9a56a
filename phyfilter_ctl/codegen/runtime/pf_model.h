/* What a generated model offers to whoever runs it: the simulation driver, the FMI shell, firmware.
 *
 * An instance is one flat block of memory without pointers: memcpy saves and restores it. No function allocates, none
 * touches anything but its instance. Vectors x (continuous states), u (inputs), y (outputs), p (parameters) are in the
 * order of the generated header.
 */
#ifndef PF_MODEL_H
#define PF_MODEL_H
#include <stddef.h>

#ifndef PF_REAL
#define PF_REAL double
#endif
typedef PF_REAL pf_real;
typedef double pf_time; /* seconds; double also where pf_real is float, which has no digits left after an hour at 1 kHz */

#define PF_NEVER 1e300 /* pf_model.next: no instant to come */

enum {
  PF_OK = 0,
  PF_NOT_FINITE = 1,
  PF_NO_CONVERGENCE = 2,
  PF_STEP_TOO_SMALL = 3,
  PF_TOO_MANY_STEPS = 4,
  PF_UNUSABLE = 5,
  PF_ENDLESS_EVENTS = 6
};

#define PF_EVENTS 0 /* 1: the model has events, and pf_run.c what runs them */

typedef struct { /* a condition's side: the sign it was last seen with; waiting: the one it is heading for */
  signed char side, waiting, back; /* back: on its way back from `depth` beyond 0, where an event left it */
  pf_real depth, largest;          /* largest: of its values at events */
} pf_side;

typedef struct { /* what a model with events remembers of them, besides the sides; all 0 before a run */
  pf_time last, soon, h;
  long long count;
  int in_a_row, armed, latest;
} pf_events;

typedef struct {
  int count;
  const signed char *directions; /* of each condition at its event: -1 falling, 0 either way, 1 rising */
  pf_events *(*clock)(void *self);
  pf_side *(*sides)(void *self);
  int (*conditions)(void *self, pf_time t, const pf_real *x, pf_real *g);
  int (*reset)(void *self, pf_time t, int event, pf_real *x); /* x becomes what it is after the event */
} pf_event_table;

typedef struct pf_model {
  const char *name;
  size_t size;             /* bytes of an instance */
  int n_x, n_u, n_y, n_p;
  int n_s;                 /* states of the sampled blocks that can be read */
  int n_tasks;             /* sampled blocks with instants of their own */
  int communication;       /* 1: a sampled block updates once per communication step (pf_model.update) */

  /* All start values; t = 0; nothing sampled yet. PF_UNUSABLE: corrupt parameters, or arithmetic that is not IEEE's
   * (pf_ieee.h); `start` and a step say it again. */
  int (*init)(void *self);
  pf_real *(*x)(void *self);     /* continuous states, in place */
  pf_real *(*u)(void *self);     /* inputs, in place */
  pf_real *(*p)(void *self);     /* parameters as last set, in place; in force after apply */
  void (*s)(const void *self, pf_real *s); /* copies the states of the sampled blocks */

  /* Checks the parameters together and puts them in force without a jump of any output of a filter. NULL, or why they
   * are refused: then those in force stay, and p is set back to them. */
  const char *(*apply)(void *self);

  int (*start)(void *self, pf_time t);                 /* first sample of all sampled blocks, on x in place */
  int (*derivatives)(void *self, pf_time t, const pf_real *x, pf_real *dx);
  int (*outputs)(void *self, pf_time t, const pf_real *x, pf_real *y);
  pf_time (*next)(const void *self);                   /* next instant of a sampled block; PF_NEVER if none */
  /* Runs the sampled blocks whose earliest instant is at or before t, and those that coincide with it. Once: where
   * next is still at or before t, call again. */
  int (*sample)(void *self, pf_time t, const pf_real *x);
  int (*update)(void *self, pf_time t, pf_time elapsed);  /* communication: one sample after `elapsed` seconds */

  /* Derivative of (dx, y) along a seed of (x, u, p), and its transpose (adds nothing, overwrites the results), at x and
   * u in place and the parameters in force.
   * Held outputs and parameters of filters count as constant: their seeds are ignored, their results 0. NULL where the
   * model has none. */
  int (*directional)(void *self, pf_time t, const pf_real *seed_x, const pf_real *seed_u, const pf_real *seed_p,
                     pf_real *dx, pf_real *y);
  int (*adjoint)(void *self, pf_time t, const pf_real *seed_dx, const pf_real *seed_y, pf_real *x, pf_real *u,
                 pf_real *p);
  /* A step of integration was accepted and ends at t, x and u in place: algebraic loops are sought from their solution
   * there until the next. NULL where the model has none. */
  void (*accepted)(void *self, pf_time t);
  const pf_event_table *events; /* NULL where there are none */
} pf_model;

#endif
