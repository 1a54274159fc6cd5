"""Way of the head to the start of a push, past the part."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final

import numpy as np
import shapely

from fixel.typing import FloatArray

AROUND: Final = 12  # places about the part through which a way may lead


def clear_way(
    outline: FloatArray, here: FloatArray, there: FloatArray, room: float
) -> list[FloatArray] | None:
    """Return places on a way that stays clear of a part.

    Parameters
    ----------
    outline : (n, 2) float64
        Outline of the part where it lies [m].
    here, there : (2,) float64
        Beginning and end of the way [m]. Either may be nearer to the part than `room`; the way does
        not come nearer than they are.
    room : float
        Distance between way and part [m].

    Returns
    -------
    list of (2,) float64, or None
        The places after `here`, of which `there` is the last; None if no way was found.

    Examples
    --------
    >>> import numpy as np
    >>> square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    >>> way = clear_way(square, np.array([-3.0, 0.0]), np.array([3.0, 0.0]), 0.5)
    >>> len(way) > 1
    True
    >>> len(clear_way(square, np.array([-3.0, 0.0]), np.array([-3.0, 2.0]), 0.5))
    1
    """
    part = shapely.Polygon(outline)
    middle = outline.mean(axis=0)
    # Chords of the ring keep their distance too.
    radius = (float(np.hypot(*(outline - middle).T).max()) + room) / math.cos(math.pi / AROUND)
    turns = np.linspace(0.0, 2.0 * math.pi, AROUND, endpoint=False)
    ring = middle + 1.01 * radius * np.column_stack((np.cos(turns), np.sin(turns)))
    first = int(np.argmin(np.hypot(*(ring - here).T)))
    ways = [[there]]
    for n in range(1, AROUND // 2 + 2):
        for step in (1, -1):
            ways.append([*(ring[(first + step * k) % AROUND] for k in range(n)), there])
    return next((way for way in ways if _is_clear(part, [here, *way], room)), None)


def _is_clear(part: shapely.Polygon, places: list[FloatArray], room: float) -> bool:
    near = [float(part.distance(shapely.Point(place))) for place in places]
    legs = [shapely.LineString(pair) for pair in pairwise(places)]
    return all(
        part.distance(leg) >= min(room, near[k], near[k + 1]) - 1e-9 for k, leg in enumerate(legs)
    )
