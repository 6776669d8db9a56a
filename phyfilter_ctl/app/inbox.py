"""The file that is to be opened as a log: sent by the front end in pieces, or named where the designer was started."""

from __future__ import annotations

import shutil
import tempfile
import threading
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ..logfiles import LogFile, open_log
from .checking import MessageError

__all__ = ["LARGEST_PIECE", "Inbox", "Source"]

LARGEST_PIECE = 3_000_000  # bytes; of base64 in one message a third more
_LEFT_FREE = 500_000_000  # bytes of the disk


@dataclass(frozen=True)
class Source:
    """A file to be read as a log.

    Parameters
    ----------
    path : Path
        Where it stands; never shown.
    name : str
        What it is called.
    """

    path: Path
    name: str

    @cached_property
    def size(self) -> int:
        """Bytes; of a folder those of its files."""
        if self.path.is_dir():
            return sum(file.stat().st_size for file in self.path.rglob("*") if file.is_file())
        return self.path.stat().st_size

    @cached_property
    def log(self) -> LogFile:
        """Opened as a log that says its times itself.

        Raises
        ------
        ValueError
            If it cannot, or the unit of its times has to be given.
        """
        return open_log(self.path)


class Inbox:
    """Holds one file at a time. Pieces are written to a temporary folder that ends with the session.

    Parameters
    ----------
    path : Path, optional
        A file of this machine that waits to be opened.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._lock = threading.Lock()
        self._folder: Path | None = None
        self._tidy: Callable[[], object] = lambda: None
        self.named: Path | None = path
        self._source = None if path is None else Source(path, path.name)
        self._size, self._there = 0, 0

    @property
    def waiting(self) -> str | None:
        """Name of the file that is there."""
        return None if self._source is None else self._source.name

    @property
    def source(self) -> Source:
        """The file that is there.

        Raises
        ------
        ValueError
            If there is none, or not all of it.
        """
        if self._source is None:
            raise ValueError("no file has arrived: drop one, or pick it")
        return self._source

    def receive(self, name: str, size: int, at: int, piece: bytes) -> int:
        """Take the next piece of a file; return how many bytes are there.

        Parameters
        ----------
        name : str
            Of the file; only ever shown, its ending tells some formats.
        size : int
            Of the whole file.
        at : int
            Bytes before this piece; 0 begins anew.
        piece : bytes

        Raises
        ------
        MessageError
            If a piece is missing before this one, more than ``size`` bytes arrive, or the disk has no room.
        """
        with self._lock:
            if at == 0:
                self._begin(size)
            if self._folder is None or size != self._size or at != self._there:
                raise MessageError(
                    "at", f"expected the piece after {self._there} bytes, got {at}: send the file again"
                )
            if at + len(piece) > size:
                raise MessageError("data", f"expected {size} bytes in all, got {at + len(piece)}")
            path = Path(self._folder, f"log{_ending(name)}")
            with path.open("ab") as file:
                file.write(piece)
            self._there += len(piece)
            if self._there == size:
                self._source = Source(path, name)
            return self._there

    def _begin(self, size: int) -> None:
        self._end()
        self._folder = Path(tempfile.mkdtemp(prefix="phyfilter_"))
        self._tidy = weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)
        self._size = size
        free = shutil.disk_usage(self._folder).free - _LEFT_FREE
        if size > free:
            self._end()
            raise MessageError(
                "size",
                f"the file has {size / 1e9:.3g} GB, but {max(free, 0) / 1e9:.3g} GB are free for temporary files: name "
                "it where the designer is started (phyfilter-ctl app --log FILE), which takes no copy",
            )

    def _end(self) -> None:
        self._folder, self._source = None, None
        self._size, self._there = 0, 0
        self._tidy()

    def close(self) -> None:
        """Let go of the file; a copy is deleted."""
        with self._lock:
            self._end()


def _ending(name: str) -> str:
    """Letters and digits after the last dot of a name, so that it can be the ending of a file."""
    suffix = Path(name).suffix[1:]
    return f".{suffix}" if suffix.isascii() and suffix.isalnum() and len(suffix) <= 8 else ""
