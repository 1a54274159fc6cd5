"""Semismooth Newton on the natural map of one step, in velocity space.

Each contact and each friction element is linearised in its present state (apart, sliding, sticking) and its
impulse eliminated, so that a linear system in the velocities alone is left: three unknowns for one body
however many points it rests on. Constraints enter with a compliance EPSILON times the block's own; as each
iteration starts from the impulses of the last, the compliance leaves no trace in the answer, and redundant
contacts (two on one edge, three supports that all stick) are no special case.

Source: Alart & Curnier (1991) for the map; the compliance is a proximal step as in Rockafellar (1976).
"""

import math

from fixel.kernels.arrays import FloatArray, Problem, Workspace
from fixel.kernels.jit import kernel
from fixel.kernels.linear import DENSE_LIMIT, solve_dense, solve_skyline

EPSILON = (
    1e-5  # compliance of a held constraint, relative to its block's; larger needs more iterations
)

# States of a contact in this iteration.
_APART = 0
_SLIDING = 1
_STICKING = 2


@kernel
def newton(
    problem: Problem, work: Workspace, tolerance: float, max_iterations: int, damped: bool
) -> tuple[float, int]:
    """Improve the problem's velocity and impulses until the map is below `tolerance`.

    Returns the largest entry of the natural map at the last linearisation (impulse units of this module's
    own scaling); above `tolerance` it has failed.
    """
    epsilon = 1.0 if damped else EPSILON
    before = math.inf
    full = True
    for iteration in range(max_iterations):
        worst = _linearise(problem, work, epsilon)
        # The momentum rows are linear: a full step leaves them solved, but the guess need not solve them.
        if iteration > 0 and full and worst <= tolerance:
            return worst, iteration
        if damped:
            epsilon = (
                max(EPSILON, 0.1 * epsilon) if worst < 0.8 * before else min(1.0, 10.0 * epsilon)
            )
            before = worst
            _linearise(problem, work, epsilon)
        n_dof = problem.size[0]
        if n_dof <= DENSE_LIMIT:
            solved = solve_dense(work.matrix, work.right, n_dof)
        else:
            solved = solve_skyline(work.matrix, work.matrix_upper, work.profile, work.right, n_dof)
        if not solved:
            return math.inf, iteration
        full = True
        if damped:
            largest = 0.0
            for i in range(n_dof):
                largest = max(largest, abs(work.right[i]))
            if largest > 2.0:
                full = False
                _update(problem, work, epsilon, 2.0 / largest)
                continue
        _update(problem, work, epsilon, 1.0)
    return _linearise(problem, work, epsilon), max_iterations


@kernel
def _linearise(problem: Problem, work: Workspace, epsilon: float) -> float:
    """Fill the linear system of the present iterate; returns the largest entry of the natural map."""
    n_dof = problem.size[0]
    n_free = problem.size[3]
    v = problem.velocity
    matrix = work.matrix
    right = work.right
    dense = n_dof <= DENSE_LIMIT
    pull = epsilon if epsilon > EPSILON else 1e-11
    for i in range(n_dof):
        for j in range(0 if dense else work.profile[i], n_dof if dense else i + 1):
            matrix[i, j] = 0.0
            if not dense:
                work.matrix_upper[i, j] = 0.0
    for i in range(0, n_free, 3):
        for k in range(3):
            total = problem.momentum[i + k]
            for m in range(3):
                inertia = problem.inertia[i + k, m]
                total -= inertia * v[i + m]
                if dense or m <= k:
                    matrix[i + k, i + m] = inertia
                else:
                    work.matrix_upper[i + m, i + k] = inertia
            matrix[i + k, i + k] += pull * problem.stiffness[i + k]
            right[i + k] = total
    for i in range(n_free, n_dof):
        matrix[i, i] = problem.inertia[i, 0] + pull * problem.stiffness[i]
        right[i] = problem.momentum[i] - problem.inertia[i, 0] * v[i]
    return max(
        _add_elements(problem, work, dense, epsilon), _add_contacts(problem, work, dense, epsilon)
    )


@kernel
def _add(matrix: FloatArray, upper: FloatArray, dense: bool, i: int, j: int, value: float) -> None:
    if dense or j <= i:
        matrix[i, j] += value
    else:
        upper[j, i] += value


@kernel
def _add_elements(problem: Problem, work: Workspace, dense: bool, epsilon: float) -> float:
    v = problem.velocity
    row = problem.element_row
    p = problem.element_impulse
    change = work.element_change
    right = work.right
    matrix = work.matrix
    worst = 0.0
    for e in range(problem.size[2]):
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
        zx = p[e, 0] - rho * ux
        zy = p[e, 1] - rho * uy
        zz = p[e, 2] - rho * uz
        stiff = rho / epsilon
        # The change of impulse is c - (kx, ky, kz) slip change, with slip change taken across `d`.
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
                    _add(
                        matrix,
                        work.matrix_upper,
                        dense,
                        o + k,
                        o + m,
                        t0 * row[e, 0, m] + t1 * row[e, 1, m] + t2 * row[e, 2, m],
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
def _add_contacts(problem: Problem, work: Workspace, dense: bool, epsilon: float) -> float:
    v = problem.velocity
    p = problem.impulse
    normal = problem.normal
    tangent = problem.tangent
    change = work.contact_change
    right = work.right
    worst = 0.0
    for i in range(problem.size[1]):
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
        zn = pn - rho * un
        zt = pt - rho * ut
        stiff = rho / epsilon
        if zn <= 0.0:
            state = _APART
            cn = -pn
            ct = -pt
            slope = 0.0
            worst = max(worst, abs(pn), abs(pt))
        else:
            cn = -stiff * un
            if abs(zt) <= mu * zn:
                state = _STICKING
                slope = 0.0
                ct = -stiff * ut
                worst = max(worst, abs(rho * un), abs(rho * ut))
            else:
                state = _SLIDING
                slope = mu if zt > 0.0 else -mu
                ct = slope * (pn + cn) - pt
                worst = max(worst, abs(rho * un), abs(pt - slope * zn))
        change[i, 0] = cn
        change[i, 1] = ct
        change[i, 2] = slope
        change[i, 3] = float(state)
        fn = pn + cn
        ft = pt + ct
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
                push = stiff * (wn + slope * wt)
                drag = stiff * wt if state == _STICKING else 0.0
                for other in range(2):
                    q = a if other == 0 else b
                    if q < 0:
                        continue
                    for m in range(3):
                        _add(
                            work.matrix,
                            work.matrix_upper,
                            dense,
                            o + k,
                            q + m,
                            push * normal[i, 3 * other + m] + drag * tangent[i, 3 * other + m],
                        )
    return worst


@kernel
def _update(problem: Problem, work: Workspace, epsilon: float, alpha: float) -> None:
    """Move the velocities by the solution in `work.right`, and the impulses with them."""
    dv = work.right
    p = problem.impulse
    for i in range(problem.size[1]):
        state = int(work.contact_change[i, 3])
        p[i, 0] += alpha * work.contact_change[i, 0]
        p[i, 1] += alpha * work.contact_change[i, 1]
        if state == _APART:
            continue
        a = problem.contact_dof[i, 0]
        b = problem.contact_dof[i, 1]
        rho = problem.stiffness[a]
        dn = 0.0
        dt = 0.0
        for k in range(3):
            dn += problem.normal[i, k] * dv[a + k]
            dt += problem.tangent[i, k] * dv[a + k]
        if b >= 0:
            rho = min(rho, problem.stiffness[b])
            for k in range(3):
                dn += problem.normal[i, 3 + k] * dv[b + k]
                dt += problem.tangent[i, 3 + k] * dv[b + k]
        stiff = rho / epsilon
        p[i, 0] -= alpha * stiff * dn
        if state == _STICKING:
            p[i, 1] -= alpha * stiff * dt
        else:
            p[i, 1] -= alpha * work.contact_change[i, 2] * stiff * dn
    change = work.element_change
    row = problem.element_row
    for e in range(problem.size[2]):
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
        problem.element_impulse[e, 0] += alpha * (
            change[e, 0] - kappa * (ux - cross * change[e, 4])
        )
        problem.element_impulse[e, 1] += alpha * (
            change[e, 1] - kappa * (uy - cross * change[e, 5])
        )
        problem.element_impulse[e, 2] += alpha * (
            change[e, 2] - kappa * (uz - cross * change[e, 6])
        )
    for i in range(problem.size[0]):
        problem.velocity[i] += alpha * dv[i]
