"""Camera parameters as an array, for the compiled loops."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.typing import FloatArray
from fixel.vision.camera import Camera
from fixel.vision.tracking.loops import pixel_of

MAX_KEPT: Final = 64

# Arrays by the identity of their camera, since its hash takes longer than a projection. Storing the
# camera too ensures that its identity is not reused.
_kept: dict[int, tuple[Camera, FloatArray]] = {}


def optics_of(camera: Camera) -> FloatArray:
    """Array (26,): rotation, translation, focal lengths, centre, skew, fisheye, distortion."""
    kept = _kept.get(id(camera))
    if kept is None:
        lens = camera.lens
        optics = np.concatenate(
            (
                camera.rotation.ravel(),
                camera.translation,
                lens.focal,
                lens.centre,
                (lens.skew, float(lens.fisheye)),
                lens.distortion,
            )
        )
        if len(_kept) >= MAX_KEPT:
            _kept.clear()
        kept = _kept[id(camera)] = camera, np.pad(optics, (0, 26 - len(optics)))
    return kept[1]


def seen_at(camera: Camera, place: FloatArray, height: float) -> tuple[float, float]:
    """Project one place [m] at a height above the plane [m]; a fast `Camera.project_at`."""
    u, v, there = pixel_of(optics_of(camera), float(place[0]), float(place[1]), float(height))
    if not there or not math.isfinite(u + v):
        raise InvalidInput(
            "points", found="a point behind the camera", expected="points in front of it [m]"
        )
    return u, v
