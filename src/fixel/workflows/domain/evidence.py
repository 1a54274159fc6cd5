"""Held-out errors of a project's experiments, computed once and stored."""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.calibration.noise import noise_from_repetitions
from fixel.calibration.objective import ANGLE_SCALE, EndPose
from fixel.calibration.target import Target, repetitions, same_configuration
from fixel.database.project import ANALYSES, Project
from fixel.database.store import Store
from fixel.domain.coordinates import coordinates_of, label_of
from fixel.domain.evidence import HeldOutErrors, Value, default_folds
from fixel.errors import InvalidInput
from fixel.io.atomic import written_whole
from fixel.io.damaged_files import readable
from fixel.io.result_cache import ResultCache
from fixel.typing import FloatArray, ProgressCallback
from fixel.workflows.calibration.project import select_experiments
from fixel.workflows.calibration.stored import known_pushes, load_values, newest_calibration
from fixel.workflows.domain.held_out import (
    MAX_TRAINING,
    SQUARES,
    Apart,
    CalibrationModel,
    HeldOut,
    held_out,
)
from fixel.workflows.domain.request import DomainRequest, model_of, own_best

FOLDER: Final = "held-out"
WHOLE: Final = "evidence.json"
VERSION: Final = 2  # increase it when the same request no longer means the same numbers


class DomainEvidence(NamedTuple):
    """Held-out errors, with the settings that produced them."""

    evidence: HeldOutErrors
    calibration: int | None
    started: str  # start of the fits, in words
    floor_mm: float | None  # error of a perfect simulator, from measurement noise alone
    floor_from: str
    fits: int
    folds: int
    points: dict[str, list[float]]
    labels: tuple[str, ...]
    motion: str
    stepper: str
    scale_mm: float  # length that a radian counts as
    left_out: dict[str, str]
    is_real: bool
    mark: str = ""  # name of the folder in which it is stored
    unseen: tuple[str, ...] = ()  # what no experiment of the calibration has


def gather(
    project: Project, asked: DomainRequest, progress: ProgressCallback | None = None
) -> DomainEvidence:
    """Compute the held-out errors of the requested experiments, or load them if stored.

    They are shared by maps of the same experiments with other axes, thresholds and nominals.
    """
    with project.store() as store:
        summaries = store.experiments(asked.query).rows
        if not summaries:
            raise InvalidInput(
                "experiments",
                found="none",
                expected="some",
                hint="fixel list shows all experiments",
            )
        mark = _mark(asked, [summary.id for summary in summaries], _newest(store, asked))
        folder = project.folder / ANALYSES / FOLDER / mark
        content = _read(folder / WHOLE)
        if content is None:
            content = _computed(project, store, asked, ResultCache(folder), progress)
            with written_whole(folder / WHOLE) as path:
                path.write_text(json.dumps(content, allow_nan=False), encoding="utf-8")
        with readable(folder / WHOLE, f"delete the folder {folder}"):
            gathered = gathered_from(content, asked)
        if asked.measure == "relative":
            gathered = _with_own(project, store, asked, gathered)
    real = all(summary.is_real for summary in summaries)
    return gathered._replace(is_real=real, mark=mark)


def store_evidence(
    project: Project, content: Mapping[str, Any], asked: DomainRequest
) -> DomainEvidence:
    """Store evidence of a map that was computed in memory, for the pages; return it with ids."""
    if not content:
        expected = "a map that fixel.map_domain has made"
        raise InvalidInput("map", found="no evidence in it", expected=expected)
    with project.store() as store:
        ids = [store.find(key) for key in content["keys"]]
        real = all(store.experiment(number).real for number in ids)
    whole = {**content, "ids": ids}
    text = json.dumps(whole, allow_nan=False)
    mark = hashlib.sha256(text.encode()).hexdigest()[:12]
    folder = project.folder / ANALYSES / FOLDER / mark
    folder.mkdir(parents=True, exist_ok=True)
    with written_whole(folder / WHOLE) as path:
        path.write_text(text, encoding="utf-8")
    return gathered_from(whole, asked)._replace(is_real=real, mark=mark)


def gathered_before(
    project: Project, store: Store, asked: DomainRequest, mark: str
) -> DomainEvidence | None:
    """Load evidence that `gather` has stored, without computation; None if it is gone."""
    path = project.folder / ANALYSES / FOLDER / mark / WHOLE
    content = _read(path) if mark else None
    if content is None:
        return None
    with readable(path, f"delete the folder {path.parent} and compute the map again"):
        gathered = gathered_from(content, asked)
    if asked.measure == "relative":
        gathered = _with_own(project, store, asked, gathered)
    real = all(summary.is_real for summary in store.experiments(asked.query).rows)
    return gathered._replace(is_real=real, mark=mark)


def mark_of(store: Store, asked: DomainRequest, calibration: int | None) -> str:
    """Name of the folder in which evidence was stored when a calibration was the newest."""
    ids = store.experiment_ids(asked.query)
    return _mark(asked, ids, calibration)


def _newest(store: Store, asked: DomainRequest) -> int | None:
    return (
        None
        if asked.calibration is not None or asked.fit
        else newest_calibration(store, engine=asked.engine)
    )


def _mark(asked: DomainRequest, ids: Sequence[int], latest: int | None) -> str:
    """Hash of everything the numbers depend on; stored records never change."""
    question = asked.question()
    kept = {k: question[k] for k in ("calibration", "fit", "apart", "leave_out", "folds", "seed")}
    kept |= {"engine": asked.engine} if asked.engine else {}
    if asked.calibration is None and not asked.fit:
        kept["newest_calibration"] = latest
    of = [VERSION, kept, list(ids), repr(SQUARES), MAX_TRAINING]
    return hashlib.sha256(json.dumps(of, sort_keys=True).encode()).hexdigest()[:12]


def _computed(
    project: Project,
    store: Store,
    asked: DomainRequest,
    finished: ResultCache,
    progress: ProgressCallback | None,
) -> dict[str, Any]:
    chosen = select_experiments(store, (), asked.query)
    started = model_of(project, store, asked, chosen.targets)
    if asked.measure == "relative":  # raises before hours of fits if there is no own best
        own_best(store, chosen.ids, started.model)
    return {
        **evidence_of(chosen.targets, started.model, asked, finished, progress),
        "ids": chosen.ids,
        "unseen": _unseen(store, started.calibration, chosen.targets),
        "calibration": started.calibration,
        "started": started.said,
        "left_out": dict(chosen.left_out),
    }


def _unseen(store: Store, calibration: int | None, targets: Sequence[Target]) -> list[str]:
    """Return what no experiment of the calibration has, with the number of experiments."""
    if calibration is None:
        return []
    known = known_pushes(store, load_values(store, calibration))
    counts = Counter(text for target in targets for text in known.texts(target))
    return [
        f"calibration {calibration}: {text} ({n} experiment{'s' if n > 1 else ''})"
        for text, n in counts.items()
    ]


def evidence_of(
    targets: Sequence[Target],
    model: CalibrationModel,
    asked: DomainRequest,
    finished: ResultCache,
    progress: ProgressCallback | None = None,
    threads: int | None = None,
) -> dict[str, Any]:
    """Compute held-out errors of experiments, with coordinates and noise, as plain values."""
    apart = apart_of(targets, asked)
    errors = held_out(targets, model, apart, finished, progress, threads)
    floor, source = noise_floor(targets, _scale(model), ends=isinstance(model.error, EndPose))
    return {
        "keys": [target.key for target in targets],
        "ids": list(range(len(targets))),
        "coordinates": [coordinates_of(target) for target in targets],
        "configuration": [same_configuration(target) for target in targets],
        **_plain(errors),
        "calibration": None,
        "started": "the calibration",
        "floor_mm": floor,
        "floor_from": source,
        "folds": apart.folds,
        "labels": list(model.space.labels),
        "motion": model.motion.name,
        "scale_mm": 1e3 * _scale(model),
        "left_out": {},
    }


def apart_of(targets: Sequence[Target], asked: DomainRequest) -> Apart:
    """Return what is fitted separately, and what is held out together."""
    folds = _usual(targets, asked) if asked.folds is None else asked.folds
    return Apart(tuple(asked.apart), asked.leave_out, folds, asked.seed)


def _usual(targets: Sequence[Target], asked: DomainRequest) -> int:
    if asked.leave_out:
        return len({label_of(t.conditions, (asked.leave_out,)) for t in targets})
    return default_folds(len(targets))


def _scale(model: CalibrationModel) -> float:
    return float(getattr(model.error, "angle_scale", ANGLE_SCALE))


def _plain(errors: HeldOut) -> dict[str, Any]:
    words = {np.inf: "failed"}
    return {
        "error": [None if np.isnan(e) else words.get(e, e) for e in errors.error.tolist()],
        "fold": errors.fold.tolist(),
        "points": errors.points,
        "stepper": errors.stepper,
    }


def _read(path: Any) -> dict[str, Any] | None:
    try:
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content


def gathered_from(content: Mapping[str, Any], asked: DomainRequest) -> DomainEvidence:
    """Return the evidence that plain values describe, divided into the maps requested."""
    rows: list[dict[str, Value]] = content["coordinates"]
    names = dict.fromkeys(name for row in rows for name in row)
    values = {None: np.nan, "failed": np.inf}
    evidence = HeldOutErrors(
        keys=tuple(content["keys"]),
        ids=tuple(content["ids"]),
        coordinates={name: tuple(row.get(name) for row in rows) for name in names},
        error_mm2=np.array([values.get(e, e) for e in content["error"]], np.float64),
        fold=np.array(content["fold"]),
        group=tuple(label_of(row, asked.by) for row in rows),
        configuration=tuple(content["configuration"]),
    )
    return DomainEvidence(
        evidence=evidence,
        calibration=content["calibration"],
        started=content["started"],
        floor_mm=content["floor_mm"],
        floor_from=content["floor_from"],
        fits=len(content["points"]),
        folds=content["folds"],
        points=content["points"],
        labels=tuple(content["labels"]),
        motion=content["motion"],
        stepper=content["stepper"],
        scale_mm=content["scale_mm"],
        left_out=content["left_out"],
        is_real=True,
        unseen=tuple(content.get("unseen", ())),
    )


def _with_own(
    project: Project, store: Store, asked: DomainRequest, one: DomainEvidence
) -> DomainEvidence:
    """Add own best errors; experiments without one get a note and are no evidence."""
    targets = select_experiments(store, one.evidence.keys[:1], asked.query).targets
    model = model_of(project, store, asked, targets).model
    own, notes = own_best(store, one.evidence.ids, model)
    return one._replace(evidence=replace(one.evidence, own_mm2=own, notes=tuple(notes)))


# --- noise of the measurement -------------------------------------------------------------------


def noise_floor(
    targets: Sequence[Target], scale: float, *, ends: bool = False
) -> tuple[float | None, str]:
    """Return the root mean square error of a perfect simulator [mm], and its source.

    It is computed from repetitions, else from the scatter of measured poses about smooth motion;
    None if there are too few frames.

    Parameters
    ----------
    targets : sequence of Target
    scale : float
        Length that an angle counts as [m/rad].
    ends : bool
        Whether only last poses count, as in a map of them.
    """
    groups = repetitions(targets, ends=ends)
    if groups:
        noise = noise_from_repetitions(groups)
        floor = 1e3 * math.hypot(noise.position_m, noise.position_m, scale * noise.angle_rad)
        return floor, "repetitions"
    weights = np.array([1e3, 1e3, 1e3 * scale])
    bends = [_bends(target.pose * weights) for target in targets if len(target.pose) > 8]
    if not bends:
        return None, ""
    # The median over runs: in a few, contacts bend the path itself.
    return float(np.median(bends)), "scatter from frame to frame"


def _bends(pose: FloatArray) -> float:
    """Noise [mm] from second differences, whose variance is six times as large (white noise)."""
    second = np.diff(pose, n=2, axis=0)
    middle = np.median(second**2, axis=0) / 0.4549  # variance of normal numbers from the median
    return float(np.sqrt(middle.sum() / 6.0))
