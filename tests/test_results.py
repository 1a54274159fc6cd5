"""Base class of results: equality, text and HTML within their limits, conversion."""

from dataclasses import FrozenInstanceError, dataclass

import numpy as np
import pytest

from fixel.errors import InvalidInput
from fixel.results import MAX_COLUMNS, MAX_HTML, MAX_LINES, Result, Summary
from fixel.table import Column, Table
from fixel.typing import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, repr=False, eq=False)
class Lengths(Result):
    """Lengths by name."""

    names: tuple[str, ...]
    length: FloatArray

    def _summary(self) -> Summary:
        rows = Table(
            ("name", Column("length", "m", ".3f")), zip(self.names, self.length, strict=True)
        )
        return Summary(f"{len(self.names)} lengths", [rows], ["measured by hand"])


def lengths(n: int) -> Lengths:
    return Lengths(names=tuple(f"<{k}>" for k in range(n)), length=np.arange(n, dtype=float))


def test_text_shows_heading_table_and_notes() -> None:
    assert repr(lengths(2)).splitlines() == [
        "2 lengths",
        "  name  length [m]",
        "  <0>        0.000",
        "  <1>        1.000",
        "  measured by hand",
    ]


def test_long_text_is_cut_and_says_how_much_is_missing() -> None:
    lines = repr(lengths(1000)).splitlines()

    assert len(lines) == MAX_LINES
    assert lines[-2] == "  ... and 979 more"


@pytest.mark.parametrize("summary", [
    Summary("x" * 1000, notes=["word " * 500] * 80),
    Summary("h", [Table(("a" * 300, "b"), [("w" * 400, k) for k in range(99)])] * 40, ["n"] * 9),
])  # fmt: skip
def test_text_and_html_stay_within_their_limits(summary: Summary) -> None:
    lines = summary.text().splitlines()

    assert len(lines) <= MAX_LINES
    assert max(map(len, lines)) <= MAX_COLUMNS
    assert len(summary.html().encode()) <= MAX_HTML


def test_html_is_escaped() -> None:
    assert "&lt;0&gt;" in lengths(1)._repr_html_()
    assert "<0>" not in lengths(1)._repr_html_()


def test_equality_is_bit_for_bit_and_counts_missing_numbers() -> None:
    a, b = lengths(3), lengths(3)
    a.length[1] = b.length[1] = np.nan

    assert a == b
    assert hash(a) == hash(b)
    b.length[2] = np.nextafter(2.0, 3.0)
    assert a != b
    assert a != "lengths"


def test_frozen() -> None:
    with pytest.raises(FrozenInstanceError):
        lengths(1).names = ()  # type: ignore[misc]


def test_columns_by_name() -> None:
    assert lengths(2).to_dict() == {"name": ["<0>", "<1>"], "length": [0.0, 1.0]}
    arrow = lengths(2).to_arrow()
    assert arrow.column_names == ["name", "length"]
    assert arrow.schema.field("length").metadata == {b"unit": b"m"}


def test_unknown_plot_is_refused() -> None:
    with pytest.raises(InvalidInput, match="no plot"):
        lengths(1).plot("histogram")
