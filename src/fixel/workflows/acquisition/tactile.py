"""The tactile board from the command line: which port, is it in order, what does it feel?"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, final

from fixel.testbed.serial_port import PortSeen, found_ports
from fixel.testbed.tactile import DEADLINE, TactileReader
from fixel.testbed.tactile_reading import TactileReading
from fixel.typing import Progress

FRAME: Final = 1.0 / 30.0  # [s]
READINGS: Final = 300


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class TactileCheck:
    """How a board answered.

    Attributes
    ----------
    port : str
    protocol : int
    thresholds : (int, int, int), optional
        Of bits 0, 1, 2 [-].
    statistics : dict
        As `Statistics.summary` gives them.
    drift : float
        Rate of the host's clock over the board's, less 1 [-]; 0 where it tells no time.
    seconds : float
        What it took [s].
    deadline : float
        [s].
    trouble : str
        Why the board could be asked no longer; empty where it could.
    """

    port: str
    protocol: int
    thresholds: tuple[int, int, int] | None
    statistics: dict[str, Any]
    drift: float
    seconds: float
    deadline: float
    trouble: str

    @property
    def passed(self) -> bool:
        """Whether every request was answered in time and undamaged."""
        return bool(self.statistics["answered"] == self.statistics["asked"])

    def summary(self) -> dict[str, Any]:
        """As plain values."""
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


def serial_ports() -> list[PortSeen]:
    """The serial ports of this computer."""
    return found_ports()


def check_tactile(
    port: str | None,
    *,
    readings: int = READINGS,
    deadline: float = DEADLINE,
    progress: Progress | None = None,
) -> TactileCheck:
    """Ask as often as told, as fast as it goes, and count what came back."""
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
    """A reading every interval, until the time is over or the caller has seen enough; a pulled
    plug is waited for."""
    with TactileReader(port, thresholds=thresholds) as reader:
        start = due = time.monotonic()
        while duration is None or due - start < duration:
            yield reader, reader.read()
            if not reader.connected:
                time.sleep(0.5)
                reader.reconnect()
            due = max(due + interval, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))
