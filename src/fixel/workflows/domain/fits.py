"""Fits of held-out errors: their start, and the folder of the finished ones."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.calibration.objective import AbstractError, EndPose, MeanSquare
from fixel.calibration.result import FitKind
from fixel.calibration.target import Target
from fixel.calibration.usual_parameters import Space, search_space
from fixel.database.project import Project
from fixel.database.store import Store
from fixel.domain.held_out import Apart, CalibrationModel, Finished, counted
from fixel.errors import InvalidInput
from fixel.io.array_bytes import ResultCache
from fixel.io.atomic import write_whole
from fixel.io.damaged_files import readable
from fixel.model.selection import ExperimentQuery, parse_filter
from fixel.simulation import AbstractMotionModel
from fixel.simulation.motion import motion_model, stated_name
from fixel.simulation.trust import permit
from fixel.typing import FloatArray
from fixel.workflows.calibration.calibration import Calibration
from fixel.workflows.calibration.plan import other_call
from fixel.workflows.calibration.request import target_files
from fixel.workflows.calibration.stored import CalibratedValues, load_values, searched_space

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
        raise InvalidInput(
            "relative",
            found=f"no experiment with its own smallest error ({counted(notes)})",
            expected="experiments that were calibrated in mode each with the same model",
            hint="calibrate them first: fixel calibrate --mode each",
        )
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
    if folder is None:
        return ResultCache(None).get
    folder = Path(folder)
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
        return ResultCache(folder).get
    cache = ResultCache(folder)
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
