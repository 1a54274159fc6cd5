"""Status reports, settings and move commands of GRBL controllers, versions 0.9 and 1.1."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple, final

from fixel.errors import InvalidInput

BAUD: Final = 115200
BUFFER: Final = 127  # bytes that may be under way; the controller's buffer has 128
STATUS, HOLD, RESUME, RESET = b"?", b"!", b"~", b"\x18"
AXES: Final = "XYZ"
INCH: Final = 25.4  # [mm]

ALARMS: Final[Mapping[int, str]] = {
    1: "a limit switch was hit; the position is lost",
    2: "the move would have left its travel",
    3: "it was reset while moving; the position is lost",
    4: "the probe was not ready",
    5: "the probe touched nothing",
    6: "it was reset while homing",
    7: "its door opened while homing",
    8: "homing could not leave the limit switch",
    9: "homing found no limit switch",
}
ERRORS: Final[Mapping[int, str]] = {
    1: "a line without a letter",
    2: "a number it cannot read",
    3: "a $ command it does not know",
    5: "homing is not enabled ($22=1)",
    8: "a $ command while moving",
    9: "locked until homed or unlocked",
    15: "a position beyond its travel",
    20: "a command it does not know",
    22: "no feed rate",
    33: "a position it cannot reach",
}

_STATUS = re.compile(r"<([A-Za-z]+)(?::(\d+))?[|,](.*)>")
_FIELD = re.compile(r"(MPos|WPos|WCO):([-\d.,]+)")


class GrblStatus(NamedTuple):
    """Status report of a controller.

    Attributes
    ----------
    state : str
        `Idle`, `Run`, `Hold`, `Alarm`, ...
    part : int, optional
        `Hold:0` has come to rest, `Hold:1` not yet; missing in version 0.9.
    machine, work, offset : tuple of float, optional
        Coordinates as reported; which are present depends on the controller's settings.
    """

    state: str
    part: int | None
    machine: tuple[float, ...] | None
    work: tuple[float, ...] | None
    offset: tuple[float, ...] | None

    @property
    def placed(self) -> bool:
        """Whether the report contains the position of the drive."""
        return self.machine is not None or self.work is not None


def status_of(line: str) -> GrblStatus | None:
    """Parse the status report in a line; None if there is none, or it is damaged."""
    found = _STATUS.fullmatch(line)
    if found is None:
        return None
    values: dict[str, tuple[float, ...]] = {}
    try:
        for name, numbers in _FIELD.findall(found[3]):
            values[name] = tuple(float(number) for number in numbers.split(",") if number)
    except ValueError:
        return None
    if any(len(place) < len(AXES) for place in values.values()):
        return None
    part = int(found[2]) if found[2] else None
    return GrblStatus(found[1], part, values.get("MPos"), values.get("WPos"), values.get("WCO"))


def number_after(line: str, word: str) -> int | None:
    """Return the number after `word`, as in `error:9`; 0 without a number, None for other lines."""
    if not line.startswith(word):
        return None
    digits = line[len(word) :].strip()
    return int(digits) if digits.isdigit() else 0


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class AxisSettings:
    """Settings of one axis of the controller, in millimetres and seconds.

    Attributes
    ----------
    fastest : float
        Largest speed [mm/s].
    acceleration : float
        Acceleration [mm/s^2].
    travel : float
        Length of the travel [mm].
    homing : bool
        Whether it has end switches and must be homed.
    soft_limits : bool
        Whether it refuses to leave its travel.
    inches : bool
        Whether it reports inches.
    zero : float
        Machine coordinate of position 0 [mm].
    direction : int
        Sign of the machine coordinate as the drive extends.
    """

    fastest: float
    acceleration: float
    travel: float
    homing: bool
    soft_limits: bool
    inches: bool
    zero: float
    direction: int

    def coordinate(self, position: float) -> float:
        """Convert a position [m] to a machine coordinate [mm]."""
        return self.zero + self.direction * 1e3 * position

    def position(self, coordinate: float) -> float:
        """Convert a machine coordinate [mm] to a position [m]."""
        return self.direction * (coordinate - self.zero) * 1e-3


def settings_of(lines: list[str], axis: str) -> AxisSettings:
    """Parse the answers to `$$` and `$I`.

    With homing, machine coordinates range from `-travel` to 0 (unless the controller was built to
    count from the switch), and the switch is assumed at the withdrawn end. Without homing, they
    count from the place of the drive when the controller was switched on.
    """
    values: dict[int, float] = {}
    for line in lines:
        found = re.match(r"\$(\d+)\s*=\s*([-\d.]+)", line)
        if found:
            values[int(found[1])] = float(found[2])
    number = AXES.index(axis)
    missing = [n for n in (110 + number, 120 + number, 130 + number) if n not in values]
    if missing:
        raise InvalidInput(
            "the controller", found=f"no setting ${missing[0]}", expected="GRBL 0.9 or later"
        )
    travel = abs(values[130 + number])
    homing = bool(values.get(22, 0))
    at_low_end = bool(int(values.get(23, 0)) >> number & 1)
    options = next((line for line in lines if line.startswith("[OPT:")), "")
    counts_from_switch = "Z" in options.split(",")[0]
    zero = -travel if homing and at_low_end and not counts_from_switch else 0.0
    direction = -1 if homing and not at_low_end else 1
    return AxisSettings(
        fastest=values[110 + number] / 60.0,
        acceleration=values[120 + number],
        travel=travel,
        homing=homing,
        soft_limits=bool(values.get(20, 0)),
        inches=bool(values.get(13, 0)),
        zero=zero,
        direction=direction,
    )


def move_line(axis: str, coordinate: float, speed: float) -> str:
    """Return the line for a move to a machine coordinate [mm] at a speed [mm/s], in any mode."""
    return f"G21G90G94G53G1{axis}{coordinate:.3f}F{60.0 * speed:.2f}"
