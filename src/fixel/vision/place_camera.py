"""Place of a camera above the plate, from a board that lies on it or from tags fixed to it.

All points are fitted together, so that one view of the plate gives one place, not one per tag.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.model.fields import vector
from fixel.model.shape import placed
from fixel.typing import FloatArray
from fixel.vision.bundle import BundleFit, PointObservations, fit, slopes_of
from fixel.vision.camera import PLACE, Camera, MeasuredCamera
from fixel.vision.frame import Picture, opencv
from fixel.vision.lens import Lens
from fixel.vision.marks import Board, Tag, gray_of
from fixel.vision.tracking.tags import find_tags, other_tags, tag_points

MIN_TAGS: Final = 2
UNEVEN: Final = 0.2  # variation of the shift of tags' edges between corners, as a share of it
WRONG: Final = 3e-3  # [m] largest misfit of a point
WORST_PIXELS: Final = 3.0  # [px] largest root mean square; above it, board or lens is another


class Placement(NamedTuple):
    """Camera with its measured place."""

    camera: MeasuredCamera
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

    Its lower left corner has a pose (3,) in the world [m, m, rad], its upper face a height [m].
    """
    measured.lens.for_pictures_of((picture.shape[1], picture.shape[0]))
    corners = board.find(picture)
    flat = placed(corners.places, vector(pose, "board.pose", "x [m], y [m], angle [rad]"))
    points = np.column_stack([flat, np.full(len(flat), height)])
    names = tuple(f"corner {k + 1}" for k in range(len(points)))
    return place_by_points(measured, points, corners.pixels, names)


def place_by_tags(measured: MeasuredCamera, picture: Picture, tags: Sequence[Tag]) -> Placement:
    """Determine the place of a camera from tags fixed to the plate, at known poses."""
    measured.lens.for_pictures_of((picture.shape[1], picture.shape[0]))
    found = find_tags(picture, tags)
    if len(found) < MIN_TAGS:
        seen = ", ".join(str(tags[k].id) for k in found) or "none"
        others = other_tags(gray_of(picture), {(tag.family, tag.id) for tag in tags})
        raise InvalidInput(
            "picture",
            found=f"{seen} of the {len(tags)} tags on the plate"
            + (f", but {others}" if others else ""),
            expected=f"at least {MIN_TAGS} of " + ", ".join(str(tag.id) for tag in tags),
            hint="check that the plate is lit and in full view",
        )
    points, pixels = tag_points({tags[k]: corners for k, corners in found.items()})
    names = tuple(f"tag {tags[k].id}, corner {n}" for k in found for n in range(1, 5))
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
    result = replace(
        measured,
        camera=camera,
        names=joint_names,
        covariance=covariance,
        noise=max(measured.noise or 0.0, found.noise, 1e-9),
        source=f"{measured.source}; place by {len(points)} points".removeprefix("; "),
    )
    return Placement(result, misfit, rms)


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


def _refuse_misfit(misfit: FloatArray, rms: float, names: Sequence[str]) -> None:
    off = np.hypot(*misfit.T)
    worst = int(np.argmax(off))
    if off[worst] > WRONG or rms > WORST_PIXELS:
        found = f"{names[worst]} {1e3 * off[worst]:.1f} mm from its nominal position"
        expected = f"points within {1e3 * WRONG:g} mm of their nominal positions"
        hint = "check the board or rig that you named, the lens file, and that the board is flat"
        raise InvalidInput("picture", found=found, expected=expected, hint=hint)
