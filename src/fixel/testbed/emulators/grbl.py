"""Emulated GRBL controller: one to four axes that move in real time, on a pseudo-terminal.

    python -m fixel.testbed.emulators.grbl --link /tmp/grbl

It is for tests, and for trying `fixel actuator` without hardware. It emulates what a drive needs:
realtime characters, the receive buffer, the planner's look-ahead with slower corners, holds with
deceleration, alarms, limit switches, soft limits, homing. It has no arcs, spindles, overrides or
probing.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import re
import select
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, NamedTuple, Self

from fixel.errors import InvalidInput

BUFFER: Final = 128  # bytes
PLANNER: Final = 15  # moves
TURN: Final = 0.001  # [s], wait for input in one turn of the loop
SUBSTEP: Final = 0.001  # [s]
PULL_OFF: Final = 1.0  # [mm], distance from the switch after homing
HOMING_SPEED: Final = 25.0  # [mm/s]
JUNCTION: Final = 0.01  # [mm], deviation from a corner that determines the speed in it, `$11`
NO_SPACE: Final = b" \t"
WORDS: Final = re.compile(r"([A-Z])([-+]?\d*\.?\d*)")


class Firmware(NamedTuple):
    """Answers in which one firmware differs from another."""

    greeting: str
    version: tuple[str, ...]  # answer to `$I`
    more: tuple[str, ...] = ()  # settings besides those of the axes
    named: bool = False  # whether `$/axes/x` has the settings of the axis, not `$$`


FIRMWARE: Final = {
    "GRBL": Firmware("Grbl 1.1h ['$' for help]", ("[VER:1.1h.20190825:]", "[OPT:V,15,128]")),
    "grblHAL": Firmware(
        "GrblHAL 1.1f ['$' or '$HELP' for help]",
        ("[VER:1.1f.20240420:]", "[OPT:VNMSL,35,1024,3,0]", "[FIRMWARE:grblHAL]"),
        ("$70=", "$300=grblHAL", "$302=192.168.5.1", "$304=255.255.255.0", "$535=02:08:dc:2b:eb"),
    ),
    "FluidNC": Firmware(
        "Grbl 3.7 [FluidNC v3.7.8 (wifi) '$' for help]",
        ("[VER:3.7 FluidNC v3.7.8:]", "[OPT:MPHS]", "[MSG:Machine: emulated]"),
        ("$30=1000",),
        named=True,
    ),
}


class GrblEvent(NamedTuple):
    """Event of the emulated controller."""

    what: str  # name of the event: `hold`, `reset`, `rest` (the drive came to rest), `alarm 3`, ...
    time: float  # time of the event, by `time.monotonic` [s]
    speed: float  # speed of the drive at that time [mm/s]


class PlannerBlock(NamedTuple):
    """Straight move in the planner."""

    begin: tuple[float, ...]  # place of each axis, from its withdrawn end [mm]
    end: tuple[float, ...]
    way: tuple[float, ...]  # unit vector
    length: float  # [mm]
    speed: float  # [mm/s]
    acceleration: float  # [mm/s^2]

    def at(self, gone: float) -> tuple[float, ...]:
        """Return the place after a part of the move [mm]."""
        return tuple(b + gone * w for b, w in zip(self.begin, self.way, strict=True))

    def corner(self, following: PlannerBlock) -> float:
        """Return the square of the largest speed between two moves [mm^2/s^2], as in GRBL."""
        along = sum(a * b for a, b in zip(self.way, following.way, strict=True))
        full = min(self.speed, following.speed) ** 2
        if along > 0.999999:
            return full
        half = math.sqrt(max(0.0, 0.5 * (1.0 + along)))
        slower = min(self.acceleration, following.acceleration)
        return min(full, slower * JUNCTION * half / (1.0 - half))


class EmulatedGrbl:
    """Emulated controller of a drive with 1 to 4 axes.

    Lengths, speeds and accelerations are those of all axes or of each. The firmware is a name in
    `FIRMWARE`.
    """

    def __init__(
        self,
        *,
        travel: float | Sequence[float] = 150.0,  # distance between the limit switches [mm]
        start: float | Sequence[float] = 40.0,  # from the withdrawn end [mm]
        acceleration: float | Sequence[float] = 500.0,  # [mm/s^2]
        fastest: float | Sequence[float] = 50.0,  # maximum speed [mm/s]
        homing: bool = False,  # whether it has switches, and requires homing first
        inches: bool = False,  # whether it reports inches
        rate: float = 1.0,  # emulated seconds per real second: 10 is ten times as fast
        firmware: str = "GRBL",
        axes: int = 3,
    ) -> None:
        if sys.platform == "win32":
            raise InvalidInput(
                "emulated drive", found="Windows", expected="Linux or macOS: it needs a terminal"
            )
        import pty
        import tty

        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        # A port without a reader becomes full; a real wire would lose the data, too.
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)  # path of the port to open
        self.lines: list[str] = []  # all received lines
        self.events: list[GrblEvent] = []
        self.lost = 0  # number of bytes that did not fit into its buffer
        self.mute = False  # fault: sends nothing
        self.refuse = 0  # fault: number of following lines to reject
        self._rate, self._homing = rate, homing
        self._firmware, self._axes = FIRMWARE[firmware], axes  # axes in its reports
        self._letters = "XYZA"[:axes]
        self._travel = _of_axes(travel, axes)
        self._places = _of_axes(start, axes)  # the withdrawn ends are at 0, where the switches are
        self._settings = {
            10: 1.0, 13: float(inches), 20: float(homing), 21: float(homing), 22: float(homing),
            23: 0.0,
        }  # fmt: skip
        for first, values, unit in (110, fastest, 60.0), (120, acceleration, 1.0), (130, travel, 1):
            of_axes = enumerate(_of_axes(values, axes))
            self._settings |= {first + k: unit * value for k, value in of_axes}
        # Machine coordinates decrease as the drive extends, as in GRBL after homing to the switch.
        self._shift = _of_axes(0.0, axes) if homing else tuple(-at for at in self._places)
        self._sign, self.state = (-1.0, "Alarm") if homing else (1.0, "Idle")
        self._critical, self._speed = False, 0.0
        self._blocks: deque[PlannerBlock] = deque()
        self._planned, self._gone = self._places, 0.0  # the latter of the first block [mm]
        self._partial, self._feed, self._units = bytearray(), 0.0, 1.0
        self._waiting: deque[bytes] = deque()
        self._relative = self._ended = False
        self._errands: deque[Callable[[], object]] = deque()
        # Place of each axis from its withdrawn end [mm] and speed [mm/s], while it moved.
        self.trace: list[tuple[tuple[float, ...], float]] = []
        self._say("", self._firmware.greeting, *self._lock_words())
        self._thread = threading.Thread(target=self._run, name="emulated-grbl", daemon=True)
        self._thread.start()

    # --- for tests ----------------------------------------------------------------------------

    @property
    def place(self) -> float:
        """True position of axis X, from its withdrawn end [mm]."""
        return self._places[0]

    @property
    def places(self) -> tuple[float, ...]:
        """True position of each axis, from its withdrawn end [mm]."""
        return self._places

    def slowest(self, begin: float, end: float) -> float:
        """Smallest speed [mm/s] so far between two positions of axis X [mm]."""
        low, high = sorted((begin, end))
        return min(speed for places, speed in self.trace if low < places[0] < high)

    @property
    def speed(self) -> float:
        """Magnitude of the true speed [mm/s]."""
        return abs(self._speed)

    @property
    def stopped(self) -> float:
        """Time at which it last came to rest or had an alarm, by `time.monotonic` [s]."""
        return next(
            event.time
            for event in reversed(self.events)
            if event.what == "rest" or event.what.startswith("alarm")
        )

    @property
    def queued(self) -> float:
        """Duration of the queued moves at their commanded speeds [s]."""
        blocks = list(self._blocks)
        gone = self._gone / blocks[0].speed if blocks else 0.0
        return sum(block.length / block.speed for block in blocks) - gone

    def unplug(self) -> None:
        """Remove the port; the drive completes its queued moves."""
        self._do(self._unplug)

    def power_cycle(self) -> None:
        """Switch the controller off and on: it stops and loses its state."""
        self._do(lambda: self._reset(cold=True))

    def hit_switch(self) -> None:
        """Close a limit switch."""
        self._do(lambda: self._alarm(1))

    def press_hold(self) -> None:
        """Press the hold button on the controller."""
        self._do(lambda: self._take(b"!"))

    def obey(self, line: str) -> None:
        """Execute a motion command that did not come through the port."""
        self._do(lambda: self._motion(line))

    def _do(self, errand: Callable[[], object]) -> None:
        """Run a function in the controller's thread, and return when it is done."""
        done = threading.Event()
        self._errands += [errand, done.set]
        if not done.wait(5.0):
            raise TimeoutError("the emulated controller hangs, or has ended")

    def _unplug(self) -> None:
        for descriptor in (self._master, self._slave):
            os.close(descriptor)
        self._master = -1

    def close(self) -> None:
        """End the controller and remove the port."""
        self._ended = True
        self._thread.join()
        if self._master >= 0:
            self._unplug()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # --- the loop -----------------------------------------------------------------------------

    def _run(self) -> None:
        last = time.monotonic()
        while not self._ended:
            while self._errands:
                self._errands.popleft()()
            self._listen()
            now = time.monotonic()
            # A loaded computer may suspend this thread; a drive would not catch up in one leap.
            left = min(now - last, 0.05) * self._rate
            last = now
            while left > 0.0:
                self._move(min(SUBSTEP, left))
                left -= SUBSTEP
            self._work()

    def _listen(self) -> None:
        if self._master < 0:
            time.sleep(TURN)
            return
        try:
            if not select.select([self._master], [], [], TURN)[0]:
                return
            for value in os.read(self._master, 1024):
                self._take(bytes([value]))
        except OSError:
            time.sleep(TURN)  # the port is not open elsewhere, or it was unplugged

    def _take(self, byte: bytes) -> None:
        if byte == b"?":
            self._report()
        elif byte == b"!":
            self._event("hold")
            if self.state in ("Run", "Idle"):
                self.state = "Hold"
        elif byte == b"~":
            if self.state == "Hold" and self._speed == 0.0:
                self.state = "Run" if self._blocks else "Idle"
        elif byte == b"\x18":
            self._reset()
        elif byte in (b"\n", b"\r"):
            if self._partial or byte == b"\n":
                self._waiting.append(bytes(self._partial))
            self._partial.clear()
        elif byte[0] < 0x80 and byte not in NO_SPACE:
            if len(self._partial) + sum(len(line) + 1 for line in self._waiting) >= BUFFER:
                self.lost += 1
            else:
                self._partial += byte

    def _work(self) -> None:
        """Execute waiting lines, as long as the planner has room for their moves."""
        while self._waiting and len(self._blocks) < PLANNER and self.state != "Home":
            if self._critical or (self.state == "Hold" and not self._waiting[0].startswith(b"$")):
                return
            line = self._waiting.popleft().decode("ascii").upper()
            self.lines.append(line)
            verdict = self._command(line) if line.startswith("$") else self._motion(line)
            if verdict:
                self._say(verdict)

    # --- lines --------------------------------------------------------------------------------

    def _command(self, line: str) -> str:
        if line == "$H":
            if not self._homing:
                return "error:5"
            self.state = "Home"
            return ""
        if line == "$X":
            if self.state == "Alarm":
                self.state, self._planned = "Idle", self._places
                self._say("[MSG:Caution: Unlocked]")
            return "ok"
        if self.state not in ("Idle", "Alarm"):
            return "error:8"
        if line == "$$":
            self._say(*self._numbered_settings(), *self._firmware.more)
        elif line == "$I":
            self._say(*self._firmware.version)
        elif line.startswith("$/AXES/") and line[7:] in self._letters and self._firmware.named:
            self._say(*self._named_settings(line[7:]))
        else:
            return "error:3"
        return "ok"

    def _numbered_settings(self) -> list[str]:
        few = (10, 13) if self._firmware.named else sorted(self._settings)
        return [f"${number}={self._settings[number]:g}" for number in few]

    def _named_settings(self, letter: str) -> list[str]:
        """Return the part of FluidNC's configuration that describes an axis."""
        of, k = self._settings, self._letters.index(letter)
        return [
            f"/axes/{letter.lower()}:", "  steps_per_mm: 80.000000",
            f"  max_rate_mm_per_min: {of[110 + k]:f}",
            f"  acceleration_mm_per_sec2: {of[120 + k]:f}", f"  max_travel_mm: {of[130 + k]:f}",
            f"  soft_limits: {'true' if of[20] else 'false'}", "  homing:",
            f"    cycle: {of[22]:.0f}", "    positive_direction: true",
            f"    mpos_mm: {-PULL_OFF:f}", "", "  motor0:", "    limit_neg_pin: NO_PIN",
            "    pulloff_mm: 1.000000",
        ]  # fmt: skip

    def _motion(self, line: str) -> str:
        if self.state == "Alarm":
            return "error:9"
        if self.refuse:
            self.refuse -= 1
            return "error:20"
        words = WORDS.findall(line)
        if "".join(letter + number for letter, number in words) != line:
            return "error:1"
        if any(number in ("", "-", "+", ".") for _, number in words):
            return "error:2"
        targets: dict[int, float] = {}
        machine, moves = False, False
        for letter, number in words:
            value = float(number)
            if letter == "G" and value in (0, 1):
                moves = True
            elif letter == "G" and value in (20, 21):
                self._units = 25.4 if value == 20 else 1.0
            elif letter == "G" and value in (90, 91):
                self._relative = value == 91
            elif letter == "G" and value in (53, 94):
                machine = machine or value == 53
            elif letter == "F":
                self._feed = value * self._units / 60.0
            elif letter in self._letters:
                targets[self._letters.index(letter)] = value * self._units
            elif letter not in "NS":
                return "error:20"
        if not targets:
            return "ok"
        if self._feed <= 0.0 or not moves:
            return "error:22"
        return self._plan(targets, relative=self._relative and not machine)

    def _plan(self, targets: dict[int, float], *, relative: bool) -> str:
        ends = list(self._planned)
        for k, target in targets.items():
            # From the withdrawn end, of a machine coordinate.
            ends[k] = self._sign * target + (ends[k] if relative else -self._shift[k])
        inside = all(0.0 <= end <= most for end, most in zip(ends, self._travel, strict=True))
        if self._settings[20] and not inside:
            self._alarm(2)
            self._critical = True
            return ""
        length = math.dist(ends, self._planned)
        if length > 0.0:
            way = tuple((e - b) / length for e, b in zip(ends, self._planned, strict=True))
            moved = [(k, abs(part)) for k, part in enumerate(way) if part]
            speed = min(self._settings[110 + k] / 60.0 / part for k, part in moved)
            slowing = min(self._settings[120 + k] / part for k, part in moved)
            begin, self._planned = self._planned, tuple(ends)
            speed = min(self._feed, speed)
            self._blocks.append(PlannerBlock(begin, self._planned, way, length, speed, slowing))
            if self.state == "Idle":
                self.state = "Run"
        return "ok"

    # --- motion -------------------------------------------------------------------------------

    def _move(self, step: float) -> None:
        if self.state == "Home":
            self._move_home(step)
        elif self.state in ("Run", "Hold"):
            self._move_on(step)

    def _move_home(self, step: float) -> None:
        self._places = tuple(max(0.0, at - HOMING_SPEED * step) for at in self._places)
        if not any(self._places):
            axes = len(self._places)
            self._shift, self._places = _of_axes(0.0, axes), _of_axes(PULL_OFF, axes)
            self._planned, self.state = self._places, "Idle"
            self._event("homed")
            self._say("ok")

    def _move_on(self, step: float) -> None:
        if not self._blocks:
            self._come_to_rest()
            return
        block = self._blocks[0]
        slowing = block.acceleration * step
        wanted = 0.0 if self.state == "Hold" else self._allowed_speed()
        before = self._speed
        self._speed = min(max(wanted, self._speed - slowing), self._speed + slowing)
        if self._speed == 0.0 and self.state == "Hold":
            if before:
                self._event("rest", before)
            return
        self.trace.append((self._places, self._speed))
        self._gone += max(self._speed, 1e-3) * step
        while self._gone >= block.length - 1e-9:
            self._blocks.popleft()
            if not self._blocks:
                self._gone = 0.0
                self._places = block.end
                break
            self._gone, block = max(0.0, self._gone - block.length), self._blocks[0]
        else:
            self._places = block.at(self._gone)
        self._look_for_trouble()
        if not self._blocks:
            self._come_to_rest()

    def _allowed_speed(self) -> float:
        """Largest speed from which it can slow down to that of every corner ahead [mm/s]."""
        blocks = list(self._blocks)
        allowed, ahead = blocks[0].speed, -self._gone
        for k, block in enumerate(blocks):
            ahead += block.length
            corner = block.corner(blocks[k + 1]) if k + 1 < len(blocks) else 0.0
            room = 2.0 * block.acceleration * max(0.0, ahead)
            allowed = min(allowed, math.sqrt(corner + room))
        return allowed

    def _come_to_rest(self) -> None:
        if self._speed:
            self._event("rest", self._speed)
        self._speed = 0.0
        if self.state == "Run":
            self.state = "Idle"

    def _look_for_trouble(self) -> None:
        inside = all(0.0 <= at <= most for at, most in zip(self._places, self._travel, strict=True))
        if self._homing and not inside:
            self._alarm(1)
            self._critical = True

    def _alarm(self, number: int) -> None:
        self._event(f"alarm {number}")
        self._forget_moves()
        self._speed = 0.0
        self.state = "Alarm"
        self._say(f"ALARM:{number}")

    def _reset(self, *, cold: bool = False) -> None:
        self._event("reset")
        if cold:  # it has no memory of a move, and sends no alarm
            self.state = "Alarm" if self._homing else "Idle"
            self._speed, self._shift = 0.0, tuple(-at for at in self._places)
        elif self._speed > 0.0 or self.state == "Home":
            self._alarm(6 if self.state == "Home" else 3)
        elif self.state != "Alarm":
            self.state = "Idle"
        self._forget_moves()
        self._waiting.clear()
        self._partial.clear()
        self._critical = False
        self._feed, self._relative, self._units = 0.0, False, 1.0
        self._say("", self._firmware.greeting, *self._lock_words())

    def _forget_moves(self) -> None:
        self._blocks.clear()
        self._gone, self._planned = 0.0, self._places

    # --- output -------------------------------------------------------------------------------

    def _lock_words(self) -> list[str]:
        return ["[MSG:'$H'|'$X' to unlock]"] if self.state == "Alarm" else []

    def _report(self) -> None:
        state = self.state
        if state == "Hold":
            state += ":0" if self._speed == 0.0 else ":1"
        unit, digits = (25.4, 4) if self._settings[13] else (1.0, 3)
        reported = list(zip(self._places, self._shift, strict=True))[: self._axes]
        place = ",".join(f"{self._sign * (at + by) / unit:.{digits}f}" for at, by in reported)
        room = PLANNER - len(self._blocks)
        speed = round(60.0 * self._speed)
        self._say(f"<{state}|MPos:{place}|Bf:{room},{BUFFER}|FS:{speed},0>")

    def _say(self, *lines: str) -> None:
        if self.mute or self._master < 0:
            return
        data = "".join(f"{line}\r\n" for line in lines).encode("ascii")
        with contextlib.suppress(OSError):
            os.write(self._master, data)

    def _event(self, what: str, speed: float | None = None) -> None:
        moved = self._speed if speed is None else speed
        self.events.append(GrblEvent(what, time.monotonic(), moved))


def _of_axes(value: float | Sequence[float], axes: int) -> tuple[float, ...]:
    """Return one value for each axis."""
    return (float(value),) * axes if isinstance(value, float | int) else tuple(value)


def main() -> None:
    """Run an emulated controller until Ctrl-C."""
    parser = argparse.ArgumentParser(description="An emulated GRBL controller.")
    parser.add_argument("--link", type=Path, required=True, help="name of a link to the port")
    parser.add_argument("--axes", type=int, default=3, choices=range(1, 5), help="number of axes")
    parser.add_argument("--homing", action="store_true", help="require homing first")
    parser.add_argument(
        "--rate", type=float, default=1.0, help="ratio of its clock to the computer's"
    )
    chosen = parser.parse_args()
    if chosen.link.exists() and not chosen.link.is_symlink():
        parser.error(f"--link: {chosen.link} already exists and is not a link")
    with EmulatedGrbl(homing=chosen.homing, rate=chosen.rate, axes=chosen.axes) as controller:
        chosen.link.unlink(missing_ok=True)
        chosen.link.symlink_to(controller.port)
        print(f"{chosen.link}: a GRBL controller; stop it with Ctrl-C", flush=True)
        try:
            threading.Event().wait()
        except KeyboardInterrupt:
            pass
        finally:
            chosen.link.unlink(missing_ok=True)


if __name__ == "__main__":
    main()
