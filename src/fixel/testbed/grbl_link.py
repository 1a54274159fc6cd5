"""Connection to a GRBL controller, and its identification after opening its port."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Final, final

from fixel.errors import DeviceFailed
from fixel.testbed import grbl_lines as grbl
from fixel.testbed.grbl_lines import GrblStatus
from fixel.testbed.serial_port import arrived_within, refusal, resets_on_opening

if TYPE_CHECKING:
    from serial import Serial


ASKING: Final = 0.04  # [s] between two status requests
TURN: Final = 0.01  # [s] longest time between two checks of the thread for lines to send
LATE: Final = 0.05  # [s] most that one turn of the thread counts as listening
SILENCE: Final = 1.0  # [s] without a status report after which the controller counts as gone
ANSWER: Final = 2.0  # [s] timeout of a command that takes no time
BOOT_TIME: Final = 3.0  # [s] in which an Arduino restarts after its port was opened
PATIENCE: Final = 0.25  # [s] between two attempts
QUESTIONS: Final = 4


@final
class GrblLink:
    """Lines to a controller and its answers; every method may be called from any thread.

    Unanswered bytes are counted, so that the controller's buffer of 128 bytes never overflows.

    The port is that of a GRBL controller, as `greet` found. `next_line` is called repeatedly in the
    link's own thread, which holds `changed`; it returns the next line of a move, or None for no
    more at present.
    """

    def __init__(self, port: Serial, next_line: Callable[[], str | None]) -> None:
        # Notified when anything below changes; hold it to read more than one of them.
        self.changed = threading.Condition(threading.RLock())
        self.status: GrblStatus | None = None  # last report
        self.reported = time.monotonic()  # arrival of the last report, on `time.monotonic` [s]
        # How long the thread has listened [s]: `time.monotonic` without the time for which a busy
        # computer suspended it. All times to wait for the controller are counted by it.
        self.listened = self._heard = 0.0
        # Whether the last report was requested after the last line was accepted.
        self.current = False
        # Why a move cannot continue: an alarm, a reset, a refused line, a lost connection.
        self.trouble = ""
        self.lost = False  # whether the controller is no longer there
        self.resets = 0
        self.losses = 0  # alarms, and resets that this program did not request; see `zero_known`
        self.offset: tuple[float, ...] = (0.0,) * len(grbl.AXES)  # of work coordinates
        self._port = port
        self._next_line = next_line
        self._partial = b""
        self._unanswered: deque[int] = deque()  # lengths of lines
        self._answers: list[str] | None = None  # to the pending command
        self._verdict = ""
        self._asked = self._accepted = self._sent = 0.0
        self._ended = self._resetting = False
        self._thread = threading.Thread(target=self._run, name="grbl", daemon=True)
        self._thread.start()

    def at_once(self, realtime: bytes) -> None:
        """Send a byte that takes effect ahead of everything queued."""
        with contextlib.suppress(OSError):
            self._port.write(realtime)

    def command(self, line: str, patience: float = ANSWER) -> list[str]:
        """Send one line, wait until it is done, and return the lines received in between.

        If it was refused, or an alarm or no answer came, raise `DeviceFailed`.
        """
        with self.changed:
            self._answers, self._verdict, self.trouble = [], "", ""
            self._send(line)
            try:
                self._await(lambda: self._verdict or self.trouble, patience)
            finally:
                answers, self._answers = self._answers, None
            if self._verdict == "ok":
                return answers
            why = self._verdict or self.trouble or f"no answer to {line} in {patience:.3g} s"
            raise DeviceFailed(why)

    @property
    def occupied(self) -> bool:
        """Whether a command such as homing is not answered yet."""
        return self._answers is not None

    def _await(self, condition: Callable[[], object], patience: float) -> None:
        """Wait for a condition, or until the thread has listened for a time [s] or has ended."""
        until = self.listened + patience
        while not (condition() or self.lost or self._ended or self.listened >= until):
            self.changed.wait(0.05)

    def fresh_status(self, patience: float = SILENCE) -> GrblStatus:
        """Wait for a report that was requested after the call, or raise `DeviceFailed`."""
        with self.changed:
            called = time.monotonic()
            self._await(lambda: self.status is not None and self.reported >= called, patience)
            if self.status is None or self.reported < called:
                raise DeviceFailed(self.trouble or f"no status report in {patience:.3g} s")
            return self.status

    def idle(self) -> bool:
        """Whether all lines sent were accepted and carried out."""
        return (
            not self._unanswered
            and self.current
            and self.status is not None
            and self.status.state == "Idle"
        )

    def reset(self, patience: float = 1.0) -> None:
        """Clear the controller's queue by a reset, and return when it has restarted."""
        with self.changed:
            before = self.resets
            self._resetting = True
            self.at_once(grbl.RESET)
            self._await(lambda: self.resets != before, patience)
            self._resetting = False
            self._unanswered.clear()
            if not self.lost:
                self.trouble = ""

    def close(self) -> None:
        """End the thread and close the port."""
        self._ended = True
        if self._thread is not threading.current_thread():
            self._thread.join()
        self._port.close()

    # --- the thread ---------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._converse()
        except Exception as problem:  # otherwise the caller would wait for a move without end
            self._lose(problem)

    def _converse(self) -> None:
        self._port.timeout = TURN
        now = time.monotonic()
        while not self._ended and not self.lost:
            try:
                self._ask()
                arrived = self._port.read(1)
                arrived += self._port.read(self._port.in_waiting) if arrived else b""
                before, now = now, time.monotonic()
                with self.changed:
                    self.listened += min(now - before, LATE)
                    for line in self._lines(arrived):
                        self._hear(line)
                    self._miss_controller()
                    self._feed()
            except (OSError, TypeError) as problem:  # TypeError: closed while pyserial reads
                self._lose(problem)

    def _ask(self) -> None:
        now = time.monotonic()
        if now - self._asked > ASKING:
            self._asked = now
            self._port.write(grbl.STATUS)

    def _miss_controller(self) -> None:
        """Report silence, after everything that arrived was read."""
        # A command such as homing may occupy the controller, and has its own timeout; an unanswered
        # line of a move has none.
        if self.listened - self._heard > SILENCE and self._answers is None:
            self.trouble = self.trouble or f"the controller has not responded for {SILENCE:.3g} s"
            self.changed.notify_all()

    def _lines(self, arrived: bytes) -> list[str]:
        *whole, self._partial = (self._partial + arrived).split(b"\n")
        return [text for line in whole if (text := line.decode("ascii", "replace").strip())]

    def _hear(self, line: str) -> None:
        status = grbl.status_of(line)
        if status is not None:
            if self.status is not None and 0 < self.status.n_axis != status.n_axis:
                return  # damaged: it lacks the position of an axis that the previous one had
            self.offset = status.offset or self.offset
            self.current = self._asked > self._accepted
            self.status, self.reported, self._heard = status, time.monotonic(), self.listened
            self._miss_answers()
        elif line == "ok":
            self._accept("ok")
        elif (number := grbl.number_after(line, "error:")) is not None:
            why = f"the controller rejected a line: {grbl.ERRORS.get(number, f'error {number}')}"
            if self._answers is None:
                self.trouble = self.trouble or why
            self._accept(why)
        elif (number := grbl.number_after(line, "ALARM:")) is not None:
            self.losses += 1
            self.trouble = f"alarm of the controller: {grbl.ALARMS.get(number, f'{number}')}"
        elif line.startswith(grbl.GREETINGS):
            self.resets += 1
            self.losses += not self._resetting
            self._unanswered.clear()
            # `reset` clears the trouble, perhaps before a command that waits has read it.
            self._verdict = self.trouble = self.trouble or "the controller was reset"
        elif self._answers is not None:
            self._answers.append(line)
        self.changed.notify_all()

    def _miss_answers(self) -> None:
        """Report a lost answer: a controller at rest answered every line unless one was damaged."""
        owes = self._unanswered and self._answers is None
        at_rest = self.status is not None and self.status.state == "Idle"
        if owes and at_rest and self.listened - self._sent > SILENCE:
            self._unanswered.clear()
            self.trouble = self.trouble or "a reply of the controller was lost"

    def _accept(self, verdict: str) -> None:
        if self._unanswered:
            self._unanswered.popleft()
        self._accepted, self._heard = time.monotonic(), self.listened
        self.current = False
        if self._answers is not None and not self._unanswered:
            self._verdict = verdict

    def _feed(self) -> None:
        while not self.trouble and self._answers is None:
            room = grbl.BUFFER - sum(self._unanswered)
            # All our lines are shorter; `next_line` must not make one that cannot be sent.
            line = self._next_line() if room > 72 else None
            if line is None:
                return
            self._send(line)

    def _send(self, line: str) -> None:
        data = line.encode("ascii") + b"\n"
        self._unanswered.append(len(data))
        self._sent = self.listened
        self.current = False
        try:
            self._port.write(data)
        except OSError as problem:
            self._lose(problem)

    def _lose(self, problem: Exception) -> None:
        with self.changed:
            self.lost = True
            self.trouble = f"the connection to the controller was lost: {problem}"
            self.changed.notify_all()


def greet(link: Serial, port: str) -> None:
    """Check that a GRBL controller answers; raise `InvalidInput` for other devices.

    Only the status request `?` is sent: it moves no controller, and is harmless to most other
    devices.
    """
    heard = arrived_within(link, BOOT_TIME, b"Grbl") if resets_on_opening(link) else b""
    for _ in range(QUESTIONS):
        link.write(grbl.STATUS)
        answer = arrived_within(link, PATIENCE, b">")
        heard += answer
        lines = answer.decode("ascii", "replace").splitlines()
        if any(grbl.status_of(line.strip()) for line in lines):
            # Half a line of a previous program must neither be executed nor corrupt our first one:
            # a letter without a number makes every line invalid.
            link.write(b"Q\n")
            arrived_within(link, PATIENCE, b"\n")
            return
        if answer and b"Grbl" not in heard and b"<" not in answer:
            break  # another device answers
    known = None
    if len(heard) == 1 and heard[0] <= 7:
        found = f"one byte, {heard[0]}, as from the tactile board"
        known = found, "use that port with fixel tactile; the controller is on another port"
    raise refusal(
        port, "the actuator's controller (GRBL)", heard, group="actuator", known=known,
        silent="the power of the controller, and its speed of 115200 baud",
        echo=heard.strip() == grbl.STATUS,
    )  # fmt: skip
