"""Rendering of the testbed from above: plate, fixels, object, actuator and a hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from fixel.model import Scene
from fixel.typing import FloatArray
from fixel.vision.frame import opencv
from fixel.vision.marks import Rig
from fixel.vision.render import bodies
from fixel.vision.render.canvas import FloatPicture, PictureWindow, cover, painter, window_of
from fixel.vision.render.looks import CameraEffects
from fixel.vision.render.solids import PlacedSolid, Solid, painting_order, place
from fixel.vision.render.virtual_camera import Projection

Poses = Mapping[str, FloatArray]

HAND: Final = "hand"  # name of its pose among those of bodies and pushers


class RenderedBench:
    """Renderer of a scene on the testbed.

    Resting things are painted once; moving ones in the window that they and their shadows touch.
    Parts that the rig lacks are 25.4 mm high, pushers 30 mm, without markers. The textures are
    those of the seed; the plate is that of `like`, which has the same rig, looks and seed.
    """

    def __init__(
        self,
        scene: Scene,
        rig: Rig,
        looks: CameraEffects,
        seed: int,
        like: RenderedBench | None = None,
    ) -> None:
        self._rig, self._looks = rig, looks
        self._eye = Projection(rig.camera)
        self.size = self._eye.size  # width and height [px]
        pixel = bodies.pixel_of(rig)
        dull, turned = bodies.grain(seed, "plastic", 0.03), bodies.grain(seed, "milled", 0.02)
        self._moving: list[tuple[str, Solid]] = [
            (body.name, bodies.body_solid(body, rig, pixel, dull)) for body in scene.bodies
        ]
        resting = [
            (bodies.fixel_solid(fixel, rig.fixel_height, pixel), fixel.pose)
            for fixel in scene.fixels
        ]
        for pusher in scene.pushers:
            solids = bodies.pusher_solids(pusher, rig, pixel, turned)
            self._moving += [(pusher.name, solid) for solid in solids]
            resting.append((bodies.housing_solid(pusher, pixel), pusher.pose))
        self._hand = bodies.hand_solid(4.0 * pixel)
        self._resting = [place(solid, pose, self._eye) for solid, pose in resting]
        self._plate: FloatPicture = (
            bodies.backdrop(rig, self._eye, seed) if like is None else like._plate
        )
        self._falloff = bodies.falloff(self._eye, looks.vignetting)
        self._still = self._developed(PictureWindow(0, 0, *self.size), self._painted([]))

    def light(self, instants: Sequence[Poses]) -> FloatPicture:
        """Render the light on the sensor (h, w, 3) float32 [grey levels].

        Each instant has poses (3,) of bodies and pushers [m, m, rad], at times spread evenly over
        the exposure; with a hand where there is a pose for `HAND`.
        """
        placed = [self._placed(poses) for poses in instants]
        window = PictureWindow(0, 0, 0, 0)
        for moving in placed:
            for thing in moving:
                window = window.joined(thing.window)
            window = window.joined(shadow_window(moving, self._eye))
        margin = int(np.ceil(3.0 * self._looks.blur)) + 1
        window = window.grown(margin, self.size)
        picture = self._still.copy()
        if window.width and window.height:
            light = self._painted(placed[0], window)
            for moving in placed[1:]:
                light += self._painted(moving, window)
            light /= np.float32(len(placed))
            self._paste(picture, window, light, margin)
        return picture

    def _placed(self, poses: Poses) -> list[PlacedSolid]:
        placed = [place(solid, poses[name], self._eye) for name, solid in self._moving]
        if HAND in poses:
            placed.append(place(self._hand, poses[HAND], self._eye))
        return placed

    def _painted(
        self, moving: Sequence[PlacedSolid], window: PictureWindow | None = None
    ) -> FloatPicture:
        """Paint resting and moving things in a window, without blur."""
        window = window or PictureWindow(0, 0, *self.size)
        depth, eye = self._looks.shadows, self._eye
        things = [*self._resting, *moving]
        picture = self._plate[window.slices].copy()
        dimmed = shade(window, 0.0, things, eye, depth)
        if dimmed is not None:
            picture *= dimmed[..., None]
        paint = painter(window, picture)
        for thing in painting_order(things, eye.position):
            if not thing.window.meets(window):
                continue
            shades = self._shades(thing, things, window)
            for stroke, level in thing.strokes:
                paint(stroke, None if level is None else shades.get(level))
        return picture

    def _shades(
        self, thing: PlacedSolid, things: Sequence[PlacedSolid], window: PictureWindow
    ) -> dict[float, FloatPicture]:
        """Compute shadows of higher things on the faces of one that has markers."""
        if not thing.solid.markings:
            return {}
        high = thing.solid.high
        others = [other for other in things if other is not thing and other.solid.high > high]
        dimmed = shade(window, high, others, self._eye, self._looks.shadows)
        if dimmed is None:
            return {}
        return {level: dimmed for _, level in thing.strokes if level is not None}

    def _developed(self, window: PictureWindow, light: FloatPicture) -> FloatPicture:
        """Apply blur and vignetting of the lens."""
        if self._looks.blur > 0.0:
            light = opencv().GaussianBlur(light, (0, 0), self._looks.blur)
        return np.asarray(light * self._falloff[window.slices][..., None])

    def _paste(
        self, picture: FloatPicture, window: PictureWindow, light: FloatPicture, margin: int
    ) -> None:
        """Copy a window into the picture, without the margin that blurring made invalid."""
        ends = zip((window.top, window.left), light.shape, self.size[::-1], strict=False)
        inside = tuple(
            slice(margin if first > 0 else 0, n - (margin if first + n < whole else 0))
            for first, n, whole in ends
        )
        picture[window.slices][inside] = self._developed(window, light)[inside]


COARSE: Final = 4  # [px] per value; shadows are soft

# Offsets of shadows from points of the lamp and of the bright room, along x and y per unit of
# height, and shares of these points in the light.
_LAMP = [(0.42 + 0.16 * np.cos(a), -0.37 + 0.16 * np.sin(a)) for a in np.arange(5) * 0.4 * np.pi]
_ROOM = [(0.75 * np.cos(a), 0.75 * np.sin(a)) for a in 0.3 + np.arange(5) * 0.4 * np.pi]
RAYS: Final = np.array(_LAMP + _ROOM)
SHARES: Final = np.array([0.13] * 5 + [0.07] * 5)
SHADOW_REACH: Final = float(np.abs(RAYS).max())  # longest shadow per unit of height


def shadow_window(things: Sequence[PlacedSolid], eye: Projection) -> PictureWindow:
    """Window that the shadows of solids on the plane can touch."""
    window = PictureWindow(0, 0, 0, 0)
    for thing in things:
        high = thing.solid.high
        for piece in thing.footprint:
            low, top = (
                piece.min(axis=0) - SHADOW_REACH * high,
                piece.max(axis=0) + SHADOW_REACH * high,
            )
            corners = np.array([low, [top[0], low[1]], top, [low[0], top[1]]])
            window = window.joined(window_of(eye.project_at(corners, 0.0), eye.size))
    return window.grown(2 * COARSE, eye.size)


def shade(
    window: PictureWindow,
    level: float,
    casters: Sequence[PlacedSolid],
    eye: Projection,
    depth: float,
) -> FloatPicture | None:
    """Compute the light that shadows leave on a horizontal face, in a window of the picture.

    `level` is the height of the face [m]; solids below it cast no shadow on it. `depth` is the
    share of the light that is missing in a full shadow [-]. The factors (h, w) are None without
    shadows.
    """
    hulls = [
        hull
        for thing in casters
        if depth > 0.0 and thing.solid.high > level + 1e-4
        for hull in _hulls(thing, level, eye)
    ]
    if not hulls:
        return None
    # On the same grid for all windows, or shadows would flicker as windows move.
    left, top = window.left % COARSE, window.top % COARSE
    w, h = -(-(window.width + left) // COARSE), -(-(window.height + top) // COARSE)
    corner = np.array([window.left - left, window.top - top])
    ends = (np.array([ends for _, ends in hulls]) + 0.5 - corner) / COARSE - 0.5
    meets = (ends[:, 0] < (w, h)).all(axis=1) & (ends[:, 1] > -1.0).all(axis=1)
    if not meets.any():
        return None
    room = np.zeros((h, w + 2))
    lost: FloatPicture = np.zeros((h, w), np.float32)
    one: FloatPicture = np.empty((h, w), np.float32)
    for ray, share in enumerate(SHARES):
        one[:] = 0.0
        for k in np.flatnonzero(meets[ray :: len(RAYS)]).tolist():
            cover(one, room, (hulls[ray + k * len(RAYS)][0] + 0.5 - corner) / COARSE - 0.5)
        lost += share * one
    cv2 = opencv()
    smooth = cv2.GaussianBlur(lost, (0, 0), 0.7)
    fine = cv2.resize(smooth, (w * COARSE, h * COARSE), interpolation=cv2.INTER_LINEAR)
    part = fine[top : top + window.height, left : left + window.width]
    return np.asarray(1.0 - np.float32(depth) * part)


def _hulls(
    thing: PlacedSolid, level: float, eye: Projection
) -> list[tuple[FloatArray, FloatArray]]:
    """Shadows of the pieces of a solid on a horizontal face, for every ray; computed once."""
    if level not in thing.shadows:
        low, high = thing.solid.low, thing.solid.high
        thing.shadows[level] = [
            hull for piece in thing.footprint for hull in _swept(piece, low, high, level, eye)
        ]
    return thing.shadows[level]


def _swept(
    piece: FloatArray, low: float, high: float, level: float, eye: Projection
) -> list[tuple[FloatArray, FloatArray]]:
    """Shadow of a convex piece for every ray, as convex polygons with their ends [px]."""
    cv2 = opencv()
    near, far = max(low - level, 0.0), high - level
    ends = np.concatenate((piece + near * RAYS[:, None], piece + far * RAYS[:, None]), axis=1)
    pixels = eye.project_at(ends, level).astype(np.float32)
    hulls = [np.asarray(cv2.convexHull(ray)[:, 0], dtype=np.float64) for ray in pixels]
    return [(hull, np.array([hull.min(axis=0), hull.max(axis=0)])) for hull in hulls]
