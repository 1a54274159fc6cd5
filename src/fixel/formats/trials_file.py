"""Files of the trials of a plan: one row per trial, appended durably.

    # {"fixel": "trials", "format": 1, "plan": "a1", "stated": 0.93, "mean": 0.96}
    trial,time,met,failure,start_x_m,start_y_m,start_theta_rad,end_x_m,end_y_m,end_theta_rad,by
    1,2026-11-22T21:00:00+00:00,no,slid off,0.1,0.0,0.0,0.12,0.01,0.3,operator

The first line is written before the first trial and never changed. A row without a line break was
cut by a crash: readers ignore it, and the next row replaces it.
"""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from fixel.errors import InvalidInput, number_of
from fixel.io.atomic import WRITABLE, read_bounded, usable, write_whole
from fixel.io.lock import FileLock
from fixel.model.bodies import POSE
from fixel.planning.trials import PlanTrial, Trials

FORMAT: Final = 1
MAX_BYTES: Final = 50_000_000
POSES: Final = ("start", "end")
COORDINATES: Final = ("x_m", "y_m", "theta_rad")
COLUMNS: Final = (
    "trial", "time", "met", "failure",
    *(f"{pose}_{name}" for pose in POSES for name in COORDINATES), "by",
)  # fmt: skip
_EXPECTED: Final = "a file of trials of fixel"


def write_trials(path: str | Path, trials: Trials) -> Path:
    """Write trials to a new file, whole or not at all, and return its path.

    A file that exists raises `InvalidInput`: a stated probability is never replaced.
    """
    path = Path(path)
    if path.exists():
        hint = "append trials to it, or choose another name"
        raise InvalidInput(str(path), found="an existing file", expected="a new file", hint=hint)
    head = {
        "fixel": "trials",
        "format": FORMAT,
        "plan": trials.plan,
        "stated": trials.stated,
        "mean": trials.mean,
    }
    rows = (_row(k, trial) for k, trial in enumerate(trials.trials, 1))
    write_whole(path, f"# {json.dumps(head)}\n".encode() + _line(COLUMNS) + b"".join(rows))
    return path


def append_trials(path: str | Path, *trials: PlanTrial, plan: str | None = None) -> Trials:
    """Append trials to a file of `write_trials`; return all trials of the file.

    They are durable when this returns. `plan` is the id of the plan that was executed. A file that
    is missing, damaged or of another plan raises `InvalidInput`; one to which another process
    writes raises `JobRefused`.
    """
    path = Path(path)
    with FileLock(path.with_name(f".{path.name}.lock"), f"the file {path}"):
        before = read_trials(path, plan=plan)
        rows = b"".join(_row(k, trial) for k, trial in enumerate(trials, before.n + 1))
        with usable(path, WRITABLE), path.open("r+b") as stream:
            stream.truncate(stream.read().rfind(b"\n") + 1)
            stream.seek(0, os.SEEK_END)
            stream.write(rows)
            stream.flush()
            os.fsync(stream.fileno())
    return before.added(*trials)


def read_trials(path: str | Path, *, plan: str | None = None) -> Trials:
    """Read a file of trials, if given of the `plan` with an id.

    A file that is missing, damaged, or of something else raises `InvalidInput` with the line.
    """
    path = Path(path)
    lines = _lines(path)
    if not lines:
        raise InvalidInput(str(path), found="no complete line", expected=_EXPECTED)
    head = _head(lines[0], path)
    if plan is not None and head["plan"] != plan:
        found = f"trials of the plan {head['plan']}"
        raise InvalidInput(str(path), found=found, expected=f"trials of the plan {plan}")
    rows = list(_parsed(lines[1:], path))
    if not rows or tuple(rows[0]) != COLUMNS:
        where = f"{path}, line 2"
        raise InvalidInput(where, found="other columns", expected=f"{', '.join(COLUMNS)}")
    trials = tuple(_trial(row, k, f"{path}, line {k + 2}") for k, row in enumerate(rows[1:], 1))
    try:
        return Trials(plan=head["plan"], stated=head["stated"], mean=head["mean"], trials=trials)
    except (InvalidInput, TypeError) as problem:
        where = f"{path}, line 1"
        raise InvalidInput(where, found=problem, expected=_EXPECTED) from None


def _lines(path: Path) -> list[str]:
    """Return the complete lines of a file."""
    data = read_bounded(path, _EXPECTED, MAX_BYTES)
    try:
        text = data[: data.rfind(b"\n") + 1].decode()
    except UnicodeDecodeError:
        raise InvalidInput(str(path), found="bytes outside UTF-8", expected=_EXPECTED) from None
    return text.splitlines(keepends=True)


def _head(line: str, path: Path) -> dict[str, Any]:
    try:
        head = json.loads(line.removeprefix("#"))
        known = head["fixel"] == "trials" and isinstance(head["plan"], str)
        known = known and all(
            isinstance(head[name], float | int) for name in ("format", "stated", "mean")
        )
    except (ValueError, KeyError, TypeError):
        known = False
    if not known or not line.startswith("# {"):
        raise InvalidInput(f"{path}, line 1", found="something else", expected=_EXPECTED)
    if head["format"] != FORMAT:
        hint = "install a newer version of fixel"
        found = f"format {head['format']}"
        raise InvalidInput(str(path), found=found, expected=f"format {FORMAT}", hint=hint)
    return dict(head)


def _parsed(lines: Sequence[str], path: Path) -> Iterator[list[str]]:
    reader = csv.reader(lines, strict=True)
    try:
        yield from reader
    except csv.Error as problem:
        where = f"{path}, line {reader.line_num + 1}"
        raise InvalidInput(where, found=problem, expected="a row of a CSV file") from None


def _trial(row: list[str], number: int, where: str) -> PlanTrial:
    if len(row) != len(COLUMNS):
        raise InvalidInput(where, found=f"{len(row)} columns", expected=f"{len(COLUMNS)} columns")
    values = dict(zip(COLUMNS, row, strict=True))
    if values["trial"] != str(number):
        hint = "rows may not be removed, repeated or reordered"
        expected = f"trial {number}"
        raise InvalidInput(where, found=f"trial {values['trial']}", expected=expected, hint=hint)
    if values["met"] not in ("yes", "no"):
        raise InvalidInput(f"{where}, met", found=values["met"], expected="yes or no")
    poses: dict[str, Any] = {}
    for pose in POSES:
        texts = [values[f"{pose}_{name}"] for name in COORDINATES]
        try:
            poses[pose] = tuple(number_of(text, pose) for text in texts) if any(texts) else None
        except ValueError:
            expected = f"3 numbers: {POSE}"
            raise InvalidInput(f"{where}, {pose}", found=texts, expected=expected) from None
    met, failure = values["met"] == "yes", values["failure"]
    try:
        return PlanTrial(values["time"], met, failure, by=values["by"], **poses)
    except InvalidInput as problem:
        raise problem.at(f"{where}, {problem.where}") from None


def _row(number: int, trial: PlanTrial) -> bytes:
    known = (getattr(trial, pose) for pose in POSES)
    poses = [text for pose in known for text in (map(repr, pose) if pose else ("", "", ""))]
    return _line(
        [str(number), trial.time, "yes" if trial.met else "no", trial.failure, *poses, trial.by]
    )


def _line(values: Sequence[str]) -> bytes:
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerow(values)
    return stream.getvalue().encode()
