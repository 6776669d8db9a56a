"""Two links in a vertical plane with an unknown load in the gripper: its path, without and with PhyFilter.

    M(q) w' = g + f        g = torque - h, h of Coriolis and weight, of the arm alone;  f = all that the load adds

python two_link_arm.py prints the error of the gripper and saves two_link_arm.png
"""

import matplotlib.pyplot as plt
import numpy as np

import phyfilter_ctl as pf
from phyfilter_ctl.plants import solve, stack

dt, lag, noise, G = 0.002, 0.008, 0.002, 9.81  # s; s, of the motors; rad/s; m/s^2
a, b, first, second, load = 0.4, 0.3, 2.0, 1.0, 0.5  # m, of the links; kg, of links and load
start, size, rate = np.array([-0.9, 1.6]), np.array([0.5, 0.4]), np.array([2.0, 3.0])  # rad, rad, rad/s
t = np.arange(0.0, 8.0, dt)


def terms(q, w, load):
    """M(q) and h of the arm with a load; its links have their masses in the middle."""
    outer, coupled = b**2 * (second / 4 + load), a * b * (second / 2 + load)
    inner = a**2 * (first / 4 + second + load) + outer
    M = np.array([[inner, outer], [outer, outer]]) + coupled * np.array([[2, 1], [1, 0]]) * np.cos(q[1])
    far = G * b * (second / 2 + load) * np.cos(q[0] + q[1])
    weight = stack(G * a * (first / 2 + second + load) * np.cos(q[0]) + far, far)
    return M, weight + coupled * np.sin(q[1]) * stack(-(2 * w[0] + w[1]) * w[1], w[0] ** 2)


def arm(t, x, u, p):
    (M, h), (true_M, true_h) = terms(x.q, x.w, 0.0), terms(x.q, x.w, p.load)
    w_rate = solve(true_M, x.torque - true_h)
    derivatives = {"q": x.w, "w": w_rate, "torque": (u.torque - x.torque) / lag}
    return derivatives, {"q": x.q, "w": x.w + noise * u.noise, "f": M @ w_rate - x.torque + h}


def model(t, x, u, p):
    return {}, dict(zip("Mh", terms(u.q, u.w, 0.0), strict=True))


def controller(t, x, u, p):
    """Computed torque of the arm alone with poles at -speed, -speed."""
    r, r_rate = start + size * (1 - np.cos(rate * t)), size * rate * np.sin(rate * t)
    wanted = size * rate**2 * np.cos(rate * t) + 2 * p.speed * (r_rate - u.w) + p.speed**2 * (r - u.q)
    g = u.M @ wanted - u.f_hat
    return {}, {"torque": g + u.h, "g": g, "r": r}


def loop(speed=30.0, filtered=True):
    """The closed loop with its poles, and those of the filter, at ``speed`` rad/s."""
    zero, seen = np.zeros(2), {"q": (start, "rad"), "w": (np.zeros(2), "rad/s")}
    states = seen | {"torque": (terms(start, zero, load)[1], "N m")}
    plant = pf.plant(arm, states=states, inputs={"torque": zero, "noise": zero}, params={"load": load})
    known = pf.plant(model, states={}, inputs=seen, dt=dt)
    inputs = seen | {"M": np.eye(2), "h": zero, "f_hat": zero}
    law = pf.plant(controller, states={}, inputs=inputs, params={"speed": speed}, optional=["f_hat"], dt=dt)
    filter = pf.sampled_block(
        pf.lowpass(1, speed).sampled(dt, inertia="full"), 2, f_theta=False, name="filter"
    )
    wires = {"q": "arm.q", "w": "arm.w", "M": "model.M", "h": "model.h", "torque": "controller.torque"}
    wires |= {"g": "controller.g", "filter.x": "w"}
    if filtered:
        wires["f_hat"] = "filter.f_hat"
    outputs = {"q": "arm.q", "r": "controller.r", "f": "arm.f", "f_hat": "filter.f_hat"}
    blocks = [plant, pf.sampled_block(known), pf.sampled_block(law), filter]
    return pf.wired(blocks, wires, inputs=["noise"], outputs=outputs, name="two_link_arm")


def run(filtered):
    """Speed and signals of the fastest loop that has a modulus margin of 0.5 without load: one search for both."""
    loops, bare = ((s, loop(s, filtered)) for s in np.geomspace(150.0, 10.0, 30)), {"arm.load": 0.0}
    stable = ((s, it, pf.margins(it, at="arm.torque", params=bare)) for s, it in loops)
    speed, tuned = next((s, it) for s, it, found in stable if found.modulus_margin >= 0.5)
    noise = np.random.default_rng(0).standard_normal((2, t.size))
    return speed, pf.simulate(tuned, t, noise, interpolation="hold").outputs


def gripper(q):
    """Its place (2, N) in m."""
    return a * np.array([np.cos(q[0]), np.sin(q[0])]) + b * np.array(
        [np.cos(q[0] + q[1]), np.sin(q[0] + q[1])]
    )


if __name__ == "__main__":
    figure, (errors, forces) = plt.subplots(2, 1, sharex=True, figsize=(8, 4), layout="constrained")
    runs = {"without": run(False), "with PhyFilter": run(True)}
    for name, (speed, found) in runs.items():
        error = np.linalg.norm(gripper(found["q"]) - gripper(found["r"]), axis=0)
        said = f"{name} ({speed:.0f} rad/s): {1e3 * np.sqrt(np.mean(error**2)):.1f} mm rms"
        print(said)
        errors.plot(t, 1e3 * error, label=said)
    found = runs["with PhyFilter"][1]
    forces.plot(t, found["f_hat"].T, t, found["f"].T, "k--", linewidth=1)
    errors.set(ylabel="error [mm]")
    errors.legend()
    forces.set(xlabel="t [s]", ylabel="f, its estimate [N m]")
    figure.savefig("two_link_arm.png")
