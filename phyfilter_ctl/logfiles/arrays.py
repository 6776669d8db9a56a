"""MATLAB's .mat (version 4 by scipy, 7.3 by h5py) and HDF5: a group, or a struct, with a vector of times is a topic."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from ..recording.header import unit_in
from .clock import Times, column_times, time_column
from .contents import Column, Contents, Table
from .formats import format_of
from .matlab import Values, read_arrays
from .sizes import check_size, inflated
from .tables import TABLE

if TYPE_CHECKING:
    import h5py

_WIDEST = 256  # columns of a matrix
_DEFLATE, _CHECKSUM = 1, 3  # HDF5's numbers of its filters zlib and Fletcher-32
_DEFLATED = 1033  # bytes that zlib makes of one, at most


@dataclass(frozen=True)
class _Array:
    """An array of numbers that is read when it is asked for; shape without axes of length one."""

    shape: tuple[int, ...]
    dtype: np.dtype[np.generic]
    unit: str
    get: Callable[[], NDArray[np.generic]]

    @property
    def size(self) -> int:
        """Bytes that it takes once it is read; as floats, where those are larger."""
        return math.prod(self.shape) * max(self.dtype.itemsize, 8)


_Groups = Mapping[str, Mapping[str, _Array]]


def read(path: Path, time_unit: str | None, time: str | None, largest: int) -> Contents:
    """Topics by the path of their group; what has no times, or other numbers of them, is left out and said."""
    form = format_of(path)
    groups = _hdf5(path, largest) if form == "hdf5" or _is_version_7_3(path) else _matlab(path, largest)
    timed = {name: arrays for name, arrays in groups.items() if time is None or time in arrays}
    chosen: dict[str, str] = {}
    without: list[str] = []
    for name, arrays in timed.items():
        vectors = [key for key, array in arrays.items() if len(array.shape) == 1 and array.shape[0] > 1]
        try:
            chosen[name] = time_column(vectors, (), time)
        except ValueError as error:
            without.append(f"{name}: {error}")
    if not chosen:
        raise ValueError(
            "; ".join(without) or f"no group has {'arrays of numbers' if time is None else repr(time)}"
        )
    check_size(
        sum(groups[name][key].size for name, key in chosen.items()), largest, "the times of all topics"
    )
    times = _common({name: (key, groups[name][key]) for name, key in chosen.items()}, time_unit)
    tables = {name: _table(groups[name], chosen[name], times[name].seconds, largest) for name in chosen}
    notes = {found.note for found in times.values()}
    return Contents(form, tables, None, (*sorted(notes), *(f"left out, {why}" for why in without)))


def _common(clocks: Mapping[str, tuple[str, _Array]], unit: str | None) -> dict[str, Times]:
    """All times from the earliest first one: possible where all count the same."""
    own = {
        name: column_times(key, array.get(), unit, said=array.unit) for name, (key, array) in clocks.items()
    }
    units = {found.unit for found in own.values()}
    if len(units) > 1:
        raise ValueError(f"its groups count time in {' and '.join(sorted(units))}: no common clock")
    zero = min(found.zero for found in own.values())
    if any(isinstance(found.zero, int) for found in own.values()):
        zero = math.floor(zero)  # whole numbers are counted from a whole one
    return {
        name: column_times(key, array.get(), unit, said=array.unit, zero=zero)
        for name, (key, array) in clocks.items()
    }


def _table(arrays: Mapping[str, _Array], time: str, times: FloatArray, largest: int) -> Table:
    n = len(times)
    columns: list[Column] = []
    notes: list[str] = []
    for name, array in arrays.items():
        unit, kind = array.unit or unit_in(name), array.dtype.name
        if name == time:
            continue
        if array.shape == (n,):
            columns.append(Column(name, unit, kind))
        elif len(array.shape) == 2 and n in array.shape and _width(array, n) <= _WIDEST:
            columns += [Column(f"{name}[{k}]", unit, kind) for k in range(_width(array, n))]
        else:
            notes.append(f"left out, {name}: shape {array.shape} has no axis of the {n} of {time!r}")

    def load(names: Sequence[str]) -> FloatArray:
        sources = [name if name in arrays else name[: name.rindex("[")] for name in names]
        needed = list(dict.fromkeys(sources))
        check_size(sum(arrays[source].size for source in needed), largest, ", ".join(map(repr, needed[:5])))
        read = {source: _by_rows(np.squeeze(arrays[source].get()), n) for source in needed}
        picked = [
            read[source] if name == source else read[source][:, int(name[len(source) + 1 : -1])]
            for name, source in zip(names, sources, strict=True)
        ]
        return np.stack(picked, axis=1).astype(float)

    return Table(tuple(columns), times, load, tuple(notes))


def _width(array: _Array, n: int) -> int:
    return array.shape[1] if array.shape[0] == n else array.shape[0]


def _by_rows(values: NDArray[np.generic], n: int) -> NDArray[np.generic]:
    return values if values.shape[0] == n else values.T


# -- MATLAB -----------------------------------------------------------------------------------------------------------


def _is_version_7_3(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(128)[124:126] in (b"\x00\x02", b"\x02\x00")  # whatever the text before says


def _matlab(path: Path, largest: int) -> _Groups:
    with path.open("rb") as file:
        old = 0 in file.read(4)  # version 4
    groups: dict[str, dict[str, _Array]] = {}
    for group, name, array in _version_4(path) if old else read_arrays(path, largest):
        shape = tuple(k for k in array.shape if k != 1)
        if shape:
            groups.setdefault(group or TABLE, {})[name] = _Array(
                shape, array.dtype, "", lambda a=array: np.squeeze(a.get())
            )
    return groups


def _version_4(path: Path) -> Iterator[tuple[str, str, Values]]:
    from scipy.io import loadmat

    for name, value in loadmat(path).items():
        if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
            yield "", name, Values(value.shape, value.dtype, value.ravel(order="F"))


# -- HDF5 -------------------------------------------------------------------------------------------------------------


def _hdf5(path: Path, largest: int) -> _Groups:
    import h5py

    groups: dict[str, dict[str, _Array]] = {}

    def visit(name: str, item: object) -> None:
        if not isinstance(item, h5py.Dataset) or name.startswith("#refs#"):
            return
        if item.external or item.is_virtual:
            raise ValueError(
                f"{name!r} takes its numbers from another file, which is not read; copy them into this one "
                "(h5repack, or a new dataset)"
            )
        check_size(math.prod(item.chunks or ()) * item.dtype.itemsize, largest, f"a chunk of {name!r}")
        group, _, own = name.rpartition("/")
        if item.dtype.names is not None:  # a table of its own
            for column in item.dtype.names:
                if item.dtype[column].kind in "biuf" and not item.dtype[column].shape:
                    array = _Array(
                        item.shape,
                        item.dtype[column],
                        "",
                        lambda c=column: _hdf5_values(path, name, c, largest),
                    )
                    groups.setdefault(name, {})[column] = array
        elif item.dtype.kind in "biuf" and item.shape and item.attrs.get("MATLAB_class") != b"char":
            shape = tuple(k for k in item.shape if k != 1)
            unit = item.attrs.get("unit", item.attrs.get("units", ""))
            unit = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else str(unit)
            array = _Array(shape, item.dtype, unit, lambda: _hdf5_values(path, name, None, largest))
            groups.setdefault(group or TABLE, {})[own] = array

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    return groups


def _hdf5_values(path: Path, name: str, column: str | None, largest: int) -> NDArray[np.generic]:
    import h5py

    with h5py.File(path, "r") as file:
        item = file[name]
        assert isinstance(item, h5py.Dataset)
        if item.chunks and path.stat().st_size * _DEFLATED > largest:
            _check_chunks(item, largest)
        return np.squeeze(item[() if column is None else column])


def _check_chunks(item: h5py.Dataset, largest: int) -> None:
    """Refuse chunks that unpack to more than allowed: HDF5 unpacks whatever comes."""
    pipeline = item.id.get_create_plist()
    filters = [pipeline.get_filter(k)[0] for k in range(pipeline.get_nfilters())]
    if _DEFLATE not in filters:
        return
    if filters.count(_DEFLATE) > 1 or filters[-1] not in (
        _DEFLATE,
        _CHECKSUM,
    ):
        raise ValueError(
            f"{item.name!r}: expected zlib once, and last but for a checksum, got the filters {filters}; pack it anew "
            "by h5repack"
        )
    large: list[tuple[int, ...]] = []

    def note(chunk: h5py.h5d.StoreInfo) -> None:
        if chunk.size * _DEFLATED > largest:
            large.append(chunk.chunk_offset)

    item.id.chunk_iter(note)
    for offset in large:
        inflated(item.id.read_direct_chunk(offset)[1], largest, f"a chunk of {item.name!r}")
