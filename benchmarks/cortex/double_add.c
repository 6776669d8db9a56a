/* Sums of doubles, rounded to nearest even, for cores that have no instruction for them.
 *
 * The __aeabi_dadd and __aeabi_dsub of libgcc 12 (ieee754-df.S) keep one bit too few where the exponents differ by 33
 * and the difference loses a bit in front: then the last bit of the result may be wrong. Linked instead of them with
 * -Wl,--wrap=__aeabi_dadd,--wrap=__aeabi_dsub. Subnormal numbers, infinities and what is not a number go to libgcc,
 * which is right about them.
 */
#include <stdint.h>
#include <string.h>

#define IN_CORE_REGISTERS __attribute__((pcs("aapcs"))) /* as the run-time ABI has it, whatever -mfloat-abi says */
double __real___aeabi_dadd(double a, double b) IN_CORE_REGISTERS;
double __wrap___aeabi_dadd(double a, double b) IN_CORE_REGISTERS;
double __wrap___aeabi_dsub(double a, double b) IN_CORE_REGISTERS;

#define HIDDEN (1ull << 52)

static uint64_t bits_of(double v) {
  uint64_t bits;
  memcpy(&bits, &v, sizeof bits);
  return bits;
}

double __wrap___aeabi_dadd(double a, double b) {
  uint64_t x = bits_of(a), y = bits_of(b);
  if (x << 1 < y << 1) { /* |a| >= |b| */
    const uint64_t swap = x;
    x = y;
    y = swap;
  }
  const int ex = (int)(x >> 52 & 0x7FFu), ey = (int)(y >> 52 & 0x7FFu), apart = ex - ey;
  if (ey == 0 || ex >= 0x7FE || ex < 60 || apart > 60) return __real___aeabi_dadd(a, b);
  /* Three bits behind the last, the third of them also for all that is behind it. */
  uint64_t large = (HIDDEN | (x & (HIDDEN - 1))) << 3, small = (HIDDEN | (y & (HIDDEN - 1))) << 3, sum;
  int exponent = ex;
  small = small >> apart | (uint64_t)(small << (63 - apart) << 1 != 0);
  sum = (x ^ y) >> 63 ? large - small : large + small;
  if (!sum) return 0.0;
  if (sum >> 56) {
    sum = sum >> 1 | (sum & 1u);
    exponent++;
  }
  while (!(sum >> 55)) {
    sum <<= 1;
    exponent--;
  }
  /* A carry out of the rounding goes on into the exponent, as it should. */
  const uint64_t whole = sum >> 3, rest = sum & 7u;
  const uint64_t result = ((uint64_t)(exponent - 1) << 52) + whole + (rest > 4u || (rest == 4u && whole & 1u));
  double v;
  const uint64_t signed_result = result | (x & 1ull << 63);
  memcpy(&v, &signed_result, sizeof v);
  return v;
}

double __wrap___aeabi_dsub(double a, double b) { return __wrap___aeabi_dadd(a, -b); }
