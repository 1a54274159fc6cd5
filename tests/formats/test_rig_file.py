"""Rig files: what is written reads back, the examples see their plate, what is wrong is said."""

import copy
import re
from pathlib import Path

import numpy as np
import pytest
from tests.fixtures import refused

from fixel.formats import rig_file
from fixel.formats.rig_file import (
    EXAMPLES,
    camera_dict,
    load_rig,
    rig_dict,
    rig_from_dict,
    rig_of,
    save_camera,
    save_rig,
)
from fixel.io.document import yaml_text
from fixel.sampling import thesis_plan
from fixel.testing.scenes import grasp, micro_push
from fixel.vision.camera import MeasuredCamera


@pytest.mark.parametrize("name", EXAMPLES)
def test_example_reads_back(name, tmp_path):
    rig = rig_of(name)
    save_rig(rig, tmp_path / "rig.yaml")
    again = load_rig(tmp_path / "rig.yaml")
    assert again.parts == rig.parts
    assert again.plate == rig.plate
    assert again.camera.lens == rig.camera.lens
    np.testing.assert_allclose(again.camera.translation, rig.camera.translation, atol=1e-15)
    save_rig(again, tmp_path / "again.yaml")
    assert (tmp_path / "again.yaml").read_text() == (tmp_path / "rig.yaml").read_text()


@pytest.mark.parametrize("name", EXAMPLES[:2])
def test_thesis_examples_see_the_whole_workspace(name):
    rig = rig_of(name)
    reach, travel = 0.076, 0.15
    scenes = [experiment.scene for experiment in thesis_plan().experiments]
    places = np.array([body.pose[:2] for scene in scenes for body in scene.bodies])
    for x in (0.0, travel):
        for corner in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
            # Objects are pushed along by at most what the head goes beyond touching them.
            around = places + [0.5 * x, 0.0] + reach * np.array(corner)
            assert rig.camera.lens.sees(rig.camera.project_at(around, 0.0254)).all()
    fixels = np.array([fixel.pose[:2] for scene in scenes for fixel in scene.fixels])
    assert rig.camera.lens.sees(rig.camera.project_at(fixels, rig.fixel_height)).all()
    for tag in rig.plate:
        corners = tag.pose[:2] + 0.5 * tag.size * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        assert rig.camera.lens.sees(rig.camera.project_at(corners, tag.height)).all()


def test_parts_have_the_names_of_the_scenes():
    for name, scene in (
        ("thesis-tags", thesis_plan().experiments[0].scene),
        ("thesis-stickers", grasp()),
        ("microscope", micro_push()),
    ):
        named = {thing.name for thing in (*scene.bodies, *scene.pushers)}
        assert set(rig_of(name).parts) == named


@pytest.mark.parametrize(("path", "value", "where", "word"), [
    (("camera",), 3, "camera", "camera file"),
    (("camera",), "no.yaml", "camera", "no such file"),
    (("camera", "place"), None, "camera.place", "fixel camera place"),
    (("camera", "lens", "focal_px"), [-1.0, 900.0], "camera.lens.focal_px", "greater than 0"),
    (("camera", "lens", "focal"), [900.0, 900.0], "camera.lens.focal", "did you mean"),
    (("camera", "lens", "distortion"), [1.0] * 9, "camera.lens.distortion", "8"),
    (("parts", "object", "height_mm"), 0.0, "parts.object.height_mm", "greater than 0"),
    (("parts", "object", "tags", 0, "family"), "x", "parts.object.tags[0].family", "36h11"),
    (("parts", "object", "tags", 0, "id"), 20, "rig.parts", "tag 20"),
    (("parts", "object", "tags", 0, "size_mm"), float("nan"), "size_mm", "number"),
    (("plate", 0, "pose_mm_deg"), [0.0], "plate[0].pose_mm_deg", "3 entries"),
    (("tactile_bits",), ["a", "a"], "rig.tactile", "each once"),
    (("name",), "", "rig.name", "name"),
    (("fixel_rig",), 2, "fixel_rig", "1"),
])  # fmt: skip
def test_what_is_wrong_is_said(path, value, where, word, tmp_path):
    content = copy.deepcopy(rig_dict(rig_of("thesis-tags")))
    at = content
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    refusal = refused(rig_from_dict, content)
    assert where in str(refusal)
    assert word in str(refusal)
    file = tmp_path / "rig.yaml"
    file.write_text(yaml_text(content))
    found = str(refused(load_rig, file))
    assert found.startswith(f"{file}: ")
    assert where in found
    assert word in found


@pytest.mark.parametrize("raw", [None, [], "rig", 3, {}, {"fixel_rig": 1}])
def test_no_rig_at_all(raw):
    refused(rig_from_dict, raw)


def test_unknown_names_list_the_examples():
    refused(rig_of, "thesis", match="thesis-stickers")


def test_the_page_shows_a_rig_that_loads(tmp_path):
    page = Path(__file__).parents[2] / "docs" / "how-to" / "camera.md"
    (text,) = re.findall(r"```yaml\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    rig = rig_of("thesis-tags")
    save_camera(
        MeasuredCamera(lens=rig.camera.lens, camera=rig.camera), tmp_path / "camera-placed.yaml"
    )
    (tmp_path / "rig.yaml").write_text(text)
    assert set(load_rig(tmp_path / "rig.yaml").parts) == {"object", "actuator"}


@pytest.mark.parametrize("apart", [True, False])
def test_what_is_known_of_the_cameras_errors_is_kept(apart, tmp_path):
    rig = rig_of("thesis-tags")
    names = ("fx", "k1", "tx", "tz")
    root = np.random.default_rng(0).normal(size=(4, 4)) * [[0.4], [1e-3], [1e-4], [3e-4]]
    measured = MeasuredCamera(
        lens=rig.camera.lens, camera=rig.camera, names=names, covariance=root @ root.T, noise=0.03
    )
    if apart:
        save_camera(measured, tmp_path / "camera.yaml")
        content = rig_dict(rig) | {"camera": "camera.yaml"}
        (tmp_path / "rig.yaml").write_text(yaml_text(content))
        rig = load_rig(tmp_path / "rig.yaml")
    else:
        rig = rig_from_dict(rig_dict(rig) | {"camera": camera_dict(measured)})
    save_rig(rig, tmp_path / "again.yaml")
    again = load_rig(tmp_path / "again.yaml").measured
    assert again.names == names
    assert again.noise == 0.03
    np.testing.assert_allclose(again.covariance, root @ root.T, rtol=1e-12)


def test_markers_are_read_before_the_camera_is_placed(tmp_path):
    content = rig_dict(rig_of("thesis-tags")) | {"camera": "not-there-yet.yaml"}
    (tmp_path / "rig.yaml").write_text(yaml_text(content))
    rig = rig_of("thesis-tags")
    assert rig_file.markers_of(tmp_path / "rig.yaml") == (rig.name, rig.parts, rig.plate)
