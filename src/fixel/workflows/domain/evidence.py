"""Held-out errors of a project's experiments, computed once and stored; and the fits they need."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.calibration.objective import ANGLE_SCALE, AbstractError, EndPose, MeanSquare
from fixel.calibration.result import CalibratedValues, FitKind
from fixel.calibration.target import Target, same_configuration
from fixel.calibration.usual_parameters import Space, search_space
from fixel.database.project import ANALYSES, Project, check_known_names
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
    reasons_text,
)
from fixel.errors import InvalidInput, counted, no_experiments
from fixel.io.array_bytes import ResultCache
from fixel.io.atomic import readable, write_whole
from fixel.model.selection import ExperimentQuery, parse_filter
from fixel.simulation import AbstractMotionModel
from fixel.simulation.motion import motion_model, stated_name
from fixel.trust import permit
from fixel.typing import FloatArray, ProgressCallback
from fixel.workflows.calibration.calibration import Calibration
from fixel.workflows.calibration.execution import select_experiments
from fixel.workflows.calibration.plan import other_call
from fixel.workflows.calibration.request import target_files
from fixel.workflows.calibration.stored import (
    known_pushes,
    load_values,
    newest_calibration,
    searched_space,
)

CALL: Final = "call.json"
JOB: Final = "job.json"  # makes a folder that of a calibration


# --- start --------------------------------------------------------------------------------------


def calibration_model(
    fit: Calibration | Space,
    targets: Sequence[Target],
    motion: AbstractMotionModel | str | None = None,
) -> CalibrationModel:
    """Return the parameters that are fitted without each fold, and the method.

    They are those of a calibration, at which fits start, or as for `fixel.calibrate`. The motion
    model is by default that of the calibration, else dynamic. A program that is named is permitted.
    """
    permit(motion)
    error: AbstractError = MeanSquare()
    if isinstance(fit, Calibration):
        # Maps count mean squares [mm^2]; other errors minimised before do not matter here.
        space, motion = fit.space.started_at(fit.found.point), motion or fit.motion
        made = fit.request.made_error
        error = made if isinstance(made, MeanSquare | EndPose) else error
    else:
        space = search_space(fit, targets)
    return CalibrationModel(space=space, motion=motion_model(motion), error=error)


class ProjectRequest(NamedTuple):
    """Request on a project whose store is open."""

    project: Project
    store: Store
    # Request of a capability that fits: with `calibration`, `fit`, `engine`, `where` and so on.
    asked: Any

    @property
    def query(self) -> ExperimentQuery:
        """Query for the experiments of the request."""
        own = self.asked
        return parse_filter(*own.where, dataset=own.dataset or None, include_faulty=own.flagged)


class FitStarts(NamedTuple):
    """Model at which fits start, with the id of its calibration and words for it."""

    model: CalibrationModel
    calibration: int | None
    words: str


def stored_model(of: ProjectRequest, targets: Sequence[Target]) -> FitStarts:
    """Return the parameters, motion and error of a stored calibration, else the usual ones."""
    scenes, asked = [target.case.scene for target in targets], of.asked
    one = None
    if asked.calibration is not None:
        one = load_values(of.store, asked.calibration, engine=asked.engine)
    elif not asked.fit and (asked.engine or of.store.calibrations()):
        one = load_values(of.store, engine=asked.engine)
    words = "the usual parameters, no calibration stored"
    if asked.fit:
        words = "parameters of --fit"
    elif one is not None:
        words = f"calibration {one.id}"
    model = CalibrationModel(
        space=searched_space(of.project, one, scenes, asked.fit),
        motion=motion_model(stated_name(asked.engine or "dynamic")) if one is None else one.motion,
        error=MeanSquare() if one is None else one.error,
    )
    return FitStarts(model, None if one is None or asked.fit else one.id, words)


def own_best(
    store: Store, ids: Sequence[int], model: CalibrationModel
) -> tuple[FloatArray, list[str]]:
    """(n,) least E of single calibrations of experiments [mm^2], and why some have none.

    Calibrations with another motion model, error or angle scale are ignored.
    """
    place = {number: k for k, number in enumerate(ids)}
    best = np.full(len(ids), np.nan)
    notes = ["not calibrated by itself"] * len(ids)
    for number, record in store.calibration_summaries().items():
        if (
            record.method.get("how") not in (FitKind.ALONE, FitKind.NEIGHBOUR)
            or len(record.members) != 1
        ):
            continue
        k = place.get(record.members[0].experiment_id)
        if k is None:
            continue
        other = _differs(CalibratedValues(number, record), model)
        if other:
            if np.isnan(best[k]):
                notes[k] = f"calibrated by itself under another {other}"
            continue
        if np.isfinite(record.members[0].error_mm2):
            best[k] = np.fmin(best[k], record.members[0].error_mm2)
            notes[k] = ""
    if np.isnan(best).all():
        found = f"no experiment with its own smallest error ({reasons_text(notes)})"
        expected = "experiments that were calibrated in mode each with the same model"
        hint = "calibrate them first: fixel calibrate --mode each"
        raise InvalidInput("relative", found=found, expected=expected, hint=hint)
    return best, notes


def _differs(one: CalibratedValues, model: CalibrationModel) -> str:
    if one.motion.name != model.motion.name:
        return f"motion model ({one.motion.name})"
    if one.error.name != model.error.name:
        return f"error ({one.error.name})"
    scales = [float(e.angle_scale) for e in (one.error, model.error)]
    return "" if scales[0] == scales[1] else f"angle scale ({1e3 * scales[0]:g} mm/rad)"


# --- finished fits ------------------------------------------------------------------------------


def fit_store(
    folder: str | Path | None, targets: Sequence[Target], model: CalibrationModel, apart: Apart
) -> Finished:
    """Return the cache of fits in a folder; one that stores nothing without a folder.

    A folder of a call that needs other fits raises `InvalidInput` with the difference.
    """
    cache = ResultCache(folder)
    if cache.folder is None:
        return cache.get
    folder = cache.folder
    own = _arguments(targets, model, apart)
    path = folder / CALL
    if (folder / JOB).is_file():
        raise other_call(folder, "a job")
    if path.is_file():
        with readable(path, f"delete the folder {folder}"):
            before = dict(json.loads(path.read_text(encoding="utf-8")))
        for name, now in own.items():
            if before.get(name) != now:
                if name == "experiments":
                    raise other_call(folder, "a call with other experiments")
                found = f"a call with another {name}: {before.get(name)}"
                raise other_call(folder, found, f", which has {now} now")
        return cache.get
    write_whole(path, json.dumps(own, indent=1))
    return cache.get


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
            check_known_names(records, of.query)
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
