/* drone_filter: a sampled PhyFilter. pf_filter.h says how it is used.
 *
 * F(s) = 8.177/(s + 8.177)
 *
 * x[3]        measured state, kg m/s
 * g[3]        known part of M x', N
 * f_theta[3]  learned model of f, N
 * f_hat[3]    estimate of f, N
 * channels: x, y, z
 *
 * dt = 0.002 s, method exact, g average, f_theta average, float64, a sample that is not finite: raise
 */
#ifndef PF_GENERATED_DRONE_FILTER_H
#define PF_GENERATED_DRONE_FILTER_H
#ifdef __cplusplus
extern "C" {
#endif

#define drone_filter_N_X 3
#define drone_filter_N_F 3
#define drone_filter_ORDER 1
#define drone_filter_FILTERS 1
#define drone_filter_FLOAT 0
#define drone_filter_METHOD 0
#define drone_filter_G_AVERAGE 1
#define drone_filter_F_THETA_AVERAGE 1
#define drone_filter_INERTIA 0
#define drone_filter_INERTIA_INPUT 0
#define drone_filter_DIRECTION 0
#define drone_filter_PAST 0
#define drone_filter_LIMIT 0
#define drone_filter_G_LIMIT 0
#define drone_filter_HOLD_BAD 0
#define drone_filter_PAIRS 0
#define drone_filter_LOWPASS 0
#define drone_filter_VARIABLE 1
#define drone_filter_TUNABLE 1
#define drone_filter_CONSTANT 0
#define PF_NAME drone_filter
#include "pf_filter.h"

extern const drone_filter_params drone_filter_parameters;

#ifdef __cplusplus
}
#endif
#endif
