"""Plans of calibrations, and the folders of their jobs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np

from fixel.calibration.target import Target, targets_of
from fixel.calibration.usual_parameters import Space, search_space
from fixel.errors import InvalidInput
from fixel.io.damaged_files import readable
from fixel.jobs import folder as files
from fixel.kernels import codes
from fixel.model import Experiment, Scene
from fixel.registry import offered
from fixel.simulation.motion import stated_name
from fixel.simulation.trust import remember
from fixel.workflows import jobs
from fixel.workflows.calibration.job import REQUEST, comparer_of, explained
from fixel.workflows.calibration.request import (
    NAMED,
    CalibrationRequest,
    named_options,
    read_targets,
    target_files,
)

if TYPE_CHECKING:
    from fixel.database.project import Project
    from fixel.model.records import CalibrationRecord

LEFT_OUT: Final = "left_out.json"  # skipped experiments with reasons
MAKER: Final = "calibration:calibration_work"
PREFLIGHT: Final = 16  # experiments that are simulated before any work starts
JAMMED: Final = codes.STATUS_NAMES[codes.JAMMED]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class CalibrationPlan:
    """Calibration that has not been run yet: its request and its experiments.

    Parameters
    ----------
    request : CalibrationRequest
        Parameters and method.
    targets : sequence of Target
        Scenes and measured poses of the experiments.
    source : str
        Python expression of the experiments.
    asked : mapping
        Options of the command or page, as plain content; empty for other calls.
    left_out : mapping from name to reason
        Experiments that were skipped.
    """

    request: CalibrationRequest
    targets: Sequence[Target]
    source: str = "experiments"
    asked: Mapping[str, Any] = field(default_factory=dict, compare=False)
    left_out: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        mode: str,
        experiments: Iterable[Experiment | Target],
        parameters: Space,
        asked: SimpleNamespace,
    ) -> Self:
        """Return the plan for arguments of `calibrate`, checked and rehearsed."""
        capability, given = offered("capability", "calibrate"), vars(asked)
        known = capability.options.items()
        capability.request({k: given[k] for k, own in known if k in given and not own.door.plain})
        targets = targets_of(experiments)
        space = search_space(parameters, targets, asked.start)
        own = {name: given[name] for name in CalibrationRequest.model_fields if name in given}
        own |= {name: named_options(given[name], name) for name in NAMED}
        own |= {
            "mode": mode,
            "unknowns": list(space.unknowns),
            "motion": stated_name(asked.motion),
            "sample_of": getattr(experiments, "sample_of", None),
        }
        if asked.noise is not None:
            own["noise_position"] = asked.noise.position_m
            own["noise_angle"] = asked.noise.angle_rad
        request = CalibrationRequest(**own).with_usual_search(targets)
        request.check()
        plan = cls(
            request=request,
            targets=targets,
            source=str(getattr(experiments, "call", "experiments")),
            left_out=getattr(experiments, "left_out", {}),
        )
        return plan.rehearse(asked.threads)

    def rehearse(self, threads: int | None = None) -> Self:
        """Simulate a few experiments, and all that may jam, with the start values.

        The plan that is returned lacks the experiments whose rigid drive jams, which would make the
        error of one set of parameters for all infinite; they are named in `left_out`. An error is
        raised if nothing can be simulated.
        """
        n = len(self.targets)
        rigid = [k for k, target in enumerate(self.targets) if may_jam(target.case.scene)]
        spread = np.linspace(0, n - 1, PREFLIGHT).astype(int)
        some = np.unique(np.concatenate((spread, np.array(rigid, np.int64))))
        start = np.repeat(self.request.space.nominal[None], len(some), axis=0)
        answer = comparer_of(self.request, self.targets, threads).errors(some, start)
        found = zip(some.tolist(), answer.reasons, strict=True)
        jammed = {k: explained(reason) for k, reason in found if reason.startswith(JAMMED)}
        if np.isinf(answer.error).all():
            key, reason = self.targets[int(some[0])].key, explained(answer.reasons[0])
            raise InvalidInput(
                "start",
                found=f"values with which nothing can be simulated: {key}: {reason}",
                expected="values with which an experiment can be simulated",
                hint="" if jammed else "choose another start or other bounds",
            )
        if not jammed or self.request.mode == "each":
            return self
        return replace(
            self,
            targets=[target for k, target in enumerate(self.targets) if k not in jammed],
            left_out={**self.left_out, **{self.targets[k].key: why for k, why in jammed.items()}},
        )


def may_jam(scene: Scene) -> bool:
    """Whether a rigid drive could push a body against fixels."""
    return bool(scene.fixels) and any(p.drive.force_limit is None for p in scene.pushers)


# --- folders of jobs ----------------------------------------------------------------------------


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

    If the folder belongs to another calibration, the error names the difference.
    """
    if not (folder / "job.json").is_file():
        remember(plan.request.motion)  # for the processes of the job
        jobs.prepare_job(folder, maker=MAKER, inputs=_inputs(plan))
    else:
        _check_same(plan, folder)


def _inputs(plan: CalibrationPlan) -> dict[str, bytes]:
    skipped = {LEFT_OUT: json.dumps(dict(plan.left_out)).encode()} if plan.left_out else {}
    request = {REQUEST: plan.request.model_dump_json().encode()}
    return target_files(plan.targets) | request | skipped


def _check_same(plan: CalibrationPlan, folder: Path) -> None:
    """Raise if a folder belongs to another calibration, naming the first difference."""
    found, now = "another job", ""
    if files.made_by(folder, MAKER):
        own, before, files_of = plan.request, request_of(folder), target_files(plan.targets)
        fields = CalibrationRequest.model_fields
        name = next((k for k in fields if getattr(own, k) != getattr(before, k)), "")
        if name:
            word = {"unknowns": "parameters", "mode": "function"}.get(name, name.replace("_", " "))
            found = f"a calibration with another {word}: {_plain(getattr(before, name))}"
            now = f", which has {_plain(getattr(own, name))} now"
        elif files_of != {k: (folder / "inputs" / k).read_bytes() for k in files_of}:
            found = "a calibration of other experiments"
        else:
            return
    raise InvalidInput(
        "store",
        found=f"{folder}, which belongs to {found}",
        expected=f"the same call again{now}",
        hint="give this calibration a folder of its own",
    )


def _plain(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(
            f"{u.label} = {u.nominal:g}" if u.frozen else f"{u.label} {u.low:g} to {u.high:g}"
            for u in value
        )
    return str(getattr(value, "name", value))


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
