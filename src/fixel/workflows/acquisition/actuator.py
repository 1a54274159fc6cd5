"""Home the actuator, move it and report its position."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

from fixel.errors import unknown_name
from fixel.testbed.motion import SPEED, AbstractActuator
from fixel.testbed.motion_grbl import GrblActuator
from fixel.testbed.motion_manual import ManualActuator
from fixel.testbed.motion_simulated import SimulatedActuator
from fixel.typing import Notify


class ActuatorAnswer(NamedTuple):
    """Position and state of the drive after a command."""

    driver: str
    position: float  # position of the drive [m]
    reach: tuple[float, float]  # range of positions [m]
    state: str  # state as the controller names it; empty if it names none
    seconds: float  # duration of the command [s]

    def summary(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        return {
            "driver": self.driver,
            "position_m": self.position,
            "reach_m": list(self.reach),
            "state": self.state,
            "seconds": self.seconds,
        }


def chosen_actuator(
    driver: str, port: str | None, *, notify: Notify = print, dead_man: float | None = None
) -> AbstractActuator:
    """Create the driver called `grbl`, `manual` or `simulated`."""
    if driver == GrblActuator.name:
        return GrblActuator(port, keys=True, dead_man=dead_man)
    if driver == ManualActuator.name:
        return ManualActuator(notify=notify, ask=_asking(notify))
    if driver == SimulatedActuator.name:
        return SimulatedActuator()
    drivers = (GrblActuator, ManualActuator, SimulatedActuator)
    raise unknown_name("--driver", driver, (member.name for member in drivers))


def _asking(notify: Notify) -> Callable[[str], str]:
    """Return an `input` that prompts through the notifier: stdout may be used for the answer."""

    def ask(sentence: str) -> str:
        notify(sentence)
        return input()

    return ask


def home_actuator(actuator: AbstractActuator) -> ActuatorAnswer:
    """Home the drive, so that it knows its position."""
    start = time.perf_counter()
    with actuator:
        actuator.home()
        return _answer(actuator, start)


def move_actuator(
    actuator: AbstractActuator,
    *,
    to: float | None,
    by: float | None,
    speed: float = SPEED,
    unlock: bool = False,
) -> ActuatorAnswer:
    """Move the drive and return when it has arrived [m, m/s]."""
    start = time.perf_counter()
    with actuator:
        if unlock and isinstance(actuator, GrblActuator):
            actuator.unlock()
        actuator.move(to=to, by=by, speed=speed)
        return _answer(actuator, start)


def where_is_actuator(actuator: AbstractActuator) -> ActuatorAnswer:
    """Read the position of the drive."""
    start = time.perf_counter()
    with actuator:
        return _answer(actuator, start)


def _answer(actuator: AbstractActuator, start: float) -> ActuatorAnswer:
    return ActuatorAnswer(
        driver=actuator.name,
        position=actuator.position(),
        reach=actuator.reach,
        state=actuator.state if isinstance(actuator, GrblActuator) else "",
        seconds=time.perf_counter() - start,
    )
