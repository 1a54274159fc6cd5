"""Pusher drive with uneven speed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fixel.model import LineDrive, PathDrive, Pusher
from fixel.typing import FloatArray

WAYPOINT_INTERVAL = 1.0 / 60.0  # [s]; resolves a ripple of a few hertz


def driven_unevenly(
    pusher: Pusher,
    duration: float,
    *,
    speed_ratio: float,
    ripple: float,
    frequency: float,
    phase: float,
) -> Pusher:
    """Return the pusher on its planned path, with uneven timing.

    Parameters
    ----------
    pusher : Pusher
        Planned pusher.
    duration : float
        Time for which waypoints are needed [s].
    speed_ratio : float
        Mean speed over the planned speed [-].
    ripple : float
        Amplitude of the speed about its mean, as a share of it [-].
    frequency : float
        Frequency of the ripple [Hz].
    phase : float
        Phase of the ripple at the start [rad].
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
    """Times at which an even drive reaches the positions of the uneven one at `time` [s]."""
    turn = 2.0 * math.pi * frequency
    return np.asarray(time + ripple / turn * (np.sin(turn * time + phase) - math.sin(phase)))


def _planned_poses(pusher: Pusher, time: FloatArray) -> FloatArray:
    """Poses (n, 3) of the planned drive at times (n,) [s]."""
    drive = pusher.drive
    if isinstance(drive, PathDrive):
        instants, *columns = drive.waypoints.T
        return np.column_stack([np.interp(time, instants, column) for column in columns])
    covered = np.minimum(drive.speed * time, drive.travel)
    return np.asarray(
        pusher.pose + np.column_stack((np.outer(covered, drive.direction), 0.0 * covered))
    )


def with_stall_force(pusher: Pusher, stall_force: float | None) -> Pusher:
    """Return the pusher with a drive that stalls at a force [N]; None leaves it as planned."""
    if stall_force is None:
        return pusher
    drive: LineDrive | PathDrive = replace(pusher.drive, force_limit=stall_force)
    return replace(pusher, drive=drive)
