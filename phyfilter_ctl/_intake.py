"""What comes from files of unknown origin, looked at before a path is made of it or memory is taken for it.

Free of the package's other rooms, and of the libraries that they need.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["LARGEST", "check_count", "check_name", "inside", "limited"]

LARGEST = 1 << 30
"""Bytes that one quantity of a file may take in memory, unless a caller says otherwise."""

_NO_NAME = re.compile(r'[/\\:*?"<>|\x00-\x1f\x7f]')


def check_name(name: str, what: str) -> str:
    """A name that becomes part of a path, returned as it is.

    Parameters
    ----------
    name : str
    what : str
        Where it was read, for the message.

    Raises
    ------
    ValueError
        If it is empty, names a folder (a slash, a backslash, "..", a drive), or has a character or an end that some
        file systems drop.

    Examples
    --------
    >>> check_name("drone_2.1", "modelIdentifier")
    'drone_2.1'
    >>> check_name("../drone", "modelIdentifier")
    Traceback (most recent call last):
    ...
    ValueError: modelIdentifier: expected a name without a path, got '../drone'; refused
    """
    if (
        not name
        or _NO_NAME.search(name)
        or name.endswith((".", " "))
        or len(name.encode("utf-8", "replace")) > 200
    ):
        raise ValueError(f"{what}: expected a name without a path, got {name[:200]!r}; refused")
    return name


def inside(path: Path, folder: Path) -> bool:
    """Whether a file lies in a folder, links followed.

    Parameters
    ----------
    path, folder : Path

    Examples
    --------
    >>> inside(Path("a/../b"), Path("a"))
    False
    """
    return path.resolve().is_relative_to(folder.resolve())


def check_count(count: float, most: int, what: str, advice: str = "") -> int:
    """A number of things that memory is taken for, as a whole number.

    Parameters
    ----------
    count : float
    most : int
    what : str
        What is counted, for the message.
    advice : str
        What to do where the number is meant, for the message.

    Raises
    ------
    ValueError
        If it is negative, not finite, or above the limit.

    Examples
    --------
    >>> check_count(12.0, 100, "steps")
    12
    >>> check_count(1e15, 100, "steps")
    Traceback (most recent call last):
    ...
    ValueError: 1000000000000000 steps, expected at most 100; refused
    """
    if not (math.isfinite(count) and count >= 0):
        raise ValueError(f"{count} {what}, expected 0 to {most}; refused")
    if count > most:
        raise ValueError(f"{int(count)} {what}, expected at most {most}; {advice or 'refused'}")
    return int(count)


@contextmanager
def limited(what: str) -> Iterator[None]:
    """Numbers and nestings too large for the machine become the error of what holds them.

    Parameters
    ----------
    what : str
        File and line or key, for the message.

    Raises
    ------
    ValueError
        In place of OverflowError, MemoryError and RecursionError.

    Examples
    --------
    >>> with limited("robot.toml: model.M"):
    ...     float(10**400)
    Traceback (most recent call last):
    ...
    ValueError: robot.toml: model.M: too large or too deeply nested: int too large to convert to float
    """
    try:
        yield
    except (OverflowError, MemoryError, RecursionError) as error:
        raise ValueError(f"{what}: too large or too deeply nested: {error or 'out of memory'}") from error
