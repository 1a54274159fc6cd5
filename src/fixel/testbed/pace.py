"""Measured frame rate, and gaps between frames."""

from __future__ import annotations

from collections import deque
from typing import Final, final

LATE: Final = 2.5  # intervals this many times the mean one are gaps
WINDOW: Final = 61  # frames over which the rate is computed


@final
class FrameRate:
    """Running measurement of the rate of frames and of gaps between them.

    Attributes
    ----------
    gaps : int
        Number of intervals much longer than usual, in which frames were lost before arrival.
    longest : float
        Longest gap [s].
    longest_at : float
        Beginning of the longest gap [s].
    """

    def __init__(self) -> None:
        self.gaps = 0
        self.longest = 0.0
        self.longest_at = 0.0
        self._times: deque[float] = deque(maxlen=WINDOW)

    def tick(self, time: float) -> None:
        """Record the time of a frame [s]."""
        times = self._times
        if len(times) > WINDOW // 4:
            step, usual = time - times[-1], (times[-1] - times[0]) / (len(times) - 1)
            if step > LATE * usual:
                self.gaps += 1
                if step > self.longest:
                    self.longest, self.longest_at = step, times[-1]
        times.append(time)

    @property
    def rate(self) -> float:
        """Mean rate of the last frames [frames/s]; 0 before the second frame."""
        times = self._times
        span = times[-1] - times[0] if len(times) > 1 else 0.0
        return (len(times) - 1) / span if span > 0.0 else 0.0

    def sentence(self) -> str:
        """Return a sentence about the gaps; empty without gaps."""
        if not self.gaps:
            return ""
        plural = "" if self.gaps == 1 else "s"
        return (
            f"{self.gaps} gap{plural} between frames; the longest is {self.longest * 1e3:.0f} ms, "
            f"after t = {self.longest_at:.3f} s"
        )
