"""`fixel testbed film`, as a person and as a program."""

import pytest
from tests.cli.shell import json_of, output, refusal
from tests.vision.rendered import small_rig

from fixel.formats.rig_file import save_rig
from fixel.formats.scene_file import SceneFile, save_scene
from fixel.testing.scenes import grasp, sliding_block


@pytest.fixture
def files(tmp_path):
    save_rig(small_rig(size=(160, 120)), tmp_path / "rig.yaml")
    save_scene(SceneFile(scene=grasp()), tmp_path / "push.yaml")
    return tmp_path


def test_five_frames_of_a_scene(capsys, files):
    out = files / "film"
    said = output(
        capsys, "testbed", "film", files / "push.yaml", "--rig", files / "rig.yaml",
        "--frames", 5, "--out", out,
    )  # fmt: skip
    assert said.splitlines()[0].split() == [
        "film", "frames", "time", "[s]", "simulation", "recording",
    ]  # fmt: skip
    assert said.splitlines()[1].split()[:2] == ["push", "5"]
    assert said.splitlines()[-1] == f"Next: fixel track {out}"
    assert (out / "recording.json").is_file()


def test_the_answer_as_json(capsys, files):
    answer = json_of(
        capsys, "testbed", "film", files / "push.yaml", "--rig", files / "rig.yaml",
        "--frames", 2, "--looks", "clean", "--out", files / "film",
    )  # fmt: skip
    (one,) = answer["films"]
    assert (one["name"], one["frames"], one["video"]) == ("push", 2, None)


@pytest.mark.parametrize(
    ("change", "where"),
    [("bulr=1", "--set"), ("blur=much", "--set blur"), ("dropped=1.5", "--set dropped")],
)
def test_values_of_looks_are_refused_by_their_option(capsys, change, where):
    said = refusal(capsys, "testbed", "film", "push.yaml", "--set", change)
    assert said.startswith(f"fixel: {where}")


def test_looks_that_do_not_exist_are_bad_input(capsys, files):
    err = refusal(
        capsys, "testbed", "film", files / "push.yaml", "--looks", "herd", "--out", files / "film"
    )
    assert "did you mean 'hard'?" in err


def test_what_carries_no_mark_is_said(capsys, files):
    save_scene(SceneFile(scene=sliding_block()), files / "block.yaml")
    said = output(
        capsys, "testbed", "film", files / "block.yaml", "--rig", files / "rig.yaml",
        "--frames", 2, "--out", files / "film",
    )  # fmt: skip
    assert "rendered without markers, since the rig has none for them: block" in said
