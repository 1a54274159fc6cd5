"""Rendering of the background: table, aluminium plate with holes, and tags on it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fixel.model.probability import stream
from fixel.typing import FloatArray
from fixel.vision.marks import Rig
from fixel.vision.opencv import opencv
from fixel.vision.render.bodies import markings
from fixel.vision.render.canvas import Canvas, FilledPolygons, FloatPicture, PictureWindow
from fixel.vision.render.solids import circle, polygon
from fixel.vision.render.virtual_camera import Projection

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
    canvas = Canvas(PictureWindow(0, 0, *size), picture)
    light = np.ones(picture.shape[:2], np.float32)
    for stroke in _plate_strokes(eye, middle):
        canvas.paint(stroke, light)
    sheet = np.asarray(METAL * (metal / METAL.mean())[..., None], dtype=np.float32)
    picture[:] = picture + _plate_share(eye, middle) * (sheet - picture)
    for stroke in (*_holes(eye, middle), *_scratches(eye, middle, seed)):
        canvas.paint(stroke, light)
    for tag in rig.plate:
        for ink in markings(tag, eye.pixel_size()):
            canvas.paint(eye.polygons(ink.points, ink.height, ink.colour, ink.starts), light)
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
    pixel = eye.pixel_size()
    for grown, colour in ((0.006, 0.45 * WOOD), (0.0015, 0.6 * METAL)):
        corners = middle + (_corners(middle) - middle) * (1.0 + grown / HALF)
        yield eye.polygons(polygon(corners, pixel).points, 0.0, colour)


def _plate_share(eye: Projection, middle: FloatArray) -> FloatPicture:
    size = eye.size
    share = np.zeros((size[1], size[0], 3), np.float32)
    outline = polygon(_corners(middle), eye.pixel_size()).points
    canvas = Canvas(PictureWindow(0, 0, *size), share)
    canvas.paint(eye.polygons(outline, 0.0, np.ones(3)), np.ones(share.shape[:2], np.float32))
    return share


def _holes(eye: Projection, middle: FloatArray) -> Iterator[FilledPolygons]:
    """Yield threaded holes with a countersink, bright on one side."""
    pixel = eye.pixel_size()
    reach = int((HALF - 0.012) / PITCH)
    rings = (
        (1.45 * HOLE, (0.0, 0.0), 0.80 * METAL),
        (1.36 * HOLE, (-0.0003, 0.0003), 1.16 * METAL),
        (1.12 * HOLE, (0.0, 0.0), 0.55 * METAL),
        (HOLE, (0.0, 0.0), DARK),
    )
    for i in range(-reach, reach + 1):
        for j in range(-reach, reach + 1):
            place = middle + PITCH * np.array([i, j])
            if not eye.camera.lens.sees(eye.project_at(place, 0.0)):
                continue
            for radius, aside, colour in rings:
                yield eye.polygons(circle(radius, pixel, place + aside).points, 0.0, colour)


def _scratches(eye: Projection, middle: FloatArray, seed: int) -> Iterator[FilledPolygons]:
    random = stream(seed, "film", "scratches")
    for _ in range(26):
        place = middle + random.uniform(-HALF, HALF, 2) * 0.97
        angle = random.normal(0.2, 0.7)
        along = np.array([np.cos(angle), np.sin(angle)]) * random.uniform(0.01, 0.05)
        across = np.array([-along[1], along[0]]) / np.hypot(*along) * 1.2e-4
        line = np.array([place, place + along, place + along + across, place + across])
        inside = (np.abs(line - middle) < HALF).all()
        if inside:
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
