"""Plan files and the trials next to them."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from os import PathLike
from pathlib import Path
from typing import Final, final

import numpy as np

from fixel.errors import InvalidInput
from fixel.formats.trials_file import append_trials, read_trials, write_trials
from fixel.io import load, save
from fixel.io.array_bytes import array_of
from fixel.io.journal import Journal
from fixel.planning.plan import PushPlan
from fixel.planning.trials import PlanTrial, Trials
from fixel.typing import FloatArray
from fixel.workflows.planning.request import FoundPlan, PlanRequest

JOURNAL: Final = "answers.journal"


@final
@dataclass(frozen=True, kw_only=True)
class PlanFile:
    """Content of a plan file."""

    found: FoundPlan
    version: str  # version of fixel
    created: str  # time of creation, as ISO 8601 in UTC

    @property
    def id(self) -> str:
        """Id of the plan: a digest of its motions and of its stated success probability."""
        return plan_id(self.found.plan)


def plan_id(plan: PushPlan) -> str:
    """Return the id of a plan."""
    digest = hashlib.sha256(np.ascontiguousarray(plan.path).tobytes())
    digest.update(np.ascontiguousarray(plan.start).tobytes())
    digest.update(repr(plan.success.stated).encode())
    return digest.hexdigest()[:12]


def save_plan(found: FoundPlan, path: Path) -> PlanFile:
    """Write a plan file, whole or not at all."""
    now = datetime.now(UTC).isoformat(timespec="seconds")
    content = PlanFile(found=found, version=version("fixel"), created=now)
    save(content, path)
    return content


def load_plan(path: Path) -> PlanFile:
    """Load a plan file; also a plan that `PushPlan.save` wrote.

    Raises
    ------
    InvalidInput
        The file is missing, damaged, of a newer version, or another kind of file.
    """
    content = load(path)
    if isinstance(content, PushPlan):
        found = FoundPlan(plan=content, request=PlanRequest(goal={}))
        return PlanFile(found=found, version="", created="")
    if not isinstance(content, PlanFile):
        raise InvalidInput(
            str(path), found=f"a saved {type(content).__name__}", expected="a plan file"
        )
    return content


def trials_path(path: Path) -> Path:
    """Return the file of the trials of a plan file."""
    return path.with_name(f"{path.name}.trials.csv")


def load_trials(path: Path, file: PlanFile) -> Trials:
    """Load the trials of a plan file; none if there is no file of trials.

    Raises
    ------
    InvalidInput
        The trials are damaged, or those of another plan.
    """
    where = trials_path(path)
    if where.exists():
        return read_trials(where, plan=file.id)
    success = file.found.plan.success
    stated = min(success.stated, 1.0 - 1e-9)
    return Trials(plan=file.id, stated=stated, mean=max(stated, success.mean))


def add_trials(path: Path, file: PlanFile, *trials: PlanTrial) -> Trials:
    """Add trials to those of a plan file, durably; return all of them."""
    where = trials_path(path)
    if not where.exists():
        write_trials(where, load_trials(path, file))
    return append_trials(where, *trials, plan=file.id)


@final
class StoredAnswers(dict[str, FloatArray]):
    """Arrays by name, each durable in a journal once it is set."""

    def __init__(self, journal: Journal) -> None:
        super().__init__((name, array_of(journal.get(name) or b"")) for name in journal)
        self._journal = journal

    def __setitem__(self, name: str, array: FloatArray) -> None:
        stream = io.BytesIO()
        np.save(stream, array, allow_pickle=False)
        self._journal.append([(name, stream.getvalue())])
        super().__setitem__(name, array)


@contextmanager
def answers_in(folder: PathLike[str] | str | None) -> Iterator[dict[str, FloatArray]]:
    """Yield the arrays by name that are stored in a folder; without one they are in memory."""
    if folder is None:
        yield {}
        return
    Path(folder).mkdir(parents=True, exist_ok=True)
    with Journal(Path(folder) / JOURNAL) as journal:
        yield StoredAnswers(journal)
