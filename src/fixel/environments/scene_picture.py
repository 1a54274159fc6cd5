"""Pictures of a scene seen from above, with a goal."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from fixel.model import Disk, Polygon, Scene, Shape
from fixel.model.shape import placed
from fixel.typing import FloatArray

PIXELS: Final = 480  # side of a picture
FINER: Final = 2  # pixels drawn for each pixel of the picture, to smooth edges
TABLE, AROUND = "#ffffff", "#e4e4e4"
GOAL, BODY, TOOL, FIXEL = "#b8e3c4", "#778899", "#4169e1", "#555555"


def scene_picture(
    scene: Scene,
    centre: FloatArray,
    half_side: float,
    body: FloatArray,
    tool: FloatArray,
    *,
    goal: FloatArray | None = None,
    table: Polygon | None = None,
) -> NDArray[np.uint8]:
    """Draw a scene.

    Parameters
    ----------
    scene : Scene
        Scene with one body and one pusher.
    centre : (2,) float64
        Centre of the picture, a square [m].
    half_side : float
        Half of its side [m].
    body, tool : (3,) float64
        Poses of the body's shape and of the pusher [m, m, rad].
    goal : (3,) float64, optional
        Pose of the body at its goal.
    table : Polygon, optional
        Outline of a table; by default everywhere.

    Returns
    -------
    (PIXELS, PIXELS, 3) uint8
    """
    side = FINER * PIXELS
    image = Image.new("RGB", (side, side), TABLE if table is None else AROUND)
    pen = ImageDraw.Draw(image)
    corner, scale = centre + np.array([-half_side, half_side]), 0.5 * side / half_side

    def draw(shape: Shape, pose: FloatArray, colour: str) -> None:
        points = np.zeros((1, 2)) if isinstance(shape, Disk) else shape.vertices
        at = (placed(points, pose) - corner) * (scale, -scale)
        if isinstance(shape, Disk):
            size = shape.radius * scale
            pen.ellipse([*(at[0] - size), *(at[0] + size)], fill=colour)
        else:
            pen.polygon([tuple(point) for point in at.tolist()], fill=colour)

    if table is not None:
        draw(table, np.zeros(3), TABLE)
    shape = scene.bodies[0].shape
    if goal is not None:
        draw(shape, goal, GOAL)
    for fixel in scene.fixels:
        draw(fixel.shape, fixel.pose, FIXEL)
    draw(shape, body, BODY)
    draw(scene.pushers[0].shape, tool, TOOL)
    return np.asarray(image.reduce(FINER))
