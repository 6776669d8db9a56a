/* A thread that runs @name@ every @dt@ s on what `measure` gives. */
#include <zephyr/kernel.h>
#include <zephyr/sys/printk.h>

#include "@name@_guard.h"

static @name@_guard guard;

/* Your sensor and your known force go here: g is @which_g@. */
static void measure(@name@_real *x, @name@_real *g)
{
	for (int i = 0; i < @name@_N_X; i++) {
		x[i] = g[i] = 0;
	}
}

int main(void)
{
	@name@_real x[@name@_N_X], g[@name@_N_X], f_theta[@name@_N_F] = {0}, f_hat[@name@_N_F];
	const int64_t start = k_uptime_ticks();
	const int code = @name@_guard_init(&guard, &@name@_parameters);

	if (code) {
		printk("@name@: %s\n", pf_filter_message(code));
		return code;
	}
	for (uint32_t k = 0;; k++) {
		measure(x, g);
		const uint32_t health = @name@_guard_step(&guard, k_ticks_to_us_floor64(k_uptime_ticks()), x, g, f_theta,
							   NULL, f_hat);

		if (health || k % 1000 == 0) {
			printk("%u: health %u, f_hat[0] = %d milli\n", k, health, (int)(1000 * f_hat[0]));
		}
		if (k % 500 == 499) {
			@name@_guard_check(&guard);
		}
		/* From the start on: a period that is no whole number of ticks does not drift. */
		k_sleep(K_TIMEOUT_ABS_TICKS(start + (int64_t)k_us_to_ticks_near64(@period_us@ * (k + UINT64_C(1)))));
	}
}
