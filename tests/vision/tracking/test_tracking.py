"""Tracking: the contract of all methods, and what only some of them must do."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.fixtures import refused

from fixel.errors import InvalidInput
from fixel.formats.rig_file import rig_of
from fixel.model import Trajectory, pose_error
from fixel.model.shape import placed
from fixel.testing.scenes import micro_push
from fixel.testing.tracking_contract import (
    PAINT,
    TrackingContract,
    as_seen,
    camera,
    moving,
    painted,
    row,
    tag_rig,
)
from fixel.vision.camera import Camera
from fixel.vision.frame import Frame
from fixel.vision.marks import MarkedPart, Rig, Sticker, Tag
from fixel.vision.render import film_scene, looks_named
from fixel.vision.tracking import Stickers, Tags, track


def sticker_rig():
    """Create a rig with one part with two stickers of 12 mm, and one with two of 10 mm."""
    return Rig(
        name="small",
        camera=camera(),
        parts={
            "object": MarkedPart(
                height=0.0254,
                marks=(
                    Sticker(colour="red", diameter=0.012, place=row(-0.02, 0.0), height=0.0255),
                    Sticker(colour="blue", diameter=0.012, place=row(0.02, 0.003), height=0.0255),
                ),
            ),
            "actuator": MarkedPart(
                height=0.03,
                marks=(
                    Sticker(colour="green", diameter=0.01, place=row(-0.01, -0.008), height=0.0301),
                    Sticker(colour="yellow", diameter=0.01, place=row(0.01, 0.008), height=0.0301),
                ),
            ),
        },
    )


@pytest.mark.system
class TestTags(TrackingContract):
    @pytest.fixture
    def tracking(self):
        return Tags()

    @pytest.fixture
    def painter(self):
        return painted(tag_rig())

    @pytest.mark.parametrize(
        ("seen", "message"), [(np.fliplr, "mirrored"), (np.rot90, "turned by 90 degrees")]
    )
    def test_mirrored_and_turned_pictures_are_refused(self, painter, seen, message):
        with pytest.raises(InvalidInput, match=message):
            track([Frame(0.0, seen(painter.frame(0.0).picture).copy())], painter.rig)

    @pytest.mark.parametrize(("change", "message"), [
        ({"size": 0.034}, "mm in the picture"),
        ({"family": "aruco-5x5-100"}, "apriltag-36h11 tags 1, 2"),
    ])  # fmt: skip
    def test_tags_of_another_size_or_family_are_refused(self, painter, change, message):
        part = painter.rig.parts["object"]
        other = replace(part, marks=(replace(part.marks[0], **change),))
        others = {} if "family" in change else painter.rig.parts
        with pytest.raises(InvalidInput, match=message):
            track([painter.frame(0.0)], replace(painter.rig, parts={**others, "object": other}))

    def test_a_tag_that_is_there_twice_is_refused(self, painter):
        picture = painter.picture(moving(0.0))
        u, _ = painter.rig.camera.project_at(moving(0.0)["object"][:2], 0.0255).astype(int)
        picture[:, 10:110] = picture[:, u - 50 : u + 50]
        frames = [Frame(k / 30.0, as_seen(picture)) for k in range(12)]
        refused(track, frames, painter.rig, match="tag 1 is in the picture 2 times")

    @pytest.mark.parametrize("side", range(4))
    def test_half_a_tag_is_enough(self, painter, side):
        """As long as two of its sides show that meet, and it was seen a moment ago."""
        frames = [painter.frame(k / 30.0) for k in range(2)]
        for k in (2, 3):
            poses = moving(k / 30.0)
            picture = painter.picture(poses)
            middle = placed(painter.rig.parts["object"].marks[0].pose[:2], poses["object"])
            c = painter.rig.camera.project_at(middle, 0.0255)
            v, u = np.mgrid[0 : picture.shape[0], 0 : picture.shape[1]]
            across = 0.5 * np.pi * side - poses["object"][2]
            picture[(u - c[0]) * np.cos(across) + (v - c[1]) * np.sin(across) > 1.0] = 120.0
            frames.append(Frame(k / 30.0, as_seen(picture, seed=k)))
        part = track(frames, painter.rig).parts["object"]
        assert part.good.all()
        position, angle = pose_error(part.pose, [moving(f.time)["object"] for f in frames])
        assert position.max() < 0.1e-3
        assert angle.max() < 0.004
        assert (part.sd[2:, 0] > part.sd[:2, 0].max()).all()


@pytest.mark.system
class TestStickers(TrackingContract):
    @pytest.fixture
    def tracking(self):
        return Stickers()

    @pytest.fixture
    def painter(self):
        return painted(sticker_rig())

    def test_two_things_of_one_colour_are_refused(self, painter):
        picture = painter.picture(moving(0.0))
        v, u = np.mgrid[0 : picture.shape[0], 0 : picture.shape[1]]
        picture[np.hypot(u - 60, v - 200) < 11.0] = PAINT["red"]
        frames = [Frame(k / 30.0, as_seen(picture)) for k in range(12)]
        refused(track, frames, painter.rig, match="2 regions of the colour")


class TestPlate:
    """Tags on the plate tell whether the camera is where it was."""

    @pytest.fixture
    def painter(self):
        return painted(tag_rig(plate=True))

    def _moved(self, rig, shift):
        camera = rig.camera
        moved = Camera(
            lens=camera.lens,
            rotation=camera.rotation,
            translation=camera.translation + camera.rotation @ [*shift, 0.0],
        )
        return replace(rig, camera=moved)

    def test_in_place_it_is_tracked(self, painter):
        assert track([painter.frame(0.0)], painter.rig).remarks == ()

    def test_a_camera_that_was_moved_is_refused(self, painter):
        frame = painter.frame(0.0)
        rig = self._moved(painter.rig, (0.004, -0.002))
        refused(track, [frame], rig, match="was moved")
        refused(track, [frame], rig, register=True, match="at least 3 tags")

    def test_a_camera_that_was_moved_is_registered(self):
        """Moved by 3 mm and turned by a degree: values, and poses are those of the plate again."""
        rig = tag_rig(plate=True)
        corners = [(-0.063, 0.034), (0.066, 0.038), (0.066, -0.042), (-0.06, -0.055)]
        rig = replace(
            rig,
            plate=tuple(
                Tag(id=20 + k, size=0.024, pose=(*place, 0.1 * k), height=0.0)
                for k, place in enumerate(corners)
            ),
        )
        painter = painted(rig)
        camera, turn = rig.camera, Rotation.from_rotvec([0.004, -0.003, 0.017]).as_matrix()
        moved = Camera(
            lens=camera.lens,
            rotation=camera.rotation @ turn,
            translation=camera.translation + np.array([0.003, -0.001, 0.002]),
        )
        frames = [painter.frame(k / 30.0) for k in range(3)]
        refused(track, frames, replace(rig, camera=moved), match="--register")
        tracked = track(frames, replace(rig, camera=moved), register=True)
        assert "estimated again" in tracked.remarks[0]
        for name, part in tracked.parts.items():
            position, angle = pose_error(part.pose, [moving(t)[name] for t in tracked.time])
            assert part.good.all()
            assert position.max() < 0.3e-3
            assert angle.max() < 0.003

    @pytest.mark.parametrize("by", [4, 40])
    def test_what_is_seen_after_a_bump_is_not_believed(self, painter, by):
        """The plate is looked at in every fifteenth frame, and in the last."""
        still, bumped = painter.picture(moving(0.0)), painter.picture(moving(0.0))
        bumped[by:] = still[:-by]
        frames = [Frame(k / 30.0, as_seen(bumped if k > 19 else still)) for k in range(24)]
        tracked = track(frames, painter.rig)
        (remark,) = tracked.remarks
        assert "moved during the film" in remark
        assert "0.77 s" in remark
        for part in tracked.parts.values():
            assert np.flatnonzero(part.good).tolist() == list(range(16))
            assert "was moved" in part.reason[17]

    def test_a_tag_of_the_plate_that_is_covered_tells_nothing(self, painter):
        picture = painter.picture(moving(0.0))
        u, v = painter.rig.camera.project_at(painter.rig.plate[1].pose[:2], 0.0).astype(int)
        picture[v - 24 : v + 6, u - 24 : u + 24] = 35.0
        assert track([Frame(0.0, as_seen(picture))], painter.rig).remarks == ()
        u, v = painter.rig.camera.project_at(painter.rig.plate[0].pose[:2], 0.0).astype(int)
        picture[v - 25 : v + 25, u - 25 : u + 25] = 120.0
        tracked = track([Frame(0.0, as_seen(picture))], painter.rig)
        assert "motion of the camera cannot be detected" in tracked.remarks[0]

    def test_half_a_turn_is_named(self, painter):
        turned = painter.frame(0.0).picture[::-1, ::-1].copy()
        refused(track, [Frame(0.0, turned)], painter.rig, match=r"180 degrees|was moved")


def test_the_microscope_scene():
    scene, rig = micro_push(), rig_of("microscope")
    time = np.arange(5) / 30.0  # what moves before and after is in the exposures too
    part = np.array([[1e-5 * k, -2e-5 * k, 0.01 * k] for k in range(5)])
    probe = scene.pushers[0].pose + [[1e-5 * k - 9e-5, 0.0, 0.0] for k in range(5)]
    motion = {"part": Trajectory(time=time, pose=part), "probe": Trajectory(time=time, pose=probe)}
    frames = film_scene(scene, motion, rig, looks_named("microscope"), time[1:4], 1)
    tracked = track(frames, rig, scene)
    assert tracked.parts["part"].pose[:, :2] == pytest.approx(part[1:4, :2], abs=0.3e-6)
    assert tracked.parts["part"].pose[:, 2] == pytest.approx(part[1:4, 2], abs=2e-4)
    assert tracked.parts["probe"].pose[:, :2] == pytest.approx(probe[1:4, :2], abs=1e-6)


def test_the_tab_of_a_fast_part_is_not_taken_for_its_side():
    """It moves by the length of its tab from one frame to the next."""
    scene, rig = micro_push(), rig_of("microscope")
    time = np.arange(6) / 30.0
    part = np.array([[0.0, 53e-6 * k, 0.0] for k in range(6)])
    motion = {
        "part": Trajectory(time=time, pose=part),
        "probe": Trajectory(time=time, pose=np.tile(scene.pushers[0].pose, (6, 1))),
    }
    looks = replace(looks_named("microscope"), exposure=0.0)
    tracked = track(film_scene(scene, motion, rig, looks, time, 1), rig, scene).parts["part"]
    assert tracked.good.sum() > 3
    off = np.hypot(*(tracked.pose - part)[tracked.good, :2].T)
    assert off.max() < 1e-6


def test_unknown_methods_are_refused():
    rig = tag_rig((96, 72))
    frame = Frame(0.0, np.zeros((72, 96, 3), np.uint8))
    refused(track, [frame], rig, method="guess", match="auto, tags")
    for method in ("stickers", "silhouette"):
        refused(track, [frame], rig, method=method, match=f"for {method}, ")
    bare = replace(rig, parts={name: MarkedPart(height=0.02) for name in rig.parts})
    refused(track, [frame], bare, match=r"for tags, .* for stickers, .* for silhouette, ")
    refused(track, [], rig, match="no frames")


def test_tags_that_the_rig_does_not_have_are_named():
    rig = tag_rig()
    poses = {"object": np.zeros(3), "actuator": np.array([-0.06, -0.04, 0.0])}
    frame = Frame(0.0, as_seen(painted(rig).picture(poses), seed=1))
    part = rig.parts["object"]
    marks = [replace(mark, id=mark.id + 100) for mark in part.marks]
    other = replace(rig, parts=rig.parts | {"object": replace(part, marks=marks)})
    seen = ", ".join(str(mark.id) for mark in part.marks)
    problem = refused(track, [frame], other, match="in none of 1 frames")
    assert f"the first frame shows {part.marks[0].family} tag" in str(problem)
    assert f"{seen}, but" in str(problem)


def test_the_width_of_a_tag_written_in_metres_is_named():
    rig = tag_rig()
    poses = {"object": np.zeros(3), "actuator": np.array([-0.06, -0.04, 0.0])}
    frame = Frame(0.0, as_seen(painted(rig).picture(poses), seed=1))
    part = rig.parts["object"]
    marks = [replace(mark, size=mark.size / 1e3) for mark in part.marks]
    other = replace(rig, parts=rig.parts | {"object": replace(part, marks=marks)})
    refused(track, [frame], other, match=rf"needs {part.marks[0].size:g} mm, as in the rig file")


@pytest.mark.system
def test_a_part_that_was_pushed_on_while_covered_is_seen_at_once():
    """A hand over the object for 0.7 s, in which it goes 50 mm at 75 mm/s."""
    painter = painted(tag_rig())
    frames = []
    for k in range(34):
        poses = {
            "object": np.array([-0.035 + 0.0025 * max(k - 4, 0), 0.0, 0.1]),
            "actuator": np.array([-0.06, -0.04, 0.0]),
        }
        covered = 5 <= k < 26
        shown = {"actuator": poses["actuator"]} if covered else poses
        frames.append(Frame(k / 30.0, as_seen(painter.picture(shown), seed=k)))
    part = track(frames, painter.rig).parts["object"]
    assert not part.good[5:26].any()
    assert part.good[28:].all()  # two frames later at most
