/* Part of pf_filter_code.h: measurements that come late (a delay) or not at all (gaps of samples that were held). */

/* One interval's share of the integrals: the part of it between the ages `young` and `old` (s before now); it began at
 * the age `began`. */
static void PF_P(add_share_)(PF_NAME *self, double dt, double began, double young, double old, const PF_T *g_first,
                             const PF_T *g_last, const PF_T *f_first, const PF_T *f_last) {
  const double length = old - young, middle = (began - 0.5 * (young + old)) / dt;
  for (int i = 0; i < PF_N_X; i++) {
    const double first = (double)g_first[i], last = (double)g_last[i];
    self->sum_g[i] += length * (first + (last - first) * middle);
  }
  for (int i = 0; i < PF_N_F; i++) {
    const double first = (double)f_first[i], last = (double)f_last[i];
    self->sum_f_theta[i] += length * (first + (last - first) * middle);
  }
}

#if PF_P(PAST)
/* Two neighbours, the shortest together, become one of the same integral and trend. */
static void PF_P(make_room_)(PF_NAME *self) {
  PF_P(interval) *p = self->past;
  int best = 0;
  for (int k = 1; k + 1 < self->count; k++)
    if (p[k].dt + p[k + 1].dt < p[best].dt + p[best + 1].dt) best = k;
  PF_P(interval) *a = &p[best], *b = &p[best + 1];
  const double share = a->dt / (a->dt + b->dt);
#define PF_JOIN(field, count)                                                                       \
  for (int i = 0; i < (count); i++) {                                                               \
    const double mean_a = 0.5 * ((double)a->field[0][i] + (double)a->field[1][i]);                  \
    const double mean_b = 0.5 * ((double)b->field[0][i] + (double)b->field[1][i]);                  \
    const double rise = (double)b->field[1][i] - (double)a->field[0][i];                            \
    const double mean = mean_b + share * (mean_a - mean_b);                                         \
    a->field[0][i] = (PF_T)(mean - 0.5 * rise);                                                     \
    a->field[1][i] = (PF_T)(mean + 0.5 * rise);                                                     \
  }
  PF_JOIN(g, PF_N_X)
  PF_JOIN(f_theta, PF_N_F)
#undef PF_JOIN
  PF_P(copy_)(b->inertia[1], a->inertia[1], PF_ENTRIES);
  a->dt += b->dt;
  self->count--;
  memmove(b, b + 1, (size_t)(self->count - best - 1) * sizeof *b);
}

/* Adds a finished interval, forgets those that lie before the delay, counts in what leaves the delay line. */
static void PF_P(collect_)(PF_NAME *self, double h, const PF_T *g_first, const PF_T *g_last, const PF_T *f_first,
                           const PF_T *f_last, const PF_T *before, const PF_T *now, PF_T *late_inertia) {
  const double delay = self->delay;
  PF_P(interval) *newest;
  double ended = 0.0;
  int k;
  PF_P(copy_)(now, late_inertia, PF_ENTRIES);
  if (self->count == 0) { /* before the first sample everything was as at its beginning */
    newest = &self->past[self->count++];
    newest->dt = 2.0 * delay;
    for (int end = 0; end < 2; end++) {
      PF_P(copy_)(g_first, newest->g[end], PF_N_X);
      PF_P(copy_)(f_first, newest->f_theta[end], PF_N_F);
      PF_P(copy_)(before, newest->inertia[end], PF_ENTRIES);
    }
  }
  if (self->count == PF_P(PAST)) PF_P(make_room_)(self);
  newest = &self->past[self->count++];
  newest->dt = h;
  PF_P(copy_)(g_first, newest->g[0], PF_N_X);
  PF_P(copy_)(g_last, newest->g[1], PF_N_X);
  PF_P(copy_)(f_first, newest->f_theta[0], PF_N_F);
  PF_P(copy_)(f_last, newest->f_theta[1], PF_N_F);
  PF_P(copy_)(before, newest->inertia[0], PF_ENTRIES);
  PF_P(copy_)(now, newest->inertia[1], PF_ENTRIES);
  for (k = self->count - 1; k >= 0 && ended < h + delay; k--) {
    const PF_P(interval) *p = &self->past[k];
    const double began = ended + p->dt, young = ended > delay ? ended : delay;
    const double old = began < h + delay ? began : h + delay;
    if (old > young)
      PF_P(add_share_)(self, p->dt, began, young, old, p->g[0], p->g[1], p->f_theta[0], p->f_theta[1]);
    if (ended <= delay && delay < began)
      for (int i = 0; i < PF_ENTRIES; i++)
        late_inertia[i] = p->inertia[0][i] + (p->inertia[1][i] - p->inertia[0][i]) * (PF_T)((began - delay) / p->dt);
    ended = began;
  }
  for (ended = 0.0, k = self->count - 1; k > 0 && ended + self->past[k].dt < delay; k--) ended += self->past[k].dt;
  if (k > 0) { /* [k, count) cover the last `delay` seconds */
    self->count -= k;
    memmove(self->past, self->past + k, (size_t)self->count * sizeof *self->past);
  }
}
#else
static void PF_P(collect_)(PF_NAME *self, double h, const PF_T *g_first, const PF_T *g_last, const PF_T *f_first,
                           const PF_T *f_last, const PF_T *before, const PF_T *now, PF_T *late_inertia) {
  (void)before;
  PF_P(add_share_)(self, h, h, 0.0, h, g_first, g_last, f_first, f_last);
  PF_P(copy_)(now, late_inertia, PF_ENTRIES);
}
#endif

/* Takes in what g, f_theta and the inertia did in the last h seconds, h > 0. */
static void PF_P(pass_)(PF_NAME *self, double h, const PF_T *g, const PF_T *f_theta, const PF_T *inertia,
                        PF_T *late_inertia) {
#if PF_P(INERTIA_INPUT)
  const PF_T *before = self->has_inertia ? self->inertia : inertia;
  if (!self->has_inertia) { /* an inertia first given now was the same before */
    PF_P(copy_)(inertia, self->inertia_then, PF_ENTRIES);
#if PF_P(PAST)
    for (int k = 0; k < self->count; k++)
      for (int end = 0; end < 2; end++) PF_P(copy_)(inertia, self->past[k].inertia[end], PF_ENTRIES);
#endif
  }
#else
  const PF_T *before = inertia;
#endif
#if PF_P(G_AVERAGE)
  const PF_T *g_first = self->has_g ? self->g : g;
#else
  const PF_T *g_first = g;
#endif
#if PF_P(F_THETA_AVERAGE)
  const PF_T *f_last = f_theta;
#else
  const PF_T *f_last = self->f_theta;
  (void)f_theta;
#endif
#if !PF_P(PAST)
  if (self->gap == 0.0) PF_P(copy_)(before, self->inertia_then, PF_ENTRIES);
#endif
  PF_P(collect_)(self, h, g_first, g, self->f_theta, f_last, before, inertia, late_inertia);
}

/* u over the time since the last accepted sample, `delay` late; that time. */
static double PF_P(aligned_residual_)(PF_NAME *self, const PF_T *x, const PF_T *g, const PF_T *f_theta,
                                      const PF_T *inertia, double h, PF_T *u) {
  const double length = self->gap + h;
  PF_T late[PF_ENTRIES], dx[PF_N_X];
  double of_x[PF_N_X], of_f;
  PF_P(pass_)(self, h, g, f_theta, inertia, late);
  for (int i = 0; i < PF_N_X; i++) dx[i] = x[i] - self->x[i];
#if PF_P(INERTIA)
  for (int i = 0; i < PF_ENTRIES; i++) self->inertia_then[i] = (self->inertia_then[i] + late[i]) * (PF_T)0.5;
#endif
  for (int i = 0; i < PF_N_X; i++)
    of_x[i] = (double)(PF_TIMES(self->inertia_then, dx, i)) / length - self->sum_g[i] / length;
  for (int i = 0; i < PF_N_F; i++) {
#if PF_P(DIRECTION)
    of_f = (double)self->E_left[i][0] * of_x[0];
    for (int j = 1; j < PF_N_X; j++) of_f += (double)self->E_left[i][j] * of_x[j];
#else
    of_f = of_x[i];
#endif
    u[i] = (PF_T)(of_f - self->sum_f_theta[i] / length);
  }
#if PF_P(INERTIA)
  PF_P(copy_)(late, self->inertia_then, PF_ENTRIES);
#endif
  memset(self->sum_g, 0, sizeof self->sum_g);
  memset(self->sum_f_theta, 0, sizeof self->sum_f_theta);
  return length;
}

#if PF_P(HOLD_BAD)
/* A sample that is not finite: f_hat - f_theta stays, and what is finite of it counts in a step that becomes longer. */
PF_RARE int PF_P(hold_)(PF_NAME *self, const PF_T *g, const PF_T *f_theta, const PF_T *inertia, double h, PF_T *f_hat) {
  PF_T kept_g[PF_N_X], kept_f[PF_N_F], kept_inertia[PF_ENTRIES], late[PF_ENTRIES];
  for (int i = 0; i < PF_N_X; i++) kept_g[i] = PF_P(finite_)(&g[i], 1) ? g[i] : self->g[i];
  for (int i = 0; i < PF_N_F; i++) kept_f[i] = PF_P(finite_)(&f_theta[i], 1) ? f_theta[i] : self->f_theta[i];
#if PF_P(INERTIA_INPUT)
  for (int i = 0; i < PF_ENTRIES; i++) {
    const PF_T last = self->has_inertia ? self->inertia[i] : (PF_T)1;
    kept_inertia[i] = PF_P(finite_)(&inertia[i], 1) ? inertia[i] : last;
  }
#elif PF_P(INERTIA)
  PF_P(copy_)(inertia, kept_inertia, PF_ENTRIES);
#else
  (void)inertia;
  kept_inertia[0] = (PF_T)1;
#endif
  PF_P(pass_)(self, h, kept_g, kept_f, kept_inertia, late);
  PF_P(copy_)(kept_g, self->g, PF_N_X);
  PF_P(copy_)(kept_f, self->f_theta, PF_N_F);
#if PF_P(INERTIA_INPUT)
  if (inertia != self->inertia) {
    PF_P(copy_)(kept_inertia, self->inertia, PF_ENTRIES);
    self->has_inertia = 1;
  }
#endif
  self->has_g = self->held = 1;
  self->gap += h;
  PF_P(keep_)(self, kept_f, f_hat);
  return PF_FILTER_OK;
}
#endif
