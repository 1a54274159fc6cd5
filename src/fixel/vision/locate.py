"""Where the marked parts of a rig lie in one picture, without a history."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

from fixel.model.fields import FloatArray
from fixel.model.shape import placed
from fixel.vision.frame import Picture
from fixel.vision.marks import Rig, Tag
from fixel.vision.outlines import vision_library

DICTIONARIES: Final = {
    "apriltag-36h11": "DICT_APRILTAG_36h11",
    "aruco-4x4-50": "DICT_4X4_50",
    "aruco-5x5-100": "DICT_5X5_100",
}
# Upper left, upper right, lower right, lower left, in halves of a side.
CORNERS: Final = np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]]) / 2.0


class Located(NamedTuple):
    """What one picture shows.

    Attributes
    ----------
    parts : dict of str to (3,) float64
        Poses of the parts that are seen [m, m, rad].
    plate : dict of int to (2,) float64
        How far plate tags appear from where they are, by their number [m].
    """

    parts: dict[str, FloatArray]
    plate: dict[int, FloatArray]


@final
class TagLocator:
    """Finds tags in single pictures, and the parts they sit on.

    Corners are taken down the camera's rays to the height of the tag, and the pose in the plane
    that fits them best is the part's: a tag cannot flip.

    Parameters
    ----------
    rig : Rig
    """

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        tags = [tag for part in rig.parts.values() for tag in part.marks if isinstance(tag, Tag)]
        families = dict.fromkeys(tag.family for tag in (*tags, *rig.plate))
        self._detectors = {family: _detector(family) for family in families}

    def __call__(self, picture: Picture) -> Located:
        """Where everything lies that is seen."""
        found = self._corners(picture)
        parts = {}
        for name, part in self.rig.parts.items():
            seen = [mark for mark in part.marks if _key(mark) in found]
            if seen:
                own = [placed(mark.size * CORNERS, mark.pose) for mark in seen]  # type: ignore[union-attr]
                there = [self._on_plane(mark, found) for mark in seen]
                parts[name] = fitted_pose(np.concatenate(own), np.concatenate(there))
        return Located(
            parts=parts,
            plate={
                tag.id: self._on_plane(tag, found).mean(axis=0) - tag.pose[:2]
                for tag in self.rig.plate
                if _key(tag) in found
            },
        )

    def _on_plane(self, mark: Any, found: dict[Any, FloatArray]) -> FloatArray:
        return self.rig.camera.on_plane(found[_key(mark)], mark.height)

    def _corners(self, picture: Picture) -> dict[Any, FloatArray]:
        """(4, 2) corners [px] of every tag in the picture."""
        cv2 = vision_library()
        gray = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) if picture.ndim == 3 else picture
        found: dict[Any, FloatArray] = {}
        for family, detector in self._detectors.items():
            corners, ids, _ = detector.detectMarkers(gray)
            for number, quad in zip([] if ids is None else ids.ravel(), corners, strict=True):
                found[family, int(number)] = quad.reshape(4, 2).astype(np.float64)
        return found


def fitted_pose(own: ArrayLike, there: ArrayLike) -> FloatArray:
    """(3,) pose [m, m, rad] that brings points (n, 2) of a frame nearest to others (n, 2) [m]."""
    a, b = np.asarray(own, dtype=np.float64), np.asarray(there, dtype=np.float64)
    p, q = a - a.mean(axis=0), b - b.mean(axis=0)
    angle = math.atan2(float((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum()), float((p * q).sum()))
    x, y = b.mean(axis=0) - placed(a.mean(axis=0), (0.0, 0.0, angle))
    return np.array([x, y, angle])


def _key(mark: Any) -> Any:
    return (mark.family, mark.id) if isinstance(mark, Tag) else mark


def _detector(family: str) -> Any:
    cv2 = vision_library()
    parameters = cv2.aruco.DetectorParameters()
    # Lines along whole sides: what refines single corners is pulled aside by the cells next to them.
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARIES[family]))
    return cv2.aruco.ArucoDetector(dictionary, parameters)
