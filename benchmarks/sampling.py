"""What sampling leaves of a filter's promises: error, peak, noise and margins over the step.

    python benchmarks/sampling.py                        the table
    python benchmarks/sampling.py --picture sampling.png with a picture
    python benchmarks/sampling.py --quick                three steps

Two filters with poles at 20 rad/s: of order 3 with 1 - F(6j) = 0, of order 2 and type 2. For exact, matched and Tustin
sampling: the error at the samples of a residual of 6 rad/s, or of a ramp of slope 1 /s (in units of the poles' time
constant), the peak of |F|, the noise of f_hat for white noise of x at the samples (times h: what stays alike over the
steps), and by how much M_hat may exceed M before a loop with f_hat fed back breaks. Exits with status 1 if matched
sampling leaves more than 1e-12 at a step of at most half a time constant.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

import phyfilter_ctl as pf
from phyfilter_ctl.filter.sampling import Method
from phyfilter_ctl.plots import COLOURS, PAGE, dress, letter_panels

POLE, FREQUENCY = 20.0, 6.0
FILTERS = {
    f"n = 3, 1 - F({FREQUENCY:g}j) = 0": pf.place_poles([-POLE] * 3, zeros_at=[FREQUENCY]),
    "n = 2, type 2": pf.place_poles([-POLE] * 2, type=2),
}
METHODS: tuple[Method, ...] = ("exact", "matched", "tustin")
STEPS = (0.001, 0.002, 0.005, 0.01, 0.018, 0.025, 0.035, 0.05)
LEFT = 1e-12


def left(filter: pf.PhyFilter, h: float, method: Method) -> float:
    """Largest error at the samples long after the start, of a record that ``run`` filters."""
    t = h * np.arange(int(80.0 / POLE / h) + 200)
    if filter.type > 1:
        t = t - t[-1]
        gamma, x = POLE * t, 0.5 * POLE * t**2
    else:
        gamma, x = np.sin(FREQUENCY * t), -np.cos(FREQUENCY * t) / FREQUENCY
    return float(np.abs(gamma - filter.sampled(h, method).run(x)[:, 0])[-int(7.0 / FREQUENCY / h) :].max())


def figures(filter: pf.PhyFilter, h: float, method: Method) -> tuple[float, float, float, float]:
    sampled = filter.sampled(h, method)
    response = pf.frequency_response(sampled)
    return (
        left(filter, h, method),
        response.peak.value,
        h * response.noise_gain,
        pf.margins(sampled).max_ratio,
    )


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="three steps")
    parser.add_argument("--picture", type=Path, help="where to draw it")
    options = parser.parse_args()
    steps, worst = (STEPS[1::3] if options.quick else STEPS), 0.0
    found: dict[tuple[str, Method], np.ndarray] = {
        (name, method): np.array([figures(filter, h, method) for h in steps])
        for name, filter in FILTERS.items()
        for method in METHODS
    }
    for name in FILTERS:
        print(f"\n{name}: error, peak of |F|, noise gain times h, largest M_hat/M")
        print(f"{'h':>8}  " + "".join(f"{method:>38}" for method in METHODS))
        for i, h in enumerate(steps):
            cells = [found[name, method][i] for method in METHODS]
            print(
                f"{h * 1e3:5.0f} ms  "
                + "".join(f"   {e:9.1e} {p:7.4f} {s:8.5f} {m:6.2f}" for e, p, s, m in cells)
            )
            if h <= 0.5 / POLE:
                worst = max(worst, cells[1][0])
    print(f"\nmatched sampling leaves at most {worst:.1e}, limit {LEFT:g}")
    if options.picture:
        draw(steps, found, options.picture)
    return int(worst > LEFT)


def draw(steps: tuple[float, ...], found: dict[tuple[str, Method], np.ndarray], path: Path) -> None:
    from matplotlib import pyplot as plt

    titles = ("Error at the samples", "Peak of $|F|$", r"Largest $\hat M / M$")
    figure, axes = plt.subplots(len(FILTERS), 3, figsize=(PAGE, 5.2), sharex=True, layout="constrained")
    for row, name in zip(axes, FILTERS, strict=True):
        for ax, column, title in zip(row, (0, 1, 3), titles, strict=True):
            for method, style, colour in zip(METHODS, ("-", "--", ":"), COLOURS, strict=False):
                values = np.maximum(found[name, method][:, column], 1e-16)
                label = method.replace("tustin", "Tustin")
                ax.plot(1e3 * np.array(steps), values, style, color=colour, marker="o", ms=3, label=label)
            dress(ax, title)
        row[0].set_yscale("log")
        row[0].set_ylabel(name.replace("1 - F(6j)", "$1 - F(6j)$"), fontsize="small")
    for ax in axes[-1]:
        ax.set_xlabel("Step [ms]", fontsize="small")
    axes[0, 0].legend(fontsize="x-small", frameon=False)
    letter_panels(figure)
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    sys.exit(main())
