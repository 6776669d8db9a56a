"""Frames and labelled arrays beside numpy: what ``run``, a log of them and a frame of a log cost in time and memory.

    python benchmarks/containers.py [--quick]

Memory is what the process holds at its peak beyond what it held before, the answer included, in multiples of x (Linux
only, and at full length: less comes from what the process holds already). Promise: where the numbers lie in one block,
``run`` takes no more of it than for numpy's own.
"""

from __future__ import annotations

import argparse
import gc
import sys
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from phyfilter_ctl import PhyFilter, Recording

CHANNELS = ["u", "v", "w"]
LIMIT = 0.1  # of x, beyond numpy's own


def held(x: np.ndarray[Any, np.dtype[np.float64]]) -> Iterator[tuple[str, bool, Any]]:
    """Name of a container, whether its numbers lie in one block, and the container with x in it."""
    yield "numpy", True, x
    yield "numpy, Fortran order", True, np.asfortranarray(x)
    if find_spec("pandas"):
        import pandas as pd

        yield "pandas, one block", True, pd.DataFrame(x, columns=pd.Index(CHANNELS), copy=False)
        columns = {name: x[:, i].copy() for i, name in enumerate(CHANNELS)}
        yield "pandas, column by column", False, pd.DataFrame(columns, copy=False)
        if find_spec("pyarrow"):
            yield "pandas, Arrow", False, pd.DataFrame(columns).astype("float64[pyarrow]")
    if find_spec("polars"):
        import polars as pl

        yield "polars", False, pl.DataFrame({name: x[:, i].copy() for i, name in enumerate(CHANNELS)})
    if find_spec("xarray"):
        import xarray as xr

        yield "xarray", True, xr.DataArray(x, dims=("time", "channel"))


def status(entry: str) -> int:
    """Bytes by Linux's own account."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(f"{entry}:"))


def cost(work: Callable[[], object], unit: int) -> tuple[float, float]:
    """Seconds, the least of three, and memory in a unit; NaN where the system does not tell."""
    times = []
    for _ in range(3):
        before = time.perf_counter()
        work()
        times.append(time.perf_counter() - before)
    gc.collect()
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # the peak begins anew
        start = status("VmRSS")
        answer = work()
        memory = (status("VmHWM") - start) / unit
        del answer
    except OSError:
        memory = float("nan")
    return min(times), memory


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--quick", action="store_true", help="100 times fewer rows, and no promise")
    quick = parser.parse_args().quick
    n = 10**5 if quick else 10**7
    x = np.cumsum(1e-3 * np.random.default_rng(0).standard_normal((n, len(CHANNELS))), axis=0)
    t = 0.002 * np.arange(n)
    sampled = PhyFilter([400.0, 40.0]).sampled(0.002)
    print(f"{n} rows of {x.shape[1]} channels, {x.nbytes / 1e6:.1f} MB")
    print(
        "| container | run, s | memory / x | Recording, s | memory / x |", "|---|---|---|---|---|", sep="\n"
    )
    broken, own = list[str](), float("nan")
    for name, block, given in held(x):
        run = cost(lambda given=given: sampled.run(given), x.nbytes)
        log = cost(lambda given=given: Recording(t, given), x.nbytes)
        print(f"| {name} | {run[0]:.3f} | {run[1]:.2f} | {log[0]:.3f} | {log[1]:.2f} |", flush=True)
        own = run[1] if name == "numpy" else own
        if block and run[1] > own + LIMIT:
            broken.append(f"run on {name} takes {run[1]:.2f} x, on numpy's own {own:.2f}")
    if find_spec("pandas"):
        log = Recording(t, x, g=x, channels=CHANNELS)
        for copy in (True, False):
            taken = cost(lambda copy=copy: log.to_pandas(copy=copy), x.nbytes)
            print(f"to_pandas(copy={copy}) of x and g: {taken[0]:.3f} s, memory / x {taken[1]:.2f}")
    if not quick:
        print(*broken, sep="\n", end="\n" if broken else "")
    return int(bool(broken) and not quick)


if __name__ == "__main__":
    sys.exit(main())
