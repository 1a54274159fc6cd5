"""Request for a domain map, the command that repeats it, and the model that its fits start from."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, NamedTuple, final

import numpy as np

from fixel.calibration.objective import MeanSquare
from fixel.calibration.target import Target
from fixel.calibration.usual_parameters import default_unknowns
from fixel.database.project import Project
from fixel.database.store import Store
from fixel.domain.claim import Claim
from fixel.domain.evidence import Measure
from fixel.errors import InvalidInput
from fixel.model.selection import Bound, ExperimentQuery, parse_filter
from fixel.model.space import ParameterSpace
from fixel.simulation.motion import motion_model, stated_name
from fixel.typing import FloatArray
from fixel.workflows.calibration.parameter_options import searched_unknowns
from fixel.workflows.calibration.result import FitKind
from fixel.workflows.calibration.stored import CalibratedValues, load_values, searched_space
from fixel.workflows.domain.held_out import CalibrationModel

OFFSETS: Final = ("offset_x_m", "offset_y_m", "offset_theta_rad")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class DomainRequest:
    """Options of a domain map.

    Attributes
    ----------
    query : ExperimentQuery
        Selection of experiments.
    calibration : int, optional
        Calibration at which fits start; by default the newest for several experiments.
    fit : sequence of str
        Parameters that replace the calibration's: `NAME=LOW:HIGH:START`.
    axes, by, apart : sequence of str
        Coordinates of the map; conditions that get a map for each value; conditions that get
        parameters for each value.
    engine : str
        Engine whose newest calibration is used, or that simulates with the parameters of `fit`.
    leave_out : str
        Condition whose values are held out as a whole.
    nominal : mapping of name to value
    steps : mapping of name to float
        Widths of ranges [SI].
    threshold : float, optional
        Largest allowed error [mm], or a share.
    measure : str
    level, confidence : float
    folds : int, optional
    seed : int
    """

    query: ExperimentQuery = field(default_factory=ExperimentQuery)
    calibration: int | None = None
    fit: Sequence[str] = ()
    axes: Sequence[str] = ()
    by: Sequence[str] = ()
    apart: Sequence[str] = ()
    leave_out: str = ""
    engine: str = ""
    nominal: Mapping[str, str | float] = field(default_factory=dict)
    steps: Mapping[str, float] = field(default_factory=dict)
    threshold: float | None = None
    measure: Measure = "absolute"
    level: float = 0.9
    confidence: float = 0.95
    folds: int | None = None
    seed: int = 0

    def _where(self) -> dict[str, str | float] | str:
        """Return the values of conditions, or a filter that compares otherwise."""
        bounds = self.query.bounds
        only_equal = self.query == ExperimentQuery(
            dataset=self.query.dataset, bounds=bounds, include_faulty=self.query.include_faulty
        ) and all(one.relation == "=" for one in bounds)
        return {one.name: one.value for one in bounds} if only_equal else self.query.filter

    def question(self) -> dict[str, Any]:
        """Return the request as plain content."""
        return {
            "dataset": self.query.dataset,
            "where": self._where(),
            "flagged": self.query.include_faulty,
            "calibration": self.calibration,
            "fit": list(self.fit),
            "axes": list(self.axes),
            "by": list(self.by),
            "apart": list(self.apart),
            "leave_out": self.leave_out,
            "engine": self.engine,
            "nominal": dict(self.nominal),
            "steps": dict(self.steps),
            "threshold": self.threshold,
            "measure": self.measure,
            "level": self.level,
            "confidence": self.confidence,
            "folds": self.folds,
            "seed": self.seed,
        }


def asked_again(question: Mapping[str, Any]) -> DomainRequest:
    """Rebuild a request from stored content; inverse of `DomainRequest.question`."""
    known = dict(question)
    where: dict[str, str | float] | str = known.pop("where")
    query = parse_filter(
        where if isinstance(where, str) else "", include_faulty=known.pop("flagged")
    )
    equal = () if isinstance(where, str) else where.items()
    bounds = (*query.bounds, *(Bound(name, "=", value) for name, value in equal))
    query = replace(query, dataset=known.pop("dataset"), bounds=bounds)
    return DomainRequest(query=query, **known)


class FitStarts(NamedTuple):
    """Model at which fits start."""

    model: CalibrationModel
    calibration: int | None
    said: str


def model_of(
    project: Project, store: Store, asked: DomainRequest, targets: Sequence[Target]
) -> FitStarts:
    """Return the parameters, motion and error of a stored calibration, else the usual ones."""
    scenes = [target.case.scene for target in targets]
    one = _calibration(store, asked)
    if one is None or asked.fit:
        unknowns = searched_unknowns(asked.fit, scenes) if asked.fit else default_unknowns(scenes)
        space = ParameterSpace(unknowns=tuple(unknowns))
        motion = motion_model(stated_name(asked.engine or "dynamic")) if one is None else one.motion
        error = MeanSquare() if one is None else one.error
        said = "parameters of --fit" if asked.fit else "the usual parameters, no calibration stored"
        return FitStarts(CalibrationModel(space=space, motion=motion, error=error), None, said)
    space = searched_space(project, one, scenes)
    model = CalibrationModel(space=space, motion=one.motion, error=one.error)
    return FitStarts(model, one.id, f"calibration {one.id}")


def _calibration(store: Store, asked: DomainRequest) -> CalibratedValues | None:
    if asked.calibration is not None:
        return load_values(store, asked.calibration, engine=asked.engine)
    if asked.fit or not (asked.engine or store.calibrations()):
        return None
    return load_values(store, engine=asked.engine)


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
            found=f"no experiment with its own smallest error ({notes[0]})",
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


def command_of(folder: Path, asked: DomainRequest, claim: Claim) -> str:
    """Return the command that repeats a map.

    Parameters
    ----------
    folder : Path
        Folder of the project; left out of the command if it is the current folder.
    asked : DomainRequest
    claim : Claim
        Claim that replaces the requested one.
    """
    words = ["fixel", "domain"]
    words += [] if folder == Path() else ["--project", str(folder)]
    if asked.query.dataset:
        words += ["--dataset", asked.query.dataset]
    words += ["--where", asked.query.filter] if asked.query.filter else []
    words += ["--all"] * asked.query.include_faulty
    if asked.calibration is not None:
        words += ["--calibration", str(asked.calibration)]
    words += ["--engine", asked.engine] if asked.engine else []
    for setting in asked.fit:
        words += ["--fit", setting]
    for option, names in (("--axes", asked.axes), ("--by", asked.by), ("--apart", asked.apart)):
        words += [option, ",".join(names)] if names else []
    words += ["--leave-out", asked.leave_out] if asked.leave_out else []
    if asked.nominal:
        words += ["--nominal", ",".join(f"{k}={v}" for k, v in asked.nominal.items())]
    for name, width in asked.steps.items():
        words += ["--step", f"{name}={width}"]
    option = "--threshold-mm" if claim.measure == "absolute" else "--relative"
    words += [option, f"{claim.threshold:.4g}"]
    for name in ("level", "confidence"):
        value = getattr(claim, name)
        words += [] if value == getattr(DomainRequest(), name) else [f"--{name}", f"{value:g}"]
    words += ["--folds", str(asked.folds)] if asked.folds else []
    words += ["--seed", str(asked.seed)] if asked.seed else []
    return shlex.join(words)
