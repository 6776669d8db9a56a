"""The files to copy are short, and need no more than the package and what everybody has."""

import ast
import importlib
from pathlib import Path

import pytest

MODELS = Path(__file__).resolve().parents[2] / "models"
FILES = {str(path.relative_to(MODELS)): 150 for path in sorted(MODELS.glob("*/example.py"))}
FILES |= {str(path.relative_to(MODELS)): 100 for path in sorted((MODELS / "everyday").glob("*.py"))}
ALLOWED = {"phyfilter_ctl", "numpy", "matplotlib", "control"}


@pytest.mark.parametrize("file", FILES)
def test_a_file_to_copy_is_short_and_imports_little(file):
    text = (MODELS / file).read_text(encoding="utf-8")
    assert len(text.splitlines()) <= FILES[file]
    taken = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Import | ast.ImportFrom)]
    names = [
        name
        for node in taken
        for name in (
            [node.module] if isinstance(node, ast.ImportFrom) else [each.name for each in node.names]
        )
    ]
    assert {name.split(".")[0] for name in names} <= ALLOWED
    # Public names of the package; the quadruped's and the humanoid's simulators are in their folders.
    packages = [name for name in names if name.startswith("phyfilter_ctl.") and ".models." not in name]
    for node in (node for node in taken if isinstance(node, ast.ImportFrom) and node.module in packages):
        assert {each.name for each in node.names} <= set(importlib.import_module(node.module).__all__)
