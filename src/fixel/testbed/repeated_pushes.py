"""Planned pushes carried out many times on the simulated testbed, without camera and records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from fixel.errors import InvalidInput
from fixel.model import PlannedExperiment, Scene
from fixel.simulation.batch import simulate_batch
from fixel.testbed.simulated import SimulatedTestbed
from fixel.typing import BoolArray, FloatArray

LATE: Final = 1.1  # duration of a push over the planned one: slow drives also reach their end


class RepeatedPushes(NamedTuple):
    """n runs of the same pushes."""

    pose: FloatArray  # (n, n_push + 1, 3) true poses of the part: at the start, after each push
    force: FloatArray  # (n,) force of the drive at the end of the last push [N]
    stalled: BoolArray  # (n,) whether the drive is stalled then
    failure: tuple[str, ...]  # (n,) why a run could not be finished; empty for others
    scene: Scene  # true scene, with the true size of the part


def repeat_pushes(
    testbed: SimulatedTestbed,
    pushes: Sequence[Scene],
    starts: FloatArray,
    *,
    name: str = "trial",
    threads: int | None = None,
) -> RepeatedPushes:
    """Carry out pushes one after the other, without seeing the part, n times.

    Every run has its own conditions: friction, centre of pressure and speed, which do not change
    between its pushes. The plate and the underside of the part are the same in all runs.

    Scenes have the path of the tool; instead of the part's pose in the first, `starts` (n, 3) has
    its true poses [m, m, rad]. Trials of another name have other random conditions. A run in which
    the tool would be put down on the part, or the part does not fit between fixels, ends before
    that push. Results are bit for bit the same for any number of threads. No push, no start, or a
    scene that is no push of one body raises `InvalidInput`.

    Examples
    --------
    >>> import numpy as np
    >>> from fixel.testbed.simulated import SimulatedTestbed
    >>> from fixel.testing.scenes import grasp
    >>> starts = np.tile(grasp().bodies[0].pose, (3, 1))
    >>> repeat_pushes(SimulatedTestbed(seed=4), [grasp()], starts, threads=1).stalled
    array([ True,  True,  True])
    """
    if not pushes or not len(starts):
        raise InvalidInput("pushes", found="none", expected="one push and one start at least")
    n = len(starts)
    pose = np.repeat(np.asarray(starts, np.float64)[:, None], len(pushes) + 1, axis=1)
    force, stalled, failure = np.zeros(n), np.zeros(n, bool), [""] * n
    true = testbed.true_scene(PlannedExperiment(name=f"{name}-0", scene=pushes[0]))
    for k, push in enumerate(pushes):
        scenes = {}
        for r in np.flatnonzero(np.equal(failure, "")).tolist():
            try:
                planned = PlannedExperiment(name=f"{name}-{r}", scene=_at(push, pose[r, k]))
                scenes[r] = testbed.true_scene(planned)
            except InvalidInput as problem:
                failure[r] = f"push {k + 1} cannot begin: {problem}"
        done = simulate_batch(list(scenes.values()), threads=threads)
        for r, run in zip(scenes, done, strict=True):
            pose[r, k + 1 :] = run.pose[0, -1, 0]
            force[r], stalled[r] = run.force[0, 0], run.stalled[0, 0]
            status = str(run.status[0])
            failure[r] = "" if status == "converged" else f"{status} in push {k + 1}"
    return RepeatedPushes(pose, force, stalled, tuple(failure), true)


def _at(push: Scene, pose: FloatArray) -> Scene:
    """Return a push of the part at another pose; raises where it overlaps the tool or a fixel."""
    body = replace(push.bodies[0], pose=pose)
    return replace(push, bodies=(body,), duration=LATE * push.duration)
