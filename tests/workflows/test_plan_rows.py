"""Experiments of a plan file or of a table, also from stored experiments."""

from dataclasses import replace

import numpy as np
import pytest
from tests.filtering.recordings import push
from tests.fixtures import project_of, refused

from fixel.errors import InvalidInput
from fixel.formats.plan_file import plan_text
from fixel.sampling import thesis_plan
from fixel.testbed.simulated import SimulatedTestbed
from fixel.workflows.sampling import planned_rows


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    bench = SimulatedTestbed(seed=3)
    (first,) = bench.run(thesis_plan().experiments[:1])
    bare = replace(push(seed=1, duration=1.0), name="bare", scene=None)
    return project_of(tmp_path_factory.mktemp("labs") / "lab", [first, bare])


def table(folder, text):
    path = folder / "plan.csv"
    path.write_text(text)
    return path


def test_a_plan_file_has_its_scenes(tmp_path):
    path = tmp_path / "plan.yaml"
    path.write_text(plan_text(thesis_plan()))

    assert planned_rows(path) == thesis_plan().experiments
    with pytest.raises(InvalidInput, match=r"^scene: .*fixel needs a table"):
        planned_rows(path, scene=tmp_path / "scene.yaml")


def test_offsets_from_the_start_of_a_stored_experiment(project, tmp_path):
    """Offsets of the plan of the thesis, from its stored first experiment, give its next ones."""
    with project.store() as store:
        stored = store.experiment(store.find("001-square-collinear-tight-nominal"))
    text = "name,experiment,offset_x_mm\n" + "".join(
        f"push-{k},{stored.key},{5 * k}\n" for k in (1, 2)
    )
    rows = planned_rows(table(tmp_path, text), project)

    for row, wanted in zip(rows, thesis_plan().experiments[1:3], strict=True):
        assert wanted.conditions["offset_x_m"] == row.conditions["offset_x_m"]
        old, new = wanted.scene, row.scene
        np.testing.assert_allclose(new.bodies[0].pose, old.bodies[0].pose, atol=1e-12)
        assert (new.pushers, new.fixels) == (old.pushers, old.fixels)


@pytest.mark.parametrize(
    ("key", "found"), [("nothing", "nothing"), ("bare", "no scene"), (None, "no project")]
)
def test_experiments_that_are_no_start(key, found, project, tmp_path):
    path = table(tmp_path, f"name,experiment\na,{key or 'bare'}\n")
    problem = refused(planned_rows, path, project if key else None)
    assert problem.where.startswith("plan.csv, row 1, column experiment")
    assert found in str(problem)
