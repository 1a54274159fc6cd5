"""Coordinator, the only process that runs a job: `python -m fixel.jobs.coordinator FOLDER`.

It may die at any moment: the journal stays, and the next run continues from it.
"""

from __future__ import annotations

import argparse
import os
import signal
import socket
import sys
import time
import traceback
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from fixel.errors import FixelError, JobRefused, counted
from fixel.io.atomic import write_whole
from fixel.io.journal import Journal
from fixel.jobs import folder as files
from fixel.jobs.folder import Job, JobState, RunSettings
from fixel.jobs.functions import named_function, stamp
from fixel.jobs.work import AbstractEngine, JobProgress, LocalEngine, Show, StopRequest, run_work
from fixel.typing import Notify

LARGE: Final = 1 << 16  # [byte] larger answers are dropped from the journal once the job is done
MIN_PAUSE_S: Final = 1.0  # [s] shortest time between two writes of state.json


def coordinate(
    folder: Path,
    *,
    progress: Show | None = None,
    notify: Notify | None = None,
    local: AbstractEngine | None = None,
) -> JobState:
    """Run a job until it is `done`, or `cancelled` if that was requested meanwhile.

    `notify` is called with a sentence when something happens. `local` is the engine of a job
    without workers, by default `LocalEngine`. A job that cannot be run, for the reason in its
    state, or that another process runs, raises `JobRefused`; Ctrl-C or SIGTERM raises
    `KeyboardInterrupt` in the state `stopped`.
    """
    job, run = files.read_job(folder), files.read_run(folder)
    with Journal(folder / files.JOURNAL) as journal:
        state = _StateWriter(folder, progress, notify)
        try:
            state.enter("preparing")
            _check_unchanged(folder, job, run)
            if n := journal.damaged:
                lost = f"the journal is damaged in {counted(n, 'place')}"
                state.notify(f"{lost}; the chunks there are computed again")
            result = _run(folder, job, run, journal, state, local)
            state.enter("collecting")
            write_whole(folder / files.RESULT, result, durable=True)
            state.enter("done")
        except StopRequest:
            state.enter("cancelled")
        except KeyboardInterrupt:
            if not (folder / files.CANCEL).exists():
                state.enter("stopped")
                raise
            state.enter("cancelled")
        except FixelError as problem:
            state.enter("failed", str(problem))
            raise
        except Exception as problem:
            files.log(folder, traceback.format_exc())
            state.enter("failed", f"{type(problem).__name__}: {problem}")
            raise
        if state.status.state == "done":  # otherwise a resumed job would compute them again
            with suppress(FixelError):  # of a full disk
                journal.drop(LARGE)
        return state.status


def main(arguments: list[str] | None = None) -> int:
    """Run a job in the background; messages go to its log and its state."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    given = parser.parse_args(arguments)
    interrupt_on_termination()
    try:
        coordinate(given.folder)
    except FixelError as problem:
        files.log(given.folder, str(problem))
        return 1
    except KeyboardInterrupt:
        return 130
    except Exception:
        return 1
    return 0


def interrupt_on_termination() -> None:
    """Treat SIGTERM as Ctrl-C, so that the state is written and workers are ended."""

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)


def _run(
    folder: Path,
    job: Job,
    run: RunSettings,
    journal: Journal,
    state: _StateWriter,
    local: AbstractEngine | None,
) -> bytes:
    inputs = folder / "inputs"
    work = named_function(job.maker)(inputs, job.options)
    with _engine(folder, job, run, state.notify, local) as engine:
        state.engine = engine
        state.enter("running")
        return run_work(
            work, engine, inputs, journal, progress=state.show, stop=(folder / files.CANCEL).exists
        )


def _engine(
    folder: Path, job: Job, run: RunSettings, notify: Notify, local: AbstractEngine | None
) -> AbstractEngine:
    if run.workers == 0:
        return local or LocalEngine()
    from fixel.jobs.dask_engine import DaskEngine
    from fixel.jobs.link import require_dask
    from fixel.jobs.pool import AbstractPool, LocalPool, SlurmPool

    require_dask()
    pool: AbstractPool
    if run.site is None:
        pool = LocalPool(folder, run.workers)
    else:
        pool = SlurmPool(folder, run.workers, run.site, job.label, notify=notify)
    return DaskEngine(folder, pool, notify=notify, lease_s=run.lease_s, max_deaths=run.max_deaths)


def _check_unchanged(folder: Path, job: Job, run: RunSettings) -> None:
    allowed = run.stamp or job.stamp
    if allowed != stamp():
        raise JobRefused(
            f"the job was begun by fixel {allowed}, and this is fixel {stamp()}",
            hint="resume with that version, or accept different last digits: fixel jobs resume "
            "FOLDER --accept-version",
        )
    if files.inputs_digest(folder / "inputs") != job.inputs_sha256:
        raise JobRefused(
            f"the files in {folder / 'inputs'} are not those with which the job was prepared",
            hint="restore them, or prepare another job",
        )


class _StateWriter:
    """Writer of the state and the log of a job."""

    def __init__(self, folder: Path, progress: Show | None, notify: Notify | None) -> None:
        self._folder = folder
        self._progress = progress
        self._say = notify
        self._written = 0.0
        self._before = files.read_status(folder)
        self.engine: AbstractEngine | None = None
        self.status = JobState(
            host=socket.gethostname(),
            pid=os.getpid(),
            started_utc=files.utc(),
            **self._before.model_dump(include={"done", "total", "failed", "deaths", "again"}),
        )

    def enter(self, state: files.State, reason: str = "") -> None:
        """Store and log a new state of the job."""
        self.notify(f"{state}: {reason}" if reason else state)
        still: dict[str, Any] = {}
        if state in files.ENDED:
            still = {"rate": 0.0, "left_s": None, "workers": 0}
        if state == "done":
            still["share"] = 1.0
        self._write(state=state, reason=reason, **still)

    def notify(self, sentence: str) -> None:
        """Log a sentence and pass it on."""
        files.log(self._folder, sentence)
        if self._say is not None:
            self._say(sentence)

    def show(self, progress: JobProgress) -> None:
        """Pass on the progress; store it at most once per `MIN_PAUSE_S`."""
        if self._progress is not None:
            self._progress(progress)
        if time.monotonic() - self._written > MIN_PAUSE_S or progress.share == 1.0:
            waiting = getattr(self.engine, "note", "")
            self._write(reason=waiting, **progress.model_dump(exclude_unset=True))

    def _write(self, **changes: Any) -> None:
        if self.engine is not None:
            changes["deaths"] = self._before.deaths + self.engine.deaths
            changes["again"] = self._before.again + self.engine.again
        self.status = self.status.model_copy(update=changes)
        self._written = time.monotonic()
        files.write_status(self._folder, self.status)


if __name__ == "__main__":
    sys.exit(main())
