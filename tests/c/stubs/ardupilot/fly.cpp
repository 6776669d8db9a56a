/* Flies the exported backend; POLE comes from the test. */
#include <cmath>
#define private public /* parameters by hand */
#include "AC_CustomControl_Wind.h"
#undef private

int main() {
  AC_CustomControl frontend;
  AP_AHRS_View view, *ahrs = &view;
  AC_AttitudeControl attitude, *control = &attitude;
  AP_MotorsMulticopter all, *motors = &all;
  AC_CustomControl_Wind backend(frontend, ahrs, control, motors, 0.0025f);
  const float push[3] = {3.0f, 0.0f, -2.0f}, b[3] = {100.0f, 100.0f, 20.0f}, h = 0.0025f;
  float rate[3] = {0, 0, 0};
  Vector3f out;
  double off = 0.0;
  backend._share.value = 1.0f;
  for (int k = 0; k < 4000; k++) { /* rate damping by the main controller, and a steady push on roll and yaw */
    AP_HAL::stub_time += 2500;
    if (k == 2000) backend._p0r.value = POLE;
    view.gyro = Vector3f(rate[0], rate[1], rate[2]);
    all.out = Vector3f(-0.1f * rate[0], -0.1f * rate[1], -0.2f * rate[2]);
    if (k > 600 && k < 1200) /* the main controller's feed-forward moves: known, no push */
      all.feed_forward = Vector3f(k / 100 % 2 ? 0.1f : -0.1f, 0.0f, 0.05f);
    else
      all.feed_forward.zero();
    out = backend.update();
    for (int i = 0; k > 500 && k < 1300 && i < 3; i++)
      off = std::fmax(off, std::fabs(AP::stub_logger.last[i] - (double)push[i]));
    const float used[3] = {out.x + all.feed_forward.x, out.y, out.z + all.feed_forward.z};
    for (int i = 0; i < 3; i++) rate[i] += h * (b[i] * used[i] + push[i]);
    if (k == 1999 || k == 3999)
      std::printf("%d %g %g %g %g %u\n", k, (double)(b[0] * out.x), (double)(b[2] * out.z), (double)rate[0],
                  (double)rate[2], (unsigned)backend._guard.health);
  }
  all.spool = AP_Motors::SpoolState::GROUND_IDLE;
  all.out = Vector3f();
  AP_HAL::stub_time += 2500;
  out = backend.update();
  std::printf("%d %g %g 0 0 %u\n", 4000, (double)out.x, (double)out.z, AP::stub_logger.lines);
  std::printf("%g\n", off);
  return 0;
}
