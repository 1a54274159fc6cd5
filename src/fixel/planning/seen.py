"""The rest of a plan, from the pose that is seen between two of its pushes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.model.goals import BodyTrack
from fixel.model.scene import check_push
from fixel.model.trajectory import pose_difference
from fixel.planning.belief import Belief
from fixel.planning.plan import PushPlan, plan_rounds, search_of
from fixel.planning.pushes import FreePushes
from fixel.planning.search import conduct
from fixel.progress import Progress
from fixel.typing import BoolArray, FloatArray
from fixel.uncertainty.error_terms import RPI_CAMERA, StartError

WORLDS: Final = 2048  # parameter draws that are weighted
FRESH: Final = 11  # number of their stream of random values
SETS: Final = 256  # parameter sets that are kept
MIN_EFFECTIVE: Final = 32.0  # runs near the seen pose that count
WIDEST: Final = 0.5  # standard deviations of the runs by which the likelihood may be made wider


def belief_after(
    plan: PushPlan, seen: FloatArray, done: int, error: StartError
) -> tuple[Belief, str]:
    """Return the belief for the rest of a plan, from the pose seen after some of its pushes.

    The second value is why the parameters are as before; empty where they were narrowed.

    After `done` pushes the part was seen at a pose (3,) [m, m, rad], with an error. Simulated runs
    are weighted by the likelihood of that pose, a normal distribution with the error of the pose,
    made wider until enough runs count. Friction and pressure of the run stay what they were, and
    are not drawn again.
    """
    start = replace(plan.belief, start=error)
    if done == 0:
        return start, ""
    scenarios = plan.belief.scenarios(plan.scene, worlds=WORLDS, runs=1, seed=plan.seed + FRESH)
    begun = replace(plan, start=plan.start[:done], path=plan.path[:done])
    runs = begun.run(scenarios, samples=1)
    poses = runs.pose[:, done - 1]
    off = pose_difference(poses, seen)
    weight = _weights(off, error.deviation, runs.failure == 0)
    if weight is None:
        return start, "the seen pose is unlike the planned runs; parameters stay as uncertain"
    # Systematic resampling: each run as often as its weight says, up to one.
    places = (np.arange(SETS) + 0.5) / SETS
    rows = np.searchsorted(np.cumsum(weight) / weight.sum(), places)
    values = scenarios.values
    sets = [{name: float(column[row]) for name, column in values.items()} for row in rows]
    nearest = int(np.argmax(weight))
    sets.insert(0, {name: float(column[nearest]) for name, column in values.items()})
    scatter = plan.belief.run_to_run
    if scatter is not None:
        scatter = replace(scatter, start=0.0, centre=0.0, friction=0.0)
    # A model has an error of its own, which a seen pose does not lessen.
    field = "sets" if plan.belief.is_calibrated else "parameters"
    new: dict[str, Any] = {field: tuple(sets), "run_to_run": scatter}
    return replace(start, **new), ""


def _weights(off: FloatArray, deviation: FloatArray, good: BoolArray) -> FloatArray | None:
    """Return the weights (n,) of runs that end `off` (n, 3) from the seen pose; None if too far."""
    spread = off.std(axis=0)
    for wider in (0.0, *np.geomspace(0.01, WIDEST, 12)):
        width = np.maximum(np.hypot(deviation, wider * spread), 1e-12)
        weight = np.where(good, np.exp(-0.5 * np.sum((off / width) ** 2, axis=1)), 0.0)
        if weight.sum() ** 2 >= MIN_EFFECTIVE * np.sum(weight**2) > 0.0:
            return weight
    return None


def plan_again(
    plan: PushPlan,
    seen: FloatArray,
    done: int,
    *,
    error: StartError = RPI_CAMERA,
    rollouts: int,
    untrusted: bool = False,
    report: Callable[[Progress], None] | None = None,
) -> tuple[PushPlan, str]:
    """Plan again from a seen pose (3,) [m, m, rad], with the pushes that are left.

    The plan has the present belief, and `done` of its pushes were carried out. The second value is
    why the parameters are as before; empty where they were narrowed. `InvalidInput` is raised where
    no push is left.
    """
    check_push(plan.scene)  # where other parts are was not seen
    left = len(plan.pushes) - done
    if left < 1:
        expected = f"less than {len(plan.pushes)}, the plan's pushes"
        raise InvalidInput("done", found=done, expected=expected)
    belief, note = belief_after(plan, seen, done, error)
    choose, body = plan.choose, plan.scene.bodies[0]
    search = search_of(
        replace(plan.scene, bodies=(replace(body, pose=np.asarray(seen)),)),
        plan.goal,
        replace(choose, most=left) if isinstance(choose, FreePushes) else choose,
        belief, rollouts=rollouts, seed=plan.seed, motion=plan.motion, stepper=plan.stepper,
        first=[plan.pushes[done:]], report=report,
    )  # fmt: skip
    return conduct(search, plan_rounds(search, untrusted=untrusted), {}), note


def is_met(plan: PushPlan, seen: FloatArray) -> bool:
    """Return whether a part at rest at a seen pose already meets the goal, without a force."""
    fixels = None if plan.fixels is None else plan.fixels[None]
    try:
        track = BodyTrack(np.asarray(seen)[None, None], None, np.zeros(1), fixels)
        return bool(plan.goal.met(plan.scene, track)[0])
    except InvalidInput:  # the goal needs stalls
        return False
