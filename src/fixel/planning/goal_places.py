"""Places of a goal: poses that meet it, and the poses around it."""

from __future__ import annotations

import math

import numpy as np

from fixel.model import Scene
from fixel.model.goals import Beyond, Goal, Inside, PoseRegion, Seated
from fixel.typing import FloatArray


def goal_poses(scene: Scene, goal: Goal) -> FloatArray:
    """Return poses (n, 3) in the middle of the pose regions of a goal."""
    body = scene.bodies[0]
    found = [own.targets(body) for own in goal.clauses if isinstance(own, PoseRegion)]
    return np.vstack([np.zeros((0, 3)), *found])


def needs_fixtures(goal: Goal) -> bool:
    """Return whether a goal is about more than the pose: contacts, or a region."""
    return any(not isinstance(own, PoseRegion) for own in goal.clauses)


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
