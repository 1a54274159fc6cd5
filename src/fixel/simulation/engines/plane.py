"""Parts that adapters of several engines share."""

from __future__ import annotations

import math
from collections.abc import Iterator

from fixel.simulation.engines.task import PlainTask, Segment, segments

MAX_FRICTION = 2.0  # of Drake: no partner has a larger harmonic mean with 1


def planar_refusal(task: PlainTask) -> str:
    """Return what of a task an engine with point joints cannot represent."""
    if (task.body.arms > 0.0).any():
        return "an ellipsoidal limit surface; it takes support points"
    return drive_refusal(task)


def drive_refusal(task: PlainTask) -> str:
    """Return a drive that an adapter cannot represent; empty for others."""
    if task.pusher is not None and task.pusher.force_limit is not None:
        return "a drive with a force limit; it takes drives that nothing slows down"
    return ""


def steps_of(task: PlainTask, step: float) -> Iterator[tuple[Segment, int, float]]:
    """Yield segments with the number and the length [s] of their steps, at most `step` each."""
    for segment in segments(task):
        n = math.ceil(segment.duration / step * (1.0 - 1e-9))
        yield segment, n, segment.duration / n


def harmonic_partner(friction: float) -> float:
    """Return the coefficient that combines with 1 to `friction`: Drake takes the harmonic mean."""
    return friction / (2.0 - friction)
