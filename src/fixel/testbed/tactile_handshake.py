"""Test whether the device at a serial port is the tactile board, of protocol 1 or 2."""

from __future__ import annotations

import re
import time
from typing import TYPE_CHECKING, Final

from fixel.errors import InvalidInput
from fixel.testbed import tactile_frames as frames
from fixel.testbed.serial_port import quoted, resets_on_opening

if TYPE_CHECKING:
    from serial import Serial

BOOT_TIME: Final = 2.0  # [s] the boot loader of a Mega waits a second for a new program
PATIENCE: Final = 0.25  # [s] between two attempts
QUESTIONS: Final = 4
# With these numbers the checksum consists of letters and digits: the request neither stops nor
# starts a motion controller on the port.
NUMBERS: Final = (9, 8)
OLD_CHECKS: Final = 3
GRBL: Final = re.compile(rb"Grbl|<(Idle|Run|Hold|Jog|Alarm|Home|Door|Check|Sleep)|error:\d|ALARM:")


def shake_hands(
    link: Serial, port: str, settle: float | None
) -> tuple[int, frames.Identity | None]:
    """Return the protocol of the board and its identity.

    Raises
    ------
    InvalidInput
        Another device answers, or none.
    """
    heard = _wait_for_boot(link, settle)
    if heard and GRBL.search(heard):
        raise _refusal(port, heard, b"")
    link.read(link.in_waiting)
    for number in (NUMBERS * QUESTIONS)[:QUESTIONS]:
        question = frames.request(frames.IDENTIFY, number)
        link.write(question)
        finder = frames.FrameFinder()
        answer = b""
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until:
            link.timeout = max(0.0, until - time.monotonic())
            arrived = link.read(1)
            arrived += link.read(link.in_waiting) if arrived else b""
            answer += arrived
            for frame in finder.add(arrived):
                identity = frames.identity_of(frame)
                if identity is not None and frame.number in NUMBERS:
                    return _known(identity, port), identity
        heard += answer
        if _is_old_board(link, question, answer):
            return 1, None
        if answer:
            break  # another device answers; more requests would only disturb it
    if not heard:
        heard = _asked_as_a_controller(link)
    raise _refusal(port, heard, question)


def _wait_for_boot(link: Serial, settle: float | None) -> bytes:
    """Wait until the board has started; return the bytes it sent meanwhile."""
    if settle is None:
        settle = BOOT_TIME if resets_on_opening(link) else 0.0
    heard = b""
    until = time.monotonic() + settle
    while (left := until - time.monotonic()) > 0.0:
        link.timeout = left
        heard += link.read(1)
    return heard


def _asked_as_a_controller(link: Serial) -> bytes:
    """Send the status request of motion controllers and return the answer, to identify them."""
    link.write(b"?")
    link.timeout = PATIENCE
    heard = link.read(1)
    time.sleep(0.02 if heard else 0.0)
    return heard + link.read(link.in_waiting)


def _is_old_board(link: Serial, question: bytes, answer: bytes) -> bool:
    """Whether every byte is answered by one plausible byte, in the answer and in new tests."""
    # A slow board answers several requests together.
    if not answer or len(answer) % len(question) or max(answer) > frames.OLD_MOST:
        return False
    for _ in range(OLD_CHECKS):
        link.write(frames.OLD_REQUEST)
        link.timeout = PATIENCE
        one = link.read(1)
        if not one or one[0] > frames.OLD_MOST or link.in_waiting:
            return False
    return True


def _known(identity: frames.Identity, port: str) -> int:
    if identity.protocol != frames.PROTOCOL or identity.sensors != frames.SENSORS:
        raise InvalidInput(
            f"port {port}",
            found=f"a tactile board of protocol {identity.protocol} with"
            f" {identity.sensors} sensors",
            expected=f"protocol {frames.PROTOCOL} with {frames.SENSORS} sensors",
            hint="upload the firmware that came with this version of fixel",
        )
    return identity.protocol


def _refusal(port: str, heard: bytes, question: bytes) -> InvalidInput:
    where, expected = f"port {port}", "the tactile board"
    if not heard:
        return InvalidInput(
            where,
            found="no answer",
            expected=expected,
            hint="is it the right port (fixel tactile ports), the firmware on it"
            " (firmware/README.md), the speed 115200 baud?",
        )
    if GRBL.search(heard):
        return InvalidInput(
            where,
            found=f"a motion controller that says {quoted(heard)}",
            expected=expected,
            hint="it is for fixel actuator; the board is on another port",
        )
    if question and question in heard:
        return InvalidInput(
            where,
            found="an echo of every byte: a modem, a console or a looped cable",
            expected=expected,
            hint="choose another port: fixel tactile ports",
        )
    return InvalidInput(
        where,
        found=f"something that says {quoted(heard)}",
        expected=expected,
        hint="if it is the board, upload firmware/tactile to it; else choose another port",
    )
