"""Pictures of a scene seen from above, with a goal."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from fixel.model import Disk, Scene, Shape
from fixel.model.shape import placed
from fixel.typing import FloatArray

PIXELS: Final = 480  # side of a picture
FINER: Final = 2  # pixels drawn for each pixel of the picture, to smooth edges
GOAL, BODY, TOOL, FIXEL = "#b8e3c4", "#778899", "#4169e1", "#555555"


def scene_picture(
    scene: Scene,
    view: FloatArray,
    body: FloatArray,
    tool: FloatArray,
    goal: FloatArray | None = None,
) -> NDArray[np.uint8]:
    """Draw a scene.

    Parameters
    ----------
    scene : Scene
        Scene with one body and one pusher.
    view : (4,) float64
        Low x, high x, low y and high y of the picture, a square [m].
    body, tool : (3,) float64
        Poses of the body's shape and of the pusher [m, m, rad].
    goal : (3,) float64, optional
        Pose of the body at its goal.

    Returns
    -------
    (PIXELS, PIXELS, 3) uint8
    """
    side = FINER * PIXELS
    image = Image.new("RGB", (side, side), "white")
    pen = ImageDraw.Draw(image)
    scale = side / (view[1] - view[0])

    def draw(shape: Shape, pose: FloatArray, colour: str) -> None:
        points = np.zeros((1, 2)) if isinstance(shape, Disk) else shape.vertices
        at = (placed(points, pose) - (view[0], view[3])) * (scale, -scale)
        if isinstance(shape, Disk):
            pen.circle(tuple(at[0]), shape.radius * scale, fill=colour)
        else:
            pen.polygon([tuple(corner) for corner in at.tolist()], fill=colour)

    shape = scene.bodies[0].shape
    if goal is not None:
        draw(shape, goal, GOAL)
    for fixel in scene.fixels:
        draw(fixel.shape, fixel.pose, FIXEL)
    draw(shape, body, BODY)
    draw(scene.pushers[0].shape, tool, TOOL)
    return np.asarray(image.reduce(FINER))
