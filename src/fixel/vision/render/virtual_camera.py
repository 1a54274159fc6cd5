"""Virtual camera: projection of places, also outside the picture, and the sensor."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fixel.kernels.jit import entry
from fixel.model.probability import stream
from fixel.typing import FloatArray
from fixel.vision.camera import Camera
from fixel.vision.frame import Picture
from fixel.vision.render.canvas import FilledPolygons, FloatPicture, filled_polygons
from fixel.vision.render.looks import CameraEffects

# Limits of points outside the picture, as factors of the distance from its middle to its corners.
BEYOND: Final = (1.3, 1.2, 1.1, 1.05, 1.02)
# Noise is drawn once and read from another offset for every frame, since drawing it takes longer
# than rendering the picture.
SPARE: Final = 1 << 20


class Projection:
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

    def polygons(
        self,
        places: FloatArray,
        height: float,
        colour: FloatArray,
        starts: NDArray[np.int64] | None = None,
    ) -> FilledPolygons:
        """Project polygons at a height above the plane [m], see `filled_polygons`."""
        return filled_polygons(self.project_at(places, height), colour, self.size, starts)

    def _holds(self, limit: float) -> bool:
        """Whether distortion is monotonic up to this direction [-]."""
        r = np.linspace(0.0, limit, 64)
        seen = self.camera.lens.distorted(np.column_stack((r, 0.0 * r)))[:, 0]
        return bool((np.diff(seen) > 0.0).all())


class Sensor:
    """Converter of light to grey levels, with noise, for pictures of (width, height) [px]."""

    def __init__(self, looks: CameraEffects, size: tuple[int, int], seed: int) -> None:
        self._read, self._shot = looks.read_noise, looks.shot_noise
        self._seed = seed
        self._values = 3 * size[0] * size[1]
        self._bank: FloatPicture = np.zeros(self._values, np.float32)
        if self._read > 0.0 or self._shot > 0.0:
            random = stream(seed, "film", "noise")
            self._bank = random.standard_normal(self._values + SPARE, dtype=np.float32)

    def exposed(self, light: FloatPicture, factor: FloatArray, frame: int) -> Picture:
        """Convert light (h, w, 3) [grey levels], times factors (3,) of its colours, to uint8.

        `frame` is the number in the film, which determines the noise.
        """
        random = stream(self._seed, "film", "frame", str(frame))
        start = int(random.integers(len(self._bank) - self._values + 1))
        picture, rows = np.empty(light.shape, np.uint8), (len(light), -1)
        noise = self._bank[start : start + self._values].reshape(rows)
        factors, per_level = np.tile(factor, light.shape[1]), self._shot**2 / 255.0
        _grey_levels(
            light.reshape(rows), factors, self._read**2, per_level, noise, picture.reshape(rows)
        )
        return picture


@entry
def _digitise(
    light: FloatArray,
    factor: FloatArray,
    dark: float,
    per_level: float,
    noise: FloatArray,
    picture: FloatArray,
) -> None:
    """Write grey levels with noise of variance `dark + per_level * level`, rounded and clipped.

    Rows hold all colours of their pixels: loops over three colours would give no vector
    instructions, in 2.5 times the time, and neither would `max`.
    """
    for row in range(light.shape[0]):
        for k in range(light.shape[1]):
            level = light[row, k] * factor[k]
            level += math.sqrt(dark + per_level * (level if level > 0.0 else 0.0)) * noise[row, k]
            level = level + 0.5 if level > -0.5 else 0.0
            picture[row, k] = np.int32(level if level < 255.0 else 255.0)


# The kernel takes any real arrays, but is annotated for float64.
_grey_levels: Any = _digitise
