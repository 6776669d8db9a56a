/* What the exported backend uses of ArduPilot, for a build on the host. */
#pragma once
#include <cstdarg>
#include <cstdint>
#include <cstdio>

#define AP_CUSTOMCONTROL_ENABLED 1
#define GCS_SEND_TEXT(severity, ...) (std::printf(__VA_ARGS__), std::printf("\n"))

struct Vector3f {
  float x{0}, y{0}, z{0};
  Vector3f() = default;
  Vector3f(float a, float b, float c) : x(a), y(b), z(c) {}
  void zero() { x = y = z = 0; }
  Vector3f operator+(const Vector3f &other) const { return Vector3f(x + other.x, y + other.y, z + other.z); }
};
static inline float constrain_float(float value, float low, float high) { return value < low ? low : value > high ? high : value; }

struct AP_Float {
  float value{0};
  float get() const { return value; }
};
struct AP_Param {
  struct GroupInfo { const char *name; AP_Float *(*at)(void *); float start; };
  static void setup_object_defaults(void *self, const GroupInfo *info) {
    for (; info->name; info++) info->at(self)->value = info->start;
  }
};
#define AP_GROUPINFO(name, index, type, member, start) {name, [](void *self) { return &static_cast<type *>(self)->member; }, start}
#define AP_GROUPEND {nullptr, nullptr, 0.0f}

namespace AP_HAL { inline uint64_t stub_time = 1000000; inline uint64_t micros64() { return stub_time; } }
namespace AP {
struct Logger {
  unsigned lines{0};
  double last[3]{0, 0, 0};
  void Write(const char *, const char *, const char *, ...); /* the format must be QfffI */
};
inline void Logger::Write(const char *, const char *, const char *format, ...) {
  va_list arguments;
  va_start(arguments, format);
  (void)va_arg(arguments, uint64_t);
  for (double &value : last) value = va_arg(arguments, double);
  va_end(arguments);
  lines++;
}
inline Logger stub_logger;
inline Logger &logger() { return stub_logger; }
}
struct AP_Motors { enum class SpoolState { SHUT_DOWN, GROUND_IDLE, SPOOLING_UP, THROTTLE_UNLIMITED, SPOOLING_DOWN }; };
struct AP_MotorsMulticopter : AP_Motors {
  Vector3f out, feed_forward;
  SpoolState spool{SpoolState::THROTTLE_UNLIMITED};
  float get_roll() const { return out.x; }
  float get_pitch() const { return out.y; }
  float get_yaw() const { return out.z; }
  float get_roll_ff() const { return feed_forward.x; }
  float get_pitch_ff() const { return feed_forward.y; }
  float get_yaw_ff() const { return feed_forward.z; }
  SpoolState get_spool_state() const { return spool; }
};
struct AP_AHRS_View { Vector3f gyro; Vector3f get_gyro_latest() const { return gyro; } };
struct AC_AttitudeControl {};
struct AC_CustomControl {};
class AC_CustomControl_Backend {
public:
  AC_CustomControl_Backend(AC_CustomControl &frontend, AP_AHRS_View *&ahrs, AC_AttitudeControl *&control, AP_MotorsMulticopter *&motors, float)
      : _ahrs(ahrs), _att_control(control), _motors(motors), _frontend(frontend) {}
  virtual ~AC_CustomControl_Backend() = default;
  virtual Vector3f update() = 0;
  virtual void reset() = 0;

protected:
  AP_AHRS_View *&_ahrs;
  AC_AttitudeControl *&_att_control;
  AP_MotorsMulticopter *&_motors;
  AC_CustomControl &_frontend;
};
