"""Candidate plans: single pushes, and sequences joined from a table of displacements."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from fixel.errors import InvalidInput
from fixel.model import Disk, Scene
from fixel.model.goals import Beyond, BodyTrack, Goal, Inside, PoseRegion, Seated, tolerance_of
from fixel.planning.belief import Belief
from fixel.planning.geometric import fence_pushes, geometric_pushes
from fixel.planning.pushes import FreePushes, PushChoice
from fixel.planning.rollout import CARRIED_OUT, PlanSimulator, others_overlap, part_overlap
from fixel.simulation.vary import composed, inverted
from fixel.typing import FloatArray
from fixel.uncertainty.error_terms import even_points

LIBRARY: Final = (1024, 2048)  # least and largest number of pushes in the table of displacements
EACH: Final = 40  # rollouts of a search for each of them
TRIED: Final = 4  # poses near the goal for each of them, from which last pushes are tried
WITHIN: Final = 16_384  # poses about a region, of which those inside are taken
NARROWED: Final = 6  # times that this is repeated where there are few
ENOUGH: Final = 64
PERTURBED: Final = 8  # starts from which a last push is judged
CHAINS: Final = 131_072  # sequences joined from the table
JOINED: Final = 768  # sequences kept for each number of pushes

Numbers = list[FloatArray]  # a plan each: (k, d) numbers of its pushes


def spread_pushes(scene: Scene, choice: PushChoice, n: int, seed: int) -> FloatArray:
    """Return numbers (n, 1, d) of single pushes, evenly spread over the ranges of the choice."""
    low, high = choice.bounds(scene)
    wide = np.flatnonzero(high > low)
    numbers = np.tile(low, (n, 1))
    if len(wide):
        numbers[:, wide] += (high - low)[wide] * even_points(n, len(wide), seed)
    return numbers[:, None]


def plans_of_mechanics(simulator: PlanSimulator) -> Numbers:
    """Return plans towards the poses of the goal that mechanics propose.

    For a round tool these are pushes by the closed form of a sticking contact, for a fence wider
    than the part those that orient it from any angle.
    """
    scene, choice = simulator.scene, simulator.choice
    if not isinstance(choice, FreePushes):
        return []
    body, tool = scene.bodies[0], scene.pushers[0]
    low, high = choice.bounds(scene)
    length = (float(low[2]), float(high[2]))
    start = np.asarray(body.pose, np.float64)[None]
    found: Numbers = []
    for pose in goal_poses(scene, simulator.goal):
        # Nothing is proposed for disks, for parts without friction, and where the goal is met.
        with suppress(InvalidInput):
            if isinstance(tool.shape, Disk):
                pushes = geometric_pushes(
                    body, composed(inverted(start), pose)[0], friction=tool.friction,
                    tool_radius=tool.shape.radius, angle=choice.angle, length=length,
                )  # fmt: skip
                found += list(pushes[:, None])
            elif np.ptp(tool.shape.outline[:, 1]) >= 2.0 * body.shape.radius:
                found += fence_pushes(
                    body, float(pose[2]), most=choice.most, angle=choice.angle, length=length
                )
    straight = np.clip(0.0, low[3:], high[3:])  # where the tool may turn
    return [np.hstack((plan, np.tile(straight, (len(plan), 1)))) for plan in found]


class PushTable(NamedTuple):
    """Displacements of the part by pushes away from all fixels."""

    numbers: FloatArray  # (n, d)
    moved: FloatArray  # (n, 3) pose after the push in the frame of the part before it
    spread: FloatArray  # (3,) median standard deviation of the ends [m, m, rad]


def displacements(
    simulator: PlanSimulator, belief: Belief, rollouts: int, seed: int = 0
) -> PushTable:
    """Simulate pushes of the part alone; the plane is even, so that any place will do."""
    n = 2 ** int(np.log2(np.clip(rollouts / EACH, *LIBRARY)))
    alone = replace(simulator.alone)  # whose rollouts are counted here
    numbers = spread_pushes(alone.scene, alone.choice, n, seed)
    planned = alone.planned(numbers)
    good = planned.nominal.failure == CARRIED_OUT
    planned, numbers = planned.rows(np.flatnonzero(good)), numbers[good]
    some = np.linspace(0, len(numbers) - 1, 64).astype(np.int64)
    scenarios = belief.scenarios(alone.scene, worlds=16, runs=1, seed=seed)
    runs = alone.run(
        planned, np.repeat(some, 16), scenarios.rows(np.tile(np.arange(16), len(some)))
    )
    ends = runs.pose[:, -1].reshape(len(some), 16, 3)
    spread = np.median(ends.std(axis=1), axis=0)
    simulator.rollouts += alone.rollouts
    return PushTable(numbers[:, 0], planned.nominal.pose[:, -1], spread)


def sequences(
    simulator: PlanSimulator,
    table: PushTable,
    ends: tuple[FloatArray, FloatArray],
    pushes: int,
    seed: int = 0,
) -> Numbers:
    """Return sequences of `pushes` pushes whose nominal end is near the goal.

    The pushes before the last one are taken from the table, so that they lead to a pose from which
    a last push of `ends` (see `last_pushes`) reaches the goal.
    """
    before, last = ends
    if not len(last):
        return []
    rng = np.random.default_rng([seed, pushes])
    start = np.asarray(simulator.scene.bodies[0].pose, np.float64)
    chain = np.zeros((0, 0), np.int64)
    if pushes == 2:
        chain = np.arange(len(table.moved))[:, None]
    else:
        chain = rng.integers(len(table.moved), size=(CHAINS, pushes - 1))
    pose = np.tile(start, (len(chain), 1))
    for k in range(chain.shape[1]):
        pose = composed(pose, table.moved[chain[:, k]])
    arm = np.sqrt(simulator.scene.bodies[0].shape.unit_inertia)
    tree = cKDTree(embedded(pose, arm))
    distance, nearest = tree.query(embedded(before, arm), k=min(8, len(pose)))
    distance, nearest = distance.reshape(len(before), -1), nearest.reshape(len(before), -1)
    order = np.argsort(distance, axis=None, kind="stable")[:JOINED]
    rows, columns = np.unravel_index(order, distance.shape)
    return [
        np.vstack((table.numbers[chain[nearest[r, c]]], last[r][None]))
        for r, c in zip(rows, columns, strict=True)
    ]


def last_pushes(
    simulator: PlanSimulator, table: PushTable, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Return last pushes (n, d), tried from poses near the goal, the least sensitive first.

    They are judged from perturbed starts, and come after the poses (n, 3) of the part before them.
    """
    tried, kept = TRIED * len(table.moved), max(32, len(table.moved) // 8)
    rng = np.random.default_rng([seed, 77])
    before, numbers = [], []
    scene, goal = simulator.scene, simulator.goal
    for pose in goal_poses(scene, goal):
        before.append(composed(pose[None], inverted(table.moved)))
        numbers.append(table.numbers)
    if not all(isinstance(own, PoseRegion) for own in goal.clauses):  # contacts, or a region
        low, high = surroundings(scene, goal)
        even = even_points(tried, 3, seed)
        before.append(low + (high - low) * even)
        numbers.append(table.numbers[rng.integers(len(table.numbers), size=tried)])
    within = poses_within(simulator, seed)
    if len(within):
        rows, ends = rng.integers((len(table.moved), len(within)), size=(tried, 2)).T
        before.append(composed(within[ends], inverted(table.moved[rows])))
        numbers.append(table.numbers[rows])
    poses, pushes = np.vstack(before), np.vstack(numbers)
    planned = simulator.planned(pushes[:, None], poses)
    margin = np.where(planned.collides, -np.inf, simulator.margins(planned.nominal))
    # Poses inside a fixel or another part are impossible starts.
    scene, others = simulator.simulated, simulator.others(len(poses))
    on_other = others_overlap(scene, scene.bodies[0].shape, poses, others) > 0.0
    margin[on_other | (part_overlap(scene, poses, None) > 0.0)] = -np.inf
    rows = np.flatnonzero(margin >= 0.0)
    rows = rows[np.argsort(-margin[rows], kind="stable")][: 4 * kept]
    if not len(rows):
        return poses[:0], pushes[:0]
    shaken = rng.standard_normal((len(rows) * PERTURBED, 3)) * table.spread
    known = Belief(parameters=simulator.nominal).scenarios(scene, worlds=len(shaken), runs=1)
    runs = simulator.run(planned, np.repeat(rows, PERTURBED), known._replace(start=shaken))
    met = (simulator.margins(runs) >= 0.0).reshape(len(rows), PERTURBED).mean(axis=1)
    best = np.argsort(-met, kind="stable")[:kept]
    return poses[rows[best]], pushes[rows[best]]


def embedded(pose: FloatArray, arm: float) -> FloatArray:
    """Return points (n, 4) whose distances are those of poses, rotations counted at `arm`."""
    turn = arm * np.column_stack((np.cos(pose[:, 2]), np.sin(pose[:, 2])))
    return np.column_stack((pose[:, :2], turn))


def goal_poses(scene: Scene, goal: Goal) -> FloatArray:
    """Return poses (n, 3) in the middle of the pose regions of a goal."""
    body = scene.bodies[0]
    found = [own.targets(body) for own in goal.clauses if isinstance(own, PoseRegion)]
    return np.vstack([np.zeros((0, 3)), *found])


def poses_within(simulator: PlanSimulator, seed: int) -> FloatArray:
    """Return poses (n, 3) of the part inside a region of a goal, and outside all fixels.

    Pushes that end there without fixels lead into slots that random ones hardly ever find.
    """
    scene = simulator.simulated
    regions = [own for own in simulator.goal.clauses if isinstance(own, Inside)]
    if not regions:
        return np.zeros((0, 3))
    rng, body = np.random.default_rng([seed, 78]), scene.bodies[0]
    outline = np.vstack([own.region.outline for own in regions])
    low, high = np.append(outline.min(axis=0), -math.pi), np.append(outline.max(axis=0), math.pi)
    poses, size = low + (high - low) * even_points(WITHIN, 3, seed), high - low
    for _ in range(NARROWED):
        track = BodyTrack.of_ends(poses)
        margins = [tolerance_of(own.tolerance, body) * own.margin(scene, track) for own in regions]
        off = np.maximum(-np.max(margins, axis=0), part_overlap(scene, poses, None))
        good = poses[off <= 0.0]
        if len(good) >= ENOUGH:
            break
        size = size / 4.0  # again, about those that are nearest
        poses = np.repeat(poses[np.argsort(off)[: WITHIN // 16]], 16, axis=0)
        poses = poses + size * rng.uniform(-0.5, 0.5, poses.shape)
    return np.asarray(good)


def surroundings(scene: Scene, goal: Goal) -> tuple[FloatArray, FloatArray]:
    """Return the lower and upper end (3,) of poses from which one push may reach a goal."""
    body = scene.bodies[0]
    radius = float(body.shape.radius)
    fixels = {fixel.name: fixel for fixel in scene.fixels}
    points = [goal_poses(scene, goal)[:, :2]]
    for own in goal.clauses:
        if isinstance(own, Seated):
            points += [fixels[name].pose[None, :2] for name in own.fixels]
        elif isinstance(own, Inside):
            points.append(np.asarray(own.region.outline))
        elif isinstance(own, Beyond):
            points.append(own.line)
    around = np.vstack(points)
    if not len(around):
        around = np.asarray(body.pose)[None, :2]
    low, high = around.min(axis=0) - 2.5 * radius, around.max(axis=0) + 2.5 * radius
    return np.append(low, -math.pi), np.append(high, math.pi)
