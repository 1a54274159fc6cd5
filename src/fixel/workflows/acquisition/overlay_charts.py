"""Draw the wanted and measured outlines of all parts on a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from fixel.drawing.palette import PUSHER, TOUCHED, TRAIL
from fixel.model import Fixel, Polygon, Pusher, placed
from fixel.vision.frame import Picture
from fixel.vision.outlines import (
    Bgr,
    bgr,
    draw_arrow,
    draw_outline,
    draw_words,
    outline_pixels,
    place_pixels,
)

if TYPE_CHECKING:
    from fixel.workflows.acquisition.overlay_check import Look, PartLook

WANTED: Final = bgr(TRAIL)
ACTUATOR: Final = bgr(PUSHER)
STANDING: Final = bgr("#E8E8E8")
MEASURED: Final = bgr("#F0E442")  # yellow of the same palette
PLACED: Final = bgr(TOUCHED)
BRIGHT: Final = bgr("#7CFFB2")  # the same green, to be read on a dark rim
WARNING: Final = bgr("#FF8A66")
AXIS: Final = 55.0  # [px] length of the world's axes as drawn
FAINT: Final = 0.45
ARROW: Final = (45.0, 130.0)  # [px] shortest and longest arrow of a push
EXAGGERATED: Final = 8.0  # drawn length of a push over its true length


def draw_look(picture: Picture, look: Look, *, words: bool) -> Picture:
    """Return a copy of a picture with outlines; `words` writes the errors on it too."""
    canvas = picture.copy()
    if (canvas.shape[1], canvas.shape[0]) == look.rig.camera.lens.image_size:
        _axes(canvas, look)
        for part in reversed(look.parts):
            _wanted(canvas, look, part)
        for part in look.checked:
            _measured(canvas, look, part)
    if words:
        _words(canvas, look)
    return canvas


def _wanted(canvas: Picture, look: Look, part: PartLook) -> None:
    """Draw the upper outline solid, the footprint and the edges between them faint."""
    camera, thing = look.rig.camera, part.thing
    foot = outline_pixels(camera, thing.shape, thing.pose, 0.0)
    upper = outline_pixels(camera, thing.shape, thing.pose, part.height)
    colour = _colour(part)
    draw_outline(canvas, foot, colour, width=1, strength=FAINT, halo=False)
    if isinstance(thing.shape, Polygon):
        corners = placed(thing.shape.outline, thing.pose)
        ends = place_pixels(camera, corners, 0.0), place_pixels(camera, corners, part.height)
        for edge in np.stack(ends, axis=1):
            draw_outline(canvas, edge, colour, width=1, strength=FAINT, closed=False, halo=False)
    draw_outline(canvas, upper, colour, width=4 if part.within else 2)


def _measured(canvas: Picture, look: Look, part: PartLook) -> None:
    """Draw the measured outline dashed, and an arrow towards the wanted place."""
    if part.measured is None or look.problems:
        return
    camera = look.rig.camera
    line = outline_pixels(camera, part.thing.shape, part.measured, part.height)
    draw_outline(canvas, line, MEASURED, width=2, dash=9.0)
    if part.within:
        return
    start, end = place_pixels(camera, [part.measured[:2], part.thing.pose[:2]], part.height)
    way = end - start
    length = float(np.linalg.norm(way))
    if length > 0.0:
        drawn = float(np.clip(EXAGGERATED * length, *ARROW))
        draw_arrow(canvas, start, start + way * drawn / length, MEASURED, width=4)


def _axes(canvas: Picture, look: Look) -> None:
    length = AXIS * look.rig.camera.metres_per_pixel()
    ends = place_pixels(look.rig.camera, [[0.0, 0.0], [length, 0.0], [0.0, length]], 0.0)
    for name, end in zip("xy", ends[1:], strict=True):
        draw_arrow(canvas, ends[0], end, STANDING, width=1)
        draw_words(canvas, name, [end[0] + 4.0, end[1] + 4.0], STANDING, size=0.5)


def _colour(part: PartLook) -> Bgr:
    if part.within:
        return BRIGHT
    if isinstance(part.thing, Fixel):
        return STANDING
    return ACTUATOR if isinstance(part.thing, Pusher) else WANTED


def _words(canvas: Picture, look: Look) -> None:
    """Write the verdict large, then one line for each part, from the upper left."""
    size = max(0.4, canvas.shape[1] / 1600.0)
    step = 42.0 * size
    lines = [*look.problems, *(_line(look, part) for part in look.checked), *look.remarks]
    band = canvas[: round(step * (1.6 + len(lines)))]
    band[:] = band // 3
    colour = BRIGHT if look.placed else WARNING
    draw_words(canvas, look.sentence, (16.0, step), colour, size=1.5 * size)
    for number, line in enumerate(lines):
        draw_words(canvas, line, (16.0, step * (2.1 + number)), STANDING, size=0.8 * size)


def _line(look: Look, part: PartLook) -> str:
    if part.error is None:
        return f"{part.name}: not seen, {part.reason}"
    x, y, turn = look.words(part)
    angle = "" if part.round else f"angle {turn} deg, "
    return f"{part.name}: x {x} mm, y {y} mm, {angle}{'in place' if part.within else 'off'}"
