"""Solids on the plate: upright prisms with printed markers, and their projection to polygons."""

from __future__ import annotations

from math import ceil, pi
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fixel.model import Disk, Shape
from fixel.model.shape import placed
from fixel.typing import FloatArray
from fixel.vision.render import canvas
from fixel.vision.render.virtual_camera import Projection

CHORD: Final = 8.0  # [px] longest piece of a straight edge drawn as a line, in spite of distortion
SAGITTA: Final = 0.004  # [px] largest distance of a circle's polygon from it
FACETS: Final = 32  # shades around a cylinder
OVERLAP: Final = 1.2  # [px] of neighbouring faces, so that no ground is visible between them

# Direction towards the light, for the shading of upright faces.
TO_LIGHT: Final = np.array([-0.75, 0.66])


class Outline(NamedTuple):
    """Closed line, fine enough to be projected corner by corner."""

    points: FloatArray  # (n, 2) corners, counter-clockwise, in the frame of the solid [m]
    facet: NDArray[np.int64]  # (k + 1,) index of the first corner of each face, and n

    def shrunk(self, by: float) -> Outline:
        """Shrink the outline towards its middle by about `by` [m]."""
        middle = self.points.mean(axis=0)
        r = self.points - middle
        size = float(np.hypot(*r.T).max())
        return Outline(middle + r * max(1.0 - by / size, 0.0), self.facet)


def outline_of(shape: Shape, pixel: float) -> Outline:
    """Create the outline of a shape, for a size of pixels of about `pixel` [m]."""
    if isinstance(shape, Disk):
        return circle(shape.radius, pixel)
    return polygon(shape.outline, pixel)


def polygon(corners: ArrayLike, pixel: float) -> Outline:
    """Create an outline with straight edges between corners (n, 2) [m]."""
    given = np.asarray(corners, dtype=np.float64)
    parts, facet = [], [0]
    for a, b in zip(given, np.roll(given, -1, axis=0), strict=True):
        pieces = max(1, ceil(float(np.hypot(*(b - a))) / (CHORD * pixel)))
        parts.append(a + np.outer(np.arange(pieces) / pieces, b - a))
        facet.append(facet[-1] + pieces)
    return Outline(np.concatenate(parts), np.array(facet))


def circle(radius: float, pixel: float, middle: ArrayLike = (0.0, 0.0)) -> Outline:
    """Create a circle as a polygon of the same area [m]."""
    chords = pi / np.sqrt(2.0 * SAGITTA * pixel / radius)
    per_facet = max(1, ceil(chords / FACETS))
    n = FACETS * per_facet
    angle = 2.0 * pi * np.arange(n) / n
    wide = radius * np.sqrt(2.0 * pi / n / np.sin(2.0 * pi / n))
    points = np.asarray(middle) + wide * np.column_stack((np.cos(angle), np.sin(angle)))
    return Outline(points, np.arange(0, n + 1, per_facet))


class Slab(NamedTuple):
    """Prism between two heights."""

    outline: Outline
    low: float  # heights above the plane [m]
    high: float  # heights above the plane [m]
    side: FloatArray  # (3,) colours: blue, green, red from 0 to 255
    top: FloatArray  # (3,) colours: blue, green, red from 0 to 255
    rim: float = 0.0  # width of a bright bevel around the upper face [m]


class Marking(NamedTuple):
    """Polygons of one colour at one height, on top of a solid."""

    points: FloatArray  # (n, 2) corners of all polygons in the frame of the solid [m]
    starts: NDArray[np.int64]  # (k + 1,)
    height: float  # height above the plane [m]
    colour: FloatArray  # (3,)


class Solid(NamedTuple):
    """Solid of slabs from the lowest to the highest, with ink on top."""

    name: str
    slabs: tuple[Slab, ...]
    # Convex pieces that contain all slabs, for shadows and the order of painting [m].
    footprint: tuple[FloatArray, ...]
    markings: tuple[Marking, ...] = ()
    # Texture of the upper faces, fixed to the solid, half a millimetre per value.
    grain: canvas.FloatPicture | None = None

    @property
    def low(self) -> float:
        """Height of the lowest face [m]."""
        return min(slab.low for slab in self.slabs)

    @property
    def high(self) -> float:
        """Height of the highest face [m]."""
        return max(slab.high for slab in self.slabs)


class PlacedSolid(NamedTuple):
    """Solid at a pose, as polygons in the picture."""

    solid: Solid
    footprint: tuple[FloatArray, ...]  # convex pieces in the world [m]
    # Strokes in the order of painting; upper faces with the height at which shadows fall [m].
    strokes: tuple[tuple[canvas.FilledPolygons, float | None], ...]
    window: canvas.PictureWindow  # window of all strokes
    # Shadows on horizontal faces by their heights [m], as far as they were computed: corners (n, 2)
    # of convex polygons, and their smallest and largest coordinates (2, 2) [px].
    shadows: dict[float, list[tuple[FloatArray, FloatArray]]]


GRAIN_PITCH: Final = 5e-4  # [m] between values of a solid's grain


def place(solid: Solid, pose: FloatArray, eye: Projection) -> PlacedSolid:
    """Project a solid at a pose (3,) [m, m, rad]."""
    strokes: list[tuple[canvas.FilledPolygons, float | None]] = []
    grain = _grain(solid, pose, eye)
    for slab in solid.slabs:
        strokes += _slab_strokes(slab, pose, eye, grain)
    for ink in solid.markings:
        points = placed(ink.points, pose)
        strokes.append((eye.polygons(points, ink.height, ink.colour, ink.starts), ink.height))
    window = strokes[0][0].window
    for stroke, _ in strokes[1:]:
        window = window.joined(stroke.window)
    footprint = tuple(placed(piece, pose) for piece in solid.footprint)
    return PlacedSolid(solid, footprint, tuple(strokes), window, {})


def _slab_strokes(
    slab: Slab, pose: FloatArray, eye: Projection, grain: canvas.Texture
) -> list[tuple[canvas.FilledPolygons, float | None]]:
    size = eye.size
    world = placed(slab.outline.points, pose)
    low, high = eye.project_at(world, slab.low), eye.project_at(world, slab.high)
    middle = high.mean(axis=0)
    inward = middle - high
    under = high + inward * (OVERLAP / np.maximum(np.hypot(*inward.T), OVERLAP))[:, None]
    n = len(world)
    strokes: list[tuple[canvas.FilledPolygons, float | None]] = []
    flat = slab.high <= slab.low
    for first, last, shade in [] if flat else _seen_faces(slab.outline, world, eye.position):
        k = np.arange(first, last + 1) % n
        beyond = (last + 1) % n
        step = _towards(low[k[-1]], low[beyond]), _towards(high[k[-1]], high[beyond])
        points = np.concatenate(
            (low[k], low[k[-1:]] + step[0], high[k[-1:]] + step[1], under[k[::-1]])
        )
        strokes.append((canvas.filled_polygons(points, slab.side * shade, size), None))
    if slab.rim > 0.0:
        bright = np.minimum(slab.top * 1.25 + 14.0, 250.0)
        strokes.append((canvas.filled_polygons(high, bright, size), slab.high))
        high = eye.project_at(placed(slab.outline.shrunk(slab.rim).points, pose), slab.high)
    strokes.append((canvas.filled_polygons(high, slab.top, size, grain=grain), slab.high))
    return strokes


def _seen_faces(
    outline: Outline, world: FloatArray, eye: FloatArray
) -> list[tuple[int, int, float]]:
    """Visible faces, farthest first: first and last corner, and brightness."""
    corner = world[outline.facet[:-1]]
    along = np.roll(corner, -1, axis=0) - corner
    outward = np.column_stack((along[:, 1], -along[:, 0]))
    outward /= np.maximum(np.hypot(*outward.T), 1e-12)[:, None]
    to_eye = eye[:2] - (corner + 0.5 * along)
    seen = np.flatnonzero((outward * to_eye).sum(axis=1) > 0.0)
    order = seen[np.argsort(-np.hypot(*to_eye[seen].T), kind="stable")]
    bright = 0.62 + 0.38 * outward @ TO_LIGHT
    return [(int(outline.facet[k]), int(outline.facet[k + 1]), float(bright[k])) for k in order]


def _towards(a: FloatArray, b: FloatArray) -> FloatArray:
    """Step from a towards b, of at most `OVERLAP` [px]."""
    way = b - a
    length = float(np.hypot(*way))
    return way * (min(OVERLAP, length) / length) if length > 0.0 else way


def _grain(solid: Solid, pose: FloatArray, eye: Projection) -> canvas.Texture:
    """Place a solid's grain by a linear map near its middle, sufficient for a texture."""
    if solid.grain is None:
        return canvas.PLAIN
    local = np.array([[0.0, 0.0], [0.01, 0.0], [0.0, 0.01]])
    pixels = eye.project_at(placed(local, pose), solid.high)
    pixel_from_local = np.column_stack(((pixels[1:] - pixels[0]).T / 0.01, pixels[0]))
    inverse = np.linalg.inv(pixel_from_local[:, :2])
    matrix = np.column_stack((inverse, -inverse @ pixel_from_local[:, 2]))
    return solid.grain, matrix / GRAIN_PITCH


def painting_order(things: list[PlacedSolid], eye: FloatArray) -> list[PlacedSolid]:
    """Order in which solids are painted: those that hide others after these.

    An upright solid hides others behind it as seen from the foot of the camera. Where footprints
    overlap, the higher one is on top.
    """
    left = list(things)
    ordered: list[PlacedSolid] = []
    while left:
        # A solid that hides none of the others is next; in a cycle, the first one.
        free = (a for a in left if not any(_hides(a, b, eye) for b in left if b is not a))
        chosen = next(free, left[0])
        ordered.append(chosen)
        left.remove(chosen)
    return ordered


def _hides(a: PlacedSolid, b: PlacedSolid, eye: FloatArray) -> bool:
    """Whether part of `a` may hide part of `b`."""
    return a.window.meets(b.window) and any(
        _piece_hides(p, q, a.solid.high >= b.solid.high, eye)
        for p in a.footprint
        for q in b.footprint
    )


def _piece_hides(p: FloatArray, q: FloatArray, higher: bool, eye: FloatArray) -> bool:
    best, axis, edge = -np.inf, np.zeros(2), 0.0
    for one, other, sign in ((p, q, 1.0), (q, p, -1.0)):
        along = np.roll(one, -1, axis=0) - one
        outward = np.column_stack((along[:, 1], -along[:, 0]))
        outward /= np.maximum(np.hypot(*outward.T), 1e-12)[:, None]
        reach = (one * outward).sum(axis=1)
        gap = (other @ outward.T).min(axis=0) - reach
        k = int(np.argmax(gap))
        if gap[k] > best:
            best, axis = float(gap[k]), sign * outward[k]
            edge = sign * float(reach[k] + 0.5 * gap[k])
    if best < -1e-3:  # [m] overlap: one stands on the other
        return higher
    return float(eye[:2] @ axis) < edge
