"""What the tactile board said, and how the conversation with it went."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from statistics import median
from typing import Any, Final, final

KEPT: Final = 4096  # round trips that the statistics remember


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class TactileReading:
    """What the fixels said, once.

    Attributes
    ----------
    bits : int, optional
        Bit 0 blue, bit 1 red, bit 2 green, set where touched; none where the board gave no answer.
    time : float
        When the fixels were read, on `time.monotonic` [s].
    device_time : float, optional
        The same on the board's clock [s]; only boards of protocol 2 tell.
    values : (int, int, int), optional
        What the converter saw at bits 0, 1, 2 [-], 1023 at 5 V; likewise.
    problem : str
        Why there are no bits, or why they are to be doubted; empty if all is well.
    """

    bits: int | None
    time: float
    device_time: float | None = None
    values: tuple[int, int, int] | None = None
    problem: str = ""


@final
@dataclass(slots=True, kw_only=True)
class Statistics:
    """How the conversation went.

    Attributes
    ----------
    asked, answered : int
        Requests, and those answered in time and undamaged.
    missing : int
        Requests without an answer until the deadline.
    late : int
        Answers that came after their deadline.
    garbled : int
        Requests that something unreadable came back to.
    stray_bytes : int
        Bytes that belonged to no answer.
    restarts : int
        How often the board began anew.
    round_trips : deque of float
        The last of them [s].
    """

    asked: int = 0
    answered: int = 0
    missing: int = 0
    late: int = 0
    garbled: int = 0
    stray_bytes: int = 0
    restarts: int = 0
    round_trips: deque[float] = field(default_factory=lambda: deque(maxlen=KEPT))

    def summary(self) -> dict[str, Any]:
        """As plain values."""
        counts = ("asked", "answered", "missing", "late", "garbled", "stray_bytes", "restarts")
        trips = self.round_trips
        return {name: getattr(self, name) for name in counts} | {
            "round_trip_median_s": median(trips) if trips else None,
            "round_trip_max_s": max(trips) if trips else None,
        }
