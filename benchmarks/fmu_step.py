"""What an FMU costs: time of a communication step from a C host, size, and time of an export.

    python benchmarks/fmu_step.py [--quick] [--json FILE]

A second-order filter of three channels, sampled at 500 Hz. The host (fmu_step.c) loads the binary and calls set,
doStep and get; beside it, in the same run, the recursion as a hand-written loop. Promises: a step below 0.1 us over the
loop, an FMU for one platform below 100 kB, a warm export below 3 s.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path
from typing import Literal

from fmpy import read_model_description
from tqdm import tqdm

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.codegen import CompilerError
from phyfilter_ctl.codegen.compiler import compile_sources
from phyfilter_ctl.fmi import FmuPorts
from phyfilter_ctl.fmi.build import native_platform
from phyfilter_ctl.fmi.export import export_fmu
from phyfilter_ctl.fmi.glue import fmi_headers

PERIOD = 0.002
CHANNELS = 3
MOST_OVERHEAD = 100.0  # ns over the loop
MOST_BYTES = 100_000
MOST_SECONDS = 3.0
# f_hat is the same but for the order of sums: mean difference per step, of numbers of size 1.
AGREES = 1e-12


def compile_host(folder: Path) -> Path:
    source = {
        "fmu_step.c": Path(__file__).with_suffix(".c").read_text(),
        **fmi_headers("2.0"),
        **fmi_headers("3.0"),
    }
    try:
        return compile_sources(source, folder / "fmu_step", kind="program", name="the host", flags=["-ldl"])
    except CompilerError as error:
        print(f"not evaluated: {error}")
        raise SystemExit(0) from None


def measure(
    host: Path, path: Path, fmi: Literal["2.0", "3.0"], steps: int, repetitions: int
) -> tuple[float, ...]:
    """ns per step of the FMU and the loop, and their difference in f_hat."""
    filter = PhyFilter([400.0, 40.0])
    dA, equilibrium, C = filter.sampled(PERIOD).transition
    description = read_model_description(str(path))
    first = {
        name: min(v.valueReference for v in description.modelVariables if v.name.split("[")[0] == name)
        for name in ("x", "g", "f_theta", "f_hat")
    }
    target = native_platform()
    with zipfile.ZipFile(path) as archive:
        library = Path(
            archive.extract(f"binaries/{target.folder(fmi)}/bench{target.suffix}", path.with_suffix(""))
        )
    numbers = [*dA.ravel(), *equilibrium, *C, PERIOD]
    text = " ".join(
        [fmi, str(library), description.guid or "", str(steps), str(repetitions), *map(str, first.values())]
        + [f"{float(number):.17g}" for number in numbers]
    )
    answer = subprocess.run([str(host)], input=text, capture_output=True, text=True, check=True)
    return tuple(map(float, answer.stdout.split()))


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="few steps: no verdict on times")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    steps, repetitions = (20_000, 3) if options.quick else (2_000_000, 15)
    rows = []
    kept = True
    sampled = PhyFilter([400.0, 40.0]).sampled(PERIOD)
    versions: tuple[Literal["2.0", "3.0"], ...] = ("2.0", "3.0")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        host = compile_host(folder)
        export_fmu(sampled, folder / "warm.fmu", ports=FmuPorts(channels=CHANNELS))
        for fmi in tqdm(versions, desc=f"{steps:,} steps, {repetitions} times", disable=None):
            begin = time.perf_counter()
            path = export_fmu(
                sampled, folder / f"fmi{fmi[0]}.fmu", fmi=fmi, name="bench", ports=FmuPorts(channels=CHANNELS)
            )
            seconds = time.perf_counter() - begin
            fmu, loop, difference = measure(host, path, fmi, steps, repetitions)
            rows.append({"fmi": fmi, "fmu_ns": fmu, "loop_ns": loop, "difference": difference,
                         "bytes": path.stat().st_size, "export_s": seconds})  # fmt: skip
    print(
        f"{'FMI':>4} {'set + doStep + get':>19} {'loop':>9} {'over it':>9} {'f_hat':>9} {'size':>9} {'export':>8}"
    )
    for row in rows:
        over = row["fmu_ns"] - row["loop_ns"]
        kept &= over < MOST_OVERHEAD and row["bytes"] < MOST_BYTES and row["export_s"] < MOST_SECONDS
        print(
            f"{row['fmi']:>4} {row['fmu_ns']:16.1f} ns {row['loop_ns']:6.1f} ns {over:6.1f} ns "
            f"{row['difference']:9.1e} {row['bytes'] / 1e3:6.1f} kB {row['export_s']:6.2f} s"
        )
    right = all(row["difference"] < AGREES for row in rows)
    print(
        "F_HAT DIFFERS" if not right
        else "a short run: no verdict" if options.quick
        else "the promises hold" if kept else "A PROMISE DOES NOT HOLD"
    )  # fmt: skip
    if options.json:
        options.json.write_text(json.dumps({"steps": steps, "rows": rows}, indent=1))
    return 0 if right and (kept or options.quick) else 1


if __name__ == "__main__":
    sys.exit(main())
