"""The actuator's path: how fast, and which part of it is worth comparing."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from fixel.typing import FloatArray

SMOOTH: Final = 0.25  # [s] to either side, that a speed is told from
STEADY: Final = 0.05  # of the cruising speed, that a steady one may differ by
MOVING: Final = 0.3  # of the largest speed: below, it stands
MIN_TRAVEL: Final = 8.0  # standard deviations of a position, below which nothing moved


class ActuatorMotion(NamedTuple):
    """How the actuator moved.

    Attributes
    ----------
    speed : (n,) float64
        Smoothed, along its direction [m/s].
    cruise : float
        Median while it moved [m/s]; 0 where it did not.
    direction : (2,) float64
        Of the whole travel [-].
    travel : float
        From the first place to the farthest [m].
    start, end : float
        First instant after the start's unsteadiness, last before the final braking [s].
    moved : bool
    back : (float, float) or None
        When it went back between two pushes, if there is more than one [s].
    """

    speed: FloatArray
    cruise: float
    direction: FloatArray
    travel: float
    start: float
    end: float
    moved: bool
    back: tuple[float, float] | None = None


def motion_of(time: FloatArray, place: FloatArray, noise: float) -> ActuatorMotion:
    """Speed of a path and its steady part.

    Parameters
    ----------
    time : (n,) float64
        [s].
    place : (n, 2) float64
        [m].
    noise : float
        Standard deviation of a place [m].

    Notes
    -----
    As in the laboratory: useful data begin once the speed has come within 5 % of its median, and
    end before it leaves it for good. Speeds are slopes of lines fitted over half a second, without
    the lag of the Kalman filter that was used there.
    """
    away = np.hypot(*(place - place[0]).T)
    farthest = int(np.argmax(away))  # where it ends, unless it goes home before the film ends
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
    # A line fitted across a start or a stop tilts: half its width in from there, it no longer does.
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
