"""A minimal writer of PX4's ULog, from the format's specification (docs.px4.io, "ULog file format")."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

KINDS = {"float": "f4", "double": "f8", "uint64_t": "u8", "uint32_t": "u4", "int32_t": "i4", "uint8_t": "u1"}
KINDS |= {"bool": "u1", "uint16_t": "u2", "int16_t": "i2", "int8_t": "i1", "int64_t": "i8", "char": "S1"}


def message(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def ulog(
    topics: Mapping[str | tuple[str, int], Mapping[str, tuple[str, np.ndarray]]],
    *,
    start: int = 0,
    dropouts: Sequence[tuple[int, int]] = (),
) -> bytes:
    """A log of topics by name, or by (name, instance): fields as (type, values), one of them uint64_t timestamp in us.

    ``start`` is the file's own time in us; dropouts are (us, ms). Values of several columns are arrays.
    """
    keys = {key if isinstance(key, tuple) else (key, 0): fields for key, fields in topics.items()}
    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", start) + message("B", bytes(40))
    for name in dict.fromkeys(name for name, _ in keys):
        fields = next(fields for key, fields in keys.items() if key[0] == name)
        listed = "".join(
            f"{kind}{f'[{np.shape(values)[1]}]' if np.ndim(values) == 2 else ''} {field};"
            for field, (kind, values) in fields.items()
        )
        out += message("F", f"{name}:{listed}".encode())
    messages: list[tuple[int, bytes]] = []
    for number, ((name, instance), fields) in enumerate(keys.items()):
        out += message("A", struct.pack("<BH", instance, number) + name.encode())
        layout = [
            (field, "<" + KINDS[kind], np.shape(values)[1:]) for field, (kind, values) in fields.items()
        ]
        rows = np.zeros(len(fields["timestamp"][1]), layout)
        for field, (_, values) in fields.items():
            rows[field] = values
        head = struct.pack("<H", number)
        messages += [(int(row["timestamp"]), message("D", head + row.tobytes())) for row in rows]
    messages += [(time, message("O", struct.pack("<H", ms))) for time, ms in dropouts]
    return out + b"".join(body for _, body in sorted(messages, key=lambda each: each[0]))


def write_ulog(path: Path, *arguments: Mapping, **options: object) -> Path:
    """The same into a file."""
    path.write_bytes(ulog(*arguments, **options))
    return path
