"""Progress of a running calibration: its objective, read from the journal of its job."""

from __future__ import annotations

import math
import threading
from contextlib import suppress
from functools import lru_cache, partial
from itertools import islice, zip_longest
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
from fixel.jobs.work import unframed
from fixel.typing import FloatArray
from fixel.web.values import Answer, Finite
from fixel.web.views.calibration_detail import Residual
from fixel.workflows import jobs
from fixel.workflows.calibration.parameter_options import command_of, options_of
from fixel.workflows.calibration.plan import MAKER, plan_in
from fixel.workflows.calibration.stored import collected, stored_ids

ERRORS: Final = "all together"  # stage of a search by errors; parts of a round are one evaluation
SQUARES: Final = "squares"  # stage of a search by residuals
# Fields of the status of a job that are shown as they are.
OF_JOB: Final = ("name", "state", "ended", "reason", "note", "share", "started_utc")


@final
class SearchErrors:
    """Errors in the journal of a calibration's job so far; only what is new is read."""

    def __init__(self, project: Project, folder: Path) -> None:
        plan = plan_in(folder)
        self.request, self.keys = plan.request, [target.key for target in plan.targets]
        with project.store() as store:
            self.ids = [store.find(key) for key in self.keys]
        self.stage = ""
        # One per evaluation, the mean of the experiments; inf where it failed.
        self.objective: list[float] = []
        self.nominal: list[float] = []  # one per experiment
        self.alone: dict[int, float] = {}  # index of an experiment to its error
        self.n_read = 0  # blocks of the journal
        self._journal, self._lock = folder / files.JOURNAL, threading.Lock()
        self._waiting: list[FloatArray] = []  # parts of an unfinished round

    def read(self) -> None:
        """Read what the journal has more than last time."""
        with self._lock:
            for name, data in islice(read_journal(self._journal), self.n_read, None):
                self.n_read += 1
                if isinstance(answer := unframed(data), bytes):
                    self._take(name, arrays_of(answer))

    def _take(self, name: str, arrays: dict[str, Any]) -> None:
        n, (self.stage, _, part) = len(self.ids), name.rpartition(" ")[0].rpartition("/")
        if self.stage == "nominal":
            self.nominal += arrays["error"].tolist()
        elif self.stage == "alone":
            self.alone |= {one.members[0]: float(one.errors[0]) for one in found_of(arrays)}
        elif self.stage == ERRORS:
            # Before the first part there may be remains of a round that was lost.
            self._waiting = [*(() if part == "0" else self._waiting), arrays["error"]]
            values = np.concatenate(self._waiting)
            if len(values) % n == 0:
                self.objective += self.shares(values.reshape(-1, n))
                self._waiting = []
        elif self.stage == SQUARES:
            squares = np.einsum("km,km->k", arrays["table"], arrays["table"])
            self.objective += self.request.error_of_one(squares, n).tolist()

    def shares(self, errors: FloatArray) -> list[float]:
        """Return the mean errors per experiment of rows (k, n) of all of them."""
        combined = combined_errors(errors, self.request.combine)
        shares: list[float] = self.request.error_of_one(combined, errors.shape[1]).tolist()
        return shares

    @property
    def limit(self) -> int | None:
        """Maximum number of evaluations; None without one."""
        request = self.request
        if request.least_squares is not None or request.mode == "each":
            return None
        limit: int | None = request.max_evaluations or request.made_optimiser.limit
        return limit


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
    singles: list[Residual] = Field(
        description="results of the experiments calibrated so far, in mode each"
    )


@final
class ProgressReader:
    """Reader of the progress of a project's calibrations, which reads only what is new."""

    def __init__(self, project: Project) -> None:
        self._project = project
        self._errors = lru_cache(None)(partial(SearchErrors, project))

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
        status, read = jobs.status_of(folder), self._errors(folder)
        if status.kept > read.n_read:
            read.read()
        stored = stored_ids(folder)
        if status.state == "done" and not stored:
            with suppress(JobRefused):  # the process that ran it is about to
                stored = list(collected(self._project, folder).ids)
        request, ids, nominal, objective = read.request, read.ids, read.nominal, [*read.objective]
        # The job counts chunks, which have about the same number of evaluations each.
        searching = read.stage in (ERRORS, SQUARES) and not status.ended
        rate = status.rate * len(objective) / max(1, status.kept) if searching else 0.0
        limit, left = read.limit, None if status.ended else status.left_s
        at_most = left is None and limit is not None and rate > 0.0
        if at_most and limit is not None:
            left = max(0.0, (limit - len(objective)) / rate)
        before = read.shares(np.array([nominal])) if nominal else []
        return LiveProgress(
            **{name: getattr(status, name) for name in OF_JOB},
            label=request.name,
            mode=request.mode,
            optimiser=request.optimiser.name,
            experiments=len(ids),
            unknowns=list(request.space.labels),
            unit=request.made_error.unit,
            stage=read.stage,
            evaluations=len(objective),
            most=limit,
            rate=rate,
            left_s=left,
            at_most=at_most,
            best=min(filter(math.isfinite, objective), default=None),
            start=next(filter(math.isfinite, before), None),
            stored=stored,
            command=command_of(options_of(request, ids, self._project.folder)),
            objective=[*objective],
            singles=[
                Residual(id=own, key=key, before=start, after=read.alone[k])
                for k, (own, key, start) in enumerate(zip_longest(ids, read.keys, nominal))
                if k in read.alone
            ],
        )

    def _folders(self) -> dict[str, Path]:
        every = jobs.job_folders(self._project.folder).items()
        return {name: folder for name, folder in every if files.made_by(folder, MAKER)}
