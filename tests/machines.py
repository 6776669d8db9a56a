"""The suite on machines of every kind, as a table: processor kernels, threads, Python, oldest and newest dependencies.

    python -m tests.machines                             this environment, as it is
    python -m tests.machines --core-type Haswell Zen     with the kernels of three processors
    python -m tests.machines --python 3.11 3.13 --resolution lowest-direct highest
                                                         in environments made for it (needs uv)
    python -m tests.machines --turn "$(git rev-list --count HEAD)"
                                                         one Python and age of dependencies of those that are promised
                                                         and held here; the next number takes the next one
    python -m tests.machines --bare                      no compiler, HOME, fonts, network, writable checkout
    python -m tests.machines --sensitive                 only what depends on rounding and training
    python -m tests.machines -- -n 0 tests/test_filter.py     these files, with these options of pytest

Options multiply. One line a machine: passed, failed, skipped (whose reasons follow the table), wall and CPU seconds.
"""

from __future__ import annotations

import argparse
import itertools
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# What trains, factorises or searches, so that another order of summation shows.
SENSITIVE = (
    "tests/learned",
    "tests/design",
    "tests/analysis",
    "tests/baselines",
    "tests/models/test_acceleration.py",
)
# What is promised: every Python, with the oldest and newest dependencies.
PYTHONS, AGES = ("3.11", "3.12", "3.13", "3.14"), ("lowest-direct", "highest")
SHOWN = ("numpy", "scipy", "control", "casadi")
_VERSIONS = f"from importlib.metadata import version; print(*map(version, {SHOWN!r}))"
# A few products and factorisations: kernels of instructions the processor lacks die in them, and so do those of AVX2 in
# OpenBLAS 0.3.34 where the processor has AVX-512 (OpenMathLib/OpenBLAS issues 6013 and 6026: A A' overruns the stack;
# numpy 2.5.2 to 2.5.5 bring it).
_KERNELS = """
import numpy, scipy.linalg
for n, k in [(55, 165)] * 20 + [(n, k) for n in range(1, 130, 3) for k in (30, 80, 300)] + [(400, 80)] * 3:
    a = numpy.random.default_rng(0).standard_normal((n, k))
    a @ a.T, a.T @ a
for n in (3, 64, 200):
    a = numpy.random.default_rng(0).standard_normal((n, n))
    for linalg in (numpy.linalg, scipy.linalg):
        linalg.solve(a, a @ a), linalg.eig(a), linalg.svd(a), linalg.qr(a), linalg.cholesky(a @ a.T + numpy.eye(n))
"""
# No network but loopback and a checkout that cannot be written, for one command: Linux, and the right to do so.
_SEALED = (
    "tools=/usr/sbin:/usr/bin:/sbin:/bin; PATH=$tools ip link set lo up; PATH=$tools mount --bind {root} {root}"
    ' && PATH=$tools mount -o remount,bind,ro {root} && exec "$@"'
)


@dataclass(frozen=True)
class Machine:
    """One line of the table."""

    python: str  # interpreter, "" for this one
    resolution: str  # "" where the environment is taken as it is
    core_type: str
    threads: str
    bare: bool

    def environment(self, scratch: Path) -> dict[str, str]:
        """Variables under which the suite runs."""
        named = dict(os.environ)
        if self.bare:
            named = {
                name: value
                for name, value in named.items()
                if name not in ("CC", "DISPLAY", "XDG_CACHE_HOME")
            }
            (scratch / "bin").mkdir(exist_ok=True)  # no compiler on it, nor anything else
            named |= {
                "PATH": str(scratch / "bin"),
                "HOME": "/dev/null/home",
                "FONTCONFIG_FILE": "/dev/null/fonts.conf",
            }
        if self.core_type:
            named["OPENBLAS_CORETYPE"] = self.core_type
        if self.threads:
            named["OPENBLAS_NUM_THREADS"] = self.threads
        return named


@dataclass(frozen=True)
class Outcome:
    """What a run of the suite came to."""

    counts: Counter[str]
    failed: tuple[str, ...]
    reasons: Counter[str]
    wall: float
    cpu: float


def installed(version: str) -> str:
    """The interpreter of a version that pyenv holds but does not put in the way; else the version, for uv to find."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    found = sorted(pyenv.glob(f"versions/{version}.*/bin/python")) if version else []
    return str(found[-1]) if found else version


def held(version: str) -> bool:
    """Whether uv can make an environment of a version here."""
    uv = shutil.which("uv")
    return (
        uv is not None
        and subprocess.run([uv, "python", "find", installed(version)], capture_output=True).returncode == 0
    )


def turn(number: int, pythons: Sequence[str]) -> tuple[str, str]:
    """Python and age of dependencies of a number: all of them in as many numbers one after the other.

    >>> sorted(turn(number, PYTHONS) for number in range(100, 108)) == sorted(itertools.product(PYTHONS, AGES))
    True
    """
    every = [(python, age) for age in AGES for python in pythons]
    return every[number % len(every)]


def interpreter(machine: Machine, scratch: Path) -> str:
    """The Python of a machine; made, with its dependencies, where another version or another age is asked for.

    "" where that version cannot be had here.
    """
    if not machine.python and not machine.resolution:
        return sys.executable
    folder = scratch / f"python-{machine.python.replace(os.sep, '_')}-{machine.resolution or 'highest'}"
    python = folder / ("Scripts" if os.name == "nt" else "bin") / "python"
    if not python.exists():
        uv = shutil.which("uv")
        if uv is None:
            raise SystemExit(
                "other versions need uv (pip install uv); without it leave --python and --resolution out"
            )
        made = [uv, "venv", "-q", "--python", installed(machine.python) or sys.executable, str(folder)]
        # The oldest that has a wheel for this Python: older ones would be compiled, some from sources out of reach.
        age = ["--resolution", machine.resolution or "highest", "--only-binary", ":all:"]
        install = [uv, "pip", "install", "-q", "--python", str(python), *age, "-e", f"{ROOT}[test]"]
        if subprocess.run(made, check=False).returncode:
            return ""
        subprocess.run(install, check=True)
    return str(python)


def kernels_run(machine: Machine, python: str) -> bool:
    """Whether this processor can run the kernels asked for as this numpy brings them: a signal ends those it cannot."""
    if not machine.core_type:
        return True
    named = {**os.environ, "OPENBLAS_CORETYPE": machine.core_type}
    ended = subprocess.run([python, "-c", _KERNELS], env=named, capture_output=True).returncode
    return ended not in (
        -signal.SIGILL,
        -signal.SIGSEGV,
        -signal.SIGABRT,
        0xC000001D,
        0xC0000005,
    )  # POSIX, Windows


def run(machine: Machine, python: str, arguments: Sequence[str], scratch: Path) -> Outcome:
    """One run of the suite, its counts read from pytest's own report."""
    report = scratch / "report.xml"
    report.unlink(missing_ok=True)
    command = [python, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"--junitxml={report}", *arguments]
    if machine.bare and (seal := sealed()):
        command = [*seal, *command]
    before, began = os.times(), time.perf_counter()
    done = subprocess.run(
        command,
        cwd=ROOT,
        env=machine.environment(scratch),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    wall, after = time.perf_counter() - began, os.times()
    if not report.exists():
        raise SystemExit(f"{' '.join(command)}\nended without a report:\n{done.stdout[-3000:]}")
    counts, reasons, failed = Counter[str](), Counter[str](), []
    for case in ElementTree.parse(report).iter("testcase"):
        kinds = {child.tag: child for child in case}
        kind = next((tag for tag in ("error", "failure", "skipped") if tag in kinds), "passed")
        counts["failed" if kind in ("error", "failure") else kind] += 1
        if kind == "skipped":  # without the place, so that a reason is counted once
            why = (kinds[kind].text or "").strip()
            reasons[re.sub(r"""^(\(.*['"]Skipped: |\S*:\d+: )|['"]\)$""", "", why, flags=re.S)] += 1
        elif kind != "passed":
            why = (kinds[kind].get("message") or "").strip().splitlines()[:1]
            failed.append(": ".join([f"{case.get('classname')}::{case.get('name')}", *why]))
    if done.returncode and not failed:  # nothing failed by name: what pytest said is all there is
        counts["failed"] += 1
        failed.append(f"pytest ended with {done.returncode}:\n{done.stdout[-2000:]}")
    cpu = sum(after[2:4]) - sum(before[2:4])
    return Outcome(counts, tuple(failed), reasons, wall, cpu)


def sealed() -> list[str]:
    """The command in front of another that takes network and writing away; none where the system does not let it."""
    unshare, shell = shutil.which("unshare"), shutil.which("sh")
    if unshare is None or shell is None:
        return []
    front = [unshare, "--net", "--mount", shell, "-c", _SEALED.format(root=ROOT), "sh"]
    return front if subprocess.run([*front, "/bin/true"], capture_output=True).returncode == 0 else []


def table(rows: Sequence[tuple[Machine, str, str, Outcome]]) -> Iterator[str]:
    """The table in Markdown, then why tests were skipped and which failed."""
    yield f"| kernels | threads | Python | {', '.join(SHOWN)} | passed | failed | skipped | wall s | CPU s |"
    yield "|" + "---|" * 9
    for machine, python, versions, outcome in rows:
        c = outcome.counts
        yield (
            f"| {machine.core_type or 'own'} | {machine.threads or 'own'} | {python}{' bare' if machine.bare else ''} "
            f"| {versions} | {c['passed']} | {c['failed']} | {c['skipped']} | {outcome.wall:.0f} | {outcome.cpu:.0f} |"
        )
    reasons = sum((outcome.reasons for *_, outcome in rows), Counter[str]())
    yield from (f"skipped {count} times: {reason}" for reason, count in reasons.most_common())
    for machine, python, _, outcome in rows:
        yield from (f"failed ({machine.core_type or 'own'}, {python}): {name}" for name in outcome.failed)


def main() -> int:
    """Run what is asked for and print the table; 1 if anything failed."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.machines", description=(__doc__ or "").split("\n\n")[0]
    )
    parser.add_argument("--python", nargs="+", default=[""], help="versions or interpreters (needs uv)")
    parser.add_argument("--resolution", nargs="+", default=[""], choices=["", "lowest-direct", "highest"])
    parser.add_argument(
        "--turn",
        type=int,
        metavar="N",
        help="the N-th Python and resolution of those held here, round and round",
    )
    parser.add_argument(
        "--core-type", nargs="+", default=[""], help="OPENBLAS_CORETYPE, e.g. Haswell Zen Nehalem"
    )
    parser.add_argument("--threads", nargs="+", default=[""], help="BLAS threads")
    parser.add_argument(
        "--bare", action="store_true", help="without compiler, HOME, fonts, network, writable checkout"
    )
    parser.add_argument("--sensitive", action="store_true", help="only what depends on rounding")
    parser.add_argument("--environments", type=Path, help="folder that keeps environments for the next run")
    parser.add_argument("tests", nargs="*", help="files and options for pytest instead of the whole suite")
    asked = parser.parse_args()
    if asked.turn is not None:
        if asked.python != [""] or asked.resolution != [""]:
            parser.error("--turn chooses Python and resolution: leave --python and --resolution out")
        pythons = [version for version in PYTHONS if held(version)]
        if not pythons:
            parser.error(f"--turn: expected uv and one of Python {', '.join(PYTHONS)}, found none")
        asked.python, asked.resolution = ([chosen] for chosen in turn(asked.turn, pythons))
        print(
            f"turn {asked.turn}: Python {asked.python[0]}, {asked.resolution[0]}, of Python {', '.join(pythons)}",
            flush=True,
        )
    rows = []
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        for values in itertools.product(asked.python, asked.resolution, asked.core_type, asked.threads):
            machine = Machine(*values, asked.bare)
            python = interpreter(machine, asked.environments or scratch)
            if not python:
                print(f"skipped: Python {machine.python} is not on this machine", flush=True)
                continue
            if not kernels_run(machine, python):
                print(
                    f"skipped: this processor cannot run the kernels of {machine.core_type} as numpy brings them",
                    flush=True,
                )
                continue
            ask = "import platform; print(platform.python_version())"
            known = [
                subprocess.run(
                    [python, "-c", code], check=True, capture_output=True, text=True
                ).stdout.strip()
                for code in (ask, _VERSIONS)
            ]
            outcome = run(machine, python, asked.tests or (SENSITIVE if asked.sensitive else ()), scratch)
            rows.append((machine, known[0], known[1], outcome))
            print(
                *outcome.failed,
                f"{outcome.counts['failed']} failed in {outcome.wall:.0f} s",
                sep="\n",
                flush=True,
            )
    print(*table(rows), sep="\n")
    return int(any(outcome.counts["failed"] for *_, outcome in rows))


if __name__ == "__main__":
    sys.exit(main())
