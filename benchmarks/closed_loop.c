/* The closed loop of closed_loop.py as one would write it by hand: the limit for generated code.
 *
 * States: position, velocity, roll-pitch-yaw, rates, and two of each of three filters. RK4.
 */
#include <math.h>

#if defined(_WIN32)
#define SHOWN __declspec(dllexport)
#else
#define SHOWN __attribute__((visibility("default")))
#endif

enum { N_X = 18, N_Y = 6 };

/* Of one filter: z' = A z + b_x v + b_g g, f_hat = c z + d_x v. */
typedef struct {
  double A[2][2], b_x[2], b_g[2], c[2], d_x;
  double drag, kp, kd, k_angle, k_rate;
} parameters;

static void filters(const parameters *p, const double *x, double f_hat[3]) {
  for (int i = 0; i < 3; i++) {
    const double *z = x + 12 + 2 * i;
    f_hat[i] = p->c[0] * z[0] + p->c[1] * z[1] + p->d_x * x[3 + i];
  }
}

static void derivatives(const parameters *p, double t, const double *x, double *dx) {
  double f_hat[3], wanted[3], g[3], speed = 1e-6, relative[3];
  filters(p, x, f_hat);
  const double wind[3] = {2.0 + 1.5 * sin(1.1 * t), -1.0 + sin(1.9 * t), 0.5 * sin(2.9 * t)};
  const double goal[3] = {2.0 * cos(0.5 * t), 2.0 * sin(0.5 * t), 0.2 * t};
  const double goal_v[3] = {-sin(0.5 * t), cos(0.5 * t), 0.2};
  const double goal_a[3] = {-0.5 * cos(0.5 * t), -0.5 * sin(0.5 * t), 0.0};
  for (int i = 0; i < 3; i++) {
    wanted[i] = goal_a[i] + p->kp * (goal[i] - x[i]) + p->kd * (goal_v[i] - x[3 + i]) - f_hat[i];
    relative[i] = x[3 + i] - wind[i];
    speed += relative[i] * relative[i];
  }
  wanted[2] += 9.81;
  speed = sqrt(speed);
  const double roll = x[6], pitch = x[7], yaw = x[8];
  const double sr = sin(roll), cr = cos(roll), sp = sin(pitch), cp = cos(pitch), sy = sin(yaw), cy = cos(yaw);
  const double thrust = wanted[2] / (cr * cp);
  const double angle[3] = {-wanted[1] / 9.81, wanted[0] / 9.81, 0.0};
  g[0] = thrust * (cy * sp * cr + sy * sr);
  g[1] = thrust * (sy * sp * cr - cy * sr);
  g[2] = thrust * (cp * cr) - 9.81;
  for (int i = 0; i < 3; i++) {
    dx[i] = x[3 + i];
    dx[3 + i] = g[i] - p->drag * speed * relative[i];
    dx[9 + i] = p->k_angle * (angle[i] - x[6 + i]) - p->k_rate * x[9 + i];
    for (int j = 0; j < 2; j++) {
      const double *z = x + 12 + 2 * i;
      dx[12 + 2 * i + j] = p->A[j][0] * z[0] + p->A[j][1] * z[1] + p->b_x[j] * x[3 + i] + p->b_g[j] * g[i];
    }
  }
  const double tp = sp / cp;
  dx[6] = x[9] + tp * (sr * x[10] + cr * x[11]);
  dx[7] = cr * x[10] - sr * x[11];
  dx[8] = (sr * x[10] + cr * x[11]) / cp;
}

static void record(const parameters *p, const double *x, double *y) {
  for (int i = 0; i < 3; i++) y[i] = x[i];
  filters(p, x, y + 3);
}

/* y (n, 6); `substeps` equal steps between the times. */
SHOWN void run_by_hand(const parameters *p, int n, int substeps, const double *times, double *x, double *y) {
  double k[N_X], sum[N_X], trial[N_X];
  record(p, x, y);
  for (int row = 1; row < n; row++) {
    const double h = (times[row] - times[row - 1]) / substeps;
    for (int step = 0; step < substeps; step++) {
      const double t = times[row - 1] + step * h;
      derivatives(p, t, x, sum);
      for (int i = 0; i < N_X; i++) trial[i] = x[i] + h / 2.0 * sum[i];
      derivatives(p, t + h / 2.0, trial, k);
      for (int i = 0; i < N_X; i++) {
        sum[i] += 2.0 * k[i];
        trial[i] = x[i] + h / 2.0 * k[i];
      }
      derivatives(p, t + h / 2.0, trial, k);
      for (int i = 0; i < N_X; i++) {
        sum[i] += 2.0 * k[i];
        trial[i] = x[i] + h * k[i];
      }
      derivatives(p, t + h, trial, k);
      for (int i = 0; i < N_X; i++) x[i] += h / 6.0 * (sum[i] + k[i]);
    }
    record(p, x, y + N_Y * row);
  }
}
