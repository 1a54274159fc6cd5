"""Actuator with a GRBL controller on a serial port."""

from __future__ import annotations

import contextlib
import sys
import threading
from typing import ClassVar, Final, Self

import numpy as np

from fixel.errors import DeviceFailed, InvalidInput
from fixel.model.fields import optional_positive
from fixel.testbed import grbl_link as grbl, motion
from fixel.testbed.emergency import StopGuard
from fixel.testbed.grbl_link import ASKING, AxisSettings, GrblLink, greet
from fixel.testbed.serial_port import chosen_port, closed_on_failure, open_port
from fixel.typing import FloatArray

DEAD_MAN: Final = 0.5  # [s]
MAX_DEAD_MAN: Final = 3.0  # [s]
CHUNKS: Final = 6  # pieces in a full queue
HOMING_TIME: Final = 90.0  # [s]
UNLOCK: Final = "check the position of the drive, then: fixel actuator move --unlock --by 0"
NO_HOMING: Final = (
    "positions count from where the controller was switched on: move the drive by hand to its"
    " withdrawn end, and switch the controller off and on; with end switches, set $22=1"
)
SHORT: Final = 0.5  # [s] at rest before the target after which the move has failed


class GrblActuator(motion.AbstractActuator):
    """Axes of a GRBL controller, version 0.9 or 1.1, or of grblHAL or FluidNC.

    Coordinates count from the end of each axis at which it homes, or without homing from its place
    when the controller was switched on. The second axis counts from its other end where these
    coordinates would be a mirror image of the controller's.

    A move is sent in pieces, at most as many as the drive needs for `dead_man` seconds: if this
    program dies or hangs, the drive runs out of pieces and comes to rest. A guard
    (`stop_guard.py`) is a separate process that stops the drive at once when this process dies,
    on Ctrl-C, and on `fixel actuator stop`.

    Parameters
    ----------
    port : str, optional
        Serial port: `/dev/ttyUSB0`, `COM5`. None raises, with a list of the ports found.
    axis : str
        Axis of the controller: `"X"`, `"Y"`, `"Z"` or `"A"`.
    axes : str, optional
        Several axes instead, such as `"XY"`.
    reach : (float, float), or one pair for each axis
        Smallest and largest coordinate of each axis [m]; limited to the controller's travel where
        it is known.
    dead_man : float, optional
        Longest motion without this program [s]. Default: 0.5 s, or longer if a low acceleration
        would otherwise slow the drive down between pieces.
    keys : bool
        Whether any key on the terminal stops the drive.
    guard : bool
        Whether the guard runs; never on Windows.
    """

    name: ClassVar[str] = "grbl"
    travels: FloatArray

    def __init__(
        self,
        port: str | None = None,
        *,
        axis: str = "X",
        axes: str | None = None,
        reach: motion.Reach = motion.DRIVE_REACH,
        dead_man: float | None = None,
        keys: bool = False,
        guard: bool = True,
    ) -> None:
        self.port = chosen_port(port, "the actuator's controller")
        self.axes = grbl.checked_axes(axis, "axis") if axes is None else grbl.checked_axes(axes)
        self.axis = self.axes[0]
        self.travels = self._wanted_travels = motion.checked_travels(reach, len(self.axes))
        self._set_line(None)
        self.dead_man = optional_positive(dead_man, "dead_man", "s")
        self._keys, self._wants_guard = keys, guard
        self._link: GrblLink | None = None
        self._guard: StopGuard | None = None
        self._settings: tuple[AxisSettings, ...] = ()
        self._way = self.line  # of the move under way, in machine coordinates [mm]
        self._target: float | None = None  # end of the way, from where it began [mm]
        self._sent_to = 0.0  # [mm] of the way
        self._speed = 0.0  # [mm/s]
        self._queue = DEAD_MAN  # [s] of this move
        self._failure = ""
        self._stops = self._stops_before = 0  # number of requests, and that before a move
        self._stopping = threading.Lock()
        self._at_rest_since: float | None = None
        self._zero_losses = -1  # value of `GrblLink.losses` at `set_zero`

    # --- connection ---------------------------------------------------------------------------

    def connect(self) -> Self:
        """Open the port, check that a controller answers, and read its settings.

        Raise `InvalidInput` with the answer if the port cannot be opened or another device answers,
        and `DeviceFailed` if the controller does not answer as it should.
        """
        self.disconnect()
        serial = open_port(self.port, grbl.BAUD, "the actuator's controller")
        with closed_on_failure(serial.close, self.port, "the actuator's controller"):
            greet(serial, self.port)
            self._link = GrblLink(serial, self._next_piece)
        self._zero_losses = -1
        try:
            self._read_settings()
            # Sharing the port and hearing signals need a POSIX system.
            if self._wants_guard and sys.platform != "win32":
                self._guard = StopGuard(self.port, serial.fileno(), keys=self._keys)
        except BaseException:
            self._link.close()
            self._link = None
            raise
        return self

    def disconnect(self) -> None:
        if self._link is None:
            return
        try:
            self.stop()
        finally:
            if self._guard is not None:
                self._guard.release()
            link, self._link, self._guard = self._link, None, None
            link.close()

    @property
    def connected(self) -> bool:
        return self._link is not None and not self._link.lost

    def _read_settings(self) -> None:
        link = self._open
        status = link.fresh_status()
        present = grbl.AXES[: status.n_axis or None]
        for axis in self.axes:
            if axis not in present:
                expected = f"an axis of the controller: {present}"
                raise InvalidInput("axis", found=repr(axis), expected=expected)
        if status.state not in ("Idle", "Alarm"):
            # The program that started the move is gone: the port was free.
            self.stop()
        lines = link.command("$I")
        numbered = link.command("$$")
        settings = []
        for axis in self.axes:
            named = link.command(f"$/axes/{axis.lower()}") if grbl.has_named_settings(lines) else []
            settings.append(grbl.settings_of([*lines, *named, *numbered], axis))
        if len(settings) > 1 and settings[0].direction != settings[1].direction:
            settings[1] = settings[1].from_other_end()
        self._settings = tuple(settings)
        self.travels = self._wanted_travels.copy()
        for ends, of_axis in zip(self.travels, settings, strict=True):
            # Without homing, it counts from any place; a bench begins at the withdrawn end.
            low = 0.0 if of_axis.homing or of_axis.soft_limits else -of_axis.travel
            ends[:] = max(ends[0], 1e-3 * low), min(ends[1], 1e-3 * of_axis.travel)
        self.travels = motion.checked_travels(self.travels.tolist(), len(self.axes))
        self._set_line(self._aimed)

    # --- state --------------------------------------------------------------------------------

    @property
    def state(self) -> str:
        """State as the controller names it: `Idle`, `Run`, `Hold`, `Alarm`."""
        return self._open.fresh_status().state

    @property
    def settings(self) -> AxisSettings:
        """Settings of the first axis, as read from the controller."""
        if not self._settings:
            raise DeviceFailed("the actuator is not connected", hint="call connect first")
        return self._settings[0]

    @property
    def _homes(self) -> bool:
        return any(of_axis.homing for of_axis in self._settings)

    @property
    def zero_known(self) -> bool:
        if self._link is None:
            return False
        homing = all(of_axis.homing for of_axis in self._settings)
        return homing or self._zero_losses == self._link.losses

    def set_zero(self) -> None:
        if self.zero_known:
            return
        losses, status = self._open.losses, self._open.fresh_status()
        if status.state == "Alarm":
            self.unlock()
        pairs = zip(self._settings, self._coordinates(status), strict=True)
        self._settings = tuple(
            one if one.homing else one._replace(zero=float(at)) for one, at in pairs
        )
        self._zero_losses = losses

    def position(self) -> float:
        return self.line.along(self.place())

    def place(self) -> FloatArray:
        return self._place_of(self._coordinates(self._open.fresh_status()))

    def _place_of(self, coordinates: FloatArray) -> FloatArray:
        found = zip(self._settings, coordinates, strict=True)
        return np.array([of_axis.position(at) for of_axis, at in found]) + 0.0  # no minus zero

    @property
    def moving(self) -> bool:
        if self._link is None:
            return False
        with self._link.changed:
            if self._target is not None:
                self._look()
            return self._target is not None

    def home(self) -> None:
        self._refuse_second_move()
        if self.connected and not self._homes:
            raise DeviceFailed("homing is off in this controller ($22=0)", hint=NO_HOMING)
        try:
            self._open.command("$H", HOMING_TIME)
        except BaseException as failed:
            # Only a reset ends homing, which goes on if it was interrupted or takes too long.
            self._open.at_once(grbl.RESET)
            if not isinstance(failed, DeviceFailed):
                raise
            hint = "check the drive, then home it again"
            raise DeviceFailed(f"homing failed: {failed.reason}", hint) from None

    def unlock(self) -> None:
        """End an alarm without homing. Look at the position of the drive before."""
        self._open.command("$X")

    def _coordinates(self, status: grbl.GrblStatus) -> FloatArray:
        """Return the machine coordinates of the axes (n_axes,) [mm]."""
        places = status.machine
        if places is None and status.work is not None:
            places = tuple(map(sum, zip(status.work, self._open.offset, strict=False)))
        if places is None:
            raise DeviceFailed("the controller reports no position", hint="set $10=1")
        unit = grbl.INCH if self._settings and self._settings[0].inches else 1.0
        return unit * np.array([places[grbl.AXES.index(axis)] for axis in self.axes])

    @property
    def _open(self) -> GrblLink:
        if self._link is None:
            raise DeviceFailed("the actuator is not connected", hint="call connect first")
        return self._link

    # --- moves --------------------------------------------------------------------------------

    def check(
        self, *, to: float | None = None, by: float | None = None, speed: float = motion.SPEED
    ) -> None:
        super().check(to=to, by=by, speed=speed)
        self._refuse_state(self._open.fresh_status().state)
        self._queue_for(1e3 * speed)

    def _checked_speed(self, speed: float) -> float:
        self._stops_before = self._stops  # a stop from now on prevents the move
        return super()._checked_speed(speed)

    def _refuse_state(self, state: str) -> None:
        if state == "Alarm":
            hint = "home it: fixel actuator home" if self._homes else UNLOCK
            raise DeviceFailed("the controller is locked by an alarm", hint=hint)
        if state != "Idle":
            raise DeviceFailed(f"the controller is in the state {state}", hint="stop it")

    def _begin(self, target: float, speed: float) -> None:
        link = self._open
        status = link.fresh_status()
        self._refuse_state(status.state)
        self._queue = self._queue_for(1e3 * speed)
        begin = self._coordinates(status)
        goal = zip(self._settings, self._end_of(target, self._place_of(begin)), strict=True)
        end = np.array([of_axis.coordinate(place) for of_axis, place in goal]).round(3)
        with link.changed:
            if self._stops != self._stops_before:
                raise DeviceFailed("the drive did not move: a stop was requested")
            link.trouble = self._failure = ""
            self._at_rest_since = None
            self._speed = 1e3 * speed
            length = float(np.linalg.norm(end - begin))
            self._way = motion.Line(begin, (end - begin) / (length or 1.0))
            self._sent_to, self._target = 0.0, length

    def _queue_for(self, speed: float) -> float:
        """Return the motion to queue [s]: enough that the planner, which decelerates towards the
        end of its queue, does not slow down."""
        shares = [abs(share) for share in self.line.direction.tolist()]
        moved = [(s, share) for s, share in zip(self._settings, shares, strict=True) if share > 0.0]
        fastest = min(of_axis.fastest / share for of_axis, share in moved)
        slowest = min(moved, key=lambda one: one[0].acceleration / one[1])
        acceleration = slowest[0].acceleration / slowest[1]
        if speed > fastest * (1.0 + 1e-6):
            expected = f"at most {fastest:.4g} mm/s, the controller's limit"
            raise InvalidInput("speed", found=f"{speed:.4g} mm/s", expected=expected)
        piece = 1.0 / CHUNKS
        needed = (0.5 * speed / acceleration + 2.0 * ASKING) / (1.0 - 1.5 * piece)
        queue = max(DEAD_MAN, needed) if self.dead_man is None else self.dead_man
        if queue < needed or queue > MAX_DEAD_MAN:
            axis = self.axes[self._settings.index(slowest[0])]
            number = 120 + grbl.AXES.index(axis)
            raise InvalidInput(
                "dead_man" if queue < needed else "speed",
                found=f"{queue:.3g} s" if queue < needed else f"{speed:.4g} mm/s",
                expected=f"at least {needed:.2g} s" if queue < needed else "lower, for this queue",
                hint=f"with an acceleration of {acceleration:.4g} mm/s^2 (${number}) the "
                "drive would slow down between pieces; increase the acceleration",
            )
        return queue

    def _next_piece(self) -> str | None:
        """Return the next line of the move, None if it is too early; called by the link."""
        link = self._link
        if link is None or link.status is None or link.status.state not in ("Idle", "Run"):
            return None
        if self._target is None or self._sent_to == self._target:
            return None
        step = self._speed * self._queue / CHUNKS
        last = self._target - self._sent_to <= 1.5 * step
        end = self._target if last else self._sent_to + step
        # The last reported position lags, so that the queued motion is overestimated.
        if end - self._way.along(self._coordinates(link.status)) > self._speed * self._queue:
            return None
        self._sent_to = end
        self._at_rest_since = None
        return grbl.move_line(self.axes, self._way.at(end), self._speed)

    def wait(self) -> None:
        link = self._open
        with link.changed:
            while self.moving:
                # Wakes regularly, so that Ctrl-C is handled on every system.
                link.changed.wait(0.1)
            failure, self._failure = self._failure, ""
        if failure:
            self.stop()  # what is queued
            hint = "if the drive still moves, switch off its power; else: fixel actuator where"
            raise DeviceFailed(f"the drive was stopped: {failure}", hint=hint)

    def _look(self) -> None:
        """Update the move: done, failed or under way. The caller holds `changed`."""
        link = self._open
        status = link.status
        if link.trouble:
            self._give_up(link.trouble)
        elif status is not None and status.state in ("Hold", "Door", "Alarm", "Sleep"):
            self._give_up(f"the controller is in the state {status.state}")
        elif status is not None and self._target is not None and link.idle():
            goal = self._way.at(self._target)
            off = float(np.linalg.norm(self._coordinates(status) - goal))
            now = link.listened
            self._at_rest_since = self._at_rest_since or now
            if self._sent_to == self._target and off <= 2e3 * motion.NEAR:
                self._target = None
            elif now - self._at_rest_since > SHORT:
                self._give_up(f"it stopped {off:.3f} mm short of its target")
        else:
            self._at_rest_since = None

    def _give_up(self, why: str) -> None:
        self._failure, self._target = why, None

    def stop(self) -> None:
        link = self._link
        if link is None:
            return
        with link.changed:
            self._stops += 1
            # Many controllers report nothing while they home, and do not hold.
            homing, moving = link.occupied, self._target is not None
            # The last report may precede the trouble.
            at_rest = ("Alarm",) if link.trouble else ("Alarm", "Idle")
            if moving:
                self._give_up(link.trouble or "stop was requested")
        if link.lost:
            return
        if not (homing or moving) and link.status and link.status.state in at_rest:
            return
        # A move that another thread stops is stopped by its own thread, too.
        with self._stopping:
            if not homing:
                link.at_once(grbl.HOLD)
                self._wait_for_rest(link)
            link.reset()  # empties its queue

    def _wait_for_rest(self, link: GrblLink) -> None:
        """Wait until the drive has slowed down: an earlier reset would lose its position."""
        slowing = min((of_axis.acceleration for of_axis in self._settings), default=10.0)
        until = link.listened + 0.3 + 1.5 * self._speed / slowing
        with contextlib.suppress(DeviceFailed):
            while link.listened < until:
                status = link.fresh_status(0.3)
                if status.state in ("Alarm", "Idle") or status[:2] == ("Hold", 0):
                    return
