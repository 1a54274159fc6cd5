"""Newton's linearisation of many pressure points at once.

Points are taken in groups of LANES that belong to one body. The same field of all points of a group
is contiguous, so that the compiler computes a group by vector instructions, with the bits of one
point at a time. Velocities and impulses of a group are those along the axes of friction, scaled by
its half-axes: the rows of a point are then (1, 0, x) and (0, 1, y). `newton.py` linearises all
other friction elements; the equations are the same.
"""

import math

from fixel.kernels.arrays import LANE_FIELDS, N_POINT, Problem, Workspace
from fixel.kernels.jit import kernel, large_kernel, view
from fixel.typing import FloatArray

LANES = 8
# Fields of a point in `work.lanes`: its arm, its impulse and limit, how its impulse changes as in
# `newton.py`, and what it adds to the linear system.
_X = 0  # third column of the first row: -y of the arm
_Y = 1  # third column of the second row
_IMPULSE_X = 2
_IMPULSE_Y = 3
_LIMIT = 4
_CHANGE_X = 5
_CHANGE_Y = 6
_KAPPA = 7
_DX = 8
_DY = 9
_WORST = 10  # largest entry of the natural map
_TURN = 11  # of the impulse with the constant part of its change
_XX = 12  # of the stiffness
_XY = 13
_YY = 14
_XT = 15
_YT = 16
_TT = 17


@kernel
def is_group(problem: Problem, first: int) -> bool:
    """Whether element `first` and those after it are a group."""
    return (
        first + LANES <= problem.size[N_POINT]
        and problem.element_dof[first] == problem.element_dof[first + LANES - 1]
    )


@large_kernel
def gather_points(problem: Problem, work: Workspace, first: int, last: int) -> None:
    """Copy the groups of elements `first` to ``last - 1`` into `work.lanes`."""
    row = problem.element_row
    p = problem.element_impulse
    for e in range(first, last, LANES):
        f = view(work.lanes, LANE_FIELDS * e, (LANE_FIELDS, LANES))
        for j in range(LANES):
            f[_X, j] = row[e + j, 0, 2]
            f[_Y, j] = row[e + j, 1, 2]
            f[_IMPULSE_X, j] = p[e + j, 0]
            f[_IMPULSE_Y, j] = p[e + j, 1]
            f[_LIMIT, j] = problem.element_limit[e + j]


@kernel
def to_axes(row: FloatArray, x: float, y: float) -> tuple[float, float]:
    """Transform a velocity of the world to the axes of friction of a point with this row."""
    return row[0, 0] * x + row[0, 1] * y, row[1, 0] * x + row[1, 1] * y


@kernel
def from_axes(
    row: FloatArray, px: float, py: float, xx: float, xy: float, yy: float, xt: float, yt: float
) -> tuple[float, float, float, float, float, float, float]:
    """Transform an impulse and a stiffness from these axes to those of the world."""
    px, py = row[0, 0] * px + row[1, 0] * py, row[0, 1] * px + row[1, 1] * py
    xt, yt = row[0, 0] * xt + row[1, 0] * yt, row[0, 1] * xt + row[1, 1] * yt
    left, right = xx * row[0, 0] + xy * row[1, 0], xx * row[0, 1] + xy * row[1, 1]
    low, high = xy * row[0, 0] + yy * row[1, 0], xy * row[0, 1] + yy * row[1, 1]
    xx, xy = row[0, 0] * left + row[1, 0] * low, row[0, 0] * right + row[1, 0] * high
    return px, py, xx, xy, row[0, 1] * right + row[1, 1] * high, xt, yt


@large_kernel
def linearise_points(
    problem: Problem, work: Workspace, first: int, last: int, epsilon: float
) -> tuple[float, float, float, float, float, float, float, float, float, float]:
    """Linearise the groups of one body, elements `first` to ``last - 1``.

    Returns the largest entry of their natural map, their wrench (x, y, turn) and their stiffness
    (xx, xy, yy, xt, yt, tt), in the axes of the world.
    """
    for e in range(first, last, LANES):
        _linearise_group(problem, work, e, epsilon)
    worst = 0.0
    px = 0.0
    py = 0.0
    turn = 0.0
    xx = 0.0
    xy = 0.0
    yy = 0.0
    xt = 0.0
    yt = 0.0
    tt = 0.0
    for e in range(first, last, LANES):
        f = view(work.lanes, LANE_FIELDS * e, (LANE_FIELDS, LANES))
        for j in range(LANES):
            worst = max(worst, f[_WORST, j])
            px += f[_IMPULSE_X, j] + f[_CHANGE_X, j]
            py += f[_IMPULSE_Y, j] + f[_CHANGE_Y, j]
            turn += f[_TURN, j]
            xx += f[_XX, j]
            xy += f[_XY, j]
            yy += f[_YY, j]
            xt += f[_XT, j]
            yt += f[_YT, j]
            tt += f[_TT, j]
    row = problem.element_row[first]
    px, py, xx, xy, yy, xt, yt = from_axes(row, px, py, xx, xy, yy, xt, yt)
    return worst, px, py, turn, xx, xy, yy, xt, yt, tt


@kernel
def _linearise_group(problem: Problem, work: Workspace, e: int, epsilon: float) -> None:
    """Compute the fields of a group at the present velocity and impulses."""
    f = view(work.lanes, LANE_FIELDS * e, (LANE_FIELDS, LANES))
    o = problem.element_dof[e]
    vx, vy = to_axes(problem.element_row[e], problem.velocity[o], problem.velocity[o + 1])
    spin = problem.velocity[o + 2]
    rho = problem.stiffness[o]
    per_rho = 1.0 / rho
    stiff = rho / epsilon
    for j in range(LANES):
        x = f[_X, j]
        y = f[_Y, j]
        px = f[_IMPULSE_X, j]
        py = f[_IMPULSE_Y, j]
        limit = f[_LIMIT, j]
        ux = vx + x * spin
        uy = vy + y * spin
        zx = px - rho * ux
        zy = py - rho * uy
        length = math.sqrt(zx * zx + zy * zy)
        slides = length > limit
        # No branches: what the other state needs may be infinite, and is not selected. One quotient
        # for both: of the direction, and of the stiffness.
        beyond = length - limit
        inverse = 1.0 / (length * beyond)
        dx = zx * beyond * inverse if slides else 0.0
        dy = zy * beyond * inverse if slides else 0.0
        fx = px - limit * dx if slides else rho * ux
        fy = py - limit * dy if slides else rho * uy
        kappa = min(rho * limit * length * inverse, stiff) if slides else stiff
        across = per_rho * kappa * (fy * dx - fx * dy)
        cx = across * dy - fx if slides else -stiff * ux
        cy = -across * dx - fy if slides else -stiff * uy
        cross = dx * x + dy * y
        f[_CHANGE_X, j] = cx
        f[_CHANGE_Y, j] = cy
        f[_KAPPA, j] = kappa
        f[_DX, j] = dx
        f[_DY, j] = dy
        f[_WORST, j] = max(abs(fx), abs(fy))
        f[_TURN, j] = x * (px + cx) + y * (py + cy)
        f[_XX, j] = kappa * (1.0 - dx * dx)
        f[_XY, j] = -kappa * dx * dy
        f[_YY, j] = kappa * (1.0 - dy * dy)
        f[_XT, j] = kappa * (x - dx * cross)
        f[_YT, j] = kappa * (y - dy * cross)
        f[_TT, j] = kappa * (x * x + y * y - cross * cross)


@large_kernel
def change_points(
    problem: Problem, work: Workspace, first: int, last: int, vx: float, vy: float, spin: float
) -> None:
    """Change the impulses of the groups of one body by a change of its velocity."""
    p = problem.element_impulse
    vx, vy = to_axes(problem.element_row[first], vx, vy)
    for e in range(first, last, LANES):
        f = view(work.lanes, LANE_FIELDS * e, (LANE_FIELDS, LANES))
        for j in range(LANES):
            ux = vx + f[_X, j] * spin
            uy = vy + f[_Y, j] * spin
            along = ux * f[_DX, j] + uy * f[_DY, j]
            f[_IMPULSE_X, j] += f[_CHANGE_X, j] - f[_KAPPA, j] * (ux - along * f[_DX, j])
            f[_IMPULSE_Y, j] += f[_CHANGE_Y, j] - f[_KAPPA, j] * (uy - along * f[_DY, j])
        for j in range(LANES):
            p[e + j, 0] = f[_IMPULSE_X, j]
            p[e + j, 1] = f[_IMPULSE_Y, j]


@large_kernel
def add_points(problem: Problem, work: Workspace, epsilon: float) -> float:
    """Add the groups of points to the linear system; returns the largest entry of their natural
    map.

    In two passes over the groups, so that no vector is loaded right after its entries were stored.
    """
    n_point = problem.size[N_POINT]
    for e in range(0, n_point, LANES):
        if is_group(problem, e):
            gather_points(problem, work, e, e + LANES)
    worst = 0.0
    right = work.right
    matrix = work.matrix
    for e in range(0, n_point, LANES):
        if not is_group(problem, e):
            continue
        o = problem.element_dof[e]
        off, px, py, turn, xx, xy, yy, xt, yt, tt = linearise_points(
            problem, work, e, e + LANES, epsilon
        )
        worst = max(worst, off)
        right[o] += px
        right[o + 1] += py
        right[o + 2] += turn
        matrix[o, o] += xx
        matrix[o, o + 1] += xy
        matrix[o, o + 2] += xt
        matrix[o + 1, o] += xy
        matrix[o + 1, o + 1] += yy
        matrix[o + 1, o + 2] += yt
        matrix[o + 2, o] += xt
        matrix[o + 2, o + 1] += yt
        matrix[o + 2, o + 2] += tt
    return worst


@large_kernel
def step_points(problem: Problem, work: Workspace) -> None:
    """Change the impulses of the groups by the solution in `work.right`."""
    right = work.right
    for e in range(0, problem.size[N_POINT], LANES):
        if is_group(problem, e):
            o = problem.element_dof[e]
            change_points(problem, work, e, e + LANES, right[o], right[o + 1], right[o + 2])
