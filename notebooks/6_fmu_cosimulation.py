# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # 6 · FMUs and co-simulation
#
# An FMU is a model in a file that any simulation tool can run. Here the filter becomes one and gives somebody else's
# importer the same numbers, and a loop is cut into two FMUs that meet only at communication points.
#
# This notebook compiles. On a machine without any C compiler the next cell says so and stops.

# %%
import tempfile
from pathlib import Path

import control as ct
import fmpy
import matplotlib.pyplot as plt
import numpy as np

import phyfilter_ctl as pf
from phyfilter_ctl import fmi
from phyfilter_ctl.codegen import find_compiler
from phyfilter_ctl.plots import COLOURS, dress

plt.rc("axes", prop_cycle=plt.cycler(color=COLOURS))
folder = Path(tempfile.mkdtemp())
_ = find_compiler()

# %% [markdown]
# ## The filter as an FMU
#
# One sample per communication step. Names and units come with the filter; coefficients are tunable parameters.

# %%
dt = 0.01
filter = pf.lowpass(2, 20.0, family="butterworth")
units = {"x": "m/s", "g": "m/s2", "f": "m/s2"}
sampled = filter.sampled(dt, g="average", channels=["v"], units=units)
fmu = pf.export_fmu(sampled, folder / "phyfilter.fmu", fmi="2.0", kinds=("cs",))
print("\n".join(str(fmi.describe(fmu)).splitlines()[8:]))

# %% [markdown]
# `check` reads the archive, its description, units and structure, and then runs it:

# %%
report = fmi.check(fmu)
print("\n".join(str(report).splitlines()[1:]))

# %% [markdown]
# ## In another tool
#
# FMPy, for one, knows nothing of this toolbox. Inputs set at the beginning of a step appear in the outputs at its
# end; shifted by that step, the numbers are those of `run`.

# %%
rng = np.random.default_rng(3)
t = dt * np.arange(400)
g, f_theta = np.sin(2.0 * t), np.zeros_like(t)
f = np.where(t < 2.0, 0.8, -0.4) + 0.5 * np.sin(4.0 * t)
v = np.concatenate([[0.0], dt * np.cumsum(0.5 * (f + g)[1:] + 0.5 * (f + g)[:-1])])
v += 0.001 * rng.standard_normal(len(t))
recording = np.rec.fromarrays([t, v, g, f_theta], names=["time", "x[0]", "g[0]", "f_theta[0]"])
theirs = fmpy.simulate_fmu(
    fmu,
    stop_time=t[-1],
    step_size=dt,
    output_interval=dt,
    input=recording,
    output=["f_hat[0]"],
)["f_hat[0]"]
ours = sampled.run(v[:, None], g[:, None], f_theta[:, None])[:, 0]
largest = np.abs(theirs[1:] - ours[: len(theirs) - 1]).max()
print(f"largest difference {largest:.1e} m/s^2")

figure, axis = plt.subplots(figsize=(8, 3), layout="constrained")
axis.plot(t, f, color="0.3", linestyle="--", label="true $f$")
axis.plot(t, ours, label="run")
axis.plot(t[: len(theirs) - 1], theirs[1:], ":", color=COLOURS[1], linewidth=2, label="FMPy, a step earlier")
axis.set(xlabel="time [s]", ylabel="m/s$^2$")
axis.legend(ncols=3, frameon=False)
dress(axis, "A recorded velocity through the filter")

# %% [markdown]
# ## A loop in two FMUs
#
# The cart of notebook 5 under its PD controller. The body is one part, the computer with controller and filter the
# other; `export_ssp` makes an FMU of each and writes their wiring into a system structure package.


# %%
def equations(t, x, u, p):
    drag = p.friction * x.speed * pf.plants.norm(x.speed)
    return {"position": x.speed, "speed": (u.force - drag - p.pull) / p.mass}


cart = pf.plant(
    equations,
    states={"position": (0.0, "m"), "speed": (0.0, "m/s")},
    inputs={"force": (0.0, "N")},
    params={"mass": (2.0, "kg"), "friction": (1.5, "N s^2/m^2"), "pull": (3.0, "N")},
    name="cart",
)
controller = ct.nlsys(
    None,
    lambda t, x, u, p: [1.8 * (9.0 * (u[0] - u[1]) - 5.0 * u[2]) - u[3]],
    inputs=["goal", "position", "speed", "f_hat"],
    outputs=["force"],
    name="pd",
)
estimator = pf.sampled_block(filter.sampled(0.002), channels=1, name="phyfilter", inertia=1.8, f_theta=False)
loop = ct.interconnect(
    [cart, controller, estimator],
    connections=[
        ["cart.force", "pd.force"],
        ["pd.position", "cart.position"],
        ["pd.speed", "cart.speed"],
        ["pd.f_hat", "phyfilter.f_hat[0]"],
        ["phyfilter.x[0]", "cart.speed"],
        ["phyfilter.g[0]", "pd.force"],
    ],
    inplist=["pd.goal"],
    inputs=["goal"],
    outlist=["cart.position", "phyfilter.f_hat[0]"],
    outputs=["position", "f_hat"],
    name="cart_loop",
)
package = pf.export_ssp(loop, folder / "cart.ssp", split={"body": ["cart"], "computer": ["pd", "phyfilter"]})
print(f"{package.name}: {package.stat().st_size / 1e3:.0f} kB")
pf.draw(package)

# %% [markdown]
# ## How often must they talk?
#
# Each part advances on inputs that it holds. **Jacobi**: all on the values of the last communication point.
# **Gauss-Seidel**: the computer already sees where the body has got to. The reference is the undivided diagram.

# %%
t = 0.064 * np.arange(48)
reference = pf.simulate(loop, t, np.ones_like(t)).outputs[0]
steps = [0.002, 0.004, 0.008, 0.016, 0.032, 0.064]
schemes = {"Jacobi": ("jacobi", None), "Gauss-Seidel, body first": ("gauss-seidel", ["body", "computer"])}
runs = {
    (name, step): pf.cosimulate(
        package, t, inputs={"goal": 1.0}, master=fmi.Master(step, scheme, order=order)
    ).outputs[0]
    for name, (scheme, order) in schemes.items()
    for step in steps
}
apart = {name: [np.abs(runs[name, step] - reference).max() for step in steps] for name in schemes}

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
left.plot(t, reference, "k--", linewidth=1, label="undivided")
for name in schemes:
    left.plot(t, runs[name, steps[-1]], label=f"{name.split(',')[0]}, {1e3 * steps[-1]:.0f} ms")
    right.loglog([1e3 * step for step in steps], apart[name], "o-", markersize=4, label=name)
left.set(xlabel="time [s]", ylabel="position [m]")
right.set(xlabel="communication step [ms]", ylabel="largest difference [m]")
right.set_xticks([1e3 * step for step in steps], [f"{1e3 * step:.0f}" for step in steps])
right.minorticks_off()
left.legend(frameon=False)
right.legend(frameon=False)
dress(left, "The slowest conversation")
dress(right, "Distance from the undivided loop")

# %% [markdown]
# What an SSP cannot mend: a filter that holds $g$ and a controller whose command follows $\hat f$ at once belong into
# one part. Cut between them, they stay a sample apart at any communication step.

# %% tags=["remove-cell"]
assert report.ok
assert largest < 1e-12
assert apart["Gauss-Seidel, body first"][0] < 1e-3
assert all(np.diff(differences).min() > 0 for differences in apart.values())
assert all(gs < j for gs, j in zip(apart["Gauss-Seidel, body first"], apart["Jacobi"], strict=True))
