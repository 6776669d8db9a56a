"""What the packed buffers of Arrow's files and streams say that they unpack to: pyarrow asks for that memory unseen.

Formats: https://arrow.apache.org/docs/format/Columnar.html, of flatbuffers: https://flatbuffers.dev/internals.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

import pyarrow as pa

__all__ = ["unpacked_size"]

_MAGIC = 6  # bytes of the file's last word, ARROW1
_DICTIONARY, _BATCH = 2, 3  # kinds of messages
_PLAIN = -1  # said of a buffer that is not packed


def unpacked_size(data: pa.Buffer, *, is_file: bool) -> int:
    """Bytes that all packed buffers together say they take; others are read in place.

    Parameters
    ----------
    data : pyarrow.Buffer
    is_file : bool
        Whether it is a file, with its messages listed at the end, or a stream of them.

    Raises
    ------
    Exception
        Of many kinds, where it is damaged.
    """
    messages = _listed(data) if is_file else _streamed(data)
    return sum(_message_size(message.metadata.to_pybytes(), message.body) for message in messages)


def _streamed(data: pa.Buffer) -> Iterator[pa.Message]:
    reader = pa.ipc.MessageReader.open_stream(data)
    while True:
        try:
            yield reader.read_next_message()
        except StopIteration:
            return


def _listed(data: pa.Buffer) -> Iterator[pa.Message]:
    end = data.size - _MAGIC - 4
    (length,) = struct.unpack("<i", data.slice(end, 4).to_pybytes())
    footer = data.slice(end - length, length).to_pybytes()
    for field in (2, 3):  # dictionaries, record batches
        at, count = _vector(footer, _root(footer), field)
        for k in range(count):
            offset, head, body = struct.unpack_from("<qi4xq", footer, at + 24 * k)
            yield pa.ipc.read_message(data.slice(offset, head + body))


def _message_size(message: bytes, body: pa.Buffer | None) -> int:
    root = _root(message)
    kind, header = _field(message, root, 1), _table(message, root, 2)
    if kind is None or header is None or body is None or message[kind] not in (_DICTIONARY, _BATCH):
        return 0
    batch = _table(message, header, 1) if message[kind] == _DICTIONARY else header
    if batch is None or _field(message, batch, 3) is None:  # nothing is packed
        return 0
    at, count = _vector(message, batch, 2)
    sizes = 0
    for k in range(count):
        offset, length = struct.unpack_from("<qq", message, at + 16 * k)
        if length >= 8:
            (size,) = struct.unpack("<q", body.slice(offset, 8).to_pybytes())
            sizes += 0 if size == _PLAIN else size % (1 << 64)
    return sizes


# -- flatbuffers: a table has, at a signed distance before it, the places of its fields -------------------------------


def _root(data: bytes) -> int:
    return struct.unpack_from("<I", data)[0]


def _field(data: bytes, table: int, k: int) -> int | None:
    """Where the k-th field of a table stands; None where it is left out."""
    places = table - struct.unpack_from("<i", data, table)[0]
    (size,) = struct.unpack_from("<H", data, places)
    (place,) = struct.unpack_from("<H", data, places + 4 + 2 * k) if 4 + 2 * k < size else (0,)
    return table + place if place else None


def _table(data: bytes, table: int, k: int) -> int | None:
    """Where the table that is the k-th field begins."""
    at = _field(data, table, k)
    return None if at is None else at + struct.unpack_from("<I", data, at)[0]


def _vector(data: bytes, table: int, k: int) -> tuple[int, int]:
    """Where the entries of the k-th field begin, and how many there are."""
    at = _table(data, table, k)
    return (0, 0) if at is None else (at + 4, struct.unpack_from("<I", data, at)[0])
