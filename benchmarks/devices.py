"""The bench's devices, emulated: round trips of the tactile board, and how soon a drive stops.

    python -m benchmarks.devices [--readings 10000] [--stops 10] [--axes XY]

The board's firmware runs in an emulated Mega 2560, the drive behind an emulated GRBL controller;
a real USB adapter adds its own latency, of a millisecond or so.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

from fixel.testbed import emergency
from fixel.testbed.emulators import bench as emulated_mega
from fixel.testbed.emulators.grbl import EmulatedGrbl
from fixel.testbed.tactile import DEADLINE, TactileReader

PROGRAM = """
import sys, time
from fixel.testbed.motion_grbl import GrblActuator
drive = GrblActuator(sys.argv[1], dead_man=float(sys.argv[2]), axes=sys.argv[3])
drive.connect()
if drive.n_axes == 2:
    drive.aim([0.0, 0.0], [0.6, 0.8])
drive.move(by=0.1, speed=0.0135, wait=False)
time.sleep(0.2)
print(drive._guard.pid, flush=True)
if sys.argv[4]:  # a server that is asked to stop
    sys.stdin.readline()
    drive.stop()
sum(range(10**10))  # minutes during which no other Python code of this process runs
"""
CLI = [sys.executable, "-c", "from fixel.cli.main import run; run()", "actuator", "stop"]


def main() -> None:
    """Measure, and print one line a figure."""
    parser = argparse.ArgumentParser(description="The bench's devices, emulated.")
    parser.add_argument("--readings", type=int, default=10_000)
    parser.add_argument("--stops", type=int, default=10)
    parser.add_argument("--axes", default="X", choices=("X", "XY"))
    chosen = parser.parse_args()
    reason = emulated_mega.why_not()
    if reason:
        print(f"no tactile board: {reason}")
    else:
        measure_readings(chosen.readings)
    with tempfile.TemporaryDirectory() as folder:
        # `fixel actuator stop` must not stop the drives of other programs.
        os.environ |= {"XDG_RUNTIME_DIR": folder, "TMPDIR": folder}
        measure_stops(chosen.stops, chosen.axes)


def measure_readings(readings: int) -> None:
    """Round trips and losses of the tactile board."""
    with tempfile.TemporaryDirectory() as folder:
        built = emulated_mega.built(Path(folder))
        with (
            emulated_mega.EmulatedMega(built) as mega,
            TactileReader(mega.port, deadline=1.0) as reader,
        ):
            trips = []
            for _ in range(readings):
                reader.read()
                trips.append(reader.statistics.round_trips[-1])
            counts = reader.statistics.summary()
    trips.sort()
    lost = {name: counts[name] for name in ("missing", "late", "garbled", "stray_bytes")}
    over = sum(trip > DEADLINE for trip in trips)
    print(f"{readings} readings: {lost}, {over} later than {1e3 * DEADLINE:.3g} ms")
    print(f"round trip {1e3 * median(trips):.2f} ms median", end=", ")
    print(f"{1e3 * trips[int(0.99 * readings)]:.2f} ms 99 %, {1e3 * trips[-1]:.2f} ms at most")


def _kill_all(*processes: int) -> None:
    for process in processes:
        os.kill(process, signal.SIGKILL)


def measure_stops(stops: int, axes: str) -> None:
    """Time from an event to rest, while the program computes, or waits to `stop()`."""
    ways: dict[str, Callable[[int, int, str], object] | None] = {
        "Ctrl-C": lambda program, guard, port: os.killpg(program, signal.SIGINT),
        "SIGINT to the program alone": lambda program, guard, port: os.kill(program, signal.SIGINT),
        "emergency.stop_drive elsewhere": lambda program, guard, port: emergency.stop_drive(port),
        "stop() of the program": None,
        "fixel actuator stop": lambda program, guard, port: subprocess.run(
            CLI, check=True, stdout=subprocess.DEVNULL
        ),
        "kill -9 of the program": lambda program, guard, port: os.kill(program, signal.SIGKILL),
        "kill -9 of program and guard": lambda program, guard, port: _kill_all(guard, program),
    }
    for name, way in ways.items():
        # Long enough that the way is measured; the last is about the queue itself, as it comes.
        dead_man = 0.5 if "guard" in name else 3.0
        took = sorted(_stopped_after(way, dead_man, axes) for _ in range(stops))
        print(f"{name}: {1e3 * median(took):.1f} ms median, {1e3 * took[-1]:.1f} ms at most")


def _stopped_after(
    way: Callable[[int, int, str], object] | None, dead_man: float, axes: str
) -> float:
    with EmulatedGrbl(acceleration=500.0) as controller:
        command = [sys.executable, "-c", PROGRAM, controller.port, str(dead_man), axes]
        running = subprocess.Popen(
            [*command, "" if way else "stop"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        assert running.stdout is not None
        assert running.stdin is not None
        try:
            guard = int(running.stdout.readline())
            time.sleep(0.02)
            since = time.monotonic()
            if way is None:
                running.stdin.write(b"stop\n")
                running.stdin.flush()
            else:
                way(running.pid, guard, controller.port)
            while controller.speed > 0.0:
                time.sleep(0.0002)
            return controller.stopped - since
        finally:
            running.kill()
            running.communicate()


if __name__ == "__main__":
    main()
