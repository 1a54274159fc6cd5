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

import numpy as np
import pytest

from fixel.model import pose_error
from fixel.testing.painted import Painter, as_seen, moving
from fixel.vision.frame import Frame
from fixel.vision.opencv import opencv
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
        with pytest.raises(ValueError, match="was calibrated"):
            track([Frame(0.0, np.zeros((90, 160, 3), np.uint8))], painter.rig, method=tracking)
