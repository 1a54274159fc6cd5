"""Pictures of boards and plates by OpenCV's projection: nothing of fixel's own lens or renderer.

Each pixel is traced to the print through OpenCV's inverse of its own lens model, the print is
sampled there, and blur, uneven light, vignetting, noise and gamma follow.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from fixel.typing import FloatArray
from fixel.vision.frame import Picture

FINE: Final = 2  # samples a pixel, in each direction
PER_MM: Final = 10  # pixels of a print


@dataclass(frozen=True)
class OtherCamera:
    """A lens in OpenCV's terms: 1280 x 720 px, barrel distortion with a third coefficient."""

    size: tuple[int, int] = (1280, 720)
    fx: float = 951.3
    fy: float = 948.6
    cx: float = 652.7
    cy: float = 351.4
    distortion: tuple[float, ...] = (-0.183, 0.071, 0.0007, -0.0009, -0.011)

    @property
    def matrix(self) -> FloatArray:
        """(3, 3) camera matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @cached_property
    def rays(self) -> NDArray[np.float32]:
        """(height * FINE, width * FINE, 3) float32 directions of all samples."""
        width, height = self.size
        u = (np.arange(width * FINE) + 0.5) / FINE - 0.5
        v = (np.arange(height * FINE) + 0.5) / FINE - 0.5
        pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
        flat = self.directions(pixels)
        rays = np.column_stack([flat, np.ones(len(flat))]).astype(np.float32)
        return rays.reshape(height * FINE, width * FINE, 3)

    def directions(self, pixels: FloatArray) -> FloatArray:
        """(n, 2) directions of pixels (n, 2)."""
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-12)
        found = cv2.undistortPointsIter(
            pixels[:, None], self.matrix, np.array(self.distortion), np.eye(3), np.eye(3), stop
        )
        return np.asarray(found[:, 0])

    def places(
        self, pixels: FloatArray, rotation: FloatArray, shift: FloatArray, height: float
    ) -> FloatArray:
        """(n, 2) places at a height over the plate [m] that pixels (n, 2) show."""
        rays = np.column_stack([self.directions(pixels), np.ones(len(pixels))]) @ rotation
        middle = -rotation.T @ shift
        far = (height - middle[2]) / rays[:, 2]
        return np.asarray(middle[:2] + far[:, None] * rays[:, :2])


def seen(
    camera: OtherCamera,
    print_: Picture,
    origin: tuple[float, float],
    rotation: FloatArray,
    shift: FloatArray,
    rng: np.random.Generator,
) -> Picture:
    """(height, width) uint8 picture of a print in the plane z = 0.

    Parameters
    ----------
    camera : OtherCamera
    print_ : (rows, columns) uint8
        The print at `PER_MM`; its lower left corner lies at `origin` [m].
    origin : (float, float)
    rotation : (3, 3) float64
    shift : (3,) float64
        Of the world's origin in the camera's axes [m].
    rng : numpy.random.Generator
    """
    scale = 1e3 * PER_MM
    rows = print_.shape[0]
    # From places to pixels of the print, after the way from rays to places: one homography.
    to_plane = np.linalg.inv(np.column_stack([rotation[:, 0], rotation[:, 1], shift]))
    to_print = np.array(
        [
            [scale, 0.0, -scale * origin[0] - 0.5],
            [0.0, -scale, rows - 0.5 + scale * origin[1]],
            [0.0, 0.0, 1.0],
        ]
    )
    there = camera.rays @ (to_print @ to_plane).T.astype(np.float32)
    map_ = there[..., :2] / there[..., 2:]
    empty = np.empty(0, np.float32)
    softened = cv2.GaussianBlur(print_, (0, 0), 1.2)  # toner, and samples between its pixels
    fine = cv2.remap(
        softened, map_, empty, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=205
    )
    width, height = camera.size
    light = cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA).astype(np.float64)
    light = 0.03 + 0.77 * (light / 255.0)
    v, u = np.mgrid[:height, :width]
    x, y = (u - width / 2) / width, (v - height / 2) / height
    tilt = rng.uniform(-0.5, 0.5, 2)
    light *= (1.0 + tilt[0] * x + tilt[1] * y) * (1.0 - 0.7 * (x**2 + y**2))
    light = np.asarray(cv2.GaussianBlur(light, (0, 0), rng.uniform(0.5, 0.9)), dtype=np.float64)
    light += np.sqrt(4e-5 * (light.clip(0.0) + 0.05)) * rng.standard_normal(light.shape)
    curve = np.where(
        light < 0.0031308, 12.92 * light, 1.055 * light.clip(1e-9) ** (1 / 2.4) - 0.055
    )
    return np.asarray(np.rint(255.0 * curve.clip(0.0, 1.0)), dtype=np.uint8)


def board_print(board: cv2.aruco.CharucoBoard, columns: int, rows: int, square: float) -> Picture:
    """(rows, columns) uint8 print of a ChArUco board at `PER_MM`."""
    size = round(1e3 * columns * square * PER_MM), round(1e3 * rows * square * PER_MM)
    return np.asarray(board.generateImage(size, marginSize=0))


def checker_print(columns: int, rows: int, square: float) -> Picture:
    """(rows, columns) uint8 print of a checkerboard with a white border of a square."""
    side = round(1e3 * square * PER_MM)
    v, u = np.mgrid[: (rows + 2) * side, : (columns + 2) * side]
    i, j = v // side, u // side
    inside = (i > 0) & (i <= rows) & (j > 0) & (j <= columns)
    return np.where(inside & ((i + j) % 2 == 0), 0, 255).astype(np.uint8)


def tag_print(
    tags: list[tuple[int, float, float]], side: float, low: FloatArray, high: FloatArray
) -> Picture:
    """(rows, columns) uint8 plate with AprilTags: (id, x, y) of their middles, and one side [m]."""
    columns, rows = (round(1e3 * PER_MM * float(n)) for n in high - low)
    plate = np.full((rows, columns), 205, np.uint8)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    n = round(1e3 * PER_MM * side)
    white = n // 8
    for id_, x, y in tags:
        card = np.full((n + 2 * white, n + 2 * white), 255, np.uint8)
        card[white:-white, white:-white] = cv2.aruco.generateImageMarker(dictionary, id_, n)
        left = round(1e3 * PER_MM * float(x - low[0])) - len(card) // 2
        top = rows - round(1e3 * PER_MM * float(y - low[1])) - len(card) // 2
        plate[top : top + len(card), left : left + len(card)] = card
    return plate
