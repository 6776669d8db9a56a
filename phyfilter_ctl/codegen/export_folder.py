"""Folders of generated files, written all or not at all."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from .._output import replacing_folder

__all__ = ["own_order", "own_symbols", "write_folder"]

_LIST = "pf_files.txt"
_FIRST_LINE = "Written by phyfilter_ctl; the next export to this folder replaces these files:"

_ORDER = re.compile(r"^#define (?!PF_MAX)\w+_ORDER (\d+)$", re.M)
_FUNCTION = re.compile(r"^(?!static\b|typedef\b)[a-z][\w ]*[ *](pf_\w+)\(", re.M)


def own_symbols(sources: Mapping[str, str], name: str) -> dict[str, str]:
    """The same C with the functions of the runtime called after the model: several exports fit into one image.

    Parameters
    ----------
    sources : mapping of str to str
        File name to text; those named pf_*.c are the runtime's.
    name : str
        Prefix, the model's C name.

    Returns
    -------
    dict of str to str

    Examples
    --------
    >>> own_symbols({"pf_a.c": "int pf_a(void) { return 1; }", "m.c": "int b(void) { return pf_a(); }"}, "m")
    {'pf_a.c': 'int m_pf_a(void) { return 1; }', 'm.c': 'int b(void) { return m_pf_a(); }'}
    """
    runtime = (text for file, text in sources.items() if re.fullmatch(r"pf_\w+\.c", file))
    found = sorted({function for text in runtime for function in _FUNCTION.findall(text)})
    if not found:
        return dict(sources)
    calls = re.compile(rf"\b({'|'.join(found)})\b(?!\.)")  # pf_roots, but not the file pf_roots.c
    return {file: calls.sub(rf"{name}_\1", text) for file, text in sources.items()}


def own_order(sources: Mapping[str, str]) -> dict[str, str]:
    """The same C with matrices on the stack as large as the highest order of its filters, and not the highest of all.

    Parameters
    ----------
    sources : mapping of str to str
        File name to text.

    Returns
    -------
    dict of str to str

    Examples
    --------
    >>> own_order({"a.h": "#define a_ORDER 3", "pf_hurwitz.h": "#define PF_MAX_ORDER 12"})["pf_hurwitz.h"]
    '#define PF_MAX_ORDER 3'
    """
    orders = [int(order) for text in sources.values() for order in _ORDER.findall(text)]
    if not orders or "pf_hurwitz.h" not in sources:
        return dict(sources)
    # Not below 2: compilers warn of what is done with pairs of poles where there is room for one pole.
    sized = re.sub(r"(?<=#define PF_MAX_ORDER )\d+", str(max(2, *orders)), sources["pf_hurwitz.h"])
    return {**sources, "pf_hurwitz.h": sized}


def write_folder(folder: str | Path, files: Mapping[str, str]) -> Path:
    """Writes text files to a folder, in one go.

    Parameters
    ----------
    folder : str or Path
        Made if it is not there; its parent must be. An earlier export is replaced.
    files : mapping of str to str
        Relative path to text.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    FileExistsError
        If the folder holds files that no export wrote; nothing is touched then.
    FileNotFoundError
        If there is no folder for it to be in.
    ValueError
        If a path leaves the folder.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as parent:
    ...     sorted(path.name for path in write_folder(Path(parent, "code"), {"a.c": ""}).iterdir())
    ['a.c', 'pf_files.txt']
    """
    target = Path(folder).absolute()
    for name in files:
        path = PurePosixPath(name)
        if path.is_absolute() or ".." in path.parts or "\\" in name or not path.name:
            raise ValueError(f"files: expected paths within the folder, got {name!r}")
    if not target.parent.is_dir():
        raise FileNotFoundError(f"{target.parent}: there is no such folder to export into; make it first")
    if target.exists():
        _check_ours(target)
    contents = {**files, _LIST: "\n".join([_FIRST_LINE, *sorted(files)]) + "\n"}
    with replacing_folder(target) as fresh:
        for name, text in contents.items():
            Path(fresh, name).parent.mkdir(parents=True, exist_ok=True)
            Path(fresh, name).write_text(text, encoding="utf-8", newline="\n")
    return target


def _check_ours(target: Path) -> None:
    if not target.is_dir():
        raise FileExistsError(f"{target} is a file; expected a folder to export into")
    present = {path.relative_to(target).as_posix() for path in target.rglob("*") if not path.is_dir()}
    listing = target / _LIST
    ours: set[str] = set()
    if listing.is_file():
        first, *names = listing.read_text(encoding="utf-8").splitlines() or [""]
        ours = {_LIST, *names} if first == _FIRST_LINE else set()
    foreign = sorted(present - ours)
    if foreign:
        raise FileExistsError(
            f"{target} holds files that no export wrote ({', '.join(foreign[:5])}); move them away or take "
            "another folder"
        )
