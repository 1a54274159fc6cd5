"""Plans of calibrations: requests with their experiments, and their computation in this process."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self, final

import numpy as np
from pydantic import ValidationError

from fixel.calibration.objective import Comparer, EndPose
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
from fixel.simulation.motion import stated_name
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
    Mode,
    named_options,
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
    asked : mapping
        Options of the command or page, as plain content; empty for other calls.
    left_out : mapping from name to reason
        Experiments that were skipped.
    """

    request: CalibrationRequest
    targets: Sequence[Target]
    source: str = "experiments"
    asked: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    left_out: Mapping[str, str] = dataclasses.field(default_factory=dict)

    @classmethod
    def of(
        cls,
        mode: Mode,
        experiments: Iterable[Experiment | Target],
        parameters: Space = None,
        /,
        *,
        start: Mapping[str, float] | None = None,
        **options: Any,
    ) -> Self:
        """Return the plan for arguments of `calibrate`, checked."""
        targets = targets_of(experiments)
        space = search_space(parameters, targets, start)
        own = {name: v for name, v in options.items() if name in CalibrationRequest.model_fields}
        kind = named_options(options["error"], "error")
        search = named_options(options["optimiser"], "optimiser")
        if search.name == "auto":
            usual = usual_search(mode, options["combine"], kind.name, targets, space)
            search = search.model_copy(update={"name": usual})
        own |= {"mode": mode, "unknowns": list(space.unknowns), "error": kind, "optimiser": search}
        if (noise := options["noise"]) is not None:
            own |= {"noise_position": noise.position_m, "noise_angle": noise.angle_rad}
        own["motion"] = stated_name(options["motion"])
        own["sample_of"] = getattr(experiments, "sample_of", None)
        try:
            request = CalibrationRequest(**own)
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
            asked=self.asked,
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
        report.show(
            Progress(
                stage=progress.note or report.stage,
                done=progress.done,
                total=None if progress.share is None else progress.total,
                best=progress.best,
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
