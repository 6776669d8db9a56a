/* A whole run in one call: from the first of the given times to the last, with what happened at each of them. */
#ifndef PF_SIMULATE_H
#define PF_SIMULATE_H
#include "pf_run.h"

enum { PF_CANCELLED = 100 };

/* Shared with whoever watches from another thread. */
typedef struct {
  volatile long long rows; /* times reached so far */
  volatile int cancel;     /* set it to end the run at the next time, status PF_CANCELLED */
} pf_progress;

/* work: pf_work_reals(model) + n_u numbers. `times` (n) increases; u (n, n_u) row by row, NULL: those in the instance throughout; linear: inputs between the times
 * are on straight lines, else each row is held until the next. Starts the sampled blocks at times[0]. x (n, n_x),
 * y (n, n_y) and s (n, n_s) receive states, outputs and states of the sampled blocks, each NULL where not wanted; at an
 * instant, as the sampled blocks left them. progress->rows of them are filled; *t_reached is where a run that failed stands. */
int pf_simulate(const pf_model *model, void *self, pf_real *work, pf_solver *solver, long long n, const pf_time *times,
                const pf_real *u, int linear, pf_real *x, pf_real *y, pf_real *s, pf_progress *progress,
                pf_time *t_reached);

#endif
