"""Plans of calibrations: requests with their experiments, and their computation in this process."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self, final

import numpy as np
from pydantic import ValidationError

from fixel.calibration.noise import Noise
from fixel.calibration.objective import AbstractError, Comparer, EndPose
from fixel.calibration.optimiser import AbstractOptimiser
from fixel.calibration.study import at_points, run_study
from fixel.calibration.target import Target, targets_of
from fixel.calibration.usual_parameters import Space, search_space
from fixel.errors import InvalidInput
from fixel.io.array_bytes import arrays_of
from fixel.jobs.work import AbstractEngine, Batch, Chunk, JobProgress, Show, answer_of
from fixel.kernels import codes
from fixel.model import Experiment, Scene
from fixel.model.space import ParameterSpace
from fixel.progress import Progress, Reporter
from fixel.simulation.motion import AbstractMotionModel, stated_name
from fixel.simulation.trust import permit
from fixel.workflows.calibration.calibration import Calibrations
from fixel.workflows.calibration.job import (
    CHUNKS,
    SearchState,
    comparer_of,
    evaluate_here,
    explained,
)
from fixel.workflows.calibration.request import (
    CalibrationRequest,
    Combine,
    Mode,
    NamedOptions,
    usual_optimiser,
)
from fixel.workflows.calibration.result import (
    CalibrationResult,
    FitKind,
    ParameterSet,
    found_of,
)

PREFLIGHT: Final = 16  # experiments that are simulated before any work starts
JAMMED: Final = codes.STATUS_NAMES[codes.JAMMED]
SINGLES: Final = "calibration:calibrate_alone"  # chunks that calibrate single experiments
_BEST: Final = re.compile(r", best RMS (\S+) mm")

Named = Mapping[str, Any] | str


@final
@dataclass(frozen=True, kw_only=True)
class CalibrationPlan:
    """Calibration that has not been run yet: its request and its experiments.

    Parameters
    ----------
    request : CalibrationRequest
    targets : sequence of Target
    source : str
        Python expression of the experiments.
    command : str
        Shell command that was typed, if any.
    left_out : mapping from name to reason
        Experiments that were skipped.
    """

    request: CalibrationRequest
    targets: Sequence[Target]
    source: str = "experiments"
    command: str = ""
    left_out: Mapping[str, str] = dataclasses.field(default_factory=dict)

    @classmethod
    def of(
        cls,
        mode: Mode,
        experiments: Iterable[Experiment | Target],
        parameters: Space = None,
        *,
        error: Named | AbstractError = "mean-square",
        combine: Combine = "sum",
        optimiser: Named | AbstractOptimiser = "auto",
        start: Mapping[str, float] | None = None,
        noise: Noise | None = None,
        motion: str | AbstractMotionModel = "dynamic",
        **others: Any,
    ) -> Self:
        """Return the plan for arguments of `calibrate`, checked."""
        permit(motion)
        targets = targets_of(experiments)
        space = search_space(parameters, targets, start)
        kind = _named(error, "error")
        search = _named(optimiser, "optimiser")
        if search.name == "auto":
            usual = usual_search(mode, combine, kind.name, targets, space)
            search = search.model_copy(update={"name": usual})
        try:
            request = CalibrationRequest(
                mode=mode,
                unknowns=list(space.unknowns),
                error=kind,
                combine=combine,
                optimiser=search,
                noise_position=None if noise is None else noise.position_m,
                noise_angle=None if noise is None else noise.angle_rad,
                motion=stated_name(motion),
                sample_of=getattr(experiments, "sample_of", None),
                **others,
            )
        except ValidationError as problem:
            first = problem.errors(include_url=False)[0]
            where = ".".join(map(str, first["loc"]))
            expected = first["msg"].removeprefix("Input should be ")
            raise InvalidInput(where, found=first["input"], expected=expected) from None
        request.check()
        return cls(
            request=request,
            targets=targets,
            source=str(getattr(experiments, "call", "experiments")),
            command=str(getattr(experiments, "command", "")),
            left_out=getattr(experiments, "left_out", {}),
        )

    def rehearse(self, threads: int | None = None) -> Self:
        """Simulate a few experiments, and all that may jam, with the start values.

        Returns
        -------
        CalibrationPlan
            Without the experiments whose rigid drive jams, which would make the error of one set of
            parameters for all infinite; they are named in `left_out`.

        Raises
        ------
        InvalidInput
            Nothing can be simulated.
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
        return dataclasses.replace(
            self,
            targets=[target for k, target in enumerate(self.targets) if k not in jammed],
            left_out={**self.left_out, **{self.targets[k].key: why for k, why in jammed.items()}},
        )

    def result(self, outcome: CalibrationResult, **more: Any) -> Calibrations:
        """Return the calibrations for the numbers that were found."""
        return Calibrations(
            request=self.request,
            outcome=outcome,
            targets=tuple(self.targets),
            source=self.source,
            command=self.command,
            left_out=self.left_out,
            **more,
        )


class DirectEngine(AbstractEngine):
    """Engine that computes the chunks of one calibration in this process, without files."""

    workers = 1

    def __init__(self, request: CalibrationRequest, comparer: Comparer) -> None:
        self._own = request, comparer
        self.alone: list[bytes] = []  # calibrations of single experiments so far

    def results(self, function: str, inputs: Path, chunks: Sequence[Chunk]) -> Iterator[Batch]:
        call = CHUNKS[function]
        for chunk in chunks:
            answer = answer_of(call, *self._own, chunk.payload)
            if function == SINGLES and isinstance(answer, bytes):
                self.alone.append(answer)
            yield [(chunk.name, answer)]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass


def best_so_far(
    plan: CalibrationPlan, comparer: Comparer, state: SearchState, alone: Sequence[bytes] = ()
) -> Calibrations | None:
    """Return what an interrupted calibration has found; None if there is nothing yet.

    Parameters
    ----------
    plan : CalibrationPlan
    comparer : Comparer
    state : SearchState
    alone : sequence of bytes
        Answers of the chunks that calibrated single experiments.
    """
    found = [*state.found] or [one for own in alone for one in found_of(arrays_of(own))]
    members = tuple(range(len(plan.targets)))
    here = evaluate_here(comparer)
    if not state.found and math.isfinite(state.best.error):
        point = state.best.point
        errors, _ = run_study(at_points(members, point[None]), here)
        found.append(
            ParameterSet(
                how=FitKind.DIRECT,
                members=members,
                point=point,
                errors=errors[0],
                trace=state.trace,
            )
        )
    if not found:
        return None
    nominal, _ = run_study(at_points(members, comparer.space.nominal[None]), here)
    outcome = CalibrationResult(
        keys=tuple(target.key for target in plan.targets),
        labels=comparer.space.labels,
        nominal=nominal[0],
        found=tuple(found),
    )
    return plan.result(outcome, interrupted=True)


def reporting(report: Reporter) -> Show:
    """Return a callback that reports the progress of rounds."""

    def show(progress: JobProgress) -> None:
        best = _BEST.search(progress.note)
        report.show(
            Progress(
                stage=_BEST.sub("", progress.note) or report.stage,
                done=progress.done,
                total=None if progress.share is None else progress.total,
                best=None if best is None else 1e-3 * float(best[1]),
                left=progress.left_s,
            )
        )

    return show


def may_jam(scene: Scene) -> bool:
    """Whether a rigid drive could push a body against fixels."""
    return bool(scene.fixels) and any(p.drive.force_limit is None for p in scene.pushers)


def usual_search(
    mode: Mode, combine: str, error: str, targets: Sequence[Target], space: ParameterSpace
) -> str:
    """Return the name of the search that suits a calibration best."""
    ends = error == EndPose.name
    frames = sum(1 if ends else len(target.pose) for target in targets)
    several = mode if len(targets) > 1 else "each"
    return usual_optimiser(several, combine, error, 3 * frames, len(space.free))


def _named(choice: Any, where: str) -> NamedOptions:
    """Return a method by name with its options, from a name, a mapping or the object itself."""
    if isinstance(choice, NamedOptions):
        return choice
    if isinstance(choice, str):
        return NamedOptions(name=choice)
    if isinstance(choice, Mapping) and "name" in choice:
        options = {key: value for key, value in choice.items() if key != "name"}
        return NamedOptions(name=str(choice["name"]), options=options)
    if isinstance(choice, AbstractError | AbstractOptimiser):
        names = [own.name for own in dataclasses.fields(choice)]  # type: ignore[arg-type]
        options = {name: getattr(choice, name) for name in names}
        return NamedOptions(name=choice.name, options=options)
    raise InvalidInput(where, found=choice, expected="a name, or a mapping with a name and options")
