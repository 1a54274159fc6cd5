"""Outlines with fewer corners, which a search simulates instead of traced ones."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
import shapely

from fixel.errors import InvalidInput
from fixel.model import Disk, Polygon, Scene
from fixel.model.goals import Beyond, Goal, Inside, PoseRegion, Seated

MANY: Final = 64  # corners up to which an outline is simulated as it is
FEW: Final = 40  # corners that are wanted of others
# Largest distances between the outlines, relative to the part's radius.
SHARES: Final = (0.001, 0.002, 0.004, 0.006, 0.008, 0.012, 0.016)
OF_GOAL: Final = 0.25  # the same, relative to the smallest tolerance of a length of the goal


def simplified(scene: Scene, goal: Goal) -> Scene:
    """Return the scene with a part of about `FEW` corners; the same scene up to `MANY` of them.

    The tool takes a step at each corner that it passes, so that an outline traced in a picture
    takes some 40 times as long as a square. Its corners are left out as far as the outline stays
    within the smallest of `SHARES` that is enough, and within a quarter of the goal's tolerances.

    Source
    ------
    Douglas & Peucker (1973), by Shapely.
    """
    body = scene.bodies[0]
    if isinstance(body.shape, Disk) or len(body.shape.outline) <= MANY:
        return scene
    most = OF_GOAL * _tolerance(goal)
    outline, found = shapely.Polygon(body.shape.outline), body.shape
    for share in SHARES:
        if share * body.shape.radius > most or len(found.outline) <= FEW:
            break
        fewer = outline.simplify(share * body.shape.radius)
        found = Polygon(shapely.get_coordinates(fewer)[:-1])
    try:
        return replace(scene, bodies=(replace(body, shape=found), *scene.bodies[1:]))
    except InvalidInput:  # such as a centre of friction that is only just on the part
        return scene


def _tolerance(goal: Goal) -> float:
    """Return the smallest tolerance of a length that a goal states [m]."""
    found = [own.position for own in goal.clauses if isinstance(own, PoseRegion)]
    found += [own.tolerance for own in goal.clauses if isinstance(own, Seated | Inside | Beyond)]
    return min((own for own in found if own is not None), default=np.inf)
