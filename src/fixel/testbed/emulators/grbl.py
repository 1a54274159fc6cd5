"""Emulated GRBL controller: one axis that moves in real time, on a pseudo-terminal.

    python -m fixel.testbed.emulators.grbl --link /tmp/grbl

It is for tests, and for trying `fixel actuator` without hardware. It emulates what one drive needs:
realtime characters, the receive buffer, the planner's look-ahead, holds with deceleration, alarms,
limit switches, soft limits, homing. It has no arcs, spindles, overrides or probing.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import select
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple, Self, final

from fixel.errors import InvalidInput

BUFFER: Final = 128  # bytes
PLANNER: Final = 15  # moves
TURN: Final = 0.001  # [s], wait for input in one turn of the loop
SUBSTEP: Final = 0.001  # [s]
PULL_OFF: Final = 1.0  # [mm], distance from the switch after homing
HOMING_SPEED: Final = 25.0  # [mm/s]
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


@final
class EmulatedGrbl:
    """Emulated controller whose axis X has a drive.

    Parameters
    ----------
    travel : float
        Distance between the limit switches [mm].
    start : float
        Initial position of the drive, from the withdrawn end [mm].
    acceleration : float
        Acceleration [mm/s^2].
    fastest : float
        Maximum speed [mm/s].
    homing : bool
        Whether it has switches, and requires homing first.
    inches : bool
        Whether it reports inches.
    rate : float
        Emulated seconds per real second: 10 is ten times as fast.
    firmware : str
        Name in `FIRMWARE`.
    axes : int
        Number of axes that it reports.
    """

    def __init__(
        self,
        *,
        travel: float = 150.0,
        start: float = 40.0,
        acceleration: float = 500.0,
        fastest: float = 50.0,
        homing: bool = False,
        inches: bool = False,
        rate: float = 1.0,
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
        self.garble = 0  # fault: number of following bytes to damage
        self.refuse = 0  # fault: number of following lines to reject
        self._rate = rate
        self._firmware, self._axes = FIRMWARE[firmware], axes
        self._travel, self._end = travel, start  # the withdrawn end is at 0, where the switch is
        self._homing = homing
        self._settings = {
            10: 1.0, 13: float(inches), 20: float(homing), 21: float(homing), 22: float(homing),
            23: 0.0, 110: 60.0 * fastest, 120: acceleration, 130: travel,
        }  # fmt: skip
        # Machine coordinates decrease as the drive extends, as in GRBL after homing to the switch.
        self._shift = -start if not homing else 0.0
        self._sign = -1.0 if homing else 1.0
        self.state = "Alarm" if homing else "Idle"
        self._critical = False
        self._speed = 0.0
        self._blocks: deque[tuple[float, float]] = deque()  # end of stroke [mm], speed [mm/s]
        self._planned = start
        self._partial = bytearray()
        self._waiting: deque[bytes] = deque()
        self._feed = 0.0
        self._relative = False
        self._units = 1.0
        self._ended = False
        self._errands: deque[Callable[[], object]] = deque()
        # Position from the withdrawn end [mm] and speed [mm/s], while it moved.
        self.trace: list[tuple[float, float]] = []
        self._say("", self._firmware.greeting, *self._lock_words())
        self._thread = threading.Thread(target=self._run, name="emulated-grbl", daemon=True)
        self._thread.start()

    # --- for tests ----------------------------------------------------------------------------

    @property
    def place(self) -> float:
        """True position of the drive, from the withdrawn end [mm]."""
        return self._end

    def slowest(self, begin: float, end: float) -> float:
        """Smallest speed [mm/s] so far between two positions [mm]."""
        low, high = sorted((begin, end))
        return min(speed for place, speed in self.trace if low < place < high)

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
        total, here = 0.0, self._end
        for end, speed in list(self._blocks):
            total, here = total + abs(end - here) / speed, end
        return total

    def wait_for(self, what: str, patience: float = 5.0) -> GrblEvent:
        """Wait for an event of a given name; return the first one."""
        until = time.monotonic() + patience
        while time.monotonic() < until:
            found = next((event for event in self.events if event.what == what), None)
            if found:
                return found
            time.sleep(0.001)
        raise TimeoutError(f"no {what!r} among {[event.what for event in self.events]}")

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
            left = min(now - last, 0.25) * self._rate
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
            self.state, self._planned = "Home", 0.0
            return ""
        if line == "$X":
            if self.state == "Alarm":
                self.state, self._planned = "Idle", self._end
                self._say("[MSG:Caution: Unlocked]")
            return "ok"
        if self.state not in ("Idle", "Alarm"):
            return "error:8"
        if line == "$$":
            self._say(*self._numbered_settings(), *self._firmware.more)
        elif line == "$I":
            self._say(*self._firmware.version)
        elif line == "$/AXES/X" and self._firmware.named:
            self._say(*self._named_settings())
        else:
            return "error:3"
        return "ok"

    def _numbered_settings(self) -> list[str]:
        few = (10, 13) if self._firmware.named else self._settings
        return [f"${number}={self._settings[number]:g}" for number in few]

    def _named_settings(self) -> list[str]:
        """Return the part of FluidNC's configuration that describes the axis."""
        of = self._settings
        return [
            "/axes/x:", "  steps_per_mm: 80.000000", f"  max_rate_mm_per_min: {of[110]:f}",
            f"  acceleration_mm_per_sec2: {of[120]:f}", f"  max_travel_mm: {of[130]:f}",
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
        target, machine, moves = None, False, False
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
            elif letter == "X":
                target = value * self._units
            elif letter not in "NS":
                return "error:20"
        if target is None:
            return "ok"
        if self._feed <= 0.0 or not moves:
            return "error:22"
        return self._plan(target, relative=self._relative and not machine)

    def _plan(self, target: float, *, relative: bool) -> str:
        end = self._planned + self._sign * target if relative else self._stroke(target)
        if self._settings[20] and not 0.0 <= end <= self._travel:
            self._alarm(2)
            self._critical = True
            return ""
        if end != self._planned:
            self._blocks.append((end, min(self._feed, self._settings[110] / 60.0)))
            self._planned = end
            if self.state == "Idle":
                self.state = "Run"
        return "ok"

    def _stroke(self, coordinate: float) -> float:
        """Position from the withdrawn end [mm] of a machine coordinate [mm]."""
        return self._sign * coordinate - self._shift

    def _coordinate(self) -> float:
        return self._sign * (self._end + self._shift)

    # --- motion -------------------------------------------------------------------------------

    def _move(self, step: float) -> None:
        if self.state == "Home":
            self._move_home(step)
        elif self.state in ("Run", "Hold"):
            self._move_on(step)

    def _move_home(self, step: float) -> None:
        self._end = max(0.0, self._end - HOMING_SPEED * step)
        if self._end == 0.0:
            self._end, self._shift, self._planned = PULL_OFF, 0.0, PULL_OFF
            self.state = "Idle"
            self._event("homed")
            self._say("ok")

    def _move_on(self, step: float) -> None:
        slowing = self._settings[120] * step
        if not self._blocks:
            self._come_to_rest()
            return
        end, full = self._blocks[0]
        way = 1.0 if end > self._end else -1.0
        wanted = 0.0 if self.state == "Hold" else min(full, self._speed_for(self._ahead(way)))
        before = self._speed
        self._speed = min(max(wanted, self._speed - slowing), self._speed + slowing)
        if self._speed == 0.0 and self.state == "Hold":
            if before:
                self._event("rest", before)
            return
        self.trace.append((self._end, self._speed))
        self._end += way * max(self._speed, 1e-3) * step
        while self._blocks and way * (self._end - self._blocks[0][0]) >= -1e-9:
            past = self._blocks.popleft()[0]
            turns = not self._blocks or way * (self._blocks[0][0] - past) <= 0.0
            if turns:
                self._end = past
        self._look_for_trouble()
        if not self._blocks:
            self._come_to_rest()

    def _ahead(self, way: float) -> float:
        """Distance that the queued moves continue in this direction [mm]."""
        here = self._end
        for end, _ in list(self._blocks):
            if way * (end - here) < 0.0:
                break
            here = end
        return abs(here - self._end)

    def _speed_for(self, distance: float) -> float:
        """Largest speed from which it can come to rest within a distance [mm/s]."""
        return float((2.0 * self._settings[120] * distance) ** 0.5)

    def _come_to_rest(self) -> None:
        if self._speed:
            self._event("rest", self._speed)
        self._speed = 0.0
        if self.state == "Run":
            self.state = "Idle"

    def _look_for_trouble(self) -> None:
        if self._homing and not 0.0 <= self._end <= self._travel:
            self._alarm(1)
            self._critical = True

    def _alarm(self, number: int) -> None:
        self._event(f"alarm {number}")
        self._blocks.clear()
        self._speed = 0.0
        self._planned = self._end
        self.state = "Alarm"
        self._say(f"ALARM:{number}")

    def _reset(self, *, cold: bool = False) -> None:
        self._event("reset")
        if cold:  # it has no memory of a move, and sends no alarm
            self.state = "Alarm" if self._homing else "Idle"
            self._speed, self._shift = 0.0, -self._end
        elif self._speed > 0.0 or self.state == "Home":
            self._alarm(6 if self.state == "Home" else 3)
        elif self.state != "Alarm":
            self.state = "Idle"
        self._blocks.clear()
        self._waiting.clear()
        self._partial.clear()
        self._planned, self._critical = self._end, False
        self._feed, self._relative, self._units = 0.0, False, 1.0
        self._say("", self._firmware.greeting, *self._lock_words())

    # --- output -------------------------------------------------------------------------------

    def _lock_words(self) -> list[str]:
        return ["[MSG:'$H'|'$X' to unlock]"] if self.state == "Alarm" else []

    def _report(self) -> None:
        state = self.state
        if state == "Hold":
            state += ":0" if self._speed == 0.0 else ":1"
        unit = 25.4 if self._settings[13] else 1.0
        place = f"{self._coordinate() / unit:.{4 if unit > 1.0 else 3}f}"
        place += (self._axes - 1) * ",0.000"
        room = PLANNER - len(self._blocks)
        speed = round(60.0 * self._speed)
        self._say(f"<{state}|MPos:{place}|Bf:{room},{BUFFER}|FS:{speed},0>")

    def _say(self, *lines: str) -> None:
        if self.mute or self._master < 0:
            return
        data = bytearray("".join(f"{line}\r\n" for line in lines).encode("ascii"))
        for k in range(min(self.garble, len(data))):
            data[k] ^= 0x2A
            self.garble -= 1
        with contextlib.suppress(OSError):
            os.write(self._master, data)

    def _event(self, what: str, speed: float | None = None) -> None:
        moved = self._speed if speed is None else speed
        self.events.append(GrblEvent(what, time.monotonic(), moved))


def main() -> None:
    """Run an emulated controller until Ctrl-C."""
    parser = argparse.ArgumentParser(description="An emulated GRBL controller.")
    parser.add_argument("--link", type=Path, required=True, help="name of a link to the port")
    parser.add_argument("--homing", action="store_true", help="require homing first")
    parser.add_argument(
        "--rate", type=float, default=1.0, help="ratio of its clock to the computer's"
    )
    chosen = parser.parse_args()
    if chosen.link.exists() and not chosen.link.is_symlink():
        parser.error(f"--link: {chosen.link} already exists and is not a link")
    with EmulatedGrbl(homing=chosen.homing, rate=chosen.rate) as controller:
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
