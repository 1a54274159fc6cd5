"""Projection of places that may lie outside the picture."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from fixel.typing import FloatArray
from fixel.vision.camera import Camera

# Limits of points outside the picture, as factors of the distance from its middle to its corners.
BEYOND: Final = (1.3, 1.2, 1.1, 1.05, 1.02)


class Eye:
    """Camera whose projection stays outside the picture for points far outside.

    A lens model is valid within the picture. Farther out its polynomial may turn back, so that a
    sleeve that leaves the picture would reappear on the other side. Points far outside are
    therefore moved towards the axis, to where the model is valid and still outside the picture.
    """

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self.size = camera.lens.image_size
        self.position = camera.position
        w, h = self.size
        corners = [[-0.5, -0.5], [w - 0.5, -0.5], [w - 0.5, h - 0.5], [-0.5, h - 0.5]]
        widest = float(np.hypot(*camera.lens.direction(corners).T).max())
        self._limit = widest * next((f for f in BEYOND if self._holds(widest * f)), 1.0)

    def project_at(self, places: ArrayLike, height: float) -> FloatArray:
        """Project places (..., 2) [m] at one height above the plane [m] to pixels (..., 2)."""
        rotation = self.camera.rotation
        flat = np.asarray(places, dtype=np.float64)
        seen = flat @ rotation[:, :2].T + (self.camera.translation + height * rotation[:, 2])
        direction = seen[..., :2] / seen[..., 2:]
        far = np.hypot(direction[..., 0], direction[..., 1])
        if far.size and far.max() > self._limit:
            direction *= np.minimum(self._limit / np.maximum(far, 1e-300), 1.0)[..., None]
        return self.camera.lens.pixel(direction)

    def pixel_size(self, height: float = 0.0) -> float:
        """Scale in the middle of the picture at a height [m/px]."""
        return self.camera.metres_per_pixel(height)

    def _holds(self, limit: float) -> bool:
        """Whether distortion is monotonic up to this direction [-]."""
        r = np.linspace(0.0, limit, 64)
        seen = self.camera.lens.distorted(np.column_stack((r, 0.0 * r)))[:, 0]
        return bool((np.diff(seen) > 0.0).all())
