/* A filter behind real signals: what a flight controller needs around it, the same on every target.
 *
 * Time stamps are integers in microseconds. A sample that is late or missing makes one longer step; where time stands
 * still, runs back or jumps the filter goes on from the sample with the states that it has; samples that are not finite leave the
 * correction f_hat - f_theta where it is. Parameters come from another thread, by double buffer with version and
 * CRC-32, must have all poles in the open left half plane, and take over without a jump. Bits that flip are found: in
 * the coefficients by their CRC-32 (wing_guard_check, at any slow rate), in the states by a bound on the correction that
 * the caller sets. What no number shows stays unsaid: a sensor that sticks, drifts or spikes within the bound.
 *
 * A step within 5 % of the nominal one counts as nominal. Limits are those of the parameters: others, by wing_set_limit,
 * count as damage. For PF_NAME wing: wing_guard and the functions below. f_hat is finite after every step, whatever
 * came in, and within its limit for as long as the filter is not stopped (PF_HEALTH_DAMAGED).
 */
#ifndef PF_GUARD_COMMON
#define PF_GUARD_COMMON

enum { /* health of the last step, flags */
  PF_HEALTH_OK = 0,
  PF_HEALTH_MISSED = 1,     /* samples were missing before this one: one longer step made up for them */
  PF_HEALTH_NOT_FINITE = 2, /* a number was not finite: the correction is held */
  PF_HEALTH_TIME = 4,       /* time stood still, ran back or jumped: no step, the estimate stays */
  PF_HEALTH_LIMIT = 8,      /* f_hat is at its limit */
  PF_HEALTH_REFUSED = 16,   /* new parameters were damaged, of another version or not stable: the old ones stay */
  PF_HEALTH_STATE = 32,     /* the correction, before its limit, is not plausible: started again from f_theta */
  PF_HEALTH_REPAIRED = 64,  /* wing_guard_check found damaged coefficients and put them back */
  PF_HEALTH_DAMAGED = 128   /* the parameters to put back are damaged too, or init has refused: f_hat = f_theta */
};

#endif

typedef struct {
  uint32_t version, crc; /* wing_guard_seal fills them */
  double poles[PF_P(FILTERS)][PF_P(ORDER)][2], b[PF_P(FILTERS)][PF_P(ORDER)]; /* as of wing_retune_poles */
} PF_P(tuning);

typedef struct {
  PF_NAME filter;
  const PF_P(params) *params;         /* as exported */
  PF_P(tuning) tunings[2], in_force;  /* one of two is written while the other may be read */
  volatile uint32_t sent, seen;       /* tunings sent by the other thread, seen by the step */
  uint32_t running, tuned;            /* whether there was a good sample; whether in_force differs from what was exported */
  uint32_t crc;                       /* of the coefficients in the filter */
  PF_P(real) plausible[PF_P(N_F)];    /* bound on the correction before its limit; 0: none */
  PF_P(real) correction[PF_P(N_F)];   /* f_hat - f_theta of the last good step */
  PF_P(real) f_theta[PF_P(N_F)];      /* last that was finite */
  uint64_t time;                      /* us, of the last good sample */
  uint32_t longest;                   /* us, without a sample: longer is a jump; more than LONGEST nominal steps are no step anyhow */
  uint32_t health, repaired;
  uint32_t missed, bad, jumps, refused, implausible; /* counts since init */
} PF_P(guard);

/* 0 or why the filter refuses its parameters (pf_filter_message). `longest` is 20 nominal steps until it is set. */
int PF_P(guard_init)(PF_P(guard) *self, const PF_P(params) *params);

/* One sample taken at `time` (us). g as for the filter's step: where it is held, the g that acted since the last
 * sample. Returns the health; f_hat is always written, and may be the memory of f_theta. */
uint32_t PF_P(guard_step)(PF_P(guard) *self, uint64_t time, const PF_P(real) *x, const PF_P(real) *g,
                          const PF_P(real) *f_theta, const PF_P(real) *inertia, PF_P(real) *f_hat);

#if PF_P(TUNABLE)
void PF_P(guard_seal)(PF_P(tuning) *tuning);

/* From any one other thread: the next step takes it over. 0; PF_FILTER_INVALID while the one before waits to be seen;
 * PF_FILTER_NOT_HURWITZ, _VERSION or _CORRUPT, and then nothing was sent. */
int PF_P(guard_send)(PF_P(guard) *self, const PF_P(tuning) *tuning);
#endif

/* Compares the coefficients in the filter with their CRC-32 and puts them back where bits have flipped; the step after
 * says so. Where the parameters are damaged as well, the filter stops, and every step says that. From the thread of the
 * step. */
void PF_P(guard_check)(PF_P(guard) *self);

#undef PF_NAME
