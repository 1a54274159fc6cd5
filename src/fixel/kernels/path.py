"""Pose, direction and straight pieces of a pusher's prescribed path."""

import math

from fixel.kernels.jit import kernel, large_kernel
from fixel.typing import FloatArray, IntArray


@kernel
def _waypoint_before(path: FloatArray, low: int, high: int, time: float) -> int:
    """Bisect for the last waypoint at or before a time, from `low` (before) and `high` (after)."""
    while high - low > 1:
        middle = (low + high) // 2
        if path[middle, 0] <= time:
            low = middle
        else:
            high = middle
    return low


@large_kernel
def path_pose(
    path_start: IntArray, path: FloatArray, driven: int, time: float
) -> tuple[float, float, float]:
    """Pose of a pusher at a time of its own clock: linear between waypoints, at rest beyond both
    ends."""
    first = path_start[driven]
    last = path_start[driven + 1] - 1
    if time <= path[first, 0]:
        return path[first, 1], path[first, 2], path[first, 3]
    if time >= path[last, 0]:
        return path[last, 1], path[last, 2], path[last, 3]
    low = _waypoint_before(path, first, last, time)
    high = low + 1
    u = (time - path[low, 0]) / (path[high, 0] - path[low, 0])
    return (
        path[low, 1] + u * (path[high, 1] - path[low, 1]),
        path[low, 2] + u * (path[high, 2] - path[low, 2]),
        path[low, 3] + u * (path[high, 3] - path[low, 3]),
    )


@large_kernel
def path_direction(
    path_start: IntArray, path: FloatArray, driven: int, time: float, step: float
) -> tuple[float, float, float, float]:
    """Unit direction (x, y, turn) and commanded speed of a pusher over the next `step` of its
    clock.

    Beyond the end of the path the commanded speed is zero, along the last direction.
    """
    x0, y0, a0 = path_pose(path_start, path, driven, time)
    x1, y1, a1 = path_pose(path_start, path, driven, time + step)
    dx = x1 - x0
    dy = y1 - y0
    da = a1 - a0
    length = math.sqrt(dx * dx + dy * dy + da * da)
    if length > 1e-14:
        return dx / length, dy / length, da / length, length / step
    k = path_start[driven + 1] - 1
    while k > path_start[driven]:
        dx = path[k, 1] - path[k - 1, 1]
        dy = path[k, 2] - path[k - 1, 2]
        da = path[k, 3] - path[k - 1, 3]
        length = math.sqrt(dx * dx + dy * dy + da * da)
        if length > 1e-14:
            return dx / length, dy / length, da / length, 0.0
        k -= 1
    return 1.0, 0.0, 0.0, 0.0


@large_kernel
def straight_time(
    path_start: IntArray, path: FloatArray, driven: int, time: float, step: float, slack: float
) -> float:
    """Return the longest time from `time`, at most `step`, over which a path is straight.

    Up to there no waypoint lies further than `slack` from uniform motion between both ends, in x,
    y or angle. Where that is shorter than `step`, it ends at a waypoint. One pass: each waypoint
    narrows the interval of velocities that pass all waypoints before it closely enough.
    """
    first = path_start[driven]
    last = path_start[driven + 1] - 1
    if path[last, 0] <= time or path[first, 0] >= time + step:
        return step
    x, y, a = path_pose(path_start, path, driven, time)
    ahead_of = _waypoint_before(path, first - 1, last, time) + 1
    low_x = low_y = low_a = -math.inf
    high_x = high_y = high_a = math.inf
    longest = step
    found = False
    for k in range(ahead_of, last + 1):
        ahead = path[k, 0] - time
        if ahead >= step:
            break
        vx = (path[k, 1] - x) / ahead
        vy = (path[k, 2] - y) / ahead
        va = (path[k, 3] - a) / ahead
        if not found or (low_x <= vx <= high_x and low_y <= vy <= high_y and low_a <= va <= high_a):
            longest = ahead
            found = True
        wide = slack / ahead
        low_x = max(low_x, vx - wide)
        low_y = max(low_y, vy - wide)
        low_a = max(low_a, va - wide)
        high_x = min(high_x, vx + wide)
        high_y = min(high_y, vy + wide)
        high_a = min(high_a, va + wide)
        if low_x > high_x or low_y > high_y or low_a > high_a:
            return longest
    dx, dy, da = path_pose(path_start, path, driven, time + step)
    vx = (dx - x) / step
    vy = (dy - y) / step
    va = (da - a) / step
    if low_x <= vx <= high_x and low_y <= vy <= high_y and low_a <= va <= high_a:
        return step
    return longest
