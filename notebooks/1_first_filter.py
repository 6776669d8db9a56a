# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # 1 · A first filter
#
# A drone of known mass flies through gusts. Its model of the aerodynamic force was fitted at low speed and is wrong
# at high speed. We **choose** a filter, **understand** what it will do, **run** it on a log, **connect** it to a
# plant, and
# **keep** it in a file.
#
# $$ m\,\dot v = g + f, \qquad \hat f = f_\theta + F(s)\,\bigl(m\,\dot v - g - f_\theta\bigr) $$

# %%
import tempfile
from pathlib import Path

import control as ct
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import display

import phyfilter_ctl as pf
from phyfilter_ctl.plots import COLOURS, dress

plt.rc("axes", prop_cycle=plt.cycler(color=COLOURS))

# %% [markdown]
# ## Choose
#
# Two poles at 12 rad/s, low-pass; and the same poles with a numerator of type 2, which follows a ramp of the residual
# without a steady error. With the mouse: `pf.designer(lowpass)` here, or `phyfilter-ctl app` as a page of its own.

# %%
lowpass = pf.place_poles([-12.0, -12.0])
type2 = pf.place_poles([-12.0, -12.0], type=2)
print(type2.describe())
display(lowpass, type2)

# %% [markdown]
# ## Understand
#
# What passes ($F$) and what remains ($1 - F$), continuous and as sampled at 100 Hz. Type 2 suppresses slow residuals
# more steeply and pays with a peak.

# %%
dt = 0.01
responses = pf.frequency_response([lowpass, type2, type2.sampled(dt, g="average")])
responses.plot(labels=["low-pass", "type 2", "type 2, sampled"])
for name, response in zip(["low-pass", "type 2"], responses[:2], strict=True):
    peak = response.error_peak.value
    print(f"{name:9} bandwidth {response.bandwidth:5.1f} rad/s, peak of |1-F| {peak:.2f}")

# %% [markdown]
# ## Run
#
# The true force is quadratic drag with gusts. The model knows the drag up to 1.5 m/s and extrapolates it as a
# straight line. Velocities carry 3 mm/s of noise.

# %%
rng = np.random.default_rng(7)
mass, t = 1.2, np.arange(0.0, 40.0, dt)
v = np.stack([3.0 * np.sin(0.5 * t), 2.0 * np.sin(0.9 * t + 1.0)], axis=1)
v_rate = np.stack([1.5 * np.cos(0.5 * t), 1.8 * np.cos(0.9 * t + 1.0)], axis=1)
gusts = 0.4 * np.stack([np.sin(2.3 * t) + np.sin(0.7 * t), np.sin(1.7 * t)], axis=1)
f = -0.5 * v * np.abs(v) + gusts  # what acts
f_theta = -0.5 * v * np.minimum(np.abs(v), 1.5)  # what the model says
g = mass * v_rate - f  # thrust and gravity, known
log = pf.Recording.from_arrays(
    x=v + 0.003 * rng.standard_normal(v.shape),
    dt=dt,
    g=g,
    f_theta=f_theta,
    label=f,
    inertia=mass,
    channels=["vx", "vy"],
    unit="m/s",
)
print(log)


# %%
def rmse(estimate):
    return float(np.sqrt(np.mean((estimate - log.label) ** 2)))


estimates = {"model alone": log.f_theta}
for name, filter in {"low-pass": lowpass, "type 2": type2}.items():
    estimates[name] = filter.sampled(log.dt, g="average").run(log.x, log.g, log.f_theta, log.inertia)
for name, estimate in estimates.items():
    print(f"{name:12} RMSE {rmse(estimate):.3f} N")

figure, (upper, lower) = plt.subplots(2, 1, figsize=(8, 4.5), sharex=True, layout="constrained")
upper.plot(t, log.f_theta[:, 0], color=COLOURS[1], label=r"model $f_\theta$")
upper.plot(t, estimates["type 2"][:, 0], color=COLOURS[0], label=r"filtered $\hat f$")
upper.plot(t, log.label[:, 0], "k--", linewidth=0.8, label="true $f$")
upper.set(ylabel="force [N]", xlim=(0, 20))
upper.legend(ncols=3, frameon=False)
for name, colour in zip(estimates, (COLOURS[1], COLOURS[2], COLOURS[0]), strict=True):
    lower.plot(t, (estimates[name] - log.label)[:, 0], color=colour, label=name, linewidth=1)
lower.set(xlabel="time [s]", ylabel="error [N]")
lower.legend(ncols=3, frameon=False)
dress(upper, "Along x")
dress(lower, "What remains")

# %% [markdown]
# ## Connect
#
# The filter is a python-control system with named signals; `f_theta=False` leaves out those of a learned model. Here it
# closes the loop on a mass: the command subtracts what the filter estimates, and a constant push of 3 N soon stops
# accelerating it.

# %%
plant = ct.ss(
    [[0.0]],
    [[1 / mass, 1 / mass]],
    [[1.0]],
    [[0.0, 0.0]],
    inputs=["g[0]", "push"],
    outputs=["x[0]"],
    name="mass",
)
cancel = ct.ss([], [], [], [[-1.0]], inputs=["f_hat[0]"], outputs=["g[0]"], name="cancel")
loop = ct.interconnect(
    [plant, cancel, pf.phyfilter_block(lowpass, 1, inertia=mass, f_theta=False)],
    inputs=["push"],
    outputs=["x[0]", "f_hat[0]"],
)
time = np.linspace(0, 1.5, 151)
response = ct.forced_response(loop, time, np.full_like(time, 3.0))
figure, axis = plt.subplots(figsize=(8, 2.5), layout="constrained")
axis.axhline(3.0, color="0.3", linestyle="--", label="push [N]")
axis.plot(time, response.outputs[1], label=r"$\hat f$ [N]")
axis.plot(time, response.outputs[0], label="velocity [m/s]")
axis.set(xlabel="time [s]")
axis.legend(ncols=3, frameon=False)
dress(axis, "A constant push, found and cancelled")

# %% [markdown]
# ## Keep
#
# A filter on disk is a human-readable TOML file.

# %%
path = Path(tempfile.mkdtemp()) / "type2.toml"
units = {"x": "m/s", "g": "N", "f": "N"}
sampled = type2.sampled(dt, g="average", channels=["vx", "vy"], units=units)
pf.save(path, sampled)
print(path.read_text())
kept = pf.load(path)

# %% tags=["remove-cell"]
assert kept == sampled
assert rmse(estimates["low-pass"]) < 0.35 * rmse(estimates["model alone"])
assert rmse(estimates["type 2"]) < 0.25 * rmse(estimates["model alone"])
assert abs(response.outputs[1, -1] - 3.0) < 1e-3
