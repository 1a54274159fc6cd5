"""Held-out errors of a project's experiments, computed once and stored."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.calibration.objective import ANGLE_SCALE, EndPose
from fixel.calibration.target import Target, same_configuration
from fixel.database.project import ANALYSES, Project
from fixel.database.store import Store
from fixel.domain.cells import coordinates_of, label_of
from fixel.domain.evidence import HeldOutErrors, default_folds
from fixel.domain.held_out import (
    MAX_TRAINING,
    SQUARES,
    Apart,
    CalibrationModel,
    Finished,
    held_out,
    noise_floor,
)
from fixel.errors import InvalidInput, counted, no_experiments
from fixel.io.array_bytes import ResultCache
from fixel.io.atomic import write_whole
from fixel.io.damaged_files import readable
from fixel.typing import ProgressCallback
from fixel.workflows.calibration.execution import select_experiments
from fixel.workflows.calibration.stored import known_pushes, load_values, newest_calibration
from fixel.workflows.domain.fits import ProjectRequest, own_best, stored_model

FOLDER: Final = "held-out"
WHOLE: Final = "evidence.json"
VERSION: Final = 2  # increase it when the same request no longer means the same numbers


class DomainEvidence(NamedTuple):
    """Held-out errors, with the settings that produced them."""

    errors: HeldOutErrors
    # Plain values as they are stored: points of the fits, `floor_mm`, `motion` and so on.
    found: Mapping[str, Any]
    is_real: bool = True
    mark: str = ""  # name of the folder in which they are stored


def gather(project: Project, asked: Any, report: ProgressCallback | None = None) -> DomainEvidence:
    """Compute the held-out errors of the experiments of a request for a map, or load stored ones.

    They are shared by maps of the same experiments with other axes, thresholds and nominals.
    """
    with project.store() as records:
        of = ProjectRequest(project, records, asked)
        ids = [row.id for row in records.experiments(of.query).rows]
        if not ids:
            raise no_experiments()
        mark = mark_of(of, ids)
        folder = project.folder / ANALYSES / FOLDER / mark
        if _read(folder) is None:
            _write(folder, _computed(of, ResultCache(folder).get, report))
        found = load_evidence(of, mark)
    assert found is not None
    return found


def load_evidence(of: ProjectRequest, mark: str) -> DomainEvidence | None:
    """Load evidence that is stored under a mark, without computation; None if it is gone."""
    folder = of.project.folder / ANALYSES / FOLDER / mark
    content = _read(folder) if mark else None
    if content is None:
        return None
    with readable(folder / WHOLE, f"delete the folder {folder} and compute the map again"):
        errors = errors_of(content, of.asked)
    if of.asked.relative is not None:
        targets = select_experiments(of.store, errors.keys[:1], of.query).targets
        own, notes = own_best(of.store, errors.ids, stored_model(of, targets).model)
        errors = replace(errors, own_mm2=own, notes=tuple(notes))
    real = all(row.is_real for row in of.store.experiments(of.query).rows)
    return DomainEvidence(errors, content, real, mark)


def store_evidence(project: Project, content: Mapping[str, Any], asked: Any) -> DomainEvidence:
    """Store evidence of a map that was computed in memory, for the pages; return it with ids."""
    if not content:
        expected = "a map that fixel.map_domain has made"
        raise InvalidInput("map", found="no evidence in it", expected=expected)
    with project.store() as records:
        ids = [records.find(key) for key in content["keys"]]
        real = all(records.experiment(number).real for number in ids)
    whole = {**content, "ids": ids}
    mark = hashlib.sha256(json.dumps(whole, allow_nan=False).encode()).hexdigest()[:12]
    _write(project.folder / ANALYSES / FOLDER / mark, whole)
    return DomainEvidence(errors_of(whole, asked), whole, real, mark)


def mark_of(of: ProjectRequest, ids: Sequence[int]) -> str:
    """Return a hash of everything the numbers depend on; stored records never change."""
    asked = of.asked
    names = ("calibration", "fit", "apart", "leave_out", "folds", "seed")
    kept = asked.model_dump(mode="json", include=set(names))
    kept |= {"engine": asked.engine} if asked.engine else {}
    kept |= {"table": of.project.view.sha256} if of.project.view is not None else {}
    if asked.calibration is None and not asked.fit:
        kept["newest_calibration"] = newest_calibration(of.store, engine=asked.engine)
    whole = [VERSION, kept, list(ids), repr(SQUARES), MAX_TRAINING]
    return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()[:12]


def _computed(
    of: ProjectRequest, finished: Finished, report: ProgressCallback | None
) -> dict[str, Any]:
    chosen = select_experiments(of.store, (), of.query)
    started = stored_model(of, chosen.targets)
    if of.asked.relative is not None:  # raises before hours of fits if there is no own best
        own_best(of.store, chosen.ids, started.model)
    return {
        **evidence_of(chosen.targets, started.model, of.asked, finished, report),
        "ids": chosen.ids,
        "unseen": _unseen(of.store, started.calibration, chosen.targets),
        "calibration": started.calibration,
        "started": started.words,
        "left_out": dict(chosen.left_out),
    }


def _unseen(records: Store, calibration: int | None, targets: Sequence[Target]) -> list[str]:
    """Return what no experiment of the calibration has, with the number of experiments."""
    if calibration is None:
        return []
    known = known_pushes(records, load_values(records, calibration))
    counts = Counter(text for target in targets for text in known.texts(target))
    return [
        f"calibration {calibration}: {text} ({counted(n, 'experiment')})"
        for text, n in counts.items()
    ]


def evidence_of(
    targets: Sequence[Target],
    model: CalibrationModel,
    asked: Any,
    finished: Finished,
    report: ProgressCallback | None = None,
) -> dict[str, Any]:
    """Compute held-out errors of experiments, with coordinates and noise, as plain values."""
    apart = apart_of(targets, asked)
    errors = held_out(targets, model, apart, finished, report, asked.threads)
    scale = float(getattr(model.error, "angle_scale", ANGLE_SCALE))
    floor, source = noise_floor(targets, scale, ends=isinstance(model.error, EndPose))
    return {
        "keys": [target.key for target in targets],
        "ids": list(range(len(targets))),
        "coordinates": [coordinates_of(target) for target in targets],
        "configuration": [same_configuration(target) for target in targets],
        "error": [
            None if np.isnan(e) else "failed" if np.isinf(e) else e for e in errors.error.tolist()
        ],
        "fold": errors.fold.tolist(),
        "points": errors.points,
        "stepper": errors.stepper,
        "calibration": None,
        "started": "the calibration",
        "unseen": [],
        "floor_mm": floor,
        "floor_from": source,
        "folds": apart.folds,
        "labels": list(model.space.labels),
        "motion": model.motion.name,
        "scale_mm": 1e3 * scale,
        "left_out": {},
    }


def apart_of(targets: Sequence[Target], asked: Any) -> Apart:
    """Return what is fitted separately, and what is held out together."""
    folds = asked.folds
    if folds is None and asked.leave_out:
        folds = len({label_of(t.conditions, (asked.leave_out,)) for t in targets})
    elif folds is None:
        folds = default_folds(len(targets))
    return Apart(asked.apart, asked.leave_out, folds, asked.seed)


def errors_of(content: Mapping[str, Any], asked: Any) -> HeldOutErrors:
    """Return the errors that plain values describe, divided into the requested maps."""
    rows = content["coordinates"]
    names = dict.fromkeys(name for row in rows for name in row)
    values = {None: np.nan, "failed": np.inf}
    return HeldOutErrors(
        keys=tuple(content["keys"]),
        ids=tuple(content["ids"]),
        coordinates={name: tuple(row.get(name) for row in rows) for name in names},
        error_mm2=np.array([values.get(e, e) for e in content["error"]], np.float64),
        fold=np.array(content["fold"]),
        group=tuple(label_of(row, asked.facets) for row in rows),
        configuration=tuple(content["configuration"]),
    )


def _read(folder: Path) -> dict[str, Any] | None:
    try:
        content: dict[str, Any] = json.loads((folder / WHOLE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content


def _write(folder: Path, content: Mapping[str, Any]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(folder / WHOLE, json.dumps(content, allow_nan=False))
