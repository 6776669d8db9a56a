"""Ultimate bounds by four methods, over orders, families and bandwidths, and what each costs.

    python benchmarks/bounds.py            orders 1 to 6, half a minute
    python benchmarks/bounds.py --quick    orders 1 to 3

Two kernels: (1 - F)/s of the low-pass filter (residual of bounded slope) and 1/D, which is (1 - F)/s^n of N = D - s^n
(residual of bounded n-th derivative; the paper's forcing form). Exact gains in s and s^n, the others as factors over
them. Exits with status 1 if an exact bound is not certified to 1e-6, an ellipsoid exceeds 1.1 (to n = 5) or 1.55, or,
unless --quick, the median time of an exact bound is above 5 ms or a trade-off curve of 100 designs takes more than 5 s.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

import phyfilter_ctl as pf
from phyfilter_ctl.analysis import ultimate_bound
from phyfilter_ctl.analysis.bounds.result import Method
from phyfilter_ctl.design.optimal import bound_trade_off, variance_trade_off

FAMILIES = ("binomial", "butterworth", "bessel", "itae")
OTHERS: tuple[Method, ...] = ("ellipsoid", "lyapunov", "lyapunov-raw")
CERTIFIED, ELLIPSOID, ELLIPSOID_OF_D, MILLISECONDS, SECONDS = 1e-6, 1.1, 1.55, 5.0, 5.0


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="orders 1 to 3")
    quick = parser.parse_args().quick
    missed: list[str] = []
    times: list[float] = []
    for kernel in ("(1 - F)/s", "1/D"):
        print(
            f"{kernel:10} {'':12} {'rad/s':>6} {'exact':>11} {'ellipsoid':>10} {'scaled':>10} {'textbook':>10}"
        )
        for order in range(1, 4 if quick else 7):
            for family in FAMILIES if order > 1 else FAMILIES[:1]:
                for cutoff in (10.0, 50.0):
                    filter = pf.lowpass(order, cutoff, family=family)
                    k = 1
                    if kernel == "1/D":
                        filter, k = pf.place_poles(filter.poles, numerator=order), order
                    begun = time.perf_counter()
                    exact = ultimate_bound(filter, residual={k: 1.0})
                    times.append(1e3 * (time.perf_counter() - begun))
                    assert exact.certificate is not None
                    ratios = [
                        ultimate_bound(filter, residual={k: 1.0}, method=method).bound / exact.bound
                        for method in OTHERS
                    ]
                    print(
                        f"n = {order:<6} {family:12} {cutoff:6.0f} {exact.bound:11.4e} "
                        + " ".join(f"{ratio:10.4g}" for ratio in ratios)
                    )
                    limit = ELLIPSOID if kernel != "1/D" else ELLIPSOID_OF_D
                    if exact.certificate.gap > CERTIFIED:
                        missed.append(f"{family} {order}: certified to {exact.certificate.gap:.1e} only")
                    if order <= 5 and ratios[0] > limit:
                        missed.append(f"{kernel} {family} {order}: ellipsoid {ratios[0]:.3f}")
        print()
    print(f"exact bound: {np.median(times):.2f} ms (median), {np.max(times):.2f} ms (longest)")
    begun = time.perf_counter()
    curve = bound_trade_off(3, residual={1: 8.0}, noise=0.01)
    seconds = [time.perf_counter() - begun]
    begun = time.perf_counter()
    variance_trade_off(3, residual=pf.gauss_markov(1.0, 0.5), noise=0.01, dt=0.01)
    seconds.append(time.perf_counter() - begun)
    count = len(curve.filters)
    print(f"curves of {count} designs, n = 3: {seconds[0]:.2f} s (bounds), {seconds[1]:.2f} s (variances)")
    if not quick and max(seconds) > SECONDS:
        missed.append("a trade-off curve takes too long")
    if not quick and np.median(times) > MILLISECONDS:
        missed.append("an exact bound takes too long")
    for line in missed:
        print("missed:", line)
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
