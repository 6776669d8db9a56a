"""A quadruped that carries 60 % of its weight, which its policies never saw: walks without and with PhyFilter.

    M_0 q'' = g + f        g = tau - d q', no contact and no payload;  f = all the rest, f_hat at most 20 N m
    tau = Kp (q_d - f_hat/Kp - q) - Kd q'                                     a PD law whose target the filter moves

python -m phyfilter_ctl.models.quadruped.example prints the error of the walking speed and saves example.png (half a
minute; needs the extra mujoco). The policies are the study's, ``phyfilter-ctl run quadruped``.
"""

# pyright: reportMissingImports=false
import matplotlib.pyplot as plt
import numpy as np
from phyfilter_ctl.models.quadruped.batch import Batch
from phyfilter_ctl.models.quadruped.gait import following, sent, trot
from phyfilter_ctl.models.quadruped.params import params
from phyfilter_ctl.models.quadruped.policy import observe, shipped
from phyfilter_ctl.models.quadruped.robot import joint_inertia

import phyfilter_ctl as pf
from phyfilter_ctl.controllers import JointTorqueFilter
from phyfilter_ctl.plants import JointQuantities, JointSpacePrior

p = params()  # every number with its unit and reason: models/quadruped/params.toml
dt, decimation, kp, kd = (
    p.control.dt,
    p.control.decimation,
    p.control.kp,
    p.control.kd,
)  # 200 Hz, policies at 50 Hz
speed, payload, duration, settled = (
    1.0,
    0.6 * p.robot.mass,
    10.0,
    2.0,
)  # m/s; kg; s; s, from when the error counts
limits = np.tile(p.robot.torque_limits, 4)  # N m
policies = [
    shipped(f"filter-{seed}") for seed in range(3)
]  # trained with this filter, on payloads of at most 3 kg


# --- known force and filter -------------------------------------------------------------------------------------------
def make_filter():
    """Order 1 at 1 rad/s, in each of twelve joints, told the motors' torques and nothing of contact and payload."""
    prior = JointSpacePrior(
        inertia="constant",
        bias="damping",
        contact="omitted",
        constant_inertia=joint_inertia(p),
        damping=p.robot.damping,
    )
    return JointTorqueFilter(pf.lowpass(1, 1.0).sampled(dt, g="average", limit=20.0), prior)


# --- loop -------------------------------------------------------------------------------------------------------------
def walk(used, policy, phase):
    """Robots that walk side by side, of policies by number, from phases of the gait: speeds, f_hat, and who fell.

    ``used`` (robots, 1) is 1 where f_hat goes to the joint loop and 0 where it is only looked at.
    """
    size, phase = len(phase), phase.copy()
    robots = Batch(size)
    robots.set_payload(np.full(size, payload))
    place = np.zeros((size, 3))
    place[:, 1] = np.arange(size)  # m, one beside the other
    robots.reset(np.arange(size), joints=sent(trot(phase, np.zeros((size, 3)))), place=place)
    filter = make_filter()
    state, torque, f_hat = filter.start(robots.qd), np.zeros((size, 12)), np.zeros((size, 12))
    action, fallen, speeds, estimates = np.zeros((size, 12)), np.zeros(size, dtype=bool), [], []
    for k in range(round(duration / (dt * decimation))):
        motion, command = robots.motion, np.zeros((size, 3))
        command[:, 0] = speed * min(1.0, k * dt * decimation)  # reached within a second
        command[:, 2] = np.clip(-motion.yaw, -0.5, 0.5)  # rad/s, keeps the heading
        seen = observe(motion, phase, command, action)
        for number, network in enumerate(policies):
            action[policy == number] = network(seen[policy == number])
        phase = following(phase, command)
        target = trot(phase, command) + p.control.action_scale * action
        for _ in range(decimation):
            q, qd = robots.q, robots.qd
            state, f_hat = filter.step(state, qd, JointQuantities(qd), torque)
            wanted = sent(target - used * f_hat / kp)
            torque = np.clip(kp * (wanted - q) - kd * qd, -limits, limits)
            robots.step(torque)
        fallen |= robots.fallen(robots.motion)
        speeds.append(np.where(fallen, 0.0, robots.motion.velocity[:, 0]))
        estimates.append(f_hat)
    return np.array(speeds), np.array(estimates), fallen


# --- run and picture --------------------------------------------------------------------------------------------------
if __name__ == "__main__":
    phases = 2.0 * np.pi * np.arange(8) / 8
    used, policy, phase = (each.ravel() for each in np.meshgrid([0.0, 1.0], range(3), phases, indexing="ij"))
    speeds, estimates, fallen = walk(used[:, None], policy, phase)
    t = dt * decimation * (1 + np.arange(len(speeds)))
    walked = np.where(fallen, 0.0, speeds[t > settled].mean(axis=0))  # a robot that fell stands still
    errors = np.abs(walked - speed).reshape(2, 3, 8).mean(axis=2)  # without and with, by policy
    figure, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(8, 5), layout="constrained")
    for row, name in enumerate(("without", "with PhyFilter")):
        each = ", ".join(f"{error:.2f}" for error in errors[row])
        print(f"{name:15} {errors[row].mean():.2f} m/s of 1 m/s missing, by policy {each}")
        above.plot(
            t, speeds[:, used == row].mean(axis=1), label=f"{name}: {errors[row].mean():.2f} m/s missing"
        )
    below.plot(t, estimates[:, used == 1.0][:, :, 2::3].mean(axis=1))
    above.axhline(speed, color="k", linestyle="--", linewidth=1)
    above.set(ylabel="forward speed [m/s]")
    above.legend()
    below.set(xlabel="t [s]", ylabel="f_hat of the knees [N m]")
    figure.savefig("example.png")
