"""Detection of wrong units from the motion, such as degrees labelled radians or mm labelled m."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.model import Trajectory
from fixel.typing import FloatArray

WORDS: Final = {"deg": "degrees", "rad": "radians"}

FASTEST_TURN: Final = 6.0  # [rad/s], a turn per second; pushed parts turn at up to about 2
MAX_TURN: Final = 4.0 * math.pi  # [rad] of values as in the file; more is rather in degrees
WINDOW: Final = 0.1  # [s] for rates of turning, long enough to average noise of the angle
FASTEST: Final = 5.0  # [m/s]
WIDEST: Final = 5.0  # [m] of motion of a part on a plate
FARTHEST: Final = 20.0  # [m] of positions from the origin, which may be in a corner of the room
GLANCES: Final = 60  # number of instants at which a motion is sampled; more would add up noise
# A pushing tip hardly slides along the object. The unit of angles is wrong if the tip slides this
# many times farther in the object's frame than with the other unit.
FEWER_TIMES: Final = 8.0
MIN_SLIP: Final = 0.1  # share of the distance from the object to the tip; less is noise
MIN_TURN: Final = 0.05  # [rad] with either unit; less decides nothing


def refuse_implausible(
    track: Trajectory, tip: Trajectory | None, source: str, where: str, unit: str | None
) -> None:
    """Raise `InvalidInput` for positions and angles whose unit in the header cannot be right.

    Parameters
    ----------
    track : Trajectory
        Trajectory of the object in the units of the header, with angles not unwrapped.
    tip : Trajectory, optional
        Trajectory of the pusher.
    source, where : str
        Table, and its column of angles, for the message.
    unit : str, optional
        `rad` or `deg`; None for a table without angles.

    Raises
    ------
    InvalidInput
        The object moves or turns faster, or moves farther, than is possible on a plate; radians
        make it turn more than twice; or the tip would slide along it far less with the other unit.
    """
    glance = np.linspace(track.time[0], track.time[-1], GLANCES)
    _refuse_lengths(track, source)
    if unit is None or len(track.time) < 3:
        return
    other = "deg" if unit == "rad" else "rad"
    factor = math.pi / 180.0 if unit == "rad" else 180.0 / math.pi  # from this unit to the other
    rate = _turning(track)
    if rate > FASTEST_TURN:
        step = max(WINDOW, float(np.median(np.diff(track.time))))
        _refuse(
            where,
            f"an object that turns {math.degrees(rate * step):.3g} degrees in {step:.3g} s",
            unit,
            other,
        )
    if unit == "rad" and (turn := float(np.ptp(track.pose[:, 2]))) > MAX_TURN:
        _refuse(where, f"an object that turns {math.degrees(turn):.4g} degrees", unit, other)
    if tip is None:
        return
    here, there = rescaled(track, 1.0), rescaled(track, factor)
    slip, slip_other = _slip(here, tip, glance), _slip(there, tip, glance)
    arm = float(np.median(np.hypot(*(tip.at(glance) - track.at(glance))[:, :2].T)))
    turn = max(float(np.ptp(one.pose[:, 2])) for one in (here, there))
    if turn > MIN_TURN and slip > MIN_SLIP * arm and slip > FEWER_TIMES * slip_other:
        _refuse(
            where,
            f"a pusher that moves {1e3 * slip:.3g} mm along the object, against"
            f" {1e3 * slip_other:.3g} mm with angles in {other}",
            unit,
            other,
        )


def _refuse(where: str, found: str, unit: str, other: str) -> None:
    raise InvalidInput(
        where,
        found=found,
        expected=f"the motion of a pushed object, with angles in {WORDS[unit]}",
        hint=hint_of(other, unit),
    )


def hint_of(other: str, unit: str) -> str:
    """Hint with the likely unit of angles, and the two statements that confirm the other one."""
    return (
        f"it is likely in {WORDS[other]}: set angle_unit={other} with --option, or in Python"
        f" units={{'angle': '{other}'}}; if it is in {WORDS[unit]}, end its title with _{unit} and"
        f" set angle_unit={unit}"
    )


def _refuse_lengths(track: Trajectory, source: str) -> None:
    width = float(np.ptp(track.pose[:, :2], axis=0).max())
    reach = float(np.abs(track.pose[:, :2]).max())
    step = np.diff(track.time)
    pace = np.hypot(*np.diff(track.pose[:, :2], axis=0).T) / step if len(step) else np.zeros(1)
    speed = float(np.quantile(pace, 0.75))
    if width > WIDEST or speed > FASTEST or reach > FARTHEST:
        found = f"a motion of {width:.3g} m" if width > WIDEST else f"a motion of {speed:.3g} m/s"
        if width <= WIDEST and speed <= FASTEST:
            found = f"positions up to {reach:.3g} m"
        raise InvalidInput(
            f"{source}, positions of the object",
            found=found,
            expected=f"at most {WIDEST:g} m and {FASTEST:g} m/s on a plate, within {FARTHEST:g} m",
            hint="check the unit of positions in the header: x_mm is in millimetres",
        )


def _turning(track: Trajectory) -> float:
    """Rate of turning while the object turns [rad/s]; jumps by a whole turn are ignored."""
    # The first frame of each window.
    _, rows = np.unique(np.floor(track.time / WINDOW), return_index=True)
    step, turn = np.diff(track.time[rows]), np.diff(track.pose[rows, 2])
    turn = np.where(np.abs(np.abs(turn) - 2.0 * math.pi) < 0.5, 0.0, turn)
    rates = np.abs(turn) / step
    moving = rates[np.abs(turn) > 1e-3 * np.abs(turn).max(initial=1e-12)]
    return float(np.quantile(moving, 0.75)) if len(moving) else 0.0


def rescaled(track: Trajectory, factor: float) -> Trajectory:
    """Return a trajectory with its angles multiplied by a factor, then unwrapped."""
    pose = track.pose.copy()
    pose[:, 2] = np.unwrap(pose[:, 2] * factor)
    return Trajectory(time=track.time, pose=pose)


def _slip(track: Trajectory, tip: Trajectory, glance: FloatArray) -> float:
    """Path length of the tip in the object's frame while the object moves [m]."""
    pose = track.at(glance)
    dx, dy = (tip.at(glance) - pose)[:, :2].T
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    local = np.column_stack((c * dx + s * dy, c * dy - s * dx))
    strides = np.hypot(*np.diff(local, axis=0).T)
    moved = np.hypot(*np.diff(pose[:, :2], axis=0).T)
    return float(strides[moved > 0.1 * moved.max(initial=1e-12)].sum())
