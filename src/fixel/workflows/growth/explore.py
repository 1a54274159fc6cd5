"""Grow the domains of a project, study its axes, and store the averaged calibrations."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.calibration.objective import Comparer, Evaluation
from fixel.calibration.result import CalibratedValues, FitKind
from fixel.database.store import Store
from fixel.domain.along_axis import SIZES, AxisStudy, plan_studies
from fixel.domain.growth import (
    AVERAGED,
    AXES,
    Growth,
    RolloutQueue,
    SingleCalibrations,
    Step,
    plan_growth,
    weights,
)
from fixel.errors import InvalidInput, check_name, counted, number_of, some_of
from fixel.model import Parameters, Provenance
from fixel.model.records import CalibrationRecord, Member
from fixel.model.space import ParameterSpace, Unknown
from fixel.progress import Reporter
from fixel.simulation.simulate import get_ready
from fixel.typing import FloatArray
from fixel.workflows.growth.samples import GrowthSamples, read_samples

# Threshold of the thesis, read off figure 6.5 (section 6.3.1) [mm^2].
THRESHOLD: Final = 5.0

# A stored error that differs from a repeated simulation by more than this share comes from other
# data or from another simulator.
SAME_ERROR: Final = 0.01

# Share of an experiment's own best error: if another set does better, its search failed.
STUCK: Final = 0.5


class Exploration(NamedTuple):
    """Result of an exploration."""

    samples: GrowthSamples
    stored: StoredSets
    growth: Growth
    studies: list[AxisStudy]
    threshold: float  # threshold in the unit of the error
    rollouts: int
    added: list[int]  # ids of the calibrations that were stored
    warnings: list[str]

    @property
    def unit(self) -> str:
        """Unit of the errors."""
        return self.stored.method.unit


def explore(
    store: Store,
    asked: Any,
    folder: Path = Path(),
    command: str = "",
    progress: Reporter | None = None,
) -> Exploration:
    """Explore the domain of applicability as in the thesis, for a request of `grow_stored`.

    The store has single calibrations, and new means are added to it. `folder`, that of the project,
    and `command` are for commands that repeat it.
    """
    limits = {**SIZES, **sizes_in(asked.sizes)}
    samples = read_samples(store, asked.shape or None, asked.dataset or None)
    summaries = store.calibration_summaries()
    stored = best_singles(summaries, samples, asked.motion, asked.error, folder)
    threshold = threshold_in(asked.limit, stored.method.unit)
    wanted = RolloutQueue()
    growth_of = plan_growth(samples.groups, stored.singles, wanted, asked.index)
    studies_of = plan_studies(samples.groups, stored.singles, wanted, limits)
    get_ready(samples.targets[0].case.scene)
    if progress is not None:
        progress.stage = f"simulating {counted(len(wanted), 'time')}"
    method = stored.best[0]  # they have the same motion model and error
    comparer = Comparer(samples.targets, _space(stored), method.error, method.motion)
    answer = wanted.run(comparer.errors)
    growth = growth_of(answer)
    added = _keep(store, summaries, growth, samples, stored, command)
    return Exploration(
        samples=samples,
        stored=stored,
        growth=growth,
        studies=studies_of(answer),
        threshold=threshold,
        rollouts=len(wanted),
        added=added,
        warnings=[
            *samples.warnings,
            *stored.warnings,
            *_changed(growth, stored.singles),
            *_beaten(wanted, answer, stored.singles, samples),
            *_empty(growth),
            *_failed(answer),
        ],
    )


def sizes_in(texts: Sequence[str]) -> dict[str, tuple[int, ...]]:
    """Return the numbers of samples by axis: `y=3,5` for one axis, `2,4` for all."""
    found: dict[str, tuple[int, ...]] = {}
    for text in texts:
        axis, equals, numbers = text.rpartition("=")
        is_list = re.fullmatch(r" *[0-9]+ *(, *[0-9]+ *)*", numbers)
        own = tuple(map(int, numbers.split(","))) if is_list else ()
        if not own or (equals and axis not in AXES):
            raise InvalidInput(
                "sizes", found=repr(text), expected="numbers of samples, such as y=3,5 or 2,4"
            )
        found |= dict.fromkeys((axis,) if equals else AXES, own)
    return found


def threshold_in(text: str, unit: str) -> float:
    """Convert the text of a threshold to the unit of the error, `"mm^2"` or `"mm"`.

    The text is a number in that unit, or a root mean square distance with the suffix `mm`:
    `"2.2mm"` is 4.84 for an error in mm^2. Empty for 5 mm^2, as in the thesis.
    """
    if not text:
        return THRESHOLD if unit == "mm^2" else math.sqrt(THRESHOLD)
    match = re.fullmatch(r"\s*([0-9.eE+-]+)\s*(mm\^?2|mm)?\s*", text)
    expected = f"a positive number [{unit}], or a distance like 2.2mm"
    value = number_of(match[1], "limit", expected) if match else -1.0
    if match is None or value <= 0.0:
        raise InvalidInput("limit", found=repr(text), expected=expected)
    given = unit if match[2] is None else match[2].replace("mm2", "mm^2")
    if given == unit:
        return value
    return value**2 if unit == "mm^2" else math.sqrt(value)


def _space(stored: StoredSets) -> ParameterSpace:
    """Parameters for the comparer; nothing is searched, so bounds need only contain the points."""
    points = [stored.singles.points, *(own[None] for _, own in stored.singles.joint.values())]
    every = np.concatenate(points)
    low, high = every.min(axis=0).tolist(), every.max(axis=0).tolist()
    return ParameterSpace(
        unknowns=tuple(
            Unknown(name=name, low=a, high=b if b > a else a + 1.0, nominal=a)
            for name, a, b in zip(stored.method.names, low, high, strict=True)
        )
    )


# --- stored calibrations ------------------------------------------------------------------------


def _keep(
    store: Store,
    summaries: Mapping[int, CalibrationRecord],
    growth: Growth,
    samples: GrowthSamples,
    stored: StoredSets,
    command: str,
) -> list[int]:
    """Store a calibration for every averaged set, unless it is stored already."""
    found = [
        _record(step, growth, samples, stored, command)
        for row in growth.steps
        for step in row
        if step.used.source == AVERAGED and not step.reason
    ]
    ids = store.add_calibrations(found, _content)
    return [number for number in dict.fromkeys(ids) if number not in summaries]


def _content(record: CalibrationRecord) -> tuple[object, ...]:
    """Content by which two averaged sets are the same."""
    method = {k: v for k, v in record.method.items() if k not in ("step", "index")}
    return (
        record.members,
        tuple(sorted(record.parameters.items())),
        tuple(sorted(method.items(), key=str)),
    )


def _record(
    step: Step, growth: Growth, samples: GrowthSamples, stored: StoredSets, command: str
) -> CalibrationRecord:
    members, point, method = step.used.members, step.used.point, stored.method
    assert point is not None  # it was averaged
    shares = weights(members, stored.singles)
    return CalibrationRecord(
        name=f"{FitKind.GROWTH}: {step.group.name}, step {step.step}, {len(members)} experiments",
        parameters=Parameters(dict(zip(method.names, point.tolist(), strict=True))),
        members=tuple(
            Member.of(samples.ids[m], share, error, method.unit)
            for m, share, error in zip(members, shares.tolist(), step.errors.tolist(), strict=True)
        ),
        provenance=Provenance(version=version("fixel"), command=command),
        method={
            "how": FitKind.GROWTH,
            "mode": "growth",
            "index": growth.index,
            "step": float(step.step),
            "weights": "inverse errors",
            "error": method.error,
            "error_unit": method.unit,
            "motion": method.motion,
            **dict(method.options),
        },
    )


# --- warnings -----------------------------------------------------------------------------------


def _changed(growth: Growth, singles: SingleCalibrations) -> list[str]:
    """Warn if errors of nominal experiments differ from the stored ones."""
    changed = []
    for row in growth.steps:
        first, errors = row[0], row[0].errors
        if not first.reason:
            stored = float(singles.errors[first.used.members[0]])
            if not math.isclose(float(errors[0]), stored, rel_tol=SAME_ERROR, abs_tol=1e-9):
                changed.append(f"{first.group.name} ({stored:.4g}, now {errors[0]:.4g})")
    if not changed:
        return []
    return [
        "Simulating nominal experiments again does not reproduce their stored errors: "
        f"{some_of(changed, 3)}. The calibrations are of another version or of other data; "
        "calibrate again."
    ]


def _beaten(
    wanted: RolloutQueue, answer: Evaluation, singles: SingleCalibrations, samples: GrowthSamples
) -> list[str]:
    """Warn of experiments with a far smaller error under a domain's set than under their own."""
    least = singles.errors.copy()
    np.minimum.at(least, wanted.which, answer.error)
    stuck = np.flatnonzero(least < STUCK * singles.errors)
    if len(stuck) == 0:
        return []
    with np.errstate(divide="ignore"):
        worst = int(stuck[(singles.errors[stuck] / least[stuck]).argmax()])
    return [
        f"{len(stuck)} of {len(least)} experiments have less than half their own best error under"
        f" a set of some domain, such as {samples.keys[worst]} ({least[worst]:.3g} for"
        f" {singles.errors[worst]:.3g}): the searches for their own sets ended early. Calibrate"
        " with --mode campaign or --starts 8."
    ]


def _empty(growth: Growth) -> list[str]:
    lacking = [(row[0].group.name, step) for row in growth.steps for step in row if step.reason]
    if not lacking:
        return []
    name, step = lacking[0]
    return [
        f"No largest error for {counted(len(lacking), 'step')}, such as {name}, step {step.step}: "
        f"{step.reason}."
    ]


def _failed(answer: Evaluation) -> list[str]:
    n = int(np.isinf(answer.error).sum())
    return [f"{n} of {len(answer.error)} simulations failed and count as above every threshold."] \
        if n else []  # fmt: skip


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


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredSets:
    """Sets of parameters of one method."""

    method: SingleMethod
    best: list[CalibratedValues]  # best set of each experiment
    # The same sets for the growth; parameters in the order of `method.names`.
    singles: SingleCalibrations
    warnings: list[str] = field(default_factory=list)


def best_singles(
    summaries: Mapping[int, CalibrationRecord],
    samples: GrowthSamples,
    motion: str = "",
    error: str = "",
    folder: Path = Path(),
) -> StoredSets:
    """Select the best stored calibration of every single experiment, all of one method.

    Only calibrations with this motion model and error are used. `folder`, that of the project, is
    for commands in hints. Raise `InvalidInput` for experiments without a calibration, or
    calibrations of several methods.
    """
    place = {number: k for k, number in enumerate(samples.ids)}
    by_method: dict[SingleMethod, dict[int, CalibratedValues]] = {}
    singles = [
        (number, record)
        for number, record in summaries.items()
        if len(record.members) == 1 and record.members[0].experiment_id in place
    ]
    if motion and singles:
        check_name("motion", motion, sorted({one.motion for _, one in singles}))
    if error and singles:
        check_name("error", error, sorted({str(one.method.get("error")) for _, one in singles}))
    for number, record in singles:
        if motion not in ("", record.motion) or error not in ("", record.method.get("error")):
            continue
        k = place[record.members[0].experiment_id]
        one = CalibratedValues(number, record)
        best = by_method.setdefault(_method(record, one.values(samples.targets[k].conditions)), {})
        # The newest of equals.
        if k not in best or not record.errors[0] > best[k].record.errors[0]:
            best[k] = one
    method, warnings = _chosen(by_method, samples, folder)
    found = [by_method[method][k] for k in range(len(samples.ids))]
    sets = [one.values(own.conditions) for one, own in zip(found, samples.targets, strict=True)]
    points = np.array([[values[name] for name in method.names] for values in sets])
    errors = np.array([one.record.errors[0] for one in found])
    return StoredSets(
        method=method,
        best=found,
        singles=SingleCalibrations(
            points=points, errors=errors, joint=_joint(summaries, method, place, samples)
        ),
        warnings=warnings,
    )


def _method(record: CalibrationRecord, names: Iterable[str]) -> SingleMethod:
    own = record.method
    return SingleMethod(
        motion=record.motion,
        error=str(own.get("error", "")),
        unit=str(own.get("error_unit", "")),
        options=tuple((k, v) for k, v in sorted(own.items()) if k.startswith("error.")),
        names=tuple(sorted(names)),
    )


def _chosen(
    by_method: dict[SingleMethod, dict[int, CalibratedValues]], samples: GrowthSamples, folder: Path
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
    by_method: dict[SingleMethod, dict[int, CalibratedValues]], samples: GrowthSamples, folder: Path
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
    expected = "the same motion model, error, unit and parameters for all"
    hint = f"calibrate all in one way: {command}"
    raise InvalidInput("calibrations", found="; ".join(parts), expected=expected, hint=hint)


def _joint(
    summaries: Mapping[int, CalibrationRecord],
    method: SingleMethod,
    place: Mapping[int, int],
    samples: GrowthSamples,
) -> dict[tuple[int, ...], tuple[int, FloatArray]]:
    """Stored joint sets of these experiments; of several, that with the least largest error, then
    the newest. Means of an exploration are recomputed: members may have better sets by now."""
    least: dict[tuple[int, ...], float] = {}
    found: dict[tuple[int, ...], tuple[int, FloatArray]] = {}
    for number, record in summaries.items():
        if len(record.members) < 2 or record.method.get("how") == FitKind.GROWTH:
            continue
        rows = [place.get(member.experiment_id, -1) for member in record.members]
        if min(rows) < 0:
            continue
        model = CalibratedValues(number, record)
        sets = [model.values(samples.targets[k].conditions) for k in rows]
        if _method(record, sets[0]) != method or any(values != sets[0] for values in sets):
            continue
        members, largest = tuple(sorted(rows)), max(record.errors)
        if not math.isfinite(largest) or largest > least.get(members, math.inf):
            continue
        least[members] = largest
        found[members] = number, np.array([sets[0][name] for name in method.names])
    return found
