"""Cameras calibrated from pictures of another renderer than fixel's: is the stated radius right?

``python -m benchmarks other-camera`` writes the rows of a board and a seed to `ROWS` as it goes: a
run that was stopped continues, and a partial one counts as far as it got. The rows in the
repository are those of the documentation; delete the file to start again.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.figures import Figure, Size, at_least
from benchmarks.other_pictures import OtherCamera, board_print, checker_print, seen, tag_print
from benchmarks.report import RESULTS
from fixel.errors import InvalidInput
from fixel.typing import FloatArray
from fixel.vision.calibrate_lens import BoardView, calibrate_lens
from fixel.vision.frame import Picture
from fixel.vision.marks import Board, Tag, board_of
from fixel.vision.place_camera import Placement, place_by_board, place_by_tags
from fixel.vision.plane_errors import plane_errors

# The number of coefficients, the jackknife and the spread of edges were chosen on seeds below 20.
SEEDS: Final = range(100, 120)
ROWS: Final = RESULTS / "other-camera.csv"
HEAD: Final = ("board", "seed", "coefficients", "place", "held", "off_mm", "said_mm")
COEFFICIENTS: Final = ("usual", "4")  # what is found unasked, and what was before
PICTURES: Final = 15
HEIGHT: Final = 0.0254  # [m] of the places that are judged
PLATE: Final = np.array([[-0.2, -0.25], [0.5, 0.25]])  # [m] its corners
MIDDLE: Final = np.array([0.148, 0.006, 0.505])  # [m] of the camera
SIDE: Final = 0.03  # [m] of the tags
TAGS: Final = tuple(
    Tag(id=k, size=SIDE, pose=(x, y, 0.0), height=0.0)  # type: ignore[arg-type]
    for k, x, y in ((20, -0.07, 0.12), (21, 0.37, 0.125), (22, 0.365, -0.11), (23, -0.075, -0.115))
)
# Where the middles of the boards are seen, as shares of the picture, in turn.
MIDDLES: Final = "0.5 0.5  0.25 0.28  0.75 0.28  0.25 0.72  0.75 0.72  0.5 0.3  0.5 0.7  0.3 0.5"
AIMS: Final = np.array(MIDDLES.split(), dtype=np.float64).reshape(-1, 2)


class Print(NamedTuple):
    """A board, its print, and how much white lies around its squares [m]."""

    name: str
    board: Board
    picture: Picture
    border: float
    reach: float  # [px] beyond the picture that it may reach


def prints() -> tuple[Print, ...]:
    """The two boards."""
    charuco = board_of("charuco:7x5:30mm:22mm")
    picture = board_print(charuco.of_opencv(), 7, 5, 0.03)
    return (
        Print("charuco", charuco, picture, 0.0, 60.0),
        Print(
            "checkerboard",
            board_of("checkerboard:9x6:25mm"),
            checker_print(10, 7, 0.025),
            0.025,
            -12.0,
        ),
    )


def run(size: Size) -> list[Figure]:
    """Both boards; the place by the board on the plate, and by tags on it."""
    cv2.setNumThreads(1)
    full = size.rollouts >= 500
    wanted = [(print_, seed) for seed in (SEEDS if full else SEEDS[:1]) for print_ in prints()]
    return figures_of(_rows(wanted, ROWS if full else None, PICTURES if full else 6))


def figures_of(rows: Sequence[dict[str, str]]) -> list[Figure]:
    """Shares of pictures within the radius, with median errors and radii of pictures."""
    groups: dict[tuple[str, str, str], list[dict[str, str]]] = {}
    for row in rows:
        groups.setdefault((row["board"], row["coefficients"], row["place"]), []).append(row)
    figures = []
    for (board, coefficients, place), own in groups.items():
        held, off, said = (
            tuple(float(row[name]) for row in own) for name in ("held", "off_mm", "said_mm")
        )
        mean = (float(np.mean(held)),)
        if coefficients != "usual":
            label = f"other camera, {board}, by {place}, {coefficients} coefficients ({len(own)})"
            figures.append(Figure(f"{label}, held, mean", "-", mean))
            continue
        label = f"other camera, {board}, by {place} ({len(own)})"
        figures += [
            Figure(f"{label}, held, mean", "-", mean, at_least(0.93)),
            Figure(f"{label}, held", "-", held),
            Figure(f"{label}, error, median", "mm", off),
            Figure(f"{label}, stated radius, median", "mm", said),
        ]
    return figures


def _rows(
    wanted: Sequence[tuple[Print, int]], path: Path | None, pictures: int
) -> list[dict[str, str]]:
    known = []
    if path is not None and path.is_file():
        with path.open(newline="") as file:
            known = list(csv.DictReader(file))
    done = {(row["board"], int(row["seed"])) for row in known}
    camera = OtherCamera()
    for print_, seed in wanted:
        if (print_.name, seed) in done:
            continue
        rows = _one(camera, print_, seed, pictures)
        known += [{name: str(value) for name, value in row.items()} for row in rows]
        if path is not None:
            fresh = not path.is_file()
            with path.open("a", newline="") as file:
                writer = csv.DictWriter(file, HEAD, lineterminator="\n")
                if fresh:
                    writer.writeheader()
                writer.writerows(rows)
    asked = {(print_.name, seed) for print_, seed in wanted}
    return [row for row in known if (row["board"], int(row["seed"])) in asked]


def _one(
    camera: OtherCamera, print_: Print, seed: int, pictures: int
) -> list[dict[str, str | float]]:
    """One row a number of coefficients and a way of placing."""
    rng = np.random.default_rng([seed, len(print_.name)])
    views = _views(camera, print_, rng, pictures)
    turn = Rotation.from_euler("xyz", [*rng.uniform(-2, 2, 2), rng.uniform(-4, 4)], degrees=True)
    rotation = turn.as_matrix() @ np.diag([1.0, -1.0, -1.0])
    shift = -rotation @ MIDDLE
    corner = MIDDLE[:2] - 0.5 * np.array(print_.board.size)
    low = (float(corner[0]) - print_.border, float(corner[1]) - print_.border)
    by_board = seen(camera, print_.picture, low, rotation, shift, rng)
    plate = tag_print(
        [(tag.id, float(tag.pose[0]), float(tag.pose[1])) for tag in TAGS], SIDE, *PLATE
    )
    by_tags = seen(camera, plate, (PLATE[0, 0], PLATE[0, 1]), rotation, shift, rng)
    rows: list[dict[str, str | float]] = []
    for name in COEFFICIENTS:
        measured = calibrate_lens(views, coefficients=None if name == "usual" else int(name)).camera
        placed = {
            "board": place_by_board(measured, by_board, print_.board, pose=(*corner, 0.0)),
            "tags": place_by_tags(measured, by_tags, TAGS),
        }
        for how, found in placed.items():
            held, off, said = _judged(camera, found, rotation, shift)
            own: tuple[str | float, ...] = (print_.name, seed, name, how)
            numbers = (round(held, 4), round(1e3 * off, 4), round(1e3 * said, 4))
            rows.append(dict(zip(HEAD, (*own, *numbers), strict=True)))
    return rows


def _judged(
    camera: OtherCamera, found: Placement, rotation: FloatArray, shift: FloatArray
) -> tuple[float, float, float]:
    """Share of the picture within the radius, median error and median radius [m]."""
    errors = plane_errors(found.camera, HEIGHT)
    true = camera.places(errors.pixels.reshape(-1, 2), rotation, shift, HEIGHT)
    off = np.linalg.norm(true.reshape(errors.places.shape) - errors.places, axis=-1)
    return (
        float(np.mean(off <= errors.camera)),
        float(np.median(off)),
        float(np.median(errors.camera)),
    )


def _views(
    camera: OtherCamera, print_: Print, rng: np.random.Generator, pictures: int
) -> list[BoardView]:
    """Views of a board that is held in all parts of the picture."""
    views: list[BoardView] = []
    width, height = print_.board.size
    corners = np.array([[0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0.0]])
    size = np.array(camera.size)
    number = 0
    while len(views) < pictures:
        number += 1
        middle = np.append(camera.directions((AIMS[number % len(AIMS)] * size)[None])[0], 1.0)
        axis = rng.uniform(0.0, 2.0 * math.pi)
        lean = np.radians(rng.uniform(15.0, 35.0)) * np.array([math.cos(axis), math.sin(axis), 0.0])
        turn = Rotation.from_rotvec(lean) * Rotation.from_euler("z", rng.uniform(-0.44, 0.44))
        rotation = turn.as_matrix() @ np.diag([1.0, -1.0, -1.0])
        shift = rng.uniform(0.33, 0.52) * middle - rotation @ [width / 2, height / 2, 0.0]
        rim, _ = cv2.projectPoints(
            corners, cv2.Rodrigues(rotation)[0], shift, camera.matrix, np.array(camera.distortion)
        )
        beyond = np.maximum(-rim[:, 0], rim[:, 0] - size)
        if beyond.max() > print_.reach:
            continue
        origin = (-print_.border, -print_.border)
        try:
            found = print_.board.find(seen(camera, print_.picture, origin, rotation, shift, rng))
        except InvalidInput:
            continue
        views.append(BoardView(f"{number}", camera.size, found))
    return views
