"""Check and watch the tactile board."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

from fixel.testbed.tactile import DEADLINE, TactileReader, TactileReading
from fixel.typing import ProgressCallback

FRAME: Final = 1.0 / 30.0  # [s]
READINGS: Final = 300


class TactileCheck(NamedTuple):
    """Result of checking a tactile board."""

    port: str
    protocol: int
    thresholds: tuple[int, int, int] | None  # thresholds of bits 0, 1, 2 [-]
    statistics: dict[str, Any]  # as `Statistics.summary` gives them
    # Rate of the host's clock over the board's, minus 1 [-]; 0 if the board reports no time.
    drift: float
    seconds: float  # duration of the check [s]
    deadline: float  # longest time allowed for an answer [s]
    trouble: str  # why the board stopped answering; empty if it did not

    @property
    def passed(self) -> bool:
        """Whether every request was answered in time and undamaged."""
        return bool(self.statistics["answered"] == self.statistics["asked"])

    def summary(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        return {
            "port": self.port,
            "passed": self.passed,
            "protocol": self.protocol,
            "thresholds": self.thresholds,
            "drift": self.drift,
            "seconds": self.seconds,
            "deadline_s": self.deadline,
            "trouble": self.trouble,
            **self.statistics,
        }


def check_tactile(
    port: str | None,
    *,
    readings: int = READINGS,
    deadline: float = DEADLINE,
    progress: ProgressCallback | None = None,
) -> TactileCheck:
    """Request a number of readings as fast as possible and count the answers."""
    start = time.perf_counter()
    with TactileReader(port, deadline=deadline) as reader:
        protocol = reader.protocol
        for k in range(readings):
            if reader.read().bits is None and not reader.connected:
                break
            if progress is not None:
                progress(k + 1, readings)
        return TactileCheck(
            port=reader.port,
            protocol=protocol,
            thresholds=reader.identity.thresholds if reader.identity else None,
            statistics=reader.statistics.summary(),
            drift=reader.clock.drift,
            seconds=time.perf_counter() - start,
            deadline=deadline,
            trouble=reader.trouble,
        )


def watch_tactile(
    port: str | None,
    *,
    interval: float = FRAME,
    duration: float | None = None,
    thresholds: tuple[int, int, int] | None = None,
) -> Iterator[tuple[TactileReader, TactileReading]]:
    """Yield one reading per interval until the duration is over or the caller stops; reconnect
    after a pulled plug."""
    with TactileReader(port, thresholds=thresholds) as reader:
        start = due = time.monotonic()
        while duration is None or due - start < duration:
            yield reader, reader.read()
            if not reader.connected:
                time.sleep(0.5)
                reader.reconnect()
            due = max(due + interval, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))
