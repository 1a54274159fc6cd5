"""What tracking a film gives."""

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
    """Where one part was, frame by frame.

    Attributes
    ----------
    name : str
    time : (n,) float64
        Of all frames [s].
    pose : (n, 3) float64
        [m, m, rad], angles continuous; NaN where it was not seen.
    seen : (n,) bool
        Whether there is a pose.
    good : (n,) bool
        Whether it is to be believed: seen, and no outlier.
    residual : (n,) float64
        Root mean square distance of marks from where the pose puts them [px]; NaN where not seen.
    residual_m : (n,) float64
        The same on the plane [m].
    sd : (n, 3) float64
        Standard deviations of the poses by that residual [m, m, rad]; independent from frame to
        frame.
    camera_sd : (n, 3) float64, or None
        Standard deviations by the errors of the camera [m, m, rad], much the same in all frames;
        None where nothing is known of them.
    marks : (n,) int64
        How many took part.
    share : (n,) float64
        Of what should show of them [-].
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
        """(n, 3) standard deviations by the marks and, as far as known, the camera [m, m, rad]."""
        return self.sd if self.camera_sd is None else np.hypot(self.sd, self.camera_sd)

    @property
    def trajectory(self) -> Trajectory:
        """The good poses.

        Raises
        ------
        InvalidInput
            There are none.
        """
        if not self.good.any():
            raise InvalidInput(
                self.name, found="no pose in any frame", expected="a part that shows in the film"
            )
        return Trajectory(time=self.time[self.good], pose=self.pose[self.good])

    @property
    def gaps(self) -> tuple[tuple[float, float, str], ...]:
        """First and last instant without a good pose [s], and why, one a gap."""
        bad = np.flatnonzero(~self.good)
        runs = np.split(bad, np.flatnonzero(np.diff(bad) > 1) + 1) if len(bad) else []
        return tuple(
            (float(self.time[run[0]]), float(self.time[run[-1]]), _commonest(self.reason, run))
            for run in runs
        )

    @property
    def n_outliers(self) -> int:
        """Poses that were seen and are not believed."""
        return int((self.seen & ~self.good).sum())


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FoundFixel(Comparable):
    """A fixel as the camera saw it.

    Attributes
    ----------
    name : str
    place : (2,) float64
        Median over the frames it was measured in [m].
    scatter : float
        Root mean square distance from that, frame by frame [m].
    n : int
        Of frames.
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
    """What one film shows.

    Attributes
    ----------
    method : str
    rig : Rig
        With its camera where the film has it, see `--register`.
    time : (n,) float64
        Of all frames [s].
    parts : dict of str to PartTrack
    fixels : tuple of FoundFixel
        Those that could be measured.
    remarks : tuple of str
        What one should know before using it.
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
