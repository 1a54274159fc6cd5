"""Thumbnail of an experiment: a small SVG, written without Matplotlib in a millisecond."""

from __future__ import annotations

from typing import Final

import numpy as np

from fixel.drawing import palette
from fixel.drawing.view import Rectangle, evenly
from fixel.model import Experiment, Shape, placed, rotated
from fixel.typing import FloatArray

WIDTH: Final = 120
HEIGHT: Final = 80
MARGIN: Final = 0.04  # share of the larger side
MAX_POINTS: Final = 60  # maximum number of points of a trail
ROUND: Final = 16  # number of corners that a disk is drawn with


def thumbnail(experiment: Experiment) -> str:
    """Draw the object at start and end, its trail, pusher and fixels, as an SVG of 120 by 80.

    Of an experiment without a scene, only the trail is drawn, with a cross at its end.
    """
    scene = experiment.scene
    poses = experiment.trajectory.pose
    poses = poses[evenly(len(poses), MAX_POINTS)]
    trail = poses[:, :2]
    outlines: list[tuple[FloatArray, str]] = []  # in the world, with their SVG style
    if scene is not None:
        body = next(b for b in scene.bodies if b.name == experiment.object_name)
        touched = experiment.contact_mode
        for k, fixel in enumerate(scene.fixels):
            colour = palette.TOUCHED if touched[k : k + 1] == "1" else palette.FIXEL
            outlines.append((_outline(fixel.shape, fixel.pose), f'fill="{colour}"'))
        for pusher in scene.pushers[:1]:
            pose = pusher.pose if experiment.pusher is None else experiment.pusher.pose[-1]
            style = f'fill="{palette.PUSHER}" fill-opacity="0.35" stroke="{palette.PUSHER}"'
            outlines.append((_outline(pusher.shape, pose), style))
        blue = palette.BODY
        for pose, style in (
            (poses[0], f'fill="none" stroke="{blue}" stroke-opacity="0.5" stroke-dasharray="3 2"'),
            (poses[-1], f'fill="{blue}" fill-opacity="0.22" stroke="{blue}"'),
        ):
            outlines.append((_outline(body.shape, pose), style))
        trail = trail + rotated(body.com, poses[:, 2])
    points = np.concatenate([trail, *(outline for outline, _ in outlines)])
    box = Rectangle.around(points, 1e-9).widened(MARGIN).with_aspect(HEIGHT / WIDTH)
    scale = WIDTH / (box.x[1] - box.x[0])

    def path(world: FloatArray, end: str) -> str:
        across = (world[:, 0] - box.x[0]) * scale
        down = (box.y[1] - world[:, 1]) * scale
        corners = "L".join(f"{x:.1f} {y:.1f}" for x, y in zip(across, down, strict=True))
        return f"M{corners}{end}"

    shapes = "".join(f'<path d="{path(world, "Z")}" {look}/>' for world, look in outlines)
    end = path(trail[-1:], "m-3 0h6m-3 -3v6") if scene is None else ""
    # Draw start and end alone as two dots: the motion between was not measured.
    dots = "".join(path(row[None], "h0") for row in trail)
    line = path(trail, "") if len(trail) > 2 else dots
    width = 1.4 if len(trail) > 2 else 3.5
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
        f'stroke-linejoin="round" stroke-width="1.2">{shapes}'
        f'<path d="{line}{end}" fill="none" stroke="{palette.INK}" '
        f'stroke-width="{width}" stroke-linecap="round"/></svg>'
    )


def _outline(shape: Shape, pose: FloatArray) -> FloatArray:
    outline = shape.outline
    every = max(1, len(outline) // ROUND) if len(outline) > 2 * ROUND else 1
    return placed(outline[::every], pose)
