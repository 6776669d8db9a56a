"""A DC motor with friction: its speed loop through reversals, without and with PhyFilter.

    J omega' = tau + f        f = -coulomb sign(omega) - viscous omega, which the controller does not know

python dc_motor.py prints the error of the speed and saves dc_motor.png
"""

import matplotlib.pyplot as plt
import numpy as np

import phyfilter_ctl as pf

dt, J, lag = 0.001, 2e-4, 0.004  # s; kg m^2; s, of the current loop
coulomb, viscous, noise = 0.02, 5e-5, 0.05  # N m; N m s; rad/s
size, rate = 100.0, 2.0  # rad/s, of the reference: its amplitude and its frequency
t = np.arange(0.0, 8.0, dt)


def motor(t, x, u, p):
    f = -coulomb * np.sign(x.omega) - viscous * x.omega
    derivatives = {"omega": (x.torque + f) / J, "torque": (u.torque - x.torque) / lag}
    return derivatives, {"omega": x.omega, "measured": x.omega + noise * u.noise, "f": f}


def controller(t, x, u, p):
    """Feedforward and a P law; the known force g is the torque itself."""
    r, r_rate = size * np.sin(rate * t), size * rate * np.cos(rate * t)
    return {}, {"torque": J * (r_rate + p.speed * (r - u.omega)) - u.f_hat, "r": r}


def loop(speed=100.0, filtered=True):
    """The closed loop with its pole, and that of the filter, at ``speed`` rad/s."""
    states = {"omega": (0.0, "rad/s"), "torque": (0.0, "N m")}
    plant = pf.plant(motor, states=states, inputs={"torque": (0.0, "N m"), "noise": 0.0})
    inputs = {"omega": (0.0, "rad/s"), "f_hat": (0.0, "N m")}
    law = pf.plant(controller, states={}, inputs=inputs, params={"speed": speed}, optional=["f_hat"], dt=dt)
    filter = pf.lowpass(1, speed).sampled(dt, channels=1, inertia=J)
    blocks = [plant, pf.sampled_block(law), pf.sampled_block(filter, f_theta=False, name="filter")]
    wires = {
        "torque": "controller.torque",
        "omega": "motor.measured",
        "filter.x": "omega",
        "filter.g": "torque",
    }
    if filtered:
        wires["f_hat"] = "filter.f_hat"
    outputs = {"omega": "motor.omega", "r": "controller.r", "f": "motor.f", "f_hat": "filter.f_hat"}
    return pf.wired(blocks, wires, inputs=["noise"], outputs=outputs, name="dc_motor")


def run(filtered):
    """Speed and signals of the fastest loop at a modulus margin of 0.5: one search, with and without the filter."""
    loops = ((s, loop(s, filtered)) for s in np.geomspace(500.0, 20.0, 30))
    speed, tuned = next((s, it) for s, it in loops if pf.margins(it, at="motor.torque").modulus_margin >= 0.5)
    noise = np.random.default_rng(0).standard_normal(t.shape)
    return speed, pf.simulate(tuned, t, noise, interpolation="hold").outputs


if __name__ == "__main__":
    figure, (errors, forces) = plt.subplots(2, 1, sharex=True, figsize=(8, 4), layout="constrained")
    runs = {"without": run(False), "with PhyFilter": run(True)}
    for name, (speed, found) in runs.items():
        error = found["r"] - found["omega"]
        said = f"{name} ({speed:.0f} rad/s): {np.sqrt(np.mean(error**2)):.3f} rad/s rms"
        print(said)
        errors.plot(t, error, label=said)
    found = runs["with PhyFilter"][1]
    forces.plot(t, found["f_hat"], t, found["f"], "k--")
    errors.set(ylabel="error [rad/s]")
    errors.legend()
    forces.set(xlabel="t [s]", ylabel="f, its estimate [N m]")
    figure.savefig("dc_motor.png")
