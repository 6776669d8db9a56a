/* Runs a pf_model over time: integration between the instants of its sampled blocks, to any end. */
#ifndef PF_RUN_H
#define PF_RUN_H
#include "pf_model.h"

enum { PF_RK4 = 0, PF_ADAPTIVE = 1 }; /* classical Runge-Kutta; Dormand-Prince 5(4) */

typedef struct {
  int method;
  pf_time step;       /* longest step in seconds; 0: RK4 goes to the next stop in one step, adaptive has no bound */
  pf_real rtol, atol; /* adaptive: error of a step below atol + rtol |x|, entry by entry */
  pf_time h;          /* adaptive: step to try next; 0 at first */
  /* Steps that may still be tried, counted down; 0: no bound, -1: spent, PF_TOO_MANY_STEPS. Another thread may set it
   * to -1 to end a run. */
  volatile long long budget;
} pf_solver;

size_t pf_work_reals(const pf_model *model); /* length of `work` below */

/* From t to t_end, instants in (t, t_end] included. Inputs are those in the instance at t and constant unless `slope`
 * (n_u, may be NULL) gives their rates; they are left as at t_end. RK4 divides the way from stop to stop (instants and
 * t_end) into equal steps; stops within rounding of each other are one. On failure the instance is left as at the last
 * accepted step; *t_reached tells where. PF_STEP_TOO_SMALL also where t_end is before t or not a number. */
int pf_advance(const pf_model *model, void *self, pf_real *work, pf_solver *solver, pf_time t, pf_time t_end,
               const pf_real *slope, pf_time *t_reached);

/* The same without the instants at t_end: for inputs that jump there. Then set u and call pf_catch_up. */
int pf_approach(const pf_model *model, void *self, pf_real *work, pf_solver *solver, pf_time t, pf_time t_end,
                const pf_real *slope, pf_time *t_reached);

/* Runs the instants at t, those within rounding of it included; `since` is the time the run came from. */
int pf_catch_up(const pf_model *model, void *self, pf_time since, pf_time t);

#if PF_EVENTS
/* For who integrates by himself. At a point that a condition has passed 0 at, and wherever inputs or held signals have
 * jumped: runs the events, in place. */
int pf_events_here(const pf_model *model, void *self, pf_real *work, pf_time t);

/* After a step that no event cut short: 1 in *due where one should have. */
int pf_events_seen(const pf_model *model, void *self, pf_real *work, pf_time t, int *due);
#endif

#endif
