"""Packed parts of bags, which rosbags unpacks whole: none becomes larger than allowed.

Chunks of ROS 1 bags are bounded while they are unpacked; those of MCAP, and packed files and messages of ROS 2 bags,
are tried before. Formats: http://wiki.ros.org/Bags/Format/2.0, https://mcap.dev/spec.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from io import BufferedReader, FileIO
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from .sizes import check_size, check_unpacked, unpacked

if TYPE_CHECKING:
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

__all__ = ["check_packed", "limit_chunks", "limit_reads"]

_MCAP, _ZSTD = b"\x89MCAP0\r\n", b"\x28\xb5\x2f\xfd"
_CHUNK = 6  # kind of an MCAP record
_END = 28  # bytes from where the file's end says where its summary begins
_FRAME = 4  # bytes by which a zstd frame is known
_CHUNK_HEAD = 40  # bytes of a chunk's record: two times, two sizes, a checksum and two lengths


def check_packed(path: Path, largest: int) -> None:
    """Try what is unpacked while a bag is opened.

    Parameters
    ----------
    path : Path
        A file, or the folder of a ROS 2 bag.
    largest : int
        Bytes that a packed part may become.

    Raises
    ------
    ValueError
        If one becomes more.
    OSError
        If a file cannot be read.
    """
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        if not (file.is_file() and file.stat().st_size):
            continue
        with file.open("rb") as stream, mmap(stream.fileno(), 0, access=ACCESS_READ) as data:
            if data[:_FRAME] == _ZSTD:
                check_unpacked(data[:], "zstd", largest, file.name)
            elif data[: len(_MCAP)] == _MCAP:
                _check_records(data, largest)


def _check_records(data: mmap, largest: int) -> None:
    """The records of an MCAP file, and those of its summary where the end of the file says that it stands."""
    summary = int.from_bytes(data[-_END : -_END + 8], "little")
    for at in (len(_MCAP), *([summary] if len(_MCAP) < summary < len(data) else [])):
        while at + 9 <= len(data):
            size = int.from_bytes(data[at + 1 : at + 9], "little")
            if at + 9 + size > len(data):
                raise ValueError(
                    f"no readable mcap log: a record of {size} bytes reaches beyond the end of the file"
                )
            if data[at] == _CHUNK and size >= _CHUNK_HEAD:
                length = int.from_bytes(data[at + 37 : at + 41], "little")
                kind, begin = data[at + 41 : at + 41 + length], at + 49 + length
                packed = int.from_bytes(data[begin - 8 : begin], "little")
                _check_chunk(data[begin : begin + packed], kind, largest)
            at += 9 + size


def _check_chunk(data: bytes, kind: bytes, largest: int) -> None:
    if kind in (b"lz4", b"zstd"):
        check_unpacked(data, kind.decode(), largest, "a packed chunk")


class _Bounded(BufferedReader):
    """A file that takes no memory for more bytes than it still has."""

    def __init__(self, raw: FileIO, size: int) -> None:
        super().__init__(raw)
        self._size = size

    def read(self, size: int | None = -1, /) -> bytes:
        left = max(0, self._size - self.tell())
        return super().read(left if size is None or size < 0 else min(size, left))


@dataclass(frozen=True)
class _Source:
    """A path as far as a reader of ROS 1 opens it."""

    path: Path

    def __str__(self) -> str:
        return str(self.path)

    def open(self, mode: Literal["rb"]) -> BufferedReader:
        return _Bounded(FileIO(self.path, mode), self.path.stat().st_size)


def limit_reads(reader: Any) -> None:
    """Let a reader of a ROS 1 bag that is not yet open take no memory for lengths beyond the end of the file.

    Parameters
    ----------
    reader : rosbags reader of ROS 1 or ROS 2
    """
    from rosbags.rosbag1 import Reader as Reader1

    if isinstance(reader, Reader1):
        reader.path = _Source(Path(str(reader.path)))  # pyright: ignore[reportAttributeAccessIssue]  # opened, and named in errors


def limit_chunks(reader: Reader1 | Reader2, largest: int) -> None:
    """Bound what an open bag unpacks while its messages are read.

    Parameters
    ----------
    reader : rosbags reader of ROS 1 or ROS 2
        Its chunks are told to unpack no more.
    largest : int
        Bytes that one part may become.

    Raises
    ------
    ValueError
        If a part of a ROS 2 bag becomes more.
    """
    from rosbags.rosbag1 import Reader as Reader1

    if isinstance(reader, Reader1):
        _limit_ros1(reader, largest)
        return
    storage = reader.storage
    for each in getattr(storage, "storages", [storage]):
        if getattr(storage.metadata, "compression_mode", None) == "message":
            for _, _, data in each.messages(each.connections):
                check_unpacked(data, "zstd", largest, "a packed message")
        for chunk in getattr(each, "chunks", ()):  # where the index says that they stand
            check_size(chunk.compressed_size, largest, "a chunk")
            each.bio.seek(chunk.chunk_start_offset + 9 + _CHUNK_HEAD + len(chunk.compression))
            _check_chunk(each.bio.read(chunk.compressed_size), chunk.compression.encode(), largest)


def _limit_ros1(reader: Reader1, largest: int) -> None:
    from rosbags.rosbag1.reader import decompressors

    kinds = {function: name for name, function in decompressors.items() if name != "none"}
    for place, chunk in reader.chunks.items():
        kind = kinds.get(chunk.decompressor)
        if kind is not None:
            reader.chunks[place] = chunk._replace(decompressor=partial(_unpacked, kind=kind, largest=largest))


def _unpacked(data: bytes, *, kind: str, largest: int) -> bytes:
    return b"".join(unpacked(data, kind, largest, "a packed chunk"))
