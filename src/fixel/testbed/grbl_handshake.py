"""Test whether the device at a serial port is a GRBL controller."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

from fixel.errors import InvalidInput
from fixel.testbed import grbl_lines as grbl
from fixel.testbed.serial_port import quoted, resets_on_opening

if TYPE_CHECKING:
    from serial import Serial

BOOT_TIME: Final = 3.0  # [s] in which an Arduino restarts after its port was opened
PATIENCE: Final = 0.25  # [s] between two attempts
QUESTIONS: Final = 4


def greet(link: Serial, port: str) -> None:
    """Check that a GRBL controller answers.

    Only the status request `?` is sent: it moves no controller, and is harmless to most other
    devices.

    Raises
    ------
    InvalidInput
        Another device answers, or none.
    """
    heard = _until(link, b"Grbl", BOOT_TIME) if resets_on_opening(link) else b""
    for _ in range(QUESTIONS):
        link.write(grbl.STATUS)
        answer = _until(link, b">", PATIENCE)
        heard += answer
        if any(_is_status(line) for line in answer.splitlines()):
            # Half a line of a previous program would corrupt our first one.
            link.write(b"\n")
            _until(link, b"\n", PATIENCE)
            return
        if answer and b"Grbl" not in heard and b"<" not in answer:
            break  # another device answers
    raise _refusal(port, heard)


def _until(link: Serial, end: bytes, patience: float) -> bytes:
    heard = b""
    until = time.monotonic() + patience
    while end not in heard and (left := until - time.monotonic()) > 0.0:
        link.timeout = left
        arrived = link.read(1)
        heard += arrived + (link.read(link.in_waiting) if arrived else b"")
    return heard


def _is_status(line: bytes) -> bool:
    return grbl.status_of(line.decode("ascii", "replace").strip()) is not None


def _refusal(port: str, heard: bytes) -> InvalidInput:
    where, expected = f"port {port}", "the actuator's controller (GRBL)"
    if not heard:
        return InvalidInput(
            where,
            found="no answer",
            expected=expected,
            hint="is it the right port (fixel actuator ports), the controller's power on, its speed"
            " 115200 baud?",
        )
    if len(heard) == 1 and heard[0] <= 7:
        return InvalidInput(
            where,
            found=f"one byte, {heard[0]}: the tactile board, it seems",
            expected=expected,
            hint="it is for fixel tactile; the controller is on another port",
        )
    if heard.strip() == grbl.STATUS:
        return InvalidInput(
            where,
            found="an echo of every byte: a modem, a console or a looped cable",
            expected=expected,
            hint="choose another port: fixel actuator ports",
        )
    return InvalidInput(
        where,
        found=f"something that says {quoted(heard)}",
        expected=expected,
        hint="choose another port: fixel actuator ports",
    )
