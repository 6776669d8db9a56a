/* A thread that runs @name@ every @NAME@_STEP s on its start inputs. */
#include <zephyr/kernel.h>
#include <zephyr/sys/printk.h>

#include "@name@.h"

static @name@ self;

int main(void)
{
	pf_real u[@NAME@_N_U + 1] = {0}, y[@NAME@_N_Y + 1];
	const int64_t start = k_uptime_ticks();

	if (@name@_init(&self)) {
		printk("@name@: refused, see pf_ieee.h\n");
		return 1;
	}
	for (int i = 0; i < @NAME@_N_U; i++) { /* your inputs, every step */
		u[i] = @name@_model.u(&self)[i];
	}
	for (uint32_t k = 0;; k++) {
		const int status = @name@_step(&self, u, y);

		if (status || k % 1000 == 0) {
			printk("%u: status %d, y[0] = %d milli\n", k, status, (int)(1000 * y[0]));
		}
		/* From the start on: a step that is no whole number of ticks does not drift. */
		k_sleep(K_TIMEOUT_ABS_TICKS(start + (int64_t)k_us_to_ticks_near64((uint64_t)(1e6 * @NAME@_STEP * (k + 1.0) + 0.5))));
	}
}
