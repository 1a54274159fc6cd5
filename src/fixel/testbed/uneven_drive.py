"""A drive that runs unevenly."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fixel.model import LineDrive, PathDrive, Pusher
from fixel.typing import FloatArray

WAYPOINT_INTERVAL = 1.0 / 60.0  # [s]; a ripple of some hertz is a smooth curve in this


def driven_unevenly(
    pusher: Pusher,
    duration: float,
    *,
    speed_ratio: float,
    ripple: float,
    frequency: float,
    phase: float,
) -> Pusher:
    """The pusher on the planned path, but early here and late there.

    Parameters
    ----------
    pusher : Pusher
        As planned.
    duration : float
        For how long waypoints are needed [s].
    speed_ratio : float
        Mean speed over the planned speed [-].
    ripple : float
        Amplitude of the speed about its mean, as a share of it [-].
    frequency : float
        Of the ripple [Hz].
    phase : float
        Of the ripple at the start [rad].
    """
    if speed_ratio == 1.0 and ripple == 0.0:
        return pusher
    time = np.arange(math.ceil(duration / WAYPOINT_INTERVAL) + 1.0) * WAYPOINT_INTERVAL
    poses = _planned_poses(pusher, speed_ratio * uneven_time(time, ripple, frequency, phase))
    drive = PathDrive(
        waypoints=np.column_stack((time, poses)), force_limit=pusher.drive.force_limit
    )
    return replace(pusher, drive=drive)


def uneven_time(time: FloatArray, ripple: float, frequency: float, phase: float) -> FloatArray:
    """When the drive, were it even, would be where it is at these instants [s]."""
    turn = 2.0 * math.pi * frequency
    return np.asarray(time + ripple / turn * (np.sin(turn * time + phase) - math.sin(phase)))


def _planned_poses(pusher: Pusher, time: FloatArray) -> FloatArray:
    """(n, 3) poses the planned drive asks for at instants (n,) [s]."""
    drive = pusher.drive
    if isinstance(drive, PathDrive):
        instants, *columns = drive.waypoints.T
        return np.column_stack([np.interp(time, instants, column) for column in columns])
    covered = np.minimum(drive.speed * time, drive.travel)
    return np.asarray(
        pusher.pose + np.column_stack((np.outer(covered, drive.direction), 0.0 * covered))
    )


def with_stall_force(pusher: Pusher, stall_force: float | None) -> Pusher:
    """The pusher with a drive that stalls at this force [N]; None leaves it as planned."""
    if stall_force is None:
        return pusher
    drive: LineDrive | PathDrive = replace(pusher.drive, force_limit=stall_force)
    return replace(pusher, drive=drive)
