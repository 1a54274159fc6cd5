"""Compiled loops over environments: control of the agent, motion of the body, and coverage.

Lengths are pixels here, times seconds. Each function calls nothing outside this file, so that
Numba's check of the file suffices for its cache.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fixel.kernels.jit import entry, kernel
from fixel.typing import FloatArray, IntArray

MAX_CORNERS = 16  # of the intersection of two quadrilaterals, with room for rounding


class AgentState(NamedTuple):
    """State of n environments with an agent that pushes a body."""

    agent: FloatArray  # (n, 4) x, y [px], velocity [px/s]
    body: FloatArray  # (n, 3) pose of the centre of mass [px, px, rad]
    sunk: FloatArray  # (n,) overlap of agent and body that is left from the start [px]
    route: FloatArray  # (n, 1 + substeps, 2) places of the agent in the last step [px]
    outcome: IntArray  # (n,) see MOVED
    settled: IntArray  # (n,) 0 until a body placed at random has been moved out of the walls


# Outcomes of a control step.
STILL = 0  # the body was not touched
MOVED = 1
STALLED = 2  # the agent could not move on, and stopped


class Control(NamedTuple):
    """Constants of the control, and of the region where nothing can be touched."""

    stiffness: float  # of the controller [1/s^2]
    damping: float  # [1/s]
    dt: float  # of a substep [s]
    radius: float  # of the agent [px]
    reach: float  # of the body from its centre of mass [px]
    decay: float  # share of the overlap that is left after a control step
    slop: float  # overlap that stays, and least gap of an agent that touches nothing [px]
    per_pixel: float  # scaled length of a pixel
    per_second: float  # scaled time of a second


class Rows(NamedTuple):
    """Arrays of a batch that change from step to step, and their constant sources."""

    begin: IntArray  # (n, n_family) of `Batch`
    source: IntArray  # (n, n_family) rows that belong to environment k
    plane: FloatArray  # (n, 3) of `Model`
    plane_source: FloatArray  # (n, 3)
    pose: FloatArray  # (n, n_body, 3) of `Batch`
    path: FloatArray  # (n, 1 + substeps, 4) of `Model`
    piece_radius: FloatArray  # (n, n_piece)
    piece_bound: FloatArray  # (n, n_piece, 3)
    piece: int  # that of the agent
    extra: FloatArray  # (n,) excess of the agent's radius [px]
    place: IntArray  # (n,) environment of each rollout


@kernel
def _control_agent(state: AgentState, control: Control, k: int, ax: float, ay: float) -> float:
    """Move the agent towards (ax, ay) for one control step; return how far it went at most."""
    x, y, vx, vy = state.agent[k, 0], state.agent[k, 1], state.agent[k, 2], state.agent[k, 3]
    x0, y0 = x, y
    farthest = 0.0
    state.route[k, 0, 0] = x
    state.route[k, 0, 1] = y
    for i in range(1, state.route.shape[1]):
        vx += (control.stiffness * (ax - x) + control.damping * (0.0 - vx)) * control.dt
        vy += (control.stiffness * (ay - y) + control.damping * (0.0 - vy)) * control.dt
        x += vx * control.dt
        y += vy * control.dt
        state.route[k, i, 0] = x
        state.route[k, i, 1] = y
        farthest = max(farthest, math.hypot(x - x0, y - y0))
    state.agent[k, 0] = x
    state.agent[k, 1] = y
    state.agent[k, 2] = vx
    state.agent[k, 3] = vy
    return farthest


@kernel
def _may_touch(
    state: AgentState, outline: FloatArray, k: int, reach: float, radius: float, far: float
) -> bool:
    """Whether an agent of a radius may touch its body, which rests until then.

    `reach` is that of the body, `far` how far the agent goes from its start at most.
    """
    bx, by = state.body[k, 0], state.body[k, 1]
    away = math.hypot(state.route[k, 0, 0] - bx, state.route[k, 0, 1] - by)
    if away - far > reach + radius:
        return False
    n = outline.shape[0]
    if n == 0 or state.sunk[k] > 0.0:
        return True
    c, s = math.cos(state.body[k, 2]), math.sin(state.body[k, 2])
    way_x = way_y = x = y = 0.0
    for i in range(state.route.shape[1]):
        dx, dy = state.route[k, i, 0] - bx, state.route[k, i, 1] - by
        before_x, before_y, x, y = x, y, c * dx + s * dy, c * dy - s * dx
        if i > 0:
            way_x, way_y = x - before_x, y - before_y
        # Edges are near an end of the way from the last place, within half of it; corners may be
        # nearer to its middle.
        limit = radius + 0.5 * math.hypot(way_x, way_y)
        square = max(way_x * way_x + way_y * way_y, 1e-300)
        for j in range(n):
            ax, ay = outline[j, 0], outline[j, 1]
            ex, ey = outline[(j + 1) % n, 0] - ax, outline[(j + 1) % n, 1] - ay
            u = ((x - ax) * ex + (y - ay) * ey) / (ex * ex + ey * ey)
            u = min(max(u, 0.0), 1.0)
            gx, gy = x - ax - u * ex, y - ay - u * ey
            u = min(max(((x - ax) * way_x + (y - ay) * way_y) / square, 0.0), 1.0)
            hx, hy = x - ax - u * way_x, y - ay - u * way_y
            near = hx * hx + hy * hy <= radius * radius
            if near or gx * gx + gy * gy <= limit * limit:
                return True
    return False


@entry
def begin_step(
    state: AgentState,
    control: Control,
    rows: Rows,
    outline: FloatArray,
    action: FloatArray,
    first: int,
    last: int,
) -> int:
    """Move the agents, and write the rollouts of the bodies that they may touch.

    Corners (m, 2) of the body are about its centre of mass, none for a disk; actions (n, 2) are
    targets of the agents [px]. The rollouts written for the environments `first` to ``last - 1``
    are those from `first` to before the value returned.
    """
    n = first
    for k in range(first, last):
        far = _control_agent(state, control, k, action[k, 0], action[k, 1])
        x, y = state.body[k, 0], state.body[k, 1]
        state.outcome[k] = STILL
        near = control.radius + rows.extra[k] + control.slop
        if state.settled[k] == 1 and not _may_touch(state, outline, k, control.reach, near, far):
            continue
        state.settled[k] = 1
        over = state.sunk[k] - control.slop
        if over > 0.0:
            state.sunk[k] = control.slop + over * control.decay
        radius = max(control.radius + rows.extra[k] - state.sunk[k], 0.01) * control.per_pixel
        rows.place[n] = k
        for j in range(rows.begin.shape[1]):
            rows.begin[n, j] = rows.source[k, j]
        for j in range(3):
            rows.plane[n, j] = rows.plane_source[k, j]
        rows.piece_bound[k, rows.piece, 2] = radius
        rows.piece_radius[k, rows.piece] = radius
        rows.pose[k, 0, 0] = x * control.per_pixel
        rows.pose[k, 0, 1] = y * control.per_pixel
        rows.pose[k, 0, 2] = state.body[k, 2]
        for i in range(state.route.shape[1]):
            rows.path[k, i, 0] = i * control.dt * control.per_second
            rows.path[k, i, 1] = state.route[k, i, 0] * control.per_pixel
            rows.path[k, i, 2] = state.route[k, i, 1] * control.per_pixel
        for j in range(2):
            rows.pose[k, 1, j] = rows.path[k, 0, 1 + j]
        n += 1
    return n


@entry
def end_step(
    state: AgentState,
    control: Control,
    rows: Rows,
    pose: FloatArray,
    samples: IntArray,
    status: IntArray,
    reached: FloatArray,
    first: int,
    last: int,
) -> None:
    """Read the rollouts `first` to ``last - 1`` back into the states of their environments.

    An agent stops where its rollout ended early: no motion of the body lets it move on. Each
    rollout has a scaled end pose (n, 3), a number of poses written (n,), a status (n,), and the
    scaled time (n,) that it reached.
    """
    n = state.route.shape[1] - 1
    for r in range(first, last):
        k = rows.place[r]
        ok = samples[r] > 0
        for j in range(3):
            ok = ok and math.isfinite(pose[r, j])
        if ok:
            x = pose[r, 0] / control.per_pixel
            y = pose[r, 1] / control.per_pixel
            if x != state.body[k, 0] or y != state.body[k, 1] or pose[r, 2] != state.body[k, 2]:
                state.outcome[k] = MOVED
            state.body[k, 0] = x
            state.body[k, 1] = y
            state.body[k, 2] = pose[r, 2]
        if ok and status[r] == 0:
            continue
        time = reached[r] / (control.dt * control.per_second) if ok else 0.0
        i = min(int(time), n - 1)
        u = min(max(time - i, 0.0), 1.0)
        for j in range(2):
            a = state.route[k, i, j]
            state.agent[k, j] = a + u * (state.route[k, i + 1, j] - a)
            state.agent[k, 2 + j] = 0.0
        state.outcome[k] = STALLED


@kernel
def _clip(
    polygon: FloatArray, n: int, ax: float, ay: float, bx: float, by: float, out: FloatArray
) -> int:
    """Clip a polygon of n corners at the line from a to b, and keep what is left of it."""
    m = 0
    ex, ey = bx - ax, by - ay
    px, py = polygon[n - 1, 0], polygon[n - 1, 1]
    before = ex * (py - ay) - ey * (px - ax)
    for i in range(n):
        qx, qy = polygon[i, 0], polygon[i, 1]
        side = ex * (qy - ay) - ey * (qx - ax)
        if (side >= 0.0) != (before >= 0.0):
            u = before / (before - side)
            out[m, 0] = px + u * (qx - px)
            out[m, 1] = py + u * (qy - py)
            m += 1
        if side >= 0.0:
            out[m, 0] = qx
            out[m, 1] = qy
            m += 1
        px, py, before = qx, qy, side
    return m


@kernel
def _common_area(one: FloatArray, other: FloatArray, here: FloatArray, there: FloatArray) -> float:
    """Area of the intersection of two convex quadrilaterals, both counter-clockwise."""
    n = 4
    for i in range(4):
        here[i, 0] = one[i, 0]
        here[i, 1] = one[i, 1]
    for i in range(4):
        k = (i + 1) % 4
        n = _clip(here, n, other[i, 0], other[i, 1], other[k, 0], other[k, 1], there)
        here, there = there, here
        if n < 3:
            return 0.0
    area = 0.0
    for i in range(1, n - 1):
        ax, ay = here[i, 0] - here[0, 0], here[i, 1] - here[0, 1]
        bx, by = here[i + 1, 0] - here[0, 0], here[i + 1, 1] - here[0, 1]
        area += 0.5 * (ax * by - ay * bx)
    return area


@entry
def coverage(
    pose: FloatArray, pieces: FloatArray, goal: FloatArray, first: int, last: int, out: FloatArray
) -> None:
    """Compute which share of the goal each of the bodies `first` to ``last - 1`` covers.

    The shares `out` (n,) are from 0 to 1. Pieces (n_piece, 4, 2) are quadrilaterals of the shape in
    its frame, counter-clockwise, without overlap [px]; `goal` has the same in the world. Poses
    (n, 3) are of the shapes [px, px, rad].
    """
    here = np.empty((MAX_CORNERS, 2))
    there = np.empty((MAX_CORNERS, 2))
    placed = np.empty((4, 2))
    whole = 0.0
    for g in range(goal.shape[0]):
        whole += _common_area(goal[g], goal[g], here, there)
    for k in range(first, last):
        c, s = math.cos(pose[k, 2]), math.sin(pose[k, 2])
        area = 0.0
        for p in range(pieces.shape[0]):
            for i in range(4):
                x, y = pieces[p, i, 0], pieces[p, i, 1]
                placed[i, 0] = pose[k, 0] + (c * x - s * y)
                placed[i, 1] = pose[k, 1] + (s * x + c * y)
            for g in range(goal.shape[0]):
                area += _common_area(placed, goal[g], here, there)
        out[k] = area / whole
