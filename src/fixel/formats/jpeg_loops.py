"""Compiled loops of `jpeg_blocks`.

As in the kernels, they use arrays and numbers only, and a status instead of exceptions. A buffer of
64 bits has the next bit highest. It has at least 33 bits before each code; a code and its value
have at most 31.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fixel.kernels.jit import entry, kernel
from fixel.vision.frame import Gray, Picture

STATE = 6  # rows of units scanned, bits scanned, three levels, units to the next restart

Words = NDArray[np.uint32]
Codes = NDArray[np.uint16]
Strides = NDArray[np.uint32]
Whole = NDArray[np.int64]

# Mixed with signed integers, unsigned ones become floats; `whole` converts them first.
whole: Any = np.int64
U32, U48, U51 = np.uint64(32), np.uint64(48), np.uint64(51)

# The transform's constants, in units of 2^-13.
C0298, C0390, C0541, C0765, C0899, C1175 = 2446, 3196, 4433, 6270, 7373, 9633
C1501, C1847, C1961, C2053, C2562, C3072 = 12299, 15137, 16069, 16819, 20995, 25172


@kernel
def _value(bits: int, size: int) -> int:
    """Signed value of `size` bits, as JPEG codes coefficients."""
    return bits if bits >= 1 << (size - 1) else bits - (1 << size) + 1


@entry
def find_blocks(
    words: Words,
    limit: int,
    state: Whole,
    until: int,
    across: int,
    interval: int,
    parts: Whole,
    codes: Codes,
    strides: Strides,
    place: Whole,
    level: NDArray[np.int16],
) -> bool:
    """Continue to scan rows of units; store the place and first coefficient of each block.

    Parameters
    ----------
    words : (n,) uint32
        Compressed data, most significant bit first.
    limit : int
        Index of the first word after the data.
    state : (STATE,) int64
        State of the scan; modified.
    until : int
        Row of units at which the scan stops.
    across : int
        Units in a row.
    interval : int
        Units between restarts, 0 for none.
    parts, codes, strides
        See `JpegLayout`.
    place : (n,) int64
        Position of the bit after the first coefficient of each block; modified.
    level : (n,) int16
        First coefficient of each block; modified.

    Returns
    -------
    bool
        Whether the data are valid.
    """
    n = len(parts)
    first, second, third = state[2], state[3], state[4]
    left = state[5]
    at = state[1] >> 5
    gone = state[1] & 31
    buffer = (np.uint64(words[at]) << U32 | np.uint64(words[at + 1])) << np.uint64(gone)
    have = 64 - gone
    at += 2
    for row in range(state[0], until):
        for column in range(across):
            if interval > 0:
                if left == 0:
                    bit = (at * 32 - have + 7) & ~7
                    at, gone = bit >> 5, bit & 31
                    if at >= limit:
                        return False
                    buffer = (np.uint64(words[at]) << U32 | np.uint64(words[at + 1])) << np.uint64(
                        gone
                    )
                    if whole(buffer >> U51) != 0xFFD0 >> 3:
                        return False
                    buffer <<= np.uint64(16)
                    have = 48 - gone
                    at += 2
                    first, second, third = 0, 0, 0
                    left = interval
                left -= 1
            for part in range(n):
                which = parts[part, 5]
                zero, others = which >> 1, which & 1
                for below in range(parts[part, 1]):
                    for beside in range(parts[part, 0]):
                        if at > limit:
                            return False
                        if have <= 32:
                            buffer |= np.uint64(words[at]) << np.uint64(32 - have)
                            at += 1
                            have += 32
                        stride = whole(strides[0, zero, whole(buffer >> U51)])
                        size, length = stride >> 8, stride & 255
                        if stride == 0:
                            code = whole(codes[0, zero, whole(buffer >> U48)])
                            size, length = code & 255, code >> 8
                            if length == 0:
                                return False
                        if size > 15:
                            return False
                        buffer <<= np.uint64(length)
                        change = 0
                        if size > 0:
                            change = _value(whole(buffer >> np.uint64(64 - size)), size)
                            buffer <<= np.uint64(size)
                        have -= length + size
                        if part == 0:
                            first += change
                            value = first
                        elif part == 1:
                            second += change
                            value = second
                        else:
                            third += change
                            value = third
                        block = (
                            parts[part, 2]
                            + (row * parts[part, 1] + below) * parts[part, 3]
                            + column * parts[part, 0]
                            + beside
                        )
                        place[block] = at * 32 - have
                        level[block] = value
                        k = 1
                        while k < 64:
                            if have <= 32:
                                buffer |= np.uint64(words[at]) << np.uint64(32 - have)
                                at += 1
                                have += 32
                            stride = whole(strides[1, others, whole(buffer >> U51)])
                            after = k + ((stride >> 8) & 255)
                            ended = stride >> 16
                            if stride != 0 and after + ended <= 64:
                                buffer <<= np.uint64(stride & 255)
                                have -= stride & 255
                                if ended:
                                    break
                                k = after
                                continue
                            code = whole(codes[1, others, whole(buffer >> U48)])
                            length, size = code >> 8, code & 15
                            if length == 0:
                                return False
                            buffer <<= np.uint64(length + size)
                            have -= length + size
                            if size == 0 and code & 255 != 0xF0:
                                break
                            k += ((code >> 4) & 15) + 1
                        if k > 64:
                            return False
        state[0] = row + 1
        state[1] = at * 32 - have
        state[2], state[3], state[4], state[5] = first, second, third, left
    return True


@kernel
def _transform(block: Whole, start: int, step: int, shift: int) -> None:
    """Inverse cosine transform of eight numbers, in place."""
    a, b = block[start + 2 * step], block[start + 6 * step]
    z1 = (a + b) * C0541
    t2, t3 = z1 - b * C1847, z1 + a * C0765
    a, b = block[start], block[start + 4 * step]
    t0, t1 = (a + b) << 13, (a - b) << 13
    e0, e3, e1, e2 = t0 + t3, t0 - t3, t1 + t2, t1 - t2
    t0, t1 = block[start + 7 * step], block[start + 5 * step]
    t2, t3 = block[start + 3 * step], block[start + step]
    z1, z2, z3, z4 = t0 + t3, t1 + t2, t0 + t2, t1 + t3
    z5 = (z3 + z4) * C1175
    z1, z2 = -z1 * C0899, -z2 * C2562
    z3, z4 = z5 - z3 * C1961, z5 - z4 * C0390
    t0 = t0 * C0298 + z1 + z3
    t1 = t1 * C2053 + z2 + z4
    t2 = t2 * C3072 + z2 + z3
    t3 = t3 * C1501 + z1 + z4
    half = 1 << (shift - 1)
    block[start] = (e0 + t3 + half) >> shift
    block[start + 7 * step] = (e0 - t3 + half) >> shift
    block[start + step] = (e1 + t2 + half) >> shift
    block[start + 6 * step] = (e1 - t2 + half) >> shift
    block[start + 2 * step] = (e2 + t1 + half) >> shift
    block[start + 5 * step] = (e2 - t1 + half) >> shift
    block[start + 3 * step] = (e3 + t0 + half) >> shift
    block[start + 4 * step] = (e3 - t0 + half) >> shift


@entry
def read_blocks(
    words: Words,
    place: Whole,
    level: NDArray[np.int16],
    part: Whole,
    quantum: Whole,
    codes: Codes,
    order: Whole,
    left: int,
    top: int,
    out: Gray,
) -> bool:
    """Decode the blocks of a plane into `out`, from column `left` and row `top` of blocks on.

    Returns
    -------
    bool
        Whether the data are valid.
    """
    others = part[5] & 1
    block = np.empty(64, np.int64)
    for row in range(out.shape[0] // 8):
        for column in range(out.shape[1] // 8):
            number = part[2] + (top + row) * part[3] + left + column
            block[:] = 0
            block[0] = level[number] * quantum[0]
            at = place[number] >> 5
            gone = place[number] & 31
            buffer = (np.uint64(words[at]) << U32 | np.uint64(words[at + 1])) << np.uint64(gone)
            have = 64 - gone
            at += 2
            k = 1
            while k < 64:
                if have <= 32:
                    buffer |= np.uint64(words[at]) << np.uint64(32 - have)
                    at += 1
                    have += 32
                code = whole(codes[1, others, whole(buffer >> U48)])
                length, size = code >> 8, code & 15
                if length == 0:
                    return False
                buffer <<= np.uint64(length)
                if size == 0:
                    have -= length
                    if code & 255 != 0xF0:
                        break
                    k += 16
                    continue
                k += (code >> 4) & 15
                if k > 63:
                    return False
                where = order[k]
                block[where] = quantum[where] * _value(whole(buffer >> np.uint64(64 - size)), size)
                buffer <<= np.uint64(size)
                have -= length + size
                k += 1
            for i in range(8):
                _transform(block, i, 8, 11)
            for i in range(8):
                _transform(block, 8 * i, 1, 18)
                for j in range(8):
                    out[8 * row + i, 8 * column + j] = min(max(block[8 * i + j] + 128, 0), 255)
    return True


@entry
def bgr_of(
    luma: Gray,
    blue: Gray,
    red: Gray,
    corners: Whole,
    parts: Whole,
    top: int,
    left: int,
    out: Picture,
) -> None:
    """Write blue, green and red of a window at `top`, `left`, from planes at `corners`."""
    across, down = parts[0, 0], parts[0, 1]
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            y = whole(luma[top + row - corners[0, 0], left + column - corners[0, 1]])
            u = (
                whole(
                    blue[
                        (top + row) * parts[1, 1] // down - corners[1, 0],
                        (left + column) * parts[1, 0] // across - corners[1, 1],
                    ]
                )
                - 128
            )
            v = (
                whole(
                    red[
                        (top + row) * parts[2, 1] // down - corners[2, 0],
                        (left + column) * parts[2, 0] // across - corners[2, 1],
                    ]
                )
                - 128
            )
            out[row, column, 0] = min(max(y + ((116130 * u + 32768) >> 16), 0), 255)
            out[row, column, 1] = min(max(y + ((32768 - 22554 * u - 46802 * v) >> 16), 0), 255)
            out[row, column, 2] = min(max(y + ((91881 * v + 32768) >> 16), 0), 255)
