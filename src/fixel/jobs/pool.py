"""Pools, which start the workers of a job and replace those that end."""

from __future__ import annotations

import abc
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Final, final

from fixel.errors import InvalidInput, JobRefused
from fixel.jobs import link
from fixel.jobs.functions import stamp
from fixel.jobs.worker import REFUSED

MAX_STILLBORN: Final = 3  # workers in a row that end before they have joined
TAIL: Final = 12  # lines of a log in an error message


class AbstractPool(abc.ABC):
    """Pool of `size` workers, which are replaced when they end."""

    size: int  # workers that are wanted
    interface: str = link.LOOPBACK

    @abc.abstractmethod
    def keep(self) -> None:
        """Replace workers that have ended; called about once a second, returns soon.

        Raises
        ------
        JobRefused
            Workers cannot be started, and waiting does not help.
        """

    @abc.abstractmethod
    def close(self) -> None:
        """End the workers."""

    @property
    def note(self) -> str:
        """Reason why workers wait; empty if they do not."""
        return ""


@final
class LocalPool(AbstractPool):
    """Pool of worker processes on this machine; they end with this process.

    Parameters
    ----------
    folder : Path
        Folder of the job.
    size : int
        Number of workers.
    python : str, optional
        Interpreter of the workers; by default the one that runs.
    """

    def __init__(self, folder: Path, size: int, python: str | None = None) -> None:
        if size < 1:
            raise InvalidInput("workers", found=size, expected="at least 1")
        self.size = size
        self._folder = folder
        self._python = python or sys.executable
        self._slots: dict[int, tuple[str, subprocess.Popen[bytes]] | None] = dict.fromkeys(
            range(size)
        )
        self._stillborn = 0
        self._started = 0
        # Workers of earlier sessions must not count as joined to this one.
        self._session = f"{os.getpid()}-{time.time_ns() % 10**6:06d}"

    def keep(self) -> None:
        for slot, held in self._slots.items():
            if held is not None and held[1].poll() is not None:
                self._note_end(*held)
                self._slots[slot] = None
            if self._slots[slot] is None:
                self._slots[slot] = self._start()

    def close(self) -> None:
        held = [slot for slot in self._slots.values() if slot is not None]
        for _, process in held:
            process.kill()
        for _, process in held:
            process.wait()
            if process.stdin is not None:
                process.stdin.close()
        self._slots = dict.fromkeys(self._slots)

    def _start(self) -> tuple[str, subprocess.Popen[bytes]]:
        self._started += 1
        name = f"local-{self._session}-{self._started}"
        cores = max(1, (os.cpu_count() or 1) // self.size)
        command = [
            *worker_command(self._folder, name, self.interface, cores),
            "--watch-parent",
        ]
        with (self._folder / "workers" / f"{name}.log").open("wb") as log:
            process = subprocess.Popen(
                [self._python, *command],
                stdin=subprocess.PIPE, stdout=log, stderr=log, start_new_session=True,
            )  # fmt: skip
        return name, process

    def _note_end(self, name: str, process: subprocess.Popen[bytes]) -> None:
        if process.stdin is not None:
            process.stdin.close()
        if link.joined(self._folder, name):
            self._stillborn = 0
            return
        if process.returncode == REFUSED:
            return  # the engine reads the reason that the worker has stored
        self._stillborn += 1
        if self._stillborn >= MAX_STILLBORN:
            raise stillborn(self._folder / "workers" / f"{name}.log")


def worker_command(folder: Path, name: str, interface: str, cores: int) -> list[str]:
    """Return the arguments of the interpreter that start a worker."""
    return [
        "-m", "fixel.jobs.worker", str(folder.resolve()),
        "--name", name,
        "--stamp", stamp(),
        "--interface", interface,
        "--threads", str(cores),
    ]  # fmt: skip


def stillborn(*logs: Path) -> JobRefused:
    """Return the error for workers that ended before they had joined, with lines of logs."""
    said = "\n".join(
        line
        for log in logs
        if log.exists()
        for line in log.read_text(errors="replace").splitlines()[-TAIL:]
    )
    end = f"; output of the last one:\n{said}" if said else ", without output"
    return JobRefused(f"{MAX_STILLBORN} workers in a row ended before they could compute{end}")
