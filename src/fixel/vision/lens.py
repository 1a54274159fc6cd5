"""Lenses: from directions to pixels and back, distortion included."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.model.fields import Comparable, FloatArray, frozen, settle, vector

# Newton's method halves the digits left at every step; from a start without distortion, eight are
# plenty inside any picture a lens can make.
MAX_ITERATIONS = 50
CLOSE = 1e-13  # [-] of directions; times a focal length of 1000 px still 1e-10 px


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lens(Comparable):
    """A lens and the sensor behind it.

    Directions are given where they meet the plane one unit in front of the camera: x to the right,
    y down, as in OpenCV. A pixel is (u, v) from the middle of the upper left pixel.

    Parameters
    ----------
    image_size : (int, int)
        Width and height [px].
    focal : (2,) array_like
        Focal lengths along u and v [px].
    centre : (2,) array_like
        Where the axis meets the sensor [px].
    skew : float
        How far u moves with y, in focal lengths: `alpha_c` of the MATLAB toolbox [-].
    distortion : (n,) array_like
        k1, k2, p1, p2, k3, k4, k5, k6 in OpenCV's order; those left out are 0. With `fisheye`, the
        four numbers of the equidistant model of Kannala and Brandt.
    fisheye : bool
        Which of the two models.

    Sources
    -------
    D. C. Brown, "Decentering distortion of lenses", Photogrammetric Engineering 32(3), 1966;
    J. Kannala and S. S. Brandt, "A generic camera model and calibration method for conventional,
    wide-angle, and fish-eye lenses", IEEE TPAMI 28(8), 2006.
    """

    image_size: tuple[int, int]
    focal: FloatArray
    centre: FloatArray
    skew: float = 0.0
    distortion: FloatArray = (0.0,) * 8  # type: ignore[assignment]
    fisheye: bool = False

    def __post_init__(self) -> None:
        if min(self.image_size) < 1:
            raise InvalidInput(
                "lens.image_size", found=self.image_size, expected="width and height [px]"
            )
        focal = vector(self.focal, "lens.focal", "along u [px], along v [px]")
        if focal.min() <= 0.0:
            raise InvalidInput("lens.focal", found=focal.tolist(), expected="above 0 [px]")
        settle(
            self,
            focal=focal,
            centre=vector(self.centre, "lens.centre", "u [px], v [px]"),
            skew=float(self.skew),
            distortion=_coefficients(self.distortion, 4 if self.fisheye else 8),
        )

    def distorted(self, direction: ArrayLike) -> FloatArray:
        """(..., 2) where directions (..., 2) [-] appear to come from [-]."""
        xy = np.asarray(direction, dtype=np.float64)
        return self._fisheye(xy) if self.fisheye else self._brown(xy)

    def undistorted(self, apparent: ArrayLike) -> FloatArray:
        """(..., 2) the directions [-] that appear to come from these (..., 2) [-].

        Raises
        ------
        InvalidInput
            A direction from which, by this model, no light comes.
        """
        wanted = np.asarray(apparent, dtype=np.float64)
        xy = wanted.copy()
        for _ in range(MAX_ITERATIONS):
            off = self.distorted(xy) - wanted
            if not off.size or np.abs(off).max() < CLOSE:
                return xy
            xy = xy - _solved(self._jacobian(xy), off)
        lost = np.abs(self.distorted(xy) - wanted).max(axis=-1) >= CLOSE * 1e3
        if lost.any():
            u, v = np.atleast_2d(self._pixels_of(wanted)[lost])[0]
            raise InvalidInput(
                "pixel",
                found=f"({u:.0f}, {v:.0f}) px, {int(lost.sum())} in all",
                expected="a place which the lens model can have light from",
                hint="calibrate the lens with boards near the corners of the picture too",
            )
        return xy

    def pixel(self, direction: ArrayLike) -> FloatArray:
        """(..., 2) pixels of directions (..., 2) [-]."""
        return self._pixels_of(self.distorted(direction))

    def direction(self, pixel: ArrayLike) -> FloatArray:
        """(..., 2) directions [-] of pixels (..., 2), without distortion; see `undistorted`."""
        y = (np.asarray(pixel, dtype=np.float64) - self.centre) / self.focal
        y[..., 0] -= self.skew * y[..., 1]
        return self.undistorted(y)

    def sees(self, pixel: ArrayLike) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """(...) whether pixels (..., 2) lie on the sensor."""
        uv = np.asarray(pixel, dtype=np.float64)
        return np.asarray(((uv >= -0.5) & (uv <= np.array(self.image_size) - 0.5)).all(axis=-1))

    def for_pictures_of(self, size: tuple[int, int], *, rescale: bool = False) -> Lens:
        """The same lens, if it was calibrated for pictures of this size.

        Parameters
        ----------
        size : (int, int)
            Width and height of the pictures [px].
        rescale : bool
            Take a picture of the same shape for the same view in other pixels. Wrong where the
            sensor was cropped, which the picture alone does not tell; so never without asking.

        Raises
        ------
        InvalidInput
            Another size, or with `rescale` another shape.
        """
        ours, theirs = self.image_size, (int(size[0]), int(size[1]))
        if theirs == ours:
            return self
        if theirs == ours[::-1]:
            hint = "is the picture turned by 90 degrees?"
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
        k1, k2, p1, p2, k3, k4, k5, k6 = self.distortion
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        aside = 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
        down = p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
        return np.stack([x * radial + aside, y * radial + down], axis=-1)

    def _fisheye(self, xy: FloatArray) -> FloatArray:
        k1, k2, k3, k4 = self.distortion
        r = np.hypot(xy[..., 0], xy[..., 1])
        angle = np.arctan(r)
        a2 = angle * angle
        seen = angle * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
        ratio = np.divide(seen, r, out=np.ones_like(r), where=r > 0.0)
        return np.asarray(xy * ratio[..., None])

    def _jacobian(self, xy: FloatArray) -> FloatArray:
        """(..., 2, 2) of `distorted`, by central differences."""
        step = 1e-6
        columns = [
            (self.distorted(xy + shift) - self.distorted(xy - shift)) / (2.0 * step)
            for shift in np.eye(2) * step
        ]
        return np.stack(columns, axis=-1)


def _coefficients(values: ArrayLike, count: int) -> FloatArray:
    given = np.atleast_1d(np.asarray(values, dtype=np.float64))
    if given.ndim != 1 or not np.isfinite(given).all() or given[count:].any():
        raise InvalidInput(
            "lens.distortion",
            found=f"{given.tolist()}",
            expected=f"at most {count} finite numbers of this model",
        )
    return frozen(np.pad(given[:count], (0, count - len(given[:count]))))


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """(..., 2) solutions of 2 x 2 systems; where there is none, a step of nothing."""
    (a, b), (c, d) = np.moveaxis(matrix, (-2, -1), (0, 1))
    det = a * d - b * c
    det = np.where(np.abs(det) < 1e-12, np.inf, det)
    x, y = right[..., 0], right[..., 1]
    return np.stack([(d * x - b * y) / det, (a * y - c * x) / det], axis=-1)
