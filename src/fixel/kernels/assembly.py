"""Assembly of the mixed complementarity problem of one step, for the three motion models.

The rows are taken at a configuration reached `lead` after the step's start by the predicted
velocities (lead 0: at the start, Stewart & Trinkle 1996; half a step: the midpoint, Moreau 1988),
and the gaps are carried to the step's start by a parabola and to its end by the rows, so both are
one formula:

    u_n = n . (relative velocity over the step) + bias >= 0,
    bias = (gap at the step's start) / step - (prescribed normal velocity).

See docs/theory/contact.md. The three models differ in `inertia` and `momentum` only:

    dynamic       M (v' - v) = h f + impulses          inertia M, momentum M v + h f
    quasi-static            0 = h f + impulses          inertia 0, momentum h f
    first-order         h D v' = h f + impulses          inertia h D, momentum h f
"""

import math

from fixel.kernels import codes
from fixel.kernels.arrays import (
    N_DOF,
    N_FREE_DOF,
    N_POINT,
    NORMAL_X,
    NORMAL_Y,
    POINT_X,
    POINT_Y,
    Model,
    Problem,
    State,
)
from fixel.kernels.jit import kernel
from fixel.typing import FloatArray


@kernel
def assemble_bodies(
    model: Model, state: State, motion: int, step: float, pose: FloatArray, problem: Problem
) -> None:
    """Write inertia and momentum of every free body, at the configuration `pose`."""
    n_free = model.mass.size
    for b in range(n_free):
        o = 3 * b
        fx = model.wrench[b, 0]
        fy = model.wrench[b, 1]
        ft = model.wrench[b, 2]
        k = model.spring[b, 0]
        if k > 0.0:
            # Taken implicitly: the spring's pull at the step's end, so that stiff springs stay
            # stable.
            fx -= k * (state.pose[b, 0] - model.spring[b, 1])
            fy -= k * (state.pose[b, 1] - model.spring[b, 2])
        problem.momentum[o] = step * fx
        problem.momentum[o + 1] = step * fy
        problem.momentum[o + 2] = step * ft
        for i in range(3):
            for j in range(3):
                problem.inertia[o + i, j] = 0.0
        if motion == codes.DYNAMIC:
            m = model.mass[b]
            problem.inertia[o, 0] = m
            problem.inertia[o + 1, 1] = m
            problem.inertia[o + 2, 2] = model.inertia[b]
            problem.momentum[o] += m * state.velocity[o]
            problem.momentum[o + 1] += m * state.velocity[o + 1]
            problem.momentum[o + 2] += model.inertia[b] * state.velocity[o + 2]
        elif motion == codes.FIRST_ORDER:
            _rotate_drag(model, b, step, pose[b, 2], problem)
        if k > 0.0:
            problem.inertia[o, 0] += step * step * k
            problem.inertia[o + 1, 1] += step * step * k


@kernel
def _rotate_drag(model: Model, b: int, step: float, angle: float, problem: Problem) -> None:
    """Write ``step * R D R^T`` of body b, where R rotates the plane and leaves the spin."""
    c = math.cos(angle)
    s = math.sin(angle)
    d = model.drag[b]
    o = 3 * b
    xx = c * c * d[0, 0] - c * s * (d[0, 1] + d[1, 0]) + s * s * d[1, 1]
    yy = s * s * d[0, 0] + c * s * (d[0, 1] + d[1, 0]) + c * c * d[1, 1]
    xy = c * s * (d[0, 0] - d[1, 1]) + c * c * d[0, 1] - s * s * d[1, 0]
    xt = c * d[0, 2] - s * d[1, 2]
    yt = s * d[0, 2] + c * d[1, 2]
    problem.inertia[o, 0] = step * xx
    problem.inertia[o, 1] = step * xy
    problem.inertia[o, 2] = step * xt
    problem.inertia[o + 1, 0] = step * xy
    problem.inertia[o + 1, 1] = step * yy
    problem.inertia[o + 1, 2] = step * yt
    problem.inertia[o + 2, 0] = step * xt
    problem.inertia[o + 2, 1] = step * yt
    problem.inertia[o + 2, 2] = step * d[2, 2]


@kernel
def plane_factor(model: Model, x: float, y: float) -> float:
    """Interpolate the friction map at a point of the plane: bilinear between nodes, constant beyond
    the border."""
    n_row, n_column = model.map_factor.shape
    if n_row == 0:
        return 1.0
    u = min(n_column - 1.0, max(0.0, (x - model.map_frame[0]) / model.map_frame[2]))
    v = min(n_row - 1.0, max(0.0, (y - model.map_frame[1]) / model.map_frame[3]))
    column = min(int(u), max(0, n_column - 2))
    row = min(int(v), max(0, n_row - 2))
    u -= column
    v -= row
    right = min(column + 1, n_column - 1)
    up = min(row + 1, n_row - 1)
    f = model.map_factor
    return (1.0 - v) * ((1.0 - u) * f[row, column] + u * f[row, right]) + v * (
        (1.0 - u) * f[up, column] + u * f[up, right]
    )


@kernel
def assemble_elements(
    model: Model, motion: int, step: float, pose: FloatArray, problem: Problem
) -> int:
    """Write rows and limits of every support friction element; returns their number, 0 in first
    order.

    Anisotropic friction is an ellipse of impulses; rows scaled by its half-axes turn it into a
    disc.
    """
    problem.size[N_POINT] = 0
    if motion == codes.FIRST_ORDER:
        return 0
    row = problem.element_row
    even = model.plane[0] == 1.0 and model.plane[1] == 1.0
    n_point = model.element_body.size if model.sides == 0 else 0
    last = -1
    c = 1.0
    s = 0.0
    for e in range(model.element_body.size):
        b = model.element_body[e]
        if b != last:
            c = math.cos(pose[b, 2])
            s = math.sin(pose[b, 2])
            last = b
        px = model.element_point[e, 0]
        py = model.element_point[e, 1]
        rx = c * px - s * py
        ry = s * px + c * py
        limit = step * model.element_limit[e]
        if model.map_factor.size > 0:
            limit *= plane_factor(model, pose[b, 0] + rx, pose[b, 1] + ry)
        problem.element_limit[e] = limit
        if even:
            row[e, 0, 0] = 1.0
            row[e, 0, 1] = 0.0
            row[e, 0, 2] = -ry
            row[e, 1, 0] = 0.0
            row[e, 1, 1] = 1.0
            row[e, 1, 2] = rx
        else:
            ca = math.cos(model.plane[2])
            sa = math.sin(model.plane[2])
            f1 = model.plane[0]
            f2 = model.plane[1]
            row[e, 0, 0] = f1 * ca
            row[e, 0, 1] = f1 * sa
            row[e, 0, 2] = f1 * (sa * rx - ca * ry)
            row[e, 1, 0] = -f2 * sa
            row[e, 1, 1] = f2 * ca
            row[e, 1, 2] = f2 * (ca * rx + sa * ry)
        if model.element_kind[e] == codes.ELLIPSOID:
            row[e, 2, 2] = model.element_ratio[e]
            n_point = min(n_point, e)
    problem.size[N_POINT] = n_point
    return int(model.element_body.size)


@kernel
def set_stiffness(problem: Problem, n_element: int) -> None:
    """Write the typical impulse per unit velocity of each block: its inertia plus its friction
    limits."""
    n_free_dof = problem.size[N_FREE_DOF]
    largest = 0.0
    for o in range(0, n_free_dof, 3):
        problem.stiffness[o] = problem.inertia[o, 0]
    o = 0
    total = 0.0
    for e in range(n_element):
        # Written once per body: an array would pass each sum through memory.
        if problem.element_dof[e] != o:
            problem.stiffness[o] += total
            total = 0.0
            o = problem.element_dof[e]
        total += problem.element_limit[e]
    problem.stiffness[o] += total
    for o in range(0, n_free_dof, 3):
        k = problem.stiffness[o]
        problem.stiffness[o + 1] = k
        problem.stiffness[o + 2] = k
        largest = max(largest, k)
    for o in range(n_free_dof, problem.size[N_DOF]):
        problem.stiffness[o] = largest


@kernel
def assemble_contact(
    problem: Problem,
    i: int,
    pose: FloatArray,
    n_free: int,
    drive_dof: int,
    drive_x: float,
    drive_y: float,
    drive_turn: float,
) -> None:
    """Write the rows of contact i. A driven second body moves along (drive_x, drive_y, drive_turn)
    at unit speed."""
    a = problem.contact_body[i, 0]
    b = problem.contact_body[i, 1]
    nx = problem.contact_place[i, NORMAL_X]
    ny = problem.contact_place[i, NORMAL_Y]
    px = problem.contact_place[i, POINT_X]
    py = problem.contact_place[i, POINT_Y]
    normal = problem.normal
    tangent = problem.tangent
    rx = px - pose[a, 0]
    ry = py - pose[a, 1]
    normal[i, 0] = nx
    normal[i, 1] = ny
    normal[i, 2] = rx * ny - ry * nx
    tangent[i, 0] = -ny
    tangent[i, 1] = nx
    tangent[i, 2] = rx * nx + ry * ny
    problem.contact_dof[i, 0] = 3 * a
    if b < n_free:
        rx = px - pose[b, 0]
        ry = py - pose[b, 1]
        normal[i, 3] = -nx
        normal[i, 4] = -ny
        normal[i, 5] = -(rx * ny - ry * nx)
        tangent[i, 3] = ny
        tangent[i, 4] = -nx
        tangent[i, 5] = -(rx * nx + ry * ny)
        problem.contact_dof[i, 1] = 3 * b
        return
    problem.contact_dof[i, 1] = drive_dof
    if drive_dof >= 0:
        rx = px - pose[b, 0]
        ry = py - pose[b, 1]
        mx = drive_x - ry * drive_turn
        my = drive_y + rx * drive_turn
        normal[i, 3] = -(nx * mx + ny * my)
        tangent[i, 3] = -(nx * my - ny * mx)
        for k in range(4, 6):
            normal[i, k] = 0.0
            tangent[i, k] = 0.0
