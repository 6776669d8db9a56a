// Runs the exported component; NODE comes from the test.
#include <cstdio>
#include "NODE"

using geometry_msgs::msg::Vector3Stamped;
template <typename T> static T &topic(rclcpp::Node &node, const char *name) {
  return *static_cast<T *>(node.topics.at(name).get());
}

int main() {
  wind_node::Node node{rclcpp::NodeOptions{}};
  rclcpp::Node &base = node;
  auto &x = topic<rclcpp::Subscription<Vector3Stamped>>(node, "~/x");
  auto &out = topic<rclcpp::Publisher<Vector3Stamped>>(node, "~/f_hat");
  auto &diagnostics = topic<rclcpp::Publisher<diagnostic_msgs::msg::DiagnosticArray>>(node, "/diagnostics");
  Vector3Stamped at;
  auto fly = [&](int from, int to) {
    for (int k = from; k < to; k++) {
      at.header.stamp = {1 + k / 500, static_cast<uint32_t>(k % 500) * 2000000u};
      at.vector.x = 1.0 * 0.002 * k, at.vector.z = -0.5 * 0.002 * k;
      x.callback(at);
    }
    node.timer->callback();
    std::printf("%zu %g %g %g %d\n", out.sent.size(), out.sent.back().vector.x, out.sent.back().vector.y,
                out.sent.back().vector.z, diagnostics.sent.back().status[0].level);
  };
  fly(0, 1000);
  auto bad = base.on_set({{"plausible", {1e-3}}, {"poles_real", {-12.0, 5.0, 5.0}}, {"poles_imag", {0.0, 1.0, -1.0}}});
  auto few = base.on_set({{"poles_real", {-12.0}}});
  auto good = base.on_set({{"poles_real", {-40.0, -30.0, -30.0}}, {"poles_imag", {0.0, 5.0, -5.0}}});
  std::printf("%d %d %d\n", bad.successful, few.successful, good.successful);
  fly(1000, 1500);
  fly(1505, 2000);
  /* Parameters of a launch file: those that are set at the start. */
  rclcpp::NodeOptions options;
  options.overrides = {{"poles_real", {-40.0, -30.0, -30.0}}, {"poles_imag", {0.0, 5.0, -5.0}}, {"plausible", {1e-3}}};
  wind_node::Node launched(options), set{rclcpp::NodeOptions{}};
  static_cast<rclcpp::Node &>(set).on_set({{"plausible", {2.0}}, {"poles_real", {-40.0, -30.0, -30.0}}, {"poles_imag", {0.0, 5.0, -5.0}}});
  static_cast<rclcpp::Node &>(launched).on_set({{"plausible", {2.0}}});
  for (int k = 0; k < 20; k++) {
    at.header.stamp = {1, static_cast<uint32_t>(k) * 2000000u};
    at.vector.x = 1.0 * 0.002 * k, at.vector.z = 0.0;
    for (auto *node : {&launched, &set}) topic<rclcpp::Subscription<Vector3Stamped>>(*node, "~/x").callback(at);
  }
  for (auto *node : {&launched, &set})
    std::printf("%.17g\n", topic<rclcpp::Publisher<Vector3Stamped>>(*node, "~/f_hat").sent.back().vector.x);
  options.overrides["plausible"] = {1e-3};
  wind_node::Node bounded(options);
  for (int k = 0; k < 20; k++) {
    at.header.stamp = {1, static_cast<uint32_t>(k) * 2000000u}, at.vector.x = 0.002 * k;
    topic<rclcpp::Subscription<Vector3Stamped>>(bounded, "~/x").callback(at);
  }
  static_cast<rclcpp::Node &>(bounded).timer->callback();
  auto &said = topic<rclcpp::Publisher<diagnostic_msgs::msg::DiagnosticArray>>(bounded, "/diagnostics");
  options.overrides["poles_real"] = {40.0, -30.0, -30.0};
  try {
    wind_node::Node unstable(options);
  } catch (const std::invalid_argument &error) {
    std::printf("%d\n", said.sent.back().status[0].level);
    return 0;
  }
  return 1;
}
