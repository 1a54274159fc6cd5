"""Frames of a film, with the instant at which each was taken."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]


@final
@dataclass(frozen=True, slots=True)
class Frame:
    """One picture of a film.

    Attributes
    ----------
    time : float
        When it was taken, as the film itself says [s].
    picture : (height, width, 3) uint8
        Blue, green, red; rows from above.
    """

    time: float
    picture: Picture
