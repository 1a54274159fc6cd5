"""Calibration boards: checkerboards, also with tags in their white squares (ChArUco).

A board's frame has x to the right and y up along the print, z out of the paper, and its origin at
the lower left corner of the outermost squares.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, final

import numpy as np

from fixel.errors import InvalidInput
from fixel.model.fields import positive, settle
from fixel.typing import FloatArray
from fixel.vision.frame import Gray, Picture, opencv

MIN_OTHERS: Final = 3  # tags of another dictionary that may be found by chance
MIN_CORNERS: Final = 8  # of one picture; a pose has six parameters, a corner two coordinates
DICTIONARIES: Final = {"4x4": 50, "5x5": 100, "6x6": 250}  # number of tags of each
UNITS: Final = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
SHAPE: Final = (
    "charuco:7x5:30mm:22mm (squares, size, size of tags) or checkerboard:9x6:25mm (inner corners, "
    "size of squares)"
)


class Corners(NamedTuple):
    """Corners of a board in a picture."""

    places: FloatArray  # (n, 2) coordinates in the board's frame [m]
    pixels: FloatArray  # (n, 2)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """Checkerboard, with or without tags.

    Parameters
    ----------
    columns, rows : int
        Number of squares.
    square : float
        Side of a square [m].
    marker : float, optional
        Side of the tags in the white squares [m]; None for a plain checkerboard.
    dictionary : str
        Dictionary of the tags, one of `DICTIONARIES`.
    """

    columns: int
    rows: int
    square: float
    marker: float | None = None
    dictionary: str = "4x4"

    def __post_init__(self) -> None:
        if not (3 <= self.columns <= 60 and 3 <= self.rows <= 60):
            raise InvalidInput(
                "board", found=f"{self.columns} x {self.rows} squares", expected="3 to 60 each"
            )
        settle(self, square=positive(self.square, "board.square", "m"))
        if self.marker is None:
            return
        settle(self, marker=positive(self.marker, "board.marker", "m"))
        if not self.marker < self.square:
            raise InvalidInput(
                "board.marker",
                found=f"tags of {1e3 * self.marker:g} mm in squares of {1e3 * self.square:g} mm",
                expected="tags smaller than the squares",
            )
        if self.dictionary not in DICTIONARIES:
            raise InvalidInput(
                "board.dictionary", found=repr(self.dictionary), expected=", ".join(DICTIONARIES)
            )
        if self.columns * self.rows // 2 > DICTIONARIES[self.dictionary]:
            raise InvalidInput(
                "board",
                found=f"{self.columns * self.rows // 2} tags",
                expected=f"at most {DICTIONARIES[self.dictionary]} tags of this family",
                hint="use fewer squares",
            )

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of all squares [m]."""
        return self.columns * self.square, self.rows * self.square

    def find(self, picture: Picture) -> Corners:
        """Find the corners of the board in a picture.

        Raises
        ------
        InvalidInput
            Too few corners were found, with the reason where it is known.
        """
        gray = gray_of(picture)
        found = self._find_tagged(gray) if self.marker else self._find_plain(gray)
        if found is None or len(found.pixels) < MIN_CORNERS:
            self._refuse(gray, 0 if found is None else len(found.pixels))
        assert found is not None
        return found

    def _refuse(self, gray: Gray, count: int) -> None:
        if self.marker:
            mirrored = self._find_tagged(np.ascontiguousarray(gray[:, ::-1]))
            if mirrored is not None and len(mirrored.pixels) >= max(MIN_CORNERS, count + 1):
                raise InvalidInput(
                    "picture",
                    found="a mirrored board",
                    expected="the picture as the camera sees it",
                    hint="switch off mirroring in the camera's settings",
                )
        inner = (self.columns - 1) * (self.rows - 1)
        others = self._other_dictionaries(gray) if self.marker else ""
        if others:
            raise InvalidInput(
                "picture",
                found=f"a board with tags of {others}",
                expected=f"tags of {self.dictionary}, as in the name of the board",
                hint=f"add :{others} to the board, as in charuco:7x5:30mm:22mm:{others}",
            )
        raise InvalidInput(
            "picture",
            found=f"{count} of {inner} corners" if count else "no such board",
            expected=f"a sharp view of at least {MIN_CORNERS} of its {inner} corners"
            if self.marker
            else f"a sharp view of all {inner} inner corners with a white border",
        )

    def _find_tagged(self, gray: Gray) -> Corners | None:
        cv2 = opencv()
        board = self.of_opencv()
        pixels, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(gray)
        if ids is None or not len(ids):
            return None
        places = np.asarray(board.getChessboardCorners(), dtype=np.float64)[ids.ravel(), :2]
        return self._sharpened(gray, places, pixels.reshape(-1, 2).astype(np.float64))

    def _other_dictionaries(self, gray: Gray) -> str:
        """Return the dictionary of most tags in a picture if it is another one, else empty."""
        aruco = opencv().aruco
        counts = {}
        for name, size in DICTIONARIES.items():
            tags = aruco.getPredefinedDictionary(getattr(aruco, f"DICT_{name.upper()}_{size}"))
            ids = aruco.ArucoDetector(tags).detectMarkers(gray)[1]
            counts[name] = 0 if ids is None else len(ids)
        most = max(counts, key=lambda name: counts[name])
        return most if most != self.dictionary and counts[most] > MIN_OTHERS else ""

    def _find_plain(self, gray: Gray) -> Corners | None:
        cv2 = opencv()
        across, down = self.columns - 1, self.rows - 1
        # Its option to normalise the picture makes corners ten times less accurate.
        done, pixels = cv2.findChessboardCornersSB(gray, (across, down))
        if not done:
            return None
        grid = pixels.reshape(down, across, 2).astype(np.float64)
        # The board looks the same after half a turn, and its corners come in any order: make the
        # upper row of the picture the first, from left to right.
        if grid[0, -1, 0] < grid[0, 0, 0]:
            grid = grid[:, ::-1]
        along, below = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
        if along[0] * below[1] - along[1] * below[0] < 0.0:
            grid = grid[::-1]
        i, j = np.meshgrid(np.arange(across), np.arange(down))
        places = np.asarray((np.stack([i, j], axis=-1) + 1.0) * self.square, dtype=np.float64)
        return self._sharpened(gray, places.reshape(-1, 2), grid.reshape(-1, 2).copy())

    def _sharpened(self, gray: Gray, places: FloatArray, pixels: FloatArray) -> Corners:
        """Refine corners to the crossing of the edges around them, within windows between tags."""
        cv2 = opencv()
        if len(places) < 4:
            return Corners(self._upright(places), pixels)
        flat, _ = cv2.findHomography(places, pixels)
        clear = (self.square - self.marker) / 2.0 if self.marker else self.square / 3.0
        room = np.full(len(places), 9.0)
        for step in clear * np.array([[1, 0], [0, 1], [1, 1], [1, -1]]):
            aside = cv2.perspectiveTransform((places + step)[:, None], flat)[:, 0]
            here = cv2.perspectiveTransform(places[:, None].copy(), flat)[:, 0]
            room = np.minimum(room, 0.9 * np.abs(aside - here).max(axis=1))
        halves = np.maximum(room.astype(int), 2)
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
        sharp = pixels.copy()
        for half in np.unique(halves).tolist():
            some = halves == half
            rough = pixels[some].astype(np.float32)[:, None].copy()
            found = cv2.cornerSubPix(gray, rough, (half, half), (-1, -1), stop)
            sharp[some] = found.reshape(-1, 2)
        size = np.array(gray.shape[::-1])
        inside = ((sharp > halves[:, None]) & (sharp < size - 1 - halves[:, None])).all(axis=1)
        steady = np.abs(sharp - pixels).max(axis=1) < 1.5
        return Corners(self._upright(places[inside & steady]), sharp[inside & steady])

    def _upright(self, places: FloatArray) -> FloatArray:
        """Convert OpenCV's places, with y from the upper edge, to the board's frame."""
        return np.stack([places[:, 0], self.size[1] - places[:, 1]], axis=-1)

    def of_opencv(self) -> Any:
        """Return the OpenCV object of a board with tags."""
        aruco = opencv().aruco
        tags = f"DICT_{self.dictionary.upper()}_{DICTIONARIES[self.dictionary]}"
        dictionary = aruco.getPredefinedDictionary(getattr(aruco, tags))
        return aruco.CharucoBoard(
            (self.columns, self.rows), float(self.square), float(self.marker or 0.0), dictionary
        )


def board_of(text: str) -> Board:
    """Parse the text of a board: `charuco:7x5:30mm:22mm`, `checkerboard:9x6:25mm`.

    A checkerboard is specified by its inner corners, a ChArUco board by its squares, as is usual.
    """
    kind, *parts = text.strip().lower().split(":")
    counts = re.fullmatch(r"(\d{1,3})x(\d{1,3})", parts[0]) if parts else None
    wanted = {"charuco": (3, 4), "checkerboard": (2,)}.get(kind, ())
    if not counts or len(parts) not in wanted:
        raise InvalidInput("board", found=repr(text), expected=SHAPE)
    across, down = (int(count) for count in counts.groups())
    if kind == "checkerboard":
        return Board(columns=across + 1, rows=down + 1, square=_length(parts[1]))
    dictionary = parts[3] if len(parts) == 4 else "4x4"
    return Board(
        columns=across,
        rows=down,
        square=_length(parts[1]),
        marker=_length(parts[2]),
        dictionary=dictionary,
    )


def _length(text: str) -> float:
    found = re.fullmatch(r"(\d+(?:\.\d+)?)(mm|cm|m)", text)
    if not found:
        raise InvalidInput("board", found=repr(text), expected="a length with its unit: 30mm")
    return float(found[1]) * UNITS[found[2]]


def gray_of(picture: Picture) -> Gray:
    """Convert a picture to grey levels."""
    if picture.ndim == 2:
        return picture
    gray: Gray = opencv().cvtColor(picture, opencv().COLOR_BGR2GRAY)
    return gray
