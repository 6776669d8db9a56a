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
# The model knows the first half of $f$. The filter sees all of it through the velocity. The vehicle, its numbers
# and the tuning are in `models/drone`; here are four short flights of a few methods (`phyfilter-ctl run drone` flies
# all).

# %%
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import display
from phyfilter_ctl.models.drone.comparison import compare
from phyfilter_ctl.models.drone.diagram import build
from phyfilter_ctl.models.drone.experiment import fly
from phyfilter_ctl.models.drone.flights import conditions
from phyfilter_ctl.models.drone.methods import NAMES
from phyfilter_ctl.models.drone.params import params
from phyfilter_ctl.models.drone.picture import COLOURS, draw

from phyfilter_ctl.plots import dress

plt.ion()  # draws figures that the package makes
methods = ("baseline", "seer", "observer", "phyfilter")
seeds, duration = range(4), 14.0

# %% [markdown]
# ## The loop
#
# One python-control diagram: delayed commands, vehicle, wind and sensors, the controllers, the estimator.

# %%
loop = build()
print(
    f"{loop.ninputs} inputs of noise, outputs",
    ", ".join(dict.fromkeys(n.split("[")[0] for n in loop.output_labels)),
)

# %% [markdown]
# ## The flights
#
# Every method has gains of its own, found by one procedure: the least error on flights with unknown mass in still
# air, with a modulus margin of at least 0.5 and quiet rotors. None of them has met wind before.

# %%
found = compare(seeds, methods=methods, duration=duration)
training = found.training
print(f"SEER-I fits its training flights to {training.rmse:.3f} N of {training.label_rms:.1f} N\n")
still, windy = (found.mae(scenario) for scenario in ("mass", "wind"))
print(f"{'mean |e| [cm]':26}{'unknown mass':>13}{'and wind':>10}{'estimator':>12}{'margin':>8}")
for name in methods:
    entry = found.methods[name]
    rate = f"{entry.method.bandwidth:.1f} rad/s" if entry.method.tunable else ""
    print(
        f"{NAMES[name]:26}{100 * still[name].median:13.1f}{100 * windy[name].median:10.1f}"
        f"{rate:>12}{entry.modulus_margin:8.2f}"
    )

# %%
display(draw(found))

# %% [markdown]
# The model alone is best where it was trained and fails in the wind, which it mistakes for mass. The filter keeps the
# model's part and adds what the model misses; with $f_\theta = 0$ it is a disturbance observer, which estimates
# everything itself and lags behind all of it.
#
# ## How much wind?
#
# The same flights with the wind scaled, from none to one and a half times.

# %%
strengths = np.array([0.0, 0.5, 1.0, 1.5])
errors = {
    name: np.array(
        [
            fly(
                found.methods[name].method,
                conditions(seeds, "wind", strength=strength),
                training.model,
                duration=duration,
            )
            .score()
            .total
            for strength in strengths
        ]
    )
    for name in methods
}
figure, axis = plt.subplots(figsize=(8, 3.2), layout="constrained")
for name, error in errors.items():
    axis.plot(
        strengths, 100 * np.median(error, axis=1), "o-", color=COLOURS[name], markersize=4, label=NAMES[name]
    )
    axis.fill_between(
        strengths,
        100 * error.min(axis=1),
        100 * error.max(axis=1),
        color=COLOURS[name],
        alpha=0.15,
        linewidth=0,
    )
low, high = params().wind.jet_speed_low, params().wind.jet_speed_high
axis.set(xlabel=f"wind, times a fan of {low:g} to {high:g} m/s", ylabel="mean |e| [cm]", ylim=(0, None))
axis.legend(frameon=False)
dress(axis, "Median and range of four flights")

# %% [markdown]
# The figures this notebook stands for:

# %%
wind, mass = ({name: value.median for name, value in part.items()} for part in (windy, still))
assert mass["seer"] < 0.5 * mass["baseline"]  # the model does what it was trained for
assert wind["seer"] > 4.0 * mass["seer"]  # and fails beyond
assert wind["phyfilter"] < 0.4 * wind["seer"]
assert wind["phyfilter"] < 0.4 * wind["baseline"]
