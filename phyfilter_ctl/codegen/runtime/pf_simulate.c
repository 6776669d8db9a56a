/* See pf_simulate.h. */
#include "pf_ieee.h"

#include "pf_simulate.h"

static void copy(pf_real *to, const pf_real *from, int n) {
  for (int i = 0; i < n; i++) to[i] = from[i];
}

/* Rates of the inputs between two rows, NULL where they are held: then `rates` is not touched. */
static const pf_real *rates_of(const pf_real *u, const pf_real *u_next, int n, pf_time length, pf_real *rates) {
  if (!u || !(length > 0.0)) return NULL;
  for (int i = 0; i < n; i++) rates[i] = (pf_real)(((pf_time)u_next[i] - (pf_time)u[i]) / length);
  return rates;
}

int pf_simulate(const pf_model *model, void *self, pf_real *work, pf_solver *solver, long long n, const pf_time *times,
                const pf_real *u, int linear, pf_real *x, pf_real *y, pf_real *s, pf_progress *progress,
                pf_time *t_reached) {
  const int n_x = model->n_x, n_u = model->n_u;
  pf_real *const rates = work, *const rest = work + n_u; /* work: pf_work_reals + n_u */
  progress->rows = 0;
  *t_reached = n > 0 ? times[0] : 0.0;
  for (long long row = 0; row < n; row++) {
    const pf_real *const here = u ? u + row * n_u : NULL;
    int status;
    if (progress->cancel) return PF_CANCELLED;
    if (row == 0) {
      if (here) copy(model->u(self), here, n_u);
      status = model->start(self, times[0]);
    } else {
      const pf_time before = times[row - 1], t = times[row];
      const pf_real *const slope = linear ? rates_of(here ? here - n_u : NULL, here, n_u, t - before, rates) : NULL;
      status = pf_approach(model, self, rest, solver, before, t, slope, t_reached);
      if (status) return status;
      if (here) copy(model->u(self), here, n_u); /* to the last digit, and the jump of a held one */
      status = pf_catch_up(model, self, before, t);
    }
    if (status) return status;
    if (x) copy(x + row * n_x, model->x(self), n_x);
    if (y) {
      status = model->outputs(self, times[row], model->x(self), y + row * model->n_y);
      if (status) return status;
    }
    if (s) model->s(self, s + row * model->n_s);
    progress->rows = row + 1;
  }
  return PF_OK;
}
