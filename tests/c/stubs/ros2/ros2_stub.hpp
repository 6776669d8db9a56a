// What the exported component uses of ROS 2, for a build on the host. Messages go straight to who asks for them.
#pragma once
#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace builtin { struct Time { int32_t sec{0}; uint32_t nanosec{0}; }; struct Header { Time stamp; std::string frame_id; }; }
namespace geometry_msgs::msg {
struct Vector3 { double x{0}, y{0}, z{0}; };
struct Vector3Stamped { builtin::Header header; Vector3 vector; };
}
namespace diagnostic_msgs::msg {
struct KeyValue { std::string key, value; };
struct DiagnosticStatus {
  static constexpr unsigned char OK = 0, WARN = 1, ERROR = 2;
  unsigned char level{0};
  std::string name, message;
  std::vector<KeyValue> values;
};
struct DiagnosticArray { builtin::Header header; std::vector<DiagnosticStatus> status; };
}
namespace rcl_interfaces::msg { struct SetParametersResult { bool successful{false}; std::string reason; }; }

namespace rclcpp {
struct NodeOptions { std::map<std::string, std::vector<double>> overrides; };
struct SensorDataQoS { SensorDataQoS() = default; };
struct QoS { QoS(SensorDataQoS) {} QoS(int) {} };
struct Time {
  builtin::Time stamp;
  explicit Time(builtin::Time from) : stamp(from) {}
  int64_t nanoseconds() const { return 1000000000LL * stamp.sec + stamp.nanosec; }
  operator builtin::Time() const { return stamp; }
};
struct Parameter {
  std::string name;
  std::vector<double> values;
  const std::string &get_name() const { return name; }
  std::vector<double> as_double_array() const { return values; }
  double as_double() const { return values.at(0); }
};
template <typename T> struct Publisher {
  using SharedPtr = std::shared_ptr<Publisher>;
  std::vector<T> sent;
  void publish(const T &message) { sent.push_back(message); }
};
template <typename T> struct Subscription {
  using SharedPtr = std::shared_ptr<Subscription>;
  std::function<void(const T &)> callback;
};
struct TimerBase { using SharedPtr = std::shared_ptr<TimerBase>; std::function<void()> callback; };
namespace node_interfaces { struct OnSetParametersCallbackHandle { using SharedPtr = std::shared_ptr<OnSetParametersCallbackHandle>; }; }
struct Node {
  std::map<std::string, Parameter> parameters;
  std::map<std::string, std::shared_ptr<void>> topics;
  std::shared_ptr<TimerBase> timer;
  std::function<rcl_interfaces::msg::SetParametersResult(const std::vector<Parameter> &)> on_set;
  std::map<std::string, std::vector<double>> overrides;
  Node(const std::string &, const NodeOptions &options) : overrides(options.overrides) {}
  virtual ~Node() = default;
  std::vector<double> declare_parameter(const std::string &name, const std::vector<double> &values) {
    parameters[name] = {name, overrides.count(name) ? overrides.at(name) : values};
    return parameters[name].values;
  }
  double declare_parameter(const std::string &name, double value) { return declare_parameter(name, std::vector<double>{value})[0]; }
  Parameter get_parameter(const std::string &name) const { return parameters.at(name); }
  template <typename F> node_interfaces::OnSetParametersCallbackHandle::SharedPtr add_on_set_parameters_callback(F f) { on_set = f; return nullptr; }
  template <typename T> typename Publisher<T>::SharedPtr create_publisher(const std::string &name, QoS) {
    auto made = std::make_shared<Publisher<T>>();
    topics[name] = made;
    return made;
  }
  template <typename T, typename F> typename Subscription<T>::SharedPtr create_subscription(const std::string &name, QoS, F f) {
    auto made = std::make_shared<Subscription<T>>();
    made->callback = f;
    topics[name] = made;
    return made;
  }
  template <typename D, typename F> TimerBase::SharedPtr create_wall_timer(D, F f) {
    timer = std::make_shared<TimerBase>();
    timer->callback = f;
    return timer;
  }
  Time now() const { return Time(builtin::Time{}); }
};
}
#define RCLCPP_COMPONENTS_REGISTER_NODE(type)
