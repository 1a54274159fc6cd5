"""How regularly frames come."""

from __future__ import annotations

from collections import deque
from typing import Final, final

LATE: Final = 2.5  # a step this many times the usual one is a gap
WINDOW: Final = 61  # frames over which a rate is formed


@final
class FrameRate:
    """Rate of the frames, and gaps between them.

    Attributes
    ----------
    gaps : int
        Steps much longer than usual: the camera, or the way from it, left frames out.
    longest : float
        The longest of them [s].
    longest_at : float
        When that was [s].
    """

    def __init__(self) -> None:
        self.gaps = 0
        self.longest = 0.0
        self.longest_at = 0.0
        self._times: deque[float] = deque(maxlen=WINDOW)

    def tick(self, time: float) -> None:
        """A frame came, at a time [s]."""
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
        """Over the last frames [frames/s], 0 before the second."""
        times = self._times
        span = times[-1] - times[0] if len(times) > 1 else 0.0
        return (len(times) - 1) / span if span > 0.0 else 0.0

    def sentence(self) -> str:
        """About the gaps; empty where there are none."""
        if not self.gaps:
            return ""
        plural = "" if self.gaps == 1 else "s"
        return (
            f"{self.gaps} gap{plural} between frames; the longest is {self.longest * 1e3:.0f} ms, "
            f"after t = {self.longest_at:.3f} s"
        )
