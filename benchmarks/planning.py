"""Plans carried out in another model: success stated by the planner, and success in the laboratory.

``python -m benchmarks planning``: every task has a world of its own, a simulated laboratory with
uneven pressure, a rough plate, and friction and centre of pressure that are not stated. It records
eight experiments into a project, `fixel.calibrate` stores a calibration there, and the plan is that
of `fixel plan GOAL --untrusted`: the same function with the same defaults, so that the belief is
that of a calibration. The plan is carried out 200 times in that world with new conditions and new
errors of the start.
"""

from __future__ import annotations

import csv
import json
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from math import pi
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

import fixel
from benchmarks.figures import Figure, Size, at_least, at_most
from benchmarks.report import RESULTS
from fixel.database.project import Project
from fixel.errors import InvalidInput
from fixel.formats.goal_file import goal_file_from_dict
from fixel.model import Body, Ellipsoid, Experiment, PlannedExperiment, Polygon, Scene
from fixel.model.goals import BodyTrack, Goal, touching
from fixel.parts.next_pushes import push_candidates
from fixel.planning.plan import PushPlan, simulator_of
from fixel.planning.pushes import FreePushes, scene_of_push
from fixel.planning.search import PlanSearch
from fixel.planning.success import SuccessProbability, rate_quantile
from fixel.sampling.published import thesis_plan
from fixel.simulation.ensemble import Ensemble
from fixel.simulation.rollouts import RolloutCase
from fixel.testbed.simulated import SimulatedTestbed, repeat_pushes
from fixel.typing import FloatArray
from fixel.units import deg, mm
from fixel.workflows.planning.run import PLAN, plan_goal

SEED: Final = 90_177  # worlds that decided one choice: how many pushes a table simulates
RUNS: Final = 200  # executions of a plan
EXPERIMENTS: Final = 8  # recorded before planning
START: Final = {"x_mm": 1.0, "y_mm": 1.0, "theta_deg": 1.5, "kind": "normal"}
HARD_MM_DEG, EASY_MM_DEG = 3.0, 5.0
TOOL: Final = Polygon.rectangle(10 * mm, 40 * mm)
MASS, FRICTION = 0.3, 0.25
ROWS: Final = RESULTS / "planning.csv"
KINDS: Final = ("push", "sequence", "grasp")
# Statements that are compared with the executions together.
BINS: Final = (0.0, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0)
# A statement is clipped to this share before its logarithm is taken: certainty has a finite price.
MIN_SHARE: Final = 0.01


class Task(NamedTuple):
    """Scene, content of the goal file, and the world in which the plan is tried."""

    name: str
    kind: str
    scene: Scene
    goal: Mapping[str, Any]
    world: SimulatedTestbed


class Row(NamedTuple):
    """Result of one task: success stated and held, of the plan and of the nominal one."""

    task: str
    kind: str
    mean: float  # stated mean over samples of the parameters
    low: float  # lower end of the stated range over samples of the parameters
    held: float
    expected: float  # mean |mean - held| over the belief's own samples of the parameters
    nominal_mean: float
    nominal_held: float
    pushes: int
    runs: int
    rollouts: int
    processor_seconds: float


def run(size: Size) -> list[Figure]:
    """Stated against held success, and the robust plan against the nominal one."""
    full = size.rollouts >= 500
    number, runs, rollouts = (
        (30, RUNS, PLAN.options["rollouts"].default) if full else (2, 10, 4_000)
    )
    rows = compared_tasks(tasks(number), runs, rollouts, ROWS if full else None)
    return figures(rows, bar=full)


def compared_tasks(
    own: Iterator[Task], runs: int, rollouts: int, path: Path | None = None
) -> list[Row]:
    """Return the rows of tasks, and write them to a file as they are computed."""
    rows: list[Row] = []
    for task in own:
        try:
            rows.append(compared(task, runs, rollouts))
        except InvalidInput as refusal:  # no plan, so that there is nothing to compare
            print(f"{task.name}: {refusal}", flush=True)
            continue
        print(*(f"{x:.3f}" if isinstance(x, float) else x for x in rows[-1]), flush=True)
        if path is not None:
            with path.open("w", newline="") as stream:
                csv.writer(stream, lineterminator="\n").writerows([Row._fields, *rows])
    return rows


def figures(rows: Sequence[Row], *, bar: bool) -> list[Figure]:
    """Figures of all tasks; the harder half is that in which nominal plans hold less."""
    mean, low, held, expected, nominal = (
        np.array([getattr(row, name) for row in rows])
        for name in ("mean", "low", "held", "expected", "nominal_held")
    )
    hard = np.argsort(nominal, kind="stable")[: max(1, len(rows) // 2)]
    off = mean - held
    values = {
        "tasks": (len(rows), "-"),
        "stated mean less held (bias)": (100.0 * off.mean(), "points"),
        "size of the bias": (100.0 * abs(off.mean()), "points"),
        "log score": (log_score(mean, held), "-"),
        "difference of stated mean and held": (100.0 * np.abs(off).mean(), "points"),
        "difference that the belief expects": (100.0 * expected.mean(), "points"),
        "held below 5 % quantile": (100.0 * (held < low).mean(), "%"),
        "robust less nominal, hard half": (100.0 * (held - nominal)[hard].mean(), "points"),
        "success held": (100.0 * held.mean(), "%"),
        "processor time of a plan": (np.median([row.processor_seconds for row in rows]), "s"),
    }  # fmt: skip
    bars = {
        "size of the bias": at_most(5.0),
        "held below 5 % quantile": at_most(10.0),
        "robust less nominal, hard half": at_least(20.0),
    }
    found = [
        Figure(f"plans, {name}", unit, (float(x),), bars.get(name) if bar else None)
        for name, (x, unit) in values.items()
    ]
    return found + reliability(mean, held)


def log_score(stated: FloatArray, held: FloatArray) -> float:
    """Mean of -log of the probability that was stated for what happened; less is better.

    Source: Good (1952), J. R. Stat. Soc. B 14, 107-114.
    """
    p = np.clip(stated, MIN_SHARE, 1.0 - MIN_SHARE)
    return float(-(held * np.log(p) + (1.0 - held) * np.log(1.0 - p)).mean())


def reliability(stated: FloatArray, held: FloatArray) -> list[Figure]:
    """Mean statement and mean held success of the tasks in every bin of statements."""
    found = []
    for low, high in pairwise(BINS):
        own = (stated >= low) & ((stated < high) | (high == BINS[-1]))
        if own.any():
            name = f"plans, {own.sum()} stated {low:g} to {high:g}"
            for what, x in (("mean stated", stated), ("held", held)):
                found.append(Figure(f"{name}: {what}", "%", (100.0 * float(x[own].mean()),)))
    return found


def compared(task: Task, runs: int, rollouts: int) -> Row:
    """Plan a task robustly and nominally, and carry both plans out."""
    with tempfile.TemporaryDirectory() as folder:
        project = calibrated_project(task, Path(folder) / "project")
        task.scene.save(Path(folder) / "scene.yaml")
        goal = {"fixel": 1, "scene": "scene.yaml", "belief": {"start": START}, **task.goal}
        (Path(folder) / "goal.yaml").write_text(json.dumps(goal))
        begun = time.process_time()
        plan = plan_goal(
            project, f"{folder}/goal.yaml", rollouts=rollouts, seed=task.world.seed, untrusted=True,
            threads=1, progress=False,
        ).found.plan  # fmt: skip
        seconds = time.process_time() - begun
    return Row(
        task.name, task.kind, plan.success.mean, plan.success.least,
        held(task, plan.goal, plan.scenes, runs), expected_difference(plan.success, runs),
        plan.nominal_success.mean,
        held(task, plan.goal, nominal_pushes(plan, rollouts), runs),
        len(plan.scenes), runs, rollouts, seconds,
    )  # fmt: skip


def calibrated_project(task: Task, folder: Path) -> Project:
    """Project with the experiments of a task and their calibration."""
    project = Project.create(folder)
    with project.store() as store:
        added = [store.add_experiment(own) for own in recorded(task)]
        experiments = [store.experiment(own.id) for own in added]
    fixel.calibrate(
        experiments, unknowns(task), motion="quasistatic", threads=1, progress=False, store=folder
    )
    return project


def nominal_pushes(plan: PushPlan, rollouts: int) -> list[Scene]:
    """Pushes that would be best if nothing were unknown; no task moves fixels."""
    simulator = simulator_of(plan.scene, plan.goal, plan.choose, plan.belief, None, None, 1)
    search = PlanSearch(simulator=simulator, belief=plan.belief, rollouts=rollouts)
    best = simulator.planned(search.candidates()[0][None])
    return [
        scene_of_push(plan.scene, *own) for own in zip(best.start[0], best.path[0], strict=True)
    ]


def expected_difference(success: SuccessProbability, runs: int) -> float:
    """Mean of |stated mean - share held| over the samples of the parameters, for n executions."""
    from scipy.stats import binom

    ranks = np.arange(1, len(success.rates) + 1) / (len(success.rates) + 1)
    rates = rate_quantile(success.rates * success.n_runs, success.n_runs, ranks)
    share = np.arange(runs + 1) / runs
    chance = binom.pmf(np.arange(runs + 1), runs, np.clip(rates, 0.0, 1.0)[:, None])
    return float((chance @ np.abs(success.mean - share)).mean())


def held(task: Task, goal: Goal, pushes: Sequence[Scene], runs: int) -> float:
    """Share of executions in the world of a task that meet the goal."""
    start = goal_file_from_dict({"fixel": 1, **task.goal, "belief": {"start": START}}).belief.start
    assert start is not None
    rng = np.random.default_rng([task.world.seed, 2])
    starts = pushes[0].bodies[0].pose + rng.standard_normal((runs, 3)) * start.deviation
    done = repeat_pushes(task.world, pushes, starts, threads=1)
    met = goal.met(done.scene, BodyTrack(done.pose[:, 1:], done.stalled, done.force))
    return float((met & np.equal(done.failure, "")).mean())


# --- what is recorded -----------------------------------------------------------------------


def unknowns(task: Task) -> dict[str, tuple[float, float]]:
    """Parameters of a task to calibrate, with their bounds."""
    bounds = {"mu_pusher": (0.0, 1.0), "mu_fixel": (0.0, 1.0)}
    bounds |= dict.fromkeys(("friction_centre_x", "friction_centre_y"), (-0.01, 0.01))
    if task.kind == "grasp":
        return bounds | {"tripod_radius": (0.02, 0.06)}
    del bounds["mu_fixel"]
    support = task.scene.bodies[0].support
    assert isinstance(support, Ellipsoid)
    torque = support.torque
    return bounds | {"ellipsoid_torque": (0.5 * torque, 1.5 * torque)}


def recorded(task: Task) -> list[Experiment]:
    """Experiments in the world of a task, whose starts are measured."""
    rng = np.random.default_rng([task.world.seed, 1])
    if task.kind == "grasp":
        turn = np.column_stack((np.zeros(EXPERIMENTS), *_even(rng, [0.02, pi / 4])))
        scenes = [_laid(task.scene, own) for own in turn]
    else:
        body = replace(task.scene.bodies[0], pose=np.zeros(3))
        pushes = push_candidates(body, travel=0.04, contacts=16)
        scenes = [pushes[k] for k in rng.permutation(len(pushes))[:EXPERIMENTS]]
    named = [PlannedExperiment(name=f"before-{k}", scene=own) for k, own in enumerate(scenes)]
    return list(task.world.run(named, threads=1))


def _even(rng: np.random.Generator, reach: Sequence[float]) -> Iterator[FloatArray]:
    share = (np.arange(EXPERIMENTS) + 0.5) / EXPERIMENTS * 2.0 - 1.0
    return (size * rng.permutation(share) for size in reach)


def _laid(scene: Scene, change: FloatArray) -> Scene:
    body = scene.bodies[0]
    return replace(scene, bodies=(replace(body, pose=body.pose + change),))


# --- tasks ----------------------------------------------------------------------------------


def tasks(number: int, seed: int = SEED) -> Iterator[Task]:
    """Tasks of the three kinds in turn, each in another world."""
    for k in range(number):
        rng = np.random.default_rng([seed, k])
        kind = KINDS[k % 3]
        pusher, fixel_ratio = float(rng.uniform(0.7, 1.4)), float(rng.uniform(0.7, 1.3))
        centre, uneven = rng.normal(size=2) * 2.5 * mm, float(rng.uniform(0.1, 0.4))
        world = SimulatedTestbed(
            seed=seed + k,
            pusher_friction=pusher,
            fixel_friction=fixel_ratio,
            centre_of_pressure=(float(centre[0]), float(centre[1])),
            unevenness=uneven,
        )
        if kind == "grasp":
            yield _grasp(f"{k + 1:02d}", k // 3, world, rng)
        else:
            yield _free_push(f"{k + 1:02d}", kind, k // 3, world, rng)


def _free_push(
    name: str, kind: str, k: int, world: SimulatedTestbed, rng: np.random.Generator
) -> Task:
    """Task to push a part to the pose at which random pushes of the nominal model leave it."""
    outline = _outline(rng, k)
    force = FRICTION * MASS * 9.81
    arm = 0.9 * float(np.sqrt(outline.unit_inertia))  # of a force that opposes turning
    body = Body("part", outline, mass=MASS, support=Ellipsoid(force=force, torque=arm * force))
    n = 1 if kind == "push" else 2
    choose = FreePushes(most=2, tool=TOOL, length=(8 * mm, 80 * mm))
    scene = choose.prepared(Scene(bodies=(body,), duration=1.0))
    end = np.zeros(3)
    while not 20 * mm < np.hypot(*end[:2]) < 120 * mm:
        end = _after_random_pushes(scene, choose, n, rng)
    size = EASY_MM_DEG if k % 2 else HARD_MM_DEG
    pose = [end[0] / mm, end[1] / mm, end[2] / deg]
    goal = {
        "goal": {"pose": {"pose_mm_deg": pose, "position_mm": size, "angle_deg": size}},
        "choose": {
            "free": {
                "most": choose.most,
                "tool": {"polygon_mm": (TOOL.outline / mm).tolist()},
                "length_mm": [8, 80],
            }
        },
    }
    return Task(f"{name} {kind} within {size:g} mm and deg", kind, scene, goal, world)


def _outline(rng: np.random.Generator, k: int) -> Polygon:
    """Rectangles, triangles, hexagons and wide rectangles in turn, of 70 to 120 mm."""
    a, b = rng.uniform(0.035, 0.06, 2)
    n = (4, 3, 6, 4)[k % 4]
    turn = 2.0 * np.pi * (np.arange(n) + 0.5) / n
    corners = np.column_stack((a * np.cos(turn), b * np.sin(turn)))
    return Polygon(corners * (1.3 if n < 6 else 1.0))


def _after_random_pushes(
    scene: Scene, choose: FreePushes, n: int, rng: np.random.Generator
) -> FloatArray:
    pose = np.array(scene.bodies[0].pose, np.float64)
    low, high = choose.bounds(scene)
    for _ in range(n):
        motion = choose.motions(scene, rng.uniform(low, high)[None], pose[None])
        push = scene_of_push(scene, pose, motion.path[0])
        end = Ensemble([RolloutCase(push, np.array([push.duration]))], threads=1)
        pose = end.simulate(np.zeros(1, np.int64), {}).pose[0, -1]
    return pose


def _grasp(name: str, k: int, world: SimulatedTestbed, rng: np.random.Generator) -> Task:
    """Task to seat the part of the thesis on the rig, on as many fixels as can be."""
    own = grasp_scenes()[k % 20]
    scene, mode = own.scene, seating(own.scene, rng)
    goal = {
        "goal": {"seated": {"fixels": list(mode)}},
        "choose": {"rig": {"y_mm": [-30, 30], "theta_deg": [-45, 45]}},
    }
    title = f"{name} {own.conditions['shape']}, {own.conditions['layout']}, {len(mode)} fixels"
    return Task(title, "grasp", scene, goal, world)


def grasp_scenes() -> list[PlannedExperiment]:
    """First experiment of every shape and layout of the thesis; shapes in turn."""
    found: dict[tuple[object, object], PlannedExperiment] = {}
    for one in thesis_plan().experiments:
        found.setdefault((one.conditions["shape"], one.conditions["layout"]), one)
    own = list(found.values())
    half = len(own) // 2
    return [own[(k % 2) * half + (k + k // 10) % half] for k in range(len(own))]


def seating(scene: Scene, rng: np.random.Generator, n: int = 400) -> tuple[str, ...]:
    """Names of the fixels of the largest contact mode that random placements reach in 1 %."""
    case = RolloutCase(scene, np.array([scene.duration]))
    placed = {
        "start_y": rng.uniform(-0.03, 0.03, n),
        "start_theta": rng.uniform(-pi / 4, pi / 4, n),
    }
    done = Ensemble([case], threads=1).simulate(np.zeros(n, np.int64), placed)
    touched = touching(scene, scene.bodies[0], done.pose[:, -1]) & done.stalled[:, None]
    modes, counts = np.unique(touched, axis=0, return_counts=True)
    common = modes[counts >= n / 100]
    best = common[np.argmax(common.sum(axis=1))]
    return tuple(f.name for f, own in zip(scene.fixels, best, strict=True) if own)
