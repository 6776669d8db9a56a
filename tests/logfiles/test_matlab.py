"""The reader of .mat against scipy's, on the files that scipy has from MATLAB itself, and on damaged ones."""

from __future__ import annotations

import re
import struct
import warnings
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from scipy.io import loadmat, savemat

from phyfilter_ctl.logfiles.matlab import read_arrays

THEIRS = Path(scipy.io.__file__).parent / "matlab" / "tests" / "data"


def members(value: Mapping[str, object], at: str = "") -> Iterator[tuple[str, np.ndarray]]:
    for name, each in value.items():
        if name.startswith("__"):
            continue
        if isinstance(each, dict):
            yield from members(each, f"{at}{name}.")
        elif isinstance(each, np.ndarray | np.number) and np.asarray(each).dtype.kind in "biuf":
            yield at + name, np.asarray(each)


def ours(path: Path) -> dict[str, np.ndarray]:
    return {f"{at}.{name}".lstrip("."): np.squeeze(array.get()) for at, name, array in read_arrays(path)}


@pytest.mark.skipif(not THEIRS.is_dir(), reason="scipy is installed without its test data")
def test_files_of_matlab_are_read_as_scipy_reads_them() -> None:
    compared = 0
    for path in sorted(THEIRS.glob("*.mat")):
        head = path.read_bytes()[:128]
        if 0 in head[:4] or head[124:126] == b"\x00\x02":  # version 4, and 7.3
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # scipy warns of names that occur twice
            try:
                expected = dict(members(loadmat(path, simplify_cells=True)))
            except Exception:
                expected = None
        try:
            found = ours(path)
        except ValueError:
            # What one reader refuses the other may read, if it is no file as MATLAB writes them.
            assert path.name.startswith(("bad", "broken", "corrupted", "malformed")), path.name
            continue
        for name, array in (expected or {}).items():
            if array.size and not re.search(r"\._\d+_", name):  # scipy's name for a field that occurs twice
                np.testing.assert_array_equal(found[name], array, err_msg=f"{path.name}: {name}")
                compared += 1
    assert compared >= 20


@pytest.mark.parametrize("compressed", [True, False])
def test_every_type_of_number(tmp_path: Path, compressed: bool) -> None:
    rng = np.random.default_rng(1)
    kinds = ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"]
    wrote = {kind: (100.0 * rng.random((3, 2, 4))).astype(kind) for kind in kinds}
    wrote["flag"] = rng.random((1, 9)) > 0.5
    path = tmp_path / "types.mat"
    savemat(path, {"a": {"b": wrote}, **wrote}, do_compression=compressed)
    found = ours(path)
    for name, array in wrote.items():
        for full in (name, f"a.b.{name}"):
            np.testing.assert_array_equal(found[full], np.squeeze(array))
            assert found[full].dtype == ("u1" if name == "flag" else array.dtype)


def element(kind: int, body: bytes) -> bytes:
    return struct.pack("<II", kind, len(body)) + body + bytes(-len(body) % 8)


def matrix(dims: tuple[int, ...], values: bytes, found: int = 6, name: bytes = b"v") -> bytes:
    parts = element(6, struct.pack("<II", found, 0)) + element(5, struct.pack(f"<{len(dims)}i", *dims))
    return element(14, parts + element(1, name) + values)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (matrix((1 << 30, 1 << 10), element(9, bytes(16))), "asks for 1099511627776 numbers, got 2"),
        (matrix((2, 1), element(31, bytes(16))), "element of type 31"),
        (matrix((2, 1), struct.pack("<II", 9, 1 << 31) + bytes(16)), "reaches beyond its end"),
        (matrix((1, 1), element(5, bytes(4)) + element(1, b"abc"), 2), "field names of 0 characters"),
        (element(15, zlib.compress(bytes(64))[:-3]), "breaks off"),
        (element(15, zlib.compress(matrix((1, 1), element(9, bytes(8))) * 2)), "holds 2 elements"),
        (element(15, b"nothing"), "incorrect header check"),
    ],
)
def test_what_does_not_fit_is_refused(tmp_path: Path, body: bytes, words: str) -> None:
    path = tmp_path / "log.mat"
    path.write_bytes(b"MATLAB".ljust(124) + b"\x00\x01IM" + body)
    with pytest.raises(ValueError, match=words):
        ours(path)


def test_structs_too_deep_are_refused(tmp_path: Path) -> None:
    inner = matrix((1, 1), element(9, bytes(8)))
    for _ in range(40):
        fields = element(5, struct.pack("<i", 8)) + element(1, b"s".ljust(8, b"\0"))
        inner = matrix((1, 1), fields + inner, 2)
    path = tmp_path / "log.mat"
    path.write_bytes(b"MATLAB".ljust(124) + b"\x00\x01IM" + inner)
    with pytest.raises(ValueError, match="more than 32 deep"):
        ours(path)
