"""What the camera's errors do to poses, against cameras drawn from them."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from tests.vision.test_place_camera import tagged

from fixel.errors import InvalidInput
from fixel.formats.rig_file import rig_of
from fixel.model.shape import placed
from fixel.vision.camera import Camera, MeasuredCamera
from fixel.vision.frame import Frame
from fixel.vision.plane_errors import pose_covariance, shifted
from fixel.vision.tracking.checks import check_camera_place

NAMES = ("fx", "fy", "cx", "cy", "k1", "rx", "ry", "rz", "tx", "ty", "tz")
SPREAD = np.array([0.8, 0.8, 0.8, 0.8, 2e-3, 4e-4, 4e-4, 4e-4, 2e-4, 2e-4, 4e-4])
POINTS = np.array([[-0.02, 0.03], [0.02, 0.03], [0.02, -0.01], [-0.02, -0.01]])


def measured():
    rig = rig_of("thesis-tags")
    return MeasuredCamera(
        lens=rig.camera.lens, camera=rig.camera, names=NAMES, covariance=np.diag(SPREAD**2)
    )


def kabsch(own, seen):
    """(3,) pose by the singular value decomposition."""
    a, b = own - own.mean(0), seen - seen.mean(0)
    u, _, v = np.linalg.svd(a.T @ b)
    turn = v.T @ u.T
    return np.append(seen.mean(0) - turn @ own.mean(0), np.arctan2(turn[1, 0], turn[0, 0]))


def test_poses_err_as_with_cameras_drawn():
    """OpenCV projects points through a random camera; the nominal camera computes the pose."""
    known, rng, height = measured(), np.random.default_rng(0), 0.0254
    pose = np.array([0.21, -0.05, 0.7])
    points = np.column_stack([placed(POINTS, pose), np.full(4, height)])
    errors = []
    for _ in range(1500):
        draw = dict(zip(NAMES, rng.normal(0.0, SPREAD).tolist(), strict=True))
        true = shifted(known, draw)
        fx, fy = true.lens.focal
        cx, cy = true.lens.centre
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
        turn = cv2.Rodrigues(true.rotation)[0]
        pixels = cv2.projectPoints(points, turn, true.translation, matrix, true.lens.distortion)[0]
        seen = known.placed().on_plane(pixels[:, 0], height)
        errors.append(kabsch(POINTS, seen) - pose)
    covariance = pose_covariance(known, pose[None], POINTS, height)[0]
    drawn = np.cov(np.array(errors).T)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), np.sqrt(np.diag(drawn)), rtol=0.08)
    scale = np.sqrt(np.outer(np.diag(drawn), np.diag(drawn)))
    np.testing.assert_allclose(covariance / scale, drawn / scale, atol=0.1)


def off_by(rig, metres):
    """The plate seen by a camera `metres` away from its place in the rig."""
    camera = rig.camera
    aside = camera.rotation @ [metres, 0.0, 0.0]
    there = Camera(
        lens=camera.lens, rotation=camera.rotation, translation=camera.translation + aside
    )
    gray = tagged(there, rig.plate)
    return Frame(0.0, np.repeat(gray[..., None], 3, axis=2))


def test_a_camera_that_never_moved_is_not_said_to_have():
    """1 mm off is within a calibration that is sure to 1.4 mm, and not within one that is sure."""
    rig = rig_of("thesis-tags")
    unsure = MeasuredCamera(
        lens=rig.camera.lens,
        camera=rig.camera,
        names=("tx", "ty"),
        covariance=np.diag([0.6e-3, 0.6e-3]) ** 2,
    )
    frame = off_by(rig, 1.0e-3)
    with pytest.raises(InvalidInput, match="was moved"):
        check_camera_place(rig, frame)
    assert check_camera_place(replace(rig, measured=unsure), frame)
    with pytest.raises(InvalidInput, match="was moved"):
        check_camera_place(replace(rig, measured=unsure), off_by(rig, 4.0e-3))
