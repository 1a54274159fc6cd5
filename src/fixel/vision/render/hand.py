"""Hand that covers part of the object for a while."""

from __future__ import annotations

from typing import Final

import numpy as np

from fixel.model import Shape
from fixel.model.chance import stream
from fixel.model.fields import frozen
from fixel.model.shape import placed
from fixel.typing import FloatArray
from fixel.vision.marks import Rig
from fixel.vision.render.canvas import cover
from fixel.vision.render.eye import Eye
from fixel.vision.render.looks import Looks
from fixel.vision.render.solids import outline_of
from fixel.vision.render.things import OBJECT_HEIGHT, hand_solid, pixel_of

AWAY: Final = 0.45  # [m] from its resting place to one outside the picture
MOVING: Final = 0.45  # [s] to arrive, and to leave
STEPS: Final = 12  # bisections to find the resting place


class Occlusion:
    """Motion of a hand in one film.

    Parameters
    ----------
    looks : Looks
        Duration of the occlusion, and covered share of the object.
    name : str
        Name of the object.
    shape : Shape
        Shape of the object.
    rig : Rig
    times : (n,) float64
        Times of the film's frames [s].
    seed : int
    """

    def __init__(
        self, looks: Looks, name: str, shape: Shape, rig: Rig, times: FloatArray, seed: int
    ) -> None:
        self._looks, self._name, self._rig = looks, name, rig
        self._eye = Eye(rig.camera)
        random = stream(seed, "film", "hand")
        first, last = float(times[0]), float(times[-1])
        spare = max(last - first - looks.occlusion, 0.0)
        self._begins = first + spare * random.uniform(0.35, 0.6)
        self._ends = min(self._begins + looks.occlusion, last)
        self._heading = 0.5 * np.pi + random.uniform(-0.35, 0.35)
        pixel = pixel_of(rig)
        self._hand = hand_solid(4.0 * pixel)
        self._outline = outline_of(shape, 2.0 * pixel).points
        self._ahead: float | None = None

    @property
    def interval(self) -> tuple[float, float]:
        """First and last time at which the hand lies over the object [s]; (0, 0) without a hand."""
        return (self._begins, self._ends) if self._looks.occlusion > 0.0 else (0.0, 0.0)

    def pose(self, time: float, object_pose: FloatArray) -> FloatArray | None:
        """Pose (3,) of the hand [m, m, rad]; None while it is outside the picture."""
        if self._looks.occlusion == 0.0:
            return None
        late = max(self._begins - time, time - self._ends, 0.0) / MOVING
        if late >= 1.0:
            return None
        if self._ahead is None:
            self._ahead = self._ahead_for(object_pose)
        away = late * late * (3.0 - 2.0 * late) * AWAY
        return self._at(object_pose, self._ahead - away)

    def share(self, hand: FloatArray | None, object_pose: FloatArray) -> float:
        """Share of the object's upper face that a hand at this pose covers [-]."""
        if hand is None:
            return 0.0
        part = self._rig.parts.get(self._name)
        height = part.height if part else OBJECT_HEIGHT
        face = self._eye.project_at(placed(self._outline, object_pose), height)
        low = np.floor(face.min(axis=0))
        w, h = (int(n) for n in np.ceil(face.max(axis=0)) - low + 1)
        room = np.zeros((h, w + 2))
        wanted, covered = np.zeros((h, w), np.float32), np.zeros((h, w), np.float32)
        cover(wanted, room, face - low)
        for slab in self._hand.slabs:
            pixels = self._eye.project_at(placed(slab.outline.points, hand), slab.high)
            cover(covered, room, pixels - low)
        return float(np.minimum(wanted, covered).sum() / wanted.sum())

    def _at(self, object_pose: FloatArray, ahead: float) -> FloatArray:
        along = np.array([np.cos(self._heading), np.sin(self._heading)])
        return frozen([*(object_pose[:2] + ahead * along), self._heading])

    def _ahead_for(self, object_pose: FloatArray) -> float:
        """Find the reach of the fingertips beyond the object that covers the given share [m]."""
        low, high = -0.15, 0.2
        for _ in range(STEPS):
            middle = 0.5 * (low + high)
            found = self.share(self._at(object_pose, middle), object_pose)
            low, high = (middle, high) if found < self._looks.occluded else (low, middle)
        return 0.5 * (low + high)
