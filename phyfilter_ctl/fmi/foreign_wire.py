"""What passes between a process that runs a foreign binary and the one that asked for it.

A frame is two lengths, JSON, and the bytes of arrays: it is data and nothing else, whatever the binary did to its
process.
"""

from __future__ import annotations

import ctypes
import json
import os
import struct
from typing import Any

from phyfilter_ctl._intake import check_count

__all__ = ["COMPONENT", "Component", "decoded", "encoded", "receive", "send"]

_HEAD = struct.Struct("<II")
_LARGEST = 1 << 30
_TYPES: dict[str, Any] = {
    kind._type_: kind
    for kind in (
        *(ctypes.c_bool, ctypes.c_float, ctypes.c_double, ctypes.c_int8, ctypes.c_uint8, ctypes.c_int16),
        *(ctypes.c_uint16, ctypes.c_int32, ctypes.c_uint32, ctypes.c_int64, ctypes.c_uint64),
    )
}


class Component:
    """Stands for the instance's own pointer, which means nothing outside its process."""


COMPONENT = Component()


def send(descriptor: int, message: object, arrays: bytes = b"") -> None:
    """Write one frame.

    Parameters
    ----------
    descriptor : int
    message : object
        As JSON has it.
    arrays : bytes
    """
    text = json.dumps(message).encode()
    view = memoryview(_HEAD.pack(len(text), len(arrays)) + text + arrays)
    while view:
        view = view[os.write(descriptor, view) :]


def receive(descriptor: int) -> tuple[Any, bytes]:
    """Read one frame.

    Parameters
    ----------
    descriptor : int

    Raises
    ------
    EOFError
        If the other side is gone, or what came is no frame.
    """
    lengths = _HEAD.unpack(_exactly(descriptor, _HEAD.size))
    if max(lengths) > _LARGEST:
        raise EOFError("no frame")
    body = _exactly(descriptor, sum(lengths))
    try:
        return json.loads(body[: lengths[0]]), body[lengths[0] :]
    except (ValueError, RecursionError) as error:
        raise EOFError("no frame") from error


def _exactly(descriptor: int, count: int) -> bytes:
    pieces, left = [], count
    while left:
        piece = os.read(descriptor, min(left, 1 << 20))
        if not piece:
            raise EOFError("the other side is gone")
        pieces.append(piece)
        left -= len(piece)
    return pieces[0] if len(pieces) == 1 else b"".join(pieces)


def encoded(values: tuple[object, ...]) -> tuple[list[object], bytes]:
    """Arguments or results: numbers, texts and lists as they are, arrays and pointers marked.

    Parameters
    ----------
    values : tuple
    """
    words: list[object] = []
    arrays: list[bytes] = []
    for value in values:
        if isinstance(value, ctypes.Array):
            data = bytes(value)
            arrays.append(data)
            words.append({"array": value._type_._type_, "length": len(value)})
        elif isinstance(value, ctypes.c_void_p):
            words.append({"pointer": value.value})
        elif isinstance(value, ctypes._SimpleCData):
            words.append(value.value)
        elif value is COMPONENT:
            words.append({"component": True})
        else:
            words.append(value)
    return words, b"".join(arrays)


def decoded(words: list[Any], arrays: bytes, component: object = None) -> tuple[list[Any], bytes]:
    """The other way round; also returns the bytes that are left.

    Parameters
    ----------
    words : list
    arrays : bytes
    component : object
        What stands for the instance here.

    Raises
    ------
    EOFError
        If they are no arguments or results of :func:`encoded`.
    """
    try:
        return _decoded(words, arrays, component)
    except (TypeError, ValueError, LookupError, OverflowError, MemoryError) as error:
        raise EOFError("no frame") from error


def _decoded(words: list[Any], arrays: bytes, component: object) -> tuple[list[Any], bytes]:
    result: list[Any] = []
    at = 0
    for word in words:
        if not isinstance(word, dict):
            result.append(word)
        elif "array" in word:
            length = check_count(word["length"], len(arrays) - at, "elements of an array")
            kind = _TYPES[word["array"]] * length
            result.append(kind.from_buffer_copy(arrays, at))
            at += ctypes.sizeof(kind)
        elif "pointer" in word:
            result.append(ctypes.c_void_p(word["pointer"]))
        else:
            result.append(component)
    return result, arrays[at:]
