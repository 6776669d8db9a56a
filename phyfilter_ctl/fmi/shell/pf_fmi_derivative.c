/* Directional and adjoint derivatives, and which variable depends on which. See pf_fmi.h. */
#include <string.h>

#include "pf_fmi.h"

/* Where a variable lies in the vectors (x, u, p) of knowns and (x', y) of unknowns. */
static int known_at(const pf_fmi *self, pf_fmi_variable variable, size_t *at) {
  const size_t x = (size_t)self->model->n_x, u = (size_t)self->model->n_u;
  *at = variable.first + (variable.kind == PF_FMI_STATE ? 0 : variable.kind == PF_FMI_INPUT ? x : x + u);
  return variable.kind == PF_FMI_STATE || variable.kind == PF_FMI_INPUT || variable.kind == PF_FMI_PARAMETER;
}

static int unknown_at(const pf_fmi *self, pf_fmi_variable variable, size_t *at) {
  *at = variable.first + (variable.kind == PF_FMI_OUTPUT ? (size_t)self->model->n_x : 0);
  return variable.kind == PF_FMI_OUTPUT || variable.kind == PF_FMI_DERIVATIVE;
}

typedef int place(const pf_fmi *self, pf_fmi_variable variable, size_t *at);

static int check(pf_fmi *self, const uint32_t *references, size_t n, size_t n_values, place *where, const char *role) {
  size_t total = 0, at;
  for (size_t i = 0; i < n; i++) {
    if (!pf_fmi_exists(references[i]) || !where(self, pf_fmu_here.variables[references[i]], &at))
      return pf_fmi_say(self, PF_FMI_ERROR, "derivatives: value reference %lu cannot be %s",
                        (unsigned long)references[i], role);
    total += pf_fmi_count(self, pf_fmu_here.variables[references[i]]);
  }
  if (total == n_values) return PF_FMI_OK;
  return pf_fmi_say(self, PF_FMI_ERROR, "derivatives: expected %lu values for %s, got %lu", (unsigned long)total, role,
                    (unsigned long)n_values);
}

static void scatter(const pf_fmi *self, const uint32_t *references, size_t n, const double *values, place *where) {
  for (size_t i = 0; i < n; i++) {
    const pf_fmi_variable variable = pf_fmu_here.variables[references[i]];
    size_t at;
    (void)where(self, variable, &at);
    const uint32_t count = pf_fmi_count(self, variable);
    for (uint32_t k = 0; k < count; k++) self->seed[at + k] += *values++;
  }
}

static void gather(const pf_fmi *self, const uint32_t *references, size_t n, double *values, place *where) {
  for (size_t i = 0; i < n; i++) {
    const pf_fmi_variable variable = pf_fmu_here.variables[references[i]];
    size_t at;
    (void)where(self, variable, &at);
    const uint32_t count = pf_fmi_count(self, variable);
    for (uint32_t k = 0; k < count; k++) *values++ = self->result[at + k];
  }
}

static int ready(pf_fmi *self, int there, int complete) {
  if (!pf_fmi_in(self, PF_FMI_ANY & ~(uint32_t)PF_FMI_INSTANTIATED, "derivatives")) return 0;
  if (there && complete) return 1;
  pf_fmi_say(self, PF_FMI_ERROR, there ? "derivatives: an argument is NULL" : "derivatives: the model has none");
  return 0;
}

int pf_fmi_directional(pf_fmi *self, const uint32_t *unknowns, size_t n_unknowns, const uint32_t *knowns,
                       size_t n_knowns, const double *seed, size_t n_seed, double *result, size_t n_result) {
  const pf_model *const model = self->model;
  const size_t x = (size_t)model->n_x, u = (size_t)model->n_u, p = (size_t)model->n_p, y = (size_t)model->n_y;
  const int complete = (unknowns || !n_unknowns) && (knowns || !n_knowns) && (seed || !n_seed) && (result || !n_result);
  if (!ready(self, model->directional != NULL, complete)) return PF_FMI_ERROR;
  if (check(self, unknowns, n_unknowns, n_result, unknown_at, "an unknown")) return PF_FMI_ERROR;
  if (check(self, knowns, n_knowns, n_seed, known_at, "a known")) return PF_FMI_ERROR;
  memset(self->seed, 0, (x + u + p) * sizeof(pf_real));
  memset(self->result, 0, (x + y) * sizeof(pf_real));
  scatter(self, knowns, n_knowns, seed, known_at);
  char *const view = pf_fmi_view(self);
  const int code = !view ? PF_NOT_FINITE
                         : model->directional(view, self->saved->time, self->seed, self->seed + x, self->seed + x + u,
                                              self->result, self->result + x);
  if (code) return pf_fmi_failure(self, "derivatives", code);
  gather(self, unknowns, n_unknowns, result, unknown_at);
  return PF_FMI_OK;
}

int pf_fmi_adjoint(pf_fmi *self, const uint32_t *unknowns, size_t n_unknowns, const uint32_t *knowns, size_t n_knowns,
                   const double *seed, size_t n_seed, double *result, size_t n_result) {
  const pf_model *const model = self->model;
  const size_t x = (size_t)model->n_x, u = (size_t)model->n_u, p = (size_t)model->n_p, y = (size_t)model->n_y;
  const int complete = (unknowns || !n_unknowns) && (knowns || !n_knowns) && (seed || !n_seed) && (result || !n_result);
  if (!ready(self, model->adjoint != NULL, complete)) return PF_FMI_ERROR;
  if (check(self, unknowns, n_unknowns, n_seed, unknown_at, "an unknown")) return PF_FMI_ERROR;
  if (check(self, knowns, n_knowns, n_result, known_at, "a known")) return PF_FMI_ERROR;
  memset(self->seed, 0, (x + y) * sizeof(pf_real));
  memset(self->result, 0, (x + u + p) * sizeof(pf_real));
  scatter(self, unknowns, n_unknowns, seed, unknown_at);
  char *const view = pf_fmi_view(self);
  const int code = !view ? PF_NOT_FINITE
                         : model->adjoint(view, self->saved->time, self->seed, self->seed + x, self->result,
                                          self->result + x, self->result + x + u);
  if (code) return pf_fmi_failure(self, "derivatives", code);
  gather(self, knowns, n_knowns, result, known_at);
  return PF_FMI_OK;
}

/* ---- dependencies ---- */

static int rows_of(pf_fmi *self, uint32_t reference, size_t *first, size_t *count) {
  if (!pf_fmi_exists(reference) || !unknown_at(self, pf_fmu_here.variables[reference], first)) {
    pf_fmi_say(self, PF_FMI_ERROR, "dependencies: value reference %lu is neither output nor derivative",
               (unsigned long)reference);
    return 0;
  }
  *count = pf_fmi_count(self, pf_fmu_here.variables[reference]);
  return 1;
}

int pf_fmi_dependencies(pf_fmi *self, uint32_t reference, size_t *n) {
  size_t first, count;
  if (!n) return pf_fmi_say(self, PF_FMI_ERROR, "dependencies: the argument is NULL");
  if (!rows_of(self, reference, &first, &count)) return PF_FMI_ERROR;
  *n = pf_fmu_here.rows[first + count] - pf_fmu_here.rows[first];
  return PF_FMI_OK;
}

int pf_fmi_dependency(pf_fmi *self, uint32_t reference, size_t *dependent_elements, uint32_t *independents,
                      size_t *independent_elements, size_t n) {
  const size_t x = (size_t)self->model->n_x;
  size_t first, count, done = 0;
  if (!rows_of(self, reference, &first, &count)) return PF_FMI_ERROR;
  if (n != pf_fmu_here.rows[first + count] - pf_fmu_here.rows[first] ||
      (n && (!dependent_elements || !independents || !independent_elements)))
    return pf_fmi_say(self, PF_FMI_ERROR, "dependencies: the arrays do not fit");
  for (size_t row = 0; row < count; row++)
    for (uint32_t k = pf_fmu_here.rows[first + row]; k < pf_fmu_here.rows[first + row + 1]; k++) {
      const size_t column = pf_fmu_here.columns[k];
      const uint32_t kind = column < x ? PF_FMI_STATE : PF_FMI_INPUT;
      const size_t element = column < x ? column : column - x;
      for (uint32_t i = 1; i <= pf_fmu_here.n_variables; i++) {
        const pf_fmi_variable variable = pf_fmu_here.variables[i];
        const uint32_t width = pf_fmi_count(self, variable);
        if (variable.kind != kind || element < variable.first || element >= variable.first + width) continue;
        independents[done] = i;
        independent_elements[done] = width == 1 ? 0 : element - variable.first + 1; /* from 1; 0: all */
        break;
      }
      dependent_elements[done++] = count == 1 ? 0 : row + 1;
    }
  return PF_FMI_OK;
}
