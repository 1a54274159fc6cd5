"""Requests to the tactile board and its answers, and its identification after opening its port.

The protocol is described in `firmware/README.md`.
"""

from __future__ import annotations

import binascii
import re
import struct
import time
from typing import TYPE_CHECKING, Final, NamedTuple

from fixel.errors import InvalidInput
from fixel.testbed.serial_port import arrived_within, arriving, quoted, refusal, resets_on_opening

if TYPE_CHECKING:
    from serial import Serial


PROTOCOL: Final = 2
BAUD: Final = 115200
BYTE_TIME: Final = 10 / BAUD  # [s] on the wire: start bit, eight bits, stop bit
SENSORS: Final = 3
NAME: Final = b"fixel-tactile"
OLD_REQUEST: Final = b"?"  # any byte works
OLD_MOST: Final = 7  # largest answer of protocol 1: three bits

IDENTIFY: Final = b"I"
READ: Final = b"R"
SET_THRESHOLDS: Final = b"T"

_REQUEST: Final = b"\xf5"
_REPLY: Final = 0xFA
_HEAD: Final = 4  # start byte, kind, number, length
_SUM: Final = 2
_READING: Final = struct.Struct("<BBI3H")
_IDENTITY: Final = struct.Struct("<BB3HI13s")
_LONGEST: Final = _IDENTITY.size

READ_REQUEST_BYTES: Final = 5
READ_REPLY_BYTES: Final = _HEAD + _READING.size + _SUM
SAMPLING_TIME: Final = 3 * 112e-6  # [s] three conversions, after the time stamp
BOOT_TIME: Final = 2.0  # [s] the boot loader of a Mega waits a second for a new program
PATIENCE: Final = 0.25  # [s] between two attempts
QUESTIONS: Final = 4
# With these numbers the checksum consists of letters and digits: the request neither stops nor
# starts a motion controller on the port.
NUMBERS: Final = (9, 8)
OLD_CHECKS: Final = 3
GRBL: Final = re.compile(rb"Grbl|<(Idle|Run|Hold|Jog|Alarm|Home|Door|Check|Sleep)|error:\d|ALARM:")


class BoardFrame(NamedTuple):
    """Framed answer of the board with a correct checksum."""

    kind: bytes
    number: int
    content: bytes


class Identity(NamedTuple):
    """Content of an answer to `IDENTIFY` or `SET_THRESHOLDS`."""

    protocol: int
    sensors: int
    # Thresholds of the bits 0, 1, 2, in steps of the converter [-], 1023 at 5 V.
    thresholds: tuple[int, int, int]


def request(kind: bytes, number: int, *thresholds: int) -> bytes:
    """Encode a request of protocol 2, with a number from 0 to 255 that the answer repeats.

    A request `SET_THRESHOLDS` has the thresholds of bits 0, 1, 2.
    """
    summed = kind + bytes([number]) + struct.pack(f"<{len(thresholds)}H", *thresholds)
    return _REQUEST + summed + _checksum(summed)


def reading_of(frame: BoardFrame) -> tuple[int, int, tuple[int, int, int]] | None:
    """Decode bits, time [us] and values of a reading in a frame; None for frames of other kinds."""
    if frame.kind != READ or len(frame.content) != _READING.size:
        return None
    _, bits, time_us, *values = _READING.unpack(frame.content)
    return bits, time_us, (values[0], values[1], values[2])


def identity_of(frame: BoardFrame) -> Identity | None:
    """Decode the identity in a frame; None for frames of other kinds or boards."""
    if frame.kind not in (IDENTIFY, SET_THRESHOLDS) or len(frame.content) != _IDENTITY.size:
        return None
    protocol, sensors, *thresholds, _, name = _IDENTITY.unpack(frame.content)
    if name != NAME:
        return None
    return Identity(protocol, sensors, (thresholds[0], thresholds[1], thresholds[2]))


class FrameFinder:
    """Finder of frames in arriving bytes, which resynchronises after errors."""

    def __init__(self) -> None:
        self.stray = 0  # number of bytes so far that belong to no frame with a correct checksum
        self._held = bytearray()

    def add(self, arrived: bytes) -> list[BoardFrame]:
        """Add bytes and return the frames that are complete now."""
        self._held += arrived
        found = []
        while self._held:
            size = self._size()
            if size is None:
                break  # the frame is incomplete
            if size == 0:
                # This byte starts no frame: the true start may follow directly.
                self.stray += 1
                del self._held[0]
            else:
                number = self._held[2]
                kind, content = bytes(self._held[1:2]), bytes(self._held[_HEAD : size - _SUM])
                found.append(BoardFrame(kind, number, content))
                del self._held[:size]
        return found

    def forget(self) -> int:
        """Discard an incomplete frame; return its number of bytes."""
        given_up = len(self._held)
        self.stray += given_up
        self._held.clear()
        return given_up

    def _size(self) -> int | None:
        """Return the size of the first frame; None if not yet known, 0 for no frame."""
        held = self._held
        if held[0] != _REPLY:
            return 0
        if len(held) < _HEAD:
            return None
        size = _HEAD + held[3] + _SUM
        if held[3] > _LONGEST:
            return 0
        if len(held) < size:
            return None
        summed, said = held[1 : size - _SUM], held[size - _SUM : size]
        return size if _checksum(bytes(summed)) == bytes(said) else 0


def _checksum(summed: bytes) -> bytes:
    """CRC-16 with polynomial 0x1021, started at 0xFFFF, low byte first."""
    return binascii.crc_hqx(summed, 0xFFFF).to_bytes(2, "little")


def shake_hands(link: Serial, port: str, settle: float | None) -> tuple[int, Identity | None]:
    """Return the protocol of the board and its identity; raise `InvalidInput` for other devices."""
    if settle is None:
        settle = BOOT_TIME if resets_on_opening(link) else 0.0
    heard = arrived_within(link, settle)  # what the board sends while it starts
    if heard and GRBL.search(heard):
        raise _refused(port, heard)
    link.read(link.in_waiting)
    for number in (NUMBERS * QUESTIONS)[:QUESTIONS]:
        question = request(IDENTIFY, number)
        link.write(question)
        finder = FrameFinder()
        answer = b""
        until, late = time.monotonic() + PATIENCE, False
        while not late:
            late = time.monotonic() >= until  # reads then what arrived while this thread was late
            arrived = arriving(link, until)
            answer += arrived
            for frame in finder.add(arrived):
                identity = identity_of(frame)
                if identity is not None and frame.number in NUMBERS:
                    return _known(identity, port), identity
        heard += answer
        if _is_old_board(link, question, answer):
            return 1, None
        if answer:
            break  # another device answers; more requests would only disturb it
    if not heard:
        link.write(b"?")  # the status request of motion controllers, to identify one
        heard = arriving(link, time.monotonic() + PATIENCE)
        time.sleep(0.02 if heard else 0.0)
        heard += link.read(link.in_waiting)
    raise _refused(port, heard, echo=question in heard)


def _is_old_board(link: Serial, question: bytes, answer: bytes) -> bool:
    """Whether every byte is answered by one plausible byte, in the answer and in new tests."""
    # A slow board answers several requests together.
    if not answer or len(answer) % len(question) or max(answer) > OLD_MOST:
        return False
    for _ in range(OLD_CHECKS):
        link.write(OLD_REQUEST)
        link.timeout = PATIENCE
        one = link.read(1)
        if not one or one[0] > OLD_MOST or link.in_waiting:
            return False
    return True


def _known(identity: Identity, port: str) -> int:
    if identity.protocol != PROTOCOL or identity.sensors != SENSORS:
        raise InvalidInput(
            f"port {port}",
            found=f"a tactile board of protocol {identity.protocol} with"
            f" {identity.sensors} sensors",
            expected=f"protocol {PROTOCOL} with {SENSORS} sensors",
            hint="upload the firmware that came with this version of fixel",
        )
    return identity.protocol


def _refused(port: str, heard: bytes, *, echo: bool = False) -> InvalidInput:
    known = None
    if GRBL.search(heard):
        found = f"a motion controller that sent {quoted(heard)}"
        known = found, "use that port with fixel actuator; the board is on another port"
    return refusal(
        port, "the tactile board", heard, group="tactile", echo=echo, known=known,
        silent="the firmware (firmware/README.md) and the speed of 115200 baud",
        hint="if this is the board, upload firmware/tactile to it; else choose another port",
    )  # fmt: skip
