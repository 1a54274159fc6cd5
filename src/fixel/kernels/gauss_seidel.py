"""Projected Gauss-Seidel, contact by contact, with accelerated sweeps: robust, but slow to converge
to the last digit.

A block without inertia (quasi-static bodies, drives) gets an inertia equal to its stiffness, and a
pull towards its velocity of the previous sweep, a proximal-point iteration. The pull vanishes at a
fixed point, so that the fixed points are exactly the solutions of the problem. After each sweep the
iterate is moved further along a direction that accumulates the changes of the sweeps, as in the
method of conjugate gradients. In a heap this saves up to nine sweeps of ten.

Source: Jourdan, Alart & Jean (1998) for the contacts; Rockafellar (1976) for the proximal pull;
Silcowitz-Hansen, Niebe & Erleben (2010) for the directions.
"""

import math

from fixel.kernels.arrays import N_CONTACT, N_DOF, N_ELEMENT, N_FREE_DOF, Problem, Workspace
from fixel.kernels.jit import kernel
from fixel.kernels.linear import invert_block

# Columns of `work.contact_change` and `work.element_change`.
_NORMAL = 5  # velocities of the two bodies per unit normal impulse
_TANGENT = 11  # and per unit tangential impulse
_COUPLING = 17  # relative velocities per unit impulse: normal, mixed, tangential
_OLD = 20  # impulse before the sweep
_ALONG = 22  # direction of acceleration
_STIFFNESS = 11
_OLD_ELEMENT = 12
_ALONG_ELEMENT = 15
TURN = 1.05  # times the squared change of the last sweep: a larger one begins a new direction
SOFT = 0.1  # part of a contact's normal compliance that sliding leaves, at least


@kernel
def gauss_seidel(problem: Problem, work: Workspace, tolerance: float, max_sweeps: int) -> float:
    """Sweep until the largest velocity change of a sweep is below `tolerance`; returns that
    change."""
    _prepare(problem, work)
    _prepare_contacts(problem, work)
    _prepare_elements(problem, work)
    change = math.inf
    size = 0.0
    for sweep in range(max_sweeps):
        _store(problem, work)
        change = _pull(problem, work)
        change = max(change, _sweep_elements(problem, work))
        change = max(change, _sweep_contacts(problem, work))
        if not change > tolerance:
            break
        if sweep < max_sweeps - 1:
            size = _accelerate(problem, work, size)
    return change


@kernel
def _store(problem: Problem, work: Workspace) -> None:
    """Store the iterate before a sweep."""
    for o in range(problem.size[N_DOF]):
        work.search[o, 0] = problem.velocity[o]
        work.search[o, 3] = work.centre[o]
    for i in range(problem.size[N_CONTACT]):
        for k in range(2):
            work.contact_change[i, _OLD + k] = problem.impulse[i, k]
    for e in range(problem.size[N_ELEMENT]):
        for k in range(3):
            work.element_change[e, _OLD_ELEMENT + k] = problem.element_impulse[e, k]


@kernel
def _accelerate(problem: Problem, work: Workspace, before: float) -> float:
    """Move the iterate along the accumulated direction; returns the squared change of the sweep.

    `before` is that of the last sweep. A sweep that changes clearly more than the last one begins a
    new direction; one that changes the same impulses again and again, hardly any velocity, does
    not.
    """
    p = problem.impulse
    q = problem.element_impulse
    contact = work.contact_change
    element = work.element_change
    search = work.search
    size = 0.0
    for i in range(problem.size[N_CONTACT]):
        for k in range(2):
            change = p[i, k] - contact[i, _OLD + k]
            size += change * change
    for e in range(problem.size[N_ELEMENT]):
        for k in range(3):
            change = q[e, k] - element[e, _OLD_ELEMENT + k]
            size += change * change
    share = min(1.0, size / before) if size < TURN * before else 0.0
    for i in range(problem.size[N_CONTACT]):
        for k in range(2):
            more = share * contact[i, _ALONG + k]
            contact[i, _ALONG + k] = more + p[i, k] - contact[i, _OLD + k]
            p[i, k] += more
    for e in range(problem.size[N_ELEMENT]):
        for k in range(3):
            more = share * element[e, _ALONG_ELEMENT + k]
            element[e, _ALONG_ELEMENT + k] = more + q[e, k] - element[e, _OLD_ELEMENT + k]
            q[e, k] += more
    for o in range(problem.size[N_DOF]):
        more = share * search[o, 1]
        search[o, 1] = more + problem.velocity[o] - search[o, 0]
        problem.velocity[o] += more
        more = share * search[o, 4]
        search[o, 4] = more + work.centre[o] - search[o, 3]
        work.centre[o] += more
    return size


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
        work.search[o, 1] = 0.0
        work.search[o, 4] = 0.0
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
def _prepare_contacts(problem: Problem, work: Workspace) -> None:
    """Compute how the velocities of each contact depend on its impulses."""
    row = work.contact_change
    inverse = work.inverse
    for i in range(problem.size[N_CONTACT]):
        for k in range(_NORMAL, _OLD):
            row[i, k] = 0.0
        for k in range(2):
            row[i, _ALONG + k] = 0.0
        for side in range(2):
            o = problem.contact_dof[i, side]
            if o < 0:
                continue
            for k in range(3 if o < problem.size[N_FREE_DOF] else 1):
                for m in range(3):
                    n = problem.normal[i, 3 * side + m]
                    t = problem.tangent[i, 3 * side + m]
                    row[i, _NORMAL + 3 * side + k] += inverse[o + k, m] * n
                    row[i, _TANGENT + 3 * side + k] += inverse[o + k, m] * t
        for k in range(6):
            row[i, _COUPLING] += row[i, _NORMAL + k] * problem.normal[i, k]
            row[i, _COUPLING + 1] += row[i, _NORMAL + k] * problem.tangent[i, k]
            row[i, _COUPLING + 2] += row[i, _TANGENT + k] * problem.tangent[i, k]


@kernel
def _sweep_contacts(problem: Problem, work: Workspace) -> float:
    v = problem.velocity
    row = work.contact_change
    largest = 0.0
    for i in range(problem.size[N_CONTACT]):
        p_n = problem.impulse[i, 0]
        p_t = problem.impulse[i, 1]
        u_n = problem.bias[i, 0]
        u_t = problem.bias[i, 1]
        for side in range(2):
            o = problem.contact_dof[i, side]
            if o >= 0:
                for k in range(3):
                    u_n += problem.normal[i, 3 * side + k] * v[o + k]
                    u_t += problem.tangent[i, 3 * side + k] * v[o + k]
        nn = row[i, _COUPLING]
        nt = row[i, _COUPLING + 1]
        tt = row[i, _COUPLING + 2]
        x_n, x_t = _contact_answer(
            u_n - nn * p_n - nt * p_t, u_t - nt * p_n - tt * p_t, nn, nt, tt, problem.friction[i],
            p_t,
        )  # fmt: skip
        d_n = x_n - p_n
        d_t = x_t - p_t
        if d_n == 0.0 and d_t == 0.0:
            continue
        problem.impulse[i, 0] = x_n
        problem.impulse[i, 1] = x_t
        for side in range(2):
            o = problem.contact_dof[i, side]
            if o >= 0:
                for k in range(3):
                    s = 3 * side + k
                    dv = row[i, _NORMAL + s] * d_n + row[i, _TANGENT + s] * d_t
                    v[o + k] += dv
                    largest = max(largest, abs(dv))
    return largest


@kernel
def _contact_answer(
    n: float, t: float, nn: float, nt: float, tt: float, friction: float, before: float
) -> tuple[float, float]:
    """Impulses of one contact with relative velocities (n, t) without impulses and the others
    constant; `before` is its present tangential impulse."""
    if n >= 0.0:
        return 0.0, 0.0
    determinant = nn * tt - nt * nt
    if determinant > 1e-9 * nn * tt:
        x_n = (nt * t - tt * n) / determinant
        x_t = (nt * n - nn * t) / determinant
        if x_n > 0.0 and abs(x_t) <= friction * x_n:
            return x_n, x_t
        slope = friction if x_t > 0.0 else -friction
        rest = nn + slope * nt
        if rest > SOFT * nn:
            x_n = -n / rest
            if (t + (nt + slope * tt) * x_n) * slope <= 0.0:
                return x_n, slope * x_n
    # Several answers, or none: one impulse after the other.
    x_n = max(0.0, -(n + nt * before) / nn)
    reach = friction * x_n
    return x_n, min(reach, max(-reach, -(t + nt * x_n) / tt))


@kernel
def _prepare_elements(problem: Problem, work: Workspace) -> None:
    """Compute the stiffness of each element: that of its most compliant row."""
    row = problem.element_row
    for e in range(problem.size[N_ELEMENT]):
        o = problem.element_dof[e]
        n = 3 if o < problem.size[N_FREE_DOF] else 1
        most = 0.0
        for j in range(3):
            compliance = 0.0
            for k in range(n):
                for m in range(n):
                    compliance += row[e, j, k] * work.inverse[o + k, m] * row[e, j, m]
            most = max(most, compliance)
            work.element_change[e, _ALONG_ELEMENT + j] = 0.0
        work.element_change[e, _STIFFNESS] = 1.0 / most if most > 0.0 else 0.0


@kernel
def _sweep_elements(problem: Problem, work: Workspace) -> float:
    row = problem.element_row
    p = problem.element_impulse
    v = problem.velocity
    inverse = work.inverse
    largest = 0.0
    for e in range(problem.size[N_ELEMENT]):
        o = problem.element_dof[e]
        x, y, z = friction_answer(problem, e, work.element_change[e, _STIFFNESS])
        dx = x - p[e, 0]
        dy = y - p[e, 1]
        dz = z - p[e, 2]
        p[e, 0] = x
        p[e, 1] = y
        p[e, 2] = z
        px = row[e, 0, 0] * dx + row[e, 1, 0] * dy + row[e, 2, 0] * dz
        py = row[e, 0, 1] * dx + row[e, 1, 1] * dy + row[e, 2, 1] * dz
        pz = row[e, 0, 2] * dx + row[e, 1, 2] * dy + row[e, 2, 2] * dz
        for k in range(3 if o < problem.size[N_FREE_DOF] else 1):
            dv = inverse[o + k, 0] * px + inverse[o + k, 1] * py + inverse[o + k, 2] * pz
            v[o + k] += dv
            largest = max(largest, abs(dv))
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
