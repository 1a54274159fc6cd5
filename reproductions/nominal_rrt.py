"""Plans of a rapidly exploring random tree over nominal simulations, as a baseline.

The planner of the ASME paper's group grew a tree in the poses of the part: arcs are pushes of the
probe in a simulation without errors. A plan is done where a node meets the goal; nothing makes it
robust.

Source: LaValle & Kuffner (2001) for the tree; Cappelleri et al. (ICRA 2006) for its use.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from fixel.planning.candidates import goal_poses
from fixel.planning.rollout import CARRIED_OUT, PlanSimulator
from fixel.typing import FloatArray

TARGETS: Final = 16  # random poses at a time, each of which the tree grows towards
TRIED: Final = 8  # random pushes from the node nearest to each
MAX_ROUNDS: Final = 150
MAX_PUSHES: Final = 12


def nominal_rrt(simulator: PlanSimulator, seed: int) -> FloatArray | None:
    """Grow a tree until a node meets the goal; return the pushes (k, d) to it.

    Parameters
    ----------
    simulator : PlanSimulator
    seed : int

    Returns
    -------
    (k, d) float64 or None
        None where the tree did not reach the goal.
    """
    rng = np.random.default_rng([seed, 2006])
    scene = simulator.scene
    radius = float(scene.bodies[0].shape.radius)
    low, high = simulator.choice.bounds(scene)
    poses = np.array(scene.bodies[0].pose, np.float64)[None]
    plans: list[FloatArray] = [np.zeros((0, len(low)))]
    places = [scene.bodies[0].pose[:2], *(fixel.pose[:2] for fixel in scene.fixels)]
    around = np.vstack((places, goal_poses(scene, simulator.goal)[:, :2]))
    box = around.min(axis=0) - radius, around.max(axis=0) + radius
    for _ in range(MAX_ROUNDS):
        targets = np.column_stack(
            (rng.uniform(*box, size=(TARGETS, 2)), rng.uniform(-np.pi, np.pi, TARGETS))
        )
        nearest = np.argmin(_distance(targets[:, None], poses[None], radius), axis=1)
        start = np.repeat(nearest, TRIED)
        numbers = rng.uniform(low, high, (len(start), 1, len(low)))
        done = simulator.planned(numbers, poses[start])
        end = done.nominal.pose[:, -1]
        good = ~done.collides & (done.nominal.failure == CARRIED_OUT)
        reached = np.flatnonzero(good & (simulator.margins(done.nominal) >= 0.0))
        if len(reached):
            first = reached[0]
            return np.vstack((plans[start[first]], numbers[first]))
        off = _distance(np.repeat(targets, TRIED, axis=0), end, radius)
        off = np.where(good, off, np.inf).reshape(TARGETS, TRIED)
        for row, best in enumerate(np.argmin(off, axis=1)):
            k = row * TRIED + best
            if np.isfinite(off[row, best]) and len(plans[start[k]]) < MAX_PUSHES:
                poses = np.vstack((poses, end[k]))
                plans.append(np.vstack((plans[start[k]], numbers[k])))
    return None


def _distance(a: FloatArray, b: FloatArray, radius: float) -> FloatArray:
    """Return distances of poses (..., 3), with angles as ways at the radius of the part [m]."""
    turn = np.abs((a[..., 2] - b[..., 2] + np.pi) % (2.0 * np.pi) - np.pi)
    return np.asarray(np.hypot(np.hypot(*np.moveaxis((a - b)[..., :2], -1, 0)), radius * turn))
