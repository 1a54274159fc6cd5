"""Abstract actuator: the common interface of all drives of the pusher."""

from __future__ import annotations

import abc
from typing import ClassVar, Final, Self

from fixel.errors import DeviceFailed, InvalidInput
from fixel.model.fields import finite, positive

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
