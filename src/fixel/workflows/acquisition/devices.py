"""Check and watch the tactile board; home the actuator, move it and report its position."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from fixel.errors import InvalidInput, check_name
from fixel.testbed.grbl_link import checked_axes
from fixel.testbed.motion import AbstractActuator, ManualActuator, SimulatedActuator
from fixel.testbed.motion_grbl import GrblActuator
from fixel.testbed.tactile import TactileReader, TactileReading
from fixel.typing import Notify, ProgressCallback


class ActuatorAnswer(NamedTuple):
    """Position and state of the drive after a command."""

    driver: str
    position_m: float  # position of the drive
    place_m: tuple[float, ...]  # coordinate of each axis
    reach_m: tuple[float, float]  # range of positions
    state: str  # state as the controller names it; empty if it names none
    seconds: float  # duration of the command [s]
    zero_known: bool  # as the property of `AbstractActuator`


def chosen_actuator(
    driver: str,
    port: str | None,
    *,
    axes: str = "X",
    notify: Notify = print,
    dead_man: float | None = None,
    keys: bool = True,
) -> AbstractActuator:
    """Create the driver called `grbl`, `manual` or `simulated`, for axes such as `XY`.

    With `keys`, any key on the terminal stops a drive with a controller.
    """
    if driver == GrblActuator.name:
        return GrblActuator(port, axes=axes, keys=keys, dead_man=dead_man)
    check_name("driver", driver, (GrblActuator.name, ManualActuator.name, SimulatedActuator.name))
    if port is not None:
        raise InvalidInput("port", found=repr(port), expected=f"none with the driver {driver}")
    if driver == SimulatedActuator.name:
        return SimulatedActuator(n_axes=len(checked_axes(axes)))
    if len(axes) > 1:
        raise InvalidInput("axes", found=axes, expected="one axis with --driver manual")
    return ManualActuator(notify=notify, ask=_asking(notify))


def _asking(notify: Notify) -> Callable[[str], str]:
    """Return an `input` that prompts through the notifier: stdout may be used for the answer."""

    def ask(sentence: str) -> str:
        notify(sentence)
        return input()

    return ask


def move_actuator(
    actuator: AbstractActuator,
    *,
    to: float | tuple[float, ...] | None,
    by: float | tuple[float, ...] | None,
    speed: float,
    unlock: bool = False,
) -> ActuatorAnswer:
    """Move the drive and return when it has arrived [m, m/s]; several numbers are for its axes."""

    def move() -> None:
        if unlock and isinstance(actuator, GrblActuator):
            actuator.unlock()
        if isinstance(to, tuple) and by is None:
            actuator.go(to, speed=speed)
        elif isinstance(by, tuple) and to is None:
            actuator.go(np.add(actuator.place(), by), speed=speed)
        else:
            actuator.move(to=to, by=by, speed=speed)  # type: ignore[arg-type]

    return commanded(actuator, move)


def commanded(
    actuator: AbstractActuator, command: Callable[[], None] = lambda: None
) -> ActuatorAnswer:
    """Connect to a drive, carry out a command such as `actuator.home`, and return where it is."""
    start = time.perf_counter()
    with actuator:
        command()
        return ActuatorAnswer(
            driver=actuator.name,
            position_m=actuator.position(),
            place_m=tuple(actuator.place().tolist()),
            reach_m=actuator.reach,
            state=actuator.state if isinstance(actuator, GrblActuator) else "",
            seconds=time.perf_counter() - start,
            zero_known=actuator.zero_known,
        )


class TactileCheck(NamedTuple):
    """Result of checking a tactile board."""

    port: str
    protocol: int
    thresholds: tuple[int, int, int] | None  # thresholds of bits 0, 1, 2 [-]
    statistics: dict[str, Any]  # as `Statistics.summary` gives them
    # Rate of the host's clock over the board's, minus 1 [-]; 0 if the board reports no time.
    drift: float
    seconds: float  # duration of the check [s]
    deadline_s: float  # longest time allowed for an answer
    trouble: str  # why the board stopped answering; empty if it did not

    @property
    def passed(self) -> bool:
        """Whether every request was answered in time and undamaged."""
        return bool(self.statistics["answered"] == self.statistics["asked"])

    def summary(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        own = self._asdict() | self.statistics | {"passed": self.passed}
        del own["statistics"]
        return own


def check_tactile(
    port: str | None, *, readings: int, deadline: float, progress: ProgressCallback | None = None
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
            deadline_s=deadline,
            trouble=reader.trouble,
        )


def watch_tactile(
    port: str | None, *, rate: float, duration: float | None = None, threshold: int | None = None
) -> Iterator[tuple[TactileReader, TactileReading]]:
    """Yield readings until the time is over or the caller stops; reconnect after a pulled plug."""
    thresholds = None if threshold is None else (threshold,) * 3
    with TactileReader(port, thresholds=thresholds) as reader:
        start = due = time.monotonic()
        while duration is None or due - start < duration:
            yield reader, reader.read()
            if not reader.connected:
                time.sleep(0.5)
                reader.reconnect()
            due = max(due + 1.0 / rate, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))
