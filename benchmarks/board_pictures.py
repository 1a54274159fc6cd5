"""Rendered pictures of boards through a known lens, for tests and benchmarks of calibration."""

from __future__ import annotations

from typing import Final, final

import numpy as np

from fixel.typing import FloatArray
from fixel.vision.calibrate_lens import BoardView
from fixel.vision.frame import Picture, opencv
from fixel.vision.lens import Lens
from fixel.vision.marks import Board, Corners

FINE: Final = 2  # samples per pixel along each axis

Place = tuple[FloatArray, FloatArray]  # rotation and translation in the camera's axes [m]


@final
class Studio:
    """Renderer of pictures of one board with one lens.

    Parameters
    ----------
    lens : Lens
    board : Board
    per_square : int
        Resolution of the printed board, in pixels per square.
    seed : int
        Seed of the noise.
    """

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
            size = (b.columns * per_square, b.rows * per_square)
            return np.asarray(b.of_opencv().generateImage(size), dtype=np.uint8)
        i, j = np.meshgrid(np.arange(b.columns), np.arange(b.rows))
        squares = np.where((i + j) % 2, 255, 0).astype(np.uint8)
        return np.kron(squares, np.ones((per_square, per_square), np.uint8))

    def picture(self, rotation: FloatArray, translation: FloatArray, noise: float = 2.0) -> Picture:
        """Render the board, with its frame at a rotation and translation in the camera's [m]."""
        h = np.stack([rotation[:, 0], rotation[:, 1], translation], axis=1)
        place = self.rays @ np.linalg.inv(h).T
        x, y = (place[..., k] / place[..., 2] for k in (0, 1))
        # Pixel 0 of the texture is the centre of its first pixel; y counts from the upper edge.
        across = (x * self.per_metre - 0.5).astype(np.float32)
        down = ((self.board.size[1] - y) * self.per_metre - 0.5).astype(np.float32)
        fine = opencv().remap(self.texture, across, down, opencv().INTER_LINEAR, borderValue=255)
        width, height = self.lens.image_size
        gray = fine.reshape(height, FINE, width, FINE).astype(np.float64).mean(axis=(1, 3))
        gray = 40.0 + 0.7 * gray + self.random.normal(0.0, noise, gray.shape)
        return np.asarray(np.clip(gray, 0, 255), dtype=np.uint8)

    def facing(
        self, at: tuple[float, float], depth: float, tilt: tuple[float, float], spin: float = 0.0
    ) -> Place:
        """Rotation and translation of a board whose centre is in a direction at a depth [m]."""
        return _facing(self.board, at, depth, tilt, spin)


def _facing(
    board: Board, at: tuple[float, float], depth: float, tilt: tuple[float, float], spin: float
) -> Place:
    (ax, ay), (cs, sn) = tilt, (np.cos(spin), np.sin(spin))
    about_x = np.array([[1, 0, 0], [0, np.cos(ax), -np.sin(ax)], [0, np.sin(ax), np.cos(ax)]])
    about_y = np.array([[np.cos(ay), 0, np.sin(ay)], [0, 1, 0], [-np.sin(ay), 0, np.cos(ay)]])
    flat = np.array([[cs, sn, 0.0], [sn, -cs, 0.0], [0.0, 0.0, -1.0]])
    rotation = about_y @ about_x @ flat
    middle = depth * np.array([*at, 1.0])
    return rotation, middle - rotation @ [*(0.5 * np.array(board.size)), 0.0]


def spread(studio: Studio, count: int, depth: float, near: float = 1.0) -> list[Place]:
    """Poses of a board that calibrate a lens well: tilted, near each corner in turn."""
    lens, random = studio.lens, np.random.default_rng(5)
    corners = 0.5 + near * np.array([(-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2), (0, 0)])
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


def seen_corners(
    lens: Lens,
    board: Board,
    count: int,
    noise: float,
    depth: float = 0.4,
    tilt: float = 0.5,
    seed: int = 0,
) -> tuple[BoardView, ...]:
    """Simulate detected corners of a board in views that show all of them, with noise."""
    random = np.random.default_rng(seed)
    i, j = np.meshgrid(np.arange(1, board.columns), np.arange(1, board.rows))
    places = board.square * np.stack([i, j], axis=-1).reshape(-1, 2).astype(np.float64)
    views: list[BoardView] = []
    while len(views) < count:
        at = lens.direction(random.uniform(0.25, 0.75, 2) * lens.image_size)
        lean = random.uniform(0.4 * tilt, tilt, 2) * random.choice([-1.0, 1.0], 2)
        rotation, translation = _facing(
            board,
            (at[0], at[1]),
            depth * random.uniform(0.9, 1.4),
            (lean[0], lean[1]),
            random.uniform(-0.4, 0.4),
        )
        solid = np.column_stack([places, np.zeros(len(places))]) @ rotation.T + translation
        pixels = lens.pixel(solid[:, :2] / solid[:, 2:])
        if lens.sees(pixels).all():
            pixels = pixels + random.normal(0.0, noise, pixels.shape)
            views.append(BoardView(f"view {len(views)}", lens.image_size, Corners(places, pixels)))
    return tuple(views)
