"""Cameras from pictures of boards through a known lens: how far off, how sure."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmarks.board_pictures import Studio
from benchmarks.figures import Figure, Size, at_least, at_most
from fixel.formats.rig_file import rig_of
from fixel.typing import FloatArray
from fixel.vision.calibrate_lens import calibrate_lens, find_boards
from fixel.vision.camera import Camera
from fixel.vision.marks import board_of
from fixel.vision.place_camera import place_by_board
from fixel.vision.plane_errors import plane_errors

BOARDS: Final = ("charuco:7x5:30mm:22mm", "checkerboard:8x5:25mm")
PICTURES: Final = 15
REPEATS: Final = 20
HEIGHT: Final = 0.0254  # [m] of the object of the thesis
ABOVE: Final = 0.516  # [m] of its camera above the plate


@dataclass(frozen=True)
class Try:
    """One calibration: what it got wrong, against what it said."""

    held: float
    typical: float
    worst: float
    off: float
    seconds: float


def run(size: Size) -> list[Figure]:
    """The thesis's camera, calibrated from pictures of 1280 x 720 px, over and over."""
    repeats = REPEATS if size.rollouts >= 500 else 2
    return [
        *_speed(),
        *(figure for board in BOARDS for figure in _figures(board, repeats)),
    ]


def _figures(text: str, repeats: int) -> list[Figure]:
    studio = Studio(rig_of("thesis-tags").camera.lens, board_of(text))
    tries = [_one(studio, seed) for seed in range(repeats)]
    kind = text.split(":")[0]

    def column(name: str, scale: float = 1.0) -> tuple[float, ...]:
        return tuple(scale * getattr(one, name) for one in tries)

    held = float(np.mean(column("held")))
    return [
        Figure(f"camera, {kind}, 95 % held", "-", (held,), at_least(0.95)),
        Figure(f"camera, {kind}, stated radius, median", "mm", column("typical", 1e3)),
        Figure(f"camera, {kind}, stated radius, worst", "mm", column("worst", 1e3)),
        Figure(f"camera, {kind}, error, median", "mm", column("off", 1e3)),
        Figure(f"camera, {kind}, CPU time of a calibration", "s", column("seconds")),
    ]


def _one(studio: Studio, seed: int) -> Try:
    """A lens from boards in every part of the picture, its place from one on the plate."""
    random, lens = np.random.default_rng(seed), studio.lens
    parts = np.array([(0.28, 0.32), (0.72, 0.32), (0.72, 0.68), (0.28, 0.68), (0.5, 0.5)])
    pictures = []
    for k in range(PICTURES):
        at = lens.direction(parts[k % 5] * lens.image_size)
        lean = random.uniform(0.2, 0.6, 2) * random.choice([-1.0, 1.0], 2)
        place = studio.facing(
            (at[0], at[1]),
            random.uniform(0.34, 0.5),
            (lean[0], lean[1]),
            random.uniform(-0.4, 0.4),
        )
        pictures.append((f"{k}", studio.picture(*place)))
    begun = time.process_time()
    found = calibrate_lens(*find_boards(pictures, studio.board))
    seconds = time.process_time() - begun
    middle = 0.5 * np.array(studio.board.size)
    true = Camera.looking_down(
        lens, ABOVE, above=middle, turned=random.uniform(-0.2, 0.2), tilted=(0.014, 0.026)
    )
    flat = studio.picture(true.rotation, true.translation)
    errors = plane_errors(place_by_board(found.camera, flat, studio.board).camera, HEIGHT)
    off = np.linalg.norm(true.on_plane(errors.pixels, HEIGHT) - errors.places, axis=-1)
    return Try(
        held=float(np.mean(off <= errors.camera)),
        typical=float(np.median(errors.whole)),
        worst=float(errors.whole.max()),
        off=float(np.median(off)),
        seconds=seconds,
    )


def _speed() -> list[Figure]:
    """Pixels to places: few, as a tracker asks for, and a whole picture."""
    camera = rig_of("thesis-tags").camera
    pixels = np.random.default_rng(0).uniform((0, 0), (1279, 719), (921_600, 2))
    trip = float(np.abs(camera.project_at(camera.on_plane(pixels, HEIGHT), HEIGHT) - pixels).max())
    return [
        Figure("camera, there and back, worst", "px", (trip,), at_most(1e-6)),
        Figure("camera, 4 pixels to places", "us", _timed(camera, pixels[:4], 300, 1e6)),
        Figure("camera, 921,600 pixels to places", "s", _timed(camera, pixels, 1, 1.0)),
    ]


def _timed(camera: Camera, pixels: FloatArray, calls: int, scale: float) -> tuple[float, ...]:
    times = []
    for _ in range(3):
        begun = time.process_time()
        for _ in range(calls):
            camera.on_plane(pixels, HEIGHT)
        times.append(scale * (time.process_time() - begun) / calls)
    return tuple(times)
