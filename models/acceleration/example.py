"""Acceleration from velocity: a network that fails at higher speeds, the filter that repairs it, and two without it.

    v' = g + f        g = 0, inertia 1,  f = acceleration,  f_theta a network on a window of past velocities

python -m phyfilter_ctl.models.acceleration.example prints the errors on flights faster than those trained on, and saves
example.png (ten seconds). The study, of more methods and every number's reason, is ``phyfilter-ctl run acceleration``.
"""

import matplotlib.pyplot as plt
import numpy as np

import phyfilter_ctl as pf
from phyfilter_ctl.baselines import KalmanDifferentiator, tune
from phyfilter_ctl.learned import Network, Windowed
from phyfilter_ctl.plants import norm

dt, warm_up, left_out = (
    0.002,
    2.0,
    0.5,
)  # s: sampling; flown before recording; start of a flight that does not count
length, stride = 8, 5  # velocities in the network's window, and their spacing in samples
rows = slice(round(left_out / dt), None)


# --- plant: a quadrotor's velocity loop with drag and gusts, its pilot's stick, and its estimate of the velocity ----
def coloured(state, noise, deviation, tau):
    """Rate of a first-order (Ornstein-Uhlenbeck) signal driven by noise that is held over each sample."""
    return (deviation * np.sqrt(2.0 * tau / dt) * noise - state) / tau


def equations(t, x, u, p):
    wanted = 4.0 * (x.command - x.v)
    wanted = wanted * np.minimum(1.0, 6.0 / norm(wanted))  # tilt limit
    air = x.v - x.gust
    a = x.tilt - (0.3 + 0.1 * norm(air)) * air
    derivatives = {
        "v": a,
        "tilt": x.tilt_rate,
        "tilt_rate": 12.0**2 * (wanted - x.tilt) - 2.0 * 0.8 * 12.0 * x.tilt_rate,
    }
    derivatives |= {"stick": 6.0 * (u.target - x.stick), "command": 6.0 * (x.stick - x.command)}
    derivatives |= {"gust": coloured(x.gust, u.air, 0.5, 0.5), "drift": coloured(x.drift, u.slow, 0.003, 0.1)}
    return derivatives, {"measured": x.v + x.drift + 0.002 * u.white, "a": a}


states = {name: np.zeros(3) for name in ("v", "tilt", "tilt_rate", "stick", "command", "gust", "drift")}
inputs = {name: np.zeros(3) for name in ("target", "air", "slow", "white")}
vehicle = pf.flatten(pf.plant(equations, name="vehicle", states=states, inputs=inputs))


def fly(seed, fastest, duration):
    """A recording of a flight between random velocities up to ``fastest`` in m/s."""
    rng, t = np.random.default_rng(seed), dt * np.arange(round((duration + warm_up) / dt))
    starts = np.cumsum(rng.uniform(0.8, 2.4, 20))
    targets = rng.standard_normal((21, 3)) * [1.0, 1.0, 0.5]
    targets *= rng.uniform(0.0, fastest, (21, 1)) / np.linalg.norm(targets, axis=1, keepdims=True)
    signals = np.vstack([targets[np.searchsorted(starts, t)].T, rng.standard_normal((9, len(t)))])
    found = pf.simulate(vehicle, t, signals, method="rk4", max_step=dt, interpolation="hold").outputs
    v, a = (found[name][:, round(warm_up / dt) :].T for name in ("measured", "a"))
    return pf.Recording.from_arrays(x=v, dt=dt, label=a, channels=("vx", "vy", "vz"), unit="m/s")


# --- the learned model: a network from a window of velocities to the acceleration ------------------------------------
def fit(logs):
    network = Network(hidden=(20, 20), l2=1e-3, max_iterations=200, seed=0)
    windowed = Windowed(network, length, stride)
    z = np.concatenate([windowed.features(log.x)[rows][::2] for log in logs])
    f = np.concatenate([np.asarray(log.label)[rows][::2] for log in logs])
    return Windowed(network.fit(z, f).model, length, stride)


if __name__ == "__main__":
    training = [fly(i, fastest, 7.0) for i, fastest in enumerate(np.linspace(0.8, 2.0, 8))]
    tests = [fly(100 + i, 3.0, 5.6) for i in range(12)]
    slow, fast = pf.split(training)
    network, twin = fit(training), fit(slow)  # the twin has not seen the flights that its filter learns from

    # --- filters, learned: behind the network, and without one; a differentiator tuned on the same flights ----------
    behind = pf.learn([log.with_model(twin) for log in fast], 3).filter.sampled(dt)
    alone = pf.learn(training, 3, shape="general").filter.sampled(dt)
    flights = [(log.x, np.asarray(log.label), dt, rows.start) for log in training]
    rival = tune(KalmanDifferentiator, flights, max_evaluations=60).differentiator
    estimates = {
        "network": [network.predict(log.x) for log in tests],
        "PhyFilter behind it": [behind.run(log.x, f_theta=network.predict(log.x)) for log in tests],
        "learned filter alone": [alone.run(log.x) for log in tests],
        "Kalman": [rival.estimate(log.x, dt) for log in tests],
    }

    # --- score and picture ------------------------------------------------------------------------------------------
    rmse, t, true = {}, tests[0].times[rows], np.asarray(tests[0].label)[rows, 0]
    figure, (accelerations, misses) = plt.subplots(2, 1, sharex=True, figsize=(9, 5), layout="constrained")
    for name, found in estimates.items():
        errors = [(f_hat - np.asarray(log.label))[rows] for f_hat, log in zip(found, tests, strict=True)]
        rmse[name] = np.sqrt(np.mean(np.concatenate(errors) ** 2))
        print(f"{name:22} {rmse[name]:.3f} m/s^2")
        accelerations.plot(t, true + errors[0][:, 0], linewidth=1)
        misses.plot(t, errors[0][:, 0], label=f"{name}: {rmse[name]:.3f} m/s^2", linewidth=1)
    accelerations.plot(t, true, "k--", linewidth=1)
    accelerations.set(ylabel="a_x [m/s^2]")
    misses.set(ylabel="error [m/s^2]", xlabel="t [s]")
    misses.legend(ncols=2)
    figure.savefig("example.png")
