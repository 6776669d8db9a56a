# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # 8 · The aerial manipulator
#
# A multirotor with an arm of five joints picks 0.3 kg from a stand and places it 1.2 m further, in the jet of a fan.
# Its gripper has to stay within 2.5 cm. Three disturbances are unknown to every controller: the arm's own inertia, the
# load, the wind. Force and torque each get a filter:
#
# $$ \hat f = f_\theta + F(s)\,(m \dot v - g - f_\theta), \qquad
#    \hat\tau = \tau_\theta + F_\tau(s)\,(J \dot\omega - g_\tau - \tau_\theta) $$
#
# Here neither has a model ($f_\theta = 0$). All of it is one file to copy, `models/aerial_manipulator/example.py`;
# `phyfilter-ctl run aerial_manipulator` flies the study, with SEER-I.

# %%
import matplotlib.pyplot as plt
import numpy as np
from phyfilter_ctl.models.aerial_manipulator.example import (
    arm,
    fly,
    gripper,
    loop,
    picture,
    references,
    strayed,
    t,
)

from phyfilter_ctl.plants import coupling_force
from phyfilter_ctl.plots import dress

plt.ion()  # draws figures that the package makes
seeds = range(6)

# %% [markdown]
# ## What an arm does to its platform
#
# The arm's links hang from the platform and accelerate against it. On a level platform at rest, the force is the weight
# plus what it takes to move the centre of mass: swing the shoulder, and the platform feels it.

# %%
print(f"{arm.joints} joints, {arm.mass:.2f} kg, gripper at home {gripper.round(3)} m from the platform")
at_rest = {"q": np.array([1.0, 0.0, 0.0, 0.0])} | dict.fromkeys(
    ("omega", "v_rate", "omega_rate"), np.zeros(3)
)
swing, shoulder = 4.5, np.eye(arm.joints)[1]  # rad/s; which joint
times = np.linspace(0.0, 2.0, 200)
force = []
for now in times:
    angle, rate = 0.3 * np.sin(swing * now), 0.3 * swing * np.cos(swing * now)
    motion = arm.motion(
        arm.home + angle * shoulder, rate * shoulder, joint_acceleration=-(swing**2) * angle * shoulder
    )
    force.append(np.asarray(coupling_force(motion, **at_rest)))
figure, axis = plt.subplots(figsize=(8, 2.6), layout="constrained")
axis.plot(times, np.array(force)[:, 0], label="forwards")
axis.plot(times, np.array(force)[:, 2] + arm.mass * 9.81, label="upwards, less the weight")
axis.set(xlabel="Time [s]", ylabel="N")
axis.legend(frameon=False)
dress(axis, "Force of an arm whose shoulder swings by 0.3 rad")

# %% [markdown]
# ## The plan
#
# A quadratic program every 70 ms shares the way between platform and arm, within the limits of both. It starts from its
# own plan, so every flight has the same references, and both windows begin with the gripper on the spot.

# %%
goals = references()
figure, (platform, reach) = plt.subplots(1, 2, figsize=(9, 2.8), layout="constrained")
platform.plot(t, goals[:3].T, label=list("xyz"))
reach.plot(t, 100.0 * (goals[12:15].T - gripper))
platform.set(xlabel="Time [s]", ylabel="m")
reach.set(xlabel="Time [s]", ylabel="cm")
platform.legend(frameon=False, ncols=3)
dress(platform, "Platform")
dress(reach, "Gripper from where home has it")

# %% [markdown]
# ## The missions
#
# Each loop has gains of its own, from one procedure: the least error on missions in still air, at a modulus margin of
# at least 0.5 in all six channels, with quiet rotors. None of them has met wind before.

# %%
loops = {
    "PD": loop((3.0, 3.8), 0.0, 0.56, None),
    "integral action": loop((3.05, 3.25), 0.636, 0.56, None),
    "PhyFilters": loop(),
}
runs = {name: fly(closed, goals, seeds) for name, closed in loops.items()}
print(f"{'largest |e| [cm], median':26}{'grasp':>8}{'place':>8}")
for name, run in runs.items():
    print(f"{name:26}" + "".join(f"{100 * np.median(strayed(run, w)):8.2f}" for w in ("grasp", "place")))
figure = picture(runs, goals)

# %% [markdown]
# The filters answer wind and load within half a second; integral action takes several, and its place window comes too
# early.
#
# ## An arm that helps
#
# The platform's error is measured. If the arm makes up half of it, every window holds, and integral action does as
# well. It costs stability margin: the arm pushes back on the platform.

# %%
shares = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
figure, axis = plt.subplots(figsize=(8, 3.0), layout="constrained")
worst = {}
for name in ("integral action", "PhyFilters"):
    helped = [fly(loops[name], goals, seeds, {"arm.share": share}) for share in shares]
    worst[name] = [max(strayed(run, window).max() for window in ("grasp", "place")) for run in helped]
    axis.plot(100 * shares, 100 * np.array(worst[name]), "o-", markersize=4, label=name)
axis.axhline(2.5, color="k", ls=":", lw=0.8)
axis.set(xlabel="share of the platform's error, %", ylabel="worst |e| in a window [cm]", ylim=(0, None))
axis.legend(frameon=False)
dress(axis, "The arm makes up for the platform")

# %% tags=["remove-cell"]
held = {name: strayed(run, "grasp") < 0.025 for name, run in runs.items()}
assert held["PhyFilters"].all()
assert not held["PD"].any()
assert worst["PhyFilters"][2] < 0.025
