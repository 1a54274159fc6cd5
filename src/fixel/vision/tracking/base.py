"""Abstract tracking method, what all methods share, and the result: tracks of parts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from fixel.errors import InvalidInput
from fixel.model import Body, Pusher, Trajectory
from fixel.model.fields import Comparable, frozen, settle
from fixel.model.trajectory import pose_difference
from fixel.typing import BoolArray, FloatArray
from fixel.vision.frame import Frame
from fixel.vision.marks import Rig

Thing = Body | Pusher

FORGET: Final = 0.25  # [s] without a sighting after which a prediction is invalid
COUNTED: Final = 3  # frames likewise, for predictions by number of frames
SAME_PREDICTION: Final = 0.05  # of the motion since the last sighting: below, two are one

SEARCH_EVERY: Final = 2  # frames between two searches for a part lost for a while
SEARCH_ALL: Final = 16  # likewise, of the whole picture
MARGIN: Final = 40  # [px] around the last place that is searched at first
SPREADS: Final = 6  # [px] per frame of growth: 0.1 m/s at 0.55 mm per pixel, 30 frames/s

# Largest standard deviations of a pose: with more, too little of a marker is visible.
VAGUE_POSITION: Final = 0.25e-3  # [m] at 0.55 mm per pixel; scaled with the pixel
VAGUE_ANGLE: Final = 0.004  # [rad]
USUAL_PIXEL: Final = 0.55e-3  # [m]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PartObservation:
    """Measurement of one part in one frame."""

    # (3,) Pose [m, m, rad]; None where it is unknown, with the cause in `reason`.
    pose: FloatArray | None = None
    # Root mean square distance of the markers from their places by the pose [px].
    residual: float = 0.0
    scale: float = 0.0  # size of a pixel at the part [m]
    # (3,) Standard deviations of the pose from the residual [m, m, rad].
    sd: FloatArray = field(default_factory=lambda: np.zeros(3))
    marks: int = 0  # number of markers, or of edges of an outline, used
    share: float = 0.0  # share of the expected edges that was used [-]
    reason: str = ""


class AbstractFollower(ABC):
    """Abstract follower of the parts in one film, called with its frames in order."""

    @abstractmethod
    def see(self, frame: Frame) -> dict[str, PartObservation]:
        """Measure the parts in the next frame; return sightings by name."""


class AbstractTracking(ABC):
    """Abstract method to find parts in pictures.

    Subclasses use the rig and the outlines of the scene, and return poses in the plane, with a
    reason where there is none.
    """

    name: ClassVar[str]
    needs: ClassVar[str]  # requirement on a part, for messages

    @abstractmethod
    def parts(self, rig: Rig, things: Mapping[str, Thing]) -> tuple[str, ...]:
        """Names of the parts that this method can follow."""

    @abstractmethod
    def follow(self, rig: Rig, things: Mapping[str, Thing]) -> AbstractFollower:
        """Create a follower for a film of a rig with at least one suitable part.

        `things` are bodies and pushers of the scene, with outlines and approximate start poses.
        """


class PartPrediction:
    """Prediction of the pose of a part from its last sightings.

    Time stamps of arrival may be uneven where the frames are not, so that the motion is also
    predicted by number of frames: call `follow` or `at` once per frame.
    """

    def __init__(self) -> None:
        self._last: tuple[float, FloatArray] | None = None
        self._rate = np.zeros(3)  # per second
        self._step = np.zeros(3)  # per frame
        self._unseen = 0  # frames since the last sighting

    @property
    def pose(self) -> FloatArray | None:
        """Last pose (3,) seen; None before the first."""
        return None if self._last is None else self._last[1]

    def at(self, time: float) -> FloatArray | None:
        """Predict the pose (3,) at a time [s] from the time stamps; call once per frame."""
        self._unseen += 1
        if self._last is None:
            return None
        then, pose = self._last
        return pose + self._rate * min(time - then, FORGET)

    def follow(
        self, time: float, measure: Callable[[FloatArray], PartObservation]
    ) -> PartObservation | None:
        """Measure a part near its predicted pose; None before its first sighting.

        Call it once per frame. `measure` is called near a pose (3,), and again with the pose
        predicted by number of frames if it finds nothing and that is another one.
        """
        expected = self.at(time)
        if expected is None:
            return None
        sight = measure(expected)
        counted = None if sight.pose is not None else self.by_count(expected)
        return sight if counted is None else measure(counted)

    def by_count(self, expected: FloatArray) -> FloatArray | None:
        """Predict the pose (3,) from the number of frames; None if it is close to `expected`."""
        if self._last is None or self._unseen > COUNTED:
            return None
        moved = self._step * self._unseen
        pose = self._last[1] + moved
        alike = (np.abs(pose - expected) <= SAME_PREDICTION * np.abs(moved)).all()
        return None if alike else pose

    def fresh(self, time: float) -> bool:
        """Whether the part was seen so recently that predictions are valid."""
        return self._last is not None and (time - self._last[0] < FORGET or self._unseen <= COUNTED)

    def seen(self, time: float, pose: FloatArray) -> None:
        """Store a sighting."""
        self._rate, self._step = np.zeros(3), np.zeros(3)
        if self._last is not None and self.fresh(time):
            then, before = self._last
            step = pose_difference(pose, before)  # angles read from a tag are modulo 2 pi
            self._step = step / max(self._unseen, 1)
            if time - then < FORGET:
                self._rate = step / (time - then)
        self._last = (time, pose)
        self._unseen = 0


class PartFollower(ABC):
    """Abstract follower of one part with markers: at its predicted pose, else by a search."""

    def __init__(self) -> None:
        self._prediction = PartPrediction()
        self._lost = 0  # frames since it was seen
        self._why_not = ""

    def see(self, frame: Frame) -> PartObservation:
        """Measure the part in the next frame."""
        sight = self._prediction.follow(frame.time, lambda pose: self._measured(frame, pose))
        sight = sight or PartObservation(reason=self._why_not)
        if sight.pose is None and (self._lost < 3 or self._lost % SEARCH_EVERY == 0):
            sight = self._searched(frame, sight)
            self._why_not = sight.reason
        if sight.pose is None:
            self._lost += 1
        else:
            self._lost = 0
            self._prediction.seen(frame.time, sight.pose)
        return sight

    @abstractmethod
    def _measured(self, frame: Frame, pose: FloatArray) -> PartObservation:
        """Measure the part near a pose (3,) [m, m, rad]."""

    @abstractmethod
    def _searched(self, frame: Frame, followed: PartObservation) -> PartObservation:
        """Search for a part that was not seen at its predicted pose; `followed` has the reason."""

    @property
    def _search_near(self) -> FloatArray | None:
        """Last pose (3,) to search near; None to search the whole picture."""
        last = self._prediction.pose
        return None if self._lost and self._lost % SEARCH_ALL == 0 else last

    @property
    def _search_margin(self) -> int:
        """Largest distance of the part from its last place [px]; it may move while covered."""
        return MARGIN + SPREADS * self._lost


class PartFollowers(AbstractFollower):
    """Follower of several parts, each by itself."""

    def __init__(self, parts: Mapping[str, PartFollower]) -> None:
        self._parts = parts

    def see(self, frame: Frame) -> dict[str, PartObservation]:
        """Measure the parts in the next frame."""
        return {name: part.see(frame) for name, part in self._parts.items()}


def vague(sd: FloatArray, scale: float) -> bool:
    """Whether the standard deviations of a pose are too large to accept it."""
    most = VAGUE_POSITION * scale / USUAL_PIXEL
    return bool(np.hypot(sd[0], sd[1]) > most or sd[2] > VAGUE_ANGLE)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PartTrack(Comparable):
    """Measured poses of one part, frame by frame."""

    name: str
    time: FloatArray  # (n,) times of all frames [s]
    pose: FloatArray  # (n, 3) poses [m, m, rad], with continuous angles; NaN where it was not seen
    seen: BoolArray  # (n,) whether there is a pose
    good: BoolArray  # (n,) whether the pose is seen and no outlier
    # (n,) Root mean square distance of markers from their places by the pose [px]; NaN where not
    # seen.
    residual: FloatArray
    residual_m: FloatArray  # (n,) the same on the plane [m]
    # (n, 3) Standard deviations of the poses from that residual [m, m, rad]; independent from frame
    # to frame.
    sd: FloatArray
    marks: NDArray[np.int64]  # (n,) number of markers used
    share: FloatArray  # (n,) share of the expected edges that was used [-]
    reason: tuple[str, ...]  # why there is no good pose; empty where there is
    # (n, 3) Standard deviations due to errors of the camera [m, m, rad], much the same in all
    # frames; None where these are unknown.
    camera_sd: FloatArray | None = None

    @property
    def total_sd(self) -> FloatArray:
        """Standard deviations (n, 3) by markers and, where known, camera [m, m, rad]."""
        return self.sd if self.camera_sd is None else np.hypot(self.sd, self.camera_sd)

    @property
    def trajectory(self) -> Trajectory:
        """Trajectory of the good poses; `InvalidInput` if there are none."""
        if not self.good.any():
            expected = "a part that is visible in the film"
            raise InvalidInput(self.name, found="no pose in any frame", expected=expected)
        return Trajectory(time=self.time[self.good], pose=self.pose[self.good])

    @property
    def gaps(self) -> tuple[tuple[float, float, str], ...]:
        """First and last time without a good pose [s] and the reason, for each gap."""
        bad = np.flatnonzero(~self.good)
        runs = np.split(bad, np.flatnonzero(np.diff(bad) > 1) + 1) if len(bad) else []
        found = []
        for run in runs:
            reason, _ = Counter(self.reason[k] for k in run).most_common(1)[0]
            found.append((float(self.time[run[0]]), float(self.time[run[-1]]), reason))
        return tuple(found)

    @property
    def n_outliers(self) -> int:
        """Number of poses that were seen and rejected."""
        return int((self.seen & ~self.good).sum())


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FoundFixel(Comparable):
    """Measured place of a fixel."""

    name: str
    place: FloatArray  # (2,) median over the frames in which it was measured [m]
    scatter: float  # root mean square distance of single frames from the median [m]
    n: int  # number of these frames

    def __post_init__(self) -> None:
        settle(self, place=frozen(self.place))


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilmTracks(Comparable):
    """Tracks of all parts in one film."""

    method: str
    rig: Rig  # rig with the place of the camera in the film, see `--register`
    time: FloatArray  # (n,) times of all frames [s]
    parts: dict[str, PartTrack]
    fixels: tuple[FoundFixel, ...] = ()  # fixels that could be measured
    remarks: tuple[str, ...] = field(default=())  # remarks on the quality of the tracks


SMOOTH: Final = 0.25  # [s] to either side from which a speed is computed
STEADY: Final = 0.05  # of the cruising speed, largest deviation of a steady one
MOVING: Final = 0.3  # of the largest speed; below it, the actuator stands
MIN_TRAVEL: Final = 8.0  # standard deviations of a position; below it, nothing moved


class ActuatorMotion(NamedTuple):
    """Motion of the actuator."""

    speed: FloatArray  # (n,) smoothed speed along the direction [m/s]
    cruise: float  # median speed while it moved [m/s]; 0 where it did not
    direction: FloatArray  # (2,) direction of the whole travel [-]
    travel: float  # distance from the first place to the farthest [m]
    start: float  # first time after the unsteady start [s]
    end: float  # last time before the final braking [s]
    moved: bool
    # Interval in which it moved back between two pushes [s]; None for a single push.
    back: tuple[float, float] | None = None


def motion_of(time: FloatArray, place: FloatArray, noise: float) -> ActuatorMotion:
    """Compute the speed along a path (n, 2) [m] with a standard deviation, and its steady part.

    As in the laboratory, useful data begin once the speed is within 5 % of its median, and end when
    it leaves this range for the last time. Speeds are slopes of lines fitted over half a second,
    without the lag of the Kalman filter used there.
    """
    away = np.hypot(*(place - place[0]).T)
    farthest = int(np.argmax(away))  # its end, unless it returns before the film ends
    way, travel = place[farthest] - place[0], float(away[farthest])
    still = ActuatorMotion(np.zeros(len(time)), 0.0, np.zeros(2), travel, time[0], time[-1], False)
    if len(time) < 8 or travel < MIN_TRAVEL * noise:
        return still
    direction = way / travel
    along = place @ direction
    speed, spread = _slopes(time, along, noise)
    moving = speed > MOVING * speed.max()
    cruise = float(np.median(speed[moving]))
    slack = np.maximum(STEADY * cruise, 3.0 * spread)
    # Lines fitted across a start or a stop have wrong slopes, up to half their width from there.
    steady = np.flatnonzero(moving & (np.abs(speed - cruise) <= slack))
    if not len(steady):
        return still
    first, last = steady[0], steady[-1]
    back = first + np.flatnonzero(speed[first:last] < -MOVING * cruise)
    between = (float(time[back[0]]), float(time[back[-1]])) if len(back) else None
    return ActuatorMotion(
        speed, cruise, direction, travel, float(time[first]), float(time[last]), True, between
    )


def _slopes(time: FloatArray, along: FloatArray, noise: float) -> tuple[FloatArray, FloatArray]:
    """Slopes of lines fitted around each instant, and their standard deviations."""
    first = np.searchsorted(time, time - SMOOTH)
    last = np.searchsorted(time, time + SMOOTH, side="right")
    t = time - time.mean()
    x = along - along.mean()
    sums = [np.concatenate(([0.0], np.cumsum(v))) for v in (np.ones_like(t), t, x, t * t, t * x)]
    n, st, sx, stt, stx = (total[last] - total[first] for total in sums)
    spread = np.maximum(stt - st * st / n, 1e-12)
    return (stx - st * sx / n) / spread, noise / np.sqrt(spread)
