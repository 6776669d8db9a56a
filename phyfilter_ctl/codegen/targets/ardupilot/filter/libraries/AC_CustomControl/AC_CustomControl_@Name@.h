#pragma once

#include "AC_CustomControl_Backend.h"

#if AP_CUSTOMCONTROL_ENABLED

#include "@name@/@name@_guard.h"

/* The main rate controller without its integrator, and the torque that it does not explain taken off its output. */
class AC_CustomControl_@Name@ : public AC_CustomControl_Backend {
public:
    AC_CustomControl_@Name@(AC_CustomControl& frontend, AP_AHRS_View*& ahrs, AC_AttitudeControl*& att_control, AP_MotorsMulticopter*& motors, float dt);

    Vector3f update(void) override;
    void reset(void) override;

    static const struct AP_Param::GroupInfo var_info[];

private:
    void tune(void);

    AP_Float _authority_roll;  // rad/s^2 per unit of output
    AP_Float _authority_pitch;
    AP_Float _authority_yaw;
    AP_Float _share;           // of the estimate that is taken off: 0 watches only
@ardupilot_members@

    @name@_guard _guard;
    Vector3f _applied;         // output since the last step, with the main controller's feed-forward
    float _poles_in_force[@ardupilot_count@];
    uint32_t _steps;
    bool _usable;
};

#endif
