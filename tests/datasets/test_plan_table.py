"""Plans as tables: what is read, and what is refused before anything runs."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures import refused

from fixel.datasets.plan_table import read_rows, write_rows
from fixel.sampling import eight_push_plan, thesis_plan

PLANNED = thesis_plan().experiments[0]


def stored(name):
    assert name == "lab/push-1"
    return PLANNED.scene


@pytest.fixture
def read(tmp_path):
    """Read a table next to the scene of the thesis."""
    PLANNED.scene.save(tmp_path / "scene.yaml")

    def read_text(text, template=None):
        path = tmp_path / "plan.csv"
        path.write_text(text, encoding="utf-8")
        return read_rows(path, template, stored)

    return read_text


def test_a_table_in_its_order_with_empty_cells_as_in_the_template(read):
    second, first = read("name,x_mm,angle_deg,speed_mm_s\nb,160,,20\n\n, ,,\na,,45,\n,,,\n")
    assert (second.name, first.name) == ("b", "a")
    old = PLANNED.scene.bodies[0].pose
    np.testing.assert_allclose(second.scene.bodies[0].pose, [0.16, old[1], old[2]])
    np.testing.assert_allclose(first.scene.bodies[0].pose, [old[0], old[1], math.pi / 4])
    assert second.scene.pushers[0].drive.speed == pytest.approx(0.02)
    assert second.scene.duration == pytest.approx(0.15 / 0.02)
    assert dict(first.conditions) == {"angle_rad": pytest.approx(math.pi / 4)}
    assert first.scene.fixels == PLANNED.scene.fixels


def test_offsets_from_a_stored_experiment(read):
    (row,) = read("name,experiment,offset_y_mm,offset_angle_deg\nagain,lab/push-1,-8,18\n")
    old, new = PLANNED.scene.bodies[0].pose, row.scene.bodies[0].pose
    np.testing.assert_allclose(new - old, [0.0, -0.008, math.pi / 10], atol=1e-12)
    assert row.conditions["offset_y_m"] == pytest.approx(-0.008)
    assert row.conditions["offset_theta_rad"] == pytest.approx(math.pi / 10)
    assert {"offset_y_m", "offset_theta_rad"} <= {*PLANNED.conditions}


def test_a_template_by_name_and_conditions(read, tmp_path):
    other = thesis_plan().experiments[250].scene
    other.save(tmp_path / "other.yaml")
    text = "\ufeffname,scene,condition.surface,condition.layer\na,other.yaml,abs,2\nb,,,\n"
    named, usual = read(text)
    assert named.scene == other
    assert dict(named.conditions) == {"surface": "abs", "layer": 2.0}
    assert (usual.scene, dict(usual.conditions)) == (PLANNED.scene, {})
    (chosen,) = read("name\nc\n", tmp_path / "other.yaml")
    assert chosen.scene == other


@pytest.mark.parametrize("plan", [eight_push_plan, thesis_plan])
def test_what_is_written_is_read(plan, tmp_path):
    rows = plan().experiments[::21] if plan is thesis_plan else plan().experiments
    noted = {"note": "=1+1", **rows[0].conditions}  # a spreadsheet would run it as a formula
    rows = (replace(rows[0], conditions=noted), *rows[1:])
    write_rows(tmp_path / "rows", rows)
    assert read_rows(tmp_path / "rows" / "plan.csv", None, stored) == rows
    assert len([*(tmp_path / "rows").iterdir()]) == len(rows) + 1
    refused(write_rows, tmp_path / "rows", rows, match="a new or empty folder")


@pytest.mark.parametrize(("text", "where", "words"), [
    ("id,x_mm\na,1\n", "plan.csv", "fixel needs a column named name"),
    ("name,x\na,1\n", "plan.csv, header", "'x', but must be one of"),
    ("name,speed_mms\na,1\n", "plan.csv, header", "did you mean 'speed_mm_s'"),
    ("name,ofset_x_mm\na,1\n", "plan.csv, row 1, a.ofset_x_m", "mean 'offset_x_m'"),
    ("name,comment\na,nice\n", "plan.csv, header", "name a column of your own condition.comment"),
    ("name,x_mm,x_m\na,160,0.2\n", "plan.csv, header", "'x_m' in another unit too"),
    ("name,x_deg\na,1\n", "plan.csv, header", "'x_deg'"),
    ("name|x_mm\na|1\n", "plan.csv", "fixel needs a column named name"),
    ("name,x_mm\na,160\nb,far\n", "plan.csv, row 2, column x_mm", "'far', but must be a finite"),
    ("name,x_mm\na,nan\n", "plan.csv, row 1, column x_mm", "finite number"),
    ("name,speed_mm_s\na,0\n", "plan.csv, row 1, a.drive", "greater than 0"),
    ("name,x_mm\na,160\na,161\n", "plan.csv, row 2, column name", "'a' twice"),
    ("name,x_mm\na/b,160\n", "plan.csv, row 1, column name", "'a/b', but must be at most"),
    ("name,x_mm\na,160\nb,20\n", "plan.csv, row 2, b.'object' and 'actuator'", "an overlap of"),
    ("name,scene\na,none.yaml\n", "plan.csv, row 1, column scene", "none.yaml"),
    ("name,scene,experiment\na,scene.yaml,lab/push-1\n", "plan.csv, row 1, column scene",
     "one of them"),
    ("name,x_mm\na,160,3\n", "plan.csv, row 1", "3 cells"),
    ("name\n", "plan.csv", "a header and rows"),
])  # fmt: skip
def test_what_is_refused(text, where, words, read):
    problem = refused(read, text)
    assert problem.where.startswith(where)
    assert words in str(problem)


def test_a_value_for_a_fixel_that_the_scene_of_the_row_lacks(read, tmp_path):
    eight_push_plan().experiments[0].scene.save(tmp_path / "open.yaml")
    table = "name,scene,fixel-1_x_mm\na,scene.yaml,240\nb,open.yaml,240\n"
    said = r"row 2, b\.fixel-1_x_m: found an unknown name, but fixel needs one of"
    refused(read, table, match=said)


def test_no_template(tmp_path):
    path = tmp_path / "plan.csv"
    path.write_text("name,x_mm\na,160\n")
    said = "row 1, column scene: found none, but fixel needs a scene file or an exp"
    refused(read_rows, path, None, stored, match=said)
