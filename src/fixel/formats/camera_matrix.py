"""Conversion between OpenCV's camera matrix and fixel's lens."""

from __future__ import annotations

import numpy as np

from fixel.errors import InvalidInput
from fixel.typing import FloatArray
from fixel.vision.camera import Camera
from fixel.vision.lens import Lens


def lens_of(
    size: tuple[int, int],
    matrix: FloatArray,
    distortion: FloatArray,
    *,
    fisheye: bool = False,
) -> Lens:
    """Build a lens from OpenCV's camera matrix and distortion coefficients."""
    k = np.asarray(matrix, dtype=np.float64)
    if k.shape != (3, 3) or not np.isfinite(k).all():
        raise InvalidInput(
            "camera_matrix", found=f"an array of {k.shape}", expected="3 x 3 finite numbers"
        )
    if k[0, 0] <= 0.0:
        raise InvalidInput(
            "camera_matrix",
            found=f"a focal length of {k[0, 0]:g} px",
            expected="a calibrated camera: focal lengths above 0 px",
        )
    if (np.abs([k[1, 0], k[2, 0], k[2, 1], k[2, 2] - 1.0]) > 1e-9).any():
        raise InvalidInput(
            "camera_matrix", found=k.tolist(), expected="fx, skew, cx; 0, fy, cy; 0, 0, 1"
        )
    if k[0, 1] and not fisheye:
        raise InvalidInput(
            "camera_matrix",
            found=f"a skew of {k[0, 1]:g} px",
            expected="0: OpenCV does not heed it when it projects",
            hint="write 0 there if the coefficients come from OpenCV or ROS",
        )
    lens = Lens(
        image_size=size,
        focal=(k[0, 0], k[1, 1]),  # type: ignore[arg-type]
        centre=(k[0, 2], k[1, 2]),  # type: ignore[arg-type]
        skew=k[0, 1] / k[0, 0],
        distortion=np.ravel(distortion),
        fisheye=fisheye,
    )
    refuse_strange(lens)
    return lens


def refuse_strange(lens: Lens) -> None:
    """Reject an implausible lens, for example with numbers of another resolution or in mm."""
    width, height = lens.image_size
    u, v = lens.centre
    if not (0.0 < u < width and 0.0 < v < height):
        raise InvalidInput(
            "centre",
            found=f"({u:.0f}, {v:.0f}) px in pictures of {width} x {height} px",
            expected="a place in the picture",
            hint="are these the numbers of another resolution?",
        )
    if not 0.1 < lens.focal[0] / lens.focal[1] < 10.0:
        raise InvalidInput(
            "focal", found=lens.focal.tolist(), expected="focal lengths that are nearly equal"
        )


def placed_above(lens: Lens, rotation: FloatArray, translation: FloatArray) -> tuple[Camera, bool]:
    """Build a placed camera; also return whether the plane's y and z axes had to be reversed."""
    # If the world's z points away from the camera, half a turn about x reverses it.
    turned = bool((-rotation.T @ translation)[2] < 0.0)
    if turned:
        rotation = rotation @ np.diag([1.0, -1.0, -1.0])
    return Camera(lens=lens, rotation=rotation, translation=translation), turned


def matrix_of(lens: Lens) -> FloatArray:
    """OpenCV's camera matrix of a lens, (3, 3)."""
    (fx, fy), (cx, cy) = lens.focal, lens.centre
    return np.array([[fx, fx * lens.skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
