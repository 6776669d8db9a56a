/* A sampled PhyFilter, for every set of options, in C99: the declarations. pf_filter_code.h has the functions.
 *
 * A generated header sets the options of one filter as macros that start with its name and includes this file:
 *
 *   #define wing_N_X 3              channels of x and g
 *   #define wing_N_F 3              channels of f_theta and f_hat
 *   #define wing_ORDER 2            largest order
 *   #define wing_FILTERS 1          1 shared by all channels, or N_F
 *   #define wing_FLOAT 1            real is float, with a compensation word per state; else double
 *   #define wing_METHOD 0           PF_EXACT, PF_EULER, PF_TUSTIN of pf_tune.h
 *   #define wing_G_AVERAGE 0        g: 0 held, 1 mean of both ends of a step
 *   #define wing_F_THETA_AVERAGE 1
 *   #define wing_INERTIA 0          0 I, 1 scalar, 2 diagonal, 3 full
 *   #define wing_INERTIA_INPUT 0    1: given at every step
 *   #define wing_DIRECTION 0        1: E, f acts in fewer directions than x has channels
 *   #define wing_PAST 0             intervals kept for a delay; 0: no delay
 *   #define wing_LIMIT 0            1: bounds on |f_hat|
 *   #define wing_G_LIMIT 0          1: bounds on what acts of g
 *   #define wing_HOLD_BAD 0         1: nonfinite="hold"
 *   #define wing_PAIRS 1            bit i: sections i and i + 1 may be a complex pair
 *   #define wing_LOWPASS 0          1: C = (0, ..., 0, 1), never tuned
 *   #define wing_VARIABLE 1         steps of other lengths
 *   #define wing_TUNABLE 1          a and b while running
 *   #define wing_CONSTANT 0         1: the numbers stay in wing_parameters, for no others; then with wing_RATE, 1 / dt;
 *                                   none of VARIABLE, TUNABLE, HOLD_BAD, PAST
 *   #define wing_LONGEST 20.0       with VARIABLE or HOLD_BAD: nominal steps without a good sample that make one step
 *   #define wing_LONG_STEPS 0       with them, 1: every good sample after a good one makes a step, however long
 *   #define PF_NAME wing
 *   #include "pf_filter.h"
 *
 * and its source file defines PF_NAME again and includes pf_filter_code.h. VARIABLE, TUNABLE and HOLD_BAD need
 * pf_tune.c, TUNABLE pf_roots.c too. Any number of filters may stand in one program, each with a name of its own. For
 * PF_NAME wing there are:
 *
 *   wing, wing_real     One filter: a flat struct in the caller's hands, without pointers; memcpy saves and restores it.
 *   wing_params         Its numbers, with version and CRC-32. The generated `wing_parameters` is one.
 *   wing_init(self, params)              First of all. Not 0: the filter must not be used.
 *   wing_reset(self)                     Forgets all samples; coefficients and limits stay.
 *   wing_start(self, x0, f_hat0, f_theta0, M0, g0)
 *       The first sample; all but x0 may be NULL. Optional: the first step or output does it too, at f_hat = f_theta.
 *   wing_step(self, x, g, f_theta, M, f_hat)
 *       One sample after a nominal step. g, as of SampledPhyFilter.step: where it is held, the g that acted since the
 *       last sample (SampledPhyFilter.run, blocks and FMUs take the g that acts from this sample on); where it is
 *       averaged, g at this sample. M: its entries row by row; NULL keeps the last one (I at first); not looked at
 *       unless INERTIA_INPUT. f_hat may be the same memory as f_theta.
 *   wing_step_after(self, x, g, f_theta, M, dt, f_hat)      The same after dt seconds (VARIABLE).
 *   wing_output(self, x, g, f_theta, M, f_hat), wing_output_after(self, x, g, f_theta, M, dt, f_hat),
 *   wing_remember(self, g)
 *       The two phases of a block in a diagram. output puts f_hat out; a held g is the one last remembered, not the one
 *       given (but at the first sample, which keeps it). remember, once all blocks have put out, takes the g that
 *       acts from this sample on; nothing where g is averaged.
 *   wing_shift_x(self, dx)               The estimate of x jumped by dx: a reset, not an acceleration.
 *   wing_set_limit(self, limit)          N_F bounds (LIMIT).
 *   wing_set_g_limit(self, low, high)    N_X ends each, between which every g given is clipped (G_LIMIT).
 *   wing_retune(self, a, b), wing_retune_poles(self, poles, b)   (TUNABLE)
 *       Other coefficients of the same orders, all filters at once, in double: a and b FILTERS x ORDER, ascending, the
 *       short ones padded with zeros; poles FILTERS x ORDER x (real, imaginary). f_hat does not jump;
 *       at rest it stays where it is for as long as the residual does, where F(0) is the same.
 *
 * All but reset and remember return 0 or a code below; then nothing has changed, f_hat neither. With HOLD_BAD a sample
 * that is not finite is no error: f_hat - f_theta stays, however long the gap, self->held is 1, and the gap becomes
 * part of one longer step. After more than LONGEST nominal steps there is no such step: the filter goes on from the good
 * sample with the f_hat - f_theta that it had.
 *
 * Delay: PAST intervals are kept, enough for nominal steps. Where shorter steps need more, the two neighbours that are
 * shortest together become one of the same integral; the averages lose detail finer than delay / PAST, nothing else.
 * Only pf_tune.c, pf_roots.c, a delay and a gap compute in double where real is float. No heap, no libm, nothing global
 * that changes. With -std=c99 (no fused multiply-add) and without -ffast-math results are the same bits everywhere.
 */
#ifndef PF_FILTER_COMMON
#define PF_FILTER_COMMON
#include <stddef.h>
#include <stdint.h>

#define PF_FILTER_FORMAT 1u /* of the parameter struct */

enum {
  PF_FILTER_OK = 0,
  PF_FILTER_NOT_FINITE = 1,  /* a sample, or a number given */
  PF_FILTER_STEP = 2,        /* not a positive length, or forward Euler would diverge at it */
  PF_FILTER_VERSION = 3,
  PF_FILTER_CORRUPT = 4,     /* CRC-32 of the parameters */
  PF_FILTER_NOT_HURWITZ = 5, /* a pole on or right of the imaginary axis */
  PF_FILTER_NO_REST = 6,     /* F(0) = 0: no constant residual gives f_hat0 */
  PF_FILTER_INVALID = 7,     /* parameters out of range: step, delay, order or a limit; or init has refused them */
  PF_FILTER_ARITHMETIC = 8   /* the compiler's flags: see pf_ieee.h */
};

static inline const char *pf_filter_message(int code) {
  switch (code) {
    case PF_FILTER_OK: return "ok";
    case PF_FILTER_NOT_FINITE: return "a number is not finite";
    case PF_FILTER_STEP: return "the step is not positive, or forward Euler diverges at it: |1 + p h| >= 1";
    case PF_FILTER_VERSION: return "the parameters are of another format version";
    case PF_FILTER_CORRUPT: return "the CRC-32 of the parameters is wrong";
    case PF_FILTER_NOT_HURWITZ: return "D is not Hurwitz: a pole on or right of the imaginary axis";
    case PF_FILTER_NO_REST: return "F(0) = 0: no constant residual gives this f_hat; start without it";
    case PF_FILTER_ARITHMETIC: return "arithmetic is not IEEE's: see pf_ieee.h for the compiler's flags";
    default: return "a parameter is out of range, or the filter was not initialised";
  }
}

#define PF_CAT_(a, b) a##_##b
#define PF_CAT(a, b) PF_CAT_(a, b)
#define PF_P(member) PF_CAT(PF_NAME, member) /* PF_P(step) is wing_step where PF_NAME is wing */
#endif

#if PF_P(INERTIA) == 0
#define PF_ENTRIES 1
#elif PF_P(INERTIA) == 1
#define PF_ENTRIES 1
#elif PF_P(INERTIA) == 2
#define PF_ENTRIES PF_P(N_X)
#else
#define PF_ENTRIES (PF_P(N_X) * PF_P(N_X))
#endif
#define PF_WIDE (PF_P(VARIABLE) || PF_P(HOLD_BAD)) /* steps other than the nominal one happen */

#if PF_P(FLOAT)
typedef float PF_P(real);
#else
typedef double PF_P(real);
#endif

typedef struct {
  uint32_t version, crc; /* PF_FILTER_FORMAT; CRC-32 (zlib's) of all numbers below in order, low byte first */
  uint32_t order[PF_P(FILTERS)];
  double dt, delay;                                        /* s */
  double a[PF_P(FILTERS)][PF_P(ORDER)];                    /* ascending, (rad/s)^(n-i) */
#if PF_P(TUNABLE)
  double b[PF_P(FILTERS)][PF_P(ORDER)];
#endif
#if PF_WIDE || PF_P(TUNABLE)
  double poles[PF_P(FILTERS)][PF_P(ORDER)][2];             /* real, imaginary part in rad/s */
#endif
  PF_P(real) dA[PF_P(FILTERS)][PF_P(ORDER)][PF_P(ORDER)];  /* transition over a nominal step, minus I */
  PF_P(real) equilibrium[PF_P(FILTERS)][PF_P(ORDER)];
  PF_P(real) C[PF_P(FILTERS)][PF_P(ORDER)];
#if PF_P(LIMIT)
  PF_P(real) limit[PF_P(N_F)];                             /* bound on |f_hat| */
#endif
#if PF_P(G_LIMIT)
  PF_P(real) g_low[PF_P(N_X)], g_high[PF_P(N_X)];          /* between them g acts */
#endif
#if PF_P(DIRECTION)
  PF_P(real) E_left[PF_P(N_F)][PF_P(N_X)];                 /* left inverse of E */
#endif
#if PF_P(INERTIA) && !PF_P(INERTIA_INPUT)
  PF_P(real) inertia[PF_ENTRIES];                          /* constant */
#endif
} PF_P(params);

#if PF_P(PAST)
typedef struct {
  double dt;
  PF_P(real) g[2][PF_P(N_X)], f_theta[2][PF_P(N_F)], inertia[2][PF_ENTRIES]; /* at its beginning and end */
} PF_P(interval);
#endif

typedef struct { /* what moves; from `rate` on what only init, retune and the limits set */
  PF_P(real) w[PF_P(N_F)][PF_P(ORDER)]; /* states of the sections, in the unit of f */
#if PF_P(FLOAT)
  PF_P(real) carry[PF_P(N_F)][PF_P(ORDER)]; /* what rounding took from them */
#endif
  PF_P(real) x[PF_P(N_X)], g[PF_P(N_X)], f_theta[PF_P(N_F)]; /* of the last sample */
#if !PF_P(G_AVERAGE)
  PF_P(real) g_held[PF_P(N_X)]; /* remembered: acts until the next sample */
#endif
#if PF_P(INERTIA_INPUT) || (PF_P(INERTIA) && !PF_P(CONSTANT))
  PF_P(real) inertia[PF_ENTRIES];
#endif
  int8_t started, held, has_g, has_inertia;
#if PF_WIDE
  PF_P(real) dA_other[PF_P(FILTERS)][PF_P(ORDER)][PF_P(ORDER)]; /* of the last step of another length, dt_other */
  double dt_other;
#endif
#if PF_P(HOLD_BAD) || PF_P(PAST)
  double gap; /* seconds from the last accepted sample to the last one */
  double sum_g[PF_P(N_X)], sum_f_theta[PF_P(N_F)]; /* integrals since the last accepted sample, `delay` late */
  PF_P(real) inertia_then[PF_ENTRIES]; /* inertia at their beginning */
#endif
#if PF_P(PAST)
  int32_t count;
  PF_P(interval) past[PF_P(PAST)]; /* oldest first */
#endif
#if PF_P(CONSTANT)
  int32_t ready; /* init has found the parameters as they were exported */
#else
  PF_P(real) rate; /* 1 / dt */
  PF_P(real) dA[PF_P(FILTERS)][PF_P(ORDER)][PF_P(ORDER)];
  PF_P(real) equilibrium[PF_P(FILTERS)][PF_P(ORDER)], C[PF_P(FILTERS)][PF_P(ORDER)];
#if PF_P(DIRECTION)
  PF_P(real) E_left[PF_P(N_F)][PF_P(N_X)];
#endif
#if PF_P(LIMIT)
  PF_P(real) limit[PF_P(N_F)];
#endif
#if PF_P(G_LIMIT)
  PF_P(real) g_low[PF_P(N_X)], g_high[PF_P(N_X)];
#endif
  double dt;
#endif
#if PF_WIDE || PF_P(TUNABLE)
  int32_t order[PF_P(FILTERS)];
  double poles[PF_P(FILTERS)][PF_P(ORDER)][2];
#endif
#if PF_P(TUNABLE)
  double a[PF_P(FILTERS)][PF_P(ORDER)], b[PF_P(FILTERS)][PF_P(ORDER)]; /* in force */
  double a_home[PF_P(FILTERS)][PF_P(ORDER)], poles_home[PF_P(FILTERS)][PF_P(ORDER)][2]; /* as exported: exact poles */
#endif
#if PF_P(PAST)
  double delay;
#endif
} PF_NAME;

int PF_P(init)(PF_NAME *self, const PF_P(params) *params);
void PF_P(reset)(PF_NAME *self);
int PF_P(start)(PF_NAME *self, const PF_P(real) *x0, const PF_P(real) *f_hat0, const PF_P(real) *f_theta0,
                const PF_P(real) *inertia0, const PF_P(real) *g0);
int PF_P(step)(PF_NAME *self, const PF_P(real) *x, const PF_P(real) *g, const PF_P(real) *f_theta,
               const PF_P(real) *inertia, PF_P(real) *f_hat);
int PF_P(output)(PF_NAME *self, const PF_P(real) *x, const PF_P(real) *g, const PF_P(real) *f_theta,
                 const PF_P(real) *inertia, PF_P(real) *f_hat);
#if PF_P(VARIABLE)
int PF_P(step_after)(PF_NAME *self, const PF_P(real) *x, const PF_P(real) *g, const PF_P(real) *f_theta,
                     const PF_P(real) *inertia, double dt, PF_P(real) *f_hat);
int PF_P(output_after)(PF_NAME *self, const PF_P(real) *x, const PF_P(real) *g, const PF_P(real) *f_theta,
                       const PF_P(real) *inertia, double dt, PF_P(real) *f_hat);
#endif
void PF_P(remember)(PF_NAME *self, const PF_P(real) *g);
int PF_P(shift_x)(PF_NAME *self, const PF_P(real) *dx);
#if PF_P(LIMIT) && !PF_P(CONSTANT)
int PF_P(set_limit)(PF_NAME *self, const PF_P(real) *limit);
#endif
#if PF_P(G_LIMIT) && !PF_P(CONSTANT)
int PF_P(set_g_limit)(PF_NAME *self, const PF_P(real) *low, const PF_P(real) *high);
#endif
#if PF_P(TUNABLE)
int PF_P(retune)(PF_NAME *self, const double *a, const double *b);
int PF_P(retune_poles)(PF_NAME *self, const double *poles, const double *b);
#endif

#undef PF_ENTRIES
#undef PF_WIDE
#undef PF_NAME
