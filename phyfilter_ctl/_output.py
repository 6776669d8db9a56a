"""Files that the commands write: whole or not at all."""

from __future__ import annotations

import os
import sys
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO

from matplotlib.figure import Figure

__all__ = ["check_target", "write_figure", "write_text"]


def check_target(path: str | None, *, suffixes: Sequence[str] = ()) -> None:
    """Refuse a file that could not be written, before any work is done.

    Parameters
    ----------
    path : str, optional
        None and "-" (standard output) are fine.
    suffixes : sequence of str
        Allowed endings; empty for any.

    Raises
    ------
    ValueError
        If the ending is another, the folder does not exist, or the path is a folder.
    """
    if path is None or (path == "-" and not suffixes):
        return
    target = Path(path)
    if suffixes and target.suffix.lower() not in suffixes:
        raise ValueError(f"{path}: expected a file that ends in {', '.join(suffixes)}")
    if target.is_dir():
        raise ValueError(f"{path}: is a folder, expected a file")
    if not target.parent.is_dir():
        raise ValueError(f"{path}: there is no folder {target.parent}")


def write_text(path: str, text: str) -> None:
    """Write text to a file, or to standard output for "-"."""
    if path == "-":
        sys.stdout.write(text)
    else:
        _write_whole(Path(path), lambda file: file.write(text.encode()))


def write_figure(path: str, figure: Figure) -> None:
    """Write a figure in the format that the ending of the path names."""
    target = Path(path)
    kind = target.suffix.lower().removeprefix(".")
    _write_whole(target, lambda file: figure.savefig(file, format=kind, dpi=150))


def _write_whole(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    path = Path(os.path.realpath(path))  # a link stays a link
    part = path.with_name(f".{path.name}.{uuid.uuid4().hex}.tmp")
    try:
        with part.open("xb") as file:
            write(file)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
