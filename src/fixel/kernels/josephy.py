"""Newton's method for generalised equations: contacts by pivoting, friction elements linearised.

In each iteration Newton on the natural map chooses which contacts press, slide and stick. It may
cycle where these choices exclude each other: a part that seats between a pusher and a fixel is held
by forces a hundred times those of the step before. Here only the support friction is linearised.
The rest is a linear complementarity problem in the few contacts and drives, which Lemke's method
solves along a path. One or two iterations are usual, each with tens of pivots of a small
tableau.

Source: Josephy (1979) for the method; Stewart & Trinkle (1996) for the linear problem, copositive,
so that Lemke's method ends with a solution unless prescribed motions jam a body.
"""

import math

from fixel.kernels.arrays import N_CONTACT, N_DOF, N_ELEMENT, N_FREE_DOF, Problem, Workspace
from fixel.kernels.gauss_seidel import friction_answer
from fixel.kernels.jit import kernel, large_kernel
from fixel.kernels.linear import invert_block
from fixel.kernels.newton import FLOOR, step_all
from fixel.kernels.proximal import linearise_any
from fixel.typing import FloatArray

MAX_CONTACTS = 12
MAX_DRIVES = 4
MAX_UNKNOWNS = 36
COMPLIANCE = 1e-5  # of an element that sticks, relative to its block's
PULL = 1e-4  # towards the present velocity, relative to its block's stiffness, where a body
LIGHT = 1e-3  # has less inertia than this
SMALL = 1e-11  # of the largest entry of a column: smaller entries are no pivots
PIVOTS = 8  # largest number per row
WHOLE_STEPS = 8  # iterations before steps are shortened
ARRIVED = 1e-10  # change of velocity at convergence


@large_kernel
def josephy(problem: Problem, work: Workspace, iteration: int, covering: int) -> bool:
    """Take one iteration of the method; returns False where another would not help.

    Solutions of the linear problem may lead to each other in a cycle. Another `covering` vector
    finds other solutions, and later iterations take part of the step only.
    """
    n_contact = problem.size[N_CONTACT]
    n_element = problem.size[N_ELEMENT]
    n_drive = problem.size[N_DOF] - problem.size[N_FREE_DOF]
    n_support = 0
    while n_support < n_element and problem.element_dof[n_support] < problem.size[N_FREE_DOF]:
        n_support += 1
    if not is_small(problem) or n_element - n_support != n_drive:
        return False
    pull = FLOOR
    for o in range(0, problem.size[N_FREE_DOF], 3):
        if problem.inertia[o, 0] < LIGHT * problem.stiffness[o]:
            pull = PULL
    # Without contacts and drives: every body separately on its supports.
    problem.size[N_CONTACT] = 0
    problem.size[N_ELEMENT] = n_support
    linearise_any(problem, work, COMPLIANCE, pull, False, False, False)
    problem.size[N_CONTACT] = n_contact
    problem.size[N_ELEMENT] = n_element
    m = work.matrix
    for o in range(0, problem.size[N_FREE_DOF], 3):
        invert_block(
            work.inverse, o, m[o, o], m[o, o + 1], m[o, o + 2], m[o + 1, o + 1], m[o + 1, o + 2],
            m[o + 2, o + 2],
        )  # fmt: skip
    _write_tableau(problem, work, n_support, covering)
    if not _lemke(work.tableau, work.basis, 4 * n_contact + 2 * n_drive):
        return True
    return (
        _take_answer(problem, work, n_support, 1.0 if iteration < WHOLE_STEPS else 0.25) > ARRIVED
    )


@kernel
def is_small(problem: Problem) -> bool:
    """Whether a problem has few enough contacts, drives and unknowns for this method."""
    n_drive = problem.size[N_DOF] - problem.size[N_FREE_DOF]
    return (
        problem.size[N_DOF] <= MAX_UNKNOWNS
        and problem.size[N_CONTACT] <= MAX_CONTACTS
        and n_drive <= MAX_DRIVES
    )


@kernel
def _coupling(
    problem: Problem, work: Workspace, first: FloatArray, i: int, second: FloatArray, j: int
) -> float:
    """Velocity along row i of `first` per unit impulse along row j of `second`."""
    total = 0.0
    for side in range(2):
        o = problem.contact_dof[i, side]
        if o < 0 or o >= problem.size[N_FREE_DOF]:
            continue
        for other in range(2):
            if problem.contact_dof[j, other] == o:
                for k in range(3):
                    for m in range(3):
                        total += (
                            first[i, 3 * side + k]
                            * work.inverse[o + k, m]
                            * second[j, 3 * other + m]
                        )
    return total


@kernel
def _write_tableau(problem: Problem, work: Workspace, n_support: int, covering: int) -> None:
    """Write the linear complementarity problem as the initial tableau of Lemke's method.

    Unknowns of contact i from 4 i: normal impulse, tangential impulse forwards and backwards, slip
    speed. Unknowns of drive d from 4 n + 2 d: speed below, and above, the commanded one. Rows of
    a drive: unused part of its force limit. The `covering` selects among several solutions.
    """
    n_contact = problem.size[N_CONTACT]
    n_free = problem.size[N_FREE_DOF]
    n_drive = problem.size[N_DOF] - n_free
    n = 4 * n_contact + 2 * n_drive
    t = work.tableau
    v = problem.velocity
    for r in range(n):
        for c in range(2 * n + 2):
            t[r, c] = 0.0
        t[r, r] = 1.0
        t[r, 2 * n] = -1.0 / (1 + (7 * r * covering) % 11)
    q = 2 * n + 1
    unit = work.contact_change
    least = math.inf
    for i in range(n_contact):
        give = _coupling(problem, work, problem.normal, i, problem.normal, i) + _coupling(
            problem, work, problem.tangent, i, problem.tangent, i
        )
        unit[i, 0] = 1.0 / give if give > 0.0 else 1.0
        least = min(least, unit[i, 0])
    # Velocities without contact impulses, the drives at the commanded speed.
    free = work.centre
    for o in range(0, n_free, 3):
        for k in range(3):
            free[o + k] = v[o + k]
            for m in range(3):
                free[o + k] += work.inverse[o + k, m] * work.right[o + m]
    for d in range(n_drive):
        free[n_free + d] = -problem.element_bias[n_support + d, 0]
    for i in range(n_contact):
        r = 4 * i
        for side in range(2):
            o = problem.contact_dof[i, side]
            if o < 0:
                continue
            for k in range(3):
                t[r, q] += problem.normal[i, 3 * side + k] * free[o + k]
                t[r + 1, q] += problem.tangent[i, 3 * side + k] * free[o + k]
            if o >= n_free:
                r_drive = 4 * n_contact + 2 * (o - n_free)
                _couple_drive(problem, t, i, r_drive, side, n, unit[i, 0] / least)
        t[r, q] += problem.bias[i, 0]
        t[r + 1, q] += problem.bias[i, 1]
        t[r + 2, q] = -t[r + 1, q]
        for j in range(n_contact):
            c = n + 4 * j
            scale = unit[j, 0]
            nn = scale * _coupling(problem, work, problem.normal, i, problem.normal, j)
            nt = scale * _coupling(problem, work, problem.normal, i, problem.tangent, j)
            tn = scale * _coupling(problem, work, problem.tangent, i, problem.normal, j)
            tt = scale * _coupling(problem, work, problem.tangent, i, problem.tangent, j)
            t[r, c] = -nn
            t[r, c + 1] = -nt
            t[r, c + 2] = nt
            t[r + 1, c] = -tn
            t[r + 1, c + 1] = -tt
            t[r + 1, c + 2] = tt
            t[r + 2, c] = tn
            t[r + 2, c + 1] = tt
            t[r + 2, c + 2] = -tt
        c = n + r
        t[r + 1, c + 3] = -1.0
        t[r + 2, c + 3] = -1.0
        t[r + 3, c] = -problem.friction[i]
        t[r + 3, c + 1] = 1.0
        t[r + 3, c + 2] = 1.0
    for d in range(n_drive):
        r = 4 * n_contact + 2 * d
        o = n_free + d
        inertia = problem.inertia[o, 0] / least
        force = inertia * free[o] - problem.momentum[o] / least
        t[r, q] = problem.element_limit[n_support + d] / least - force
        t[r + 1, q] = problem.element_limit[n_support + d] / least + force
        t[r, n + r] -= inertia
        t[r, n + r + 1] += inertia
        t[r + 1, n + r] += inertia
        t[r + 1, n + r + 1] -= inertia


@kernel
def _couple_drive(
    problem: Problem, t: FloatArray, i: int, r: int, side: int, n: int, scale: float
) -> None:
    """Couple a contact and a drive: the contact to the deviation of the drive's speed, the drive to
    the contact's impulses, scaled."""
    along = problem.normal[i, 3 * side]
    across = problem.tangent[i, 3 * side]
    c = 4 * i
    for sign in range(2):
        direction = 1.0 if sign == 0 else -1.0  # slower, faster
        t[c, n + r + sign] += direction * along
        t[c + 1, n + r + sign] += direction * across
        t[c + 2, n + r + sign] -= direction * across
        t[r + sign, n + c] -= direction * scale * along
        t[r + sign, n + c + 1] -= direction * scale * across
        t[r + sign, n + c + 2] += direction * scale * across


@kernel
def _lemke(t: FloatArray, basis: FloatArray, n: int) -> bool:
    """Pivot the tableau ``w - M z - z0 = q`` until z0 leaves; lexicographic, so it never cycles.

    ``basis[r]`` is the column that row r represents: w from 0, z from n, z0 is 2 n.
    """
    q = 2 * n + 1
    row = -1
    scale = 0.0
    for r in range(n):
        scale = max(scale, abs(t[r, q]))
    for r in range(n):
        basis[r] = r
        if t[r, q] < 0.0 and (row < 0 or t[r, q] * t[row, 2 * n] > t[row, q] * t[r, 2 * n]):
            row = r
    if row < 0:
        return True
    column = 2 * n
    for _ in range(PIVOTS * n):
        leaving = int(basis[row])
        _pivot(t, row, column, n)
        basis[row] = column
        if leaving == 2 * n:
            return True
        column = leaving + n if leaving < n else leaving - n
        largest = 0.0
        for r in range(n):
            largest = max(largest, abs(t[r, column]))
        row = -1
        for r in range(n):
            if t[r, column] > SMALL * largest and (
                row < 0 or _comes_first(t, r, row, column, basis, n, scale)
            ):
                row = r
        if row < 0:
            return False
    return False


@kernel
def _comes_first(
    t: FloatArray, r: int, row: int, column: int, basis: FloatArray, n: int, scale: float
) -> bool:
    """Whether row r blocks before `row`: by the quotients of q, then of the first columns."""
    q = 2 * n + 1
    a = t[r, q] / t[r, column]
    b = t[row, q] / t[row, column]
    slack = 1e-13 * scale * (1.0 / t[r, column] + 1.0 / t[row, column])
    if a < b - slack:
        return True
    if a > b + slack:
        return False
    if basis[r] == 2 * n:
        return True
    if basis[row] == 2 * n:
        return False
    for k in range(n):
        a = t[r, k] / t[r, column]
        b = t[row, k] / t[row, column]
        slack = 1e-13 * (1.0 / t[r, column] + 1.0 / t[row, column])
        if a < b - slack:
            return True
        if a > b + slack:
            return False
    return False


@kernel
def _pivot(t: FloatArray, row: int, column: int, n: int) -> None:
    inverse = 1.0 / t[row, column]
    for c in range(2 * n + 2):
        t[row, c] *= inverse
    for r in range(n):
        factor = t[r, column]
        if r != row and factor != 0.0:
            for c in range(2 * n + 2):
                t[r, c] -= factor * t[row, c]
    # Set exactly, without rounding errors.
    for r in range(n):
        t[r, column] = 1.0 if r == row else 0.0


@kernel
def _take_answer(problem: Problem, work: Workspace, n_support: int, share: float) -> float:
    """Take the impulses of the tableau's solution and a share of the change to its velocities;
    returns the largest change of velocity."""
    n_contact = problem.size[N_CONTACT]
    n_free = problem.size[N_FREE_DOF]
    n_drive = problem.size[N_DOF] - n_free
    n_element = problem.size[N_ELEMENT]
    n = 4 * n_contact + 2 * n_drive
    t = work.tableau
    v = problem.velocity
    right = work.right
    for i in range(n_contact):
        problem.impulse[i, 0] = 0.0
        problem.impulse[i, 1] = 0.0
    for d in range(n_drive):
        work.search[n_free + d, 0] = work.centre[n_free + d]
    for r in range(n):
        c = int(work.basis[r]) - n
        value = t[r, 2 * n + 1]
        if c < 0 or c >= n:
            continue
        if c >= 4 * n_contact:
            d = (c - 4 * n_contact) // 2
            work.search[n_free + d, 0] += -value if c % 2 == 0 else value
        elif c % 4 == 0:
            problem.impulse[c // 4, 0] = work.contact_change[c // 4, 0] * max(0.0, value)
        elif c % 4 == 1:
            problem.impulse[c // 4, 1] += work.contact_change[c // 4, 0] * value
        elif c % 4 == 2:
            problem.impulse[c // 4, 1] -= work.contact_change[c // 4, 0] * value
    change = 0.0
    for d in range(n_drive):
        o = n_free + d
        change = max(change, abs(work.search[o, 0] - v[o]))
        v[o] = work.search[o, 0]
        problem.element_impulse[n_support + d, 0] = (
            problem.inertia[o, 0] * v[o] - problem.momentum[o]
        )
    for i in range(n_contact):
        for side in range(2):
            o = problem.contact_dof[i, side]
            if o < 0:
                continue
            pn = problem.impulse[i, 0]
            pt = problem.impulse[i, 1]
            if o >= n_free:
                problem.element_impulse[n_support + o - n_free, 0] -= (
                    problem.normal[i, 3 * side] * pn + problem.tangent[i, 3 * side] * pt
                )
                continue
            for k in range(3):
                right[o + k] += (
                    problem.normal[i, 3 * side + k] * pn + problem.tangent[i, 3 * side + k] * pt
                )
    for o in range(0, n_free, 3):
        x = right[o]
        y = right[o + 1]
        z = right[o + 2]
        for k in range(3):
            right[o + k] = (
                work.inverse[o + k, 0] * x + work.inverse[o + k, 1] * y + work.inverse[o + k, 2] * z
            )
            change = max(change, abs(right[o + k]))
            right[o + k] *= share
    for o in range(n_free, problem.size[N_DOF]):
        right[o] = 0.0
    # Update the elements' impulses from their velocities; those of contacts are already set.
    problem.size[N_CONTACT] = 0
    problem.size[N_ELEMENT] = n_support
    step_all(problem, work)
    problem.size[N_CONTACT] = n_contact
    problem.size[N_ELEMENT] = n_element
    # Linearised where it sticks, an element gets an impulse far above its limit; linearised there
    # again, nearly none. So project it to its friction law at its slip velocity.
    p = problem.element_impulse
    for e in range(n_support):
        rho = problem.stiffness[problem.element_dof[e]]
        p[e, 0], p[e, 1], p[e, 2] = friction_answer(problem, e, rho)
    return change if math.isfinite(change) else math.inf
