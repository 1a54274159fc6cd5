"""Plan files and the trials next to them."""

from __future__ import annotations

import csv
import hashlib
import io
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Final, final

import numpy as np

from fixel.errors import InvalidInput
from fixel.io import load, save
from fixel.io.atomic import written_whole
from fixel.planning.plan import PushPlan
from fixel.planning.trials import PlanTrial, Trials
from fixel.workflows.planning.request import FoundPlan, PlanRequest

ENDING: Final = ".plan"
COLUMNS: Final = (
    "plan", "time", "met", "failure", "by",
    "start_x_m", "start_y_m", "start_angle_rad", "end_x_m", "end_y_m", "end_angle_rad",
)  # fmt: skip


@final
@dataclass(frozen=True, kw_only=True)
class PlanFile:
    """Content of a plan file.

    Attributes
    ----------
    found : FoundPlan
    version : str
        Version of fixel.
    created : str
        Time of creation, as ISO 8601 in UTC.
    """

    found: FoundPlan
    version: str
    created: str

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
    plan = file.found.plan
    stated = min(plan.success.stated, 1.0 - 1e-9)
    empty = Trials(plan=file.id, stated=stated, mean=max(stated, plan.success.mean))
    where = trials_path(path)
    if not where.is_file():
        return empty
    try:
        rows = list(csv.reader(io.StringIO(where.read_text(encoding="utf-8"))))
    except (OSError, UnicodeDecodeError, csv.Error) as problem:
        raise InvalidInput(str(where), found=str(problem), expected="a table of trials") from None
    if not rows or tuple(rows[0]) != COLUMNS:
        raise InvalidInput(str(where), found="another header", expected=",".join(COLUMNS))
    trials = []
    for number, row in enumerate(rows[1:], 2):
        if row and row[0] != file.id:
            raise InvalidInput(
                f"{where}, line {number}",
                found=f"a trial of plan {row[0]}",
                expected=f"trials of plan {file.id}",
            )
        try:
            trials.append(_trial(row))
        except (ValueError, IndexError) as problem:
            raise InvalidInput(
                f"{where}, line {number}", found=str(problem), expected="a trial"
            ) from None
    return empty.added(*trials)


def add_trials(path: Path, file: PlanFile, *trials: PlanTrial) -> Trials:
    """Add trials to those of a plan file, whole or not at all; return all of them."""
    every = load_trials(path, file).added(*trials)
    with written_whole(trials_path(path)) as unfinished, unfinished.open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(COLUMNS)
        for one in every.trials:
            poses = [*(one.start or [""] * 3), *(one.end or [""] * 3)]
            writer.writerow([file.id, one.time, int(one.met), one.failure, one.by, *poses])
    return every


def _trial(row: list[str]) -> PlanTrial:
    _, time, met, failure, by, *numbers = row
    if met not in ("0", "1") or len(numbers) != 6:
        raise ValueError(f"the row {','.join(row)!r}")
    poses = [tuple(map(float, own)) if own[0] else None for own in (numbers[:3], numbers[3:])]
    return PlanTrial(
        time=time,
        met=met == "1",
        failure=failure,
        start=poses[0],  # type: ignore[arg-type]
        end=poses[1],  # type: ignore[arg-type]
        by=by,
    )
