"""Plate and solids of the testbed: objects, actuator, fixels with coils and a hand, markers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fixel.model import Body, Disk, Fixel, LineDrive, Pusher, Shape
from fixel.model.probability import stream
from fixel.model.shape import placed
from fixel.typing import FloatArray
from fixel.vision.frame import opencv
from fixel.vision.marks import Mark, Rig, Tag, cells
from fixel.vision.render.canvas import FilledPolygons, FloatPicture, PictureWindow, painter
from fixel.vision.render.solids import Marking, Slab, Solid, circle, outline_of, polygon
from fixel.vision.render.virtual_camera import Projection

QUIET: Final = 1.0  # width of the white margin in cells, which detectors need

PAPER: Final = np.array([222.0, 226.0, 228.0])
TONER: Final = np.array([30.0, 28.0, 27.0])
COLOUR_OF: Final[dict[str, tuple[float, float, float]]] = {
    "red": (42.0, 38.0, 205.0),
    "orange": (30.0, 120.0, 235.0),
    "yellow": (45.0, 215.0, 235.0),
    "green": (70.0, 165.0, 55.0),
    "cyan": (205.0, 190.0, 40.0),
    "blue": (185.0, 85.0, 35.0),
    "magenta": (165.0, 45.0, 205.0),
}
OBJECT_HEIGHT: Final = 0.0254  # [m] for bodies that the rig lacks
HEAD_HEIGHT: Final = 0.030  # [m] for pushers that the rig lacks
DELRIN: Final = np.array([62.0, 60.0, 58.0])
COPPER: Final = np.array([78.0, 122.0, 176.0])  # the tape that closes the fixels' circuits
WIRE: Final = np.array([52.0, 98.0, 160.0])
TAPE: Final = np.array([58.0, 56.0, 55.0])
ALUMINIUM: Final = np.array([178.0, 177.0, 174.0])
BRIGHT: Final = np.array([226.0, 226.0, 224.0])
HOUSING: Final = np.array([44.0, 42.0, 41.0])
HEAD: Final = np.array([150.0, 149.0, 146.0])
SKIN: Final = np.array([124.0, 150.0, 196.0])
SLEEVE: Final = np.array([112.0, 84.0, 62.0])
ROD: Final = (0.011, 0.008, 0.019)  # [m] width, lower and upper height
ROD_LENGTH: Final = 0.30  # [m]
ACTUATOR: Final = (0.038, 0.020, 0.34, 0.042)  # [m] width, distance behind the head, length, height
HAND_AT: Final = (0.066, 0.092)  # [m] lower and upper height


def markings(mark: Mark, pixel: float) -> tuple[Marking, ...]:
    """Return the coloured polygons of a marker, for a size of pixels of about `pixel` [m]."""
    if isinstance(mark, Tag):
        return _tag(mark, pixel)
    ring = circle(0.5 * mark.diameter, pixel, mark.place).points
    colour = np.array(COLOUR_OF[mark.colour])
    return (Marking(ring, np.array([0, len(ring)]), mark.height, colour),)


def _tag(tag: Tag, pixel: float) -> tuple[Marking, Marking]:
    white = cells(tag.family, tag.id)[1]
    n = math.isqrt(len(white))
    cell = tag.size / n
    half = 0.5 * tag.size + QUIET * cell
    corners = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    paper = polygon(corners, pixel).points
    row, column = np.nonzero(~white.reshape(n, n))
    # Neighbours share their edges exactly, so that no paper is visible between them.
    left, top = cell * column - 0.5 * tag.size, 0.5 * tag.size - cell * row
    square = cell * np.array([[0.0, -1.0], [1.0, -1.0], [1.0, 0.0], [0.0, 0.0]])
    ink = (np.column_stack((left, top))[:, None] + square).reshape(-1, 2)
    return (
        _ink(paper, np.array([0, len(paper)]), tag, PAPER),
        _ink(ink, np.arange(0, len(ink) + 1, 4), tag, TONER),
    )


def _ink(points: FloatArray, starts: NDArray[np.int64], tag: Tag, colour: FloatArray) -> Marking:
    return Marking(placed(points, tag.pose), starts, tag.height, colour)


def body_solid(body: Body, rig: Rig, pixel: float, grain: FloatPicture) -> Solid:
    """Create an object: black plastic with copper tape around its sides, and its markers."""
    height, drawn = _printed(rig, body.name, OBJECT_HEIGHT, pixel)
    slab = Slab(outline_of(body.shape, pixel), 0.0, height, COPPER, DELRIN, rim=0.0008)
    return Solid(body.name, (slab,), _pieces(body.shape), drawn, grain)


def _printed(rig: Rig, name: str, usual: float, pixel: float) -> tuple[float, tuple[Marking, ...]]:
    """Return the height of a part, by default the usual one, and the polygons of its markers."""
    part = rig.parts.get(name)
    if part is None:
        return usual, ()
    return part.height, tuple(ink for mark in part.marks for ink in markings(mark, pixel))


def pusher_solids(pusher: Pusher, rig: Rig, pixel: float, grain: FloatPicture) -> list[Solid]:
    """Create the head of the actuator with its markers, and the rod behind it; both move."""
    height, drawn = _printed(rig, pusher.name, HEAD_HEIGHT, pixel)
    slab = Slab(outline_of(pusher.shape, pixel), 0.002, height, 0.8 * HEAD, HEAD, rim=0.0006)
    head = Solid(pusher.name, (slab,), _pieces(pusher.shape), drawn, grain)
    width, low, high = ROD
    rod = _behind(pusher, 0.5 * _extent(pusher.shape), ROD_LENGTH, width)
    steel = Slab(polygon(rod, pixel), low, high, 0.62 * ALUMINIUM, ALUMINIUM, rim=0.002)
    return [Solid(f"{pusher.name}'s rod", (steel,), (rod,)), head]


def housing_solid(pusher: Pusher, pixel: float) -> Solid:
    """Create the housing of the rod, bolted to the plate behind the head's start."""
    width, gap, length, height = ACTUATOR
    start = 0.5 * _extent(pusher.shape) + gap
    block = _behind(pusher, start, length, width)
    mount = _behind(pusher, start + 0.012, 0.02, width + 0.034)
    slabs = (
        Slab(polygon(mount, pixel), 0.0, 0.008, 0.7 * ALUMINIUM, 0.92 * ALUMINIUM, rim=0.0006),
        Slab(polygon(block, pixel), 0.0, height, HOUSING, 1.25 * HOUSING, rim=0.0012),
    )
    return Solid(f"{pusher.name}'s housing", slabs, (block, mount))


def fixel_solid(fixel: Fixel, height: float, pixel: float) -> Solid:
    """Create a fixel: two coils of copper wire over tape, and a turned end with a threaded hole."""
    if not isinstance(fixel.shape, Disk):
        outline = outline_of(fixel.shape, pixel)
        slab = Slab(outline, 0.0, height, 0.8 * ALUMINIUM, BRIGHT, rim=0.0006)
        return Solid(fixel.name, (slab,), _pieces(fixel.shape))
    r = fixel.shape.radius
    core, coil = circle(0.9 * r, pixel), circle(r, pixel)
    levels = (  # as shares of the height
        (core, 0.0, 0.12, TAPE, TAPE),
        (coil, 0.12, 0.25, WIRE, 0.8 * WIRE),
        (core, 0.25, 0.31, TAPE, TAPE),
        (coil, 0.31, 0.44, WIRE, 0.8 * WIRE),
        (core, 0.44, 0.58, TAPE, TAPE),
        (core, 0.58, 1.0, 0.86 * ALUMINIUM, 0.45 * ALUMINIUM),
    )
    slabs = [
        Slab(ring, low * height, up * height, side, top) for ring, low, up, side, top in levels
    ]
    slabs += [
        Slab(circle(share * r, pixel), height, height, colour, colour)
        for share, colour in ((0.78, BRIGHT), (0.30, 0.25 * ALUMINIUM))
    ]
    return Solid(fixel.name, tuple(slabs), (coil.points[::8],))


def hand_solid(pixel: float) -> Solid:
    """Create a flat hand that reaches along +x, with its fingertips near the origin."""
    fingers = [(-0.031, -0.012), (-0.0105, 0.0), (0.0105, -0.003), (0.030, -0.022)]
    bones = [
        ((-0.052, 0.066), (-0.098, 0.040), 0.0105),
        *(((tip - 0.009, y), (-0.085, 0.85 * y), 0.0093) for y, tip in fingers),
        ((-0.086, 0.021), (-0.086, -0.021), 0.020),
        ((-0.110, 0.019), (-0.110, -0.017), 0.022),
        ((-0.125, 0.0), (-0.23, -0.003), 0.029),
    ]
    arm = ((-0.225, -0.003), (-0.9, -0.05), 0.043)
    slabs: list[Slab] = []
    for parts, colour in ((bones, SKIN), ([arm], SLEEVE)):
        # Smaller and brighter layers on top of each other give a round appearance.
        for layer, shrink in enumerate((0.0, 0.22, 0.45, 0.7)):
            level = HAND_AT[0] + (HAND_AT[1] - HAND_AT[0]) * layer / 3.0
            bright = colour * (0.82 + 0.07 * layer)
            for tip, root, radius in parts:
                ring = polygon(_capsule(tip, root, radius * (1.0 - shrink)), pixel)
                slabs.append(Slab(ring, level, level, bright, bright))
    footprint = tuple(_capsule(*bone)[::2] for bone in (*bones, arm))
    return Solid("hand", tuple(slabs), footprint)


def grain(seed: int, purpose: str, rough: float) -> FloatPicture:
    """Create a seamless texture (256, 256) of mean 1 and deviation `rough`."""
    cv2 = opencv()
    white = stream(seed, "film", purpose).standard_normal((256, 256))
    wrapped = np.pad(white, 24, mode="wrap").astype(np.float32)
    soft = cv2.GaussianBlur(wrapped, (0, 0), 1.2) + 0.5 * cv2.GaussianBlur(wrapped, (0, 0), 6.0)
    middle = soft[24:-24, 24:-24]
    return np.asarray(1.0 + rough * (middle - middle.mean()) / middle.std(), dtype=np.float32)


def pixel_of(rig: Rig) -> float:
    """Scale in the middle of the picture, at the height of objects [m/px]."""
    return rig.camera.metres_per_pixel(OBJECT_HEIGHT)


def direction_of(pusher: Pusher) -> FloatArray:
    """Unit vector (2,) along which a pusher moves, in its own frame at the start."""
    drive = pusher.drive
    if isinstance(drive, LineDrive):
        along = drive.direction
    else:
        along = drive.waypoints[-1, 1:3] - drive.waypoints[0, 1:3]
    length = float(np.hypot(*along))
    along = along / length if length > 0.0 else np.array([1.0, 0.0])
    return placed(along, (0.0, 0.0, -pusher.pose[2]))


def _behind(pusher: Pusher, start: float, length: float, width: float) -> FloatArray:
    """Corners (4, 2) of a bar behind a pusher, from `start` behind its middle [m]."""
    x = direction_of(pusher)
    y = np.array([-x[1], x[0]])
    near, far, half = -start * x, -(start + length) * x, 0.5 * width * y
    return np.array([far - half, near - half, near + half, far + half])


def _extent(shape: Shape) -> float:
    return float(np.ptp(shape.outline, axis=0).min())


def _pieces(shape: Shape) -> tuple[FloatArray, ...]:
    if isinstance(shape, Disk):
        return (shape.outline[::2],)
    return tuple(piece for piece, _ in shape.pieces)


def _capsule(tip: ArrayLike, root: ArrayLike, radius: float) -> FloatArray:
    """Outline (n, 2) of a capsule around two points, counter-clockwise."""
    a, b = np.asarray(tip), np.asarray(root)
    along = a - b
    heading = float(np.arctan2(along[1], along[0]))
    half = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 9)
    ends = [(a, heading + half), (b, heading + np.pi + half)]
    return np.concatenate(
        [p + radius * np.column_stack((np.cos(angle), np.sin(angle))) for p, angle in ends]
    )


HALF: Final = 0.305  # [m] half the plate's side
PITCH: Final = 0.0254  # [m] between holes
HOLE: Final = 0.0031  # [m] radius
NODES: Final = 16  # [px] between places that are computed; others are interpolated

METAL: Final = np.array([171.0, 170.0, 167.0])
WOOD: Final = np.array([66.0, 92.0, 122.0])
DARK: Final = np.array([34.0, 33.0, 32.0])


def plane_places(eye: Projection) -> NDArray[np.float32]:
    """Place of the plane under every pixel (h, w, 2) [m], approximate, for textures."""
    w, h = eye.size
    u = np.linspace(0.0, w - 1.0, max(2, w // NODES))
    v = np.linspace(0.0, h - 1.0, max(2, h // NODES))
    nodes = eye.camera.on_plane(np.stack(np.meshgrid(u, v), axis=-1))
    across, down = _hats(u, w), _hats(v, h)
    places = np.stack([down @ nodes[..., k] @ across.T for k in (0, 1)], axis=-1)
    return np.asarray(places, dtype=np.float32)


def backdrop(rig: Rig, eye: Projection, seed: int) -> FloatPicture:
    """Render table and plate (h, w, 3) without shadows."""
    size = eye.size
    places = plane_places(eye)
    middle = _middle(eye)
    metal = _brushed(places, seed) + _sheen(places, middle)
    picture = np.asarray(WOOD * _planks(places, seed)[..., None], dtype=np.float32)
    paint = painter(PictureWindow(0, 0, *size), picture)
    for stroke in _plate_strokes(eye, middle):
        paint(stroke)
    sheet = np.asarray(METAL * (metal / METAL.mean())[..., None], dtype=np.float32)
    picture[:] = picture + _plate_share(eye, middle) * (sheet - picture)
    for stroke in (*_holes(eye, middle), *_scratches(eye, middle, seed)):
        paint(stroke)
    for tag in rig.plate:
        for ink in markings(tag, eye.camera.metres_per_pixel()):
            paint(eye.polygons(ink.points, ink.height, ink.colour, ink.starts))
    return picture


def falloff(eye: Projection, vignetting: float) -> FloatPicture:
    """Share of the light that reaches the sensor (h, w), which falls towards the corners."""
    w, h = eye.size
    u, v = np.arange(w) - 0.5 * (w - 1), np.arange(h) - 0.5 * (h - 1)
    out = (u**2 + v[:, None] ** 2) / max(u[0] ** 2 + v[0] ** 2, 1.0)
    return np.asarray(1.0 - vignetting * out, dtype=np.float32)


def _middle(eye: Projection) -> FloatArray:
    """Place in the middle of the picture, rounded to the grid of holes [m]."""
    w, h = eye.size
    seen = eye.camera.on_plane([0.5 * (w - 1), 0.5 * (h - 1)])
    return np.asarray(np.rint(seen / PITCH) * PITCH)


def _corners(middle: FloatArray) -> FloatArray:
    return middle + HALF * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def _plate_strokes(eye: Projection, middle: FloatArray) -> Iterator[FilledPolygons]:
    """Yield the shadow line under the plate, and its milled edge."""
    pixel = eye.camera.metres_per_pixel()
    for grown, colour in ((0.006, 0.45 * WOOD), (0.0015, 0.6 * METAL)):
        corners = middle + (_corners(middle) - middle) * (1.0 + grown / HALF)
        yield eye.polygons(polygon(corners, pixel).points, 0.0, colour)


def _plate_share(eye: Projection, middle: FloatArray) -> FloatPicture:
    size = eye.size
    share = np.zeros((size[1], size[0], 3), np.float32)
    outline = polygon(_corners(middle), eye.camera.metres_per_pixel()).points
    paint = painter(PictureWindow(0, 0, *size), share)
    paint(eye.polygons(outline, 0.0, np.ones(3)))
    return share


def _holes(eye: Projection, middle: FloatArray) -> Iterator[FilledPolygons]:
    """Yield threaded holes with a countersink, bright on one side."""
    pixel = eye.camera.metres_per_pixel()
    reach = int((HALF - 0.012) / PITCH)
    steps = PITCH * np.arange(-reach, reach + 1)
    places = middle + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    places = places[eye.camera.lens.sees(eye.project_at(places, 0.0))]
    rings = (
        (1.45 * HOLE, (0.0, 0.0), 0.80 * METAL),
        (1.36 * HOLE, (-0.0003, 0.0003), 1.16 * METAL),
        (1.12 * HOLE, (0.0, 0.0), 0.55 * METAL),
        (HOLE, (0.0, 0.0), DARK),
    )
    for radius, aside, colour in rings if len(places) else ():
        ring = circle(radius, pixel, aside).points
        points, starts = places[:, None] + ring, len(ring) * np.arange(len(places) + 1)
        yield eye.polygons(points.reshape(-1, 2), 0.0, colour, starts)


def _scratches(eye: Projection, middle: FloatArray, seed: int) -> Iterator[FilledPolygons]:
    random = stream(seed, "film", "scratches")
    for _ in range(26):
        place = middle + random.uniform(-HALF, HALF, 2) * 0.97
        angle = random.normal(0.2, 0.7)
        along = np.array([np.cos(angle), np.sin(angle)]) * random.uniform(0.01, 0.05)
        across = np.array([-along[1], along[0]]) / np.hypot(*along) * 1.2e-4
        line = np.array([place, place + along, place + along + across, place + across])
        if (np.abs(line - middle) < HALF).all():
            yield eye.polygons(line, 0.0, METAL * random.uniform(1.04, 1.2))


def _brushed(places: NDArray[np.float32], seed: int) -> FloatPicture:
    """Grey levels (h, w) of brushed metal, without the reflection of the lamp."""
    fine = _noise(seed, "brushed", (512, 512), (40.0, 0.5))
    slow = _noise(seed, "stains", (512, 512), (18.0, 14.0))
    return np.asarray(
        METAL.mean() + 3.2 * _sampled(fine, places, 5e-4) + 2.6 * _sampled(slow, places, 1.1e-3)
    )


def _planks(places: NDArray[np.float32], seed: int) -> FloatPicture:
    wood = _noise(seed, "wood", (512, 512), (1.2, 30.0))
    return np.asarray(1.0 + 0.11 * _sampled(wood, places, 8e-4))


def _sheen(places: NDArray[np.float32], middle: FloatArray) -> FloatPicture:
    """Broad reflection of the lamp (h, w) [grey levels]."""
    aside = places - (middle + np.array([-0.11, 0.09])).astype(np.float32)
    far = aside[..., 0] ** 2 / 0.26**2 + aside[..., 1] ** 2 / 0.17**2
    return np.asarray(20.0 * np.exp(-0.5 * far) - 6.0)


def _noise(
    seed: int, purpose: str, size: tuple[int, int], soft: tuple[float, float]
) -> FloatPicture:
    """Create a seamless texture of deviation 1, smoothed by `soft` values along x and y."""
    white = stream(seed, "film", purpose).standard_normal(size).astype(np.float32)
    margin = int(np.ceil(3.0 * max(soft)))
    wrapped = np.pad(white, margin, mode="wrap")
    smooth = opencv().GaussianBlur(wrapped, (0, 0), soft[0], sigmaY=soft[1])
    middle = smooth[margin:-margin, margin:-margin]
    return np.asarray(middle / middle.std(), dtype=np.float32)


def _sampled(texture: FloatPicture, places: NDArray[np.float32], pitch: float) -> FloatPicture:
    cv2: Any = opencv()
    at = np.mod(places / np.float32(pitch), np.float32(len(texture)))
    return np.asarray(cv2.remap(texture, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP))


def _hats(nodes: FloatArray, count: int) -> FloatArray:
    """Weights (count, n) of linear interpolation between nodes."""
    unit = np.eye(len(nodes))
    return np.stack([np.interp(np.arange(count), nodes, row) for row in unit], axis=-1)
