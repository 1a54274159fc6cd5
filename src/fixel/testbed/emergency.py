"""Emergency stop of a drive by a guard process, or from any other process.

Nothing heavy is imported: every millisecond counts.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import select
import signal
import stat
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Final, NamedTuple

from fixel.errors import DeviceFailed, InvalidInput
from fixel.io.lock import is_running

GUARD: Final = Path(__file__).with_name("stop_guard.py")
STOP: Final = b"!\x18"
START_TIME: Final = 5.0  # [s] in which the guard must start, on a loaded computer
END_TIME: Final = 5.0  # [s] in which the guard must end


class Running(NamedTuple):
    """Program that drives an actuator."""

    port: str
    pid: int  # process id of the program
    guard: int  # process id of its guard; 0 without a guard


class StopGuard:
    """Separate process that stops the drive when this one cannot.

    It has the descriptor of the open port, and the name under which other processes can open it.
    With `keys`, any key on this terminal stops the drive.
    """

    def __init__(self, port: str, descriptor: int, *, keys: bool = False) -> None:
        self._entry: Path | None = None
        self._previous_wakeup: int | None = None
        terminal = _terminal() if keys else -1
        shared = [descriptor] + [terminal] * (terminal >= 0)
        command = [sys.executable, "-I", "-S", str(GUARD), str(descriptor), str(terminal)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, pass_fds=shared
        )
        if terminal >= 0:
            os.close(terminal)
        self._to_guard, self._from_guard = self._process.stdin, self._process.stdout
        assert self._to_guard is not None
        assert self._from_guard is not None
        self._pipe = self._to_guard.fileno()
        if not self._starts():
            self._process.kill()
            self._let_go()
            raise DeviceFailed("the process that stops the drive in an emergency did not start")
        os.set_blocking(self._pipe, False)
        try:
            self._announce(port)
            self._hear_signals()
        except BaseException:
            self.release()
            raise

    @property
    def pid(self) -> int:
        """Process id of the guard."""
        return self._process.pid

    def release(self) -> None:
        """End the guard; the drive is not touched."""
        if self._previous_wakeup is not None:
            signal.set_wakeup_fd(self._previous_wakeup)
            self._previous_wakeup = None
        if self._entry is not None:
            self._entry.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            os.write(self._pipe, b"q")
        self._let_go()

    def _starts(self) -> bool:
        """Whether the guard reports in time that it is ready."""
        assert self._from_guard is not None
        said = select.select([self._from_guard], [], [], START_TIME)[0]
        return bool(said) and self._from_guard.readline() == b"ready\n"

    def _let_go(self) -> None:
        """Close the pipes and wait for the guard to end; kill it if it hangs."""
        for pipe in (self._to_guard, self._from_guard):
            assert pipe is not None
            with contextlib.suppress(OSError):
                pipe.close()
        try:
            self._process.wait(END_TIME)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _hear_signals(self) -> None:
        # The interpreter writes a signal's number here at once, even while the main thread computes
        # outside Python.
        if threading.current_thread() is not threading.main_thread():
            return
        previous = signal.set_wakeup_fd(self._pipe, warn_on_full_buffer=False)
        if previous != -1:
            signal.set_wakeup_fd(previous)  # it belongs to an event loop
            return
        self._previous_wakeup = previous

    def _announce(self, port: str) -> None:
        target = os.path.realpath(port)
        name = hashlib.sha256(target.encode()).hexdigest()[:16]
        entry = json.dumps(Running(target, os.getpid(), self.pid)._asdict())
        for folder in announcements():
            with contextlib.suppress(OSError):
                folder.mkdir(mode=0o700, parents=True, exist_ok=True)
                if not _is_ours(folder):
                    continue
                self._entry = folder / f"{name}.json"
                self._entry.write_text(entry, encoding="utf-8")
                return
        raise DeviceFailed(
            f"cannot register this program for `fixel actuator stop`: {tempfile.gettempdir()} is "
            "not writable",
            hint=f"free disk space in {tempfile.gettempdir()}, or allow writing there",
        )


def announcements() -> list[Path]:
    """Folders in which this user's programs that drive an actuator register.

    A program uses the first writable one. A search must read all of them, since terminals of one
    user may differ in the environment variable of their session.
    """
    user = os.getuid() if hasattr(os, "getuid") else 0
    session = os.environ.get("XDG_RUNTIME_DIR") or f"/run/user/{user}"
    places = [session] * os.path.isdir(session) + [tempfile.gettempdir()]
    return [Path(place) / f"fixel-actuators-{user}" for place in places]


def _is_ours(folder: Path) -> bool:
    """Whether a folder exists and is of this user: others may create it in a shared folder."""
    with contextlib.suppress(OSError):
        found = folder.lstat()
        return stat.S_ISDIR(found.st_mode) and found.st_uid == getattr(os, "getuid", int)()
    return False


def running() -> list[Running]:
    """Programs of this user that drive an actuator now."""
    found = []
    ours = filter(_is_ours, announcements())
    for path in sorted(path for folder in ours for path in folder.glob("*.json")):
        try:
            entry = json.loads(path.read_text(encoding="utf-8"))
            program = Running(str(entry["port"]), int(entry["pid"]), int(entry["guard"]))
        except (OSError, ValueError, KeyError, TypeError):
            continue
        # The guard outlives its program until it has sent the stop to the drive.
        if is_running(program.pid) or is_running(program.guard):
            found.append(program)
        else:
            path.unlink(missing_ok=True)
    return found


def stop_drive(port: str) -> float:
    """Write the stop command to a port that another program may have open.

    The time of writing is returned, on `time.monotonic` [s]. `DeviceFailed` is raised where the
    port cannot be written to.
    """
    if sys.platform == "win32":
        hint = "switch off the power of the drive"
        raise DeviceFailed("this system cannot write to the port of another program", hint=hint)
    try:
        # Opening for writing ignores the lock of the program that uses the port.
        descriptor = os.open(port, os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            if not os.isatty(descriptor):
                raise OSError(errno.ENOTTY, "it is not a serial port")
            _drop_unsent(descriptor)
            os.write(descriptor, STOP)
            return time.monotonic()
        finally:
            os.close(descriptor)
    except OSError as problem:
        raise DeviceFailed(
            f"{port} cannot be written to: {problem.strerror}",
            hint="switch off the power of the drive",
        ) from None


def stop_actuators(port: str | None) -> list[str]:
    """Stop the drive at a port, or all drives moved by programs of this user; return the ports.

    Writes to the port although another program has it open. If a drive could not be stopped, the
    others are stopped, and `DeviceFailed` is raised.
    """
    ports = [port] if port else [program.port for program in running()]
    if not ports:
        found = "no program of yours that moves a drive"
        expected = "such a program, or the port of the drive"
        hint = "if a drive moves, switch off its power"
        raise InvalidInput("--port", found=found, expected=expected, hint=hint)
    stopped, failed = [], []
    # A drive that cannot be stopped must not prevent stopping the others.
    for one in ports:
        try:
            stop_drive(one)
            stopped.append(one)
        except DeviceFailed as failure:
            failed.append(failure)
    if failed:
        reasons = "; ".join(failure.reason for failure in failed)
        others = f" (stopped: {', '.join(stopped)})" if stopped else ""
        raise DeviceFailed(reasons + others, failed[0].hint)
    return stopped


def _drop_unsent(descriptor: int) -> None:
    import termios

    with contextlib.suppress(termios.error):
        termios.tcflush(descriptor, termios.TCOFLUSH)


def _terminal() -> int:
    try:
        return os.open("/dev/tty", os.O_RDWR)
    except OSError:
        return -1
