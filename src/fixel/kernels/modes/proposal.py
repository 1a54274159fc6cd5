"""Choice of the next mode.

The solver of the stepper solves a step a little ahead. The mode read from its solution is mended
until it holds there.
"""

import math

from fixel.kernels import arrays as at, codes
from fixel.kernels.arrays import N_CONTACT, NORMAL_X, NORMAL_Y, Model, Problem, State, Workspace
from fixel.kernels.gap import FEATURES, FIRST_VERTEX, VERTEX_VERTEX
from fixel.kernels.jit import kernel, large_kernel, spliced_kernel
from fixel.kernels.modes.equation import project, seed, solve_mode, write_rows
from fixel.kernels.modes.geometry import (
    EDGE,
    FIRST,
    FLUSH,
    FORM,
    FRICTION,
    MOST,
    N_CLOSED,
    ONE,
    OPEN,
    OTHER,
    OWN,
    PIVOT,
    POLE,
    ROUND,
    ROWS,
    SECOND,
    SLIP,
    SPEED,
    SUPPORT,
    TIP,
    ContactMode,
    after,
    is_disk,
    place_mode,
    set_frame,
    vertex_at,
)
from fixel.kernels.newton import newton, start_afresh
from fixel.kernels.solve import (
    MAX_ATTEMPTS_EARLY,
    NEWTON_TOLERANCE,
    QUICK_ITERATIONS,
    TOLERANCE,
    recover,
    save,
)
from fixel.kernels.step import keep_impulses, prepare_step
from fixel.typing import FloatArray

# What a proposal is.
SLIDES = 0
RESTS = 1
STALLS = 2
UNKNOWN = -1  # no solution, or a mode that cannot be described

BROKEN = -1e-6  # of a proposed mode's margins
LOST = 1e-10  # by which a margin may be negative a little ahead
MENDS = 6  # changes of a proposed mode, at most
SLOWED = 0.999  # of its commanded speed: a drive that is slower has reached its limit
STILL = 1e-7  # speed of a part at rest
PRESSES = 1e-7  # share of the support friction: a contact with less is open
INSIDE_CONE = 1e-5  # of friction that sticks, from its limit


@kernel
def _facing(model: Model, mode: ContactMode, piece: int, nx: float, ny: float) -> int:
    """Edge of a piece whose outward normal is nearest to (nx, ny)."""
    f = mode.frame[model.piece_body[piece]]
    best = -math.inf
    found = int(model.piece_start[piece])
    for k in range(model.piece_start[piece], model.piece_start[piece + 1]):
        m = after(model, piece, k)
        ex = model.vertex[m, 0] - model.vertex[k, 0]
        ey = model.vertex[m, 1] - model.vertex[k, 1]
        wx = f[0] * ex - f[1] * ey
        wy = f[1] * ex + f[0] * ey
        lean = (wy * nx - wx * ny) / math.sqrt(ex * ex + ey * ey)
        if lean > best:
            best = lean
            found = k
    return found


@kernel
def _facing_disk(
    model: Model, mode: ContactMode, piece: int, disk: int, nx: float, ny: float
) -> tuple[int, bool]:
    """Edge of a polygon that faces a disk along (nx, ny), and True; where its centre is beyond an
    end of that edge, the corner there, and False."""
    edge = _facing(model, mode, piece, nx, ny)
    body = model.piece_body[piece]
    last = after(model, piece, edge)
    ax, ay = vertex_at(model, mode, body, edge)
    bx, by = vertex_at(model, mode, body, last)
    cx, cy = vertex_at(model, mode, model.piece_body[disk], model.piece_start[disk])
    along = (cx - ax) * (bx - ax) + (cy - ay) * (by - ay)
    if along < 0.0:
        return edge, False
    if along > (bx - ax) ** 2 + (by - ay) ** 2:
        return last, False
    return edge, True


@large_kernel
def _name_features(model: Model, mode: ContactMode, c: int, problem: Problem, i: int) -> bool:
    """Write form and features of contact i of the problem as contact c of the mode; False for two
    corners."""
    own = mode.contact[c]
    key = problem.contact_key[i]
    pair = key // FEATURES
    code = key % FEATURES
    one = pair // model.piece_body.size
    two = pair % model.piece_body.size
    place = problem.contact_place
    nx = place[i, NORMAL_X]
    ny = place[i, NORMAL_Y]
    own[FIRST] = one
    own[SECOND] = two
    first = model.piece_start[one]
    second = model.piece_start[two]
    if is_disk(model, one) or is_disk(model, two):
        own[ONE] = first
        own[OTHER] = second
        own[FORM] = ROUND
        if not is_disk(model, one):
            own[ONE], foot = _facing_disk(model, mode, one, two, -nx, -ny)
            own[FORM] = TIP if foot else ROUND
        elif not is_disk(model, two):
            own[OTHER], foot = _facing_disk(model, mode, two, one, nx, ny)
            own[FORM] = EDGE if foot else ROUND
        return True
    if VERTEX_VERTEX <= code < FIRST_VERTEX:
        return False
    if code >= FIRST_VERTEX:
        own[FORM] = EDGE
        own[ONE] = first + code - FIRST_VERTEX
        own[OTHER] = _facing(model, mode, two, nx, ny)
    else:
        own[FORM] = TIP
        own[ONE] = _facing(model, mode, one, -nx, -ny)
        own[OTHER] = second + code
    return True


@spliced_kernel
def propose(
    model: Model,
    mode: ContactMode,
    q: FloatArray,
    ahead: float,
    state: State,
    control: FloatArray,
    guess: FloatArray,
    rows: FloatArray,
    problem: Problem,
    work: Workspace,
) -> bool:
    """Solve a step of the length `ahead` from a state; False where no solver does."""
    for k in range(3):
        state.pose[0, k] = q[k]
    state.path_time[0] = q[3]
    control[at.TIME] = q[3]
    control[at.TRIAL] = ahead
    control[at.LEAD] = 0.5 * ahead
    control[at.SPAN] = ahead
    control[at.RATIO] = ahead / control[at.LAST_SPAN] if control[at.LAST_SPAN] > 0.0 else 0.0
    if not prepare_step(model, state, control, codes.QUASI_STATIC, guess, rows, problem, work):
        return False
    if problem.impulse[0, 0] == 0.0:
        start_afresh(problem)
    save(problem, work)
    residual = newton(problem, work, NEWTON_TOLERANCE, QUICK_ITERATIONS)
    if not residual <= TOLERANCE:
        residual, _ = recover(problem, work, guess, False, MAX_ATTEMPTS_EARLY)
    if not residual <= TOLERANCE:
        return False
    keep_impulses(control, problem, work)
    for i in range(problem.velocity.size - 2):
        guess[i] = problem.velocity[i]
    return True


@large_kernel
def read_mode(
    model: Model, mode: ContactMode, rows: FloatArray, ahead: float, problem: Problem
) -> int:
    """Read the mode of a solved step; returns SLIDES, RESTS, STALLS or UNKNOWN."""
    size = mode.size
    for body in range(2):
        set_frame(mode, body, rows[body, 0], rows[body, 1], rows[body, 2])
    size[N_CLOSED] = 0
    size[PIVOT] = -1
    v = problem.velocity
    scale = ahead * mode.number[FRICTION]
    if model.drive_dof[0] >= 0 and v[3] < SLOWED * mode.number[SPEED]:
        return STALLS
    if abs(v[0]) + abs(v[1]) + abs(v[2]) < STILL:
        return RESTS
    k = 0  # of the unknown forces
    for i in range(problem.size[N_CONTACT]):
        normal = problem.impulse[i, 0] / scale
        if normal <= PRESSES:
            continue
        pair = problem.contact_key[i] // FEATURES
        tangential = problem.impulse[i, 1] / scale
        c = size[N_CLOSED]
        if c > 0 and (
            mode.contact[c - 1, FIRST] * model.piece_body.size + mode.contact[c - 1, SECOND] == pair
        ):
            own = mode.contact[c - 1]
            if own[FORM] == FLUSH:
                return UNKNOWN
            nx = problem.contact_place[i, NORMAL_X]
            ny = problem.contact_place[i, NORMAL_Y]
            own[FORM] = FLUSH
            own[ONE] = _facing(model, mode, own[FIRST], -nx, -ny)
            own[OTHER] = _facing(model, mode, own[SECOND], nx, ny)
            mode.proposed[c - 1, 0] += normal
            mode.proposed[c - 1, 1] += tangential
            continue
        if c == MOST:
            return UNKNOWN
        if not _name_features(model, mode, c, problem, i):
            return UNKNOWN
        mode.proposed[c, 0] = normal
        mode.proposed[c, 1] = tangential
        size[N_CLOSED] += 1
    for c in range(size[N_CLOSED]):
        own = mode.contact[c]
        rub = model.friction[0, model.piece_body[own[SECOND]]]
        normal = mode.proposed[c, 0]
        tangential = mode.proposed[c, 1]
        own[SLIP] = 1 if tangential >= 0.0 else -1
        if abs(tangential) < rub * normal * (1.0 - INSIDE_CONE):
            own[SLIP] = 0
        mode.unknown[3 + k] = normal
        k += 1
        if own[SLIP] == 0:
            mode.unknown[3 + k] = tangential
            k += 1
        if own[FORM] == FLUSH:
            mode.unknown[3 + k] = 0.0
            k += 1
        if k > 3:
            return UNKNOWN
    for i in range(3):
        mode.velocity[i] = v[i]
    seed(model, mode, True)
    for e in range(model.element_body.size):
        if model.element_kind[e] != codes.POINT:
            continue
        fx = problem.element_impulse[e, 0]
        fy = problem.element_impulse[e, 1]
        strength = math.sqrt(fx * fx + fy * fy)
        limit = problem.element_limit[e]
        if strength < limit * (1.0 - INSIDE_CONE):
            if size[PIVOT] >= 0:
                return UNKNOWN
            size[PIVOT] = e
        elif e == size[POLE] and strength > 0.0:
            # Where it hardly slips, its direction is that of its friction.
            mode.unknown[1] = math.atan2(-fy, -fx)
    return SLIDES


@large_kernel
def settle(model: Model, mode: ContactMode, q: FloatArray) -> bool:
    """Solve the mode at a state, after taking back the drift of its closed gaps."""
    place_mode(mode, q)
    if write_rows(model, mode) < 0:
        return False
    project(mode, q)
    return solve_mode(model, mode, q)


@large_kernel
def mend(model: Model, mode: ContactMode, which: int) -> bool:
    """Change a mode where its margin is broken: a contact that pulls opens, one out of its cone
    slips, one that slips back sticks, and so does or slides a support; False for other margins."""
    size = mode.size
    if which == SUPPORT:
        if size[PIVOT] >= 0:
            # It slides against its friction.
            k = size[ROWS] - 2
            fx = mode.force[k]
            fy = mode.force[k + 1]
            pole = size[PIVOT]
            size[PIVOT] = -1
            seed(model, mode, True)
            if size[POLE] == pole:
                mode.unknown[1] = math.atan2(-fy, -fx)
        elif size[ROWS] == 1:
            size[PIVOT] = size[POLE]
        else:
            return False
    elif which < SUPPORT:
        c = which // OWN
        own = mode.contact[c]
        kind = which % OWN
        if kind == 0:
            for d in range(c, size[N_CLOSED] - 1):
                mode.margin[OWN * d] = mode.margin[OWN * (d + 1)]
                for i in range(6):
                    mode.contact[d, i] = mode.contact[d + 1, i]
            size[N_CLOSED] -= 1
        elif kind > 2:
            return False
        elif own[SLIP] != 0:
            own[SLIP] = 0
        else:
            own[SLIP] = 1 if kind == 1 else -1
        seed(model, mode, True)
    else:
        return False
    k = 3
    for c in range(size[N_CLOSED]):
        own = mode.contact[c]
        mode.unknown[k] = mode.margin[OWN * c]
        k += 1
        if own[SLIP] == 0:
            mode.unknown[k] = 0.0
            k += 1
        if own[FORM] == FLUSH:
            mode.unknown[k] = 0.0
            k += 1
        if k > 6:
            return False
    return True


@large_kernel
def enter(model: Model, mode: ContactMode, q: FloatArray, ahead: float) -> bool:
    """Solve a proposed mode, mended until it holds at a state and a little ahead; False where it
    does not."""
    point = mode.point[2]
    for _ in range(MENDS):
        if not settle(model, mode, q):
            return False
        worst = 0.0
        which = -1
        for k in range(OPEN):
            if mode.margin[k] < min(worst, BROKEN):
                worst = mode.margin[k]
                which = k
        if which < 0:
            for i in range(3):
                point[i] = q[i] + ahead * mode.velocity[i]
            point[3] = q[3] + ahead
            for i in range(9):
                mode.saved[i] = mode.unknown[i]
            for k in range(OPEN):
                mode.floor[k] = mode.margin[k]
            if not solve_mode(model, mode, point):
                return False
            for k in range(OPEN):
                if mode.margin[k] < min(worst, -LOST) and mode.margin[k] < mode.floor[k]:
                    worst = mode.margin[k]
                    which = k
            if which < 0:
                for i in range(9):
                    mode.unknown[i] = mode.saved[i]
                return solve_mode(model, mode, q)
        if not mend(model, mode, which):
            return False
    return False
