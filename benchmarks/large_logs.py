"""Learning from more data than memory holds: time and memory against reading the files, and over a Dask cluster.

    python benchmarks/large_logs.py --flights 1000 --megabytes 10      10 GB of Parquet, generated, deleted afterwards
    python benchmarks/large_logs.py --quick                            8 flights of 0.5 MB, no cluster

Every flight is three channels of a Gauss-Markov force, 500 Hz, 3 mm/s of noise on the velocity, with g and label.
"reading" is pyarrow's reading of every file by as many processes. Memory is the most that this process and all below it
take together, each shared page divided among those who share it (Linux: Pss of /proc/PID/smaps_rollup, looked at every
100 ms). The cluster's workers are processes of one thread each; the last run kills one of two in the midst. Exits with
status 1 if answers differ by more than 1e-10, memory passes 1 GB, or the cluster loses a flight.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import os
import resource
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy.signal import lfilter

from phyfilter_ctl import Reading
from phyfilter_ctl.design.learning import LearnResult, learn
from phyfilter_ctl.logfiles import read_recording
from phyfilter_ctl.study import Executor

H = 0.002
COLUMNS = 10
Found = TypeVar("Found")
SAME, MOST_MEMORY = 1e-10, 1e9
READ = partial(read_recording, time_unit="s")


def generate(number: int, folder: Path, rows: int) -> Path:
    rng = np.random.default_rng(number)
    keep = np.exp(-H / 0.4)
    f = np.asarray(lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.standard_normal((rows, 3)), axis=0))
    g = np.asarray(lfilter([0.02], [1.0, -0.98], 5.0 * rng.standard_normal((rows, 3)), axis=0))
    x = np.cumsum(np.vstack([np.zeros((1, 3)), H * (f + g)[:-1]]), axis=0) + 3e-3 * rng.standard_normal(
        (rows, 3)
    )
    columns = {"t": H * np.arange(rows)}
    for k, axis in enumerate("xyz"):
        columns |= {f"v{axis}": x[:, k], f"a{axis}": f[:, k], f"g_v{axis}": g[:, k]}
    path = folder / f"flight_{number:04d}.parquet"
    pq.write_table(pa.table(columns), path, use_dictionary=False, compression="none")
    return path


def size_of(path: Path) -> int:
    with pq.ParquetFile(path) as file:
        return file.read(use_threads=False).nbytes


class Memory(threading.Thread):
    """The most bytes that this process and those below it took together while it ran; 0 where there is no /proc."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.most, self._ended = 0.0, threading.Event()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._ended.set()
        self.join()

    def run(self) -> None:
        while not self._ended.wait(0.1):
            self.most = max(self.most, sum(proportional(process) for process in below(os.getpid())))


def below(process: int) -> list[int]:
    """A process and its descendants."""
    found = [process]
    for file in Path(f"/proc/{process}/task").glob("*/children"):
        with contextlib.suppress(OSError):  # it has ended
            found += [each for child in file.read_text().split() for each in below(int(child))]
    return found


def proportional(process: int) -> float:
    with contextlib.suppress(OSError):
        for line in Path(f"/proc/{process}/smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                return 1024.0 * float(line.split()[1])
    return 0.0


def timed(call: Callable[[], Found]) -> tuple[float, Found]:
    begin = time.perf_counter()
    found = call()
    return time.perf_counter() - begin, found


def cpu() -> float:
    """CPU seconds of this process and of the children that have ended."""
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def difference(one: LearnResult, other: LearnResult) -> float:
    pairs = [(one.filter.a, other.filter.a), (one.filter.b, other.filter.b), (one.rmse, other.rmse)]
    if one.wiener is not None and other.wiener is not None:
        pairs.append((one.wiener.ratio, other.wiener.ratio))
    return max(float(np.max(np.abs(np.divide(b, a) - 1.0))) for a, b in pairs)


@contextlib.contextmanager
def cluster(workers: int) -> Iterator[tuple[str, list[int]]]:
    """Address of a scheduler, and the processes of its workers."""
    distributed: Any = importlib.import_module(
        "distributed"
    )  # its annotations are those of its coroutines too
    options = {"threads_per_worker": 1, "processes": True, "dashboard_address": None}
    with (
        distributed.LocalCluster(n_workers=workers, **options) as local,
        distributed.Client(local, set_as_default=False) as client,
    ):
        client.wait_for_workers(workers)
        yield local.scheduler_address, list(client.run(os.getpid).values())


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--flights", type=int, default=1000)
    parser.add_argument("--megabytes", type=float, default=10.0, help="of each flight")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--folder", help="where the flights are made (default: a temporary one)")
    parser.add_argument("--no-cluster", action="store_true")
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    flights, megabytes = (8, 0.5) if options.quick else (options.flights, options.megabytes)
    folder = Path(tempfile.mkdtemp(prefix="large_logs_", dir=options.folder))
    try:
        return run(folder, flights, megabytes, options.workers, options.quick or options.no_cluster)
    finally:
        shutil.rmtree(folder)


def run(folder: Path, flights: int, megabytes: float, workers: int, alone: bool) -> int:
    rows, good, seconds = int(megabytes * 1e6 / (8 * COLUMNS)), True, 0.0
    with Executor(workers) as executor:
        work = partial(generate, folder=folder, rows=rows)
        seconds, _ = timed(lambda: list(executor.map(work, range(flights))))
    files = sorted(folder.iterdir())
    total = sum(path.stat().st_size for path in files)
    made = f"{total / 1e9:.3g} GB, made in {seconds:.0f} s"
    print(
        f"{flights} flights of {rows} x 3 samples, {made}; {workers} processes; CPU time is that of all processes"
    )
    print(f"{'':<44}{'s':>8}{'CPU s':>8}{'reading':>9}{'MB/s':>8}{'memory MB':>11}{'difference':>12}")
    used: list[float] = []
    most: list[float] = []

    def row(name: str, call: Callable[[], Found], to: LearnResult | None = None) -> Found:
        before = cpu()
        with Memory() as memory:
            seconds, found = timed(call)
        used.append(cpu() - before)
        most.append(memory.most)
        text = (
            f"{name:<44}{seconds:8.1f}{used[-1]:8.1f}{used[-1] / used[0]:9.2f}{1e-6 * total / seconds:8.0f}"
            f"{1e-6 * memory.most:11.0f}"
        )
        off = f"{difference(to, found):12.1e}" if to is not None and isinstance(found, LearnResult) else ""
        print(text + off, flush=True)
        return found

    def read() -> list[int]:
        with Executor(workers) as executor:
            return list(executor.map(size_of, files))

    row("reading", read)

    def bare(by: Any) -> LearnResult:
        return learn(folder, 2, shape="general", reading=Reading(READ, workers=by))

    def more() -> LearnResult:
        result = bare(workers)
        assert result.wiener is not None
        assert result.intervals is not None
        return result

    first = row("learn, order 2: the filter and its RMSE", lambda: bare(workers))
    full = row("  with Wiener filter, folds and intervals", more)
    print(f"  {first.filter!r}, RMSE {first.rmse:.4g}, {full.wiener_ratio:.4f} of the Wiener filter's")
    good &= max(most) < MOST_MEMORY
    if not alone:
        for count in (1, 2):
            with cluster(count) as (address, _):
                begin = time.perf_counter()
                name = f"Dask, {count} worker{'s' * (count > 1)}"
                found = row(name, lambda at=address: bare(at), first)
                seconds = time.perf_counter() - begin
            good &= difference(first, found) < SAME
        with cluster(2) as (address, processes):
            killer = threading.Timer(0.4 * seconds, os.kill, (processes[0], signal.SIGKILL))
            killer.start()
            name = f"Dask, one of two killed after {0.4 * seconds:.0f} s"
            found = row(name, lambda: bare(address), first)
            killer.join()
        good &= difference(first, found) < SAME
    return 0 if good else 1


if __name__ == "__main__":
    # Under its own name: workers import what they run.
    sys.exit(importlib.import_module(Path(__file__).stem).main())
