# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # 2 · Frequency response and sampling
#
# A filter is designed in continuous time and runs on samples. What does that change, which sampling interval is short
# enough, and which details of the sampled filter decide its accuracy?

# %%
import matplotlib.pyplot as plt
import numpy as np

import phyfilter_ctl as pf
from phyfilter_ctl.filter import PaperFilter
from phyfilter_ctl.plots import COLOURS, dress

plt.rc("axes", prop_cycle=plt.cycler(color=COLOURS))

# %% [markdown]
# ## One filter, three sampling intervals
#
# Solid lines are $F$, dashed ones $1 - F$. Each sampled response ends at its Nyquist frequency. The filter knows a
# step's residual only as its average, yet sampling costs no delay: the curves leave each other near the Nyquist
# frequency only.

# %%
filter = pf.lowpass(3, 25.0, family="butterworth")
intervals = [0.002, 0.010, 0.018]
sampled = [filter.sampled(dt) for dt in intervals]
responses = pf.frequency_response([filter, *sampled], np.geomspace(1.0, 2000.0, 500))
responses.plot(labels=["continuous", *(f"{1e3 * dt:.0f} ms" for dt in intervals)])
late = {}
for name, response in zip(["continuous", *intervals], responses, strict=True):
    lag = 1e3 * (response.phase_lag(5.0) - responses[0].phase_lag(5.0)) / 5.0
    print(f"{name!s:>10}  bandwidth {response.bandwidth:5.2f} rad/s, at 5 rad/s later by {lag + 0.0:.3f} ms")
    late[name] = lag

# %% [markdown]
# ## The response is what a run does
#
# A residual of 5 and of 30 rad/s goes through the 18 ms filter as data: $\dot x = \gamma$, $g = f_\theta = 0$. The
# circles are the samples, the lines the response's amplitude and phase.

# %%
dt = intervals[-1]
t = dt * np.arange(400)
figure, axes = plt.subplots(1, 2, figsize=(9, 3), layout="constrained")
measured = {}
for axis, omega in zip(axes, (5.0, 30.0), strict=True):
    x, zero = -np.cos(omega * t)[:, None] / omega, np.zeros((400, 1))
    f_hat = filter.sampled(dt).run(x, zero, zero)[:, 0]
    F = pf.frequency_response(filter.sampled(dt), [omega]).F[0]
    fine = np.linspace(t[-1] - 0.7, t[-1], 500)
    axis.plot(fine, np.sin(omega * fine), color="0.7", label="residual")
    axis.plot(fine, np.imag(F * np.exp(1j * omega * fine)), label="from $F$")
    axis.plot(t, f_hat, "o", markersize=4, color=COLOURS[1], label="run")
    axis.set(xlabel="time [s]", ylabel=r"$\hat f$", xlim=(fine[0], fine[-1]), ylim=(-1.5, 1.5))
    dress(axis, f"{omega:g} rad/s")
    settled = t > 4.0
    measured[omega] = np.abs(f_hat - np.imag(F * np.exp(1j * omega * t)))[settled].max()
axes[0].legend(ncols=3, frameon=False, loc="upper center")
print({omega: f"{difference:.1e}" for omega, difference in measured.items()})

# %% [markdown]
# ## Exact, Euler, Tustin
#
# The paper steps its filter forward by Euler's rule. It agrees while the steps are short, peaks when they are not,
# and diverges in the end; such a filter is refused. The exact discretisation has no such limit.

# %%
fast = pf.lowpass(4, 50.0, family="butterworth")
methods = ["exact", "euler", "tustin"]
discretised = [fast.sampled(0.010, method=method) for method in methods]
responses = pf.frequency_response(discretised, np.geomspace(3.0, 314.0, 400))
figure, axis = plt.subplots(figsize=(8, 3), layout="constrained")
continuous = pf.frequency_response(fast, responses[0].omega)
axis.loglog(continuous.omega, np.abs(continuous.F), color="0.3", linestyle="--", label="continuous")
for method, response in zip(methods, responses, strict=True):
    axis.loglog(response.omega, np.abs(response.F), label=method)
axis.set(xlabel=r"$\omega$ [rad/s]", ylabel="$|F|$", ylim=(1e-3, 10))
axis.legend(frameon=False)
dress(axis, "Butterworth, order 4, 50 rad/s, sampled every 10 ms")
peaks = dict(zip(methods, (float(np.abs(r.F).max()) for r in responses), strict=True))
print({method: round(peak, 2) for method, peak in peaks.items()})
try:
    fast.sampled(0.018, method="euler")
    refused = ""
except ValueError as error:
    refused = str(error)
print(refused)

# %% [markdown]
# ## What happens between the samples
#
# $g$ may be a command that an actuator holds over the step, or the sample of a smooth signal. Say which: the wrong
# choice costs more than the whole filter gains.

# %%
dt, omega = 0.010, 8.0
t = dt * np.arange(2000)
smooth = np.sin(omega * t)[:, None]
f = 0.5 * np.cos(3.0 * t)[:, None]
x_smooth = -np.cos(omega * t)[:, None] / omega + 0.5 * np.sin(3.0 * t)[:, None] / 3.0  # x' = g + f
held = np.vstack([np.zeros((1, 1)), dt * np.cumsum(smooth[:-1], axis=0)])
x_held = held + 0.5 * np.sin(3.0 * t)[:, None] / 3.0
errors = {}
for case, x in {"smooth g": x_smooth, "held g": x_held}.items():
    for choice in ("average", "hold"):
        f_hat = filter.sampled(dt, g=choice).run(x, smooth, np.zeros_like(x))
        response = pf.frequency_response(filter.sampled(dt), [3.0]).F[0]
        ideal = 0.5 * np.real(response * np.exp(3j * t))[:, None]
        errors[case, choice] = np.abs(f_hat - ideal)[500:].max()
        print(f"{case:9} run as g={choice!r:10} stray error {errors[case, choice]:.4f}")

# %% [markdown]
# ## Noise against bandwidth
#
# The noise gain says how much of the sensor's white noise arrives in $\hat f$: the price of every rad/s.

# %%
dt = 0.002
bandwidths = np.geomspace(2.0, 100.0, 30)
figure, axis = plt.subplots(figsize=(8, 3), layout="constrained")
for order in (1, 2, 3, 4):
    family = [pf.lowpass(order, w, family="butterworth").sampled(dt) for w in bandwidths]
    axis.loglog(bandwidths, [pf.frequency_response(each).noise_gain for each in family], label=f"n = {order}")
axis.set(xlabel="bandwidth [rad/s]", ylabel="noise gain [1/s]")
axis.legend(frameon=False, ncols=4)
dress(axis, r"Standard deviation of $\hat f$ over that of the noise on x, 500 Hz")

# %% [markdown]
# ## Why not the paper's states
#
# The paper's Eq. (5) integrates $x$, $\hat f$ and $f_\theta$ openly and lets the growing integrals cancel. In single
# precision the cancellation fails within a minute; the recursion used here has no growing state.

# %%
slow = pf.place_poles([-20.0] * 3)
t = dt * np.arange(15_000)
x, zero = np.sin(0.5 * t)[:, None], np.zeros((15_000, 1))
reference = slow.sampled(dt).run(x, zero, zero)
figure, axis = plt.subplots(figsize=(8, 3), layout="constrained")
drift = {}
single = {"as printed": PaperFilter(slow, dt, "float32"), "sections": slow.sampled(dt, precision="float32")}
for realisation, sampled in single.items():
    drift[realisation] = np.abs(sampled.run(x, zero, zero) - reference)[:, 0]
    axis.semilogy(t[1:], np.maximum.accumulate(drift[realisation])[1:], label=realisation)
axis.set(xlabel="time [s]", ylabel=r"largest error so far [m/s$^2$]")
axis.legend(frameon=False)
dress(axis, "Three poles at 20 rad/s in float32, 500 Hz")

# %% tags=["remove-cell"]
assert max(abs(lag) for lag in late.values()) < 0.01
assert max(measured.values()) < 1e-3
assert peaks["exact"] < 1.05 < 1.5 < peaks["euler"]
assert "diverges" in refused
assert errors["smooth g", "average"] < 0.1 * errors["smooth g", "hold"]
assert errors["held g", "hold"] < 1e-6 < 0.01 < errors["held g", "average"]
assert drift["sections"].max() < 1e-6 < 1e-2 < drift["as printed"].max()
