/* Runs drone_filter on the signals in drone_filter_vectors.h and compares f_hat with what Python computed.
 *
 * Build all files of this folder:   cc -std=c99 -O2 -ffp-contract=off *.c -o drone_filter
 * In a product: leave out this file and drone_filter_vectors.h.
 *
 * In a loop, every 0.002 s:
 *
 *   static drone_filter filter;
 *   drone_filter_init(&filter, &drone_filter_parameters);                  once; not 0: see pf_filter.h
 *   drone_filter_step(&filter, x, g, f_theta, NULL, f_hat);            g: now
 *
 * The first step is the start: f_hat = f_theta. A jump of the estimate of x (a reset): drone_filter_shift_x.
 */
#include <stdio.h>

#include "drone_filter.h"
#include "drone_filter_vectors.h"

int main(void) {
  static drone_filter filter;
  drone_filter_real f_hat[DRONE_FILTER_N_F], worst = 0;
  int code = drone_filter_init(&filter, &drone_filter_parameters);
  for (int k = 0; !code && k < DRONE_FILTER_SAMPLES; k++) {
    code = drone_filter_step(&filter, drone_filter_x[k], drone_filter_g[k], drone_filter_f_theta[k], NULL, f_hat);
    for (int i = 0; !code && i < DRONE_FILTER_N_F; i++) {
      const drone_filter_real off = f_hat[i] - drone_filter_f_hat[k][i];
      if (!(off <= worst && -off <= worst)) worst = off < 0 ? -off : off;
    }
  }
  if (code) {
    printf("drone_filter: %s\n", pf_filter_message(code));
    return 1;
  }
  printf("drone_filter: %d samples, f_hat within %g of the recorded one, allowed %g\n", DRONE_FILTER_SAMPLES, (double)worst,
         (double)DRONE_FILTER_ALLOWED);
  return worst <= DRONE_FILTER_ALLOWED ? 0 : 1;
}
