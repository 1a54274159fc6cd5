"""Common interface of all drives of the pusher, and drives that a person operates or a
program simulates."""

from __future__ import annotations

import abc
import threading
import time
from collections.abc import Callable, Sequence
from typing import ClassVar, Final, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import DeviceFailed, InvalidInput
from fixel.model.fields import finite, fraction, non_negative, positive, vector
from fixel.testbed.imperfections import uneven_time
from fixel.typing import FloatArray

DRIVE_REACH: Final = (0.0, 0.150)  # [m] of the thesis's actuator
SPEED: Final = 0.0135  # [m/s] in all its experiments
NEAR: Final = 2e-5  # [m] largest distance at which the drive has arrived
ON_LINE: Final = 1e-4  # [m] largest distance from its line at which a move may begin
Reach = tuple[float, float] | Sequence[tuple[float, float]]  # of all axes, or of each [m]


class Line(NamedTuple):
    """Straight line in the coordinates of a drive."""

    origin: FloatArray  # place of position 0 (n_axes,) [m]
    direction: FloatArray  # unit vector towards growing positions (n_axes,) [-]

    def at(self, position: float) -> FloatArray:
        """Return the place (n_axes,) [m] of a position [m]."""
        return self.origin + position * self.direction

    def along(self, place: FloatArray) -> float:
        """Return the position [m] of a place (n_axes,) [m], projected onto the line."""
        return float(self.direction @ (place - self.origin))

    def inside(self, travels: FloatArray) -> tuple[float, float]:
        """Return the range of positions inside travels (n_axes, 2) [m]; descending if empty."""
        low, high = -np.inf, np.inf
        for start, way, ends in zip(self.origin, self.direction, travels, strict=True):
            if way != 0.0:
                near, far = sorted(((ends - start) / way).tolist())
                low, high = max(low, near), min(high, far)
            elif not ends[0] - NEAR <= start <= ends[1] + NEAR:
                return 0.0, -1.0
        return low, high


class AbstractActuator(abc.ABC):
    """Abstract drive on a straight line.

    Positions are distances along its line [m]. Until it is aimed, the line of a drive with one axis
    is its stroke: 0 where it is fully withdrawn, growing as it extends. A drive with more axes
    moves parallel to its first axis until it is aimed. Use it as a context manager; leaving the
    block stops a drive that still moves.
    """

    name: ClassVar[str]  # name on the command line
    # Smallest and largest position that it may be sent to [m].
    reach: tuple[float, float]
    # Smallest and largest coordinate of each axis (n_axes, 2) [m]; None if it cannot be aimed.
    travels: FloatArray | None = None
    _aimed: Line | None = None

    @property
    def n_axes(self) -> int:
        """Number of axes."""
        return 1 if self.travels is None else len(self.travels)

    @property
    def line(self) -> Line:
        """Line of the moves."""
        return self._aimed or Line(np.zeros(self.n_axes), np.eye(self.n_axes)[0])

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
    def zero_known(self) -> bool:
        """Whether position 0 is the same place as in earlier sessions, or was confirmed."""
        return True

    def set_zero(self) -> None:  # noqa: B027 - most home
        """Make the present place position 0 of a drive whose `zero_known` is false."""

    def place(self) -> FloatArray:
        """Return the coordinates of the drive (n_axes,) [m]."""
        return np.array([self.position()])

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

    def aim(self, origin: ArrayLike, direction: ArrayLike) -> None:
        """Set the line of the next moves; nothing moves.

        `reach` becomes the part of the line that is inside the travels of all axes. A move begins
        on the line: the method `go` moves the drive there.

        Parameters
        ----------
        origin : array_like, shape (n_axes,)
            Place of position 0, in coordinates of the drive [m].
        direction : array_like, shape (n_axes,)
            Unit vector towards growing positions; 1 or -1 with one axis.

        Raises
        ------
        InvalidInput
            The direction is no unit vector, or no part of the line is inside the travels.
        DeviceFailed
            The drive moves.
        """
        if self.travels is None:
            raise InvalidInput(
                "aim", found="a driver with a fixed line", expected="one that states its travels"
            )
        start = vector(origin, "origin", self._labels)
        way = vector(direction, "direction", self._labels)
        length = float(np.linalg.norm(way))
        if abs(length - 1.0) > 1e-6:
            unit = "a unit vector" if self.n_axes > 1 else "1 or -1"
            raise InvalidInput("direction", found=way.tolist(), expected=unit)
        self._refuse_second_move()
        # The rounding error of a cosine must not move an axis.
        self._set_line(Line(start, np.where(np.abs(way) < 1e-12, 0.0, way / length)))

    def go(self, place: ArrayLike, *, speed: float = SPEED, wait: bool = True) -> None:
        """Move straight to a place (n_axes,) [m], which need not be on the line of the moves.

        Parameters and errors are those of the method `move`.
        """
        here, end, before = self.place(), vector(place, "place", self._labels), self._aimed
        if self.travels is not None:
            # A place on the border may be outside by a rounding error.
            inside = np.clip([here, end], *self.travels.T)
            here, end = np.where(np.abs(inside - [here, end]) <= NEAR, inside, [here, end])
            if (end != inside[1]).any():
                found = f"{(1e3 * end).round(3).tolist()} mm"
                raise InvalidInput(
                    "place", found=found, expected=f"a place inside {self._travels_text}"
                )
        distance = float(np.linalg.norm(end - here))
        self.aim(here, (end - here) / distance if distance > 0.0 else np.eye(len(here))[0])
        try:
            self.move(to=distance, speed=speed, wait=wait)
        finally:
            self._set_line(before)

    @property
    def _travels_text(self) -> str:
        assert self.travels is not None
        words = [f"{1e3 * low:.4g} to {1e3 * high:.4g} mm" for low, high in self.travels]
        return f"the travels, {' and '.join(words)}"

    @property
    def _labels(self) -> str:
        return ", ".join(f"axis {k + 1}" for k in range(self.n_axes))

    def _set_line(self, line: Line | None) -> None:
        """Set the line and the reach along it; None for the line of a drive that is not aimed."""
        assert self.travels is not None
        low, high = self.travels[0].tolist() if line is None else line.inside(self.travels)
        if line is not None and low >= high:
            raise InvalidInput(
                "origin",
                found=f"{(1e3 * line.origin).round(3).tolist()} mm with direction"
                f" {line.direction.round(4).tolist()}",
                expected=f"a line inside {self._travels_text}",
            )
        self._aimed, self.reach = line, (low, high)

    def _end_of(self, target: float, here: FloatArray) -> FloatArray:
        """Return the place (n_axes,) [m] of a target [m]; raise if the drive is off its line."""
        line = self.line
        if self.n_axes == 1:
            return line.at(target)
        nearest = line.at(line.along(here))
        if self._aimed is None:
            return line.at(target) + (here - nearest)
        off = float(np.linalg.norm(here - nearest))
        if off > ON_LINE:
            raise DeviceFailed(
                f"the drive is {1e3 * off:.2f} mm off the line of the move",
                hint=f"go to a place on it first, such as {(1e3 * nearest).round(2).tolist()} mm",
            )
        return line.at(target)

    def check(
        self, *, to: float | None = None, by: float | None = None, speed: float = SPEED
    ) -> None:
        """Raise what `move` would raise for the same parameters before it begins; nothing moves.

        The drive need not be on its line yet.
        """
        self._checked_speed(speed)
        self._place_meant(to, by)

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
        speed = self._checked_speed(speed)
        target = self._place_meant(to, by)
        try:
            self._begin(target, speed)
            if wait:
                self.wait()
        except BaseException:
            self.stop()
            raise

    def _checked_speed(self, speed: float) -> float:
        speed = positive(speed, "speed", "m/s")
        if not self.connected:
            raise DeviceFailed("the actuator is not connected", hint="call connect first")
        self._refuse_second_move()
        return speed

    def _refuse_second_move(self) -> None:
        if self.moving:
            raise DeviceFailed(
                "the actuator is already moving", hint="wait until it stands, or stop it"
            )

    def _place_meant(self, to: float | None, by: float | None) -> float:
        if to is None and by is None:
            hint = "or a distance with by=DISTANCE"
            raise InvalidInput("to", found=None, expected="a target position", hint=hint)
        if to is not None and by is not None:
            raise InvalidInput("to", found="by too", expected="one of them")
        target = finite(to, "to", "m") if by is None else self.position() + finite(by, "by", "m")
        low, high = self.reach
        if not low - NEAR <= target <= high + NEAR:
            found = f"a move to {1e3 * target:.2f} mm"
            expected = f"a position from {1e3 * low:.4g} to {1e3 * high:.4g} mm"
            raise InvalidInput("to" if by is None else "by", found=found, expected=expected)
        return min(max(target, low), high)

    def __enter__(self) -> Self:
        return self if self.connected else self.connect()

    def __exit__(self, *_: object) -> None:
        self.disconnect()


def checked_travels(reach: Reach, n_axes: int) -> FloatArray:
    """Return the ends of each axis (n_axes, 2) [m], ascending, from those of each or of all."""
    pairs = np.atleast_2d(reach).tolist()
    if len(pairs) not in (1, n_axes):
        raise InvalidInput("reach", found=reach, expected=f"positions for each of {n_axes} axes")
    for pair in pairs:
        low, high = (finite(end, "reach", "m") for end in pair)
        if low >= high:
            raise InvalidInput("reach", found=pair, expected="two positions in ascending order [m]")
    return np.array(pairs * (n_axes // len(pairs)), dtype=np.float64)


class _AimedActuator(AbstractActuator):
    """Actuator without a controller, which can be aimed since its travels are known."""

    travels: FloatArray
    _connected = False

    def connect(self) -> Self:
        self._connected = True
        return self

    def disconnect(self) -> None:
        self.stop()
        self._connected = False

    @property
    def connected(self) -> bool:
        return self._connected

    def position(self) -> float:
        return self.line.along(self.place())


class ManualActuator(_AimedActuator):
    """Actuator that prompts a person to set and start the drive, and relies on the answers.

    It cannot stop the drive itself, only request it from the person. `ask` prints a sentence and
    returns the line typed, `notify` only prints. `reach` has the ends of the positions [m].
    """

    name: ClassVar[str] = "manual"

    def __init__(
        self,
        *,
        reach: tuple[float, float] = DRIVE_REACH,
        ask: Callable[[str], str] = input,
        notify: Callable[[str], None] = print,
    ) -> None:
        self.travels = checked_travels(reach, 1)
        self._set_line(None)
        self._ask, self._say = ask, notify
        self._at: float | None = None  # [m] coordinate of the drive
        self._heading: float | None = None  # [m] target of the move under way
        self._stopped = ""

    def connect(self) -> Self:
        self._answered(
            "Switch on the drive and wait until it is ready (Servo ON). Then press Enter: "
        )
        return super().connect()

    def home(self) -> None:
        self._answered("Move the drive to its origin. When it stands there, press Enter: ")
        self._at = float(self.travels[0, 0])

    def place(self) -> FloatArray:
        if self._at is None:
            self._at = self._asked_for_position()
        return np.array([self._at])

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
        place = self.place()
        here, end = float(place[0]), float(self._end_of(target, place)[0])
        self._stopped = ""
        self._say(
            f"Set in the drive's program: from {1e3 * here:.2f} mm to {1e3 * end:.2f} mm"
            f" (by {1e3 * (end - here):+.2f} mm), speed {1e3 * speed:.2f} mm/s."
        )
        self._heading = end  # an interrupted person may have clicked already
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


class SimulatedActuator(_AimedActuator):
    """Actuator that moves as in the simulated testbed: at its own speed, with a ripple.

    `reach` has the ends of all axes, or one pair for each, and `start` the initial coordinates [m].
    `speed_ratio` is the true over the requested speed. The ripple of the speed has an amplitude, as
    a share of it less than 1, a frequency [Hz], and a phase when a move begins [rad]. A `clock`
    other than `time.monotonic` may run faster than real time.
    """

    name: ClassVar[str] = "simulated"

    def __init__(
        self,
        *,
        n_axes: int = 1,
        reach: Reach = DRIVE_REACH,
        start: float | Sequence[float] = 0.0,
        speed_ratio: float = 1.0,
        ripple: float = 0.0,
        frequency: float = 2.7,
        phase: float = 0.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.travels = checked_travels(reach, n_axes)
        self._set_line(None)
        self._speed_ratio = positive(speed_ratio, "speed_ratio")
        # Above 1 it would move backwards at times; no stepper motor does.
        self._ripple = min(fraction(ripple, "ripple"), 1.0 - 1e-9)
        self._frequency = positive(frequency, "frequency", "Hz")
        self._phase = phase
        self._clock = clock
        self._lock = threading.RLock()
        given = np.broadcast_to(np.asarray(start), n_axes).tolist()
        self._from = self._to = np.array([non_negative(each, "start", "m") for each in given])
        self._speed, self._began = 0.0, 0.0
        self._stopped = ""

    def home(self) -> None:
        with self._lock:
            self._from = self._to = self.travels[:, 0].copy()
            self._speed = 0.0

    def place(self) -> FloatArray:
        with self._lock:
            return self._place(self._clock()).copy()

    @property
    def moving(self) -> bool:
        with self._lock:
            return self._speed > 0.0 and self._place(self._clock()) is not self._to

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
        end = self._end_of(target, self.place())
        with self._lock:
            now = self._clock()
            self._from, self._to = self._place(now), end
            self._speed, self._began = speed * self._speed_ratio, now
            self._stopped = ""

    def _place(self, now: float) -> FloatArray:
        if self._speed == 0.0:
            return self._to
        elapsed = np.array(now - self._began)
        even = float(uneven_time(elapsed, self._ripple, self._frequency, self._phase))
        covered = max(0.0, self._speed * even)
        way = self._to - self._from
        whole = float(np.linalg.norm(way))
        return self._to if covered >= whole else self._from + covered * (way / whole)
