"""Which format a file has: by its first bytes, then by its name."""

from __future__ import annotations

import string
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from .contents import Contents

Reader = Callable[[Path, str | None, str | None, int], Contents]


@dataclass(frozen=True)
class Format:
    """Module that reads it, package it needs, and whether it is a table with a column of times."""

    module: str
    package: str = ""
    table: bool = False

    def reader(self) -> Reader:
        """Its function ``read(path, time_unit, time, largest)``."""
        return import_module(f".{self.module}", __package__).read


FORMATS = {
    "ulog": Format("ulog", "pyulog"),
    "dataflash": Format("dataflash", "pymavlink"),
    "rosbag1": Format("rosbag", "rosbags"),
    "rosbag2": Format("rosbag", "rosbags"),
    "mcap": Format("rosbag", "rosbags"),
    "crazyflie": Format("crazyflie"),
    "parquet": Format("arrow", "pyarrow", table=True),
    "arrow": Format("arrow", "pyarrow", table=True),
    "mat": Format("arrays", "h5py", table=True),
    "hdf5": Format("arrays", "h5py", table=True),
    "csv": Format("tables", table=True),
}

_HEAD = 1024
_MAGIC = (
    (b"ULog\x01\x12\x35", "ulog"),
    (b"\xa3\x95\x80", "dataflash"),
    (b"#ROSBAG V2.0\n", "rosbag1"),
    (b"SQLite format 3\0", "rosbag2"),
    (b"\x89MCAP0\r\n", "mcap"),
    (b"\xbc\x01\0", "crazyflie"),
    (b"\xbc\x02\0", "crazyflie"),
    (b"PAR1", "parquet"),
    (b"ARROW1\0\0", "arrow"),
    (b"FEA1", "arrow"),
    (b"\xff\xff\xff\xff", "arrow"),
    (b"MATLAB ", "mat"),
    (b"\x89HDF\r\n\x1a\n", "hdf5"),
)
_REFUSED = (
    (b"FMT, 128", "a text dump of DataFlash; give the .bin that it was made from"),
    (b"#ROSBAG V1", "a ROS bag of format 1; convert it with rosbag fix"),
)
_NAMES = {".ulg": "ulog", ".bag": "rosbag1", ".db3": "rosbag2", ".mcap": "mcap", ".parquet": "parquet"}
_TEXT = set(string.printable.encode()) | set(range(128, 256))


def format_of(path: Path) -> str:
    """Format of a file.

    Raises
    ------
    OSError
        If it cannot be read.
    ValueError
        If it is empty or of no known format.
    """
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return "rosbag2"
        raise ValueError(
            f"{path}: a folder without metadata.yaml is no ROS 2 bag; ros2 bag reindex writes one"
        )
    with path.open("rb") as file:
        head = file.read(_HEAD)
    if not head:
        raise ValueError(f"{path}: the file is empty")
    for magic, name in _MAGIC:
        if head.startswith(magic):
            return name
    for magic, why in _REFUSED:
        if head.startswith(magic):
            raise ValueError(f"{path}: {why}")
    suffix = path.suffix.lower()
    if suffix == ".mat":  # version 4 has no mark
        return "mat"
    if suffix in _NAMES:
        raise ValueError(
            f"{path}: ends in {suffix}, but does not begin as a {_NAMES[suffix]} log: {head[:12]!r}"
        )
    if set(head) <= _TEXT:
        return "csv"
    raise ValueError(f"{path}: begins as no format that is known here: {', '.join(FORMATS)}")
