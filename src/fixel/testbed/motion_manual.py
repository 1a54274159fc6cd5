"""Actuator that a person operates with the drive's own program, as in the thesis."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Self, final

from fixel.errors import DeviceFailed, InvalidInput
from fixel.model.fields import finite
from fixel.testbed.motion import DRIVE_REACH, AbstractActuator, checked_reach


@final
class ManualActuator(AbstractActuator):
    """Actuator that prompts a person to set and start the drive, and relies on the answers.

    It cannot stop the drive itself, only request it from the person.

    Parameters
    ----------
    reach : (float, float)
        Smallest and largest position [m].
    ask : callable
        Function that prints a sentence and returns the line typed; `input` by default.
    notify : callable
        Function that prints a sentence.
    """

    name: ClassVar[str] = "manual"

    def __init__(
        self,
        *,
        reach: tuple[float, float] = DRIVE_REACH,
        ask: Callable[[str], str] = input,
        notify: Callable[[str], None] = print,
    ) -> None:
        self.reach = checked_reach(reach)
        self._ask, self._say = ask, notify
        self._connected = False
        self._at: float | None = None
        self._heading: float | None = None  # [m] target of the move under way
        self._stopped = ""

    def connect(self) -> Self:
        self._answered(
            "Switch on the drive and wait until it is ready (Servo ON). Then press Enter: "
        )
        self._connected = True
        return self

    def disconnect(self) -> None:
        self.stop()
        self._connected = False

    @property
    def connected(self) -> bool:
        return self._connected

    def home(self) -> None:
        self._answered("Move the drive to its origin. When it stands there, press Enter: ")
        self._at = self.reach[0]

    def position(self) -> float:
        if self._at is None:
            self._at = self._asked_for_position()
        return self._at

    @property
    def moving(self) -> bool:
        return self._heading is not None

    def wait(self) -> None:
        if self._heading is not None:
            self._answered("When the drive stands still, press Enter: ")
            self._at, self._heading = self._heading, None
        why, self._stopped = self._stopped, ""
        if why:
            raise DeviceFailed(why)

    def stop(self) -> None:
        if self._heading is None:
            return
        self._say("STOP THE DRIVE NOW, with the stop button of its program or its power switch.")
        self._at, self._heading = None, None
        self._stopped = "the operator was instructed to stop the drive"

    def _begin(self, target: float, speed: float) -> None:
        here = self.position()
        self._stopped = ""
        self._say(
            f"Set in the drive's program: from {1e3 * here:.2f} mm to {1e3 * target:.2f} mm"
            f" (by {1e3 * (target - here):+.2f} mm), speed {1e3 * speed:.2f} mm/s."
        )
        self._heading = target  # an interrupted person may have clicked already
        self._answered("Click its start button and press Enter at the same moment: ")

    def _asked_for_position(self) -> float:
        for _ in range(3):
            typed = self._answered("Position of the drive in mm: ")
            try:
                return finite(float(typed.replace(",", ".")) * 1e-3, "position", "m")
            except (ValueError, InvalidInput):
                self._say(f"{typed!r} is not a number.")
        raise DeviceFailed("the position of the drive is unknown; home it first")

    def _answered(self, sentence: str) -> str:
        try:
            return self._ask(sentence)
        except EOFError:
            raise DeviceFailed(
                "there is no operator: this is not a terminal", hint="run it in a terminal"
            ) from None
