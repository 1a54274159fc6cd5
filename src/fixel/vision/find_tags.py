"""Tags in one picture: the corners of those that are looked for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.model.fields import FloatArray
from fixel.vision.boards import Gray, Picture, gray_of
from fixel.vision.marks import Tag
from fixel.vision.opencv import opencv

DICTIONARY: Final = {
    "apriltag-36h11": "DICT_APRILTAG_36h11",
    "aruco-4x4-50": "DICT_4X4_50",
    "aruco-5x5-100": "DICT_5X5_100",
}
# Upper left, upper right, lower right, lower left, as parts of the side.
CORNERS: Final = 0.5 * np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])


def tag_corners(tag: Tag) -> FloatArray:
    """(4, 2) corners of a tag in the frame of what it sits on, the upper left one first [m]."""
    x, y, angle = tag.pose
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(tag.size * CORNERS @ np.array([[c, s], [-s, c]]) + [x, y])


def find_tags(picture: Picture, tags: Sequence[Tag]) -> dict[int, FloatArray]:
    """Corners (4, 2) [px] by the place of each tag in `tags`; those that are not seen are left out.

    Raises
    ------
    InvalidInput
        A mirrored picture, or a tag that is there twice.
    """
    gray = gray_of(picture)
    found = _find(gray, tags)
    if not found and _find(np.ascontiguousarray(gray[:, ::-1]), tags):
        raise InvalidInput(
            "picture",
            found="mirrored tags",
            expected="the picture as the camera sees it",
            hint="switch off mirroring in the camera's settings",
        )
    return found


def _find(gray: Gray, tags: Sequence[Tag]) -> dict[int, FloatArray]:
    found: dict[int, FloatArray] = {}
    for family in sorted({tag.family for tag in tags}):
        seen = _of_family(gray, family)
        for index, tag in enumerate(tags):
            if tag.family == family and tag.id in seen:
                found[index] = seen[tag.id]
    return found


def _of_family(gray: Gray, family: str) -> dict[int, FloatArray]:
    aruco = opencv().aruco
    options = aruco.DetectorParameters()
    options.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
    dictionary = aruco.getPredefinedDictionary(getattr(aruco, DICTIONARY[family]))
    corners, ids, _ = aruco.ArucoDetector(dictionary, options).detectMarkers(gray)
    numbers = [] if ids is None else ids.ravel().tolist()
    twice = sorted({number for number in numbers if numbers.count(number) > 1})
    if twice:
        raise InvalidInput(
            "picture",
            found=f"{family} tag {twice[0]} at two places",
            expected="every tag once",
            hint="take the second print out of the picture",
        )
    return {
        number: np.asarray(four, dtype=np.float64).reshape(4, 2)
        for number, four in zip(numbers, corners, strict=True)
    }
