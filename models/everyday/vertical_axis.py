"""The vertical axis of a multirotor that picks up a load of unknown mass: its height, and the mass found.

    m v' = g + f        g = thrust - m G, the thrust as the motors' lag leaves it;  f = -load (v' + G)

python vertical_axis.py prints the error of the height and the mass of the load and saves vertical_axis.png
"""

import matplotlib.pyplot as plt
import numpy as np

import phyfilter_ctl as pf

dt, m, lag, G = 0.004, 1.5, 0.05, 9.81  # s; kg; s, of the motors; m/s^2
load, lifted, noise = (
    0.3,
    4.0,
    0.02,
)  # kg; s, when it is picked up; m/s: the first two are known to the plant only
t = np.arange(0.0, 10.0, dt)


def multirotor(t, x, u, p):
    carried = np.where(t < lifted, 0.0, load)
    acceleration = x.thrust / (m + carried) - G
    outputs = {"z": x.z, "v": x.v + noise * u.noise, "f": -carried * (acceleration + G)}
    return {"z": x.v, "v": acceleration, "thrust": (u.thrust - x.thrust) / lag}, outputs


def controller(t, x, u, p):
    """A PD law about the height 0; it predicts the thrust that its commands leave until the next sample."""
    thrust = m * (G - 2.0 * p.speed * u.v - p.speed**2 * u.z) - u.f_hat
    mean = thrust + (x.thrust - thrust) * lag / dt * (1.0 - np.exp(-dt / lag))
    return {"thrust": thrust + (x.thrust - thrust) * np.exp(-dt / lag)}, {"thrust": thrust, "g": mean - m * G}


def loop(speed=8.0, filtered=True):
    """The closed loop with its poles, and that of the filter, at ``speed`` rad/s."""
    states = {"z": (0.0, "m"), "v": (0.0, "m/s"), "thrust": (m * G, "N")}
    plant = pf.plant(multirotor, states=states, inputs={"thrust": (m * G, "N"), "noise": 0.0})
    seen = {"z": (0.0, "m"), "v": (0.0, "m/s"), "f_hat": (0.0, "N")}
    law = pf.plant(
        controller, states={"thrust": m * G}, inputs=seen, params={"speed": speed}, optional=["f_hat"], dt=dt
    )
    filter = pf.lowpass(1, speed).sampled(dt, channels=1, inertia=m)
    blocks = [plant, pf.sampled_block(law), pf.sampled_block(filter, f_theta=False, name="filter")]
    wires = {"thrust": "controller.thrust", "g": "controller.g", "z": "multirotor.z", "v": "multirotor.v"}
    wires["filter.x"] = "v"
    if filtered:
        wires["f_hat"] = "filter.f_hat"
    outputs = {"z": "multirotor.z", "f": "multirotor.f", "f_hat": "filter.f_hat"}
    return pf.wired(blocks, wires, inputs=["noise"], outputs=outputs, name="vertical_axis")


def run(filtered):
    """Speed and signals of the fastest loop at a modulus margin of 0.5: one search, with and without the filter."""
    loops = ((s, loop(s, filtered)) for s in np.geomspace(20.0, 1.0, 30))
    stable = ((s, it, pf.margins(it, at="multirotor.thrust")) for s, it in loops)
    speed, tuned = next((s, it) for s, it, found in stable if found.modulus_margin >= 0.5)
    noise = np.random.default_rng(0).standard_normal(t.shape)
    return speed, pf.simulate(tuned, t, noise, interpolation="hold").outputs


if __name__ == "__main__":
    figure, (heights, masses) = plt.subplots(2, 1, sharex=True, figsize=(8, 4), layout="constrained")
    runs = {"without": run(False), "with PhyFilter": run(True)}
    for name, (speed, found) in runs.items():
        said = f"{name} ({speed:.1f} rad/s): {100.0 * abs(found['z'][t > 8.0].mean()):.2f} cm from its height"
        print(said)
        heights.plot(t, 100.0 * found["z"], label=said)
    found = runs["with PhyFilter"][1]
    mass = -found["f_hat"] / G
    print(f"load {mass[t > 8.0].mean():.3f} kg, in truth {load:.3f} kg")
    masses.plot(t, mass, t, np.where(t < lifted, 0.0, load), "k--")
    heights.set(ylabel="height [cm]")
    heights.legend()
    masses.set(xlabel="t [s]", ylabel="load, its estimate [kg]")
    figure.savefig("vertical_axis.png")
