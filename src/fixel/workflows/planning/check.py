"""Plans under the present calibration, and new plans from a seen pose."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from fixel.database.project import Project
from fixel.errors import InvalidInput
from fixel.model import Experiment
from fixel.model.goals import BodyTrack
from fixel.model.scene import Scene
from fixel.planning.belief import Belief
from fixel.planning.held_out import HeldSuccess, held_success
from fixel.planning.plan import PushPlan, simulator_of
from fixel.planning.pushes import FreePushes
from fixel.planning.seen import belief_after
from fixel.planning.success import SuccessProbability
from fixel.planning.trials import Trials
from fixel.progress import ProgressOption
from fixel.typing import FloatArray
from fixel.uncertainty.starts import RPI_CAMERA, StartError
from fixel.workflows.calibration.calibration import Calibration
from fixel.workflows.calibration.run import calibrate
from fixel.workflows.calibration.stored import newest_calibration
from fixel.workflows.planning.request import FoundPlan, inputs_of, warnings_of, with_experiments
from fixel.workflows.planning.run import plan
from fixel.workflows.planning.stored import load_plan, load_trials

WORLDS: Final = 64
FRESH: Final = 1_000_003  # added to the seed of a plan, so that a check draws other scenarios
QUICK: Final = 12_000  # rollouts of a new plan from a seen pose


@final
@dataclass(frozen=True, kw_only=True)
class CheckedPlan:
    """Plan with its success probability under the present calibration, and its trials.

    Attributes
    ----------
    found : FoundPlan
    id : str
    now : SuccessProbability
    calibration : int or None
        Id of the present calibration.
    changed : bool
        Whether the plan was made with another calibration.
    trials : Trials
    """

    found: FoundPlan
    id: str
    now: SuccessProbability
    calibration: int | None
    changed: bool
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
        now=success_under(file.found.plan, belief),
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


def success_under(plan: PushPlan, belief: Belief) -> SuccessProbability:
    """Compute the success probability of a plan from fresh scenarios of a belief."""
    scenarios = belief.scenarios(plan.scene, worlds=WORLDS, runs=WORLDS, seed=plan.seed + FRESH)
    simulator = simulator_of(
        plan.scene, plan.goal, plan.choose, belief, plan.motion, plan.stepper, None
    )
    runs = simulator.run(plan.planned(), np.zeros(scenarios.n, np.int64), scenarios)
    margins = simulator.margins(runs)
    return SuccessProbability.of(margins.reshape(WORLDS, WORLDS))


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
    project: Project | None,
    path: Path,
    seen: FloatArray,
    *,
    done: int = 0,
    error: StartError | None = None,
    rollouts: int = QUICK,
    progress: ProgressOption = None,
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
    error : StartError, optional
        Error of the seen pose; by default that of the stickers' camera.
    rollouts : int
        Number of simulated pushes.
    progress : bool or callable, optional
    """
    found = load_plan(path).found
    old = found.plan
    if already_met(old, seen):
        hint = "no push is needed"
        raise InvalidInput(
            "--seen", found="a pose that meets the goal", expected="another", hint=hint
        )
    belief, number = present_belief(project, found)
    left = len(old.pushes) - done
    if left < 1:
        raise InvalidInput(
            "--done", found=done, expected=f"less than {len(old.pushes)}, the plan's pushes"
        )
    choose = replace(old.choose, most=left) if isinstance(old.choose, FreePushes) else old.choose
    scene = at_pose(old.scene, seen)
    told = belief_after(replace(old, belief=belief), seen, done, error or RPI_CAMERA)
    again = plan(
        scene,
        old.goal,
        choose,
        told.belief,
        rollouts=rollouts,
        seed=old.seed,
        motion=old.motion,
        stepper=old.stepper,
        untrusted=found.request.get("untrusted", False),
        first=[old.pushes[done:]],
        progress=progress,
    )
    return FoundPlan(
        plan=again,
        request=found.request,
        calibration=number,
        wanted=found.wanted,
        warnings=(*warnings_of(again, found.wanted), *filter(None, [told.note])),
    )


def already_met(plan: PushPlan, seen: FloatArray) -> bool:
    """Return whether a seen pose already meets the goal, judged by the pose alone."""
    try:
        return bool(plan.goal.met(plan.scene, BodyTrack.of_ends(seen))[0])
    except InvalidInput:  # the goal needs forces or stalls
        return False


def at_pose(scene: Scene, pose: Sequence[float] | FloatArray) -> Scene:
    """Return a scene with its part at another pose (3,) [m, m, rad]."""
    return replace(scene, bodies=(replace(scene.bodies[0], pose=np.asarray(pose)),))
