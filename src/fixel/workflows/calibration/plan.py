"""Plans of calibrations, and their jobs: folders and rounds of chunks."""

from __future__ import annotations

import functools
import json
import time
from collections.abc import Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final, Self

import numpy as np

from fixel.calibration import search
from fixel.calibration.honest import draw_joint, linear_fit
from fixel.calibration.noise import check_noise
from fixel.calibration.objective import Comparer
from fixel.calibration.result import CalibrationResult, found_arrays, found_of, json_array, json_of
from fixel.calibration.search import CalibrationTask, PartAnswer, Question, Rows, Steps, explained
from fixel.calibration.study import relayed
from fixel.calibration.target import Target, targets_of
from fixel.calibration.usual_parameters import Space, search_space
from fixel.errors import InvalidInput
from fixel.io.array_bytes import arrays_of, bytes_of
from fixel.io.atomic import readable
from fixel.jobs import folder as files
from fixel.jobs.functions import callable_by_jobs, threads
from fixel.jobs.work import Answers, Chunk, Failure, Round, Work
from fixel.kernels import codes
from fixel.model import Experiment, Scene
from fixel.registry import offered
from fixel.simulation.motion import stated_name
from fixel.uncertainty.predictive import DRAWS, LEAST, check_predictions, predictive_of
from fixel.workflows import jobs
from fixel.workflows.calibration.request import (
    NAMED,
    CalibrationRequest,
    named_options,
    read_targets,
    target_files,
)

REQUEST: Final = "request.json"
ABOUT: Final = "about.json"  # fields of the plan that no result depends on
STORE: Final = "store"  # argument of calls, in errors
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
        check_noise(asked.noise)
        if asked.noise is not None:
            own |= {"noise_position": asked.noise.position_m, "noise_angle": asked.noise.angle_rad}
        request = CalibrationRequest(**own).with_usual_search(targets)
        request.check()
        plan = cls(
            request=request,
            targets=targets,
            source=str(getattr(experiments, "call", "experiments")),
            left_out=getattr(experiments, "left_out", {}),
        )
        return plan.rehearse(asked.threads)

    def task(self, threads: int | None = None) -> CalibrationTask:
        """Return the experiments and the method, as what calibrates takes them."""
        request = self.request
        space, error, motion = request.space, request.made_error, request.made_motion
        comparer = Comparer(self.targets, space, error, motion, None, threads)
        own: dict[str, Any] = {"comparer": comparer, "optimiser": request.made_search}
        names = {field.name for field in fields(CalibrationTask)} - {*own}
        return CalibrationTask(**own, **{name: getattr(request, name) for name in names})

    @property
    def inputs(self) -> dict[str, bytes]:
        """Files of its job, by name."""
        about = {"source": self.source, "left_out": dict(self.left_out)}
        own = {REQUEST: self.request.model_dump_json(), ABOUT: json.dumps(about)}
        return target_files(self.targets) | {name: text.encode() for name, text in own.items()}

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
        answer = self.task(threads).comparer.errors(some, start)
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


def check_same(plan: CalibrationPlan, folder: Path) -> None:
    """Raise if a folder has a job of another calibration, naming the first difference."""
    if not (folder / "job.json").is_file():
        return
    if jobs.capability_of(folder) != "calibrate":
        raise other_call(folder, "another job, or one of an earlier version")
    before = plan_in(folder)
    for name in CalibrationRequest.model_fields:
        old, now = (getattr(own.request, name) for own in (before, plan))
        if old != now:
            word = {"unknowns": "parameters", "mode": "function"}.get(name, name.replace("_", " "))
            found = f"a call with another {word}: {_plain(old)}"
            raise other_call(folder, found, f", which has {_plain(now)} now")
    if target_files(before.targets) != target_files(plan.targets):
        raise other_call(folder, "a call with other experiments")


def other_call(folder: Path, found: str, now: str = "") -> InvalidInput:
    """Return the error for a folder of finished results that belongs to another call."""
    return InvalidInput(
        STORE,
        found=f"{folder}, which belongs to {found}",
        expected=f"the same call again{now}",
        hint="give this call a folder of its own",
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
    inputs = folder / "inputs"
    with readable(inputs, f"delete the folder {folder}"):
        about = json.loads((inputs / ABOUT).read_bytes())
        return CalibrationPlan(
            request=CalibrationRequest.model_validate_json((inputs / REQUEST).read_bytes()),
            targets=read_targets(inputs),
            source=str(about["source"]),
            asked=dict(files.read_job(folder).options["request"]),
            left_out={str(key): str(reason) for key, reason in about["left_out"].items()},
        )


# --- rounds of chunks ---------------------------------------------------------------------------


def rounds(steps: Steps[CalibrationResult]) -> Work:
    """Answer the questions of a calibration by rounds of chunks; return its result as bytes."""

    def ask(question: Question) -> Generator[Round, Answers, list[PartAnswer]]:
        chunks = [
            Chunk(f"{question.stage}/{k}", bytes_of(kind=question.kind, **part))
            for k, part in enumerate(question.parts())
        ]
        answers = yield Round(
            "calibration:answer_part", chunks, question.note, question.left, question.best
        )
        own = [answers[chunk.name] for chunk in chunks]
        return [one.reason if isinstance(one, Failure) else arrays_of(one) for one in own]

    return outcome_bytes((yield from relayed(steps, ask)))


@callable_by_jobs
def answer_part(inputs: Path, payload: bytes) -> bytes:
    """Chunk: answer to a part of a question."""
    return answer_bytes(load_task(inputs), payload)


def answer_bytes(task: CalibrationTask, payload: bytes) -> bytes:
    """Return the answer to a part of a question, with the time that it took to compute."""
    begun, rows = time.process_time(), arrays_of(payload)
    # Not `str`: NumPy's may return "..." for another array after Ctrl-C has interrupted it.
    answer = ANSWERS[rows.pop("kind").item()](task, rows)
    return bytes_of(**answer, **{search.TIME: time.process_time() - begun})


def _ends(task: CalibrationTask, rows: Rows) -> dict[str, Any]:
    """Number of recorded ends in the regions predicted from the other experiments, and of all."""
    comparer, (best, value, sd) = task.comparer, (rows[k][0] for k in ("point", "value", "sd"))
    targets, space, motion = comparer.targets, comparer.space, comparer.ensemble.motion
    if len(targets) < LEAST:
        return {"count": [0, 0]}
    near = linear_fit(comparer, best)
    drawn = draw_joint(value, space.low, space.high, sd, near.correlation, DRAWS, 0)
    moved = near.left_out()
    predictive = predictive_of(targets, space, motion, best, value, drawn, moved)
    return {"count": check_predictions(predictive, targets, motion, best, moved)}


ANSWERS: Final = {**search.ANSWERS, "ends": _ends}


def load_task(inputs: Path) -> CalibrationTask:
    """Load the task of a job; cached, since a process answers many chunks."""
    return _read(inputs.resolve(), (inputs / REQUEST).stat().st_mtime_ns)


@functools.lru_cache(maxsize=2)
def _read(inputs: Path, _: int) -> CalibrationTask:
    return plan_in(inputs.parent).task(threads())


def outcome_bytes(outcome: CalibrationResult) -> bytes:
    """Serialise the result of a calibration."""
    return bytes_of(
        keys=json_array(list(outcome.keys)),
        labels=json_array(list(outcome.labels)),
        nominal=outcome.nominal,
        **found_arrays(outcome.found),
    )


def outcome_of(data: bytes) -> CalibrationResult:
    """Load a result; inverse of `outcome_bytes`."""
    arrays = arrays_of(data)
    return CalibrationResult(
        keys=tuple(json_of(arrays["keys"])),
        labels=tuple(json_of(arrays["labels"])),
        nominal=arrays["nominal"],
        found=tuple(found_of(arrays)),
    )
