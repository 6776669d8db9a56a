/* A sampled PhyFilter in 32-bit integers with 64-bit sums, for cores without floating point: the declarations.
 * pf_q31_code.h has the functions.
 *
 *   v_k = x_k - x_{k-1} - h (mean of g + f_theta over the step)
 *   w_k = w_{k-1} + dA w_{k-1} - b v_k
 *   f_hat_k = f_theta_k + C w_k
 *
 * Every signal is an integer: wing_X_FRACTION and the like are its fractional bits, wing_X_SCALE is 2 to that power, for
 * where numbers in the unit of the signal are at hand. Rounded to nearest, ties up: w where it is multiplied, f_hat.
 * Rounded down: v, whose rest goes into the next step, and sums 2^-30 of a bit of w. All is integer arithmetic that C
 * defines, but for the right shift of negative numbers, which must be arithmetic: every compiler for
 * these cores does so, and building ends where one does not. So results are the same bits everywhere.
 *
 * Within the ranges that the generated header names nothing overflows, whatever the signals do. For PF_NAME wing:
 *
 *   wing, wing_params, wing_parameters   One filter, in the caller's hands; its numbers, which stay where they are.
 *   wing_init(self, params)              First of all. Not 0: the filter must not be used.
 *   wing_reset(self)                     Forgets all samples.
 *   wing_step(self, x, g, f_theta, f_hat)
 *       One sample, wing_N of each. g: where it is held, the g that acted since the last sample; where it is averaged,
 *       g at this sample. The first one starts the filter: f_hat = f_theta. f_hat may be the same memory as f_theta.
 *   wing_shift_x(self, dx)               The estimate of x jumped by dx: a reset, not an acceleration.
 *
 * They return 0 or flags below. An input out of its range counts as the end of it.
 */
#ifndef PF_Q31_COMMON
#define PF_Q31_COMMON
#include <stdint.h>

#define PF_Q31_FORMAT 1u /* of the parameter struct */

enum {
  PF_Q31_X = 1, /* out of range: saturated */
  PF_Q31_G = 2,
  PF_Q31_F_THETA = 4,
  PF_Q31_STATE = 8,  /* only after jumps of x that add up to more than its range, or damage: saturated */
  PF_Q31_LIMIT = 16, /* f_hat is at its limit */
  PF_Q31_VERSION = 32,
  PF_Q31_CORRUPT = 64,  /* CRC-32 of the parameters */
  PF_Q31_NOT_READY = 128 /* init has refused, or was not called */
};

typedef char pf_q31_needs_an_arithmetic_right_shift_[(-3 >> 1) == -2 && ((int64_t)-3 >> 1) == -2 ? 1 : -1];

#define PF_CAT_(a, b) a##_##b
#define PF_CAT(a, b) PF_CAT_(a, b)
#define PF_P(member) PF_CAT(PF_NAME, member)
#endif

typedef struct {
  uint32_t version, crc; /* PF_Q31_FORMAT; CRC-32 (zlib's) of all numbers below in order, low byte first */
  int32_t x, g, f_theta; /* largest |x|, |g|, |f_theta| */
  int32_t f_hat[PF_P(N)]; /* largest |f_hat| */
  int32_t of_g, of_f_theta; /* h, half of it where the mean of both ends counts */
  int32_t dA[PF_P(ORDER)][PF_P(ORDER)], b[PF_P(ORDER)], C[PF_P(ORDER)];
} PF_P(params);

typedef struct {
  const PF_P(params) *params;
  int64_t w[PF_P(N)][PF_P(ORDER)]; /* 30 bits below the least significant one */
  int32_t x[PF_P(N)], f_theta[PF_P(N)];
#if PF_P(G_AVERAGE)
  int32_t g[PF_P(N)];
#endif
  int32_t rest[PF_P(N)]; /* of v */
  int32_t started;
} PF_NAME;

int PF_P(init)(PF_NAME *self, const PF_P(params) *params);
void PF_P(reset)(PF_NAME *self);
int PF_P(step)(PF_NAME *self, const int32_t *x, const int32_t *g, const int32_t *f_theta, int32_t *f_hat);
int PF_P(shift_x)(PF_NAME *self, const int32_t *dx);

#undef PF_NAME
