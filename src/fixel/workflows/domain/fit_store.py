"""Folder with the finished fits of a call, which refuses another call."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from fixel.calibration.target import Target
from fixel.errors import InvalidInput
from fixel.io.atomic import written_whole
from fixel.io.damaged_files import readable
from fixel.io.result_cache import ResultCache
from fixel.workflows.calibration.request import target_files
from fixel.workflows.domain.held_out import Apart, CalibrationModel

CALL: Final = "call.json"
JOB: Final = "job.json"  # makes a folder that of a calibration


def fit_store(
    store: str | Path | None, targets: Sequence[Target], model: CalibrationModel, apart: Apart
) -> ResultCache:
    """Return the cache of fits in a folder; one that stores nothing without a folder.

    Raises
    ------
    InvalidInput
        The folder belongs to a call that needs other fits; the difference is named.
    """
    if store is None:
        return ResultCache(None)
    folder = Path(store)
    own = _arguments(targets, model, apart)
    path = folder / CALL
    if (folder / JOB).is_file():
        raise InvalidInput("store", found=f"a job in {folder}", expected="a new folder")
    if path.is_file():
        with readable(path, f"delete the folder {folder}"):
            before = dict(json.loads(path.read_text(encoding="utf-8")))
        for name, now in own.items():
            if before.get(name) != now:
                raise _other(folder, name, str(before.get(name)), now)
        return ResultCache(folder)
    cache = ResultCache(folder)
    with written_whole(path) as beside:
        beside.write_text(json.dumps(own, indent=1), encoding="utf-8")
    return cache


def _other(folder: Path, name: str, before: str, now: str) -> InvalidInput:
    many = name == "experiments"
    return InvalidInput(
        "store",
        found=f"{folder}, which belongs to a call with "
        + ("other experiments" if many else f"another {name}: {before}"),
        expected="the same call again" + ("" if many else f", which has {now} now"),
        hint="give this call a folder of its own",
    )


def _arguments(targets: Sequence[Target], model: CalibrationModel, apart: Apart) -> dict[str, str]:
    """Arguments on which the fits depend, as texts."""
    files = target_files(targets)
    mark = hashlib.sha256(b"".join(files[name] for name in sorted(files))).hexdigest()
    space = (
        f"{u.label} = {u.nominal:.9g}"
        if u.frozen
        else f"{u.label} {u.low:.9g} to {u.high:.9g} from {u.nominal:.9g}"
        for u in model.space.unknowns
    )
    return {
        "experiments": mark,
        "fit": ", ".join(space),
        "motion": model.motion.name,
        "error": repr(model.error),
        "folds": str(apart.folds),
        "leave_out": apart.out or "nothing",
        "seed": str(apart.seed),
    }
