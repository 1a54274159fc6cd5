"""Speed of the actuator along its path, and the steady part of its motion."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from fixel.typing import FloatArray

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
