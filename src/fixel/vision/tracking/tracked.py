"""Results of tracking a film."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import final

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
