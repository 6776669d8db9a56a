"""Files and folders that are written: whole or not at all, even where the process is killed.

What is new is made beside its target, under a name of its own (a *temporary*), and moved there in one step. A killed
process leaves its temporary behind; the next write of the same target removes it. It tells a leftover from the work of
another process by a lock that every writer holds on its temporary, and which ends with the process, however that ends.
"""

from __future__ import annotations

import errno
import json
import os
import re
import secrets
import shutil
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import IO, TYPE_CHECKING

if sys.platform != "win32":
    import fcntl

if TYPE_CHECKING:
    from argparse import _ActionsContainer

    import numpy as np
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

__all__ = [
    "add_json",
    "add_quiet",
    "check_folder",
    "check_target",
    "naming",
    "noted_writes",
    "replacing",
    "replacing_folder",
    "write_figure",
    "write_gif",
    "write_json",
    "write_text",
]

_MARK_BYTES = 6
_MARK = re.compile(rf"[0-9a-f]{{{2 * _MARK_BYTES}}}\.tmp")
# Errors of a write that name no file, for it is open by then: a full disk or share of it, a file too large.
_FULL = frozenset(number for name in ("ENOSPC", "EDQUOT", "EFBIG") if (number := getattr(errno, name, None)))
# Targets written in this context, as their caller named them; None where nobody asked.
_noted: ContextVar[list[Path] | None] = ContextVar("_noted", default=None)


@contextmanager
def noted_writes() -> Iterator[list[Path]]:
    """Files and folders that are put into place within the block, in order, for a caller who says so to the user."""
    token = _noted.set(paths := [])
    try:
        yield paths
    finally:
        _noted.reset(token)


def _note(path: str | os.PathLike[str]) -> None:
    if (paths := _noted.get()) is not None and Path(path) not in paths:
        paths.append(Path(path))


@contextmanager
def naming(path: str | os.PathLike[str]) -> Iterator[None]:
    """Where the disk is full, the error names the file.

    Parameters
    ----------
    path : str or path
        As its caller named it.

    Raises
    ------
    OSError
        In place of one without a name.

    Examples
    --------
    >>> with naming("flight.csv"):
    ...     raise OSError(errno.ENOSPC, "No space left on device")
    Traceback (most recent call last):
    ...
    OSError: [Errno 28] No space left on device: 'flight.csv'
    """
    try:
        yield
    except OSError as error:
        if error.filename is None and error.errno in _FULL:
            raise OSError(error.errno, error.strerror, os.fspath(path)) from error
        raise


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


def check_folder(path: str | os.PathLike[str]) -> Path:
    """A folder that is there, or can be made: refused before any work is done.

    Parameters
    ----------
    path : str or path

    Raises
    ------
    FileNotFoundError
        If there is no folder for it to be in.
    FileExistsError
        If it is a file.
    """
    target = Path(path)
    if not target.parent.is_dir():
        raise FileNotFoundError(f"{path}: there is no folder {target.parent}")
    if target.exists() and not target.is_dir():
        raise FileExistsError(f"{path}: is a file, expected a folder")
    return target


def write_text(path: str, text: str) -> None:
    """Write text to a file, or to standard output for "-"."""
    if path == "-":
        sys.stdout.write(text)
    else:
        with replacing(path) as file:
            file.write(text.encode())


def write_json(path: str, value: object) -> None:
    """Write a value as strict JSON: infinite numbers are "Infinity" and "-Infinity", null is what is not known."""
    from .results import plain

    write_text(path, json.dumps(plain(value, infinite=True), indent=2, allow_nan=False) + "\n")


def add_json(parser: _ActionsContainer) -> None:
    """Add ``--json``, alike for every command."""
    parser.add_argument(
        "--json", metavar="FILE", help="write the figures as JSON; - for standard output instead of the text"
    )


def add_quiet(parser: _ActionsContainer) -> None:
    """Add ``--quiet``, alike for every command."""
    parser.add_argument("--quiet", action="store_true", help="no progress bar, no line on what was written")


def write_figure(path: str, figure: Figure) -> None:
    """Write a figure in the format that the ending of the path names."""
    with replacing(path) as file:
        figure.savefig(file, format=Path(path).suffix.lower().removeprefix("."), dpi=150)


def write_gif(
    path: str | os.PathLike[str], frames: Iterable[NDArray[np.uint8]], *, milliseconds: int
) -> None:
    """Write pictures (height, width, 3) as an animation of 64 colours that repeats, each shown for so long."""
    from PIL import Image

    images = [Image.fromarray(frame).quantize(64) for frame in frames]
    with replacing(path) as file:
        images[0].save(
            file,
            format="GIF",
            save_all=True,
            append_images=images[1:],
            duration=milliseconds,
            loop=0,
            optimize=True,
        )


@contextmanager
def replacing(path: str | os.PathLike[str], *, follow_links: bool = True) -> Iterator[IO[bytes]]:
    """A file that takes the place of ``path`` at the end of the block; where the block raises, all stays as it was.

    Parameters
    ----------
    path : str or path
        An existing file's permissions are kept. What is no file (a device, a pipe) is written to as it is.
    follow_links : bool
        A link stays a link, and its target is replaced; False replaces the link.

    Raises
    ------
    OSError
        If the folder does not exist or cannot be written to, or the disk is full: the file is named.
    """
    if follow_links and os.path.exists(path) and not (os.path.isfile(path) or os.path.isdir(path)):
        with naming(path), open(path, "wb") as file:
            yield file
        return
    target = Path(os.path.realpath(path) if follow_links else path)
    _remove_leftovers(target)
    part, file = _new_file(target)
    try:
        with naming(path), file:
            with suppress(FileNotFoundError):
                shutil.copymode(target, part)
            yield file
            file.flush()
            os.fsync(file.fileno())  # else a power cut may leave the new name with old or no content
            if sys.platform == "win32":
                file.close()  # an open file cannot be moved there
            os.replace(part, target)
        _note(path)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def replacing_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A new folder that takes the place of ``path``, with all in it, at the end of the block.

    A folder cannot be replaced in one step. A process killed between the two it takes leaves the old one in its
    temporary; the next write puts it back first.

    Parameters
    ----------
    path : str or path
        A link stays a link.

    Raises
    ------
    OSError
        If the parent does not exist or cannot be written to, or the disk is full: the folder is named.
    """
    target = Path(os.path.realpath(path))
    _remove_leftovers(target)
    part, descriptor = _new_folder(target)
    try:
        new = part / "new"
        new.mkdir()
        with naming(path):
            yield new
        if target.exists():
            os.replace(target, part / "old")
        os.replace(new, target)
        _note(path)
    finally:
        _remove_folder(part, target)
        if descriptor is not None:
            os.close(descriptor)


def _beside(target: Path) -> Path:
    return target.with_name(f".{target.name}.{secrets.token_hex(_MARK_BYTES)}.tmp")


def _new_file(target: Path) -> tuple[Path, IO[bytes]]:
    while True:
        part = _beside(target)
        file = part.open("xb")
        if _claimed(file.fileno(), part):
            return part, file
        file.close()


def _new_folder(target: Path) -> tuple[Path, int | None]:
    while True:
        part = _beside(target)
        part.mkdir(mode=0o700)
        if sys.platform == "win32":
            return part, None
        with suppress(FileNotFoundError):
            descriptor = os.open(part, os.O_RDONLY)
            if _claimed(descriptor, part):
                return part, descriptor
            os.close(descriptor)


def _claimed(descriptor: int, part: Path) -> bool:
    """Lock a new temporary; False where another process took it for a leftover in the instant before."""
    if sys.platform == "win32":
        return True
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return os.path.samestat(os.fstat(descriptor), os.stat(part))
    except (BlockingIOError, FileNotFoundError):
        return False
    except OSError:  # a file system without locks, on which nobody can take anything for a leftover
        return True


def _remove_leftovers(target: Path) -> None:
    """Remove the temporaries of this target whose writers are gone. Without such locks (Windows) they stay."""
    prefix = f".{target.name}."
    with suppress(OSError), os.scandir(target.parent) as entries:
        for name in [entry.name for entry in entries]:
            if name.startswith(prefix) and _MARK.fullmatch(name, len(prefix)):
                _remove_leftover(target.with_name(name), target)


def _remove_leftover(part: Path, target: Path) -> None:
    if sys.platform == "win32":
        return
    with suppress(OSError):
        descriptor = os.open(part, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if part.is_dir():
                _remove_folder(part, target)
            else:
                part.unlink()
        finally:
            os.close(descriptor)


def _remove_folder(part: Path, target: Path) -> None:
    if (part / "old").exists() and not target.exists():
        os.replace(part / "old", target)
    shutil.rmtree(part, ignore_errors=True)
