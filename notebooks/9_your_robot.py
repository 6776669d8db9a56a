# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # 9 · Your own robot
#
# You have a log, a mass and a question: which force does my model miss? Here the log is of a multirotor of 1.5 kg in
# wind, simulated so that the answer is known, with the topics, rates and frames of PX4: world north-east-down, body
# forward-right-down. All that you write is a **robot file**; its keys are in
# [the page on robot files](../docs/your_robot.md).
#
# $$ m\,\dot v = R(q)\,e_z T - m\,G\,e_z + f $$

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.io import savemat
from scipy.spatial.transform import Rotation

import phyfilter_ctl as pf
from phyfilter_ctl.plots import COLOURS
from phyfilter_ctl.robot import describe_log

plt.rc("axes", prop_cycle=plt.cycler(color=COLOURS))
folder = Path(tempfile.mkdtemp())
MASS, GRAVITY, MOTOR_THRUST, TICK = 1.5, 9.80665, 7.0, 1e-3

# %% [markdown]
# ## A log
#
# The motors get a new command every 4 ms, the attitude is logged every 8 ms, the velocity every 20 ms with 3 % of its
# samples lost and 5 mm/s of noise.

# %%
rng = np.random.default_rng(0)
t = TICK * np.arange(40_001)


def wind(t):
    """Force, N: east, north, up."""
    return np.stack([1 + 0.8 * np.sin(1.3 * t), 0.6 * np.cos(0.9 * t) - 0.5, 0.4 * np.sin(2 * t)], axis=1)


def attitude(t):
    """Forward, left, up to east, north, up."""
    angles = [0.5 + 0.2 * t, 0.25 * np.sin(1.1 * t), -0.2 * np.sin(0.7 * t + 1.0)]
    return Rotation.from_euler("ZYX", np.stack(angles, axis=1))


commands = 1.03 + 0.15 * np.sin(3.0 * t[:-1:4]) + 0.02 * rng.standard_normal(10_000)
commands *= MASS * GRAVITY / (4 * MOTOR_THRUST)
acting = np.repeat(4 * MOTOR_THRUST * commands, 4)  # held for 4 ms
middle = t[:-1] + 0.5 * TICK
force = attitude(middle).apply(acting[:, None] * [0.0, 0.0, 1.0]) - [0.0, 0.0, MASS * GRAVITY] + wind(middle)
v = np.vstack([np.zeros(3), np.cumsum(force * TICK / MASS, axis=0)])

ned, frd = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]), np.diag([1.0, -1, -1])
slow = np.arange(0, len(t), 20)[rng.random(2001) > 0.03]
v_logged = (v[slow] + 0.005 * rng.standard_normal((len(slow), 3))) @ ned.T
q_logged = Rotation.from_matrix(ned @ attitude(t[::8]).as_matrix() @ frd).as_quat(scalar_first=True)
log = {
    "vehicle_local_position": {"time_s": t[slow], **dict(zip(("vx", "vy", "vz"), v_logged.T, strict=True))},
    "vehicle_attitude": {"time_s": t[::8], "q": q_logged},
    "actuator_motors": {"time_s": t[:-1:4], "control": np.repeat(commands[:, None], 4, axis=1)},
}
savemat(folder / "flight.mat", log)

# %% [markdown]
# ## What is in it
#
# `phyfilter-ctl log flight.mat` tells; with `--describe > robot.toml` it writes a first robot file, in which what
# has to be filled in is marked.

# %%
print(describe_log(pf.open_log(folder / "flight.mat")))

# %% [markdown]
# ## The robot file
#
# The preset knows PX4's topics; two numbers are ours.

# %%
(folder / "robot.toml").write_text("""
format = "phyfilter-robot"
version = 1
preset = "px4-multirotor"

[constants]
mass = 1.5           # kg
motor_thrust = 7.0   # N, of one motor at command 1
""")
robot = pf.Robot.load(folder / "robot.toml")
check = robot.check(folder / "flight.mat")
recording = check.recording
print(recording.describe())
print(check)

# %% [markdown]
# `g` is the mean of thrust and gravity over each step of the velocity, from the motors' and the attitude's own clocks:
# sampled at the velocity's times instead, it would be wrong by what the motors do in between: in the
# comparison below the error up, along the thrust, grows by 40 % (across it the filter's own lag hides it).
#
# ## The answer
#
# A filter of order 1 at 8 rad/s. Its error is that of its bandwidth, bounded by the wind's slope, and the noise.

# %%
filter = pf.lowpass(1, 8.0)
sampled = filter.sampled(0.02, nonfinite="hold")
f_hat = sampled.run(recording.x, recording.g, None, recording.inertia, recording.times)
now = np.minimum(np.round(recording.times / TICK).astype(int), len(acting) - 1)
g_now = attitude(recording.times).apply(acting[now, None] * [0.0, 0.0, 1.0]) - [0.0, 0.0, MASS * GRAVITY]
by_samples = sampled.run(recording.x, g_now, None, recording.inertia, recording.times)
settled = recording.with_signals(label=wind(recording.times)).segment(50, recording.n)
compared = settled.compare({"f_hat": f_hat[50:], "with g sampled": by_samples[50:]}, unit="N")
print(compared)
noise = float(np.sqrt(pf.error_variance(sampled, pf.Gaussian(noise=0.005 * MASS)).noise))
bound = [pf.error_bound(sampled, {1: slope}).bound for slope in (1.04, 0.54, 0.8)]  # N/s, of the wind
print(f"of which {noise:.3f} N is noise; without it at most {np.round(bound, 3)} N, by the wind's slope")
compared.plot()

# %% [markdown]
# ## What if the file is wrong?
#
# The quaternion read in another order, and twice the mass: both are noticed, and what would fit is named.

# %%
text = (folder / "robot.toml").read_text()
for change in (text + '\n[signals.q]\nrotation = "xyzw"\n', text.replace("mass = 1.5 ", "mass = 3.0 ")):
    (folder / "wrong.toml").write_text(change)
    for finding in pf.Robot.load(folder / "wrong.toml").check(folder / "flight.mat"):
        print(f"{finding.suspicion}: {finding}\n")

# %% [markdown]
# The same at the command line, with a suggested filter: `phyfilter-ctl estimate flight.mat --robot robot.toml`.

# %% tags=["remove-cell"]
rms, sampled_rms = compared.channel_rmse.values()
assert check.ok
assert np.all(rms < np.hypot(bound, noise))
assert noise < rms.min()
assert rms[2] < sampled_rms[2]
