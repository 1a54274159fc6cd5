"""Files of datasets: CSV tables with named columns, and JSON objects."""

from __future__ import annotations

import csv
import gzip
import json
import math
import re
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import timedelta
from itertools import chain
from pathlib import Path
from typing import Any, Final, TextIO

import numpy as np
from numpy.typing import NDArray

from fixel.errors import DECIMAL, DatasetMissing, FixelError, InvalidInput, number_of, require
from fixel.io.atomic import parsed, usable
from fixel.model.fields import instance
from fixel.typing import BoolArray, FloatArray

MM: Final = 1e-3

# Experiment, or part of a folder, that cannot be read, and the reason.
Problems = dict[str, FixelError]

# Larger numbers cannot be readings, not even nanoseconds since 1970. Squares of smaller ones stay
# far inside float64.
LARGEST_NUMBER: Final = 5e18
MAX_WHOLE: Final = 2**31

# Maximum length of an unpacked file and of one line [characters]: a few kilobytes of gzip can
# unpack to more than fits in memory.
MAX_FILE = 500_000_000
MAX_LINE = 1_000_000
MAX_CELLS = 20_000_000  # a gigabyte or two as text; the force log of 245 pushes has one million
_MISSING: Final = ("None", "nan", "NaT", "<NA>", "--")  # as NumPy and pandas print what is missing
_USUAL: Final = re.compile(r"[-+.0-9eE ]*")  # characters of numbers, but not of `nan` or `1_0`


@dataclass(frozen=True, slots=True)
class CsvRows:
    """Rows of a CSV file, stored as text and converted to numbers on request."""

    source: str  # name of the file, for messages
    columns: Mapping[str, Sequence[str]]  # columns of equal length
    # Number of each row in the file, from 0; by default they are in order.
    lines: Sequence[int] = ()
    # Rows with a wrong number of cells.
    torn: Mapping[int, InvalidInput] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def text(self, name: str) -> NDArray[np.str_]:
        """Return one column as text, (n,)."""
        self.require([name])
        return np.array(self.columns[name], dtype=np.str_)

    def numbers(self, name: str, *, blank: bool = False) -> FloatArray:
        """Return one column as numbers, (n,); with `blank`, empty cells become NaN."""
        self.require([name])
        cells = self.columns[name]
        if (values := _fast_numbers(cells, blank=blank)) is not None:
            return values
        return np.array([self._number(name, row, cell, blank) for row, cell in enumerate(cells)])

    def whole_numbers(self, name: str, largest: int = MAX_WHOLE) -> NDArray[np.int64]:
        """Return one column as whole numbers (n,) from 0 to `largest`; raise for others."""
        numbers = self.numbers(name)
        wrong = ~_whole(numbers, largest)
        if wrong.any():
            raise self._not_whole(name, int(np.argmax(wrong)), largest)
        return numbers.astype(np.int64)

    def sound(
        self, key: str, numbers: Iterable[str], whole: Iterable[str] = (), *, once: bool = False
    ) -> tuple[CsvRows, Problems]:
        """Return the rows whose key has no damaged row, and the first error of each other key.

        The column `key` names the experiment of each row; with `once`, a repeated key is damaged.
        `numbers` and `whole` are columns of numbers and of whole numbers. Raise `InvalidInput` if a
        column is missing, or every key has a damaged row.
        """
        whole = list(whole)
        self.require([key, *(columns := [*numbers, *whole])])
        damage = dict(self.torn)
        for name in columns:
            for row, problem in self._damaged(name, whole=name in whole):
                damage.setdefault(row, problem)
        keys = self.columns[key]
        seen: set[str] = set()
        for row, one in enumerate(keys if once else ()):
            if one in seen:
                damage.setdefault(row, self._repeated(key, row))
            seen.add(one)
        if not damage:
            return self, {}
        problems: Problems = {}
        for row in sorted(damage):
            problems.setdefault(keys[row] or f"{self.source}, row {row + 1}", damage[row])
        rows = [row for row, one in enumerate(keys) if one not in problems and row not in damage]
        if not rows:
            raise damage[min(damage)]
        return self.only(rows), problems

    def only(self, rows: Sequence[int]) -> CsvRows:
        """Return some of the rows."""
        columns = {name: [cells[row] for row in rows] for name, cells in self.columns.items()}
        lines = [self.lines[row] if self.lines else row for row in rows]
        torn = {k: self.torn[row] for k, row in enumerate(rows) if row in self.torn}
        return CsvRows(self.source, columns, lines, torn)

    def _damaged(self, name: str, *, whole: bool) -> Iterator[tuple[int, InvalidInput]]:
        """Yield the rows in which a cell is no number."""
        cells = self.columns[name]
        values = _fast_numbers(cells)
        if values is not None and (not whole or _whole(values, MAX_WHOLE).all()):
            return
        for row, cell in enumerate(cells):
            try:
                value = self._number(name, row, cell)
            except InvalidInput as problem:
                yield row, problem
                continue
            if whole and not _whole(np.array(value), MAX_WHOLE):
                yield row, self._not_whole(name, row, MAX_WHOLE)

    def _repeated(self, name: str, row: int) -> InvalidInput:
        found, expected = f"{self.columns[name][row]!r} again", "each name once"
        return InvalidInput(self.place(name, row), found=found, expected=expected)

    def _not_whole(self, name: str, row: int, largest: int) -> InvalidInput:
        found, expected = float(self.columns[name][row]), f"a whole number from 0 to {largest}"
        return InvalidInput(self.place(name, row), found=found, expected=expected)

    def stacked(self, *names: str, blank: bool = False) -> FloatArray:
        """Return several columns as numbers, (n, n_name)."""
        return np.column_stack([self.numbers(name, blank=blank) for name in names])

    def require(self, names: Iterable[str]) -> None:
        """Raise `InvalidInput` if one of these columns is missing."""
        for name in names:
            if name not in self.columns:
                found, expected = "the columns " + ", ".join(self.columns), f"a column named {name}"
                raise InvalidInput(self.source, found=found, expected=expected)

    def place(self, name: str, row: int) -> str:
        """Return the place of a cell, for messages."""
        line = self.lines[row] if self.lines else row
        return f"{self.source}, row {line + 1}, column {name}"

    def _number(self, name: str, row: int, cell: str, blank: bool = False) -> float:
        if blank and not cell:
            return math.nan
        with suppress(InvalidInput):  # the place is a text that most cells do not need
            if abs(value := number_of(cell, "")) <= LARGEST_NUMBER:
                return value
        where = self.place(name, row)
        number_of(cell, where, "a finite number")
        raise InvalidInput(where, found=repr(cell), expected=f"a number within {LARGEST_NUMBER:g}")


def _fast_numbers(cells: Sequence[str], *, blank: bool = False) -> FloatArray | None:
    """Return the numbers (n,) in cells; None where a cell may be wrong, or be written unusually."""
    with suppress(ValueError):
        texts = [cell or "nan" for cell in cells] if blank else cells
        values = np.array([*map(float, texts)], dtype=np.float64)
        if _USUAL.fullmatch("".join(cells)) and not (np.abs(values) > LARGEST_NUMBER).any():
            return values
    return None


def _whole(numbers: FloatArray, largest: int) -> BoolArray:
    """Whether numbers (...) are whole, from 0 to `largest`."""
    whole = (numbers >= 0.0) & (numbers <= largest) & (numbers == np.round(numbers))
    return np.asarray(whole)


def table_rows(table: Any, source: str = "table") -> CsvRows:
    """Return the rows of a table in memory: pandas, polars, Arrow or columns by name."""
    frame = hasattr(table, "to_dict") and hasattr(table, "columns")
    if hasattr(table, "to_pydict"):  # Arrow
        columns = table.to_pydict()
    elif frame or isinstance(table, Mapping):
        names = [*table.columns] if frame else [*table]
        _refuse_twice(names, source)
        columns = {str(name): table[name] for name in names}
    else:
        expected = "a file, a folder, or a table of pandas, polars or Arrow"
        raise InvalidInput(source, found=f"the type {type(table).__name__}", expected=expected)
    if not all(isinstance(column, Iterable) for column in columns.values()):
        raise InvalidInput(source, found="a row of values", expected="columns of values by name")
    cells = {name: [*map(_cell, column)] for name, column in columns.items()}
    lengths = {name: len(column) for name, column in cells.items()}
    if not any(lengths.values()):
        raise InvalidInput(source, found="no rows", expected="one at least")
    if len({*lengths.values()}) > 1:
        found, expected = f"columns of lengths {lengths}", "columns of equal length"
        raise InvalidInput(source, found=found, expected=expected)
    return CsvRows(source, cells)


def _refuse_twice(names: Sequence[Any], where: str) -> None:
    if len(set(names)) < len(names):
        twice = next(name for k, name in enumerate(names) if name in names[:k])
        raise InvalidInput(where, found=f"{twice!r} twice", expected="different names")


def _cell(value: Any) -> str:
    """Return a value as its cell in a CSV file; empty for a missing one."""
    if isinstance(value, float | np.floating):
        return repr(float(value)) if value == value else ""
    if isinstance(value, timedelta | np.timedelta64):  # times of a clock need no unit
        value = np.datetime64(0, "ns") + np.timedelta64(value)
    text = str(value)
    return "" if text in _MISSING and not isinstance(value, str) else text


def read_table(path: Path, *, torn: bool = False) -> CsvRows:
    """Load the rows of a Parquet file, or of a CSV file, plain or compressed with gzip.

    Columns are separated by commas; or by semicolons or tabs, and numbers may then have decimal
    commas, as spreadsheets of many countries write them. Rows with a wrong number of cells are
    errors; with `torn`, they are listed as such.
    """
    if path.suffix == ".parquet":
        require("pyarrow", path.name, extra="parquet")
        with parsed(path):
            columns = _arrow_table(path)
        return table_rows(columns, path.name)
    opened = gzip.open if path.suffix == ".gz" else open
    try:
        with opened(path, "rt", encoding="utf-8-sig", newline="") as stream:
            lines = bounded_lines(stream, path.name)
            header_line = next(lines, "")
            separator = max(",;\t", key=header_line.count)
            cells = csv.reader(chain([header_line], lines), delimiter=separator)
            rows = _bounded_rows(cells if separator == "," else map(_pointed, cells), path.name)
    except UnicodeDecodeError:
        found, hint = "characters that are not UTF-8", 'save the table as "CSV UTF-8"'
        expected = "a readable CSV file"
        raise InvalidInput(path.name, found=found, expected=expected, hint=hint) from None
    except (OSError, EOFError, zlib.error, csv.Error) as problem:
        raise InvalidInput(path.name, found=problem, expected="a readable CSV file") from None
    if len(rows) < 2:
        found = "a header without rows" if any(rows) else "an empty file"
        raise InvalidInput(path.name, found=found, expected="a header and rows")
    header, body = rows[0], [row for row in rows[1:] if any(map(str.strip, row))]
    _refuse_twice(header, f"{path.name}, header")
    wrong: dict[int, InvalidInput] = {}
    for number, row in enumerate(body):
        if len(row) != len(header):
            found, expected = f"{len(row)} cells", f"{len(header)}, as in the header"
            where = f"{path.name}, row {number + 1}"
            wrong[number] = InvalidInput(where, found=found, expected=expected)
            if not torn:
                raise wrong[number]
            body[number] = [*row, *[""] * len(header)][: len(header)]
    columns = dict(zip(header, zip(*body, strict=True), strict=True))
    return CsvRows(path.name, columns, torn=wrong)


def _pointed(cells: list[str]) -> list[str]:
    """Return cells with decimal points instead of decimal commas."""
    return [cell.replace(",", ".") if DECIMAL.fullmatch(cell) else cell for cell in cells]


def bounded_lines(stream: TextIO, source: str) -> Iterator[str]:
    """Yield the lines of a file; raise once they exceed the maximum size of a table."""
    left = MAX_FILE
    while line := stream.readline(MAX_LINE):
        left -= len(line)
        if left < 0 or len(line) == MAX_LINE:
            raise _too_long(source, f"a line of {MAX_LINE} characters" if left >= 0 else "more")
        yield line


def _arrow_table(path: Path) -> Any:
    """Load the texts and numbers of a Parquet file; raise if they take too much memory.

    One long text that many rows have is stored once, so texts are counted before they are unpacked.
    """
    from pyarrow import compute, parquet, types

    schema = parquet.read_schema(path)
    names = [own.name for own in schema if not types.is_nested(own.type)]
    with parquet.ParquetFile(path, read_dictionary=names) as file:
        about = file.metadata
        groups, each = map(about.row_group, range(about.num_row_groups)), range(about.num_columns)
        if sum(own.column(k).num_values for own in groups for k in each) > MAX_CELLS:
            raise _too_many_cells(path.name)
        table = file.read(columns=names)
    characters = 0
    for column in table.columns:
        if types.is_fixed_size_binary(column.type):
            characters += column.type.byte_width * len(column)
        for part in column.chunks if types.is_dictionary(column.type) else ():
            lengths = compute.binary_length(part.dictionary).take(part.indices)
            characters += compute.sum(lengths).as_py() or 0
    if characters > MAX_FILE:
        raise _too_long(path.name, "more")
    return table


def _bounded_rows(rows: Iterable[list[str]], source: str) -> list[list[str]]:
    """Load the rows of a table; raise once they exceed the maximum number of cells."""
    found, cells = [], 0
    for row in rows:
        cells += len(row) + 1  # an empty row takes memory too
        if cells > MAX_CELLS:
            raise _too_many_cells(source)
        found.append(row)
    return found


def _too_long(source: str, found: str) -> InvalidInput:
    expected = f"at most {MAX_FILE // 10**6} million characters, unpacked"
    return InvalidInput(source, found=found, expected=expected)


def _too_many_cells(source: str) -> InvalidInput:
    expected = f"at most {MAX_CELLS // 10**6} million cells"
    return InvalidInput(source, found="more", expected=expected)


def read_json(path: Path) -> dict[str, Any]:
    """Load the JSON object in a file."""
    with usable(path.name, "a JSON file", (OSError, ValueError, RecursionError)):
        if path.stat().st_size > MAX_FILE:
            raise InvalidInput(f"{path.stat().st_size} bytes")
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    instance(content, dict, path.name, "an object")
    return content


def member(content: Mapping[str, Any], path: str, source: str) -> Any:
    """Return a value inside nested objects, such as `"object.mass_kg"`; raise if missing."""
    value: Any = content
    for name in path.split("."):
        if not isinstance(value, Mapping) or name not in value:
            raise InvalidInput(source, found="nothing", expected=f"a value for {path}")
        value = value[name]
    return value


def has_files(folder: Path, *groups: Sequence[str]) -> bool:
    """Whether a folder has a file of each group of names."""
    return all(any((folder / name).is_file() for name in names) for names in groups)


def only_file(folder: Path, *names: str) -> Path:
    """Path of the first of these files that exists in a folder; raise if none does."""
    for name in names:
        if (folder / name).is_file():
            return folder / name
    raise DatasetMissing(folder, " or ".join(names))


def increasing(
    time: FloatArray, source: str, hint: str = "", lines: Sequence[int] = ()
) -> FloatArray:
    """Return times unchanged; raise with hint and row in `lines` if they do not increase."""
    if (np.diff(time) <= 0.0).any():
        row = int(np.argmax(np.diff(time) <= 0.0)) + 1
        where = f"{source}, row {(lines[row] if lines else row) + 1}"
        found = f"t = {time[row]:g} s after {time[row - 1]:g} s"
        raise InvalidInput(where, found=found, expected="increasing times", hint=hint)
    return time


def rows_of(series: CsvRows, key: str) -> dict[str, NDArray[np.intp]]:
    """Row numbers of each key of a table."""
    keys = series.text(key)
    order = np.argsort(keys, kind="stable")
    found, first = np.unique(keys[order], return_index=True)
    return dict(zip(found.tolist(), np.split(order, first[1:]), strict=True))


def missing_rows(
    rows: Mapping[str, NDArray[np.intp]], source: str, listed: CsvRows, key: str, least: int = 1
) -> Problems:
    """Return an error for each listed key with fewer than `least` rows in the table `source`."""
    return {
        name: InvalidInput(
            listed.place(key, row),
            found=f"{name}, of which {source} has {len(rows.get(name, ()))} rows",
            expected=f"at least {least} readings of every listed name",
        )
        for row, name in enumerate(listed.columns[key])
        if len(rows.get(name, ())) < least
    }


def advancing(time: FloatArray) -> BoolArray:
    """Mask (n,) of the times that are later than all previous ones."""
    latest = np.maximum.accumulate(time)
    return np.append(True, time[1:] > latest[:-1])[: len(time)]


def rate_of(time: FloatArray) -> float:
    """Readings per second [1/s], from the median interval; 0 for fewer than two."""
    steps = np.diff(time)
    typical = float(np.median(steps)) if len(steps) else 0.0
    return 1.0 / typical if typical > 0.0 else 0.0
