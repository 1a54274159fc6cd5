"""Readings of the tactile board, and statistics of the communication."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from statistics import median
from typing import Any, Final, final

KEPT: Final = 4096  # round trips stored in the statistics


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class TactileReading:
    """One reading of the fixels.

    Attributes
    ----------
    bits : int, optional
        Bit 0 blue, bit 1 red, bit 2 green, set where touched; None without an answer.
    time : float
        Time of the reading, on `time.monotonic` [s].
    device_time : float, optional
        The same on the board's clock [s]; None for protocol 1.
    values : (int, int, int), optional
        Converter values of bits 0, 1, 2 [-], 1023 at 5 V; None for protocol 1.
    problem : str
        Why there are no bits, or why they are doubtful; empty otherwise.
    """

    bits: int | None
    time: float
    device_time: float | None = None
    values: tuple[int, int, int] | None = None
    problem: str = ""


@final
@dataclass(slots=True, kw_only=True)
class Statistics:
    """Statistics of the communication with the board.

    Attributes
    ----------
    asked, answered : int
        Number of requests, and of those answered in time and undamaged.
    missing : int
        Number of requests without an answer until the deadline.
    late : int
        Number of answers after their deadline.
    garbled : int
        Number of requests with an unreadable answer.
    stray_bytes : int
        Number of bytes that belonged to no answer.
    restarts : int
        Number of restarts of the board.
    round_trips : deque of float
        Last round-trip times [s].
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
        """Return the statistics as plain values."""
        counts = ("asked", "answered", "missing", "late", "garbled", "stray_bytes", "restarts")
        trips = self.round_trips
        return {name: getattr(self, name) for name in counts} | {
            "round_trip_median_s": median(trips) if trips else None,
            "round_trip_max_s": max(trips) if trips else None,
        }
