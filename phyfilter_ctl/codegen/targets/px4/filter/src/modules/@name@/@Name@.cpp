/* The acceleration that thrust and gravity do not explain, from velocity, attitude and motor controls (NED, m/s^2). The
 * controls are normalised thrusts, of motors that all push along the body's -z. */
#include "@Name@.hpp"

#include <cstring>

@Name@::@Name@() : ModuleParams(nullptr), ScheduledWorkItem("@name@", px4::wq_configurations::nav_and_controllers) {}

@Name@::~@Name@() { _position_sub.unregisterCallback(); }

bool @Name@::init()
{
	const int code = @name@_guard_init(&_guard, &@name@_parameters);

	if (code) {
		PX4_ERR("%s", pf_filter_message(code));
		return false;
	}

	return _position_sub.registerCallback();
}

/* Poles from the parameters; a low-pass filter stays one, of gain 1 at rest. */
void @Name@::tune()
{
	@name@_tuning tuning{};
	double a0 = 1.0;
@px4_tune@
	tuning.b[0][0] = a0;
	@name@_guard_seal(&tuning);
	const int code = @name@_guard_send(&_guard, &tuning);
	_tune = code == PF_FILTER_INVALID; /* the one before waits for its step: again at the next */

	if (code && !_tune) {
		PX4_WARN("poles kept: %s", pf_filter_message(code));
	}
}

/* Thrust along the body's z and gravity, in NED. */
bool @Name@::known_acceleration(float g[3])
{
	actuator_motors_s motors;
	vehicle_attitude_s attitude;

	if (!_motors_sub.copy(&motors) || !_attitude_sub.copy(&attitude)) {
		return false;
	}

	float thrust = 0.f;

	for (const float control : motors.control) {
		if (PX4_ISFINITE(control)) { /* else the motor is stopped, or there is none */
			thrust += _t_max.get() * control;
		}
	}

	const float w = attitude.q[0], x = attitude.q[1], y = attitude.q[2], z = attitude.q[3];
	g[0] = -thrust * 2.f * (x * z + w * y);
	g[1] = -thrust * 2.f * (y * z - w * x);
	g[2] = -thrust * (1.f - 2.f * (x * x + y * y)) + 9.80665f;
	return true;
}

/* A jump of the estimated velocity is a reset of the estimator, not a force. */
void @Name@::undo_resets(const vehicle_local_position_s &position)
{
	@name@_real jump[3] = {};

	if (position.vxy_reset_counter != _xy_resets) {
		jump[0] = position.delta_vxy[0];
		jump[1] = position.delta_vxy[1];
	}

	if (position.vz_reset_counter != _z_resets) {
		jump[2] = position.delta_vz;
	}

	_xy_resets = position.vxy_reset_counter;
	_z_resets = position.vz_reset_counter;
	(void)@name@_shift_x(&_guard.filter, jump);
}

void @Name@::Run()
{
	if (should_exit()) {
		_position_sub.unregisterCallback();
		exit_and_cleanup();
		return;
	}

	if (_parameter_update_sub.updated()) {
		parameter_update_s update;
		_parameter_update_sub.copy(&update);
		updateParams();
		_tune = true;
	}

	if (_tune) {
		tune();
	}

	vehicle_local_position_s position;
	vehicle_land_detected_s landed{};
	float g[3];

	if (!_position_sub.update(&position) || !position.v_xy_valid || !position.v_z_valid || !known_acceleration(g)) {
		return;
	}

	undo_resets(position);

	if (_landed_sub.copy(&landed) && landed.landed) { /* the ground's force is not one to learn, nor the last one to apply */
		const float none[3] = {};
		_flying = false;
		publish(position, none, PF_HEALTH_OK);
		return;
	}

	if (!_flying) {
		@name@_reset(&_guard.filter);
		_guard.running = 0;
		_flying = true;
	}

	const @name@_real x[3] = {position.vx, position.vy, position.vz};
	const @name@_real known[3] = {g[0], g[1], g[2]};
	const @name@_real f_theta[3] = {}; /* a learned model goes here */
	@name@_real f_hat[3];
	const uint32_t health =
		@name@_guard_step(&_guard, position.timestamp_sample, x, known, f_theta, nullptr, f_hat);

	if (++_steps % 500 == 0) {
		@name@_guard_check(&_guard);
	}

	const float out[3] = {(float)f_hat[0], (float)f_hat[1], (float)f_hat[2]};
	publish(position, out, health);
}

void @Name@::publish(const vehicle_local_position_s &position, const float f_hat[3], uint32_t health)
{
	debug_vect_s debug{};
	@name@_estimate_s estimate{};
	std::strncpy(debug.name, "@short@", sizeof(debug.name) - 1);
	debug.x = f_hat[0];
	debug.y = f_hat[1];
	debug.z = f_hat[2];
	debug.timestamp = estimate.timestamp = hrt_absolute_time();
	estimate.timestamp_sample = position.timestamp_sample;

	for (int i = 0; i < 3; i++) {
		estimate.force[i] = f_hat[i];
		estimate.feed_forward[i] = _ff_en.get() ? -f_hat[i] : 0.f;
	}

	estimate.health = health;
	estimate.missed = _guard.missed;
	estimate.bad = _guard.bad;
	estimate.jumps = _guard.jumps;
	estimate.refused = _guard.refused;
	_debug_pub.publish(debug);
	_estimate_pub.publish(estimate);
}

int @Name@::task_spawn(int argc, char *argv[])
{
	(void)argc;
	(void)argv;
	@Name@ *const instance = new @Name@();

	if (instance != nullptr) {
		_object.store(instance);
		_task_id = task_id_is_work_queue;

		if (instance->init()) {
			return PX4_OK;
		}
	}

	delete instance;
	_object.store(nullptr);
	_task_id = -1;
	return PX4_ERROR;
}

int @Name@::print_status()
{
	PX4_INFO("health %u, missed %u, bad %u, time jumps %u, refused %u", (unsigned)_guard.health,
		 (unsigned)_guard.missed, (unsigned)_guard.bad, (unsigned)_guard.jumps, (unsigned)_guard.refused);
	return 0;
}

int @Name@::custom_command(int argc, char *argv[])
{
	(void)argc;
	(void)argv;
	return print_usage("unknown command");
}

int @Name@::print_usage(const char *reason)
{
	if (reason != nullptr) {
		PX4_WARN("%s", reason);
	}

	PRINT_MODULE_DESCRIPTION("Estimates the acceleration that thrust and gravity do not explain.");
	PRINT_MODULE_USAGE_NAME("@name@", "estimator");
	PRINT_MODULE_USAGE_COMMAND("start");
	PRINT_MODULE_USAGE_DEFAULT_COMMANDS();
	return 0;
}

extern "C" __EXPORT int @name@_main(int argc, char *argv[]);

int @name@_main(int argc, char *argv[]) { return @Name@::main(argc, argv); }
