"""Learned models on disk: named arrays in an uncompressed .npz archive, without pickle.

Every file has the entries ``format`` = "phyfilter-learned-model", ``version`` and ``kind``. What a file declares
is checked against its size before memory is set aside for it.
"""

from __future__ import annotations

import io
import math
import os
import struct
import tokenize
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .._output import replacing

FORMAT = "phyfilter-learned-model"
VERSION = 1

Array = NDArray[np.generic]
# Real and whole numbers, booleans, text: what can be read without running anything.
_PLAIN_KINDS = "fiubU"
# What zipfile and numpy's header reader raise on damaged bytes; OSError for places outside the data.
_DAMAGE = (
    zipfile.BadZipFile,
    ValueError,
    TypeError,
    RuntimeError,
    OSError,
    EOFError,
    SyntaxError,
    OverflowError,
    MemoryError,
    struct.error,
    tokenize.TokenError,
)


def write(path: str | os.PathLike[str], kind: str, arrays: Mapping[str, Array]) -> None:
    """Write the arrays to a file, whole or not at all."""
    named = {"format": np.array(FORMAT), "version": np.array(VERSION), "kind": np.array(kind), **arrays}
    for name, array in named.items():
        if array.dtype.kind not in _PLAIN_KINDS:
            raise TypeError(f"{name}: expected numbers or text, got dtype {array.dtype}")
    with replacing(path) as file:
        np.savez(file, allow_pickle=False, **named)


def read(path: str | os.PathLike[str], kind: str) -> dict[str, Array]:
    """The arrays of a file of this kind of model.

    Raises
    ------
    ValueError
        If it is not such a file, is damaged, or of an unknown version; the message names the path.
    """
    arrays = _read(path)
    for name, expected in (("format", FORMAT), ("version", VERSION), ("kind", kind)):
        if name not in arrays:
            raise ValueError(f"{path}: not a learned model, the entry {name!r} is missing")
        got = arrays.pop(name)
        if got.shape != () or got.item() != expected:
            advice = "; it was written by another version of this package" if name == "version" else ""
            raise ValueError(f"{path}: expected {name} {expected!r}, got {got.tolist()!r}{advice}")
    return arrays


def kind_of(path: str | os.PathLike[str]) -> str:
    """Which kind of model a file holds; ValueError as for :func:`read`."""
    return str(_read(path).get("kind", ""))


def _read(path: str | os.PathLike[str]) -> dict[str, Array]:
    data = Path(path).read_bytes()
    try:
        return _entries(data)
    except _RefusedError as error:
        raise ValueError(f"{path}: {error}; expected a file that save() wrote") from error
    except _DAMAGE as error:
        raise ValueError(f"{path}: damaged or not a learned model ({error}); save it again") from error


class _RefusedError(Exception):
    """An entry that save() would not have written."""


def _entries(data: bytes) -> dict[str, Array]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = archive.infolist()
        if len({entry.filename for entry in entries}) != len(entries):
            raise _RefusedError("an entry occurs twice")
        for entry in entries:
            if entry.compress_type != zipfile.ZIP_STORED or entry.flag_bits & 1:
                raise _RefusedError(f"entry {entry.filename!r} is compressed or encrypted")
        # Stored entries cannot be larger together than the file: a few bytes must not ask for gigabytes.
        if sum(entry.file_size for entry in entries) > len(data):
            raise _RefusedError("the entries declare more bytes than the file has")
        return {
            entry.filename.removesuffix(".npy"): _array(entry.filename, archive.read(entry))
            for entry in entries
        }


def _array(name: str, data: bytes) -> Array:
    buffer = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(buffer)
        if version != (1, 0):
            raise _RefusedError(f"entry {name!r} has array format {version}")
        shape, _, dtype = np.lib.format.read_array_header_1_0(buffer)
        if dtype.kind not in _PLAIN_KINDS:
            raise _RefusedError(f"entry {name!r} has dtype {dtype}, which is not numbers or text")
        if math.prod(shape) * dtype.itemsize != len(data) - buffer.tell():
            raise _RefusedError(f"entry {name!r} declares the shape {shape} but has other data")
        return np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
    except _DAMAGE as error:
        raise _RefusedError(f"entry {name!r} is not an array ({error})") from error
