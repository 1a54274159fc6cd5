"""Distances of parts from the places that a scene wants."""

import math
import re
import threading
import time
from dataclasses import replace

import cv2
import numpy as np
import pytest
from tests.testbed.films import Pictures
from tests.vision.plate import plate_picture, small_rig

from fixel.errors import InvalidInput
from fixel.formats.recording_video import jpeg_of
from fixel.model import Disk, Fixel
from fixel.testbed.frame_source import CameraPicture, FrameSource, Stream
from fixel.testing.scenes import grasp
from fixel.vision.camera import Camera
from fixel.vision.frame import Frame
from fixel.workflows.acquisition.overlay import (
    Overlay,
    Tolerance,
    draw_look,
    frames_of,
    watch,
    write_png,
)

RIG = small_rig()
WANTED = (0.11, -0.01, 0.35)
TOLERANCE = Tolerance(distance=1e-3, angle=math.radians(1.0))
PEG = (0.24, 0.07, 0.0)
GRASP = grasp()
SCENE = replace(
    GRASP,
    bodies=(replace(GRASP.bodies[0], pose=WANTED),),
    fixels=(Fixel(name="fixel-1", shape=Disk(0.00476), pose=PEG, friction=0.2),),
)
AT_HOME = {"object": WANTED, "actuator": (0.0, 0.0, 0.0)}


def frame(picture, time=0.0):
    return Frame(time, picture)


def look_at(poses, rig=RIG, seen_by=None):
    return Overlay(rig, SCENE, TOLERANCE).look(frame(plate_picture(seen_by or rig, poses)))


def test_everything_in_place():
    look = look_at(AT_HOME)
    assert look.placed
    assert look.state == "placed"
    assert look.sentence == "In place"
    assert [part["name"] for part in look.summary()["parts"]] == ["object", "actuator"]


def test_errors_are_measured_less_wanted():
    look = look_at(AT_HOME | {"object": (0.116, -0.013, 0.35 + math.radians(4.0))})
    assert look.state == "off"
    (part, actuator) = look.summary()["parts"]
    assert part["dx_mm"] == pytest.approx(6.0, abs=0.1)
    assert part["dy_mm"] == pytest.approx(-3.0, abs=0.1)
    assert part["angle_deg"] == pytest.approx(4.0, abs=0.3)
    assert part["distance_mm"] == pytest.approx(6.7, abs=0.1)
    assert actuator["within"]
    assert "push 6." in look.sentence
    assert "clockwise" in look.sentence
    assert "counter" not in look.sentence


def test_the_push_points_home_in_the_picture():
    """The camera is turned by 0.05 rad, so the world's x is not quite the picture's right."""
    look = look_at(AT_HOME | {"object": (0.10, -0.01, 0.35)})
    (part, _) = look.summary()["parts"]
    home, here = RIG.camera.project_at([WANTED[:2], (0.10, -0.01)], 0.0254)
    right, down = home - here
    assert part["push_screen_deg"] == pytest.approx(math.degrees(math.atan2(down, right)), abs=3.0)


def test_an_actuator_off_its_start_is_no_start():
    look = look_at(AT_HOME | {"actuator": (0.004, 0.0, 0.0)})
    assert look.state == "off"
    assert look.sentence.startswith("actuator: push")


def test_angles_go_the_short_way_round():
    scene = replace(SCENE, bodies=(replace(SCENE.bodies[0], pose=(0.11, -0.01, 3.1)),))
    picture = plate_picture(RIG, AT_HOME | {"object": (0.11, -0.01, -3.1)})
    part = Overlay(RIG, scene, TOLERANCE).look(frame(picture)).summary()["parts"][0]
    assert part["angle_deg"] == pytest.approx(math.degrees(2 * math.pi - 6.2), abs=0.3)


def test_an_object_out_of_sight():
    look = look_at({"actuator": (0.0, 0.0, 0.0)})
    assert look.state == "not-seen"
    assert look.sentence == "object is not seen"
    part = look.summary()["parts"][0]
    assert part["seen"] is False
    assert part["dx_mm"] is None
    assert part["push_screen_deg"] is None


def test_a_spoilt_picture_is_passed_over():
    jpeg = jpeg_of(plate_picture(RIG, AT_HOME))
    source = Pictures(3, lambda k: jpeg if k != 1 else jpeg[:4] + jpeg[-2:])
    source.open()
    assert len(list(frames_of(source, live=False))) == 2


def test_a_camera_that_moved_is_distinguished_from_a_part_that_did():
    camera = RIG.camera
    moved = Camera.looking_down(camera.lens, 0.516, above=(0.125, 0.01), turned=0.05)
    look = look_at(AT_HOME, seen_by=small_rig(camera=moved))
    assert look.state == "trouble"
    assert "was moved" in look.problems[0]
    assert "mm" in look.problems[0]


def test_plate_tags_out_of_sight_are_a_remark():
    look = look_at(AT_HOME, seen_by=small_rig(plate=()))
    assert look.placed
    assert "No tag on the plate" in look.remarks[0]


@pytest.mark.parametrize(
    ("shape", "words"), [((480, 640), "640 x 480"), ((640, 360), "by 90 degrees")]
)
def test_another_resolution_is_refused_with_both(shape, words):
    look = Overlay(RIG, SCENE, TOLERANCE).look(frame(np.zeros((*shape, 3), np.uint8)))
    assert look.state == "trouble"
    assert words in look.problems[0]
    assert "640 x 360" in look.problems[0]


def test_a_mirrored_picture():
    overlay = Overlay(RIG, SCENE, TOLERANCE)
    mirrored = np.ascontiguousarray(plate_picture(RIG, AT_HOME)[:, ::-1])
    for k in range(3):
        assert "mirror" in overlay.look(frame(mirrored, 0.1 * k)).problems[0]
    # What was not found for a while is looked for in every fourth frame.
    right = plate_picture(RIG, AT_HOME)
    assert any([overlay.look(frame(right, 1.0 + 0.1 * k)).placed for k in range(4)])
    empty = np.full((360, 640, 3), 90, dtype=np.uint8)
    assert overlay.look(frame(empty, 2.0)).state == "not-seen"


def test_a_picture_turned_by_half_a_turn():
    turned = np.ascontiguousarray(plate_picture(RIG, AT_HOME)[::-1, ::-1])
    assert Overlay(RIG, SCENE, TOLERANCE).look(frame(turned)).state == "trouble"


def test_a_rig_that_knows_none_of_the_parts():
    rig = small_rig(parts={"probe": RIG.parts["object"]})
    with pytest.raises(InvalidInput, match=r"found probe, but fixel needs .*object, actuator"):
        Overlay(rig, SCENE)


def test_the_rig_says_how_well_to_place():
    overlay = Overlay(small_rig(position_tolerance=3e-3), SCENE)
    assert overlay.tolerance.distance == 3e-3
    assert overlay.tolerance.angle == RIG.angle_tolerance


@pytest.mark.parametrize(("mm", "words"), [(1.0, r"push \d\.\d mm"), (0.02, r"push \d\.\d\d mm")])
def test_digits_are_those_of_the_tolerance(mm, words):
    fine = Tolerance(distance=1e-3 * mm, angle=1.0)
    picture = plate_picture(RIG, AT_HOME | {"object": (0.116, -0.01, 0.35)})
    assert re.search(words, Overlay(RIG, SCENE, fine).look(frame(picture)).sentence)


@pytest.mark.parametrize("poses", [AT_HOME, AT_HOME | {"object": (0.12, 0.0, 0.3)}, {}])
def test_drawing_leaves_the_picture_alone(poses):
    picture = plate_picture(RIG, poses)
    before = picture.copy()
    overlay = Overlay(RIG, SCENE, TOLERANCE)
    look = overlay.look(frame(picture))
    drawn = draw_look(picture, look, words=True)
    np.testing.assert_array_equal(picture, before)
    assert (drawn != picture).any()


def test_outlines_stand_where_the_part_stands():
    """The upper outline of a placed part runs through its projected corners."""
    picture = plate_picture(RIG, AT_HOME)
    overlay = Overlay(RIG, SCENE, TOLERANCE)
    drawn = draw_look(picture, overlay.look(frame(picture)))
    changed = np.abs(drawn.astype(int) - picture).max(axis=2) > 60
    c, s = math.cos(0.35), math.sin(0.35)
    corners = SCENE.bodies[0].shape.outline @ np.array([[c, s], [-s, c]]) + WANTED[:2]
    for u, v in np.round(RIG.camera.project_at(corners, 0.0254)).astype(int):
        assert changed[v - 1 : v + 2, u - 1 : u + 2].any()


def test_watching_shows_every_frame():
    pictures = [plate_picture(RIG, AT_HOME | {"object": (0.11 + dx, -0.01, 0.35)})
                for dx in (0.01, 0.005, 0.0)]  # fmt: skip
    shown = []
    frames = (Frame(0.1 * k, picture) for k, picture in enumerate(pictures))
    overlay = Overlay(RIG, SCENE, TOLERANCE)
    *_, last = watch(overlay, frames, lambda draw, status: shown.append(status))
    assert [status["state"] for status in shown] == ["off", "off", "placed"]
    errors = [status["parts"][0]["distance_mm"] for status in shown]
    assert errors == sorted(errors, reverse=True)
    assert last.placed


class Hangs(FrameSource):
    """A camera whose driver never comes back with the second picture."""

    name = "hangs"

    def __init__(self):
        self.closed = threading.Event()

    def open(self):
        return Stream((640, 360), 30.0, jpeg=False, live=True)

    def frames(self):
        yield CameraPicture(0.0, pixels=np.zeros((360, 640, 3), np.uint8))
        self.closed.wait(120.0)

    def close(self):
        self.closed.set()


def test_a_camera_that_hangs_ends_the_pictures(monkeypatch):
    monkeypatch.setattr("fixel.workflows.acquisition.overlay.SILENT", 0.3)
    source, values = Hangs(), []
    begun = time.monotonic()
    assert len(list(frames_of(source, True, values.append))) == 1
    assert time.monotonic() - begun < 60.0
    assert values == ["the camera has sent nothing for 0.3 s"]
    assert source.closed.is_set()


def test_a_picture_is_written_as_it_is(tmp_path):
    picture = np.random.default_rng(0).integers(0, 255, (12, 20, 3), dtype=np.uint8)
    write_png(tmp_path / "a.png", picture)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "a.png")), picture)


def about(pose, inner):
    """Pose in the world of an inner pose of a frame with a pose."""
    x, y, angle = pose
    c, s = math.cos(angle), math.sin(angle)
    return (x + c * inner[0] - s * inner[1], y + s * inner[0] + c * inner[1], angle + inner[2])


SHIFTED = (0.012, 0.008, math.radians(6.0))


def anchored_looks(poses, n=6, anchor="actuator"):
    """Looks at equal pictures of parts, and a fixel, whose poses are those of an inner frame."""
    there = {name: about(SHIFTED, pose) for name, pose in poses.items()}
    tops = [(about(SHIFTED, PEG)[:2], 0.00476)]
    overlay = Overlay(RIG, SCENE, TOLERANCE, anchor=anchor)
    picture = plate_picture(RIG, there, tops)
    return overlay, [overlay.look(frame(picture, 0.1 * k)) for k in range(n)]


def test_the_scene_is_anchored_where_the_actuator_is_seen():
    """Rotated and shifted together, the part and the fixel are in place for the actuator."""
    overlay, looks = anchored_looks(AT_HOME)

    assert looks[0].placed
    assert looks[-1].placed
    np.testing.assert_allclose(overlay.scene.bodies[0].pose, about(SHIFTED, WANTED), atol=5e-4)
    fixel = looks[-1].parts[2]
    assert fixel.measured is not None
    assert fixel.within
    (remark,) = looks[0].remarks
    assert "14.4 mm and 6." in remark or "14.5 mm and 6." in remark
    assert not anchored_looks(AT_HOME, 1, anchor="")[1][0].placed


def test_errors_of_an_anchored_scene_are_those_from_the_actuator():
    _, looks = anchored_looks(AT_HOME | {"object": (0.116, -0.01, 0.35)})
    part = looks[-1].summary()["parts"][0]

    assert part["dx_mm"] == pytest.approx(6.0 * math.cos(SHIFTED[2]), abs=0.3)
    assert part["dy_mm"] == pytest.approx(6.0 * math.sin(SHIFTED[2]), abs=0.3)


def test_the_anchor_stays_where_it_was_seen_last():
    overlay, looks = anchored_looks({"object": WANTED}, 1)
    assert "has not been seen yet" in looks[0].remarks[0]
    assert overlay.scene == SCENE

    overlay, _ = anchored_looks(AT_HOME, 1)
    before = overlay.scene
    hidden = overlay.look(frame(plate_picture(RIG, {"object": about(SHIFTED, WANTED)}), 0.1))
    assert not hidden.placed
    assert overlay.scene == before
    assert hidden.parts[0].within
    assert overlay.look(frame(plate_picture(RIG, AT_HOME), 0.6)).placed


def test_an_anchor_must_be_measurable():
    for name in ("fixel-1", "actuater"):
        with pytest.raises(InvalidInput, match=r"anchor is .* must be one of object, actuator"):
            Overlay(RIG, SCENE, TOLERANCE, anchor=name)
