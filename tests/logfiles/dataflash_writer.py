"""A minimal writer of ArduPilot's DataFlash, from AP_Logger's LogStructure.h."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence

HEAD = b"\xa3\x95"
SIZES = {"b": 1, "B": 1, "M": 1, "h": 2, "H": 2, "i": 4, "I": 4, "q": 8, "Q": 8, "f": 4, "d": 8}
SIZES |= {"c": 2, "C": 2, "e": 4, "E": 4, "L": 4, "n": 4, "N": 16, "Z": 64, "a": 64}
STRUCT = {
    "c": "h",
    "C": "H",
    "e": "i",
    "E": "I",
    "L": "i",
    "M": "B",
    "n": "4s",
    "N": "16s",
    "Z": "64s",
    "a": "64s",
}
UNITS = {"s": "s", "m": "m", "n": "m/s", "o": "m/s/s", "d": "deg", "E": "rad/s", "-": "", "#": "instance"}
MULTIPLIERS = {"-": 0.0, "0": 1.0, "A": 1e-1, "B": 1e-2, "C": 1e-3, "F": 1e-6, "G": 1e-7}

Message = tuple[str, str, str, str]  # format, columns, unit ids, multiplier ids


def dataflash(messages: Mapping[str, Message], rows: Sequence[tuple[str, tuple]]) -> bytes:
    """A log of messages (format characters, columns, ids of units, of multipliers) and their rows, as they come."""
    known: dict[str, Message] = {
        "FMT": ("BBnNZ", "Type,Length,Name,Format,Columns", "-b---", "-----"),
        "UNIT": ("QbZ", "TimeUS,Id,Label", "s--", "F--"),
        "MULT": ("Qbd", "TimeUS,Id,Mult", "s--", "F--"),
        "FMTU": ("QBNN", "TimeUS,FmtType,UnitIds,MultIds", "s---", "F---"),
        **messages,
    }
    numbers = {name: 0x80 + k for k, name in enumerate(known)}

    def row(name: str, values: tuple) -> bytes:
        kinds = "<" + "".join(STRUCT.get(c, c) for c in known[name][0])
        encoded = [value.encode() if isinstance(value, str) else value for value in values]
        return HEAD + bytes([numbers[name]]) + struct.pack(kinds, *encoded)

    out = b""
    for name, (kinds, columns, _, _) in known.items():
        out += row("FMT", (numbers[name], 3 + sum(SIZES[c] for c in kinds), name, kinds, columns))
    out += b"".join(row("UNIT", (1, ord(i), label)) for i, label in UNITS.items())
    out += b"".join(row("MULT", (1, ord(i), factor)) for i, factor in MULTIPLIERS.items())
    for name, (_, _, units, multipliers) in known.items():
        out += row("FMTU", (1, numbers[name], units, multipliers))
    return out + b"".join(row(name, values) for name, values in rows)
