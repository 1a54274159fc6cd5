"""Run a capability: compute, report and store, for every door and for jobs."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping
from dataclasses import replace
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from fixel.capability.capability import Capability
from fixel.capability.options import TABLE
from fixel.errors import InvalidInput, JobRefused, check_name, no_experiments
from fixel.io.atomic import readable
from fixel.jobs.functions import callable_by_jobs, stamp
from fixel.workflows.calibration.run import CALIBRATE
from fixel.workflows.compare import COMPARE
from fixel.workflows.domain.run import DOMAIN
from fixel.workflows.error_bound import ERROR_BOUND
from fixel.workflows.filtering.run import FILTER
from fixel.workflows.growth.run import GROWTH
from fixel.workflows.next_pushes.run import NEXT
from fixel.workflows.planning.run import PLAN
from fixel.workflows.sampling import SAMPLE
from fixel.workflows.sensitivity.run import SENSITIVITY
from fixel.workflows.simulation import SIMULATE
from fixel.workflows.table_check import TABLE_CHECK
from fixel.workflows.table_map import TABLE_MAP, TableView
from fixel.workflows.uncertainty.run import UNCERTAINTY

if TYPE_CHECKING:
    from pydantic import BaseModel

    from fixel.database.project import Project
    from fixel.domain.domain import DomainMap
    from fixel.jobs.work import Work
    from fixel.progress import ProgressOption
    from fixel.workflows.analysis import Analysis, StoredAnswer

CAPABILITIES: Final[Mapping[str, Capability]] = {
    one.name: one
    for one in (
        CALIBRATE, COMPARE, DOMAIN, ERROR_BOUND, FILTER, GROWTH, NEXT,
        PLAN, SAMPLE, SENSITIVITY, SIMULATE, TABLE_CHECK, TABLE_MAP, UNCERTAINTY,
    )
}  # fmt: skip
MAKER: Final = "capability:run_request"
MAP: Final = "table.map"  # input of a job whose experiments are on a mapped table


def run(
    capability: Capability,
    request: BaseModel,
    folder: Path = Path(),
    *,
    plot: Path | None = None,
    progress: ProgressOption = None,
) -> StoredAnswer:
    """Run a request on the project in a folder, and store its analysis with the whole request.

    `plot` is a folder or file for figures. What the function refuses, and a program that the user
    has not permitted, raises `InvalidInput`.
    """
    from fixel.trust import check_named

    check_named(*capability.programs(request))
    begun = time.monotonic()
    place = project_for(capability, request, folder)
    project: Any = place[0] if place else None
    result = capability.function(*place, **capability.arguments(request), progress=progress)
    return report_result(capability, request, project, result, time.monotonic() - begun, plot)


def project_for(
    capability: Capability, request: BaseModel, folder: Path
) -> tuple[()] | tuple[Project | Path | None]:
    """Return the first arguments of a function: the project in a folder, or the folder, or none.

    The project is None in a folder without one, for a request that needs none.
    """
    if not capability.on_project:
        return ()
    from fixel.database.project import SETTINGS, Project

    if signature(capability.function).parameters["project"].annotation in (Path, "Path"):
        return (folder,)
    needed = capability.needs_project or folder != Path() or (folder / SETTINGS).is_file()
    if capability.in_project is not None:
        needed = capability.in_project(request)
    needed = needed or (capability.on_table and getattr(request, TABLE.name) is not None)
    return (_on_table(Project(folder), capability, request) if needed else None,)


def call(project: Project, name: str, /, *, progress: ProgressOption = None, **options: Any) -> Any:
    """Run a capability on a project for Python, which may name a program, and return its result.

    The options are arguments of its function, as plain values.
    """
    from fixel.trust import permit

    capability = CAPABILITIES[name]
    request = capability.request(options)
    permit(*capability.programs(request))
    begun, place = time.monotonic(), _on_table(project, capability, request)
    result = capability.function(place, **capability.arguments(request), progress=progress)
    return report_result(capability, request, place, result, time.monotonic() - begun).result


def _on_table(
    project: Project, capability: Capability, request: BaseModel, copy: Path | None = None
) -> Project:
    """Return the project with its experiments on the table whose map, or copy, a request names."""
    path = getattr(request, TABLE.name) if capability.on_table else None
    return project if path is None else project.seen_through(TableView.of(path, copy))


def _table_warnings(project: Project, analysis: Analysis) -> list[str]:
    """Return what a reader must know about the table under the experiments."""
    if isinstance(project.view, TableView):
        return project.view.warnings(project, analysis.experiments)
    if analysis.kind == CALIBRATE.name:
        return []
    with project.store() as store:
        results = {k: store.calibration(k).result or {} for k in analysis.calibrations}
    why = "was made with the map of a table, and this result is without it"
    return [f"calibration {k} {why}" for k, own in results.items() if "load_maps" in own]


def report_result(
    capability: Capability,
    request: BaseModel,
    project: Project | None,
    result: Any,
    seconds: float,
    plot: Path | None = None,
    keep: bool = False,
) -> StoredAnswer:
    """Report a result; store the report to `keep` it, or unless the request states otherwise.

    The call took `seconds`, unless the report has another time. `plot` is a folder or file for
    figures.
    """
    from fixel.workflows.analysis import StoredAnswer, store_analysis, write_pictures

    present = capability.present
    report = present.report_of(result)
    view = None if project is None else project.view
    warnings = [] if project is None else _table_warnings(project, report.analysis)
    question = capability.question(request) | report.analysis.question
    if "calibration" in question:  # the newest, where the request names none
        question["calibration"] = next(iter(report.analysis.calibrations), None)
    analysis = report.analysis.model_copy(
        update={
            "kind": capability.name,
            "question": question | ({"table_sha256": view.sha256} if view else {}),
            "warnings": (*report.analysis.warnings, *warnings),
            "request": request.model_dump(mode="json"),
            "command": capability.command(request, project.folder if project else Path()),
            "seed": getattr(request, "seed", None),
            "seconds": report.analysis.seconds or seconds,
        }
    )
    kept = None
    if project and capability.inputs is None and (keep or getattr(request, "save", True)):
        kept = store_analysis(project, analysis, report.pictures, report.arrays)
        analysis = kept.analysis
        if hasattr(present, "add_files"):
            present.add_files(result, kept.folder)
    files = {**capability.files(request), **report.files}
    if plot is not None and capability.plot == "file":
        present.draw(result, plot)
        files["plot"] = plot
    elif plot is not None:
        paths = kept.copy_pictures(plot) if kept else write_pictures(plot, report.pictures)
        files |= {path.name: path for path in paths}
    return StoredAnswer(
        capability=capability,
        request=request,
        result=result,
        analysis=analysis,
        folder=None if kept is None else kept.folder,
        files=files,
        drawn=plot is not None,
        failed=bool(getattr(present, "failed", lambda _: False)(result)),
    )


def store_map(project: Project, domain: DomainMap) -> StoredAnswer:
    """Store a map of experiments that a project has; raise `NotStored` if it lacks one of them."""
    from fixel.workflows.domain.evidence import store_evidence
    from fixel.workflows.domain.mapping import DomainAnswer, claimed

    asked = claimed(DOMAIN.request(domain.question), domain.claimed)
    gathered = store_evidence(project, domain.source, asked)
    number = dict(zip(gathered.errors.keys, gathered.errors.ids, strict=True))
    evidence = domain.evidence
    own = replace(domain, evidence=replace(evidence, ids=tuple(number[k] for k in evidence.keys)))
    answer = DomainAnswer(asked, gathered, own, len(number) - len(evidence))
    return report_result(DOMAIN, asked, project, answer, 0.0)


# --- jobs -----------------------------------------------------------------------------------------


def request_of(inputs: Path) -> tuple[Capability, BaseModel, Project | None]:
    """Return the capability, request and project of a job, if the files to read are unchanged.

    There is no project if the inputs are all that the job needs.
    """
    from fixel.database.project import SETTINGS, Project
    from fixel.jobs.folder import read_job

    options = read_job(inputs.parent).options
    with readable(inputs.parent / "job.json"):
        capability = CAPABILITIES[options["capability"]]
        request = capability.from_json(json.dumps(options["request"]))
    for path, _ in options.get("reads", {}).items() - capability.reads(request).items():
        hint = "restore it, or prepare another job"
        raise JobRefused(f"{path} has changed since the job was prepared", hint=hint)
    place = inputs.resolve().parents[2]
    if capability.inputs is not None and not (place / SETTINGS).is_file():
        return capability, request, None
    project = _on_table(Project(place), capability, request, inputs / MAP)
    return capability, request, project


def _check_files(capability: Capability, request: BaseModel, project: Project | None) -> None:
    """Raise for a file that a job would write outside its project: its folder may be foreign."""
    for name, path in capability.files(request).items():
        if project is None or not path.resolve().is_relative_to(project.folder.resolve()):
            expected = "a file in the folder of the project, or this command without a job"
            raise InvalidInput(name, found=str(path), expected=expected)


def _check_selection(capability: Capability, request: BaseModel, project: Project) -> None:
    """Raise for a filter that selects no experiment, or a condition that no experiment has."""
    own: Any = request
    dataset, flagged = getattr(own, "dataset", ""), getattr(own, "flagged", False)
    filters = (*getattr(own, "where", ()), *([f'"dataset:{dataset}"'] if dataset else []))
    if filters and not project.experiments(*filters, flagged=flagged, limit=1):
        raise no_experiments()
    for name, option in capability.options.items():
        if option.door.condition and getattr(own, name):
            with project.store() as store:
                check_name(name, getattr(own, name), sorted(store.conditions()))


@callable_by_jobs
def run_request(inputs: Path, options: Mapping[str, Any]) -> Work:
    """Run the request of a job and store its analysis; the result is the name of its folder.

    A capability with `inputs` stores records of its own, and the result are the bytes of them.
    A capability with `rounds` yields them; another one computes in the coordinator's process, and
    repeats what it has not stored itself when the job is resumed.
    """
    from fixel.jobs.work import report_stage
    from fixel.trust import check_named

    capability, request, project = request_of(inputs)
    check_named(*capability.programs(request))
    _check_files(capability, request, project)
    begun, arguments = time.monotonic(), capability.arguments(request)
    if capability.rounds is None:
        yield from ()
        result = capability.function(project, **arguments, progress=report_stage)
    else:
        result = yield from capability.rounds(
            project, **arguments, inputs=inputs, progress=report_stage
        )
    if isinstance(result, bytes):
        return result
    seconds = time.monotonic() - begun
    folder = report_result(capability, request, project, result, seconds, keep=True).folder
    assert folder is not None
    return folder.name.encode()


def prepare(
    capability: Capability,
    request: BaseModel,
    project: Project,
    inputs: Mapping[str, bytes] | None = None,
) -> Path:
    """Prepare the job of a request in a project, to be run as it states; return its folder.

    The same request on the same records and files, or with the same `inputs` of a capability that
    has them, has the same folder with this version of fixel, so that it continues. Run it with
    `jobs.run_here`, `jobs.run_detached` or `fixel jobs submit`. Raise `InvalidInput` if the
    capability does not work on a project, or what it settles is invalid.
    """
    from fixel.jobs.site import load_site
    from fixel.simulation.motion import motion_model
    from fixel.workflows import jobs

    if not capability.on_project:
        raise InvalidInput("job", found=capability.name, expected="a capability on a project")
    project = _on_table(project, capability, request)
    _check_files(capability, request, project)
    if capability.settled is not None:
        request = capability.settled(project, request)
    table, of = project.view, list[Any]()
    if capability.inputs is not None:
        inputs = capability.inputs(project, request) if inputs is None else inputs
        of = [[name, hashlib.sha256(data).hexdigest()] for name, data in sorted(inputs.items())]
    else:
        # Its processes may work in another folder.
        paths = {k: x.resolve() for k, x in request if isinstance(x, Path) and k != TABLE.name}
        request = request.model_copy(update=paths)
        # A job would fail without its engine or records.
        for name in capability.programs(request):
            motion_model(name)
        own = [getattr(request, "experiment", ""), *getattr(request, "experiments", ())]
        with project.store() as store:
            for key in filter(None, own):
                store.find(key)
            if (number := getattr(request, "calibration", None)) is not None:
                store.calibration(number)
            of = [request.model_dump(mode="json"), store.record_ids(), capability.reads(request)]
        _check_selection(capability, request, project)
    of += [stamp(), table and table.sha256]
    digest = hashlib.sha256(json.dumps(of, sort_keys=True).encode()).hexdigest()
    name = getattr(request, "name", capability.name)
    folder = project.folder / jobs.JOBS / f"{name}-{digest[:10]}"
    files: dict[str, bytes | Path] = dict(inputs or {})
    if table is not None:
        files[MAP] = table.path
    prepare_in(folder, capability, request, files)
    count, site = (getattr(request, option, None) for option in ("workers", "site"))
    jobs.arrange(folder, workers=count or None, site=site and load_site(site))
    return folder


def prepare_in(
    folder: Path, capability: Capability, request: BaseModel, inputs: Mapping[str, bytes | Path]
) -> None:
    """Prepare the job of a request in a folder, if it is not there."""
    from fixel.trust import remember
    from fixel.workflows import jobs

    if not (folder / "job.json").is_file():
        for name in capability.programs(request):
            remember(name)  # for the processes of the job, if the user has named it
        options = {"capability": capability.name, "request": request.model_dump(mode="json")}
        options["reads"] = {} if capability.inputs else capability.reads(request)
        try:
            jobs.prepare_job(folder, maker=MAKER, inputs=inputs, options=options)
        except (InvalidInput, JobRefused):
            if not (folder / "job.json").is_file():  # else another process has prepared it
                raise


def begin(capability: Capability, request: BaseModel, project: Project) -> Path:
    """Start the job of a request in its own process, which outlives this one; return its folder."""
    from fixel.workflows import jobs

    folder = prepare(capability, request, project)
    if capability.inputs is None or jobs.status_of(folder).state != "done":
        jobs.run_detached(folder)
    return folder
