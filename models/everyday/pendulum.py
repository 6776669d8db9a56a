"""A driven pendulum with a load and friction that nobody weighed: its angle, without and with PhyFilter.

    M omega' = g + f        M = m l^2,  g = torque - m l G sin(angle),  f = all that load and friction add

python pendulum.py prints the error of the angle and saves pendulum.png
"""

import matplotlib.pyplot as plt
import numpy as np

import phyfilter_ctl as pf

dt, m, length, G, lag = 0.002, 0.5, 0.4, 9.81, 0.01  # s; kg; m; m/s^2; s, of the motor
load, viscous, noise = 0.2, 0.05, 0.005  # kg; N m s; rad/s: the first two are known to the plant only
size, rate = 1.2, 2.5  # rad and rad/s: amplitude and frequency of the reference
M, t = m * length**2, np.arange(0.0, 10.0, dt)


def pendulum(t, x, u, p):
    weight = (m + p.load) * length * G * np.sin(x.angle)
    acceleration = (x.torque - weight - viscous * x.omega) / ((m + p.load) * length**2)
    f = M * acceleration - x.torque + m * length * G * np.sin(x.angle)
    derivatives = {"angle": x.omega, "omega": acceleration, "torque": (u.torque - x.torque) / lag}
    return derivatives, {"angle": x.angle, "omega": x.omega + noise * u.noise, "f": f}


def controller(t, x, u, p):
    """Computed torque with poles at -speed, -speed; g is what the model knows."""
    r, r_rate = size * np.sin(rate * t), size * rate * np.cos(rate * t)
    wanted = -(rate**2) * r + 2.0 * p.speed * (r_rate - u.omega) + p.speed**2 * (r - u.angle)
    weight = m * length * G * np.sin(u.angle)
    torque = M * wanted + weight - u.f_hat
    return {}, {"torque": torque, "g": torque - weight, "r": r}


def loop(speed=25.0, filtered=True):
    """The closed loop with its poles, and that of the filter, at ``speed`` rad/s."""
    states = {"angle": (0.0, "rad"), "omega": (size * rate, "rad/s"), "torque": (0.0, "N m")}
    plant = pf.plant(
        pendulum, states=states, inputs={"torque": (0.0, "N m"), "noise": 0.0}, params={"load": load}
    )
    inputs = {"angle": (0.0, "rad"), "omega": (0.0, "rad/s"), "f_hat": (0.0, "N m")}
    law = pf.plant(controller, states={}, inputs=inputs, params={"speed": speed}, optional=["f_hat"], dt=dt)
    filter = pf.lowpass(1, speed).sampled(dt, channels=1, inertia=M)
    blocks = [plant, pf.sampled_block(law), pf.sampled_block(filter, f_theta=False, name="filter")]
    wires = {"torque": "controller.torque", "g": "controller.g", "angle": "pendulum.angle"}
    wires |= {"omega": "pendulum.omega", "filter.x": "omega"}
    if filtered:
        wires["f_hat"] = "filter.f_hat"
    outputs = {"angle": "pendulum.angle", "r": "controller.r", "f": "pendulum.f", "f_hat": "filter.f_hat"}
    return pf.wired(blocks, wires, inputs=["noise"], outputs=outputs, name="pendulum_loop")


def run(filtered):
    """Speed and signals of the fastest loop that has a modulus margin of 0.5 without load: one search for both."""
    loops, bare = ((s, loop(s, filtered)) for s in np.geomspace(50.0, 3.0, 30)), {"pendulum.load": 0.0}
    stable = ((s, it, pf.margins(it, at="pendulum.torque", params=bare)) for s, it in loops)
    speed, tuned = next((s, it) for s, it, found in stable if found.modulus_margin >= 0.5)
    noise = np.random.default_rng(0).standard_normal(t.shape)
    return speed, pf.simulate(tuned, t, noise, interpolation="hold").outputs


if __name__ == "__main__":
    figure, (errors, forces) = plt.subplots(2, 1, sharex=True, figsize=(8, 4), layout="constrained")
    runs = {"without": run(False), "with PhyFilter": run(True)}
    for name, (speed, found) in runs.items():
        error = np.degrees(found["r"] - found["angle"])
        said = f"{name} ({speed:.1f} rad/s): {np.sqrt(np.mean(error**2)):.3f} degrees rms"
        print(said)
        errors.plot(t, error, label=said)
    found = runs["with PhyFilter"][1]
    forces.plot(t, found["f_hat"], t, found["f"], "k--")
    errors.set(ylabel="error [degrees]")
    errors.legend()
    forces.set(xlabel="t [s]", ylabel="f, its estimate [N m]")
    figure.savefig("pendulum.png")
