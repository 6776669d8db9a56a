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
# load, the wind. For the first there is a learned model, SEER-I. Force and torque each get a filter:
#
# $$ \hat f = f_\theta + F(s)\,(m \dot v - g - f_\theta), \qquad
#    \hat\tau = \tau_\theta + F_\tau(s)\,(J \dot\omega - g_\tau - \tau_\theta) $$
#
# The vehicle, its numbers and the tuning are in `models/aerial_manipulator`; here are four missions of a few methods
# (`phyfilter-ctl run aerial_manipulator` flies twenty of all).

# %%
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import display
from phyfilter_ctl.models.aerial_manipulator.comparison import compare
from phyfilter_ctl.models.aerial_manipulator.experiment import fly
from phyfilter_ctl.models.aerial_manipulator.methods import NAMES
from phyfilter_ctl.models.aerial_manipulator.mission import arm, home_offset, reference
from phyfilter_ctl.models.aerial_manipulator.picture import COLOURS, draw

from phyfilter_ctl.plants import coupling_force
from phyfilter_ctl.plots import dress

plt.ion()  # draws figures that the package makes
methods = ("baseline", "integral", "observer", "phyfilter")
seeds = range(4)

# %% [markdown]
# ## What an arm does to its platform
#
# The arm's links hang from the platform and accelerate against it. On a level platform at rest, the force is the weight
# plus what it takes to move the centre of mass: swing the shoulder, and the platform feels it.

# %%
links = arm()
print(
    f"{links.joints} joints, {links.mass:.2f} kg, gripper at home {home_offset().round(3)} m from the platform"
)
at_rest = {"q": np.array([1.0, 0.0, 0.0, 0.0])} | dict.fromkeys(
    ("omega", "v_rate", "omega_rate"), np.zeros(3)
)
t = np.linspace(0.0, 2.0, 200)
swing = 4.5  # rad/s
force = []
for now in t:
    angle, rate, acceleration = np.zeros((3, links.joints))
    angle[1], rate[1], acceleration[1] = (
        0.3 * np.sin(swing * now),
        0.3 * swing * np.cos(swing * now),
        -0.3 * swing**2 * np.sin(swing * now),
    )
    motion = links.motion(links.home + angle, rate, joint_acceleration=acceleration)
    force.append(np.asarray(coupling_force(motion, **at_rest)))
figure, axis = plt.subplots(figsize=(8, 2.6), layout="constrained")
axis.plot(t, np.array(force)[:, 0], label="forwards")
axis.plot(t, np.array(force)[:, 2] + links.mass * 9.81, label="upwards, less the weight")
axis.set(xlabel="Time [s]", ylabel="N")
axis.legend(frameon=False)
dress(axis, "Force of an arm whose shoulder swings by 0.3 rad")

# %% [markdown]
# ## The plan
#
# A quadratic program every 70 ms shares the way between platform and arm, within the limits of both. It starts from its
# own plan, so every flight has the same references, and both windows begin with the gripper on the spot.

# %%
goals = reference()
milliseconds = 1e3 * np.array(goals.path.solve_seconds)
print(
    f"{len(milliseconds)} plans, all {'/'.join(sorted(set(goals.path.statuses)))}, "
    f"the slowest per cent {np.percentile(milliseconds, 99):.1f} ms"
)
figure, (platform, gripper) = plt.subplots(1, 2, figsize=(9, 2.8), layout="constrained")
for i, name in enumerate("xyz"):
    platform.plot(goals.time, goals.r[:, i], label=name)
    gripper.plot(goals.time, 100.0 * (goals.offset[:, i] - home_offset()[i]), label=name)
platform.set(xlabel="Time [s]", ylabel="m")
gripper.set(xlabel="Time [s]", ylabel="cm")
platform.legend(frameon=False, ncols=3)
dress(platform, "Platform")
dress(gripper, "Gripper from where home has it")

# %% [markdown]
# ## The missions
#
# Every method has gains of its own, from one procedure: the least error on missions in still air, at a modulus margin
# of at least 0.5 in all six channels, with quiet rotors. None of them has met wind before.

# %%
found = compare(seeds, methods=methods, cases=("mission",))
print(
    f"{'largest |e| [cm]':26}{'mean':>8}{'grasp':>8}{'place':>8}{'lift-off':>10}{'grasped':>9}{'placed':>8}"
)
for name in methods:
    score = found.scores["mission", name]
    columns = (score.mean, score.grasp, score.settle, score.lift_off)
    print(
        f"{NAMES[name]:26}"
        + "".join(f"{100 * np.median(v):{w}.2f}" for v, w in zip(columns, (8, 8, 8, 10), strict=True))
        + f"{score.grasped.sum():9d}{score.placed.sum():8d}"
    )

# %%
display(draw(found))

# %% [markdown]
# The filters answer wind and load within half a second; integral action takes several, and its place window comes too
# early. The observer, which has no model, is as good as the model with a filter: the mission's motions are slow, and
# what the arm does then is small beside the wind.
#
# ## An arm that helps
#
# The platform's error is measured. If the arm makes up half of it, every window holds, and integral action does as
# well. It costs stability margin: the arm pushes back on the platform.

# %%
shares = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
figure, axis = plt.subplots(figsize=(8, 3.0), layout="constrained")
worst = {}
for name in ("integral", "phyfilter"):
    worst[name] = np.array(
        [
            fly(found.methods[name].method, seeds, found.training.seer, others={"controller.arm.share": s})
            .score()
            .windows.max()
            for s in shares
        ]
    )
    axis.plot(100 * shares, 100 * worst[name], "o-", color=COLOURS[name], markersize=4, label=NAMES[name])
axis.axhline(100 * found.mission.tolerance, color="k", ls=":", lw=0.8)
axis.set(xlabel="share of the platform's error, %", ylabel="worst |e| in a window [cm]", ylim=(0, None))
axis.legend(frameon=False)
dress(axis, "The arm makes up for the platform")

# %% [markdown]
# The figures this notebook stands for:

# %%
ours, theirs = (found.scores["mission", name] for name in ("phyfilter", "baseline"))
assert ours.grasped.all()
assert not theirs.grasped.any()
assert np.median(ours.mean) < 0.2 * np.median(theirs.mean)
assert worst["phyfilter"][2] < found.mission.tolerance
