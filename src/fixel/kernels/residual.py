"""Natural-map residual of a step problem, which shares no code with any solver."""

import math

from fixel.kernels.arrays import N_CONTACT, N_DOF, N_ELEMENT, N_FREE_DOF, Problem
from fixel.kernels.jit import kernel
from fixel.typing import FloatArray


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
    left_over : (n_dof + 2,) float64
        Scratch; on return the momentum residual of each degree of freedom.
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
    for i in range(problem.size[N_ELEMENT]):
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
    for i in range(n_dof):
        worst = max(worst, abs(left_over[i]))
        if not math.isfinite(left_over[i]):
            return math.inf
    return worst


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
