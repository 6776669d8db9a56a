/* A sampled PhyFilter in 32-bit integers: the functions. pf_q31.h says what they do and how both are used. */
#include "pf_crc.h"

#if defined(__clang__)
#define PF_UNROLL _Pragma("unroll")
#elif defined(__GNUC__)
#define PF_UNROLL _Pragma("GCC unroll 16")
#else
#define PF_UNROLL
#endif
#define PF_N PF_P(ORDER)
#define PF_TWO_TO(bits) ((int64_t)1 << (bits))
#define PF_GUARD 30
#define PF_MOST (PF_TWO_TO(31 + PF_GUARD) - 2 * PF_TWO_TO(PF_GUARD)) /* of a state */

/* The product in 64 bits. A core without an instruction for it would multiply 64 by 64 bits. */
#if defined(__ARM_ARCH_6M__) || defined(__ARM_ARCH_8M_BASE__)
__attribute__((noinline)) static int64_t PF_P(times_)(int32_t a, int32_t b) {
  const int32_t a_low = a & 0xFFFF, b_low = b & 0xFFFF, a_high = a >> 16, b_high = b >> 16;
  const uint32_t low = (uint32_t)a_low * (uint32_t)b_low;
  const int32_t first = a_high * b_low + (int32_t)(low >> 16), second = a_low * b_high + (first & 0xFFFF);
  const int32_t high = a_high * b_high + (first >> 16) + (second >> 16);
  const uint64_t product = (uint64_t)(uint32_t)high << 32 | (uint32_t)second << 16 | (low & 0xFFFFu);
  return (int64_t)product;
}
#else
static inline int64_t PF_P(times_)(int32_t a, int32_t b) { return (int64_t)a * b; }
#endif

static inline int64_t PF_P(nearest_)(int64_t value, int bits) { return (value + PF_TWO_TO(bits - 1)) >> bits; }

static inline int32_t PF_P(within_)(int32_t value, int32_t most, int flag, int *flags) {
  if (value >= -most && value <= most) return value;
  *flags |= flag;
  return value < 0 ? -most : most;
}

static inline int32_t PF_P(word_)(int64_t value) {
  return value > INT32_MAX ? INT32_MAX : value < -INT32_MAX ? -INT32_MAX : (int32_t)value;
}

int PF_P(init)(PF_NAME *self, const PF_P(params) *params) {
  const uint32_t *const numbers = (const uint32_t *)&params->x;
  const int count = (int)(sizeof *params / sizeof(int32_t)) - 2;
  memset(self, 0, sizeof *self); /* refused: it does not start */
  if (params->version != PF_Q31_FORMAT) return PF_Q31_VERSION;
  if (params->crc != pf_crc32_uint(0, numbers, count)) return PF_Q31_CORRUPT;
  self->params = params;
  return 0;
}

void PF_P(reset)(PF_NAME *self) {
  const PF_P(params) *const params = self->params;
  memset(self, 0, sizeof *self);
  self->params = params;
}

int PF_P(shift_x)(PF_NAME *self, const int32_t *dx) {
  int flags = 0;
  if (!self->params) return PF_Q31_NOT_READY;
  for (int i = 0; i < PF_P(N); i++)
    self->x[i] = PF_P(within_)(PF_P(word_)((int64_t)self->x[i] + dx[i]), self->params->x, PF_Q31_X, &flags);
  return flags;
}

/* v of one channel. */
static inline int32_t PF_P(change_)(PF_NAME *self, int i, int32_t x, int32_t g, int32_t f_theta) {
  const PF_P(params) *const p = self->params;
  int64_t v = (int64_t)(x - self->x[i]) * PF_TWO_TO(PF_P(SHIFT_X)) + self->rest[i];
#if PF_P(G_AVERAGE)
  v -= PF_P(times_)(p->of_g, g + self->g[i]);
#else
  v -= PF_P(times_)(p->of_g, g);
#endif
#if PF_P(F_THETA_AVERAGE)
  v -= PF_P(times_)(p->of_f_theta, f_theta + self->f_theta[i]);
#else
  (void)f_theta;
  v -= PF_P(times_)(p->of_f_theta, self->f_theta[i]);
#endif
  self->rest[i] = (int32_t)(v & (PF_TWO_TO(PF_GUARD) - 1));
  return (int32_t)(v >> PF_GUARD);
}

/* C w once the states have moved. */
static inline int64_t PF_P(advance_)(PF_NAME *self, int i, int32_t v, int *flags) {
  const PF_P(params) *const p = self->params;
  int32_t w[PF_N];
  int64_t y = 0;
  PF_UNROLL for (int j = 0; j < PF_N; j++) w[j] = (int32_t)PF_P(nearest_)(self->w[i][j], PF_GUARD);
  PF_UNROLL for (int j = 0; j < PF_N; j++) {
    /* Block lower triangular: above the diagonal only pairs have entries. */
    const int last = j + 1 < PF_N && ((unsigned)PF_P(PAIRS) >> (unsigned)j & 1u) != 0u ? j + 1 : j;
    int64_t change = PF_P(times_)(p->dA[j][0], w[0]);
    PF_UNROLL for (int k = 1; k < PF_N; k++) {
      if (k > last) break;
      change += PF_P(times_)(p->dA[j][k], w[k]);
    }
    int64_t state = self->w[i][j] + (change >> PF_P(SHIFT_DA)) - (PF_P(times_)(p->b[j], v) >> PF_P(SHIFT_B));
    if (state > PF_MOST || state < -PF_MOST) {
      state = state < 0 ? -PF_MOST : PF_MOST;
      *flags |= PF_Q31_STATE;
    }
    self->w[i][j] = state;
#if PF_P(LOWPASS)
    if (j == PF_N - 1) y = PF_P(nearest_)(state, PF_GUARD) * PF_TWO_TO(PF_P(SHIFT_W));
#else
    y += PF_P(times_)(p->C[j], (int32_t)PF_P(nearest_)(state, PF_GUARD));
#endif
  }
  return y;
}

int PF_P(step)(PF_NAME *self, const int32_t *x, const int32_t *g, const int32_t *f_theta, int32_t *f_hat) {
  const PF_P(params) *const p = self->params;
  int flags = 0;
  if (!p) return PF_Q31_NOT_READY;
  for (int i = 0; i < PF_P(N); i++) {
    const int32_t x_i = PF_P(within_)(x[i], p->x, PF_Q31_X, &flags);
    const int32_t g_i = PF_P(within_)(g[i], p->g, PF_Q31_G, &flags);
    const int32_t f_theta_i = PF_P(within_)(f_theta[i], p->f_theta, PF_Q31_F_THETA, &flags);
    int64_t y = f_theta_i * PF_TWO_TO(PF_P(SHIFT_F_THETA));
    if (self->started != 0) y += PF_P(advance_)(self, i, PF_P(change_)(self, i, x_i, g_i, f_theta_i), &flags);
    self->x[i] = x_i;
#if PF_P(G_AVERAGE)
    self->g[i] = g_i;
#endif
    self->f_theta[i] = f_theta_i;
    f_hat[i] = PF_P(within_)(PF_P(word_)(PF_P(nearest_)(y, PF_P(SHIFT_C))), p->f_hat[i], PF_Q31_LIMIT, &flags);
  }
  self->started = 1;
  return flags;
}

#undef PF_MOST
#undef PF_GUARD
#undef PF_TWO_TO
#undef PF_N
#undef PF_UNROLL
#undef PF_NAME
