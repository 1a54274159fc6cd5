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
CAUTIOUS = 1e4  # residual over the square of the one before, at most, before it is known
SLOW = 1e-9  # slip of a support point below which its direction is not resolved


@kernel
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
def _slide(
    model: Model, mode: ContactMode, e: int
) -> tuple[float, float, float, float, float, float, float]:
    """Wrench of a sliding element at the velocity of the mode, for a friction limit of one, its
    lever, its arm about its own axis, and one over its speed."""
    velocity = mode.velocity
    rx, ry = lever(model, mode, e)
    arm = model.element_ratio[e] if model.element_kind[e] == codes.ELLIPSOID else 0.0
    ux = velocity[0] - velocity[2] * ry
    uy = velocity[1] + velocity[2] * rx
    uz = arm * velocity[2]
    slow = 1.0 / max(math.sqrt(ux * ux + uy * uy + uz * uz), SLOW)
    ex = ux * slow
    ey = uy * slow
    return ex, ey, rx * ey - ry * ex + arm * uz * slow, rx, ry, arm, slow


@large_kernel
def seed(model: Model, mode: ContactMode, always: bool) -> bool:
    """Start Newton's unknowns at the velocity, about its slowest support point; unless `always`,
    only where that is another one now. Returns whether it did."""
    y = mode.unknown
    velocity = mode.velocity
    pole = -1
    slowest = math.inf
    ux, uy = velocity[0], velocity[1]
    for e in range(model.element_body.size):
        if model.element_kind[e] == codes.ELLIPSOID:
            pole = -1
            ux, uy = velocity[0], velocity[1]
            break
        rx, ry = lever(model, mode, e)
        wx = velocity[0] - velocity[2] * ry
        wy = velocity[1] + velocity[2] * rx
        if wx * wx + wy * wy < slowest:
            slowest = wx * wx + wy * wy
            pole = e
            ux, uy = wx, wy
    if not always and pole == mode.size[POLE] and (pole < 0 or y[0] >= 0.0):
        return False
    mode.size[POLE] = pole
    y[0] = ux if pole < 0 else math.sqrt(slowest)
    y[1] = uy if pole < 0 else math.atan2(uy, ux)
    y[2] = velocity[2]
    return True


@kernel
def write_velocity(model: Model, mode: ContactMode) -> tuple[float, float, float, float]:
    """Write the velocity of the unknowns; returns direction and lever of the pole."""
    y = mode.unknown
    velocity = mode.velocity
    velocity[2] = y[2]
    if mode.size[POLE] < 0:
        velocity[0] = y[0]
        velocity[1] = y[1]
        return 1.0, 0.0, 0.0, 0.0
    rx, ry = lever(model, mode, mode.size[POLE])
    c = math.cos(y[1])
    s = math.sin(y[1])
    velocity[0] = y[0] * c + y[2] * ry
    velocity[1] = y[0] * s - y[2] * rx
    return c, s, rx, ry


@kernel
def assemble(model: Model, mode: ContactMode, n: int, slopes: bool) -> None:
    """Write the velocity of the unknowns, the residuals of the balance of wrenches and of `n` rows,
    and, with `slopes`, their derivatives by the first three unknowns."""
    y = mode.unknown
    matrix = mode.matrix
    vector = mode.vector
    ways = mode.ways
    pole = mode.size[POLE]
    c, s, px, py = write_velocity(model, mode)
    v0 = v1 = v2 = 0.0
    a00 = a01 = a02 = a11 = a12 = a22 = 0.0
    for e in range(model.element_body.size):
        if e == pole or e == mode.size[PIVOT]:
            continue
        ex, ey, ez, rx, ry, arm, slow = _slide(model, mode, e)
        w = mode.weight[e]
        v0 += w * ex
        v1 += w * ey
        v2 += w * ez
        if slopes:
            w *= slow
            a00 += w * (1.0 - ex * ex)
            a01 -= w * ex * ey
            a02 -= w * (ry + ex * ez)
            a11 += w * (1.0 - ey * ey)
            a12 += w * (rx - ey * ez)
            a22 += w * (rx * rx + ry * ry + arm * arm - ez * ez)
    if slopes:
        ways[0, 0] = c
        ways[1, 0] = s
        ways[2, 0] = 0.0
        ways[0, 1] = -y[0] * s if pole >= 0 else 0.0
        ways[1, 1] = y[0] * c if pole >= 0 else 1.0
        ways[2, 1] = 0.0
        ways[0, 2] = py
        ways[1, 2] = -px
        ways[2, 2] = 1.0
        for j in range(3):
            matrix[0, j] = a00 * ways[0, j] + a01 * ways[1, j] + a02 * ways[2, j]
            matrix[1, j] = a01 * ways[0, j] + a11 * ways[1, j] + a12 * ways[2, j]
            matrix[2, j] = a02 * ways[0, j] + a12 * ways[1, j] + a22 * ways[2, j]
    if pole >= 0:
        w = mode.weight[pole]
        v0 += w * c
        v1 += w * s
        v2 += w * (px * s - py * c)
        if slopes:
            matrix[0, 1] -= w * s
            matrix[1, 1] += w * c
            matrix[2, 1] += w * (px * c + py * s)
    velocity = mode.velocity
    for k in range(n):
        v0 -= mode.pull[k, 0] * y[3 + k]
        v1 -= mode.pull[k, 1] * y[3 + k]
        v2 -= mode.pull[k, 2] * y[3 + k]
        r0 = mode.row[k, 0]
        r1 = mode.row[k, 1]
        r2 = mode.row[k, 2]
        vector[3 + k] = r0 * velocity[0] + r1 * velocity[1] + r2 * velocity[2] - mode.right[k]
        for j in range(3 if slopes else 0):
            matrix[3 + k, j] = r0 * ways[0, j] + r1 * ways[1, j] + r2 * ways[2, j]
    vector[0] = v0
    vector[1] = v1
    vector[2] = v2


@kernel
def _write_cross(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@kernel
def write_dual(rows: FloatArray, dual: FloatArray) -> bool:
    """Write the vectors of which each makes 1 with its row and 0 with the others; False where the
    rows depend on each other."""
    _write_cross(rows[1], rows[2], dual[0])
    _write_cross(rows[2], rows[0], dual[1])
    _write_cross(rows[0], rows[1], dual[2])
    volume = rows[0, 0] * dual[0, 0] + rows[0, 1] * dual[0, 1] + rows[0, 2] * dual[0, 2]
    if not abs(volume) > 0.0:
        return False
    share = 1.0 / volume
    for k in range(3):
        for i in range(3):
            dual[k, i] *= share
    return True


@kernel
def reduce_balance(mode: ContactMode, n: int) -> bool:
    """Write three equations for the velocity alone, and their dual vectors; False where they depend
    on each other.

    They are the `n` rows and the balance along directions in which no contact force acts.
    """
    matrix = mode.matrix
    pull = mode.pull
    solve = mode.solve
    if n == 1:
        pull[1, 0] = -pull[0, 1]
        pull[1, 1] = pull[0, 0]
        pull[1, 2] = 0.0
    if n < 3:
        _write_cross(pull[0], pull[1], pull[2])
    for k in range(3):
        for j in range(3):
            if k < n:
                solve[k, j] = matrix[3 + k, j]
            else:
                x, y, z = pull[k, 0], pull[k, 1], pull[k, 2]
                solve[k, j] = x * matrix[0, j] + y * matrix[1, j] + z * matrix[2, j]
    return write_dual(solve, mode.dual)


@kernel
def newton_step(mode: ContactMode, n: int) -> bool:
    """Replace the residuals by the changes of the unknowns that make them; False where there are
    none. The forces follow from the balance."""
    vector = mode.vector
    matrix = mode.matrix
    pull = mode.pull
    dual = mode.dual
    right = mode.change
    if not reduce_balance(mode, n):
        return False
    for k in range(3):
        right[k] = vector[3 + k]
        if k >= n:
            right[k] = pull[k, 0] * vector[0] + pull[k, 1] * vector[1] + pull[k, 2] * vector[2]
    for i in range(3):
        right[3 + i] = -vector[i]
    for j in range(3):
        vector[j] = right[0] * dual[0, j] + right[1] * dual[1, j] + right[2] * dual[2, j]
        for i in range(3):
            right[3 + i] += matrix[i, j] * vector[j]
    if not write_dual(pull, dual):
        return False
    for k in range(n):
        vector[3 + k] = 0.0
        for i in range(3):
            vector[3 + k] += dual[k, i] * right[3 + i]
    return True


@kernel
def _solve_sliding(model: Model, mode: ContactMode, n: int) -> bool:
    """Newton's method for a part that slides on all its supports with one or two rows."""
    y = mode.unknown
    vector = mode.vector
    polar = mode.size[POLE] >= 0
    worst = math.inf
    for _ in range(NEWTON_STEPS):
        last = worst
        assemble(model, mode, n, True)
        worst = 0.0
        for i in range(3 + n):
            worst = max(worst, abs(vector[i]))
        if worst < SOLVED:
            break
        if not newton_step(mode, n):
            return False
        part = TURN / abs(vector[1]) if polar and abs(vector[1]) > TURN else 1.0
        for i in range(3 + n):
            y[i] -= part * vector[i]
        if not abs(y[0]) < FASTEST:
            return False
        # It converges as the square: the next residual is known well enough not to be computed.
        rate = CAUTIOUS if math.isinf(last) else max(1.0, worst / (last * last))
        if rate * worst * worst < SOLVED:
            write_velocity(model, mode)
            worst = SOLVED
            break
    for k in range(n):
        mode.force[k] = y[3 + k]
    mode.margin[SUPPORT] = y[0] if polar else math.inf
    return worst < ENOUGH


@kernel
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
            ex, ey, ez, _, _, _, _ = _slide(model, mode, e)
            w = mode.weight[e]
            vector[0] += w * ex
            vector[1] += w * ey
            vector[2] += w * ez
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
    place_mode(mode, q)
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
def project(mode: ContactMode, q: FloatArray) -> bool:
    """Take back the drift of closed gaps and flush angles, by the least change of the pose; False
    where there is none.

    The rows must be those of the pose `q`.
    """
    count = 0
    for k in range(mode.size[ROWS]):
        if mode.gap[k] != 0.0:
            mode.drifted[count] = k
            count += 1
    if count == 0 or count > 3:
        return False
    matrix = mode.matrix
    right = mode.force
    for a in range(count):
        row = mode.row[mode.drifted[a]]
        right[a] = mode.gap[mode.drifted[a]]
        for b in range(count):
            other = mode.row[mode.drifted[b]]
            matrix[a, b] = row[0] * other[0] + row[1] * other[1] + row[2] * other[2]
    if not solve_dense(matrix, right, count):
        return False
    for a in range(count):
        for i in range(3):
            q[i] -= right[a] * mode.row[mode.drifted[a], i]
    return True
