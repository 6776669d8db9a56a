# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # 3 · Learn the filter
#
# Poles placed by hand stop being intuitive beyond order 2. Where a flight has a **label**, the true $f$ (from motion
# capture, say), the filter follows from it by least squares. Here a log is generated, filters of several orders are
# learned, and each is held against the best that any causal linear filter could do: the **Wiener floor**.
#
# $$ \min_F \sum_k \bigl|\gamma^*_k - (F u)_k\bigr|^2, \qquad \gamma^* = f - f_\theta, \qquad
# u = M\dot x - g - f_\theta \ \text{ measured over each step} $$

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import phyfilter_ctl as pf
from phyfilter_ctl.plots import COLOURS, dress

plt.rc("axes", prop_cycle=plt.cycler(color=COLOURS))

# %% [markdown]
# ## Flights with a label
#
# A mass is pushed by what its model leaves out: two slow oscillations and gusts of 0.15 s. Its velocity is measured
# every 5 ms with 3 mm/s of noise. One flight is learned from, another is kept back.

# %%
dt, n = 0.005, 6000


def flight(seed, name):
    rng = np.random.default_rng(seed)
    t = dt * np.arange(n)
    gust = np.zeros((n, 2))
    for k in range(1, n):  # white noise through a first-order lag
        gust[k] = gust[k - 1] * (1 - dt / 0.15) + np.sqrt(2 * dt / 0.15) * rng.standard_normal(2)
    phase = rng.uniform(0, 2 * np.pi, (2, 2))
    f = 2.0 * np.sin(3.0 * t[:, None] + phase[0]) + 1.0 * np.sin(11.0 * t[:, None] + phase[1]) + 0.6 * gust
    g = -1.5 * np.cos(0.8 * t[:, None] + phase[0])  # known thrust
    f_theta = 0.7 * np.sin(3.0 * t[:, None] + phase[0])  # the model has a part of it
    v = dt * np.cumsum(np.vstack([np.zeros((1, 2)), 0.5 * (f[1:] + f[:-1]) + g[:-1]]), axis=0)
    measured = v + 0.003 * rng.standard_normal((n, 2))
    return pf.Recording.from_arrays(
        x=measured, dt=dt, g=g, f_theta=f_theta, label=f, channels=["vx", "vy"], unit="m/s", name=name
    )


log, kept_back = flight(1, "learned from"), flight(2, "kept back")
print(log)

# %% [markdown]
# ## Learn
#
# One call: no start, no learning rate. The orders below are learned on the way and warm-start the next.

# %%
result = pf.learn(log, 3, held_out=kept_back, shape="general")
print(result.filter.describe())
print()
print(f"{result.status}: {result.message}")
print(f"RMSE {result.rmse:.4f} on the flight learned from, {result.held_out_rmse:.4f} on the one kept back")
low, high = result.wiener_interval
print(f"{result.wiener_ratio:.3f} times the Wiener floor (95 % interval {low:.3f} to {high:.3f})")

# %% [markdown]
# Every line above the frequency response is one descent. They all end on the same few costs. Below, the filter beside
# the Wiener filter, an impulse response of many free taps: where the two agree, nothing is left to learn.

# %%
_ = result.plot()

# %% [markdown]
# What the learned filter makes of the flight that it has not seen:


# %%
def estimate(filter, flight):
    return filter.sampled(dt).run(flight.x, flight.g, flight.f_theta)


t = dt * np.arange(n)
figure, axis = plt.subplots(figsize=(8, 3), layout="constrained")
axis.plot(t, kept_back.f_theta[:, 0], color=COLOURS[1], label=r"model $f_\theta$")
axis.plot(t, estimate(result.filter, kept_back)[:, 0], color=COLOURS[0], label=r"learned filter $\hat f$")
axis.plot(t, kept_back.label[:, 0], "k--", linewidth=0.8, label="true $f$")
axis.set(xlabel="time [s]", ylabel="force [N]", xlim=(10, 16), ylim=(-6, 4))
axis.legend(ncols=3, frameon=False, loc="lower right")
dress(axis, "The flight kept back, along x")

# %% [markdown]
# ## Which order?
#
# The low-pass form ($N = a_0$) follows constants whatever its poles are; the general form is free in $N$ and contains
# every lower order, so its cost never rises. Where one more pole does not pay in the low-pass form, the lower order
# is returned, and the result says so.

# %%
table = {}
print(f"{'':20}{'learned from':>14}{'kept back':>11}{'to the floor':>14}")
for form in ("lowpass", "general"):
    for order in (1, 2, 3, 4):
        row = table[form, order] = pf.learn(log, order, held_out=kept_back, shape=form)
        print(
            f"{form:12}n = {order:<4}{row.rmse:>14.4f}{row.held_out_rmse:>11.4f}{row.wiener_ratio:>14.3f}"
            f"   {row.status}" + (f", order {row.order_used}" if row.order_used < order else "")
        )

# %% [markdown]
# ## Beside a filter placed by hand
#
# Two equal poles, the best of a sweep made on the very same flight.


# %%
def rmse(filter, flight):
    return float(np.sqrt(np.mean((estimate(filter, flight) - flight.label)[1:] ** 2)))


poles = np.geomspace(2.0, 200.0, 40)
swept = [rmse(pf.place_poles([-p, -p]), log) for p in poles]
by_hand = pf.place_poles([-poles[np.argmin(swept)]] * 2)

figure, axis = plt.subplots(figsize=(8, 3), layout="constrained")
axis.semilogx(poles, swept, label="two equal poles")
for (form, order), row in table.items():
    if order == 2:
        size = np.exp(np.mean(np.log(np.abs(row.filter.poles))))
        axis.plot(size, row.rmse, "*", markersize=12, label=f"learned, {form}, n = 2")
axis.axhline(result.wiener.rmse, color="0.4", linestyle="--", label="Wiener filter, held out")
axis.set(xlabel="pole [rad/s]", ylabel="RMSE [N]")
axis.legend(frameon=False)
dress(axis, "Swept by hand, learned, and what is possible")

# %% [markdown]
# ## Keep
#
# The learned filter is a `PhyFilter` like any other: it is saved in a human-readable file and comes back bit for
# bit.

# %%
path = Path(tempfile.mkdtemp()) / "learned.toml"
sampled = result.filter.sampled(dt, channels=["vx", "vy"], units={"x": "m/s", "f": "N"})
pf.save(path, sampled)
print(path.read_text())
again = pf.load(path)

# %% [markdown]
# The command line does all of this on CSV files: `phyfilter-ctl learn LOG.csv --order 1 2 3 --out filter.toml
# --picture learned.png`.

# %% tags=["remove-cell"]
assert again == sampled
assert abs(rmse(result.filter, log) - result.rmse) < 1e-9 * result.rmse  # the filter, run
costs = [table["general", order].rmse for order in (1, 2, 3, 4)]
assert np.all(np.diff(costs) <= 1e-9)
assert table["lowpass", 2].rmse <= min(swept)
assert result.rmse < 0.96 * min(swept)
assert result.held_out_rmse < rmse(by_hand, kept_back)
assert result.wiener_ratio < 1.05
