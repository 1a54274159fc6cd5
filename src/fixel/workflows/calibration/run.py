"""Calibrate stored experiments, and store the results in their project."""

from __future__ import annotations

import hashlib
import json
import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from fixel.calibration.objective import Comparer
from fixel.calibration.target import Target, target_of
from fixel.database.project import Project
from fixel.database.store import Store
from fixel.errors import InvalidInput
from fixel.io.atomic import written_whole
from fixel.io.damaged_files import readable
from fixel.io.lock import FileLock
from fixel.jobs import folder as files
from fixel.jobs.functions import callable_by_jobs
from fixel.jobs.site import Site
from fixel.jobs.work import JobProgress
from fixel.model import Parameters, Provenance
from fixel.model.records import CalibrationRecord, Evaluations, Member
from fixel.model.selection import ExperimentQuery
from fixel.model.space import Unknown
from fixel.workflows import jobs
from fixel.workflows.calibration.commands import command_of
from fixel.workflows.calibration.job import REQUEST
from fixel.workflows.calibration.request import CalibrationRequest, read_targets, target_files
from fixel.workflows.calibration.result import SEARCHED, CalibrationResult, ParameterSet, outcome_of
from fixel.workflows.project.filters import check_known_names

MAKER: Final = "calibration:calibration_work"
STORE_RESULT: Final = "calibration-result:store_result"  # what follows a job in the background
EXPERIMENTS: Final = "experiments.json"  # ids of the targets in the project
STORED: Final = "stored.json"  # ids of the calibrations, once they are stored
MEMBERS_A_GROUP: Final = 5  # experiments for each value of a condition that a sample is spread over
PREFLIGHT: Final = 16  # experiments simulated before any work starts, to see that they can be


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentSelection:
    """Experiments to calibrate.

    Attributes
    ----------
    ids : list of int
    targets : list of Target
    left_out : dict from key to reason
        Those that cannot be compared.
    sample_of : int, optional
        Number of experiments that these were drawn from at random; None where they are all.
    """

    ids: list[int]
    targets: list[Target]
    left_out: Mapping[str, str]
    sample_of: int | None = None

    def check_some(self, which: str, hint: str) -> None:
        """Raise `InvalidInput` if there are none."""
        if not self.targets:
            reason = next(iter(self.left_out.values()), "")
            raise InvalidInput(
                "experiments",
                found=f"none to calibrate with{f' ({reason})' if reason else ''}",
                expected=f"one at least {which}",
                hint=hint,
            )


def select_experiments(
    store: Store, keys: Sequence[str], query: ExperimentQuery
) -> ExperimentSelection:
    """Select experiments by name, or by what they have in common.

    Named ones must be fit for it, and count once under whatever names; of a listing, those that are
    not are left out with a reason.
    """
    ids = list(dict.fromkeys(store.find(key) for key in keys))
    if not ids:
        ids = [summary.id for summary in store.experiments(query).rows]
        if not ids:
            check_known_names(store, query)
    found = comparable(store, ids, strict=bool(keys))
    found.check_some("with a scene and measured poses", "see what there is: fixel list")
    return found


def comparable(store: Store, ids: Sequence[int], *, strict: bool = False) -> ExperimentSelection:
    """Select the experiments that can be compared with simulations; raise if `strict` and not."""
    targets: dict[int, Target] = {}
    left_out: dict[str, str] = {}
    for experiment_id in ids:
        experiment = store.experiment(experiment_id)
        try:
            targets[experiment_id] = target_of(experiment)
        except InvalidInput as problem:
            if strict:
                raise
            left_out[experiment.key] = str(problem)
    return ExperimentSelection(ids=list(targets), targets=list(targets.values()), left_out=left_out)


def draw_sample(chosen: ExperimentSelection, count: int, seed: int) -> ExperimentSelection:
    """A random part of the chosen experiments, in which every condition keeps its share.

    Parameters
    ----------
    chosen : ExperimentSelection
    count : int
        Experiments wanted; all are kept where there are no more.
    seed : int
        Seed of the draw.
    """
    n = len(chosen.ids)
    if count >= n:
        return chosen
    groups: dict[tuple[tuple[str, str], ...], list[int]] = {}
    kinds = _grouping([target.conditions for target in chosen.targets])
    for k, target in enumerate(chosen.targets):
        key = tuple((name, str(target.conditions.get(name, ""))) for name in kinds)
        groups.setdefault(key, []).append(k)
    draw = np.random.default_rng(seed)
    # Shuffled within each group, then taken at even distances along all groups one after another:
    # each gives its share, to one experiment.
    order = [k for key in sorted(groups) for k in draw.permutation(groups[key]).tolist()]
    first = draw.random()
    places = ((first + np.arange(count)) * n / count).astype(int)
    kept = sorted(order[place] for place in places.tolist())
    return ExperimentSelection(
        ids=[chosen.ids[k] for k in kept],
        targets=[chosen.targets[k] for k in kept],
        left_out=chosen.left_out,
        sample_of=n,
    )


def _grouping(conditions: Sequence[Mapping[str, str | float]]) -> list[str]:
    """Conditions that sort experiments into groups, not those that number them."""
    names = sorted({name for own in conditions for name in own})
    most = max(1, len(conditions) // MEMBERS_A_GROUP)
    return [
        name for name in names if 1 < len({str(own.get(name, "")) for own in conditions}) <= most
    ]


def stored_points(store: Store, request: CalibrationRequest) -> list[list[float]]:
    """Values of the free unknowns in all stored calibrations that have them, each set once."""
    labels = request.space.labels
    points: dict[tuple[float, ...], None] = {}
    for calibration_id in store.calibrations():
        parameters = store.calibration(calibration_id).parameters
        if all(label in parameters for label in labels):
            points[tuple(parameters[label] for label in labels)] = None
    return [list(point) for point in points]


def prepare(project: Project, chosen: ExperimentSelection, request: CalibrationRequest) -> Path:
    """The job folder of a calibration; the same one for the same request on the same experiments.

    Raises
    ------
    InvalidInput
        The request and the experiments do not fit.
    """
    request.check()
    _rehearse(chosen.targets, request)
    inputs = target_files(chosen.targets) | {REQUEST: request.model_dump_json().encode()}
    inputs[EXPERIMENTS] = json.dumps(chosen.ids).encode()
    digest = hashlib.sha256()
    for name in sorted(inputs):
        digest.update(name.encode() + b"\0" + hashlib.sha256(inputs[name]).digest())
    folder = project.folder / jobs.JOBS / f"{request.name}-{digest.hexdigest()[:10]}"
    if not (folder / "job.json").is_file():
        jobs.prepare_job(folder, maker=MAKER, inputs=inputs)
    return folder


def _rehearse(targets: Sequence[Target], request: CalibrationRequest) -> None:
    """Simulate a few experiments, so that what cannot be is refused now and not hours in."""
    spread = np.unique(np.linspace(0, len(targets) - 1, PREFLIGHT).astype(int))
    few = [targets[k] for k in spread.tolist()]
    comparer = Comparer(targets, request.space, request.made_error, request.made_motion)
    start = np.repeat(request.space.nominal[None], len(few), axis=0)
    answer = comparer.errors(spread, start)
    if np.isinf(answer.error).all():
        raise InvalidInput(
            "start of the search",
            found=f"no simulation at it: {answer.reasons[0]}",
            expected="parameters with which an experiment can be simulated",
            hint="start elsewhere: --fit NAME=LOW:HIGH:START",
        )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """A finished calibration.

    Attributes
    ----------
    folder : Path
        Of its job.
    request : CalibrationRequest
    outcome : CalibrationResult
    ids : list of int
        Of the stored calibrations, one a set of parameters found.
    left_out : mapping from key to reason
    command : str
        What was typed.
    """

    folder: Path
    request: CalibrationRequest
    outcome: CalibrationResult
    ids: list[int]
    left_out: Mapping[str, str]
    command: str = ""

    @property
    def targets(self) -> list[Target]:
        """The experiments it used."""
        return read_targets(self.folder / "inputs")

    def summary(self) -> dict[str, Any]:
        """Plain values, for `--json`; infinite errors become none."""
        outcome = self.outcome
        return {
            "name": self.request.name,
            "mode": self.request.mode,
            "job": str(self.folder),
            "experiments": list(outcome.keys),
            "left_out": dict(self.left_out),
            "sample_of": self.request.sample_of,
            "error": self.request.error.name,
            "unit": self.request.made_error.unit,
            "nominal_error": [_finite(error) for error in outcome.nominal.tolist()],
            "found": [
                _found(one, number, outcome)
                for one, number in zip(outcome.found, self.ids, strict=True)
            ],
        }


def _found(one: ParameterSet, calibration_id: int, outcome: CalibrationResult) -> dict[str, Any]:
    return {
        "calibration": calibration_id,
        "how": one.how,
        "experiments": [outcome.keys[m] for m in one.members],
        "misfit": list(one.misfit),
        "misfit_ratio": _finite(one.misfit_ratio),
        "parameters": dict(zip(outcome.labels, one.values(outcome.labels).tolist(), strict=True)),
        "best_fit": dict(zip(outcome.labels, one.point.tolist(), strict=True)),
        "errors": [_finite(error) for error in one.errors.tolist()],
        "evaluations": 0 if one.trace is None else len(one.trace.errors),
        "ended": "" if one.trace is None else one.trace.ended,
        "seconds": one.seconds,
        "note": one.note,
        "noise": one.noise,
        "solutions": [dict(zip(outcome.labels, s, strict=True)) for s in one.solutions.tolist()],
        "estimates": [estimate.stored() for estimate in one.estimates],
    }


def _finite(error: float) -> float | None:
    return error if math.isfinite(error) else None


def run(
    folder: Path,
    *,
    workers: int | None = None,
    site: Site | None = None,
    progress: Callable[[JobProgress], None] | None = None,
    notify: Callable[[str], None] | None = None,
) -> None:
    """Run or continue the job of a calibration; nothing to do where it is done."""
    if jobs.status_of(folder).state == "done":
        return
    jobs.arrange(folder, workers=workers, site=site)
    jobs.run_here(folder, progress, notify)


def collect(
    project: Project, folder: Path, command: str, left_out: Mapping[str, str]
) -> Calibration:
    """Store what a job found in its project, once, and give it back."""
    request = request_of(folder)
    path = folder / files.RESULT
    with readable(path, f"delete that file, then: fixel jobs resume {shlex.quote(str(folder))}"):
        outcome = outcome_of(path.read_bytes())
    ids = _stored(project, folder, request, outcome, command)
    return Calibration(
        folder=folder,
        request=request,
        outcome=outcome,
        ids=ids,
        left_out=left_out,
        command=command,
    )


def collected(project: Project, folder: Path) -> list[int]:
    """Return the ids of the stored calibrations of a finished job; store them if necessary.

    Raises
    ------
    JobRefused
        Another process is storing them.
    """
    request, ids = request_of(folder), experiments_of(folder)
    command = command_of(project.folder.resolve(), request, [str(number) for number in ids])
    return collect(project, folder, command, {}).ids


@callable_by_jobs
def store_result(folder: Path) -> None:
    """Store the result of a finished job in the project that contains its folder.

    The process may be killed at any moment: the next one that inspects the job does the rest.
    """
    collected(Project.open(folder.resolve().parents[1]), folder)


def reopened(project: Project, record: CalibrationRecord) -> Calibration | None:
    """The calibration that a stored set of parameters came from; none where its job is gone."""
    folder = project.folder / jobs.JOBS / str(record.method.get("job", ""))
    if not ((folder / files.RESULT).is_file() and (folder / STORED).is_file()):
        return None
    return collect(project, folder, record.provenance.command, {})


def request_of(folder: Path) -> CalibrationRequest:
    """Load the request of a calibration's job."""
    path = folder / "inputs" / REQUEST
    with readable(path, f"delete the folder {folder}"):
        return CalibrationRequest.model_validate_json(path.read_bytes())


def experiments_of(folder: Path) -> list[int]:
    """Ids of the experiments of a calibration's job."""
    path = folder / "inputs" / EXPERIMENTS
    with readable(path, f"delete the folder {folder}"):
        return [int(number) for number in json.loads(path.read_text())]


def stored_ids(folder: Path) -> list[int]:
    """Load the ids of the calibrations that a job has stored so far."""
    path = folder / STORED
    if not path.is_file():
        return []
    with readable(path):
        return [int(number) for number in json.loads(path.read_text())]


def _stored(
    project: Project,
    folder: Path,
    request: CalibrationRequest,
    outcome: CalibrationResult,
    command: str,
) -> list[int]:
    path = folder / STORED
    experiments = experiments_of(folder)
    known = stored_ids(folder)
    if len(known) == len(outcome.found):
        return known
    # A page and a command may see the end of a job at the same moment.
    with FileLock(folder / f"{STORED}.lock", f"the result of {folder}"), project.store() as store:
        known = stored_ids(folder)
        # One after the other, each noted at once: a crash between costs one doubled record at most.
        for one in outcome.found[len(known) :]:
            known.append(
                store.add_calibration(_record(folder, request, outcome, one, experiments, command))
            )
            with written_whole(path) as temporary:
                temporary.write_text(json.dumps(known))
    return known


def _record(
    folder: Path,
    request: CalibrationRequest,
    outcome: CalibrationResult,
    one: ParameterSet,
    experiments: Sequence[int],
    command: str,
) -> CalibrationRecord:
    keys = [outcome.keys[m] for m in one.members]
    title = keys[0] if len(keys) == 1 else f"{len(keys)} experiments"
    unit = request.made_error.unit.replace("^", "")
    evaluations = None
    if one.trace is not None:
        evaluations = Evaluations(
            names=outcome.labels,
            values=one.trace.points,
            error=one.trace.errors,
            reasons=tuple(one.trace.reasons),
            unit=unit,
        )
    return CalibrationRecord(
        name=f"{request.name}: {title}, {one.how}",
        parameters=_parameters(request, one),
        members=tuple(
            Member.of(experiments[m], 1.0, error, request.made_error.unit)
            for m, error in zip(one.members, one.errors.tolist(), strict=True)
        ),
        provenance=Provenance(version=version("fixel"), command=command, seed=request.seed),
        method=_method(folder, request, outcome, one),
        evaluations=evaluations,
        estimates=one.estimates,
    )


def _parameters(request: CalibrationRequest, one: ParameterSet) -> Parameters:
    """Return the parameters that all members share; the others are among the estimates."""
    values = request.space.values(one.point)
    return Parameters({u.name: values[u.label] for u in request.space.unknowns if not u.where})


def _without_defaults(unknown: Unknown) -> dict[str, Any]:
    usual: dict[str, Any] = {"frozen": False, "prior": None, "where": {}}
    return {k: v for k, v in unknown.plain().items() if k not in usual or v != usual[k]}


def _method(
    folder: Path, request: CalibrationRequest, outcome: CalibrationResult, one: ParameterSet
) -> dict[str, str | float]:
    nominal = outcome.nominal[list(one.members)]
    options = {f"optimiser.{k}": v for k, v in request.optimiser.options.items()}
    options |= {f"error.{k}": v for k, v in request.error.options.items()}
    return {
        "how": one.how,
        "mode": request.mode,
        **({} if request.sample_of is None else {"sample_of": float(request.sample_of)}),
        **({} if request.budget is None else {"budget_s": request.budget}),
        "error": request.error.name,
        "error_unit": request.made_error.unit,
        "motion": request.motion,
        "optimiser": request.optimiser.name,
        "starts": float(request.starts),
        "combine": request.combine,
        "job": folder.name,
        SEARCHED: json.dumps([_without_defaults(unknown) for unknown in request.unknowns]),
        "seconds": one.seconds,
        "nominal_error": float(nominal.mean()),
        "ended": "" if one.trace is None else one.trace.ended,
        **({"misfit": "\n".join(one.misfit)} if one.misfit else {}),
        **({"misfit_ratio": one.misfit_ratio} if math.isfinite(one.misfit_ratio) else {}),
        **{k: v if isinstance(v, str | float | int) else str(v) for k, v in options.items()},
    }
