/* Part of pf_filter_code.h: other coefficients while the filter runs. */

/* Puts checked coefficients in force; every output stays where it is, and rest stays rest. */
static void PF_P(exchange_)(PF_NAME *self, const double *a, const double *b, double (*poles)[PF_N][2]) {
  double equilibrium[2][PF_BANKS][PF_N], C[2][PF_BANKS][PF_N]; /* before and after, as rounded for the recursion */
  for (int i = 0; i < PF_BANKS; i++) {
    const int n = (int)self->order[i];
    double dA[PF_N * PF_N], rest[PF_N], output[PF_N];
    drone_filter_pf_chain(n, &poles[i][0][0], dA, rest); /* the matrix is not needed: stacks are small */
    drone_filter_pf_transition(n, &poles[i][0][0], PF_P(METHOD), self->dt, dA);
    drone_filter_pf_chain_output(n, &poles[i][0][0], &a[i * PF_N], &b[i * PF_N], output);
    for (int j = 0; j < n; j++) {
      equilibrium[0][i][j] = (double)self->equilibrium[i][j];
      C[0][i][j] = (double)self->C[i][j];
      for (int k = 0; k < n; k++) self->dA[i][j][k] = (PF_T)dA[j * n + k];
      self->equilibrium[i][j] = (PF_T)rest[j];
      self->C[i][j] = (PF_T)output[j];
      equilibrium[1][i][j] = (double)self->equilibrium[i][j];
      C[1][i][j] = (double)self->C[i][j];
      self->a[i][j] = a[i * PF_N + j];
      self->b[i][j] = b[i * PF_N + j];
    }
  }
#if PF_WIDE
  self->dt_other = 0.0;
#endif
  for (int i = 0; i < PF_N_F; i++) {
    const int bank = PF_BANK(i), n = (int)self->order[bank];
    double w[PF_N];
    for (int j = 0; j < n; j++) {
      w[j] = (double)self->w[i][j];
#if PF_P(FLOAT)
      w[j] += (double)self->carry[i][j];
#endif
    }
    drone_filter_pf_move_state(n, &self->poles[bank][0][0], equilibrium[0][bank], C[0][bank], &poles[bank][0][0],
                  equilibrium[1][bank], C[1][bank], w);
    for (int j = 0; j < n; j++) {
      self->w[i][j] = (PF_T)w[j];
#if PF_P(FLOAT)
      self->carry[i][j] = (PF_T)(w[j] - (double)self->w[i][j]);
#endif
    }
  }
  memcpy(self->poles, poles, sizeof self->poles);
}

/* 0, or why coefficients a, b with these poles are refused. */
static int PF_P(refuse_)(const PF_NAME *self, const double *b, double (*poles)[PF_N][2]) {
  for (int i = 0; i < PF_BANKS * PF_N; i++)
    if (!(b[i] - b[i] == 0.0)) return PF_FILTER_NOT_FINITE;
#if PF_P(METHOD) == 1
  for (int i = 0; i < PF_BANKS; i++)
    if (drone_filter_pf_euler_diverges((int)self->order[i], &poles[i][0][0], self->dt)) return PF_FILTER_STEP;
#else
  (void)self;
  (void)poles;
#endif
  return PF_FILTER_OK;
}

int PF_P(retune)(PF_NAME *self, const double *a, const double *b) {
  double poles[PF_BANKS][PF_N][2];
  int code;
  memset(poles, 0, sizeof poles);
  for (int i = 0; i < PF_BANKS; i++) {
    const int n = (int)self->order[i];
    const double *const row = &a[i * PF_N];
    for (int j = 0; j < n; j++)
      if (!(row[j] - row[j] == 0.0)) return PF_FILTER_NOT_FINITE;
    if (!memcmp(row, self->a[i], sizeof(double) * (size_t)n)) /* only b is new */
      memcpy(poles[i], self->poles[i], sizeof poles[i]);
    else if (!memcmp(row, self->a_home[i], sizeof(double) * (size_t)n)) /* known exactly, however often repeated */
      memcpy(poles[i], self->poles_home[i], sizeof poles[i]);
    else if (!pf_hurwitz(n, row) || !drone_filter_pf_roots(n, row, &poles[i][0][0]))
      return PF_FILTER_NOT_HURWITZ;
  }
  code = PF_P(refuse_)(self, b, poles);
  if (code == PF_FILTER_OK) PF_P(exchange_)(self, a, b, poles);
  return code;
}

int PF_P(retune_poles)(PF_NAME *self, const double *poles, const double *b) {
  double sorted[PF_BANKS][PF_N][2], a[PF_BANKS * PF_N];
  int code;
  memset(a, 0, sizeof a);
  memcpy(sorted, poles, sizeof sorted);
  for (int i = 0; i < PF_BANKS; i++) {
    const int n = (int)self->order[i];
    if (!drone_filter_pf_sort_poles(n, &sorted[i][0][0])) return PF_FILTER_NOT_HURWITZ;
    drone_filter_pf_polynomial(n, &sorted[i][0][0], &a[i * PF_N]);
  }
  code = PF_P(refuse_)(self, b, sorted);
  if (code == PF_FILTER_OK) PF_P(exchange_)(self, a, b, sorted);
  return code;
}
