"""How much a user has to know and to type: distinct public names, and characters of code on pages.

    python -m tests.meta.counters               this tree
    python -m tests.meta.counters --root DIR    another one

Names are those of the package and of the packages one level below it. Code is what README, the pages and the notebooks
show in Python, without comments and blank lines; spaces count once.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def public_names(root: Path) -> dict[str, list[str]]:
    """``__all__`` of the package ("" is its name) and of each package in it, read without importing."""
    package = root / "phyfilter_ctl"
    found = {"": _listed(package)}
    for each in sorted(package.iterdir()):
        if each.is_dir() and not each.name.startswith("_") and (each / "__init__.py").exists():
            found[each.name] = _listed(each)
    return found


def _listed(folder: Path) -> list[str]:
    for name in ("__init__.pyi", "__init__.py"):
        path = folder / name
        if not path.exists():
            continue
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            targets = node.targets if isinstance(node, ast.Assign) else []
            if any(isinstance(target, ast.Name) and target.id == "__all__" for target in targets):
                return list(ast.literal_eval(node.value))  # type: ignore[union-attr]  # an Assign, as it has targets
    return []


def code_of_pages(root: Path) -> dict[str, str]:
    """What each page, notebook and README has of Python."""
    found = {}
    for path in [root / "README.md", *sorted((root / "docs").glob("*.md"))]:
        blocks = re.findall(r"^```python\n(.*?)^```", path.read_text(encoding="utf-8"), re.M | re.S)
        found[str(path.relative_to(root))] = "".join(blocks)
    for path in sorted((root / "notebooks").glob("*.py")):
        found[str(path.relative_to(root))] = path.read_text(encoding="utf-8")
    return {name: _bare(text) for name, text in found.items()}


def _bare(text: str) -> str:
    lines = (re.sub(r"\s+", " ", line).strip() for line in text.splitlines())
    return "\n".join(line for line in lines if line and not line.startswith("#"))


def main() -> int:
    """Print both."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.meta.counters", description=(__doc__ or "").split("\n\n")[0]
    )
    parser.add_argument("--root", type=Path, default=ROOT, help="a checkout")
    root: Path = parser.parse_args().root
    names = public_names(root)
    for room, listed in sorted(names.items(), key=lambda entry: -len(entry[1])):
        print(f"{room or 'phyfilter_ctl':<16}{len(listed):>5}")
    print(f"{'distinct names':<16}{len({name for listed in names.values() for name in listed}):>5}")
    code = code_of_pages(root)
    for name, text in sorted(code.items(), key=lambda entry: -len(entry[1])):
        if text:
            print(f"{name:<46}{len(text):>6}")
    print(f"{'characters of code':<46}{sum(map(len, code.values())):>6}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
