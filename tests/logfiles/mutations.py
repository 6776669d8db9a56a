"""Damaged logs: ``python -m tests.logfiles.mutations --count 10000 [--only ulog]``.

A small log of each format is damaged at random places and read whole; nothing but the documented errors may come of it.
Every format has a process of its own, with limits of memory and time, so that a crash or an endless loop of a library
is seen for what it is.
"""

from __future__ import annotations

import argparse
import faulthandler
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

import phyfilter_ctl as pf

PACKAGES = {
    **{"ulog": "pyulog", "dataflash": "pymavlink", "crazyflie": "numpy", "csv": "numpy"},
    **{"bag": "rosbags", "db3": "rosbags", "mcap": "rosbags", "parquet": "pyarrow", "feather": "pyarrow"},
    **{"bz2.bag": "rosbags", "lz4.bag": "rosbags", "zstd.mcap": "rosbags"},
    **{"hdf5": "h5py", "mat": "scipy"},
}
_MEMORY = 4 << 30  # bytes
_LONGEST = 300  # s that an example may take
_LENGTHS = [1 << 16, 1 << 24, 10**9, (1 << 31) - 1, (1 << 32) - 1, 1 << 40, (1 << 63) - 1, (1 << 64) - 1]
_ROWS = 20


def sound(kind: str, folder: Path) -> bytes:
    """A small log of the format."""
    t, v = 0.01 * np.arange(_ROWS), np.sin(np.arange(_ROWS))
    path = folder / "sound"
    if kind == "ulog":
        from tests.logfiles.ulog_writer import ulog

        us = 10_000 * np.arange(1, 1 + _ROWS)
        return ulog(
            {"a": {"timestamp": ("uint64_t", us), "q": ("float", np.ones((_ROWS, 2)))}},
            dropouts=[(50_000, 3)],
        )
    if kind == "dataflash":
        from tests.logfiles.dataflash_writer import dataflash

        rows = [("IMU", (1000 * k, k % 2, 0.5 * k)) for k in range(_ROWS)]
        return dataflash({"IMU": ("QBf", "TimeUS,I,AccX", "s#o", "F-0")}, rows)
    if kind == "crazyflie":
        from tests.logfiles.test_crazyflie import usd

        return usd(2)
    packed, _, ending = kind.rpartition(".")
    if ending in ("bag", "db3", "mcap"):
        from tests.logfiles.test_rosbag import write

        names = {"bag": "rosbag1", "db3": "rosbag2 sqlite3", "mcap": "rosbag2 mcap"}
        made = write(path, names[ending], count=_ROWS, packed=packed.upper())
        return (made if made.is_file() else next(made.glob(f"*.{ending}"))).read_bytes()
    if kind in ("parquet", "feather"):
        import pyarrow as pa
        from pyarrow import feather, parquet

        table = pa.table({"t_s": t, "v": v, "n": np.arange(_ROWS), "s": ["text"] * _ROWS})
        (parquet.write_table if kind == "parquet" else feather.write_feather)(table, path)
    elif kind == "hdf5":
        import h5py

        with h5py.File(path, "w") as file:
            file["a/t_s"], file["a/v"] = t, np.stack([v, v])
    elif kind == "mat":
        from scipy.io import savemat

        savemat(
            path, {"flight": {"t_s": t, "v": v, "q": np.stack([v, v])}}, appendmat=False, do_compression=True
        )
    else:
        path.write_text(
            "t_s;v;w\n" + "".join(f"{a!r};{b!r};x\n" for a, b in zip(t.tolist(), v.tolist(), strict=True))
        )
    return path.read_bytes()


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """A few bytes set, bits turned, stretches dropped, doubled or zeroed, lengths enlarged; or the end cut off."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 6))):
        at, length = int(rng.integers(len(out) or 1)), int(rng.integers(1, 40))
        match int(rng.integers(8)):
            case 0 if out:
                out[at] = int(rng.integers(256))
            case 1 if out:
                out[at] ^= 1 << int(rng.integers(8))
            case 2:
                del out[at : at + length]
            case 3:
                out[at:at] = out[at : at + length]
            case 4:
                out[at : at + length] = bytes(min(length, len(out) - at))
            case 5:
                out[at : at + 4] = rng.integers(256, size=4, dtype=np.uint8).tobytes()
            case 6:
                large, width = _LENGTHS[int(rng.integers(len(_LENGTHS)))], int(rng.choice([4, 8]))
                order = "little" if rng.integers(4) else "big"
                out[at : at + width] = (large % (1 << 8 * width)).to_bytes(width, order)
            case _ if rng.integers(4) == 0:
                del out[at:]
    return bytes(out)


def outcome(path: Path) -> str:
    """What comes of reading the file whole: "read", or the kind of refusal; another error is raised."""
    try:
        log = pf.open_log(path)
        for topic in log.topics:
            signal = log.read(topic.name)
            assert signal.values.shape == (topic.count, len(signal.fields))
            assert signal.times.shape == (topic.count,)
    except (ValueError, OSError) as error:
        if str(path) not in str(error):
            raise AssertionError("the file is not named") from error
        if "MemoryError" in str(error):
            raise AssertionError("memory was asked for before the file was refused") from error
        return "refused"
    return "read"


def search(kind: str, count: int, seed: int) -> None:
    """Damage and read a log ``count`` times; say how it went."""
    import resource  # not on Windows

    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    tally: Counter[str] = Counter()
    slowest = (0.0, 0)
    with tempfile.TemporaryDirectory() as folder:
        data = sound(kind, Path(folder))
        path = Path(folder) / f"log.{kind}"
        path.write_bytes(data)
        assert outcome(path) == "read"
        for k in range(count):
            path.write_bytes(mutated(data, np.random.default_rng([seed, k])))
            faulthandler.dump_traceback_later(_LONGEST, exit=True)
            before = time.process_time()
            try:
                tally[outcome(path)] += 1
            except BaseException:
                print(f"{kind}: example {k} of seed {seed}", flush=True)
                raise
            slowest = max(slowest, (time.process_time() - before, k))
            path.unlink()
    faulthandler.cancel_dump_traceback_later()
    shown = ", ".join(f"{number} {word}" for word, number in sorted(tally.items()))
    print(f"{kind:10} {shown}; the slowest took {slowest[0]:.2f} CPU s (example {slowest[1]})", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=10_000, help="damaged files of each format")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=PACKAGES)
    parser.add_argument("--here", action="store_true", help="in this process")
    options = parser.parse_args()
    if options.here:
        search(options.only, options.count, options.seed)
        return 0
    command = [sys.executable, "-X", "faulthandler", "-m", "tests.logfiles.mutations", "--here"]
    command += ["--count", str(options.count), "--seed", str(options.seed), "--only"]
    kinds = [options.only] if options.only else list(PACKAGES)
    return max(subprocess.run([*command, kind], check=False).returncode != 0 for kind in kinds)


if __name__ == "__main__":
    sys.exit(main())
