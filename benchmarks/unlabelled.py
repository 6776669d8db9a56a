"""Filters suggested without labels, on generated recordings whose force is known.

    python benchmarks/unlabelled.py [--quick]

x' = f with f a Gauss-Markov process (0.5 s) and two sines, 30 s at 500 Hz, or with jitter, dropped samples and a gap;
white noise of x of 1, 5 and 20 mm/s. Prints RMSE of the suggested filter over that of the best of its family by the
label, how often the interval of the noise level and that of the expected error hold the truth, and the level over it.
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy.signal import lfilter

import phyfilter_ctl as pf

H, FINE = 0.002, 10


def recording(seed: int, noise: float, *, irregular: bool, seconds: float = 30.0) -> pf.Recording:
    """One flight with its label."""
    rng, count = np.random.default_rng(seed), round(seconds / H) * FINE
    t = H / FINE * np.arange(count + 1)
    fall = np.exp(-H / FINE / 0.5)
    walk = np.asarray(lfilter([1.0], [1.0, -fall], np.sqrt(1.0 - fall**2) * rng.standard_normal(count + 1)))
    f = walk + np.sin(3.0 * t) + 0.5 * np.sin(8.0 * t)
    x = np.concatenate([[0.0], np.cumsum(0.5 * (f[1:] + f[:-1]) * H / FINE)])
    at = np.arange(0, count + 1, FINE)
    if irregular:
        at[1:-1] += rng.integers(-3, 4, len(at) - 2)
        at = np.delete(at, [*range(5000, 5040), *rng.integers(1, len(at) - 1, len(at) // 100)])
    return pf.Recording(t[at], x[at] + noise * rng.standard_normal(len(at)), label=f[at])


def rmse(log: pf.Recording, filter: pf.PhyFilter) -> float:
    assert log.label is not None
    f_hat = filter.sampled(log.dt).run(log.x, times=log.times)
    return float(np.sqrt(np.mean((f_hat - log.label)[1:] ** 2)))


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="two flights each instead of 12")
    options = parser.parse_args()
    print(
        f"{'steps':<12}{'noise':>7}{'RMSE / best: median':>21}{'largest':>9}"
        f"{'noise held':>12}{'error held':>12}{'level':>8}"
    )
    for irregular in (False, True):
        for noise in (0.001, 0.005, 0.02):
            ratios, held, errors, levels = [], [], [], []
            for seed in range(2 if options.quick else 12):
                log = recording(seed, noise, irregular=irregular)
                found = pf.estimate(log.with_signals(label=None))
                for order, (w, _) in found.suggestion.orders.items():
                    family = [
                        pf.lowpass(order, w * span, family="butterworth")
                        for span in np.geomspace(0.6, 1.7, 23)
                    ]
                    ours = rmse(log, pf.lowpass(order, w, family="butterworth"))
                    ratios.append(ours / min(rmse(log, each) for each in family))
                truth = rmse(log, found.suggestion.filter)
                held.append(bool(found.noise.low[0] < noise < found.noise.high[0]))
                errors.append(found.error.low < truth < found.error.high)
                levels.append(found.error.value / truth)
            print(
                f"{'irregular' if irregular else 'equal':<12}{noise:>7g}{np.median(ratios):>21.4f}{max(ratios):>9.4f}"
                f"{np.mean(held):>12.0%}{np.mean(errors):>12.0%}{np.median(levels):>8.2f}"
            )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
