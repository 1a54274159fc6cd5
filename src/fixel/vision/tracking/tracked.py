"""Results of tracking a film, and the motion of the actuator in it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from fixel.errors import InvalidInput
from fixel.model import Trajectory
from fixel.model.fields import Comparable, frozen, settle
from fixel.typing import BoolArray, FloatArray
from fixel.vision.marks import Rig


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
        """Trajectory of the good poses.

        Raises
        ------
        InvalidInput
            There are no good poses.
        """
        if not self.good.any():
            raise InvalidInput(
                self.name,
                found="no pose in any frame",
                expected="a part that is visible in the film",
            )
        return Trajectory(time=self.time[self.good], pose=self.pose[self.good])

    @property
    def gaps(self) -> tuple[tuple[float, float, str], ...]:
        """First and last time without a good pose [s] and the reason, for each gap."""
        bad = np.flatnonzero(~self.good)
        runs = np.split(bad, np.flatnonzero(np.diff(bad) > 1) + 1) if len(bad) else []
        return tuple(
            (float(self.time[run[0]]), float(self.time[run[-1]]), _commonest(self.reason, run))
            for run in runs
        )

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


def _commonest(reasons: tuple[str, ...], run: NDArray[np.int64]) -> str:
    own = [reasons[k] for k in run]
    return str(max(dict.fromkeys(own), key=own.count))


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
    """Compute the speed along a path and its steady part.

    Parameters
    ----------
    time : (n,) float64
        Times of the places [s].
    place : (n, 2) float64
        Measured places [m].
    noise : float
        Standard deviation of a place [m].

    Notes
    -----
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
