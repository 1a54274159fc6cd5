"""Reader of the tactile board, an Arduino that reports the fixels that the object touches."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from statistics import median
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self

from fixel.errors import InvalidInput
from fixel.model.fields import positive
from fixel.testbed import tactile_protocol as frames
from fixel.testbed.clocks import DeviceClock
from fixel.testbed.serial_port import arriving, chosen_port, closed_on_failure, open_port
from fixel.testbed.tactile_protocol import shake_hands

if TYPE_CHECKING:
    from serial import Serial


DEADLINE: Final = 0.015  # [s] less than half the interval at 30 frames/s
QUIET: Final = 0.003  # [s] of silence after which a late answer is complete
KEPT: Final = 4096  # round trips stored in the statistics
COLOURS: Final = ("blue", "red", "green")  # bits 0, 1, 2
# The laboratory stored its readings in the order green, red, blue, and its contact mode is
# 4 f1 + 2 f2 + f3: in this order the byte equals the mode.
FIXELS: Final = ("green", "red", "blue")  # fixels 1, 2, 3


class TactileReader:
    """Reader of the tactile board, one reading per request.

    Parameters
    ----------
    port : str, optional
        Serial port: `/dev/ttyACM0`, `COM4`. None raises, with a list of the ports found.
    deadline : float
        Longest time that `read` waits [s].
    thresholds : (int, int, int), optional
        Thresholds of bits 0, 1, 2, from 0 to 1023; None leaves those of the board, initially 900.
        Set again when the board restarts. Needs protocol 2.
    settle : float, optional
        Time without requests after opening [s], since the boot loader would take them for a new
        program. Default: 2 s where opening restarts a board, else 0.
    """

    def __init__(
        self,
        port: str | None = None,
        *,
        deadline: float = DEADLINE,
        thresholds: tuple[int, int, int] | None = None,
        settle: float | None = None,
    ) -> None:
        self.port = chosen_port(port, "the tactile board")
        self.deadline = positive(deadline, "deadline", "s")
        self.statistics = Statistics()
        # 1: one byte per request byte, as in the thesis; 2: with time and checksum; 0: not
        # connected.
        self.protocol = 0
        self.identity: frames.Identity | None = None  # identity that a board of protocol 2 reports
        self.clock = DeviceClock()
        self.trouble = "not connected"  # why the connection ended; empty while it lasts
        self._thresholds = None if thresholds is None else _checked(thresholds)
        self._settle = settle
        self._serial: Serial | None = None
        self._finder = frames.FrameFinder()
        self._number = 0
        self._doubt = False  # an answer of protocol 1 may still be under way
        self._restarted = False  # and its thresholds are not set yet

    # --- connection ---------------------------------------------------------------------------

    def connect(self) -> Self:
        """Open the port and identify the board.

        Raise `InvalidInput` with the answer if the port cannot be opened or another device answers.
        """
        self.disconnect()
        self._serial = link = open_port(self.port, frames.BAUD, "the tactile board")
        with closed_on_failure(self.disconnect, self.port, "the tactile board"):
            self.protocol, self.identity = shake_hands(link, self.port, self._settle)
            self._finder, self.clock = frames.FrameFinder(), DeviceClock()
            self._doubt = self._restarted = False
            if self._thresholds is not None:
                self.set_thresholds(self._thresholds)
        self.trouble = ""
        return self

    def disconnect(self) -> None:
        """Close the port."""
        self._lose("not connected")

    def reconnect(self) -> bool:
        """Connect again after the board was unplugged; return whether it succeeded.

        This takes some seconds where opening restarts the board. The statistics continue.
        """
        try:
            self.connect()
        except InvalidInput as problem:
            self.trouble = str(problem)
        return self.connected

    @property
    def connected(self) -> bool:
        """Whether a board is connected."""
        return self._serial is not None

    def __enter__(self) -> Self:
        return self if self.connected else self.connect()

    def __exit__(self, *_: object) -> None:
        self.disconnect()

    def _lose(self, why: str) -> None:
        link, self._serial = self._serial, None
        self.protocol, self.trouble = 0, why
        if link is not None:
            with suppress(OSError):  # it is already closed
                link.close()

    # --- reading ------------------------------------------------------------------------------

    def read(self) -> TactileReading:
        """Request a reading, and wait for it until the deadline.

        Never raises: a missing answer or a lost board is reported in `problem`.
        """
        if self._serial is None:
            return _missing(time.monotonic(), self.trouble)
        self.statistics.asked += 1
        try:
            reading = self._ask_framed() if self.protocol >= 2 else self._ask_old()
        except OSError as problem:
            self._lose(f"{self.port} was disconnected: {problem}; connect it again")
            self.statistics.missing += 1
            return _missing(time.monotonic(), self.trouble)
        self.statistics.answered += reading.bits is not None
        return reading

    def _ask_framed(self) -> TactileReading:
        link, counted = self._link, self.statistics
        self._number = (self._number + 1) % 256
        stray = self._finder.stray
        sent = time.monotonic()
        link.write(frames.request(frames.READ, self._number))
        frame = self._frame_of(frames.READ, sent + self.deadline)
        received = time.monotonic()
        garbled = self._finder.stray - stray
        counted.stray_bytes += garbled
        if frame is None:
            half = self._finder.forget()  # an incomplete answer; a late rest counts as stray then
            counted.stray_bytes += half
            return self._without_answer(received, garbled + half)
        found = frames.reading_of(frame)
        if found is None:
            counted.garbled += 1
            return _missing(received, "an unknown answer")
        counted.round_trips.append(received - sent)
        # An emulated board that catches up with its clock answers faster than a real line.
        earliest = sent + frames.READ_REQUEST_BYTES * frames.BYTE_TIME
        latest = received - frames.READ_REPLY_BYTES * frames.BYTE_TIME - frames.SAMPLING_TIME
        if latest < earliest:
            earliest, latest = sent, received
        bits, time_us, values = found
        device, host = self.clock.place(time_us, earliest, latest)
        return TactileReading(bits, host, device, values, self._restart_noticed())

    def _frame_of(self, kind: bytes, until: float) -> frames.BoardFrame | None:
        """Wait for the answer to the last request; count older ones as late."""
        link = self._link
        while True:
            for frame in self._finder.add(arriving(link, until)):
                if frame.kind == kind and frame.number == self._number:
                    return frame
                self.statistics.late += 1
            if time.monotonic() >= until:
                return None

    def _without_answer(self, now: float, unreadable: int = 0) -> TactileReading:
        if unreadable:
            self.statistics.garbled += 1
            return _missing(now, f"{unreadable} bytes that are not an answer")
        self.statistics.missing += 1
        return _missing(now, f"no answer within {1e3 * self.deadline:.3g} ms")

    def _restart_noticed(self) -> str:
        self._restarted = self._restarted or self.clock.restarts > 0
        if not self._restarted:
            return ""
        self.statistics.restarts += self.clock.restarts
        self.clock.restarts = 0
        if self._thresholds is None:
            self._restarted = False
            return "the board restarted or its clock jumped"
        # If this fails it is tried again at the next reading, since this one must not wait long.
        self._restarted = not self._confirmed(self._thresholds)
        if self._restarted:
            return "the board restarted and does not accept its thresholds"
        return "the board restarted: this reading is with its default thresholds"

    def _ask_old(self) -> TactileReading:
        link, counted = self._link, self.statistics
        doubt = self._drain()
        sent = time.monotonic()
        link.write(frames.OLD_REQUEST)
        link.timeout = self.deadline
        answer = link.read(1)
        received = time.monotonic()
        if not answer:
            self._doubt = True
            return self._without_answer(received)
        if answer[0] > frames.OLD_MOST:
            counted.garbled += 1
            counted.stray_bytes += 1
            return _missing(received, f"byte {answer[0]} is not an answer")
        counted.round_trips.append(received - sent)
        return TactileReading(bits=answer[0], time=0.5 * (sent + received), problem=doubt)

    def _drain(self) -> str:
        """Discard late bytes: in protocol 1 a byte does not identify the request it answers."""
        link = self._link
        link.timeout = QUIET if self._doubt else 0.0
        over = link.read(max(1, link.in_waiting))
        if not over:
            self._doubt = False
            return ""
        if self._doubt:
            self.statistics.late += len(over)
        else:
            self.statistics.stray_bytes += len(over)
        # The extra byte may have been the answer, and the last reading that of the frame before.
        unasked = not self._doubt
        self._doubt = True
        return "an extra byte preceded it; the last reading may be one frame old" * unasked

    # --- thresholds ---------------------------------------------------------------------------

    def set_thresholds(self, thresholds: tuple[int, int, int]) -> None:
        """Set the values above which a fixel counts as touched, also after restarts of the board.

        They are those of bits 0, 1, 2 (blue, red, green), from 0 to 1023. `InvalidInput` is raised
        for a board that has protocol 1, or does not confirm.
        """
        thresholds = _checked(thresholds)
        if self.protocol < 2:
            raise InvalidInput(
                "thresholds",
                found=f"a board of protocol {self.protocol}" if self.protocol else self.trouble,
                expected="a board whose thresholds can be set",
                hint="upload firmware/tactile to it",
            )
        if not any(self._confirmed(thresholds) for _ in range(3)):
            raise InvalidInput("thresholds", found="no confirmation from the board", expected="one")
        self._thresholds, self._restarted = thresholds, False

    def _confirmed(self, thresholds: tuple[int, int, int]) -> bool:
        """Send thresholds to the board; return whether it confirmed them."""
        self._number = (self._number + 1) % 256
        self._link.write(frames.request(frames.SET_THRESHOLDS, self._number, *thresholds))
        frame = self._frame_of(frames.SET_THRESHOLDS, time.monotonic() + max(0.1, self.deadline))
        answer = frame and frames.identity_of(frame)
        if not answer or answer.thresholds != thresholds:
            return False
        self.identity = answer
        return True

    @property
    def _link(self) -> Serial:
        assert self._serial is not None
        return self._serial


def _checked(thresholds: Sequence[object]) -> tuple[int, int, int]:
    found = [value for value in thresholds if isinstance(value, int) and 0 <= value <= 1023]
    if len(thresholds) != frames.SENSORS or len(found) != frames.SENSORS:
        raise InvalidInput("thresholds", found=thresholds, expected="three numbers from 0 to 1023")
    return found[0], found[1], found[2]


class TactileReading(NamedTuple):
    """One reading of the fixels."""

    # Bit 0 blue, bit 1 red, bit 2 green, set where touched; None without an answer.
    bits: int | None
    time: float  # time of the reading, on `time.monotonic` [s]
    device_time: float | None = None  # the same on the board's clock [s]; None for protocol 1
    # Converter values of bits 0, 1, 2 [-], 1023 at 5 V; None for protocol 1.
    values: tuple[int, int, int] | None = None
    problem: str = ""  # why there are no bits, or why they are doubtful; empty otherwise


def _missing(time: float, problem: str) -> TactileReading:
    return TactileReading(bits=None, time=time, problem=problem)


@dataclass(slots=True, kw_only=True)
class Statistics:
    """Statistics of the communication with the board."""

    asked: int = 0  # number of requests
    answered: int = 0  # number of requests answered in time and undamaged
    missing: int = 0  # number of requests without an answer until the deadline
    late: int = 0  # number of answers after their deadline
    garbled: int = 0  # number of requests with an unreadable answer
    stray_bytes: int = 0  # number of bytes that belonged to no answer
    restarts: int = 0  # number of restarts of the board
    # Last round-trip times [s].
    round_trips: deque[float] = field(default_factory=lambda: deque(maxlen=KEPT))

    def summary(self) -> dict[str, Any]:
        """Return the statistics as plain values."""
        counts = ("asked", "answered", "missing", "late", "garbled", "stray_bytes", "restarts")
        trips = self.round_trips
        return {name: getattr(self, name) for name in counts} | {
            "round_trip_median_s": median(trips) if trips else None,
            "round_trip_max_s": max(trips) if trips else None,
        }


def fixels_of(bits: int, order: tuple[str, str, str] = FIXELS) -> tuple[bool, bool, bool]:
    """Return whether fixels 1, 2, 3 are touched, by the bits of a reading.

    `order` has their colours; by default it is that of the thesis.
    """
    if sorted(order) != sorted(COLOURS):
        raise InvalidInput("order", found=order, expected="blue, red and green, each once")
    one, two, three = (COLOURS.index(colour) for colour in order)
    return bool(bits >> one & 1), bool(bits >> two & 1), bool(bits >> three & 1)


def contact_mode(bits: int, order: tuple[str, str, str] = FIXELS) -> str:
    """Return one digit per fixel, as experiments store it: `"100"` if only fixel 1 is touched."""
    return "".join("1" if touched else "0" for touched in fixels_of(bits, order))
