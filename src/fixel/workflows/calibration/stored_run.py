"""Calibrations with a folder: journal, workers, clusters, and the same call that continues."""

from __future__ import annotations

import hashlib
import json
import shlex
import tempfile
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from fixel.errors import FixelError, Interrupted, InvalidInput
from fixel.io.damaged_files import readable
from fixel.io.journal import Journal
from fixel.jobs import folder as files
from fixel.jobs.site import Site, load_site
from fixel.jobs.work import StopRequest, run_work
from fixel.progress import ProgressOption, show_progress
from fixel.simulation.trust import remember
from fixel.workflows import jobs
from fixel.workflows.calibration.calibration import Calibration, Calibrations
from fixel.workflows.calibration.job import (
    REQUEST,
    SearchState,
    calibration_rounds,
    comparer_of,
)
from fixel.workflows.calibration.plan import (
    CalibrationPlan,
    DirectEngine,
    best_so_far,
    reporting,
)
from fixel.workflows.calibration.request import CalibrationRequest, read_targets, target_files
from fixel.workflows.calibration.result import outcome_of

if TYPE_CHECKING:
    from os import PathLike

    from fixel.database.project import Project
    from fixel.model.records import CalibrationRecord

LEFT_OUT: Final = "left_out.json"  # skipped experiments with reasons
MAKER: Final = "calibration:calibration_work"


def run_stored(
    plan: CalibrationPlan,
    folder: Path | None,
    threads: int | None = None,
    workers: int = 0,
    site: PathLike[str] | str | Site | None = None,
    progress: ProgressOption = None,
) -> Calibrations:
    """Run or continue a calibration in a folder.

    Parameters
    ----------
    plan : CalibrationPlan
    folder : Path or None
        Folder of the job; None for a temporary one.
    threads, workers, site, progress
        As for `fixel.calibrate`.
    """
    if folder is None:
        with tempfile.TemporaryDirectory(prefix="fixel-") as place:
            run = run_stored(plan, Path(place) / "job", threads, workers, site, progress)
        return replace(run, folder=None)
    prepare_folder(plan, folder)
    if jobs.status_of(folder).state != "done":
        cluster = site if isinstance(site, Site | None) else load_site(Path(site))
        number = None if cluster is not None and not workers else workers
        _run(plan, folder, threads, number, cluster, progress)
    return collect(plan, folder)


def job_folder(project: Path, plan: CalibrationPlan) -> Path:
    """Return the folder of a calibration in the folder of a project; one for each calibration."""
    digest = hashlib.sha256()
    for name, content in sorted(_inputs(plan).items()):
        digest.update(name.encode() + b"\0" + hashlib.sha256(content).digest())
    return project / jobs.JOBS / f"{plan.request.name}-{digest.hexdigest()[:10]}"


def job_of(project: Project, record: CalibrationRecord) -> Path:
    """Return the folder of the job of a calibration; that of all jobs for another folder's name.

    A record may come from elsewhere, so that its name must not lead out of the project.
    """
    name = str(record.method.get("job", ""))
    return project.folder / jobs.JOBS / ("" if name == ".." or Path(name).name != name else name)


def prepare_folder(plan: CalibrationPlan, folder: Path) -> None:
    """Make the job of a calibration in a folder, if it is not there.

    Raises
    ------
    InvalidInput
        The folder belongs to another calibration; the difference is named.
    """
    if not (folder / "job.json").is_file():
        remember(plan.request.motion)  # for the processes of the job
        jobs.prepare_job(folder, maker=MAKER, inputs=_inputs(plan))
    elif not files.made_by(folder, MAKER):
        raise InvalidInput("store", found=f"another job in {folder}", expected="a new folder")
    else:
        _check_same(plan, folder)


def _inputs(plan: CalibrationPlan) -> dict[str, bytes]:
    skipped = {LEFT_OUT: json.dumps(dict(plan.left_out)).encode()} if plan.left_out else {}
    request = {REQUEST: plan.request.model_dump_json().encode()}
    return target_files(plan.targets) | request | skipped


def _check_same(plan: CalibrationPlan, folder: Path) -> None:
    """Raise if a folder belongs to another calibration, naming the first difference."""
    before = request_of(folder)
    for name in CalibrationRequest.model_fields:
        own, other = getattr(plan.request, name), getattr(before, name)
        if own != other:
            raise InvalidInput(
                "store",
                found=f"{folder}, which belongs to a calibration with another"
                f" {ARGUMENTS.get(name, name)}: {_plain(other)}",
                expected=f"the same call again, which has {_plain(own)} now",
                hint="give this calibration a folder of its own",
            )
    own = target_files(plan.targets)
    if own != {name: (folder / "inputs" / name).read_bytes() for name in own}:
        raise InvalidInput(
            "store",
            found=f"{folder}, which belongs to a calibration of other experiments",
            expected="the same call again",
            hint="give this calibration a folder of its own",
        )


# Arguments of `calibrate` by the field of a request, where they differ.
ARGUMENTS: Final = {
    "unknowns": "parameters",
    "noise_position": "noise",
    "noise_angle": "noise",
    "mode": "function",
}


def _plain(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(
            f"{u.label} = {u.nominal:g}" if u.frozen else f"{u.label} {u.low:g} to {u.high:g}"
            for u in value
        )
    return str(getattr(value, "name", value))


def _run(
    plan: CalibrationPlan,
    folder: Path,
    threads: int | None,
    workers: int | None,
    site: Site | None,
    progress: ProgressOption,
) -> None:
    settings = jobs.arrange(folder, workers=workers, site=site)
    local = None
    if not settings.workers:
        local = DirectEngine(plan.request, comparer_of(plan.request, plan.targets, threads))
    with show_progress(progress, "searching") as report:
        try:
            jobs.run_here(folder, reporting(report), local=local)
        except KeyboardInterrupt:
            again = f"fixel jobs resume {shlex.quote(str(folder))}"
            hint = f"the same call with this store continues, or: {again}"
            raise Interrupted(_best_in(plan, folder), hint) from None


def _best_in(plan: CalibrationPlan, folder: Path) -> Calibration | None:
    """Return the best parameter set in the journal of an interrupted calibration."""
    comparer = comparer_of(plan.request, plan.targets, None)
    state = SearchState(plan.request)

    class Nothing(DirectEngine):
        """Engine that ends where the journal ends."""

        def results(self, *_: Any) -> Any:
            raise StopRequest

    with suppress(StopRequest, FixelError), Journal(folder / files.JOURNAL) as journal:
        work = calibration_rounds(plan.request, comparer, state)
        run_work(work, Nothing(plan.request, comparer), folder, journal)
    found = best_so_far(plan, comparer, state)
    return found[-1] if found else None


def collect(plan: CalibrationPlan, folder: Path) -> Calibrations:
    """Load the result of a finished job."""
    path = folder / files.RESULT
    with readable(path, f"delete that file, then: fixel jobs resume {shlex.quote(str(folder))}"):
        return plan.result(outcome_of(path.read_bytes()), folder=folder)


def plan_in(folder: Path) -> CalibrationPlan:
    """Load the plan of a calibration from the folder of its job."""
    path, left_out = folder / "inputs" / LEFT_OUT, {}
    if path.is_file():
        with readable(path, f"delete the folder {folder}"):
            left_out = {str(k): str(v) for k, v in json.loads(path.read_bytes()).items()}
    targets = read_targets(folder / "inputs")
    return CalibrationPlan(request=request_of(folder), targets=targets, left_out=left_out)


def request_of(folder: Path) -> CalibrationRequest:
    """Load the request of a calibration's job."""
    path = folder / "inputs" / REQUEST
    with readable(path, f"delete the folder {folder}"):
        return CalibrationRequest.model_validate_json(path.read_bytes())
