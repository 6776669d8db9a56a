"""ROS 1 bags, ROS 2 bags and MCAP files with ROS messages, by rosbags.

The times of a topic are those at which its messages were received: the one clock that all topics have. Where messages
carry a header, ``header.stamp`` is a field of times, and the topic's notes say how far it is from the reception.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from . import units
from .clock import since, utc_of
from .contents import TIME, Column, Contents, Table
from .packed_bags import check_packed, limit_chunks, limit_reads
from .sizes import check_size

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys.store import Typestore

_WIDEST = 256  # elements of an array that become columns: no images, no clouds
_NO_MEMBER = "structure_needs_at_least_one_member"  # rosbags' own, of no byte in ROS 1
_MOST_MESSAGES = 4096  # in an array of fixed length
_MESSAGE = 64  # bytes that the times of a message take
_STAMP = "header.stamp"
_TIME_TYPE = "builtin_interfaces/msg/Time"
_HEADER_TYPE = "std_msgs/msg/Header"


@dataclass
class _Topic:
    kind: str
    first: object  # its first message
    stamped: bool
    received: list[int] = field(default_factory=list)
    stamps: list[int] = field(default_factory=list)


@cache
def _usual() -> Typestore:
    """Definitions for a bag that brings none."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)


@contextmanager
def _opened(path: Path, largest: int) -> Iterator[tuple[AnyReader, bool]]:
    """A reader, and whether the bag says what its messages hold; what is packed may become so large."""
    from rosbags.highlevel import AnyReader

    if path.is_file() and path.suffix.lower() not in (".bag", ".db3", ".mcap"):
        raise ValueError(
            f"rename it: rosbags tells bags by .bag, .db3 or .mcap, and this one ends in {path.suffix!r}"
        )
    check_packed(path, largest)
    reader = AnyReader([path], default_typestore=_usual())
    for each in reader.readers:
        limit_reads(each)
    with reader:
        for each in reader.readers:
            limit_chunks(each, largest)
        _refuse_weightless(reader.typestore)
        yield reader, any(connection.msgdef.data for connection in reader.connections)


def read(path: Path, time_unit: str | None, time: str | None, largest: int) -> Contents:
    """Topics by name; those whose messages cannot be read are left out, and said."""
    from rosbags.serde import SerdeError

    topics: dict[str, _Topic] = {}
    left_out: dict[str, str] = {}
    with _opened(path, largest) as (reader, described):
        store, ros2 = reader.typestore, reader.is2
        for count, (connection, received, data) in enumerate(reader.messages(), start=1):
            check_size(_MESSAGE * count, largest, "its messages")
            name = connection.topic
            topic = topics.get(name)
            if topic is None:
                if name in left_out:
                    continue
                try:
                    first = reader.deserialize(data, connection.msgtype)
                except (SerdeError, KeyError) as error:
                    unknown = isinstance(error, KeyError)
                    left_out[name] = (
                        f"{connection.msgtype} is {'not defined' if unknown else f'broken: {error}'}"
                    )
                    continue
                stamped = _stamped(store, connection.msgtype)
                topic = topics[name] = _Topic(connection.msgtype, first, stamped)
            topic.received.append(received)
            if topic.stamped:
                topic.stamps.append(_stamp(data, ros2))
    zero = min((topic.received[0] for topic in topics.values()), default=0)
    tables = {name: _table(path, name, topic, store, zero, largest) for name, topic in sorted(topics.items())}
    notes = [f"left out, {name}: {why}" for name, why in left_out.items()]
    if not described and topics:
        notes.append("the bag does not define its messages: they are taken for those of ROS 2 Humble")
    form = {".bag": "rosbag1", ".mcap": "mcap"}.get(path.suffix.lower(), "rosbag2")
    return Contents(form, tables, utc_of(zero // 1000), tuple(notes))


def _refuse_weightless(store: Typestore) -> None:
    """Refuse definitions by which a few bytes become any number of messages.

    Lists of messages without a byte, whose number is said and bounded by nothing; and long arrays of messages, for each
    element of which rosbags writes a line of code.
    """

    @cache
    def weighs(kind: str) -> bool:
        return any(
            name != _NO_MEMBER and (not isinstance(detail, str) or weighs(detail))
            for name, (_, detail) in store.fielddefs[kind][1]
        )

    for kind, (_, fields) in store.fielddefs.items():
        for name, (_, detail) in fields:
            if isinstance(detail, str) or not isinstance(detail[0], tuple):  # one message, one number
                continue
            (_, element), length = detail
            if isinstance(element, str) and (int(length) > _MOST_MESSAGES or not weighs(element)):
                raise ValueError(
                    f"{kind}: field {name!r}: expected a list of messages with fields, or at most {_MOST_MESSAGES} of "
                    f"them, got {element}[{length or ''}]"
                )


def _stamped(store: Typestore, kind: str) -> bool:
    fields = store.fielddefs[kind][1]
    return bool(fields) and fields[0][0] == "header" and fields[0][1][1] == _HEADER_TYPE


def _stamp(data: bytes, ros2: bool) -> int:
    """Time of a header that a message begins with, ns: after ROS 1's sequence number, or CDR's head."""
    little = not ros2 or data[1] & 1
    seconds, nanoseconds = struct.unpack_from("<II" if not ros2 else "<iI" if little else ">iI", data, 4)
    return seconds * 1_000_000_000 + nanoseconds


@dataclass(frozen=True)
class _Leaf:
    """Numbers somewhere in a message: at ``path``, as many as ``width``; 0 for one that is no array."""

    path: str
    unit: str
    dtype: str
    width: int

    def columns(self) -> list[Column]:
        if not self.width:
            return [Column(self.path, self.unit, self.dtype)]
        return [Column(f"{self.path}[{k}]", self.unit, self.dtype) for k in range(self.width)]


def _leaves(
    store: Typestore, kind: str, message: object, at: str, unit: str, left_out: list[str]
) -> Iterator[_Leaf]:
    for name, (_, detail) in store.fielddefs[kind][1]:
        path = f"{at}{name}"
        value = getattr(message, name)
        own = unit or units.ros(kind, name)
        if detail == _TIME_TYPE:
            yield _Leaf(path, "s", TIME, 0)
        elif isinstance(detail, str):  # another message
            yield from _leaves(store, detail, value, f"{path}.", own, left_out)
        elif isinstance(value, int | float):
            yield _Leaf(path, own, str(detail[0]), 0)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and 0 < len(value) <= _WIDEST:
            yield _Leaf(path, own, value.dtype.name, len(value))
        elif not isinstance(value, str):
            left_out.append(f"{path} ({len(value)} elements{'' if len(value) else ' in the first message'})")


def _table(path: Path, name: str, topic: _Topic, store: Typestore, zero: int, largest: int) -> Table:
    left_out: list[str] = []
    leaves = {leaf.path: leaf for leaf in _leaves(store, topic.kind, topic.first, "", "", left_out)}
    notes = [topic.kind]
    if topic.stamped:
        notes.append(_lag(np.array(topic.stamps), np.array(topic.received)))
    if left_out:
        notes.append(f"left out: {', '.join(left_out)}")
    columns = [column for leaf in leaves.values() for column in leaf.columns()]
    times = since(np.array(topic.received), zero, "ns")

    def load(names: Sequence[str]) -> FloatArray:
        places = [_place(leaves, each) for each in names]
        wanted = list(dict.fromkeys(leaf for leaf, _ in places))
        values = dict(zip(wanted, _values(path, name, wanted, zero, largest), strict=True))
        found = {len(value) for value in values.values()}
        if found - {len(times)}:  # its index and its messages disagree
            raise ValueError(
                f"topic {name!r}: expected {len(times)} messages, as in the whole file, got {max(found)}: it is damaged"
            )
        return np.stack([values[leaf] if k is None else values[leaf][:, k] for leaf, k in places], axis=1)

    return Table(tuple(columns), times, load, tuple(notes))


def _place(leaves: dict[str, _Leaf], column: str) -> tuple[_Leaf, int | None]:
    """Which leaf a column is of, and which of its elements."""
    if column in leaves:
        return leaves[column], None
    path, _, element = column[:-1].rpartition("[")
    return leaves[path], int(element)


def _lag(stamps: NDArray[np.int64], received: NDArray[np.int64]) -> str:
    if not stamps.any():
        return f"{_STAMP} is never set"
    late = (received - stamps) / 1e6
    return (
        f"{_STAMP} is {np.median(late):.3g} ms before the reception, which is the clock ({late.min():.3g} to "
        f"{late.max():.3g} ms)"
    )


def _values(path: Path, name: str, leaves: Sequence[_Leaf], zero: int, largest: int) -> list[FloatArray]:
    """Of each leaf, shape (N,) or (N, width)."""
    get = attrgetter(*(leaf.path for leaf in leaves))
    with _opened(path, largest) as (reader, _):
        connections = [c for c in reader.connections if c.topic == name]
        rows = [get(reader.deserialize(data, c.msgtype)) for c, _, data in reader.messages(connections)]
    columns = [rows] if len(leaves) == 1 else list(zip(*rows, strict=True))
    return [_array(leaf, column, zero) for leaf, column in zip(leaves, columns, strict=True)]


def _array(leaf: _Leaf, column: Sequence[object], zero: int) -> FloatArray:
    if leaf.dtype == TIME:
        get = attrgetter("sec", "nanosec")
        return since(np.array([s * 1_000_000_000 + ns for s, ns in map(get, column)]), zero, "ns")
    if not leaf.width:
        return np.array(column, dtype=float)
    lengths = {len(row) for row in column if isinstance(row, np.ndarray)}
    if lengths != {leaf.width}:
        raise ValueError(
            f"field {leaf.path!r}: expected {leaf.width} elements in all messages, got {sorted(lengths)}"
        )
    return np.array(column, dtype=float)
