"""Plans carried out in another model: success stated by the planner, and success in the laboratory.

``python -m benchmarks planning``: every task has a world of its own, a simulated laboratory with
uneven pressure, a rough plate, and friction and centre of pressure that nobody states. It records
eight experiments, `fixel.calibrate` makes the belief of them, the planner plans, and the plan is
carried out 200 times in that world with new conditions and new errors of the start.
"""

from __future__ import annotations

import csv
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from math import pi
from typing import Final, NamedTuple

import numpy as np

import fixel
from benchmarks.figures import Figure, Size, at_least, at_most
from benchmarks.report import RESULTS
from fixel.model import Body, Ellipsoid, Experiment, PlannedExperiment, Polygon, Scene
from fixel.model.goals import BodyTrack, Goal, PoseRegion, Seated, touching
from fixel.parts.candidates import push_candidates
from fixel.planning.belief import Belief
from fixel.planning.plan import simulator_of
from fixel.planning.pushes import FreePushes, RigPushes, scene_of_push
from fixel.planning.search import PlanSearch
from fixel.sampling.thesis import thesis_plan
from fixel.simulation.ensemble import Ensemble
from fixel.simulation.rollouts import RolloutCase
from fixel.testbed.repeated_pushes import repeat_pushes
from fixel.testbed.simulated import SimulatedTestbed
from fixel.typing import FloatArray
from fixel.uncertainty.starts import StartError
from fixel.units import deg, mm

SEED: Final = 18_001
RUNS: Final = 200  # executions of a plan
EXPERIMENTS: Final = 8  # recorded before planning
START: Final = StartError(x=1 * mm, y=1 * mm, theta=1.5 * deg, kind="normal")
ROLLOUTS: Final = 8_000
HARD_MM_DEG, EASY_MM_DEG = 3.0, 5.0
TOOL: Final = Polygon.rectangle(10 * mm, 40 * mm)
MASS, FRICTION = 0.3, 0.25
ROWS: Final = RESULTS / "planning.csv"
KINDS: Final = ("push", "sequence", "grasp")


class Task(NamedTuple):
    """Goal in a scene, what may be chosen, and the world in which it is tried."""

    name: str
    kind: str
    scene: Scene
    goal: Goal
    choose: FreePushes | RigPushes
    world: SimulatedTestbed


class PlanComparison(NamedTuple):
    """Pushes of two plans, and the success that the planner states for them."""

    robust: Sequence[Scene]
    nominal: Sequence[Scene]  # best if nothing were unknown
    stated: float  # mean over samples of the parameters
    low: float  # success in the worst 5 % of these samples
    nominal_stated: float


class Row(NamedTuple):
    """Result of one task."""

    task: str
    kind: str
    stated: float
    low: float
    held: float
    nominal_stated: float
    nominal_held: float
    pushes: int
    seconds: float


Planner = Callable[[Task, Belief, int], PlanComparison]


def run(size: Size) -> list[Figure]:
    """Stated against held success, and the robust plan against the nominal one."""
    full = size.rollouts >= 500
    number, runs, rollouts = (30, RUNS, ROLLOUTS) if full else (2, 10, 4_000)
    rows = []
    for task in tasks(number):
        rows.append(compared(task, runs, rollouts))
        print(*(f"{x:.3f}" if isinstance(x, float) else x for x in rows[-1]), flush=True)
    if full:
        with ROWS.open("w", newline="") as stream:
            csv.writer(stream).writerows([Row._fields, *rows])
    return figures(rows, bar=full)


def figures(rows: Sequence[Row], *, bar: bool) -> list[Figure]:
    """Figures of all tasks; the harder half is that in which nominal plans hold less."""
    stated, low, held, nominal = (
        np.array([getattr(row, name) for row in rows])
        for name in ("stated", "low", "held", "nominal_held")
    )
    hard = np.argsort(nominal, kind="stable")[: max(1, len(rows) // 2)]
    below = 100.0 * float((held < low).mean())
    gain = 100.0 * float((held - nominal)[hard].mean())
    off = 100.0 * float(np.abs(stated - held).mean())
    limit = at_least(20.0) if bar else None
    return [
        Figure("plans, stated less held success", "points", (off,), at_most(5.0) if bar else None),
        Figure("plans, held below 5 % quantile", "%", (below,), at_most(10.0) if bar else None),
        Figure("plans, robust less nominal, hard half", "points", (gain,), limit),
        Figure("plans, success held", "%", (100.0 * float(held.mean()),)),
        Figure("plans, time of a plan", "s", (float(np.median([r.seconds for r in rows])),)),
    ]  # fmt: skip


def compared(task: Task, runs: int, rollouts: int, planner: Planner | None = None) -> Row:
    """Plan a task robustly and nominally, and carry both plans out."""
    find = planner or planned
    fit = fixel.calibrate(
        recorded(task), unknowns(task), motion="quasistatic", threads=1, progress=False
    )
    begun = time.perf_counter()
    found = find(task, Belief(parameters=fit, start=START), rollouts)
    return Row(
        task.name, task.kind, found.stated, found.low, held(task, found.robust, runs),
        found.nominal_stated, held(task, found.nominal, runs), len(found.robust),
        time.perf_counter() - begun,
    )  # fmt: skip


def planned(task: Task, belief: Belief, rollouts: int) -> PlanComparison:
    """Plan with `fixel.plan`."""
    plan = fixel.plan(
        task.scene, task.goal, task.choose, belief, rollouts=rollouts, threads=1, progress=False,
        untrusted=True,
    )  # fmt: skip
    simulator = simulator_of(plan.scene, task.goal, task.choose, belief, None, None, 1)
    search = PlanSearch(simulator=simulator, belief=belief, rollouts=rollouts)
    other = simulator.planned(search.candidates()[0][None])
    return PlanComparison(
        plan.scenes,
        pushes_of(plan.scene, other.start[0], other.path[0]),
        plan.success.mean, plan.success.stated, plan.nominal_success.mean,
    )  # fmt: skip


def pushes_of(scene: Scene, start: FloatArray, path: FloatArray) -> list[Scene]:
    """Scenes of planned pushes in the world; no task moves fixels."""
    return [scene_of_push(scene, *own) for own in zip(start, path, strict=True)]


def held(task: Task, pushes: Sequence[Scene], runs: int) -> float:
    """Share of executions in the world of a task that meet the goal."""
    rng = np.random.default_rng([task.world.seed, 2])
    starts = pushes[0].bodies[0].pose + rng.standard_normal((runs, 3)) * START.size
    done = repeat_pushes(task.world, pushes, starts, threads=1)
    met = task.goal.met(done.scene, BodyTrack(done.pose[:, 1:], done.stalled, done.force))
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
    goal = PoseRegion(end, position=size * mm, angle=size * deg)
    return Task(f"{name} {kind} within {size:g} mm and deg", kind, scene, goal, choose, world)


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
    goal = Seated(*mode)
    choose = RigPushes(y=(-30 * mm, 30 * mm), theta=(-45 * deg, 45 * deg))
    title = f"{name} {own.conditions['shape']}, {own.conditions['layout']}, {len(mode)} fixels"
    return Task(title, "grasp", scene, goal, choose, world)


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
