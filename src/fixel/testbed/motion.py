"""Common interface of all drives of the pusher, and drives that a person operates or a
program simulates."""

from __future__ import annotations

import abc
import math
import threading
import time
from collections.abc import Callable
from typing import ClassVar, Final, Self, final

import numpy as np

from fixel.errors import DeviceFailed, InvalidInput
from fixel.model.fields import finite, fraction, non_negative, positive
from fixel.testbed.imperfections import uneven_time

DRIVE_REACH: Final = (0.0, 0.150)  # [m] of the thesis's actuator
SPEED: Final = 0.0135  # [m/s] in all its experiments
NEAR: Final = 2e-5  # [m] largest distance at which the drive has arrived


class AbstractActuator(abc.ABC):
    """Abstract drive on a straight line.

    Positions are distances along its stroke [m]: 0 where it is fully withdrawn, growing as it
    extends. Use it as a context manager; leaving the block stops a drive that still moves.
    """

    name: ClassVar[str]  # name on the command line
    # Smallest and largest position that it may be sent to [m].
    reach: tuple[float, float]

    @abc.abstractmethod
    def connect(self) -> Self:
        """Connect to the drive, without moving it."""

    @abc.abstractmethod
    def disconnect(self) -> None:
        """Stop the drive if it moves, and disconnect. Do nothing without a connection."""

    @property
    @abc.abstractmethod
    def connected(self) -> bool:
        """Whether the drive can be moved."""

    @abc.abstractmethod
    def home(self) -> None:
        """Determine the position: go to the end switch, or ask the operator. Returns when done."""

    @abc.abstractmethod
    def position(self) -> float:
        """Return the current position [m]."""

    @property
    @abc.abstractmethod
    def moving(self) -> bool:
        """Whether a move is under way."""

    @abc.abstractmethod
    def wait(self) -> None:
        """Return when the move is done.

        Raises
        ------
        DeviceFailed
            The move ended early; with the reason.
        """

    @abc.abstractmethod
    def stop(self) -> None:
        """End the move, decelerating so that the position is not lost, and return when at rest.
        May be called from any thread, and when nothing moves."""

    @abc.abstractmethod
    def _begin(self, target: float, speed: float) -> None:
        """Start towards a position within reach [m] at a speed [m/s]; returns at once."""

    def move(
        self,
        *,
        to: float | None = None,
        by: float | None = None,
        speed: float = SPEED,
        wait: bool = True,
    ) -> None:
        """Move to a position, or by a distance; give one of the two.

        Parameters
        ----------
        to : float, optional
            Target position [m].
        by : float, optional
            Distance from the current position [m].
        speed : float
            Speed of the move [m/s].
        wait : bool
            Whether to return on arrival, or at once; see the method `wait`. Any interruption of
            the waiting, such as Ctrl-C, stops the drive.

        Raises
        ------
        InvalidInput
            The target is out of reach, or the speed is not positive.
        DeviceFailed
            The drive is not ready, or ended the move early.
        """
        speed = positive(speed, "speed", "m/s")
        if not self.connected:
            raise DeviceFailed("the actuator is not connected", hint="call connect first")
        if self.moving:
            raise DeviceFailed(
                "the actuator is already moving", hint="wait until it stands, or stop it"
            )
        target = self._place_meant(to, by)
        try:
            self._begin(target, speed)
            if wait:
                self.wait()
        except BaseException:
            self.stop()
            raise

    def _place_meant(self, to: float | None, by: float | None) -> float:
        if (to is None) == (by is None):
            found = "both" if to is not None else None
            raise InvalidInput("move", found=found, expected="a target position or a distance")
        target = finite(to, "to", "m") if by is None else self.position() + finite(by, "by", "m")
        low, high = self.reach
        if not low - NEAR <= target <= high + NEAR:
            raise InvalidInput(
                "to" if by is None else "by",
                found=f"{1e3 * target:.2f} mm",
                expected=f"a position from {1e3 * low:.4g} to {1e3 * high:.4g} mm",
            )
        return min(max(target, low), high)

    def __enter__(self) -> Self:
        return self if self.connected else self.connect()

    def __exit__(self, *_: object) -> None:
        self.disconnect()


def checked_reach(reach: tuple[float, float]) -> tuple[float, float]:
    """Return two positions [m], checked to be finite and in ascending order."""
    low, high = (finite(end, "reach", "m") for end in reach)
    if low >= high:
        raise InvalidInput("reach", found=reach, expected="two positions in ascending order [m]")
    return low, high


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


@final
class SimulatedActuator(AbstractActuator):
    """Actuator that moves as in the simulated testbed: at its own speed, with a ripple.

    Parameters
    ----------
    reach : (float, float)
        Smallest and largest position [m].
    start : float
        Initial position [m].
    speed_ratio : float
        True speed over the requested speed [-].
    ripple : float
        Amplitude of the speed about its mean, as a share of it, less than 1 [-].
    frequency : float
        Frequency of the ripple [Hz].
    phase : float
        Phase of the ripple when a move begins [rad].
    clock : callable
        Function that returns seconds; replace it to run faster than real time.
    """

    name: ClassVar[str] = "simulated"

    def __init__(
        self,
        *,
        reach: tuple[float, float] = DRIVE_REACH,
        start: float = 0.0,
        speed_ratio: float = 1.0,
        ripple: float = 0.0,
        frequency: float = 2.7,
        phase: float = 0.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.reach = checked_reach(reach)
        self._speed_ratio = positive(speed_ratio, "speed_ratio")
        # Above 1 it would move backwards at times; no stepper motor does.
        self._ripple = min(fraction(ripple, "ripple"), 1.0 - 1e-9)
        self._frequency = positive(frequency, "frequency", "Hz")
        self._phase = phase
        self._clock = clock
        self._connected = False
        self._lock = threading.RLock()
        self._from = self._to = non_negative(start, "start", "m")
        self._speed, self._began = 0.0, 0.0
        self._stopped = ""

    def connect(self) -> Self:
        self._connected = True
        return self

    def disconnect(self) -> None:
        self.stop()
        self._connected = False

    @property
    def connected(self) -> bool:
        return self._connected

    def home(self) -> None:
        with self._lock:
            self._from = self._to = self.reach[0]
            self._speed = 0.0

    def position(self) -> float:
        with self._lock:
            return self._place(self._clock())

    @property
    def moving(self) -> bool:
        with self._lock:
            return self._speed > 0.0 and self._place(self._clock()) != self._to

    def wait(self) -> None:
        while self.moving:
            time.sleep(0.002)
        with self._lock:
            why, self._stopped = self._stopped, ""
            self._speed = 0.0
        if why:
            raise DeviceFailed(why)

    def stop(self) -> None:
        with self._lock:
            if self.moving:
                self._stopped = "the drive was stopped"
            self._from = self._to = self._place(self._clock())
            self._speed = 0.0

    def _begin(self, target: float, speed: float) -> None:
        with self._lock:
            now = self._clock()
            self._from, self._to = self._place(now), target
            self._speed, self._began = speed * self._speed_ratio, now
            self._stopped = ""

    def _place(self, now: float) -> float:
        if self._speed == 0.0:
            return self._to
        elapsed = np.array(now - self._began)
        even = float(uneven_time(elapsed, self._ripple, self._frequency, self._phase))
        covered = max(0.0, self._speed * even)
        whole = self._to - self._from
        return self._to if covered >= abs(whole) else self._from + math.copysign(covered, whole)
