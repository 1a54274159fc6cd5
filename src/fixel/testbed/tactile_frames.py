"""The bytes between a program and the tactile board; `firmware/README.md` has the tables."""

from __future__ import annotations

import binascii
import struct
from typing import Final, NamedTuple

PROTOCOL: Final = 2
BAUD: Final = 115200
BYTE_TIME: Final = 10 / BAUD  # [s] on the wire: start bit, eight bits, stop bit
SENSORS: Final = 3
NAME: Final = b"fixel-tactile"
OLD_REQUEST: Final = b"?"  # any byte would do
OLD_MOST: Final = 7  # the largest old answer: three bits

IDENTIFY: Final = b"I"
READ: Final = b"R"
SET_THRESHOLDS: Final = b"T"

_REQUEST: Final = b"\xf5"
_REPLY: Final = 0xFA
_HEAD: Final = 4  # begin, kind, number, length
_SUM: Final = 2
_READING: Final = struct.Struct("<BBI3H")
_IDENTITY: Final = struct.Struct("<BB3HI13s")
_LONGEST: Final = _IDENTITY.size

READ_REQUEST_BYTES: Final = 5
READ_REPLY_BYTES: Final = _HEAD + _READING.size + _SUM
SAMPLING_TIME: Final = 3 * 112e-6  # [s] three conversions, after the time stamp


class BoardFrame(NamedTuple):
    """A framed answer of the board, its checksum right."""

    kind: bytes
    number: int
    content: bytes


class FramedReading(NamedTuple):
    """Content of an answer to `READ`."""

    protocol: int
    bits: int
    time_us: int
    values: tuple[int, int, int]


class Identity(NamedTuple):
    """Content of an answer to `IDENTIFY` or `SET_THRESHOLDS`.

    Attributes
    ----------
    protocol : int
    sensors : int
    thresholds : (int, int, int)
        Of the bits 0, 1, 2, in steps of the converter [-], 1023 at 5 V.
    uptime : float
        Since the board started [s].
    name : str
    """

    protocol: int
    sensors: int
    thresholds: tuple[int, int, int]
    uptime: float
    name: str


def request(kind: bytes, number: int, values: bytes = b"") -> bytes:
    """A request of the new kind.

    Parameters
    ----------
    kind : bytes
        `IDENTIFY`, `READ` or `SET_THRESHOLDS`.
    number : int
        From 0 to 255; the answer repeats it.
    values : bytes
        The thresholds, for `SET_THRESHOLDS`.
    """
    summed = kind + bytes([number]) + values
    return _REQUEST + summed + _checksum(summed)


def thresholds_request(number: int, thresholds: tuple[int, int, int]) -> bytes:
    """A request to set the thresholds of bits 0, 1, 2."""
    return request(SET_THRESHOLDS, number, struct.pack("<3H", *thresholds))


def reading_of(frame: BoardFrame) -> FramedReading | None:
    """What the frame says about the fixels; None if it is no such frame."""
    if frame.kind != READ or len(frame.content) != _READING.size:
        return None
    protocol, bits, time_us, *values = _READING.unpack(frame.content)
    return FramedReading(protocol, bits, time_us, (values[0], values[1], values[2]))


def identity_of(frame: BoardFrame) -> Identity | None:
    """Who the board says it is; None if the frame does not say."""
    if frame.kind not in (IDENTIFY, SET_THRESHOLDS) or len(frame.content) != _IDENTITY.size:
        return None
    protocol, sensors, a, b, c, uptime_ms, name = _IDENTITY.unpack(frame.content)
    if name != NAME:
        return None
    return Identity(protocol, sensors, (a, b, c), 1e-3 * uptime_ms, name.decode())


class FrameFinder:
    """Frames among whatever arrives: finds its place again after anything.

    Attributes
    ----------
    stray : int
        Bytes so far that belong to no frame with a right checksum.
    """

    def __init__(self) -> None:
        self.stray = 0
        self._held = bytearray()

    def add(self, arrived: bytes) -> list[BoardFrame]:
        """The frames that are complete now."""
        self._held += arrived
        found = []
        while self._held:
            size = self._size()
            if size is None:
                break  # more is to come
            if size == 0:
                # What looked like a beginning was none: the true one may be just behind it.
                self.stray += 1
                del self._held[0]
            else:
                number = self._held[2]
                kind, content = bytes(self._held[1:2]), bytes(self._held[_HEAD : size - _SUM])
                found.append(BoardFrame(kind, number, content))
                del self._held[:size]
        return found

    def forget(self) -> int:
        """Give up what is incomplete; how many bytes that was."""
        given_up = len(self._held)
        self.stray += given_up
        self._held.clear()
        return given_up

    def _size(self) -> int | None:
        """Of the frame at the beginning; None for not yet known, 0 for no frame."""
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
