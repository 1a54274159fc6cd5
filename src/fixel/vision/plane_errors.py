"""Errors of places and poses on the plane, caused by errors of lens and camera place."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.errors import InvalidInput
from fixel.model.shape import placed
from fixel.typing import FloatArray
from fixel.vision.camera import PLACE, Camera, MeasuredCamera, turned
from fixel.vision.lens import FOCAL

LEVEL: Final = 0.95
CORNERS: Final = ("upper left", "upper right", "lower left", "lower right")
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
    # (m_row, m_column) Numbers of board corners in each cell of the picture; empty if unknown.
    seen: FloatArray

    @property
    def worst(self) -> tuple[np.intp, ...]:
        """Row and column of the largest radius."""
        return np.unravel_index(int(np.argmax(self.whole)), self.whole.shape)

    @property
    def sentence(self) -> str:
        """Accuracy in one sentence, for the user."""
        height = f"{1e3 * self.height:g} mm above the plate"
        if not self.known:
            return (
                f"The accuracy of positions {height} is unknown, since the camera file has no "
                "uncertainty"
            )
        text = (
            f"Accuracy of positions {height}: {mm(float(np.median(self.whole)))} (95 %), at worst "
            f"{mm(float(self.whole.max()))} in the {_part_of_picture(self.pixels, self.worst)}"
        )
        if not self.seen.size:
            return text
        empty = empty_corners(self.seen)
        said = (
            f"no board was near {len(empty)} of 4 corners of the picture ({', '.join(empty)})"
            if empty
            else "the boards cover all corners of the picture"
        )
        return f"{text}; {said}"

    def summary(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        known = self.known
        return {
            "height_m": self.height,
            "known": known,
            "typical_95_m": float(np.median(self.whole)) if known else None,
            "worst_95_m": float(self.whole.max()) if known else None,
            "worst_at": _part_of_picture(self.pixels, self.worst) if known else None,
            "corners_without_board": list(empty_corners(self.seen)) if self.seen.size else None,
            "sentence": self.sentence,
        }


def plane_errors(
    measured: MeasuredCamera, height: float, *, columns: int = 17, rows: int = 11
) -> PlaneErrors:
    """Compute errors of places at a height above the plate [m], on a grid over the picture."""
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
        known={*PLACE, *FOCAL[:4]} <= set(measured.names),
        seen=measured.seen,
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
    A part at poses (n, 3) is measured by at least two points (k, 2) of it [m], at a height [m].
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


def empty_corners(seen: FloatArray) -> tuple[str, ...]:
    """Return the corners of the picture, a quarter of its sides wide, that no board reached."""
    if not seen.size:
        return CORNERS
    rows, columns = max(1, seen.shape[0] // 4), max(1, seen.shape[1] // 4)
    upper, lower = seen[:rows], seen[-rows:]
    parts = (upper[:, :columns], upper[:, -columns:], lower[:, :columns], lower[:, -columns:])
    return tuple(name for name, part in zip(CORNERS, parts, strict=True) if not part.any())


def mm(metres: float) -> str:
    """Format a length for reading: microns below a tenth of a millimetre."""
    return f"{1e3 * metres:.2g} mm" if metres >= 1e-4 else f"{1e6 * metres:.2g} um"


def _part_of_picture(pixels: FloatArray, place: tuple[np.intp, ...]) -> str:
    u, v = pixels[place] / pixels[-1, -1]
    down = "upper" if v < 0.25 else "lower" if v > 0.75 else ""
    across = "left" if u < 0.25 else "right" if u > 0.75 else ""
    if down and across:
        return f"{down} {across} corner"
    return f"{down or across} part of the picture" if down or across else "middle of the picture"
