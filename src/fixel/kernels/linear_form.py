"""Step problems as linear complementarity problems, for Lemke's method.

Friction impulses lie in polygons and intervals, and the velocities are eliminated:

    A = [ W_n'D^-1 W_n  W_n'D^-1 W_f  0 ]      z = (p_n, p_f, s)
        [ W_f'D^-1 W_n  W_f'D^-1 W_f  E ]      D inertia, W rows of the impulses,
        [ U             -E'           0 ]      U friction coefficients, s slip speeds

Blocks with little inertia (quasi-static bodies, drives) get some, and a pull towards their
velocities of the previous solve: a proximal-point iteration, as in gauss_seidel.py.

Source: Stewart & Trinkle (1996) and Anitescu & Potra (1997) for the form and why Lemke's method
ends at a solution of it; Rockafellar (1976) for the proximal pull.
"""

import math
from typing import Final

from fixel.kernels.arrays import N_CONTACT, N_DOF, N_ELEMENT, N_FREE_DOF, Problem, Workspace
from fixel.kernels.jit import kernel, large_kernel
from fixel.kernels.lemke import MAX_PIVOTS, SOLVED, Tableau, lemke, resolve

# Results of a solve, besides the codes of `lemke`.
NOT_LINEAR: Final = 4  # a friction element is a ball or an unapproximated disc
NO_ROOM: Final = 5  # the tableau has too few rows
UNSETTLED: Final = 6  # the proximal iteration did not come to rest

# Proximal mass over stiffness, tried in turn: small converges sooner, large is better scaled.
PULLS = (1e-2, 1.0, 1e-4)
MAX_PULLS = 100
ATTEMPTS = 2
ENOUGH = 10  # pivots per row with which a step may be begun; one or two are usual
SETTLED = 1e-10  # impulse left in the proximal pull, which is the momentum residual


@kernel
def tableau_size(problem: Problem, sides_for_discs: int) -> int:
    """Rows of the linear form of the present step; -1 where it has none."""
    rows = 4 * problem.size[N_CONTACT]
    for e in range(problem.size[N_ELEMENT]):
        m = _directions(problem, e, sides_for_discs)
        if m == 0:
            return -1
        rows += m + 1
    return int(rows)


@kernel
def _directions(problem: Problem, e: int, sides_for_discs: int) -> int:
    """Number of directions that span the impulses of element e; 0 where none can."""
    row = problem.element_row
    if row[e, 2, 0] != 0.0 or row[e, 2, 1] != 0.0 or row[e, 2, 2] != 0.0:
        return 0
    if problem.element_sides[e] > 0:
        return int(problem.element_sides[e])
    if row[e, 1, 0] == 0.0 and row[e, 1, 1] == 0.0 and row[e, 1, 2] == 0.0:
        return 2
    return sides_for_discs


@large_kernel
def solve_linear_form(
    problem: Problem, work: Workspace, tableau: Tableau, sides_for_discs: int, max_pivots: int
) -> int:
    """Solve a step with friction in polygons and intervals; returns one of the codes above.

    Parameters
    ----------
    problem : Problem
        In: `velocity` is the guess, towards which blocks without inertia are pulled first.
        Out: `velocity`, `impulse` and `element_impulse`, where SOLVED or UNSETTLED is returned.
    work : Workspace
        `inverse`, `pull`, `centre` and `right` are used.
    tableau : Tableau
        Tableau with room for `tableau_size` rows.
    sides_for_discs : int
        Sides of the polygon that replaces an exact disc, whose solution is then a start for
        another solver; with 0, discs return NOT_LINEAR.
    max_pivots : int
        Largest number of pivots for this step; `tableau.spent` counts them and may exceed it by
        one solve of a basis.

    Source: Stewart & Trinkle (1996), condensed; Anitescu & Potra (1997), theorem 3.1.
    """
    n = tableau_size(problem, sides_for_discs)
    if n < 0:
        return NOT_LINEAR
    if n > tableau.vector.size:
        return NO_ROOM
    _write_rows(problem, tableau, sides_for_discs)
    tableau.spent[0] = 0
    code = UNSETTLED
    for share in PULLS:
        pulled = _invert_blocks(problem, work, share)
        _write_matrix(problem, work, tableau, n, sides_for_discs)
        code = _settle(problem, work, tableau, n, sides_for_discs, max_pivots)
        if code == SOLVED or not pulled or tableau.spent[0] >= max_pivots:
            break
    return code


@kernel
def _settle(
    problem: Problem,
    work: Workspace,
    tableau: Tableau,
    n: int,
    sides_for_discs: int,
    max_pivots: int,
) -> int:
    """Repeat solving and updating the proximal centres until the pull vanishes."""
    for attempt in range(MAX_PULLS):
        _write_vector(problem, work, tableau, n)
        # Between solves only q changes, and the basis rarely does: try the last basis first.
        if attempt == 0 or not resolve(tableau, n):
            code = _insist(tableau, n, max_pivots)
            if code != SOLVED:
                return code
        _read_impulses(problem, tableau, sides_for_discs)
        if _read_velocity(problem, work, tableau, n) <= SETTLED:
            return SOLVED
        if tableau.spent[0] >= max_pivots:
            return MAX_PIVOTS
    return UNSETTLED


@kernel
def _insist(tableau: Tableau, n: int, max_pivots: int) -> int:
    """Call `lemke`, and where it fails once more with an uneven covering vector.

    A step with a solution ends on a ray only by rounding errors in ties between symmetric rows; an
    uneven vector has other ties. A step without one (a seated grasp) ends on a ray twice.
    """
    code = SOLVED
    for attempt in range(ATTEMPTS):
        for i in range(n):
            # Multiples of the golden ratio modulo one: evenly spread, all different.
            tableau.cover[i] = (
                1.0 if attempt == 0 else 0.5 + (0.6180339887498949 * (i + attempt)) % 1.0
            )
        code = lemke(tableau, n, max_pivots - tableau.spent[0])
        if code == SOLVED or tableau.spent[0] >= max_pivots:
            break
    return code


@kernel
def _invert_blocks(problem: Problem, work: Workspace, share: float) -> bool:
    """Write proximal masses and the inverse of every block; returns whether any mass is used."""
    n_free = problem.size[N_FREE_DOF]
    d = problem.inertia
    pulled = False
    for o in range(problem.size[N_DOF]):
        own = d[o, o % 3] if o < n_free else d[o, 0]
        pull = share * problem.stiffness[o]
        work.pull[o] = 0.0 if own > pull else pull
        pulled = pulled or work.pull[o] > 0.0
        work.centre[o] = problem.velocity[o]
    block = work.matrix
    for o in range(0, n_free, 3):
        for i in range(3):
            for j in range(3):
                block[i, j] = d[o + i, j]
            block[i, i] += work.pull[o + i]
        for i in range(3):
            # Cofactors, in cyclic order so that no sign is needed.
            p = (i + 1) % 3
            q = (i + 2) % 3
            for j in range(3):
                a = (j + 1) % 3
                b = (j + 2) % 3
                work.inverse[o + j, i] = block[p, a] * block[q, b] - block[p, b] * block[q, a]
        determinant = 0.0
        for j in range(3):
            determinant += block[0, j] * work.inverse[o + j, 0]
        for i in range(3):
            for j in range(3):
                work.inverse[o + i, j] /= determinant
    for o in range(n_free, problem.size[N_DOF]):
        work.inverse[o, 0] = 1.0 / (d[o, 0] + work.pull[o])
        work.inverse[o, 1] = 0.0
        work.inverse[o, 2] = 0.0
    return pulled


@kernel
def _write_rows(problem: Problem, tableau: Tableau, sides_for_discs: int) -> None:
    """Write lever, block and bias of every row: normal, two tangents, slip; or directions, slip."""
    for i in range(problem.size[N_CONTACT]):
        r = 4 * i
        for side in range(2):
            o = problem.contact_dof[i, side]
            for k in range(3 * side, 3 * side + 3):
                tableau.lever[r, k] = problem.normal[i, k]
                tableau.lever[r + 1, k] = problem.tangent[i, k]
                tableau.lever[r + 2, k] = -problem.tangent[i, k]
            for j in range(3):
                tableau.block[r + j, side] = o
            tableau.block[r + 3, side] = -1
        tableau.bias[r] = problem.bias[i, 0]
        tableau.bias[r + 1] = problem.bias[i, 1]
        tableau.bias[r + 2] = -problem.bias[i, 1]
        tableau.bias[r + 3] = 0.0
    r = 4 * problem.size[N_CONTACT]
    row = problem.element_row
    for e in range(problem.size[N_ELEMENT]):
        m = _directions(problem, e, sides_for_discs)
        for j in range(m):
            c = math.cos(2.0 * math.pi * j / m)
            s = math.sin(2.0 * math.pi * j / m)
            for k in range(3):
                tableau.lever[r, k] = c * row[e, 0, k] + s * row[e, 1, k]
                tableau.lever[r, 3 + k] = 0.0
            tableau.bias[r] = c * problem.element_bias[e, 0] + s * problem.element_bias[e, 1]
            tableau.block[r, 0] = problem.element_dof[e]
            tableau.block[r, 1] = -1
            r += 1
        tableau.bias[r] = problem.element_limit[e]
        tableau.block[r, 0] = -1
        tableau.block[r, 1] = -1
        r += 1


@kernel
def _write_matrix(
    problem: Problem, work: Workspace, tableau: Tableau, n: int, sides_for_discs: int
) -> None:
    """Write the matrix A, scaled from both sides: the block of each contact has size one.

    The unit of impulses is 1 / sqrt(compliance) and that of slips its inverse, so that the coupling
    entries (one, minus one, friction) do not change.
    """
    for r in range(n):
        for c in range(r, n):
            tableau.matrix[r, c] = 0.0
            tableau.matrix[c, r] = 0.0
        _write_compliance(problem, work, tableau, n, r)
    r = 0
    for i in range(problem.size[N_CONTACT]):
        _scale_group(tableau, r, 3)
        for j in range(1, 3):
            tableau.matrix[r + j, r + 3] = 1.0
            tableau.matrix[r + 3, r + j] = -1.0
        tableau.matrix[r + 3, r] = problem.friction[i]
        r += 4
    for e in range(problem.size[N_ELEMENT]):
        m = _directions(problem, e, sides_for_discs)
        _scale_group(tableau, r, m)
        for j in range(m):
            tableau.matrix[r + j, r + m] = 1.0
            tableau.matrix[r + m, r + j] = -1.0
        r += m + 1
    for r in range(n):
        for c in range(n):
            if tableau.block[r, 0] >= 0 and tableau.block[c, 0] >= 0:
                tableau.matrix[r, c] *= tableau.scale[r] * tableau.scale[c]


@kernel
def _write_compliance(problem: Problem, work: Workspace, tableau: Tableau, n: int, r: int) -> None:
    """Write row r of W' D^-1 W: the velocity along every row per unit impulse along row r."""
    lever = tableau.lever
    for side in range(2):
        o = tableau.block[r, side]
        if o < 0:
            continue
        s = 3 * side
        x, y, z = _respond(problem, work, o, lever[r, s], lever[r, s + 1], lever[r, s + 2])
        for c in range(n):
            for other in range(2):
                if tableau.block[c, other] == o:
                    k = 3 * other
                    tableau.matrix[r, c] += (
                        lever[c, k] * x + lever[c, k + 1] * y + lever[c, k + 2] * z
                    )


@kernel
def _respond(
    problem: Problem, work: Workspace, o: int, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Velocity of block o under the impulse (x, y, z)."""
    inverse = work.inverse
    if o >= problem.size[N_FREE_DOF]:
        return inverse[o, 0] * x, 0.0, 0.0
    return (
        inverse[o, 0] * x + inverse[o, 1] * y + inverse[o, 2] * z,
        inverse[o + 1, 0] * x + inverse[o + 1, 1] * y + inverse[o + 1, 2] * z,
        inverse[o + 2, 0] * x + inverse[o + 2, 1] * y + inverse[o + 2, 2] * z,
    )


@kernel
def _scale_group(tableau: Tableau, start: int, m: int) -> None:
    """Set the unit of the m impulses of a contact or element from its largest compliance."""
    largest = 0.0
    for j in range(start, start + m):
        largest = max(largest, tableau.matrix[j, j])
    unit = 1.0 / math.sqrt(largest) if largest > 0.0 else 1.0
    for j in range(start, start + m):
        tableau.scale[j] = unit
    tableau.scale[start + m] = 1.0 / unit


@kernel
def _write_vector(problem: Problem, work: Workspace, tableau: Tableau, n: int) -> None:
    """Write the vector b: velocities along every row without impulses, and the limits."""
    n_free = problem.size[N_FREE_DOF]
    v = problem.velocity
    right = work.right
    for o in range(problem.size[N_DOF]):
        right[o] = problem.momentum[o] + work.pull[o] * work.centre[o]
    for o in range(0, n_free, 3):
        v[o], v[o + 1], v[o + 2] = _respond(problem, work, o, right[o], right[o + 1], right[o + 2])
    for o in range(n_free, problem.size[N_DOF]):
        v[o] = work.inverse[o, 0] * right[o]
    for r in range(n):
        u = tableau.bias[r]
        for side in range(2):
            o = tableau.block[r, side]
            if o >= 0:
                for k in range(3):
                    u += tableau.lever[r, 3 * side + k] * v[o + k]
        tableau.vector[r] = tableau.scale[r] * u


@kernel
def _read_impulses(problem: Problem, tableau: Tableau, sides_for_discs: int) -> None:
    """Compute the impulses of contacts and elements from the solution."""
    z = tableau.answer
    for i in range(problem.size[N_CONTACT]):
        r = 4 * i
        problem.impulse[i, 0] = tableau.scale[r] * z[r]
        problem.impulse[i, 1] = tableau.scale[r] * (z[r + 1] - z[r + 2])
    r = 4 * problem.size[N_CONTACT]
    for e in range(problem.size[N_ELEMENT]):
        m = _directions(problem, e, sides_for_discs)
        for k in range(3):
            problem.element_impulse[e, k] = 0.0
        for j in range(m):
            if z[r] != 0.0:
                p = tableau.scale[r] * z[r]
                problem.element_impulse[e, 0] += p * math.cos(2.0 * math.pi * j / m)
                problem.element_impulse[e, 1] += p * math.sin(2.0 * math.pi * j / m)
            r += 1
        r += 1


@kernel
def _read_velocity(problem: Problem, work: Workspace, tableau: Tableau, n: int) -> float:
    """Compute velocities from the solution, also as new centres; returns the largest pull."""
    n_free = problem.size[N_FREE_DOF]
    v = problem.velocity
    right = work.right
    for r in range(n):
        p = tableau.scale[r] * tableau.answer[r]
        for side in range(2):
            o = tableau.block[r, side]
            if o >= 0 and p != 0.0:
                for k in range(3):
                    right[o + k] += p * tableau.lever[r, 3 * side + k]
    for o in range(0, n_free, 3):
        v[o], v[o + 1], v[o + 2] = _respond(problem, work, o, right[o], right[o + 1], right[o + 2])
    for o in range(n_free, problem.size[N_DOF]):
        v[o] = work.inverse[o, 0] * right[o]
    left = 0.0
    for o in range(problem.size[N_DOF]):
        left = max(left, work.pull[o] * abs(v[o] - work.centre[o]))
        work.centre[o] = v[o]
    return left
