"""Coverage of pixels by a sticker, compiled."""

import math

import numpy as np

from fixel.kernels.jit import entry
from fixel.vision.frame import Gray, Picture

CORE, RING = 0.55, (1.35, 1.75)  # of the radius: certainly inside, certainly outside
CONTRAST = 25.0  # of 255 between a sticker and its surroundings
COVERED, BARE = 215.0, 40.0  # brightness of pictures of coverage
MIN_INSIDE, MIN_AROUND = 4, 8  # pixels needed for a mean colour


@entry
def cover(window: Picture, u: float, v: float, radius: float, covered: Gray) -> bool:
    """Write the coverage of each pixel by a sticker near (u, v) as a picture.

    Returns
    -------
    bool
        Whether a sticker is visible there.
    """
    height, width = covered.shape
    inside, around = np.zeros(3), np.zeros(3)
    n_inside = n_around = 0
    for y in range(height):
        for x in range(width):
            apart = math.hypot(x - u, y - v) / radius
            if apart < CORE:
                n_inside += 1
                for k in range(3):
                    inside[k] += window[y, x, k]
            elif RING[0] < apart < RING[1]:
                n_around += 1
                for k in range(3):
                    around[k] += window[y, x, k]
    if n_inside < MIN_INSIDE or n_around < MIN_AROUND:
        return False
    inside /= n_inside
    around /= n_around
    by = inside - around
    square = by[0] * by[0] + by[1] * by[1] + by[2] * by[2]
    if square < CONTRAST**2:
        return False
    by *= (COVERED - BARE) / square
    level = BARE - (by[0] * around[0] + by[1] * around[1] + by[2] * around[2])
    for y in range(height):
        for x in range(width):
            value = level
            for k in range(3):
                value += by[k] * window[y, x, k]
            covered[y, x] = int(min(max(value, 0.0), 255.0))
    return True
