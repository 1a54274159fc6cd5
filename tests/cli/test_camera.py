"""`fixel camera` from the shell: a day with a camera."""

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
from benchmarks.board_pictures import Studio, seen_corners, spread
from tests.cli.shell import fixel, json_of, output, refusal
from tests.formats.test_camera_import import CALIB_RESULTS, ROS

from fixel.formats.rig_file import load_camera
from fixel.vision.calibrate_lens import calibrate_lens
from fixel.vision.camera import Camera
from fixel.vision.lens import Lens
from fixel.vision.marks import Corners, board_of
from fixel.workflows.acquisition.camera.report import CameraAnswer

BOARD = "charuco:7x5:30mm:20mm"
LENS = Lens(image_size=(480, 360), focal=(440, 444), centre=(244, 177), distortion=(-0.12, 0.05))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Pictures of a board, and one of it flat on a plate."""
    path = tmp_path_factory.mktemp("pictures")
    studio = Studio(LENS, board_of(BOARD))
    (path / "boards").mkdir()
    for k, place in enumerate(spread(studio, 6, 0.3)):
        cv2.imwrite(str(path / "boards" / f"p{k}.png"), studio.picture(*place))
    true = Camera.looking_down(LENS, 0.4, above=(0.1, 0.07), turned=0.2, tilted=(0.04, -0.03))
    cv2.imwrite(str(path / "flat.png"), studio.picture(true.rotation, true.translation))
    return path


@pytest.fixture(scope="module")
def placed(folder):
    from typer.testing import CliRunner

    from fixel.cli.main import app

    shell = CliRunner()
    calibrated, done = folder / "camera.yaml", folder / "placed.yaml"
    first = shell.invoke(app, ["camera", "calibrate", str(folder / "boards"), "--board", BOARD,
                               "--out", str(calibrated)])  # fmt: skip
    assert first.exit_code == 0, first.output
    assert "Next: fixel camera place" in first.output
    second = shell.invoke(app, ["camera", "place", str(calibrated), str(folder / "flat.png"),
                                "--board", BOARD, "--out", str(done), "--at", "10,20,90",
                                "--plot", str(folder / "map.png")])  # fmt: skip
    assert second.exit_code == 0, second.output
    assert "95 %" in second.output
    assert "Next: " in second.output
    return done


def test_calibrate_says_it_in_json(capsys, folder, tmp_path):
    out = tmp_path / "camera.yaml"
    answer = json_of(
        capsys, "camera", "calibrate", folder / "boards", folder / "flat.png",
        "--board", BOARD, "--out", out, "--coefficients", 2,
    )  # fmt: skip
    assert len(answer["used"]) == 7
    assert answer["rms_px"] < 0.1
    assert abs(answer["focal_px"][0] - 440.0) < 4.0 * answer["standard_deviations"]["fx"]
    assert load_camera(out).lens.image_size == (480, 360)


def test_check_of_a_placed_camera(capsys, placed, folder):
    answer = json_of(
        capsys, "camera", "check", placed, "--video", folder / "flat.png",
        "--height-mm", 25.4,
    )  # fmt: skip
    assert answer["round_trip_px"] < 1e-6
    (verdict,) = answer["verdicts"]
    assert 1e-5 < verdict["typical_95_m"] < 1e-3
    assert "mm above the plate: " in verdict["sentence"]
    assert (folder / "map.png").exists()


def test_a_rig_with_this_camera(capsys, placed, tmp_path):
    shutil.copy(placed, tmp_path / "camera.yaml")
    (tmp_path / "rig.yaml").write_text("fixel_rig: 1\nname: mine\ncamera: camera.yaml\n")
    assert "Accuracy of positions" in output(capsys, "camera", "check", tmp_path / "rig.yaml")


def test_check_refuses_another_size(capsys, tmp_path):
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((360, 640, 3), np.uint8))
    err = refusal(capsys, "camera", "check", "thesis-tags", "--video", tmp_path / "small.png")
    assert "640 x 360" in err


def test_check_sees_that_the_camera_was_moved(capsys, tmp_path):
    from tests.vision.test_place_camera import tagged

    from fixel.formats.rig_file import rig_of, save_rig

    rig = rig_of("thesis-tags")
    save_rig(rig, tmp_path / "rig.yaml")
    moved = replace(rig.camera, translation=rig.camera.translation + np.array([0.003, 0.0, 0.0]))
    cv2.imwrite(str(tmp_path / "now.png"), tagged(moved, rig.plate))
    code, text, _ = fixel(
        capsys, "camera", "check", tmp_path / "rig.yaml", "--video", tmp_path / "now.png"
    )
    assert code == 1
    assert "the camera or the plate was moved" in text


def test_import_and_export(capsys, tmp_path):
    (tmp_path / "Calib_Results.m").write_text(CALIB_RESULTS)
    out = tmp_path / "camera.yaml"
    text = output(
        capsys, "camera", "import", tmp_path / "Calib_Results.m", "--out", out,
        "--size", "1280x720",
    )  # fmt: skip
    assert "skew 0.002" in text
    err = refusal(
        capsys, "camera", "export", out, "--out", tmp_path / "a.yml", "--format", "opencv"
    )
    assert "skew" in err
    (tmp_path / "ros.yaml").write_text(ROS)
    fixel(capsys, "camera", "import", tmp_path / "ros.yaml", "--out", out)
    output(capsys, "camera", "export", out, "--out", tmp_path / "again.yaml", "--format", "ros")
    fixel(capsys, "camera", "import", tmp_path / "again.yaml", "--out", tmp_path / "b.yaml")
    assert load_camera(out).lens == load_camera(tmp_path / "b.yaml").lens


def test_prints(capsys, tmp_path):
    assert "calibrate" in output(capsys, "camera", "board", "--out", tmp_path / "board.pdf")
    answer = json_of(capsys, "camera", "tags", "thesis-tags", "--out", tmp_path / "tags.pdf")
    assert answer["tags"] == 6
    assert (tmp_path / "tags.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(("arguments", "word"), [
    (("calibrate", "{}/boards"), "--board"),
    (("calibrate", "{}/boards", "--board", "charuco:7x5"), "charuco:7x5:30mm"),
    (("calibrate", "{}/flat.png", "--board", BOARD), "at least 4"),
    (("calibrate", "{}", "--board", "checkerboard:9x6:25mm"), "at least 4"),
    (("calibrate", "{}/boards", "--board", BOARD, "--out", "{}/a.txt"), ".yaml"),
    (("calibrate", "{}/none", "--board", BOARD, "--coefficients", "3"), "0, 1, 2, 4, 5, 8"),
    (("place", "{}/camera.yaml", "{}/flat.png"), "--board or --rig"),
    (("place", "{}/camera.yaml", "{}/flat.png", "--board", BOARD, "--at", "1,2"), "--at"),
    (("place", "{}/camera.yaml", "{}/flat.png", "--rig", "microscope"), "no tags"),
    (("place", "{}/camera.yaml", "{}/flat.png", "--rig", "thesis-tags"), "at least 2"),
    (("place", "{}/camera.yaml", "{}/camera.yaml", "--board", BOARD), "ending"),
    (("place", ".", "{}/flat.png", "--board", BOARD), "folder"),
    (("check", "nowhere.yaml"), "no such file or folder, but fixel needs a camera or rig file"),
    (("place", "nowhere.yaml", "a.png", "--rig", "thesis-tags"), "needs a camera file, in YAML"),
    (("import", "{}/flat.png"), "unknown format"),
    (("import", "{}/camera.yaml"), "already"),
    (("import", "{}/camera.yaml", "--size", "big"), "1280x720"),
    (("tags",), "neither a rig nor --ids"),
    (("tags", "--ids", "9-0"), "range"),
    (("tags", "--ids", "x"), "0-9"),
    (("tags", "thesis-stickers"), "no tags"),
    (("board", "charuco:9x6:40mm:30mm"), "--paper"),
    (("board", "--out", "{}/board.txt"), ".pdf"),
])  # fmt: skip
def test_bad_input_is_one_sentence(capsys, placed, folder, tmp_path, monkeypatch, arguments, word):
    monkeypatch.chdir(tmp_path)
    assert word in refusal(capsys, "camera", *(a.format(folder) for a in arguments))


def test_a_file_that_is_no_picture(capsys, placed, folder, tmp_path):
    for content in (b"", b"hello", b"\x89PNG\r\n\x1a\n" + b"\x00" * 40):
        (tmp_path / "a.png").write_bytes(content)
        err = refusal(capsys, "camera", "place", placed, tmp_path / "a.png", "--board", BOARD)
        assert "not a picture" in err


def test_tags_of_the_plate_are_used_before_a_board_and_the_board_instead_of_none(
    capsys, placed, folder, tmp_path
):
    from tests.vision.test_place_camera import tagged

    from fixel.formats.rig_file import rig_dict, rig_of
    from fixel.io.document import yaml_text
    from fixel.vision.marks import Tag

    true = Camera.looking_down(LENS, 0.4, above=(0.1, 0.07), turned=0.2, tilted=(0.04, -0.03))
    tags = [Tag(id=k, size=0.02, pose=(0.06 + 0.09 * (k % 2), 0.04 + 0.07 * (k // 2), 0.0),
                height=0.0) for k in range(4)]  # fmt: skip
    content = rig_dict(rig_of("thesis-tags"))
    content |= {"camera": "later.yaml", "plate": [
        {"id": t.id, "size_mm": 20.0, "pose_mm_deg": [float(1e3 * n) for n in t.pose],
         "height_mm": 0.0} for t in tags]}  # fmt: skip
    (tmp_path / "rig.yaml").write_text(yaml_text(content))
    cv2.imwrite(str(tmp_path / "plate.png"), tagged(true, tuple(tags)))
    shutil.copy(folder / "flat.png", tmp_path / "flat.png")
    # No rig is named: the one next to the picture is taken.
    for name, words in (("plate.png", "placed by the tags"), ("flat.png", "placed by the board")):
        text = output(
            capsys, "camera", "place", placed, tmp_path / name, "--board", BOARD,
            "--out", tmp_path / "done.yaml",
        )  # fmt: skip
        assert words in text
        found = load_camera(tmp_path / "done.yaml").placed()
        assert np.abs(found.position - true.position).max() < 2e-3


def test_a_picture_that_is_used_in_part_is_not_left_out():
    """One corner of a board is off by 1 px: it is left out, and its picture is not."""
    views = list(seen_corners(LENS, board_of("checkerboard:8x5:25mm"), 8, noise=0.05))
    pixels = views[5].corners.pixels.copy()
    pixels[7] += 0.8
    views[5] = views[5]._replace(corners=Corners(views[5].corners.places, pixels))
    found = calibrate_lens(views, coefficients=4)
    answer = CameraAnswer(camera=found.camera, calibration=found)
    text = "\n".join(answer.analysis().lines())
    assert "8 pictures used" in text
    assert "left out (" not in text
    assert "used in part (1):" in text
    summary = answer.summary()
    assert summary["dropped"] == []
    assert [each["name"] for each in summary["used_in_part"]] == [views[5].name]
