"""A robot on two driven wheels, on a slope, its left wheel in sand: its path, without and with PhyFilter.

    diag(m, J) (v, omega)' = g + f        g = force and torque of the wheels;  f = slope and sand, both unknown

python differential_drive.py prints the distance from the path and saves differential_drive.png
"""

import matplotlib.pyplot as plt
import numpy as np

import phyfilter_ctl as pf
from phyfilter_ctl.plants import stack

dt, lag, noise = 0.01, 0.03, 0.005  # s; s, of the motors; m/s and rad/s
M, half = np.array([12.0, 0.5]), 0.2  # kg and kg m^2; m, half the track
slope, sand = 12.0, 8.0  # N: the weight along the slope, and what the left wheel has against it
ref, radius, t = np.array([0.6, 0.4]), 1.5, np.arange(0.0, 20.0, dt)  # m/s and rad/s; m; s


def robot(t, x, u, p):
    v, omega, heading = x.w[0], x.w[1], x.pose[2]
    drag = sand * v / np.sqrt(v**2 + 0.01**2)
    f = stack(-slope * np.cos(heading) - drag, half * drag)
    moved = {"pose": stack(v * np.cos(heading), v * np.sin(heading), omega), "w": (x.force + f) / M}
    outputs = {"pose": x.pose, "w": x.w + noise * u.noise, "f": f}
    return moved | {"force": (u.force - x.force) / lag}, outputs


def controller(t, x, u, p):
    """Kanayama's law of the pose gives the wanted (v, omega), a P law the forces."""
    goal, k = ref[1] * t, p.speed / 4.0
    dx, dy = radius * np.sin(goal) - u.pose[0], radius * (1.0 - np.cos(goal)) - u.pose[1]
    c, s, turn = np.cos(u.pose[2]), np.sin(u.pose[2]), goal - u.pose[2]
    faster = stack(k * (c * dx + s * dy), k**2 / ref[0] * (c * dy - s * dx) + 2.0 * k * np.sin(turn))
    return {}, {"force": M * p.speed * (ref * stack(np.cos(turn), 1.0) + faster - u.w) - u.f_hat}


def loop(speed=10.0, filtered=True):
    """The closed loop of (v, omega), and the filter, at ``speed`` rad/s; that of the pose is four times slower."""
    pose, zero = (np.zeros(3), "m, m, rad"), np.zeros(2)
    states = {"pose": pose, "w": ref, "force": zero}
    plant = pf.plant(robot, states=states, inputs={"force": zero, "noise": zero})
    inputs = {"pose": pose, "w": zero, "f_hat": zero}
    law = pf.plant(controller, states={}, inputs=inputs, params={"speed": speed}, optional=["f_hat"], dt=dt)
    filter = pf.lowpass(1, speed).sampled(dt, channels=2, inertia=M)
    blocks = [plant, pf.sampled_block(law), pf.sampled_block(filter, f_theta=False, name="filter")]
    wires = {"force": "controller.force", "pose": "robot.pose", "w": "robot.w"}
    wires |= {"filter.x": "w", "filter.g": "force"}
    if filtered:
        wires["f_hat"] = "filter.f_hat"
    outputs = {"pose": "robot.pose", "f": "robot.f", "f_hat": "filter.f_hat"}
    return pf.wired(blocks, wires, inputs=["noise"], outputs=outputs, name="differential_drive")


def run(filtered):
    """Speed and signals of the fastest loop at a modulus margin of 0.5: one search, with and without the filter."""
    loops = ((s, loop(s, filtered)) for s in np.geomspace(20.0, 1.0, 30))
    speed, tuned = next((s, it) for s, it in loops if pf.margins(it, at="robot.force").modulus_margin >= 0.5)
    noise = np.random.default_rng(0).standard_normal((2, t.size))
    return speed, pf.simulate(tuned, t, noise, interpolation="hold").outputs


if __name__ == "__main__":
    figure, (errors, forces) = plt.subplots(2, 1, sharex=True, figsize=(8, 4), layout="constrained")
    runs = {"without": run(False), "with PhyFilter": run(True)}
    for name, (speed, found) in runs.items():
        x, y, _ = found["pose"]
        error = np.hypot(x - radius * np.sin(ref[1] * t), y - radius * (1.0 - np.cos(ref[1] * t)))
        said = f"{name} ({speed:.1f} rad/s): {100.0 * np.sqrt(np.mean(error**2)):.2f} cm rms"
        print(said)
        errors.plot(t, 100.0 * error, label=said)
    found = runs["with PhyFilter"][1]
    forces.plot(t, found["f_hat"].T, t, found["f"].T, "k--", linewidth=1)
    errors.set(ylabel="error [cm]")
    errors.legend()
    forces.set(xlabel="t [s]", ylabel="f, its estimate [N, N m]")
    figure.savefig("differential_drive.png")
