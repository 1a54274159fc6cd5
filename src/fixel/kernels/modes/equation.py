"""Velocity and forces of a mode, as a smooth equation of the pose and the pusher's clock.

Newton's method solves for the velocity, the contact forces and the margins, which are positive as
long as the mode holds; docs/theory/modes.md derives the equation. The slowest support point is held
in polar coordinates, slip and direction: where the centre of rotation passes through it, its slip
goes through zero while everything else stays smooth.
"""

import math

from fixel.kernels import codes
from fixel.kernels.arrays import Model
from fixel.kernels.jit import kernel, large_kernel
from fixel.kernels.linear import solve_dense
from fixel.kernels.modes.geometry import (
    DRIVE,
    FLUSH,
    FORM,
    LIMIT,
    N_CLOSED,
    N_MARGIN,
    OWN,
    PIVOT,
    POLE,
    ROWS,
    SECOND,
    SLIP,
    SPEED,
    SUPPORT,
    ContactMode,
    place_contact,
    place_mode,
)
from fixel.typing import FloatArray

NEWTON_STEPS = 25
SOLVED = 1e-12
ENOUGH = 1e-10
TURN = 0.6  # [rad] of the pole's direction in one step of Newton, at most
FASTEST = 1e6
SLOW = 1e-9  # slip of a support point below which its direction is not resolved


@large_kernel
def write_rows(model: Model, mode: ContactMode) -> int:
    """Write the rows of the contacts and of the pivot at the frames of the mode; returns their
    number, or -1 for too many."""
    size = mode.size
    x = mode.frame[0, 2]
    y = mode.frame[0, 3]
    for k in range(N_MARGIN):
        mode.margin[k] = math.inf
    n = 0
    for c in range(size[N_CLOSED]):
        own = mode.contact[c]
        flush = own[FORM] == FLUSH
        if n + 2 + (1 if flush else 0) > 6:
            return -1
        nx, ny, px, py, gap, angle = place_contact(model, mode, c)
        rx = px - x
        ry = py - y
        turn_n = rx * ny - ry * nx
        turn_t = rx * nx + ry * ny
        un = 0.0
        ut = 0.0
        spin = 0.0
        body = model.piece_body[own[SECOND]]
        if body == 1:
            spin = mode.motion[2]
            ux = mode.motion[0] - spin * (py - mode.frame[1, 3])
            uy = mode.motion[1] + spin * (px - mode.frame[1, 2])
            un = ux * nx + uy * ny
            ut = -ux * ny + uy * nx
        rub = own[SLIP] * model.friction[0, body]
        mode.tangent[c, 0] = -ny
        mode.tangent[c, 1] = nx
        mode.tangent[c, 2] = turn_t
        mode.tangent[c, 3] = ut
        _set_row(mode, n, nx, ny, turn_n, un, gap)
        mode.pull[n, 0] = nx - rub * ny
        mode.pull[n, 1] = ny + rub * nx
        mode.pull[n, 2] = turn_n + rub * turn_t
        mode.push[n] = un + rub * ut
        n += 1
        if own[SLIP] == 0:
            _set_row(mode, n, -ny, nx, turn_t, ut, 0.0)
            n += 1
        if flush:
            _set_row(mode, n, 0.0, 0.0, 1.0, spin, angle)
            n += 1
    if size[PIVOT] >= 0:
        if n + 2 > 6:
            return -1
        rx, ry = lever(model, mode, size[PIVOT])
        _set_row(mode, n, 1.0, 0.0, -ry, 0.0, 0.0)
        _set_row(mode, n + 1, 0.0, 1.0, rx, 0.0, 0.0)
        n += 2
    size[ROWS] = n
    return n


@kernel
def _set_row(
    mode: ContactMode, n: int, a: float, b: float, c: float, right: float, gap: float
) -> None:
    mode.row[n, 0] = a
    mode.row[n, 1] = b
    mode.row[n, 2] = c
    mode.pull[n, 0] = a
    mode.pull[n, 1] = b
    mode.pull[n, 2] = c
    mode.right[n] = right
    mode.push[n] = right
    mode.gap[n] = gap


@kernel
def lever(model: Model, mode: ContactMode, e: int) -> tuple[float, float]:
    """Support element e from the part's centre of mass, in the world."""
    f = mode.frame[0]
    x = model.element_point[e, 0]
    y = model.element_point[e, 1]
    return f[0] * x - f[1] * y, f[1] * x + f[0] * y


@kernel
def _add_friction(
    model: Model,
    mode: ContactMode,
    e: int,
    velocity: FloatArray,
    total: FloatArray,
    matrix: FloatArray,
    ways: FloatArray,
    sloped: bool,
) -> None:
    """Add the resistance of a sliding element to `total`; with `sloped`, its derivative along the
    three columns of `ways` to `matrix`."""
    rx, ry = lever(model, mode, e)
    arm = model.element_ratio[e] if model.element_kind[e] == codes.ELLIPSOID else 0.0
    ux = velocity[0] - velocity[2] * ry
    uy = velocity[1] + velocity[2] * rx
    uz = arm * velocity[2]
    speed = max(math.sqrt(ux * ux + uy * uy + uz * uz), SLOW)
    ex = ux / speed
    ey = uy / speed
    ez = uz / speed
    w = mode.weight[e]
    total[0] += w * ex
    total[1] += w * ey
    total[2] += w * (rx * ey - ry * ex + arm * ez)
    if not sloped:
        return
    for j in range(3):
        dx = ways[0, j] - ways[2, j] * ry
        dy = ways[1, j] + ways[2, j] * rx
        dz = arm * ways[2, j]
        along = ex * dx + ey * dy + ez * dz
        dx = w * (dx - along * ex) / speed
        dy = w * (dy - along * ey) / speed
        dz = w * (dz - along * ez) / speed
        matrix[0, j] += dx
        matrix[1, j] += dy
        matrix[2, j] += rx * dy - ry * dx + arm * dz


@large_kernel
def seed(model: Model, mode: ContactMode, velocity: FloatArray) -> None:
    """Start Newton's unknowns at a velocity, about its slowest support point."""
    size = mode.size
    size[POLE] = -1
    slowest = math.inf
    for e in range(model.element_body.size):
        if model.element_kind[e] == codes.ELLIPSOID:
            size[POLE] = -1
            break
        rx, ry = lever(model, mode, e)
        ux = velocity[0] - velocity[2] * ry
        uy = velocity[1] + velocity[2] * rx
        slip = math.sqrt(ux * ux + uy * uy)
        if slip < slowest:
            slowest = slip
            size[POLE] = e
            mode.unknown[0] = slip
            mode.unknown[1] = math.atan2(uy, ux)
    if size[POLE] < 0:
        mode.unknown[0] = velocity[0]
        mode.unknown[1] = velocity[1]
    mode.unknown[2] = velocity[2]


@large_kernel
def assemble(model: Model, mode: ContactMode, n: int, sloped: bool) -> None:
    """Write the velocity of the unknowns and the residuals of the balance of wrenches and of `n`
    rows; with `sloped`, their derivatives too."""
    y = mode.unknown
    matrix = mode.matrix
    vector = mode.vector
    velocity = mode.velocity
    ways = mode.ways
    pole = mode.size[POLE]
    for i in range(3 + n):
        vector[i] = 0.0
        for j in range(3 + n):
            matrix[i, j] = 0.0
    for i in range(3):
        for j in range(3):
            ways[i, j] = 1.0 if i == j else 0.0
        velocity[i] = y[i]
    if pole >= 0:
        rx, ry = lever(model, mode, pole)
        c = math.cos(y[1])
        s = math.sin(y[1])
        velocity[0] = y[0] * c + y[2] * ry
        velocity[1] = y[0] * s - y[2] * rx
        ways[0, 0] = c
        ways[1, 0] = s
        ways[0, 1] = -y[0] * s
        ways[1, 1] = y[0] * c
        ways[0, 2] = ry
        ways[1, 2] = -rx
        w = mode.weight[pole]
        vector[0] = w * c
        vector[1] = w * s
        vector[2] = w * (rx * s - ry * c)
        matrix[0, 1] = -w * s
        matrix[1, 1] = w * c
        matrix[2, 1] = w * (rx * c + ry * s)
    for e in range(model.element_body.size):
        if e != pole and e != mode.size[PIVOT]:
            _add_friction(model, mode, e, velocity, vector, matrix, ways, sloped)
    for k in range(n):
        for i in range(3):
            vector[i] -= mode.pull[k, i] * y[3 + k]
            matrix[i, 3 + k] = -mode.pull[k, i]
        vector[3 + k] = -mode.right[k]
        for i in range(3):
            vector[3 + k] += mode.row[k, i] * velocity[i]
            matrix[3 + k, i] = (
                mode.row[k, 0] * ways[0, i]
                + mode.row[k, 1] * ways[1, i]
                + mode.row[k, 2] * ways[2, i]
            )


@large_kernel
def _solve_sliding(model: Model, mode: ContactMode, n: int) -> bool:
    """Newton's method for a part that slides on all its supports with one or two rows."""
    y = mode.unknown
    vector = mode.vector
    polar = mode.size[POLE] >= 0
    worst = math.inf
    for _ in range(NEWTON_STEPS):
        assemble(model, mode, n, True)
        worst = 0.0
        for i in range(3 + n):
            worst = max(worst, abs(vector[i]))
        if worst < SOLVED:
            break
        if not solve_dense(mode.matrix, vector, 3 + n):
            return False
        part = TURN / abs(vector[1]) if polar and abs(vector[1]) > TURN else 1.0
        for i in range(3 + n):
            y[i] -= part * vector[i]
        if not abs(y[0]) < FASTEST:
            return False
    for k in range(n):
        mode.force[k] = y[3 + k]
    mode.margin[SUPPORT] = y[0] if polar else math.inf
    return worst < ENOUGH


@large_kernel
def _solve_moved(model: Model, mode: ContactMode) -> bool:
    """Solve a mode whose three rows prescribe the velocity; their forces follow."""
    matrix = mode.matrix
    vector = mode.vector
    for k in range(3):
        vector[k] = mode.right[k]
        for i in range(3):
            matrix[k, i] = mode.row[k, i]
    if not solve_dense(matrix, vector, 3):
        return False
    largest = 0.0
    for i in range(3):
        mode.velocity[i] = vector[i]
        largest = max(largest, abs(vector[i]))
        vector[i] = 0.0
    if not largest < FASTEST:
        return False
    for e in range(model.element_body.size):
        if e != mode.size[PIVOT]:
            _add_friction(model, mode, e, mode.velocity, vector, matrix, mode.ways, False)
    for k in range(3):
        for i in range(3):
            matrix[i, k] = mode.pull[k, i]
    if not solve_dense(matrix, vector, 3):
        return False
    mode.size[POLE] = -1
    for k in range(3):
        mode.force[k] = vector[k]
        mode.unknown[k] = mode.velocity[k]
        mode.unknown[3 + k] = vector[k]
    if mode.size[PIVOT] >= 0:
        w = mode.weight[mode.size[PIVOT]]
        mode.margin[SUPPORT] = 1.0 - (vector[1] ** 2 + vector[2] ** 2) / (w * w)
    return True


@large_kernel
def solve_mode(model: Model, mode: ContactMode, q: FloatArray) -> bool:
    """Solve a mode at a state: velocity, forces and margins, without those of open gaps.

    Forces are in units of the whole support friction. Returns False where Newton's method does not
    arrive.
    """
    place_mode(model, mode, q)
    n = write_rows(model, mode)
    if n < 1 or n > 3 or (mode.size[PIVOT] >= 0 and n != 3):
        return False
    if n == 3:
        if not _solve_moved(model, mode):
            return False
    elif not _solve_sliding(model, mode, n):
        return False
    k = 0
    power = 0.0
    for c in range(mode.size[N_CLOSED]):
        own = mode.contact[c]
        m = OWN * c
        margin = mode.margin
        body = model.piece_body[own[SECOND]]
        rub = model.friction[0, body]
        normal = mode.force[k]
        margin[m] = normal
        power += mode.push[k] * normal
        k += 1
        if own[SLIP] == 0:
            margin[m + 1] = rub * normal - mode.force[k]
            margin[m + 2] = rub * normal + mode.force[k]
            power += mode.push[k] * mode.force[k]
            k += 1
        elif rub > 0.0:
            slip = -mode.tangent[c, 3]
            for i in range(3):
                slip += mode.tangent[c, i] * mode.velocity[i]
            margin[m + 1] = -own[SLIP] * slip
        if own[FORM] == FLUSH:
            # The centre of pressure stays where the edges overlap.
            start = margin[m + 3]
            end = margin[m + 4]
            moment = mode.force[k]
            power += mode.push[k] * moment
            margin[m + 3] = end - start
            margin[m + 4] = math.inf
            # Along the obstacle's edge a force at x has the moment -x about its middle.
            margin[m + 5] = end * normal + moment
            margin[m + 6] = -start * normal - moment
            k += 1
    mode.margin[DRIVE] = mode.number[LIMIT] - power / mode.number[SPEED]
    return True


@large_kernel
def project(model: Model, mode: ContactMode, q: FloatArray) -> None:
    """Take back the drift of closed gaps and flush angles, by the least change of the pose.

    The rows must be those of the pose `q`.
    """
    count = 0
    for k in range(mode.size[ROWS]):
        if mode.gap[k] != 0.0:
            mode.drifted[count] = k
            count += 1
    if count == 0 or count > 3:
        return
    matrix = mode.matrix
    right = mode.force
    for a in range(count):
        row = mode.row[mode.drifted[a]]
        right[a] = mode.gap[mode.drifted[a]]
        for b in range(count):
            other = mode.row[mode.drifted[b]]
            matrix[a, b] = row[0] * other[0] + row[1] * other[1] + row[2] * other[2]
    if not solve_dense(matrix, right, count):
        return
    for a in range(count):
        for i in range(3):
            q[i] -= right[a] * mode.row[mode.drifted[a], i]
