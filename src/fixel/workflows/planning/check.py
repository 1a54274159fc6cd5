"""Plans under the present calibration, and new plans from a seen pose."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, final

import numpy as np

from fixel.database.project import Project
from fixel.errors import InvalidInput
from fixel.model import Experiment
from fixel.planning.belief import Belief
from fixel.planning.held_out import HeldSuccess, held_success
from fixel.planning.seen import plan_again
from fixel.planning.success import SuccessProbability
from fixel.planning.trials import Trials
from fixel.progress import show_progress
from fixel.typing import FloatArray
from fixel.workflows.calibration.calibration import Calibration
from fixel.workflows.calibration.run import calibrate
from fixel.workflows.calibration.stored import newest_calibration
from fixel.workflows.planning.request import FoundPlan, inputs_of, warnings_of, with_experiments
from fixel.workflows.planning.stored import load_plan, load_trials


@final
@dataclass(frozen=True, kw_only=True)
class CheckedPlan:
    """Plan with its success probability under the present calibration, and its trials."""

    found: FoundPlan
    id: str
    now: SuccessProbability
    calibration: int | None  # id of the present calibration
    changed: bool  # whether the plan was made with another calibration
    trials: Trials

    @property
    def sentences(self) -> list[str]:
        """Results of the check, in sentences."""
        plan = self.found.plan
        lines = [
            f"Stated when it was made: {plan.success.sentence}.",
            f"{plan.belief.start_text.capitalize()}.",
        ]
        if self.changed:
            lines.append(f"The calibration has changed: now {self.calibration}.")
        lines.append(f"Under the present calibration: {self.now.sentence}.")
        if self.now.stated < self.found.wanted:
            lines.append(f"This is below the wanted {self.found.wanted:g}: plan again.")
        else:
            share = 100.0 * self.now.spare(self.found.wanted)
            lines.append(
                f"It is at least the wanted {self.found.wanted:g} as long as less than"
                f" {share:.1f} % of the samples are misplaced."
            )
        if self.trials.n:
            lines.append(str(self.trials).splitlines()[0] + ".")
        else:
            lines.append("No trials yet.")
        return lines


def check_plan(project: Project | None, path: Path) -> CheckedPlan:
    """Compute the success probability of a stored plan under the present calibration.

    Raises
    ------
    InvalidInput
        The plan file or its trials cannot be read.
    """
    file = load_plan(path)
    trials = load_trials(path, file)
    belief, number = present_belief(project, file.found)
    return CheckedPlan(
        found=file.found,
        id=file.id,
        now=file.found.plan.success_under(belief),
        calibration=number,
        changed=number != file.found.calibration,
        trials=trials,
    )


def present_belief(project: Project | None, found: FoundPlan) -> tuple[Belief, int | None]:
    """Return the belief of a plan with the present calibration of its project, and its id."""
    if project is None or found.calibration is None:
        return found.plan.belief, found.calibration
    given = found.request
    scene = Path(given["scene"]) if given.get("scene") else None
    own = inputs_of(
        project, given["goal"], Path(given["folder"]), scene, given.get("experiment", "")
    )
    return own.belief, own.calibration


def held_out_success(
    calibration: Calibration, experiments: Sequence[Experiment], **options: Any
) -> HeldSuccess:
    """Compare stated with held success for the parameters and the motion of a calibration.

    Parameters
    ----------
    calibration : Calibration
    experiments : sequence of Experiment
    **options
        Options of `held_success`.
    """
    space = {
        own.label: own.nominal if own.frozen else (own.low, own.high)
        for own in calibration.space.unknowns
    }

    def fit(train: Sequence[Experiment], seed: int) -> Calibration:
        return calibrate(train, space, motion=calibration.motion, seed=seed, progress=False)

    return held_success(fit, experiments, **options)


def stored_held_success(project: Project, number: int | None = None, **options: Any) -> HeldSuccess:
    """Compare stated with held success for a stored calibration; by default the newest."""
    with project.store() as store:
        number = newest_calibration(store) if number is None else number
        if number is None:
            hint = "fixel calibrate makes one"
            raise InvalidInput("project", found="no calibration", expected="one", hint=hint)
    calibration, experiments = with_experiments(project, number)
    return held_out_success(calibration, experiments, **options)


def seen_pose(text: str, where: str = "--seen") -> FloatArray:
    """Return a pose (3,) [m, m, rad] from text such as `120.5,3,-10` [mm, mm, deg]."""
    try:
        x, y, angle = (float(part) for part in text.split(","))
        if not all(map(math.isfinite, (x, y, angle))):
            raise ValueError
    except ValueError:
        raise InvalidInput(
            where, found=repr(text), expected="x,y,angle in mm, mm and degrees: 120.5,3,-10"
        ) from None
    return np.array([x / 1e3, y / 1e3, math.radians(angle)])


def next_plan(
    project: Project | None, path: Path, seen: FloatArray, done: int = 0, **options: Any
) -> FoundPlan:
    """Plan again from a seen pose of the part, with the pushes that are left.

    Parameters
    ----------
    project : Project or None
    path : Path
        Plan file.
    seen : (3,) float64
        Pose of the part [m, m, rad].
    done : int
        Number of pushes that were carried out.
    **options
        Options of `plan_again`.
    """
    found = load_plan(path).found
    belief, number = present_belief(project, found)
    old = replace(found.plan, belief=belief)
    with show_progress(None, "planning") as report:
        again, note = plan_again(
            old, seen, done, **{"untrusted": found.request.get("untrusted", False), **options},
            report=report.show,
        )  # fmt: skip
    warnings = (*warnings_of(again, found.wanted), *filter(None, [note]))
    return replace(found, plan=again, calibration=number, warnings=warnings)
