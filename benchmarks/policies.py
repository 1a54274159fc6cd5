"""Plans with looks carried out in another model: success stated by the policy, and success held.

``python -m benchmarks policies``: the pushes of `benchmarks.planning` without its grasps, for goals
of 1 to 2.5 mm and degrees with a round tool. The belief comes from a calibration to eight recorded
pushes, and every second world has an uneven table, too, of which no belief knows. Plans have one
look or two. Each is carried out by `PushPlan.perform` with new conditions and new errors of the
start, and a camera with the error that the plan assumes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

import fixel
from benchmarks.figures import Figure, Size, at_most
from benchmarks.planning import Task, log_score, recorded, reliability, tasks, unknowns
from fixel.errors import InvalidInput
from fixel.model import Disk, Scene
from fixel.model.goals import BodyTrack, Goal, PoseRegion
from fixel.planning.belief import Belief
from fixel.planning.plan import PushPlan
from fixel.planning.pushes import FreePushes
from fixel.testbed.simulated import repeat_pushes
from fixel.uncertainty.error_terms import StartError
from fixel.units import deg, mm

SEED: Final = 424_242
RUNS: Final = 32  # executions of a plan
ROLLOUTS: Final = 8_000  # of a plan
START: Final = StartError(x=1 * mm, y=1 * mm, theta=1.5 * deg, kind="normal")
CHOOSE: Final = FreePushes(most=2, tool=Disk(5 * mm))
UNEVEN: Final = 0.4  # of every second table


class Row(NamedTuple):
    """Result of one task: success stated and held."""

    task: str
    looks: int
    stated: float
    held: float


def run(size: Size) -> list[Figure]:
    """Stated against held success of policies with one look and with two."""
    number, runs, rollouts = (60, RUNS, ROLLOUTS) if size.rollouts >= 500 else (2, 2, 1_000)
    rows: list[Row] = []
    for k, task in enumerate(islice(_pushes(), number)):
        try:
            rows.append(compared(task, 1 + k % 2, runs, rollouts))
        except InvalidInput as refusal:  # no plan, so that there is nothing to compare
            print(f"{task.name}: {refusal}", flush=True)
            continue
        print(*(f"{x:.3f}" if isinstance(x, float) else x for x in rows[-1]), flush=True)
    return figures(rows)


def figures(rows: Sequence[Row]) -> list[Figure]:
    """Figures of all tasks, and of those with each number of looks."""
    found = []
    looks, stated, held = (
        np.array([getattr(row, name) for row in rows]) for name in ("looks", "stated", "held")
    )
    for name, own in (("all", looks > 0), ("one look", looks == 1), ("two looks", looks == 2)):
        if own.any():
            bias = 100.0 * float((stated - held)[own].mean())
            found += [
                Figure(f"policies, {name}", "-", (float(own.sum()),)),
                Figure(f"policies, {name}, bias", "points", (bias,)),
                Figure(f"policies, {name}, size of the bias", "points", (abs(bias),), at_most(5.0)),
                Figure(f"policies, {name}, held", "%", (100.0 * float(held[own].mean()),)),
            ]
    score = Figure("policies, log score", "-", (log_score(stated, held),))
    return [*found, score, *reliability(stated, held)]


def compared(task: Task, looks: int, runs: int, rollouts: int) -> Row:
    """Plan a task with looks, and carry the plan out."""
    rng = np.random.default_rng([task.world.seed, 4])
    tolerance, seen = rng.uniform(1.0, 2.5), rng.uniform(0.2, 0.6)
    pose = np.array(task.goal["goal"]["pose"]["pose_mm_deg"]) * (mm, mm, deg)
    goal = PoseRegion(pose, position=tolerance * mm, angle=tolerance * deg)
    fit = fixel.calibrate(
        recorded(task), unknowns(task), motion="quasistatic", threads=1, progress=False
    )
    plan = fixel.plan(
        task.scene, goal, CHOOSE, Belief(parameters=fit, start=START), rollouts=rollouts,
        looks=looks, camera=StartError(x=seen * mm, y=seen * mm, theta=seen * deg, kind="normal"),
        untrusted=True, seed=task.world.seed, threads=1, progress=False,
    )  # fmt: skip
    assert plan.looks is not None
    held = np.mean([meets(task, goal, plan, r) for r in range(runs)])
    return Row(task.name.partition(" within")[0], looks, plan.looks.worth[-1].mean, float(held))


def meets(task: Task, goal: Goal, plan: PushPlan, r: int) -> bool:
    """Whether run r of a plan in the world of its task meets the goal."""
    rng = np.random.default_rng([task.world.seed, 2, r])
    pose = plan.scenes[0].bodies[0].pose + rng.standard_normal(3) * START.deviation
    failure = ""

    def push(scene: Scene) -> None:
        nonlocal pose, failure
        # The name gives a run its conditions, the same for all its pushes.
        done = repeat_pushes(task.world, [scene], pose[None], name=f"held-{r}", threads=1)
        pose, failure = done.pose[0, -1], failure or done.failure[0]

    def look() -> ArrayLike:
        assert plan.looks is not None
        return np.asarray(pose + rng.standard_normal(3) * plan.looks.camera.deviation)

    plan.perform(push, look)
    return not failure and bool(goal.met(plan.scene, BodyTrack.of_ends(pose[None]))[0])


def _pushes() -> Iterator[Task]:
    """Tasks without grasps; every second world has an uneven table."""
    free = (task for task in tasks(10_000, SEED) if task.kind != "grasp")
    for k, task in enumerate(free):
        uneven = UNEVEN if k // 2 % 2 else 0.0
        world = replace(task.world, uneven_table=uneven, table_seed=task.world.seed)
        yield task._replace(world=world)
