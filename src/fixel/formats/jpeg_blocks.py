"""Decoding of windows of a JPEG picture, without the rest of it.

The start of a block of 8 x 8 pixels in the data is found only by scanning all data before it. The
scan need not decode them: a table skips several coefficients at once. Then only the blocks in a
window are decoded.

The pixels are those of libjpeg, bit for bit, except for colours stored at half the resolution,
which are repeated here and smoothed there.

Source
------
ITU-T T.81 (1992), Annex F; the inverse transform of C. Loeffler, A. Ligtenberg and G. S. Moschytz,
"Practical fast 1-D DCT algorithms with 11 multiplications", ICASSP 1989, as libjpeg rounds it.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from fixel.formats.jpeg_loops import STATE, bgr_of, find_blocks, read_blocks
from fixel.formats.jpeg_tables import fill_codes, fill_strides, fill_words
from fixel.vision.frame import Gray, Picture

SLACK: Final = 128  # words of zeros after the data: longer than any block
AHEAD: Final = 3  # words that may have been read ahead when the data end

# Places of the coefficients in a block, in the zigzag order of the data.
_ORDER: Final = sorted(
    range(64), key=lambda k: (k // 8 + k % 8, k // 8 if (k // 8 + k % 8) % 2 else k % 8)
)


@final
@dataclass(frozen=True, slots=True, eq=False)
class JpegLayout:
    """Layout of the compressed data of a JPEG, from its header.

    Attributes
    ----------
    size : (int, int)
        Width and height [px].
    parts : (n, 6) int64
        For brightness and colours: blocks across and down in a unit, number of the first block,
        blocks across and down in the picture, numbers of its code tables.
    quantum : (n, 64) int64
        Factors of the coefficients, row by row.
    codes : (2, 2, 65536) uint16
        For the tables of first and other coefficients: length and meaning of the code at the start
        of each 16 bits.
    strides : (2, 2, 8192) uint32
        Bits and coefficients to skip by the codes within each 13 bits; see `fill_strides`.
    units : (int, int)
        Number of units across and down.
    interval : int
        Units between two restarts; 0 for none.
    """

    size: tuple[int, int]
    parts: NDArray[np.int64]
    quantum: NDArray[np.int64]
    codes: NDArray[np.uint16]
    strides: NDArray[np.uint32]
    units: tuple[int, int]
    interval: int


@final
class JpegBlocks:
    """Decoder of the blocks of one picture.

    Parameters
    ----------
    layout : JpegLayout
    data : bytes
        Data after the header.
    """

    __slots__ = ("_end", "_layout", "_level", "_place", "_state", "_words")

    def __init__(self, layout: JpegLayout, data: bytes) -> None:
        plain = np.frombuffer(data, np.uint8)
        self._words = np.empty(len(plain) // 4 + SLACK, np.uint32)
        self._end = fill_words(plain, self._words) + AHEAD
        self._layout = layout
        across, down = layout.units
        count = int((layout.parts[:, 0] * layout.parts[:, 1]).sum()) * across * down
        self._place = np.empty(count, np.int64)
        self._level = np.empty(count, np.int16)
        self._state = np.zeros(STATE, np.int64)
        self._state[-1] = layout.interval

    def luma(self, rows: slice, columns: slice) -> Gray | None:
        """Decode the brightness of a window, (height, width); None if the data are corrupt."""
        top, bottom, left, right = self._within(rows, columns)
        if not self._walked(bottom):
            return None
        plane, above, before = self._plane(0, top, bottom, left, right)
        return (
            None
            if plane is None
            else plane[top - above : bottom - above, left - before : right - before]
        )

    def colour(self, rows: slice, columns: slice) -> Picture | None:
        """Decode blue, green, red of a window, (height, width, 3); None if that is impossible."""
        top, bottom, left, right = self._within(rows, columns)
        if len(self._layout.parts) != 3 or not self._walked(bottom):
            return None
        planes, corners = [], np.empty((3, 2), np.int64)
        for part in range(3):
            plane, *corners[part] = self._plane(part, top, bottom, left, right)
            if plane is None:
                return None
            planes.append(plane)
        out = np.empty((bottom - top, right - left, 3), np.uint8)
        bgr_of(planes[0], planes[1], planes[2], corners, self._layout.parts, top, left, out)
        return out

    def _within(self, rows: slice, columns: slice) -> tuple[int, int, int, int]:
        width, height = self._layout.size
        top, bottom, _ = rows.indices(height)
        left, right, _ = columns.indices(width)
        return top, max(bottom, top), left, max(right, left)

    def _walked(self, bottom: int) -> bool:
        """Whether the starts of all blocks above a row of pixels were found, scanning as needed."""
        layout = self._layout
        tall = 8 * int(layout.parts[:, 1].max())
        until = -(-bottom // tall)
        if self._state[0] >= until:
            return True
        return bool(
            find_blocks(
                self._words,
                self._end,
                self._state,
                until,
                layout.units[0],
                layout.interval,
                layout.parts,
                layout.codes,
                layout.strides,
                self._place,
                self._level,
            )
        )

    def _plane(
        self, part: int, top: int, bottom: int, left: int, right: int
    ) -> tuple[Gray | None, int, int]:
        """Decode the blocks of a plane that cover a window; also return their first row, column."""
        parts = self._layout.parts
        across, down = parts[part, :2] * 8
        wide, tall = parts[:, :2].max(0) * 8
        first = int(left * across // wide) // 8, int(top * down // tall) // 8
        last = (
            int((right * across + wide - 1) // wide + 7) // 8,
            int((bottom * down + tall - 1) // tall + 7) // 8,
        )
        out = np.empty((8 * (last[1] - first[1]), 8 * (last[0] - first[0])), np.uint8)
        fine = read_blocks(
            self._words,
            self._place,
            self._level,
            parts[part],
            self._layout.quantum[part],
            self._layout.codes,
            NATURAL,
            first[0],
            first[1],
            out,
        )
        return (out if fine else None), 8 * first[1], 8 * first[0]


NATURAL: Final = np.array(_ORDER, dtype=np.int64)


def blocks_of(data: bytes) -> JpegBlocks | None:
    """Create a decoder of blocks; None for a picture of an unsupported kind.

    Supported are baseline pictures of 8 bits in one scan, with brightness alone or with the two
    colours of JFIF.
    """
    start = _scan(data)
    if start is None:
        return None
    layout = _layout(data[:start])
    return None if layout is None else JpegBlocks(layout, data[start:])


def _scan(data: bytes) -> int | None:
    """Offset of the compressed data, after all segments of the header; None if not found."""
    place = 2
    while place + 4 <= len(data) and data[place] == 0xFF:
        end = place + 2 + int.from_bytes(data[place + 2 : place + 4])
        if data[place + 1] == 0xDA:
            return end
        place = end
    return None


@functools.lru_cache(maxsize=8)
def _layout(head: bytes) -> JpegLayout | None:
    try:
        return _read_head(head)
    except (IndexError, KeyError, ValueError):
        return None


def _read_head(head: bytes) -> JpegLayout | None:
    quanta: dict[int, NDArray[np.int64]] = {}
    tables: dict[int, bytes] = {}
    frame = scan = b""
    interval, place = 0, 2
    while place < len(head):
        marker = head[place + 1]
        length = int.from_bytes(head[place + 2 : place + 4])
        content = head[place + 4 : place + 2 + length]
        place += 2 + length
        if marker == 0xDB:
            quanta |= _quanta(content)
        elif marker == 0xC4:
            tables |= _tables(content)
        elif marker == 0xDD:
            interval = int.from_bytes(content[:2])
        elif marker in (0xC0, 0xC1):
            frame = content
        elif marker == 0xDA:
            scan = content
        elif 0xC0 <= marker <= 0xCF or marker == 0xEE:  # another process, or Adobe's colours
            return None
    n = frame[5]
    if frame[0] != 8 or n not in (1, 3) or scan[0] != n or frame[6 : 6 + 3 * n : 3] == b"RGB":
        return None
    height, width = int.from_bytes(frame[1:3]), int.from_bytes(frame[3:5])
    parts, quantum = np.zeros((n, 6), np.int64), np.zeros((n, 64), np.int64)
    for k in range(n):
        name, sampling, table = frame[6 + 3 * k : 9 + 3 * k]
        if scan[1 + 2 * k] != name:
            return None
        chosen = scan[2 + 2 * k]
        # A single plane is coded block by block, whatever its sampling factors.
        parts[k, :2] = (sampling >> 4, sampling & 15) if n > 1 else (1, 1)
        parts[k, 5] = 2 * (chosen >> 4) + (chosen & 15)
        if max(chosen >> 4, chosen & 15) > 1:
            return None
        quantum[k] = quanta[table]
    most = parts[:, :2].max(0)
    if (
        not height
        or not width
        or parts[0, :2].tolist() != most.tolist()
        or (parts[:, :2] < 1).any()
    ):
        return None
    units = -(-width // (8 * int(most[0]))), -(-height // (8 * int(most[1])))
    first = 0
    for part in parts:
        part[2:5] = first, units[0] * part[0], units[1] * part[1]
        first += int(part[3] * part[4])
    codes, strides = _codes(tuple(sorted(tables.items())))
    return JpegLayout((width, height), parts, quantum, codes, strides, units, interval)


def _quanta(content: bytes) -> dict[int, NDArray[np.int64]]:
    found = {}
    while content:
        wide = content[0] >> 4
        kind = np.dtype(">u2") if wide else np.dtype(np.uint8)
        quantum = np.zeros(64, np.int64)
        quantum[NATURAL] = np.frombuffer(content, kind, 64, 1)
        found[content[0] & 15] = quantum
        content = content[1 + 64 * kind.itemsize :]
    return found


def _tables(content: bytes) -> dict[int, bytes]:
    """Code tables by class and number; each has 16 counts, then the meanings."""
    found = {}
    while content:
        end = 17 + sum(content[1:17])
        found[content[0]] = content[1:end]
        content = content[end:]
    return found


@functools.lru_cache(maxsize=8)
def _codes(
    tables: tuple[tuple[int, bytes], ...],
) -> tuple[NDArray[np.uint16], NDArray[np.uint32]]:
    codes = np.zeros((2, 2, 1 << 16), np.uint16)
    strides = np.zeros((2, 2, 1 << 13), np.uint32)
    for which, table in tables:
        kind, number = which >> 4, which & 15
        counts, meanings = np.frombuffer(table[:16], np.uint8), np.frombuffer(table[16:], np.uint8)
        if not fill_codes(counts, meanings, codes[kind, number]):
            raise ValueError("codes that are no codes")
        fill_strides(codes[kind, number], kind == 1, strides[kind, number])
    return codes, strides
