"""Errors of measured poses due to errors of the camera."""

from __future__ import annotations

import numpy as np

from fixel.model.shape import placed
from fixel.typing import FloatArray
from fixel.vision.measured_camera import MeasuredCamera
from fixel.vision.plane_errors import slope_of


def pose_covariance(
    measured: MeasuredCamera, poses: FloatArray, points: FloatArray, height: float
) -> FloatArray:
    """Covariances (n, 3, 3) of poses due to the camera's errors [m^2, m rad, rad^2].

    The errors are the same in every picture, so that averaging over frames does not reduce them.

    Parameters
    ----------
    measured : MeasuredCamera
        Placed camera.
    poses : (n, 3) float64
        Poses of the part [m, m, rad].
    points : (k, 2) float64
        At least two points of the part by which it is measured [m].
    height : float
        Height of these points above the plate [m].
    """
    if not measured.names:
        return np.zeros((len(poses), 3, 3))
    places = np.stack([placed(points, pose) for pose in poses])
    pixels = measured.placed().project_at(places, height)
    arms = places - places.mean(axis=1, keepdims=True)
    square = (arms**2).sum(axis=(1, 2))
    slopes = np.empty((len(poses), 3, len(measured.names)))
    for k, name in enumerate(measured.names):
        moved = slope_of(measured, name, pixels, height)
        slopes[:, :2, k] = moved.mean(axis=1)
        turned = arms[..., 0] * moved[..., 1] - arms[..., 1] * moved[..., 0]
        slopes[:, 2, k] = turned.sum(axis=1) / square
    # The position is that of the frame's origin, not of the middle of the points.
    away = poses[:, :2] - places.mean(axis=1)
    slopes[:, 0] -= away[:, 1:] * slopes[:, 2]
    slopes[:, 1] += away[:, :1] * slopes[:, 2]
    return np.asarray(slopes @ measured.covariance @ np.swapaxes(slopes, -1, -2))
