/* What the exported app uses of the Crazyflie's firmware, for a build on the host. */
#pragma once
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>

typedef struct { float x, y, z; } velocity_t;
typedef struct { float x, y, z, w; } quaternion_t;
typedef struct { velocity_t velocity; quaternion_t attitudeQuaternion; } state_t;
typedef struct { float thrust; } control_t;
typedef struct { int unused; } setpoint_t, sensorData_t;

extern uint64_t stub_time;
extern float stub_thrust;
static inline uint64_t usecTimestamp(void) { return stub_time; }
void vTaskDelay(uint32_t ticks);
#define M2T(milliseconds) (milliseconds)
#define RATE_DO_EXECUTE(rate, tick) ((tick) % (1000 / (rate)) == 0)
#define DEBUG_PRINT(...) printf(__VA_ARGS__)
static inline void controllerPidInit(void) {}
static inline bool controllerPidTest(void) { return true; }
static inline void controllerPid(control_t *control, const setpoint_t *setpoint, const sensorData_t *sensors,
                                 const state_t *state, const uint32_t tick) {
  (void)setpoint, (void)sensors, (void)state, (void)tick;
  control->thrust = stub_thrust;
}
void appMain(void);
void controllerOutOfTreeInit(void);
bool controllerOutOfTreeTest(void);
void controllerOutOfTree(control_t *control, const setpoint_t *setpoint, const sensorData_t *sensors,
                         const state_t *state, const uint32_t tick);

/* Groups become tables of names and addresses. */
typedef struct { const char *name; void *at; } stub_entry;
enum { LOG_FLOAT, LOG_UINT32, PARAM_FLOAT, PARAM_UINT8 };
#define LOG_GROUP_START(group) stub_entry stub_logs[] = {
#define LOG_ADD(type, name, at) {#name, (void *)(at)},
#define LOG_GROUP_STOP(group) {0, 0}};
#define PARAM_GROUP_START(group) stub_entry stub_params[] = {
#define PARAM_ADD(type, name, at) {#name, (void *)(at)},
#define PARAM_GROUP_STOP(group) {0, 0}};
