"""Emulated bench: a film as camera, firmware in an emulator, and a controller to move."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, final

import numpy as np

from fixel.errors import FixelError
from fixel.formats.recording import Recording, open_recording
from fixel.model import LineDrive, Scene
from fixel.testbed.file_source import FILM
from fixel.testbed.loopback import LoopbackCamera
from fixel.testbed.recorder import RecordingStatus

if TYPE_CHECKING:
    from fixel.testbed.emulators.mega import EmulatedMega
    from fixel.testbed.motion import AbstractActuator


@final
class EmulatedBench:
    """Camera, fixels and drive for a recorder, without hardware.

    Attributes
    ----------
    camera : str
        Address of the network camera that plays the film.
    tactile : str
        Port of the board; `film` to use the film's readings if the board cannot be emulated.
    actuator : AbstractActuator or None
        GRBL driver of an emulated controller.
    """

    def __init__(
        self,
        film: Recording,
        camera: str,
        board: EmulatedMega | None,
        actuator: AbstractActuator | None,
    ) -> None:
        self.camera, self.actuator = camera, actuator
        self.tactile = f"{FILM}:{film.folder}" if board is None else board.port
        self._film, self._board = film, board
        self._move: threading.Thread | None = None
        self._failure: FixelError | None = None

    def begin(self, status: RecordingStatus, scene: Scene, lead: float) -> None:
        """Schedule the contacts of the film, which has started to play, and start the drive."""
        if self._board is not None:
            self._schedule_contacts(self._board, status.seconds)
        drive = scene.pushers[0].drive
        if self.actuator is not None and isinstance(drive, LineDrive):
            travel = min(drive.travel, drive.speed * scene.duration)
            self._move = threading.Thread(
                target=self._drive, args=(max(0.0, lead - status.seconds), travel, drive.speed)
            )
            self._move.start()

    def end(self) -> float | None:
        """Wait for the drive and return its position [m].

        Raises
        ------
        FixelError
            The drive did not move as it should.
        """
        if self.actuator is None:
            return None
        if self._move is not None:
            self._move.join()
        if self._failure is not None:
            raise self._failure
        return self.actuator.position()

    def _schedule_contacts(self, board: EmulatedMega, now: float) -> None:
        time, bits = self._film.time - self._film.time[0], self._film.readings
        for k in np.flatnonzero(np.diff(bits, prepend=-1)).tolist():
            board.touch(int(bits[k]), max(0.0, float(time[k]) - now))

    def _drive(self, wait: float, travel: float, speed: float) -> None:
        assert self.actuator is not None
        time.sleep(wait)
        try:
            self.actuator.move(by=travel, speed=speed)
        except FixelError as failure:
            self._failure = failure


@contextmanager
def emulated_bench(film: Path, firmware: Path | None) -> Iterator[EmulatedBench]:
    """Create a bench that plays a film.

    Parameters
    ----------
    film : Path
        Folder of the film.
    firmware : Path, optional
        Firmware with its emulator, as built by `mega.built`.
    """
    from fixel.testbed.emulators.grbl import EmulatedGrbl
    from fixel.testbed.emulators.mega import EmulatedMega

    with ExitStack() as stack:
        camera = stack.enter_context(LoopbackCamera(film))
        board = None if firmware is None else stack.enter_context(EmulatedMega(firmware))
        actuator: AbstractActuator | None = None
        if sys.platform != "win32":  # it has no pseudo-terminals: the drive is left out
            from fixel.testbed.motion_grbl import GrblActuator

            controller = stack.enter_context(EmulatedGrbl(start=0.0))
            actuator = stack.enter_context(GrblActuator(controller.port))
        yield EmulatedBench(open_recording(film), camera.url, board, actuator)
