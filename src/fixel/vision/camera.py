"""Camera above the plane: projection between the world and pixels, and the errors of both."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fixel.errors import InvalidInput
from fixel.model import fields
from fixel.typing import FloatArray
from fixel.vision.lens import BROWN, FISHEYE, FOCAL, Lens

ORTHONORMAL = 1e-6
# Parameters of the place: a small rotation about the camera's axes [rad], after the camera's own,
# and the translation [m].
PLACE: Final = ("rx", "ry", "rz", "tx", "ty", "tz")


def turned(rotations: FloatArray, angles: FloatArray) -> FloatArray:
    """Turn rotations (..., 3, 3) further by rotation vectors (..., 3) [rad]."""
    from scipy.spatial.transform import Rotation

    flat = Rotation.from_rotvec(angles.reshape(-1, 3)).as_matrix()
    return np.asarray(flat.reshape(*angles.shape[:-1], 3, 3) @ rotations)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Camera(fields.Comparable):
    """Lens at a place above the plane; projects points to pixels and back.

    The world has x and y in the plane and z up, towards the camera. Heights are along z.

    Parameters
    ----------
    lens : Lens
    rotation : (3, 3) array_like
        `camera_from_world`: the camera's axes are x right, y down, z away from it.
    translation : (3,) array_like
        Origin of the world in the camera's axes [m].
    """

    lens: Lens
    rotation: FloatArray
    translation: Annotated[FloatArray, fields.Value(fields.vector, "x [m], y [m], z [m]")]

    def __post_init__(self) -> None:
        rotation = fields.frozen(self.rotation)
        if (
            rotation.shape != (3, 3)
            or np.abs(rotation @ rotation.T - np.eye(3)).max() > ORTHONORMAL
        ):
            raise InvalidInput(
                "camera.rotation", found=rotation.tolist(), expected="a 3 x 3 rotation matrix"
            )
        if np.linalg.det(rotation) < 0.0:
            found = "a mirrored frame"
            expected = "a rotation matrix of determinant 1"
            hint = "the picture may be mirrored, or the y axis of the board reversed"
            raise InvalidInput("camera.rotation", found=found, expected=expected, hint=hint)
        fields.check_fields(self, "camera")
        fields.settle(self, rotation=rotation)
        if self.position[2] <= 0.0:
            raise InvalidInput(
                "camera.translation",
                found=f"a camera {self.position[2] * 1e3:.1f} mm above the plane",
                expected="a camera above the plane: z of the world points towards it",
            )

    @classmethod
    def looking_down(
        cls,
        lens: Lens,
        height: float,
        *,
        above: ArrayLike = (0.0, 0.0),
        turned: float = 0.0,
        tilted: ArrayLike = (0.0, 0.0),
    ) -> Camera:
        """Create a camera at a height [m] that looks straight down, or with a small tilt.

        `above` (2,) is the point of the plane below it [m], `turned` the angle from the world's x
        to the picture's right, counter-clockwise from above [rad]. `tilted` (2,) is the tilt of the
        axis towards the lower part of the picture, then towards its right: about the camera's x,
        then its y [rad].
        """
        c, s = math.cos(turned), math.sin(turned)
        straight = np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])
        down, right = fields.vector(tilted, "tilted", "downwards [rad], to the right [rad]")
        (cx, sx), (cy, sy) = ((math.cos(a), math.sin(a)) for a in (down, right))
        about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
        about_y = np.array([[cy, 0.0, -sy], [0.0, 1.0, 0.0], [sy, 0.0, cy]])
        rotation = about_y @ about_x @ straight
        x, y = fields.vector(above, "above", "x [m], y [m]")
        return cls(lens=lens, rotation=rotation, translation=-rotation @ [x, y, height])

    @property
    def position(self) -> FloatArray:
        """Position (3,) of the camera in the world [m]."""
        return -self.rotation.T @ self.translation

    def project(self, points: ArrayLike) -> FloatArray:
        """Project points (..., 3) of the world [m], before the camera, to pixels (..., 2)."""
        seen = np.asarray(points, dtype=np.float64) @ self.rotation.T + self.translation
        depth = seen[..., 2:]
        if (depth <= 0.0).any():
            raise InvalidInput(
                "points", found="a point behind the camera", expected="points in front of it [m]"
            )
        return self.lens.pixel(seen[..., :2] / depth)

    def project_at(self, places: ArrayLike, height: float) -> FloatArray:
        """Project places (..., 2) [m] at one height above the plane [m] to pixels (..., 2)."""
        xy = np.asarray(places, dtype=np.float64)
        return self.project(np.concatenate([xy, np.full((*xy.shape[:-1], 1), height)], axis=-1))

    def homography(self, height: float = 0.0) -> FloatArray:
        """Return the map (3, 3) from places (x, y, 1) at a height [m] to directions (x, y, 1).

        Directions are up to scale; the third number is the depth before the camera [m].
        """
        across, down, up = self.rotation.T
        return np.stack([across, down, up * height + self.translation], axis=1)

    def on_plane(self, pixels: ArrayLike, height: float = 0.0) -> FloatArray:
        """Project pixels (..., 2) to places (..., 2) [m] at a height above the plane [m].

        Raise `InvalidInput` for a pixel that does not see the plane or has no direction in the lens
        model, or a height that is not below the camera.
        """
        if not height < self.position[2]:
            expected = f"a height below the camera, at {1e3 * self.position[2]:.1f} mm"
            raise InvalidInput("height", found=f"{1e3 * height:.1f} mm", expected=expected)
        back = np.linalg.inv(self.homography(height))
        there = self.lens.direction(pixels) @ back[:, :2].T + back[:, 2]
        # The third number is one over the depth.
        if (there[..., 2] <= 0.0).any():
            raise InvalidInput(
                "pixels", found="a pixel above the horizon", expected="pixels that show the plane"
            )
        return np.asarray(there[..., :2] / there[..., 2:])

    def metres_per_pixel(self, height: float = 0.0) -> float:
        """Scale in the middle of the picture: side of a pixel on the plane [m/px]."""
        middle = (np.array(self.lens.image_size) - 1.0) / 2.0
        corners = middle + np.array([[-0.5, -0.5], [0.5, -0.5], [-0.5, 0.5]])
        a, b, c = self.on_plane(corners, height)
        across, down = b - a, c - a
        return math.sqrt(abs(across[0] * down[1] - across[1] * down[0]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredCamera(fields.Comparable):
    """Lens with its place, if known, and the covariance of their errors.

    Parameters
    ----------
    lens : Lens
    camera : Camera, optional
        Lens at its place above the plate; None before it was placed.
    names : tuple of str
        Measured parameters out of `Lens.parameters` and `PLACE`; empty where errors
        are unknown.
    covariance : (n, n) array_like
        Covariance of these parameters, in pixels, radians and metres.
    noise : float, optional
        Standard deviation of a corner along each axis of the picture [px].
    seen : (n_row, n_column) array_like
        Number of board corners in each cell of the picture; empty where unknown.
    source : str
        Origin of the measurement, for messages.
    """

    lens: Lens
    camera: Camera | None = None
    names: tuple[str, ...] = ()
    covariance: FloatArray = ()  # type: ignore[assignment]
    noise: Annotated[float | None, fields.Value(fields.positive, "px")] = None
    seen: NDArray[np.float64] = ()  # type: ignore[assignment]
    source: str = ""

    def __post_init__(self) -> None:
        fields.instance(self.lens, Lens, "camera.lens", "a Lens")
        if self.camera is not None and self.camera.lens != self.lens:
            raise InvalidInput("camera.lens", found="two lenses", expected="one")
        names = tuple(self.names)
        known = (*self.lens.parameters, *PLACE)
        if len(set(names)) < len(names) or not set(names) <= set(known):
            raise InvalidInput(
                "measured.names", found=list(names), expected="each once of " + ", ".join(known)
            )
        covariance = _covariance(self.covariance, len(names))
        seen = fields.frozen(self.seen)
        if seen.size and (seen.ndim != 2 or not np.isfinite(seen).all() or seen.min() < 0.0):
            raise InvalidInput("measured.seen", found=seen.tolist(), expected="rows of counts")
        fields.check_fields(self, "measured")
        fields.settle(self, names=names, covariance=covariance, seen=seen)

    @property
    def deviations(self) -> dict[str, float]:
        """Standard deviation of each measured parameter [px, -, rad or m]."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    def lines(self) -> list[str]:
        """Resolution and parameters of a lens, and their standard deviations."""
        lens, known = self.lens, self.deviations

        def number(name: str, value: float, unit: str = " px") -> str:
            spread = f" +- {known[name]:.2g}" if name in known else ""
            return f"{name} {value:.6g}{spread}{unit}"

        terms = [number("skew", lens.skew, "")] if lens.skew else []
        terms += [
            number(name, value, "")
            for name, value in zip(FISHEYE if lens.fisheye else BROWN, lens.distortion, strict=True)
            if value or name in known
        ]
        kind, (width, height) = "fisheye" if lens.fisheye else "lens", lens.image_size
        pairs = ((("fx", "fy"), lens.focal), (("cx", "cy"), lens.centre))
        rows = [", ".join(map(number, names, values.tolist())) for names, values in pairs]
        rows += [", ".join(terms)] if terms else []
        return [f"{kind} for pictures of {width} x {height} px", *(f"  {row}" for row in rows)]

    def placed(self) -> Camera:
        """Return the camera at its place; raise if it was not placed."""
        if self.camera is None:
            expected = "the pose of the camera above the plate"
            hint = "run: fixel camera place CAMERA PICTURE"
            raise InvalidInput("camera.place", found=None, expected=expected, hint=hint)
        return self.camera

    def for_pictures_of(self, size: tuple[int, int], *, rescale: bool = False) -> MeasuredCamera:
        """Return the camera if its lens is for this size of picture; see `Lens.for_pictures_of`."""
        lens = self.lens.for_pictures_of(size, rescale=rescale)
        if lens is self.lens:
            return self
        scale = lens.image_size[0] / self.lens.image_size[0]
        grow = np.array([scale if name in FOCAL[:4] else 1.0 for name in self.names])
        return replace(
            self,
            lens=lens,
            camera=self.camera and replace(self.camera, lens=lens),
            covariance=self.covariance * grow[:, None] * grow,
            noise=self.noise and self.noise * scale,
        )


def _covariance(values: object, count: int) -> FloatArray:
    found = fields.frozen(np.asarray(values, dtype=np.float64).reshape(-1) if not count else values)  # type: ignore[arg-type]
    if not count and not found.size:
        return fields.frozen(np.zeros((0, 0)))
    if found.shape != (count, count) or not np.isfinite(found).all():
        raise InvalidInput(
            "measured.covariance",
            found=f"an array of {found.shape}",
            expected=f"{count} rows of {count} finite numbers, one for each name",
        )
    scale = np.sqrt(np.abs(np.diag(found)))
    scale = np.where(scale > 0.0, scale, 1.0)
    unit = found / np.outer(scale, scale)
    if np.abs(unit - unit.T).max() > 1e-9 or np.linalg.eigvalsh(unit).min() < -1e-9:
        raise InvalidInput(
            "measured.covariance",
            found="a matrix that is not a covariance",
            expected="a symmetric matrix without negative eigenvalues",
        )
    return fields.frozen(0.5 * (found + found.T))
