"""Lens models: conversion between directions and pixels, with distortion."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.model.fields import Comparable, Value, check_fields, frozen, settle, vector
from fixel.typing import FloatArray

# Parameters of the lens, with OpenCV's names.
FOCAL = ("fx", "fy", "cx", "cy", "skew")
BROWN = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
FISHEYE = ("k1", "k2", "k3", "k4")

# From a start without distortion Newton's method needs four or five steps wherever a direction
# exists; elsewhere it wanders.
MAX_ITERATIONS = 50
CONVERGED_DIRECTION = 1e-13  # [-] of directions; 1e-10 px at a focal length of 1000 px
LOST = 1e-11  # [-] residual from which no direction was found
FARTHEST_STEP = 0.5  # [-] of Newton's method, for lens models that fold the picture nearby


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lens(Comparable):
    """Lens and sensor.

    A direction is its intersection with the plane one unit in front of the camera: x to the right,
    y down, as in OpenCV. A pixel is (u, v) from the middle of the upper left pixel.

    Parameters
    ----------
    image_size : (int, int)
        Width and height [px].
    focal : (2,) array_like
        Focal lengths along u and v [px].
    centre : (2,) array_like
        Intersection of the optical axis with the sensor [px].
    skew : float
        Change of u with y, in focal lengths: `alpha_c` of the MATLAB toolbox [-].
    distortion : (n,) array_like
        k1, k2, p1, p2, k3, k4, k5, k6 in OpenCV's order; missing ones are 0. With `fisheye`, the
        four coefficients of the equidistant model of Kannala and Brandt.
    fisheye : bool
        Whether the model is Kannala and Brandt's instead of Brown's.

    Sources
    -------
    D. C. Brown, "Decentering distortion of lenses", Photogrammetric Engineering 32(3), 1966;
    J. Kannala and S. S. Brandt, "A generic camera model and calibration method for conventional,
    wide-angle, and fish-eye lenses", IEEE TPAMI 28(8), 2006.
    """

    image_size: tuple[int, int]
    focal: Annotated[FloatArray, Value(vector, "along u [px], along v [px]")]
    centre: Annotated[FloatArray, Value(vector, "u [px], v [px]")]
    skew: float = 0.0
    distortion: FloatArray = (0.0,) * 8  # type: ignore[assignment]
    fisheye: bool = False

    def __post_init__(self) -> None:
        if min(self.image_size) < 1:
            raise InvalidInput(
                "lens.image_size", found=self.image_size, expected="width and height [px]"
            )
        check_fields(self, "lens")
        if self.focal.min() <= 0.0:
            raise InvalidInput("lens.focal", found=self.focal.tolist(), expected="above 0 [px]")
        settle(
            self,
            skew=float(self.skew),
            distortion=_coefficients(self.distortion, 4 if self.fisheye else 8),
        )

    @property
    def parameters(self) -> dict[str, float]:
        """Focal lengths, centre, skew and coefficients, by OpenCV's names."""
        names = (*FOCAL, *(FISHEYE if self.fisheye else BROWN))
        values = (*self.focal, *self.centre, self.skew, *self.distortion)
        return dict(zip(names, map(float, values), strict=True))

    def with_parameters(self, names: Iterable[str], values: Iterable[float]) -> Lens:
        """Return the lens with some parameters replaced."""
        new = self.parameters | dict(zip(names, values, strict=True))
        fx, fy, cx, cy, skew, *distortion = new.values()
        return replace(self, focal=(fx, fy), centre=(cx, cy), skew=skew, distortion=distortion)  # type: ignore[arg-type]

    def distorted(self, direction: ArrayLike) -> FloatArray:
        """Apply distortion to directions (..., 2) [-]."""
        xy = np.asarray(direction, dtype=np.float64)
        return self._fisheye(xy) if self.fisheye else self._brown(xy)

    def undistorted(self, apparent: ArrayLike) -> FloatArray:
        """Remove distortion from apparent directions (..., 2) [-]; inverse of `distorted`.

        A direction from which no light appears to come by this model raises `InvalidInput`.
        """
        wanted = np.asarray(apparent, dtype=np.float64)
        xy = self._opened(wanted) if self.fisheye else self._without_brown(wanted)
        lost = ~np.isfinite(xy).all(axis=-1)
        if lost.any():
            u, v = np.atleast_2d(self._pixels_of(wanted)[lost])[0]
            found = f"({u:.0f}, {v:.0f}) px, {int(lost.sum())} in all"
            expected = "a point in the range of the lens model"
            hint = "calibrate the lens with boards near the corners of the picture too"
            raise InvalidInput("pixel", found=found, expected=expected, hint=hint)
        return xy

    def pixel(self, direction: ArrayLike) -> FloatArray:
        """Project directions (..., 2) [-] to pixels (..., 2)."""
        return self._pixels_of(self.distorted(direction))

    def direction(self, pixel: ArrayLike) -> FloatArray:
        """Convert pixels (..., 2) to directions (..., 2) [-], without distortion."""
        y = (np.asarray(pixel, dtype=np.float64) - self.centre) / self.focal
        y[..., 0] -= self.skew * y[..., 1]
        return self.undistorted(y)

    def sees(self, pixel: ArrayLike) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Return (...) bool: whether pixels (..., 2) lie on the sensor."""
        uv = np.asarray(pixel, dtype=np.float64)
        return np.asarray(((uv >= -0.5) & (uv <= np.array(self.image_size) - 0.5)).all(axis=-1))

    def for_pictures_of(self, size: tuple[int, int], *, rescale: bool = False) -> Lens:
        """Return the lens if it was calibrated for pictures of a size [px], else raise or rescale.

        With `rescale`, a picture of the same aspect ratio is taken for the same view at another
        resolution. This is wrong for a cropped sensor, which a picture does not show.
        """
        ours, theirs = self.image_size, (int(size[0]), int(size[1]))
        if theirs == ours:
            return self
        if theirs == ours[::-1]:
            hint = "the picture may be turned by 90 degrees"
        elif ours[0] * theirs[1] != ours[1] * theirs[0]:
            hint = "pictures of another shape are cropped: calibrate the lens at this size"
        else:
            hint = (
                "calibrate the lens at this size, or rescale it if the camera scales whole pictures"
            )
        if not rescale or ours[0] * theirs[1] != ours[1] * theirs[0]:
            raise InvalidInput(
                "picture",
                found=f"{theirs[0]} x {theirs[1]} px",
                expected=f"{ours[0]} x {ours[1]} px, for which the lens is calibrated",
                hint=hint,
            )
        scale = theirs[0] / ours[0]
        centre = (self.centre + 0.5) * scale - 0.5  # pixel 0 is the middle of the first one
        return replace(self, image_size=theirs, focal=self.focal * scale, centre=centre)

    def _pixels_of(self, apparent: FloatArray) -> FloatArray:
        x, y = apparent[..., 0], apparent[..., 1]
        return np.asarray(np.stack([x + self.skew * y, y], axis=-1) * self.focal + self.centre)

    def _brown(self, xy: FloatArray) -> FloatArray:
        _, _, p1, p2, *_ = self.distortion
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        top, bottom, _, _ = self._radial(r2)
        radial = top / bottom
        aside = 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
        down = p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
        return np.stack([x * radial + aside, y * radial + down], axis=-1)

    def _radial(self, r2: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Numerator and denominator (...) of the radial factor, and their derivatives by r2."""
        k1, k2, _, _, k3, k4, k5, k6 = self.distortion
        top = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        bottom = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
        top_slope = k1 + r2 * (2.0 * k2 + r2 * (3.0 * k3))
        bottom_slope = k4 + r2 * (2.0 * k5 + r2 * (3.0 * k6))
        return top, bottom, top_slope, bottom_slope

    def _without_brown(self, wanted: FloatArray) -> FloatArray:
        """Invert `_brown` by Newton's method: directions (..., 2), NaN where there is none."""
        _, _, p1, p2, *_ = self.distortion
        xy = wanted.copy()
        if not self.distortion.any():
            return xy
        with np.errstate(all="ignore"):
            for _ in range(MAX_ITERATIONS):
                x, y = xy[..., 0], xy[..., 1]
                r2 = x * x + y * y
                top, bottom, top_slope, bottom_slope = self._radial(r2)
                radial = top / bottom
                # Twice the derivative of the radial factor by r2, common to those by x and y.
                bend = 2.0 * (top_slope - radial * bottom_slope) / bottom
                aside, down = p1 * y + p2 * x, p1 * x + p2 * y
                off_x = x * radial + 2.0 * x * aside + p2 * r2 - wanted[..., 0]
                off_y = y * radial + 2.0 * y * (p1 * y + p2 * x) + p1 * r2 - wanted[..., 1]
                a = radial + bend * x * x + 2.0 * aside + 4.0 * p2 * x
                b = bend * x * y + 2.0 * down
                d = radial + bend * y * y + 2.0 * aside + 4.0 * p1 * y
                det = a * d - b * b
                step = np.stack([d * off_x - b * off_y, a * off_y - b * off_x], axis=-1)
                step /= np.where(np.abs(det) > 1e-12, det, np.inf)[..., None]
                off = np.maximum(np.abs(off_x), np.abs(off_y))
                if not off.size or off.max() < CONVERGED_DIRECTION:
                    break
                length = np.hypot(step[..., 0], step[..., 1])[..., None]
                xy = xy - step * np.minimum(1.0, FARTHEST_STEP / np.maximum(length, 1e-300))
            # Solutions beyond a fold of the picture have no physical meaning.
            found = (
                (off < LOST * (1.0 + np.abs(wanted).max(axis=-1))) & (det > 0.0) & (bottom > 0.0)
            )
        return np.where(found[..., None], xy, np.nan)

    def round_trip(self, columns: int = 65, rows: int = 37) -> float:
        """Largest error from pixels to directions and back, on a grid over the picture [px]."""
        width, height = self.image_size
        u, v = np.linspace(0, width - 1, columns), np.linspace(0, height - 1, rows)
        pixels = np.stack(np.meshgrid(u, v), axis=-1)
        return float(np.abs(self.pixel(self.direction(pixels)) - pixels).max())

    def _seen_angle(self, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Apparent angles (...) of a fisheye for angles off its axis [rad], and the derivative."""
        k1, k2, k3, k4 = self.distortion
        a2 = angle * angle
        seen = angle * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
        slope = 1.0 + a2 * (3.0 * k1 + a2 * (5.0 * k2 + a2 * (7.0 * k3 + a2 * (9.0 * k4))))
        return seen, slope

    def _fisheye(self, xy: FloatArray) -> FloatArray:
        r = np.hypot(xy[..., 0], xy[..., 1])
        seen, _ = self._seen_angle(np.arctan(r))
        ratio = np.divide(seen, r, out=np.ones_like(r), where=r > 0.0)
        return np.asarray(xy * ratio[..., None])

    def _opened(self, wanted: FloatArray) -> FloatArray:
        """Invert `_fisheye` by Newton's method: directions (..., 2), NaN where there is none."""
        seen = np.hypot(wanted[..., 0], wanted[..., 1])
        angle = np.minimum(seen, 0.5 * np.pi)
        with np.errstate(all="ignore"):
            for _ in range(MAX_ITERATIONS):
                there, slope = self._seen_angle(angle)
                off = there - seen
                if not off.size or np.abs(off).max() < CONVERGED_DIRECTION:
                    break
                angle = angle - np.clip(off / slope, -FARTHEST_STEP, FARTHEST_STEP)
            found = (np.abs(off) < LOST) & (slope > 0.0) & (angle >= 0.0) & (angle < 0.5 * np.pi)
            ratio = np.where(seen > 0.0, np.tan(angle) / np.where(seen > 0.0, seen, 1.0), 1.0)
            return np.where(found[..., None], wanted * ratio[..., None], np.nan)


def _coefficients(values: ArrayLike, count: int) -> FloatArray:
    given = np.atleast_1d(np.asarray(values, dtype=np.float64))
    if given.ndim != 1 or not np.isfinite(given).all() or given[count:].any():
        expected = f"at most {count} finite numbers of this model"
        raise InvalidInput("lens.distortion", found=f"{given.tolist()}", expected=expected)
    return frozen(np.pad(given[:count], (0, count - len(given[:count]))))
