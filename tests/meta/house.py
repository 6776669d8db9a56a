"""How large the house is, and how its rooms hang together, as a table: before and after a change.

    python -m tests.meta.house                  this tree
    python -m tests.meta.house --at COMMIT      that commit beside it (repeatable; needs git)
    python -m tests.meta.house --circles        with every import circle's modules, and the walk's

A room is a module or package of `phyfilter_ctl`; an arrow is an import from one room to another, those for type
checking and those inside functions included. Floors are the longest way down. The walk is what a record's x passes:
read from a file, a filter learned from it, run, exported as an FMU.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterable, Mapping
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = "phyfilter_ctl"
Graph = dict[str, set[str]]

# Runs in the tree it measures; prints the functions of the package in order of their first call.
_WALK = r"""
import json, sys, tempfile
from pathlib import Path
import numpy as np
import phyfilter_ctl as pf

package = str(Path(pf.__file__).parent)
seen = {}
def note(frame, event, argument):
    code = frame.f_code
    ours = code.co_filename.startswith(package) and not code.co_name.startswith("<")
    if event == "call" and ours and code.co_flags & 1:  # a function; bodies of classes are not optimised
        seen.setdefault((code.co_filename[len(package) + 1 :], code.co_qualname), None)

t = 0.01 * np.arange(1500)
f = np.sin(3.0 * t) + np.sin(0.7 * t)
x = np.cumsum(0.01 * f) + 1e-3 * np.random.default_rng(0).standard_normal(1500)
rows = "".join(f"{a!r},{b!r},{c!r}\n" for a, b, c in np.stack([t, x, f], axis=1).tolist())
with tempfile.TemporaryDirectory() as folder:
    path = Path(folder, "log.csv")
    path.write_text("t,x,label_x\n" + rows)
    sys.setprofile(note)
    log = pf.Recording.from_csv(path, x=["x"])
    sampled = pf.learn(log, 1).filter.sampled(0.01)
    sampled.run(log.x)
    pf.export_fmu(sampled, Path(folder, "filter.fmu"), channels=1)
    sys.setprofile(None)
print(json.dumps(list(seen)))
"""


def modules(tree: Path) -> dict[str, Path]:
    """Dotted names and files of the package; the wheel carries the top-level models in it."""
    found = {}
    for path in sorted([*(tree / PACKAGE).rglob("*.py"), *(tree / "models").rglob("*.py")]):
        relative = path.relative_to(tree)
        parts = (() if relative.parts[0] == PACKAGE else (PACKAGE,)) + relative.with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(name: str, path: Path, known: Iterable[str]) -> set[str]:
    """Modules of the package that one module names, wherever in the file."""
    known, found = set(known), set()
    package = name if path.stem == "__init__" else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            for alias in node.names:
                full = f"{base}.{alias.name}"
                found.add(full if full in known else base)
    return {entry for entry in found if entry in known} - {name}


def graph(tree: Path) -> Graph:
    """Which module imports which."""
    files = modules(tree)
    return {name: imports(name, path, files) for name, path in files.items()}


def circles(edges: Graph) -> list[list[str]]:
    """Strongly connected components of more than one module (Tarjan, SIAM J. Computing 1 (1972))."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(name: str) -> None:
        index[name] = low[name] = len(index)
        stack.append(name)
        for other in sorted(edges[name]):
            if other not in index:
                visit(other)
            if other in stack:
                low[name] = min(low[name], low[other])
        if low[name] == index[name]:
            part = stack[stack.index(name) :]
            del stack[stack.index(name) :]
            if len(part) > 1:
                found.append(sorted(part))

    for name in sorted(edges):
        if name not in index:
            visit(name)
    return found


def rooms(edges: Graph) -> Graph:
    """Modules joined to rooms: the first name below the package."""
    joined: Graph = {}
    for name, others in edges.items():
        if name == PACKAGE:
            continue
        room = name.split(".")[1]
        joined.setdefault(room, set()).update(
            other.split(".")[1] for other in others if other != PACKAGE and other.split(".")[1] != room
        )
    return joined


def floors(edges: Graph) -> int:
    """Rooms on the longest way down; rooms of one circle share a floor."""
    member = {name: name for name in edges}
    for part in circles(edges):
        member |= dict.fromkeys(part, part[0])
    joined: Graph = {}
    for name, others in edges.items():
        joined.setdefault(member[name], set()).update({member[other] for other in others} - {member[name]})
    height: dict[str, int] = {}
    for name in TopologicalSorter(joined).static_order():
        height[name] = 1 + max((height[other] for other in joined[name]), default=0)
    return max(height.values())


def _is_foundation(room: str) -> bool:
    """What every room may stand on: checks of signals, sections, files, results."""
    return room.startswith("_") or room == "results"


def code_lines(path: Path) -> int:
    """Lines that are neither blank, nor comment, nor docstring."""
    source = path.read_text()
    documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    prose = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, documented) and ast.get_docstring(node) is not None:
            prose |= set(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    lines = enumerate(source.splitlines(), start=1)
    return sum(
        bool(text.strip()) and not text.strip().startswith("#") and i not in prose for i, text in lines
    )


def walk(tree: Path) -> list[tuple[str, str]]:
    """Files and functions of the package from a log to an FMU, in order."""
    run = subprocess.run([sys.executable, "-c", _WALK], cwd=tree, check=True, capture_output=True, text=True)
    return [(file, function) for file, function in json.loads(run.stdout)]


def measures(tree: Path) -> tuple[dict[str, int], list[list[str]], list[tuple[str, str]]]:
    """The table's column of one tree, its circles and its walk."""
    edges = graph(tree)
    between, parts, steps = rooms(edges), circles(edges), walk(tree)
    library = sorted((tree / PACKAGE).rglob("*.py"))
    models = sorted((tree / "models").rglob("*.py"))
    column = {
        "library, files": len(library),
        "library, lines": sum(len(path.read_text().splitlines()) for path in library),
        "library, lines of code": sum(map(code_lines, library)),
        "models, lines": sum(len(path.read_text().splitlines()) for path in models),
        "models, lines of code": sum(map(code_lines, models)),
        "rooms": len(between),
        "floors": floors(between),
        "arrows": sum(map(len, between.values())),
        "arrows but those to foundations": sum(
            not _is_foundation(other) for others in between.values() for other in others
        ),
        "circles of modules": len(parts),
        "circles of rooms": len(circles(between)),
        "walk from log to FMU, files": len({file for file, _ in steps}),
        "walk from log to FMU, functions": len(steps),
    }
    return column, parts, steps


def show(columns: Mapping[str, Mapping[str, int]]) -> None:
    """Print the table."""
    names = list(next(iter(columns.values())))
    print(" " * 34 + "".join(f"{head[:10]:>12}" for head in columns))
    for name in names:
        print(f"{name:<34}" + "".join(f"{column[name]:>12,}" for column in columns.values()))


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--at", action="append", default=[], metavar="COMMIT")
    parser.add_argument("--circles", action="store_true", help="name the modules of circles and walks")
    options = parser.parse_args()
    columns, details = {}, []
    with tempfile.TemporaryDirectory() as scratch:
        for commit in options.at:
            tree = Path(scratch, commit.replace("/", "_"))
            packed = subprocess.run(
                ["git", "-C", ROOT, "archive", "--format=zip", commit], check=True, capture_output=True
            )
            with zipfile.ZipFile(io.BytesIO(packed.stdout)) as archive:
                archive.extractall(tree)
            columns[commit], *detail = measures(tree)
            details.append((commit, *detail))
        columns["this tree"], *detail = measures(ROOT)
        details.append(("this tree", *detail))
    show(columns)
    for name, parts, steps in details if options.circles else ():
        print(f"\n{name}: circles")
        for part in parts:
            print("  " + ", ".join(part))
        print(f"{name}: walk")
        for file in dict.fromkeys(file for file, _ in steps):
            print(f"  {file}: " + ", ".join(function for other, function in steps if other == file))
    return 0


if __name__ == "__main__":
    sys.exit(main())
