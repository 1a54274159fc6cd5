"""Stop drives in an emergency. Nothing heavy is imported: every millisecond counts."""

from __future__ import annotations

from fixel.errors import DeviceFailed, InvalidInput
from fixel.testbed.emergency import running, stop_drive


def stop_actuators(port: str | None) -> list[str]:
    """Stop the drive at a port, or all drives moved by programs of this user; return the ports.

    Writes to the port although another program has it open.

    Raises
    ------
    DeviceFailed
        A drive could not be stopped; the others were stopped.
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
