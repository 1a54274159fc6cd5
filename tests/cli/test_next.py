"""`fixel next`, as called from a shell."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.cli.shell import fixel, json_of, output, refusal
from tests.fixtures import project_of

from fixel.formats import SceneFile, save_scene
from fixel.formats.plan_file import load_plan
from fixel.model import LineDrive, Polygon, Pusher
from fixel.testing.pushes import example_parts
from fixel.workflows.analysis import load_analyses


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = tmp_path_factory.mktemp("projects") / "my_lab"
    pushes = example_parts(4, 16)
    bare = replace(pushes[0], name="bare", scene=None)
    return project_of(folder, [*pushes[:-10], bare])  # part-4 has six pushes


@pytest.fixture(scope="module")
def new_part(tmp_path_factory):
    """Scene file of a part without experiments."""
    path = tmp_path_factory.mktemp("scenes") / "new.yaml"
    scene = example_parts(1, 1, seed=9)[0].scene
    save_scene(SceneFile(scene=replace(scene, pushers=())), path)
    return path


def _at_rest(scene):
    """Place of the tip and direction of a push in the part's frame."""
    body, tip = scene.bodies[0], scene.pushers[0]
    c, s = math.cos(body.pose[2]), math.sin(body.pose[2])
    turn = np.array([[c, s], [-s, c]])
    return turn @ (tip.pose[:2] - body.pose[:2]), turn @ tip.drive.direction


def test_pushes_of_a_part_with_some_are_proposed_and_written_as_a_plan(capsys, project, tmp_path):
    out = tmp_path / "next.yaml"
    words = ["next", "-p", project.folder, "--part", "part-4", "--contacts", 8, "-n", 3]
    text = output(capsys, *words, "--out", out, "--plot", tmp_path / "charts")
    lines = text.splitlines()
    assert lines[0] == "Warning: part 'part-4': only 6 pushes of it"
    assert "Next pushes of part-4 on board, after 6 pushes (24 candidates)" in text
    assert "1 experiment without a scene: not used" in text
    assert lines[-1] == f"Next: fixel testbed run {out} --project {project.folder}"
    assert "learned from 48 pushes of 3 parts" in text
    assert (tmp_path / "charts" / "pushes.pdf").is_file()

    (kept,) = load_analyses(project, "next")
    assert kept.analysis.warnings[0] == "part 'part-4': only 6 pushes of it"
    # The plan makes the pushes that were proposed, with the head along +x.
    planned = load_plan(out).experiments
    for own, push in zip(planned, kept.analysis.numbers["pushes"], strict=True):
        place, direction = _at_rest(own.scene)
        np.testing.assert_allclose(place, push["start_m"], atol=1e-6)
        way = np.subtract(push["end_m"], push["start_m"])
        np.testing.assert_allclose(direction, way / np.linalg.norm(way), atol=1e-6)


def test_a_part_without_experiments_has_a_scene_and_json_names_what_is_unseen(
    capsys, project, new_part
):
    words = ["next", "-p", project.folder, "--scene", new_part, "--contacts", 4, "-n", 2]
    answer = json_of(capsys, *words)
    assert next(iter(answer)) == "unseen"
    assert any("part" in sentence for sentence in answer["unseen"])
    assert any("surface not given" in sentence for sentence in answer["unseen"])
    assert answer["pushes_made"] == 0
    assert [len(push["position_m"]) for push in answer["pushes"]] == [2, 2]
    assert answer["skipped"] == {"without a scene": 1}


def test_candidates_of_a_plan_are_the_only_ones(capsys, project, new_part, tmp_path):
    out = tmp_path / "first.yaml"
    words = ["next", "-p", project.folder, "--scene", new_part, "--contacts", 4]
    output(capsys, *words, "-n", 4, "--out", out)
    text = output(
        capsys, "next", "-p", project.folder, "--candidates", out, "--surface", "board", "-n", 2
    )
    assert "(4 candidates)" in text
    assert f"fixel next --surface board --candidates {out}" in text.splitlines()[-1]


@pytest.mark.parametrize(("words", "message"), [
    ((), "--part: found none, but fixel needs one of part-1, part-2"),
    (("--part", "part-9"), "a part without experiments needs its scene file"),
    (("--part", "surprise=1"), "--part is 'surprise', but must be one of"),
    (("--part", "part-4", "--out", "next.txt"), "a plan file: .yaml"),
    (("--part", "part-4", "--travel-mm", "-3"), "--travel-mm"),
    (("--part", "part-4", "--where", "surface=ice"), "ice"),
    (("--part", "part-4", "--radius-mm", "0"), "--radius-mm"),
])  # fmt: skip
def test_bad_input_is_one_sentence(capsys, project, words, message):
    assert message in refusal(capsys, "next", "-p", project.folder, *words)


def test_experiments_whose_conditions_name_no_surface_are_used(capsys, tmp_path):
    pushes = [
        replace(own, conditions={"part": own.conditions["part"]}) for own in example_parts(3, 6)
    ]
    lab = project_of(tmp_path / "lab", pushes).folder
    text = output(capsys, "next", "-p", lab, "--part", "part-3", "--contacts", 4, "-n", 2)
    assert "Next pushes of part-3, after 6 pushes" in text
    assert "learned from 12 pushes of 2 parts" in text
    other = refusal(capsys, "next", "-p", lab, "--part", "part-3", "--surface", "abs")
    assert "--surface is 'abs', but must be a known name; there is none" in other


@pytest.mark.parametrize("part", ["part-1", "part=part-1"])
def test_square_pushers_and_no_missing_name_are_the_reason(capsys, tmp_path, part):
    square, drive = Polygon.regular(4, 0.02), LineDrive(speed=0.01)
    tip = Pusher(name="tip", shape=square, friction=0.2, pose=(-0.2, 0, 0), drive=drive)
    pushes = [replace(own, scene=replace(own.scene, pushers=(tip,))) for own in example_parts(2, 2)]
    lab = project_of(tmp_path / "lab", pushes).folder
    assert "4 with a pusher that is not round" in refusal(capsys, "next", "-p", lab, "--part", part)


def test_ctrl_c_leaves_no_half_written_file(capsys, project, tmp_path, monkeypatch):
    from fixel.parts.model import PartModel

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(PartModel, "next_pushes", interrupted)
    before = sorted((project.folder / "analyses").glob("*"))
    out = tmp_path / "next.yaml"
    words = ["next", "-p", project.folder, "--part", "part-4", "--out", out]
    assert fixel(capsys, *words)[0] == 130
    assert not out.exists()
    assert sorted((project.folder / "analyses").glob("*")) == before
