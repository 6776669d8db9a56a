/* Instants of sampled blocks: k * period after the start, which of them coincide, and who is next. */
#ifndef PF_INSTANTS_H
#define PF_INSTANTS_H
#include <stdint.h>

#include "pf_model.h"

#define PF_COINCIDENT 1e-9      /* of the shorter period */
#define PF_TIME_ROUNDING 8.9e-16 /* 4 eps: what k * period may differ from j times another period; rules after hours */

/* `start` is PF_NEVER before the run. */
static inline pf_time pf_instant(pf_time start, const int64_t *ticks, const pf_time *periods, int i) {
  return start + (pf_time)ticks[i] * periods[i];
}

static inline int pf_earliest(pf_time start, const int64_t *ticks, const pf_time *periods, int n) {
  int first = 0;
  for (int i = 1; i < n; i++)
    if (pf_instant(start, ticks, periods, i) < pf_instant(start, ticks, periods, first)) first = i;
  return first;
}

/* Marks the blocks of the earliest instant, if that is at or before t; how many. */
static inline int pf_due(pf_time start, const int64_t *ticks, const pf_time *periods, int n, pf_time t, int *due) {
  const int first = pf_earliest(start, ticks, periods, n);
  const pf_time instant = pf_instant(start, ticks, periods, first), rounding = PF_TIME_ROUNDING * (t < 0 ? -t : t);
  int count = 0;
  for (int i = 0; i < n; i++) due[i] = 0;
  if (!(instant <= t + PF_COINCIDENT * periods[first] + rounding)) return 0;
  for (int i = 0; i < n; i++) {
    const pf_time shorter = periods[i] < periods[first] ? periods[i] : periods[first];
    due[i] = pf_instant(start, ticks, periods, i) - instant <= PF_COINCIDENT * shorter + rounding;
    count += due[i];
  }
  return count;
}

#endif
