"""Connection to controllers with GRBL 0.9 or 1.1, grblHAL or FluidNC, and the lines of both."""

from __future__ import annotations

import contextlib
import math
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Final, NamedTuple

from fixel.errors import DeviceFailed, InvalidInput
from fixel.testbed.serial_port import arrived_within, refusal, resets_on_opening

if TYPE_CHECKING:
    from serial import Serial


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


def checked_axes(axes: str, where: str = "axes") -> str:
    """Return the names of axes; raise `InvalidInput` for none, an unknown one or a repeated one."""
    if not axes or any(axes.count(one) != (one in AXES) for one in axes):
        raise InvalidInput(where, found=repr(axes), expected="some of X, Y, Z and A, such as XY")
    return axes


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


ASKING: Final = 0.04  # [s] between two status requests
TURN: Final = 0.01  # [s] longest time between two checks of the thread for lines to send
LATE: Final = 0.05  # [s] most that one turn of the thread counts as listening
SILENCE: Final = 1.0  # [s] without a status report after which the controller counts as gone
ANSWER: Final = 2.0  # [s] timeout of a command that takes no time
BOOT_TIME: Final = 3.0  # [s] in which an Arduino restarts after its port was opened
PATIENCE: Final = 0.25  # [s] between two attempts
QUESTIONS: Final = 4


class GrblLink:
    """Lines to a controller and its answers; every method may be called from any thread.

    Unanswered bytes are counted, so that the controller's buffer of 128 bytes never overflows.

    The port is that of a GRBL controller, as `greet` found. `next_line` is called repeatedly in the
    link's own thread, which holds `changed`; it returns the next line of a move, or None for no
    more at present.
    """

    def __init__(self, port: Serial, next_line: Callable[[], str | None]) -> None:
        # Notified when anything below changes; hold it to read more than one of them.
        self.changed = threading.Condition(threading.RLock())
        self.status: GrblStatus | None = None  # last report
        self.reported = time.monotonic()  # arrival of the last report, on `time.monotonic` [s]
        # How long the thread has listened [s]: `time.monotonic` without the time for which a busy
        # computer suspended it. All times to wait for the controller are counted by it.
        self.listened = self._heard = 0.0
        # Whether the last report was requested after the last line was accepted.
        self.current = False
        # Why a move cannot continue: an alarm, a reset, a refused line, a lost connection.
        self.trouble = ""
        self.lost = False  # whether the controller is no longer there
        self.resets = 0
        self.losses = 0  # alarms, and resets that this program did not request; see `zero_known`
        self.offset: tuple[float, ...] = (0.0,) * len(AXES)  # of work coordinates
        self._port = port
        self._next_line = next_line
        self._partial = b""
        self._unanswered: deque[int] = deque()  # lengths of lines
        self._answers: list[str] | None = None  # to the pending command
        self._verdict = ""
        self._asked = self._accepted = self._sent = 0.0
        self._ended = self._resetting = False
        self._thread = threading.Thread(target=self._run, name="grbl", daemon=True)
        self._thread.start()

    def at_once(self, realtime: bytes) -> None:
        """Send a byte that takes effect ahead of everything queued."""
        with contextlib.suppress(OSError):
            self._port.write(realtime)

    def command(self, line: str, patience: float = ANSWER) -> list[str]:
        """Send one line, wait until it is done, and return the lines received in between.

        If it was refused, or an alarm or no answer came, raise `DeviceFailed`.
        """
        with self.changed:
            self._answers, self._verdict, self.trouble = [], "", ""
            self._send(line)
            try:
                self._await(lambda: self._verdict or self.trouble, patience)
            finally:
                answers, self._answers = self._answers, None
            if self._verdict == "ok":
                return answers
            why = self._verdict or self.trouble or f"no answer to {line} in {patience:.3g} s"
            raise DeviceFailed(why)

    @property
    def occupied(self) -> bool:
        """Whether a command such as homing is not answered yet."""
        return self._answers is not None

    def _await(self, condition: Callable[[], object], patience: float) -> None:
        """Wait for a condition, or until the thread has listened for a time [s] or has ended."""
        until = self.listened + patience
        while not (condition() or self.lost or self._ended or self.listened >= until):
            self.changed.wait(0.05)

    def fresh_status(self, patience: float = SILENCE) -> GrblStatus:
        """Wait for a report that was requested after the call, or raise `DeviceFailed`."""
        with self.changed:
            called = time.monotonic()
            self._await(lambda: self.status is not None and self.reported >= called, patience)
            if self.status is None or self.reported < called:
                raise DeviceFailed(self.trouble or f"no status report in {patience:.3g} s")
            return self.status

    def idle(self) -> bool:
        """Whether all lines sent were accepted and carried out."""
        return (
            not self._unanswered
            and self.current
            and self.status is not None
            and self.status.state == "Idle"
        )

    def reset(self, patience: float = 1.0) -> None:
        """Clear the controller's queue by a reset, and return when it has restarted."""
        with self.changed:
            before = self.resets
            self._resetting = True
            self.at_once(RESET)
            self._await(lambda: self.resets != before, patience)
            self._resetting = False
            self._unanswered.clear()
            if not self.lost:
                self.trouble = ""

    def close(self) -> None:
        """End the thread and close the port."""
        self._ended = True
        if self._thread is not threading.current_thread():
            self._thread.join()
        self._port.close()

    # --- the thread ---------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._converse()
        except Exception as problem:  # otherwise the caller would wait for a move without end
            self._lose(problem)

    def _converse(self) -> None:
        self._port.timeout = TURN
        now = time.monotonic()
        while not self._ended and not self.lost:
            try:
                self._ask()
                arrived = self._port.read(1)
                arrived += self._port.read(self._port.in_waiting) if arrived else b""
                before, now = now, time.monotonic()
                with self.changed:
                    self.listened += min(now - before, LATE)
                    for line in self._lines(arrived):
                        self._hear(line)
                    self._miss_controller()
                    self._feed()
            except (OSError, TypeError) as problem:  # TypeError: closed while pyserial reads
                self._lose(problem)

    def _ask(self) -> None:
        now = time.monotonic()
        if now - self._asked > ASKING:
            self._asked = now
            self._port.write(STATUS)

    def _miss_controller(self) -> None:
        """Report silence, after everything that arrived was read."""
        # A command such as homing may occupy the controller, and has its own timeout; an unanswered
        # line of a move has none.
        if self.listened - self._heard > SILENCE and self._answers is None:
            self.trouble = self.trouble or f"the controller has not responded for {SILENCE:.3g} s"
            self.changed.notify_all()

    def _lines(self, arrived: bytes) -> list[str]:
        *whole, self._partial = (self._partial + arrived).split(b"\n")
        return [text for line in whole if (text := line.decode("ascii", "replace").strip())]

    def _hear(self, line: str) -> None:
        status = status_of(line)
        if status is not None:
            if self.status is not None and 0 < self.status.n_axis != status.n_axis:
                return  # damaged: it lacks the position of an axis that the previous one had
            self.offset = status.offset or self.offset
            self.current = self._asked > self._accepted
            self.status, self.reported, self._heard = status, time.monotonic(), self.listened
            self._miss_answers()
        elif line == "ok":
            self._accept("ok")
        elif (number := number_after(line, "error:")) is not None:
            why = f"the controller rejected a line: {ERRORS.get(number, f'error {number}')}"
            if self._answers is None:
                self.trouble = self.trouble or why
            self._accept(why)
        elif (number := number_after(line, "ALARM:")) is not None:
            self.losses += 1
            self.trouble = f"alarm of the controller: {ALARMS.get(number, f'{number}')}"
        elif line.startswith(GREETINGS):
            self.resets += 1
            self.losses += not self._resetting
            self._unanswered.clear()
            # `reset` clears the trouble, perhaps before a command that waits has read it.
            self._verdict = self.trouble = self.trouble or "the controller was reset"
        elif self._answers is not None:
            self._answers.append(line)
        self.changed.notify_all()

    def _miss_answers(self) -> None:
        """Report a lost answer: a controller at rest answered every line unless one was damaged."""
        owes = self._unanswered and self._answers is None
        at_rest = self.status is not None and self.status.state == "Idle"
        if owes and at_rest and self.listened - self._sent > SILENCE:
            self._unanswered.clear()
            self.trouble = self.trouble or "a reply of the controller was lost"

    def _accept(self, verdict: str) -> None:
        if self._unanswered:
            self._unanswered.popleft()
        self._accepted, self._heard = time.monotonic(), self.listened
        self.current = False
        if self._answers is not None and not self._unanswered:
            self._verdict = verdict

    def _feed(self) -> None:
        while not self.trouble and self._answers is None:
            room = BUFFER - sum(self._unanswered)
            # All our lines are shorter; `next_line` must not make one that cannot be sent.
            line = self._next_line() if room > 72 else None
            if line is None:
                return
            self._send(line)

    def _send(self, line: str) -> None:
        data = line.encode("ascii") + b"\n"
        self._unanswered.append(len(data))
        self._sent = self.listened
        self.current = False
        try:
            self._port.write(data)
        except OSError as problem:
            self._lose(problem)

    def _lose(self, problem: Exception) -> None:
        with self.changed:
            self.lost = True
            self.trouble = f"the connection to the controller was lost: {problem}"
            self.changed.notify_all()


def greet(link: Serial, port: str) -> None:
    """Check that a GRBL controller answers; raise `InvalidInput` for other devices.

    Only the status request `?` is sent: it moves no controller, and is harmless to most other
    devices.
    """
    heard = arrived_within(link, BOOT_TIME, b"Grbl") if resets_on_opening(link) else b""
    for _ in range(QUESTIONS):
        link.write(STATUS)
        answer = arrived_within(link, PATIENCE, b">")
        heard += answer
        lines = answer.decode("ascii", "replace").splitlines()
        if any(status_of(line.strip()) for line in lines):
            # Half a line of a previous program must neither be executed nor corrupt our first one:
            # a letter without a number makes every line invalid.
            link.write(b"Q\n")
            arrived_within(link, PATIENCE, b"\n")
            return
        if answer and b"Grbl" not in heard and b"<" not in answer:
            break  # another device answers
    known = None
    if len(heard) == 1 and heard[0] <= 7:
        found = f"one byte, {heard[0]}, as from the tactile board"
        known = found, "use that port with fixel tactile; the controller is on another port"
    raise refusal(
        port, "the actuator's controller (GRBL)", heard, group="actuator", known=known,
        silent="the power of the controller, and its speed of 115200 baud",
        echo=heard.strip() == STATUS,
    )  # fmt: skip
