"""Calibrations with a folder: journal, workers, clusters, and the same call that continues."""

from __future__ import annotations

import hashlib
import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from fixel.errors import InvalidInput
from fixel.io.damaged_files import readable
from fixel.jobs import folder as files
from fixel.simulation.trust import remember
from fixel.workflows import jobs
from fixel.workflows.calibration.calibration import Calibrations
from fixel.workflows.calibration.job import (
    REQUEST,
)
from fixel.workflows.calibration.plan import (
    CalibrationPlan,
)
from fixel.workflows.calibration.request import CalibrationRequest, read_targets, target_files
from fixel.workflows.calibration.result import outcome_of

if TYPE_CHECKING:
    from fixel.database.project import Project
    from fixel.model.records import CalibrationRecord

LEFT_OUT: Final = "left_out.json"  # skipped experiments with reasons
MAKER: Final = "calibration:calibration_work"


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


def collect(plan: CalibrationPlan, folder: Path) -> Calibrations:
    """Load the result of a finished job."""
    path = folder / files.RESULT
    with readable(path, f"delete that file, then: fixel jobs resume {shlex.quote(str(folder))}"):
        return plan.result(outcome_of(path.read_bytes()), folder=folder)


def plan_in(folder: Path) -> CalibrationPlan:
    """Load the plan of a calibration from the folder of its job."""
    targets = read_targets(folder / "inputs")
    left_out = left_out_in(folder)
    return CalibrationPlan(request=request_of(folder), targets=targets, left_out=left_out)


def left_out_in(folder: Path) -> dict[str, str]:
    """Load the experiments that a calibration's job leaves out, with the reasons."""
    path = folder / "inputs" / LEFT_OUT
    if not path.is_file():
        return {}
    with readable(path, f"delete the folder {folder}"):
        return {str(k): str(v) for k, v in json.loads(path.read_bytes()).items()}


def request_of(folder: Path) -> CalibrationRequest:
    """Load the request of a calibration's job."""
    path = folder / "inputs" / REQUEST
    with readable(path, f"delete the folder {folder}"):
        return CalibrationRequest.model_validate_json(path.read_bytes())
