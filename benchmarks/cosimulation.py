"""What a communication step of a co-simulation FMU costs: the master beside other hosts.

    python benchmarks/cosimulation.py [--quick] [--json FILE]

FMUs of a sampled first-order lag (FMI 2.0, period 2 ms): one alone; ten in a ring; nine of them with a linear
python-control system among them, and with a nonlinear one. Ten continuous FMUs with direct feedthrough in a ring, an
algebraic loop: each integrates its own state, which counts. A ramp from outside keeps every signal moving; no results
but the last; the start of each host is not counted. Beside the master in C: the same in Python (what a machine without
a C compiler runs), in Python with the FMU in a process of its own (isolated=True), FMPy's simulate_fmu (one FMU), and
ecos where it is installed (PyPI ecospy; it solves no loops). All in time of the processor, which other programs do not
change, but for the process of its own: that by the clock.
Promises: the outputs are those of a calculation by hand; the master in C takes less than 1 us a step of an FMU, except
where it calls Python for the nonlinear system.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import control as ct
import numpy as np
from fmpy import extract, read_model_description, simulate_fmu
from tqdm import tqdm

from phyfilter_ctl.fmi import Fmu, Master, System, cosimulate, export_fmu
from phyfilter_ctl.fmi.cosimulation_run import Run

STEP = 0.002
A, THROUGH = 0.98, 0.5
MOST = 1.0  # us
AGREES = 1e-9  # the residual that an algebraic loop may leave, times ten lags; rounding otherwise
Answer = tuple[float, float]  # s, output of the last part
Host = Callable[["Case", int], Answer]


@dataclass(frozen=True)
class Case:
    """FMUs in a ring, or one alone."""

    name: str
    path: Path
    fmus: int = 10
    through: float = 0.0
    among: ct.InputOutputSystem | None = None
    in_c: bool = True

    @property
    def wires(self) -> list[tuple[str, str]]:
        """Each part on the one before, the first one on the last, subtracted."""
        count = self.fmus + (self.among is not None)
        each = range(count if count > 1 else 0)
        return [(f"part{k}.u", f"{'' if k else '-'}part{(k - 1) % count}.y") for k in each]

    def by_hand(self, steps: int) -> float:
        """Output of the last part. A sampled FMU makes the sample at the end of a step on the input of that step."""
        count = self.fmus + (self.among is not None)
        ring = np.eye(count, k=-1) if count > 1 else np.zeros((1, 1))
        ring[0, -1] -= count > 1
        sampled = np.full(count, not self.through)
        sampled[self.fmus :] = False
        a = np.where(sampled, A, np.exp(-STEP))
        x, r = np.zeros(count), np.zeros(count)
        u = before = y = r
        solve = np.linalg.inv(np.eye(count) - self.through * ring)
        for k in range(steps + 1):
            r[0] = k / steps
            y = solve @ (x + self.through * r)
            if not self.in_c:
                y[-1] = np.tanh(y[-2])
            u = ring @ y + r
            x = a * x + (1.0 - a) * np.where(sampled, before if k else u, u)
            before = u
        return float(y[-1])


def ours(case: Case, steps: int, *, isolated: bool = False) -> Answer:
    fmu = Fmu(case.path, isolated=isolated)
    parts: dict[str, Fmu | ct.InputOutputSystem] = {f"part{k}": fmu for k in range(case.fmus)}
    if case.among is not None:
        parts[f"part{case.fmus}"] = case.among
    clock = time.perf_counter if isolated else time.process_time
    began = clock()
    response = cosimulate(
        System(parts, case.wires),
        [0.0, steps * STEP],
        inputs={"part0.r": [0.0, 1.0]},
        outputs=[f"part{len(parts) - 1}.y"],
        master=Master(STEP),
    )
    took = clock() - began
    assert response.success, response.message
    return took, float(response.outputs[0, -1])


def in_python(case: Case, steps: int) -> Answer:
    loop, Run.in_c = Run.in_c, False
    try:
        return ours(case, steps)
    finally:
        Run.in_c = loop


def with_fmpy(case: Case, steps: int) -> Answer:
    folder = extract(str(case.path))
    description = read_model_description(folder)
    signal = np.array([(0.0, 0.0), (steps * STEP, 1.0)], dtype=[("time", float), ("r", float)])
    began = time.process_time()
    result = simulate_fmu(
        folder, model_description=description, fmi_type="CoSimulation", start_time=0.0, stop_time=steps * STEP,
        step_size=STEP, output_interval=STEP, input=signal, output=["y"],
    )  # fmt: skip
    return time.process_time() - began, float(result["y"][-1])


def with_ecos(case: Case, steps: int) -> Answer:
    from ecospy import EcosSimulation, EcosSimulationStructure

    with EcosSimulationStructure() as structure:
        for k in range(case.fmus):
            structure.add_model(f"part{k}", str(case.path))
        for sink, source in case.wires:
            structure.make_real_connection(source.strip("-").replace(".", "::"), sink.replace(".", "::"))
        with EcosSimulation(structure=structure, step_size=STEP) as simulation:
            simulation.init()
            began = time.process_time()
            simulation.step(steps)
            return time.process_time() - began, np.nan  # it negates no signal


def microseconds(host: Host, case: Case, steps: int, runs: int) -> float:
    """Of a step of one FMU; two lengths, so that the start does not count."""
    short, long = (min(host(case, n)[0] for _ in range(runs)) for n in (steps // 10, steps))
    return (long - short) / (steps - steps // 10) / case.fmus * 1e6


def cases(folder: Path) -> list[Case]:
    names = {"inputs": ["u", "r"], "outputs": "y"}
    lag = ct.ss([[A]], [[1.0 - A] * 2], [[1.0]], [[0.0] * 2], dt=STEP, name="lag", **names)
    lead = ct.ss([[-1.0]], [[1.0] * 2], [[1.0]], [[THROUGH] * 2], name="lead", **names)
    paths = [
        export_fmu(block, folder / f"{block.name}.fmu", fmi="2.0", name=block.name) for block in (lag, lead)
    ]
    slow = ct.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs="u", outputs="y", name="slow")
    bend = ct.nlsys(None, lambda t, x, u, params: np.tanh(u), inputs="u", outputs="y", name="bend")
    return [
        Case("alone", paths[0], fmus=1),
        Case("ring", paths[0]),
        Case("loop", paths[1], through=THROUGH),
        Case("linear", paths[0], fmus=9, among=slow),
        Case("nonlinear", paths[0], fmus=9, among=bend, in_c=False),
    ]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="few steps: no verdict on times")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    scale, runs = (0.02, 1) if options.quick else (1.0, 3)
    everything = ("alone", "ring", "loop", "linear", "nonlinear")
    hosts: list[tuple[str, Host, int, tuple[str, ...]]] = [
        ("master in C", ours, 300_000, everything),
        ("master in Python", in_python, 1_000, everything),
        ("FMPy", with_fmpy, 20_000, ("alone",)),
        ("process of its own", partial(ours, isolated=True), 4_000, ("alone",)),
    ]
    if find_spec("ecospy") is None:
        print("skipped: ecos, which is not installed (pip install ecospy)")
    else:
        hosts.append(("ecos", with_ecos, 100_000, ("alone", "ring")))
    rows: dict[str, dict[str, float]] = {}
    wrong = []
    with tempfile.TemporaryDirectory() as folder:
        all_cases = cases(Path(folder))
        for name, host, steps, able in tqdm(hosts, disable=None):
            rows[name] = {}
            for case in (case for case in all_cases if case.name in able):
                answer = host(case, 100)[1]
                if name != "ecos" and not abs(answer - case.by_hand(100)) < AGREES:
                    wrong.append(f"{name}, {case.name}: {answer!r}, by hand {case.by_hand(100)!r}")
                few = 0.1 if name == "master in C" and not case.in_c else 1.0
                rows[name][case.name] = microseconds(host, case, int(few * scale * steps), runs)
    print(f"{'us a step of one FMU':20}" + "".join(f"{name:>11}" for name in everything))
    for name, row in rows.items():
        print(
            f"{name:20}" + "".join(f"{row[key]:11.2f}" if key in row else f"{'-':>11}" for key in everything)
        )
    kept = all(rows["master in C"][case.name] < MOST for case in all_cases if case.in_c)
    print("\n".join(["OUTPUTS DIFFER", *wrong]) if wrong else "a short run: no verdict" if options.quick else
          "the promises hold" if kept else "A PROMISE DOES NOT HOLD")  # fmt: skip
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))
    return 0 if not wrong and (kept or options.quick) else 1


if __name__ == "__main__":
    sys.exit(main())
