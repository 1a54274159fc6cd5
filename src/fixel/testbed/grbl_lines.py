"""Status reports, settings and move commands of GRBL 0.9 and 1.1, grblHAL and FluidNC."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Iterable, Mapping
from typing import Final, NamedTuple

from fixel.errors import InvalidInput

BAUD: Final = 115200
BUFFER: Final = 127  # bytes that may be under way; the controller's buffer has 128
STATUS, HOLD, RESET = b"?", b"!", b"\x18"
GREETINGS: Final = ("Grbl ", "GrblHAL ")  # after a reset; FluidNC begins like GRBL
AXES: Final = "XYZA"
INCH: Final = 25.4  # [mm]
SWITCHES: Final = {"true": "1", "false": "0"}  # of FluidNC
EXPECTED: Final = "a number; GRBL 0.9 or later, grblHAL or FluidNC"

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
    """Status report of a controller."""

    state: str  # `Idle`, `Run`, `Hold`, `Alarm`, ...
    part: int | None  # `Hold:0` has come to rest, `Hold:1` not yet; missing in version 0.9
    # Coordinates as reported, one for each axis of the controller; which are present depends on its
    # settings.
    machine: tuple[float, ...] | None
    work: tuple[float, ...] | None
    offset: tuple[float, ...] | None

    @property
    def n_axis(self) -> int:
        """Number of axes whose position the report contains."""
        return len(self.machine or self.work or ())


def status_of(line: str) -> GrblStatus | None:
    """Parse the status report in a line; None if there is none, or it is damaged."""
    found = _STATUS.fullmatch(line)
    if found is None:
        return None
    values: dict[str, tuple[float, ...]] = {}
    try:
        for name, numbers in _FIELD.findall(found[3]):
            # Version 0.9 separates fields by commas as well.
            values[name] = tuple(float(number) for number in numbers.rstrip(",").split(","))
    except ValueError:
        return None
    if len({len(place) for place in values.values()}) > 1:
        return None
    part = int(found[2]) if found[2] else None
    return GrblStatus(found[1], part, values.get("MPos"), values.get("WPos"), values.get("WCO"))


def number_after(line: str, word: str) -> int | None:
    """Return the number after `word`, as in `error:9`; 0 without a number, None for other lines."""
    if not line.startswith(word):
        return None
    digits = line[len(word) :].strip()
    return int(digits) if digits.isdigit() else 0


class AxisSettings(NamedTuple):
    """Settings of one axis of the controller, in millimetres and seconds."""

    fastest: float  # largest speed [mm/s]
    acceleration: float  # acceleration [mm/s^2]
    travel: float  # length of the travel [mm]
    homing: bool  # whether it has end switches and must be homed
    soft_limits: bool  # whether it refuses to leave its travel
    inches: bool  # whether it reports inches
    zero: float  # machine coordinate of position 0 [mm]
    direction: int  # sign of the machine coordinate as the drive extends

    def coordinate(self, position: float) -> float:
        """Convert a position [m] to a machine coordinate [mm]."""
        return self.zero + self.direction * 1e3 * position

    def position(self, coordinate: float) -> float:
        """Convert a machine coordinate [mm] to a position [m]."""
        return self.direction * (coordinate - self.zero) * 1e-3

    def from_other_end(self) -> AxisSettings:
        """Return the settings with positions that count from the other end of the travel."""
        end = self.zero + self.direction * self.travel * self.homing
        return self._replace(zero=end, direction=-self.direction)


def has_named_settings(lines: list[str]) -> bool:
    """Whether the answer to `$I` is that of FluidNC, whose axes have names instead of numbers."""
    return any("FluidNC" in line for line in lines)


def settings_of(lines: list[str], axis: str) -> AxisSettings:
    """Parse the answers to `$I` and `$$`, and to `$/axes/x` of FluidNC.

    With homing, machine coordinates range from `-travel` to 0 (unless the controller was built to
    count from the switch), and the switch is assumed at the withdrawn end. FluidNC has the
    coordinate there in its configuration. Without homing, they count from the place of the drive
    when the controller was switched on. A setting of the axis that is missing, or no number, raises
    `InvalidInput`.
    """
    values = _texts_of(lines)

    def number(*names: str, default: float | None = None) -> float:
        name = next((name for name in names if name in values), "")
        if not name and default is not None:
            return default
        with contextlib.suppress(ValueError):
            if math.isfinite(value := float(values.get(name, ""))):
                return value
        found = f"{name}={values[name]}" if name else f"no setting {names[0]}"
        raise InvalidInput("the controller", found=found, expected=EXPECTED)

    k = AXES.index(axis)
    travel = abs(number(f"${130 + k}", "max_travel_mm"))
    # A mask in grblHAL, whose first bit is homing as such.
    homing = int(number("$22", default=0.0)) & 1 == 1 or number("cycle", default=0.0) > 0.0
    passes = [int(number(f"${setting}")) for setting in range(44, 50) if f"${setting}" in values]
    homing = homing and (not passes or any(mask >> k & 1 for mask in passes))  # of grblHAL
    at_low_end = int(number("$23", default=0.0)) >> k & 1 == 1
    inches = number("$13", default=0.0) != 0.0
    if axis == "A" and (inches or int(number("$376", default=0.0)) & 1):
        raise InvalidInput("axis", found="'A' in degrees", expected="an axis in mm ($376=0, $13=0)")
    options = next((line for line in lines if line.startswith("[OPT:")), "")
    counts_from_switch = "Z" in options.split(",")[0]
    zero = -travel if homing and at_low_end and not counts_from_switch else 0.0
    if homing and "positive_direction" in values:
        at_low_end, zero = number("positive_direction") == 0.0, number("mpos_mm")
    return AxisSettings(
        fastest=number(f"${110 + k}", "max_rate_mm_per_min") / 60.0,
        acceleration=number(f"${120 + k}", "acceleration_mm_per_sec2"),
        travel=travel,
        homing=homing,
        soft_limits=number("$20", "soft_limits", default=0.0) != 0.0,
        inches=inches,
        zero=zero,
        direction=-1 if homing and not at_low_end else 1,
    )


def _texts_of(lines: list[str]) -> dict[str, str]:
    """Return settings by name as text: `$110=500.000 (x max rate)`, `max_rate_mm_per_min: 500`."""
    found = (re.match(r"(\$\d+)\s*=\s*(\S*)|(\w+):\s*(\S*)", line.strip()) for line in lines)
    pairs = [(own[1] or own[3], own[2] or own[4] or "") for own in found if own]
    # Names of the axis come before those of its motors.
    return {name: SWITCHES.get(text, text) for name, text in reversed(pairs)}


def move_line(axes: str, coordinates: Iterable[float], speed: float) -> str:
    """Return the line for a move to machine coordinates [mm] at a speed [mm/s], in any mode."""
    words = (f"{axis}{value:.3f}" for axis, value in zip(axes, coordinates, strict=True))
    return f"G21G90G94G53G1{''.join(words)}F{60.0 * speed:.2f}"
