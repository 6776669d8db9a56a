/* Instances that Rust refers to by number: it needs to know nothing of their layout. */
#include "@name@_guard.h"

#ifndef @NAME@_INSTANCES
#define @NAME@_INSTANCES 1
#endif

static @name@_guard instances[@NAME@_INSTANCES];

int @name@_rust_init(uint32_t number);
uint32_t @name@_rust_step(uint32_t number, uint64_t time, const @name@_real *x, const @name@_real *g,
                          const @name@_real *f_theta, const @name@_real *inertia, @name@_real *f_hat);
void @name@_rust_check(uint32_t number);

int @name@_rust_init(uint32_t number) { return @name@_guard_init(&instances[number], &@name@_parameters); }

uint32_t @name@_rust_step(uint32_t number, uint64_t time, const @name@_real *x, const @name@_real *g,
                          const @name@_real *f_theta, const @name@_real *inertia, @name@_real *f_hat) {
  return @name@_guard_step(&instances[number], time, x, g, f_theta, inertia, f_hat);
}

void @name@_rust_check(uint32_t number) { @name@_guard_check(&instances[number]); }
