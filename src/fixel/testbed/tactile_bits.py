"""Which bit of the tactile board is which fixel."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.typing import BoolArray

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

MISSING: Final = -1  # a reading that was not to be had, among numbers

COLOURS: Final = ("blue", "red", "green")  # bits 0, 1, 2
# The laboratory stored its readings in the order green, red, blue, and its contact mode is
# 4 f1 + 2 f2 + f3: with that, the byte is the mode.
FIXELS: Final = ("green", "red", "blue")  # fixels 1, 2, 3


def fixels_of(bits: int, order: tuple[str, str, str] = FIXELS) -> tuple[bool, bool, bool]:
    """Which of the fixels 1, 2, 3 are touched.

    Parameters
    ----------
    bits : int
        Of a reading.
    order : (str, str, str)
        The colours of fixels 1, 2, 3; left out, the order in which the thesis stored them.
    """
    one, two, three = (COLOURS.index(colour) for colour in _checked_order(order))
    return bool(bits >> one & 1), bool(bits >> two & 1), bool(bits >> three & 1)


def contact_mode(bits: int, order: tuple[str, str, str] = FIXELS) -> str:
    """A digit a fixel, as experiments keep it: `"100"` where fixel 1 alone is touched."""
    return "".join("1" if touched else "0" for touched in fixels_of(bits, order))


def contacts(readings: ArrayLike, order: tuple[str, str, str] = FIXELS) -> BoolArray:
    """(n, 3) which fixels are touched, of (n,) readings; a missing one (-1) touches nothing.

    Leave missing readings out beforehand where that matters.
    """
    bits = np.asarray(readings, np.int64)
    shifts = [COLOURS.index(colour) for colour in _checked_order(order)]
    return np.asarray((bits[:, None] >> shifts & 1).astype(np.bool_) & (bits != MISSING)[:, None])


def _checked_order(order: tuple[str, str, str]) -> tuple[str, str, str]:
    if sorted(order) != sorted(COLOURS):
        raise InvalidInput("order", found=order, expected="blue, red and green, each once")
    return order
