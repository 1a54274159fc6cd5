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
    """Measured poses of one part, frame by frame.

    Attributes
    ----------
    name : str
    time : (n,) float64
        Times of all frames [s].
    pose : (n, 3) float64
        Poses [m, m, rad], with continuous angles; NaN where it was not seen.
    seen : (n,) bool
        Whether there is a pose.
    good : (n,) bool
        Whether the pose is seen and no outlier.
    residual : (n,) float64
        Root mean square distance of markers from their places by the pose [px]; NaN where not seen.
    residual_m : (n,) float64
        The same on the plane [m].
    sd : (n, 3) float64
        Standard deviations of the poses from that residual [m, m, rad]; independent from frame to
        frame.
    camera_sd : (n, 3) float64, or None
        Standard deviations due to errors of the camera [m, m, rad], much the same in all frames;
        None where these are unknown.
    marks : (n,) int64
        Number of markers used.
    share : (n,) float64
        Share of the expected edges that was used [-].
    reason : tuple of str
        Why there is no good pose; empty where there is.
    """

    name: str
    time: FloatArray
    pose: FloatArray
    seen: BoolArray
    good: BoolArray
    residual: FloatArray
    residual_m: FloatArray
    sd: FloatArray
    marks: NDArray[np.int64]
    share: FloatArray
    reason: tuple[str, ...]
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
    """Measured place of a fixel.

    Attributes
    ----------
    name : str
    place : (2,) float64
        Median over the frames in which it was measured [m].
    scatter : float
        Root mean square distance of single frames from the median [m].
    n : int
        Number of these frames.
    """

    name: str
    place: FloatArray
    scatter: float
    n: int

    def __post_init__(self) -> None:
        settle(self, place=frozen(self.place))


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilmTracks(Comparable):
    """Tracks of all parts in one film.

    Attributes
    ----------
    method : str
    rig : Rig
        Rig with the place of the camera in the film, see `--register`.
    time : (n,) float64
        Times of all frames [s].
    parts : dict of str to PartTrack
    fixels : tuple of FoundFixel
        Fixels that could be measured.
    remarks : tuple of str
        Remarks on the quality of the tracks.
    """

    method: str
    rig: Rig
    time: FloatArray
    parts: dict[str, PartTrack]
    fixels: tuple[FoundFixel, ...] = ()
    remarks: tuple[str, ...] = field(default=())


def _commonest(reasons: tuple[str, ...], run: NDArray[np.int64]) -> str:
    own = [reasons[k] for k in run]
    return str(max(dict.fromkeys(own), key=own.count))
