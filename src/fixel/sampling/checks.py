"""Checks of experiments by geometry alone, without simulation.

They find experiments that cannot work; passing them is no guarantee. `rehearse` simulates.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import hypot
from typing import Final, NamedTuple

import numpy as np
import shapely

from fixel.model import LineDrive, Scene, Shape, placed
from fixel.typing import FloatArray

# [m] Larger than any plate.
FAR_AWAY: Final = 1e6


class PlanProblem(NamedTuple):
    """Problem of one experiment of a plan.

    Attributes
    ----------
    name : str
        Name of the experiment.
    sentence : str
        Description of the problem.
    """

    name: str
    sentence: str


def scene_problems(scene: Scene) -> Iterator[str]:
    """Yield the problems of a scene with one head, which moves along +x.

    The head must meet the object, must not run into a fixel, and must be able to push the object
    to one. For the last check, the object is replaced by the smallest circle about its centroid
    that contains it. The circle moves straight ahead for the rest of the travel after the head has
    met it: the object may rotate, but does not slide sideways.
    """
    drive = scene.pushers[0].drive
    assert isinstance(drive, LineDrive)
    way = _clearance(scene)
    if way is None:
        yield "the head passes the object without contact"
    elif way > drive.travel:
        yield f"the head stops {_mm(way - drive.travel)} short of the object"
    else:
        yield from _out_of_reach(scene, drive.travel - way)
    yield from _head_hits(scene, drive.travel)


def _clearance(scene: Scene) -> float | None:
    """Return the distance that the head moves until it meets the object [m]; None if it misses.

    Measured from the foremost point of the head: exact for a flat face normal to the motion.
    """
    head, body = scene.pushers[0], scene.bodies[0]
    (_, low), (front, high) = _extent(placed(head.shape.outline, head.pose))
    outline = shapely.Polygon(placed(body.shape.outline, body.pose))
    ahead = shapely.intersection(outline, shapely.box(front, low, FAR_AWAY, high))
    return None if ahead.is_empty else max(float(ahead.bounds[0]) - front, 0.0)


def _out_of_reach(scene: Scene, way: float) -> Iterator[str]:
    """Yield a problem if the object cannot meet a fixel while it moves `way` [m] ahead."""
    body = scene.bodies[0]
    x, y = placed(body.shape.centroid, body.pose).tolist()
    track = shapely.LineString([(x, y), (x + way, y)])
    radius = _circle(body.shape)
    if not scene.fixels:
        return
    distance = {
        fixel.name: float(track.distance(shapely.Point(fixel.pose[:2])))
        - radius
        - fixel.shape.radius
        for fixel in scene.fixels
    }
    nearest = min(distance, key=lambda name: distance[name])
    if distance[nearest] > 0.0:
        yield (
            f"the object cannot reach a fixel: the distance to the nearest, {nearest}, stays "
            f"{_mm(distance[nearest])}"
        )


def _head_hits(scene: Scene, travel: float) -> Iterator[str]:
    """Yield a problem for each fixel that the head runs into."""
    head = scene.pushers[0]
    start = placed(head.shape.outline, head.pose)
    end = start + np.array([travel, 0.0])
    swept = shapely.MultiPoint(np.vstack((start, end))).convex_hull
    for fixel in scene.fixels:
        peg = shapely.Polygon(placed(fixel.shape.outline, fixel.pose))
        if swept.intersects(peg):
            yield f"the head collides with {fixel.name}"


def _circle(shape: Shape) -> float:
    """Return the largest distance of the outline from the centroid [m]."""
    return max(hypot(x, y) for x, y in (shape.outline - shape.centroid).tolist())


def _extent(points: FloatArray) -> tuple[list[float], list[float]]:
    """Return the smallest and largest coordinates [m]."""
    return points.min(axis=0).tolist(), points.max(axis=0).tolist()


def _mm(length: float) -> str:
    return f"{1e3 * length:.3g} mm"
