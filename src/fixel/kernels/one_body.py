"""Newton's method for one free body on plain points, with at most one drive.

Most scenes are of this kind. The system has three or four unknowns, which fit into registers:
without loops over blocks and sides an iteration takes a third of the time it takes in `newton.py`,
whose equations are the same.
"""

import math

from fixel.kernels.arrays import (
    LANE_FIELDS,
    N_CONTACT,
    N_DOF,
    N_ELEMENT,
    N_FREE_DOF,
    N_POINT,
    Problem,
    Workspace,
)
from fixel.kernels.jit import kernel, large_kernel, view
from fixel.kernels.residual import residual
from fixel.typing import FloatArray


@kernel
def is_one_body(problem: Problem) -> bool:
    """Whether a problem has one free body on plain points, and at most one drive."""
    n_point = problem.size[N_POINT]
    drives = problem.size[N_DOF] - 3
    return (
        problem.size[N_FREE_DOF] == 3
        and drives <= 1
        and problem.size[N_ELEMENT] == n_point + drives
    )


@kernel
def newton_one_body(
    problem: Problem,
    work: Workspace,
    tolerance: float,
    max_iterations: int,
    epsilon: float,
    floor: float,
) -> float:
    """Iterate as `newton.newton`, for a problem that `is_one_body`.

    Twice at least: `max_iterations` is 2 or more. In the names of scalars, x, y, t and d are the
    rows and columns of the body's motion and the drive's.
    """
    v = problem.velocity
    p = problem.impulse
    q = problem.element_impulse
    row = problem.element_row
    normal = problem.normal
    tangent = problem.tangent
    change = work.contact_change
    element_change = work.element_change
    inertia = problem.inertia
    n_contact = problem.size[N_CONTACT]
    n_point = problem.size[N_POINT]
    n_group = n_point - n_point % LANES  # points that are taken in groups
    driven = problem.size[N_DOF] == 4
    # Whether friction of the last few points has axes of its own.
    uneven = n_group < n_point and (
        row[n_group, 0, 0] != 1.0 or row[n_group, 0, 1] != 0.0 or row[n_group, 1, 1] != 1.0
    )
    if n_group > 0:
        gather_points(problem, work, 0, n_group)
    rho = problem.stiffness[0]  # that of a drive, too
    per_rho = 1.0 / rho
    stiff = rho / epsilon
    worst = math.inf
    vx = v[0]
    vy = v[1]
    vt = v[2]
    vd = v[3] if driven else 0.0
    for iteration in range(max_iterations + 1):
        if iteration > 1:
            worst = residual(problem, work.right)
            if worst <= tolerance or iteration == max_iterations:
                break
        off = 0.0
        xx = inertia[0, 0]
        xy = inertia[0, 1]
        xt = inertia[0, 2]
        yx = inertia[1, 0]
        yy = inertia[1, 1]
        yt = inertia[1, 2]
        tx = inertia[2, 0]
        ty = inertia[2, 1]
        tt = inertia[2, 2]
        rx = problem.momentum[0] - (xx * vx + xy * vy + xt * vt)
        ry = problem.momentum[1] - (yx * vx + yy * vy + yt * vt)
        rt = problem.momentum[2] - (tx * vx + ty * vy + tt * vt)
        pull = floor * rho
        xx += pull
        yy += pull
        tt += pull
        xd = 0.0
        yd = 0.0
        td = 0.0
        dx = 0.0
        dy = 0.0
        dt = 0.0
        dd = 1.0
        rd = 0.0
        if n_group > 0:
            off, px, py, zx, kxx, kxy, kyy, kxt, kyt, zy = linearise_points(
                problem, work, 0, n_group, epsilon
            )
            rx += px
            ry += py
            rt += zx
            xx += kxx
            xy += kxy
            yx += kxy
            yy += kyy
            xt += kxt
            tx += kxt
            yt += kyt
            ty += kyt
            tt += zy
        wx = vx
        wy = vy
        if uneven:
            wx, wy = to_axes(row[n_group], vx, vy)
        for e in range(n_group, n_point):
            ax = row[e, 0, 2]
            ay = row[e, 1, 2]
            limit = problem.element_limit[e]
            px = q[e, 0]
            py = q[e, 1]
            ux = wx + ax * vt
            uy = wy + ay * vt
            zx = px - rho * ux
            zy = py - rho * uy
            length = math.sqrt(zx * zx + zy * zy)
            if length > limit:
                # One division instead of two.
                beyond = length - limit
                inverse = 1.0 / (length * beyond)
                gx = zx * beyond * inverse
                gy = zy * beyond * inverse
                fx = px - limit * gx
                fy = py - limit * gy
                kappa = min(rho * limit * length * inverse, stiff)
                across = per_rho * kappa * (fy * gx - fx * gy)
                cx = across * gy - fx
                cy = -across * gx - fy
            else:
                gx = 0.0
                gy = 0.0
                fx = rho * ux
                fy = rho * uy
                kappa = stiff
                cx = -stiff * ux
                cy = -stiff * uy
            off = max(off, abs(fx), abs(fy))
            element_change[e, 0] = cx
            element_change[e, 1] = cy
            element_change[e, 3] = kappa
            element_change[e, 4] = gx
            element_change[e, 5] = gy
            px += cx
            py += cy
            rt += ax * px + ay * py
            cross = gx * ax + gy * ay
            kxx = kappa * (1.0 - gx * gx)
            kxy = -kappa * gx * gy
            kyy = kappa * (1.0 - gy * gy)
            kxt = kappa * (ax - gx * cross)
            kyt = kappa * (ay - gy * cross)
            if uneven:
                px, py, kxx, kxy, kyy, kxt, kyt = from_axes(row[e], px, py, kxx, kxy, kyy, kxt, kyt)
            rx += px
            ry += py
            xx += kxx
            xy += kxy
            yx += kxy
            yy += kyy
            xt += kxt
            tx += kxt
            yt += kyt
            ty += kyt
            tt += kappa * (ax * ax + ay * ay - cross * cross)
        if driven:
            dd = inertia[3, 0]
            rd = problem.momentum[3] - dd * vd
            dd += floor * problem.stiffness[3]
            ux = vd + problem.element_bias[n_point, 0]
            limit = problem.element_limit[n_point]
            px = q[n_point, 0]
            zx = px - rho * ux
            if abs(zx) > limit:
                fx = px - (limit if zx > 0.0 else -limit)
                cx = -fx
                kappa = 0.0
            else:
                fx = rho * ux
                cx = -stiff * ux
                kappa = stiff
            off = max(off, abs(fx))
            element_change[n_point, 0] = cx
            element_change[n_point, 3] = kappa
            rd += px + cx
            dd += kappa
        for i in range(n_contact):
            nx = normal[i, 0]
            ny = normal[i, 1]
            nt = normal[i, 2]
            sx = tangent[i, 0]
            sy = tangent[i, 1]
            st = tangent[i, 2]
            nd = 0.0
            sd = 0.0
            if problem.contact_dof[i, 1] >= 0:
                nd = normal[i, 3]
                sd = tangent[i, 3]
            mu = problem.friction[i]
            un = problem.bias[i, 0] + (nx * vx + ny * vy + nt * vt + nd * vd)
            ut = problem.bias[i, 1] + (sx * vx + sy * vy + st * vt + sd * vd)
            pn = p[i, 0]
            pt = p[i, 1]
            zn = pn - rho * un
            if not zn > 0.0:
                off = max(off, abs(pn), abs(pt))
                p[i, 0] = 0.0
                p[i, 1] = 0.0
                change[i, 3] = 0.0
                continue
            zt = pt - rho * ut
            fn = pn - stiff * un
            change[i, 0] = fn
            if abs(zt) <= mu * zn:
                ft = pt - stiff * ut
                off = max(off, abs(rho * un), abs(rho * ut))
                change[i, 1] = ft
                change[i, 3] = 3.0
                hx = stiff * nx
                hy = stiff * ny
                ht = stiff * nt
                hd = stiff * nd
                wx = stiff * sx
                wy = stiff * sy
                wt = stiff * st
                wd = stiff * sd
                xx += hx * nx + wx * sx
                xy += hx * ny + wx * sy
                xt += hx * nt + wx * st
                xd += hx * nd + wx * sd
                yx += hy * nx + wy * sx
                yy += hy * ny + wy * sy
                yt += hy * nt + wy * st
                yd += hy * nd + wy * sd
                tx += ht * nx + wt * sx
                ty += ht * ny + wt * sy
                tt += ht * nt + wt * st
                td += ht * nd + wt * sd
                dx += hd * nx + wd * sx
                dy += hd * ny + wd * sy
                dt += hd * nt + wd * st
                dd += hd * nd + wd * sd
            else:
                slope = mu if zt > 0.0 else -mu
                ft = slope * fn
                off = max(off, abs(rho * un), abs(pt - slope * zn))
                change[i, 1] = slope
                change[i, 3] = 1.0
                hx = stiff * (nx + slope * sx)
                hy = stiff * (ny + slope * sy)
                ht = stiff * (nt + slope * st)
                hd = stiff * (nd + slope * sd)
                xx += hx * nx
                xy += hx * ny
                xt += hx * nt
                xd += hx * nd
                yx += hy * nx
                yy += hy * ny
                yt += hy * nt
                yd += hy * nd
                tx += ht * nx
                ty += ht * ny
                tt += ht * nt
                td += ht * nd
                dx += hd * nx
                dy += hd * ny
                dt += hd * nt
                dd += hd * nd
            rx += nx * fn + sx * ft
            ry += ny * fn + sy * ft
            rt += nt * fn + st * ft
            rd += nd * fn + sd * ft
        if iteration > 1 and off <= tolerance:
            break
        # Gaussian elimination; the largest pivot of each column rises to the top.
        if abs(yx) > abs(xx):
            xx, xy, xt, xd, rx, yx, yy, yt, yd, ry = yx, yy, yt, yd, ry, xx, xy, xt, xd, rx
        if abs(tx) > abs(xx):
            xx, xy, xt, xd, rx, tx, ty, tt, td, rt = tx, ty, tt, td, rt, xx, xy, xt, xd, rx
        if abs(dx) > abs(xx):
            xx, xy, xt, xd, rx, dx, dy, dt, dd, rd = dx, dy, dt, dd, rd, xx, xy, xt, xd, rx
        first = 1.0 / xx
        factor = yx * first
        yy -= factor * xy
        yt -= factor * xt
        yd -= factor * xd
        ry -= factor * rx
        factor = tx * first
        ty -= factor * xy
        tt -= factor * xt
        td -= factor * xd
        rt -= factor * rx
        factor = dx * first
        dy -= factor * xy
        dt -= factor * xt
        dd -= factor * xd
        rd -= factor * rx
        if abs(ty) > abs(yy):
            yy, yt, yd, ry, ty, tt, td, rt = ty, tt, td, rt, yy, yt, yd, ry
        if abs(dy) > abs(yy):
            yy, yt, yd, ry, dy, dt, dd, rd = dy, dt, dd, rd, yy, yt, yd, ry
        second = 1.0 / yy
        factor = ty * second
        tt -= factor * yt
        td -= factor * yd
        rt -= factor * ry
        factor = dy * second
        dt -= factor * yt
        dd -= factor * yd
        rd -= factor * ry
        if abs(dt) > abs(tt):
            tt, td, rt, dt, dd, rd = dt, dd, rd, tt, td, rt
        third = 1.0 / tt
        factor = dt * third
        dd -= factor * td
        rd -= factor * rt
        if not abs(xx * yy * tt * dd) > 0.0:
            return math.inf
        dd = rd / dd
        dt = (rt - td * dd) * third
        dy = (ry - yt * dt - yd * dd) * second
        dx = (rx - xy * dy - xt * dt - xd * dd) * first
        vx += dx
        vy += dy
        vt += dt
        v[0] = vx
        v[1] = vy
        v[2] = vt
        if n_group > 0:
            change_points(problem, work, 0, n_group, dx, dy, dt)
        wx = dx
        wy = dy
        if uneven:
            wx, wy = to_axes(row[n_group], dx, dy)
        for e in range(n_group, n_point):
            ux = wx + row[e, 0, 2] * dt
            uy = wy + row[e, 1, 2] * dt
            gx = element_change[e, 4]
            gy = element_change[e, 5]
            kappa = element_change[e, 3]
            cross = ux * gx + uy * gy
            q[e, 0] += element_change[e, 0] - kappa * (ux - cross * gx)
            q[e, 1] += element_change[e, 1] - kappa * (uy - cross * gy)
        if driven:
            vd += dd
            v[3] = vd
            q[n_point, 0] += element_change[n_point, 0] - element_change[n_point, 3] * dd
        for i in range(n_contact):
            state = change[i, 3]
            if state == 0.0:
                continue
            un = normal[i, 0] * dx + normal[i, 1] * dy + normal[i, 2] * dt
            ut = tangent[i, 0] * dx + tangent[i, 1] * dy + tangent[i, 2] * dt
            if problem.contact_dof[i, 1] >= 0:
                un += normal[i, 3] * dd
                ut += tangent[i, 3] * dd
            pn = change[i, 0] - stiff * un
            p[i, 0] = pn
            if state == 3.0:
                p[i, 1] = change[i, 1] - stiff * ut
            else:
                p[i, 1] = change[i, 1] * pn
    return worst


# --- linearisation of many pressure points at once ------------------------------------------------

# Points are taken in groups of LANES that belong to one body. The same field of all points of a
# group is contiguous, so that the compiler computes a group by vector instructions, with the bits
# of one point at a time. Velocities and impulses of a group are those along the axes of friction,
# scaled by its half-axes: the rows of a point are then (1, 0, x) and (0, 1, y). `newton.py`
# linearises all other friction elements; the equations are the same.
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
