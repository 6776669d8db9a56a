/* Random numbers and arguments for the fuzzers of exported FMUs. See fuzz2.c and fuzz3.c. */
#ifndef FUZZ_H
#define FUZZ_H
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "pf_fmi.h"

enum { POOL = 3, CALLS = 40, ROOM = 64 };

static uint64_t seed_now;

static uint32_t random_bits(void) { /* xorshift64*, Vigna 2016 */
  seed_now ^= seed_now >> 12;
  seed_now ^= seed_now << 25;
  seed_now ^= seed_now >> 27;
  return (uint32_t)((seed_now * 2685821657736338717ULL) >> 32);
}

static uint32_t below(uint32_t n) { return random_bits() % n; }
static int chance(uint32_t percent) { return below(100) < percent; }
static double uniform(void) { return random_bits() / 4294967296.0; }

/* Mostly sensible, sometimes anything. Not: steps of 1e3 to 1e5 s, which are legal and take long. */
static double number(void) {
  static const double odd[] = {0.0, -0.0, -1.0, 1e-300, -1e300, 1e300, 1e18, 1e9, 1e-12, INFINITY, -INFINITY, NAN};
  return chance(80) ? 2.0 * uniform() - 1.0 : odd[below(sizeof odd / sizeof odd[0])];
}

static double step_size(void) { return chance(80) ? 0.02 * uniform() : number(); }

static uint32_t reference(void) { return chance(90) ? below(pf_fmu_here.n_variables) : random_bits(); }

static uint32_t references[ROOM];
static double numbers[ROOM], more_numbers[ROOM];

/* Fills references and numbers; how many references. *n_values is how many numbers belong to them, or nearly. */
static size_t arguments(size_t *n_values) {
  const size_t n = chance(3) ? 0 : 1 + below(4);
  *n_values = 0;
  for (size_t i = 0; i < n; i++) {
    references[i] = reference();
    *n_values += references[i] < pf_fmu_here.n_variables ? pf_fmu_here.variables[references[i]].count : 1;
  }
  if (chance(8)) *n_values = below(ROOM);
  if (*n_values > ROOM) *n_values = ROOM;
  for (size_t i = 0; i < ROOM; i++) numbers[i] = number();
  return n;
}

static long messages, errors;

static void fail(const char *what, uint64_t seed) {
  fprintf(stderr, "%s in the sequence of seed %llu\n", what, (unsigned long long)seed);
  exit(1);
}

#endif
