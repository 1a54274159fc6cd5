"""Place of a camera above the plate, from a board or tags on it, and errors of places there.

All points are fitted together, so that one view of the plate gives one place, not one per tag.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.model.fields import vector
from fixel.model.shape import placed
from fixel.typing import FloatArray
from fixel.vision.boards import Board, gray_of
from fixel.vision.bundle import BundleFit, PointObservations, fit, slopes_of
from fixel.vision.camera import PLACE, Camera, MeasuredCamera, turned
from fixel.vision.frame import Picture, opencv
from fixel.vision.lens import FOCAL, Lens
from fixel.vision.marks import Tag
from fixel.vision.tracking.tag_reader import find_tags, other_families, tag_corners

MIN_TAGS: Final = 2
UNEVEN: Final = 0.2  # variation of the shift of tags' edges between corners, as a share of it
WRONG: Final = 3e-3  # [m] largest misfit of a point
WORST_PIXELS: Final = 3.0  # [px] largest root mean square; above it, board or lens is another


class Placement(NamedTuple):
    """Camera with its measured place."""

    camera: MeasuredCamera
    names: tuple[str, ...]  # names of the points, for messages
    misfit: FloatArray  # (n, 2) seen minus true place of each point, on the plane at its height [m]
    rms: float  # root mean square of the pixel residuals along each axis [px]


def place_by_board(
    measured: MeasuredCamera,
    picture: Picture,
    board: Board,
    *,
    pose: ArrayLike = (0.0, 0.0, 0.0),
    height: float = 0.0,
) -> Placement:
    """Determine the place of a camera from a board that lies on the plate.

    Parameters
    ----------
    measured : MeasuredCamera
        Camera with a calibrated lens.
    picture : (height, width, 3) or (height, width) uint8
    pose : (3,) array_like
        Pose of the board's lower left corner in the world [m, m, rad].
    height : float
        Height of its upper face above the plate [m].
    """
    _refuse_size(measured.lens, picture)
    corners = board.find(picture)
    x, y, angle = vector(pose, "board.pose", "x [m], y [m], angle [rad]")
    c, s = np.cos(angle), np.sin(angle)
    flat = corners.places @ np.array([[c, s], [-s, c]]) + [x, y]
    points = np.column_stack([flat, np.full(len(flat), height)])
    names = tuple(f"corner {k + 1}" for k in range(len(points)))
    return place_by_points(measured, points, corners.pixels, names)


def place_by_tags(measured: MeasuredCamera, picture: Picture, tags: Sequence[Tag]) -> Placement:
    """Determine the place of a camera from tags fixed to the plate, at known poses."""
    _refuse_size(measured.lens, picture)
    found = find_tags(picture, tags)
    if len(found) < MIN_TAGS:
        seen = ", ".join(str(tags[k].id) for k in found) or "none"
        others = other_families(gray_of(picture), {tag.family for tag in tags})
        raise InvalidInput(
            "picture",
            found=f"{seen} of the {len(tags)} tags on the plate"
            + (f", but {others}" if others else ""),
            expected=f"at least {MIN_TAGS} of " + ", ".join(str(tag.id) for tag in tags),
            hint="check that the plate is lit and in full view",
        )
    corners = [(tags[k], tag_corners(tags[k]), pixels) for k, pixels in found.items()]
    points = np.concatenate(
        [np.column_stack([flat, np.full(4, tag.height)]) for tag, flat, _ in corners]
    )
    names = tuple(f"tag {tag.id}, corner {k}" for tag, _, _ in corners for k in range(1, 5))
    pixels = np.concatenate([p for _, _, p in corners])
    first = place_by_points(measured, points, pixels, names).camera.placed()
    sharp, spread = _without_spread(first, points, pixels)
    return place_by_points(measured, points, sharp, names, noise=UNEVEN * abs(spread))


def _without_spread(
    camera: Camera, points: FloatArray, pixels: FloatArray
) -> tuple[FloatArray, float]:
    """Correct tag corners (n, 2) for the spread of bright into dark; return also the spread [px].

    Blur and the camera's brightness curve move the edges of all tags inwards, or all outwards, by
    a fraction of a pixel. With four corners per tag, the shift can be estimated.
    """
    off = (pixels - camera.project(points)).reshape(-1, 4, 2)
    squares = pixels.reshape(-1, 4, 2)
    # Steps outwards of one pixel along each of the two sides that meet at a corner.
    before, after = squares - np.roll(squares, 1, axis=1), squares - np.roll(squares, -1, axis=1)
    outwards = before / np.linalg.norm(before, axis=-1, keepdims=True)
    outwards += after / np.linalg.norm(after, axis=-1, keepdims=True)
    spread = float((off * outwards).sum() / (outwards**2).sum())
    return np.asarray((squares - spread * outwards).reshape(-1, 2)), spread


def place_by_points(
    measured: MeasuredCamera,
    points: FloatArray,
    pixels: FloatArray,
    names: Sequence[str],
    *,
    noise: float = 0.0,
) -> Placement:
    """Determine the place of a camera from points (n, 3) of the world [m] and pixels (n, 2).

    `noise` is the least standard deviation of the pixels along each axis [px].
    """
    lens = measured.lens
    sight = PointObservations(points, pixels, np.zeros(len(points), dtype=np.intp))
    rotation, translation = _start(lens, points, pixels)
    # Fits the place only; `_joint` adds its dependence on the lens.
    found = fit(lens, (), rotation[None], translation[None], sight)
    rms = float(np.sqrt(np.mean(found.residuals**2)))
    camera = Camera(lens=lens, rotation=found.rotations[0], translation=found.translations[0])
    misfit = np.array(
        [camera.on_plane(p, z) for p, z in zip(pixels, points[:, 2].tolist(), strict=True)]
    )
    misfit -= points[:, :2]
    _refuse_misfit(misfit, rms, names)
    joint_names, covariance = _joint(measured, found, sight, noise)
    placed = replace(
        measured,
        camera=camera,
        names=joint_names,
        covariance=covariance,
        noise=max(measured.noise or 0.0, found.noise, 1e-9),
        source=f"{measured.source}; place by {len(points)} points".removeprefix("; "),
    )
    return Placement(placed, tuple(names), misfit, rms)


def _start(lens: Lens, points: FloatArray, pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
    cv2 = opencv()
    seen = lens.direction(pixels)
    done, turn, shift = cv2.solvePnP(
        points[:, None], seen[:, None], np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP
    )
    if not done:
        raise InvalidInput(
            "picture", found="points that no camera pose explains", expected="the plate"
        )
    return np.asarray(cv2.Rodrigues(turn)[0]), np.asarray(shift).ravel()


def _joint(
    measured: MeasuredCamera, found: BundleFit, sight: PointObservations, least: float
) -> tuple[tuple[str, ...], FloatArray]:
    """Joint covariance of lens and place, where the place was fitted with the given lens."""
    of_lens = [k for k, name in enumerate(measured.names) if name not in PLACE]
    names = tuple(measured.names[k] for k in of_lens)
    noise = max(measured.noise or 0.0, found.noise, least, 1e-9)
    slopes = slopes_of((found.lens, found.rotations, found.translations), names, sight)
    n = len(names)
    own = noise**2 * (np.linalg.pinv(slopes[:, n:].T @ slopes[:, n:]) + _in_step(slopes[:, n:]))
    if not names:
        return PLACE, own
    lens_covariance = measured.covariance[np.ix_(of_lens, of_lens)]
    slope = -np.linalg.lstsq(slopes[:, n:], slopes[:, :n], rcond=None)[0]
    cross = lens_covariance @ slope.T
    whole = np.block([[lens_covariance, cross], [cross.T, slope @ cross + own]])
    return (*names, *PLACE), 0.5 * (whole + whole.T)


def _in_step(slopes: FloatArray) -> FloatArray:
    """Covariance of the place for a shift common to all corners, of one pixel along each axis.

    Where a board is parallel to the pixel grid, all its corners have the same detection error.
    """
    shift = np.tile(np.eye(2), (len(slopes) // 2, 1))
    moved = np.linalg.lstsq(slopes, shift, rcond=None)[0]
    return np.asarray(moved @ moved.T)


def _refuse_size(lens: Lens, picture: Picture) -> None:
    height, width = picture.shape[:2]
    lens.for_pictures_of((width, height))


def _refuse_misfit(misfit: FloatArray, rms: float, names: Sequence[str]) -> None:
    off = np.hypot(*misfit.T)
    worst = int(np.argmax(off))
    if off[worst] > WRONG or rms > WORST_PIXELS:
        raise InvalidInput(
            "picture",
            found=f"{names[worst]} {1e3 * off[worst]:.1f} mm from its nominal position",
            expected=f"points within {1e3 * WRONG:g} mm of their nominal positions",
            hint="check the board or rig that you named, the lens file, and that the board is flat",
        )


LEVEL: Final = 0.95
NUDGES: Final = {name: 1e-2 for name in FOCAL[:4]} | dict.fromkeys(PLACE[:3], 1e-5)
SMALL_NUDGE: Final = 1e-6  # of coefficients, and of translations [m]


class PlaneErrors(NamedTuple):
    """Radii that contain 95 % of the errors of places on the plane."""

    height: float  # height above the plate [m]
    pixels: FloatArray  # (n_row, n_column, 2) grid over the picture [px]
    places: FloatArray  # (n_row, n_column, 2) places on the plane that these pixels show [m]
    # (n_row, n_column) Radius due to the camera's errors, the same in every picture [m]; 0, never
    # NaN, where they are unknown, see `known`.
    camera: FloatArray
    # (n_row, n_column) Radius due to these errors and the noise of one corner [m].
    whole: FloatArray
    known: bool  # whether the camera's errors are known


def plane_errors(
    measured: MeasuredCamera, height: float, *, columns: int = 17, rows: int = 11
) -> PlaneErrors:
    """Compute errors of places at one height, on a grid over the picture.

    Parameters
    ----------
    measured : MeasuredCamera
        Placed camera.
    height : float
        Height of the places above the plate [m].
    """
    camera = measured.placed()
    if columns < 2 or rows < 2:
        raise InvalidInput("grid", found=(columns, rows), expected="at least 2 x 2 points")
    width, tall = measured.lens.image_size
    u, v = np.linspace(0, width - 1, columns), np.linspace(0, tall - 1, rows)
    pixels = np.stack(np.meshgrid(u, v), axis=-1)
    covariance = place_covariance(measured, pixels, height)
    noise = measured.noise or 0.0
    spread = _pixel_slope(camera, pixels, height)
    noisy = covariance + noise**2 * spread @ np.swapaxes(spread, -1, -2)
    return PlaneErrors(
        height=height,
        pixels=pixels,
        places=camera.on_plane(pixels, height),
        camera=radius95(covariance),
        whole=radius95(noisy),
        known=bool(set(PLACE) <= set(measured.names)) and set(FOCAL[:4]) <= set(measured.names),
    )


def place_covariance(measured: MeasuredCamera, pixels: FloatArray, height: float) -> FloatArray:
    """Covariance (..., 2, 2) of the places of pixels (..., 2), due to camera errors [m^2]."""
    if not measured.names:
        return np.zeros((*pixels.shape[:-1], 2, 2))
    slopes = np.stack(
        [slope_of(measured, name, pixels, height) for name in measured.names], axis=-1
    )
    return np.asarray(slopes @ measured.covariance @ np.swapaxes(slopes, -1, -2))


def shifted(measured: MeasuredCamera, by: dict[str, float]) -> Camera:
    """Return the camera with some of its parameters changed [px, -, rad, m]."""
    camera = measured.placed()
    known = measured.lens.parameters
    of_lens = [name for name in by if name not in PLACE]
    lens = measured.lens.with_parameters(of_lens, [known[name] + by[name] for name in of_lens])
    place = np.array([by.get(name, 0.0) for name in PLACE])
    return replace(
        camera,
        lens=lens,
        rotation=turned(camera.rotation, place[:3]),
        translation=camera.translation + place[3:],
    )


def radius95(covariance: FloatArray) -> FloatArray:
    """Radius (...) of the circle with 95 % of normal errors of covariances (..., 2, 2)."""
    least, most = np.moveaxis(np.linalg.eigvalsh(covariance), -1, 0)
    least, most = np.maximum(least, 0.0), np.maximum(most, 0.0)
    ratio = np.sqrt(np.divide(least, most, out=np.zeros_like(most), where=most > 0.0))
    known, factors = _factors()
    return np.asarray(np.sqrt(most) * np.interp(ratio, known, factors))


@cache
def _factors() -> tuple[FloatArray, FloatArray]:
    """Ratios of the smaller to the larger deviation, and the radius in units of the larger."""
    from scipy.optimize import brentq
    from scipy.special import erf

    ratios = np.linspace(0.0, 1.0, 41)
    # Probability within r: integral over x = r sin(t) of that of |y| < sqrt(r^2 - x^2).
    nodes, weights = np.polynomial.legendre.leggauss(64)
    t = 0.5 * math.pi * nodes

    def share(r: float, ratio: float) -> float:
        x, reach = r * np.sin(t), r * np.cos(t)
        density = np.exp(-0.5 * x**2) / math.sqrt(2.0 * math.pi)
        within = erf(reach / (math.sqrt(2.0) * ratio)) if ratio > 0.0 else np.ones_like(x)
        return float(np.sum(weights * density * within * reach) * 0.5 * math.pi)

    radii = [brentq(lambda r, q=q: share(r, q) - LEVEL, 1.0, 4.0) for q in ratios.tolist()]
    return ratios, np.array(radii)


def slope_of(measured: MeasuredCamera, name: str, pixels: FloatArray, height: float) -> FloatArray:
    """Derivative (..., 2) of the places of pixels (..., 2) by a parameter of the camera."""
    nudge = NUDGES.get(name, SMALL_NUDGE)
    ahead, back = (
        shifted(measured, {name: sign * nudge}).on_plane(pixels, height) for sign in (1.0, -1.0)
    )
    return (ahead - back) / (2.0 * nudge)


def _pixel_slope(camera: Camera, pixels: FloatArray, height: float) -> FloatArray:
    """Derivative (..., 2, 2) of places by pixels [m/px]."""
    columns = [
        camera.on_plane(pixels + shift, height) - camera.on_plane(pixels - shift, height)
        for shift in 0.5 * np.eye(2)
    ]
    return np.stack(columns, axis=-1)


def pose_covariance(
    measured: MeasuredCamera, poses: FloatArray, points: FloatArray, height: float
) -> FloatArray:
    """Covariances (n, 3, 3) of poses due to the camera's errors [m^2, m rad, rad^2].

    The errors are the same in every picture, so that averaging over frames does not reduce them.

    Parameters
    ----------
    measured : MeasuredCamera
        Placed camera.
    poses : (n, 3) float64
        Poses of the part [m, m, rad].
    points : (k, 2) float64
        At least two points of the part by which it is measured [m].
    height : float
        Height of these points above the plate [m].
    """
    if not measured.names:
        return np.zeros((len(poses), 3, 3))
    places = np.stack([placed(points, pose) for pose in poses])
    pixels = measured.placed().project_at(places, height)
    arms = places - places.mean(axis=1, keepdims=True)
    square = (arms**2).sum(axis=(1, 2))
    slopes = np.empty((len(poses), 3, len(measured.names)))
    for k, name in enumerate(measured.names):
        moved = slope_of(measured, name, pixels, height)
        slopes[:, :2, k] = moved.mean(axis=1)
        turned = arms[..., 0] * moved[..., 1] - arms[..., 1] * moved[..., 0]
        slopes[:, 2, k] = turned.sum(axis=1) / square
    # The position is that of the frame's origin, not of the middle of the points.
    away = poses[:, :2] - places.mean(axis=1)
    slopes[:, 0] -= away[:, 1:] * slopes[:, 2]
    slopes[:, 1] += away[:, :1] * slopes[:, 2]
    return np.asarray(slopes @ measured.covariance @ np.swapaxes(slopes, -1, -2))
