"""Tags in a picture: read with OpenCV, and their corners to a few hundredths of a pixel."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.model.shape import placed
from fixel.typing import FloatArray
from fixel.vision.frame import Gray, Picture, opencv
from fixel.vision.marks import KNOWN_FAMILIES, Tag, dictionary_of, gray_of, mirrored
from fixel.vision.tracking.loops import find_edges

MAX_NAMED: Final = 6  # tags per family
# Corners of a tag of side 1, in OpenCV's order: clockwise in the picture from the upper left.
CORNERS: Final = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])

TagName = tuple[str, int]
ALONG: Final = np.linspace(0.12, 0.88, 16)  # fractions of a side at which its edge is measured
TAG_REACH: Final = 4.0  # [px] from the rough edge
MIN_ON_A_SIDE: Final = 6


def read_tags(picture: Gray, families: set[str]) -> dict[TagName, list[FloatArray]]:
    """Read all tags in a picture: corners (4, 2) [px] by family and id.

    Corners are clockwise from the upper left of the tag, accurate to half a pixel. More than one
    set of corners for an id indicates a second tag with it.
    """
    found: dict[TagName, list[FloatArray]] = {}
    contiguous = np.ascontiguousarray(picture)
    for family in sorted(families):
        corners, ids, _ = _detector(family).detectMarkers(contiguous)
        for quad, id_ in zip(corners, () if ids is None else np.ravel(ids), strict=True):
            found.setdefault((family, int(id_)), []).append(quad.reshape(4, 2).astype(np.float64))
    return found


def other_families(picture: Gray, families: set[str]) -> str:
    """Describe tags of other families in a picture; empty where there are none."""
    found = read_tags(picture, set(KNOWN_FAMILIES) - families)
    by_family: dict[str, list[int]] = {}
    for family, id_ in sorted(found):
        by_family.setdefault(family, []).append(id_)
    return "; ".join(
        f"{family} tag{'' if len(ids) == 1 else 's'} {', '.join(map(str, ids[:MAX_NAMED]))}"
        for family, ids in by_family.items()
    )


@functools.cache
def _detector(family: str) -> Any:
    cv2 = opencv()
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    return cv2.aruco.ArucoDetector(dictionary_of(family), parameters)


def tag_corners(tag: Tag) -> FloatArray:
    """Corners (4, 2) of a tag in the frame of its part, in the order of `read_tags` [m]."""
    return on_tag(tag, CORNERS)


def on_tag(tag: Tag, points: FloatArray) -> FloatArray:
    """Convert points (n, 2) of a tag of side 1 to the frame of its part [m]."""
    return placed(tag.size * points, tag.pose)


def tag_points(seen: Mapping[Tag, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Corners of tags in the frame of their part (n, 3) [m], and in the picture (n, 2) [px]."""
    points = [np.column_stack((tag_corners(tag), np.full(4, tag.height))) for tag in seen]
    return np.concatenate(points), np.concatenate(list(seen.values()))


def find_tags(picture: Picture, tags: Sequence[Tag]) -> dict[int, FloatArray]:
    """Find tags; return corners (4, 2) [px] by index in `tags`, without those not found.

    A mirrored picture raises, and a tag that occurs twice.
    """
    gray = gray_of(picture)
    families = {tag.family for tag in tags}
    seen = read_tags(gray, families)
    found: dict[int, FloatArray] = {}
    for index, tag in enumerate(tags):
        places = seen.get((tag.family, tag.id), [])
        if len(places) > 1:
            raise InvalidInput(
                "picture",
                found=f"{tag.family} tag {tag.id} at two positions",
                expected="each tag once",
                hint="remove the second print",
            )
        corners = _sharpened(gray, places[0]) if places else None
        if corners is not None:
            found[index] = corners
    if not found:
        seen = read_tags(gray[:, ::-1], families)
        if any((tag.family, tag.id) in seen for tag in tags):
            raise mirrored("mirrored tags")
    return found


def _sharpened(gray: Gray, corners: FloatArray) -> FloatArray | None:
    """Refine corners to the crossings of lines through four edges; None if one is unclear.

    Tags are small enough for distortion within one to be negligible.
    """
    lines = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = (end - start) / np.linalg.norm(end - start)
        outwards = np.array([along[1], -along[0]])  # clockwise in the picture, black inside
        pixels = start + ALONG[:, None] * (end - start)
        edge = find_edges(gray, pixels, np.tile(outwards, (len(ALONG), 1)), TAG_REACH)
        if edge.clear.sum() < MIN_ON_A_SIDE:
            return None
        on_it = (pixels + edge.offset[:, None] * outwards)[edge.clear]
        middle = np.median(on_it, axis=0)
        off = (on_it - middle) @ outwards
        steady = np.abs(off - np.median(off)) < 1.0
        middle = on_it[steady].mean(axis=0)
        direction = np.linalg.svd(on_it[steady] - middle)[2][0]
        lines.append((middle, np.array([direction[1], -direction[0]])))
    sharp = np.empty((4, 2))
    for k in range(4):
        (p, n), (q, m) = lines[k - 1], lines[k]
        sharp[k] = np.linalg.solve(np.stack([n, m]), [n @ p, m @ q])
    return sharp
