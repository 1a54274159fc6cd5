"""Trajectories: poses against time, measured or simulated."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.model.fields import Comparable, floats, frozen, numbers, settle, table
from fixel.typing import FloatArray


class Pose(NamedTuple):
    """Position and angle of a body, or of one body in many runs.

    Parameters
    ----------
    x, y : float, or (n,) float64
        Position of the frame of the body in the world [m].
    theta : float, or (n,) float64
        Angle of the frame [rad].

    Examples
    --------
    >>> x, y, theta = Pose(0.1, 0.0, 0.5)
    >>> theta
    0.5
    """

    x: Any
    y: Any
    theta: Any


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Trajectory(Comparable):
    """Pose of one body against time.

    Parameters
    ----------
    time : (n,) array_like
        Increasing times [s].
    pose : (n, 3) array_like
        Poses in the world [m, m, rad]; angles may wrap.

    Examples
    --------
    >>> track = Trajectory(time=[0.0, 1.0], pose=[(0.0, 0.0, 0.0), (0.1, 0.0, 0.5)])
    >>> track.final.theta
    0.5
    >>> track.at(0.5)
    array([0.05, 0.  , 0.25])
    """

    time: FloatArray
    pose: FloatArray

    if TYPE_CHECKING:  # what may be given; the fields are what is kept

        def __init__(self, *, time: ArrayLike, pose: ArrayLike) -> None: ...

    def __post_init__(self) -> None:
        pose = table(self.pose, "trajectory.pose", "x [m], y [m], angle [rad]")
        expected = f"one time for each of the {len(pose)} poses"
        time = floats(self.time, "trajectory.time", expected)
        if time.shape != (len(pose),):
            found = f"an array of shape {time.shape}"
            raise InvalidInput("trajectory.time", found=found, expected=expected)
        if not (np.isfinite(time).all() and (np.diff(time) > 0.0).all()):
            found, expected = "times that do not increase", "finite, increasing times [s]"
            raise InvalidInput("trajectory.time", found=found, expected=expected)
        settle(self, time=frozen(time), pose=pose)

    @property
    def x(self) -> FloatArray:
        """Position x (n,) [m]."""
        return self.pose[:, 0]

    @property
    def y(self) -> FloatArray:
        """Position y (n,) [m]."""
        return self.pose[:, 1]

    @property
    def theta(self) -> FloatArray:
        """Angle (n,) [rad]."""
        return self.pose[:, 2]

    @property
    def final(self) -> Pose:
        """Last pose."""
        return Pose(*self.pose[-1].tolist())

    def at(self, time: ArrayLike) -> FloatArray:
        """Interpolate poses (..., 3) at times (...) [s], angles the short way; constant at ends."""
        x, y, angle = self.pose.T
        instants = numbers(time, "time")
        columns = (x, y, np.unwrap(angle))
        return np.stack([np.interp(instants, self.time, column) for column in columns], axis=-1)

    def resampled(self, time: ArrayLike) -> Trajectory:
        """Return the trajectory at other times (n,) [s]."""
        return Trajectory(time=time, pose=self.at(time))

    def position_rms(self, other: Trajectory) -> float:
        """Root mean square distance to another trajectory, at the times of this one [m]."""
        position, _ = pose_error(self.pose, other.at(self.time))
        return float(np.sqrt(np.mean(position**2)))


def path_columns(trajectory: Trajectory) -> dict[str, Any]:
    """Columns of tables of experiments that follow from the trajectory."""
    time, ends = trajectory.time, trajectory.pose[[0, -1]].tolist()
    labels = ("x_m", "y_m", "theta_rad")
    return {
        "n_frame": len(time),
        "duration_s": float(time[-1] - time[0]),
        **{f"start_{label}": x for label, x in zip(labels, ends[0], strict=True)},
        **{f"end_{label}": x for label, x in zip(labels, ends[1], strict=True)},
    }


def pose_error(a: ArrayLike, b: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Compute distances (...) [m] and angles (...) from b to a, in [-pi, pi), of poses (..., 3)."""
    difference = pose_difference(a, b)
    return np.hypot(difference[..., 0], difference[..., 1]), difference[..., 2]


def pose_difference(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """Return differences (..., 3) from b to a of poses, with angles in [-pi, pi) [m, m, rad]."""
    difference = np.asarray(np.asarray(a, dtype=np.float64) - np.asarray(b, dtype=np.float64))
    difference[..., 2] = wrapped(difference[..., 2])
    return difference


def turned(start: float, end: float, frames: int) -> float:
    """Return the angle by which a body turned from the first to the last of some frames [rad].

    For two frames this is the angle in [-pi, pi). Longer trajectories are stored with continuous
    angles.
    """
    return end - start if frames > 2 else float(wrapped(end - start))


def wrapped(angle: ArrayLike) -> FloatArray:
    """Wrap angles into [-pi, pi) [rad]; those already there do not change by a bit."""
    given = np.asarray(angle, dtype=np.float64)
    inside = (given >= -pi) & (given < pi)
    if inside.all():
        return given.copy()
    turned = np.mod(given + pi, 2.0 * pi) - pi
    return np.where(inside, given, np.where(turned >= pi, -pi, turned))
