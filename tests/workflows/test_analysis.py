"""Analyses are kept whole, with their pictures, and found again."""

import json
import os
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from fixel.database.project import Project
from fixel.drawing.calibration import seconds_chart
from fixel.errors import StoreRefused
from fixel.table import Column, Table
from fixel.workflows.analysis import CONTENT, Analysis, Picture, load_analyses, store_analysis


@pytest.fixture
def project(tmp_path):
    return Project.create(tmp_path / "lab")


def _analysis(kind="domain", **question):
    return Analysis(
        kind=kind,
        title="Where",
        question=question,
        headline=("Within 2 mm for 8 of 10 configurations.",),
        tables=(Table(("cell", "error [mm]"), (("a", "1"),), title="Cells"),),
        numbers={"trusted": 8, "bound_mm": None},
    )


def _chart():
    return seconds_chart(
        keys=("a", "b", "c"), seconds=np.array([0.1, 0.2, 0.3]), evaluations=(1, 2, 3)
    )


def test_what_was_kept_comes_back(project):
    picture = Picture("map", _chart(), "", "Where it holds.")
    one = store_analysis(project, _analysis(tau=2.0), [picture], {"error": np.arange(3.0)})
    (again,) = load_analyses(project, "domain")
    assert again.analysis == one.analysis
    assert again.analysis.pictures[0].caption == "Where it holds."
    np.testing.assert_array_equal(again.arrays["error"], [0.0, 1.0, 2.0])
    assert all(again.picture("map", ending).stat().st_size for ending in ("png", "pdf", "csv"))
    assert load_analyses(project, "growth") == []


def test_a_picture_that_cannot_be_drawn_leaves_the_earlier_result(project):
    first = store_analysis(project, _analysis(), [Picture("map", _chart(), "", "First.")])

    class Torn:
        name, caption, banner = "map", "Second.", ""

        @property
        def chart(self):
            # What a page of results would show meanwhile.
            assert [one.analysis for one in load_analyses(project)] == [first.analysis]
            raise OSError("no space left on device")

    with pytest.raises(OSError, match="no space"):
        store_analysis(project, _analysis(), [Torn()])
    (kept,) = load_analyses(project)
    assert kept.analysis == first.analysis
    assert sorted(path.name for path in kept.folder.iterdir()) == [
        CONTENT, "map.csv", "map.pdf", "map.png"
    ]  # fmt: skip


def test_tables_come_back_with_their_values_and_texts(project):
    rows = [("a", 0.1 + 0.2, 3), ("b", None, 4)]
    table = Table(("cell", Column("error", "mm", ".2f"), "pushes"), rows, title="Cells", left=2)
    one = store_analysis(project, _analysis().model_copy(update={"tables": (table,)}))
    (again,) = load_analyses(project)
    (own,) = again.analysis.tables
    assert own.rows == rows
    assert (own.lines(), own.left) == (table.lines(), 2)
    content = json.loads((one.folder / CONTENT).read_text())

    # Earlier versions stored texts.
    content["tables"] = [{"title": "", "head": ["cell", "error [mm]"], "rows": [["a", "0.30"]]}]
    (one.folder / CONTENT).write_text(json.dumps(content))
    assert load_analyses(project)[0].analysis.tables[0].cells == [("a", "0.30")]
    # A format of a stranger would fill the memory.
    content["tables"][0]["formats"] = ["", ".999999999f"]
    (one.folder / CONTENT).write_text(json.dumps(content))
    with pytest.raises(StoreRefused, match="cannot be read"):
        load_analyses(project)


def test_the_same_question_takes_the_place_of_its_answer(project):
    first = store_analysis(project, _analysis(tau=2.0))
    assert store_analysis(project, _analysis(tau=2.0)).folder == first.folder
    assert store_analysis(project, _analysis(tau=3.0)).folder != first.folder
    assert len(load_analyses(project)) == 2


def test_the_newest_is_the_one_stored_last(project):
    """Also of two within a second, in either order of their folders."""
    for first, last in ((2.0, 3.0), (3.0, 2.0)):
        for tau in (first, last):
            store_analysis(project, _analysis(tau=tau))
        assert load_analyses(project)[0].analysis.question == {"tau": last}


def test_the_newest_is_the_one_stored_last_also_after_the_clock_has_gone_back(project):
    """The first one was stored while the clock was a day ahead."""
    first = store_analysis(project, _analysis(tau=2.0))
    ahead = datetime.now(UTC) + timedelta(days=1)
    path = first.folder / CONTENT
    path.write_text(
        first.analysis.model_copy(update={"created": ahead.isoformat()}).model_dump_json()
    )
    os.utime(path, (ahead.timestamp(), ahead.timestamp()))
    for tau in (3.0, 1.0):
        store_analysis(project, _analysis(tau=tau))
        assert load_analyses(project)[0].analysis.question == {"tau": tau}


def test_one_that_was_not_finished_is_not_there(project):
    one = store_analysis(project, _analysis())
    (one.folder / CONTENT).unlink()
    assert load_analyses(project) == []
