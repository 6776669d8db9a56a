# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # 5 · From a diagram to C
#
# A cart is held at a set-point by a PD controller that knows its mass only roughly and nothing of the friction. The
# loop is wired with `control.interconnect`, as any python-control diagram. Then the same diagram is **flattened**
# into one model, **simulated** many times faster, and **handed over** as C and as an FMU that needs no Python.

# %%
import tempfile
import time
from pathlib import Path

import control as ct
import matplotlib.pyplot as plt
import numpy as np

import phyfilter_ctl as pf
from phyfilter_ctl.codegen import CompilerError, find_compiler
from phyfilter_ctl.plots import COLOURS, dress

plt.rc("axes", prop_cycle=plt.cycler(color=COLOURS))
rng = np.random.default_rng(0)
folder = Path(tempfile.mkdtemp())

# %% [markdown]
# ## The plant, written once
#
# States, inputs and parameters carry units. The result is a python-control system; its equations are CasADi
# expressions, so they can be linearised exactly and exported.


# %%
def equations(t, x, u, p):
    drag = p.friction * x.speed * pf.plants.norm(x.speed)  # what the controller does not know
    return {"position": x.speed, "speed": (u.force - drag - p.pull) / p.mass}


cart = pf.plant(
    equations,
    states={"position": (0.0, "m"), "speed": (0.0, "m/s")},
    inputs={"force": (0.0, "N")},
    params={"mass": (2.0, "kg"), "friction": (1.5, "N s^2/m^2"), "pull": (3.0, "N", "of a rope")},
    name="cart",
)
print(cart.describe())

# %% [markdown]
# ## The loop, wired with python-control
#
# The filter runs every 2 ms in this otherwise continuous diagram: `pf.sampled_block` makes it a block that
# `ct.interconnect` accepts. $x = m v$, and $g$ is the force that is applied. The inertia $\hat m$ = 1.8 kg, the
# channel and the units are said once, with the sampling: the block, the C code and the FMU take them from there.

# %%
filter = pf.lowpass(2, 20.0, family="butterworth")
sampled = filter.sampled(0.002, channels=["speed"], inertia=1.8, units={"x": "m/s", "g": "N", "f": "N"})
estimator = pf.sampled_block(sampled, name="phyfilter", f_theta=False)
controller = ct.nlsys(
    None,
    lambda t, x, u, p: [1.8 * (p["kp"] * (u[0] - u[1]) - p["kd"] * u[2]) - p["trust"] * u[3]],
    inputs=["goal", "position", "speed", "f_hat"],
    outputs=["force"],
    params={"kp": 9.0, "kd": 5.0, "trust": 1.0},
    name="pd",
)
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
pf.draw(loop, below=["phyfilter"])

# %% [markdown]
# Drawn, the diagram shows what was wired. Flattened, it is one model:

# %%
model = pf.flatten(loop)
print(model.describe())

# %% [markdown]
# Every parameter has its block's name, so two blocks can both have a `mass`. The sampled block is a task of its own,
# with its own period.
#
# ## Simulate
#
# `pf.simulate` takes the diagram or the flat model. With `trust = 0` the estimate is not used.

# %%
t = np.linspace(0.0, 6.0, 1201)
goal = 0.3 + 0.35 * (1 - np.tanh(8 * (t - 3.0)))  # from 1 m to 0.3 m
begun = time.perf_counter()
responses = {
    label: pf.simulate(model, t, goal, params={"pd.trust": trust})
    for label, trust in (("PD", 0.0), ("PD + filter", 1.0))
}
print(f"two runs of 6 s: {1e3 * (time.perf_counter() - begun):.0f} ms")

figure, (upper, lower) = plt.subplots(2, 1, figsize=(8, 4.5), sharex=True, layout="constrained")
for (label, response), colour in zip(responses.items(), (COLOURS[1], COLOURS[0]), strict=True):
    upper.plot(t, response.outputs[0], color=colour, label=label)
upper.plot(t, goal, "k--", linewidth=0.8, label="goal")
upper.set(ylabel="position [m]")
upper.legend(ncols=3, frameon=False)
lower.plot(t, responses["PD + filter"].outputs[1])
lower.set(xlabel="time [s]", ylabel=r"$\hat f$ [N]")
dress(upper, "The cart is pulled by a rope of which the controller knows nothing")
dress(lower, "What the filter finds: rope, friction and the error of the mass")

# %% [markdown]
# Many runs in one call: thirty carts of other masses, over the cores.

# %%
masses = rng.uniform(1.0, 4.0, 30)
batch = pf.simulate_batch(model, t, goal, params={"cart.mass": masses})
finals = np.array([run.outputs[0, -1] for run in batch])
figure, axis = plt.subplots(figsize=(8, 3), layout="constrained")
for run in batch:
    axis.plot(t, run.outputs[0], color=COLOURS[0], linewidth=0.7, alpha=0.5)
axis.plot(t, goal, "k--", linewidth=0.8)
axis.set(xlabel="time [s]", ylabel="position [m]")
dress(axis, "Masses from 1 to 4 kg, one controller made for 1.8 kg")
print(f"final position {finals.min():.4f} to {finals.max():.4f} m")

# %% [markdown]
# ## Hand over
#
# The filter as C for a microcontroller, with a program that checks itself; the whole loop as an FMU. Its inputs are
# held over a communication step, which is what remains of the difference. A compiler is needed for the FMU's binary;
# without one this notebook says so and stops at the C.

# %%
pf.export_c(sampled, folder / "firmware", real="float", name="cart_filter")
print(sorted(path.name for path in (folder / "firmware").iterdir()))
print((folder / "firmware" / "cart_filter.h").read_text().split("*/")[0])

try:
    find_compiler()
    compiler = True
except CompilerError as error:
    compiler = False
    print(error)

# %%
difference = 0.0
if compiler:
    fmu = pf.export_fmu(model, folder / "cart_loop.fmu", fmi="3.0", kinds=("cs",))
    run = pf.cosimulate({"cart": fmu}, t, inputs={"cart.goal": goal}, master=pf.fmi.Master(0.005))
    position = run.outputs["cart.position"]
    difference = np.abs(position - pf.simulate(model, t, goal, interpolation="hold").outputs[0]).max()
    size = fmu.stat().st_size / 1e3
    print(f"{fmu.name}: {size:.0f} kB; largest difference from the simulation {difference:.1e} m")

# %% tags=["remove-cell"]
without, repaired = (abs(response.outputs[0, -1] - 0.3) for response in responses.values())
assert repaired < 1e-3 < 0.1 < without
assert np.all(np.abs(finals - 0.3) < 1e-3)
assert difference < 1e-3
