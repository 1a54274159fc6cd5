"""Stored calibrations of single experiments, from which a domain grows."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, final

import numpy as np

from fixel.domain.growth import Joint, SingleCalibrations
from fixel.errors import InvalidInput
from fixel.model.records import CalibrationRecord
from fixel.workflows.calibration.result import FitKind
from fixel.workflows.calibration.stored import CalibratedValues
from fixel.workflows.growth.samples import GrowthSamples

ANGLE_SCALE = "error.angle_scale"


class SingleMethod(NamedTuple):
    """Properties that sets of parameters must share for their errors to be comparable."""

    motion: str
    error: str
    unit: str
    options: tuple[tuple[str, str | float], ...]  # options of the error
    names: tuple[str, ...]  # names of the parameters

    def __str__(self) -> str:
        scale = dict(self.options).get(ANGLE_SCALE)
        at = f", {1e3 * scale:g} mm/rad" if isinstance(scale, float) else ""
        return f"{self.motion}, {self.error} [{self.unit}{at}] of {', '.join(self.names)}"


class One(NamedTuple):
    """Stored set of parameters."""

    id: int
    record: CalibrationRecord
    values: dict[str, float]

    @property
    def error(self) -> float:
        """Error of its only member."""
        return self.record.errors[0]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StoredSets:
    """Sets of parameters of one method."""

    method: SingleMethod
    best: list[One]  # best set of each experiment
    # The same sets for the growth; parameters in the order of `method.names`.
    singles: SingleCalibrations
    calibrated: CalibratedValues  # one of the sets, for motion model and error
    warnings: list[str] = field(default_factory=list)


def best_singles(
    summaries: Mapping[int, CalibrationRecord],
    samples: GrowthSamples,
    motion: str = "",
    error: str = "",
    folder: Path = Path(),
) -> StoredSets:
    """Select the best stored calibration of every single experiment, all of one method.

    Parameters
    ----------
    summaries : mapping from int to CalibrationRecord
        Result of `Store.calibration_summaries`.
    samples : GrowthSamples
    motion, error : str
        Use only calibrations made with these.
    folder : Path
        Folder of the project, for commands in hints.

    Raises
    ------
    InvalidInput
        Experiments without a calibration, or calibrations of several methods.
    """
    place = {number: k for k, number in enumerate(samples.ids)}
    by_method: dict[SingleMethod, dict[int, One]] = {}
    for number, record in summaries.items():
        if len(record.members) != 1 or record.members[0].experiment_id not in place:
            continue
        if motion not in ("", record.method.get("motion")):
            continue
        if error not in ("", record.method.get("error")):
            continue
        k = place[record.members[0].experiment_id]
        one = One(
            number, record, CalibratedValues(number, record).values(samples.targets[k].conditions)
        )
        best = by_method.setdefault(_method(one), {})
        # The newest of equals.
        if k not in best or not one.error > best[k].error:
            best[k] = one
    method, warnings = _chosen(by_method, samples, folder)
    found = [by_method[method][k] for k in range(len(samples.ids))]
    points = np.array([[one.values[name] for name in method.names] for one in found])
    errors = np.array([one.error for one in found])
    return StoredSets(
        method=method,
        best=found,
        singles=SingleCalibrations(
            points=points, errors=errors, joint=_joint(summaries, method, place, samples)
        ),
        calibrated=CalibratedValues(found[0].id, found[0].record),
        warnings=warnings,
    )


def _method(one: One) -> SingleMethod:
    own = one.record.method
    return SingleMethod(
        motion=str(own.get("motion", "")),
        error=str(own.get("error", "")),
        unit=str(own.get("error_unit", "")),
        options=tuple((k, v) for k, v in sorted(own.items()) if k.startswith("error.")),
        names=tuple(sorted(one.values)),
    )


def _chosen(
    by_method: dict[SingleMethod, dict[int, One]], samples: GrowthSamples, folder: Path
) -> tuple[SingleMethod, list[str]]:
    """Select the method under which every experiment has a set; of several the last one used."""
    n = len(samples.ids)
    whole = [method for method, best in by_method.items() if len(best) == n]
    if not whole:
        _refuse(by_method, samples, folder)
    whole.sort(key=lambda method: max(one.id for one in by_method[method].values()))
    if len(whole) == 1:
        return whole[0], []
    others = "; ".join(str(method) for method in whole[:-1])
    return whole[-1], [
        f"Calibrations of {len(whole)} methods are stored. The newest are used: {whole[-1]}. Not "
        f"used: {others}. Choose others with --motion and --error."
    ]


def _refuse(
    by_method: dict[SingleMethod, dict[int, One]], samples: GrowthSamples, folder: Path
) -> None:
    n = len(samples.ids)
    place = [] if folder == Path() else ["--project", str(folder)]
    command = shlex.join(["fixel", "calibrate", "--mode", "each", "--no-verdicts", *place])
    anywhere = {k for best in by_method.values() for k in best}
    lacking = [samples.keys[k] for k in range(n) if k not in anywhere]
    if lacking:
        few = lacking[:3]
        raise InvalidInput(
            "calibrations",
            found=f"no single calibration of {len(lacking)} of {n} experiments: {', '.join(few)}"
            + (" and others" if len(lacking) > len(few) else ""),
            expected="a single calibration of every experiment",
            hint=command,
        )
    parts = []
    for method, best in sorted(by_method.items(), key=lambda entry: -len(entry[1])):
        first = samples.keys[min(best)]
        parts.append(f"{len(best)} of {n} experiments, such as {first}, under {method}")
    raise InvalidInput(
        "calibrations",
        found="; ".join(parts),
        expected="the same motion model, error, unit and parameters for all",
        hint=f"calibrate all in one way: {command}",
    )


def _joint(
    summaries: Mapping[int, CalibrationRecord],
    method: SingleMethod,
    place: Mapping[int, int],
    samples: GrowthSamples,
) -> dict[tuple[int, ...], Joint]:
    """Stored joint sets of these experiments; of several, that with the least largest error, then
    the newest. Means of an exploration are recomputed: members may have better sets by now."""
    least: dict[tuple[int, ...], float] = {}
    found: dict[tuple[int, ...], Joint] = {}
    for number, record in summaries.items():
        if len(record.members) < 2 or record.method.get("how") == FitKind.GROWTH:
            continue
        rows = [place.get(member.experiment_id, -1) for member in record.members]
        if min(rows) < 0:
            continue
        model = CalibratedValues(number, record)
        sets = [model.values(samples.targets[k].conditions) for k in rows]
        one = One(number, record, sets[0])
        if _method(one) != method or any(values != sets[0] for values in sets):
            continue
        members, largest = tuple(sorted(rows)), max(record.errors)
        if not math.isfinite(largest) or largest > least.get(members, math.inf):
            continue
        least[members] = largest
        found[members] = Joint(number, np.array([sets[0][name] for name in method.names]))
    return found
