"""Rendering of a microscope's bright field: black part and probe on a bright ground."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from fixel.model import Body, Disk, Pusher, Scene
from fixel.model.probability import stream
from fixel.model.shape import placed
from fixel.typing import FloatArray
from fixel.vision.frame import opencv
from fixel.vision.marks import Rig
from fixel.vision.render.bodies import direction_of, falloff
from fixel.vision.render.canvas import Canvas, FloatPicture, PictureWindow
from fixel.vision.render.looks import CameraEffects
from fixel.vision.render.solids import outline_of, polygon
from fixel.vision.render.virtual_camera import Projection

Poses = Mapping[str, FloatArray]

GROUND: Final = 214.0  # [grey levels]
BLACK: Final = 22.0
SHEET: Final = 38.1e-6  # [m] height of a part that the rig lacks

# Half width of the needle behind its tip: first straight, then a cone, then the shank.
NEEDLE: Final = ((0.0, 0.5), (25e-6, 0.5), (1.6e-3, 5.2), (1.2e-2, 7.0))  # [m], [tip sides]


class BrightField:
    """Renderer of a scene under the microscope, lit from below.

    Parameters
    ----------
    scene : Scene
        Scene with the true shapes.
    rig : Rig
    looks : CameraEffects
    seed : int
        Seed of the dust.
    """

    def __init__(self, scene: Scene, rig: Rig, looks: CameraEffects, seed: int) -> None:
        self._eye, self._looks = Projection(rig.camera), looks
        self._size = self._eye.size
        pixel = self._eye.pixel_size()
        self._outlines: list[tuple[str, FloatArray, float]] = []
        for body in scene.bodies:
            self._add(rig, body.name, part_outline(body, looks.tab, pixel))
        for pusher in scene.pushers:
            self._add(rig, pusher.name, needle_outline(pusher, pixel))
            self._add(rig, pusher.name, outline_of(pusher.shape, pixel).points)
        for fixel in scene.fixels:
            self._add(rig, fixel.name, placed(outline_of(fixel.shape, pixel).points, fixel.pose))
        self._ground = _ground(self._size, seed, clean=looks.read_noise == 0.0)
        self._falloff = falloff(self._eye, looks.vignetting)[..., None]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [px]."""
        return self._size

    def light(self, instants: Sequence[Poses]) -> FloatPicture:
        """Render the light on the sensor (h, w, 3) float32 over an exposure [grey levels]."""
        total = self._sharp(instants[0])
        for poses in instants[1:]:
            total += self._sharp(poses)
        if len(instants) > 1:
            total /= np.float32(len(instants))
        if self._looks.blur > 0.0:
            total = opencv().GaussianBlur(total, (0, 0), self._looks.blur)
        return np.asarray(total * self._falloff)

    def _add(self, rig: Rig, name: str, outline: FloatArray) -> None:
        part = rig.parts.get(name)
        self._outlines.append((name, outline, part.height if part else SHEET))

    def _sharp(self, poses: Poses) -> FloatPicture:
        picture = self._ground.copy()
        canvas = Canvas(PictureWindow(0, 0, *self._size), picture)
        full = np.ones(picture.shape[:2], np.float32)
        still = np.zeros(3)
        for name, outline, height in self._outlines:
            points = placed(outline, poses.get(name, still))
            canvas.paint(self._eye.polygons(points, height, np.full(3, BLACK)), full)
        return picture


def part_outline(body: Body, tab: tuple[float, float], pixel: float) -> FloatArray:
    """Outline (n, 2) of a part with its tab in the middle of its first shortest side [m].

    Parameters
    ----------
    tab : (float, float)
        Width and length of the tab [m]; a disk has none.
    pixel : float
        Size of a pixel [m].
    """
    width, length = tab
    if isinstance(body.shape, Disk) or width * length == 0.0:
        return outline_of(body.shape, pixel).points
    corners = body.shape.outline
    along = np.roll(corners, -1, axis=0) - corners
    size = np.hypot(*along.T)
    k = int(np.argmin(np.round(size / size.max(), 6)))
    unit = along[k] / size[k]
    out = np.array([unit[1], -unit[0]])
    middle, half = corners[k] + 0.5 * along[k], 0.5 * min(width, 0.98 * float(size[k])) * unit
    stub = [
        middle - half,
        middle - half + length * out,
        middle + half + length * out,
        middle + half,
    ]
    return polygon(np.concatenate((corners[: k + 1], stub, corners[k + 1 :])), pixel).points


def needle_outline(pusher: Pusher, pixel: float) -> FloatArray:
    """Outline (n, 2) of the needle whose end is the pusher, in the pusher's frame [m]."""
    x = direction_of(pusher)
    y = np.array([-x[1], x[0]])
    side = float(np.ptp(pusher.shape.outline @ y))
    back = np.array([far for far, _ in NEEDLE])[:, None] * -x
    wide = np.array([half for _, half in NEEDLE])[:, None] * side * y
    return polygon(np.concatenate((back - wide, (back + wide)[::-1])), pixel).points


def _ground(size: tuple[int, int], seed: int, *, clean: bool) -> FloatPicture:
    """Render the bright ground (h, w, 3), with some dust out of focus."""
    w, h = size
    ground = np.full((h, w, 3), GROUND, np.float32)
    if clean:
        return ground
    random = stream(seed, "film", "dust")
    u, v = np.meshgrid(np.arange(w), np.arange(h))
    for _ in range(7):
        far = np.hypot(u - random.uniform(0, w), v - random.uniform(0, h))
        size_px, deep = random.uniform(2.0, 6.0), random.uniform(3.0, 11.0)
        spot = np.exp(-0.5 * (far / size_px) ** 2) - 0.4 * np.exp(-0.5 * (far / size_px - 2.0) ** 2)
        ground -= np.asarray(deep * spot, np.float32)[..., None]
    return ground
