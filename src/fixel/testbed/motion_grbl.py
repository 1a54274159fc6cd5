"""Actuator with a GRBL controller on a serial port."""

from __future__ import annotations

import contextlib
import math
import sys
import time
from typing import ClassVar, Final, Self, final

from fixel.errors import DeviceFailed, InvalidInput
from fixel.model.fields import optional_positive
from fixel.testbed import grbl_lines as grbl
from fixel.testbed.emergency import StopGuard
from fixel.testbed.grbl_lines import AxisSettings
from fixel.testbed.grbl_link import ASKING, GrblLink, greet
from fixel.testbed.motion import DRIVE_REACH, NEAR, AbstractActuator, checked_reach
from fixel.testbed.serial_port import chosen_port, closed_on_failure, open_port

DEAD_MAN: Final = 0.5  # [s]
MAX_DEAD_MAN: Final = 3.0  # [s]
CHUNKS: Final = 6  # pieces in a full queue
HOMING_TIME: Final = 90.0  # [s]
UNLOCK: Final = "check the position of the drive, then: fixel actuator move --unlock"
SHORT: Final = 0.5  # [s] at rest before the target after which the move has failed


@final
class GrblActuator(AbstractActuator):
    """One axis of a GRBL controller, version 0.9 or 1.1, or of grblHAL or FluidNC.

    A move is sent in pieces, at most as many as the drive needs for `dead_man` seconds: if this
    program dies or hangs, the drive runs out of pieces and comes to rest. A guard
    (`stop_guard.py`) is a separate process that stops the drive at once when this process dies,
    on Ctrl-C, and on `fixel actuator stop`.

    Parameters
    ----------
    port : str, optional
        Serial port: `/dev/ttyUSB0`, `COM5`. None raises, with a list of the ports found.
    axis : str
        Axis of the controller: `"X"`, `"Y"` or `"Z"`.
    reach : (float, float)
        Smallest and largest position [m]; limited to the controller's travel where it is known.
    dead_man : float, optional
        Longest motion without this program [s]. Default: 0.5 s, or longer if a low acceleration
        would otherwise slow the drive down between pieces.
    keys : bool
        Whether any key on the terminal stops the drive.
    guard : bool
        Whether the guard runs; never on Windows.
    """

    name: ClassVar[str] = "grbl"

    def __init__(
        self,
        port: str | None = None,
        *,
        axis: str = "X",
        reach: tuple[float, float] = DRIVE_REACH,
        dead_man: float | None = None,
        keys: bool = False,
        guard: bool = True,
    ) -> None:
        self.port = chosen_port(port, "the actuator's controller")
        self.reach = self._wanted_reach = checked_reach(reach)
        if axis not in tuple(grbl.AXES):
            raise InvalidInput("axis", found=repr(axis), expected="X, Y or Z")
        self.axis = axis
        self.dead_man = optional_positive(dead_man, "dead_man", "s")
        self._keys, self._wants_guard = keys, guard
        self._link: GrblLink | None = None
        self._guard: StopGuard | None = None
        self._settings: AxisSettings | None = None
        self._target: float | None = None  # machine coordinate of the move under way [mm]
        self._sent_to = 0.0  # [mm]
        self._speed = 0.0  # [mm/s]
        self._queue = DEAD_MAN  # [s] of this move
        self._failure = ""
        self._at_rest_since: float | None = None

    # --- connection ---------------------------------------------------------------------------

    def connect(self) -> Self:
        """Open the port, check that a controller answers, and read its settings.

        Raises
        ------
        InvalidInput
            The port cannot be opened, or another device answers; with its answer.
        DeviceFailed
            The controller does not answer as it should.
        """
        self.disconnect()
        serial = open_port(self.port, grbl.BAUD, "the actuator's controller")
        with closed_on_failure(serial.close, self.port, "the actuator's controller"):
            greet(serial, self.port)
            self._link = GrblLink(serial, self._next_piece)
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
        if 0 < status.n_axis <= grbl.AXES.index(self.axis):
            axes = grbl.AXES[: status.n_axis]
            raise InvalidInput(
                "axis", found=repr(self.axis), expected=f"an axis of the controller: {axes}"
            )
        if status.state not in ("Idle", "Alarm"):
            # The program that started the move is gone: the port was free.
            self.stop()
        lines = link.command("$I")
        if grbl.has_named_settings(lines):
            lines += link.command(f"$/axes/{self.axis.lower()}")
        lines += link.command("$$")
        self._settings = settings = grbl.settings_of(lines, self.axis)
        low, high = self._wanted_reach
        if settings.homing or settings.soft_limits:
            low, high = max(low, 0.0), min(high, 1e-3 * settings.travel)
        self.reach = checked_reach((low, high))

    # --- state --------------------------------------------------------------------------------

    @property
    def state(self) -> str:
        """State as the controller names it: `Idle`, `Run`, `Hold`, `Alarm`."""
        return self._open.fresh_status().state

    @property
    def settings(self) -> AxisSettings:
        """Settings of the axis, as read from the controller."""
        if self._settings is None:
            raise DeviceFailed("the actuator is not connected", hint="call connect first")
        return self._settings

    def position(self) -> float:
        status = self._open.fresh_status()
        return self.settings.position(self._coordinate(status))

    @property
    def moving(self) -> bool:
        if self._link is None:
            return False
        with self._link.changed:
            if self._target is not None:
                self._look()
            return self._target is not None

    def home(self) -> None:
        if self.moving:
            raise DeviceFailed("the actuator is moving", hint="wait until it stands, or stop it")
        try:
            self._open.command("$H", HOMING_TIME)
        except DeviceFailed as failed:
            again = "check the drive, then home it again"
            hint = again if self.settings.homing else UNLOCK
            raise DeviceFailed(f"homing failed: {failed.reason}", hint) from None
        except BaseException:
            # Only a reset ends homing.
            self._open.at_once(grbl.RESET)
            raise

    def unlock(self) -> None:
        """End an alarm without homing. Look at the position of the drive before."""
        self._open.command("$X")

    def _coordinate(self, status: grbl.GrblStatus) -> float:
        number = grbl.AXES.index(self.axis)
        if status.machine is not None:
            place = status.machine[number]
        elif status.work is not None:
            place = status.work[number] + self._open.offset[number]
        else:
            raise DeviceFailed("the controller reports no position", hint="set $10=1")
        return place * (grbl.INCH if self._settings and self._settings.inches else 1.0)

    @property
    def _open(self) -> GrblLink:
        if self._link is None:
            raise DeviceFailed("the actuator is not connected", hint="call connect first")
        return self._link

    # --- moves --------------------------------------------------------------------------------

    def _begin(self, target: float, speed: float) -> None:
        link, settings = self._open, self.settings
        status = link.fresh_status()
        if status.state == "Alarm":
            hint = "home it: fixel actuator home" if settings.homing else UNLOCK
            raise DeviceFailed("the controller is locked by an alarm", hint=hint)
        if status.state != "Idle":
            raise DeviceFailed(f"the controller is in the state {status.state}", hint="stop it")
        self._queue = self._queue_for(1e3 * speed)
        with link.changed:
            link.trouble = self._failure = ""
            self._at_rest_since = None
            self._speed = 1e3 * speed
            self._sent_to = self._coordinate(status)
            self._target = round(settings.coordinate(target), 3)

    def _queue_for(self, speed: float) -> float:
        """Return the motion to queue [s]: enough that the planner, which decelerates towards the
        end of its queue, does not slow down."""
        settings = self.settings
        if speed > settings.fastest * (1.0 + 1e-6):
            raise InvalidInput(
                "speed",
                found=f"{speed:.4g} mm/s",
                expected=f"at most {settings.fastest:.4g} mm/s, the controller's limit",
            )
        piece = 1.0 / CHUNKS
        needed = (0.5 * speed / settings.acceleration + 2.0 * ASKING) / (1.0 - 1.5 * piece)
        queue = max(DEAD_MAN, needed) if self.dead_man is None else self.dead_man
        if queue < needed or queue > MAX_DEAD_MAN:
            number = 120 + grbl.AXES.index(self.axis)
            raise InvalidInput(
                "dead_man" if queue < needed else "speed",
                found=f"{queue:.3g} s" if queue < needed else f"{speed:.4g} mm/s",
                expected=f"a queue of at least {needed:.2g} s and at most {MAX_DEAD_MAN:.3g} s",
                hint=f"with an acceleration of {settings.acceleration:.4g} mm/s^2 (${number}) the "
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
        left = self._target - self._sent_to
        step = self._speed * self._queue / CHUNKS
        last = abs(left) <= 1.5 * step
        end = self._target if last else self._sent_to + math.copysign(step, left)
        # The last reported position lags, so that the queued motion is overestimated.
        if abs(end - self._coordinate(link.status)) > self._speed * self._queue:
            return None
        self._sent_to = end
        self._at_rest_since = None
        return grbl.move_line(self.axis, self._sent_to, self._speed)

    def wait(self) -> None:
        link = self._open
        with link.changed:
            while self.moving:
                # Wakes regularly, so that Ctrl-C is handled on every system.
                link.changed.wait(0.1)
            failure, self._failure = self._failure, ""
        if failure:
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
            off = abs(self._coordinate(status) - self._target)
            now = time.monotonic()
            self._at_rest_since = self._at_rest_since or now
            if self._sent_to == self._target and off <= 2e3 * NEAR:
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
            was_moving = self._target is not None
            if was_moving:
                self._give_up(link.trouble or "stop was requested")
        if link.lost:
            return
        status = link.status
        if not was_moving and status is not None and status.state in ("Idle", "Alarm"):
            return
        link.at_once(grbl.HOLD)
        self._wait_for_rest(link)
        link.reset()  # empties its queue

    def _wait_for_rest(self, link: GrblLink) -> None:
        """Wait until the drive has slowed down: an earlier reset would lose its position."""
        until = time.monotonic() + 0.3 + 1.5 * self._speed / self._slowing()
        with contextlib.suppress(DeviceFailed):
            while time.monotonic() < until:
                status = link.fresh_status(0.3)
                if status.state in ("Alarm", "Idle") or status[:2] == ("Hold", 0):
                    return

    def _slowing(self) -> float:
        return 10.0 if self._settings is None else self._settings.acceleration
