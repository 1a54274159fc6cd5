"""Progress of a running calibration: its objective, read from the journal of its job."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, final

import numpy as np
from pydantic import Field

from fixel.calibration.objective import combined_errors
from fixel.calibration.result import found_of
from fixel.database.project import Project
from fixel.errors import FixelError, JobRefused, NotStored
from fixel.io.array_bytes import arrays_of
from fixel.io.damaged_files import each_readable
from fixel.io.journal import read_journal
from fixel.jobs import folder as files
from fixel.typing import FloatArray
from fixel.web.values import Answer, Finite
from fixel.workflows import jobs
from fixel.workflows.calibration.parameter_options import command_of, options_of
from fixel.workflows.calibration.plan import MAKER, request_of
from fixel.workflows.calibration.project import collected, experiments_of, stored_ids
from fixel.workflows.calibration.request import CalibrationRequest

SEARCHES: Final = ("all together", "squares")  # stages whose errors are the objective
ALONE: Final = "alone"
OF_JOB: Final = ("state", "ended", "reason", "note", "share", "started_utc")  # of the status
NOMINAL: Final = "nominal"
RATE_WINDOW_S: Final = 30.0


@final
@dataclass
class JournalProgress:
    """Content of the journal of one job so far."""

    request: CalibrationRequest
    ids: list[int]  # experiments in the project
    seen: int = 0  # blocks that were read
    size: int = -1  # [byte] of the journal when it was read
    stage: str = ""
    # One per evaluation, the mean of the experiments; inf where it failed.
    objective: list[float] = field(default_factory=list)
    nominal: list[float] = field(default_factory=list)  # one per experiment
    alone: dict[int, float] = field(default_factory=dict)  # index of an experiment to its error
    waiting: list[FloatArray] = field(default_factory=list)  # chunks of an unfinished round
    times: deque[tuple[float, int]] = field(default_factory=deque)

    def read(self, journal: Path) -> None:
        """Read what the journal has more than last time."""
        size = journal.stat().st_size if journal.is_file() else 0
        if size in (self.size, 0):
            return
        self.size = size
        for k, (name, data) in enumerate(read_journal(journal)):
            if k >= self.seen:
                self.seen = k + 1
                if data[:1] == b"A":
                    self._take(name, arrays_of(data[1:]))
        self.times.append((time.monotonic(), len(self.objective)))

    def _take(self, name: str, arrays: dict[str, Any]) -> None:
        self.stage, _, part = name.rpartition(" ")[0].rpartition("/")
        if self.stage == NOMINAL:
            self.nominal += arrays["error"].tolist()
        elif self.stage == ALONE:
            for one in found_of(arrays):
                self.alone[one.members[0]] = float(one.errors[0])
        elif self.stage == SEARCHES[0]:
            if part == "0":  # remains of a chunk that was lost
                self.waiting.clear()
            self.waiting.append(arrays["error"])
            values = np.concatenate(self.waiting)
            if len(values) % len(self.ids) == 0:
                self.objective += self.shares(values.reshape(-1, len(self.ids)))
                self.waiting.clear()
        elif self.stage == SEARCHES[1]:
            squares = np.einsum("km,km->k", arrays["table"], arrays["table"])
            self.objective += self.request.error_of_one(squares, len(self.ids)).tolist()

    def shares(self, errors: FloatArray) -> list[float]:
        """Return the mean errors per experiment of rows (k, n) of all of them."""
        combined = combined_errors(errors, self.request.combine)
        shares: list[float] = self.request.error_of_one(combined, errors.shape[1]).tolist()
        return shares

    @property
    def rate(self) -> float:
        """Recent evaluations per second."""
        now, times = time.monotonic(), self.times
        while len(times) > 2 and now - times[0][0] > RATE_WINDOW_S:
            times.popleft()
        if len(times) < 2:
            return 0.0
        return (len(self.objective) - times[0][1]) / max(now - times[0][0], 1e-3)


class ExperimentProgress(Answer):
    """An experiment with parameters of its own."""

    id: int
    before: Finite
    after: Finite


class LiveProgress(Answer):
    """A calibration that is not stored yet, and how far it is."""

    name: str = Field(description="name of the job")
    label: str = Field(description="name of the calibration")
    mode: str
    optimiser: str
    experiments: int
    unknowns: list[str]
    unit: str
    state: str = Field(
        description="status of the job: queued, preparing, running, done, "
        "stopped, lost, failed, ..."
    )
    ended: bool
    reason: str
    stage: str = Field(description="part of the calibration that was computed last")
    note: str = Field(description="part that is computed now")
    evaluations: int
    most: int | None = Field(description="maximum number of evaluations")
    rate: float = Field(description="recent evaluations per second")
    left_s: float | None = Field(description="estimated remaining time [s]; null if unknown")
    at_most: bool = Field(
        description="whether `left_s` is an upper bound, since a search may converge earlier"
    )
    share: float | None = Field(description="share of the work that is done; null if unknown")
    best: float | None = Field(description="smallest mean error per experiment so far")
    start: float | None = Field(description="mean error per experiment at the nominal values")
    started_utc: str
    stored: list[int] = Field(description="ids of the stored calibrations")
    command: str
    objective: list[Finite] = Field(
        description="mean error of each evaluation; null if a simulation failed"
    )
    singles: list[ExperimentProgress] = Field(
        description="results of the experiments calibrated so far, in mode each"
    )


@final
class ProgressReader:
    """Reader of the progress of a project's calibrations, which reads only what is new."""

    def __init__(self, project: Project) -> None:
        self._project = project
        self._lock = threading.Lock()
        self._known: dict[str, JournalProgress] = {}

    def folder(self, name: str) -> Path:
        """Return the folder of a calibration's job; raise if there is none of the name."""
        found = self._folders().get(name)
        if found is None:
            raise NotStored(f"calibration job {name!r}", hint="the page Calibrations lists all")
        return found

    def unfinished(self) -> tuple[list[LiveProgress], list[FixelError]]:
        """Return calibrations that are not stored yet, newest first, and errors of unreadable ones.

        Calibrations that are done become stored.
        """
        made = {one: files.read_job(one).made_utc for one in self._folders().values()}
        newest = sorted(made, key=made.__getitem__, reverse=True)
        found, unreadable = each_readable(
            lambda folder: None if stored_ids(folder) else self.look(folder), newest
        )
        return [seen for seen in found if seen is not None and not seen.stored], unreadable

    def look(self, folder: Path) -> LiveProgress:
        """Return the progress of one."""
        status = jobs.status_of(folder)
        with self._lock:
            read = self._known.get(folder.name)
            if read is None:
                ids = experiments_of(self._project, folder)
                read = self._known[folder.name] = JournalProgress(request_of(folder), ids)
            read.read(folder / files.JOURNAL)
            objective = [*read.objective]
            rate = 0.0 if status.ended else read.rate
        stored = stored_ids(folder)
        if status.state == "done" and not stored:
            with suppress(JobRefused):  # the process that ran it is about to
                stored = list(collected(self._project, folder).ids)
        request, ids, nominal = read.request, read.ids, read.nominal
        most, left = _most(request), status.left_s
        at_most = left is None and most is not None and rate > 0.0
        if at_most and most is not None:
            left = (most - len(objective)) / rate
        return LiveProgress(
            name=folder.name,
            label=request.name,
            mode=request.mode,
            optimiser=request.optimiser.name,
            experiments=len(ids),
            unknowns=list(request.space.labels),
            unit=request.made_error.unit,
            stage=read.stage,
            evaluations=len(objective),
            most=most,
            rate=rate,
            left_s=None if status.ended or left is None else max(0.0, left),
            at_most=at_most,
            best=min((e for e in objective if math.isfinite(e)), default=None),
            start=next(filter(math.isfinite, read.shares(np.array([nominal]))), None)
            if nominal
            else None,
            stored=stored,
            command=command_of(
                options_of(request, [str(id_) for id_ in ids])
                | {"project": str(self._project.folder.resolve())}
            ),
            objective=[*objective],
            singles=[
                ExperimentProgress(
                    id=ids[k], before=nominal[k] if k < len(nominal) else None, after=error
                )
                for k, error in sorted(read.alone.items())
            ],
            **{name: getattr(status, name) for name in OF_JOB},
        )

    def _folders(self) -> dict[str, Path]:
        every = jobs.job_folders(self._project.folder).items()
        return {name: folder for name, folder in every if files.made_by(folder, MAKER)}


def _most(request: CalibrationRequest) -> int | None:
    if request.least_squares is not None or request.mode == "each":
        return None
    most: int | None = request.max_evaluations or request.made_optimiser.limit
    return most
