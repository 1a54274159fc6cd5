"""Inner loops of tracking, called thousands of times a second, compiled, and how to call them.

As in the kernels, arguments are arrays and numbers, and errors a status instead of exceptions.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.kernels.jit import entry, kernel
from fixel.typing import BoolArray, FloatArray
from fixel.vision.camera import Camera
from fixel.vision.frame import Gray

STEP = 0.5  # [px] between readings along a normal
WINDOW = 2.6  # [px] half width of the window of an edge's rise
SHIFTS = 4  # of that window onto the centroid of its content
SIDE_DISTANCE = 2.5  # [px] from an edge to the readings of its dark and bright side
MIN_RISE = 12.0  # of brightness, of 255, least rise of an edge

NUDGE = 1e-5  # [m] step for derivatives of pixels by places
MAX_KEPT: Final = 64
# Arrays by the identity of their camera, since its hash takes longer than a projection. Storing the
# camera too ensures that its identity is not reused.
_kept: dict[int, tuple[Camera, FloatArray]] = {}


@kernel
def _bilinear(picture: Gray, u: float, v: float) -> float:
    """Bilinear brightness at a place; beyond the picture, as at its border."""
    height, width = picture.shape
    u = min(max(u, 0.0), width - 1.0)
    v = min(max(v, 0.0), height - 1.0)
    x, y = min(int(u), width - 2), min(int(v), height - 2)
    a, b = u - x, v - y
    above = (1.0 - a) * picture[y, x] + a * picture[y, x + 1]
    below = (1.0 - a) * picture[y + 1, x] + a * picture[y + 1, x + 1]
    return float((1.0 - b) * above + b * below)


@entry
def edges_along(
    picture: Gray,
    pixel: FloatArray,
    normal: FloatArray,
    reach: float,
    found: FloatArray,
    clear: BoolArray,
) -> None:
    """Find the rise of brightness along normals.

    Writes offset, dark and bright into the rows of `found` (n, 3), and whether there is an edge
    into `clear` (n,). Readings are bilinear; beyond the picture, as at its border.
    """
    height, width = picture.shape
    half = math.ceil(reach / STEP)
    m = 2 * half + 1
    profile = np.empty(m)
    for i in range(len(pixel)):
        u0, v0 = pixel[i, 0], pixel[i, 1]
        for k in range(m):
            s = STEP * (k - half)
            profile[k] = _bilinear(picture, u0 + s * normal[i, 0], v0 + s * normal[i, 1])
        best, fastest = 0, -1e300
        for k in range(m - 1):
            last, first = min(k + 2, m - 1), max(k - 1, 0)
            if profile[last] - profile[first] > fastest:
                best, fastest = k, profile[last] - profile[first]
        centre = STEP * (best + 0.5 - half)
        total = 0.0
        for _ in range(SHIFTS):
            total = moment = 0.0
            for k in range(m - 1):
                middle = STEP * (k + 0.5 - half)
                apart = (middle - centre) / WINDOW
                rise = profile[k + 1] - profile[k]
                if rise > 0.0 and abs(apart) < 1.0:
                    weight = rise * (1.0 - apart * apart)
                    total += weight
                    moment += weight * middle
            if total > 0.0:
                centre = moment / total
        found[i, 0] = centre
        for side in range(2):
            place = round((centre + (2 * side - 1) * SIDE_DISTANCE) / STEP) + half
            k = int(min(max(place, 1), m - 2))
            found[i, 1 + side] = (profile[k - 1] + profile[k] + profile[k + 1]) / 3.0
        clear[i] = (
            total > MIN_RISE
            and abs(centre) <= reach - 0.5 * WINDOW
            and 1.0 <= u0 <= width - 2.0
            and 1.0 <= v0 <= height - 2.0
        )


@kernel
def _pixel(optics: FloatArray, x: float, y: float, z: float) -> tuple[float, float, bool]:
    """Pixel of a point of the world, as `Camera.project`, and whether there is one."""
    depth = optics[6] * x + optics[7] * y + optics[8] * z + optics[11]
    if not depth > 0.0:
        return 0.0, 0.0, False
    p = (optics[0] * x + optics[1] * y + optics[2] * z + optics[9]) / depth
    q = (optics[3] * x + optics[4] * y + optics[5] * z + optics[10]) / depth
    if optics[17] > 0.0:
        r = math.hypot(p, q)
        a = math.atan(r)
        a2 = a * a
        seen = a * (
            1.0
            + a2
            * (optics[18] + a2 * (optics[18 + 1] + a2 * (optics[18 + 2] + a2 * optics[18 + 3])))
        )
        ratio = seen / r if r > 0.0 else 1.0
        p, q = p * ratio, q * ratio
    else:
        r2 = p * p + q * q
        radial = (1.0 + r2 * (optics[18] + r2 * (optics[18 + 1] + r2 * optics[18 + 4]))) / (
            1.0 + r2 * (optics[18 + 5] + r2 * (optics[18 + 6] + r2 * optics[18 + 7]))
        )
        aside = 2.0 * optics[18 + 2] * p * q + optics[18 + 3] * (r2 + 2.0 * p * p)
        down = optics[18 + 2] * (r2 + 2.0 * q * q) + 2.0 * optics[18 + 3] * p * q
        p, q = p * radial + aside, q * radial + down
    u = (p + optics[16] * q) * optics[12] + optics[14]
    v = q * optics[13] + optics[15]
    return u, v, math.isfinite(u) and math.isfinite(v)


@entry
def pixel_of(optics: FloatArray, x: float, y: float, z: float) -> tuple[float, float, bool]:
    """Pixel of a point of the world, and whether there is one."""
    return _pixel(optics, x, y, z)


@entry
def box_of(optics: FloatArray, thing: FloatArray, pose: FloatArray, box: FloatArray) -> bool:
    """Write the bounding box (2, 2) of a thing in pixels; return whether it is in front."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    box[0, :], box[1, :] = math.inf, -math.inf
    for i in range(len(thing)):
        x = c * thing[i, 0] - s * thing[i, 1] + pose[0]
        y = s * thing[i, 0] + c * thing[i, 1] + pose[1]
        u, v, there = _pixel(optics, x, y, thing[i, 4])
        if not there:
            return False
        box[0, 0], box[0, 1] = min(box[0, 0], u), min(box[0, 1], v)
        box[1, 0], box[1, 1] = max(box[1, 0], u), max(box[1, 1], v)
    return True


@entry
def edges_expected(
    optics: FloatArray,
    corner: FloatArray,
    thing: FloatArray,
    pose: FloatArray,
    pixel: FloatArray,
    normal: FloatArray,
    slope: FloatArray,
) -> bool:
    """Write expected edges, and the derivative (n, m) of their offsets along normals by the pose.

    `thing` (n, 5) contains points, directions from dark to bright, and heights. Returns whether
    all points lie in front of the camera.
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for i in range(len(thing)):
        x = c * thing[i, 0] - s * thing[i, 1]
        y = s * thing[i, 0] + c * thing[i, 1]
        out_x = c * thing[i, 2] - s * thing[i, 3]
        out_y = s * thing[i, 2] + c * thing[i, 3]
        z = thing[i, 4]
        u, v, there = _pixel(optics, x + pose[0], y + pose[1], z)
        u_x, v_x, there_x = _pixel(optics, x + pose[0] + NUDGE, y + pose[1], z)
        u_y, v_y, there_y = _pixel(optics, x + pose[0], y + pose[1] + NUDGE, z)
        if not (there and there_x and there_y):
            return False
        u_x, v_x = (u_x - u) / NUDGE, (v_x - v) / NUDGE
        u_y, v_y = (u_y - u) / NUDGE, (v_y - v) / NUDGE
        # Normal to the edge in the picture.
        n_u, n_v = out_x * v_y - out_y * v_x, out_y * u_x - out_x * u_y
        length = math.hypot(n_u, n_v)
        if not length > 0.0:
            return False
        # The picture is mirrored with respect to the plane: orient the normal like `outward`.
        if n_u * (u_x * out_x + u_y * out_y) + n_v * (v_x * out_x + v_y * out_y) < 0.0:
            length = -length
        n_u, n_v = n_u / length, n_v / length
        pixel[i, 0], pixel[i, 1] = u - corner[0], v - corner[1]
        normal[i, 0], normal[i, 1] = n_u, n_v
        dx, dy = u_x * n_u + v_x * n_v, u_y * n_u + v_y * n_v
        slope[i, 0], slope[i, 1] = dx, dy
        if slope.shape[1] > 2:
            slope[i, 2] = x * dy - y * dx
    return True


@entry
def cells_right(
    picture: Gray,
    corner: FloatArray,
    optics: FloatArray,
    middle: FloatArray,
    height: float,
    white: BoolArray,
    pose: FloatArray,
    contrast: float,
) -> float:
    """Share of the cells (n, 2) of a tag with the right colour, black or white."""
    n = len(middle)
    level, dark, bright = np.empty(n), np.empty(n), np.empty(n)
    n_dark = n_bright = 0
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for i in range(n):
        x = c * middle[i, 0] - s * middle[i, 1] + pose[0]
        y = s * middle[i, 0] + c * middle[i, 1] + pose[1]
        u, v, there = _pixel(optics, x, y, height)
        if not there:
            return 0.0
        level[i] = _bilinear(picture, u - corner[0], v - corner[1])
        if white[i]:
            bright[n_bright] = level[i]
            n_bright += 1
        else:
            dark[n_dark] = level[i]
            n_dark += 1
    low, high = np.median(dark[:n_dark]), np.median(bright[:n_bright])
    if high - low < contrast:
        return 0.0
    right = 0
    for i in range(n):
        right += (level[i] > 0.5 * (low + high)) == white[i]
    return right / n


@entry
def cells_shown(
    picture: Gray,
    corner: FloatArray,
    optics: FloatArray,
    middle: FloatArray,
    height: float,
    white: BoolArray,
    pose: FloatArray,
    dark: float,
    bright: float,
    slack: float,
) -> tuple[int, int]:
    """Count the cells (n, 2) of a tag with the right colour, and those visible.

    A cell is visible if its brightness is within `slack` of black or white; else it is covered.
    """
    right = shown = 0
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for i in range(len(middle)):
        x = c * middle[i, 0] - s * middle[i, 1] + pose[0]
        y = s * middle[i, 0] + c * middle[i, 1] + pose[1]
        u, v, there = _pixel(optics, x, y, height)
        if not there:
            return 0, 0
        level = _bilinear(picture, u - corner[0], v - corner[1])
        if abs(level - dark) < slack or abs(level - bright) < slack:
            shown += 1
            right += (abs(level - bright) < slack) == white[i]
    return right, shown


def find_edges(
    picture: Gray, pixel: FloatArray, normal: FloatArray, reach: float
) -> tuple[FloatArray, BoolArray]:
    """Find edges along their normals, accurate to a few hundredths of a pixel.

    The expected place of an edge is known from the previous frame. Brightness is read along the
    normal, and the edge is the centre of its rise. Blur, defocus and noise do not bias this
    estimate, in contrast to the refinement of corners.

    Edges are expected at pixels (n, 2), within a reach [px]; normals (n, 2) are unit vectors from
    the dark side to the bright one. Returns offset along the normal [px], dark and bright level of
    each (n, 3), and whether there is an edge, well within reach (n,).
    """
    n = len(pixel)
    found = np.empty((n, 3))
    clear = np.empty(n, dtype=np.bool_)
    edges_along(picture, pixel, normal, reach, found, clear)
    return found, clear


def optics_of(camera: Camera) -> FloatArray:
    """Array (26,): rotation, translation, focal lengths, centre, skew, fisheye, distortion."""
    kept = _kept.get(id(camera))
    if kept is None:
        lens = camera.lens
        optics = np.concatenate(
            (
                camera.rotation.ravel(),
                camera.translation,
                lens.focal,
                lens.centre,
                (lens.skew, float(lens.fisheye)),
                lens.distortion,
            )
        )
        if len(_kept) >= MAX_KEPT:
            _kept.clear()
        kept = _kept[id(camera)] = camera, np.pad(optics, (0, 26 - len(optics)))
    return kept[1]


def seen_at(camera: Camera, place: FloatArray, height: float) -> tuple[float, float]:
    """Project one place [m] at a height above the plane [m]; a fast `Camera.project_at`."""
    u, v, there = pixel_of(optics_of(camera), float(place[0]), float(place[1]), float(height))
    if not there:
        raise InvalidInput(
            "points", found="a point behind the camera", expected="points in front of it [m]"
        )
    return u, v
