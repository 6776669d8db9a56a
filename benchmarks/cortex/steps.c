/* Calls of a step, each of a kind, one after another; trace.py counts what every one of them executes. tested.h says
 * what is stepped, and SCHEDULE in which kinds: s the start, n a step in time, b a sample that is not finite, l the one
 * after it, g one after a gap, j a jump of the clock, u a step that takes other poles over, c a check of the
 * coefficients. Prints a hash of every f_hat, bytes of stack and of state. */
#include "tested.h"

#include <string.h>

#include "console.h"

static real x[3], g[3], f_theta[3], f_hat[3];
static uint64_t now = 1000000u;
static uint32_t seed = 12345, hash = 2166136261u;
void measured(void);
void measured_check(void);

static real noise(void) {
  seed = seed * 1664525u + 1013904223u;
  return (real)((int32_t)(seed >> 8) - 8388608) * (real)(1.0 / 8388608.0);
}

__attribute__((noinline)) void measured(void) { step(now, x, g, f_theta, f_hat); }
__attribute__((noinline)) void measured_check(void) { check(); }

static void all(void) {
  for (const char *kind = SCHEDULE; *kind; kind++) {
    volatile real zero = 0;
    real kept;
    for (int i = 0; i < 3; i++) {
      g[i] = noise() - x[i] * (real)0.5;
      x[i] += (real)0.002 * ((real)(i - 1) + g[i]);
      f_theta[i] = noise();
    }
    now += *kind == 'g' ? 8000u : *kind == 'j' ? 10000000u : 2000u;
    if (*kind == 'u') tune();
    kept = x[0];
    if (*kind == 'b') x[0] = zero / zero;
    if (*kind == 'c')
      measured_check();
    else
      measured();
    x[0] = kept;
    for (unsigned i = 0; i < sizeof f_hat; i++) {
      unsigned char byte;
      memcpy(&byte, (const char *)f_hat + i, 1);
      hash = (hash ^ byte) * 16777619u;
    }
  }
}

int main(void) {
  unsigned stack;
  if (begin()) return 1;
  stack = stack_of(all);
  put_number(hash);
  put_number(stack);
  put_number((uint32_t)state_bytes());
  put_text("\n");
  return 0;
}
