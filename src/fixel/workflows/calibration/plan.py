"""Plans of calibrations: requests with their experiments, and their computation in this process."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Self, final

import numpy as np
from pydantic import ValidationError

from fixel.calibration.objective import EndPose
from fixel.calibration.target import Target, targets_of
from fixel.calibration.usual_parameters import Space, search_space
from fixel.errors import InvalidInput
from fixel.kernels import codes
from fixel.model import Experiment, Scene
from fixel.model.space import ParameterSpace
from fixel.simulation.motion import stated_name
from fixel.workflows.calibration.calibration import Calibrations
from fixel.workflows.calibration.job import (
    comparer_of,
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
