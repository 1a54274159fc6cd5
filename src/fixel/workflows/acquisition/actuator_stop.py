"""Stopping drives in an emergency. Nothing heavy is imported: every millisecond counts."""

from __future__ import annotations

from fixel.errors import DeviceFailed, InvalidInput
from fixel.testbed.emergency import running, stop_drive


def stop_actuators(port: str | None) -> list[str]:
    """Stop the drive at a port, or every drive that a program of this user moves; which ports.

    It writes to the port without asking the program that has it open.

    Raises
    ------
    DeviceFailed
        A drive that could not be stopped; the others were.
    """
    ports = [port] if port else [program.port for program in running()]
    if not ports:
        raise InvalidInput(
            "--port",
            found="no program of yours that drives an actuator",
            expected="one, or the port of the drive",
            hint="if something moves, switch its power off",
        )
    stopped, failed = [], []
    # One that cannot be stopped must not keep us from the rest.
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
