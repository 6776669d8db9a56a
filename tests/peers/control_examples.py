"""python-control's own examples in the shadow of simulate: ``python -m tests.peers.control_examples``.

Fetches the source of the installed version from PyPI into a temporary folder, runs its examples, notebooks and tests,
simulates every nonlinear or interconnected system that they simulate a second time, in the virtual machine and in C,
and prints how many answers are equal, refused, wrong, failed (a status where python-control has an answer) or crashed,
and what it costs. Fails where one is wrong, has failed or crashed. With ``--backends draw`` their block diagrams are
drawn instead: equal are those without a fault.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import Any

from tests.peers.python_control import ROOT, fetched, pytest_with
from tests.peers.shadow import BACKENDS, EACH, REPORT

# Those that simulate nonlinear or interconnected systems.
SIMULATES = "nlsys|NonlinearIOSystem|interconnect|flatsys|input_output_response|phase_plane|optimal"
TESTS = "descfcn flatsys interconnect iosys kwargs nlsys optimal statefbk stochsys timeresp trdata phaseplot timeplot"
QUICK = ("cruise.ipynb", "cds112-L2b_gainsched.ipynb")
SHADOW = "tests.peers.shadow"
_LONGEST = 240.0  # s for one example


def environment(source: Path, report: Path, backends: str) -> dict[str, str]:
    return os.environ | {
        REPORT: str(report), BACKENDS: backends, "MPLBACKEND": "Agg", "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(map(str, (source, ROOT))),
    }  # fmt: skip


def run(command: list[str], folder: Path, env: dict[str, str], name: str) -> None:
    """A child process and what became of it."""
    begin = time.perf_counter()
    try:
        done = subprocess.run(
            command, cwd=folder, env=env, capture_output=True, text=True, timeout=_LONGEST, check=False
        )
        last = (done.stderr.strip().splitlines() or [""])[-1] if done.returncode else ""
    except subprocess.TimeoutExpired:
        last = f"stopped after {_LONGEST:.0f} s"
    if last or time.perf_counter() - begin > 20:
        print(f"  {name}: {time.perf_counter() - begin:.0f} s {last}", flush=True)


def table(title: str, entries: list[dict[str, Any]], backends: list[str]) -> int:
    """Prints the counts and the ratios of time; returns how many are wrong, have failed or crashed."""
    bad = 0
    print(f"\n{title}: {len(entries)} systems")
    print(
        f"{'':4} {'equal':>7} {'refused':>8} {'wrong':>6} {'failed':>7} {'crashed':>8}   "
        "time over python-control's, median"
    )
    for backend in backends:
        answers = [(entry, entry[backend]) for entry in entries if backend in entry]
        counts = Counter(answer["verdict"] for _, answer in answers)
        ratios = {
            key: [answer[key] / entry["control"] for entry, answer in answers if answer["verdict"] == "equal"]
            for key in ("once", "warm")
        }
        text = ", ".join(f"{key} {median(values):.3g}" for key, values in ratios.items() if values)
        print(
            f"{backend:4} {counts['equal']:7} {counts['refused']:8} {counts['wrong']:6} {counts['failed']:7} "
            f"{counts['crashed']:8}   {text}"
        )
        bad += counts["wrong"] + counts["failed"] + counts["crashed"]
        interpreted = sum(bool(answer.get("callbacks")) for _, answer in answers)
        if interpreted:
            print(f"       of the equal ones {interpreted} with a block that runs as Python")
        unread = sum(bool(answer.get("unread")) for _, answer in answers)
        if unread:
            print(
                f"       {unread} calls gave parameters that no block reads, which simulate refuses: left out"
            )
    for backend in backends:
        reasons = Counter(
            (entry[backend]["verdict"], _short(entry[backend]["why"]))
            for entry in entries
            if backend in entry and entry[backend]["verdict"] != "equal"
        )
        for (verdict, why), count in reasons.most_common():
            print(f"  {backend:3} {verdict} {count:3}: {why}")
    skipped = Counter(_short(entry["skipped"]) for entry in entries if "skipped" in entry)
    for why, count in skipped.most_common():
        print(f"  not compared {count:3}: {why}")
    return bad


def _short(why: str) -> str:
    """A reason without the names and numbers of the case."""
    plain = re.sub(r"^block \S+: |\[[^\]]*\]|\d[\d.e+-]*", "", why).strip()
    return (plain.splitlines() or [""])[-1][:150]


def main() -> int:
    """Run all and print the tables; 1 if an answer is wrong, has failed or crashed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="some examples, no tests")
    parser.add_argument("--only", help="examples whose name matches this, no tests")
    parser.add_argument("--backends", default="vm c")
    parser.add_argument("--source", type=Path, help="an unpacked source that is already there")
    parser.add_argument("--report", type=Path, help="keep the list of all answers there, one JSON a line")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source = options.source or fetched(folder)
        if source is None:
            return 0
        report = options.report or folder / "report.jsonl"
        env = environment(source, report, options.backends) | ({EACH: "1"} if options.quick else {})
        examples = sorted(p for kind in ("*.py", "*.ipynb") for p in (source / "examples").glob(kind))
        examples = [p for p in examples if re.search(SIMULATES, p.read_text(encoding="utf-8"))]
        if options.quick:
            examples = [p for p in examples if p.name in QUICK]
        if options.only:
            examples = [p for p in examples if re.search(options.only, p.name)]
        tables = {"examples and notebooks": examples, "tests": []}
        if not options.quick and not options.only:
            tables["tests"] = [source / f"control/tests/{part}_test.py" for part in TESTS.split()]
        bad, total = 0, 0
        for title, files in tables.items():
            if not files:
                continue
            report.write_text("")
            for file in files:
                command = [sys.executable, "-m", SHADOW, str(file)]
                if title == "tests":
                    command = pytest_with(SHADOW, str(file))
                run(command, source, env, file.name)
            entries = [json.loads(line) for line in report.read_text(encoding="utf-8").splitlines()]
            bad += table(f"control {version('control')}, {title}", entries, options.backends.split())
            total += len(entries)
            if options.report:
                options.report.with_suffix(f".{title.split()[0]}").write_text(report.read_text())
    return int(bad > 0 or not total)


if __name__ == "__main__":
    sys.exit(main())
