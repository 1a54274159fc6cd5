"""Serial ports: list them, open one exclusively, and explain failures."""

from __future__ import annotations

import errno
import os
import re
import string
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from fixel.errors import InvalidInput, require

if TYPE_CHECKING:
    from serial import Serial

ARDUINO: Final = {  # USB vendor and product, as the makers registered them
    (0x2341, 0x0010): "Arduino Mega 2560",
    (0x2341, 0x0042): "Arduino Mega 2560",
    (0x2341, 0x0043): "Arduino Uno",
    (0x1A86, 0x7523): "CH340 adapter, as on many Arduino clones",
}
FIRST_WORDS: Final = 60  # [bytes] of a port's answer that a message quotes


class PortSeen(NamedTuple):
    """Serial port of this computer."""

    port: str  # name to open: `/dev/ttyACM0`, `COM4`
    description: str  # description by the system or the device
    in_use_by: str  # programs that have it open, as far as the system shows; empty for none


def found_ports() -> list[PortSeen]:
    """List the serial ports of this computer, those on USB first."""
    require("serial", "a serial port", extra="serial")
    from serial.tools import list_ports

    seen = sorted(list_ports.comports(), key=lambda port: (port.vid is None, port.device))
    found = []
    for port in seen:
        stated = port.description if port.description != "n/a" else ""
        name = ARDUINO.get((port.vid or 0, port.pid or 0), stated or "no description")
        found.append(PortSeen(port.device, name, _program_at(port.device)))
    return found


def chosen_port(port: str | None, what: str) -> str:
    """Return the port that was named; raise with a list of the ports if none was.

    `what` is the device expected at the port, such as `"the tactile board"`.
    """
    if port:
        return port
    raise InvalidInput("port", found=None, expected=f"the port of {what}", hint=_seen())


def open_port(port: str, baud: int, what: str) -> Serial:
    """Open a port, such as `/dev/ttyACM0` or `COM4`, exclusively; `baud` is in bits per second.

    A port that does not exist, is in use, or may not be opened raises `InvalidInput` with a remedy.
    """
    require("serial", "a serial port", extra="serial")
    import serial

    try:
        return serial.Serial(port, baud, timeout=0.0, write_timeout=1.0, exclusive=True)
    except Exception as problem:  # termios.error, which pyserial lets through, is no OSError
        reason, expected, hint = _errno(problem), what, ""
        found = "no serial port" if reason in (errno.ENOTTY, errno.EISDIR) else f"{problem}"
        if reason in (errno.EAGAIN, errno.EWOULDBLOCK, errno.EBUSY):
            found = f"a port in use by {_program_at(port) or 'another program'}"
            expected, hint = f"{what} at a port that is free", "close it"
        elif reason in (errno.EACCES, errno.EPERM) and sys.platform != "win32":
            found = "no permission to open the port"
            hint = "become a member of its group and log in again:"
            hint += f" sudo usermod -aG {_group(port)} $USER"
        elif not os.path.exists(port) and sys.platform != "win32":
            found = "no port"
        hint = hint or _seen()
        raise InvalidInput(f"port {port}", found=found, expected=expected, hint=hint) from None


@contextmanager
def closed_on_failure(close: Callable[[], None], port: str, what: str) -> Iterator[None]:
    """Close an open port if the block fails; raise `InvalidInput` if the port disappeared."""
    try:
        yield
    except OSError as problem:
        close()
        found, hint = f"that the device was disconnected: {problem}", "connect it again"
        raise InvalidInput(f"port {port}", found=found, expected=what, hint=hint) from None
    except BaseException:
        close()
        raise


def resets_on_opening(port: Serial) -> bool:
    """Whether opening the port restarts its board: real ports have the control line for it,
    pseudo-terminals and sockets have none."""
    if sys.platform == "win32":
        return True
    import fcntl
    import termios

    try:
        fcntl.ioctl(port.fileno(), termios.TIOCMGET, b"\0\0\0\0")
    except OSError:
        return False
    return True


def arriving(port: Serial, until: float) -> bytes:
    """Wait for a byte until an instant of `time.monotonic` [s]; return all that has arrived."""
    port.timeout = max(0.0, until - time.monotonic())
    first = port.read(1)
    return first + (port.read(port.in_waiting) if first else b"")


def arrived_within(port: Serial, patience: float, end: bytes | None = None) -> bytes:
    """Return what arrives within a time [s], or until `end` has arrived."""
    until, heard = time.monotonic() + patience, b""
    while True:  # at least once, since this thread may be late
        heard += arriving(port, until)
        if (end is not None and end in heard) or time.monotonic() >= until:
            return heard


def refusal(
    port: str, expected: str, heard: bytes, *, group: str, silent: str, echo: bool,
    known: tuple[str, str] | None = None, hint: str = "",
) -> InvalidInput:  # fmt: skip
    """Return the error for a port with another device than the expected one, or none.

    `group` are the commands for the expected device, such as `tactile`; `silent` is what to check
    where nothing was sent; `echo` is whether the port returns what it gets. Of a `known` device
    there are words and advice.
    """
    elsewhere = f"choose another port: fixel {group} ports"
    found, advice = f"a device that sent {quoted(heard)}", hint or elsewhere
    if not heard:
        found, advice = "no answer", f"check the port (fixel {group} ports), {silent}"
    elif known:
        found, advice = known
    elif echo:
        found, advice = "an echo of every byte: a modem, a console or a looped cable", elsewhere
    return InvalidInput(f"port {port}", found=found, expected=expected, hint=advice)


def quoted(said: bytes) -> str:
    """Format the answer of a port for a message: text as text, other bytes in hexadecimal."""
    if not said:
        return "nothing"
    first = said[:FIRST_WORDS]
    more = f" ... ({len(said)} bytes)" if len(said) > len(first) else ""
    text = first.decode("ascii", "replace").strip()
    if text and all(letter in string.printable for letter in text):
        return f'"{" ".join(text.split())}"{more}'
    return " ".join(f"{byte:02x}" for byte in first[:16]) + (
        f" ... ({len(said)} bytes)" if len(said) > 16 else ""
    )


def _seen() -> str:
    ports = found_ports()
    if not ports:
        return "there is no serial port: connect the device; on Linux, dmesg shows its port"
    return "ports here: " + ", ".join(f"{port.port} ({port.description})" for port in ports[:6])


def _errno(problem: Exception) -> int | None:
    # pyserial's own exceptions have the number as first argument or in their text.
    if problem.args and isinstance(problem.args[0], int):
        return problem.args[0]
    found = re.search(r"\[Errno (\d+)\]|\((\d+), ", str(problem))
    return int(found[1] or found[2]) if found else None


def _group(port: str) -> str:
    try:
        import grp

        return grp.getgrgid(os.stat(port).st_gid).gr_name
    except (ImportError, KeyError, OSError):
        return "dialout"


def _program_at(port: str) -> str:
    """Name the processes that have a port open; empty where the system shows none."""
    users = []
    try:
        target = os.path.realpath(port)
        # This process is left out.
        for folder in sorted(Path("/proc").glob("[0-9]*"), key=lambda path: int(path.name)):
            name = _name_if_open(folder, target)
            if name:
                users.append(f"{name} (process {folder.name})")
    except OSError:
        pass
    return " and ".join(users)


def _name_if_open(folder: Path, target: str) -> str:
    try:
        for link in (folder / "fd").iterdir():
            if os.readlink(link) == target and int(folder.name) != os.getpid():
                return (folder / "comm").read_text().strip()
    except OSError:
        pass  # it ended meanwhile, or belongs to another user
    return ""
