"""Columns of numbers from a CSV file: read fast, and slowly only where something is wrong.

The fast path cannot say what is wrong with a row, or leave out a column of text; the slow one can do both.
"""

from __future__ import annotations

import codecs
import csv
import io
import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .._output import replacing
from .._sections import FloatArray

__all__ = ["CsvFile", "dialect", "open_csv", "write_csv"]

# utf-8-sig reads UTF-8 with and without the byte-order mark that spreadsheets put in front.
_ENCODING = "utf-8-sig"
_SHOWN = 60  # characters of an offending text that an error repeats
_LONGEST = 1 << 22  # bytes of a line
_LARGE = 1 << 22  # bytes from which on polars, where it is installed, is worth its import
_DELIMITERS = (";", "\t", "|", ",", " ")
_SAMPLED = 100  # rows that say which columns hold numbers
_WHOLE = re.compile(r"[+-]?\d{1,18}|[+-]?[0-8]\d{18}")  # within 64 bits
_DECIMAL_COMMA = re.compile(r"\s*[+-]?\d*,\d+([eE][+-]?\d+)?\s*")


@dataclass(frozen=True)
class CsvFile:
    """A CSV file whose header has been read.

    Attributes
    ----------
    path : Path
    delimiter : str
    header : tuple of str
        Column names, without duplicates.
    header_line : int
        Number of the line that holds them, from 1; the rows follow.
    decimal : str
        "." or ",", in numbers.
    lines : int
        How many there are, at most.
    """

    path: Path
    delimiter: str
    header: tuple[str, ...]
    header_line: int
    decimal: str = "."
    lines: int = 0

    def read(self, names: Sequence[str], *, gaps: bool = False) -> FloatArray:
        """The named columns, shape (N, len(names)); other columns may hold anything.

        With ``gaps`` an empty field is NaN.

        Raises
        ------
        ValueError
            If a row has another number of fields than the header, or a named field is empty or no number; the
            line, the column and the text are named.
        """
        columns = [self.header.index(name) for name in names]
        if (table := self._read_by_polars(columns, gaps)) is not None:
            return table.astype(float, copy=False)
        if self.decimal != ".":
            return self._read_slowly(names, columns, gaps)
        try:
            with self.path.open(encoding=_ENCODING) as file:
                # No comments here: the option would cut a field off at "#" anywhere in a row.
                rows = islice(file, self.header_line, None)
                table = np.loadtxt(rows, delimiter=self.delimiter, comments=None, ndmin=2)
        except ValueError:
            return self._read_slowly(names, columns, gaps)
        if table.shape[1] != len(self.header):
            return self._read_slowly(names, columns, gaps)
        return table[:, columns]

    def first(self, name: str) -> str:
        """Text of the named column in the first row."""
        return next(self._cells(name))

    def whole_numbers(self, name: str) -> NDArray[np.int64] | None:
        """The named column, exact beyond what a float64 holds; None where a field is no whole number."""
        if not all(map(_WHOLE.fullmatch, islice(self._cells(name), _SAMPLED))):
            return None
        table = self._read_by_polars([self.header.index(name)], False, whole=True)
        if table is not None:
            return table[:, 0].astype(np.int64, copy=False)
        texts = self.texts(name)
        return np.array(texts, np.int64) if all(map(_WHOLE.fullmatch, texts)) else None

    def texts(self, name: str) -> list[str]:
        """Text of the named column, row by row.

        Raises
        ------
        ValueError
            If a row has another number of fields than the header.
        """
        return list(self._cells(name))

    def _cells(self, name: str) -> Iterator[str]:
        column = self.header.index(name)
        return (fields[column].strip() for _, fields in self._split_rows())

    def head(self, count: int) -> list[list[str]]:
        """Texts of the first rows, at most ``count``.

        Raises
        ------
        ValueError
            If a row has another number of fields than the header.
        """
        return [[field.strip() for field in fields] for _, fields in islice(self._split_rows(), count)]

    def numeric(self) -> tuple[str, ...]:
        """Columns that hold numbers or nothing in the first rows."""
        rows = self.head(_SAMPLED)
        return tuple(
            name
            for name, column in zip(self.header, zip(*rows, strict=True), strict=True)
            if all(not field or self.number(field) is not None for field in column)
        )

    def line_numbers(self) -> list[int]:
        """Number of the line of every row, from 1."""
        return [number for number, _ in self._rows()]

    def _rows(self) -> Iterator[tuple[int, str]]:
        with self.path.open(encoding=_ENCODING) as file:
            for number, line in enumerate(file, start=1):
                if number > self.header_line and _holds_data(line):
                    yield number, line.rstrip("\n")

    def _split_rows(self) -> Iterator[tuple[int, list[str]]]:
        expected = len(self.header)
        for number, line in self._rows():
            fields = _fields(self.path, number, line, self.delimiter)
            if len(fields) != expected:
                raise ValueError(
                    f"{self.path}: line {number} has {len(fields)} fields, expected {expected} as in the header: "
                    f"{_short(line)}"
                )
            yield number, fields

    def number(self, text: str) -> float | None:
        """What a field says; None where it is no number."""
        return _number(text if self.decimal == "." else text.replace(self.decimal, "."))

    def _read_slowly(self, names: Sequence[str], columns: Sequence[int], gaps: bool) -> FloatArray:
        table: list[list[float]] = []
        for number, fields in self._split_rows():
            row = [
                math.nan if gaps and not fields[column].strip() else self.number(fields[column])
                for column in columns
            ]
            if None in row:
                k = row.index(None)
                text = fields[columns[k]].strip()
                problem = (
                    f"{_short(text)} is not a number" if text else "the field is empty, expected a number"
                )
                raise ValueError(f"{self.path}: line {number}, column {names[k]!r}: {problem}")
            table.append([value for value in row if value is not None])
        return np.array(table, dtype=float)

    def _read_by_polars(
        self, columns: Sequence[int], gaps: bool, *, whole: bool = False
    ) -> NDArray[np.generic] | None:
        """The columns of a large file; None where polars is missing or finds anything that is to be explained."""
        if self.path.stat().st_size < _LARGE:
            return None
        try:
            import polars as pl
        except ModuleNotFoundError:
            return None
        last = len(self.header) - 1
        kinds = {str(k): pl.String for k in range(last + 1)} | {
            str(k): pl.Int64 if whole else pl.Float64 for k in columns
        }
        read = [str(k) for k in sorted({*columns, last})]
        try:
            scanned = pl.scan_csv(
                self.path,
                has_header=False,
                schema=kinds,
                separator=self.delimiter,
                comment_prefix="#",
                skip_lines=self.header_line,
                decimal_comma=self.decimal == ",",
            )
            frame = scanned.select(read).collect()
        except (pl.exceptions.PolarsError, ValueError):
            return None
        # A row that is too short, or blank, ends in a null.
        nulls = frame.null_count().row(0)
        if nulls[-1] or (any(nulls) and not gaps):
            return None
        wanted = frame.select([str(k) for k in columns])
        return (wanted if whole else wanted.fill_null(math.nan)).to_numpy()


def dialect(path: Path) -> tuple[str, str]:
    """Delimiter and decimal sign of a file: those by which its first rows have as many fields as the header.

    Raises
    ------
    ValueError
        If it is no UTF-8 text.
    """
    try:
        with path.open(encoding=_ENCODING) as file:
            head = io.StringIO(file.read(_LONGEST))  # lines too long for it are open_csv's to refuse
            lines = [line.rstrip("\n") for line in islice(filter(_holds_data, head), 10)]
    except UnicodeDecodeError:
        return ",", "."  # open_csv says what is wrong with it
    best, most = ",", 1
    for delimiter in _DELIMITERS:
        counts = {len(_fields(path, 0, line, delimiter)) for line in lines}
        if len(counts) == 1 and (count := counts.pop()) > most:
            best, most = delimiter, count
    comma = best != "," and any(
        _DECIMAL_COMMA.fullmatch(field) for line in lines[1:] for field in line.split(best)
    )
    return best, "," if comma else "."


def open_csv(path: Path, delimiter: str, decimal: str = ".") -> CsvFile:
    """Read the header of a CSV file: the first line that is neither blank nor a comment ("#").

    Raises
    ------
    ValueError
        If the file is no UTF-8 text, has a line of more than 4 MiB, is empty, has no header or nothing but a header, or
        names a column twice.
    """
    _check_delimiter(delimiter)
    try:
        count = _lines(path)
        with path.open(encoding=_ENCODING) as file:
            lines = ((number, line) for number, line in enumerate(file, start=1) if _holds_data(line))
            number, line = next(lines, (0, ""))
            has_rows = next(lines, None) is not None
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path}: not UTF-8 text ({error.reason} at byte {error.start}); save it as UTF-8"
        ) from error
    if number == 0:
        raise ValueError(f"{path}: the file is empty, expected a header line and rows of numbers")
    header = tuple(name.strip() for name in _fields(path, number, line.rstrip("\n"), delimiter))
    if all(_number(name) is not None for name in header):
        raise ValueError(f"{path}: line {number} holds numbers, expected a header line with the column names")
    if twice := [name for name, count in Counter(header).items() if count > 1]:
        raise ValueError(f"{path}: line {number} names columns more than once: {', '.join(map(repr, twice))}")
    if not has_rows:
        raise ValueError(f"{path}: no rows follow the header on line {number}")
    return CsvFile(path, delimiter, header, number, decimal, count)


def _lines(path: Path) -> int:
    """How many there are, at most; text that is not UTF-8, and lines that no table has, are found here."""
    count = 1
    decoder = codecs.getincrementaldecoder("utf-8")()
    with path.open("rb") as file:
        while block := file.read(_LONGEST):
            decoder.decode(block)
            count += max(block.count(b"\n"), block.count(b"\r"))
            if len(block) == _LONGEST and b"\n" not in block and b"\r" not in block:
                raise ValueError(f"{path}: expected lines of at most {_LONGEST} bytes, got a longer one")
    decoder.decode(b"", final=True)
    return count


def _check_delimiter(delimiter: str) -> None:
    if len(delimiter) != 1 or delimiter in '\r\n"#_.+-' or delimiter.isalnum():
        raise ValueError(f"delimiter: expected one character such as ',' or ';', got {delimiter!r}")


def _holds_data(line: str) -> bool:
    text = line.strip()
    return bool(text) and not text.startswith("#")


def _fields(path: Path, number: int, line: str, delimiter: str) -> list[str]:
    if '"' not in line:
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter, strict=True))
    except csv.Error as error:
        raise ValueError(f"{path}: line {number}: {error}: {_short(line)}") from error


def _number(text: str) -> float | None:
    # float() also takes "1_000" and digits of other scripts, which no recorder means as a number.
    if "_" in text or not text.isascii():
        return None
    try:
        return float(text)
    except ValueError:
        return None


def _short(text: str) -> str:
    return repr(text if len(text) <= _SHOWN else text[:_SHOWN] + "...")


def write_csv(path: Path, header: Sequence[str], table: FloatArray, delimiter: str) -> None:
    """Write columns of numbers, each with as many digits as it takes to read the same number back.

    Raises
    ------
    ValueError
        If two columns have one name, or the first begins with "#", which would make the header a comment.
    """
    _check_delimiter(delimiter)
    if twice := [name for name, count in Counter(header).items() if count > 1]:
        raise ValueError(
            f"{path}: columns would have one name: {', '.join(map(repr, twice))}; rename the channels"
        )
    if header[0].startswith("#"):
        raise ValueError(f"the first column's name {header[0]!r} would make the header a comment; rename it")
    with replacing(path) as whole:
        file = io.TextIOWrapper(whole, "utf-8", newline="")
        csv.writer(file, delimiter=delimiter, lineterminator="\n").writerow(header)
        file.writelines(delimiter.join(map(repr, row)) + "\n" for row in table.tolist())
        file.detach()  # flushed, and not closed yet
