"""Pictures of environments: of scenes from above, and of the Push-T task.

Push-T is drawn as by gym-pusht, without its packages. Its picture of 512 x 512 pixels is never
made: a smaller one needs four of its pixels for each of its own, as in bilinear interpolation
without smoothing.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from fixel.kernels.jit import entry, kernel
from fixel.model import Disk, Polygon, Scene, Shape
from fixel.model.shape import placed
from fixel.typing import FloatArray

SIDE: Final = 512  # of the whole picture [px]
LINE: Final = 2.0  # half width of outlines and walls [px]
RADIUS, INNER_RADIUS = 15.0, 11.0  # of the agent's two discs [px]
# Faces of the walls, drawn as lines [px].
NEAR_WALL, FAR_WALL = 5.0, 506.0

# Rows of `COLOURS`.
WHITE, GOAL, AGENT, AGENT_RIM, BLOCK, BLOCK_RIM, WALL = range(7)
COLOURS: Final = np.array(
    [
        [255, 255, 255], [144, 238, 144], [78, 126, 255], [65, 105, 225], [142, 163, 183],
        [119, 136, 153], [211, 211, 211],
    ],
    np.float64,
)  # fmt: skip
CROSS: Final = (255, 0, 0)


def picture(
    agent: FloatArray,
    pieces: FloatArray,
    goal: FloatArray,
    size: tuple[int, int],
    action: FloatArray | None = None,
) -> NDArray[np.uint8]:
    """Draw one environment: (height, width, 3) uint8.

    The agent (2,), corners (2, 4, 2) of bar and stem of the T and of its goal, and the target of
    the agent, marked by a cross, are in pixels; NaN for no target.
    """
    out = np.empty((size[1], size[0], 3), np.uint8)
    _paint(np.round(agent), np.round(pieces), np.round(goal), COLOURS, out)
    if action is not None and np.isfinite(action).all():
        _mark(out, action)
    return out


def _mark(out: NDArray[np.uint8], action: FloatArray) -> None:
    """Draw a cross at an action, in the proportions of gym-pusht."""
    height, width = out.shape[:2]
    x, y = (action / SIDE * [width, height]).astype(np.int64)
    half, thick = int(8 / 96 * min(height, width)) // 2, max(1, int(min(height, width) / 96))
    low, high = -(thick // 2), thick - thick // 2

    def span(a: int, b: int) -> slice:
        return slice(max(a, 0), max(b, 0))

    out[span(y + low, y + high), span(x - half, x + half + 1)] = CROSS
    out[span(y - half, y + half + 1), span(x + low, x + high)] = CROSS


@kernel
def _side(corners: FloatArray, p: int, line: float, x: float, y: float) -> int:
    """Return 2 on the outline of a convex piece, as wide as a line, 1 inside and 0 outside."""
    inside = True
    for i in range(4):
        k = (i + 1) % 4
        ax = corners[p, i, 0]
        ay = corners[p, i, 1]
        ex = corners[p, k, 0] - ax
        ey = corners[p, k, 1] - ay
        along = ((x - ax) * ex + (y - ay) * ey) / (ex * ex + ey * ey)
        along = min(max(along, 0.0), 1.0)
        dx = x - ax - along * ex
        dy = y - ay - along * ey
        if dx * dx + dy * dy <= line * line:
            return 2
        if ex * (y - ay) - ey * (x - ax) < 0.0:
            inside = False
    return 1 if inside else 0


@kernel
def _colour(
    agent: FloatArray, pieces: FloatArray, goal: FloatArray, bounds: FloatArray, x: float, y: float
) -> int:
    """Row of the colour of a pixel of the whole picture."""
    on_wall = (
        abs(x - NEAR_WALL) <= LINE
        or abs(x - FAR_WALL) <= LINE
        or abs(y - NEAR_WALL) <= LINE
        or abs(y - FAR_WALL) <= LINE
    )
    low, high = NEAR_WALL - LINE, FAR_WALL + LINE
    if on_wall and low <= x <= high and low <= y <= high:
        return WALL
    if bounds[0, 0] <= x <= bounds[0, 1] and bounds[0, 2] <= y <= bounds[0, 3]:
        for p in range(pieces.shape[0] - 1, -1, -1):
            side = _side(pieces, p, LINE, x, y)
            if side > 0:
                return BLOCK if side == 1 else BLOCK_RIM
    away = math.hypot(x - agent[0], y - agent[1])
    if away <= RADIUS:
        return AGENT if away <= INNER_RADIUS else AGENT_RIM
    if bounds[1, 0] <= x <= bounds[1, 1] and bounds[1, 2] <= y <= bounds[1, 3]:
        for p in range(goal.shape[0]):
            if _side(goal, p, 0.0, x, y) > 0:
                return GOAL
    return WHITE


@kernel
def _write_bounds(corners: FloatArray, bounds: FloatArray, row: int) -> None:
    """Write low x, high x, low y, high y of the corners, with their outlines."""
    bounds[row, 0] = bounds[row, 2] = math.inf
    bounds[row, 1] = bounds[row, 3] = -math.inf
    for p in range(corners.shape[0]):
        for i in range(corners.shape[1]):
            for j in range(2):
                bounds[row, 2 * j] = min(bounds[row, 2 * j], corners[p, i, j] - LINE)
                bounds[row, 2 * j + 1] = max(bounds[row, 2 * j + 1], corners[p, i, j] + LINE)


@entry
def _paint(
    agent: FloatArray, pieces: FloatArray, goal: FloatArray, colours: FloatArray, out: Any
) -> None:
    bounds = np.empty((2, 4))
    _write_bounds(pieces, bounds, 0)
    _write_bounds(goal, bounds, 1)
    height, width = out.shape[0], out.shape[1]
    for row in range(height):
        v = min(max((row + 0.5) * SIDE / height - 0.5, 0.0), SIDE - 1.0)
        top = min(int(v), SIDE - 2)
        for column in range(width):
            u = min(max((column + 0.5) * SIDE / width - 0.5, 0.0), SIDE - 1.0)
            left = min(int(u), SIDE - 2)
            fu = u - left
            fv = v - top
            a = _colour(agent, pieces, goal, bounds, left, top)
            b = _colour(agent, pieces, goal, bounds, left + 1, top)
            c = _colour(agent, pieces, goal, bounds, left, top + 1)
            d = _colour(agent, pieces, goal, bounds, left + 1, top + 1)
            for j in range(3):
                upper = colours[a, j] + fu * (colours[b, j] - colours[a, j])
                lower = colours[c, j] + fu * (colours[d, j] - colours[c, j])
                out[row, column, j] = int(upper + fv * (lower - upper) + 0.5)


PIXELS: Final = 480  # side of a picture
FINER: Final = 2  # pixels drawn for each pixel of the picture, to smooth edges
TABLE, AROUND = "#ffffff", "#e4e4e4"
GOAL_COLOUR, BODY, TOOL, FIXEL = "#b8e3c4", "#778899", "#4169e1", "#555555"


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
    """Draw a scene with one body and one pusher: (PIXELS, PIXELS, 3) uint8.

    The picture is a square about `centre` (2,) [m]. The poses (3,) of the body's shape, of the
    pusher and of the goal are in the world [m, m, rad]. By default the table is everywhere.
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
        draw(shape, goal, GOAL_COLOUR)
    for fixel in scene.fixels:
        draw(fixel.shape, fixel.pose, FIXEL)
    draw(shape, body, BODY)
    draw(scene.pushers[0].shape, tool, TOOL)
    return np.asarray(image.reduce(FINER))
