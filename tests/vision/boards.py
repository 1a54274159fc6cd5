"""Pictures of boards through an exact lens, for the tests of calibration."""

from __future__ import annotations

import cv2
import numpy as np

from fixel.kernels.arrays import FloatArray
from fixel.vision.boards import Board, Picture
from fixel.vision.lens import Lens

FINE = 3  # samples of a pixel along each axis


class Studio:
    """Takes pictures of one board with one lens."""

    def __init__(self, lens: Lens, board: Board, per_square: int = 64, seed: int = 0) -> None:
        self.lens, self.board = lens, board
        self.random = np.random.default_rng(seed)
        width, height = lens.image_size
        fine = (np.arange(FINE) + 0.5) / FINE - 0.5
        u = (np.arange(width)[:, None] + fine).ravel()
        v = (np.arange(height)[:, None] + fine).ravel()
        flat = lens.direction(np.stack(np.meshgrid(u, v), axis=-1))
        self.rays = np.concatenate([flat, np.ones((*flat.shape[:-1], 1))], axis=-1)
        self.per_metre = per_square / board.square
        self.texture = self._print(per_square)

    def _print(self, per_square: int) -> Picture:
        b = self.board
        if b.marker:
            return b.of_opencv().generateImage((b.columns * per_square, b.rows * per_square))
        i, j = np.meshgrid(np.arange(b.columns), np.arange(b.rows))
        squares = np.where((i + j) % 2, 255, 0).astype(np.uint8)
        return np.kron(squares, np.ones((per_square, per_square), np.uint8))

    def picture(self, rotation: FloatArray, translation: FloatArray, noise: float = 2.0) -> Picture:
        """Of the board whose frame is at a rotation and translation of the camera's [m]."""
        h = np.stack([rotation[:, 0], rotation[:, 1], translation], axis=1)
        place = self.rays @ np.linalg.inv(h).T
        x, y = (place[..., k] / place[..., 2] for k in (0, 1))
        # Pixel 0 of the texture is the middle of its first; y counts from the upper edge.
        across = (x * self.per_metre - 0.5).astype(np.float32)
        down = ((self.board.size[1] - y) * self.per_metre - 0.5).astype(np.float32)
        fine = cv2.remap(self.texture, across, down, cv2.INTER_LINEAR, borderValue=255)
        width, height = self.lens.image_size
        gray = fine.reshape(height, FINE, width, FINE).astype(np.float64).mean(axis=(1, 3))
        gray = 40.0 + 0.7 * gray + self.random.normal(0.0, noise, gray.shape)
        return np.clip(gray, 0, 255).astype(np.uint8)

    def facing(
        self, at: tuple[float, float], depth: float, tilt: tuple[float, float], spin: float = 0.0
    ) -> tuple[FloatArray, FloatArray]:
        """Rotation and translation of a board, its middle in a direction at a depth [m]."""
        (ax, ay), (cs, sn) = tilt, (np.cos(spin), np.sin(spin))
        about_x = np.array([[1, 0, 0], [0, np.cos(ax), -np.sin(ax)], [0, np.sin(ax), np.cos(ax)]])
        about_y = np.array([[np.cos(ay), 0, np.sin(ay)], [0, 1, 0], [-np.sin(ay), 0, np.cos(ay)]])
        flat = np.array([[cs, sn, 0.0], [sn, -cs, 0.0], [0.0, 0.0, -1.0]])
        rotation = about_y @ about_x @ flat
        middle = depth * np.array([*at, 1.0])
        return rotation, middle - rotation @ [*(0.5 * np.array(self.board.size)), 0.0]


def spread(studio: Studio, count: int, depth: float) -> list[tuple[FloatArray, FloatArray]]:
    """Places of a board that calibrate a lens well: tilted, near every corner in turn."""
    lens, random = studio.lens, np.random.default_rng(5)
    corners = np.array([(0.3, 0.3), (0.7, 0.3), (0.7, 0.7), (0.3, 0.7), (0.5, 0.5)])
    places = []
    for k in range(count):
        pixel = corners[k % 5] * lens.image_size
        at = lens.direction(pixel)
        tilt = random.uniform(0.25, 0.6, 2) * random.choice([-1.0, 1.0], 2)
        places.append(
            studio.facing(
                (at[0], at[1]),
                depth * random.uniform(0.9, 1.3),
                tuple(tilt),
                random.uniform(-0.4, 0.4),
            )
        )
    return places
