"""A multirotor with an arm picks up a load and puts it down in a jet of wind: integral action, and two PhyFilters.

    m v' = g + f,   J omega' = g_tau + f_tau,   f = arm + load + wind,   f_tau = arm + load

A file to copy: python example.py flies 20 missions each, prints how far the gripper strays, and saves example.png.
"""

import matplotlib.pyplot as plt
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

import phyfilter_ctl as pf
from phyfilter_ctl.controllers import CooperativePlanner, Multirotor, PlannerLimits, arm_controller, follow
from phyfilter_ctl.plants import Sensor, aerial_manipulator, sensors, small_arm, waypoints, wind_field
from phyfilter_ctl.study import flight_times, median_interval, unit_noise

# --- numbers (SI) -----------------------------------------------------------------------------------------
dt, G = 0.002, 9.81
arm = small_arm()
body = {"mass": 2.55, "J": np.array([0.035, 0.035, 0.06]), "rotor_arm": 0.25}  # without the arm
rotors = {"torque_ratio": 0.016, "motor_lag": 0.04, "rotor_max": 16.2, "drag": [0.9, 0.9, 0.6]}
J = body["J"] + np.diag(np.asarray(arm.inertia(arm.home)))
drone = Multirotor(mass=body["mass"] + arm.mass, J=J, arm=body["rotor_arm"], delay=0.01, **rotors)
trim = -np.cross(arm.mass * np.asarray(arm.centre_of_mass(arm.home)), [0.0, 0.0, G])  # weight of the arm, N m

# --- the mission: where the gripper is to be, and how platform and arm share the way -------------------------
gripper = np.asarray(arm.end_effector(arm.home))  # from the platform
start, pick, place, up = np.array([0.0, -1.4, 1.4]), [1.0, 0.0, 1.1], [2.0, 0.6, 0.9], np.array([0, 0, 0.15])
times = [1.0, 5.0, 6.0, 9.4, 10.4, 14.0, 15.0, 18.4, 19.4]
stops = [start + gripper, pick + up, pick, pick, pick + up, place + up, place, place, place + up]
t, seeds = flight_times(21.0, dt), range(20)
windows = {"grasp": (pick, (t >= 7.0) & (t <= 8.0)), "place": (place, (t >= 16.0) & (t <= 17.0))}


def references():
    """Position, velocity, acceleration and jerk of the platform, and gripper less platform with its rate, (18, N)."""
    hall, workspace = [(-1.0, -2.5, 0.5), (3.0, 2.0, 2.5)], [(0.25, -0.05, -0.16), (0.31, 0.05, -0.05)]
    speeds = {"platform_velocity": 1.0, "arm_velocity": 0.5}
    limits = PlannerLimits(hall, workspace, platform_acceleration=1.0, arm_acceleration=2.0, **speeds)
    planner = CooperativePlanner(limits, arm.mount, horizon=20)
    goal, rest = (
        waypoints(times, stops),
        np.concatenate([start, np.zeros(3), gripper - arm.mount, np.zeros(3)]),
    )
    path = follow(planner, rest, targets=lambda t: goal.output(t, [], [])[:3], steps=302).sample(t)
    shown = ("platform", "platform_velocity", "platform_acceleration", "arm", "arm_velocity")
    padded = [np.pad(getattr(path, name).T, ((0, 0), (18, 18)), mode="edge") for name in shown]
    # Accelerations jump from plan to plan: all are averaged over its period of 70 ms.
    r, v, a, d, d_rate = (sliding_window_view(x, 37, axis=1).mean(axis=2) for x in padded)
    return np.concatenate([r, v, a, np.gradient(a, dt, axis=1), d + arm.mount[:, None], d_rate])


def load(t, x, u, p):
    """0.3 kg: comes within a second from 8.2 s on, and goes from 17.2 s on."""
    return {}, {"payload": 0.3 * (np.clip(t - 8.2, 0.0, 1.0) - np.clip(t - 17.2, 0.0, 1.0))}


def smoothing(t, x, u, p):
    """Low-pass filter of the wanted force: its noise would turn into tilt."""
    smooth = x.before + (1.0 - np.exp(-100.0 * dt)) * (u.F - x.before)
    return {"before": smooth}, {"smooth": smooth}


# --- the closed loop ----------------------------------------------------------------------------------------
def loop(bandwidths=(2.9, 5.7), corner=0.0, margin=0.58, filters=(2.408, 8.79)):
    """The vehicle in its loops; ``filters=None`` is without estimates, ``margin`` the attitude loop's modulus margin.

    Bandwidths in rad/s: position loop (level, vertical), integral action, filters of (force, torque).
    """
    w, weight = np.array(bandwidths), ([0.0, 0.0, drone.mass * G], "N")
    gains = drone.gains(dt, sharpness=6.0, modulus_margin=margin)
    low = pf.plant(smoothing, states={"before": weight}, inputs={"F": weight}, outputs={"smooth": "N"}, dt=dt)
    measured = {
        "r": Sensor("position", 0.001, "m"),
        "v": Sensor("velocity", 0.01, "m/s"),
        "q": Sensor("attitude", 0.002, "rad", quaternion=True),
        "omega": Sensor("rate", 0.01, "rad/s"),
        "joint": Sensor("joint", 0.0008, "rad", arm.home),  # for a model of the arm; here it has none
        "joint_rate": Sensor("joint_rate", 0.02, "rad/s", np.zeros(arm.joints)),
    }
    fan = {"jet_speed": 5.0, "jet_origin": (-2.0, 0.3, 1.15), "jet_width": 0.7, "turbulence": 0.1}
    blocks = [drone.position(dt, kp=w**2, kd=1.8 * w, ki=corner * w**2, gains=gains), pf.sampled_block(low)]
    blocks += [drone.attitude(dt, gains=gains, trim=trim, torque_estimate=True), drone.thrust_delay(dt)]
    blocks += [arm_controller(arm, tilt_bandwidth=5.0, dt=dt), sensors(measured)]
    blocks += [aerial_manipulator(arm=arm, nominal=(drone.mass, J), name="vehicle", **body, **rotors)]
    blocks += [pf.plant(load, states={}, outputs={"payload": "kg"})]
    blocks += [wind_field(length_scale=0.5, noise_interval=dt, **fan)]
    # A signal goes to every input of its name; what is called otherwise has a wire.
    wires = {name: f"sensors.{name}_m" for name in ("r", "v", "q", "omega")}
    wires |= {f"sensors.{name}": f"vehicle.{name}" for name in measured}
    wires |= {"joint_ref": "arm.joint_ref", "joint_rate_ref": "arm.joint_rate_ref", "payload": "load.payload"}
    wires |= {"smoothing.F": "position.F", "F": "smoothing.smooth", "thrust": "attitude.thrust"}
    wires |= {"vehicle.thrust": "delay.thrust_delayed", "wind": "wind.wind", "wind.r": "vehicle.r"}
    outputs = {name: f"vehicle.{name}" for name in ("r_e", "f_coupling", "f_payload", "f_wind")}
    if filters is not None:
        blocks += [drone.known_force(dt), drone.known_torque(dt, trim=trim)]
        for name, bandwidth, M in zip(("force", "torque"), filters, (drone.mass, J), strict=True):
            sampled = pf.lowpass(1, bandwidth).sampled(dt, channels=3, inertia=M, g="average")
            blocks.append(pf.sampled_block(sampled, name=name))
        wires |= {"force.x": "sensors.v_m", "force.g": "prior.g", "f_hat": "force.f_hat"}
        wires |= {"torque.x": "sensors.omega_m", "torque.g": "prior_torque.g", "tau_hat": "torque.f_hat"}
        outputs |= {"f_hat": "f_hat", "tau_hat": "tau_hat"}
    references = [f"{name}_ref" for name in ("r", "v", "a", "j", "d", "d_rate")]
    inputs = [*references, *(f"n_{name}" for name in measured), "noise"]
    return pf.wired(blocks, wires, inputs=inputs, outputs=outputs, name="aerial_manipulator")


# --- the missions -------------------------------------------------------------------------------------------
def fly(closed, goals, seeds=seeds, params=None):
    """Signals by name, (missions, axes, instants), with the error of the gripper."""
    noise = unit_noise(seeds, closed.ninputs - len(goals), len(t))
    inputs = np.concatenate([np.tile(goals, (len(seeds), 1, 1)), noise], axis=1)
    options = {"method": "rk4", "max_step": dt, "interpolation": "hold"}
    return pf.simulate_batch(closed, t, inputs, {"vehicle.r": start}, params=params, **options).outputs


def strayed(found, window):
    """Largest distance of the gripper within a window, m, one a mission."""
    point, inside = windows[window]
    return np.linalg.norm(found["r_e"][..., inside] - np.array(point)[:, None], axis=1).max(axis=1)


def picture(runs, goals):
    """The first mission of each run, and the last run's force."""
    figure, (errors, force) = plt.subplots(2, 1, sharex=True, figsize=(8, 5), layout="constrained")
    for name, found in runs.items():
        errors.plot(t, 100.0 * np.linalg.norm(found["r_e"][0] - goals[:3] - goals[12:15], axis=0), label=name)
    for _, inside in windows.values():
        errors.axvspan(*t[inside][[0, -1]], color="0.9")
    found = list(runs.values())[-1]
    true = found["f_coupling"][0] + found["f_payload"][0] + found["f_wind"][0]
    force.plot(t, true[[0, 2]].T, "k", linewidth=0.8)
    force.plot(t, found["f_hat"][0, [0, 2]].T, label=["estimated, x", "estimated, z"])
    errors.set(ylabel="gripper from its plan [cm]")
    force.set(xlabel="t [s]", ylabel="unknown force [N]")
    errors.legend()
    force.legend()
    return figure


if __name__ == "__main__":
    goals = references()
    loops = {"integral action": loop((3.05, 3.25), 0.636, 0.56, None), "PhyFilters": loop()}  # as tuned
    runs = {name: fly(closed, goals) for name, closed in loops.items()}
    for name, window in [(name, window) for name in runs for window in windows]:
        far = 100.0 * strayed(runs[name], window)
        print(
            f"{name}, {window}: {median_interval(far).text()} cm at most, {sum(far < 2.5)} of {len(far)} in 2.5 cm"
        )
    picture(runs, goals).savefig("example.png")
