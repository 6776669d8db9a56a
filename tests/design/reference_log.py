"""A fixed log that everyone can make: sines and gusts under a half-blind model, noisy velocity, 28,000 x 3 at 2 ms."""

import numpy as np
from scipy.signal import lfilter

from phyfilter_ctl import Recording

H = 0.002
NOISE = 3e-3  # m/s
FINER = 8  # steps of the truth per sample
GUSTS = 0.4  # s, correlation time


def reference_log(samples=28_000, seed=7, noise=NOISE):
    """x' = f; f_theta knows 30 % of the sines and nothing of the gusts."""
    rng = np.random.default_rng(seed)
    h = H / FINER
    t = h * np.arange(samples * FINER)
    sines = np.stack(
        [
            np.sin(1.1 * t) + 0.5 * np.sin(3.7 * t + 1.0),
            0.8 * np.sin(2.3 * t + 0.3),
            0.6 * np.sin(5.1 * t) + 0.7 * np.cos(0.7 * t),
        ],
        axis=1,
    )
    keep = np.exp(-h / GUSTS)
    gusts = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.standard_normal((len(t), 3)), axis=0)
    f = sines + 0.5 * gusts
    x = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * h * (f[1:] + f[:-1]), axis=0)])[::FINER]
    return Recording.from_arrays(
        x=x + noise * rng.standard_normal(x.shape),
        dt=H,
        f_theta=0.3 * sines[::FINER],
        label=f[::FINER],
        name="reference",
    )
