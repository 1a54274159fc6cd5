"""`fixel track`, as it is typed."""

import json

from tests.cli.shell import fixel, output, refusal
from tests.workflows.acquisition.test_track import scene

from fixel.formats.rig_file import save_rig
from fixel.formats.scene_file import SceneFile, save_scene
from fixel.formats.video_file import VideoWriter
from fixel.testing.tracking_contract import painted, tag_rig


def test_a_film_is_tracked_and_the_next_command_named(tmp_path, capsys):
    painter = painted(tag_rig())
    save_rig(painter.rig, tmp_path / "rig.yaml")
    save_scene(SceneFile(scene=scene()), tmp_path / "scene.yaml")
    film = tmp_path / "push.mp4"
    with VideoWriter(film, (320, 240), note="SIMULATED by a test") as writer:
        for k in range(4):
            writer.write(painter.frame(k / 30.0))
    printed = output(capsys, "track", film, "--dry-run")
    assert "residual [px]" in printed
    assert "SIMULATED" in printed
    assert f"Next: fixel track {film}\n" in printed
    rig = tmp_path / "rig.yaml"
    _, printed, _ = fixel(capsys, "track", film, "--dry-run", "--rig", rig, "--method", "tags")
    assert f"Next: fixel track {film} --rig {rig} --method tags\n" in printed
    _, printed, _ = fixel(capsys, "track", film, "--dry-run", "--json")
    answer = json.loads(printed)
    assert answer["parts"]["object"]["frames"] == 4
    assert answer["id"] is None
    assert "the lens is calibrated" in refusal(
        capsys, "track", film, "--dry-run", "--rig", "thesis-tags"
    )
