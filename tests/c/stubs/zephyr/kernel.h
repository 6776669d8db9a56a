/* What the exported sample uses of Zephyr's kernel, for a build on the host: time runs at 32,768 ticks a second, and ends
 * after 3000 sleeps. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

typedef int64_t k_timeout_t;
static int64_t stub_ticks = 100000, stub_sleeps;
static inline int64_t k_uptime_ticks(void) { return stub_ticks; }
static inline uint64_t k_ticks_to_us_floor64(int64_t t) { return (uint64_t)t * 1000000u / 32768u; }
static inline int64_t k_us_to_ticks_near64(uint64_t t) { return (int64_t)((t * 32768u + 500000u) / 1000000u); }
#define K_TIMEOUT_ABS_TICKS(t) (t)
static inline void k_sleep(k_timeout_t until) {
  stub_ticks = until;
  if (++stub_sleeps == 3000) {
    printf("%d ticks\n", (int)(stub_ticks - 100000));
    exit(0);
  }
}
