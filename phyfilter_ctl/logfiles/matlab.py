"""Arrays of numbers of MATLAB's .mat, versions 5 to 7.2, by MathWorks' "MAT-File Format" (2024).

scipy's own reader, compiled, crashes the process on some damaged files. Version 4 is left to it: that part is Python.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .._intake import LARGEST, check_count
from .sizes import check_size, inflated

__all__ = ["Values", "read_arrays"]

_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_MATRIX, _COMPRESSED = 14, 15
_STRUCT = 2
_CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
_COMPLEX = 8  # a flag
_DEEPEST = 32  # structs in structs
_NONE = (0, b"")  # an element that is not there
_MOST_FIELDS = 100_000


@dataclass(frozen=True)
class Values:
    """An array as it lies in the file: often in fewer bytes than its class has."""

    shape: tuple[int, ...]
    dtype: np.dtype[np.generic]
    stored: NDArray[np.generic]

    def get(self) -> NDArray[np.generic]:
        """The array in its class."""
        return self.stored.astype(self.dtype).reshape(self.shape, order="F")


def read_arrays(path: Path, largest: int = LARGEST) -> Iterator[tuple[str, str, Values]]:
    """The struct that an array lies in, "" outside of structs, its name, and the array.

    Cells, texts, sparse and complex arrays, objects and arrays of several structs are passed over.

    Parameters
    ----------
    path : Path
    largest : int
        Bytes that all arrays together may take in memory.

    Raises
    ------
    ValueError
        If an element reaches beyond what holds it, is of no known type, or is too large.
    """
    data = path.read_bytes()
    if len(data) < 128 or data[126:128] not in (b"IM", b"MI"):
        raise ValueError("no header of a .mat file of version 5")
    order = "<" if data[126:128] == b"IM" else ">"
    taken = 0
    for kind, body in _elements(data[128:], order):
        if kind == _COMPRESSED:
            inside = list(islice(_elements(inflated(body, largest - taken, "a compressed array"), order), 2))
            if len(inside) != 1:
                raise ValueError(f"a compressed array holds {len(inside) or 'no'} elements, expected one")
            ((kind, body),) = inside
        taken += len(body)
        check_size(taken, largest, "its arrays")
        if kind == _MATRIX:
            yield from _arrays(body, order, largest)


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Type and content of one element behind the other."""
    at = 0
    while at < len(data):
        if at + 8 > len(data):
            raise ValueError("an element breaks off")
        first, length = np.frombuffer(data, f"{order}u4", 2, at).tolist()
        if first >> 16:  # up to four bytes lie in the tag itself
            kind, length, begin = first & 0xFFFF, first >> 16, at + 4
            after = at + 8
        else:
            kind, begin = first, at + 8
            after = begin + (length if kind == _COMPRESSED else -(-length // 8) * 8)
        end = begin + length
        if end > (at + 8 if first >> 16 else len(data)):
            raise ValueError(f"an element of {length} bytes reaches beyond its end")
        yield kind, data[begin:end]
        at = after


def _numbers(element: tuple[int, bytes], order: str) -> NDArray[np.generic]:
    kind, body = element
    if kind not in _STORED:
        raise ValueError(f"expected numbers, got an element of type {kind}")
    return np.frombuffer(body, order + _STORED[kind])


def _arrays(
    body: bytes, order: str, largest: int, struct: str = "", name: str = "", depth: int = 0
) -> Iterator[tuple[str, str, Values]]:
    parts = _elements(body, order)
    head = list(islice(parts, 3))
    if len(head) < 3:
        return  # an empty array, or what MATLAB keeps for itself
    flags = int(_numbers(head[0], order)[0])
    shape = tuple(int(k) for k in _numbers(head[1], order))
    count = math.prod(shape)
    name = name or head[2][1].decode("utf-8", "replace")
    if not name or min(shape, default=0) < 0:
        return
    found = flags & 0xFF
    if found == _STRUCT and count == 1:
        if depth == _DEEPEST:
            raise ValueError(f"structs more than {_DEEPEST} deep")
        for field, part in zip(_names(next(parts, _NONE), next(parts, _NONE), order), parts, strict=True):
            if part[0] == _MATRIX:
                inner = f"{struct}.{name}" if struct else name
                yield from _arrays(part[1], order, largest, inner, field, depth + 1)
    elif found in _CLASSES and not flags >> 8 & _COMPLEX:
        stored = _numbers(next(parts, _NONE), order)
        if stored.size != count:
            raise ValueError(f"{name}: {shape} asks for {count} numbers, got {stored.size}")
        dtype = np.dtype(_CLASSES[found])
        check_size(count * dtype.itemsize, largest, repr(name))
        yield struct, name, Values(shape, dtype, stored)


def _names(length: tuple[int, bytes], names: tuple[int, bytes], order: str) -> list[str]:
    """Field names of one length each, ended by zeros."""
    width, text = int(_numbers(length, order)[0]), names[1]
    if width <= 0 or len(text) % width:
        raise ValueError(f"field names of {width} characters in {len(text)}")
    check_count(len(text) // width, _MOST_FIELDS, "fields of a struct")
    return [
        text[at : at + width].split(b"\0")[0].decode("utf-8", "replace") for at in range(0, len(text), width)
    ]
