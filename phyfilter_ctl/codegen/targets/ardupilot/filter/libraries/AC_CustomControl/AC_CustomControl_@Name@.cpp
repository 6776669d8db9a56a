#include "AC_CustomControl_@Name@.h"

#if AP_CUSTOMCONTROL_ENABLED

#include <AP_HAL/AP_HAL.h>
#include <AP_Logger/AP_Logger.h>
#include <GCS_MAVLink/GCS.h>
#include <string.h>

const AP_Param::GroupInfo AC_CustomControl_@Name@::var_info[] = {
    // @Param: B_RLL
    // @DisplayName: Roll acceleration of full output
    // @Units: rad/s/s
    AP_GROUPINFO("B_RLL", 1, AC_CustomControl_@Name@, _authority_roll, 100.0f),

    // @Param: B_PIT
    // @DisplayName: Pitch acceleration of full output
    // @Units: rad/s/s
    AP_GROUPINFO("B_PIT", 2, AC_CustomControl_@Name@, _authority_pitch, 100.0f),

    // @Param: B_YAW
    // @DisplayName: Yaw acceleration of full output
    // @Units: rad/s/s
    AP_GROUPINFO("B_YAW", 3, AC_CustomControl_@Name@, _authority_yaw, 20.0f),

    // @Param: SHARE
    // @DisplayName: Share of the estimate that is taken off the output
    // @Description: 0 watches only, 1 replaces the integrator
    // @Range: 0 1
    AP_GROUPINFO("SHARE", 4, AC_CustomControl_@Name@, _share, 0.0f),

@ardupilot_info@
    AP_GROUPEND
};

AC_CustomControl_@Name@::AC_CustomControl_@Name@(AC_CustomControl& frontend, AP_AHRS_View*& ahrs, AC_AttitudeControl*& att_control, AP_MotorsMulticopter*& motors, float dt) :
    AC_CustomControl_Backend(frontend, ahrs, att_control, motors, dt),
    _steps(0)
{
    AP_Param::setup_object_defaults(this, var_info);
    memset(_poles_in_force, 0, sizeof(_poles_in_force));
    const int code = @name@_guard_init(&_guard, &@name@_parameters);
    _usable = code == 0;
    if (!_usable) {
        GCS_SEND_TEXT(MAV_SEVERITY_ERROR, "@Name@: %s", pf_filter_message(code));
    }
}

/* Poles from the parameters, when they were changed; a low-pass filter stays one, of gain 1 at rest. */
void AC_CustomControl_@Name@::tune(void)
{
    const float poles[@ardupilot_count@] = {@ardupilot_poles@};
    if (memcmp(poles, _poles_in_force, sizeof(poles)) == 0) {
        return;
    }
    @name@_tuning tuning;
    memset(&tuning, 0, sizeof(tuning));
    double a0 = 1.0;
@ardupilot_tune@
    tuning.b[0][0] = a0;
    @name@_guard_seal(&tuning);
    const int code = @name@_guard_send(&_guard, &tuning);
    if (code == PF_FILTER_INVALID) {
        return; // the one before waits for its step: again at the next
    }
    memcpy(_poles_in_force, poles, sizeof(poles));
    if (code) {
        GCS_SEND_TEXT(MAV_SEVERITY_WARNING, "@Name@: poles kept: %s", pf_filter_message(code));
    }
}

Vector3f AC_CustomControl_@Name@::update(void)
{
    const Vector3f main_output(_motors->get_roll(), _motors->get_pitch(), _motors->get_yaw());
    if (!_usable) {
        return main_output;
    }
    switch (_motors->get_spool_state()) {
    case AP_Motors::SpoolState::SHUT_DOWN:
    case AP_Motors::SpoolState::GROUND_IDLE:
        reset(); // the ground's torque is not one to learn
        break;
    case AP_Motors::SpoolState::THROTTLE_UNLIMITED:
    case AP_Motors::SpoolState::SPOOLING_UP:
    case AP_Motors::SpoolState::SPOOLING_DOWN:
        break;
    }
    tune();

    const Vector3f gyro = _ahrs->get_gyro_latest();
    const float authority[3] = {_authority_roll.get(), _authority_pitch.get(), _authority_yaw.get()};
    const @name@_real x[3] = {gyro.x, gyro.y, gyro.z};
    const @name@_real g[3] = {authority[0] * _applied.x, authority[1] * _applied.y, authority[2] * _applied.z};
    const @name@_real f_theta[3] = {}; // a learned model goes here
    @name@_real f_hat[3];
    const uint32_t health = @name@_guard_step(&_guard, AP_HAL::micros64(), x, g, f_theta, nullptr, f_hat);
    if (++_steps % 400 == 0) {
        @name@_guard_check(&_guard);
    }
    AP::logger().Write("@log@", "TimeUS,R,P,Y,H", "QfffI", AP_HAL::micros64(),
                       (double)f_hat[0], (double)f_hat[1], (double)f_hat[2], health);

    Vector3f out = main_output;
    float *const axes[3] = {&out.x, &out.y, &out.z};
    for (uint8_t i = 0; i < 3; i++) {
        if (authority[i] > 0.0f) {
            *axes[i] = constrain_float(*axes[i] - _share.get() * (float)f_hat[i] / authority[i], -1.0f, 1.0f);
        }
    }
    // The frontend replaces roll, pitch and yaw of the motors; the main controller's feed-forward is added to them.
    _applied = out + Vector3f(_motors->get_roll_ff(), _motors->get_pitch_ff(), _motors->get_yaw_ff());
    return out;
}

void AC_CustomControl_@Name@::reset(void)
{
    @name@_reset(&_guard.filter);
    _guard.running = 0;
    _applied.zero();
}

#endif
