"""Emulated bench: a film as camera, firmware in an emulator, and a controller to move.

The tactile board runs its firmware in an emulator, behind a pseudo-terminal. The emulator is built
from `firmware/` of a checkout with Debian's AVR tools and libsimavr (GPL 3); it is not part of the
installed package. `why_not()` names missing prerequisites.
"""

from __future__ import annotations

import select
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final, Self

import numpy as np

from fixel.errors import FixelError
from fixel.formats.recording import Recording, open_recording
from fixel.model import LineDrive, Scene
from fixel.testbed.file_source import FILM, LoopbackCamera
from fixel.testbed.recorder import RecordingStatus

if TYPE_CHECKING:
    from fixel.testbed.motion import AbstractActuator


class EmulatedBench:
    """Camera, fixels and drive for a recorder, without hardware."""

    def __init__(
        self,
        film: Recording,
        camera: str,
        board: EmulatedMega | None,
        actuator: AbstractActuator | None,
    ) -> None:
        self.camera = camera  # address of the network camera that plays the film
        self.actuator = actuator  # GRBL driver of an emulated controller
        # Port of the board; `film:FOLDER` for the film's readings where it cannot be emulated.
        self.tactile = f"{FILM}:{film.folder}" if board is None else board.port
        self._film, self._board = film, board
        self._move: threading.Thread | None = None
        self._failure: FixelError | None = None

    def begin(self, status: RecordingStatus, scene: Scene, lead: float) -> None:
        """Schedule the contacts of the film, which has started to play, and start the drive."""
        if self._board is not None:
            time, bits = self._film.time - self._film.time[0], self._film.readings
            for k in np.flatnonzero(np.diff(bits, prepend=-1)).tolist():
                self._board.touch(int(bits[k]), max(0.0, float(time[k]) - status.seconds))
        drive = scene.pushers[0].drive
        if self.actuator is not None and isinstance(drive, LineDrive):
            travel = drive.distance(scene.duration)
            self._move = threading.Thread(
                target=self._drive, args=(max(0.0, lead - status.seconds), travel, drive.speed)
            )
            self._move.start()

    def end(self) -> float | None:
        """Wait for the drive and return its position [m]; raise if it did not move as it should."""
        if self.actuator is None:
            return None
        if self._move is not None:
            self._move.join()
        if self._failure is not None:
            raise self._failure
        return self.actuator.position()

    def _drive(self, wait: float, travel: float, speed: float) -> None:
        assert self.actuator is not None
        time.sleep(wait)
        try:
            self.actuator.move(by=travel, speed=speed)
        except FixelError as failure:
            self._failure = failure


@contextmanager
def emulated_bench(film: Path, firmware: Path | None) -> Iterator[EmulatedBench]:
    """Create a bench that plays the film of a folder, with a board whose firmware was `built`."""
    from fixel.testbed.emulators.grbl import EmulatedGrbl

    with ExitStack() as stack:
        camera = stack.enter_context(LoopbackCamera(film))
        board = None if firmware is None else stack.enter_context(EmulatedMega(firmware))
        actuator: AbstractActuator | None = None
        if sys.platform != "win32":  # it has no pseudo-terminals: the drive is left out
            from fixel.testbed.motion_grbl import GrblActuator

            controller = stack.enter_context(EmulatedGrbl(start=0.0))
            actuator = stack.enter_context(GrblActuator(controller.port))
        yield EmulatedBench(open_recording(film), camera.url, board, actuator)


FIRMWARE: Final = Path(__file__).parents[4] / "firmware"
PACKAGES: Final = (
    "make arduino-core-avr gcc-avr avr-libc gcc libc6-dev libsimavr-dev libelf-dev",
    "/usr/share/arduino/hardware/arduino/avr/cores/arduino/Arduino.h",
    "/usr/include/simavr/sim_avr.h",
)
CHANNEL_OF_BIT: Final = (2, 0, 1)  # bit 0 blue A2, bit 1 red A0, bit 2 green A1
TOUCHED_V, FREE_V = 4.9, 0.4
ANSWERS_WITHIN: Final = 10.0  # [s], for the emulator on a loaded computer
BUILT_WITHIN: Final = 300.0  # [s], also if another process builds it first


def why_not() -> str:
    """Reason why the emulator cannot run here; empty if it can."""
    packages, *headers = PACKAGES
    if not (FIRMWARE / "Makefile").is_file():
        return "the firmware is in a checkout of fixel, not in the installed package"
    programs = ("make", "avr-gcc", "avr-g++", "cc")
    missing = [name for name in programs if shutil.which(name) is None]
    missing += [name for name in headers if not Path(name).is_file()]
    return f"no {missing[0]}; apt install {packages}" if missing else ""


def built(folder: Path) -> Path:
    """Build firmware and emulator in a folder, unless they exist; return the folder."""
    folder = folder.resolve()  # make works in another folder
    folder.mkdir(parents=True, exist_ok=True)
    command = ["make", "-s", "-j2", "-C", str(FIRMWARE), f"BUILD={folder}", "emulator"]
    # Two test processes may build it at once; util-linux's flock makes one of them wait.
    if shutil.which("flock"):
        command = ["flock", str(folder / "lock"), *command]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, timeout=BUILT_WITHIN
    )
    if done.returncode:
        raise RuntimeError(f"the firmware was not built:\n{done.stderr[-2000:]}")
    return folder


class EmulatedMega:
    """Emulated Mega 2560 that runs the tactile firmware of a `built` folder in real time."""

    def __init__(self, folder: Path) -> None:
        self._place = tempfile.TemporaryDirectory(prefix="fixel-mega-")
        self.port = f"{self._place.name}/ttyACM0"  # path of the port to open
        program, firmware = folder / "emulated_mega", folder / "tactile.elf"
        self._process = subprocess.Popen(
            [program, firmware, self.port],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        )
        if not self._answer().startswith("ready"):
            self.close()
            raise RuntimeError("the emulator did not start")

    def tell(self, command: str) -> str:
        """Send a command to the emulator itself (see `emulated_mega.c`); return its answer."""
        assert self._process.stdin is not None
        self._process.stdin.write(command + "\n")
        answer = self._answer()
        if not answer.startswith("ok"):
            said = repr(answer) if answer else f"no answer within {ANSWERS_WITHIN:g} s"
            raise RuntimeError(f"the emulator received {command!r}, and answered {said}")
        return answer[3:]

    def touch(self, bits: int, after: float = 0.0) -> None:
        """Close the contacts of these bits and open the others, `after` seconds from now."""
        for bit, channel in enumerate(CHANNEL_OF_BIT):
            volts = TOUCHED_V if bits >> bit & 1 else FREE_V
            self.tell(f"at {round(1e3 * after)} adc {channel} {round(1e3 * volts)}")

    def volts(self, bit: int, volts: float) -> None:
        """Set the voltage at the pin of a bit."""
        self.tell(f"adc {CHANNEL_OF_BIT[bit]} {round(1e3 * volts)}")

    @property
    def time(self) -> float:
        """Time on the board's clock [s]."""
        return 1e-6 * int(self.tell("time"))

    def close(self) -> None:
        """End the emulator and remove the port."""
        self._process.kill()
        self._process.communicate()
        self._place.cleanup()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _answer(self) -> str:
        """Read one line; empty if the emulator ended or hangs."""
        stream = self._process.stdout
        assert stream is not None
        said = select.select([stream], [], [], ANSWERS_WITHIN)[0]
        return stream.readline().strip() if said else ""
