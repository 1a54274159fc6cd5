"""Conversion of the time stamps of boards and cameras to the clock of this computer."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Final

WRAP: Final = 2**32  # the device counts microseconds in 32 bits: 71.6 minutes
BIN: Final = 0.5  # [s] the shortest exchange of each such interval is stored
BINS: Final = 60
FLOOR: Final = 50e-6  # [s] smallest uncertainty that an exchange is given
STRANGE: Final = 0.05  # [s] a device this far from where its clock should be has restarted
HELD: Final = 300  # frames over which the shortest delay is taken: clocks drift meanwhile
DELAY: Final = 1.0  # [s] largest age of a stamp of this computer's clock
RESET: Final = 5.0  # [s] of change in the delay: the camera's clock was set


@dataclass(slots=True)
class DeviceClock:
    """Offset and drift between the clock of a device and that of the host.

    The device takes its time stamp between the request and its answer; the transmission time of
    the bytes narrows this interval. The exchange with the narrowest interval of every half second
    is stored, as the Network Time Protocol does (Mills 1991). A line through the stored exchanges,
    weighted by the width of their intervals, gives offset and drift. Results are clipped to the
    interval of their own exchange, which bounds the error of a bad line.
    """

    # Rate of the host's clock over that of the device, less 1 [-]; 0 until known. A Mega's ceramic
    # resonator may be off by 0.005.
    drift: float = 0.0
    # Half the narrowest interval of the stored exchanges [s]: largest error of the offset.
    room: float = math.inf
    restarts: int = 0  # number of times that the device restarted its count
    # Of each exchange: time on the device, middle on the host, half its length [s].
    _kept: list[tuple[float, float, float]] = field(default_factory=list)
    _bin: int = -1
    _last_ticks: int | None = None
    _turns: int = 0
    _centre: tuple[float, float] = (0.0, 0.0)

    def place(self, ticks: int, earliest: float, latest: float) -> tuple[float, float]:
        """Return the device's time, with its wraps counted, and the host's, of one exchange [s].

        The device has counted `ticks` [us], in 32 bits, between `earliest` and `latest` on the
        host's clock [s].
        """
        earliest, latest = min(earliest, latest), max(earliest, latest)
        last_ticks, last_turns = self._last_ticks, self._turns
        device = self._unwrapped(ticks)
        went_back = last_ticks is not None and device < 1e-6 * (last_ticks + WRAP * last_turns)
        if self._kept and (went_back or not self._plausible(device, earliest, latest)):
            self._restart()
            device = self._unwrapped(ticks)
        self._keep(device, 0.5 * (earliest + latest), 0.5 * (latest - earliest))
        centre, apart = self._centre
        host = device + apart + self.drift * (device - centre)
        return device, min(max(host, earliest), latest)

    def _unwrapped(self, ticks: int) -> float:
        if self._last_ticks is not None and ticks < self._last_ticks - WRAP // 2:
            self._turns += 1
        self._last_ticks = ticks
        return 1e-6 * (ticks + WRAP * self._turns)

    def _plausible(self, device: float, earliest: float, latest: float) -> bool:
        last, middle, half = self._kept[-1]
        # After a long silence, a drift of 0.5 % exceeds the change that a restart causes.
        allowed = STRANGE + half + 0.01 * abs(latest - middle)
        expected = middle + (device - last)
        return earliest - allowed <= expected <= latest + allowed

    def _restart(self) -> None:
        self.restarts += 1
        self.drift, self.room = 0.0, math.inf
        self._kept.clear()
        self._bin, self._last_ticks, self._turns = -1, None, 0

    def _keep(self, device: float, middle: float, half: float) -> None:
        number = math.floor(middle / BIN)
        if number != self._bin:
            self._bin = number
            self._kept.append((device, middle, half))
            del self._kept[:-BINS]
        elif half < self._kept[-1][2]:
            self._kept[-1] = device, middle, half
        else:
            return
        self._draw_line()

    def _draw_line(self) -> None:
        rows = [(1.0 / (half + FLOOR) ** 2, at, middle - at) for at, middle, half in self._kept]
        total = sum(w for w, _, _ in rows)
        device = sum(w * at for w, at, _ in rows) / total
        apart = sum(w * ahead for w, _, ahead in rows) / total
        spread = sum(w * (at - device) ** 2 for w, at, _ in rows)
        self.drift = 0.0
        if len(self._kept) > 2 and spread > 0.0:
            self.drift = sum(w * (at - device) * (ahead - apart) for w, at, ahead in rows) / spread
        self._centre = (device, apart)
        self.room = min(half for _, _, half in self._kept)


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
