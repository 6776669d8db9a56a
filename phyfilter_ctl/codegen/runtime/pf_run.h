/* Runs a pf_model over time: integration between the instants of its sampled blocks, to any end. */
#ifndef PF_RUN_H
#define PF_RUN_H
#include "pf_model.h"

#ifdef __cplusplus
extern "C" {
#endif

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

#if defined(__GNUC__) /* few states in a generated step: straight code, without a call or a loop */
#define PF_STRAIGHT static inline __attribute__((always_inline))
#else
#define PF_STRAIGHT static inline
#endif

PF_STRAIGHT int pf_all_finite_(const pf_real *x, int n) {
  pf_real sum = 0;
  for (int i = 0; i < n; i++) sum += x[i] - x[i];
  return sum == 0;
}

typedef int pf_slope(const void *of, pf_time t, const pf_real *x, pf_real *dx);

/* A step of classical Runge-Kutta of length h: x is left as it is, `next` becomes what it is at the end. */
PF_STRAIGHT int pf_rk4_(pf_slope *slope, const void *of, int n, pf_time t, pf_time t_next, pf_real h, const pf_real *x,
                        pf_real *k, pf_real *sum, pf_real *next) {
  const pf_time middle = t + 0.5 * (t_next - t);
  const pf_real half = h / 2, sixth = h / 6;
  int status = slope(of, t, x, sum);
  for (int i = 0; i < n; i++) next[i] = x[i] + half * sum[i];
  if (!status) status = slope(of, middle, next, k);
  for (int i = 0; i < n; i++) {
    sum[i] += 2 * k[i];
    next[i] = x[i] + half * k[i];
  }
  if (!status) status = slope(of, middle, next, k);
  for (int i = 0; i < n; i++) {
    sum[i] += 2 * k[i];
    next[i] = x[i] + h * k[i];
  }
  if (!status) status = slope(of, t_next, next, k);
  if (status) return status;
  for (int i = 0; i < n; i++) next[i] = x[i] + sixth * (sum[i] + k[i]);
  return pf_all_finite_(next, n) ? PF_OK : PF_NOT_FINITE;
}

#ifdef __cplusplus
}
#endif
#endif
