/* The acceleration that thrust and gravity do not explain, beside the PID controller (world frame, m/s^2). */
#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#include "app.h"

#include "FreeRTOS.h"
#include "task.h"

#include "controller.h"
#include "controller_pid.h"
#include "log.h"
#include "param.h"
#include "stabilizer_types.h"
#include "usec_time.h"

#define DEBUG_MODULE "@NAME@"
#include "debug.h"

#include "@name@_guard.h"

#define RATE_HZ @rate@
#define GRAVITY 9.81f
#define FULL_THRUST 65535.0f

static @name@_guard guard;
static float f_hat[3];
static float t_max = 18.0f; /* thrust of all motors at full control per unit of mass, m/s^2 */
static uint8_t feed_forward;  /* 1: the vertical part is taken off the thrust */
static uint8_t set_poles;     /* set to 1: the poles below take over */
static uint32_t health;
static bool usable;
static volatile bool flying;
@crazyflie_poles@

static void tune(void) {
  @name@_tuning tuning = {0};
  double a0 = 1.0;
@crazyflie_tune@
  tuning.b[0][0] = a0;
  @name@_guard_seal(&tuning);
  const int code = @name@_guard_send(&guard, &tuning);
  if (code) DEBUG_PRINT("poles kept: %s\n", pf_filter_message(code));
  set_poles = code == PF_FILTER_INVALID; /* the one before waits for its step */
}

/* Thrust along the body's z and gravity in the world's frame, z up. */
static void known_acceleration(const state_t *state, float thrust, @name@_real *g) {
  const quaternion_t q = state->attitudeQuaternion;
  const float specific = thrust / FULL_THRUST * t_max;
  g[0] = specific * 2.0f * (q.x * q.z + q.w * q.y);
  g[1] = specific * 2.0f * (q.y * q.z - q.w * q.x);
  g[2] = specific * (1.0f - 2.0f * (q.x * q.x + q.y * q.y)) - GRAVITY;
}

void appMain(void) {
  while (1) {
    vTaskDelay(M2T(1000));
    if (usable && set_poles && !flying) tune();
    if (health) DEBUG_PRINT("health %u\n", (unsigned)health);
  }
}

void controllerOutOfTreeInit(void) {
  const int code = @name@_guard_init(&guard, &@name@_parameters);
  usable = code == 0;
  if (code) DEBUG_PRINT("%s\n", pf_filter_message(code));
  controllerPidInit();
}

bool controllerOutOfTreeTest(void) { return usable && controllerPidTest(); }

void controllerOutOfTree(control_t *control, const setpoint_t *setpoint, const sensorData_t *sensors,
                         const state_t *state, const uint32_t tick) {
  static float thrust; /* commanded since the last step */
  static uint32_t steps;
  if (usable && RATE_DO_EXECUTE(RATE_HZ, tick)) {
    const @name@_real x[3] = {state->velocity.x, state->velocity.y, state->velocity.z};
    const @name@_real f_theta[3] = {0, 0, 0}; /* a learned model goes here */
    @name@_real g[3], out[3];
    known_acceleration(state, thrust, g);
    flying = thrust > 0.0f;
    if (flying) {
      health = @name@_guard_step(&guard, usecTimestamp(), x, g, f_theta, NULL, out);
      for (int i = 0; i < 3; i++) f_hat[i] = (float)out[i];
      if (++steps % RATE_HZ == 0u) @name@_guard_check(&guard);
    } else { /* on the ground its force is not one to learn, nor the last one to apply */
      /* Other poles take some milliseconds of this core, which has no double precision: now. */
      if (guard.sent != guard.seen) (void)@name@_guard_step(&guard, usecTimestamp(), x, g, f_theta, NULL, out);
      @name@_reset(&guard.filter);
      guard.running = 0u;
      health = PF_HEALTH_OK;
      for (int i = 0; i < 3; i++) f_hat[i] = 0.0f;
    }
  }
  controllerPid(control, setpoint, sensors, state, tick);
  if (feed_forward && control->thrust > 0.0f) control->thrust -= f_hat[2] / t_max * FULL_THRUST;
  if (control->thrust < 0.0f) control->thrust = 0.0f;
  if (control->thrust > FULL_THRUST) control->thrust = FULL_THRUST;
  thrust = control->thrust;
}

LOG_GROUP_START(@short@)
LOG_ADD(LOG_FLOAT, fx, &f_hat[0])
LOG_ADD(LOG_FLOAT, fy, &f_hat[1])
LOG_ADD(LOG_FLOAT, fz, &f_hat[2])
LOG_ADD(LOG_UINT32, health, &health)
LOG_GROUP_STOP(@short@)

PARAM_GROUP_START(@short@)
PARAM_ADD(PARAM_FLOAT, tMax, &t_max)
PARAM_ADD(PARAM_UINT8, ff, &feed_forward)
PARAM_ADD(PARAM_UINT8, set, &set_poles)
@crazyflie_params@
PARAM_GROUP_STOP(@short@)
