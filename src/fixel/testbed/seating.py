"""Detection of a seated part: it touches the right fixels, or motion has ended."""

from __future__ import annotations

from typing import Final, final

import numpy as np

from fixel.vision.frame import Gray

STEADY: Final = 0.5  # [s] for which the fixels must report the same
REST_SECONDS: Final = 1.0  # [s] without motion, once something has moved
LOOK: Final = 0.2  # [s] between two pictures compared
CHANGE: Final = 6  # [grey levels] of a cell of 8 x 8 pixels: noise is less than one
CELLS: Final = 3  # must change for motion; a part of one centimetre is about two cells wide


@final
class Seating:
    """Detector of a seated part from readings and pictures.

    Parameters
    ----------
    mode : int, optional
        Bits of the contacts wanted. None: only the pictures decide.
    """

    def __init__(self, mode: int | None = None) -> None:
        self.mode = mode
        self._same_since = 0.0
        self._bits: int | None = None
        self._looked = -LOOK
        self._before: Gray | None = None
        self._moved_at: float | None = None

    def touched(self, time: float, bits: int | None) -> str:
        """Return why the part is seated by the fixels at a time [s]; empty if it is not."""
        if bits is None:  # a missing reading changes nothing
            return ""
        if bits != self._bits:
            self._bits, self._same_since = bits, time
        if self.mode is None or bits != self.mode or time - self._same_since < STEADY:
            return ""
        return f"seated: contact mode {bits:03b} for {STEADY:g} s"

    def wants_look(self, time: float) -> bool:
        """Whether it is time to compare the next picture."""
        return time - self._looked >= LOOK

    def looked(self, time: float, small: Gray) -> str:
        """Return why the part is seated by the pictures; empty if it is not."""
        before, self._before, self._looked = self._before, small, time
        if before is None:
            return ""
        if _moved(before, small):
            self._moved_at = time
        if self._moved_at is None or time - self._moved_at < REST_SECONDS:
            return ""
        return f"seated: no motion for {REST_SECONDS:g} s"


def _moved(before: Gray, now: Gray) -> bool:
    """Whether two pictures differ by more than light and noise."""
    change = now.astype(np.int16) - before
    change -= np.int16(np.median(change))
    return int((np.abs(change) > CHANGE).sum()) > CELLS
