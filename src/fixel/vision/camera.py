"""A camera above the plane."""

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
    """A lens at a place: between points above the plane and pixels.

    The world has x and y in the plane and z up, towards the camera; heights are z.

    Parameters
    ----------
    lens : Lens
    rotation : (3, 3) array_like
        `camera_from_world`: the camera's axes are x right, y down, z away from it.
    translation : (3,) array_like
        Where the world's origin is, in the camera's axes [m].
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
        """A camera that looks down, straight but for a small tilt.

        Parameters
        ----------
        lens : Lens
        height : float
            Of the camera above the plane [m].
        above : (2,) array_like
            The place of the world under it [m].
        turned : float
            From the world's x to the picture's right, counter-clockwise from above [rad].
        tilted : (2,) array_like
            Of the axis: towards what the picture shows below its middle, and towards its right;
            one after the other, about the camera's x and then its y [rad].
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
        """The same camera, if its lens is for pictures of this size; see `Lens`."""
        return replace(self, lens=self.lens.for_pictures_of(size, rescale=rescale))

    @property
    def position(self) -> FloatArray:
        """(3,) of the camera in the world [m]."""
        return -self.rotation.T @ self.translation

    def project(self, points: ArrayLike) -> FloatArray:
        """(..., 2) pixels of points (..., 3) of the world [m].

        Raises
        ------
        InvalidInput
            A point behind the camera.
        """
        seen = np.asarray(points, dtype=np.float64) @ self.rotation.T + self.translation
        depth = seen[..., 2:]
        if (depth <= 0.0).any():
            raise InvalidInput(
                "points", found="a point behind the camera", expected="points in front of it [m]"
            )
        return self.lens.pixel(seen[..., :2] / depth)

    def project_at(self, places: ArrayLike, height: float) -> FloatArray:
        """(..., 2) pixels of places (..., 2) [m] at one height above the plane [m]."""
        xy = np.asarray(places, dtype=np.float64)
        return self.project(np.concatenate([xy, np.full((*xy.shape[:-1], 1), height)], axis=-1))

    def homography(self, height: float = 0.0) -> FloatArray:
        """(3, 3) from places (x, y, 1) at a height above the plane [m] to directions (x, y, 1).

        Up to scale: the third number is how deep the place lies before the camera [m].
        """
        across, down, up = self.rotation.T
        return np.stack([across, down, up * height + self.translation], axis=1)

    def on_plane(self, pixels: ArrayLike, height: float = 0.0) -> FloatArray:
        """(..., 2) places [m] at a height above the plane [m] that pixels (..., 2) show.

        Raises
        ------
        InvalidInput
            A pixel that looks past the plane, that the lens cannot have light from, or a height
            that is not below the camera.
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
        """How much of the plane one pixel shows in the middle of the picture [m/px]."""
        middle = (np.array(self.lens.image_size) - 1.0) / 2.0
        corners = middle + np.array([[-0.5, -0.5], [0.5, -0.5], [-0.5, 0.5]])
        a, b, c = self.on_plane(corners, height)
        across, down = b - a, c - a
        return math.sqrt(abs(across[0] * down[1] - across[1] * down[0]))
