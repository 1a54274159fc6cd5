"""Units judged by the motion they give: degrees headed as radians, millimetres headed as metres."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.model import Trajectory
from fixel.typing import FloatArray

WORDS: Final = {"deg": "degrees", "rad": "radians"}

FASTEST_TURN: Final = 6.0  # [rad/s], a turn a second; pushed parts turn at up to about 2
WINDOW: Final = 0.1  # [s] over which a rate is taken: noise of an angle is no turning
FASTEST: Final = 5.0  # [m/s]
WIDEST: Final = 5.0  # [m] that a part moves on a plate
GLANCES: Final = 60  # instants that a motion is judged at: more of them would add up noise
# A tip that pushes stays where it touches: how far it moves in the object's frame, under one unit
# of the angles and under the other, tells them apart where one is this many times the other.
FEWER_TIMES: Final = 8.0
MIN_SLIP: Final = 0.1  # of the distance from the object to the tip; less is noise
MIN_TURN: Final = 0.05  # [rad] under either unit; less tells nothing


def refuse_implausible(
    track: Trajectory, tip: Trajectory | None, source: str, where: str, unit: str | None
) -> None:
    """Refuse positions and angles whose unit cannot be what the header says.

    Parameters
    ----------
    track : Trajectory
        Of the object, under the units of the header; angles as they stand, not unwrapped.
    tip : Trajectory, optional
        Of the pusher.
    source, where : str
        Table, and its column of angles, for the complaint.
    unit : str, optional
        `rad` or `deg`; None for a table without angles.

    Raises
    ------
    InvalidInput
        An object that moves wider or faster than any on a plate, or that turns faster than any, or
        a tip that would slide along it by far less under the other unit.
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
    """Options that settle the unit of the angles, either way."""
    return (
        f"if the column is in {WORDS[other]}: --option angle_unit={other};"
        f" if it is in {WORDS[unit]}: --option angle_unit={unit}"
    )


def _refuse_lengths(track: Trajectory, source: str) -> None:
    width = float(np.ptp(track.pose[:, :2], axis=0).max())
    step = np.diff(track.time)
    pace = np.hypot(*np.diff(track.pose[:, :2], axis=0).T) / step if len(step) else np.zeros(1)
    speed = float(np.quantile(pace, 0.75))
    if width > WIDEST or speed > FASTEST:
        found = f"{width:.3g} m" if width > WIDEST else f"{speed:.3g} m/s"
        raise InvalidInput(
            f"{source}, positions of the object",
            found=f"a motion of {found}",
            expected=f"at most {WIDEST:g} m and {FASTEST:g} m/s on a plate",
            hint="are positions in the unit that the header says? x_mm is in millimetres",
        )


def _turning(track: Trajectory) -> float:
    """Rate at which the object turns while it turns [rad/s]; jumps by a turn are none."""
    # The first frame of each window.
    _, rows = np.unique(np.floor(track.time / WINDOW), return_index=True)
    step, turn = np.diff(track.time[rows]), np.diff(track.pose[rows, 2])
    turn = np.where(np.abs(np.abs(turn) - 2.0 * math.pi) < 0.5, 0.0, turn)
    rates = np.abs(turn) / step
    moving = rates[np.abs(turn) > 1e-3 * np.abs(turn).max(initial=1e-12)]
    return float(np.quantile(moving, 0.75)) if len(moving) else 0.0


def rescaled(track: Trajectory, factor: float) -> Trajectory:
    """The same with its angles multiplied, then unwrapped."""
    pose = track.pose.copy()
    pose[:, 2] = np.unwrap(pose[:, 2] * factor)
    return Trajectory(time=track.time, pose=pose)


def _slip(track: Trajectory, tip: Trajectory, glance: FloatArray) -> float:
    """Way of the tip in the object's frame while the object moves [m]."""
    pose = track.at(glance)
    dx, dy = (tip.at(glance) - pose)[:, :2].T
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    local = np.column_stack((c * dx + s * dy, c * dy - s * dx))
    strides = np.hypot(*np.diff(local, axis=0).T)
    moved = np.hypot(*np.diff(pose[:, :2], axis=0).T)
    return float(strides[moved > 0.1 * moved.max(initial=1e-12)].sum())
