/* What the exported module uses of PX4, for a build on the host. Topics are variables; the work queue is a call. */
#pragma once
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>

using hrt_abstime = uint64_t;
inline hrt_abstime stub_now = 0;
inline hrt_abstime hrt_absolute_time() { return stub_now; }
#define PX4_ISFINITE(x) std::isfinite(x)
#define PX4_OK 0
#define PX4_ERROR (-1)
#define PX4_ERR(...) (std::printf(__VA_ARGS__), std::printf("\n"))
#define PX4_WARN(...) (std::printf(__VA_ARGS__), std::printf("\n"))
#define PX4_INFO(...) (std::printf(__VA_ARGS__), std::printf("\n"))
#define PRINT_MODULE_DESCRIPTION(text) std::puts(text)
#define PRINT_MODULE_USAGE_NAME(name, group) std::puts(name)
#define PRINT_MODULE_USAGE_COMMAND(name) std::puts(name)
#define PRINT_MODULE_USAGE_DEFAULT_COMMANDS() std::puts("stop status")
#define __EXPORT

struct actuator_motors_s { uint64_t timestamp; float control[12]; };
struct debug_vect_s { uint64_t timestamp; char name[10]; float x, y, z; };
struct parameter_update_s { uint64_t timestamp; };
struct vehicle_attitude_s { uint64_t timestamp; float q[4]; };
struct vehicle_land_detected_s { uint64_t timestamp; bool landed; };
struct vehicle_local_position_s {
  uint64_t timestamp, timestamp_sample;
  bool v_xy_valid, v_z_valid;
  float vx, vy, vz, delta_vxy[2], delta_vz;
  uint8_t vxy_reset_counter, vz_reset_counter;
};
struct wind_estimate_s {
  uint64_t timestamp, timestamp_sample;
  float force[3], feed_forward[3];
  uint32_t health, missed, bad, jumps, refused;
};

template <typename T> struct Topic { T value{}; unsigned generation{0}; bool ever{false}; };
#define STUB_TOPIC(name) inline Topic<name##_s> stub_##name;
STUB_TOPIC(actuator_motors)
STUB_TOPIC(debug_vect)
STUB_TOPIC(parameter_update)
STUB_TOPIC(vehicle_attitude)
STUB_TOPIC(vehicle_land_detected)
STUB_TOPIC(vehicle_local_position)
STUB_TOPIC(wind_estimate)
template <typename T> void stub_publish(Topic<T> &topic, const T &value) { topic.value = value; topic.generation++; topic.ever = true; }
#define ORB_ID(name) (&stub_##name)

namespace px4 {
namespace wq_configurations { constexpr int nav_and_controllers = 0; }
struct ScheduledWorkItem {
  ScheduledWorkItem(const char *, int) {}
  virtual ~ScheduledWorkItem() = default;
  virtual void Run() = 0;
};
namespace params {
#include "stub_parameters.hpp" /* the test writes it from module.yaml */
}
}

namespace uORB {
struct Subscription {
  void *topic; bool (*copy_)(void *, void *, unsigned &, bool);
  unsigned seen{0};
  template <typename T> Subscription(Topic<T> *from) : topic(from), copy_([](void *t, void *to, unsigned &seen, bool fresh) {
    auto *const source = static_cast<Topic<T> *>(t);
    const bool is = source->ever && (!fresh || source->generation != seen);
    if (to && is) { *static_cast<T *>(to) = source->value; seen = source->generation; }
    return is; }) {}
  bool copy(void *to) { return copy_(topic, to, seen, false); }
  bool update(void *to) { return copy_(topic, to, seen, true); }
  bool updated() { return copy_(topic, nullptr, seen, true); }
};
struct SubscriptionInterval : Subscription { template <typename T> SubscriptionInterval(Topic<T> *from, unsigned) : Subscription(from) {} };
struct SubscriptionCallbackWorkItem : Subscription {
  template <typename T> SubscriptionCallbackWorkItem(px4::ScheduledWorkItem *, Topic<T> *from) : Subscription(from) {}
  bool registerCallback() { return true; }
  void unregisterCallback() {}
};
template <typename T> struct Publication { Topic<T> *to; Publication(Topic<T> *topic) : to(topic) {} bool publish(const T &value) { stub_publish(*to, value); return true; } };
}

struct ModuleParams { ModuleParams(ModuleParams *) {} virtual ~ModuleParams() = default; void updateParams() {} };
template <typename P> struct ParamFloat { float get() const { return P::value; } };
template <typename P> struct ParamBool { bool get() const { return P::value; } };

#define STUB_TYPE(...) __VA_ARGS__
#define STUB_1(x) STUB_TYPE x;
#define STUB_2(x, ...) STUB_TYPE x; STUB_1(__VA_ARGS__)
#define STUB_3(x, ...) STUB_TYPE x; STUB_2(__VA_ARGS__)
#define STUB_4(x, ...) STUB_TYPE x; STUB_3(__VA_ARGS__)
#define STUB_5(x, ...) STUB_TYPE x; STUB_4(__VA_ARGS__)
#define STUB_6(x, ...) STUB_TYPE x; STUB_5(__VA_ARGS__)
#define STUB_7(x, ...) STUB_TYPE x; STUB_6(__VA_ARGS__)
#define STUB_8(x, ...) STUB_TYPE x; STUB_7(__VA_ARGS__)
#define STUB_9(x, ...) STUB_TYPE x; STUB_8(__VA_ARGS__)
#define STUB_10(x, ...) STUB_TYPE x; STUB_9(__VA_ARGS__)
#define STUB_11(x, ...) STUB_TYPE x; STUB_10(__VA_ARGS__)
#define STUB_12(x, ...) STUB_TYPE x; STUB_11(__VA_ARGS__)
#define STUB_13(x, ...) STUB_TYPE x; STUB_12(__VA_ARGS__)
#define STUB_14(x, ...) STUB_TYPE x; STUB_13(__VA_ARGS__)
#define STUB_15(x, ...) STUB_TYPE x; STUB_14(__VA_ARGS__)
#define STUB_16(x, ...) STUB_TYPE x; STUB_15(__VA_ARGS__)
#define STUB_PICK(_1, _2, _3, _4, _5, _6, _7, _8, _9, _10, _11, _12, _13, _14, _15, _16, name, ...) name
#define DEFINE_PARAMETERS(...) STUB_PICK(__VA_ARGS__, STUB_16, STUB_15, STUB_14, STUB_13, STUB_12, STUB_11, STUB_10, STUB_9, STUB_8, STUB_7, STUB_6, STUB_5, STUB_4, STUB_3, STUB_2, STUB_1, 0)(__VA_ARGS__)

template <typename T> struct StubPointer {
  T *value{nullptr};
  void store(T *to) { value = to; }
  T *load() { return value; }
};

template <typename T> struct ModuleBase {
  static inline StubPointer<T> _object;
  static inline int _task_id{-1};
  static constexpr int task_id_is_work_queue{-2};
  virtual ~ModuleBase() = default;
  virtual int print_status() = 0;
  bool should_exit() const { return false; }
  void exit_and_cleanup() {}
  static int main(int argc, char *argv[]) {
    if (argc > 1 && !std::strcmp(argv[1], "start")) return T::task_spawn(argc, argv);
    if (argc > 1 && !std::strcmp(argv[1], "status")) return _object.load() ? _object.load()->print_status() : 1;
    return T::custom_command(argc, argv);
  }
};
