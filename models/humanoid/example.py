"""A humanoid held by one hand: a slow sideways force of 75 N for a minute, without and with PhyFilter.

    M v' = g + f        g by a twin: one step of the same robot from the measured state, without the force
    F_hat = argmin |J' F - f_hat|,   u = u*(F_hat) - K(F_hat) (x - x*(F_hat))      LQR about the posture under F_hat

python -m phyfilter_ctl.models.humanoid.example prints who stands and the force found, and saves example.png (ten
seconds; needs the extra mujoco). The study is ``phyfilter-ctl run humanoid``.
"""

# pyright: reportMissingImports=false
import matplotlib.pyplot as plt
import numpy as np
from phyfilter_ctl.models.humanoid.regulator import schedule
from phyfilter_ctl.models.humanoid.robot import load

import phyfilter_ctl as pf
from phyfilter_ctl.controllers import JointTorqueFilter
from phyfilter_ctl.plants import JointQuantities, JointSpacePrior

force = 75.0  # N, to the left: more than the LQR alone holds in this stance, less than with the filter
onset, rise, duration = 1.0, 2.0, 61.0  # s: when the force begins, how long it grows, the trial
noise = 0.003  # rad/s and m/s, of the measured velocities
dt = 0.005  # s


def make_filter():
    """Order 1 at 3 rad/s, over all 27 rows of v; g is that of the twin."""
    prior = JointSpacePrior(inertia="full", bias="none", contact="omitted")
    return JointTorqueFilter(pf.lowpass(1, 3.0).sampled(dt, g="hold"), prior)


def trial(humanoid, postures, filtered):
    """Times, forces and their estimates, and how far the centre of mass moved to the left, until the end or a fall."""
    step = humanoid.mujoco.mj_step
    robot, twin, rng = humanoid.data(), humanoid.data(), np.random.default_rng(100)
    robot.qpos[:] = postures.upright.q
    humanoid.mujoco.mj_forward(humanoid.model, robot)
    start, rows = robot.subtree_com[1].copy(), []
    filter, F_hat = make_filter(), np.zeros(2)
    state = filter.start(robot.qvel)
    for k in range(round(duration / dt)):
        # The loop: an LQR about the posture for the force that was found.
        v = robot.qvel + noise * rng.standard_normal(humanoid.nv)
        target, feedforward, K = postures.at(humanoid, F_hat if filtered else np.zeros(2))
        error = np.concatenate([humanoid.difference(target, robot.qpos), v])
        robot.ctrl[:] = np.clip(feedforward - K @ error, -1.0, 1.0)
        # The known part: a step of the twin from what is measured, without the force.
        twin.qpos[:], twin.qvel[:], twin.ctrl[:] = robot.qpos, v, robot.ctrl
        twin.qacc_warmstart[:] = robot.qacc_warmstart
        step(humanoid.model, twin)
        M = humanoid.implicit_inertia(twin)
        g = M @ (twin.qvel - v) / dt
        # The robot's own step, under the force.
        F = force * np.clip((k * dt - onset) / rise, 0.0, 1.0)
        humanoid.pull(robot, [0.0, F, 0.0])
        step(humanoid.model, robot)
        # The filter, and the force on the hand that explains most of what it found.
        after = robot.qvel + noise * rng.standard_normal(humanoid.nv)
        state, f_hat = filter.step(state._replace(qd=v), after, JointQuantities(after, M), g)
        J = humanoid.hand_jacobian(twin)
        F_hat = np.linalg.solve(J @ J.T, J @ f_hat)[:2]
        moved = robot.subtree_com[1] - start
        rows.append(((k + 1) * dt, F, F_hat[1], moved[1]))
        if moved[2] < -0.25 * start[2]:
            break
    return np.array(rows).T


if __name__ == "__main__":
    humanoid = load()  # dm_control's: 40.8 kg, 21 motors
    postures = schedule(humanoid, "wide")  # at rest under -120 to 120 N, and the LQR about each
    figure, (centres, forces) = plt.subplots(2, 1, sharex=True, figsize=(8, 5), layout="constrained")
    for name, filtered in (("without", False), ("with PhyFilter", True)):
        t, F, found, left = trial(humanoid, postures, filtered)
        stood = t[-1] > duration - dt
        said = f"{name}: " + (
            f"stands for {duration - onset:.0f} s" if stood else f"falls after {t[-1] - onset:.1f} s"
        )
        print(said)
        centres.plot(t, 100.0 * left, label=said)
    print(f"force found {found[t > duration - 1.0].mean():.1f} N, in truth {force:.1f} N")
    forces.plot(t, found, t, F, "k--")
    centres.set(ylabel="centre of mass, to the left [cm]", ylim=(-40.0, 40.0))
    centres.legend()
    forces.set(xlabel="t [s]", ylabel="force and its estimate [N]")
    figure.savefig("example.png")
