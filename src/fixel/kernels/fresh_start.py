"""Start of Newton's method for one pushed body, from its contact instead of its last motion.

From rest, Newton's method knows neither which supports slide nor that the contact presses. Here the
supports resist in proportion to their slip, and the contact sticks, or slides where it has to:
three linear equations. From their solution Newton's method arrives in two to six iterations.
"""

import math

from fixel.kernels.arrays import N_CONTACT, N_DOF, N_ELEMENT, N_FREE_DOF, Problem
from fixel.kernels.jit import large_kernel

SINGULAR = 1e-9  # determinant, relative to the diagonal: supports that do not resist every motion


@large_kernel
def start_afresh(problem: Problem) -> bool:
    """Set velocity and impulses from the contact of one body without inertia.

    The body stays at rest where its contact does not close. Returns False, without a change, for
    other problems: with several contacts, drives or bodies, or inertia.
    """
    if (
        problem.size[N_DOF] != 3
        or problem.size[N_FREE_DOF] != 3
        or problem.size[N_CONTACT] != 1
        or problem.inertia[0, 0] != 0.0
    ):
        return False
    n_element = problem.size[N_ELEMENT]
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
    if closing > 0.0:
        along = -problem.bias[0, 1]
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
    return True
