/* One guarded filter and what the tests look at in it, by name; and a tuning of their choice. */
#include <string.h>

#include "craft_guard.h"

static craft_guard self;
static craft_params parameters;

int begin(void);
void forget(void);
uint32_t step(uint64_t time, const craft_real *x, const craft_real *g, const craft_real *f_theta, craft_real *f_hat,
              const craft_real *inertia);
int send(const double *poles, const double *b, int damage);
void flip(int which, int byte, int bit);
int size(int which);
void bound(double value);
uint32_t count(int which);
void check(void);

int begin(void) {
  parameters = craft_parameters;
  return craft_guard_init(&self, &parameters);
}
void forget(void) { memset(&self, 0, sizeof self); }

uint32_t step(uint64_t time, const craft_real *x, const craft_real *g, const craft_real *f_theta, craft_real *f_hat,
              const craft_real *inertia) {
  return craft_guard_step(&self, time, x, g, f_theta, inertia, f_hat);
}

int send(const double *poles, const double *b, int damage) {
  craft_tuning tuning = {0};
  memcpy(tuning.poles, poles, sizeof tuning.poles);
  memcpy(tuning.b, b, sizeof tuning.b);
  craft_guard_seal(&tuning);
  if (damage == 1) tuning.b[0][0] += 1.0;
  if (damage == 2) tuning.version++;
  const int code = craft_guard_send(&self, &tuning);
  if (!code && damage == 3) self.tunings[(self.sent - 1u) & 1u].b[0][0] += 1.0; /* on its way */
  return code;
}

#define AT(member) {(unsigned char *)&self.filter.member, sizeof self.filter.member}
static const struct {
  unsigned char *at;
  size_t size;
} PLACES[] = {AT(dA), AT(w), AT(dA_other), AT(order), AT(a), AT(b), AT(poles), AT(a_home), AT(poles_home), AT(rate),
              AT(dt), {(unsigned char *)&parameters.a, sizeof parameters.a}, PLACES_OF_OPTIONS};
int size(int which) { return which < (int)(sizeof PLACES / sizeof *PLACES) ? (int)PLACES[which].size : 0; }
void flip(int which, int byte, int bit) { PLACES[which].at[byte] ^= (unsigned char)(1u << bit); }
void bound(double value) { for (int i = 0; i < craft_N_F; i++) self.plausible[i] = (craft_real)value; }

uint32_t count(int which) {
  const uint32_t counts[] = {self.missed, self.bad, self.jumps, self.refused, self.implausible};
  return counts[which];
}
void check(void) { craft_guard_check(&self); }
