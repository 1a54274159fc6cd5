"""A camera that may be asked about places it does not see."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from fixel.typing import FloatArray
from fixel.vision.camera import Camera

# How far outside the picture points may be, as factors of the way from its middle to its corners.
BEYOND: Final = (1.3, 1.2, 1.1, 1.05, 1.02)


class Eye:
    """Projects as its camera does, but keeps what is far outside the picture outside.

    The model of a lens holds for what the lens sees. Beyond, its polynomial turns back, and a
    sleeve that leaves the picture would come in again on the other side. So points far out are
    moved towards the axis, to where the model still holds and nobody sees them.
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
        """(..., 2) pixels of places (..., 2) [m] at one height above the plane [m]."""
        rotation = self.camera.rotation
        flat = np.asarray(places, dtype=np.float64)
        seen = flat @ rotation[:, :2].T + (self.camera.translation + height * rotation[:, 2])
        direction = seen[..., :2] / seen[..., 2:]
        far = np.hypot(direction[..., 0], direction[..., 1])
        if far.size and far.max() > self._limit:
            direction *= np.minimum(self._limit / np.maximum(far, 1e-300), 1.0)[..., None]
        return self.camera.lens.pixel(direction)

    def pixel_size(self, height: float = 0.0) -> float:
        """How much of a level one pixel shows in the middle [m/px]."""
        return self.camera.metres_per_pixel(height)

    def _holds(self, limit: float) -> bool:
        """Whether what is farther out also appears farther out, up to this direction [-]."""
        r = np.linspace(0.0, limit, 64)
        seen = self.camera.lens.distorted(np.column_stack((r, 0.0 * r)))[:, 0]
        return bool((np.diff(seen) > 0.0).all())
