"""Contract of tracking methods, as a test suite to inherit from.

Subclass it, override its two fixtures, and pytest runs the suite on your method:

    class TestMyTracking(TrackingContract):
        @pytest.fixture
        def tracking(self):
            return MyTracking()

        @pytest.fixture
        def painter(self):
            return painted(tag_rig())
"""

from __future__ import annotations

import functools
from collections.abc import Mapping

import numpy as np
import pytest

from fixel.model import pose_error
from fixel.testing.scenes import row
from fixel.typing import FloatArray
from fixel.vision.camera import Camera
from fixel.vision.frame import Frame, Picture, opencv
from fixel.vision.lens import Lens
from fixel.vision.marks import MarkedPart, Rig, Sticker, Tag, cells
from fixel.vision.tracking.base import AbstractTracking
from fixel.vision.tracking.follow import track

POSITION, ANGLE = 0.15e-3, 0.0026  # [m], [rad], accuracy required for the thesis's testbed
FRAMES = 6
RATE = 30.0  # [Hz]


class TrackingContract:
    """Tests of a tracking method: a film with known poses, and pictures it must reject."""

    @pytest.fixture
    def tracking(self) -> AbstractTracking:
        """Tracking method under test."""
        raise NotImplementedError

    @pytest.fixture
    def painter(self) -> Painter:
        """Painter of a rig that the method can track."""
        raise NotImplementedError

    def _film(self, painter: Painter, n: int = FRAMES) -> list[Frame]:
        return [painter.frame(k / RATE) for k in range(n)]

    def test_poses_are_those_of_the_film(
        self, tracking: AbstractTracking, painter: Painter
    ) -> None:
        tracked = track(self._film(painter), painter.rig, method=tracking)
        for name, part in tracked.parts.items():
            assert part.good.all()
            truth = [moving(time)[name] for time in tracked.time]
            position, angle = pose_error(part.pose, truth)
            assert np.sqrt(np.mean(position**2)) < POSITION
            assert np.sqrt(np.mean(angle**2)) < ANGLE
            assert (position < 6.0 * np.hypot(*part.sd.T[:2]) + 0.02e-3).all()

    def test_light_does_not_matter(self, tracking: AbstractTracking, painter: Painter) -> None:
        frames = []
        for k in range(FRAMES):
            picture = painter.picture(moving(k / RATE)) * (1.0 - 0.3 * k / FRAMES)
            frames.append(Frame(k / RATE, as_seen(picture, seed=k)))
        tracked = track(frames, painter.rig, method=tracking)
        for name, part in tracked.parts.items():
            position, _ = pose_error(part.pose, [moving(time)[name] for time in tracked.time])
            assert part.good.all()
            assert position.max() < 2.0 * POSITION

    def test_a_camera_of_another_response(
        self, tracking: AbstractTracking, painter: Painter
    ) -> None:
        """Webcams have a nonlinear response (half of the light is about 3/4 of white) and blur."""
        frames = []
        for k in range(FRAMES):
            sharp = painter.picture(moving(k / RATE))
            light = opencv().GaussianBlur(sharp, (0, 0), 1.2)
            frames.append(Frame(k / RATE, as_seen(255.0 * (light / 255.0) ** (1.0 / 2.2), seed=k)))
        tracked = track(frames, painter.rig, method=tracking)
        for name, part in tracked.parts.items():
            position, _ = pose_error(part.pose, [moving(time)[name] for time in tracked.time])
            assert part.good.all()
            assert position.max() < 2.0 * POSITION
            assert part.residual.max() < 0.4

    def test_what_does_not_show_is_a_gap_with_a_reason(
        self, tracking: AbstractTracking, painter: Painter
    ) -> None:
        frames = self._film(painter)
        plain = as_seen(painter.picture({}, plain=True))
        frames[3] = Frame(frames[3].time, plain)
        tracked = track(frames, painter.rig, method=tracking)
        for part in tracked.parts.values():
            assert part.good.tolist() == [k != 3 for k in range(FRAMES)]
            assert part.reason[3]
            assert np.isnan(part.pose[3]).all()
            assert len(part.gaps) == 1

    def test_half_of_it_covered_is_right_or_a_gap(
        self, tracking: AbstractTracking, painter: Painter
    ) -> None:
        frames = []
        for k in range(FRAMES):
            poses = moving(k / RATE)
            picture = painter.picture(poses)
            if k > 2:
                u, _ = painter.rig.camera.project_at(poses["object"][:2], 0.0255)
                picture[:, int(u) :] = (110.0, 140.0, 180.0)
            frames.append(Frame(k / RATE, as_seen(picture, seed=k)))
        part = track(frames, painter.rig, method=tracking).parts["object"]
        truth = np.array([moving(frame.time)["object"] for frame in frames])
        position, _ = pose_error(part.pose[part.good], truth[part.good])
        assert position.max() < 2.0 * POSITION

    def test_a_part_in_no_frame_is_refused(
        self, tracking: AbstractTracking, painter: Painter
    ) -> None:
        plain = as_seen(painter.picture({}, plain=True))
        frames = [Frame(k / RATE, plain) for k in range(2)]
        with pytest.raises(ValueError, match="in none of 2 frames"):
            track(frames, painter.rig, method=tracking)

    def test_too_little_light_is_named(self, tracking: AbstractTracking, painter: Painter) -> None:
        dark = as_seen(0.03 * painter.picture(moving(0.0)))
        with pytest.raises(ValueError, match="increase light"):
            track([Frame(0.0, dark)], painter.rig, method=tracking)

    def test_frames_of_another_size_are_refused(
        self, tracking: AbstractTracking, painter: Painter
    ) -> None:
        with pytest.raises(ValueError, match=r"rig '.*lens is calibrated"):
            track([Frame(0.0, np.zeros((90, 160, 3), np.uint8))], painter.rig, method=tracking)


OVER = 3  # points per pixel, in each direction
WHITE, BLACK = 215.0, 35.0
PLATE = np.array([120.0, 125.0, 130.0])
PAINT = {
    "red": (40, 40, 200),
    "blue": (190, 70, 30),
    "green": (60, 160, 40),
    "yellow": (40, 200, 215),
}


def camera(size: tuple[int, int] = (320, 240)) -> Camera:
    """Create a camera with about 0.55 mm per pixel, distortion, and a slight tilt."""
    lens = Lens(
        image_size=size,
        focal=row(940.0, 945.0),
        centre=row(size[0] / 2 + 2.3, size[1] / 2 - 1.7),
        distortion=row(-0.05, 0.02),
    )
    straight = Camera.looking_down(lens, 0.516, above=(0.0, 0.0), turned=0.05)
    tilt = 0.02
    turn = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    return Camera(
        lens=lens, rotation=turn @ straight.rotation, translation=turn @ straight.translation
    )


def tag_rig(size: tuple[int, int] = (320, 240), plate: bool = False) -> Rig:
    """Create a rig with one part with a tag of 30 mm, and one with a tag of 20 mm."""
    return Rig(
        name="small",
        camera=camera(size),
        parts={
            "object": MarkedPart(
                height=0.0254,
                marks=(Tag(id=1, size=0.03, pose=row(0.004, -0.003, 0.2), height=0.0255),),
            ),
            "actuator": MarkedPart(height=0.03, marks=(Tag(id=2, size=0.02, height=0.0301),)),
        },
        plate=(
            Tag(id=20, size=0.02, pose=row(-0.06, 0.03, 0.0), height=0.0),
            Tag(id=21, size=0.02, pose=row(0.065, -0.028, 0.0), height=0.0),
        )
        if plate
        else (),
    )


@functools.cache
def painted(rig: Rig) -> Painter:
    """Painter of a rig, cached for all tests."""
    return Painter(rig)


class Painter:
    """Renderer of frames of a rig; places in the world are computed once per height."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        width, height = rig.camera.lens.image_size
        step = (np.arange(OVER) + 0.5) / OVER - 0.5
        u = (np.arange(width)[:, None] + step).ravel()
        v = (np.arange(height)[:, None] + step).ravel()
        self._pixel = np.stack(np.meshgrid(u, v), axis=-1)
        self._places: dict[float, FloatArray] = {}
        self._frames: dict[float, Frame] = {}

    def at(self, height: float) -> FloatArray:
        if height not in self._places:
            self._places[height] = self.rig.camera.on_plane(self._pixel, height)
        return self._places[height]

    def picture(self, poses: Mapping[str, FloatArray], plain: bool = False) -> FloatArray:
        """Render all marks at their poses, (height, width, 3) float."""
        canvas = np.broadcast_to(PLATE, (*self._pixel.shape[:2], 3)).copy()
        for tag in self.rig.plate:
            self._tag(canvas, tag, np.zeros(3))
        for name, pose in () if plain else poses.items():
            for mark in self.rig.parts[name].marks:
                if isinstance(mark, Tag):
                    self._tag(canvas, mark, pose)
                else:
                    self._sticker(canvas, mark, pose)
        height, width = (n // OVER for n in canvas.shape[:2])
        return np.asarray(canvas.reshape(height, OVER, width, OVER, 3).mean((1, 3)))

    def frame(self, time: float) -> Frame:
        """Render a frame of the small film, with a camera's noise."""
        if time not in self._frames:
            self._frames[time] = Frame(
                time, as_seen(self.picture(moving(time)), seed=int(1e6 * time))
            )
        return self._frames[time]

    def _tag(self, canvas: FloatArray, tag: Tag, pose: FloatArray) -> None:
        xy = inverse(tag.pose, inverse(pose, self.at(tag.height))) / tag.size
        near = (np.abs(xy) < 0.72).all(-1)
        canvas[near] = WHITE
        _, white = cells(tag.family, tag.id)
        n = int(np.sqrt(len(white)))
        index = np.floor((xy * (1, -1) + 0.5) * n).astype(int)
        inside = ((index >= 0) & (index < n)).all(-1)
        row, column = index[inside][:, 1], index[inside][:, 0]
        canvas[inside] = np.where(white.reshape(n, n)[row, column], WHITE, BLACK)[:, None]

    def _sticker(self, canvas: FloatArray, sticker: Sticker, pose: FloatArray) -> None:
        xy = inverse(pose, self.at(sticker.height)) - sticker.place
        canvas[np.hypot(*np.moveaxis(xy, -1, 0)) < sticker.diameter / 2] = PAINT[sticker.colour]


def inverse(pose: FloatArray, xy: FloatArray) -> FloatArray:
    """Transform points of the world to the frame of a pose."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.asarray((xy - np.asarray(pose)[:2]) @ np.array([[c, -s], [s, c]]))


def as_seen(picture: FloatArray, noise: float = 2.0, seed: int = 0) -> Picture:
    """Add a camera's noise to a picture and round it to whole numbers."""
    rng = np.random.default_rng(seed)
    return np.clip(np.rint(picture + noise * rng.standard_normal(picture.shape)), 0, 255).astype(
        np.uint8
    )


def moving(t: float) -> dict[str, FloatArray]:
    """Poses of the parts in the small film at a time [s]."""
    return {
        "object": np.array([0.02 + 0.0135 * t, 0.004 - 0.003 * t, 0.3 + 0.2 * t]),
        "actuator": np.array([-0.045 + 0.0135 * t, -0.012, 0.02]),
    }
