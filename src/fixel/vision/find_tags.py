"""Detection of tags in one picture, with corners to a few hundredths of a pixel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.typing import FloatArray
from fixel.vision.boards import Gray, Picture, gray_of
from fixel.vision.marks import Tag
from fixel.vision.tracking.edges import EdgeLine, find_edges
from fixel.vision.tracking.tag_reader import read_tags

ALONG: Final = np.linspace(0.12, 0.88, 16)  # fractions of a side at which its edge is measured
TAG_REACH: Final = 4.0  # [px] from the rough edge
MIN_ON_A_SIDE: Final = 6


def find_tags(picture: Picture, tags: Sequence[Tag]) -> dict[int, FloatArray]:
    """Find tags; return corners (4, 2) [px] by index in `tags`, without those not found.

    Raises
    ------
    InvalidInput
        The picture is mirrored, or a tag occurs twice.
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
                found=f"{tag.family} tag {tag.id} at two places",
                expected="every tag once",
                hint="take the second print out of the picture",
            )
        corners = _sharpened(gray, places[0]) if places else None
        if corners is not None:
            found[index] = corners
    if not found:
        _refuse_mirrored(gray, tags, families)
    return found


def _refuse_mirrored(gray: Gray, tags: Sequence[Tag], families: set[str]) -> None:
    seen = read_tags(gray[:, ::-1], families)
    if any((tag.family, tag.id) in seen for tag in tags):
        raise InvalidInput(
            "picture",
            found="mirrored tags",
            expected="the picture as the camera sees it",
            hint="switch off mirroring in the camera's settings",
        )


def _sharpened(gray: Gray, corners: FloatArray) -> FloatArray | None:
    """Refine corners to the crossings of lines through four edges; None if one is unclear.

    Tags are small enough for distortion within one to be negligible.
    """
    lines = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = (end - start) / np.linalg.norm(end - start)
        outwards = np.array([along[1], -along[0]])  # clockwise in the picture, black inside
        pixels = start + ALONG[:, None] * (end - start)
        edge = find_edges(gray, EdgeLine(pixels, np.tile(outwards, (len(ALONG), 1))), TAG_REACH)
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
