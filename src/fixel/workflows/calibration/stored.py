"""Use a stored calibration as a model to simulate with."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Final, final

from fixel.calibration.known_pushes import KnownPushes
from fixel.calibration.objective import ERRORS, AbstractError, MeanSquare
from fixel.calibration.result import FitKind
from fixel.calibration.target import target_of
from fixel.database.project import DATABASE, Project
from fixel.database.store import Store
from fixel.errors import InvalidInput
from fixel.io.damaged_files import readable
from fixel.model import Experiment, Scene
from fixel.model.parameters import is_parameter
from fixel.model.records import CalibrationRecord
from fixel.model.space import ParameterSpace, Unknown, meets, split_label
from fixel.simulation import AbstractMotionModel
from fixel.simulation.engine_names import EngineName
from fixel.simulation.motion import motion_model
from fixel.workflows.calibration.parameter_options import searched_unknowns
from fixel.workflows.calibration.plan import REQUEST, job_of, request_of
from fixel.workflows.calibration.request import NAMED, CalibrationRequest, NamedOptions

SEARCHED: Final = "unknowns"  # in the method of earlier records: the parameters, as JSON
VERSION: Final = 1  # of stored requests; those without one are as of version 1


@final
@dataclass(frozen=True)
class CalibratedValues:
    """Calibrated parameters with the method that found them."""

    id: int
    record: CalibrationRecord

    @property
    def members(self) -> frozenset[int]:
        """Ids of the experiments of the calibration."""
        return frozenset(member.experiment_id for member in self.record.members)

    @property
    def is_for_several(self) -> bool:
        """Whether a single set of parameters was calibrated to several experiments."""
        how = self.record.method.get("how")
        return len(self.record.members) > 1 and how not in (FitKind.ALONE, FitKind.NEIGHBOUR)

    @cached_property
    def motion(self) -> AbstractMotionModel:
        """Motion model of the calibration, or its engine."""
        return motion_model(self.record.motion or None)

    @cached_property
    def error(self) -> AbstractError:
        """Error that the calibration minimised."""
        method = self.record.method
        kind = next((own for own in ERRORS if own.name == method.get("error")), MeanSquare)
        options = {field.name: method.get(f"error.{field.name}") for field in fields(kind)}
        return kind(**{name: float(value) for name, value in options.items() if value is not None})

    @property
    def level(self) -> float | None:
        """Confidence level of the intervals; None if it was not stored."""
        level: float | None = (self.record.request or {}).get("level")
        return level

    def values(self, conditions: Mapping[str, str | float]) -> dict[str, float]:
        """Return the parameters for an experiment under these conditions, by name [SI].

        Conditions include the experiment's key as `"experiment"`.
        """
        found: dict[str, float] = {}
        for label, value in self.record.best_fit.items():
            name, where = split_label(label)
            if meets(conditions, where):
                found.setdefault(name, value)  # the first that applies, as in `values_under`
        return found

    def values_for(self, experiment: Experiment) -> dict[str, float]:
        """Return the parameters for an experiment that this version knows, by name [SI]."""
        values = self.values({**experiment.conditions, "experiment": experiment.key})
        return {name: value for name, value in values.items() if is_parameter(name)}


def misfit_of(record: CalibrationRecord) -> list[str]:
    """Return the warning stored with a calibration that the model is wrong, by sentences."""
    return str(record.method.get("misfit", "")).splitlines()


def load_values(
    store: Store, calibration_id: int | None = None, engine: str = ""
) -> CalibratedValues:
    """Load a stored calibration: by its id, or else the newest that the engine simulated.

    Without an id, those for several experiments come first, as in `newest_calibration`. Means
    computed by the growth of a domain are selected only by their id.
    """
    own = newest_calibration(store, engine=engine) if calibration_id is None else calibration_id
    if own is None:
        raise InvalidInput(
            "calibration",
            found="none stored" + (f" by {engine}" if engine else ""),
            expected="at least one",
            hint="calibrate first: fixel calibrate" + (f" --engine {engine}" if engine else ""),
        )
    found = CalibratedValues(own, store.calibration(own))
    if engine and not EngineName.of(engine).fits(found.motion.name):
        raise InvalidInput(
            f"calibration {own}", found=f"one by {found.motion.name}", expected=f"one by {engine}"
        )
    return found


def known_pushes(store: Store, one: CalibratedValues) -> KnownPushes:
    """Return the parts, surfaces, laboratories, sides and speeds that a calibration has used."""
    targets = []
    for number in sorted(one.members):
        with suppress(InvalidInput):  # without a scene it cannot have been used
            targets.append(target_of(store.experiment(number)))
    return KnownPushes.of(targets)


def newest_calibration(store: Store, experiment: int | None = None, engine: str = "") -> int | None:
    """Return the id of the calibration that `load_values` loads by default; None without any.

    An experiment must be a member, and an engine must have simulated, with any version and choices
    that are not named; empty for any engine or motion model.
    """
    every = (CalibratedValues(*own) for own in reversed(store.calibration_summaries().items()))
    known = [
        one
        for one in every
        if one.record.method.get("how") != FitKind.GROWTH
        and (experiment is None or experiment in one.members)
        and (not engine or EngineName.of(engine).fits(one.motion.name))
    ]
    return next((one.id for one in sorted(known, key=lambda one: not one.is_for_several)), None)


def searched_space(
    project: Project, one: CalibratedValues, scenes: Sequence[Scene]
) -> ParameterSpace:
    """Return the bounds that a calibration searched, with its result as the start.

    Calibrations stored by earlier versions have the bounds in their job folder only. If it is
    gone, the usual bounds of their parameters are returned.
    """
    record, folder = one.record, job_of(project, one.record)
    found = record.best_fit
    if record.request is not None or SEARCHED in record.method:
        with readable(project.folder / DATABASE):
            space = request_in(record).space
    elif (folder / "inputs" / REQUEST).is_file():
        space = request_of(folder).space
    else:
        space = _usual_space(one, found, scenes)
    start = zip(space.labels, space.nominal.tolist(), strict=True)
    return space.started_at([found.get(label, value) for label, value in start])


def request_in(record: CalibrationRecord) -> CalibrationRequest:
    """Return the request of a record; of an earlier version, without the level."""
    if record.request is not None:
        content = dict(record.request)
        if content.pop("version", VERSION) > VERSION:
            raise ValueError("a newer version of fixel stored its request")
        return CalibrationRequest.model_validate(content)
    method = dict(record.method)
    searched = json.loads(str(method.get(SEARCHED, "[]")))
    kinds = dict.fromkeys(NAMED, "unknown") | {"error": MeanSquare.name}
    named = {
        kind: NamedOptions(
            name=str(method.get(kind, usual)),
            options={k.removeprefix(f"{kind}."): v for k, v in method.items()
                     if k.startswith(f"{kind}.")},
        )
        for kind, usual in kinds.items()
    }  # fmt: skip
    own = {k: v for k, v in method.items() if k in CalibrationRequest.model_fields}
    unknowns = [Unknown(**one) for one in searched] or [
        Unknown.fixed(name, value) for name, value in record.parameters.items()
    ]
    return CalibrationRequest.model_validate(
        {
            **own,
            **named,
            "name": record.name.partition(":")[0],
            "unknowns": unknowns,
            "seed": record.provenance.seed or 0,
            "level": None,
            "verdicts": bool(record.estimates),
        }
    )


def _usual_space(
    one: CalibratedValues, found: Mapping[str, float], scenes: Sequence[Scene]
) -> ParameterSpace:
    """Return the usual bounds, widened to the result; raise if a parameter has none."""
    held = {e.label for e in one.record.estimates if e.verdict == "frozen"}
    unknowns = []
    for label, value in found.items():
        name, where = split_label(label)
        if where:
            raise InvalidInput(
                f"calibration {one.id}",
                found=f"no job folder, and {label}, which only some experiments share",
                expected="the job folder, which has the conditions and bounds",
                hint="calibrate again, or name the parameters",
            )
        (unknown,) = searched_unknowns([name], scenes)
        low, high = min(unknown.low, value), max(unknown.high, value)
        unknowns.append(replace(unknown, low=low, high=high, nominal=value, frozen=label in held))
    return ParameterSpace(unknowns=tuple(unknowns))
