/* Numbers of one instance at fixed addresses, where a calibration tool reads and writes them (FMI-LS-XCP, ASAM MCD-2 MC).
 *
 * The page belongs to the first instance until that is freed; others run without. What a tool has written comes into force
 * where parameters do: at the beginning of a communication step, and in Event Mode. All of the page is taken over then,
 * so that numbers that are legal only together may be written one by one: while they are refused, those in force stay.
 */
#include <string.h>

#include "pf_fmi.h"

#define SHOWN                                                                                                      \
  (1u << PF_FMI_TIME | 1u << PF_FMI_INPUT | 1u << PF_FMI_OUTPUT | 1u << PF_FMI_PARAMETER | 1u << PF_FMI_FIXED | \
   1u << PF_FMI_STATE | 1u << PF_FMI_SAMPLED)
#define CALIBRATED (1u << PF_FMI_PARAMETER | 1u << PF_FMI_FIXED)

static int differ(const double *a, const double *b) { return memcmp(a, b, sizeof *a) != 0; }

static void show(pf_fmi *self) {
  pf_fmi_page *const page = pf_fmu_here.page;
  const int anew = self->saved->mode == PF_FMI_INSTANTIATED; /* nothing is computed yet */
  size_t at = 0;
  for (uint32_t i = 1; i <= pf_fmu_here.n_variables; i++) {
    const pf_fmi_variable variable = pf_fmu_here.variables[i];
    if (!(SHOWN >> variable.kind & 1u)) continue;
    if (!(CALIBRATED >> variable.kind & 1u) && !anew)
      (void)pf_fmi_get(self, &i, 1, page->values + at, variable.count); /* what cannot be told stays */
    for (uint32_t k = 0; CALIBRATED >> variable.kind & 1u && k < variable.count; k++) {
      const double *const own = &self->values[variable.kind][variable.first + k];
      if (anew || differ(own, &page->in_force[at + k]))
        page->in_force[at + k] = page->values[at + k] = page->seen[at + k] = *own;
    }
    at += variable.count;
  }
}

/* Whether the tool has written; with `own`, what it has written into the model, but for what the importer has set since. */
static int written(pf_fmi *self, int own) {
  pf_fmi_page *const page = pf_fmu_here.page;
  const uint32_t legal = self->saved->mode & PF_FMI_BEFORE ? CALIBRATED : 1u << PF_FMI_PARAMETER;
  size_t at = 0;
  int found = 0;
  for (uint32_t i = 1; i <= pf_fmu_here.n_variables; i++) {
    const pf_fmi_variable variable = pf_fmu_here.variables[i];
    for (uint32_t k = 0; legal >> variable.kind & 1u && k < variable.count; k++) {
      double *const value = &self->values[variable.kind][variable.first + k];
      const int here = differ(&page->values[at + k], &page->seen[at + k]);
      found |= here;
      if (!own || (!here && differ(value, &page->in_force[at + k]))) continue;
      *value = page->seen[at + k] = page->values[at + k];
    }
    if (SHOWN >> variable.kind & 1u) at += variable.count;
  }
  return found;
}

void pf_fmi_page_claim(pf_fmi *self) {
  pf_fmi_page *const page = pf_fmu_here.page;
#if defined(__GNUC__)
  if (!__sync_bool_compare_and_swap(&page->owner, NULL, self)) return;
#else
  if (page->owner) return;
  page->owner = self;
#endif
  show(self);
}

void pf_fmi_page_take(pf_fmi *self) {
  if (pf_fmu_here.page->owner != self || !written(self, 0)) return;
  (void)written(self, 1);
  self->saved->staged = 1;
  self->fresh = 0;
}

void pf_fmi_page_show(pf_fmi *self) {
  if (pf_fmu_here.page->owner == self) show(self);
}

void pf_fmi_page_leave(pf_fmi *self) {
  if (pf_fmu_here.page->owner == self) pf_fmu_here.page->owner = NULL;
}
