"""The paper's figure 11 and the thesis's figure 3.1: what they show, found another way."""

import csv
import re
import sqlite3

import numpy as np
import pytest
import shapely
from reproductions.run import reproduce
from tests.cli.shell import fixel

from fixel import InvalidInput, Project
from fixel.drawing.relations import Entity, columns_of
from fixel.workflows.project import maintenance


@pytest.mark.slow
def test_two_searches_settle_in_the_part(tmp_path):
    made = reproduce("asme-figure-11", out=tmp_path, quick=True)
    assert (tmp_path / "asme-figure-11.png").stat().st_size > 10_000
    with (tmp_path / "asme-figure-11_convergence.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    for search in ("search 1", "search 2"):
        own = [row for row in rows if row["search"] == search]
        errors = np.array([float(row["f_um"]) for row in own])
        sizes = np.array([float(row["simplex_size"]) for row in own])
        assert np.all(np.diff(errors) <= 0.0)  # the best never gets worse
        assert errors[-1] < errors[0]
        assert sizes[-1] < 0.2 * sizes[0]
        for row in (own[0], own[-1]):
            numbers = re.findall(r"-?\d+\.\d+", row["points_um"])
            triangle = np.array(numbers, dtype=float).reshape(3, 2)
            assert np.all(np.abs(triangle) <= (421.05, 810.55))  # in the outline
            # The paper's constraint: the centre of mass is inside.
            assert shapely.Polygon(triangle).buffer(0.1).contains(shapely.Point(0.0, 0.0))
    assert len(made.conclusions) == 2


def test_the_diagram_holds_what_the_database_does(tmp_path, monkeypatch, capsys):
    """Against what SQLite itself says of a new project's tables."""
    drawn = {}
    monkeypatch.setattr(
        "fixel.drawing.relations.draw_relations",
        lambda entities, file: drawn.update({e.name: e for e in entities}) or file.touch(),
    )
    maintenance.diagram(tmp_path / "tables.png")
    Project.create(tmp_path / "lab")
    file = next((tmp_path / "lab").glob("*.db"))
    connection = sqlite3.connect(file)
    names = {
        name
        for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
        if not name.startswith(("sqlite_", "alembic"))
    }
    assert set(drawn) == names
    for name in names:
        columns = [row[1] for row in connection.execute(f"PRAGMA table_info('{name}')")]
        assert sorted(drawn[name].columns) == sorted(columns)
        keys = connection.execute(f"PRAGMA foreign_key_list('{name}')").fetchall()
        assert drawn[name].references == {row[3]: row[2] for row in keys}
    connection.close()


def test_tables_stand_right_of_those_they_refer_to(tmp_path, capsys):
    names = [
        Entity("leaf", ("id", "b_id", "a_id"), {"b_id": "b", "a_id": "a"}),
        Entity("a", ("id",), {}),
        Entity("b", ("id", "a_id", "b_id"), {"a_id": "a", "b_id": "b"}),
        Entity("late", ("id",), {}),
        Entity("end", ("late_id", "leaf_id"), {"late_id": "late", "leaf_id": "leaf"}),
    ]
    stacks = [[entity.name for entity in stack] for stack in columns_of(names)]
    assert stacks == [["a"], ["b"], ["leaf", "late"], ["end"]]

    code, out, err = fixel(capsys, "db", "diagram", tmp_path / "tables.png")
    assert code == 0, err
    assert "11 tables" in out
    assert (tmp_path / "tables.png").stat().st_size > 10_000
    with pytest.raises(InvalidInput, match="picture"):
        maintenance.diagram(tmp_path / "tables.txt")
