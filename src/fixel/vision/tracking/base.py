"""What every method of tracking is and promises."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Final, final

import numpy as np

from fixel.model import Body, Pusher
from fixel.model.trajectory import wrapped
from fixel.typing import FloatArray
from fixel.vision.frame import Frame
from fixel.vision.marks import Rig

Thing = Body | Pusher

FORGET: Final = 0.25  # [s] without a sight after which a part may be anywhere near
COUNTED: Final = 3  # frames likewise, where they are counted
SAME_PREDICTION: Final = (
    0.05  # of the way since the last sight: predictions that differ by less are one
)

SEARCH_EVERY: Final = 2  # frames between two searches for what has been lost for a while
MARGIN: Final = 40  # [px] around the last place, in which a part is searched for at first
SPREADS: Final = 6  # [px] a frame by which that grows: 0.1 m/s at 0.55 mm a pixel, 30 frames/s

# Standard deviations of a pose beyond which a sight is none: a mark of which too little shows.
VAGUE_POSITION: Final = 0.25e-3  # [m] at 0.55 mm a pixel; scaled with the pixel
VAGUE_ANGLE: Final = 0.004  # [rad]
USUAL_PIXEL: Final = 0.55e-3  # [m]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Sighting:
    """What one frame tells of one part.

    Attributes
    ----------
    pose : (3,) float64, or None
        [m, m, rad]; none where it cannot be told, and `reason` says why.
    residual : float
        Root mean square distance from where the marks should be [px].
    scale : float
        What a pixel is there [m].
    sd : (3,) float64
        Standard deviations of the pose, from the residual [m, m, rad].
    marks : int
        How many marks, or edges of an outline, took part.
    share : float
        Of what should be seen of them [-].
    reason : str
    """

    pose: FloatArray | None = None
    residual: float = 0.0
    scale: float = 0.0
    sd: FloatArray = field(default_factory=lambda: np.zeros(3))
    marks: int = 0
    share: float = 0.0
    reason: str = ""


class AbstractFollower(ABC):
    """Follows the parts of one film, frame by frame, in order."""

    @abstractmethod
    def see(self, frame: Frame) -> dict[str, Sighting]:
        """Where the parts are in the next frame, by name."""


class AbstractTracking(ABC):
    """A method of finding parts in pictures.

    Final members know what they look for from the rig and the outlines; what they find are poses in
    the plane, and a reason wherever there is none.

    Attributes
    ----------
    name : str
    needs : str
        What a part must have to be followed, for people.
    """

    name: ClassVar[str]
    needs: ClassVar[str]

    @abstractmethod
    def parts(self, rig: Rig, things: Mapping[str, Thing]) -> tuple[str, ...]:
        """Names of the parts it can follow."""

    @abstractmethod
    def follow(self, rig: Rig, things: Mapping[str, Thing]) -> AbstractFollower:
        """Begin a film of a rig with at least one part that can be followed.

        Parameters
        ----------
        rig : Rig
        things : dict of str to Thing
            Bodies and pushers of the scene, where there is one: what outlines they have, and about
            how they lie at the start.
        """


@final
class PartPrediction:
    """Where a part should be now, from where it was.

    Time stamps of arrival may be uneven where the pictures are not, so that the motion is also
    counted in frames: `at` is called once a frame.
    """

    def __init__(self) -> None:
        self._last: tuple[float, FloatArray] | None = None
        self._rate = np.zeros(3)  # a second
        self._step = np.zeros(3)  # a frame
        self._unseen = 0  # frames since the last sight

    @property
    def pose(self) -> FloatArray | None:
        """(3,) last seen; none if never."""
        return None if self._last is None else self._last[1]

    def at(self, time: float) -> FloatArray | None:
        """(3,) pose to be expected at an instant [s], by the time stamps."""
        self._unseen += 1
        if self._last is None:
            return None
        then, pose = self._last
        return pose + self._rate * min(time - then, FORGET)

    def by_count(self, expected: FloatArray) -> FloatArray | None:
        """(3,) pose to be expected by the number of frames; none where it is much the same."""
        if self._last is None or self._unseen > COUNTED:
            return None
        moved = self._step * self._unseen
        pose = self._last[1] + moved
        alike = (np.abs(pose - expected) <= SAME_PREDICTION * np.abs(moved)).all()
        return None if alike else pose

    def fresh(self, time: float) -> bool:
        """Whether it was seen so lately that it must be about where it is expected."""
        return self._last is not None and (time - self._last[0] < FORGET or self._unseen <= COUNTED)

    def seen(self, time: float, pose: FloatArray) -> None:
        """Store a sight."""
        self._rate, self._step = np.zeros(3), np.zeros(3)
        if self._last is not None and self.fresh(time):
            then, before = self._last
            step = pose - before
            step[2] = wrapped(step[2])  # angles that were read anew know of no turns
            self._step = step / max(self._unseen, 1)
            if time - then < FORGET:
                self._rate = step / (time - then)
        self._last = (time, pose)
        self._unseen = 0


def worth_a_search(lost: int) -> bool:
    """Whether to search for a part again that was not seen in the last `lost` frames."""
    return lost < 3 or lost % SEARCH_EVERY == 0


def search_margin(lost: int) -> int:
    """Distance [px] from its last place at which a part may be after `lost` frames.

    It may have been pushed on while it was covered; the whole picture is searched much more rarely.
    """
    return MARGIN + SPREADS * lost


def vague(sd: FloatArray, scale: float) -> bool:
    """Whether too little shows to tell a pose."""
    most = VAGUE_POSITION * scale / USUAL_PIXEL
    return bool(np.hypot(sd[0], sd[1]) > most or sd[2] > VAGUE_ANGLE)
