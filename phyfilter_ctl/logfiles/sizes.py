"""How much memory a log may take: asked before it is taken, and of compressed parts while they are unpacked."""

from __future__ import annotations

import sys
import zlib
from collections.abc import Callable, Iterator
from typing import Any

from .._intake import check_count

__all__ = ["check_size", "check_unpacked", "inflated", "unpacked"]

_ADVICE = "where you trust the file, allow more by largest (--largest), or read fewer fields"
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


def _unpacker(kind: str) -> Callable[[], Any]:
    if kind == "bz2":
        from bz2 import BZ2Decompressor

        return BZ2Decompressor
    if kind == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        return LZ4FrameDecompressor
    if sys.version_info >= (3, 14):
        from compression.zstd import ZstdDecompressor
    else:
        from backports.zstd import ZstdDecompressor
    return ZstdDecompressor


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
    while data:
        unpacker = _unpacker(kind)()
        given, data = data, b""
        while not unpacker.eof:
            piece = unpacker.decompress(given, _PIECE)
            given = b""
            total += len(piece)
            check_size(total, largest, what)
            yield piece
            if not unpacker.eof and unpacker.needs_input:
                raise ValueError(f"{what} breaks off")
        data = unpacker.unused_data or b""


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
