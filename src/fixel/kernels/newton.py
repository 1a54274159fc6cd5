"""Semismooth Newton on the natural map of one step, in velocity space.

Each contact and each friction element is linearised in its present state (apart, sliding,
sticking) and its impulse eliminated, which leaves a linear system in the velocities only: three
unknowns for one body on any number of points. Constraints have a compliance of EPSILON times that
of the block. Each iteration starts from the impulses of the last, so that the compliance does not
affect the solution, and redundant contacts (two on one edge, three supports that all stick) are no
special case.

Source: Alart & Curnier (1991) for the map; the compliance is a proximal step as in Rockafellar
(1976).
"""

import math

from fixel.kernels.arrays import (
    N_CONTACT,
    N_DOF,
    N_ELEMENT,
    N_FREE_DOF,
    N_POINT,
    Problem,
    Workspace,
)
from fixel.kernels.jit import kernel, large_kernel, view
from fixel.kernels.linear import solve_dense, solve_envelope
from fixel.kernels.one_body import (
    LANES,
    add_points,
    is_group,
    is_one_body,
    newton_one_body,
    step_points,
)
from fixel.kernels.residual import residual

EPSILON = (
    1e-7  # compliance of a held constraint, relative to its block's; larger needs more iterations
)
FLOOR = 1e-11  # of a block's stiffness, added to its inertia: unconstrained blocks do not move
FIRM = 10.0  # least stiffness where a contact sticks, in its block's: softer, it slides to and fro
SINGULAR = 1e-9  # determinant, relative to the diagonal: supports that do not resist every motion

# State of a contact in this iteration: the constrained velocities. With given friction limits a
# contact that is apart may still drag.
_APART = 0
_SLIDING = 1  # the normal velocity
_HELD = 2  # the tangential velocity


@kernel
def newton(problem: Problem, work: Workspace, tolerance: float, max_iterations: int) -> float:
    """Iterate the problem's velocity and impulses until the natural map is below `tolerance`.

    Returns the residual (`residual.py`); infinite where a linear system has no solution. From the
    second step on the residual is computed first, since it costs no more than a linearisation, and
    most steps end there. For at most DENSE_LIMIT unknowns.
    """
    if is_one_body(problem):
        return newton_one_body(problem, work, tolerance, max_iterations, EPSILON, FLOOR)
    worst = math.inf
    for iteration in range(max_iterations + 1):
        if iteration > 1:
            worst = residual(problem, work.right)
            if worst <= tolerance or iteration == max_iterations:
                break
        # Redundant constraints may leave a residual of rounding errors.
        off = linearise(problem, work, EPSILON, FLOOR, True, False, False, False)
        if iteration > 1 and off <= tolerance:
            break
        if not solve_linear(problem, work, True):
            return math.inf
        step_all(problem, work)
    return worst


@kernel
def solve_linear(problem: Problem, work: Workspace, dense: bool) -> bool:
    """Solve the system that `linearise` wrote; the velocity change replaces `work.right`."""
    if dense:
        return solve_dense(work.matrix, work.right, problem.size[N_DOF])
    reach = 0
    for k in range(problem.size[N_FREE_DOF]):
        reach = max(reach, work.active[k])
        work.active[k] = reach
    return solve_envelope(
        work.matrix, work.active, work.right, problem.size[N_FREE_DOF], problem.size[N_DOF]
    )


@kernel
def linearise(
    problem: Problem,
    work: Workspace,
    epsilon: float,
    pull: float,
    dense: bool,
    proximal: bool,
    tresca: bool,
    gentle: bool,
) -> float:
    """Write the linear system of the present iterate.

    `epsilon` is the compliance of a held constraint, relative to its block's, and `pull` the share
    of each block's stiffness that is added to its inertia. `dense` writes the whole matrix, instead
    of the part within `work.profile`. The method is Newton's on the natural map in velocities and
    impulses. Where `proximal`, impulses are constant, and the map is the momentum residual where
    each constraint acts like a spring of its own stiffness (augmented Lagrangian) and each block is
    pulled towards `work.centre`. `tresca` takes friction limits from `work.contact_change` instead
    of Coulomb's law. `gentle` makes the compliance of a loaded contact so large that its impulse
    changes by no more than what it takes to open or to slide, were the velocities to stay. Returns
    the largest entry of the natural map; where `proximal`, the largest change of impulse.
    """
    n_dof = problem.size[N_DOF]
    n_free = problem.size[N_FREE_DOF]
    v = problem.velocity
    matrix = work.matrix
    right = work.right
    if dense:
        for i in range(n_dof):
            for j in range(n_dof):
                matrix[i, j] = 0.0
    else:
        _clear_envelope(problem, work)
    for i in range(0, n_free, 3):
        for k in range(3):
            total = problem.momentum[i + k]
            for m in range(3):
                inertia = problem.inertia[i + k, m]
                total -= inertia * v[i + m]
                matrix[i + k, i + m] = inertia
            right[i + k] = total
    for i in range(n_free, n_dof):
        matrix[i, i] = problem.inertia[i, 0]
        right[i] = problem.momentum[i] - problem.inertia[i, 0] * v[i]
    # Spare entries are added to as well, and must not retain infinities of a diverged iterate.
    right[n_dof] = 0.0
    right[n_dof + 1] = 0.0
    for i in range(n_dof):
        matrix[i, i] += pull * problem.stiffness[i]
        if proximal:
            right[i] -= pull * problem.stiffness[i] * (v[i] - work.centre[i])
    return max(
        _add_elements(problem, work, epsilon, proximal),
        _add_contacts(problem, work, epsilon, dense, proximal, tresca, gentle),
    )


@kernel
def _clear_envelope(problem: Problem, work: Workspace) -> None:
    n_dof = problem.size[N_DOF]
    n_free = problem.size[N_FREE_DOF]
    matrix = work.matrix
    first = 0  # column of the row; profiles never fall, and are those of the columns, too
    for k in range(n_free):
        while work.profile[first] <= k:
            first += 1
        zeros = view(matrix, k * matrix.shape[1] + first, (work.profile[k] - first,))
        for j in range(work.profile[k] - first):
            zeros[j] = 0.0
        for j in range(n_free, n_dof):
            matrix[k, j] = 0.0
            matrix[j, k] = 0.0
        work.active[k] = k - k % 3 + 3
    for k in range(n_free, n_dof):
        for j in range(n_free, n_dof):
            matrix[k, j] = 0.0


@kernel
def _add_elements(problem: Problem, work: Workspace, epsilon: float, proximal: bool) -> float:
    v = problem.velocity
    row = problem.element_row
    p = problem.element_impulse
    change = work.element_change
    right = work.right
    matrix = work.matrix
    worst = 0.0
    if not proximal and problem.size[N_POINT] >= LANES:
        worst = add_points(problem, work, epsilon)
    for e in range(problem.size[N_ELEMENT]):
        if not proximal and is_group(problem, e - e % LANES):
            continue
        o = problem.element_dof[e]
        rho = problem.stiffness[o]
        limit = problem.element_limit[e]
        ux = problem.element_bias[e, 0]
        uy = problem.element_bias[e, 1]
        uz = problem.element_bias[e, 2]
        for k in range(3):
            ux += row[e, 0, k] * v[o + k]
            uy += row[e, 1, k] * v[o + k]
            uz += row[e, 2, k] * v[o + k]
        stiff = rho / epsilon
        sharp = stiff if proximal else rho
        zx = p[e, 0] - sharp * ux
        zy = p[e, 1] - sharp * uy
        zz = p[e, 2] - sharp * uz
        # The change of impulse is c - (kx, ky, kz) slip change, with the slip change normal to `d`.
        dx = 0.0
        dy = 0.0
        dz = 0.0
        sides = problem.element_sides[e]
        slides = False
        if sides == 0:
            length = math.sqrt(zx * zx + zy * zy + zz * zz)
            if length > limit:
                slides = True
                dx = zx / length
                dy = zy / length
                dz = zz / length
                fx = p[e, 0] - limit * dx
                fy = p[e, 1] - limit * dy
                fz = p[e, 2] - limit * dz
                if proximal:
                    kappa = stiff * limit / length
                    ratio = 0.0
                else:
                    # Impulse and velocity change together: the map's two derivatives, one
                    # eliminated.
                    kappa = min(rho * limit / (length - limit), stiff)
                    ratio = kappa / rho
                along = fx * dx + fy * dy + fz * dz
                cx = -fx - ratio * (fx - along * dx)
                cy = -fy - ratio * (fy - along * dy)
                cz = -fz - ratio * (fz - along * dz)
        else:
            wedge = 2.0 * math.pi / sides
            middle = (math.floor(math.atan2(zy, zx) / wedge) + 0.5) * wedge
            dx = math.cos(middle)
            dy = math.sin(middle)
            foot = limit * math.cos(0.5 * wedge)
            if zx * dx + zy * dy > foot:
                slides = True
                half_side = limit * math.sin(0.5 * wedge)
                along = zy * dx - zx * dy
                kappa = stiff
                if along > half_side:
                    along = half_side
                    kappa = 0.0
                elif along < -half_side:
                    along = -half_side
                    kappa = 0.0
                fx = p[e, 0] - (foot * dx - along * dy)
                fy = p[e, 1] - (foot * dy + along * dx)
                fz = 0.0
                if kappa > 0.0:
                    # On a side the impulse is free along it (slip zero along it) and fixed across.
                    across = fx * dx + fy * dy
                    slip = uy * dx - ux * dy
                    cx = -across * dx + kappa * slip * dy
                    cy = -across * dy - kappa * slip * dx
                else:
                    cx = -fx
                    cy = -fy
                cz = 0.0
        if not slides:
            fx = rho * ux
            fy = rho * uy
            fz = rho * uz
            kappa = stiff
            cx = -kappa * ux
            cy = -kappa * uy
            cz = -kappa * uz
            dx = 0.0
            dy = 0.0
            dz = 0.0
        if proximal:
            worst = max(worst, abs(cx), abs(cy), abs(cz))
        else:
            worst = max(worst, abs(fx), abs(fy), abs(fz))
        # With cross = d . row, the stiffness is kappa (row^T row - cross cross^T).
        for k in range(3):
            a0 = row[e, 0, k]
            a1 = row[e, 1, k]
            a2 = row[e, 2, k]
            right[o + k] += a0 * (p[e, 0] + cx) + a1 * (p[e, 1] + cy) + a2 * (p[e, 2] + cz)
            if kappa != 0.0:
                cross = dx * a0 + dy * a1 + dz * a2
                t0 = kappa * (a0 - cross * dx)
                t1 = kappa * (a1 - cross * dy)
                t2 = kappa * (a2 - cross * dz)
                for m in range(3):
                    matrix[o + k, o + m] += (
                        t0 * row[e, 0, m] + t1 * row[e, 1, m] + t2 * row[e, 2, m]
                    )
        change[e, 0] = cx
        change[e, 1] = cy
        change[e, 2] = cz
        change[e, 3] = kappa
        change[e, 4] = dx
        change[e, 5] = dy
        change[e, 6] = dz
    return worst


@kernel
def _add_contacts(
    problem: Problem,
    work: Workspace,
    epsilon: float,
    dense: bool,
    proximal: bool,
    tresca: bool,
    gentle: bool,
) -> float:
    v = problem.velocity
    p = problem.impulse
    normal = problem.normal
    tangent = problem.tangent
    change = work.contact_change
    right = work.right
    matrix = work.matrix
    worst = 0.0
    largest = 0.0
    for i in range(problem.size[N_CONTACT]):
        a = problem.contact_dof[i, 0]
        b = problem.contact_dof[i, 1]
        mu = problem.friction[i]
        un = problem.bias[i, 0]
        ut = problem.bias[i, 1]
        rho = problem.stiffness[a]
        for k in range(3):
            un += normal[i, k] * v[a + k]
            ut += tangent[i, k] * v[a + k]
        if b >= 0:
            rho = min(rho, problem.stiffness[b])
            for k in range(3):
                un += normal[i, 3 + k] * v[b + k]
                ut += tangent[i, 3 + k] * v[b + k]
        pn = p[i, 0]
        pt = p[i, 1]
        stiff = rho / epsilon
        sharp = stiff if proximal else rho
        zn = pn - sharp * un
        zt = pt - sharp * ut
        reach = change[i, 4] if tresca else mu * zn
        hold = stiff
        if gentle:
            if un > 0.0 and pn > 0.0:
                stiff = max(rho, min(stiff, pn / un))
            if ut != 0.0:
                hold = max(FIRM * rho, min(hold, (mu * pn + (pt if ut > 0.0 else -pt)) / abs(ut)))
        state = _APART
        cn = -pn
        ct = -pt
        slope = 0.0
        if zn > 0.0:
            state = _SLIDING
            cn = -stiff * un
            worst = max(worst, abs(rho * un))
        else:
            worst = max(worst, abs(pn))
        if zn > 0.0 or tresca:
            if abs(zt) <= reach:
                state += _HELD
                ct = -hold * ut
                worst = max(worst, abs(rho * ut))
            else:
                slope = mu if zt > 0.0 else -mu
                worst = max(worst, abs(pt - slope * zn))
                if tresca:
                    ct = (reach if zt > 0.0 else -reach) - pt
                    slope = 0.0
                else:
                    ct = slope * (pn + cn) - pt
        else:
            worst = max(worst, abs(pt))
        change[i, 0] = cn
        change[i, 1] = ct
        change[i, 2] = slope
        change[i, 3] = float(state)
        change[i, 5] = stiff
        change[i, 6] = hold
        if proximal:
            largest = max(largest, abs(cn), abs(ct))
        fn = pn + cn
        ft = pt + ct
        if not dense and state != _APART and b >= 0:
            _widen(problem, work, a, b)
        for side in range(2):
            o = a if side == 0 else b
            if o < 0:
                continue
            for k in range(3):
                wn = normal[i, 3 * side + k]
                wt = tangent[i, 3 * side + k]
                right[o + k] += wn * fn + wt * ft
                if state == _APART:
                    continue
                push = stiff * (wn + slope * wt) if state & _SLIDING else 0.0
                drag = hold * wt if state & _HELD else 0.0
                for other in range(2):
                    q = a if other == 0 else b
                    if q < 0:
                        continue
                    for m in range(3):
                        matrix[o + k, q + m] += (
                            push * normal[i, 3 * other + m] + drag * tangent[i, 3 * other + m]
                        )
    return largest if proximal else worst


@kernel
def _widen(problem: Problem, work: Workspace, a: int, b: int) -> None:
    """Extend the envelope from one of two coupled blocks to the other."""
    if max(a, b) < problem.size[N_FREE_DOF]:
        last = max(a, b) + 3
        for k in range(min(a, b), min(a, b) + 3):
            work.active[k] = max(work.active[k], last)


@kernel
def step_all(problem: Problem, work: Workspace) -> None:
    """Change the velocities by the solution in `work.right`, and the impulses accordingly."""
    dv = work.right
    p = problem.impulse
    for i in range(problem.size[N_CONTACT]):
        state = int(work.contact_change[i, 3])
        p[i, 0] += work.contact_change[i, 0]
        p[i, 1] += work.contact_change[i, 1]
        if state == _APART:
            continue
        a = problem.contact_dof[i, 0]
        b = problem.contact_dof[i, 1]
        dn = 0.0
        dt = 0.0
        for k in range(3):
            dn += problem.normal[i, k] * dv[a + k]
            dt += problem.tangent[i, k] * dv[a + k]
        if b >= 0:
            for k in range(3):
                dn += problem.normal[i, 3 + k] * dv[b + k]
                dt += problem.tangent[i, 3 + k] * dv[b + k]
        stiff = work.contact_change[i, 5]
        p[i, 0] -= stiff * dn
        if state & _HELD:
            p[i, 1] -= work.contact_change[i, 6] * dt
        else:
            p[i, 1] -= work.contact_change[i, 2] * stiff * dn
    change = work.element_change
    row = problem.element_row
    if problem.size[N_POINT] >= LANES:
        step_points(problem, work)
    for e in range(problem.size[N_ELEMENT]):
        if is_group(problem, e - e % LANES):
            continue
        o = problem.element_dof[e]
        ux = 0.0
        uy = 0.0
        uz = 0.0
        for k in range(3):
            ux += row[e, 0, k] * dv[o + k]
            uy += row[e, 1, k] * dv[o + k]
            uz += row[e, 2, k] * dv[o + k]
        kappa = change[e, 3]
        cross = ux * change[e, 4] + uy * change[e, 5] + uz * change[e, 6]
        problem.element_impulse[e, 0] += change[e, 0] - kappa * (ux - cross * change[e, 4])
        problem.element_impulse[e, 1] += change[e, 1] - kappa * (uy - cross * change[e, 5])
        problem.element_impulse[e, 2] += change[e, 2] - kappa * (uz - cross * change[e, 6])
    for i in range(problem.size[N_DOF]):
        problem.velocity[i] += dv[i]


@large_kernel
def start_afresh(problem: Problem) -> bool:
    """Set velocity and impulses from the contact of one body without inertia.

    From rest, Newton's method knows neither which supports slide nor that the contact presses. Here
    the supports resist in proportion to their slip, and the contact sticks, or slides where it has
    to: three linear equations. From their solution Newton's method arrives in two to six
    iterations.

    A drive holds its speed, and the body stays at rest where its contact does not close. Returns
    False, without a change, for other problems: with several contacts, drives or bodies, or
    inertia.
    """
    drives = problem.size[N_DOF] - 3
    if (
        drives > 1
        or problem.size[N_FREE_DOF] != 3
        or problem.size[N_CONTACT] != 1
        or problem.inertia[0, 0] != 0.0
    ):
        return False
    n_element = problem.size[N_ELEMENT] - drives
    row = problem.element_row
    p = problem.element_impulse
    limit = problem.element_limit
    xx = xy = xt = yy = yt = tt = 0.0
    for e in range(n_element):
        for j in range(3):
            x = row[e, j, 0]
            y = row[e, j, 1]
            t = row[e, j, 2]
            xx += limit[e] * x * x
            xy += limit[e] * x * y
            xt += limit[e] * x * t
            yy += limit[e] * y * y
            yt += limit[e] * y * t
            tt += limit[e] * t * t
    # Cofactors, since the matrix is symmetric.
    a = yy * tt - yt * yt
    b = xt * yt - xy * tt
    c = xy * yt - xt * yy
    d = xx * tt - xt * xt
    f = xy * xt - xx * yt
    g = xx * yy - xy * xy
    determinant = xx * a + xy * b + xt * c
    if not determinant > SINGULAR * xx * yy * tt:
        return False
    n = problem.normal[0]
    s = problem.tangent[0]
    # Velocities due to impulses of 1 along the normal and the tangent.
    nx = (a * n[0] + b * n[1] + c * n[2]) / determinant
    ny = (b * n[0] + d * n[1] + f * n[2]) / determinant
    nt = (c * n[0] + f * n[1] + g * n[2]) / determinant
    sx = (a * s[0] + b * s[1] + c * s[2]) / determinant
    sy = (b * s[0] + d * s[1] + f * s[2]) / determinant
    st = (c * s[0] + f * s[1] + g * s[2]) / determinant
    nn = n[0] * nx + n[1] * ny + n[2] * nt
    ns = s[0] * nx + s[1] * ny + s[2] * nt
    ss = s[0] * sx + s[1] * sy + s[2] * st
    normal = 0.0
    tangential = 0.0
    closing = -problem.bias[0, 0]
    along = -problem.bias[0, 1]
    if drives == 1:
        speed = -problem.element_bias[n_element, 0]
        problem.velocity[3] = speed
        closing -= n[3] * speed
        along -= s[3] * speed
    if closing > 0.0:
        free = nn * ss - ns * ns
        if not free > 0.0:
            return False
        normal = (ss * closing - ns * along) / free
        tangential = (nn * along - ns * closing) / free
        if abs(tangential) > problem.friction[0] * normal:
            slope = problem.friction[0] if tangential > 0.0 else -problem.friction[0]
            if not nn + slope * ns > 0.0:
                return False
            normal = closing / (nn + slope * ns)
            tangential = slope * normal
    vx = normal * nx + tangential * sx
    vy = normal * ny + tangential * sy
    vt = normal * nt + tangential * st
    problem.velocity[0] = vx
    problem.velocity[1] = vy
    problem.velocity[2] = vt
    lost = 0.0
    viscous = 0.0
    for e in range(n_element):
        ux = problem.element_bias[e, 0] + row[e, 0, 0] * vx + row[e, 0, 1] * vy + row[e, 0, 2] * vt
        uy = problem.element_bias[e, 1] + row[e, 1, 0] * vx + row[e, 1, 1] * vy + row[e, 1, 2] * vt
        uz = problem.element_bias[e, 2] + row[e, 2, 0] * vx + row[e, 2, 1] * vy + row[e, 2, 2] * vt
        square = ux * ux + uy * uy + uz * uz
        slip = math.sqrt(square)
        share = -limit[e] / slip if slip > 0.0 else 0.0
        p[e, 0] = share * ux
        p[e, 1] = share * uy
        p[e, 2] = share * uz
        lost += limit[e] * slip
        viscous += limit[e] * square
    # Impulses of the contact that do the work which sliding supports dissipate.
    share = lost / viscous if viscous > 0.0 else 0.0
    problem.impulse[0, 0] = share * normal
    problem.impulse[0, 1] = share * tangential
    if drives == 1:
        p[n_element, 0] = -share * (n[3] * normal + s[3] * tangential)
    return True
