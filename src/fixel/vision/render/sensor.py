"""Sensor model: conversion of light to grey levels, with noise and rounding."""

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

# Noise is drawn once and read from another offset for every frame, since drawing it takes longer
# than rendering the picture.
SPARE: Final = 1 << 20


class Sensor:
    """Converter of light to grey levels.

    Parameters
    ----------
    looks : Looks
        Looks with the noise of the sensor.
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
        """Convert light (h, w, 3) [grey levels], times factors (3,) of its colours, to uint8.

        `frame` is the number in the film, which determines the noise.
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
    """Write grey levels with noise of variance `dark + per_level * level`, rounded and clipped."""
    for row in range(light.shape[0]):
        for column in range(light.shape[1]):
            for k in range(3):
                level = light[row, column, k] * factor[k]
                level += math.sqrt(dark + per_level * max(level, 0.0)) * noise[row, column, k]
                picture[row, column, k] = int(min(max(level + 0.5, 0.0), 255.0))


# The kernel takes any real arrays, but is annotated for float64.
_grey_levels: Any = _digitise
