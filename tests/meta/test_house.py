"""The house itself: commands and paths that the documents name exist, no leftovers."""

import re
import tomllib
from pathlib import Path

from tests.meta.house import code_lines

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


def test_readme_names_files_that_exist():
    text = (ROOT / "README.md").read_text()
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


def test_files_stay_readable():
    """A file with more code than this is a place to look for a second room."""
    library = [path for path in files() if path.suffix == ".py" and "tests" not in path.parts]
    long = {str(path.relative_to(ROOT)): count for path in library if (count := code_lines(path)) > 320}
    assert not long


def test_pickle_is_not_used():
    """Pickle runs what it reads; only a test that such a file is refused may write one."""
    code = [path for path in files() if path.suffix == ".py" and "tests" not in path.parts]
    assert not [path for path in code if re.search(r"^\s*(import|from) pickle", path.read_text(), re.M)]
