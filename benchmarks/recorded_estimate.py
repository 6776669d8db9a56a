"""What estimate says of recorded flights without their labels, and what the labels say of that.

    python benchmarks/recorded_estimate.py FOLDER [--compare]

FOLDER holds CSV files, one a flight: either t [s], vx vy vz [m/s] and ax ay az [m/s^2], or those that
`phyfilter-ctl run drone --replay` reads. Prints by flight the bandwidth that is suggested, the RMSE of its f_hat to the
label over that of the best of its family by the label, where noise and residual cross, and the prediction test. Where
the file has positions px py pz, their second difference over 80 ms is a label whose noise is not that of v: the ratios
by it of the suggested filter and of the one best by the label follow. With --compare other estimators over all flights.
A folder that is not there is not evaluated, which is no pass.
"""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path

import numpy as np

import phyfilter_ctl as pf
from phyfilter_ctl import models
from phyfilter_ctl.baselines import compare

SPAN = np.geomspace(0.1, 10.0, 61)
APART = 0.08  # s between the positions


def flight(path: Path) -> pf.Recording:
    """With g and a label."""
    if "hover_throttle" not in path.open().readline():
        return pf.Recording.read(path)
    found = importlib.import_module(f"{models.__name__}.drone.replay_recordings").read(path)
    return pf.Recording(
        found.log.times,
        found.v,
        g=found.g,
        label=found.label,
        name=path.stem,
        channels=tuple("xyz"),
        unit="m/s",
    )


def by_position(path: Path, log: pf.Recording) -> np.ndarray | None:
    """f by the second difference of the position: its mean, weighted by a triangle, over 80 ms on both sides of now."""
    if "px" not in path.open().readline().split(",") or log.g is None:
        return None
    p = pf.Recording.read(path, x=("px", "py", "pz"), label=None, g=None, f_theta=None, inertia=None).x
    k = round(APART / log.dt)
    label = np.full_like(p, np.nan)
    label[k:-k] = (p[2 * k :] - 2.0 * p[k:-k] + p[: -2 * k]) / (k * log.dt) ** 2
    triangle = np.bartlett(2 * k + 1) / k
    middle = 0.5 * (log.g + np.vstack([log.g[:1], log.g[:-1]]))  # g is held from its sample on
    return label - np.stack([np.convolve(column, triangle, "same") for column in middle.T], axis=1)


def rmse(log: pf.Recording, filter: pf.PhyFilter, label: np.ndarray) -> float:
    """Of f_hat, without the first second, to the label."""
    f_hat = filter.sampled(log.dt).run(log.x, log.g, times=log.times)
    return float(np.sqrt(np.nanmean((f_hat - label)[log.times > log.times[0] + 1.0] ** 2)))


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="folder of CSV files")
    parser.add_argument("--compare", action="store_true", help="other estimators as well")
    options = parser.parse_args()
    paths = sorted(options.folder.glob("*.csv")) if options.folder.is_dir() else []
    if not paths:
        print(f"not evaluated: expected CSV files in {options.folder}, found none")
        return 0
    logs = [flight(path) for path in paths]
    print(
        f"{'flight':<42}{'order':>6}{'rad/s':>8}{'RMSE':>8}{'/ best':>8}{'cross':>8}{'colour':>8}{'less by':>9}"
        f"{'by p':>8}{'by p':>8}"
    )
    ratios, positions = [], []
    for path, log in zip(paths, logs, strict=True):
        assert log.label is not None
        found = pf.estimate(log.with_signals(label=None))
        best, label = found.suggestion, log.label
        family = [
            pf.lowpass(best.filter.order, best.bandwidth * span, family="butterworth")
            for span in SPAN
            if best.bandwidth * span * log.dt < 3.0
        ]
        scores = [rmse(log, each, label) for each in family]
        ours, least = rmse(log, best.filter, label), min(scores)
        ratios.append(ours / least)
        if (other := by_position(path, log)) is not None:
            by_p = [rmse(log, each, other) for each in family]
            label_s = by_p[int(np.argmin(scores))]
            positions.append(np.array([rmse(log, best.filter, other), label_s]) / min(by_p))
        print(
            f"{log.name[-41:]:<42}{best.filter.order:>6}{best.bandwidth:>8.3g}{ours:>8.4f}{ours / least:>8.4f}"
            f"{found.spectrum.crossing:>8.3g}{float(np.max(found.noise.colour)):>8.2f}{found.prediction.reduction.value:>9.1%}"
            + "".join(f"{each:>8.4f}" for each in (positions[-1] if other is not None else ()))
        )
    print(f"RMSE over the best by the label: median {np.median(ratios):.4f}, largest {max(ratios):.4f}")
    if positions:
        middle, most = np.median(positions, axis=0), np.max(positions, axis=0)
        print(
            f"by the position: suggested median {middle[0]:.4f}, largest {most[0]:.4f}; best by the label median "
            f"{middle[1]:.4f}, largest {most[1]:.4f}"
        )
    together = pf.estimate([log.with_signals(label=None) for log in logs])
    best, test = together.suggestion, together.prediction
    value, low, high = (f"{100.0 * share:.1f}" for share in test.reduction)
    print(
        f"all flights: order {best.filter.order}, {best.bandwidth:.3g} rad/s; x {test.horizon} s ahead: "
        f"{test.model:.4f} m/s by the model, {test.filter:.4f} with f_hat, {value} % [{low}, {high}] less"
    )
    for note in together.notes:
        print(f"  {note}")
    if options.compare:
        for what in (logs, [log.with_signals(label=None) for log in logs]):
            others = compare(what, max_evaluations=30)
            print(f"against {others.against}: {others.verdict}")
            for name, value in others.rmse.items():
                print(f"  {name[:50]:<52}{value:>9.4f}  {others.tuned[name]}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
