#pragma once

#include <lib/mathlib/mathlib.h>
#include <px4_platform_common/module.h>
#include <px4_platform_common/module_params.h>
#include <px4_platform_common/px4_work_queue/ScheduledWorkItem.hpp>
#include <uORB/Publication.hpp>
#include <uORB/Subscription.hpp>
#include <uORB/SubscriptionCallback.hpp>
#include <uORB/SubscriptionInterval.hpp>
#include <uORB/topics/actuator_motors.h>
#include <uORB/topics/debug_vect.h>
#include <uORB/topics/parameter_update.h>
#include <uORB/topics/@name@_estimate.h>
#include <uORB/topics/vehicle_attitude.h>
#include <uORB/topics/vehicle_land_detected.h>
#include <uORB/topics/vehicle_local_position.h>

#include "@name@_guard.h"

class @Name@ : public ModuleBase<@Name@>, public ModuleParams, public px4::ScheduledWorkItem
{
public:
	@Name@();
	~@Name@() override;

	static int task_spawn(int argc, char *argv[]);
	static int custom_command(int argc, char *argv[]);
	static int print_usage(const char *reason = nullptr);
	int print_status() override;

	bool init();

private:
	void Run() override;
	void tune();
	bool known_acceleration(float g[3]);
	void undo_resets(const vehicle_local_position_s &position);
	void publish(const vehicle_local_position_s &position, const float f_hat[3], uint32_t health);

	uORB::SubscriptionCallbackWorkItem _position_sub{this, ORB_ID(vehicle_local_position)};
	uORB::Subscription _attitude_sub{ORB_ID(vehicle_attitude)};
	uORB::Subscription _motors_sub{ORB_ID(actuator_motors)};
	uORB::Subscription _landed_sub{ORB_ID(vehicle_land_detected)};
	uORB::SubscriptionInterval _parameter_update_sub{ORB_ID(parameter_update), 1000000};
	uORB::Publication<debug_vect_s> _debug_pub{ORB_ID(debug_vect)};
	uORB::Publication<@name@_estimate_s> _estimate_pub{ORB_ID(@name@_estimate)};

	@name@_guard _guard{};
	uint8_t _xy_resets{0};
	uint8_t _z_resets{0};
	unsigned _steps{0};
	bool _flying{false};
	bool _tune{true};

	DEFINE_PARAMETERS(
@px4_members@
		(ParamFloat<px4::params::@PREFIX@_T_MAX>) _t_max,
		(ParamBool<px4::params::@PREFIX@_FF_EN>) _ff_en
	)
};
