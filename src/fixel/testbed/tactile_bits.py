"""Assignment of the bits of the tactile board to fixels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.typing import BoolArray

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

MISSING: Final = -1  # value of a missing reading in an array

COLOURS: Final = ("blue", "red", "green")  # bits 0, 1, 2
# The laboratory stored its readings in the order green, red, blue, and its contact mode is
# 4 f1 + 2 f2 + f3: in this order the byte equals the mode.
FIXELS: Final = ("green", "red", "blue")  # fixels 1, 2, 3


def fixels_of(bits: int, order: tuple[str, str, str] = FIXELS) -> tuple[bool, bool, bool]:
    """Return whether fixels 1, 2, 3 are touched.

    Parameters
    ----------
    bits : int
        Bits of a reading.
    order : (str, str, str)
        Colours of fixels 1, 2, 3; by default in the order of the thesis.
    """
    one, two, three = (COLOURS.index(colour) for colour in _checked_order(order))
    return bool(bits >> one & 1), bool(bits >> two & 1), bool(bits >> three & 1)


def contact_mode(bits: int, order: tuple[str, str, str] = FIXELS) -> str:
    """Return one digit per fixel, as experiments store it: `"100"` if only fixel 1 is touched."""
    return "".join("1" if touched else "0" for touched in fixels_of(bits, order))


def contacts(readings: ArrayLike, order: tuple[str, str, str] = FIXELS) -> BoolArray:
    """Return touched fixels (n, 3) of readings (n,); a missing one (-1) touches nothing.

    Remove missing readings first where that matters.
    """
    bits = np.asarray(readings, np.int64)
    shifts = [COLOURS.index(colour) for colour in _checked_order(order)]
    return np.asarray((bits[:, None] >> shifts & 1).astype(np.bool_) & (bits != MISSING)[:, None])


def _checked_order(order: tuple[str, str, str]) -> tuple[str, str, str]:
    if sorted(order) != sorted(COLOURS):
        raise InvalidInput("order", found=order, expected="blue, red and green, each once")
    return order
