/* Flies the exported module; what is in capitals comes from the test. */
#define private public /* to run the work item by hand */
#include "Wind.hpp"
#undef private

extern "C" int wind_main(int argc, char *argv[]);

int main() {
  char name[] = "wind", start[] = "start", status[] = "status";
  char *starts[] = {name, start}, *asks[] = {name, status};
  const double h = 0.004, t_max = 5.0, g = 9.80665;
  float v[3] = {0, 0, 0};
  vehicle_attitude_s tilted{0, ATTITUDE};
  actuator_motors_s motors{};
  vehicle_local_position_s at{};
  for (float &control : motors.control) control = NAN;
  const double shares[4] = {0.2, 0.3, 0.4, 0.1}, body_z[3] = BODY_Z, thrust = 1.1 * g;
  for (int i = 0; i < 4; i++) motors.control[i + 1] = (float)(shares[i] * thrust / t_max); /* no motor 1 */
  stub_publish(stub_actuator_motors, motors);
  stub_publish(stub_vehicle_attitude, tilted);
  px4::params::WIND_FF_EN::value = true;
  stub_publish(stub_vehicle_land_detected, vehicle_land_detected_s{0, false});
  if (wind_main(2, starts)) return 1;
  Wind *const module = Wind::_object.load();
  at.v_xy_valid = at.v_z_valid = true;
  for (int k = 0; k <= 1000; k++) { /* z is down, thrust along -z of the body, a wind pushes with (1, 0, -0.5) */
    v[0] += (float)((1.0 - thrust * body_z[0]) * h);
    v[1] += (float)((0.0 - thrust * body_z[1]) * h);
    v[2] += (float)((-0.5 - thrust * body_z[2] + g) * h);
    if (k == 1000) stub_publish(stub_vehicle_land_detected, vehicle_land_detected_s{0, true});
    if (k == 500) { /* the estimator resets its velocity: no force */
      v[0] += 3.f;
      at.delta_vxy[0] = 3.f;
      at.vxy_reset_counter++;
    }
    if (k == 700) {
      px4::params::WIND_P0R::value = POLE;
      stub_publish(stub_parameter_update, parameter_update_s{});
    }
    if (k != 600 && k != 601) { /* two samples are lost */
      at.timestamp_sample = 1000000u + (uint64_t)(k * 1e6 * h + 0.5);
      at.vx = v[0], at.vy = v[1], at.vz = v[2];
      stub_publish(stub_vehicle_local_position, at);
      module->Run();
    }
    if (k == 499 || k == 500 || k == 602 || k == 700 || k >= 999) {
      const auto &out = stub_wind_estimate.value;
      std::printf("%d %g %g %g %u %g\n", k, (double)out.force[0], (double)out.force[1], (double)out.force[2],
                  (unsigned)out.health, (double)out.feed_forward[0]);
    }
  }
  return wind_main(2, asks) || std::strcmp(stub_debug_vect.value.name, "wind") != 0;
}
