"""Natural-map residual of a step problem, which shares no code with any solver."""

import math

from fixel.kernels.arrays import N_CONTACT, N_DOF, N_ELEMENT, N_FREE_DOF, Problem
from fixel.kernels.jit import kernel, large_kernel, view
from fixel.typing import FloatArray

MANY = 8  # elements of a body that are taken together
CHUNK = 16
SCRATCH = 7 * CHUNK


@kernel
def residual(problem: Problem, left_over: FloatArray) -> float:
    """Compute the largest violation of any row of the problem at its present velocity and impulses,
    in scaled units.

    The natural map consists of the momentum rows, ``min(p_n, u_n)``, the tangential impulse minus
    its projection on the friction interval, and each element impulse minus its projection on its
    ball or polygon. It is zero if and only if the problem is solved. Numbers that are not finite
    count as infinite.

    Parameters
    ----------
    problem : Problem
    left_over : (n_dof + 2 + SCRATCH,) float64
        Scratch; on return the momentum residual of each degree of freedom. With n_dof + 2 entries
        the elements are taken one by one.
    """
    n_dof = problem.size[N_DOF]
    v = problem.velocity
    worst = 0.0
    for i in range(n_dof):
        block = i - i % 3 if i < problem.size[N_FREE_DOF] else i
        left_over[i] = -problem.momentum[i]
        for k in range(3):
            left_over[i] += problem.inertia[i, k] * v[block + k]
    for i in range(problem.size[N_CONTACT]):
        p_n = problem.impulse[i, 0]
        p_t = problem.impulse[i, 1]
        u_n = problem.bias[i, 0]
        u_t = problem.bias[i, 1]
        for side in range(2):
            dof = problem.contact_dof[i, side]
            if dof >= 0:
                for k in range(3):
                    normal = problem.normal[i, 3 * side + k]
                    tangent = problem.tangent[i, 3 * side + k]
                    u_n += normal * v[dof + k]
                    u_t += tangent * v[dof + k]
                    left_over[dof + k] -= normal * p_n + tangent * p_t
        reach = problem.friction[i] * max(p_n, 0.0)
        worst = max(worst, abs(min(p_n, u_n)), abs(p_t - min(reach, max(-reach, p_t - u_t))))
        if not (math.isfinite(u_n) and math.isfinite(u_t) and math.isfinite(p_n + p_t)):
            return math.inf
    i = 0
    while i < problem.size[N_ELEMENT]:
        stop = _end_of_balls(problem, i)
        if stop - i >= MANY and left_over.size >= problem.momentum.size + SCRATCH:
            off = _off_balls(problem, left_over, i, stop)
            worst = max(worst, off)
            if not math.isfinite(off):
                return math.inf
            i = stop
            continue
        dof = problem.element_dof[i]
        row = problem.element_row
        p_x, p_y, p_z = problem.element_impulse[i]
        u_x = problem.element_bias[i, 0]
        u_y = problem.element_bias[i, 1]
        u_z = problem.element_bias[i, 2]
        for k in range(3):
            u_x += row[i, 0, k] * v[dof + k]
            u_y += row[i, 1, k] * v[dof + k]
            u_z += row[i, 2, k] * v[dof + k]
            left_over[dof + k] -= row[i, 0, k] * p_x + row[i, 1, k] * p_y + row[i, 2, k] * p_z
        limit = problem.element_limit[i]
        if problem.element_sides[i] == 0:
            off = _off_ball(p_x, p_y, p_z, p_x - u_x, p_y - u_y, p_z - u_z, limit)
        else:
            off = _off_polygon(p_x, p_y, p_x - u_x, p_y - u_y, limit, problem.element_sides[i])
        worst = max(worst, off)
        if not math.isfinite(off):
            return math.inf
        i += 1
    for i in range(n_dof):
        worst = max(worst, abs(left_over[i]))
        if not math.isfinite(left_over[i]):
            return math.inf
    return worst


@kernel
def _end_of_balls(problem: Problem, first: int) -> int:
    """Find the end of the elements from `first` on that are balls of one body."""
    end = first
    while (
        end < problem.size[N_ELEMENT]
        and problem.element_dof[end] == problem.element_dof[first]
        and problem.element_sides[end] == 0
    ):
        end += 1
    return end


@large_kernel
def _off_balls(problem: Problem, left_over: FloatArray, first: int, stop: int) -> float:
    """Compute the largest of `_off_ball` of many elements of one body, and add their impulses to
    the momentum residual. Not finite where a number of theirs is not.

    In chunks, so that the compiler uses vector instructions for the roots and quotients.
    """
    row = problem.element_row
    dof = problem.element_dof[first]
    v_0 = problem.velocity[dof]
    v_1 = problem.velocity[dof + 1]
    v_2 = problem.velocity[dof + 2]
    chunk = view(left_over, problem.momentum.size, (7, CHUNK))
    wrench_x = 0.0
    wrench_y = 0.0
    wrench_t = 0.0
    worst = 0.0
    total = 0.0
    for begin in range(first, stop, CHUNK):
        n = min(CHUNK, stop - begin)
        for j in range(n):
            i = begin + j
            p_x = problem.element_impulse[i, 0]
            p_y = problem.element_impulse[i, 1]
            p_z = problem.element_impulse[i, 2]
            u_x = row[i, 0, 0] * v_0 + row[i, 0, 1] * v_1 + row[i, 0, 2] * v_2
            u_y = row[i, 1, 0] * v_0 + row[i, 1, 1] * v_1 + row[i, 1, 2] * v_2
            u_z = row[i, 2, 0] * v_0 + row[i, 2, 1] * v_1 + row[i, 2, 2] * v_2
            wrench_x += row[i, 0, 0] * p_x + row[i, 1, 0] * p_y + row[i, 2, 0] * p_z
            wrench_y += row[i, 0, 1] * p_x + row[i, 1, 1] * p_y + row[i, 2, 1] * p_z
            wrench_t += row[i, 0, 2] * p_x + row[i, 1, 2] * p_y + row[i, 2, 2] * p_z
            chunk[0, j] = p_x
            chunk[1, j] = p_y
            chunk[2, j] = p_z
            chunk[3, j] = p_x - (problem.element_bias[i, 0] + u_x)
            chunk[4, j] = p_y - (problem.element_bias[i, 1] + u_y)
            chunk[5, j] = p_z - (problem.element_bias[i, 2] + u_z)
            chunk[6, j] = problem.element_limit[i]
        for j in range(n):
            x = chunk[3, j]
            y = chunk[4, j]
            z = chunk[5, j]
            limit = chunk[6, j]
            square = x * x + y * y + z * z
            shrink = limit / math.sqrt(square) if square > limit * limit else 1.0
            off_x = abs(chunk[0, j] - shrink * x)
            off_y = abs(chunk[1, j] - shrink * y)
            off_z = abs(chunk[2, j] - shrink * z)
            # Without a branch: where a square is not finite, neither is this.
            chunk[0, j] = max(max(off_x, off_y), off_z) + 0.0 * square
        for j in range(n):
            worst = max(worst, chunk[0, j])
            total += chunk[0, j]
    left_over[dof] -= wrench_x
    left_over[dof + 1] -= wrench_y
    left_over[dof + 2] -= wrench_t
    return worst + 0.0 * total


@kernel
def _off_ball(
    p_x: float, p_y: float, p_z: float, x: float, y: float, z: float, limit: float
) -> float:
    """Largest coordinate of p minus the projection of (x, y, z) on the ball of radius `limit`."""
    length = math.sqrt(x * x + y * y + z * z)
    if not math.isfinite(length):
        return math.inf  # the squares overflowed
    shrink = limit / length if length > limit else 1.0
    return max(abs(p_x - shrink * x), abs(p_y - shrink * y), abs(p_z - shrink * z))


@kernel
def _off_polygon(p_x: float, p_y: float, x: float, y: float, limit: float, sides: int) -> float:
    """Largest coordinate of p minus the projection of (x, y) on a regular polygon with `sides`."""
    wedge = 2.0 * math.pi / sides
    middle = (math.floor(math.atan2(y, x) / wedge) + 0.5) * wedge
    out_x = math.cos(middle)
    out_y = math.sin(middle)
    foot = limit * math.cos(0.5 * wedge)
    if x * out_x + y * out_y > foot:
        half_side = limit * math.sin(0.5 * wedge)
        along = min(half_side, max(-half_side, y * out_x - x * out_y))
        x = foot * out_x - along * out_y
        y = foot * out_y + along * out_x
    return max(abs(p_x - x), abs(p_y - y))
