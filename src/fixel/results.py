"""Base class of public results, which print, draw, convert and save themselves."""

from __future__ import annotations

import copyreg
import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from html import escape
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from fixel.errors import InvalidInput, require
from fixel.registry import offered, offers
from fixel.table import Table, Value

MAX_LINES: Final = 25
MAX_COLUMNS: Final = 100  # [characters]
MAX_HTML_ROWS: Final = 20
MAX_HTML: Final = 50_000  # [bytes]


def read_only(mapping: Mapping[Any, Any]) -> MappingProxyType[Any, Any]:
    """Return a read-only mapping."""
    return MappingProxyType(dict(mapping))


# Records have read-only mappings, which Python does not pickle by itself.
copyreg.pickle(MappingProxyType, lambda mapping: (read_only, (dict(mapping),)))


@dataclass(frozen=True, slots=True)
class Summary:
    """Short description of a result, for terminals and notebooks.

    Examples
    --------
    >>> from fixel.table import Table
    >>> rows = Table(("parameter", "value"), [("mu_pusher", 0.25)])
    >>> print(Summary("Calibration of 8 experiments", [rows], ["misfit: none"]).text())
    Calibration of 8 experiments
      parameter  value
      mu_pusher   0.25
      misfit: none
    """

    heading: str  # one line: the kind of result and how it ended
    tables: Sequence[Table] = ()  # the most important table first; long ones are cut
    notes: Sequence[str] = ()  # sentences below the tables: warnings, and what the numbers mean
    # Method, seed, version and command, folded in a notebook and left out in a terminal.
    details: Mapping[str, str] = field(default_factory=dict)
    # What no experiment of a calibration has, such as a new part; printed before all else.
    unseen: Sequence[str] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "tables", tuple(self.tables))
        object.__setattr__(self, "notes", tuple(self.notes))

    def text(self) -> str:
        """Return plain text of at most `MAX_LINES` lines and `MAX_COLUMNS` columns."""
        heading = [line for one in self.unseen for line in _wrapped(f"Unseen: {one}", "")]
        heading = [*_cut(heading, MAX_LINES // 3), *_wrapped(self.heading, "")[:3]]
        notes = [line for note in self.notes for line in _wrapped(note, "  ")]
        notes = _cut(notes, (MAX_LINES - len(heading)) // 2 if self.tables else MAX_LINES - 3)
        room = MAX_LINES - len(heading) - len(notes)
        lines: list[str] = []
        for k, table in enumerate(self.tables):
            share = (room - len(lines)) // (len(self.tables) - k)
            title = [f"  {table.title}"] if table.title else []
            if share >= len(title) + 2:
                rows = _cut([f"  {row}" for row in table.lines()], share - len(title))
                lines += [*title, *rows]
        return "\n".join(_shortened(line) for line in [*heading, *lines, *notes])

    def html(self) -> str:
        """Return HTML of at most `MAX_HTML` bytes, without scripts."""
        rows = MAX_HTML_ROWS
        while len((page := self._html(rows)).encode()) > MAX_HTML and rows > 0:
            rows //= 2
        return page

    def _html(self, max_rows: int) -> str:
        first = [f"Unseen: {_limited(one)}" for one in self.unseen[:MAX_HTML_ROWS]]
        parts = [f"<p><b>{escape(one)}</b></p>" for one in (*first, _limited(self.heading))]
        for table in self.tables[:MAX_HTML_ROWS]:
            parts.append(
                Table(table.columns, table.rows[:max_rows], title=table.title).html().strip()
            )
            hidden = len(table.rows) - max_rows
            parts += [f"<p>... and {hidden} more rows</p>"] if hidden > 0 else []
        parts += [f"<p>{escape(_limited(note))}</p>" for note in self.notes[:MAX_HTML_ROWS]]
        if self.details:
            lines = "<br>".join(
                f"{escape(name)}: {escape(_limited(value))}"
                for name, value in self.details.items()
                if value
            )
            parts.append(f"<details><summary>Method and version</summary>{lines}</details>")
        return f'<div class="fixel-result">{"".join(parts)}</div>'


@dataclass(frozen=True, slots=True, repr=False)
class Player:
    """Animation with play button and slider, an HTML page that loads nothing else.

    A cell of a notebook shows it; written to a file, every browser opens it.
    """

    page: str

    def __repr__(self) -> str:
        return f"Player: {len(self.page) / 1e3:.0f} kB of HTML, shown in a notebook"

    def _repr_html_(self) -> str:
        # In a frame, neither styles nor scripts meet those of the notebook or of other cells.
        style = "width: 100%; height: 420px; border: 0; color-scheme: light dark"
        return (
            f'<iframe sandbox="allow-scripts" title="Animation" style="{style}" '
            f'srcdoc="{escape(self.page)}"></iframe>'
        )


class Result:
    """Result of a public function: prints, draws, converts and saves itself.

    A subclass is a frozen dataclass with `repr=False, eq=False`. It defines `_summary`, and
    `_data` if its data are more than the first table of the summary. Its plots are registered in
    `fixel.offers`, with the usual kind first: functions of the result that make a chart or a
    figure, or that draw into axes `ax`; see `fixel.drawing.chart.plot`.
    """

    __slots__ = ()

    def _summary(self) -> Summary:
        raise NotImplementedError

    def _data(self) -> Table:
        """Return the table that `to_pandas`, `to_arrow` and `to_dict` convert."""
        return self._summary().tables[0]

    def __repr__(self) -> str:
        return self._summary().text()

    def _repr_html_(self) -> str:
        return self._summary().html()

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return _same_fields(self, other)

    def __hash__(self) -> int:
        values = (getattr(self, name) for name in _compared(self))
        return hash((type(self), *(v for v in values if isinstance(v, str | int | float | None))))

    def to_dict(self) -> dict[str, list[Value]]:
        """Return the columns of the data by name; None is a missing value."""
        data = self._data()
        return {column.name: [row[k] for row in data.rows] for k, column in enumerate(data.columns)}

    def to_pandas(self) -> Any:
        """Return the data as a pandas DataFrame, with the units in its `attrs`.

        Raises
        ------
        MissingExtra
            pandas is not installed.
        """
        require("pandas", "to_pandas", command="pip install pandas")
        import pandas

        frame = pandas.DataFrame(self.to_dict())
        frame.attrs["units"] = {column.name: column.unit for column in self._data().columns}
        return frame

    def to_arrow(self) -> Any:
        """Return the data as a table of Apache Arrow, with units in the metadata of its fields.

        Raises
        ------
        MissingExtra
            pyarrow is not installed.
        """
        require("pyarrow", "to_arrow", extra="parquet")
        import pyarrow

        arrays = {name: pyarrow.array(values) for name, values in self.to_dict().items()}
        return pyarrow.Table.from_arrays(
            list(arrays.values()),
            schema=pyarrow.schema(
                pyarrow.field(column.name, arrays[column.name].type, metadata={"unit": column.unit})
                for column in self._data().columns
            ),
        )

    def plot(self, kind: str | None = None, *, ax: Any = None, **options: Any) -> Any:
        """Draw the result with Matplotlib, and return the axes.

        Parameters
        ----------
        kind : str, optional
            Kind of plot; the usual one of this result by default.
        ax : matplotlib.axes.Axes, optional
            Axes to draw into; new ones by default.
        **options
            Options of this kind of plot.

        Returns
        -------
        matplotlib.axes.Axes, or an array of them
            Neither shown nor saved.

        Raises
        ------
        InvalidInput
            The result has no such kind of plot.
        """
        plots = f"plots of {type(self).__name__}"
        kinds = list(offers(plots))
        chosen = next(iter(kinds), "") if kind is None else kind
        if chosen not in kinds:
            expected = " or ".join(repr(own) for own in kinds) or "no plot of this result"
            raise InvalidInput("kind", found=repr(kind), expected=expected)
        return offered("methods", "plot")(offered(plots, chosen), self, ax, options)

    def save(self, path: str | Path) -> Path:
        """Save the result to a file, which `fixel.load` reads.

        Parameters
        ----------
        path : str or path
            File of any name; it is written whole or not at all.

        Returns
        -------
        pathlib.Path
            The file.

        Raises
        ------
        InvalidInput
            The file cannot be written.
        """
        saved: Path = offered("methods", "save")(self, path)
        return saved


def _compared(record: Any) -> list[str]:
    return [own.name for own in fields(record) if own.compare]


def _same_fields(a: Any, b: Any) -> bool:
    return all(_same(getattr(a, name), getattr(b, name)) for name in _compared(a))


def _same(a: Any, b: Any) -> bool:
    """Whether two values are equal bit for bit; arrays also where they are not a number."""
    if hasattr(a, "dtype") and hasattr(b, "dtype"):
        alike = a.dtype == b.dtype and a.shape == b.shape
        return bool(alike and a.tobytes() == b.tobytes())
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return list(a) == list(b) and all(_same(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple) and type(a) is type(b):
        return len(a) == len(b) and all(map(_same, a, b))
    if is_dataclass(a) and type(a) is type(b):
        return _same_fields(a, b)
    if isinstance(a, float) and isinstance(b, float) and math.isnan(a):
        return math.isnan(b)
    return bool(a == b)


def _wrapped(text: str, indent: str) -> list[str]:
    return textwrap.wrap(
        " ".join(text.split()), MAX_COLUMNS, initial_indent=indent, subsequent_indent=f"{indent}  "
    )


def _cut(lines: list[str], most: int) -> list[str]:
    if len(lines) <= most:
        return lines
    return [*lines[: most - 1], f"  ... and {len(lines) - most + 1} more"]


def _shortened(line: str) -> str:
    return line if len(line) <= MAX_COLUMNS else f"{line[: MAX_COLUMNS - 3]}..."


def _limited(text: str) -> str:
    return text if len(text) <= 1000 else f"{text[:997]}..."
