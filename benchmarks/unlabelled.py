"""Filters suggested without labels, on 20 kinds of generated recordings whose force is known.

    python benchmarks/unlabelled.py [--flights 12] [--first 0] [--kinds irregular late] [--quick]

x' = g + f with f a Gauss-Markov process (0.5 s) and two sines unless said, 30 s at 500 Hz. Prints by kind, for the
filter suggested without the label: its RMSE over that of the best of both orders by the label (median, largest), how
often the interval of the noise and that of the expected error hold the truth, the expected error over it, and how often
noise and residual were said to be inseparable. Beside it the same ratio, on the first three flights of a kind, for two
other ways to a filter without labels: least error against a two-sided smoother's label, and best prediction of x 0.2 s
ahead. The best is that of a grid of 50 filters.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

import phyfilter_ctl as pf
from phyfilter_ctl.estimation.prediction import prediction
from phyfilter_ctl.estimation.steps import steps_of

H, FINE = 0.002, 10
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Kind:
    """How recordings are made.

    noise: deviation of x's noise in m/s; colour: of what it is an autoregression; step: of the quantisation, m/s; late:
    s by which x is measured late; feedback: g = -feedback x as measured 20 ms before.
    """

    noise: float = 0.005
    colour: tuple[float, ...] = ()
    step: float = 0.0
    force: float = 1.0
    smooth: bool = False
    irregular: bool = False
    late: float = 0.0
    feedback: float = 0.0
    flights: int = 1
    seconds: float = 30.0
    given: bool = False


WHITE = {
    "1 mm/s": Kind(0.001),
    "5 mm/s": Kind(0.005),
    "20 mm/s": Kind(0.02),
    "1 mm/s, irregular": Kind(0.001, irregular=True),
    "5 mm/s, irregular": Kind(0.005, irregular=True),
    "20 mm/s, irregular": Kind(0.02, irregular=True),
    "5 mm/s, a third of the force": Kind(force=1.0 / 3.0),
    "5 mm/s, three times the force": Kind(force=3.0),
    "5 mm/s, a smooth force": Kind(smooth=True),
    "5 mm/s, 8 s": Kind(seconds=8.0),
    "5 mm/s, six flights of 8 s": Kind(flights=6, seconds=8.0),
    "5 mm/s, x 20 ms late": Kind(late=0.02),
    "5 mm/s, g reacts to the noise": Kind(feedback=5.0),
    "5 mm/s, given": Kind(given=True),
}
OTHER = {
    "coloured, AR(1) 0.6": Kind(colour=(0.6,)),
    "coloured, AR(1) 0.95": Kind(colour=(0.95,)),
    "coloured, AR(1) 0.95, given": Kind(colour=(0.95,), given=True),
    "coloured, AR(2), a resonance": Kind(colour=(1.2, -0.6)),
    "quantised, 5 mm/s": Kind(0.0, step=0.005),
    "quantised, 50 mm/s": Kind(0.0, step=0.05),
}


def force(kind: Kind, rng: np.random.Generator, count: int) -> Array:
    """On the fine grid."""
    t = H / FINE * np.arange(count + 1)
    fall = np.exp(-H / FINE / 0.5)
    walk = np.asarray(lfilter([1.0], [1.0, -fall], np.sqrt(1.0 - fall**2) * rng.standard_normal(count + 1)))
    if kind.smooth:
        pole = np.exp(-H / FINE / 0.05)
        walk = np.asarray(lfilter([(1.0 - pole) ** 2], [1.0, -2.0 * pole, pole**2], walk))
    return kind.force * (walk + np.sin(3.0 * t) + 0.5 * np.sin(8.0 * t))


def noise(kind: Kind, rng: np.random.Generator, count: int) -> Array:
    """Of the stated deviation."""
    white = rng.standard_normal(count + 500)
    v = np.asarray(lfilter([1.0], [1.0, *(-a for a in kind.colour)], white))
    return kind.noise * v[500:] / np.sqrt(covariance(kind)[0])


def covariance(kind: Kind) -> Array:
    """Of the autoregression driven by 1."""
    impulse = np.asarray(lfilter([1.0], [1.0, *(-a for a in kind.colour)], np.eye(1, 2000)[0]))
    return np.array([impulse[: 2000 - lag] @ impulse[lag:] for lag in range(200 if kind.colour else 1)])


def recording(kind: Kind, seed: int) -> pf.Recording:
    """One flight with its label."""
    rng, count = np.random.default_rng(seed), round(kind.seconds / H) * FINE
    t = H / FINE * np.arange(count + 1)
    f = force(kind, rng, count)
    rise = np.concatenate([[0.0], np.cumsum(0.5 * (f[1:] + f[:-1]) * H / FINE)])
    at = np.arange(0, count + 1, FINE)
    if kind.irregular:
        at[1:-1] += rng.integers(-3, 4, len(at) - 2)
        at = np.delete(
            at, [*range(len(at) // 3, len(at) // 3 + 40), *rng.integers(1, len(at) - 1, len(at) // 100)]
        )
    seen = np.maximum(at - round(kind.late / H) * FINE, 0)
    x, g, v = rise[seen], None, noise(kind, rng, len(at))
    if kind.feedback:
        x, g, back = np.zeros(len(at)), np.zeros(len(at)), round(0.02 / H)
        for k in range(len(at) - 1):
            g[k] = -kind.feedback * (x[max(k - back, 0)] + v[max(k - back, 0)])
            x[k + 1] = x[k] + rise[at[k + 1]] - rise[at[k]] + H * g[k]
    measured = x + v
    if kind.step:
        measured = kind.step * np.round(measured / kind.step)
    keep = slice(round(kind.late / H), None)
    return pf.Recording(t[at][keep], measured[keep], g=None if g is None else g[keep], label=f[at][keep])


def sampled(kind: Kind, logs: Sequence[pf.Recording], order: int, w: float) -> pf.SampledPhyFilter:
    return pf.lowpass(order, w, family="butterworth").sampled(logs[0].dt, delay=kind.late)


def rmse(logs: Sequence[pf.Recording], filter: pf.SampledPhyFilter) -> float:
    errors = [filter.run(log.x, log.g, times=log.times) - log.label for log in logs if log.label is not None]
    return float(np.sqrt(np.mean(np.concatenate([error[1:] for error in errors]) ** 2)))


def best(cost: Callable[[int, float], float], around: float) -> tuple[int, float]:
    grid = [(n, float(w)) for n in (1, 2) for w in around * np.geomspace(0.3, 3.0, 25)]
    return min(grid, key=lambda each: cost(*each))


@dataclass(frozen=True)
class Row:
    """One set of flights: RMSE over the labelled optimum by three ways, what the intervals held, expected over true."""

    stein: float
    smoother: float
    ahead: float
    noise: bool
    error: bool
    level: float
    refused: bool


def evaluated(kind: Kind, seed: int, *, others: bool) -> Row:
    logs = [recording(kind, 1000 * seed + i) for i in range(kind.flights)]
    bare = [log.with_signals(label=None) for log in logs]
    known = None
    if kind.given:
        shape = covariance(kind)
        known = pf.Noise.known(covariance=kind.noise**2 * shape / shape[0])
    made = partial(sampled, kind, logs)
    found = pf.estimate(bare, made(2, 20.0), noise=known)
    chosen = found.suggestion
    w = chosen.bandwidth

    def true(order: int, w: float) -> float:
        return rmse(logs, made(order, w))

    least = true(*best(true, w))
    truth = true(chosen.filter.order, w)
    smoother = ahead = float("nan")
    if others:
        smoother, ahead = (true(*way) / least for way in _others(kind, bare, made, w))
    deviation = kind.noise if kind.noise else kind.step / np.sqrt(12.0)
    return Row(
        truth / least,
        smoother,
        ahead,
        bool(found.noise.low[0] <= deviation <= found.noise.high[0]),
        chosen.error.low < truth < chosen.error.high,
        chosen.error.value / truth,
        found.noise.status == "not_identified",
    )


def _others(
    kind: Kind, logs: Sequence[pf.Recording], made: Callable[[int, float], pf.SampledPhyFilter], w: float
) -> tuple[tuple[int, float], tuple[int, float]]:
    """Order and bandwidth by the smoother's label and by prediction."""
    smooth = [pf.smooth_label(log).recording for log in logs]
    # What x measured late says of now, a smoother knows for then: it is its label that is shifted.
    back, told = round(kind.late / H), []
    for log in smooth:
        assert log.label is not None
        told.append(log.with_signals(label=np.roll(log.label, -back, axis=0)))
    parts = steps_of(logs, made(2, w))
    by_label = best(lambda n, w: rmse(told, made(n, w)), w)
    return by_label, best(lambda n, w: prediction(made(n, w), parts, 0.2, 0.95).filter, w)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flights", type=int, default=12, help="of each kind (default 12)")
    parser.add_argument("--first", type=int, default=0, help="first seed (default 0)")
    parser.add_argument(
        "--kinds", nargs="*", default=[""], help="those whose names hold one of these (default all)"
    )
    parser.add_argument("--quick", action="store_true", help="one flight of every third kind")
    options = parser.parse_args()
    print(
        f"{'':<32}{'RMSE / best: median, largest':>28}{'smoother':>10}{'ahead':>8}"
        f"{'noise held':>12}{'error held':>12}{'level':>8}{'refused':>9}"
    )
    for title, kinds in (("white noise", WHITE), ("other noise", OTHER)):
        print(title)
        rows: list[Row] = []
        for name, kind in list(kinds.items())[:: 3 if options.quick else 1]:
            if not any(part in name for part in options.kinds):
                continue
            some = [
                evaluated(kind, options.first + i, others=i < 3)
                for i in range(1 if options.quick else options.flights)
            ]
            rows += some
            _print(f"  {name}", some)
        if rows:
            _print("  all of them", rows)
    return 0


def _print(name: str, rows: Sequence[Row]) -> None:
    ratios = [row.stein for row in rows]
    smoother, ahead, level = (
        np.nanmedian([getattr(row, key) for row in rows]) for key in ("smoother", "ahead", "level")
    )
    noise, error, refused = (
        np.mean([getattr(row, key) for row in rows]) for key in ("noise", "error", "refused")
    )
    print(
        f"{name:<32}{np.median(ratios):>19.4f}{max(ratios):>9.4f}{smoother:>10.4f}{ahead:>8.4f}"
        f"{noise:>12.0%}{error:>12.0%}{level:>8.2f}{refused:>9.0%}",
        flush=True,
    )


if __name__ == "__main__":
    raise SystemExit(main())
