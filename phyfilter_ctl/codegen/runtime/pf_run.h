/* Runs a pf_model over time: integration between the instants of its sampled blocks, to any end. */
#ifndef PF_RUN_H
#define PF_RUN_H
#include "pf_model.h"

enum { PF_RK4 = 0, PF_ADAPTIVE = 1 }; /* classical Runge-Kutta; Dormand-Prince 5(4) */

typedef struct {
  int method;
  pf_real step;      /* RK4: longest step in seconds; adaptive: longest step, 0 for none */
  pf_real rtol, atol; /* adaptive */
  pf_real h;         /* adaptive: step to try next; 0 at first */
} pf_solver;

size_t pf_work_reals(const pf_model *model); /* length of `work` below */

/* From t to t_end, instants in (t, t_end] included. Inputs are constant unless `slope` (n_u, may be NULL) gives their
 * rates. On failure the instance is left as at the last accepted step; *t_reached tells where. */
int pf_advance(const pf_model *model, void *self, pf_real *work, pf_solver *solver, pf_real t, pf_real t_end,
               const pf_real *slope, pf_real *t_reached);

#endif
