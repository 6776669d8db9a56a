"""Which wrong lines the suite lets pass: ``python -m tests.mutate ROOM...``, from the top of the checkout.

A room is a module or package of ``phyfilter_ctl``. Changes of six kinds (operator, comparison, constant, sign,
boundary, dropped statement), equally many of each, are drawn at random over its files. Each is tried on a copy of the
tree with the tests of the default suite that run its line, the nearest and quickest first, until one fails or a minute
is over. Which tests run which lines is recorded once for a state of the code, which takes about twice as long as the
suite, and kept in ``build/mutate``.

A change is killed where a test fails or the run hangs; it survives where all pass; or no test runs its line. The score
is the killed part of all. Below that of ``tests/mutation_baseline.toml``, for the same count and seed, the status is 1.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import os
import queue
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

from tests.mutate.coverage_records import Records
from tests.mutate.mutants import KINDS, Mutant, compiles, drawn, mutants
from tests.mutate.recording import FOLDER

ROOT = Path(__file__).resolve().parents[2]
BASELINE = ROOT / "tests" / "mutation_baseline.toml"
PACKAGE = "phyfilter_ctl"
KILLED, SURVIVED, NOT_COVERED = "killed", "survived", "not covered"
# Seconds that a mutant gets, and those of its tests by the record: what is far from the line and slow is left out.
SECONDS, RECORDED = 60.0, 30.0
_LEFT_OUT = shutil.ignore_patterns(
    ".git", ".venv", "build", "dist", "out", "__pycache__", ".*_cache", ".hypothesis"
)
_PYTEST = [sys.executable, "-m", "pytest", "-q", "-pno:cacheprovider", "-pno:tests.cpu_budget"]


@dataclass(frozen=True)
class Outcome:
    """What became of a mutant, and of how many tests that run its line how many were tried."""

    mutant: Mutant
    result: str
    by: str = ""
    tests: int = 0
    known: int = 0


def room_files(root: Path, room: str) -> list[str]:
    """Python files of a room, from the top of the checkout.

    Raises
    ------
    ValueError
        If there is no such room.
    """
    place = root / PACKAGE / room
    found = sorted(place.rglob("*.py")) if place.is_dir() else [place.with_suffix(".py")]
    if not found or not all(path.is_file() for path in found):
        rooms = sorted(
            {
                p.stem
                for p in (root / PACKAGE).iterdir()
                if (p.suffix == ".py" and p.stem[:2] != "__") or (p / "__init__.py").is_file()
            }
        )
        raise ValueError(f"ROOM: there is no {PACKAGE}/{room}; expected one of {', '.join(rooms)}")
    return [path.relative_to(root).as_posix() for path in found]


def candidates(root: Path, room: str) -> list[Mutant]:
    """All mutants of a room."""
    return [each for file in room_files(root, room) for each in mutants(file, _text(root / file))]


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def chosen_mutants(root: Path, room: str, count: int, seed: int) -> list[Mutant]:
    """Those to try."""
    return drawn(candidates(root, room), count, seed, lambda each: compiles(each, _text(root / each.file)))


def recorded(root: Path, keep: Path) -> Records:
    """The record of this state of the code, made where there is none."""
    sources = sorted(p for part in (PACKAGE, "models", "tests") for p in (root / part).rglob("*.py"))
    digest = hashlib.sha256()
    for path in sources:
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    folder = keep / digest.hexdigest()[:16]
    if not (folder / "root").is_file():
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        with tempfile.TemporaryDirectory() as scratch:
            tree = _copied(root, Path(scratch) / "tree")
            print("recording which tests run which lines", flush=True)
            command = [*_PYTEST, "-p", "tests.mutate.recording", "--no-summary"]
            subprocess.run(command, cwd=tree, env=_environment(tree) | {FOLDER: str(folder)}, check=False)
            (folder / "root").write_text(str(tree), encoding="utf-8")
    return Records.read(folder)


def _copied(root: Path, tree: Path) -> Path:
    shutil.copytree(root, tree, ignore=_LEFT_OUT)
    return tree


def _environment(tree: Path) -> dict[str, str]:
    path = os.pathsep.join([str(tree), *filter(None, [os.environ.get("PYTHONPATH")])])
    return {**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"}


def chosen_tests(records: Records, root: Path, mutant: Mutant, room: str) -> tuple[list[str], int]:
    """Tests to try a mutant with, in order, and how many run its line.

    What runs as the module is imported is anything to a test that runs a function of the file.
    """
    lines = records.tests_by_line(mutant.file)
    if mutant.inside:
        known = lines.get(mutant.line) or lines.get(mutant.statement, set())
    else:
        inside = _lines_inside(_text(root / mutant.file))
        known = {test for line, tests in lines.items() if line in inside for test in tests}

    def far(test: str) -> tuple[bool, bool, float]:
        return test.split("::")[0] != mutant.file, f"/{room}/" not in test, records.seconds(test)

    chosen, spent = [], 0.0
    for test in sorted(known, key=lambda test: (*far(test), test)):
        spent += records.seconds(test)
        if not chosen or spent <= RECORDED:
            chosen.append(test)
    return chosen, len(known)


def _lines_inside(source: str) -> set[int]:
    functions = [
        n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    return {line for f in functions for line in range(f.body[0].lineno, (f.end_lineno or 0) + 1)}


def tried(tree: Path, mutant: Mutant, tests: Sequence[str], seconds: float = SECONDS) -> tuple[str, str]:
    """Result and the test that killed, of a mutant in a copy of the tree, which is as before afterwards.

    Raises
    ------
    RuntimeError
        If pytest finds nothing to run.
    """
    path = tree / mutant.file
    source = path.read_bytes()
    listed = tree / "mutate_tests.txt"
    listed.write_text("\n".join(tests), encoding="utf-8")
    try:
        path.write_text(mutant.applied(source.decode()), encoding="utf-8", newline="")
        command = [*_PYTEST, "-n0", "-x", "--no-header", "-rf", "--tb=no", f"@{listed}"]
        process = subprocess.Popen(
            command, cwd=tree, env=_environment(tree), text=True, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip
        try:
            said, _ = process.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            if os.name == "posix":  # what a test started ends too
                os.killpg(process.pid, signal.SIGKILL)
            process.kill()
            process.communicate()
            return KILLED, f"no end in {seconds:g} s"
    finally:
        path.write_bytes(source)
    if process.returncode == 0:
        return SURVIVED, ""
    if process.returncode == 5:
        raise RuntimeError(f"pytest runs none of {tests[:3]}: {said[-500:]}")
    failed = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", said, re.M)
    return KILLED, failed[1] if failed else "the import"


def survey(root: Path, records: Records, room: str, chosen: Sequence[Mutant], workers: int) -> list[Outcome]:
    """Try mutants, several at a time, each worker on a copy of its own."""
    with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(workers) as pool:
        trees: queue.Queue[Path] = queue.Queue()
        for i in range(workers):
            trees.put(_copied(root, Path(scratch) / f"tree{i}"))

        def judge(mutant: Mutant) -> Outcome:
            tests, known = chosen_tests(records, root, mutant, room)
            if not tests:
                return Outcome(mutant, NOT_COVERED)
            tree = trees.get()
            try:
                return Outcome(mutant, *tried(tree, mutant, tests), len(tests), known)
            finally:
                trees.put(tree)

        return list(pool.map(judge, chosen))


def score(outcomes: Sequence[Outcome]) -> float:
    """Killed part of all, to three digits; nan of none."""
    return round(sum(o.result == KILLED for o in outcomes) / len(outcomes), 3) if outcomes else float("nan")


def report(room: str, outcomes: Sequence[Outcome]) -> str:
    """The score of a room, by kind too, and what lives."""
    by = Counter((o.mutant.kind, o.result) for o in outcomes)
    counts = Counter(o.result for o in outcomes)
    lines = [
        f"{room}: {score(outcomes):.3f} of {len(outcomes)} ("
        + ", ".join(f"{counts[each]} {each}" for each in (KILLED, SURVIVED, NOT_COVERED))
        + ")",
        "  killed by kind: "
        + ", ".join(
            f"{k} {by[k, KILLED]}/{sum(by[k, r] for r in (KILLED, SURVIVED, NOT_COVERED))}" for k in KINDS
        ),
    ]
    for o in outcomes:
        if o.result != KILLED:
            m, tests = o.mutant, f", {o.tests} of {o.known} tests" if o.known else ""
            lines.append(
                f"  {o.result}{tests}: {m.file}:{m.line}: {m.kind}: {_short(m.before)} -> {_short(m.after)}"
            )
    return "\n".join(lines)


def _short(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= 70 else f"{text[:67]}..."


def lowered(baseline: dict[str, dict[str, float]], room: str, count: int, seed: int, found: float) -> str:
    """In words where a score is below the baseline's; empty where it is not, or where there is none to compare with."""
    known = baseline.get(room, {})
    if (known.get("count"), known.get("seed")) != (count, seed) or found >= known["score"]:
        return ""
    return f"{room}: {found:.3f} is below the baseline's {known['score']:.3f}: test what the change no longer holds"


def _write(baseline: dict[str, dict[str, float]]) -> None:
    head = "# Killed part of random mutants by room: python -m tests.mutate ROOM --count COUNT --seed SEED --baseline\n"
    rows = [
        f"[{room}]\ncount = {k['count']}\nseed = {k['seed']}\nscore = {k['score']}\n"
        for room, k in sorted(baseline.items())
    ]
    BASELINE.write_text("\n".join([head, *rows]), encoding="utf-8")


def main() -> int:
    """Try the rooms; 1 if a score is below the baseline's."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.mutate", description="Which wrong lines the suite lets pass, by room."
    )
    parser.add_argument("rooms", metavar="ROOM", nargs="+", help=f"module or package of {PACKAGE}")
    parser.add_argument("--count", type=int, default=40, help="mutants of each room (40)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="at a time; one a core")
    parser.add_argument("--json", type=Path, metavar="FILE", help="all outcomes")
    parser.add_argument(
        "--baseline", action="store_true", help=f"keep the scores in {BASELINE.relative_to(ROOT)}"
    )
    options = parser.parse_args()
    if options.count < 1 or options.workers < 1:
        parser.error(f"expected --count and --workers >= 1, got {options.count} and {options.workers}")
    try:
        found = {room: chosen_mutants(ROOT, room, options.count, options.seed) for room in options.rooms}
    except ValueError as error:
        parser.error(str(error))
    records = recorded(ROOT, ROOT / "build" / "mutate")
    baseline = tomllib.loads(_text(BASELINE)) if BASELINE.is_file() else {}
    shown, worse = [], []
    for room, chosen in found.items():
        outcomes = survey(ROOT, records, room, chosen, options.workers)
        print(report(room, outcomes), flush=True)
        shown += [{"room": room, **asdict(outcome)} for outcome in outcomes]
        if options.baseline and outcomes:
            baseline[room] = {"count": options.count, "seed": options.seed, "score": score(outcomes)}
            _write(baseline)
        if options.json:  # after each room: a long search may be ended
            options.json.write_text(json.dumps(shown, indent=1), encoding="utf-8")
        worse += filter(None, [lowered(baseline, room, options.count, options.seed, score(outcomes))])
    print(*worse, sep="\n", end="\n" * bool(worse))
    return int(bool(worse))


if __name__ == "__main__":
    sys.exit(main())
