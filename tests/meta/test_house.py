"""The house itself: commands and paths that the documents name exist, no leftovers."""

import ast
import re
import tomllib
from pathlib import Path

import pytest

from tests.meta.house import circles, graph, modules

ROOT = Path(__file__).resolve().parents[2]
TEXT = {".py", ".md", ".toml", ".c", ".h", ".ipynb", ""}


def files():
    skipped = {".git", ".venv", "build", "dist", "out"}
    for path in sorted(ROOT.rglob("*")):
        relative = path.relative_to(ROOT)
        if path.is_file() and not skipped & set(relative.parts) and "__pycache__" not in relative.parts:
            yield path


def fenced(text: str) -> list[str]:
    return [
        line for block in re.findall(r"```(?:bash|sh)\n(.*?)```", text, re.S) for line in block.splitlines()
    ]


def test_readme_commands_are_the_ones_that_ci_runs():
    commands = [
        line for line in fenced((ROOT / "README.md").read_text()) if line.startswith("python3 -m venv")
    ]
    assert len(commands) == 2
    script = (ROOT / ".ci" / "run").read_text()
    for command in commands:
        assert command in script, f"{command!r} is in the README but not in .ci/run"


@pytest.mark.parametrize("page", ["README.md", "docs/results.md", "docs/reproduce.md"])
def test_named_files_exist(page):
    text = (ROOT / page).read_text()
    named = set(re.findall(r"\b((?:benchmarks|notebooks|models|tests|docs|phyfilter_ctl)/[\w./-]+\w)", text))
    missing = [name for name in named if not (ROOT / name).exists()]
    assert not missing


def test_every_room_of_the_import_contract_exists():
    contract = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    named = {
        part.strip() for c in contract for entry in c.get("layers", []) for part in re.split(r"[|:]", entry)
    }
    for name in named:
        path = ROOT / name.replace(".", "/")
        assert path.is_dir() or path.with_suffix(".py").is_file(), name


@pytest.mark.slow
def test_pickle_is_not_used():
    """Pickle runs what it reads; only a test that such a file is refused may write one."""
    code = [path for path in files() if path.suffix == ".py" and "tests" not in path.parts]
    assert not [path for path in code if re.search(r"^\s*(import|from) pickle", path.read_text(), re.M)]


# What namedtuple gives every class, underscored so that it is no field.
NAMED_TUPLE = {"_asdict", "_fields", "_make", "_replace"}


def private_names(tree: ast.AST) -> tuple[set[str], set[str]]:
    """Names with one leading underscore that a module defines, and that it takes from objects or other modules."""
    defined, used = set(), set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            defined.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            defined.add(node.id)
        elif isinstance(node, ast.Attribute):
            (defined if isinstance(node.ctx, ast.Store) else used).add(node.attr)
        elif isinstance(node, ast.ImportFrom):
            used |= {alias.name for alias in node.names}
            used |= set((node.module or "").split("."))
    return tuple(
        {name for name in names if re.match(r"_[^_]", name) and name not in NAMED_TUPLE}
        for names in (defined, used)
    )


@pytest.mark.slow
def test_private_names_stay_in_their_room():
    """Modules beside the rooms, `_signals` and the like, are what the rooms stand on: theirs are everybody's."""
    defined, used = {}, {}
    for name, path in modules(ROOT).items():
        room = name.split(".")[1:2]
        own, taken = private_names(ast.parse(path.read_text()))
        parts = {part for part in name.split(".") if part.startswith("_")}
        defined.setdefault(*room or [""], set()).update(own | parts)
        used.setdefault(*room or [""], set()).update(taken)
    shared = {room for room in defined if room.startswith("_")}
    across = {
        f"{room} takes {name} of {other}"
        for room, names in used.items()
        for other in defined.keys() - shared - {room}
        for name in names & defined[other] - defined[room] - shared
    }
    assert not across


@pytest.mark.slow
def test_no_module_imports_its_importer():
    """Imports for type checking and inside functions included."""
    assert not circles(graph(ROOT))
