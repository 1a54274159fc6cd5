"""Capture times of a camera, on the clock of this computer."""

from __future__ import annotations

import math
from collections import deque
from typing import Final, final

HELD: Final = 300  # frames over which the shortest delay is taken: clocks drift meanwhile
DELAY: Final = 1.0  # [s] largest age of a stamp of this computer's clock
RESET: Final = 5.0  # [s] of change in the delay: the camera's clock was set


@final
class CaptureClock:
    """Conversion of a camera's time stamps to `time.monotonic`.

    Cameras under Linux stamp their frames on the clock of `time.monotonic`; these stamps are used
    as they are. Other clocks are tied to it by the shortest delay between stamp and arrival of the
    last `HELD` frames, as the Network Time Protocol does (Mills 1991): excess delay is latency.
    Stamps that do not increase are ignored.
    """

    def __init__(self) -> None:
        self._last = -math.inf
        self._delays: deque[float] = deque(maxlen=HELD)
        self._shared: bool | None = None

    def place(self, stamp: float | None, arrival: float) -> float | None:
        """Return the capture time of a frame from stamp and arrival [s]; None without a stamp."""
        if stamp is None or not math.isfinite(stamp) or not stamp > 0.0:
            return None
        delay = arrival - stamp
        if not stamp > self._last or (self._delays and abs(delay - min(self._delays)) > RESET):
            self._delays.clear()
            self._shared = None
            if stamp == self._last:
                return None
        self._last = stamp
        self._delays.append(delay)
        if self._shared is None:
            self._shared = 0.0 <= delay <= DELAY
        return stamp if self._shared and delay >= 0.0 else stamp + min(self._delays)
