"""Tables as plain text, HTML, CSV and JSON."""

import csv
import doctest
import io
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

import fixel.table
from fixel.errors import counted
from fixel.table import Column, Table

TABLE = Table(
    ("name", Column("error", "mm", ".2f"), "verdict"),
    [("a<b>", 0.523, "not told apart"), ("c", None, ""), ("d", math.inf, "bounded")],
    title="A & B",
)


def test_its_examples() -> None:
    assert doctest.testmod(fixel.table).failed == 0


def test_plain_text_is_aligned_and_may_be_cut() -> None:
    assert TABLE.lines() == [
        "name  error [mm]         verdict",
        "a<b>        0.52  not told apart",
        "c              -",
        "d              -         bounded",
    ]
    assert len(TABLE.lines(max_rows=1)) == 2


@pytest.mark.parametrize(("number", "what", "text"), [
    (0, "frame", "0 frames"), (1, "frame", "1 frame"), (np.int64(1), "push", "1 push"),
    (11, "push", "11 pushes"), ("1,001", "simulation", "1,001 simulations"),
])  # fmt: skip
def test_single_things_are_singular(number, what, text) -> None:
    assert counted(number, what) == text


def test_no_sentence_has_a_plural_of_its_own() -> None:
    files = Path(fixel.table.__file__).parent.rglob("*.py")
    own = re.compile(r"""\w\{?["']e?s["'] (\*|if) """)
    assert [file.name for file in files if own.search(file.read_text(encoding="utf-8"))] == []


def test_html_is_escaped_and_marks_columns_of_words() -> None:
    html = TABLE.html("Table 1.")
    assert "<caption><b>Table 1.</b> A &amp; B</caption>" in html
    assert '<tr><th scope="row">a&lt;b&gt;</th><td>0.52</td>' in html
    assert '<th scope="col" class="words">verdict</th>' in html
    assert "caption" not in Table(("a",), []).html()


def test_values_remain_in_csv_and_json() -> None:
    assert TABLE.csv().splitlines()[1:3] == ["a<b>,0.523,not told apart", "c,,"]
    records = TABLE.records()
    assert records[0] == {"name": "a<b>", "error": 0.523, "verdict": "not told apart"}
    assert json.loads(json.dumps(records, allow_nan=False))[2]["error"] is None
    assert TABLE.content()["rows"][1] == ["c", None, ""]


@pytest.mark.parametrize(
    "text", ['=HYPERLINK("http://x")', "+1+cmd|' /C calc'!A0", "@SUM(A1)", "\t=1"]
)
def test_texts_are_no_formulas_of_spreadsheets_and_numbers_stay(text) -> None:
    row = (text, -0.5, "-0.5", "+1e3", "-", "a=b")
    read = list(csv.reader(io.StringIO(Table((text, *"bcdef"), [row]).csv())))
    assert read[0][0] == read[1][0] == f"'{text}"
    assert read[1][1:] == ["-0.5", "-0.5", "+1e3", "-", "a=b"]


def test_columns_of_arrays_are_a_table() -> None:
    table = Table.from_columns({"n": ["a", "b"], "x_m": np.array([0.5, np.inf]), "k": [1, 2]})
    assert table.head == ("n", "x_m", "k")
    assert table.rows == [("a", 0.5, 1), ("b", None, 2)]
    with pytest.raises(ValueError, match="zip"):
        Table.from_columns({"a": [1], "b": [1, 2]})


def test_a_table_without_rows_has_a_head() -> None:
    empty = Table(("a", Column("b", "m")), [])
    assert empty.lines() == ["a  b [m]"]
    assert empty.records() == []
    assert "<tbody>\n</tbody>" in empty.html()


def test_rows_of_another_length_are_a_mistake() -> None:
    with pytest.raises(ValueError, match="one value for each column"):
        Table(("a", "b"), [(1.0,)])


def test_a_numbered_table_without_a_title_shows_its_number():
    """A report counted such a table, and the numbers of its captions had a gap."""
    assert "<b>Table 6.</b>" in Table(("a",), [(1,)]).html(number="Table 6.")
    assert "<caption>" not in Table(("a",), [(1,)]).html()


def test_indented_cells_stay_indented_in_html():
    text = Table(("parameter", "value"), [("mu", 1), ("  noise alone", 2)]).html()
    assert '<th scope="row">mu</th>' in text
    assert '<th scope="row">&emsp;noise alone</th>' in text


@pytest.mark.parametrize(
    ("value", "format_", "shown"),
    [
        (-4e-4, ".3f", "0.000"), (-6e-4, ".3f", "-0.001"), (-0.0, ".3f", "0.000"),
        (-0.4, ".0f", "0"), (-0.0, "", "0.0"), (-4e-4, "+.3f", "+0.000"), (4e-4, "+.3f", "+0.000"),
        (-4e-9, ".2g", "-4e-09"),
        (0, "d", "0"), (-10, "d", "-10"), (math.nan, ".3f", "nan"), ("-0.000", ".3f", "-0.000"),
    ],
)  # fmt: skip
def test_what_rounds_to_zero_has_no_sign_of_its_own(value, format_, shown):
    """A comparison printed an angle of -0.000 degrees."""
    assert Column("angle", "deg", format_).text(value) == shown
