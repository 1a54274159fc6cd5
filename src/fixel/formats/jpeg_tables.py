"""Compiled preparation of the input of `jpeg_loops`: data as words, and code tables."""

from typing import Any

import numpy as np

from fixel.formats.jpeg_loops import Codes, Strides, Words
from fixel.kernels.jit import entry
from fixel.vision.frame import Gray

whole: Any = np.int64


@entry
def fill_words(data: Gray, words: Words) -> int:
    """Write the data as words, without the stuffed zero after each 255.

    Returns
    -------
    int
        Number of words; zeros follow.
    """
    n, count, word = 0, 0, 0
    stuffed = False
    for k in range(len(data)):
        byte = whole(data[k])
        if byte == 0 and stuffed:
            stuffed = False
            continue
        stuffed = byte == 255
        word = word << 8 | byte
        count += 1
        if count == 4:
            words[n] = word
            n += 1
            count, word = 0, 0
    words[n] = word << 8 * (4 - count)
    words[n + 1 :] = 0
    return n + 1


@entry
def fill_codes(counts: Gray, meanings: Gray, codes: Codes) -> bool:
    """Write length (high byte) and meaning (low byte) of the code at the start of every 16 bits."""
    code, used = 0, 0
    for length in range(1, 17):
        for _ in range(counts[length - 1]):
            if used >= len(meanings) or code >= 1 << length:
                return False
            start = code << (16 - length)
            for bits in range(start, start + (1 << (16 - length))):
                codes[bits] = 256 * length + whole(meanings[used])
            code += 1
            used += 1
        code <<= 1
    return True


@entry
def fill_strides(codes: Codes, many: bool, strides: Strides) -> None:
    """Write, for every 13 bits, how far the codes that lie wholly within them reach.

    The lowest byte has the number of bits, including the value of the last code. The next byte has
    the number of coefficients, and the bit above it is set if the block ends there. 0 means that
    the first code is longer. For a first coefficient (not `many`), the second byte is its meaning.
    """
    for start in range(len(strides)):
        used, passed, ended = 0, 0, 0
        while used < 13:
            code = whole(codes[((start << used) & 8191) << 3])
            length, meaning = code >> 8, code & 255
            if length == 0 or used + length > 13:
                break
            if not many:
                used, passed = length, meaning
                break
            if meaning == 0:
                used += length
                ended = 1
                break
            if meaning & 15 == 0 and meaning != 0xF0:
                break
            if passed + (meaning >> 4) + 1 > 63:
                break
            used += length + (meaning & 15)
            passed += (meaning >> 4) + 1
        strides[start] = used | passed << 8 | ended << 16
