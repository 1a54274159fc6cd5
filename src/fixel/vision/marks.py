"""Rig of a testbed: camera, tags and stickers, and their places on the parts; calibration boards.

A board is a checkerboard, also with tags in its white squares (ChArUco). Its frame has x to the
right and y up along the print, z out of the paper, and its origin at the lower left corner of the
outermost squares.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from functools import cache
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fixel.errors import InvalidInput, check_name
from fixel.model.bodies import POSE
from fixel.model.fields import (
    Comparable,
    Value,
    check_fields,
    instance,
    name_of,
    non_negative,
    positive,
    settle,
    vector,
)
from fixel.typing import BoolArray, FloatArray
from fixel.vision.camera import Camera, MeasuredCamera
from fixel.vision.frame import Gray, Picture, opencv

# Bit 0 is the blue coil, 1 the red, 2 the green one. The thesis's contact mode has the reverse
# order: 4 for the first fixel, 2 for the second, 1 for the third.
THESIS_BITS: Final = ("fixel-3", "fixel-2", "fixel-1")
# OpenCV's names of families of tags.
_FAMILIES: Final = {
    "apriltag-36h11": "DICT_APRILTAG_36h11",
    "aruco-4x4-50": "DICT_4X4_50",
    "aruco-5x5-100": "DICT_5X5_100",
}
FAMILIES: Final = tuple(_FAMILIES)
# With families in common use, to name tags that do not belong to the rig.
KNOWN_FAMILIES: Final = _FAMILIES | {
    "aruco-6x6-250": "DICT_6X6_250",
    "aruco-7x7-250": "DICT_7X7_250",
    "apriltag-25h9": "DICT_APRILTAG_25h9",
    "apriltag-36h10": "DICT_APRILTAG_36h10",
}
COLOURS: Final = ("red", "orange", "yellow", "green", "cyan", "blue", "magenta")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tag(Comparable):
    """Square tag that encodes a number.

    Parameters
    ----------
    id : int
        Number within its family.
    size : float
        Side of its black square [m].
    pose : (3,) array_like
        Pose of its middle in the frame of its part [m, m, rad]; at angle 0 its upper side is along
        x, with y up.
    height : float
        Height of its upper face above the plane [m].
    family : str
        Family of the tag, one of `FAMILIES`.
    """

    id: int
    size: Annotated[float, Value(positive, "m")]
    pose: Annotated[FloatArray, Value(vector, POSE)] = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    height: Annotated[float, Value(non_negative, "m")]
    family: str = FAMILIES[0]

    def __post_init__(self) -> None:
        check_name("tag.family", self.family, FAMILIES)
        if isinstance(self.id, bool) or self.id < 0 or self.id != int(self.id):
            raise InvalidInput("tag.id", found=self.id, expected="a whole number of at least 0")
        check_fields(self, "tag")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sticker(Comparable):
    """Round sticker of one colour.

    Parameters
    ----------
    colour : str
        One of `COLOURS`, which no other sticker in the picture has.
    diameter : float
        Diameter of the sticker [m].
    place : (2,) array_like
        Place of its middle in the frame of its part [m].
    height : float
        Height of its upper face above the plane [m].
    """

    colour: str
    diameter: Annotated[float, Value(positive, "m")]
    place: Annotated[FloatArray, Value(vector, "x [m], y [m]")]
    height: Annotated[float, Value(non_negative, "m")]

    def __post_init__(self) -> None:
        check_name("sticker.colour", self.colour, COLOURS)
        check_fields(self, "sticker")


Mark = Tag | Sticker


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MarkedPart(Comparable):
    """Part of the scene with its markers.

    Parameters
    ----------
    height : float
        Height of its upper face above the plane [m].
    marks : tuple of Mark
        Markers of the part. One tag or two stickers determine its pose; more are used together.
    """

    height: Annotated[float, Value(positive, "m")]
    marks: tuple[Mark, ...] = ()

    def __post_init__(self) -> None:
        marks = tuple(self.marks)
        for index, mark in enumerate(marks):
            instance(mark, Mark, f"marks[{index}]", "a Tag or a Sticker")
        settle(self, marks=marks)
        check_fields(self, "part")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rig(Comparable):
    """Camera over a plate, with the markers of parts and plate.

    Parameters
    ----------
    name : str
        Name of the testbed; recordings of another are rejected.
    camera : Camera
    parts : dict of str to MarkedPart
        Parts by the names of body and pusher in the scene.
    fixel_height : float
        Height of the fixels above the plane [m].
    plate : tuple of Tag
        Tags fixed to the plate, at poses in the world; they show whether the camera moved.
    tactile : tuple of str
        Fixel of each bit of the tactile byte, lowest first.
    position_tolerance, angle_tolerance : float
        Largest errors of the start poses of an experiment [m, rad].
    measured : MeasuredCamera, optional
        The same camera with the covariance of its errors; None where it is unknown.
    """

    name: str
    camera: Camera
    parts: dict[str, MarkedPart] = field(default_factory=dict)
    fixel_height: Annotated[float, Value(positive, "m")] = 0.05108
    plate: tuple[Tag, ...] = ()
    tactile: tuple[str, ...] = THESIS_BITS
    position_tolerance: Annotated[float, Value(positive, "m")] = 1e-3
    angle_tolerance: Annotated[float, Value(positive, "rad")] = math.radians(1.0)
    measured: MeasuredCamera | None = None

    def __post_init__(self) -> None:
        name_of(self.name, "rig.name")
        instance(self.camera, Camera, "rig.camera", "a Camera")
        if self.measured is not None and self.measured.camera != self.camera:
            raise InvalidInput(
                "rig.measured", found="another camera", expected="the errors of rig.camera, or none"
            )
        check_fields(self, "rig")
        parts, plate = dict(self.parts), tuple(self.plate)
        settle(self, parts=parts, plate=plate, tactile=_bits(self.tactile))
        for name, part in self.parts.items():
            instance(part, MarkedPart, f"rig.parts[{name_of(name, 'rig.parts')!r}]", "a MarkedPart")
        for index, tag in enumerate(self.plate):
            instance(tag, Tag, f"rig.plate[{index}]", "a Tag")
        _refuse_twins(self)


def _bits(fixels: tuple[str, ...]) -> tuple[str, ...]:
    names = tuple(name_of(fixel, "rig.tactile") for fixel in fixels)
    if len(names) > 8 or len(set(names)) < len(names):
        raise InvalidInput(
            "rig.tactile", found=list(names), expected="at most eight fixels, each once"
        )
    return names


def _refuse_twins(rig: Rig) -> None:
    """Raise if a tag or a colour occurs twice, as it could not be assigned to a part."""
    seen: dict[str, str] = {}
    everywhere = [(name, mark) for name, part in rig.parts.items() for mark in part.marks]
    for name, mark in [*everywhere, *(("the plate", tag) for tag in rig.plate)]:
        what = f"{mark.family} tag {mark.id}" if isinstance(mark, Tag) else f"{mark.colour} sticker"
        if what in seen:
            found = f"the {what} on {seen[what]} and on {name}"
            expected = "each marker once, so that they can be distinguished"
            raise InvalidInput("rig.parts", found=found, expected=expected)
        seen[what] = name


MIN_OTHERS: Final = 3  # tags of another dictionary that may be found by chance
MIN_CORNERS: Final = 8  # of one picture; a pose has six parameters, a corner two coordinates
DICTIONARIES: Final = {"4x4": 50, "5x5": 100, "6x6": 250}  # number of tags of each
UNITS: Final = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
BOARD_SHAPE: Final = (
    "charuco:7x5:30mm:22mm (squares, size, size of tags) or checkerboard:9x6:25mm (inner corners, "
    "size of squares)"
)


class Corners(NamedTuple):
    """Corners of a board in a picture."""

    places: FloatArray  # (n, 2) coordinates in the board's frame [m]
    pixels: FloatArray  # (n, 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """Checkerboard, with or without tags."""

    columns: int  # number of squares across
    rows: int  # number of squares down
    square: float  # side of a square [m]
    marker: float | None = None  # side of the tags in the white squares [m]; None without tags
    dictionary: str = "4x4"  # of the tags, one of `DICTIONARIES`

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
            found = f"tags of {1e3 * self.marker:g} mm in squares of {1e3 * self.square:g} mm"
            expected = "tags smaller than the squares"
            raise InvalidInput("board.marker", found=found, expected=expected)
        check_name("board.dictionary", self.dictionary, DICTIONARIES)
        if self.columns * self.rows // 2 > DICTIONARIES[self.dictionary]:
            raise InvalidInput(
                "board",
                found=f"{self.columns * self.rows // 2} tags",
                expected=f"at most {DICTIONARIES[self.dictionary]} tags of this family",
                hint="use fewer squares",
            )

    @property
    def text(self) -> str:
        """The board as it is typed on the command line."""
        mm = f"{1e3 * self.square:g}mm"
        if self.marker is None:
            return f"checkerboard:{self.columns - 1}x{self.rows - 1}:{mm}"
        return f"charuco:{self.columns}x{self.rows}:{mm}:{1e3 * self.marker:g}mm"

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of all squares [m]."""
        return self.columns * self.square, self.rows * self.square

    def find(self, picture: Picture) -> Corners:
        """Find the corners of the board in a picture; raise with the reason if they are too few."""
        gray = gray_of(picture)
        found = self._find_tagged(gray) if self.marker else self._find_plain(gray)
        if found is None or len(found.pixels) < MIN_CORNERS:
            self._refuse(gray, 0 if found is None else len(found.pixels))
        assert found is not None
        return found

    def _refuse(self, gray: Gray, count: int) -> None:
        if self.marker:
            other = self._find_tagged(np.ascontiguousarray(gray[:, ::-1]))
            if other is not None and len(other.pixels) >= max(MIN_CORNERS, count + 1):
                raise mirrored("a mirrored board")
        inner = (self.columns - 1) * (self.rows - 1)
        others = self._other_dictionaries(gray) if self.marker else ""
        if others:
            found = f"a board with tags of {others}"
            expected = f"tags of {self.dictionary}, as in the name of the board"
            hint = f"add :{others} to the board, as in charuco:7x5:30mm:22mm:{others}"
            raise InvalidInput("picture", found=found, expected=expected, hint=hint)
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
            tags = f"DICT_{name.upper()}_{size}"
            ids = aruco.ArucoDetector(predefined(tags)).detectMarkers(gray)[1]
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
        tags = predefined(f"DICT_{self.dictionary.upper()}_{DICTIONARIES[self.dictionary]}")
        squares, side, marker = (self.columns, self.rows), float(self.square), self.marker or 0.0
        return opencv().aruco.CharucoBoard(squares, side, float(marker), tags)


def mirrored(found: str) -> InvalidInput:
    """Return the error for what is mirrored in a picture."""
    expected = "the picture as the camera sees it"
    hint = "switch off mirroring in the settings of the camera or the recorder"
    return InvalidInput("picture", found=found, expected=expected, hint=hint)


def predefined(name: str) -> Any:
    """Return a dictionary of tags by OpenCV's name for it."""
    aruco = opencv().aruco
    return aruco.getPredefinedDictionary(getattr(aruco, name))


@cache
def cells(family: str, id_: int) -> tuple[FloatArray, BoolArray]:
    """Middles (n, 2) of the cells of a tag of side 1, with its border, and which are white.

    Cells are in rows from the upper side down.
    """
    dictionary = dictionary_of(family, id_)
    size = dictionary.markerSize
    inner = dictionary.getBitsFromByteList(dictionary.bytesList[id_ : id_ + 1], size)
    white: NDArray[np.bool_] = np.pad(np.asarray(inner).reshape(size, size) > 0, 1)
    middle = (np.arange(size + 2) + 0.5) / (size + 2) - 0.5
    x, y = np.meshgrid(middle, -middle)
    return np.column_stack((x.ravel(), y.ravel())), white.ravel()


@cache
def dictionary_of(family: str, id_: int = 0) -> Any:
    """Return OpenCV's dictionary of a family; raise where it has no tag of this number."""
    dictionary = predefined(KNOWN_FAMILIES[family])
    count = len(dictionary.bytesList)
    if id_ >= count:
        raise InvalidInput("tag.id", found=id_, expected=f"0 to {count - 1} of {family}")
    return dictionary


def board_of(text: str) -> Board:
    """Parse the text of a board: `charuco:7x5:30mm:22mm`, `checkerboard:9x6:25mm`.

    A checkerboard is specified by its inner corners, a ChArUco board by its squares, as is usual.
    """
    kind, *parts = text.strip().lower().split(":")
    counts = re.fullmatch(r"(\d{1,3})x(\d{1,3})", parts[0]) if parts else None
    wanted = {"charuco": (3, 4), "checkerboard": (2,)}.get(kind, ())
    if not counts or len(parts) not in wanted:
        raise InvalidInput("board", found=repr(text), expected=BOARD_SHAPE)
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
