"""Tables of results, which print themselves as plain text, HTML, CSV and JSON."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any, Final

Value = str | float | int | None

MISSING: Final = "-"
_WORD: Final = re.compile(r"[^\W\d_]{2,}")
_NUMBER: Final = r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?"
_FORMULA: Final = re.compile(rf"(?!(-|{_NUMBER})$)[-+=@\t\r]")  # how spreadsheets know one


@dataclass(frozen=True, slots=True)
class Column:
    """Column of a table.

    Parameters
    ----------
    name : str
    unit : str
        Unit of its values, which follows the name in brackets; empty for none.
    format : str
        Format of its numbers for people, such as `.3g`; `str` without one.
    """

    name: str
    unit: str = ""
    format: str = ""

    @property
    def head(self) -> str:
        """Name and unit, as in `error [mm]`."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    def text(self, value: Value) -> str:
        """Format a value of this column for people; `-` for a missing one."""
        if value is None:
            return MISSING
        if isinstance(value, str):
            return str(value)
        text = format(value, self.format)
        return text if text.strip("-0.") else format(abs(value), self.format)  # no "-0.000"


@dataclass(init=False, slots=True)
class Table:
    """Table of results: columns with their units and formats, and rows of values.

    Parameters
    ----------
    columns : sequence of Column or str
        A text is a column without unit and format.
    rows : iterable of sequences of str, float, int or None
        One value for each column, also as NumPy scalars. None is for a missing one, and numbers
        that are not finite become None.
    title : str
    left : int
        Number of first columns that plain text aligns to the left; the others to the right.

    Examples
    --------
    >>> table = Table(
    ...     ("experiment", Column("error", "mm", ".2f")),
    ...     [("demo/push-1", 0.523), ("demo/push-2", None)],
    ...     title="Errors",
    ... )
    >>> print("\\n".join(table.lines()))
    experiment   error [mm]
    demo/push-1        0.52
    demo/push-2           -
    >>> table.csv()
    'experiment,error [mm]\\ndemo/push-1,0.523\\ndemo/push-2,\\n'
    >>> table.records()[0]
    {'experiment': 'demo/push-1', 'error': 0.523}
    """

    columns: tuple[Column, ...]
    rows: list[tuple[Value, ...]]
    title: str
    left: int

    def __init__(
        self,
        columns: Sequence[Column | str],
        rows: Iterable[Sequence[Any]],
        *,
        title: str = "",
        left: int = 1,
    ) -> None:
        self.columns = tuple(c if isinstance(c, Column) else Column(c) for c in columns)
        self.rows = [tuple(map(_plain, row)) for row in rows]
        self.title = title
        self.left = left
        if any(len(row) != len(self.columns) for row in self.rows):
            raise ValueError("every row of a table needs one value for each column")

    @classmethod
    def from_columns(cls, columns: Mapping[str, Iterable[Any]]) -> Table:
        """Make a table of columns of equal length: arrays or sequences, by name."""
        return cls(tuple(columns), zip(*columns.values(), strict=True))

    @property
    def head(self) -> tuple[str, ...]:
        """Names of the columns with their units."""
        return tuple(column.head for column in self.columns)

    @property
    def cells(self) -> list[tuple[str, ...]]:
        """Texts of the rows for people, in the formats of the columns."""
        return [
            tuple(column.text(value) for column, value in zip(self.columns, row, strict=True))
            for row in self.rows
        ]

    def __repr__(self) -> str:
        return "\n".join(self.lines())

    def _repr_html_(self) -> str:
        return self.html()

    def lines(self, max_rows: int | None = None) -> list[str]:
        """Return the lines of plain text: the head and at most `max_rows` rows, without title."""
        shown = [self.head, *self.cells[:max_rows]]
        widths = [max(map(len, column)) for column in zip(*shown, strict=True)]
        return [
            "  ".join(
                cell.ljust(width) if k < self.left else cell.rjust(width)
                for k, (cell, width) in enumerate(zip(row, widths, strict=True))
            ).rstrip()
            for row in shown
        ]

    def html(self, number: str = "") -> str:
        """Return an HTML element with all texts escaped, with its number and title as caption.

        Columns of words have the class `words`; the first cell of a row is its heading, indented
        as in lines.
        """
        cells = self.cells
        kinds = [
            ' class="words"' if any(len(_WORD.findall(row[k])) > 1 for row in cells) else ""
            for k in range(len(self.columns))
        ]
        head = [f'<th scope="col"{kinds[k]}>{escape(c)}</th>' for k, c in enumerate(self.head)]
        caption = f"<caption><b>{escape(number)}</b> {escape(self.title)}</caption>"
        lines = ["<table>", *([caption] if self.title or number else [])]
        lines += [f"<thead><tr>{''.join(head)}</tr></thead>", "<tbody>"]
        for first, *others in cells:
            row = [f"<td{kinds[k]}>{escape(c)}</td>" for k, c in enumerate(others, start=1)]
            own = escape(first).replace("  ", "&emsp;")
            lines.append(f'<tr><th scope="row">{own}</th>{"".join(row)}</tr>')
        return "\n".join([*lines, "</tbody>", "</table>"])

    def csv(self) -> str:
        """Return the values as CSV with a head; a missing value is an empty field."""
        file = io.StringIO()
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows(map(csv_cell, row) for row in (self.head, *self.rows))
        return file.getvalue()

    def records(self) -> list[dict[str, Value]]:
        """Return one object of values by column name for each row, as JSON can hold them."""
        names = [column.name for column in self.columns]
        return [dict(zip(names, row, strict=True)) for row in self.rows]

    def content(self) -> dict[str, Any]:
        """Return title, head, rows of values and their formats, as JSON can hold them."""
        own = {"title": self.title, "head": list(self.head), "rows": list(map(list, self.rows))}
        return own | {"formats": [column.format for column in self.columns], "left": self.left}


def csv_cell(value: Value) -> Value:
    """Return a value for a CSV file, with an apostrophe before a text that begins as a formula."""
    return f"'{value}" if isinstance(value, str) and _FORMULA.match(value) else value


def _plain(value: Any) -> Value:
    own: Value = value.item() if hasattr(value, "item") else value  # of NumPy, not imported here
    return None if isinstance(own, float) and not math.isfinite(own) else own


def shortened(lines: Sequence[str], total: int, indent: str = "") -> list[str]:
    """Return the lines, and below them how many of `total` are missing."""
    more = total - len(lines)
    return [*lines, f"{indent}... and {more} more; --json has them all"] if more > 0 else [*lines]
