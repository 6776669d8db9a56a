/* IEEE arithmetic whatever the firmware is built with: the first include of every file that computes, and once more
 * before each table of numbers, because gcc goes back to its command line after every function.
 *
 * PX4 builds with -funsafe-math-optimizations, ArduPilot with -fsingle-precision-constant, and compilers fuse products
 * and sums of their own accord. Such flags are taken back for the rest of the file; where a compiler cannot, building
 * ends here, or `init` says PF_FILTER_ARITHMETIC or PF_UNUSABLE: pf_ieee_holds_ asks the machine, not a macro.
 */
#ifndef PF_IEEE_H
#include <float.h>
/* -ffast-math also links code that flushes small numbers to zero: that cannot be taken back here. */
#if DBL_MANT_DIG != 53
#error "the filter needs a double of 64 bits: AVR's has 32"
#endif
#if defined(__FAST_MATH__) || (defined(FLT_EVAL_METHOD) && FLT_EVAL_METHOD == 2)
#error "the filter needs IEEE arithmetic: build without -ffast-math, and on 32-bit x86 with -msse2 -mfpmath=sse"
#endif
#endif

#if defined(__clang__)
#pragma float_control(precise, on)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize("no-single-precision-constant", "fp-contract=off", "no-unsafe-math-optimizations", \
                     "no-associative-math", "no-reciprocal-math", "no-finite-math-only", "signed-zeros")
#elif defined(_MSC_VER)
#pragma float_control(precise, on)
#pragma fp_contract(off)
#endif

#ifndef PF_IEEE_H
#define PF_IEEE_H
#include <stdint.h>
#include <string.h>

#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wfloat-equal" /* v - v == 0 is how a number is found to be finite */
#endif
#if (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__) || defined(__ASSOCIATIVE_MATH__) || defined(__RECIPROCAL_MATH__)
#error "the filter needs IEEE arithmetic: build without -ffinite-math-only and -funsafe-math-optimizations"
#endif
typedef char pf_build_with_fno_single_precision_constant_[sizeof(0.1) == sizeof(double) ? 1 : -1];

/* Whether sums keep their order, quotients are quotients, and what is not a number is not finite. */
static inline int pf_ieee_holds_(void) {
  const uint64_t bits = 0x7FF8000000000000u; /* not a number */
  volatile double one = 1.0, tiny = 0x1p-60, three = 3.0, none;
  double nan;
  memcpy(&nan, &bits, sizeof nan);
  none = nan;
  const double a = one, b = tiny, c = three, v = none;
  return (a + b) - a == 0.0 && a / c == 0x1.5555555555555p-2 && !(v - v == 0.0);
}

#endif
