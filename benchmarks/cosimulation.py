"""What a communication step of a co-simulation FMU costs: the master beside other hosts.

    python benchmarks/cosimulation.py [--quick] [--json FILE]

FMUs of a sampled first-order lag (FMI 2.0, period 2 ms), one alone and ten in a ring, no results but the last; the
start of each host is not counted. Beside the master in C: the same in Python (what a machine without a C compiler
runs), in Python with the FMU in a process of its own (isolated=True), FMPy's simulate_fmu (one FMU), and ecos where it
is installed (PyPI ecospy).
Promises: all give the same outputs; the master in C takes less than 1 us a step of an FMU.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import control as ct
import numpy as np
from fmpy import extract, read_model_description, simulate_fmu
from tqdm import tqdm

from phyfilter_ctl.fmi import cosimulate, export_fmu
from phyfilter_ctl.fmi.cosimulation_run import Run

STEP = 0.002
MOST = 1.0  # us
AGREES = 1e-12
Answer = tuple[float, float]  # s, output of the last part


def wires(count: int) -> list[tuple[str, str]]:
    return (
        [(f"part{k}.u", f"{'' if k else '-'}part{(k - 1) % count}.y") for k in range(count)]
        if count > 1
        else []
    )


def ours(path: Path, count: int, steps: int, *, isolated: bool = False) -> Answer:
    began = time.perf_counter()
    response = cosimulate(
        {f"part{k}": path for k in range(count)},
        wires(count),
        timepts=[0.0, steps * STEP],
        step=STEP,
        inputs={} if count > 1 else {"part0.u": 1.0},
        outputs=[f"part{count - 1}.y"],
        isolated=isolated,
    )
    return time.perf_counter() - began, float(response.outputs[0, -1])


def in_python(path: Path, count: int, steps: int) -> Answer:
    loop, Run.in_c = Run.in_c, False
    try:
        return ours(path, count, steps)
    finally:
        Run.in_c = loop


def in_its_own_process(path: Path, count: int, steps: int) -> Answer:
    return ours(path, count, steps, isolated=True)


def with_fmpy(path: Path, count: int, steps: int) -> Answer:
    folder = extract(str(path))
    description = read_model_description(folder)
    signal = np.array([(0.0, 1.0)], dtype=[("time", float), ("u", float)])
    began = time.perf_counter()
    result = simulate_fmu(
        folder, model_description=description, fmi_type="CoSimulation", start_time=0.0, stop_time=steps * STEP,
        step_size=STEP, output_interval=STEP, input=signal, output=["y"],
    )  # fmt: skip
    return time.perf_counter() - began, float(result["y"][-1])


def with_ecos(path: Path, count: int, steps: int) -> Answer:
    from ecospy import EcosSimulation, EcosSimulationStructure

    with EcosSimulationStructure() as structure:
        for k in range(count):
            structure.add_model(f"part{k}", str(path))
        for sink, source in wires(count):
            structure.make_real_connection(source.strip("-").replace(".", "::"), sink.replace(".", "::"))
        with EcosSimulation(structure=structure, step_size=STEP) as simulation:
            simulation.init()
            began = time.perf_counter()
            simulation.step(steps)
            return time.perf_counter() - began, np.nan  # it negates no signal


def microseconds(
    host: Callable[[Path, int, int], Answer], path: Path, count: int, steps: int, runs: int
) -> float:
    """Of a step of one FMU; two lengths, so that the start does not count."""
    short, long = (min(host(path, count, n)[0] for _ in range(runs)) for n in (steps // 10, steps))
    return (long - short) / (steps - steps // 10) / count * 1e6


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="few steps: no verdict on times")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    scale, runs = (0.05, 1) if options.quick else (1.0, 3)
    hosts = [
        ("master in C", ours, 200_000),
        ("master in Python", in_python, 4_000),
        ("FMPy", with_fmpy, 20_000),
        ("process of its own", in_its_own_process, 4_000),
    ]
    if find_spec("ecospy") is None:
        print("skipped: ecos, which is not installed (pip install ecospy)")
    else:
        hosts.append(("ecos", with_ecos, 100_000))
    lag = ct.ss([[0.98]], [[0.02]], [[1.0]], [[0.0]], dt=STEP, inputs="u", outputs="y", name="lag")
    rows: dict[str, dict[str, float]] = {}
    right = True
    with tempfile.TemporaryDirectory() as folder:
        path = export_fmu(lag, Path(folder, "lag.fmu"), fmi="2.0", name="lag")
        answers = [host(path, 1, 400)[1] for _, host, _ in hosts[:4]]
        right = max(abs(answer - (1.0 - 0.98**400)) for answer in answers) < AGREES
        for name, host, steps in tqdm(hosts, disable=None):
            counts = (1,) if name in ("FMPy", "process of its own") else (1, 10)
            rows[name] = {f"{n} FMU": microseconds(host, path, n, int(scale * steps), runs) for n in counts}
    print(f"{'us a step of one FMU':20} {'alone':>8} {'ten in a ring':>14}")
    for name, row in rows.items():
        ring = f"{row['10 FMU']:14.2f}" if "10 FMU" in row else f"{'-':>14}"
        print(f"{name:20} {row['1 FMU']:8.2f} {ring}")
    kept = max(rows["master in C"].values()) < MOST
    print("OUTPUTS DIFFER" if not right else "a short run: no verdict" if options.quick else
          "the promises hold" if kept else "A PROMISE DOES NOT HOLD")  # fmt: skip
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))
    return 0 if right and (kept or options.quick) else 1


if __name__ == "__main__":
    sys.exit(main())
