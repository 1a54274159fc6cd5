"""Outlines of measured parts in their videos."""

from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures import bare_experiment

from fixel.database.project import Project
from fixel.formats.rig_file import rig_of, save_rig
from fixel.model import Trajectory
from fixel.testing.scenes import grasp
from fixel.web.views.video import MAX_OUTLINES, outlines_in_video, rig_named


@pytest.fixture
def project(tmp_path):
    return Project.create(tmp_path / "lab")


def experiment(rig="thesis-tags", n=3):
    scene = grasp("seated")
    time = np.arange(float(n))
    pose = np.column_stack((0.01 * time / n, 0.0 * time, 0.2 * time / n))
    return bare_experiment(
        "1",
        dataset="bench",
        trajectory=Trajectory(time=time, pose=pose),
        scene=scene,
        object_name=scene.bodies[0].name,
        height=0.0254,
        conditions={"rig": rig},
    )


def test_the_middle_of_the_outline_is_that_of_the_part(project):
    known = experiment()
    seen = outlines_in_video(project, known)
    camera = rig_of("thesis-tags").camera
    assert seen.size == camera.lens.image_size
    np.testing.assert_array_equal(seen.time, known.trajectory.time)
    shape = known.scene.bodies[0].shape
    for pose, line in zip(known.trajectory.pose, seen.outline, strict=True):
        c, s = np.cos(pose[2]), np.sin(pose[2])
        x, y = shape.centroid
        middle = pose[:2] + np.array([c * x - s * y, s * x + c * y])
        wanted = camera.project_at(middle[None], known.height)[0]
        # Straight edges appear all but straight, so their middle is all but that of the part.
        np.testing.assert_allclose((line.min(0) + line.max(0)) / 2.0, wanted, atol=8.0)


def test_long_ones_are_thinned(project):
    seen = outlines_in_video(project, experiment(n=2000))
    assert len(seen.time) == len(seen.outline) == MAX_OUTLINES
    assert (seen.time[0], seen.time[-1]) == (0.0, 1999.0)


def test_without_a_rig_nothing_is_drawn(project):
    assert outlines_in_video(project, experiment(rig="another bench")) is None
    assert outlines_in_video(project, replace(experiment(), conditions={})) is None
    assert outlines_in_video(project, replace(experiment(), scene=None)) is None


def test_a_rig_of_the_project_next_to_a_broken_one(project):
    folder = project.folder / "rigs"
    folder.mkdir()
    (folder / "a.yaml").write_text("nothing of the kind: [")
    save_rig(replace(rig_of("thesis-tags"), name="ours"), folder / "b.yaml")
    assert rig_named(project, "ours").name == "ours"
    assert rig_named(project, "theirs") is None


def test_from_where_the_rig_has_no_camera_nothing_is_drawn(project):
    known = experiment()
    moved = replace(known, conditions={**known.conditions, "camera": "registered again"})
    assert outlines_in_video(project, moved) is None
