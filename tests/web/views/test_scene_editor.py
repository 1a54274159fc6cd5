"""Scenes made on a page."""

import numpy as np
import pytest
from tests.fixtures import refused

from fixel.web.views import scene_editor


def test_every_example_is_read_and_described_in_a_sentence():
    names = [one.name for one in scene_editor.examples()]
    assert "grasp" in names
    assert {one.name: one.sentence for one in scene_editor.examples()}[
        "grasp"
    ] == "A flat head pushes a square against three fixels"
    for name in names:
        assert scene_editor.example(name)["bodies"]


@pytest.mark.parametrize(("change", "where"), [
    ({"duration": 1e5}, "duration"),
    ({"step": 1e-6}, "step"),
    ({"motion": "magic"}, "motion"),
    ({"bodies": []}, "bodies"),
    ({"surprise": 1}, "surprise"),
])  # fmt: skip
def test_what_a_page_cannot_bear_is_refused_where_it_stands(change, where):
    assert refused(scene_editor.check_scene, scene_editor.example("grasp") | change).where == where


def test_many_corners_points_and_waypoints_are_refused():
    angle = np.linspace(0.0, 2.0 * np.pi, scene_editor.MAX_CORNERS + 2)[:-1]
    scene = scene_editor.example("grasp")
    scene["bodies"][0]["shape"] = {
        "polygon": (0.05 * np.column_stack((np.cos(angle), np.sin(angle)))).tolist()
    }
    scene["fixels"], scene["pushers"] = [], []
    refused(scene_editor.check_scene, scene, match="corners in all")
    scene = scene_editor.example("grasp")
    scene["bodies"][0]["support"] = {"uniform": {"friction": 0.2, "n_points": 5000}}
    refused(scene_editor.check_scene, scene, match="support points in all")
