"""Parquet, Arrow and Feather as a log, by pyarrow: one table with a column of times."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pyarrow import feather

from .._sections import FloatArray
from ..recording.header import unit_in
from .arrow_sizes import unpacked_size
from .clock import column_times, time_column
from .contents import Column, Contents, Table
from .formats import format_of
from .records import side_by_side
from .sizes import check_size
from .tables import TABLE

_WIDEST = 256  # elements of a list that become columns


def read(path: Path, time_unit: str | None, time: str | None, largest: int) -> Contents:
    """The table; columns that hold no numbers are left out, nulls are NaN."""
    parquet = format_of(path) == "parquet"
    if parquet:
        metadata = pq.read_metadata(path)
        check_size(8 * metadata.num_rows, largest, "a column")
    schema = pq.read_schema(path) if parquet else _arrow(path, largest).schema
    calendar = [f.name for f in schema if pa.types.is_timestamp(f.type) or pa.types.is_duration(f.type)]
    chosen = time_column(schema.names, calendar, time)

    def table(names: Sequence[str]) -> pa.Table:
        names = list(dict.fromkeys(names))
        if not parquet:
            return _arrow(path, largest).select(names)
        with pq.ParquetFile(path) as file:
            check_size(_parquet_size(file.metadata, names), largest, f"the columns {', '.join(names)}")
            return file.read(columns=names)

    kind = schema.field(chosen).type
    utc = not pa.types.is_timestamp(kind) or kind.tz is not None
    found = column_times(
        chosen, _values(table([chosen])[chosen]), time_unit, said=_unit(schema.field(chosen)), utc=utc
    )
    columns: list[Column] = []
    left_out: list[str] = []
    for f in schema:
        listed = pa.types.is_fixed_size_list(f.type) and f.type.list_size <= _WIDEST
        if f.name == chosen:
            continue
        if not _is_number(f.type.value_type if listed else f.type):
            left_out.append(f"{f.name} ({f.type})")
        elif listed:
            columns += [
                Column(f"{f.name}[{k}]", _unit(f), str(f.type.value_type)) for k in range(f.type.list_size)
            ]
        else:
            columns.append(Column(f.name, _unit(f), str(f.type)))

    def load(names: Sequence[str]) -> FloatArray:
        sources = [name if name in schema.names else name[: name.rindex("[")] for name in names]
        data = table(sources)
        columns = [
            data[source]
            if name == source
            else pc.call_function("list_element", [data[source], _element(name)])
            for name, source in zip(names, sources, strict=True)
        ]
        return side_by_side([_values(column.cast(pa.float64(), safe=False)) for column in columns])

    notes = (f"left out, as no numbers: {', '.join(left_out)}",) if left_out else ()
    only = Table(tuple(columns), found.seconds, load, notes)
    return Contents("parquet" if parquet else "arrow", {TABLE: only}, found.start, (found.note,))


def _parquet_size(metadata: pq.FileMetaData, names: Sequence[str]) -> int:
    """Bytes of columns as they are read, all elements of a list: as the file says it, and no less than as doubles."""
    groups = [metadata.row_group(k) for k in range(metadata.num_row_groups)]
    parts = [group.column(j) for group in groups for j in range(group.num_columns)]
    read = [part for part in parts if part.path_in_schema.partition(".")[0] in names]
    return sum(max(part.total_uncompressed_size, 8 * part.num_values) for part in read)


def _values(column: pa.ChunkedArray) -> NDArray[np.generic]:
    """As numpy holds them. Numbers go past ``to_numpy``, which imports pandas: 30 MB in every process that reads."""
    kind = column.type
    if column.null_count or pa.types.is_boolean(kind) or not _is_number(kind):
        return column.to_numpy()
    chunks = [np.from_dlpack(chunk) for chunk in column.chunks]
    return chunks[0] if len(chunks) == 1 else np.concatenate([np.empty(0, kind.to_pandas_dtype()), *chunks])


def _element(name: str) -> int:
    return int(name[name.rindex("[") + 1 : -1])


def _is_number(kind: pa.DataType) -> bool:
    return pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind)


def _unit(field: pa.Field) -> str:
    """As the column's metadata say it, or its name."""
    metadata = field.metadata or {}
    said = metadata.get(b"unit", metadata.get(b"units", b"")).decode("utf-8", "replace")
    return said or unit_in(field.name)


def _arrow(path: Path, largest: int) -> pa.Table:
    """A file or a stream, mapped; Feather of version 1 too."""
    with path.open("rb") as file:
        head = file.read(4)
    if head == b"FEA1":
        return feather.read_table(path, memory_map=True)
    with pa.memory_map(str(path)) as source:
        data, is_file = source.read_buffer(), head == b"ARRO"
        check_size(unpacked_size(data, is_file=is_file), largest, "its packed columns")
        with (pa.ipc.open_file if is_file else pa.ipc.open_stream)(data) as reader:
            table = reader.read_all()
    table.validate()
    return table
