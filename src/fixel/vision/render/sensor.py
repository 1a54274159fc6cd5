"""From light to grey levels: noise that depends on the light, and rounding."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from fixel.kernels.jit import entry
from fixel.model.chance import stream
from fixel.typing import FloatArray
from fixel.vision.frame import Picture
from fixel.vision.render.canvas import FloatPicture
from fixel.vision.render.looks import Looks

# Noise is drawn once and then read from another place for every frame: drawing it anew would take
# longer than the picture.
SPARE: Final = 1 << 20


class Sensor:
    """Turns pictures of light into pictures of grey levels.

    Parameters
    ----------
    looks : Looks
        Its noise.
    size : (int, int)
        Width and height [px].
    seed : int
    """

    def __init__(self, looks: Looks, size: tuple[int, int], seed: int) -> None:
        self._read, self._shot = looks.read_noise, looks.shot_noise
        self._seed = seed
        self._values = 3 * size[0] * size[1]
        noisy = self._read > 0.0 or self._shot > 0.0
        count = self._values + SPARE if noisy else self._values
        self._bank: FloatPicture = (
            stream(seed, "film", "noise").standard_normal(count, dtype=np.float32)
            if noisy
            else np.zeros(count, np.float32)
        )

    def exposed(self, light: FloatPicture, factor: FloatArray, frame: int) -> Picture:
        """(h, w, 3) uint8 of light (h, w, 3) [grey levels] times factors (3,) of its colours.

        `frame` is its number in the film; the same number has the same noise.
        """
        random = stream(self._seed, "film", "frame", str(frame))
        start = int(random.integers(len(self._bank) - self._values + 1))
        picture = np.empty(light.shape, np.uint8)
        noise = self._bank[start : start + self._values].reshape(light.shape)
        _grey_levels(light, factor, self._read**2, self._shot**2 / 255.0, noise, picture)
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
    """Grey levels of light: variance `dark` and so much `per_level`, rounded and cut off."""
    for row in range(light.shape[0]):
        for column in range(light.shape[1]):
            for k in range(3):
                level = light[row, column, k] * factor[k]
                level += math.sqrt(dark + per_level * max(level, 0.0)) * noise[row, column, k]
                picture[row, column, k] = int(min(max(level + 0.5, 0.0), 255.0))


# The kernel takes any real arrays; its annotations know of float64 only.
_grey_levels: Any = _digitise
