# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # 4 · What a filter promises
#
# The paper proves that the estimation error ends in a ball "proportional to" its forcing and that a wrong inertia
# never breaks stability. Here both become numbers: the bound itself, as tight as it can be, and the point at which
# the second statement stops being true.

# %%
import control as ct
import matplotlib.pyplot as plt
import numpy as np

import phyfilter_ctl as pf
from phyfilter_ctl.design import optimal
from phyfilter_ctl.plots import COLOURS, dress

plt.rc("axes", prop_cycle=plt.cycler(color=COLOURS))

# %% [markdown]
# ## How large can the error become?
#
# Let the residual $\gamma = f - f_\theta$ change by at most 3 N/s. The worst case is the $L_1$ norm of the response
# from $\dot\gamma$ to the error, and a bang-bang residual attains it.

# %%
filter = pf.lowpass(3, 20.0, family="butterworth")
result = pf.error_bound(filter, {1: 3.0})
print(f"|f - f_hat| <= {result.bound:.6f} N, certified to {result.certificate.gap:.1e}")

t = np.linspace(0.0, 1.0, 4001)
slope = result.worst_residual(t)
gamma = np.concatenate([[0.0], np.cumsum(slope[:-1]) * t[1]])
error = gamma - ct.forced_response(ct.ss(filter.transfer_function), t, gamma).outputs
print(f"reached in simulation: {np.abs(error).max():.6f} N")
_ = result.plot()

# %% [markdown]
# Bounds from quadratic Lyapunov functions answer the same question less sharply. What the textbook's formula costs
# depends on the coordinates it is written in:

# %%
for method in ("exact", "ellipsoid", "lyapunov", "lyapunov-raw"):
    print(f"{method:14}{pf.error_bound(filter, {1: 3.0}, method=method).bound:12.4g} N")

# %% [markdown]
# ## How wrong may the inertia be?
#
# With $\hat f$ fed back, $\tau = \tau_0 - \hat f$, the ratio $\hat M / M$ enters the loop. Filters of order 1 and 2
# tolerate any ratio; from order 3 on there is a limit, and lag or delay of the actuator lowers all of them.

# %%
lag = ct.tf([1.0], [0.05, 1.0])
print(f"{'order':>5} {'ideal actuator':>16} {'50 ms lag, 10 ms delay':>24}")
limits, lagging = {}, {}
for order in (1, 2, 3, 4, 5):
    f = pf.place_poles([-20.0] * order)
    limits[order] = pf.margins(f).max_ratio
    lagging[order] = pf.margins(f, pf.Loop(actuator=lag, delay=0.01)).max_ratio
    print(f"{order:5} {limits[order]:16.3f} {lagging[order]:24.3f}")

# %% [markdown]
# The faster the filter, the less inertia error it tolerates once the actuator lags:

# %%
bandwidths = np.geomspace(1.0, 100.0, 25)
figure, axis = plt.subplots(figsize=(8, 3), layout="constrained")
for order in (1, 2, 3):
    allowed = [
        pf.margins(pf.place_poles([-p] * order), pf.Loop(actuator=lag, delay=0.01)).max_ratio
        for p in bandwidths
    ]
    axis.loglog(bandwidths, allowed, label=f"n = {order}")
axis.axhline(1.0, color="0.4", linestyle="--")
axis.annotate("exact inertia", (1.1, 1.0), (0, 4), textcoords="offset points", color="0.4")
axis.set(xlabel="poles [rad/s]", ylabel=r"largest $\hat M / M$")
axis.legend(frameon=False, ncols=3)
dress(axis, "Actuator with 50 ms lag and 10 ms delay")

# %% [markdown]
# The inner loop alone is optimistic: with an outer PD controller the complete loop sets the limit.

# %%
inner = pf.margins(filter, pf.Loop(actuator=lag, delay=0.01))
complete = pf.margins(filter, pf.Loop(10.0, 6.0, actuator=lag, delay=0.01))
print(inner.describe(), complete.describe(), sep="\n\n")

# %% [markdown]
# ## Design from it
#
# Noise of the measurement asks for a slow filter, a moving residual for a fast one. The best trade-off for given
# bounds, and the Pareto front:

# %%
best = optimal.least_bound(4, residual={1: 8.0}, noise=0.01)
print(best.message, best.filter.poles.round(2), f"bound {best.bound.bound:.4f}")
bounds = pf.Bounded({1: 8.0}, noise=0.01)
_ = pf.trade_off(best.filter.faster, np.geomspace(0.1, 10), cost=lambda f: pf.error_bound(f, bounds)).plot()

# %% [markdown]
# For random residuals the variance takes the bound's place, and the Kalman filter shows what no filter can beat. It
# is itself a PhyFilter of general form.

# %%
process = pf.gauss_markov(deviation=1.0, time_constant=0.5)
found = optimal.least_variance(3, residual=process, noise=0.01, dt=0.01)
kalman = optimal.kalman_filter(residual=process, noise=0.001)
print(f"low-pass form: {found.ratio:.3f} times the Kalman filter's variance")
print(kalman)

# %% tags=["remove-cell"]
assert 0.999 * result.bound < np.abs(error).max() <= result.bound * (1 + 1e-9)
assert np.isinf([limits[1], limits[2]]).all()
assert np.allclose([limits[3], limits[4]], [9.0, 5.0], rtol=1e-6)
assert all(lagging[order] < limits[order] for order in limits)
assert complete.modulus_margin < inner.modulus_margin
assert 1.0 <= found.ratio < 1.1
