"""How much memory a log may take: asked before it is taken, and of compressed parts while they are unpacked."""

from __future__ import annotations

import bz2
import io
import sys
import zlib
from collections.abc import Iterator
from importlib import import_module
from typing import IO

from .._intake import check_count

__all__ = ["check_size", "check_unpacked", "inflated", "unpacked"]

_ADVICE = "where you trust the file, allow more by largest (--largest), or read fewer fields"
_ZSTD = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
_PIECE = 1 << 24  # bytes that are unpacked at a time
# What a byte can become at most: what cannot become too large need not be tried.
_RATIOS = {"lz4": 256, "zstd": 1 << 15}


def check_size(size: int, largest: int, what: str) -> None:
    """Refuse what would take more memory than a caller allows.

    Parameters
    ----------
    size : int
        Bytes.
    largest : int
        Bytes that are allowed.
    what : str
        What would take them, for the message.

    Raises
    ------
    ValueError
        If they are too many.

    Examples
    --------
    >>> check_size(8 * 10**12, 1 << 30, "'speed'")
    Traceback (most recent call last):
    ...
    ValueError: 8000000000000 bytes of memory for 'speed', expected at most 1073741824; where you trust the file, \
allow more by largest (--largest), or read fewer fields
    """
    check_count(size, largest, f"bytes of memory for {what}", _ADVICE)


def _opened(data: bytes, kind: str, largest: int, what: str) -> IO[bytes]:
    """What was packed, as a file; by whatever package the reader of bags brings."""
    held = io.BytesIO(data)
    if kind == "bz2":
        return bz2.BZ2File(held)
    try:
        module = import_module("lz4.frame" if kind == "lz4" else _ZSTD)
    except ModuleNotFoundError:
        if kind == "lz4":
            check_size(_RATIOS[kind] * len(data), largest, f"{what}, or less")
            return io.BytesIO(import_module("safelz4.frame").decompress(data))
        return import_module("zstandard").ZstdDecompressor().stream_reader(held, read_across_frames=True)
    return (module.LZ4FrameFile if kind == "lz4" else module.ZstdFile)(held)


def unpacked(data: bytes, kind: str, largest: int, what: str) -> Iterator[bytes]:
    """What was packed, piece by piece.

    Parameters
    ----------
    data : bytes
        Any number of streams, one behind the other.
    kind : {"bz2", "lz4", "zstd"}
    largest : int
        Bytes that may come out.
    what : str
        For the message.

    Raises
    ------
    ValueError
        If more come out, or the data end too early.
    """
    total = 0
    with _opened(data, kind, largest, what) as file:
        try:
            while piece := file.read(_PIECE):
                total += len(piece)
                check_size(total, largest, what)
                yield piece
        except EOFError as error:
            raise ValueError(f"{what} breaks off") from error


def check_unpacked(data: bytes, kind: str, largest: int, what: str) -> None:
    """Refuse what becomes too large; what cannot is not unpacked for it.

    Parameters
    ----------
    data, kind, largest, what
        As for :func:`unpacked`.

    Raises
    ------
    ValueError
        If it does.
    """
    if len(data) * _RATIOS[kind] > largest:
        for _ in unpacked(data, kind, largest, what):
            pass


def inflated(data: bytes, largest: int, what: str) -> bytes:
    """What zlib packed.

    Parameters
    ----------
    data, largest, what
        As for :func:`unpacked`.

    Raises
    ------
    ValueError
        If it is too large, damaged, or ends too early.
    """
    unpacker = zlib.decompressobj()
    try:
        found = unpacker.decompress(data, largest + 1)
    except zlib.error as error:
        raise ValueError(f"{what} is damaged: {error}") from error
    check_size(len(found), largest, f"{what}, or more")
    if not unpacker.eof:
        raise ValueError(f"{what} breaks off")
    return found
