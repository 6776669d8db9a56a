/* A filter behind its guard for a day at 500 Hz, with a fault every 20 s, beside one that sees none of them.
 *
 * Prints a line an hour, the same on the host and on the board: CRC-32 of every f_hat so far, what the guard counted,
 * flags that were not those of the fault, and the largest deviation from the undisturbed one once the filter has
 * settled after a fault, in millionths of the force. On the board a last line: most instructions of each kind of step,
 * and bytes of stack. -DSTEPS: of them. */
#include "pf_ieee.h"

#include "console.h"
#include "pf_crc.h"
#include "wing_guard.h"

#ifndef STEPS
#define STEPS 43200000u
#endif
#define HOUR 1800000u   /* steps */
#ifndef EVERY
#define EVERY 10000u    /* steps between faults */
#define SETTLED 3000u   /* steps after one: 6 s, 60 time constants of the slowest poles */
#endif
#define PERIOD_US 2000u

enum { NAN_X, INF_G, STUCK, SPIKE, AHEAD, BACK, MISSING, RETUNE, DAMAGED, STATE_BIT, COEFFICIENT_BIT, KINDS };
enum { NOMINAL, LONGER, RESTARTED, TUNED, CHECKED, TIMED };

static wing_guard guard, twin;
static uint32_t seed = 12345, most[TIMED];
static const double FAST[wing_ORDER][2] = TUNING, SLOW[wing_ORDER][2] = POLES;

static uint32_t bits(void) {
  seed = seed * 1664525u + 1013904223u;
  return seed >> 8;
}

static wing_real noise(void) { return (wing_real)((int32_t)bits() - 8388608) * (wing_real)(1.0 / 8388608.0); }

static wing_real over_zero(wing_real v) {
  volatile wing_real zero = 0;
  return v / zero;
}

static int send(wing_guard *to, const double (*poles)[2], int damage) {
  wing_tuning tuning;
  double a0 = 1.0;
  memset(&tuning, 0, sizeof tuning);
  memcpy(tuning.poles[0], poles, sizeof tuning.poles[0]);
  for (int i = 0; i < wing_ORDER; i++) /* pairs in a row: re^2 + im^2 */
    a0 *= poles[i][1] == 0.0 ? -poles[i][0] : poles[i][1] > 0.0 ? poles[i][0] * poles[i][0] + poles[i][1] * poles[i][1] : 1.0;
  tuning.b[0][0] = a0;
  wing_guard_seal(&tuning);
  const int code = wing_guard_send(to, &tuning);
  if (!code && damage) to->tunings[(to->sent - 1u) & 1u].b[0][0] *= 2.0; /* on its way */
  return code;
}

static void flip(void *where, size_t size) { ((unsigned char *)where)[bits() % size] ^= (unsigned char)(1u << (bits() & 7u)); }

int main(void) {
  wing_real x[wing_N_X] = {0}, g[wing_N_X] = {0}, f_theta[wing_N_F] = {0}, out[wing_N_F], clean[wing_N_F];
  wing_real seen[wing_N_X], known[wing_N_X], stuck[wing_N_X] = {0};
  uint64_t now = 1000000u, offset = 0;
  uint32_t crc = 0, wrong = 0, faults = 0, begin = 0, length = 0, kind = KINDS, flagged = 0;
  double worst = 0.0;
  if (wing_guard_init(&guard, &wing_parameters) || wing_guard_init(&twin, &wing_parameters)) return 1;
  for (int i = 0; i < wing_N_F; i++) guard.plausible[i] = (wing_real)50;
  for (uint32_t k = 1; k <= STEPS; k++, now += PERIOD_US) {
    /* A force of some N, a noisy known one, a velocity that stays bounded. */
    for (int i = 0; i < wing_N_X; i++) {
      const wing_real force = (wing_real)((k / 2000u + (uint32_t)i) % 5u) - (wing_real)2;
      g[i] = noise() - x[i] * (wing_real)0.5;
      x[i] += (wing_real)(PERIOD_US * 1e-6) * (force + g[i]);
    }
    if (k % EVERY == EVERY / 2) {
      kind = faults++ % KINDS;
      begin = k;
      length = 1u + bits() % (kind == STUCK ? 50u : 15u);
      flagged = 0;
      memcpy(stuck, x, sizeof stuck);
      if (kind == AHEAD) offset += 10000000u;
      if (kind == BACK) offset -= 3000000u;
      if (kind == RETUNE) wrong += (uint32_t)(send(&guard, faults % 2u ? FAST : SLOW, 0) || send(&twin, faults % 2u ? FAST : SLOW, 0));
      if (kind == DAMAGED) wrong += (uint32_t)send(&guard, FAST, 1);
      if (kind == STATE_BIT) flip(guard.filter.w, sizeof guard.filter.w);
      if (kind == COEFFICIENT_BIT) flip(guard.filter.dA, sizeof guard.filter.dA);
    }
    memcpy(seen, x, sizeof seen);
    memcpy(known, g, sizeof known);
    if (k - begin < length) {
      if (kind == NAN_X) seen[0] = over_zero(0); /* not a number */
      if (kind == INF_G) known[wing_N_X - 1] = over_zero(1); /* infinite */
      if (kind == STUCK) memcpy(seen, stuck, sizeof seen);
      if (kind == SPIKE && k == begin) seen[0] += (wing_real)5;
    }
    wing_guard_step(&twin, now, x, g, f_theta, NULL, clean);
    if (kind == MISSING && k - begin < length) continue;
    const uint32_t from = TICKS;
    const uint32_t health = wing_guard_step(&guard, now + offset, seen, known, f_theta, NULL, out);
    const uint32_t ticks = (from - TICKS) & 0xFFFFFFu;
    /* A step that holds is as nominal: it takes less. */
    const uint32_t restarts = PF_HEALTH_TIME | PF_HEALTH_STATE | PF_HEALTH_REPAIRED;
    const uint32_t as = (kind == RETUNE && k == begin) || health & PF_HEALTH_REFUSED ? TUNED
                        : health & PF_HEALTH_MISSED                                  ? LONGER
                        : health & restarts                                          ? RESTARTED
                                                                                     : NOMINAL;
    if (ticks > most[as]) most[as] = ticks;
    if (k % 500u == 0) {
      const uint32_t at = TICKS;
      wing_guard_check(&guard);
      const uint32_t taken = (at - TICKS) & 0xFFFFFFu;
      if (taken > most[CHECKED]) most[CHECKED] = taken;
    }
    flagged |= health;
    for (int i = 0; i < wing_N_F; i++) wrong += !(out[i] - out[i] == (wing_real)0);
    if (kind < KINDS && k == begin + SETTLED) { /* the flags were those of the fault, no others */
      static const uint32_t EXPECTED[KINDS] = {
          PF_HEALTH_NOT_FINITE, PF_HEALTH_NOT_FINITE, 0, 0, PF_HEALTH_TIME, PF_HEALTH_TIME, PF_HEALTH_MISSED, 0,
          PF_HEALTH_REFUSED, 0, PF_HEALTH_REPAIRED};
      uint32_t allowed = EXPECTED[kind];
      if (kind == NAN_X || kind == INF_G) allowed |= PF_HEALTH_MISSED; /* the next good one is a longer step */
      /* A large flip of a coefficient throws the state out before the next check finds it. */
      if (kind >= STATE_BIT || kind == STUCK || kind == SPIKE) allowed |= PF_HEALTH_STATE;
      wrong += (flagged & EXPECTED[kind]) != EXPECTED[kind] || (flagged & ~allowed) != 0;
    }
    if (kind == KINDS || k >= begin + SETTLED)
      for (int i = 0; i < wing_N_F; i++) {
        const double off = (double)(out[i] - clean[i]);
        if (off > worst || -off > worst) worst = off < 0 ? -off : off;
      }
    crc ^= pf_crc32(out, sizeof out) + (crc << 1 | crc >> 31);
    if (k % HOUR == 0 || k == STEPS) {
      put_number(k), put_number(crc), put_number(faults), put_number(wrong), put_number((uint32_t)(worst * 1e6));
      put_number(guard.missed), put_number(guard.bad), put_number(guard.jumps), put_number(guard.refused);
      put_number(guard.implausible);
      put_text("\n");
    }
  }
#ifdef __arm__
  for (int i = 0; i < TIMED; i++) put_number(most[i]);
  put_number(stack_used());
  put_number(sizeof guard);
  put_text("\n");
#endif
  return 0;
}
