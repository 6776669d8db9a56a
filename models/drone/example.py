"""A quadrotor on a circle with an unknown payload, in the jet of a fan: PD alone, and PD with PhyFilter.

    m v' = g + f        g = thrust that acts - m g e_z - R D R' v,   f = -load (v' + g e_z) + R D R' wind

A file to copy: python example.py flies the 20 test flights of the study, prints the mean distance from the circle, and
saves example.png.
"""

import matplotlib.pyplot as plt
import numpy as np

import phyfilter_ctl as pf
from phyfilter_ctl.controllers import Multirotor
from phyfilter_ctl.plants import Sensor, circle, sensors, wind_field
from phyfilter_ctl.study import flight_times, median_interval, unit_noise

# --- numbers (SI) -----------------------------------------------------------------------------------------
dt = 0.002  # s, of controllers and filter
drone = Multirotor(
    mass=3.0,
    J=[0.035, 0.035, 0.06],
    arm=0.25,
    torque_ratio=0.016,  # m, yaw torque per thrust
    motor_lag=0.04,
    rotor_max=16.2,
    drag=[0.9, 0.9, 0.6],
    delay=0.01,  # s, from a measurement to the rotors
)
radius, height, speed = 1.5, 1.5, 2.0
filter = pf.place_poles([-8.177])  # rad/s, and no learned model: f_theta = 0
t, seeds = flight_times(30.0, dt), range(20)
counted = t >= 6.0  # from then on the vehicle is on the circle


# --- the closed loop ----------------------------------------------------------------------------------------
def loop(bandwidth=2.05, filter=filter):
    """Position and attitude loop around the vehicle; ``filter=None`` is the PD controller alone.

    Parameters
    ----------
    bandwidth : float
        Of the position loop in rad/s.
    filter : PhyFilter, optional
    """
    reference = circle(radius=radius, speed=speed, height=height, ramp=3.0)
    position = drone.position(dt, kp=bandwidth**2, kd=1.8 * bandwidth)
    fan = wind_field(
        jet_speed=5.0,
        jet_origin=(-3.5, 1.0, height),
        jet_width=0.8,
        turbulence=0.15,
        length_scale=0.5,
        noise_interval=dt,
    )
    measured = sensors(
        {
            "r": Sensor("position", 0.001, "m"),
            "v": Sensor("velocity", 0.01, "m/s"),
            "q": Sensor("attitude", 0.002, "rad", quaternion=True),
            "omega": Sensor("rate", 0.01, "rad/s"),
        }
    )
    blocks = [reference, position, drone.attitude(dt), drone.thrust_delay(dt), drone.plant(), fan, measured]
    # A signal goes to every input of its name; what is called otherwise has a wire.
    names = ("r", "v", "q", "omega")
    wires = {name: f"sensors.{name}_m" for name in names}
    wires |= {f"sensors.{name}": f"quadrotor.{name}" for name in names}
    wires |= {f"{name}_ref": f"reference.{name}_ref" for name in "rvaj"}
    wires |= {"F": "position.F", "thrust": "attitude.thrust", "quadrotor.thrust": "delay.thrust_delayed"}
    wires |= {"wind": "wind.wind", "wind.r": "quadrotor.r"}
    outputs = {name: f"quadrotor.{name}" for name in ("r", "f_mass", "f_wind")} | {"r_ref": "r_ref"}
    if filter is not None:
        sampled = filter.sampled(dt, channels=3, inertia=drone.mass, g="average")
        blocks += [drone.known_force(dt), pf.sampled_block(sampled, name="filter")]
        wires |= {"filter.x": "sensors.v_m", "g": "prior.g", "f_hat": "filter.f_hat"}
        outputs |= {"f_hat": "f_hat"}
    noise = [*(f"n_{name}" for name in names), "noise"]
    return pf.wired(blocks, wires, inputs=noise, outputs=outputs, name="drone")


# --- the flights --------------------------------------------------------------------------------------------
def fly(bandwidth, filter, wind=1.0):
    """Signals by name, (flights, axes, instants); each flight has a payload and a wind of its own, times ``wind``."""
    closed = loop(bandwidth, filter)
    drawn = np.array([np.random.default_rng([seed, 0]).random(3) for seed in seeds])
    angle = 2.0 * np.pi * drawn[:, 2]
    params = {
        "quadrotor.added_mass": 0.15 + 0.75 * drawn[:, 0],  # kg: 5 to 30 %, which only the plant knows
        "wind.jet_speed": wind * (4.0 + 2.0 * drawn[:, 1]),
        "wind.mean": 0.5 * wind * np.array([np.cos(angle), np.sin(angle), 0.0 * angle]).T,
    }
    noise = unit_noise(seeds, closed.ninputs, len(t))
    start = {"quadrotor.r": [radius, 0.0, height]}
    return pf.simulate_batch(
        closed, t, noise, start, params=params, method="rk4", max_step=dt, interpolation="hold"
    ).outputs


def distance(found):
    """Mean distance of each flight from the circle in m."""
    return np.linalg.norm(found["r"] - found["r_ref"], axis=1)[:, counted].mean(axis=1)


def picture(runs):
    """The first flight of each run, and the last run's force."""
    figure, (path, force) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    for name, found in runs.items():
        path.plot(*found["r"][0, :2, counted].T, label=name)
    found = list(runs.values())[-1]
    true = found["f_mass"] + found["f_wind"]
    for axis, i in (("x", 0), ("z", 2)):
        force.plot(t, true[0, i], "k", linewidth=0.8, label=f"true, {axis}")
        force.plot(t, found["f_hat"][0, i], label=f"estimated, {axis}")
    path.plot(*found["r_ref"][0, :2], "k--", linewidth=0.8)
    path.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    force.set(xlabel="t [s]", ylabel="unknown force [N]")
    path.legend()
    force.legend(loc=(0.35, 0.28), ncols=2)
    return figure


if __name__ == "__main__":
    runs = {"PD": fly(2.8, None), "PD + PhyFilter": fly(2.05, filter)}  # each loop as it was tuned
    for name, found in runs.items():
        errors = median_interval(distance(found)).text(100.0)
        print(f"{name + ':':<16}{errors} cm from the circle, median of {len(seeds)}")
    picture(runs).savefig("example.png")
