// Estimates the unknown part f of M x' = g + f, three channels, from ~/x and ~/g; publishes ~/f_hat and diagnostics.
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <diagnostic_msgs/msg/diagnostic_array.hpp>
#include <geometry_msgs/msg/vector3_stamped.hpp>
#include <rclcpp/rclcpp.hpp>
#include <rclcpp_components/register_node_macro.hpp>

#include "@name@_guard.h"

namespace @name@_node
{

using geometry_msgs::msg::Vector3Stamped;

class Node : public rclcpp::Node
{
public:
  explicit Node(const rclcpp::NodeOptions & options) : rclcpp::Node("@name@", options)
  {
    const int code = @name@_guard_init(&guard_, &@name@_parameters);
    if (code) {
      throw std::runtime_error(pf_filter_message(code));
    }
    // What is declared may come back otherwise: from a launch file, or from YAML.
    const std::vector<double> real{@poles_real@}, imaginary{@poles_imag@};
    const auto real_now = declare_parameter("poles_real", real);
    const auto imaginary_now = declare_parameter("poles_imag", imaginary);
    bound(declare_parameter("plausible", 0.0));  // on the correction, in the unit of f; 0: none
    if (real_now != real || imaginary_now != imaginary) {
      if (const int refused = tune(real_now, imaginary_now)) {
        throw std::invalid_argument(reason(refused));
      }
    }
    on_set_ = add_on_set_parameters_callback(std::bind(&Node::on_set, this, std::placeholders::_1));
    const auto sensor = rclcpp::SensorDataQoS();
    f_hat_pub_ = create_publisher<Vector3Stamped>("~/f_hat", sensor);
    diagnostics_pub_ = create_publisher<diagnostic_msgs::msg::DiagnosticArray>("/diagnostics", 10);
    g_sub_ = create_subscription<Vector3Stamped>("~/g", sensor, [this](const Vector3Stamped & known) { g_ = known; });
    x_sub_ = create_subscription<Vector3Stamped>("~/x", sensor, [this](const Vector3Stamped & x) { step(x); });
    timer_ = create_wall_timer(std::chrono::seconds(1), [this] { diagnose(); });
  }

private:
  // All poles at once, or none: refused where one is not stable or a complex one lacks its conjugate.
  rcl_interfaces::msg::SetParametersResult on_set(const std::vector<rclcpp::Parameter> & parameters)
  {
    rcl_interfaces::msg::SetParametersResult result;
    std::vector<double> real = get_parameter("poles_real").as_double_array();
    std::vector<double> imaginary = get_parameter("poles_imag").as_double_array();
    double plausible = get_parameter("plausible").as_double();
    bool tuned = false;
    for (const auto & parameter : parameters) {
      if (parameter.get_name() == "poles_real") {
        real = parameter.as_double_array(), tuned = true;
      } else if (parameter.get_name() == "poles_imag") {
        imaginary = parameter.as_double_array(), tuned = true;
      } else if (parameter.get_name() == "plausible") {
        plausible = parameter.as_double();
      }
    }
    const int code = tuned ? tune(real, imaginary) : PF_FILTER_OK;
    result.successful = code == PF_FILTER_OK;
    if (code) {
      result.reason = reason(code);
    } else {
      bound(plausible);
    }
    return result;
  }

  static std::string reason(int code)
  {
    return code == PF_FILTER_INVALID ? "expected @order@ poles, once per sample" : pf_filter_message(code);
  }

  void bound(double plausible)
  {
    for (auto & entry : guard_.plausible) {
      entry = cast(plausible);
    }
  }

  int tune(const std::vector<double> & real, const std::vector<double> & imaginary)
  {
    @name@_tuning tuning{};
    double a0 = 1.0;
    if (real.size() != @order@ || imaginary.size() != @order@) {
      return PF_FILTER_INVALID;
    }
    for (std::size_t i = 0; i < real.size(); i++) {
      tuning.poles[0][i][0] = real[i];
      tuning.poles[0][i][1] = imaginary[i];
      if (imaginary[i] == 0.0) {
        a0 *= -real[i];
      } else if (imaginary[i] > 0.0) {  // with its conjugate
        a0 *= real[i] * real[i] + imaginary[i] * imaginary[i];
      }
    }
    tuning.b[0][0] = a0;  // gain 1 at rest
    @name@_guard_seal(&tuning);
    return @name@_guard_send(&guard_, &tuning);
  }

  void step(const Vector3Stamped & x)
  {
    const @name@_real measured[3] = {cast(x.vector.x), cast(x.vector.y), cast(x.vector.z)};
    const @name@_real known[3] = {cast(g_.vector.x), cast(g_.vector.y), cast(g_.vector.z)};
    const @name@_real f_theta[3] = {};  // a learned model goes here
    @name@_real f_hat[3];
    const rclcpp::Time stamp(x.header.stamp);
    health_ |= @name@_guard_step(
      &guard_, static_cast<uint64_t>(stamp.nanoseconds() / 1000), measured, known, f_theta, nullptr, f_hat);
    Vector3Stamped out;
    out.header = x.header;
    out.vector.x = f_hat[0];
    out.vector.y = f_hat[1];
    out.vector.z = f_hat[2];
    f_hat_pub_->publish(out);
  }

  void diagnose()
  {
    using diagnostic_msgs::msg::DiagnosticStatus;
    @name@_guard_check(&guard_);
    diagnostic_msgs::msg::DiagnosticArray array;
    DiagnosticStatus status;
    array.header.stamp = now();
    status.name = "@name@";
    status.level = health_ & PF_HEALTH_DAMAGED ? DiagnosticStatus::ERROR
                   : health_                   ? DiagnosticStatus::WARN
                                               : DiagnosticStatus::OK;
    status.message = health_ ? "flags of pf_guard.h: " + std::to_string(health_) : "ok";
    const std::pair<const char *, uint32_t> counts[] = {
      {"missed", guard_.missed}, {"not finite", guard_.bad}, {"time jumps", guard_.jumps},
      {"refused", guard_.refused}, {"implausible", guard_.implausible}};
    for (const auto & [key, count] : counts) {
      diagnostic_msgs::msg::KeyValue value;
      value.key = key;
      value.value = std::to_string(count);
      status.values.push_back(value);
    }
    array.status.push_back(status);
    diagnostics_pub_->publish(array);
    health_ = 0;
  }

  static @name@_real cast(double value) { return static_cast<@name@_real>(value); }

  @name@_guard guard_{};
  uint32_t health_{0};  // since the last diagnosis
  Vector3Stamped g_;
  rclcpp::Publisher<Vector3Stamped>::SharedPtr f_hat_pub_;
  rclcpp::Publisher<diagnostic_msgs::msg::DiagnosticArray>::SharedPtr diagnostics_pub_;
  rclcpp::Subscription<Vector3Stamped>::SharedPtr x_sub_, g_sub_;
  rclcpp::TimerBase::SharedPtr timer_;
  rclcpp::node_interfaces::OnSetParametersCallbackHandle::SharedPtr on_set_;
};

}  // namespace @name@_node

RCLCPP_COMPONENTS_REGISTER_NODE(@name@_node::Node)
