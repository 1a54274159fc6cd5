"""Camera above the plane: projection between the world and pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.model.fields import Comparable, frozen, settle, vector
from fixel.typing import FloatArray
from fixel.vision.lens import Lens

ORTHONORMAL = 1e-6


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Camera(Comparable):
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
    translation: FloatArray

    def __post_init__(self) -> None:
        rotation = frozen(self.rotation)
        if (
            rotation.shape != (3, 3)
            or np.abs(rotation @ rotation.T - np.eye(3)).max() > ORTHONORMAL
        ):
            raise InvalidInput(
                "camera.rotation", found=rotation.tolist(), expected="a 3 x 3 rotation matrix"
            )
        if np.linalg.det(rotation) < 0.0:
            raise InvalidInput(
                "camera.rotation",
                found="a mirrored frame",
                expected="a rotation matrix of determinant 1",
                hint="is the picture mirrored, or is the board's y axis turned round?",
            )
        translation = vector(self.translation, "camera.translation", "x [m], y [m], z [m]")
        settle(self, rotation=rotation, translation=translation)
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
        """Create a camera that looks straight down, or with a small tilt.

        Parameters
        ----------
        lens : Lens
        height : float
            Height of the camera above the plane [m].
        above : (2,) array_like
            Point of the plane below the camera [m].
        turned : float
            Angle from the world's x to the picture's right, counter-clockwise from above [rad].
        tilted : (2,) array_like
            Tilt of the axis towards the lower part of the picture, then towards its right: about
            the camera's x, then its y [rad].
        """
        c, s = math.cos(turned), math.sin(turned)
        straight = np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])
        down, right = vector(tilted, "tilted", "downwards [rad], to the right [rad]")
        (cx, sx), (cy, sy) = ((math.cos(a), math.sin(a)) for a in (down, right))
        about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
        about_y = np.array([[cy, 0.0, -sy], [0.0, 1.0, 0.0], [sy, 0.0, cy]])
        rotation = about_y @ about_x @ straight
        x, y = vector(above, "above", "x [m], y [m]")
        return cls(lens=lens, rotation=rotation, translation=-rotation @ [x, y, height])

    def for_pictures_of(self, size: tuple[int, int], *, rescale: bool = False) -> Camera:
        """Return the camera if its lens is for pictures of this size; see `Lens`."""
        return replace(self, lens=self.lens.for_pictures_of(size, rescale=rescale))

    @property
    def position(self) -> FloatArray:
        """Position (3,) of the camera in the world [m]."""
        return -self.rotation.T @ self.translation

    def project(self, points: ArrayLike) -> FloatArray:
        """Project points (..., 3) of the world [m] to pixels (..., 2).

        Raises
        ------
        InvalidInput
            A point lies behind the camera.
        """
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

        Raises
        ------
        InvalidInput
            A pixel does not see the plane or has no direction in the lens model, or the height is
            not below the camera.
        """
        if not height < self.position[2]:
            raise InvalidInput(
                "height",
                found=f"{1e3 * height:.1f} mm",
                expected=f"a height below the camera, at {1e3 * self.position[2]:.1f} mm",
            )
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
