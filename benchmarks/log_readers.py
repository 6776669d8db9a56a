"""Time and memory of reading large logs, beside the library alone.

    python benchmarks/log_readers.py [--quick] [--gigabytes 1.0] [--rows 10000000]

A ULog as a flight writes it (attitude and motors at 250 Hz, position at 100 Hz, a sensor at 1 kHz), a Parquet table and
a CSV table are written to a temporary folder. "alone" is the library's own reading of what we read: pyulog's parsing,
pyarrow's and polars' columns as float64. Each reading has a process of its own; memory is its largest, less that of the
imports. Judged: at most 1.5 times the library's CPU time (Parquet 2 times: describing the clock costs as much as a
column; CSV 3 times: the text is checked, then read for its times, then for its values), and its memory plus 1.5 times
what is handed out.
"""

from __future__ import annotations

import argparse
import json
import resource
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import numpy as np

MOST_TIME = {"ulog": 1.5, "parquet": 2.0, "csv": 3.0}
# Name, Hz, floats.
TOPICS = (
    ("sensor_combined", 1000, 9),
    ("vehicle_attitude", 250, 4),
    ("actuator_motors", 250, 12),
    ("vehicle_local_position", 100, 20),
)


def write_ulog(path: Path, size: float) -> None:
    """Messages in the order of their times, a second at a time, until the file has ``size`` bytes."""

    def message(kind: str, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), ord(kind)) + body

    head = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message("B", bytes(40))
    second: list[tuple[int, np.ndarray]] = []
    for k, (name, rate, width) in enumerate(TOPICS):
        head += message("F", f"{name}:uint64_t timestamp;float[{width}] value;".encode())
        rows = np.zeros(
            rate, [("n", "<u2"), ("k", "u1"), ("id", "<u2"), ("t", "<u8"), ("v", "<f4", (width,))]
        )
        rows["n"], rows["k"], rows["id"] = rows.itemsize - 3, ord("D"), k
        rows["t"], rows["v"] = np.arange(rate) * 1_000_000 // rate, np.sin(np.arange(rate))[:, None]
        second += [(int(row["t"]), row) for row in rows]
    for k, (name, _, _) in enumerate(TOPICS):
        head += message("A", struct.pack("<BH", 0, k) + name.encode())
    second.sort(key=lambda each: each[0])
    block = bytearray(b"".join(row.tobytes() for _, row in second))
    at = np.cumsum([0, *(row.nbytes for _, row in second[:-1])]) + 5
    times = np.array([t for t, _ in second], np.uint64)
    with path.open("wb") as file:
        file.write(head)
        view = np.frombuffer(block, np.uint8)
        for k in range(int((size - len(head)) / len(block)) + 1):
            view[at[:, None] + np.arange(8)] = (
                (times + np.uint64(1_000_000 * k)).view(np.uint8).reshape(-1, 8)
            )
            file.write(block)


def write_tables(folder: Path, rows: int) -> None:
    import polars as pl

    rng = np.random.default_rng(0)
    frame = pl.DataFrame(
        {"t_us": np.arange(rows) * 2000, **{f"v{k}": rng.standard_normal(rows) for k in range(4)}}
    )
    frame.write_parquet(folder / "log.parquet")
    frame.write_csv(folder / "log.csv")


def ours(path: Path) -> int:
    import phyfilter_ctl as pf

    log = pf.open_log(path)
    return sum(log.read(topic.name).values.nbytes + 8 * topic.count for topic in log.topics)


def pyulog_alone(path: Path) -> int:
    from pyulog import ULog

    return sum(values.nbytes for data in ULog(str(path)).data_list for values in data.data.values())


def pyarrow_alone(path: Path) -> int:
    import pyarrow.parquet as pq

    return sum(column.to_numpy().nbytes for column in pq.read_table(path).columns)


def polars_alone(path: Path) -> int:
    import polars as pl

    return pl.read_csv(path).to_numpy().nbytes


READINGS: dict[str, tuple[str, Callable[[Path], int]]] = {
    "ulog": ("log.ulg", pyulog_alone),
    "parquet": ("log.parquet", pyarrow_alone),
    "csv": ("log.csv", polars_alone),
}


def most_memory() -> int:
    """Largest resident memory of this program so far, bytes; rusage's would count its parent's."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(status.partition("VmHWM:")[2].split()[0])


def measured(read: str, kind: str, path: Path) -> dict[str, float]:
    """One reading in a fresh process."""
    command = [sys.executable, __file__, "--reading", read, kind, str(path)]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def reading(read: str, kind: str, path: Path) -> None:
    library, module = {
        "ulog": ("pyulog", "ulog"),
        "parquet": ("pyarrow.parquet", "arrow"),
        "csv": ("polars", "tables"),
    }[kind]
    import_module(library)
    import_module(f"phyfilter_ctl.logfiles.{module}")
    before, held = resource.getrusage(resource.RUSAGE_SELF), most_memory()
    started = time.perf_counter()
    out = (ours if read == "ours" else READINGS[kind][1])(path)
    seconds = time.perf_counter() - started
    after = resource.getrusage(resource.RUSAGE_SELF)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    print(json.dumps({"seconds": seconds, "cpu": cpu, "memory": most_memory() - held, "out": out}))


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="small files, nothing judged")
    parser.add_argument("--gigabytes", type=float, default=1.0, help="of the ULog")
    parser.add_argument("--rows", type=int, default=10_000_000, help="of the tables, of five columns")
    parser.add_argument("--reading", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.reading:
        reading(options.reading[0], options.reading[1], Path(options.reading[2]))
        return 0
    size, rows = (2e6, 60_000) if options.quick else (options.gigabytes * 1e9, options.rows)
    within = True
    with tempfile.TemporaryDirectory() as name:
        write_ulog(Path(name) / "log.ulg", size)
        write_tables(Path(name), rows)
        for kind, (file, _) in READINGS.items():
            path = Path(name) / file
            mine, alone = measured("ours", kind, path), measured("alone", kind, path)
            ratio = mine["cpu"] / alone["cpu"]
            print(f"{kind:8} {path.stat().st_size / 1e6:5.0f} MB, {mine['out'] / 1e6:.0f} MB handed out")
            for who, figures in {"ours": mine, "alone": alone}.items():
                print(
                    f"  {who:6} {figures['cpu']:7.2f} CPU s, {figures['seconds']:7.2f} s, "
                    f"{figures['memory'] / 1e6:6.0f} MB"
                )
            within &= ratio <= MOST_TIME[kind]
            within &= mine["memory"] <= alone["memory"] + 1.5 * mine["out"]
    return int(not within and not options.quick)


if __name__ == "__main__":
    sys.exit(main())
