/* Coefficients of a filter at run time: from polynomials or poles to the matrices of the recursion. All in double, no
 * libm, no memory but the caller's and the stack. Firmware that never retunes and runs at one rate leaves it out.
 *
 * D = s^n + a[n-1] s^(n-1) + ... + a[0]. Poles are pairs (real, imaginary) in rad/s, slowest first, each complex pair
 * together with the positive imaginary part first. Matrices are n x n, row by row.
 */
#ifndef PF_TUNE_H
#define PF_TUNE_H

#include "pf_hurwitz.h" /* PF_MAX_ORDER */

enum { PF_EXACT = 0, PF_EULER = 1, PF_TUSTIN = 2 };

/* pf_roots.c: poles of D, repeated ones recognised. 0 where D is not Hurwitz, a coefficient is not finite or n is out
 * of range. */
int drone_filter_pf_roots(int n, const double *a, double *poles);

/* Pairs conjugates, sorts. 0 where a pole is not in the open left half plane, lacks its conjugate or is not finite. */
int drone_filter_pf_sort_poles(int n, double *poles);

/* pf_tune.c from here on. a[0..n-1] of the monic polynomial with these roots. */
void drone_filter_pf_polynomial(int n, const double *poles, double *a);

/* The chain of sections of unit gain, the fastest first: w' = A (w - equilibrium u), and the row C with C w = F u for
 * F = N/D. */
void drone_filter_pf_chain(int n, const double *poles, double *A, double *equilibrium);
void drone_filter_pf_chain_output(int n, const double *poles, const double *a, const double *b, double *C);

/* dA = exp(A h) - I, A h or (I - A h/2)^-1 A h, by method. */
void drone_filter_pf_transition(int n, const double *poles, int method, double h, double *dA);

/* Whether forward Euler diverges, |1 + p h| >= 1 for some pole. */
int drone_filter_pf_euler_diverges(int n, const double *poles, double h);

/* Makes w, a state of the old chain, the state from which another chain goes on: the output stays where it is, and rest
 * stays rest. The equations are in phyfilter_ctl/sampled/retuning.py. */
void drone_filter_pf_move_state(int n, const double *old_poles, const double *old_equilibrium, const double *old_C,
                   const double *poles, const double *equilibrium, const double *C, double *w);

#endif
