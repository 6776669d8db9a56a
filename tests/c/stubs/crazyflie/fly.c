/* Flies the exported app; what is in capitals comes from the test. */
#include <setjmp.h>
#include <stdlib.h>
#include <string.h>
#include "crazyflie_stub.h"

uint64_t stub_time = 5000000;
float stub_thrust = 65535.0f * 9.81f / 18.0f;
extern stub_entry stub_logs[], stub_params[];

static void *at(stub_entry *table, const char *name) {
  for (; table->name; table++)
    if (!strcmp(table->name, name)) return table->at;
  exit(2);
}

static jmp_buf out;
static int delays;
void vTaskDelay(uint32_t ticks) { /* appMain never ends: one round */
  (void)ticks;
  if (delays++ % 2) longjmp(out, 1);
}

int main(void) {
  state_t state = {{0, 0, 0}, ATTITUDE};
  control_t control = {0};
  control.thrust = stub_thrust;
  setpoint_t setpoint = {0};
  sensorData_t sensors = {0};
  const double body_z[3] = BODY_Z;
  const float h = 0.001f, *const fx = at(stub_logs, "fx"), *const fz = at(stub_logs, "fz");
  controllerOutOfTreeInit();
  if (!controllerOutOfTreeTest()) return 1;
  (void)at(stub_params, "p1i");
  for (uint32_t tick = 1; tick <= 3000; tick++) {
    stub_time += 1000;
    const double thrust = (double)control.thrust / 65535.0 * 18.0; /* along z of the body, and up is z */
    state.velocity.x += (float)(thrust * body_z[0] + 1.0) * h;
    state.velocity.y += (float)(thrust * body_z[1]) * h;
    state.velocity.z += (float)(thrust * body_z[2] - 9.81 - 0.5) * h;
    if (tick == 2500) *(uint8_t *)at(stub_params, "ff") = 1;
    controllerOutOfTree(&control, &setpoint, &sensors, &state, tick);
  }
  printf("%g %g %u %g\n", (double)*fx, (double)*fz, (unsigned)*(uint32_t *)at(stub_logs, "health"),
         (double)(control.thrust / stub_thrust));
  stub_thrust = 0.0f; /* landed, with the feed-forward on */
  for (uint32_t tick = 3001; tick <= 3004; tick++) controllerOutOfTree(&control, &setpoint, &sensors, &state, tick);
  printf("%g %g %u %g\n", (double)*fx, (double)*fz, (unsigned)*(uint32_t *)at(stub_logs, "health"),
         (double)control.thrust);
  *(float *)at(stub_params, "p0r") = *(float *)at(stub_params, "p1r") = -60.0f; /* other poles, on the ground */
  *(uint8_t *)at(stub_params, "set") = 1;
  if (!setjmp(out)) appMain();
  for (uint32_t tick = 3005; tick <= 3200; tick++) {
    stub_time += 1000;
    if (tick == 3011) stub_thrust = 65535.0f * 9.81f / 18.0f;
    state.velocity.x += (float)((double)control.thrust / 65535.0 * 18.0 * body_z[0] + 1.0) * h;
    controllerOutOfTree(&control, &setpoint, &sensors, &state, tick);
  }
  printf("%g 0 %u %u\n", (double)*fx, (unsigned)*(uint32_t *)at(stub_logs, "health"), *(uint8_t *)at(stub_params, "set"));
  return 0;
}
