"""Projected Gauss-Seidel, contact by contact: robust, but slow to converge to the last digit.

A block without inertia (quasi-static bodies, drives) gets an inertia equal to its stiffness, and a
pull towards its velocity of the previous sweep, a proximal-point iteration. The pull vanishes at a
fixed point, so that the fixed points are exactly the solutions of the problem.

Source: Jourdan, Alart & Jean (1998) for the contacts; Rockafellar (1976) for the proximal pull.
"""

import math

from fixel.kernels.arrays import N_CONTACT, N_DOF, N_ELEMENT, N_FREE_DOF, Problem, Workspace
from fixel.kernels.jit import kernel
from fixel.kernels.linear import invert_block
from fixel.typing import FloatArray


@kernel
def gauss_seidel(problem: Problem, work: Workspace, tolerance: float, max_sweeps: int) -> float:
    """Sweep until the largest velocity change of a sweep is below `tolerance`; returns that
    change."""
    _prepare(problem, work)
    change = math.inf
    for _ in range(max_sweeps):
        change = _pull(problem, work)
        change = max(change, _sweep_elements(problem, work))
        change = max(change, _sweep_contacts(problem, work))
        if not change > tolerance:
            break
    return change


@kernel
def _prepare(problem: Problem, work: Workspace) -> None:
    """Invert every block of the inertia, and compute the velocities from the impulses."""
    n_dof = problem.size[N_DOF]
    n_free = problem.size[N_FREE_DOF]
    v = problem.velocity
    inverse = work.inverse
    for o in range(0, n_free, 3):
        # The proximal mass only where the block has little inertia of its own.
        own = problem.inertia[o, 0]
        pull = 0.0 if own > 1e-3 * problem.stiffness[o] else problem.stiffness[o]
        for k in range(3):
            work.pull[o + k] = pull
        d = problem.inertia
        invert_block(
            inverse, o, d[o, 0] + pull, d[o, 1], d[o, 2], d[o + 1, 1] + pull, d[o + 1, 2],
            d[o + 2, 2] + pull,
        )  # fmt: skip
    for o in range(n_free, n_dof):
        work.pull[o] = problem.stiffness[o]
        inverse[o, 0] = 1.0 / (problem.inertia[o, 0] + work.pull[o])
        inverse[o, 1] = 0.0
        inverse[o, 2] = 0.0
    right = work.right
    for o in range(n_dof):
        work.centre[o] = v[o]
        right[o] = problem.momentum[o] + work.pull[o] * v[o]
    for i in range(problem.size[N_CONTACT]):
        for side in range(2):
            o = problem.contact_dof[i, side]
            if o >= 0:
                for k in range(3):
                    right[o + k] += (
                        problem.normal[i, 3 * side + k] * problem.impulse[i, 0]
                        + problem.tangent[i, 3 * side + k] * problem.impulse[i, 1]
                    )
    for e in range(problem.size[N_ELEMENT]):
        o = problem.element_dof[e]
        for j in range(3):
            for k in range(3):
                right[o + k] += problem.element_row[e, j, k] * problem.element_impulse[e, j]
    for o in range(0, n_free, 3):
        for k in range(3):
            v[o + k] = 0.0
            for m in range(3):
                v[o + k] += inverse[o + k, m] * right[o + m]
    for o in range(n_free, n_dof):
        v[o] = inverse[o, 0] * right[o]


@kernel
def _pull(problem: Problem, work: Workspace) -> float:
    """Move the proximal centres to the present velocities."""
    n_free = problem.size[N_FREE_DOF]
    v = problem.velocity
    largest = 0.0
    for o in range(0, n_free, 3):
        if work.pull[o] == 0.0:
            continue
        d0 = work.pull[o] * (v[o] - work.centre[o])
        d1 = work.pull[o] * (v[o + 1] - work.centre[o + 1])
        d2 = work.pull[o] * (v[o + 2] - work.centre[o + 2])
        for k in range(3):
            work.centre[o + k] = v[o + k]
        for k in range(3):
            dv = (
                work.inverse[o + k, 0] * d0
                + work.inverse[o + k, 1] * d1
                + work.inverse[o + k, 2] * d2
            )
            v[o + k] += dv
            largest = max(largest, abs(dv))
    for o in range(n_free, problem.size[N_DOF]):
        dv = work.inverse[o, 0] * work.pull[o] * (v[o] - work.centre[o])
        work.centre[o] = v[o]
        v[o] += dv
        largest = max(largest, abs(dv))
    return largest


@kernel
def _compliance(
    problem: Problem, work: Workspace, rows: FloatArray, i: int, start: int, o: int
) -> float:
    """Velocity along a row of block o per unit impulse along it."""
    n_free = problem.size[N_FREE_DOF]
    total = 0.0
    if o >= n_free:
        return rows[i, start] * rows[i, start] * work.inverse[o, 0]
    for k in range(3):
        for m in range(3):
            total += rows[i, start + k] * work.inverse[o + k, m] * rows[i, start + m]
    return total


@kernel
def _push(problem: Problem, work: Workspace, o: int, x: float, y: float, z: float) -> float:
    """Apply an impulse (x, y, z) to block o; returns the largest velocity change."""
    v = problem.velocity
    if o >= problem.size[N_FREE_DOF]:
        dv = work.inverse[o, 0] * x
        v[o] += dv
        return abs(dv)
    largest = 0.0
    for k in range(3):
        dv = work.inverse[o + k, 0] * x + work.inverse[o + k, 1] * y + work.inverse[o + k, 2] * z
        v[o + k] += dv
        largest = max(largest, abs(dv))
    return largest


@kernel
def _sweep_contacts(problem: Problem, work: Workspace) -> float:
    v = problem.velocity
    largest = 0.0
    for i in range(problem.size[N_CONTACT]):
        for direction in range(2):
            rows = problem.normal if direction == 0 else problem.tangent
            u = problem.bias[i, direction]
            compliance = 0.0
            for side in range(2):
                o = problem.contact_dof[i, side]
                if o >= 0:
                    compliance += _compliance(problem, work, rows, i, 3 * side, o)
                    for k in range(3):
                        u += rows[i, 3 * side + k] * v[o + k]
            before = problem.impulse[i, direction]
            after = before
            if compliance > 0.0:
                after = before - u / compliance
            if direction == 0:
                after = max(0.0, after)
            else:
                reach = problem.friction[i] * problem.impulse[i, 0]
                after = min(reach, max(-reach, after))
            step = after - before
            if step == 0.0:
                continue
            problem.impulse[i, direction] = after
            for side in range(2):
                o = problem.contact_dof[i, side]
                if o >= 0:
                    s = 3 * side
                    moved = _push(
                        problem, work, o,
                        step * rows[i, s], step * rows[i, s + 1], step * rows[i, s + 2],
                    )  # fmt: skip
                    largest = max(largest, moved)
    return largest


@kernel
def _sweep_elements(problem: Problem, work: Workspace) -> float:
    row = problem.element_row
    p = problem.element_impulse
    largest = 0.0
    for e in range(problem.size[N_ELEMENT]):
        o = problem.element_dof[e]
        stiff = math.inf
        for j in range(3):
            c = _compliance(problem, work, row[e], j, 0, o)
            if c > 0.0:
                stiff = min(stiff, 1.0 / c)
        x, y, z = friction_answer(problem, e, stiff)
        dx = x - p[e, 0]
        dy = y - p[e, 1]
        dz = z - p[e, 2]
        p[e, 0] = x
        p[e, 1] = y
        p[e, 2] = z
        moved = _push(
            problem,
            work,
            o,
            row[e, 0, 0] * dx + row[e, 1, 0] * dy + row[e, 2, 0] * dz,
            row[e, 0, 1] * dx + row[e, 1, 1] * dy + row[e, 2, 1] * dz,
            row[e, 0, 2] * dx + row[e, 1, 2] * dy + row[e, 2, 2] * dz,
        )
        largest = max(largest, moved)
    return largest


@kernel
def friction_answer(problem: Problem, e: int, stiffness: float) -> tuple[float, float, float]:
    """Impulse of element e after a step of a spring against its slip, projected to its limit."""
    row = problem.element_row
    p = problem.element_impulse
    v = problem.velocity
    o = problem.element_dof[e]
    x = p[e, 0] - stiffness * (
        problem.element_bias[e, 0]
        + row[e, 0, 0] * v[o]
        + row[e, 0, 1] * v[o + 1]
        + row[e, 0, 2] * v[o + 2]
    )
    y = p[e, 1] - stiffness * (
        problem.element_bias[e, 1]
        + row[e, 1, 0] * v[o]
        + row[e, 1, 1] * v[o + 1]
        + row[e, 1, 2] * v[o + 2]
    )
    z = p[e, 2] - stiffness * (
        problem.element_bias[e, 2]
        + row[e, 2, 0] * v[o]
        + row[e, 2, 1] * v[o + 1]
        + row[e, 2, 2] * v[o + 2]
    )
    limit = problem.element_limit[e]
    if problem.element_sides[e] > 0:
        x, y = nearest_in_polygon(x, y, limit, problem.element_sides[e])
        return x, y, z
    length = math.sqrt(x * x + y * y + z * z)
    if length > limit:
        x *= limit / length
        y *= limit / length
        z *= limit / length
    return x, y, z


@kernel
def nearest_in_polygon(x: float, y: float, limit: float, sides: int) -> tuple[float, float]:
    """Nearest point of the regular polygon inscribed in a circle, first corner on +x."""
    wedge = 2.0 * math.pi / sides
    middle = (math.floor(math.atan2(y, x) / wedge) + 0.5) * wedge
    dx = math.cos(middle)
    dy = math.sin(middle)
    foot = limit * math.cos(0.5 * wedge)
    if x * dx + y * dy <= foot:
        return x, y
    half_side = limit * math.sin(0.5 * wedge)
    along = min(half_side, max(-half_side, y * dx - x * dy))
    return foot * dx - along * dy, foot * dy + along * dx
