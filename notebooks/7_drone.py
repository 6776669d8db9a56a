# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # 7 · The drone
#
# An unknown mass, then a wind that no model was trained on. A quadrotor of 3 kg flies a circle of 1.5 m at 2 m/s. It
# carries a payload of unknown mass, for which there is a learned model: SEER-I, Chebyshev polynomials with an
# adaptive law, trained on payloads in still air. Then a fan is switched on.
#
# $$ m\,\dot v = \underbrace{T R e_z - m g e_z - R D R^\top v}_{g} + f, \qquad
# f = -\Delta m\,(\dot v + g e_z) + R D R^\top w $$
#
# The model knows the first half of $f$. The filter sees all of it through the velocity.
#
# The first half of this page needs no model: it is `models/drone/example.py`, a file to
# copy. The second adds SEER-I, with the study's modules (`phyfilter-ctl run drone` flies all methods).

# %%
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import display
from phyfilter_ctl.models.drone import example
from phyfilter_ctl.models.drone.comparison import compare
from phyfilter_ctl.models.drone.methods import NAMES
from phyfilter_ctl.models.drone.picture import draw

import phyfilter_ctl as pf
from phyfilter_ctl.plots import dress

plt.ion()  # draws figures that the package makes

# %% [markdown]
# ## The loop
#
# A `Multirotor` has the vehicle's numbers once. It makes the plant, both controllers, the delay and the known force; a
# filter of order 1 estimates the rest, with $f_\theta = 0$.

# %%
pf.draw(example.loop())

# %% [markdown]
# ## The flights
#
# Twenty payloads and winds. Each loop is as fast as a modulus margin of 0.5 and quiet rotors let it be.

# %%
runs = {"PD": example.fly(2.8, None), "PD + PhyFilter": example.fly(2.05, example.filter)}
for name, run in runs.items():
    print(f"{name:16}{100 * np.median(example.distance(run)):5.1f} cm from the circle")
figure = example.picture(runs)

# %% [markdown]
# ## How much wind?
#
# The same flights with the wind scaled, from none to one and a half times.

# %%
strengths = (0.0, 0.5, 1.0, 1.5)
figure, axis = plt.subplots(figsize=(8, 3.2), layout="constrained")
for name, loop in {"PD": (2.8, None), "PD + PhyFilter": (2.05, example.filter)}.items():
    error = np.array([100 * example.distance(example.fly(*loop, wind=wind)) for wind in strengths])
    (line,) = axis.plot(strengths, np.median(error, axis=1), "o-", label=name)
    axis.fill_between(strengths, error.min(axis=1), error.max(axis=1), color=line.get_color(), alpha=0.15)
axis.set(xlabel="wind, times a fan of 4 to 6 m/s", ylabel="mean |e| [cm]", ylim=(0, None))
axis.legend(frameon=False)
dress(axis, "Median and range of the flights")

# %% [markdown]
# ## With a learned model
#
# Every method has gains of its own, found by one procedure on flights with unknown mass in still air. None of them has
# met wind before.

# %%
methods = ("baseline", "seer", "observer", "phyfilter")
found = compare(range(4), methods=methods, duration=14.0)
training = found.training
print(f"SEER-I fits its training flights to {training.rmse:.3f} N of {training.label_rms:.1f} N\n")
still, windy = (found.mae(scenario) for scenario in ("mass", "wind"))
print(f"{'mean |e| [cm]':26}{'unknown mass':>13}{'and wind':>10}")
for name in methods:
    print(f"{NAMES[name]:26}{100 * still[name].value:13.1f}{100 * windy[name].value:10.1f}")

# %%
display(draw(found))

# %% [markdown]
# The model alone is best where it was trained and fails in the wind, which it mistakes for mass. The filter keeps the
# model's part and adds what the model misses; with $f_\theta = 0$ it is a disturbance observer, which estimates
# everything itself and lags behind all of it.

# %% tags=["remove-cell"]
wind, mass = ({name: value.value for name, value in part.items()} for part in (windy, still))
assert mass["seer"] < 0.5 * mass["baseline"]  # the model does what it was trained for
assert wind["seer"] > 4.0 * mass["seer"]  # and fails beyond
assert wind["phyfilter"] < 0.4 * wind["seer"]
assert wind["phyfilter"] < 0.4 * wind["baseline"]
without, filtered = (np.median(example.distance(run)) for run in runs.values())
assert filtered < 0.25 * without
